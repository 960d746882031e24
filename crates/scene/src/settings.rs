//! How it is computed: quality, time, simulation, air, filling, skin (simulation.md §10.2, splatting.md §11.1).

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::value::Auto;

/// One word for resolution, stiffness and picture size; the keys it stands for can still be set one by one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Quality {
    /// Minutes on a laptop: 28 cells along the object, soft (2 % sag), 854 × 480.
    Preview,
    /// 48 cells, 0.5 % sag, 1280 × 720.
    #[default]
    Default,
    /// 64 cells, 0.5 % sag, 1920 × 1080.
    Final,
}

impl Quality {
    /// Grid cells along the object's longest side.
    pub fn cells(self) -> u32 {
        match self {
            Self::Preview => 28,
            Self::Default => 48,
            Self::Final => 64,
        }
    }

    /// Sag ratio ε of the visual stiffness `E* = ρ g H / ε` (simulation.md §2.5).
    pub fn sag_ratio(self) -> f64 {
        match self {
            Self::Preview => 0.02,
            Self::Default | Self::Final => 0.005,
        }
    }

    /// Width and height of the film \[px\].
    pub fn size(self) -> (u32, u32) {
        match self {
            Self::Preview => (854, 480),
            Self::Default => (1280, 720),
            Self::Final => (1920, 1080),
        }
    }
}

/// How long, and how fast heat runs. At most one of `melt_in_s` and `acceleration`; with neither, things melt in three
/// quarters of the film.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Time {
    /// Length of the film in seconds.
    #[schemars(range(min = 0.01, max = 3600.0))]
    pub duration_s: f64,
    /// Frames per second.
    #[schemars(range(min = 1.0, max = 240.0))]
    pub fps: f64,
    /// Choose the thermal acceleration so that the objects melt in about this many seconds; the factor is reported.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0.05, max = 1e6))]
    pub melt_in_s: Option<f64>,
    /// Thermal acceleration: heat capacity and latent heat are divided by this; 1 is nature's pace.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0.01, max = 1e5))]
    pub acceleration: Option<f64>,
    /// Simulated seconds per second of film: 0.1 is slow motion, 10 is time lapse. Mechanics run along, so time lapse costs.
    #[schemars(range(min = 0.001, max = 1000.0))]
    pub time_lapse: f64,
}

impl Default for Time {
    fn default() -> Self {
        Self { duration_s: 5.0, fps: 24.0, melt_in_s: None, acceleration: None, time_lapse: 1.0 }
    }
}

impl Time {
    /// Number of frames, the first one (at rest) included.
    pub fn frames(&self) -> u64 {
        ((self.duration_s * self.fps).round() as u64).max(1)
    }

    /// Simulated time between two frames \[s\].
    pub fn frame_dt_s(&self) -> f64 {
        self.time_lapse / self.fps
    }
}

/// How material parameters follow melting (simulation.md §5.5).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum PhaseMode {
    /// Parameters blend between solidus and liquidus.
    #[default]
    Mushy,
    /// Solid below, melt above, with hysteresis.
    Binary,
    /// The melt's law from the start.
    InitMelted,
}

/// Two sets of rules; the keys they stand for can still be set one by one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Preset {
    /// Enthalpy with latent heat, increments, parameters that blend through the mushy zone.
    #[default]
    Physical,
    /// The algorithm of the MeGAS paper, literally: temperature overwritten from the nodes, no latent heat, one specific heat for all
    /// materials, a switch at the melting point. It diffuses heat numerically; that is what it is for.
    Paper,
}

/// How temperature travels between points and nodes (simulation.md §3.2).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum HeatTransfer {
    /// Points receive what their nodes gained.
    Increments,
    /// Points take the temperature of their nodes; gradients soften the loss.
    Affine,
    /// Points take the temperature of their nodes. Diffuses strongly.
    Pic,
}

