//! Needle clamp: bounds the shape of deformed Gaussians (splatting.md §8.4).

use megas_math::{Mat3, mat3, svd};

/// Bounds of one Gaussian. They are never tighter than its shape at rest, so that an undeformed model renders unchanged
/// (the design's plain bound would shrink the large kernels of an imported splat).
#[derive(Clone, Copy, Debug)]
pub struct NeedleLimit {
    /// Largest ratio S¹/S².
    pub aspect: f64,
    /// Largest standard deviation, scene units.
    pub size: f64,
}

impl NeedleLimit {
    /// The limit of a Gaussian with covariance `sigma0` at rest; `aspect` (ρ, default 4) and `size` (τ_def) are the scene's.
    pub fn new(sigma0: Mat3<f64>, aspect: f64, size: f64) -> Self {
        let (w, _) = svd::eigen_symmetric(sigma0);
        let s = w.map(|v| v.max(0.0).sqrt());
        // No kernel grows to more than twice its length: small ones pulled to the bound of large ones are needles.
        Self { aspect: aspect.max(s[0] / s[1].max(1e-30)), size: size.min(2.0 * s[0]).max(s[0]) }
    }
}

/// Clamps the covariance to `limit`; returns the (possibly unchanged) covariance and whether it was clamped. Continuous in
/// the input.
pub fn clamp_covariance(sigma: Mat3<f64>, limit: NeedleLimit) -> (Mat3<f64>, bool) {
    if limit.aspect == f64::INFINITY {
        return (sigma, false);
    }
    let (w, r) = svd::eigen_symmetric(sigma);
    let s = w.map(|v| v.max(0.0).sqrt());
    let s2 = s[1].min(limit.size);
    let s1 = s[0].min(limit.aspect * s2).min(limit.size).max(s2);
    let s3 = s[2].clamp(0.02 * s2, s2);
    if s1 >= s[0] * (1.0 - 1e-6) && s2 >= s[1] * (1.0 - 1e-6) && s3 <= s[2] * (1.0 + 1e-6) {
        return (sigma, false);
    }
    (mat3::congruence(r, mat3::diag([s1 * s1, s2 * s2, s3 * s3])), true)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn needles_and_giants_are_cut_and_rest_shapes_kept() {
        let rest = mat3::diag([0.01, 0.0081, 0.0001]);
        let limit = NeedleLimit::new(rest, 4.0, 0.2);
        assert!(!clamp_covariance(rest, limit).1);
        let (cut, hit) = clamp_covariance(mat3::diag([1.0, 0.0025, 0.0001]), limit);
        assert!(hit);
        let (w, _) = svd::eigen_symmetric(cut);
        assert!((w[0].sqrt() - 0.2).abs() < 1e-12 && (w[1].sqrt() - 0.05).abs() < 1e-12);
        // A kernel larger than the bound at rest keeps its size.
        let giant = mat3::diag([4.0, 1.0, 0.01]);
        assert!(!clamp_covariance(giant, NeedleLimit::new(giant, 1.5, 0.2)).1);
    }
}
