//! Solid things the melt meets (simulation.md §6.1).

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::shape::{BoxShape, Frame, Plane, Sphere, Tube};

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
}

/// A solid body at rest that material cannot enter.
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
}

fn default_friction() -> f64 {
    0.4
}

fn yes() -> bool {
    true
}

/// The plane that everything stands on: fitted under the objects, or their lowest point.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Support {
    /// Put a floor under the objects.
    pub enabled: bool,
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
            raise: 0.0,
            mode: ColliderMode::default(),
            friction: default_friction(),
            melt_sticks: true,
            temperature_c: None,
        }
    }
}
