//! Quadratic B-spline weights of MLS-MPM (simulation.md §2.1).

use crate::Real;

/// Weights of the three nodes at offsets 0, 1, 2 from `base`, for a point at fractional position `f = ξ − base ∈ [½, 3/2)`.
#[inline(always)]
pub fn weights<T: Real>(f: T) -> [T; 3] {
    let half = T::of(0.5);
    let a = T::of(1.5) - f;
    let b = f - T::one();
    let c = f - half;
    [half * a * a, T::of(0.75) - b * b, half * c * c]
}

/// Derivatives of [`weights`] with respect to `f`; divide by the grid spacing for gradients in space.
#[inline(always)]
pub fn gradients<T: Real>(f: T) -> [T; 3] {
    let two = T::of(2.0);
    [f - T::of(1.5), -two * (f - T::one()), f - T::of(0.5)]
}

/// Splits the grid coordinate `ξ = (x − x_b)/Δx` into the first stencil node and the fraction in `[½, 3/2)`.
#[inline(always)]
pub fn base_and_fraction<T: Real>(xi: T) -> (i64, T) {
    let base = (xi - T::of(0.5)).floor();
    (base.f64() as i64, xi - base)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn partition_of_unity_first_and_second_moments() {
        for i in 0..100 {
            let f = 0.5 + f64::from(i) / 100.0;
            let (w, g) = (weights(f), gradients(f));
            let d = [0.0 - f, 1.0 - f, 2.0 - f];
            let sum = |g: &dyn Fn(usize) -> f64| (0..3).map(g).sum::<f64>();
            assert!((sum(&|i| w[i]) - 1.0).abs() < 1e-14);
            assert!(sum(&|i| w[i] * d[i]).abs() < 1e-14);
            assert!((sum(&|i| w[i] * d[i] * d[i]) - 0.25).abs() < 1e-14);
            assert!(sum(&|i| g[i]).abs() < 1e-14);
            assert!((sum(&|i| g[i] * d[i]) - 1.0).abs() < 1e-14);
        }
    }
}
