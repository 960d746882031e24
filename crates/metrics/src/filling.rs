//! How well an object was filled (splatting.md §9.3 M8).

use std::collections::HashMap;

use kiddo::{ImmutableKdTree, SquaredEuclidean};
use megas_math::{Vec3, vec3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Side of the cubes in which particles are counted, in grid spacings.
const CUBE: f64 = 4.0;

/// A classified lattice of cubic cells with the true signed distance of their centres.
#[derive(Clone, Copy, Debug)]
pub struct FilledGrid<'a> {
    /// Centres of the cells.
    pub centre: &'a [Vec3<f64>],
    /// Which cells were filled.
    pub inside: &'a [bool],
    /// Signed distance of the centres to the true surface, negative inside.
    pub distance: &'a [f64],
    /// Side of a cell Δ.
    pub spacing: f64,
}

/// The figures of a filling; all are fractions unless said otherwise.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct FillingQuality {
    /// Intersection over union with the truth, over all cells.
    pub iou: f64,
    /// Filled part of the true inside deeper than one cell.
    pub recall: f64,
    /// `1 − recall`.
    pub hollow: f64,
    /// Filled cells farther than one cell outside, over the true inside.
    pub false_fill: f64,
    /// Coefficient of variation of the particles in cubes of side 4Δ that lie wholly inside; 0 without such cubes.
    pub count_cv: f64,
    /// Radius of the largest ball without a particle about a cell deeper than one cell, in Δ; absent without particles.
    pub largest_gap: Option<f64>,
    /// `|Σ V_p − V| / V`.
    pub volume_error: f64,
    /// Number of particles.
    pub particles: usize,
}

impl FillingQuality {
    /// Judges a filling; `particles` are its points, `volume` what they hold together and `true_volume` what the object has.
    pub fn new(grid: FilledGrid<'_>, particles: &[Vec3<f32>], volume: f64, true_volume: f64) -> Self {
        let n = grid.centre.len();
        assert!(grid.inside.len() == n && grid.distance.len() == n, "one flag and one distance per cell");
        let (mut both, mut either, mut truth, mut deep, mut found, mut wrong) = (0usize, 0usize, 0usize, 0usize, 0usize, 0usize);
        for i in 0..n {
            let (d, got) = (grid.distance[i], grid.inside[i]);
            let real = d < 0.0;
            both += usize::from(real && got);
            either += usize::from(real || got);
            truth += usize::from(real);
            deep += usize::from(d < -grid.spacing);
            found += usize::from(d < -grid.spacing && got);
            wrong += usize::from(d > grid.spacing && got);
        }
        let ratio = |a: usize, b: usize| if b > 0 { a as f64 / b as f64 } else { 0.0 };
        let recall = ratio(found, deep);
        Self {
            iou: ratio(both, either),
            recall,
            hollow: 1.0 - recall,
            false_fill: ratio(wrong, truth),
            count_cv: count_cv(&grid, particles),
            largest_gap: largest_gap(&grid, particles),
            volume_error: (volume - true_volume).abs() / true_volume,
            particles: particles.len(),
        }
    }
}

/// Cubes lie on a lattice through the first centre; one is wholly inside where every true cell in it is and none is missing.
fn count_cv(grid: &FilledGrid<'_>, particles: &[Vec3<f32>]) -> f64 {
    let Some(&origin) = grid.centre.first() else { return 0.0 };
    let side = CUBE * grid.spacing;
    let cube = |x: Vec3<f64>| [0, 1, 2].map(|k| ((x[k] - origin[k] + 0.5 * grid.spacing) / side).floor() as i64);
    let mut cells: HashMap<[i64; 3], (usize, usize)> = HashMap::new();
    for (i, &c) in grid.centre.iter().enumerate().filter(|(i, _)| grid.distance[*i] < 0.0) {
        // The cell may still stick out where its centre is nearer to the surface than its corner.
        let whole = grid.distance[i] < -0.5 * 3f64.sqrt() * grid.spacing;
        cells.entry(cube(c)).or_default().0 += usize::from(whole);
    }
    for &p in particles {
        if let Some(c) = cells.get_mut(&cube(vec3::cast(p))) {
            c.1 += 1;
        }
    }
    let full = (CUBE * CUBE * CUBE) as usize;
    let mut counts: Vec<usize> = cells.values().filter(|c| c.0 == full).map(|c| c.1).collect();
    // The order of a hash map must not reach the sums.
    counts.sort_unstable();
    if counts.is_empty() {
        return 0.0;
    }
    let m = counts.len() as f64;
    let mean = counts.iter().sum::<usize>() as f64 / m;
    let variance = counts.iter().map(|&c| (c as f64 - mean).powi(2)).sum::<f64>() / m;
    if mean > 0.0 { variance.sqrt() / mean } else { 0.0 }
}

