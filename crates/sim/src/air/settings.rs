//! What a lattice of air is made of: sizes, rates, faces of the box, guards. Lattice units (simulation.md §0.2).

use serde::{Deserialize, Serialize};

use crate::air::population::Storage;

/// Magic parameter of the flow that puts half-way walls exactly half-way (simulation.md §4.3).
pub const LAMBDA_FLOW: f64 = 3.0 / 16.0;
/// Magic parameter of the temperature in air that moves. The design's 1/6 (simulation.md §4.4) suits conduction; 1/12 is better for
/// heat that is carried along a wall. The largest local Nusselt number of V22 at Ra = 10⁴ (64²; published 3.528 and 3.531) is
/// linear in it: 3.572 at 1/4, 3.557 at 1/6, 3.542 at 1/12.
pub const LAMBDA_AIR: f64 = 1.0 / 12.0;
/// The same in still air (simulation.md §4.4).
pub const LAMBDA_STILL: f64 = 1.0 / 6.0;
/// Magic parameter of the temperature where material is on the lattice (simulation.md §4.4).
pub const LAMBDA_MATERIAL: f64 = 0.25;

/// Flow condition of one face of the box; the wall lies half a node outside the last node (simulation.md §4.5).
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub enum FlowFace {
    /// Wall at rest.
    #[default]
    NoSlip,
    /// Wall that moves in its own plane with this velocity.
    Moving([f64; 3]),
    /// Mirror: no flow through, no friction.
    FreeSlip,
    /// Air of density 1 comes and goes.
    Open,
    /// Wraps around to the opposite face, which must be periodic too.
    Periodic,
}

/// Thermal condition of one face of the box. On periodic flow faces heat wraps as well.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub enum HeatFace {
    /// No heat passes.
    #[default]
    Adiabatic,
    /// Temperature over the reference \[K\], half a node outside.
    Fixed(f64),
    /// Heat into the domain per boundary node and step \[K\].
    Flux(f64),
    /// What flows in has the ambient temperature (zero over the reference); what flows out keeps its own.
    Open,
    /// Wraps around.
    Periodic,
}

/// Conditions of one face.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Face {
    /// For the flow.
    pub flow: FlowFace,
    /// For the temperature.
    pub heat: HeatFace,
}

impl Face {
    /// Wraps around in both.
    pub const PERIODIC: Self = Self { flow: FlowFace::Periodic, heat: HeatFace::Periodic };
    /// Open to the room.
    pub const OPEN: Self = Self { flow: FlowFace::Open, heat: HeatFace::Open };
    /// Wall at rest that takes no heat.
    pub const WALL: Self = Self { flow: FlowFace::NoSlip, heat: HeatFace::Adiabatic };

    /// Wall at rest with a temperature.
    pub fn fixed(t: f64) -> Self {
        Self { flow: FlowFace::NoSlip, heat: HeatFace::Fixed(t) }
    }
}

/// Constants of a lattice, in lattice units.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LatticeSettings {
    /// Nodes per axis.
    pub nodes: [usize; 3],
    /// Simulate the flow.
    pub flow: bool,
    /// Simulate the temperature.
    pub heat: bool,
    /// Kinematic viscosity ν̃, > 0.
    pub viscosity: f64,
    /// Λ_f; with `None` ω⁻ = ω⁺, the single-relaxation-time operator.
    pub lambda_flow: Option<f64>,
    /// Diffusivity K̃ of air, > 0.
    pub diffusivity: f64,
    /// Λ_g; with `None` ω⁺ = ω⁻, the single-relaxation-time operator.
    pub lambda_heat: Option<f64>,
    /// Uniform acceleration.
    pub force: [f64; 3],
    /// Acceleration per kelvin over the reference, −g̃β: points up, away from gravity.
    pub buoyancy: [f64; 3],
    /// Temperature over the reference beyond which buoyancy grows no further \[K\]: ½/β (simulation.md §4.2).
    pub buoyancy_limit: f64,
    /// Heat source in every node with populations \[K/step\].
    pub source: f64,
    /// Smagorinsky constant C_S, 0–0.17; 0 switches the model off.
    pub smagorinsky: f64,
    /// Low and high face per axis.
    pub faces: [[Face; 2]; 3],
    /// Layers inside an open face that damp the flow and draw the temperature to ambient; 0 switches the sponge off.
    pub sponge_layers: usize,
    /// Velocity of the air in lattices without flow.
    pub wind: [f64; 3],
    /// Number format of the stored populations.
    #[serde(default)]
    pub storage: Storage,
    /// Spacing of the flow in nodes of the temperature, and its step in theirs: 1, or 2 for a flow with a sixteenth of the updates
    /// (simulation.md §1.3).
    #[serde(default = "same_spacing")]
    pub flow_ratio: usize,
}

