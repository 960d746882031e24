//! Heat sources: region × kind × schedule × motion (simulation.md §4.7).

pub(crate) mod radiant;
pub(crate) mod surface;
pub(crate) mod terms;

use serde::{Deserialize, Serialize};

pub use crate::region::{Region, Shape};
pub use crate::schedule::{Motion, Schedule};

/// Stefan–Boltzmann constant \[W/(m²·K⁴)\].
pub const STEFAN_BOLTZMANN: f64 = 5.670_374_419e-8;

/// Something that heats or cools. All numbers SI, simulator axes.
#[derive(Clone, Debug, PartialEq)]
pub struct HeatSource {
    /// Name for reports.
    pub name: String,
    /// Where.
    pub region: Region,
    /// What.
    pub kind: SourceKind,
    /// When and how strongly.
    pub schedule: Schedule,
    /// Rigid motion of the region; ignored by regions that follow a body.
    pub motion: Motion,
}

/// What a source does to the material in its region.
///
/// The air is not part of the lattice here (§3.6 `none`, `film`), so every kind acts on material alone: a node takes its
/// share in proportion to how full it is. Keyframes of the schedule replace the number named first.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum SourceKind {
    /// Holds the region at a temperature.
    Temperature {
        /// Temperature \[K\].
        kelvin: f64,
    },
    /// Total power, spread evenly over the material in the region.
    Power {
        /// Power \[W\]; negative cools.
        watts: f64,
    },
    /// Power per volume of material.
    Volume {
        /// Power density \[W/m³\].
        watts_per_m3: f64,
    },
    /// Power per area of the surface inside the region.
    Flux {
        /// Flux into the surface \[W/m²\].
        watts_per_m2: f64,
    },
    /// Exchange of the surface inside the region with surroundings at another temperature.
    Film(Film),
    /// Light on the surface inside the region, with shadows of material and obstacles. The source's motion moves the light, not
    /// the region.
    Radiant(Radiant),
}

/// Light that surfaces take in part.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Radiant {
    /// Where it comes from.
    pub light: Light,
    /// Irradiance across the direction of [`Light::Sun`] \[W/m²\], power of [`Light::Torch`] \[W\]; keyframes replace it.
    pub strength: f64,
    /// Share that the surface takes, 0–1.
    pub absorptivity: f64,
}

/// Where light comes from.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Light {
    /// Parallel rays.
    Sun {
        /// Way of the light; any length > 0.
        direction: [f64; 3],
    },
    /// Rays from a point, evenly into a cone.
    Torch {
        /// The point \[m\].
        position: [f64; 3],
        /// Axis of the cone; any length > 0.
        direction: [f64; 3],
        /// Half of its opening angle \[rad\], 0–π.
        half_angle: f64,
    },
}

/// Robin condition: `q″ = h (T − T_∞)` plus grey radiation to the same surroundings.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Film {
    /// Temperature of the surroundings T_∞ \[K\]; keyframes replace it.
    pub ambient: f64,
    /// Film coefficient h_f \[W/(m²·K)\], ≥ 0.
    pub coefficient: f64,
    /// Emissivity, 0–1; 0 switches radiation off.
    pub emissivity: f64,
}

impl Default for Film {
    fn default() -> Self {
        Self { ambient: 293.15, coefficient: 10.0, emissivity: 0.0 }
    }
}

impl Film {
    /// Film coefficient including radiation at surface temperature `t` \[K\].
    pub fn total_coefficient(&self, t: f64) -> f64 {
        let s = self.ambient;
        self.coefficient + self.emissivity * STEFAN_BOLTZMANN * (t * t + s * s) * (t + s)
    }
}

/// What one source did in the last step.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SourceReport {
    /// Heat brought into the material \[J\]; negative = taken out.
    pub heat: f64,
    /// Surface area it acted on \[m²\]; zero for sources that act on volumes.
    pub area: f64,
    /// Nodes it acted on.
    pub nodes: u32,
}
