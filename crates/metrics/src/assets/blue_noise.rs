//! Blue-noise points on an implicit surface: no two closer than the spacing, no large gaps (splatting.md §5.5, §6.5).

use std::collections::HashMap;

use megas_math::{
    Vec3,
    rng::{Rng, hash01, mix},
    vec3,
};
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

/// Random candidates per cell; the gaps that remain are filled around the kept points.
const ROUNDS: usize = 4;
/// Candidates on the circle around every kept point, and how often newly kept ones get their own.
const AROUND: usize = 24;
const PASSES: usize = 3;

/// Throws random candidates onto the zero level of `solid` and keeps those at least `spacing` (> 0, scene units) from every
/// earlier one; then tries the circles around the kept points until hardly a gap for another one is left. The result
/// depends on the arguments alone.
pub fn blue_noise(solid: &impl Solid, spacing: f32, seed: u64) -> Vec<SurfacePoint> {
    let cells = surface_cells(solid, spacing);
    let mut net = Net { grid: Grid::new(spacing, cells.len()), kept: Vec::new(), spacing };
    for round in 0..ROUNDS {
        let candidates: Vec<Option<Vec3<f32>>> = cells
            .par_iter()
            .enumerate()
            .map(|(i, &lo)| {
                let mut rng = Rng::new(mix(seed) ^ mix((i * ROUNDS + round) as u64));
                net.candidate(solid, lo.map(|v| v + rng.unit() as f32 * spacing))
            })
            .collect();
        // Random order, or the first round would advance as a front and leave its pattern behind.
        let mut order: Vec<u32> = (0..candidates.len() as u32).filter(|&i| candidates[i as usize].is_some()).collect();
        order.sort_unstable_by_key(|&i| (mix(seed ^ mix(u64::from(i) + ((round as u64) << 40))), i));
        order.iter().filter_map(|&i| candidates[i as usize]).for_each(|x| net.offer(x));
    }
    let mut points: Vec<SurfacePoint> = Vec::new();
    for _ in 0..PASSES {
        let first = points.len();
        points.par_extend(net.kept[first..].par_iter().map(|&position| SurfacePoint { position, normal: solid.normal(position) }));
        let around: Vec<Vec3<f32>> = points[first..]
            .par_iter()
            .enumerate()
            .flat_map_iter(|(i, p)| {
                let (a, b) = vec3::frame_from_normal(p.normal);
                let turn = hash01(seed, (first + i) as u64, 77) as f32;
                let net = &net;
                (0..AROUND).filter_map(move |k| {
                    let (s, c) = ((k as f32 + turn) * (std::f32::consts::TAU / AROUND as f32)).sin_cos();
                    let r = 1.02 * spacing;
                    let x = vec3::add_scaled(vec3::add_scaled(p.position, a, c * r), b, s * r);
                    // Off the curved surface a little, so with some slack; most candidates end here without asking the body.
                    if net.grid.free(x, 0.93 * spacing, &net.kept) { net.candidate(solid, x) } else { None }
                })
            })
            .collect();
        around.iter().for_each(|&x| net.offer(x));
    }
    let first = points.len();
    points.par_extend(net.kept[first..].par_iter().map(|&position| SurfacePoint { position, normal: solid.normal(position) }));
    points
}

/// The points kept so far.
struct Net {
    grid: Grid,
    kept: Vec<Vec3<f32>>,
    spacing: f32,
}

impl Net {
    /// The surface point near `x`, unless it is sure to collide with a kept one.
    fn candidate(&self, solid: &impl Solid, x: Vec3<f32>) -> Option<Vec3<f32>> {
        // The projection of x lies |d| away, and |d| is at most the distance e of a kept point: if e is below half of the
        // spacing the projection must collide. With |d| known the test gets sharper.
        if !self.grid.free(x, 0.48 * self.spacing, &self.kept) {
            return None;
        }
        let d = solid.sdf(x);
        if d.abs() > 0.8 * self.spacing || !self.grid.free(x, self.spacing - 1.3 * d.abs(), &self.kept) {
            return None;
        }
        project(solid, x, d, self.spacing)
    }

    /// Keeps `x` if nothing is too close.
    fn offer(&mut self, x: Vec3<f32>) {
        if self.grid.free(x, self.spacing, &self.kept) {
            self.grid.insert(x, self.kept.len() as u32);
            self.kept.push(x);
        }
    }
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

/// For every point the numbers of the others within `reach`, in ascending order.
pub(super) fn neighbours(points: &[SurfacePoint], reach: f32) -> Vec<Vec<u32>> {
    let key = |x: Vec3<f32>| x.map(|v| (v / reach).floor() as i32);
    let mut sorted: Vec<(u64, u32)> = points.par_iter().enumerate().map(|(i, p)| (Grid::key(key(p.position)), i as u32)).collect();
    sorted.par_sort_unstable();
    points
        .par_iter()
        .enumerate()
        .map(|(i, p)| {
            let [a, b, c] = key(p.position);
            let mut out = Vec::new();
            for k in 0..27 {
                let cell = Grid::key([a + k % 3 - 1, b + k / 3 % 3 - 1, c + k / 9 - 1]);
                let start = sorted.partition_point(|&(key, _)| key < cell);
                for &(_, j) in sorted[start..].iter().take_while(|&&(key, _)| key == cell) {
                    let e = vec3::sub(points[j as usize].position, p.position);
                    if j as usize != i && vec3::dot(e, e) < reach * reach {
                        out.push(j);
                    }
                }
            }
            out.sort_unstable();
            out
        })
        .collect()
}

/// Accepted points by cell of side `spacing`. A cell holds few of them: at most 8 fit.
struct Grid {
    inv: f32,
    cells: HashMap<u64, ([u32; 8], u8), std::hash::BuildHasherDefault<CellHasher>>,
}

impl Grid {
    fn new(spacing: f32, capacity: usize) -> Self {
        Self { inv: 1.0 / spacing, cells: HashMap::with_capacity_and_hasher(capacity, Default::default()) }
    }

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
