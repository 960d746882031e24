//! Push-forward of one Gaussian by a deformation gradient (splatting.md §8.2, §8.3).

use megas_math::{Mat3, mat3, svd};

/// A deformed Gaussian's shape and the rotation of its appearance.
#[derive(Clone, Copy, Debug)]
pub struct Pushed {
    /// Covariance `F Σ⁰ Fᵀ`, symmetric.
    pub covariance: Mat3<f64>,
    /// Polar rotation of F: colours are evaluated at `ΔRᵀ d`.
    pub rotation: Mat3<f64>,
}

/// Singular values outside this range belong to degenerate or inverted particles and are clamped (§8.2, numerics).
const SINGULAR_RANGE: (f64, f64) = (0.05, 20.0);

/// Carries the covariance `sigma0` by `f`. Where `f` is singular or inverted its singular values are clamped first, so the
/// result is always positive definite when `sigma0` is.
pub fn push_forward(f: Mat3<f64>, sigma0: Mat3<f64>) -> Pushed {
    let d = svd::svd(f);
    let healthy = d.s[2] >= SINGULAR_RANGE.0 && d.s[0] <= SINGULAR_RANGE.1;
    let f = if healthy { f } else { d.with_values(d.s.map(|s| s.abs().clamp(SINGULAR_RANGE.0, SINGULAR_RANGE.1))) };
    Pushed { covariance: mat3::symmetrize(mat3::congruence(f, sigma0)), rotation: mat3::mul(d.u, mat3::transpose(d.v)) }
}

/// Keeps a Gaussian continuous through an event that changed the elastic gradient: `Σ⁰ ← B Σ⁰ Bᵀ` with
/// `B = F_after⁻¹ F_before` (§8.2, rebase).
pub fn rebase_covariance(b: Mat3<f64>, sigma0: Mat3<f64>) -> Mat3<f64> {
    mat3::symmetrize(mat3::congruence(b, sigma0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use megas_math::{quat, rng::Rng};

    fn random_sigma(rng: &mut Rng) -> Mat3<f64> {
        let r = quat::to_mat3::<f64>(std::array::from_fn(|_| rng.range(-1.0, 1.0)));
        mat3::congruence(r, mat3::diag([0.04, 0.03, 0.001]))
    }

    #[test]
    fn a_rotation_turns_the_covariance_exactly() {
        let mut rng = Rng::new(1);
        for _ in 0..50 {
            let s = random_sigma(&mut rng);
            let r = quat::to_mat3::<f64>(std::array::from_fn(|_| rng.range(-1.0, 1.0)));
            let p = push_forward(r, s);
            assert!(mat3::norm(mat3::sub(p.covariance, mat3::congruence(r, s))) < 1e-15);
            assert!(mat3::norm(mat3::sub(p.rotation, r)) < 1e-9);
        }
    }

    #[test]
    fn simple_shear_stretches_by_the_golden_ratio() {
        // V44: γ = 1 has the singular values 1.618 and 0.618.
        let p = push_forward([[1.0, 1.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], mat3::identity());
        let (w, _) = svd::eigen_symmetric(p.covariance);
        assert!((w[0].sqrt() - 1.618_033_988_749_895).abs() < 1e-12 && (w[2].sqrt() - 0.618_033_988_749_895).abs() < 1e-12);
    }

    #[test]
    fn inverted_and_singular_gradients_stay_positive_definite() {
        for f in [mat3::diag([1.0, 1.0, -0.5]), mat3::diag([1.0, 0.0, 0.0]), [[0.0; 3]; 3], mat3::diag([1e3, 1.0, 1.0])] {
            let p = push_forward(f, mat3::identity());
            let (w, _) = svd::eigen_symmetric(p.covariance);
            assert!(w[2] >= 0.05 * 0.05 - 1e-12 && w[0] <= 400.0 + 1e-9, "{f:?} {w:?}");
            assert!(mat3::det(p.rotation) > 0.99);
        }
    }

    #[test]
    fn a_rebase_leaves_the_gaussian_where_it_is() {
        // The simulator resets the deviatoric stretch: F_after keeps the polar rotation.
        let mut rng = Rng::new(2);
        for _ in 0..50 {
            let s0 = random_sigma(&mut rng);
            let r = quat::to_mat3::<f64>(std::array::from_fn(|_| rng.range(-1.0, 1.0)));
            let before = mat3::mul(r, mat3::diag([1.2, 0.9, 0.95]));
            let after = mat3::scale(r, (1.2f64 * 0.9 * 0.95).cbrt());
            let Some(inverse) = mat3::inverse(after) else { panic!("rotation is invertible") };
            let s1 = rebase_covariance(mat3::mul(inverse, before), s0);
            let (a, b) = (push_forward(before, s0), push_forward(after, s1));
            assert!(mat3::norm(mat3::sub(a.covariance, b.covariance)) < 1e-12);
            assert!(mat3::norm(mat3::sub(a.rotation, b.rotation)) < 1e-9);
        }
    }
}
