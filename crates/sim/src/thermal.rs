//! Heat in the material: enthalpy on points and nodes, conduction along flux links, sources, audit (simulation.md §3).
//!
//! One call of [`ThermalSolver::step`] per coupling step. Nothing is carried from step to step except what is in the points,
//! so a checkpoint of the points is a checkpoint of the heat.

pub(crate) mod contact;
pub(crate) mod enthalpy;
mod estimate;
pub(crate) mod network;
pub(crate) mod solids;
mod solver;
pub(crate) mod transfer;

use serde::{Deserialize, Serialize};

pub use enthalpy::EnthalpyCurve;
pub use estimate::natural_film_coefficient;
pub use solids::Solids;
pub use solver::{NodeFields, ThermalSolver};

use crate::air::SimulatedAir;
use crate::source::Film;

/// The points as the heat sees them: slices of equal length.
#[derive(Debug)]
pub struct ThermalPoints<'a> {
    /// Position in grid coordinates (node units from node (0, 0, 0)).
    pub xi: &'a [[f64; 3]],
    /// Mass \[kg\]; 0 marks a tracer, which only listens.
    pub mass: &'a [f32],
    /// Current volume \[m³\], `V⁰ J` with J clamped to `[0.6, 1.4]`.
    pub volume: &'a [f32],
    /// Index into the materials.
    pub material: &'a [u8],
    /// Body.
    pub object: &'a [u16],
    /// Specific enthalpy \[J/kg\].
    pub h: &'a mut [f64],
    /// Temperature gradient \[K/m\].
    pub grad_t: &'a mut [[f32; 3]],
}

/// How temperature travels between points and nodes (simulation.md §3.2, §3.4).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Transfer {
    /// Affine to the nodes, increments back, with conservative sub-grid relaxation of strength `c_sub` (0–4).
    Increments {
        /// c_sub; 0 switches the relaxation off.
        relaxation: f64,
    },
    /// Affine to the nodes, node values back: the paper's scheme, which diffuses.
    AffineOverwrite,
    /// Plain averages both ways; diffuses strongly.
    PicOverwrite,
}

impl Default for Transfer {
    fn default() -> Self {
        Self::Increments { relaxation: 2.0 }
    }
}

/// What surrounds the material (simulation.md §3.6).
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum AirModel {
    /// Nothing: surfaces are adiabatic.
    #[default]
    None,
    /// Every surface that does not face a wall exchanges heat with still surroundings.
    Film(Film),
    /// The air is a lattice of its own, which conducts and may flow.
    Simulated(SimulatedAir),
}

/// Options of the solver.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ThermalOptions {
    /// Transfer scheme.
    pub transfer: Transfer,
    /// Surroundings.
    pub air: AirModel,
    /// Axes that wrap around; for tests.
    pub periodic: [bool; 3],
    /// Sub-cycles after which a step is refused (§9.3).
    pub max_subcycles: u32,
}

impl Default for ThermalOptions {
    fn default() -> Self {
        Self { transfer: Transfer::default(), air: AirModel::None, periodic: [false; 3], max_subcycles: 64 }
    }
}

/// Thermal condition of a node that lies inside a collider (simulation.md §6.3).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Wall {
    /// Not in a collider.
    #[default]
    Open,
    /// In a collider that takes no heat. Surface facing it is not exposed to the air either.
    Adiabatic,
    /// In a collider of fixed temperature \[K\]; its face lies half a cell from the next free node.
    Fixed(f32),
    /// In a collider that conducts heat itself: its cell in [`Solids`].
    Conducting(u32),
}

/// What gives and takes heat behind the face of a wall.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Bath {
    /// A fixed temperature \[K\].
    Fixed(f64),
    /// A cell of [`Solids`].
    Cell(u32),
}

impl Wall {
    /// What exchanges heat with the material next to the wall, if anything does.
    #[inline(always)]
    pub(crate) fn bath(self) -> Option<Bath> {
        match self {
            Wall::Open | Wall::Adiabatic => None,
            Wall::Fixed(t) => Some(Bath::Fixed(f64::from(t))),
            Wall::Conducting(cell) => Some(Bath::Cell(cell)),
        }
    }
}

