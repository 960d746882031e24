//! Simple shapes and their signed distances.

use std::sync::Arc;

use megas_math::{Mat3, Vec3, mat3, vec3};

use crate::{Field, Heightfield, Sheet};

/// Upwards; stands in for directions that have no length.
const UP: Vec3<f64> = [0.0, 0.0, 1.0];

/// A solid region of space. Any unit of length; the users of this program mean metres and +z up.
#[derive(Clone, Debug, PartialEq)]
pub enum Shape {
    /// All points behind a plane: `(x − point)·normal < 0`.
    HalfSpace {
        /// A point of the plane.
        point: Vec3<f64>,
        /// Direction out of the solid, any length > 0.
        normal: Vec3<f64>,
    },
    /// An oriented box.
    Box {
        /// Centre.
        center: Vec3<f64>,
        /// Half edge lengths, > 0.
        half: Vec3<f64>,
        /// Rotation whose columns are the axes of the box.
        axes: Mat3<f64>,
    },
    /// A ball.
    Sphere {
        /// Centre.
        center: Vec3<f64>,
        /// Radius, > 0.
        radius: f64,
    },
    /// A cylinder with flat ends at `a` and `b`.
    Cylinder {
        /// Centre of one end.
        a: Vec3<f64>,
        /// Centre of the other end.
        b: Vec3<f64>,
        /// Radius, > 0.
        radius: f64,
    },
    /// Everything within `radius` of the segment from `a` to `b`.
    Capsule {
        /// One end of the segment.
        a: Vec3<f64>,
        /// Other end of the segment.
        b: Vec3<f64>,
        /// Radius, > 0.
        radius: f64,
    },
    /// Ground of varying height.
    Heightfield(Arc<Heightfield>),
    /// Distances sampled on a grid: a triangle mesh, a reconstructed background.
    Field(Arc<Field>),
    /// A thin sheet: it has no inside.
    Sheet(Arc<Sheet>),
}

impl Shape {
    /// The axis-aligned box between two corners.
    pub fn aligned_box(min: Vec3<f64>, max: Vec3<f64>) -> Self {
        Shape::Box { center: vec3::lerp(min, max, 0.5), half: vec3::scale(vec3::sub(max, min), 0.5), axes: mat3::identity() }
    }

    /// Signed distance to the surface, negative inside, and its gradient (the outward unit normal). Exact outside the simple
    /// shapes; inside them it is the distance to the nearest face.
    pub fn distance(&self, x: Vec3<f64>) -> (f64, Vec3<f64>) {
        match self {
            Shape::HalfSpace { point, normal } => {
                let n = vec3::normalize_or(*normal, UP);
                (vec3::dot(vec3::sub(x, *point), n), n)
            }
            Shape::Sphere { center, radius } => {
                let r = vec3::sub(x, *center);
                (vec3::norm(r) - radius, vec3::normalize_or(r, UP))
            }
            Shape::Capsule { a, b, radius } => {
                let (ab, ax) = (vec3::sub(*b, *a), vec3::sub(x, *a));
                let t = (vec3::dot(ax, ab) / vec3::dot(ab, ab).max(f64::MIN_POSITIVE)).clamp(0.0, 1.0);
                let r = vec3::add_scaled(ax, ab, -t);
                (vec3::norm(r) - radius, vec3::normalize_or(r, UP))
            }
            Shape::Box { center, half, axes } => {
                let (d, n) = orthant(mat3::tmul_vec(*axes, vec3::sub(x, *center)), *half);
                (d, mat3::mul_vec(*axes, n))
            }
            Shape::Cylinder { a, b, radius } => {
                let half = 0.5 * vec3::norm(vec3::sub(*b, *a));
                let axis = vec3::normalize_or(vec3::sub(*b, *a), UP);
                let r = vec3::sub(x, vec3::lerp(*a, *b, 0.5));
                let along = vec3::dot(r, axis);
                let across = vec3::add_scaled(r, axis, -along);
                let (d, n) = orthant([vec3::norm(across), along], [*radius, half]);
                let out = vec3::normalize_or(across, vec3::frame_from_normal(axis).0);
                (d, vec3::add_scaled(vec3::scale(out, n[0]), axis, n[1]))
            }
            Shape::Heightfield(h) => h.distance(x),
            Shape::Field(f) => f.distance(x),
            Shape::Sheet(s) => s.near(x, f64::INFINITY).map_or((f64::INFINITY, UP), |at| {
                let side = if at.distance < 0.0 { -1.0 } else { 1.0 };
                (at.distance.abs(), vec3::scale(at.normal, side))
            }),
        }
    }

