//! Functions of symmetric 3×3 matrices in lanes: Jacobi eigen-decomposition for any matrix, and for small traceless ones
//! power series reduced to three scalar coefficients with the Cayley–Hamilton theorem. Between them they give an isotropic
//! law everything it needs of the deformation gradient (simulation.md §5.1) without singular vectors.

use fearless_simd::{Simd, SimdBase, SimdFloat};

use super::{Lanes, Mat3s, Sym3, each6};

/// Eigenvalues `w` (unsorted) and eigenvectors `u` (columns of a rotation) of `a`, by four cyclic Jacobi sweeps: the
/// off-diagonal is then below rounding of `‖a‖`.
#[inline(always)]
pub fn eigen<S: Simd>(s: S, a: Sym3<S>) -> ([Lanes<S>; 3], Mat3s<S>) {
    let c = |v| Lanes::<S>::splat(s, v);
    let (zero, one) = (c(0.0), c(1.0));
    let mut w = [a[0], a[1], a[2]];
    // Off-diagonal entries by the axis that is *not* involved: off[0] = a12, off[1] = a02, off[2] = a01.
    let mut off = [a[5], a[4], a[3]];
    let mut u = [[one, zero, zero], [zero, one, zero], [zero, zero, one]];
    for _ in 0..4 {
        for (p, q, k) in [(0, 1, 2), (0, 2, 1), (1, 2, 0)] {
            let gap = w[q] - w[p];
            let twice = off[k] + off[k];
            let root = gap.mul_add(gap, twice * twice).sqrt();
            // Tangent of the rotation angle, |t| ≤ 1; the clamp covers squares that underflow.
            let size = (twice.abs() / (gap.abs() + root + c(1e-37))).min(one);
            let t = size.copysign(one.copysign(gap) * one.copysign(twice));
            let cos = one / t.mul_add(t, one).sqrt();
            let sin = t * cos;
            let shift = t * off[k];
            w[p] -= shift;
            w[q] += shift;
            off[k] = zero;
            let (pk, qk) = (off[q], off[p]);
            off[q] = cos * pk - sin * qk;
            off[p] = sin.mul_add(pk, cos * qk);
            for row in &mut u {
                let (up, uq) = (row[p], row[q]);
                row[p] = cos * up - sin * uq;
                row[q] = sin.mul_add(up, cos * uq);
            }
        }
    }
    (w, u)
}

/// `u diag(d) uᵀ`.
#[inline(always)]
pub fn from_eigen<S: Simd>(u: &Mat3s<S>, d: [Lanes<S>; 3]) -> Sym3<S> {
    let e = |r: usize, c: usize| {
        let t = u[r][0] * d[0] * u[c][0];
        let t = (u[r][1] * d[1]).mul_add(u[c][1], t);
        (u[r][2] * d[2]).mul_add(u[c][2], t)
    };
    [e(0, 0), e(1, 1), e(2, 2), e(0, 1), e(0, 2), e(1, 2)]
}

/// `a : b`, the sum of all nine products.
#[inline(always)]
pub fn contract<S: Simd>(a: &Sym3<S>, b: &Sym3<S>) -> Lanes<S> {
    let diagonal = a[2].mul_add(b[2], a[1].mul_add(b[1], a[0] * b[0]));
    let off = a[5].mul_add(b[5], a[4].mul_add(b[4], a[3] * b[3]));
    diagonal + (off + off)
}

/// `a²`.
#[inline(always)]
pub fn square<S: Simd>(a: &Sym3<S>) -> Sym3<S> {
    let [xx, yy, zz, xy, xz, yz] = *a;
    [
        xx.mul_add(xx, xy.mul_add(xy, xz * xz)),
        xy.mul_add(xy, yy.mul_add(yy, yz * yz)),
        xz.mul_add(xz, yz.mul_add(yz, zz * zz)),
        xy.mul_add(xx + yy, xz * yz),
        xz.mul_add(xx + zz, xy * yz),
        yz.mul_add(yy + zz, xy * xz),
    ]
}

/// A traceless symmetric matrix `x` ready for power series: `x³ = p x + d`.
#[derive(Clone, Copy)]
pub struct Traceless<S: Simd> {
    /// The matrix.
    pub x: Sym3<S>,
    /// Its square.
    pub x2: Sym3<S>,
    /// `½ tr x²`. Every eigenvalue is at most `√(4p/3)` in size.
    pub p: Lanes<S>,
    /// `det x`.
    pub d: Lanes<S>,
}

