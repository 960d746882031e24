//! Splats to a body that can be simulated: selection, outward normals, ray-traced filling, volumes (splatting.md §5.11,
//! §6). [`build_body`] does it all; the modules are its steps.

pub mod background;
pub mod bake;
mod body;
pub mod fill;
pub mod neighbours;
pub mod orient;
mod polygon;
pub mod select;
mod settings;
pub mod volumes;

pub use body::{Body, BodyReport, Internal, build_body};
pub use select::{Selection, select};
pub use settings::{BodyError, BodySettings, Placement, SplitSettings};
