//! Deformed points to a renderable surface: covariance push-forward, polar rotation for appearance, rebase, needle clamp
//! and composition with the static background (first slice of the design's chapters 7 and 8 on rendering).

mod bake;
mod clamp;
mod push;
mod skin;

pub use bake::bake_splats;
pub use clamp::{NeedleLimit, clamp_covariance};
pub use push::{Pushed, push_forward, rebase_covariance};
pub use skin::{InternalKernels, Push, Skin, SkinSettings};
