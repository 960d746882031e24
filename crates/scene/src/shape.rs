//! Shapes, the two frames they may be given in, and the way from both to metres (simulation.md §0.1).

use std::sync::Arc;

use megas_geometry::{Heightfield, Shape};
use megas_math::{Mat3, mat3, vec3};
use megas_model::Similarity;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::value::Up;

/// What positions and lengths of a shape mean.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Frame {
    /// Relative to the box of the objects at rest, with +z up whatever the file's axes are: positions run from 0 to 1 along each side
    /// of the box ([0.5, 0.5, 1] is the middle of its top), lengths are fractions of its longest side. Fits any input file.
    #[default]
    Object,
    /// The input file's own coordinates and units.
    Scene,
}

/// A ball.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Sphere {
    /// Centre.
    pub center: [f64; 3],
    /// Radius, > 0.
    #[schemars(range(min = 1e-9, max = 1e9))]
    pub radius: f64,
}

/// A box between two corners, optionally turned about its centre.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct BoxShape {
    /// Smallest corner.
    pub min: [f64; 3],
    /// Largest corner.
    pub max: [f64; 3],
    /// Rotation about the centre of the box in degrees: about x, then y, then z (fixed axes).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rotation_deg: Option<[f64; 3]>,
}

/// A cylinder or capsule around the line from `from` to `to`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Tube {
    /// One end of the axis.
    pub from: [f64; 3],
    /// The other end of the axis.
    pub to: [f64; 3],
    /// Radius, > 0.
    #[schemars(range(min = 1e-9, max = 1e9))]
    pub radius: f64,
}

/// Everything on the side of a plane that `direction` points to.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct HalfSpace {
    /// A point of the plane.
    pub point: [f64; 3],
    /// Direction into the half-space; any length but zero.
    pub direction: [f64; 3],
}

/// A solid floor or wall: material stays on the side that `normal` points to.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Plane {
    /// A point of the surface.
    pub point: [f64; 3],
    /// Direction out of the solid; any length but zero.
    pub normal: [f64; 3],
}

/// A triangle mesh out of a file (.ply, .obj or .glb). Holes do no harm; parts thinner than two cells become two cells thick, unless the
/// collider is `thin`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct MeshShape {
    /// Path of the file, relative to the scene file.
    pub file: String,
    /// Length of its longest side; if left out, the numbers of the file are lengths of the frame.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 1e-9, max = 1e9))]
    pub size: Option<f64>,
    /// Where the centre of its box goes; if left out, the coordinates of the file are positions in the frame.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub position: Option<[f64; 3]>,
    /// The direction that points up in the file, in the object frame only: "+x", "-x", "+y", "-y", "+z", "-z", or three numbers.
    #[serde(default)]
    pub up: Up,
    /// Rotation about the centre of its box in degrees: about x, then y, then z (fixed axes), after `up`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rotation_deg: Option<[f64; 3]>,
}

/// Ground of varying height: heights over a rectangle, solid below.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct HeightShape {
    /// Smallest corner of the rectangle and lowest height; +z is up whatever the frame.
    pub min: [f64; 3],
    /// Largest corner of the rectangle and greatest height.
    pub max: [f64; 3],
    /// Heights from 0 (`min`) to 1 (`max`): one list per place along x, from `min` to `max`, each with the heights along y.
    #[schemars(length(min = 2))]
    pub heights: Vec<Vec<f64>>,
}

impl HeightShape {
    /// Number of lists and length of each; `None` unless all have the same length of at least two.
    pub(crate) fn count(&self) -> Option<[usize; 2]> {
        let columns = self.heights.first()?.len();
        let even = self.heights.len() >= 2 && columns >= 2 && self.heights.iter().all(|h| h.len() == columns);
        even.then_some([self.heights.len(), columns])
    }
}

impl BoxShape {
    /// Centre, half sides, and the rotation whose columns are the box's axes.
    pub fn oriented(&self) -> ([f64; 3], [f64; 3], Mat3<f64>) {
        let center = std::array::from_fn(|a| 0.5 * (self.min[a] + self.max[a]));
        let half = std::array::from_fn(|a| 0.5 * (self.max[a] - self.min[a]));
        let axes = self.rotation_deg.map_or(mat3::diag([1.0; 3]), euler_xyz);
        (center, half, axes)
    }
}

/// Rotation about the fixed x, then y, then z axis; angles in degrees.
fn euler_xyz(deg: [f64; 3]) -> Mat3<f64> {
    let [(sx, cx), (sy, cy), (sz, cz)] = deg.map(|d| d.to_radians().sin_cos());
    let x = [[1.0, 0.0, 0.0], [0.0, cx, -sx], [0.0, sx, cx]];
    let y = [[cy, 0.0, sy], [0.0, 1.0, 0.0], [-sy, 0.0, cy]];
    let z = [[cz, -sz, 0.0], [sz, cz, 0.0], [0.0, 0.0, 1.0]];
    mat3::mul(z, mat3::mul(y, x))
}

