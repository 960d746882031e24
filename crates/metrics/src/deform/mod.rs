//! Prescribed deformations with a known answer (splatting.md §9.2): maps with exact gradients, splats carried by them, and
//! the true surface mapped the same way.

mod carry;
mod map;
mod truth;

pub use carry::{Carried, Carry, carry};
pub use map::{Deformation, Stage};
pub use truth::{deformed, finely_divided};
