//! Where something happens: simple shapes in simulator axes, a whole body, a surface (simulation.md §4.7).

use megas_math::{Vec3, mat3, quat, vec3};
use serde::{Deserialize, Serialize};

/// A region of space or of the scene. Lengths in metres, simulator axes (+z up).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Region {
    /// Everywhere.
    All,
    /// An oriented box.
    Box {
        /// Centre \[m\].
        center: Vec3<f64>,
        /// Half edge lengths \[m\], > 0.
        half: Vec3<f64>,
        /// Orientation `[w, x, y, z]`; identity by default.
        #[serde(default = "upright")]
        rotation: [f64; 4],
    },
    /// A ball.
    Sphere {
        /// Centre \[m\].
        center: Vec3<f64>,
        /// Radius \[m\], > 0.
        radius: f64,
    },
    /// A cylinder with flat ends at `a` and `b`.
    Cylinder {
        /// Centre of one end \[m\].
        a: Vec3<f64>,
        /// Centre of the other end \[m\].
        b: Vec3<f64>,
        /// Radius \[m\], > 0.
        radius: f64,
    },
    /// Everything within `radius` of the segment from `a` to `b`.
    Capsule {
        /// One end of the segment \[m\].
        a: Vec3<f64>,
        /// Other end of the segment \[m\].
        b: Vec3<f64>,
        /// Radius \[m\], > 0.
        radius: f64,
    },
    /// All points behind a plane: `(x − point)·normal < 0`.
    HalfSpace {
        /// A point of the plane \[m\].
        point: Vec3<f64>,
        /// Outward normal, any length > 0.
        normal: Vec3<f64>,
    },
    /// A whole body, wherever it moves.
    Object(u16),
    /// The surface layer of one body, or of all.
    Surface(Option<u16>),
}

fn upright() -> [f64; 4] {
    [1.0, 0.0, 0.0, 0.0]
}

impl Region {
    /// The body this region follows, if it names one.
    pub fn object(&self) -> Option<u16> {
        match self {
            Region::Object(id) | Region::Surface(Some(id)) => Some(*id),
            _ => None,
        }
    }

    /// Point about which a motion rotates the region \[m\].
    fn pivot(&self) -> Vec3<f64> {
        match self {
            Region::Box { center, .. } | Region::Sphere { center, .. } => *center,
            Region::Cylinder { a, b, .. } | Region::Capsule { a, b, .. } => vec3::lerp(*a, *b, 0.5),
            Region::HalfSpace { point, .. } => *point,
            Region::All | Region::Object(_) | Region::Surface(_) => [0.0; 3],
        }
    }

    /// The region carried by a rigid motion: rotated about its own centre by the unit quaternion `rotation`, then translated.
    pub fn moved(&self, translation: Vec3<f64>, rotation: [f64; 4]) -> Self {
        let r = quat::to_mat3(rotation);
        let pivot = self.pivot();
        let place = |x: Vec3<f64>| vec3::add(vec3::add(pivot, translation), mat3::mul_vec(r, vec3::sub(x, pivot)));
        match self.clone() {
            Region::Box { center, half, rotation: own } => Region::Box { center: place(center), half, rotation: quat::mul(rotation, own) },
            Region::Sphere { center, radius } => Region::Sphere { center: place(center), radius },
            Region::Cylinder { a, b, radius } => Region::Cylinder { a: place(a), b: place(b), radius },
            Region::Capsule { a, b, radius } => Region::Capsule { a: place(a), b: place(b), radius },
            Region::HalfSpace { point, normal } => Region::HalfSpace { point: place(point), normal: mat3::mul_vec(r, normal) },
            other => other,
        }
    }

