//! The shape and arrangement of the Gaussians themselves (splatting.md §9.3 M2, M4, M5).
//!
//! All measures take the Gaussians of the object, which the caller selects.

mod report;
mod spacing;
mod statistics;

pub use report::SplatReport;
pub use spacing::Uniformity;
pub use statistics::Spread;

use megas_model::Splats;
use serde::{Deserialize, Serialize};

use statistics::{Weighted, fraction};

/// Gaussians whose effective rank is below this count as needles whatever their axes.
pub const LOW_RANK: f64 = 1.3;

/// `S³` is taken to be at least this times `S²` where volumes are compared: flattening drives it to nothing.
pub const THICKNESS_FLOOR: f64 = 0.05;

/// Standard deviations along the local axes, largest first \[scene units\].
pub(crate) fn axes(splats: &Splats, i: usize) -> [f64; 3] {
    let mut s = splats.log_scale[i].map(|l| f64::from(l).exp());
    s.sort_unstable_by(|a, b| b.total_cmp(a));
    s
}

/// `S¹S²` \[scene units²\].
pub(crate) fn area(splats: &Splats, i: usize) -> f64 {
    let [a, b, _] = axes(splats, i);
    a * b
}

/// Distribution of the ratio `S¹/S²` of the two longest axes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Ratios {
    /// Median.
    pub p50: f64,
    /// 90th percentile.
    pub p90: f64,
    /// 99th percentile.
    pub p99: f64,
    /// Largest.
    pub max: f64,
    /// Fraction above a.
    pub above_a: f64,
    /// Fraction above 1.1 a.
    pub above_1_1_a: f64,
    /// Fraction above 2 a.
    pub above_2_a: f64,
}

impl Ratios {
    fn new(mut ratios: Vec<Weighted>, a: f64) -> Self {
        ratios.sort_unstable_by(|x, y| x.value.total_cmp(&y.value));
        let at = |q| statistics::quantile(&ratios, q);
        let above = |limit: f64| fraction(&ratios, |r| r > limit);
        Self {
            p50: at(0.5),
            p90: at(0.9),
            p99: at(0.99),
            max: at(1.0),
            above_a: above(a),
            above_1_1_a: above(1.1 * a),
            above_2_a: above(2.0 * a),
        }
    }
}

/// Needles (M2).
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Needles {
    /// Every Gaussian counts the same.
    pub plain: Ratios,
    /// Weighted by `o·S¹S²`.
    pub weighted: Ratios,
    /// Mean effective rank `exp(−Σ p ln p)`, `p = S²/ΣS²`, in [1, 3].
    pub mean_rank: f64,
    /// Fraction with an effective rank below [`LOW_RANK`].
    pub low_rank: f64,
}

impl Needles {
    /// Needles with respect to the largest permitted ratio `a`. All zero for an empty set.
    pub fn new(splats: &Splats, a: f64) -> Self {
        let ratio = |i: usize| {
            let [long, wide, _] = axes(splats, i);
            long / wide
        };
        let n = splats.len();
        let plain = (0..n).map(|i| Weighted { value: ratio(i), weight: 1.0 }).collect();
        let weight = |i: usize| f64::from(splats.opacity(i)) * area(splats, i);
        let weighted = (0..n).map(|i| Weighted { value: ratio(i), weight: weight(i) }).collect();
        let ranks: Vec<f64> = (0..n).map(|i| effective_rank(axes(splats, i))).collect();
        Self {
            plain: Ratios::new(plain, a),
            weighted: Ratios::new(weighted, a),
            mean_rank: ranks.iter().sum::<f64>() / n.max(1) as f64,
            low_rank: ranks.iter().filter(|r| **r < LOW_RANK).count() as f64 / n.max(1) as f64,
        }
    }
}

