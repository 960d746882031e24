//! Signed distance to a ground-truth mesh, and Gaussians that lie where nobody can see them (splatting.md §9.3 M3).

pub use megas_geometry::{Closest, MeshDistance};
use megas_model::Splats;
use serde::{Deserialize, Serialize};

use crate::splats::area;

/// Depths below the surface at which floaters are counted, in units of the object's diagonal L.
pub const DEPTHS: [f64; 3] = [0.01, 0.02, 0.05];

/// How much of a model lies inside the object, at each of [`DEPTHS`]; all are fractions in [0, 1].
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Floaters {
    /// `F(d)`: weighted by opacity.
    pub opacity: [f64; 3],
    /// Unweighted.
    pub count: [f64; 3],
    /// Weighted by opacity and area, `o·S¹S²`.
    pub area: [f64; 3],
}

impl Floaters {
    /// Floaters of a model from the signed distance of every mean (negative inside) and the object's diagonal, both in
    /// scene units. All zero for a model without any weight.
    pub fn new(splats: &Splats, distance: &[f64], diagonal: f64) -> Self {
        assert_eq!(splats.len(), distance.len(), "one distance per Gaussian");
        let mut inside = [[0.0; 3]; 3];
        let mut all = [0.0; 3];
        for (i, &s) in distance.iter().enumerate() {
            let o = f64::from(splats.opacity(i));
            let weights = [o, 1.0, o * area(splats, i)];
            for (k, w) in weights.into_iter().enumerate() {
                all[k] += w;
                for (d, depth) in DEPTHS.into_iter().enumerate() {
                    if s < -depth * diagonal {
                        inside[k][d] += w;
                    }
                }
            }
        }
        let fraction = |k: usize| inside[k].map(|w| if all[k] > 0.0 { w / all[k] } else { 0.0 });
        Self { opacity: fraction(0), count: fraction(1), area: fraction(2) }
    }
}

/// Fraction of Gaussians whose largest blend weight over all views stays below `threshold`; the measure of floaters without
/// a mesh uses 128 views and 0.1. Zero for an empty set.
pub fn hidden_fraction(w_max: &[f32], threshold: f32) -> f64 {
    w_max.iter().filter(|w| **w < threshold).count() as f64 / w_max.len().max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn floaters_are_weighed_three_ways() {
        let mut s = Splats::default();
        for (opacity, size) in [(0.5f32, 1.0f32), (0.25, 2.0), (0.75, 0.1), (0.5, 1.0)] {
            let l = size.ln();
            s.push([0.0; 3], [l, l, l - 3.0], [1.0, 0.0, 0.0, 0.0], megas_model::logit(opacity), &[0.0; 3]);
        }
        // L = 10: thresholds 0.1, 0.2, 0.5.
        let f = Floaters::new(&s, &[0.3, -0.15, -0.6, -0.05], 10.0);
        let close = |a: [f64; 3], b: [f64; 3]| assert!((0..3).all(|k| (a[k] - b[k]).abs() < 1e-6), "{a:?} {b:?}");
        close(f.count, [0.5, 0.25, 0.25]);
        close(f.opacity, [0.5, 0.375, 0.375]);
        // Areas times opacity: 0.5, 1, 0.0075, 0.5.
        close(f.area, [1.0075, 0.0075, 0.0075].map(|w| w / 2.0075));
        assert_eq!(Floaters::new(&Splats::default(), &[], 1.0), Floaters::default());
        assert_eq!(hidden_fraction(&[0.0, 0.05, 0.1, 0.9], 0.1), 0.5);
        assert_eq!(hidden_fraction(&[], 0.1), 0.0);
    }
}
