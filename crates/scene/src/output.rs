//! What comes out: films, pictures, splats.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

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
            thermal_range_c: None,
        }
    }
}