/// Energy balance of one step in joules (simulation.md §3.7). Heat into the material counts positive.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Audit {
    /// `Σ m h`, and the heat of simulated air, before the step.
    pub before: f64,
    /// The same after it.
    pub after: f64,
    /// Powers and fluxes.
    pub source: f64,
    /// Sources that hold a temperature.
    pub dirichlet: f64,
    /// Films, of sources and of the air model.
    pub film: f64,
    /// Walls of fixed temperature.
    pub wall: f64,
    /// Colliders that conduct heat.
    pub solid: f64,
    /// Through open faces and sponges of simulated air.
    #[serde(default)]
    pub open: f64,
    /// Heat of air that material pushed away or left behind; air only takes part where it is simulated.
    #[serde(default)]
    pub displaced: f64,
    /// With matter that left the box.
    #[serde(default)]
    pub escaped: f64,
    /// Heat of the simulated air at the end, contained in `after`.
    #[serde(default)]
    pub air: f64,
    /// Nodes of simulated air whose speed was capped, summed over steps.
    #[serde(default)]
    pub capped: u32,
    /// `after − before − Σ heat`, and the same for the conducting colliders: rounding, unless something is wrong.
    pub residual: f64,
    /// Exposed surface \[m²\]; zero if nothing asked for it.
    pub surface: f64,
    /// Conduction sub-cycles.
    pub subcycles: u32,
    /// Mass points without a finite position, left alone.
    pub skipped: u32,
}

impl Audit {
    /// Appends a later step: energies at both ends, sums of heats, largest number of sub-cycles.
    pub fn append(&mut self, later: &Audit) {
        *self = Audit {
            before: self.before,
            after: later.after,
            source: self.source + later.source,
            dirichlet: self.dirichlet + later.dirichlet,
            film: self.film + later.film,
            wall: self.wall + later.wall,
            solid: self.solid + later.solid,
            open: self.open + later.open,
            displaced: self.displaced + later.displaced,
            escaped: self.escaped + later.escaped,
            air: later.air,
            capped: self.capped.saturating_add(later.capped),
            residual: self.residual + later.residual,
            surface: later.surface,
            subcycles: self.subcycles.max(later.subcycles),
            skipped: self.skipped.max(later.skipped),
        };
    }

    /// Sum of the sizes of all heats \[J\].
    pub fn heats(&self) -> f64 {
        let all = [self.source, self.dirichlet, self.film, self.wall, self.solid, self.open, self.displaced, self.escaped];
        all.iter().map(|q| q.abs()).sum()
    }

    /// The balance of a step before which matter with this `heat` \[J\] left.
    pub(crate) fn after_loss(self, heat: f64) -> Self {
        Self { before: self.before + heat, escaped: self.escaped - heat, ..self }
    }

    /// True while the residual stays below `fraction` of the energies involved.
    pub fn closes(&self, fraction: f64) -> bool {
        self.residual.abs() <= fraction * self.scale()
    }

    /// The larger of the energies and of the sum of heats, without signs \[J\].
    pub fn scale(&self) -> f64 {
        self.before.abs().max(self.after.abs()).max(self.heats())
    }
}

/// Why a thermal step was refused.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ThermalError {
    /// Conduction is too fast for the step.
    #[error(
        "heat conducts too fast for a step of {dt} s: {needed} sub-cycles needed, {allowed} allowed; \
         shorten the coupling step, coarsen the grid or reduce the thermal acceleration"
    )]
    TooFast {
        /// Step \[s\].
        dt: f64,
        /// Sub-cycles needed.
        needed: u32,
        /// Sub-cycles allowed.
        allowed: u32,
    },
    /// The simulated air is no longer a number, or its density is far from 1.
    #[error(
        "the simulated air became unstable at t = {time:.4} s; use a shorter coupling step (simulation.coupling_step_s), weaker \
         sources, or air.mode = \"film\""
    )]
    Air {
        /// Simulated time \[s\].
        time: f64,
    },
    /// Slices of different lengths, or a material index out of range.
    #[error("thermal input: {0}")]
    Input(String),
}