/// Where the objects are: what turns positions of a scene file into metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placement {
    /// Scene units and axes ↔ metres and simulator axes.
    pub similarity: Similarity,
    /// Smallest corner of the box of all objects at rest \[m\].
    pub box_min: [f64; 3],
    /// Largest corner of that box \[m\].
    pub box_max: [f64; 3],
}

impl Placement {
    /// A position of the file → metres.
    pub fn point(&self, frame: Frame, p: [f64; 3]) -> [f64; 3] {
        match frame {
            Frame::Scene => self.similarity.to_si(p),
            Frame::Object => std::array::from_fn(|a| self.box_min[a] + p[a] * (self.box_max[a] - self.box_min[a])),
        }
    }

    /// A length of the file → metres.
    pub fn length(&self, frame: Frame, length: f64) -> f64 {
        match frame {
            Frame::Scene => length * self.similarity.metres_per_unit,
            Frame::Object => length * (0..3).map(|a| self.box_max[a] - self.box_min[a]).fold(0.0, f64::max),
        }
    }

    /// A direction of the file → simulator axes, unit length.
    pub fn direction(&self, frame: Frame, d: [f64; 3]) -> [f64; 3] {
        let d = match frame {
            Frame::Scene => self.similarity.direction_to_si(d),
            Frame::Object => d,
        };
        vec3::normalize_or(d, [0.0, 0.0, 1.0])
    }

    /// A ball of the file in metres.
    pub fn sphere(&self, frame: Frame, s: &Sphere) -> Shape {
        Shape::Sphere { center: self.point(frame, s.center), radius: self.length(frame, s.radius) }
    }

    /// A box of the file in metres.
    pub fn boxed(&self, frame: Frame, b: &BoxShape) -> Shape {
        let (center, half, axes) = b.oriented();
        let center = self.point(frame, center);
        match frame {
            Frame::Scene => {
                Shape::Box { center, half: half.map(|h| self.length(frame, h)), axes: mat3::mul(self.similarity.rotation, axes) }
            }
            Frame::Object => {
                let half = std::array::from_fn(|a| half[a] * (self.box_max[a] - self.box_min[a]));
                Shape::Box { center, half, axes }
            }
        }
    }

    /// A cylinder of the file in metres.
    pub fn cylinder(&self, frame: Frame, t: &Tube) -> Shape {
        Shape::Cylinder { a: self.point(frame, t.from), b: self.point(frame, t.to), radius: self.length(frame, t.radius) }
    }

    /// A capsule of the file in metres.
    pub fn capsule(&self, frame: Frame, t: &Tube) -> Shape {
        Shape::Capsule { a: self.point(frame, t.from), b: self.point(frame, t.to), radius: self.length(frame, t.radius) }
    }

    /// The vertices of a mesh, as its file has them, in metres.
    pub fn mesh(&self, frame: Frame, m: &MeshShape, positions: &[[f32; 3]]) -> Vec<[f32; 3]> {
        let fold = |f: fn(f64, f64) -> f64, start: f64| {
            positions.iter().fold([start; 3], |a, x| std::array::from_fn(|k| f(a[k], f64::from(x[k]))))
        };
        let (lo, hi) = (fold(f64::min, f64::INFINITY), fold(f64::max, f64::NEG_INFINITY));
        let center = vec3::lerp(lo, hi, 0.5);
        let longest = (0..3).map(|a| hi[a] - lo[a]).fold(0.0, f64::max);
        let scale = match m.size {
            Some(size) if longest > 0.0 => self.length(frame, size) / longest,
            _ => self.length(frame, 1.0),
        };
        let own = m.rotation_deg.map_or(mat3::diag([1.0; 3]), euler_xyz);
        let turn = match frame {
            Frame::Scene => mat3::mul(self.similarity.rotation, own),
            Frame::Object => mat3::mul(own, Similarity::rotation_from_up(m.up.0)),
        };
        let place = self.point(frame, m.position.unwrap_or(center));
        let map = |x: &[f32; 3]| {
            let r = mat3::mul_vec(turn, vec3::sub(vec3::cast(*x), center));
            vec3::cast(vec3::add_scaled(place, r, scale))
        };
        positions.iter().map(map).collect()
    }

    /// Ground of the file in metres; `None` if its heights are not a rectangle of numbers.
    pub fn heightfield(&self, frame: Frame, h: &HeightShape) -> Option<Shape> {
        // A rectangle that is turned with the file's axes would not stand upright; only its corners are.
        let (a, b) = (self.point(frame, h.min), self.point(frame, h.max));
        let (lo, hi) = (vec3::min(a, b), vec3::max(a, b));
        let heights = h.heights.iter().flatten().map(|v| lo[2] + v * (hi[2] - lo[2])).collect();
        let field = Heightfield::new([lo[0], lo[1]], [hi[0] - lo[0], hi[1] - lo[1]], h.count()?, heights)?;
        Some(Shape::Heightfield(Arc::new(field)))
    }

