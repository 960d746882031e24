//! Loss terms of the reconstruction with their gradients (splatting.md §4.6, §5.2, §5.8).
//!
//! Image losses take what a render gives, regularisers take the stored parameters of the visible Gaussians. All images are
//! row by row from the top left, colours interleaved. [`Photometric`] overwrites its gradient; every other term *adds*
//! `weight · ∂/∂input` to the gradient it is given and returns its own value without the weight. Every sum is formed block
//! by block and then in order, so that results do not depend on the number of threads.

mod alpha;
mod edges;
pub mod multiview;
mod normals;
mod photometric;
mod plane;
#[cfg(test)]
mod reference;
pub mod regularise;
mod target;
mod window;

pub use alpha::alpha;
pub use edges::edge_weights;
pub use normals::NormalConsistency;
pub use photometric::{Photometric, PhotometricLoss};
pub use plane::{PlaneGradient, PlaneImages};
pub use target::Target;
