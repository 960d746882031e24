//! Tying the skin to the body. Glossy and translucent parts of imported splats have a faint skin above an opaque layer;
//! the interior test stops at that layer and leaves a pocket below the skin. Whatever floats above a pocket would stay in
//! the air while the body melts, so pockets under visible Gaussians are filled.

use std::collections::HashSet;

use megas_math::{Vec3, vec3};

use super::cleanup::fill_enclosed;
use super::{Filling, Grid};

/// A skin less than about 1.5 spacings above the body (this many half steps) belongs to its border.
const LEAST_STEPS: usize = 2;
/// Of the 26 neighbours of a filled pocket cell, this many must be inside or in the pocket: single threads are not filled.
const SUPPORT: usize = 9;

/// A visible Gaussian, in the filling frame.
#[derive(Clone, Copy, Debug)]
pub struct Skin {
    /// Centre.
    pub position: Vec3<f64>,
    /// Outward unit normal.
    pub normal: Vec3<f64>,
    /// Extent across the normal (one standard deviation).
    pub radius: f64,
}

/// Fills the cells between the body and the skin where the body begins within `reach` (a length, at least eight particle
/// spacings are used) along the inward normal. Returns how many cells became interior.
pub fn attach(filling: &mut Filling, skin: &[Skin], reach: f64) -> usize {
    let grid = filling.grid;
    let delta = grid.spacing * filling.per_particle as f64;
    let steps = (2.0 * reach.max(8.0 * delta) / grid.spacing) as usize;
    let mut pocket: HashSet<usize> = HashSet::new();
    let mut path = Vec::new();
    for s in skin {
        if !descend(filling, s.position, s.normal, steps, &mut path) {
            continue;
        }
        pocket.extend(&path);
        // The skin may be sparser than the grid: a Gaussian covers a disc.
        let (t1, t2) = vec3::frame_from_normal(s.normal);
        let rings = (s.radius / grid.spacing).min(4.0 * filling.per_particle as f64) as i32;
        for (u, v) in (-rings..=rings).flat_map(|u| (-rings..=rings).map(move |v| (u, v))) {
            if u * u + v * v > 0 && u * u + v * v <= rings * rings {
                let (du, dv) = (f64::from(u) * grid.spacing, f64::from(v) * grid.spacing);
                let from = vec3::add_scaled(vec3::add_scaled(s.position, t1, du), t2, dv);
                if descend(filling, from, s.normal, steps, &mut path) {
                    pocket.extend(&path);
                }
            }
        }
    }
    // The order of a hash set must not show: sort before the decisions, decide before the changes.
    let mut candidates: Vec<usize> = pocket.iter().copied().collect();
    candidates.sort_unstable();
    for _ in 0..3 {
        let keep: Vec<usize> = candidates.iter().copied().filter(|&i| support(&grid, i, &filling.inside, &pocket) >= SUPPORT).collect();
        pocket = keep.iter().copied().collect();
        candidates = keep;
    }
    for &i in &candidates {
        filling.inside[i] = true;
    }
    let mut added = candidates.len() + close_gaps(&grid, &mut filling.inside, &candidates);
    added += fill_enclosed(&grid, &mut filling.inside);
    filling.report.attached = added;
    filling.report.interior += added;
    added
}

/// Collects the cells from below a point of the skin down to the body; false if that is nearer than a pocket or out of reach.
fn descend(filling: &Filling, from: Vec3<f64>, normal: Vec3<f64>, steps: usize, path: &mut Vec<usize>) -> bool {
    let grid = &filling.grid;
    path.clear();
    // From three quarters of a cell below the skin: the body's own border is no pocket.
    for k in 1..steps {
        let Some(cell) = grid.locate(vec3::add_scaled(from, normal, -0.5 * grid.spacing * (k as f64 + 0.5))) else { return false };
        let i = grid.index(cell);
        if filling.inside[i] {
            return k > LEAST_STEPS * filling.per_particle;
        }
        path.push(i);
    }
    false
}

/// Fills what the threads below neighbouring Gaussians left open between them, that
/// is cells within two of a pocket with a majority of interior neighbours, for as long as there are any, six times at most.
fn close_gaps(grid: &Grid, inside: &mut [bool], pocket: &[usize]) -> usize {
    const MAJORITY: usize = 14;
    let mut around: Vec<usize> = Vec::new();
    for &i in pocket {
        let c = grid.cell(i);
        for z in c[2].saturating_sub(2)..(c[2] + 3).min(grid.dims[2]) {
            for y in c[1].saturating_sub(2)..(c[1] + 3).min(grid.dims[1]) {
                around.extend((c[0].saturating_sub(2)..(c[0] + 3).min(grid.dims[0])).map(|x| grid.index([x, y, z])));
            }
        }
    }
    around.sort_unstable();
    around.dedup();
    let mut added = 0;
    let none = HashSet::new();
    for _ in 0..6 {
        let fill: Vec<usize> = around.iter().copied().filter(|&i| !inside[i] && support(grid, i, inside, &none) >= MAJORITY).collect();
        for &i in &fill {
            inside[i] = true;
        }
        added += fill.len();
        if fill.is_empty() {
            break;
        }
    }
    added
}

fn support(grid: &Grid, index: usize, inside: &[bool], pocket: &HashSet<usize>) -> usize {
    let c = grid.cell(index);
    let mut n = 0;
    for z in c[2].saturating_sub(1)..(c[2] + 2).min(grid.dims[2]) {
        for y in c[1].saturating_sub(1)..(c[1] + 2).min(grid.dims[1]) {
            for x in c[0].saturating_sub(1)..(c[0] + 2).min(grid.dims[0]) {
                let i = grid.index([x, y, z]);
                n += usize::from(i != index && (inside[i] || pocket.contains(&i)));
            }
        }
    }
    n
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fill::FillReport;

    #[test]
    fn a_pocket_under_a_sheet_is_filled_and_a_thread_is_not() {
        let grid = Grid { origin: [0.0; 3], spacing: 1.0, dims: [20, 20, 20] };
        let inside: Vec<bool> = (0..grid.len()).map(|i| grid.cell(i)[2] < 6).collect();
        let report = FillReport { interior: 6 * 400, ..FillReport::default() };
        let mut filling = Filling { grid, inside, votes: vec![0; grid.len()], per_particle: 1, report };
        let mut skin = Vec::new();
        let gaussian = |position| Skin { position, normal: [0.0, 0.0, 1.0], radius: 0.4 };
        for y in 2..12 {
            for x in 2..12 {
                if x == 6 && y == 7 {
                    continue;
                }
                skin.push(gaussian([x as f64 + 0.5, y as f64 + 0.5, 9.5]));
            }
        }
        skin.push(gaussian([16.5, 16.5, 10.5]));
        skin.push(gaussian([5.5, 5.5, 18.5]));
        let n = attach(&mut filling, &skin, 1.0);
        // Three layers of 10 × 10 below the skin's own and the fillet where they meet the
        // body; the thread and the far speck stay out.
        assert!((260..=345).contains(&n), "{n}");
        assert!(filling.inside[grid.index([6, 7, 7])] && !filling.inside[grid.index([16, 16, 8])]);
        assert!(!filling.inside[grid.index([5, 5, 14])]);
        assert_eq!(filling.report.interior, 2400 + n);
    }
}
