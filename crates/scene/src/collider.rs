//! Solid things the melt meets (simulation.md §6.1).

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::heat::MotionKey;
use crate::shape::{BoxShape, Frame, HeightShape, MeshShape, Plane, Sphere, Tube};

/// How material behaves at a collider.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ColliderMode {
    /// Slides with friction and may lift off.
    #[default]
    Separate,
    /// Slides without friction, never lifts off.
    Slip,
    /// Sticks.
    Sticky,
}

/// The shape of a collider. Write exactly one.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum ColliderShape {
    /// A floor or wall.
    Plane(Plane),
    /// A box.
    Box(BoxShape),
    /// A ball.
    Sphere(Sphere),
    /// A cylinder.
    Cylinder(Tube),
    /// A cylinder with round ends.
    Capsule(Tube),
    /// A triangle mesh out of a file.
    Mesh(MeshShape),
    /// Ground of varying height.
    Heightfield(HeightShape),
}

/// The inside of a collider that stores and conducts heat: a stove slab, a pan, a poker.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Conducting {
    /// Temperature at the start in °C; room temperature if left out.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = -273.15, max = 10000.0))]
    pub initial_temperature_c: Option<f64>,
    /// Density in kg/m³.
    #[schemars(range(min = 1.0, max = 30000.0))]
    pub density_kg_m3: f64,
    /// Specific heat in J/(kg·K).
    #[schemars(range(min = 1.0, max = 100000.0))]
    pub heat_capacity_j_kgk: f64,
    /// Conductivity in W/(m·K). A collider with `motion` has one temperature throughout.
    #[schemars(range(min = 1e-4, max = 5000.0))]
    pub conductivity_w_mk: f64,
    /// Heating in its inside in W; negative cools.
    #[schemars(range(min = -1e9, max = 1e9))]
    pub power_w: f64,
}

impl Default for Conducting {
    /// Cast iron.
    fn default() -> Self {
        Self { initial_temperature_c: None, density_kg_m3: 7200.0, heat_capacity_j_kgk: 460.0, conductivity_w_mk: 52.0, power_w: 0.0 }
    }
}

/// A solid body that material cannot enter; it may move.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Collider {
    /// Name, for messages.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub name: String,
    /// Its shape.
    pub shape: ColliderShape,
    /// What the coordinates of `shape` mean: "object" or "scene".
    #[serde(default)]
    pub frame: Frame,
    /// A sheet without thickness that holds matter on both of its sides apart (a leaf, a blade, a tray): a mesh of a single open layer of
    /// triangles, or a box, of which the rectangle across its thinnest side counts. Heat passes as if it were not there. At most 16.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub thin: bool,
    /// How material behaves at its surface.
    #[serde(default)]
    pub mode: ColliderMode,
    /// Coefficient of friction of solids for the mode separate, 0–2.
    #[serde(default = "default_friction")]
    #[schemars(range(min = 0.0, max = 2.0))]
    pub friction: f64,
    /// Melt sticks to it.
    #[serde(default = "yes")]
    pub melt_sticks: bool,
    /// Surface temperature in °C (a hot plate); insulating if left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = -273.15, max = 10000.0))]
    pub temperature_c: Option<f64>,
    /// Instead of one temperature: [[time_s, °C], …], linear in between.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub temperature_keyframes: Vec<[f64; 2]>,
    /// Instead of a given temperature: it stores and conducts heat itself.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub conducting: Option<Conducting>,
    /// How it moves: rigid motion, linear between keyframes.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub motion: Vec<MotionKey>,
    /// When it exists: [[from_s, until_s], …]; always if left out.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub active_s: Vec<[f64; 2]>,
}

fn default_friction() -> f64 {
    0.4
}

fn yes() -> bool {
    true
}

/// What of the scene behind the objects is solid.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Background {
    /// The plane that everything stands on.
    #[default]
    Plane,
    /// The whole surface that the background splats show from above: tables end, bowls hold.
    Collider,
    /// Nothing.
    None,
}

/// The plane that everything stands on: fitted under the objects, or their lowest point; or the reconstructed background.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Support {
    /// Put a floor under the objects.
    pub enabled: bool,
    /// What is solid: "plane", "collider" (the surface of the background splats) or "none".
    pub background: Background,
    /// Raises (or lowers) the floor from where it was found, as a fraction of the objects' longest side.
    #[schemars(range(min = -10.0, max = 1.0))]
    pub raise: f64,
    /// How material behaves on it.
    pub mode: ColliderMode,
    /// Coefficient of friction of solids for the mode separate, 0–2.
    #[schemars(range(min = 0.0, max = 2.0))]
    pub friction: f64,
    /// Melt sticks to it.
    pub melt_sticks: bool,
    /// Temperature of the floor in °C (a hot plate); insulating if left out.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = -273.15, max = 10000.0))]
    pub temperature_c: Option<f64>,
}

impl Default for Support {
    fn default() -> Self {
        Self {
            enabled: true,
            background: Background::default(),
            raise: 0.0,
            mode: ColliderMode::default(),
            friction: default_friction(),
            melt_sticks: true,
            temperature_c: None,
        }
    }
}
