//! The three clean-up steps after the vote (splatting.md §6.5).

use rayon::prelude::*;

use super::Grid;

/// What the clean-up changed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CleanupReport {
    /// Exterior points enclosed by interior ones that became interior.
    pub enclosed: usize,
    /// Points at the threshold that the majority of their neighbours voted out.
    pub outvoted: usize,
    /// Interior components that were dropped.
    pub components_dropped: usize,
    /// Points in them.
    pub points_dropped: usize,
}

/// Fills enclosed holes, filters the undecided (`votes == threshold`) by the majority of 26 neighbours, and drops
/// components with less than 0.5 % of the interior or fewer than 8 points.
pub fn clean(grid: &Grid, inside: &mut [bool], votes: &[u8], threshold: u8) -> CleanupReport {
    let mut report = CleanupReport { enclosed: fill_enclosed(grid, inside), ..CleanupReport::default() };
    report.outvoted = filter_undecided(grid, inside, votes, threshold);
    (report.components_dropped, report.points_dropped) = drop_small(grid, inside);
    report
}

/// Calls `f` for the 6-neighbours of a cell.
fn neighbours6(grid: &Grid, index: usize, mut f: impl FnMut(usize)) {
    let c = grid.cell(index);
    let step = [1, grid.dims[0], grid.dims[0] * grid.dims[1]];
    for k in 0..3 {
        if c[k] > 0 {
            f(index - step[k]);
        }
        if c[k] + 1 < grid.dims[k] {
            f(index + step[k]);
        }
    }
}

/// Makes exterior points interior that no path through exterior points connects with the border of the grid.
pub(super) fn fill_enclosed(grid: &Grid, inside: &mut [bool]) -> usize {
    let [nx, ny, nz] = grid.dims;
    let mut open = vec![false; grid.len()];
    let mut todo: Vec<usize> = Vec::new();
    let mut reach = |i: usize, todo: &mut Vec<usize>, inside: &[bool]| {
        if !inside[i] && !open[i] {
            open[i] = true;
            todo.push(i);
        }
    };
    for z in 0..nz {
        for y in 0..ny {
            let border = z == 0 || z == nz - 1 || y == 0 || y == ny - 1;
            for x in (0..nx).step_by(if border { 1 } else { (nx - 1).max(1) }) {
                reach(grid.index([x, y, z]), &mut todo, inside);
            }
        }
    }
    while let Some(i) = todo.pop() {
        neighbours6(grid, i, |j| reach(j, &mut todo, inside));
    }
    let mut filled = 0;
    for (v, o) in inside.iter_mut().zip(&open) {
        if !*v && !*o {
            *v = true;
            filled += 1;
        }
    }
    filled
}

fn filter_undecided(grid: &Grid, inside: &mut [bool], votes: &[u8], threshold: u8) -> usize {
    let drop: Vec<usize> = (0..grid.len())
        .into_par_iter()
        .filter(|&i| {
            if !inside[i] || votes[i] != threshold {
                return false;
            }
            let c = grid.cell(i);
            let mut around = 0;
            for z in c[2].saturating_sub(1)..(c[2] + 2).min(grid.dims[2]) {
                for y in c[1].saturating_sub(1)..(c[1] + 2).min(grid.dims[1]) {
                    for x in c[0].saturating_sub(1)..(c[0] + 2).min(grid.dims[0]) {
                        around += usize::from(inside[grid.index([x, y, z])]);
                    }
                }
            }
            // The point itself was counted; 13 of 26 is no majority against it.
            around - 1 < 13
        })
        .collect();
    for &i in &drop {
        inside[i] = false;
    }
    drop.len()
}

fn drop_small(grid: &Grid, inside: &mut [bool]) -> (usize, usize) {
    let total = inside.iter().filter(|&&v| v).count();
    let least = (0.005 * total as f64).max(8.0);
    let mut seen = vec![false; grid.len()];
    let (mut components, mut points) = (0, 0);
    let mut members = Vec::new();
    for seed in 0..grid.len() {
        if !inside[seed] || seen[seed] {
            continue;
        }
        members.clear();
        members.push(seed);
        seen[seed] = true;
        let mut next = 0;
        while next < members.len() {
            neighbours6(grid, members[next], |j| {
                if inside[j] && !seen[j] {
                    seen[j] = true;
                    members.push(j);
                }
            });
            next += 1;
        }
        if (members.len() as f64) < least {
            components += 1;
            points += members.len();
            for &i in &members {
                inside[i] = false;
            }
        }
    }
    (components, points)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn holes_close_crumbs_go_and_the_undecided_follow_their_neighbours() {
        let grid = Grid { origin: [0.0; 3], spacing: 1.0, dims: [16, 14, 12] };
        let mut inside = vec![false; grid.len()];
        for i in 0..grid.len() {
            let c = grid.cell(i);
            inside[i] = (2..10).contains(&c[0]) && (2..10).contains(&c[1]) && (2..10).contains(&c[2]);
        }
        let mut votes = vec![5u8; grid.len()];
        for c in [[5, 5, 5], [5, 5, 6], [4, 5, 5]] {
            inside[grid.index(c)] = false;
        }
        let lone = grid.index([13, 12, 10]);
        inside[lone] = true;
        let wart = grid.index([10, 5, 5]);
        inside[wart] = true;
        votes[wart] = 4;
        let undecided_within = grid.index([7, 7, 7]);
        votes[undecided_within] = 4;
        let r = clean(&grid, &mut inside, &votes, 4);
        assert_eq!(r, CleanupReport { enclosed: 3, outvoted: 1, components_dropped: 1, points_dropped: 1 });
        assert!(!inside[wart] && !inside[lone] && inside[undecided_within] && inside[grid.index([5, 5, 5])]);
        assert_eq!(inside.iter().filter(|&&v| v).count(), 512);
    }
}
