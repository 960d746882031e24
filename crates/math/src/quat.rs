//! Quaternions `[w, x, y, z]`, scalar first.

use crate::{Mat3, Real, Vec3, vec3};

/// A quaternion `[w, x, y, z]`; functions normalise at use unless they say otherwise.
pub type Quat<T> = [T; 4];

/// `q / |q|`, or `None` where the length is zero or not finite.
pub fn normalize<T: Real>(q: Quat<T>) -> Option<Quat<T>> {
    let n = (q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]).sqrt();
    (n > T::zero() && n.is_finite()).then(|| q.map(|c| c / n))
}

/// Rotation matrix of a unit quaternion (splatting.md §1.1).
#[inline(always)]
pub fn to_mat3_unit<T: Real>(q: Quat<T>) -> Mat3<T> {
    let [w, x, y, z] = q;
    let (one, two) = (T::one(), T::of(2.0));
    [
        [one - two * (y * y + z * z), two * (x * y - w * z), two * (x * z + w * y)],
        [two * (x * y + w * z), one - two * (x * x + z * z), two * (y * z - w * x)],
        [two * (x * z - w * y), two * (y * z + w * x), one - two * (x * x + y * y)],
    ]
}

/// Rotation matrix of any quaternion; the identity for a zero one.
#[inline(always)]
pub fn to_mat3<T: Real>(q: Quat<T>) -> Mat3<T> {
    let z = T::zero();
    to_mat3_unit(normalize(q).unwrap_or([T::one(), z, z, z]))
}

/// Unit quaternion (w ≥ 0) of a rotation matrix.
pub fn from_mat3<T: Real>(m: Mat3<T>) -> Quat<T> {
    let one = T::one();
    let quarter = T::of(0.25);
    let four = [
        one + m[0][0] + m[1][1] + m[2][2],
        one + m[0][0] - m[1][1] - m[2][2],
        one - m[0][0] + m[1][1] - m[2][2],
        one - m[0][0] - m[1][1] + m[2][2],
    ];
    let mut k = 0;
    for i in 1..4 {
        if four[i] > four[k] {
            k = i;
        }
    }
    let (a, b, c) = (m[2][1] - m[1][2], m[0][2] - m[2][0], m[1][0] - m[0][1]);
    let (d, e, f) = (m[1][0] + m[0][1], m[0][2] + m[2][0], m[2][1] + m[1][2]);
    let v = match k {
        0 => [four[0], a, b, c],
        1 => [a, four[1], d, e],
        2 => [b, d, four[2], f],
        _ => [c, e, f, four[3]],
    };
    let q = v.map(|x| x * quarter);
    let q = normalize(q).unwrap_or([one, T::zero(), T::zero(), T::zero()]);
    if q[0] < T::zero() { q.map(|x| -x) } else { q }
}

/// Product `a b`: the rotation `b` followed by `a`.
pub fn mul<T: Real>(a: Quat<T>, b: Quat<T>) -> Quat<T> {
    [
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
        a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
        a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
    ]
}

/// Rotation by `angle` radians about the unit `axis`.
pub fn from_axis_angle<T: Real>(axis: Vec3<T>, angle: T) -> Quat<T> {
    let (s, c) = (angle * T::of(0.5)).sin_cos();
    [c, axis[0] * s, axis[1] * s, axis[2] * s]
}

/// The shortest rotation that turns the unit vector `a` into the unit vector `b`.
pub fn between<T: Real>(a: Vec3<T>, b: Vec3<T>) -> Quat<T> {
    let d = vec3::dot(a, b);
    let z = T::zero();
    if d < T::of(-0.999_999) {
        let t = vec3::frame_from_normal(a).0;
        return [z, t[0], t[1], t[2]];
    }
    let c = vec3::cross(a, b);
    normalize([T::one() + d, c[0], c[1], c[2]]).unwrap_or([T::one(), z, z, z])
}

/// Spherical interpolation along the shorter arc; `t` in `[0, 1]`, unit inputs.
pub fn slerp<T: Real>(a: Quat<T>, b: Quat<T>, t: T) -> Quat<T> {
    let mut d = a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3];
    let b = if d < T::zero() {
        d = -d;
        b.map(|x| -x)
    } else {
        b
    };
    let (wa, wb) = if d > T::of(0.9995) {
        (T::one() - t, t)
    } else {
        let th = d.min(T::one()).acos();
        let s = th.sin();
        (((T::one() - t) * th).sin() / s, (t * th).sin() / s)
    };
    normalize(std::array::from_fn(|i| a[i] * wa + b[i] * wb)).unwrap_or(a)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{mat3, rng::Rng};

    #[test]
    fn matrix_round_trip_product_and_shortest_arc() {
        let mut rng = Rng::new(3);
        for _ in 0..200 {
            let mut r = || normalize(std::array::from_fn(|_| rng.range(-1.0, 1.0))).unwrap();
            let (a, b) = (r(), r());
            let back = to_mat3(from_mat3(to_mat3(a)));
            assert!(mat3::norm(mat3::sub(back, to_mat3(a))) < 1e-12);
            let ab = mat3::mul(to_mat3(a), to_mat3(b));
            assert!(mat3::norm(mat3::sub(ab, to_mat3(mul(a, b)))) < 1e-12);
            let (u, v) = (mat3::column(to_mat3(a), 0), mat3::column(to_mat3(b), 1));
            let w = mat3::mul_vec(to_mat3(between(u, v)), u);
            assert!(vec3::norm(vec3::sub(w, v)) < 1e-9);
        }
    }
}