fn largest_gap(grid: &FilledGrid<'_>, particles: &[Vec3<f32>]) -> Option<f64> {
    if particles.is_empty() {
        return None;
    }
    let tree: ImmutableKdTree<f32, 3> = ImmutableKdTree::new_from_slice(particles).ok()?;
    let one = std::num::NonZero::<usize>::MIN;
    let gap = |i: usize| {
        let found = tree.query(&vec3::cast(grid.centre[i])).nearest_n::<SquaredEuclidean<f32>>(one).execute();
        found.iter().map(|r| f64::from(r.distance)).fold(0.0, f64::max).sqrt()
    };
    let deep = (0..grid.centre.len()).into_par_iter().with_min_len(256).filter(|&i| grid.distance[i] < -grid.spacing);
    Some(deep.map(gap).reduce(|| 0.0, f64::max) / grid.spacing)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A ball of radius 1 on a lattice.
    fn lattice(n: i32) -> (Vec<Vec3<f64>>, Vec<f64>, f64) {
        let spacing = 2.6 / f64::from(n);
        let at = |i: i32| (f64::from(i) + 0.5) * spacing - 1.3;
        let centre: Vec<Vec3<f64>> = (0..n * n * n).map(|i| [at(i % n), at(i / n % n), at(i / (n * n))]).collect();
        let distance = centre.iter().map(|c| vec3::norm(*c) - 1.0).collect();
        (centre, distance, spacing)
    }

    fn judge(keep: impl Fn(Vec3<f64>, f64) -> bool) -> FillingQuality {
        let (centre, distance, spacing) = lattice(52);
        let inside: Vec<bool> = centre.iter().zip(&distance).map(|(c, d)| keep(*c, *d)).collect();
        let particles: Vec<Vec3<f32>> = centre.iter().zip(&inside).filter(|p| *p.1).map(|p| vec3::cast(*p.0)).collect();
        let volume = particles.len() as f64 * spacing.powi(3);
        let grid = FilledGrid { centre: &centre, inside: &inside, distance: &distance, spacing };
        FillingQuality::new(grid, &particles, volume, 4.0 / 3.0 * std::f64::consts::PI)
    }

    #[test]
    fn the_truth_is_perfect_and_holes_and_excess_are_measured() {
        let q = judge(|_, d| d < 0.0);
        assert!(q.iou == 1.0 && q.hollow == 0.0 && q.false_fill == 0.0 && q.count_cv == 0.0 && q.volume_error < 0.01, "{q:?}");
        assert!(q.largest_gap.unwrap() < 1e-5);
        // Without its core of half the radius a ball lacks an eighth of its volume.
        let q = judge(|c, d| d < 0.0 && vec3::norm(c) > 0.5);
        assert!((q.iou - 0.875).abs() < 0.005 && (q.volume_error - 0.125).abs() < 0.01, "{q:?}");
        assert!((q.hollow - 0.125 / 0.95f64.powi(3)).abs() < 0.01 && q.count_cv > 0.3, "{q:?}");
        assert!((q.largest_gap.unwrap() - 10.0).abs() < 1.0, "{q:?}");
        // A ball of radius 1.2: false beyond one cell of 0.05.
        let q = judge(|_, d| d < 0.2);
        assert!((q.iou - 1.2f64.powi(-3)).abs() < 0.01 && (q.false_fill - (1.728 - 1.05f64.powi(3))).abs() < 0.02, "{q:?}");
        let q = judge(|_, _| false);
        assert!(q.iou == 0.0 && q.hollow == 1.0 && q.volume_error == 1.0 && q.largest_gap.is_none());
    }
}