    /// True if the point lies inside or on the surface.
    pub fn contains(&self, x: Vec3<f64>) -> bool {
        self.distance(x).0 <= 0.0
    }

    /// The point about which rigid motions turn the shape: its centre.
    pub fn pivot(&self) -> Vec3<f64> {
        match self {
            Shape::HalfSpace { point, .. } => *point,
            Shape::Box { center, .. } | Shape::Sphere { center, .. } => *center,
            Shape::Cylinder { a, b, .. } | Shape::Capsule { a, b, .. } => vec3::lerp(*a, *b, 0.5),
            Shape::Heightfield(h) => h.center(),
            Shape::Field(f) => f.center(),
            Shape::Sheet(s) => {
                let (lo, hi) = s.bounds();
                vec3::lerp(lo, hi, 0.5)
            }
        }
    }

    /// Volume; `None` for solids without end.
    pub fn volume(&self) -> Option<f64> {
        use std::f64::consts::PI;
        match self {
            Shape::HalfSpace { .. } | Shape::Heightfield(_) => None,
            Shape::Sphere { radius, .. } => Some(4.0 / 3.0 * PI * radius.powi(3)),
            Shape::Box { half, .. } => Some(8.0 * half[0] * half[1] * half[2]),
            Shape::Cylinder { a, b, radius } => Some(PI * radius * radius * vec3::norm(vec3::sub(*b, *a))),
            Shape::Capsule { a, b, radius } => Some(PI * radius * radius * (vec3::norm(vec3::sub(*b, *a)) + 4.0 / 3.0 * radius)),
            Shape::Field(f) => Some(f.volume()),
            Shape::Sheet(_) => Some(0.0),
        }
    }

    /// Smallest and largest corner of an axis-aligned box around the solid; `None` for solids without end.
    pub fn bounds(&self) -> Option<(Vec3<f64>, Vec3<f64>)> {
        let around = |c: Vec3<f64>, h: Vec3<f64>| Some((vec3::sub(c, h), vec3::add(c, h)));
        match self {
            Shape::HalfSpace { .. } | Shape::Heightfield(_) => None,
            Shape::Sphere { center, radius } => around(*center, [*radius; 3]),
            Shape::Box { center, half, axes } => around(*center, std::array::from_fn(|r| (0..3).map(|c| axes[r][c].abs() * half[c]).sum())),
            Shape::Cylinder { a, b, radius } | Shape::Capsule { a, b, radius } => {
                Some((vec3::sub(vec3::min(*a, *b), [*radius; 3]), vec3::add(vec3::max(*a, *b), [*radius; 3])))
            }
            Shape::Field(f) => Some(f.bounds()),
            Shape::Sheet(s) => Some(s.bounds()),
        }
    }
}

/// Signed distance from the product of intervals `[−half, half]`, and its gradient.
fn orthant<const N: usize>(r: [f64; N], half: [f64; N]) -> (f64, [f64; N]) {
    let q: [f64; N] = std::array::from_fn(|a| r[a].abs() - half[a]);
    let sign = |a: usize| if r[a] < 0.0 { -1.0 } else { 1.0 };
    if q.iter().all(|&v| v <= 0.0) {
        let a = (0..N).fold(0, |best, a| if q[a] > q[best] { a } else { best });
        let mut n = [0.0; N];
        n[a] = sign(a);
        return (q[a], n);
    }
    let out = q.map(|v| v.max(0.0));
    let d = out.iter().map(|v| v * v).sum::<f64>().sqrt();
    (d, std::array::from_fn(|a| sign(a) * out[a] / d))
}

#[cfg(test)]
mod tests {
    use megas_math::quat;
    use megas_math::rng::Rng;

    use super::*;

    fn turned() -> Mat3<f64> {
        quat::to_mat3([0.9, 0.1, -0.3, 0.2])
    }