    /// A half-space of the file in metres.
    pub fn half_space(&self, frame: Frame, h: &HalfSpace) -> Shape {
        // The file says where the half-space lies, the shape which way its surface faces.
        Shape::HalfSpace { point: self.point(frame, h.point), normal: self.direction(frame, h.direction).map(|v| -v) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn placement() -> Placement {
        // A y-down file, 0.1 m per unit; the objects' box is 0.2 × 0.1 × 0.4 m.
        let rotation = Similarity::rotation_from_up([0.0, -1.0, 0.0]);
        let similarity = Similarity { metres_per_unit: 0.1, rotation, origin: [1.0, 2.0, 3.0] };
        Placement { similarity, box_min: [-0.1, -0.05, -0.2], box_max: [0.1, 0.05, 0.2] }
    }

    #[test]
    fn the_object_frame_spans_the_box_and_the_scene_frame_follows_the_file() {
        let p = placement();
        assert_eq!(p.point(Frame::Object, [0.5, 0.5, 1.0]), [0.0, 0.0, 0.2]);
        assert!((p.length(Frame::Object, 0.5) - 0.2).abs() < 1e-15);
        // One scene unit against y is one unit up.
        let up = p.point(Frame::Scene, [1.0, 1.0, 3.0]);
        assert!((up[2] - 0.1).abs() < 1e-12 && up[0].abs() + up[1].abs() < 1e-12, "{up:?}");
    }

    #[test]
    fn shapes_contain_the_same_points_in_both_frames() {
        let p = placement();
        let tall = BoxShape { min: [0.0, 0.0, 0.5], max: [1.0, 1.0, 1.0], rotation_deg: None };
        let upper = p.boxed(Frame::Object, &tall);
        assert!(upper.contains([0.09, 0.04, 0.01]) && !upper.contains([0.09, 0.04, -0.01]) && !upper.contains([0.09, 0.06, 0.01]));
        let tube = Tube { from: [0.5, 0.5, 0.0], to: [0.5, 0.5, 1.0], radius: 0.1 };
        assert!(!p.cylinder(Frame::Object, &tube).contains([0.0, 0.0, 0.23]));
        assert!(p.capsule(Frame::Object, &tube).contains([0.0, 0.0, 0.23]));
        let half = HalfSpace { point: [1.0, 2.0, 3.0], direction: [0.0, -1.0, 0.0] };
        assert!(p.half_space(Frame::Scene, &half).contains([0.0, 0.0, 0.01]));
        assert!(!p.half_space(Frame::Scene, &half).contains([0.0, 0.0, -0.01]));
    }

    #[test]
    fn a_turned_box_turns() {
        let p = Placement {
            similarity: Similarity { metres_per_unit: 1.0, rotation: mat3::diag([1.0; 3]), origin: [0.0; 3] },
            box_min: [0.0; 3],
            box_max: [1.0; 3],
        };
        let plank = BoxShape { min: [-1.0, -0.1, -0.1], max: [1.0, 0.1, 0.1], rotation_deg: Some([0.0, 0.0, 90.0]) };
        let turned = p.boxed(Frame::Scene, &plank);
        assert!(turned.contains([0.0, 0.9, 0.0]) && !turned.contains([0.9, 0.0, 0.0]));
    }

    #[test]
    fn meshes_are_placed_by_size_position_and_up() {
        let p = placement();
        // A file with y up: a tower 4 high on a square of side 2.
        let file = [[-1.0, 0.0, -1.0], [1.0, 4.0, 1.0], [1.0, 0.0, -1.0]];
        let tower = MeshShape {
            file: "tower.obj".into(),
            size: Some(0.5),
            position: Some([0.5, 0.5, 1.0]),
            up: Up([0.0, 1.0, 0.0]),
            rotation_deg: None,
        };
        let x = p.mesh(Frame::Object, &tower, &file);
        // Half of the longest side of 0.4 m, its centre in the middle of the top at z = 0.2 m.
        let (lo, hi) = (vec3::min(x[0], x[1]), vec3::max(x[0], x[1]));
        assert!((hi[2] - lo[2] - 0.2).abs() < 1e-6 && (hi[0] - lo[0] - 0.1).abs() < 1e-6, "{x:?}");
        assert!((lo[2] - 0.1).abs() < 1e-6 && x[2][2] == x[0][2]);
        // In the scene frame the file's coordinates are the splats'.
        let own = MeshShape { size: None, position: None, up: Up::default(), ..tower };
        let y = p.mesh(Frame::Scene, &own, &file);
        for (a, b) in file.iter().zip(y) {
            assert!(vec3::norm(vec3::sub(p.similarity.to_si(vec3::cast(*a)), vec3::cast(b))) < 1e-6);
        }
    }
}
