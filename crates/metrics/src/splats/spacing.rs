//! How evenly the means cover the surface (M5).

use kiddo::{ImmutableKdTree, SquaredEuclidean};
use megas_model::Splats;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::statistics::{Spread, Weighted, quantile};
use crate::surface::MeshDistance;

/// Surface points at which the largest empty disc is looked for.
const PROBES: usize = 50_000;

/// Evenness of the means.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Uniformity {
    /// Median distance to the nearest other mean \[scene units\].
    pub median_spacing: f64,
    /// Coefficient of variation of that distance.
    pub spacing_cv: f64,
    /// Radius of the largest disc of the true surface without any mean, in units of the median spacing; needs a mesh.
    pub largest_gap: Option<f64>,
}

impl Uniformity {
    /// `None` for fewer than two Gaussians or means that are not finite. `seed` chooses the surface points.
    pub fn new(splats: &Splats, surface: Option<&MeshDistance>, seed: u64) -> Option<Self> {
        if splats.len() < 2 || splats.mean.iter().flatten().any(|v| !v.is_finite()) {
            return None;
        }
        let tree: ImmutableKdTree<f32, 3> = ImmutableKdTree::new_from_slice(&splats.mean).ok()?;
        let nth = |x: &[f32; 3], n: usize| {
            let found = tree.query(x).nearest_n::<SquaredEuclidean<f32>>(std::num::NonZero::new(n).expect("at least one")).execute();
            found.iter().map(|r| f64::from(r.distance)).fold(0.0, f64::max).sqrt()
        };
        // The nearest mean is the Gaussian itself, or another in the same place, which is as near.
        let mut spacing: Vec<f64> = splats.mean.par_iter().with_min_len(64).map(|x| nth(x, 2)).collect();
        spacing.sort_unstable_by(f64::total_cmp);
        let sorted: Vec<Weighted> = spacing.iter().map(|&value| Weighted { value, weight: 1.0 }).collect();
        let median_spacing = quantile(&sorted, 0.5);
        let largest_gap = surface.map(|surface| {
            let probes = surface.sample(PROBES, seed);
            probes.par_iter().with_min_len(64).map(|x| nth(x, 1)).reduce(|| 0.0, f64::max) / median_spacing
        });
        Some(Self { median_spacing, spacing_cv: Spread::new(spacing).cv, largest_gap })
    }
}

#[cfg(test)]
mod tests {
    use megas_model::Mesh;

    use super::*;

    /// A square of n × n points with unit spacing in the plane z = 0, and the mesh of the same square.
    fn square(n: usize) -> (Splats, MeshDistance) {
        let mut s = Splats::default();
        for i in 0..n * n {
            s.push([(i % n) as f32, (i / n) as f32, 0.0], [0.0; 3], [1.0, 0.0, 0.0, 0.0], 0.0, &[0.0; 3]);
        }
        let e = (n - 1) as f32;
        let positions = vec![[0.0, 0.0, 0.0], [e, 0.0, 0.0], [e, e, 0.0], [0.0, e, 0.0]];
        let mesh = Mesh { positions, triangles: vec![[0, 1, 2], [0, 2, 3]], ..Mesh::default() };
        (s, MeshDistance::new(&mesh).unwrap())
    }

    #[test]
    fn a_lattice_is_even_and_a_missing_point_is_a_gap() {
        let (s, surface) = square(20);
        let u = Uniformity::new(&s, Some(&surface), 1).unwrap();
        assert!(u.median_spacing == 1.0 && u.spacing_cv < 1e-6);
        let gap = u.largest_gap.unwrap();
        assert!(gap <= 0.5f64.sqrt() + 1e-6 && gap > 0.68, "{gap}");
        // Without one point the gap reaches from its place to its four neighbours.
        let keep: Vec<usize> = (0..400).filter(|i| *i != 10 * 20 + 10).collect();
        let gap = Uniformity::new(&s.select(&keep), Some(&surface), 1).unwrap().largest_gap.unwrap();
        assert!(gap <= 1.0 + 1e-6 && gap > 0.95, "{gap}");
    }

    #[test]
    fn two_distances_and_twins() {
        let mut s = Splats::default();
        // Pairs at distance 1 and pairs at distance 3, far from each other: mean 2, deviation 1.
        for k in 0..40 {
            for x in [0.0, if k % 2 == 0 { 1.0 } else { 3.0 }] {
                s.push([x, 100.0 * k as f32, 0.0], [0.0; 3], [1.0, 0.0, 0.0, 0.0], 0.0, &[0.0; 3]);
            }
        }
        let u = Uniformity::new(&s, None, 1).unwrap();
        assert!((u.spacing_cv - 0.5).abs() < 1e-6 && u.median_spacing == 1.0 && u.largest_gap.is_none());
        for i in 0..80 {
            let m = s.mean[i];
            s.push(m, [0.0; 3], [1.0, 0.0, 0.0, 0.0], 0.0, &[0.0; 3]);
        }
        assert_eq!(Uniformity::new(&s, None, 1).unwrap().median_spacing, 0.0);
        assert!(Uniformity::new(&s.select(&[3]), None, 1).is_none());
        s.mean[0][1] = f32::NAN;
        assert!(Uniformity::new(&s, None, 1).is_none());
    }
}