impl<S: Simd> Traceless<S> {
    /// Prepares `x`, which must have no trace.
    #[inline(always)]
    pub fn new(x: Sym3<S>) -> Self {
        let x2 = square::<S>(&x);
        let p = (x2[0] + x2[1] + x2[2]) * 0.5;
        let d = contract::<S>(&x, &x2) * (1.0 / 3.0);
        Self { x, x2, p, d }
    }

    /// Coefficients `f` of `Σ cₙ xⁿ = f₀ + f₁ x + f₂ x²`.
    #[inline(always)]
    pub fn series(&self, s: S, coefficients: &[f32]) -> [Lanes<S>; 3] {
        let c = |v| Lanes::<S>::splat(s, v);
        let mut f = [c(coefficients[0]), c(coefficients[1]), c(coefficients[2])];
        let mut power = [c(0.0), c(0.0), c(1.0)];
        for &k in &coefficients[3..] {
            power = [power[2] * self.d, power[2].mul_add(self.p, power[0]), power[1]];
            for i in 0..3 {
                f[i] = power[i].mul_add(c(k), f[i]);
            }
        }
        f
    }

    /// `f₀ + f₁ x + f₂ x²`.
    #[inline(always)]
    pub fn combine(&self, f: [Lanes<S>; 3]) -> Sym3<S> {
        each6(
            #[inline(always)]
            |i| {
                let v = f[2].mul_add(self.x2[i], f[1] * self.x[i]);
                if i < 3 { v + f[0] } else { v }
            },
        )
    }
}

/// Largest `p` for which the series below are exact to rounding: eigenvalues up to 0.2.
pub const SERIES_P: f32 = 0.03;

/// Taylor coefficients of `ln(1 + x)`, degree 10.
pub const LN_1P: [f32; 11] =
    [0.0, 1.0, -1.0 / 2.0, 1.0 / 3.0, -1.0 / 4.0, 1.0 / 5.0, -1.0 / 6.0, 1.0 / 7.0, -1.0 / 8.0, 1.0 / 9.0, -1.0 / 10.0];

/// Taylor coefficients of `√(1 + x) − 1`, degree 9.
pub const SQRT_1P_M1: [f32; 10] =
    [0.0, 1.0 / 2.0, -1.0 / 8.0, 1.0 / 16.0, -5.0 / 128.0, 7.0 / 256.0, -21.0 / 1024.0, 33.0 / 2048.0, -429.0 / 32768.0, 715.0 / 65536.0];

/// Taylor coefficients of `eˣ − 1`, degree 6.
pub const EXP_M1: [f32; 7] = [0.0, 1.0, 1.0 / 2.0, 1.0 / 6.0, 1.0 / 24.0, 1.0 / 120.0, 1.0 / 720.0];

#[cfg(test)]
mod tests {
    use fearless_simd::{Level, dispatch};

    use super::*;
    use crate::rng::Rng;
    use crate::svd::svd;
    use crate::{Mat3, mat3};

    type Packed = [f64; 6];

    fn unpack(a: Packed) -> Mat3<f64> {
        [[a[0], a[3], a[4]], [a[3], a[1], a[5]], [a[4], a[5], a[2]]]
    }

    fn lanes_of<S: Simd>(s: S, batch: &[Packed]) -> Sym3<S> {
        std::array::from_fn(|k| Lanes::<S>::from_fn(s, |i| batch[i % batch.len()][k] as f32))
    }

    fn lane<S: Simd>(a: &Sym3<S>, i: usize) -> Mat3<f64> {
        unpack(std::array::from_fn(|k| f64::from(a[k][i])))
    }

    /// b = F Fᵀ of random, rank-deficient, repeated and inverted F.
    fn left_tensors() -> Vec<(Mat3<f64>, Packed)> {
        let mut rng = Rng::new(11);
        let mut f: Vec<Mat3<f64>> = Vec::new();
        for _ in 0..400 {
            let a: Mat3<f64> = std::array::from_fn(|_| std::array::from_fn(|_| rng.range(-2.0, 2.0)));
            f.push(a);
            f.push(mat3::outer(a[0], a[1]));
            let r = svd(a);
            f.push(mat3::mul(r.u, mat3::transpose(r.v)));
            f.push(r.with_values([1.5, 1.5, -0.3]));
            f.push(r.with_values([1.0001, 1.0, 0.9999]));
            f.push(r.with_values([20.0, 1.0, 0.05]));
        }
        f.extend([mat3::identity(), mat3::diag([2.0, 2.0, -0.5]), [[0.0; 3]; 3]]);
        f.into_iter()
            .map(|f| {
                let b = mat3::mul(f, mat3::transpose(f));
                (f, [b[0][0], b[1][1], b[2][2], b[0][1], b[0][2], b[1][2]])
            })
            .collect()
    }

