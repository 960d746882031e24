//! What comes out: films, pictures, splats.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::shape::Frame;
use crate::value::Colour;

/// A kind of film.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Film {
    /// What the eye sees.
    Rgb,
    /// Temperature in false colours, with a legend and the melting line.
    Thermal,
    /// Both next to each other.
    SideBySide,
}

impl Film {
    /// Name in file names and messages.
    pub fn name(self) -> &'static str {
        match self {
            Self::Rgb => "rgb",
            Self::Thermal => "thermal",
            Self::SideBySide => "side_by_side",
        }
    }
}

/// A format of mesh files.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum MeshKind {
    /// Binary PLY with colours and a `temperature` property; the input's axes.
    Ply,
    /// Wavefront OBJ with colours behind the positions; the input's axes.
    Obj,
    /// Binary glTF 2.0 with colours and the attribute `_TEMPERATURE`; +Y up.
    Glb,
}

/// A cut through the pictures: splats whose centre lies beyond the plane are left out.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Clip {
    /// A point of the plane.
    pub point: [f64; 3],
    /// Direction of the side that is cut away; any length but zero. With `frame = "object"` along the simulator's axes (+z up).
    pub normal: [f64; 3],
    /// What the numbers mean: "object" or "scene".
    #[serde(default)]
    pub frame: Frame,
}

/// What the photographs cannot know: hot matter glows, melts are wet. Cold solids keep their colours.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Appearance {
    /// Brightness of glowing matter; 0 switches it off, 1 is as bright as a white surface at `white_c`. Nothing glows below 480 °C.
    #[schemars(range(min = 0.0, max = 10.0))]
    pub glow: f64,
    /// Temperature in °C at which glowing matter is as bright as a white surface: the exposure of the camera.
    #[schemars(range(min = 500.0, max = 5000.0))]
    pub white_c: f64,
    /// Contrast of the glow: 1 is a camera (a lava flow of 700 °C is black where one of 1200 °C is white), less is how eyes adapt.
    #[schemars(range(min = 0.05, max = 1.0))]
    pub contrast: f64,
    /// How wet melts look, 0–1: darker, with a soft sheen.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub wet: f64,
}

impl Default for Appearance {
    fn default() -> Self {
        Self { glow: 1.0, white_c: 1427.0, contrast: 0.5, wet: 0.4 }
    }
}

/// Pictures and files.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Output {
    /// Width in pixels (default: from `quality`); even.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 16, max = 8192))]
    pub width: Option<u32>,
    /// Height in pixels (default: from `quality`); even.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 16, max = 8192))]
    pub height: Option<u32>,
    /// Colour behind everything: "#rrggbb" or three numbers 0–1.
    pub background: Colour,
    /// Which MP4 films to write: "rgb", "thermal", "side_by_side".
    pub films: Vec<Film>,
    /// Keep the frames of the films as PNG.
    pub png: bool,
    /// Write every n-th frame as a splat .ply with temperature; 0 writes none.
    #[schemars(range(min = 0, max = 100000))]
    pub ply_every: u32,
    /// Write a closed mesh of the objects, with colours and temperatures, in these formats: "ply", "obj", "glb".
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub mesh: Vec<MeshKind>,
    /// Write the mesh of every n-th frame.
    #[schemars(range(min = 1, max = 100000))]
    pub mesh_every: u32,
    /// Edge of the mesh's voxels in units of the default, a quarter of a simulator cell: 2 is a quick preview.
    #[schemars(range(min = 0.25, max = 4.0))]
    pub mesh_voxel: f64,
    /// Cut away what lies beyond a plane, to look inside.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub clip: Option<Clip>,
    /// Glow of hot matter, wetness of melts; with `preset = "paper"` none if left out.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub appearance: Option<Appearance>,
    /// Range of the false colours in °C, [coldest, hottest]; measured if left out.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub thermal_range_c: Option<[f64; 2]>,
}

impl Default for Output {
    fn default() -> Self {
        Self {
            width: None,
            height: None,
            background: Colour([1.0; 3]),
            films: vec![Film::Rgb, Film::Thermal, Film::SideBySide],
            png: true,
            ply_every: 0,
            mesh: Vec::new(),
            mesh_every: 1,
            mesh_voxel: 1.0,
            clip: None,
            appearance: None,
            thermal_range_c: None,
        }
    }
}
