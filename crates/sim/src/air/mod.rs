//! Air that conducts and flows: lattice Boltzmann (simulation.md §3.5–§4.9).
//!
//! [`Lattice`] advances a box of air in lattice units; [`reference`] is the slow oracle over the same node types.

mod boundaries;
mod d3q19;
mod d3q7;
mod lattice;
pub mod reference;
mod settings;
mod storage;
mod sweep;
#[cfg(test)]
mod tests;
mod velocity_sets;

pub use lattice::{ExchangeLink, HeatNode, Lattice, NodeState, StepReport};
pub use settings::{Face, FlowFace, HeatFace, LAMBDA_AIR, LAMBDA_FLOW, LAMBDA_MATERIAL, LatticeSettings, SPEED_CAP};
pub use sweep::Seen;
