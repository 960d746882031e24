//! Thermomechanical MLS-MPM: material points that deform, heat, melt and freeze (see the design's simulation chapter).
//!
//! The crate knows no splat, no pixel and no file. SI units throughout, +z is up.

pub mod air;
pub mod collider;
pub mod grid;
pub mod material;
pub mod mechanics;
pub mod particles;
pub mod phase;
pub mod reference;
pub mod region;
pub mod schedule;
pub mod solver;
pub mod source;
pub mod stretch;
pub mod table;
pub mod thermal;
