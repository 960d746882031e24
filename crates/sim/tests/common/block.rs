//! Blocks of points.

use megas_model::{FLAG_INTERNAL, Points};

/// Eight points per cell of a block of `cells` whose corner is at `low` \[cells of `spacing`\]; `kind(site)` names object and
/// temperature \[K\] by the place in half cells.
pub fn block(low: [f64; 3], cells: [usize; 3], spacing: f64, kind: impl Fn([usize; 3]) -> (u16, f32)) -> Points {
    let mut points = Points::default();
    let [nx, ny, nz] = cells.map(|n| 2 * n);
    for i in 0..nx * ny * nz {
        let site = [i / nz / ny, i / nz % ny, i % nz];
        let (object, temperature) = kind(site);
        points.position.push(std::array::from_fn(|a| (low[a] + 0.5 * (site[a] as f64 + 0.5)) * spacing));
        points.volume.push((spacing / 2.0).powi(3) as f32);
        points.temperature.push(temperature);
        points.normal.push([0.0; 3]);
        points.material.push(0);
        points.object.push(object);
        points.flags.push(FLAG_INTERNAL);
        points.id.push(i as u32);
    }
    points
}
