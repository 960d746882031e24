//! 3×3 matrices, row by row.

use crate::{Real, Vec3, vec3};

/// A matrix `m[row][column]`.
pub type Mat3<T> = [[T; 3]; 3];

/// The identity.
#[inline(always)]
pub fn identity<T: Real>() -> Mat3<T> {
    diag([T::one(); 3])
}

/// The diagonal matrix of `d`.
#[inline(always)]
pub fn diag<T: Real>(d: Vec3<T>) -> Mat3<T> {
    let z = T::zero();
    [[d[0], z, z], [z, d[1], z], [z, z, d[2]]]
}

/// `a b`.
#[inline(always)]
pub fn mul<T: Real>(a: Mat3<T>, b: Mat3<T>) -> Mat3<T> {
    std::array::from_fn(|r| std::array::from_fn(|c| a[r][0] * b[0][c] + a[r][1] * b[1][c] + a[r][2] * b[2][c]))
}

/// `a v`.
#[inline(always)]
pub fn mul_vec<T: Real>(a: Mat3<T>, v: Vec3<T>) -> Vec3<T> {
    [vec3::dot(a[0], v), vec3::dot(a[1], v), vec3::dot(a[2], v)]
}

/// `aᵀ v`.
#[inline(always)]
pub fn tmul_vec<T: Real>(a: Mat3<T>, v: Vec3<T>) -> Vec3<T> {
    std::array::from_fn(|c| a[0][c] * v[0] + a[1][c] * v[1] + a[2][c] * v[2])
}

/// `aᵀ`.
#[inline(always)]
pub fn transpose<T: Real>(a: Mat3<T>) -> Mat3<T> {
    std::array::from_fn(|r| std::array::from_fn(|c| a[c][r]))
}

/// `a + b`.
#[inline(always)]
pub fn add<T: Real>(a: Mat3<T>, b: Mat3<T>) -> Mat3<T> {
    std::array::from_fn(|r| vec3::add(a[r], b[r]))
}

/// `a - b`.
#[inline(always)]
pub fn sub<T: Real>(a: Mat3<T>, b: Mat3<T>) -> Mat3<T> {
    std::array::from_fn(|r| vec3::sub(a[r], b[r]))
}

/// `s a`.
#[inline(always)]
pub fn scale<T: Real>(a: Mat3<T>, s: T) -> Mat3<T> {
    std::array::from_fn(|r| vec3::scale(a[r], s))
}

/// `a bᵀ` of two vectors.
#[inline(always)]
pub fn outer<T: Real>(a: Vec3<T>, b: Vec3<T>) -> Mat3<T> {
    std::array::from_fn(|r| vec3::scale(b, a[r]))
}

/// Determinant.
#[inline(always)]
pub fn det<T: Real>(a: Mat3<T>) -> T {
    vec3::dot(a[0], vec3::cross(a[1], a[2]))
}

/// Trace.
#[inline(always)]
pub fn trace<T: Real>(a: Mat3<T>) -> T {
    a[0][0] + a[1][1] + a[2][2]
}

/// Inverse by cofactors, or `None` where the determinant is zero or not finite.
#[inline]
pub fn inverse<T: Real>(a: Mat3<T>) -> Option<Mat3<T>> {
    let d = det(a);
    if d == T::zero() || !d.is_finite() {
        return None;
    }
    let c0 = vec3::cross(a[1], a[2]);
    let c1 = vec3::cross(a[2], a[0]);
    let c2 = vec3::cross(a[0], a[1]);
    Some(scale(transpose([c0, c1, c2]), d.recip()))
}

/// Frobenius norm.
#[inline(always)]
pub fn norm<T: Real>(a: Mat3<T>) -> T {
    (vec3::dot(a[0], a[0]) + vec3::dot(a[1], a[1]) + vec3::dot(a[2], a[2])).sqrt()
}

/// `(a + aᵀ) / 2`.
#[inline(always)]
pub fn symmetrize<T: Real>(a: Mat3<T>) -> Mat3<T> {
    scale(add(a, transpose(a)), T::of(0.5))
}

/// `m s mᵀ`: a symmetric tensor carried by a linear map (the push-forward of a covariance).
#[inline(always)]
pub fn congruence<T: Real>(m: Mat3<T>, s: Mat3<T>) -> Mat3<T> {
    mul(mul(m, s), transpose(m))
}

/// Column `c` as a vector.
#[inline(always)]
pub fn column<T: Real>(a: Mat3<T>, c: usize) -> Vec3<T> {
    [a[0][c], a[1][c], a[2][c]]
}

/// The matrix with the given columns.
#[inline(always)]
pub fn from_columns<T: Real>(c0: Vec3<T>, c1: Vec3<T>, c2: Vec3<T>) -> Mat3<T> {
    transpose([c0, c1, c2])
}

/// Converts between scalar types.
#[inline(always)]
pub fn cast<T: Real, U: Real>(a: Mat3<T>) -> Mat3<U> {
    a.map(vec3::cast)
}
