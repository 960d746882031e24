//! Cameras: an orbit around the objects, or keyframes.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::shape::Frame;

/// A camera; each one makes its own film. Give `orbit` or `keyframes`; without either it is an orbit that fits the objects.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Camera {
    /// Name, used in file names: letters, digits, - and _.
    pub name: String,
    /// Vertical field of view in degrees.
    #[schemars(range(min = 1.0, max = 150.0))]
    pub fov_deg: f64,
    /// What positions and distances mean: "object" or "scene".
    pub frame: Frame,
    /// Circles around a point.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub orbit: Option<Orbit>,
    /// Positions over time, smoothly joined; at least one.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub keyframes: Vec<CameraKey>,
}

impl Default for Camera {
    fn default() -> Self {
        Self { name: "main".into(), fov_deg: 35.0, frame: Frame::Object, orbit: None, keyframes: Vec::new() }
    }
}

impl Camera {
    /// The orbit in use: the given one, or the default if there are no keyframes either.
    pub fn orbit_or_default(&self) -> Option<Orbit> {
        match (&self.orbit, self.keyframes.is_empty()) {
            (Some(orbit), _) => Some(orbit.clone()),
            (None, true) => Some(Orbit::default()),
            (None, false) => None,
        }
    }
}

/// A camera that circles a point.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Orbit {
    /// Where it looks, in the camera's frame; the middle of the objects by default.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub target: Option<[f64; 3]>,
    /// Distance from the target in the frame's lengths; just far enough to see everything if left out.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 1e-6, max = 1e9))]
    pub distance: Option<f64>,
    /// Direction it looks from at the start in degrees: 0 is from −y (simulator axes, z up), 90 from +x.
    #[schemars(range(min = -3600.0, max = 3600.0))]
    pub azimuth_deg: f64,
    /// Height above the horizon in degrees.
    #[schemars(range(min = -89.0, max = 89.0))]
    pub elevation_deg: f64,
    /// How far it circles during the film, in degrees; 360 is once around.
    #[schemars(range(min = -36000.0, max = 36000.0))]
    pub turn_deg: f64,
}

impl Default for Orbit {
    fn default() -> Self {
        Self { target: None, distance: None, azimuth_deg: 30.0, elevation_deg: 22.0, turn_deg: 40.0 }
    }
}

/// One keyframe of a camera path.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CameraKey {
    /// Time in seconds of the film.
    #[schemars(range(min = 0.0, max = 1e6))]
    pub time_s: f64,
    /// Position of the camera.
    pub eye: [f64; 3],
    /// Where it looks.
    pub target: [f64; 3],
    /// Vertical field of view in degrees, instead of the camera's.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 1.0, max = 150.0))]
    pub fov_deg: Option<f64>,
}
