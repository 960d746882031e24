//! Solid obstacles as conditions on nodes (simulation.md §6.1): signed distances, contact modes, friction.

use megas_math::{Vec3, vec3};
use serde::{Deserialize, Serialize};

/// Geometry of an obstacle; lengths in metres.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Shape {
    /// Half space below a plane.
    Plane {
        /// A point of the plane.
        point: [f64; 3],
        /// Direction out of the solid; need not have unit length.
        normal: [f64; 3],
    },
    /// Axis-aligned box.
    Box {
        /// Lowest corner.
        min: [f64; 3],
        /// Highest corner.
        max: [f64; 3],
    },
    /// Ball.
    Sphere {
        /// Centre.
        center: [f64; 3],
        /// Radius.
        radius: f64,
    },
    /// Ball swept along a segment.
    Capsule {
        /// One end of the axis.
        a: [f64; 3],
        /// The other end.
        b: [f64; 3],
        /// Radius.
        radius: f64,
    },
    /// Upright cylinder (axis along z).
    Cylinder {
        /// Centre of the bottom disc.
        base: [f64; 3],
        /// Radius.
        radius: f64,
        /// Height.
        height: f64,
    },
}

impl Shape {
    /// Signed distance to the surface, negative inside, and its gradient (the outward unit normal). Exact outside; inside
    /// it is the distance to the nearest face.
    pub fn distance(&self, x: [f64; 3]) -> (f64, [f64; 3]) {
        const UP: Vec3<f64> = [0.0, 0.0, 1.0];
        match *self {
            Shape::Plane { point, normal } => {
                let n = vec3::normalize_or(normal, UP);
                (vec3::dot(vec3::sub(x, point), n), n)
            }
            Shape::Sphere { center, radius } => {
                let r = vec3::sub(x, center);
                (vec3::norm(r) - radius, vec3::normalize_or(r, UP))
            }
            Shape::Capsule { a, b, radius } => {
                let (ab, ax) = (vec3::sub(b, a), vec3::sub(x, a));
                let length2 = vec3::dot(ab, ab);
                let t = if length2 > 0.0 { (vec3::dot(ax, ab) / length2).clamp(0.0, 1.0) } else { 0.0 };
                let r = vec3::add_scaled(ax, ab, -t);
                (vec3::norm(r) - radius, vec3::normalize_or(r, UP))
            }
            Shape::Box { min, max } => {
                let center: Vec3<f64> = std::array::from_fn(|a| 0.5 * (min[a] + max[a]));
                let half: Vec3<f64> = std::array::from_fn(|a| 0.5 * (max[a] - min[a]));
                let r = vec3::sub(x, center);
                orthant(r, half)
            }
            Shape::Cylinder { base, radius, height } => {
                let r = vec3::sub(x, [base[0], base[1], base[2] + 0.5 * height]);
                let radial = r[0].hypot(r[1]);
                let (d, n) = orthant([radial, 0.0, r[2]], [radius, f64::MAX, 0.5 * height]);
                let out = if radial > 0.0 { [r[0] / radial, r[1] / radial] } else { [1.0, 0.0] };
                (d, [n[0] * out[0], n[0] * out[1], n[2]])
            }
        }
    }
}

/// Signed distance from a box of half sides `half` around the origin.
fn orthant(r: [f64; 3], half: [f64; 3]) -> (f64, [f64; 3]) {
    let q: Vec3<f64> = std::array::from_fn(|a| r[a].abs() - half[a]);
    let sign = |a: usize| if r[a] < 0.0 { -1.0 } else { 1.0 };
    if q.iter().all(|&v| v <= 0.0) {
        let a = (0..3).fold(0, |best, a| if q[a] > q[best] { a } else { best });
        let mut n = [0.0; 3];
        n[a] = sign(a);
        return (q[a], n);
    }
    let out = q.map(|v| v.max(0.0));
    let d = vec3::norm(out);
    (d, std::array::from_fn(|a| sign(a) * out[a] / d))
}

/// What happens to velocity at a node inside the obstacle.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Mode {
    /// Takes the obstacle's velocity.
    Sticky,
    /// Keeps the tangential part.
    Slip,
    /// Slides with Coulomb friction and may leave (default of scenes).
    Separate,
}

/// A static obstacle.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Collider {
    /// Geometry.
    pub shape: Shape,
    /// Contact rule.
    pub mode: Mode,
    /// Coulomb friction of [`Mode::Separate`], ≥ 0.
    pub friction: f64,
    /// Nodes with a distance below this are in contact \[node spacings\]; −0.5 for visual contact, 0 for analytic tests.
    pub offset: f64,
    /// [`Mode::Separate`] turns sticky where more than half of the node's mass is liquid.
    pub melt_sticks: bool,
}

/// Contact level of scene colliders \[node spacings\]: the kernel sees a wall half a node early.
pub const SCENE_CONTACT_OFFSET: f64 = -0.5;

impl Collider {
    /// A scene collider: separate, friction 0.4, half a spacing of overlap, melts stick.
    pub fn new(shape: Shape) -> Self {
        Self { shape, mode: Mode::Separate, friction: 0.4, offset: SCENE_CONTACT_OFFSET, melt_sticks: true }
    }
}

/// One node held by one obstacle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Contact {
    /// Node inside its block of 4³.
    pub node: u8,
    pub mode: Mode,
    pub melt_sticks: bool,
    pub friction: f32,
    pub normal: [f32; 3],
}

