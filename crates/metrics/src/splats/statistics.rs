//! Quantiles and spreads.

use serde::{Deserialize, Serialize};

/// A value that counts `weight` (≥ 0) times.
#[derive(Clone, Copy, Debug)]
pub(super) struct Weighted {
    pub value: f64,
    pub weight: f64,
}

/// The smallest value with at least the fraction `q` of the weight at or below it, of values sorted in ascending order; 0
/// without any weight.
pub(super) fn quantile(sorted: &[Weighted], q: f64) -> f64 {
    let total: f64 = sorted.iter().map(|v| v.weight).sum();
    let (mut sum, mut last) = (0.0, 0.0);
    for v in sorted.iter().filter(|v| v.weight > 0.0) {
        sum += v.weight;
        last = v.value;
        // One part in 10¹² covers the rounding of the sums.
        if sum >= q * total * (1.0 - 1e-12) {
            break;
        }
    }
    last
}

/// Fraction of the weight for which `is` holds; 0 without any weight.
pub(super) fn fraction(values: &[Weighted], is: impl Fn(f64) -> bool) -> f64 {
    let total: f64 = values.iter().map(|v| v.weight).sum();
    let part: f64 = values.iter().filter(|v| is(v.value)).map(|v| v.weight).sum();
    if total > 0.0 { part / total } else { 0.0 }
}

/// How much positive values differ among each other.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Spread {
    /// Mean, in the unit of the values.
    pub mean: f64,
    /// Coefficient of variation: standard deviation over mean.
    pub cv: f64,
    /// Standard deviation of the natural logarithm.
    pub sigma_ln: f64,
    /// 99th percentile over median.
    pub p99_over_p50: f64,
}

impl Spread {
    /// All zero without values.
    pub fn new(mut values: Vec<f64>) -> Self {
        if values.is_empty() {
            return Self::default();
        }
        values.sort_unstable_by(f64::total_cmp);
        let (mean, deviation) = moments(&values);
        let (_, sigma_ln) = moments(&values.iter().map(|v| v.ln()).collect::<Vec<_>>());
        let sorted: Vec<Weighted> = values.iter().map(|&value| Weighted { value, weight: 1.0 }).collect();
        Self { mean, cv: deviation / mean, sigma_ln, p99_over_p50: quantile(&sorted, 0.99) / quantile(&sorted, 0.5) }
    }
}

/// Mean and standard deviation (of the population).
fn moments(values: &[f64]) -> (f64, f64) {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    (mean, (values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / n).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_count_weights() {
        let v = [(1.0, 1.0), (2.0, 0.0), (3.0, 2.0), (4.0, 1.0), (9.0, 0.0)].map(|(value, weight)| Weighted { value, weight });
        for (q, expected) in [(0.0, 1.0), (0.25, 1.0), (0.26, 3.0), (0.5, 3.0), (0.75, 3.0), (0.76, 4.0), (1.0, 4.0)] {
            assert_eq!(quantile(&v, q), expected, "{q}");
        }
        assert_eq!(quantile(&[], 0.5), 0.0);
        let many: Vec<Weighted> = (1..=100).map(|i| Weighted { value: f64::from(i), weight: 0.1 }).collect();
        assert_eq!((quantile(&many, 0.5), quantile(&many, 0.99)), (50.0, 99.0));
        assert!((fraction(&v, |x| x > 2.5) - 0.75).abs() < 1e-15);
    }

    #[test]
    fn spread_of_a_lognormal_sample() {
        let mut rng = megas_math::rng::Rng::new(1);
        let sigma = 0.5f64;
        let s = Spread::new((0..200_000).map(|_| (sigma * rng.normal()).exp()).collect());
        assert!((s.sigma_ln - sigma).abs() < 0.005 && (s.cv - ((sigma * sigma).exp() - 1.0).sqrt()).abs() < 0.01);
        assert!((s.p99_over_p50 - (2.3263 * sigma).exp()).abs() < 0.05 && (s.mean - (0.125f64).exp()).abs() < 0.01);
        assert_eq!(Spread::new(vec![]), Spread::default());
    }
}