    /// Signed distance of `x` to the region's boundary \[m\], negative inside; `−∞` for the regions that are not shapes.
    pub fn distance(&self, x: Vec3<f64>) -> f64 {
        match self {
            Region::All | Region::Object(_) | Region::Surface(_) => f64::NEG_INFINITY,
            Region::Box { center, half, rotation } => {
                let local = mat3::tmul_vec(quat::to_mat3(*rotation), vec3::sub(x, *center));
                outside_and_inside(std::array::from_fn::<_, 3, _>(|a| local[a].abs() - half[a]))
            }
            Region::Sphere { center, radius } => vec3::norm(vec3::sub(x, *center)) - radius,
            Region::Cylinder { a, b, radius } => {
                let half = 0.5 * vec3::norm(vec3::sub(*b, *a));
                let axis = vec3::normalize_or(vec3::sub(*b, *a), [0.0, 0.0, 1.0]);
                let d = vec3::sub(x, vec3::lerp(*a, *b, 0.5));
                let along = vec3::dot(d, axis);
                outside_and_inside([vec3::norm(vec3::add_scaled(d, axis, -along)) - radius, along.abs() - half])
            }
            Region::Capsule { a, b, radius } => {
                let (ab, ax) = (vec3::sub(*b, *a), vec3::sub(x, *a));
                let t = (vec3::dot(ax, ab) / vec3::dot(ab, ab).max(f64::MIN_POSITIVE)).clamp(0.0, 1.0);
                vec3::norm(vec3::add_scaled(ax, ab, -t)) - radius
            }
            Region::HalfSpace { point, normal } => vec3::dot(vec3::sub(x, *point), vec3::normalize_or(*normal, [0.0, 0.0, 1.0])),
        }
    }

    /// Weight χ ∈ `[0, 1]` of a node at `x`: 1 inside, 0 outside, smooth over one `spacing` across the boundary.
    pub fn weight(&self, x: Vec3<f64>, spacing: f64) -> f64 {
        let t = (0.5 - self.distance(x) / spacing).clamp(0.0, 1.0);
        t * t * (3.0 - 2.0 * t)
    }
}

/// Distance of a product of intervals from the signed distances along its axes.
fn outside_and_inside<const N: usize>(q: [f64; N]) -> f64 {
    let outside = q.iter().map(|v| v.max(0.0).powi(2)).sum::<f64>().sqrt();
    outside + q.iter().fold(f64::NEG_INFINITY, |m, v| m.max(*v)).min(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distances_of_every_shape() {
        let half = std::f64::consts::FRAC_1_SQRT_2;
        let cases: [(Region, Vec3<f64>, f64); 8] = [
            (Region::Sphere { center: [1.0, 0.0, 0.0], radius: 0.5 }, [3.0, 0.0, 0.0], 1.5),
            (Region::Box { center: [0.0; 3], half: [1.0, 2.0, 3.0], rotation: upright() }, [4.0, 6.0, 0.0], 5.0),
            (Region::Box { center: [0.0; 3], half: [1.0, 2.0, 3.0], rotation: upright() }, [0.5, 0.0, 0.0], -0.5),
            // A quarter turn about z swaps the x and y edges.
            (Region::Box { center: [0.0; 3], half: [1.0, 2.0, 3.0], rotation: [half, 0.0, 0.0, half] }, [3.0, 0.0, 0.0], 1.0),
            (Region::Cylinder { a: [0.0; 3], b: [0.0, 0.0, 2.0], radius: 1.0 }, [4.0, 0.0, 6.0], 5.0),
            (Region::Cylinder { a: [0.0; 3], b: [0.0, 0.0, 2.0], radius: 1.0 }, [0.0, 0.0, 0.25], -0.25),
            (Region::Capsule { a: [0.0; 3], b: [0.0, 0.0, 2.0], radius: 1.0 }, [0.0, 0.0, 5.0], 2.0),
            (Region::HalfSpace { point: [0.0, 0.0, 1.0], normal: [0.0, 0.0, 3.0] }, [7.0, 0.0, 0.5], -0.5),
        ];
        for (region, x, d) in cases {
            assert!((region.distance(x) - d).abs() < 1e-12, "{region:?} {}", region.distance(x));
        }
        assert_eq!(Region::All.weight([9.0; 3], 0.1), 1.0);
        assert_eq!(Region::Sphere { center: [0.0; 3], radius: 1.0 }.weight([1.0, 0.0, 0.0], 0.1), 0.5);
    }

    #[test]
    fn moving_a_region_is_moving_the_question() {
        let shape = Region::Capsule { a: [1.0, 0.0, 0.0], b: [2.0, 1.0, 0.0], radius: 0.3 };
        let q = quat::from_axis_angle(vec3::normalize_or([1.0, 2.0, 3.0], [1.0, 0.0, 0.0]), 0.7);
        let moved = shape.moved([0.1, -0.2, 0.3], q);
        let x = [0.4, 0.9, -0.6];
        let there = vec3::add(vec3::add(shape.pivot(), [0.1, -0.2, 0.3]), mat3::mul_vec(quat::to_mat3(q), vec3::sub(x, shape.pivot())));
        assert!((shape.distance(x) - moved.distance(there)).abs() < 1e-12);
    }
}
