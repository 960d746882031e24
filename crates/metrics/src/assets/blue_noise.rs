//! Blue-noise points on an implicit surface: no two closer than the spacing, no large gaps (splatting.md §5.5, §6.5).

use std::collections::HashMap;

use megas_math::{Vec3, rng::Rng, rng::mix, vec3};
use rayon::prelude::*;

use super::solid::Solid;

/// A point on a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfacePoint {
    /// Position, within a thousandth of the spacing of the surface (plus rounding).
    pub position: Vec3<f32>,
    /// Outward unit normal.
    pub normal: Vec3<f32>,
}

/// Candidates per accepted point: more fill the last gaps, fewer are faster. Gaps stay below about 1.3 spacings.
const ROUNDS: usize = 10;

/// Throws random candidates onto the zero level of `solid` and keeps those at least `spacing` (> 0, scene units) from every
/// earlier one. The order is random, so any prefix is spread over the whole surface; it depends on the arguments alone.
pub fn blue_noise(solid: &impl Solid, spacing: f32, seed: u64) -> Vec<SurfacePoint> {
    let cells = surface_cells(solid, spacing);
    let mut grid = Grid { inv: 1.0 / spacing, cells: HashMap::with_capacity_and_hasher(cells.len(), Default::default()) };
    let mut kept: Vec<Vec3<f32>> = Vec::new();
    for round in 0..ROUNDS {
        let candidates: Vec<Option<Vec3<f32>>> = cells
            .par_iter()
            .enumerate()
            .map(|(i, &lo)| {
                let mut rng = Rng::new(mix(seed) ^ mix((i * ROUNDS + round) as u64));
                let x = lo.map(|v| v + rng.unit() as f32 * spacing);
                project(solid, x, spacing)
            })
            .collect();
        // Random order, or the first round would advance as a front and leave its pattern behind.
        let mut order: Vec<u32> = (0..candidates.len() as u32).filter(|&i| candidates[i as usize].is_some()).collect();
        order.sort_unstable_by_key(|&i| (mix(seed ^ mix(u64::from(i) + ((round as u64) << 40))), i));
        for i in order {
            if let Some(x) = candidates[i as usize]
                && grid.free(x, spacing, &kept)
            {
                grid.insert(x, kept.len() as u32);
                kept.push(x);
            }
        }
    }
    kept.par_iter().map(|&position| SurfacePoint { position, normal: solid.normal(position) }).collect()
}

/// Lower corners of the cells of side `h` that the surface may cross, found from coarse to fine.
fn surface_cells(solid: &impl Solid, h: f32) -> Vec<Vec3<f32>> {
    const COARSE: usize = 8;
    let (lo, hi) = solid.bounds();
    let lo = lo.map(|v| v - 1.5 * h);
    let big = h * COARSE as f32;
    let n: [usize; 3] = std::array::from_fn(|a| ((hi[a] + 1.5 * h - lo[a]) / big).ceil() as usize);
    let corner = |lo: Vec3<f32>, i: usize, n: [usize; 3], h: f32| {
        [lo[0] + (i % n[0]) as f32 * h, lo[1] + (i / n[0] % n[1]) as f32 * h, lo[2] + (i / (n[0] * n[1])) as f32 * h]
    };
    let crossed = |c: Vec3<f32>, h: f32, slack: f32| solid.sdf(c.map(|v| v + 0.5 * h)).abs() < slack * h;
    (0..n[0] * n[1] * n[2])
        .into_par_iter()
        .flat_map_iter(|i| {
            let c = corner(lo, i, n, big);
            let fine = if crossed(c, big, 1.6) { COARSE.pow(3) } else { 0 };
            (0..fine).map(move |k| corner(c, k, [COARSE; 3], h)).filter(move |&c| crossed(c, h, 1.0))
        })
        .collect()
}

/// Moves `x` to the surface along its gradient; `None` if it started too far away or does not arrive.
fn project(solid: &impl Solid, x: Vec3<f32>, spacing: f32) -> Option<Vec3<f32>> {
    let mut d = solid.sdf(x);
    if d.abs() > 0.8 * spacing {
        return None;
    }
    let n = solid.normal(x);
    let (mut t, mut slope) = (0.0, 1.0f32);
    for _ in 0..6 {
        if d.abs() < 2e-3 * spacing {
            return Some(vec3::add_scaled(x, n, t));
        }
        let step = (-d / slope).clamp(-spacing, spacing);
        let next = solid.sdf(vec3::add_scaled(x, n, t + step));
        slope = ((next - d) / step).clamp(0.4, 2.5);
        t += step;
        d = next;
        if t.abs() > 1.5 * spacing {
            return None;
        }
    }
    (d.abs() < 1e-2 * spacing).then(|| vec3::add_scaled(x, n, t))
}

/// Accepted points by cell of side `spacing`. A cell holds few of them: at most 8 fit.
struct Grid {
    inv: f32,
    cells: HashMap<u64, ([u32; 8], u8), std::hash::BuildHasherDefault<CellHasher>>,
}

impl Grid {
    fn cell(&self, x: Vec3<f32>) -> [i32; 3] {
        x.map(|v| (v * self.inv).floor() as i32)
    }

    /// Cells are told apart within ±2²⁰ spacings of the origin.
    fn key(cell: [i32; 3]) -> u64 {
        cell.iter().fold(0, |key, &c| (key << 21) | (c as u64 & 0x1f_ffff))
    }

    fn free(&self, x: Vec3<f32>, r: f32, kept: &[Vec3<f32>]) -> bool {
        let [i, j, k] = self.cell(x);
        for dk in -1..=1 {
            for dj in -1..=1 {
                for di in -1..=1 {
                    if let Some((ids, n)) = self.cells.get(&Self::key([i + di, j + dj, k + dk])) {
                        for &id in &ids[..usize::from(*n)] {
                            let e = vec3::sub(kept[id as usize], x);
                            if vec3::dot(e, e) < r * r {
                                return false;
                            }
                        }
                    }
                }
            }
        }
        true
    }

    fn insert(&mut self, x: Vec3<f32>, id: u32) {
        let slot = self.cells.entry(Self::key(self.cell(x))).or_default();
        if let Some(place) = slot.0.get_mut(usize::from(slot.1)) {
            *place = id;
            slot.1 += 1;
        }
    }
}

/// Mixes the key of a cell; much cheaper than the default hasher and free of random state.
#[derive(Default)]
struct CellHasher(u64);

impl std::hash::Hasher for CellHasher {
    fn finish(&self) -> u64 {
        self.0
    }
    fn write(&mut self, bytes: &[u8]) {
        for &b in bytes {
            self.write_u64(u64::from(b));
        }
    }
    fn write_u64(&mut self, v: u64) {
        self.0 = mix(self.0 ^ v);
    }
}