/// How momentum travels from points to nodes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum MomentumTransfer {
    /// With the affine velocity of each point (APIC).
    #[default]
    Affine,
    /// With the mean velocity alone (PIC). Damps strongly.
    Pic,
}

/// What the sides of the simulated space do.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Bounds {
    /// They are walls.
    #[default]
    Clamp,
    /// What reaches them is gone.
    Delete,
}

/// The simulation's grid and rules.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Simulation {
    /// Grid cells along the objects' longest side (default: from `quality`). Cost grows with the fourth power.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 8, max = 256))]
    pub cells: Option<u32>,
    /// Stiffness of solids by how much they sag under their weight (default: from `quality`): 0.005 is half a percent of the height. Softer
    /// is cheaper.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0.0005, max = 0.1))]
    pub sag_ratio: Option<f64>,
    /// Gravity in m/s².
    #[schemars(range(min = 0.0, max = 1000.0))]
    pub gravity_m_s2: f64,
    /// Move at all; false leaves pure heat conduction in bodies at rest.
    pub mechanics: bool,
    /// How material parameters follow melting: "mushy", "binary" or "init_melted" (default: from `preset`, "mushy" or "binary").
    #[serde(skip_serializing_if = "Option::is_none")]
    pub phase_mode: Option<PhaseMode>,
    /// Width of the switching hysteresis in K (default: from `preset`, 1 or 0).
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0.0, max = 5.0))]
    pub hysteresis_k: Option<f64>,
    /// false: melting takes no latent heat (default: from `preset`).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub latent_heat: Option<bool>,
    /// true: every material has the specific heat of the first object's solid (default: from `preset`).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub uniform_heat_capacity: Option<bool>,
    /// How temperature travels between points and nodes: "increments", "affine" or "pic" (default: from `preset`, "increments" or
    /// "affine").
    #[serde(skip_serializing_if = "Option::is_none")]
    pub heat_transfer: Option<HeatTransfer>,
    /// Exchange heat at every mechanical substep instead of every coupling step. Slow; with "affine" it shows how that transfer diffuses.
    pub heat_every_substep: bool,
    /// How momentum travels from points to nodes: "affine" or "pic".
    pub momentum_transfer: MomentumTransfer,
    /// Share of its shear stress that a melt keeps when it freezes in one step (phase_mode "binary"), 0–1; 0 freezes stress-free.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub frozen_stress: f64,
    /// Size of the simulated space in metres, [x, y, z] with z up, around and above the objects; chosen with room to spread if left out.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub box_m: Option<[f64; 3]>,
    /// What the sides of the simulated space do: "clamp" (walls) or "delete": what comes within two cells of a side is gone, with its
    /// mass and heat, and not drawn any more. The report counts it.
    pub bounds: Bounds,
    /// Share of the stable time step that is used.
    #[schemars(range(min = 0.05, max = 0.7))]
    pub courant: f64,
    /// Time before the film in which solids settle under their weight, strongly damped, in seconds; 0 starts at once. Left out
    /// where an object has a velocity at the start, or would fall or flow meanwhile.
    #[schemars(range(min = 0.0, max = 10.0))]
    pub settle_s: f64,
    /// Longest time between two exchanges of heat, in seconds.
    #[schemars(range(min = 1e-5, max = 0.05))]
    pub coupling_step_s: f64,
}

impl Default for Simulation {
    fn default() -> Self {
        Self {
            cells: None,
            sag_ratio: None,
            gravity_m_s2: 9.81,
            mechanics: true,
            phase_mode: None,
            hysteresis_k: None,
            latent_heat: None,
            uniform_heat_capacity: None,
            heat_transfer: None,
            heat_every_substep: false,
            momentum_transfer: MomentumTransfer::Affine,
            frozen_stress: 0.0,
            box_m: None,
            bounds: Bounds::Clamp,
            courant: 0.4,
            settle_s: 0.25,
            coupling_step_s: 0.002,
        }
    }
}