    #[inline(always)]
    fn eigen_batch<S: Simd>(s: S, batch: &[Packed], out: &mut Vec<([f64; 3], Mat3<f64>)>) {
        let a = lanes_of(s, batch);
        let (w, u) = eigen(s, a);
        for i in 0..batch.len() {
            out.push((w.map(|v| f64::from(v[i])), u.map(|r| r.map(|v| f64::from(v[i])))));
        }
    }

    #[test]
    fn jacobi_gives_singular_values_and_a_rotation() {
        let level = Level::new();
        let all = left_tensors();
        let mut got = Vec::new();
        for chunk in all.chunks(4) {
            let b: Vec<Packed> = chunk.iter().map(|x| x.1).collect();
            dispatch!(level, s => eigen_batch(s, &b, &mut got));
        }
        for ((f, b), (w, u)) in all.iter().zip(&got) {
            let b = unpack(*b);
            let back = mat3::congruence(*u, mat3::diag(*w));
            assert!(mat3::norm(mat3::sub(back, b)) <= 2e-6 * mat3::norm(b), "{f:?}");
            let e = mat3::sub(mat3::mul(mat3::transpose(*u), *u), mat3::identity());
            assert!(mat3::norm(e) <= 2e-6 && mat3::det(*u) > 0.0);
            let mut s = w.map(|v| v.max(0.0).sqrt());
            s.sort_by(|a, b| b.total_cmp(a));
            let exact = svd(*f).s;
            for k in 0..3 {
                // The square root of a rounding error of the largest eigenvalue bounds the small ones.
                assert!((s[k] - exact[k].abs()).abs() <= 1e-6 * exact[0] * exact[0] / exact[k].abs().max(1e-3 * exact[0].max(1e-30)));
            }
        }
    }

    #[inline(always)]
    fn series_batch<S: Simd>(s: S, batch: &[Packed], coefficients: &[f32], out: &mut Vec<Mat3<f64>>) {
        let t = Traceless::new(lanes_of(s, batch));
        let v = t.combine(t.series(s, coefficients));
        out.extend((0..batch.len()).map(|i| lane::<S>(&v, i)));
    }

    #[test]
    fn series_match_the_functions_of_the_eigenvalues() {
        let level = Level::new();
        let mut rng = Rng::new(3);
        let mut batch: Vec<Packed> = Vec::new();
        for i in 0..600 {
            let size = if i % 3 == 0 { 1e-4 } else { 1.0 };
            let a: [f64; 6] = std::array::from_fn(|_| rng.range(-1.0, 1.0));
            let t = (a[0] + a[1] + a[2]) / 3.0;
            let mut a = [a[0] - t, a[1] - t, a[2] - t, a[3], a[4], a[5]];
            let p = 0.5 * mat3::norm(unpack(a)).powi(2);
            let k = size * rng.range(0.1, 1.0) * (f64::from(SERIES_P) / p).sqrt();
            a = a.map(|v| f64::from((v * k) as f32));
            batch.push(a);
        }
        type Function = fn(f64) -> f64;
        let cases: [(&[f32], Function); 3] =
            [(&LN_1P, f64::ln_1p), (&SQRT_1P_M1, |x| x / (1.0 + (1.0 + x).sqrt())), (&EXP_M1, f64::exp_m1)];
        for (coefficients, exact) in cases {
            let mut got = Vec::new();
            for chunk in batch.chunks(4) {
                dispatch!(level, s => series_batch(s, chunk, coefficients, &mut got));
            }
            for (a, g) in batch.iter().zip(&got) {
                let (w, u) = crate::svd::eigen_symmetric(unpack(*a));
                let want = mat3::congruence(u, mat3::diag(w.map(exact)));
                assert!(mat3::norm(mat3::sub(*g, want)) <= 3e-7 * mat3::norm(want), "{a:?}");
            }
        }
    }
}
