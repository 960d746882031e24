//! Singular value, polar and symmetric eigen-decompositions of one 3×3 matrix: the obvious version, in the caller's
//! precision. The lanes of [`crate::simd`] are tested against it.

use crate::{Mat3, Real, Vec3, mat3, vec3};

/// `a = u diag(s) vᵀ` with `u`, `v` rotations and `|s0| ≥ |s1| ≥ |s2|`; the sign of `det a` sits on `s2`
/// (simulation.md §5.1).
#[derive(Clone, Copy, Debug)]
pub struct Svd<T> {
    /// Left rotation.
    pub u: Mat3<T>,
    /// Signed singular values, largest first.
    pub s: Vec3<T>,
    /// Right rotation.
    pub v: Mat3<T>,
}

/// Eigenvalues (largest first) and eigenvectors (columns of a rotation) of the symmetric matrix `a`, by cyclic Jacobi
/// rotations until the off-diagonal is below rounding.
pub fn eigen_symmetric<T: Real>(a: Mat3<T>) -> (Vec3<T>, Mat3<T>) {
    let mut a = mat3::symmetrize(a);
    let mut v = mat3::identity::<T>();
    let tiny = T::epsilon() * T::epsilon();
    for _ in 0..30 {
        let off = a[0][1] * a[0][1] + a[0][2] * a[0][2] + a[1][2] * a[1][2];
        let size = a[0][0] * a[0][0] + a[1][1] * a[1][1] + a[2][2] * a[2][2];

        if off <= size * tiny || off.is_nan() {
            break;
        }
        for (p, q) in [(0, 1), (0, 2), (1, 2)] {
            let apq = a[p][q];
            if apq == T::zero() {
                continue;
            }
            let theta = (a[q][q] - a[p][p]) / (apq + apq);
            let t = if theta.is_finite() {
                let sign = if theta < T::zero() { -T::one() } else { T::one() };
                sign / (theta.abs() + (theta * theta + T::one()).sqrt())
            } else {
                T::zero()
            };
            let c = (t * t + T::one()).sqrt().recip();
            let s = t * c;
            for k in 0..3 {
                let (akp, akq) = (a[k][p], a[k][q]);
                a[k][p] = c * akp - s * akq;
                a[k][q] = s * akp + c * akq;
            }
            for k in 0..3 {
                let (apk, aqk) = (a[p][k], a[q][k]);
                a[p][k] = c * apk - s * aqk;
                a[q][k] = s * apk + c * aqk;
            }
            for row in &mut v {
                let (vp, vq) = (row[p], row[q]);
                row[p] = c * vp - s * vq;
                row[q] = s * vp + c * vq;
            }
        }
    }
    let mut order = [0usize, 1, 2];
    order.sort_by(|&i, &j| a[j][j].partial_cmp(&a[i][i]).unwrap_or(std::cmp::Ordering::Equal));
    let w = order.map(|i| a[i][i]);
    let (c0, c1) = (mat3::column(v, order[0]), mat3::column(v, order[1]));
    // The third column by cross product keeps the result a rotation whatever the sorting did.
    (w, mat3::from_columns(c0, c1, vec3::cross(c0, c1)))
}

/// Singular value decomposition with rotations (see [`Svd`]). Exact to rounding of the squared matrix: relative error of
/// the small singular values grows with the condition number, which is what a deformation gradient needs.
pub fn svd<T: Real>(a: Mat3<T>) -> Svd<T> {
    let (w, v) = eigen_symmetric(mat3::mul(mat3::transpose(a), a));
    let cols = [0, 1, 2].map(|k| mat3::mul_vec(a, mat3::column(v, k)));
    let scale = w[0].max(T::zero()).sqrt();
    let floor = scale * T::epsilon() * T::of(16.0);
    let x = [T::one(), T::zero(), T::zero()];
    let u0 = if scale > T::zero() { vec3::normalize_or(cols[0], x) } else { x };
    let r1 = vec3::add_scaled(cols[1], u0, -vec3::dot(u0, cols[1]));
    let u1 = if vec3::norm(r1) > floor { vec3::normalize_or(r1, x) } else { vec3::frame_from_normal(u0).0 };
    let u2 = vec3::cross(u0, u1);
    let s = [vec3::dot(u0, cols[0]), vec3::dot(u1, cols[1]), vec3::dot(u2, cols[2])];
    Svd { u: mat3::from_columns(u0, u1, u2), s, v }
}

/// The rotation of the polar decomposition `a = r p` (`p` symmetric); for inverted matrices the reflection is kept in `p`.
pub fn polar_rotation<T: Real>(a: Mat3<T>) -> Mat3<T> {
    let f = svd(a);
    mat3::mul(f.u, mat3::transpose(f.v))
}

impl<T: Real> Svd<T> {
    /// `u diag(d) vᵀ` with other diagonal values in place of the singular ones.
    pub fn with_values(&self, d: Vec3<T>) -> Mat3<T> {
        mat3::mul(mat3::mul(self.u, mat3::diag(d)), mat3::transpose(self.v))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::Rng;

    fn check(a: Mat3<f64>, tol: f64) {
        let f = svd(a);
        let back = f.with_values(f.s);
        assert!(mat3::norm(mat3::sub(back, a)) <= tol * mat3::norm(a).max(1e-30), "{a:?} -> {f:?}");
        for m in [f.u, f.v] {
            let e = mat3::sub(mat3::mul(mat3::transpose(m), m), mat3::identity());
            assert!(mat3::norm(e) < 1e-12 && mat3::det(m) > 0.0);
        }
        assert!(f.s[0].abs() >= f.s[1].abs() - 1e-12 && f.s[1].abs() >= f.s[2].abs() - 1e-7 * f.s[0].abs());
    }

    #[test]
    fn reconstructs_random_rank_deficient_repeated_and_inverted_matrices() {
        let mut rng = Rng::new(7);
        for _ in 0..500 {
            let a: Mat3<f64> = std::array::from_fn(|_| std::array::from_fn(|_| rng.range(-2.0, 2.0)));
            check(a, 1e-10);
            check(mat3::outer(a[0], a[1]), 1e-7);
        }
        check(mat3::identity(), 1e-14);
        check(mat3::diag([1.0, -1.0, 1.0]), 1e-14);
        check(mat3::diag([2.0, 2.0, -0.5]), 1e-14);
        check([[0.0; 3]; 3], 1e-14);
    }
}
