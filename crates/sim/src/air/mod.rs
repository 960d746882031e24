//! Air that conducts and flows: lattice Boltzmann (simulation.md §3.5–§4.9).
//!
//! [`Lattice`] advances a box of air in lattice units; `room` couples it to the material in SI; `reference` is the slow oracle over the same node types.

mod boundaries;
mod d3q19;
mod d3q7;
mod lattice;
mod population;
pub mod reference;
pub(crate) mod room;
mod settings;
mod storage;
mod sweep;
#[cfg(test)]
mod tests;
mod velocity_sets;

pub use lattice::{ExchangeLink, HeatNode, Lattice, NodeState, StepReport};
pub use population::Storage;
pub use room::{AirStep, SimulatedAir};
pub use settings::{Face, FlowFace, HeatFace, LAMBDA_AIR, LAMBDA_FLOW, LAMBDA_MATERIAL, LAMBDA_STILL, LatticeSettings, SPEED_CAP};
pub use sweep::Seen;
