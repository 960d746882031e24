//! Procedural bodies: scenes without a capture, in metres, on a table whose top is z = 0.

use megas_math::{mat3, quat, vec3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::heat::MotionKey;
use crate::value::Colour;

/// Form of a procedural body; `size_m` is the box around it before it is turned.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum BodyForm {
    /// A box.
    #[default]
    Box,
    /// A ball, or an ellipsoid if the sides differ.
    Ball,
    /// An upright cylinder; its diameter is the first side.
    Cylinder,
    /// An upright cone; its diameter is the first side.
    Cone,
    /// A lying ring: the first side is its outer diameter, the third its thickness.
    Torus,
    /// The triangle mesh of `mesh`, scaled to fit into the box.
    Mesh,
}

/// How the two colours of a body mix.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Pattern {
    /// Soft clouds.
    #[default]
    Marble,
    /// Chips of the second colour.
    Speckle,
    /// Level layers.
    Layers,
    /// The first colour alone.
    Plain,
}

/// A procedural body. Objects take bodies by name through `parts`; without any `object`, every body is an object of its own.
/// Bodies of no object are scenery: drawn, but not simulated.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct InputBody {
    /// Name, for `parts` of objects.
    pub name: String,
    /// Geometric form.
    pub form: BodyForm,
    /// Mesh file (.ply, .obj, .glb), relative to the scene file, for form = "mesh".
    #[serde(skip_serializing_if = "Option::is_none")]
    pub mesh: Option<String>,
    /// Sides of the box around the body in metres: x, y, z before it is turned.
    pub size_m: [f64; 3],
    /// Centre in metres; z = 0 is the table top. If left out, the body stands in the middle of the table.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub center_m: Option<[f64; 3]>,
    /// Rotation about the centre in degrees: about x, then y, then z (fixed axes).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rotation_deg: Option<[f64; 3]>,
    /// Radius of rounded edges in metres; a twelfth of the shortest side if left out.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0.0, max = 100.0))]
    pub rounding_m: Option<f64>,
    /// Colour: "#rrggbb" or three numbers 0–1.
    pub colour: Colour,
    /// Second colour; a darker shade of the first if left out.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub second_colour: Option<Colour>,
    /// How the colours mix.
    pub pattern: Pattern,
    /// Strength of the mirror-like coat.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub gloss: f64,
    /// How much light leaks through shadowed parts.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub translucency: f64,
    /// Scenery only: how it moves, a rigid motion about its centre, linear between keyframes. Give it the keyframes of the
    /// heat source or collider that it shows.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub motion: Vec<MotionKey>,
    /// Scenery only: temperature in °C that thermal films and glow show; ambient if left out.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = -273.15, max = 10000.0))]
    pub temperature_c: Option<f64>,
}

impl Default for InputBody {
    fn default() -> Self {
        Self {
            name: "body".into(),
            form: BodyForm::Box,
            mesh: None,
            size_m: [0.1; 3],
            center_m: None,
            rotation_deg: None,
            rounding_m: None,
            colour: Colour([0.86, 0.83, 0.76]),
            second_colour: None,
            pattern: Pattern::Marble,
            gloss: 0.2,
            translucency: 0.2,
            motion: Vec::new(),
            temperature_c: None,
        }
    }
}

impl InputBody {
    /// Sides that its form really has \[m\].
    pub fn sides(&self) -> [f64; 3] {
        let [x, y, z] = self.size_m;
        match self.form {
            BodyForm::Cylinder | BodyForm::Cone | BodyForm::Torus => [x, x, z],
            _ => [x, y, z],
        }
    }

    /// Rotation as the columns of a matrix.
    pub fn axes(&self) -> [[f64; 3]; 3] {
        let [x, y, z] = self.rotation_deg.unwrap_or_default().map(f64::to_radians);
        let about = |axis, angle| quat::to_mat3(quat::from_axis_angle(axis, angle));
        mat3::mul(about([0.0, 0.0, 1.0], z), mat3::mul(about([0.0, 1.0, 0.0], y), about([1.0, 0.0, 0.0], x)))
    }

    /// Centre \[m\]; a body without one stands on z = 0.
    pub fn center(&self) -> [f64; 3] {
        self.center_m.unwrap_or_else(|| [0.0, 0.0, self.reach()[2]])
    }

    /// Radius of the rounded edges \[m\].
    pub fn rounding(&self) -> f64 {
        let shortest = self.sides().into_iter().fold(f64::INFINITY, f64::min);
        self.rounding_m.unwrap_or(shortest / 12.0).min(0.49 * shortest)
    }

    /// Half sides of the upright box around the turned body's own box \[m\].
    fn reach(&self) -> [f64; 3] {
        let (axes, half) = (self.axes(), self.sides().map(|s| 0.5 * s));
        std::array::from_fn(|r| (0..3).map(|c| axes[r][c].abs() * half[c]).sum())
    }

    /// Corners of the upright box around the body \[m\].
    pub fn bounds(&self) -> ([f64; 3], [f64; 3]) {
        let (c, r) = (self.center(), self.reach());
        (vec3::sub(c, r), vec3::add(c, r))
    }
}

/// The table under procedural bodies.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Table {
    /// Draw it. The simulated floor is that of `support`, table or not.
    pub show: bool,
    /// Radius of its round top in metres; 1.6 times the longest side of all bodies if left out.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0.001, max = 100.0))]
    pub radius_m: Option<f64>,
}

impl Default for Table {
    fn default() -> Self {
        Self { show: true, radius_m: None }
    }
}
