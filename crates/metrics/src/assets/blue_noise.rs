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
                // The projection of x lies |d| away, and |d| is at most the distance e of a kept point: if e is below half of
                // the spacing the projection must collide. With |d| known the test gets sharper.
                if !grid.free(x, 0.48 * spacing, &kept) {
                    return None;
                }
                let d = solid.sdf(x);
                let hopeless = d.abs() > 0.8 * spacing || !grid.free(x, spacing - 1.3 * d.abs(), &kept);
                if hopeless { None } else { project(solid, x, d, spacing) }
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

/// Lower corners of the cells of side `h` that the surface crosses, found from coarse to fine by halving.
fn surface_cells(solid: &impl Solid, h: f32) -> Vec<Vec3<f32>> {
    const LEVELS: i32 = 3;
    let (lo, hi) = solid.bounds();
    let lo = lo.map(|v| v - 1.5 * h);
    let big = h * f32::powi(2.0, LEVELS);
    let n: [usize; 3] = std::array::from_fn(|a| ((hi[a] + 1.5 * h - lo[a]) / big).ceil() as usize);
    let coarse = (0..n[0] * n[1] * n[2]).into_par_iter().flat_map_iter(|i| {
        let cell = vec3::add_scaled(lo, [i % n[0], i / n[0] % n[1], i / (n[0] * n[1])].map(|c| c as f32), big);
        let mut out = Vec::new();
        halve(solid, cell, big, LEVELS, &mut out);
        out
    });
    coarse.collect()
}

fn halve(solid: &impl Solid, lo: Vec3<f32>, side: f32, levels: i32, out: &mut Vec<Vec3<f32>>) {
    let d = solid.sdf(lo.map(|v| v + 0.5 * side)).abs();
    if levels == 0 {
        // Cells cut only at a corner are left out: points projected from their neighbours cover that piece.
        if d < 0.6 * side {
            out.push(lo);
        }
    } else if d < 1.1 * side {
        let half = 0.5 * side;
        for c in 0..8 {
            let offset = [c & 1, (c >> 1) & 1, c >> 2].map(|b| b as f32 * half);
            halve(solid, vec3::add(lo, offset), half, levels - 1, out);
        }
    }
}

/// Moves `x`, whose distance is known, to the surface along its gradient; `None` if it does not arrive.
fn project(solid: &impl Solid, x: Vec3<f32>, distance: f32, spacing: f32) -> Option<Vec3<f32>> {
    let mut d = distance;
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

    /// True if no kept point is nearer to `x` than `r` (at most the spacing).
    fn free(&self, x: Vec3<f32>, r: f32, kept: &[Vec3<f32>]) -> bool {
        if r <= 0.0 {
            return true;
        }
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
