//! Which part of the splats becomes which object (splatting.md §5.11).

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::shape::{BoxShape, HalfSpace, Sphere, Tube};

/// A thing that is simulated: some of the splats, its real size, its material.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Object {
    /// Name, for messages and for `region = { object = "name" }`.
    pub name: String,
    /// Which splats belong to the object; everything if left out. Splats of no object stay as static background. Where objects
    /// overlap the first one wins.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub select: Option<Select>,
    /// Names of parts of an embedded asset (instead of `select`), e.g. ["scoop-1", "scoop-2"].
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub parts: Vec<String>,
    /// Real length of the object's longest side in metres. One object of a scene gives it, and all are scaled by it;
    /// 0.2 for all objects together if none does.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0.001, max = 100.0))]
    pub size_m: Option<f64>,
    /// A material preset (see `megas materials`) or the name of a [materials.NAME] table.
    pub material: String,
    /// How the inside is found; `density-field` is for comparison and leaves objects that are only a skin hollow.
    pub filling: Filling,
    /// Temperature at the start in °C; by default room temperature, or 10 K below the solidus where that is colder.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = -273.15, max = 5000.0))]
    pub initial_temperature_c: Option<f64>,
    /// Velocity at the start in m/s, +z up.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub initial_velocity_m_s: Option<[f64; 3]>,
    /// Resistance to heat of this object's side of its contacts with other objects in m²·K/W; that of a contact is the sum of both
    /// sides. None if left out. Dry, rough solids have about 1e-4, a layer of paper or felt 1e-3 to 1e-1.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0.0, max = 10.0))]
    pub contact_resistance_m2k_w: Option<f64>,
}

impl Default for Object {
    fn default() -> Self {
        Self {
            name: "object".into(),
            select: None,
            parts: Vec::new(),
            size_m: None,
            material: crate::presets::DEFAULT_MATERIAL.into(),
            filling: Filling::Rays,
            initial_temperature_c: None,
            initial_velocity_m_s: None,
            contact_resistance_m2k_w: None,
        }
    }
}

/// How the inside of an object is found.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Filling {
    /// By rays that meet the skin from inside.
    #[default]
    Rays,
    /// By the density of the splats, as PhysGaussian does.
    DensityField,
}

/// A choice of splats by their centres, in the input file's own coordinates and units. Keys side by side must all hold; `any`, `all`
/// and `not` build the rest. Filters are applied first, then `above_support_plane`, then `seed` or `largest_component`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Select {
    /// Inside this box.
    #[serde(rename = "box", skip_serializing_if = "Option::is_none")]
    pub in_box: Option<BoxShape>,
    /// Inside this ball.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sphere: Option<Sphere>,
    /// Inside this cylinder.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub cylinder: Option<Tube>,
    /// On the side of the plane that `direction` points to.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub half_space: Option<HalfSpace>,
    /// Opacity at least this, 0–1; 0.02–0.1 removes haze.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0.0, max = 1.0))]
    pub min_opacity: Option<f64>,
    /// Longest standard deviation at most this many scene units: removes sky blobs.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 1e-9, max = 1e9))]
    pub max_scale: Option<f64>,
    /// Fit the plane that the thing stands on and keep what is above it.
    pub above_support_plane: bool,
    /// Keep only the largest connected component.
    pub largest_component: bool,
    /// Keep only the connected component nearest to this point.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub seed: Option<[f64; 3]>,
    /// All of these selections.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub all: Vec<Select>,
    /// At least one of these selections.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub any: Vec<Select>,
    /// Not this selection.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub not: Option<Box<Select>>,
}
