//! Tying the skin to the body. Glossy and translucent parts of imported splats have a faint skin above an opaque layer;
//! the interior test stops at that layer and leaves a pocket below the skin. Whatever floats above a pocket would stay in
//! the air while the body melts, so pockets under visible Gaussians are filled.

use std::collections::HashSet;

use megas_math::{Vec3, vec3};

use super::{Filling, Grid};

/// How many particle spacings below a Gaussian the body may begin.
const REACH: usize = 8;
/// Of the 26 neighbours of a filled pocket cell, this many must be inside or in the pocket: single threads are not filled.
const SUPPORT: usize = 9;

/// Fills the cells between the body and `skin` (position in the filling frame, outward unit normal) where the body begins
/// within eight particle spacings along the inward normal. Returns how many cells became interior.
pub fn attach(filling: &mut Filling, skin: &[(Vec3<f64>, Vec3<f64>)]) -> usize {
    let grid = filling.grid;
    let step = 0.5 * grid.spacing;
    let mut pocket: HashSet<usize> = HashSet::new();
    let mut path = Vec::new();
    for &(position, normal) in skin {
        path.clear();
        for k in 0..2 * REACH * filling.per_particle {
            let Some(cell) = grid.locate(vec3::add_scaled(position, normal, -step * k as f64)) else { break };
            let i = grid.index(cell);
            if filling.inside[i] {
                pocket.extend(&path);
                break;
            }
            path.push(i);
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
    filling.report.attached = candidates.len();
    filling.report.interior += candidates.len();
    candidates.len()
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
        let up = [0.0, 0.0, 1.0];
        let mut skin = Vec::new();
        for y in 2..12 {
            for x in 2..12 {
                skin.push(([x as f64 + 0.5, y as f64 + 0.5, 9.5], up));
            }
        }
        skin.push(([16.5, 16.5, 10.5], up));
        skin.push(([5.5, 5.5, 18.5], up));
        let n = attach(&mut filling, &skin);
        // The corners of the top layer have too few neighbours, the thread and the far speck stay out.
        assert!((350..=400).contains(&n), "{n}");
        assert!(filling.inside[grid.index([6, 6, 8])] && !filling.inside[grid.index([16, 16, 8])]);
        assert!(!filling.inside[grid.index([5, 5, 14])]);
        assert_eq!(filling.report.interior, 2400 + n);
    }
}