    #[test]
    fn distances_have_unit_gradient_and_the_right_sign() {
        let hills = Heightfield::new([-4.0, -4.0], [8.0, 8.0], [3, 2], vec![0.1, 0.2, 0.0, 0.1, 0.2, 0.1]).unwrap();
        let shapes = [
            (Shape::HalfSpace { point: [0.0, 0.0, 0.1], normal: [0.0, 1.0, 2.0] }, [0.0, 0.0, -5.0]),
            (Shape::Box { center: [0.0, 0.5, 1.0], half: [1.0, 1.5, 2.0], axes: turned() }, [0.0, 0.5, 1.0]),
            (Shape::Sphere { center: [0.2; 3], radius: 0.7 }, [0.2; 3]),
            (Shape::Capsule { a: [0.0; 3], b: [1.0, 1.0, 0.0], radius: 0.3 }, [0.5, 0.5, 0.1]),
            (Shape::Cylinder { a: [0.1, 0.0, -0.5], b: [0.5, 0.3, 0.9], radius: 0.6 }, [0.3, 0.1, 0.2]),
            (Shape::Heightfield(Arc::new(hills)), [0.0, 0.0, -0.5]),
        ];
        let mut rng = Rng::new(2);
        for (shape, inside) in shapes {
            assert!(shape.distance(inside).0 < 0.0 && shape.contains(inside), "{shape:?}");
            let exact = !matches!(shape, Shape::Heightfield(_));
            for _ in 0..200 {
                let x: [f64; 3] = std::array::from_fn(|_| rng.range(-3.0, 4.0));
                let (d, n) = shape.distance(x);
                assert!((vec3::norm(n) - 1.0).abs() < 1e-9, "{shape:?} {x:?}");
                if d > 0.0 && exact {
                    // Walking back along the normal lands on the surface.
                    let on = vec3::add_scaled(x, n, -d);
                    assert!(shape.distance(on).0.abs() < 1e-9, "{shape:?} {x:?}");
                    if let Some((lo, hi)) = shape.bounds() {
                        assert!((0..3).all(|a| on[a] > lo[a] - 1e-9 && on[a] < hi[a] + 1e-9), "{shape:?} {on:?}");
                    }
                }
                let h = 1e-6;
                let slope: f64 = (0..3)
                    .map(|a| {
                        let mut y = x;
                        y[a] += h;
                        ((shape.distance(y).0 - d) / h).powi(2)
                    })
                    .sum();
                let near = if exact { 1e-3 } else { 0.03 };
                assert!((slope - 1.0).abs() < near || d.abs() < 1e-4 || d < 0.0, "{shape:?} {x:?} {slope}");
            }
        }
    }

    #[test]
    fn known_distances() {
        let quarter = quat::to_mat3(quat::from_axis_angle([0.0, 0.0, 1.0], std::f64::consts::FRAC_PI_2));
        let cases = [
            (Shape::Sphere { center: [1.0, 0.0, 0.0], radius: 0.5 }, [3.0, 0.0, 0.0], 1.5),
            (Shape::aligned_box([-1.0, -2.0, -3.0], [1.0, 2.0, 3.0]), [4.0, 6.0, 0.0], 5.0),
            (Shape::aligned_box([-1.0, -2.0, -3.0], [1.0, 2.0, 3.0]), [0.5, 0.0, 0.0], -0.5),
            // A quarter turn about z swaps the x and y edges.
            (Shape::Box { center: [0.0; 3], half: [1.0, 2.0, 3.0], axes: quarter }, [3.0, 0.0, 0.0], 1.0),
            (Shape::Cylinder { a: [0.0; 3], b: [0.0, 0.0, 2.0], radius: 1.0 }, [4.0, 0.0, 6.0], 5.0),
            (Shape::Cylinder { a: [0.0; 3], b: [0.0, 0.0, 2.0], radius: 1.0 }, [0.0, 0.0, 0.25], -0.25),
            (Shape::Capsule { a: [0.0; 3], b: [0.0, 0.0, 2.0], radius: 1.0 }, [0.0, 0.0, 5.0], 2.0),
            (Shape::HalfSpace { point: [0.0, 0.0, 1.0], normal: [0.0, 0.0, 3.0] }, [7.0, 0.0, 0.5], -0.5),
        ];
        for (shape, x, d) in cases {
            assert!((shape.distance(x).0 - d).abs() < 1e-12, "{shape:?} {}", shape.distance(x).0);
        }
    }
}