/// `exp(−Σ p ln p)` of the normalised variances: 1 for a needle, 2 for a disc, 3 for a ball.
pub fn effective_rank(axes: [f64; 3]) -> f64 {
    let total: f64 = axes.iter().map(|s| s * s).sum();
    let entropy = |s: f64| {
        let p = s * s / total;
        // The limit at p = 0 is 0.
        if p > 0.0 { -p * p.ln() } else { 0.0 }
    };
    axes.iter().map(|&s| entropy(s)).sum::<f64>().exp()
}

/// How equal the Gaussians are in size (M4).
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Consistency {
    /// Of the areas `S¹S²`: the decisive statistics.
    pub area: Spread,
    /// Of the volumes `S¹S²·max(S³, 0.05 S²)`.
    pub volume: Spread,
}

impl Consistency {
    /// All zero for an empty set.
    pub fn new(splats: &Splats) -> Self {
        let all = 0..splats.len();
        let volume = |i: usize| {
            let [a, b, c] = axes(splats, i);
            a * b * c.max(THICKNESS_FLOOR * b)
        };
        Self { area: Spread::new(all.clone().map(|i| area(splats, i)).collect()), volume: Spread::new(all.map(volume).collect()) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn set(shapes: &[([f32; 3], f32)]) -> Splats {
        let mut s = Splats::default();
        for (scale, opacity) in shapes {
            s.push([0.0; 3], scale.map(f32::ln), [1.0, 0.0, 0.0, 0.0], megas_model::logit(*opacity), &[0.0; 3]);
        }
        s
    }

    #[test]
    fn needles_plain_and_weighted() {
        // Ratios 1, 1.5, 3, 10 whatever the order of the axes; weights 0.5·1, 0.5·1.5, 0.5·3, 0.5·10 times 4, 1, 1, 0.1.
        let s = set(&[([2.0, 2.0, 0.1], 0.5), ([1.0, 0.1, 1.5], 0.5), ([0.1, 1.0, 3.0], 0.5), ([10.0, 1.0, 0.1], 0.05)]);
        let n = Needles::new(&s, 2.0);
        let close = |a: f64, b: f64| assert!((a - b).abs() < 1e-5 * b.abs().max(1.0), "{a} {b}");
        close(n.plain.p50, 1.5);
        close(n.plain.p90, 10.0);
        close(n.plain.max, 10.0);
        close(n.plain.above_a, 0.5);
        close(n.plain.above_2_a, 0.25);
        let total = 2.0 + 0.75 + 1.5 + 0.5;
        close(n.weighted.above_a, 2.0 / total);
        close(n.weighted.above_2_a, 0.5 / total);
        close(n.weighted.p50, 1.5);
        close(n.weighted.p90, 10.0);
        close(Needles::new(&s, 2.8).plain.above_1_1_a, 0.25);
        close(Needles::new(&s, 2.8).plain.above_a, 0.5);
        assert_eq!(Needles::new(&Splats::default(), 2.0), Needles::default());
    }

    #[test]
    fn effective_ranks_of_balls_discs_and_needles() {
        for (axes, rank) in [([0.3; 3], 3.0), ([0.2, 0.2, 0.0], 2.0), ([5.0, 0.0, 0.0], 1.0)] {
            assert!((effective_rank(axes) - rank).abs() < 1e-12);
        }
        let n = Needles::new(&set(&[([1.0, 1.0, 1e-6], 0.5), ([1.0, 1e-6, 1e-6], 0.5)]), 2.0);
        assert!((n.mean_rank - 1.5).abs() < 1e-5 && n.low_rank == 0.5);
    }

    #[test]
    fn consistency_of_sizes() {
        let s = set(&[([2.0, 1.0, 1e-9], 0.5), ([4.0, 2.0, 1.0], 0.5)]);
        let c = Consistency::new(&s);
        let close = |a: f64, b: f64| assert!((a - b).abs() < 1e-5, "{a} {b}");
        // Areas 2, 8; volumes 2·0.05, 8.
        close(c.area.mean, 5.0);
        close(c.area.cv, 0.6);
        close(c.area.sigma_ln, 4f64.ln() / 2.0);
        close(c.area.p99_over_p50, 4.0);
        close(c.volume.cv, 3.95 / 4.05);
    }
}