/// What the air does (simulation.md §3.6).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum AirMode {
    /// Nothing: the surface is insulated.
    None,
    /// The surface exchanges heat with air of one temperature.
    #[default]
    Film,
    /// The air conducts heat but does not move.
    Still,
    /// The air conducts and flows: plumes rise, cold air sinks (lattice Boltzmann). Costs most.
    Lbm,
}

/// Number format of simulated air.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum AirStorage {
    /// Single precision.
    #[default]
    F32,
    /// Half precision.
    F16,
}

/// The air around the objects.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Air {
    /// What the air does: "film", "none", "still" (conducts) or "lbm" (conducts and flows).
    pub mode: AirMode,
    /// Temperature of the air and of the surroundings in °C.
    #[schemars(range(min = -273.15, max = 5000.0))]
    pub temperature_c: f64,
    /// Film coefficient in W/(m²·K), or "auto" (natural convection around the objects). Room air 5–12.
    pub film_coefficient_w_m2k: Auto,
    /// Emissivity of the surface, 0–1; 0 switches radiation off.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub emissivity: f64,
    /// With "still" and "lbm": surfaces exchange at least as much heat as the film coefficient says, because the boundary
    /// layer of most objects is thinner than a grid cell.
    pub wall_film: bool,
    /// With "lbm": steps of the air before the film starts, objects held, so that a plume is already there; about a
    /// thousand make a second.
    #[schemars(range(min = 0, max = 100_000))]
    pub plume_steps: u32,
    /// With "still" and "lbm": a closed box with walls at the temperature of the air instead of an open one.
    pub closed: bool,
    /// With "still" and "lbm": number format in which the air is stored. "f16" takes half the memory and less time, and rounds
    /// away details of the flow below a thousandth.
    pub storage: AirStorage,
    /// With "lbm": the air flows on cells of twice the size, an eighth as many; heat keeps its cells. Faster in large boxes; plumes
    /// thinner than four cells blur.
    pub coarse_flow: bool,
}

impl Default for Air {
    fn default() -> Self {
        Self {
            mode: AirMode::Film,
            temperature_c: 20.0,
            film_coefficient_w_m2k: Auto::Value(10.0),
            emissivity: 0.9,
            wall_film: true,
            plume_steps: 0,
            closed: false,
            storage: AirStorage::F32,
            coarse_flow: false,
        }
    }
}

/// What to do about a bottom that nobody ever photographed (splatting.md §6.6).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum OpenBottom {
    /// Close it at the support plane where the object stands on one.
    #[default]
    Auto,
    /// Always close it at the support plane.
    Cap,
    /// Leave it to the rays.
    Open,
}

/// Filling the objects with material points, eight per grid cell: inside is where most rays leave through an opaque surface from behind
/// (splatting.md §6).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Fill {
    /// Rays per point: 6 (axes) or 14 (axes and diagonals; better with holes).
    #[schemars(extend("enum" = [6, 14]))]
    pub directions: u32,
    /// Opacity from which a ray counts as stopped, 0–1, or "auto" (measured).
    pub tau_alpha: Auto,
    /// Random displacement of the points, as a fraction of their spacing, 0–0.5.
    #[schemars(range(min = 0.0, max = 0.5))]
    pub jitter: f64,
    /// Unseen bottoms: "auto", "cap" or "open".
    pub open_bottom: OpenBottom,
    /// Views that vote on which side of a splat is outside.
    #[schemars(range(min = 16, max = 256))]
    pub normal_views: u32,
    /// Splats carry no mass and only follow the points inside; chosen by their number if left out.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tracers: Option<bool>,
}

impl Default for Fill {
    fn default() -> Self {
        Self { directions: 6, tau_alpha: Auto::Value(0.5), jitter: 0.25, open_bottom: OpenBottom::Auto, normal_views: 64, tracers: None }
    }
}
