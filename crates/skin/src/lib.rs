//! Deformed points to a renderable surface: covariance push-forward, polar rotation for appearance, rebase, needle clamp
//! the implicit surface between oriented samples, the densification that seals cracks, and closed meshes (splatting.md §7, §8).

mod bake;
mod clamp;
pub mod densify;
mod gloss;
pub mod imls;
pub mod mesh;
mod push;
mod realign;
mod rows;
mod skin;

pub use bake::bake_splats;
pub use clamp::{NeedleLimit, clamp_covariance};
pub use gloss::dull;
pub use push::{DEPTH_IN_PIXELS, Pushed, lost_depth, push_forward, rebase_covariance, squeeze};
pub use skin::{InternalKernels, Push, Skin, SkinSettings, SkinState};
