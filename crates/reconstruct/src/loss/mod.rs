//! Loss terms of the reconstruction with their gradients (splatting.md §4.6, §5.2, §5.8).
//!
//! Image losses take what a render gives and write or add the derivative by those images; regularisers take the stored
//! parameters of the visible Gaussians. All images are row by row from the top left, colours interleaved. Every sum is
//! formed row by row (or block by block) and then in order, so that results do not depend on the number of threads.

mod photometric;
#[cfg(test)]
mod reference;
mod target;
mod window;

pub use photometric::{Photometric, PhotometricLoss};
pub use target::Target;