fn same_spacing() -> usize {
    1
}

impl LatticeSettings {
    /// A periodic box of air at rest, flow and temperature, without forces.
    pub fn new(nodes: [usize; 3], viscosity: f64, diffusivity: f64) -> Self {
        Self {
            nodes,
            flow: true,
            heat: true,
            viscosity,
            lambda_flow: Some(LAMBDA_FLOW),
            diffusivity,
            lambda_heat: Some(LAMBDA_AIR),
            force: [0.0; 3],
            buoyancy: [0.0; 3],
            buoyancy_limit: f64::INFINITY,
            source: 0.0,
            smagorinsky: 0.0,
            faces: [[Face::PERIODIC; 2]; 3],
            sponge_layers: 0,
            wind: [0.0; 3],
            storage: Storage::F32,
            flow_ratio: 1,
        }
    }

    /// True if flow and temperature share their nodes.
    pub(crate) fn flows_here(&self) -> bool {
        self.flow && self.flow_ratio == 1
    }

    /// The flow alone, on cells of 2³ nodes and in steps of two: velocities stay the same, the viscosity is half as large. Faces stay
    /// where they are, half a node outside.
    pub(crate) fn coarse(&self) -> Self {
        Self {
            nodes: self.nodes.map(|n| n.div_ceil(2)),
            heat: false,
            viscosity: 0.5 * self.viscosity,
            force: self.force.map(|f| 2.0 * f),
            buoyancy: self.buoyancy.map(|b| 2.0 * b),
            sponge_layers: self.sponge_layers.div_ceil(2),
            flow_ratio: 1,
            ..self.clone()
        }
    }

    /// Share of velocity and temperature difference that the sponge takes from `node` per step.
    pub(crate) fn sponge(&self, node: [usize; 3]) -> f64 {
        let mut s = 0.0f64;
        for a in 0..3 {
            for (side, face) in self.faces[a].iter().enumerate() {
                if self.sponge_layers == 0 || face.flow != FlowFace::Open {
                    continue;
                }
                let depth = if side == 0 { node[a] } else { self.nodes[a] - 1 - node[a] };
                if depth < self.sponge_layers {
                    let l = (self.sponge_layers - depth) as f64 / self.sponge_layers as f64;
                    s = s.max(SPONGE_STRENGTH * l * l);
                }
            }
        }
        s
    }

    /// Even and odd relaxation rates of the flow at relaxation time `tau` = 3ν + ½.
    pub(crate) fn flow_rates(&self, tau: f64) -> (f64, f64) {
        let plus = 1.0 / tau;
        (plus, self.lambda_flow.map_or(plus, |l| 1.0 / (l / (tau - 0.5) + 0.5)))
    }

    /// Even and odd relaxation rates of the temperature at conductivity `k`.
    pub(crate) fn heat_rates(&self, k: f64) -> (f64, f64) {
        let minus = 1.0 / (4.0 * k + 0.5);
        (self.lambda_heat.map_or(minus, |l| 1.0 / (l / (4.0 * k) + 0.5)), minus)
    }
}

/// Share of velocity and temperature difference that the outermost sponge layer takes per step.
pub(crate) const SPONGE_STRENGTH: f64 = 0.05;
/// Speed at which equilibria are capped (simulation.md §4.8).
pub const SPEED_CAP: f64 = 0.25;
/// Turbulent Prandtl number.
pub(crate) const TURBULENT_PRANDTL: f64 = 0.9;
