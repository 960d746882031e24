//! Deformed points to a renderable surface: covariance push-forward, polar rotation for appearance, rebase, needle clamp
//! the implicit surface between oriented samples, and the densification that seals cracks (splatting.md §7, §8).

mod bake;
mod clamp;
pub mod densify;
pub mod imls;
mod push;
mod rows;
mod skin;

pub use bake::bake_splats;
pub use clamp::{NeedleLimit, clamp_covariance};
pub use push::{Pushed, push_forward, rebase_covariance};
pub use skin::{InternalKernels, Push, Skin, SkinSettings};
