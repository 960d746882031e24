//! Vectors of three components.

use crate::Real;

/// A column vector `[x, y, z]`.
pub type Vec3<T> = [T; 3];

/// `a + b`.
#[inline(always)]
pub fn add<T: Real>(a: Vec3<T>, b: Vec3<T>) -> Vec3<T> {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

/// `a - b`.
#[inline(always)]
pub fn sub<T: Real>(a: Vec3<T>, b: Vec3<T>) -> Vec3<T> {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

/// `s a`.
#[inline(always)]
pub fn scale<T: Real>(a: Vec3<T>, s: T) -> Vec3<T> {
    [a[0] * s, a[1] * s, a[2] * s]
}

/// `a + s b`.
#[inline(always)]
pub fn add_scaled<T: Real>(a: Vec3<T>, b: Vec3<T>, s: T) -> Vec3<T> {
    [a[0] + b[0] * s, a[1] + b[1] * s, a[2] + b[2] * s]
}

/// Inner product.
#[inline(always)]
pub fn dot<T: Real>(a: Vec3<T>, b: Vec3<T>) -> T {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Cross product, right-handed.
#[inline(always)]
pub fn cross<T: Real>(a: Vec3<T>, b: Vec3<T>) -> Vec3<T> {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// Euclidean length.
#[inline(always)]
pub fn norm<T: Real>(a: Vec3<T>) -> T {
    dot(a, a).sqrt()
}

/// `a / |a|`, or `fallback` where the length is zero or not finite.
#[inline(always)]
pub fn normalize_or<T: Real>(a: Vec3<T>, fallback: Vec3<T>) -> Vec3<T> {
    let n = norm(a);
    if n > T::zero() && n.is_finite() { scale(a, n.recip()) } else { fallback }
}

/// Linear interpolation from `a` (t = 0) to `b` (t = 1).
#[inline(always)]
pub fn lerp<T: Real>(a: Vec3<T>, b: Vec3<T>, t: T) -> Vec3<T> {
    add_scaled(a, sub(b, a), t)
}

/// Component-wise minimum.
#[inline(always)]
pub fn min<T: Real>(a: Vec3<T>, b: Vec3<T>) -> Vec3<T> {
    [a[0].min(b[0]), a[1].min(b[1]), a[2].min(b[2])]
}

/// Component-wise maximum.
#[inline(always)]
pub fn max<T: Real>(a: Vec3<T>, b: Vec3<T>) -> Vec3<T> {
    [a[0].max(b[0]), a[1].max(b[1]), a[2].max(b[2])]
}

/// Converts between scalar types.
#[inline(always)]
pub fn cast<T: Real, U: Real>(a: Vec3<T>) -> Vec3<U> {
    [U::of(a[0].f64()), U::of(a[1].f64()), U::of(a[2].f64())]
}

/// Two unit vectors that complete the unit vector `n` to a right-handed frame `(t1, t2, n)`, without branches on its
/// direction (Duff et al. 2017, "Building an Orthonormal Basis, Revisited").
pub fn frame_from_normal<T: Real>(n: Vec3<T>) -> (Vec3<T>, Vec3<T>) {
    let one = T::one();
    let s = if n[2] < T::zero() { -one } else { one };
    let a = -one / (s + n[2]);
    let b = n[0] * n[1] * a;
    ([one + s * n[0] * n[0] * a, s * b, -s * n[0]], [b, s + n[1] * n[1] * a, -n[1]])
}