impl Contact {
    /// The velocity after this contact; `liquid` is the liquid share of the node's mass.
    #[inline]
    fn apply(&self, v: [f32; 3], liquid: f32) -> [f32; 3] {
        let vn = vec3::dot(v, self.normal);
        let tangential = vec3::add_scaled(v, self.normal, -vn);
        match self.mode {
            Mode::Sticky => [0.0; 3],
            Mode::Slip => tangential,
            Mode::Separate if vn >= 0.0 => v,
            Mode::Separate if self.melt_sticks && liquid > 0.5 => [0.0; 3],
            Mode::Separate => {
                let vt = vec3::norm(tangential);
                let keep = if vt > 0.0 { (1.0 + self.friction * vn / vt).max(0.0) } else { 0.0 };
                vec3::scale(tangential, keep)
            }
        }
    }
}

/// Velocity of a node after all obstacles that hold it: each in list order, then the first again, and rest where they still
/// contradict each other (the corner rule of simulation.md §6.1).
#[inline]
pub(crate) fn apply_contacts(contacts: &[Contact], mut v: [f32; 3], liquid: f32) -> [f32; 3] {
    for c in contacts {
        v = c.apply(v, liquid);
    }
    if let [first, _, ..] = contacts {
        v = first.apply(v, liquid);
        let size = vec3::norm(v);
        if contacts.iter().any(|c| vec3::dot(v, c.normal) < -1e-6 * size) {
            return [0.0; 3];
        }
    }
    v
}

#[cfg(test)]
mod tests {
    use megas_math::rng::Rng;

    use super::*;

    #[test]
    fn distances_have_unit_gradient_and_the_right_sign() {
        let shapes = [
            (Shape::Plane { point: [0.0, 0.0, 0.1], normal: [0.0, 1.0, 2.0] }, [0.0, 0.0, -5.0]),
            (Shape::Box { min: [-1.0; 3], max: [1.0, 2.0, 3.0] }, [0.0; 3]),
            (Shape::Sphere { center: [0.2; 3], radius: 0.7 }, [0.2; 3]),
            (Shape::Capsule { a: [0.0; 3], b: [1.0, 1.0, 0.0], radius: 0.3 }, [0.5, 0.5, 0.1]),
            (Shape::Cylinder { base: [0.1, 0.0, -0.5], radius: 0.6, height: 1.4 }, [0.1, 0.0, 0.0]),
        ];
        let mut rng = Rng::new(2);
        for (shape, inside) in shapes {
            assert!(shape.distance(inside).0 < 0.0, "{shape:?}");
            for _ in 0..200 {
                let x: [f64; 3] = std::array::from_fn(|_| rng.range(-3.0, 4.0));
                let (d, n) = shape.distance(x);
                assert!((vec3::norm(n) - 1.0).abs() < 1e-9, "{shape:?} {x:?}");
                if d > 0.0 {
                    // Walking back along the normal lands on the surface.
                    let on = vec3::add_scaled(x, n, -d);
                    assert!(shape.distance(on).0.abs() < 1e-9, "{shape:?} {x:?}");
                }
                let h = 1e-6;
                let slope: f64 = (0..3)
                    .map(|a| {
                        let mut y = x;
                        y[a] += h;
                        ((shape.distance(y).0 - d) / h).powi(2)
                    })
                    .sum();
                assert!((slope - 1.0).abs() < 1e-3 || d.abs() < 1e-4 || d < 0.0, "{shape:?} {x:?} {slope}");
            }
        }
    }

    #[test]
    fn contact_modes_follow_coulomb_and_corners_come_to_rest() {
        let up = Contact { node: 0, mode: Mode::Separate, melt_sticks: true, friction: 0.5, normal: [0.0, 0.0, 1.0] };
        assert_eq!(up.apply([1.0, 0.0, 2.0], 0.0), [1.0, 0.0, 2.0]);
        assert_eq!(up.apply([1.0, 0.0, -1.0], 0.0), [0.5, 0.0, 0.0]);
        assert_eq!(up.apply([1.0, 0.0, -3.0], 0.0), [0.0; 3]);
        assert_eq!(up.apply([1.0, 0.0, -1.0], 0.9), [0.0; 3]);
        let slip = Contact { mode: Mode::Slip, ..up };
        assert_eq!(slip.apply([1.0, 2.0, -3.0], 0.0), [1.0, 2.0, 0.0]);
        assert_eq!(Contact { mode: Mode::Sticky, ..up }.apply([1.0, 2.0, 3.0], 0.0), [0.0; 3]);
        // Two opposed oblique planes: no velocity satisfies both except the common tangent.
        let s = 0.5f32.sqrt();
        let a = Contact { friction: 0.0, normal: [s, 0.0, s], ..up };
        let b = Contact { friction: 0.0, normal: [-s, 0.0, s], ..up };
        let v = apply_contacts(&[a, b], [0.0, 1.0, -1.0], 0.0);
        for c in [a, b] {
            assert!(vec3::dot(v, c.normal) >= -1e-6);
        }
        // An acute wedge: each projection pushes into the other wall.
        let c = Contact { friction: 0.0, normal: [0.98, 0.0, 0.199], ..up };
        let d = Contact { friction: 0.0, normal: [-0.98, 0.0, 0.199], ..up };
        assert_eq!(apply_contacts(&[c, d], [0.0, 0.0, -1.0], 0.0), [0.0; 3]);
    }
}
