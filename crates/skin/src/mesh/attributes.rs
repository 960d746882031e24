//! Colours and temperatures of a mesh's vertices from the eight nearest points (splatting.md §7.7, step 5).

use megas_body::neighbours::Neighbours;
use megas_model::Mesh;
use rayon::prelude::*;

/// Points looked at for each vertex.
const NEAREST: usize = 8;

/// Points with what they carry; `value` has one entry per position.
#[derive(Clone, Copy, Debug)]
pub struct Carriers<'a, T> {
    /// Positions \[scene units\].
    pub position: &'a [[f32; 3]],
    /// Values.
    pub value: &'a [T],
}

/// Mean of the nearest values, weighted with `1/(d² + 0.01Δ²)`, and the distance to the nearest.
fn blend<T: Copy, const N: usize>(
    tree: &Neighbours,
    values: &[T],
    x: &[f32; 3],
    spacing: f32,
    get: impl Fn(T) -> [f32; N],
) -> ([f32; N], f32) {
    let found = tree.nearest(x, NEAREST);
    let (mut sum, mut total) = ([0.0; N], 0.0);
    for (i, d2) in &found {
        let w = 1.0 / (d2 + 0.01 * spacing * spacing);
        total += w;
        let v = get(values[*i as usize]);
        (0..N).for_each(|k| sum[k] += w * v[k]);
    }
    (sum.map(|s| s / total.max(f32::MIN_POSITIVE)), found.first().map_or(f32::INFINITY, |f| f.1.sqrt()))
}

/// Colours the vertices from the surface points; where the nearest of them is far (from 2Δ to 4Δ) the inside shows, whose
/// points carry colours of their own.
pub fn colour(mesh: &mut Mesh, surface: Carriers<'_, [f32; 3]>, inside: Carriers<'_, [f32; 3]>, spacing: f32) {
    let (skin, core) = (Neighbours::new(surface.position), Neighbours::new(inside.position));
    let one = |x: &[f32; 3]| {
        let outer = skin.as_ref().map(|t| blend(t, surface.value, x, spacing, |c| c));
        let far = outer.map_or(1.0, |o| (0.5 * o.1 / spacing - 1.0).clamp(0.0, 1.0));
        let inner = core.as_ref().filter(|_| far > 0.0).map(|t| blend(t, inside.value, x, spacing, |c| c).0);
        match (outer, inner) {
            (Some((a, _)), Some(b)) => [0, 1, 2].map(|k| a[k] + far * (b[k] - a[k])),
            (Some((a, _)), None) => a,
            (None, Some(b)) => b,
            (None, None) => [0.5; 3],
        }
    };
    mesh.colours = mesh.positions.par_iter().with_min_len(256).map(one).collect();
}

/// Gives the vertices the temperatures of the points around them; nothing without points.
pub fn temperature(mesh: &mut Mesh, points: Carriers<'_, f32>, spacing: f32) {
    let Some(tree) = Neighbours::new(points.position) else { return };
    let one = |x: &[f32; 3]| blend(&tree, points.value, x, spacing, |t| [t]).0[0];
    mesh.temperature = mesh.positions.par_iter().with_min_len(256).map(one).collect();
}
