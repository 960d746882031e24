//! CPU rasterizer for 3D Gaussians: splats and a camera in, channels out (splatting.md §3).
//!
//! [`Gaussians`] holds what is drawn, [`Settings`] the constants of the image formation, [`Channels`] says what is wanted,
//! and a [`Rasterizer`], which keeps its scratch memory between calls, fills a [`Frame`].
//!
//! How it works. Every Gaussian is projected in double precision, eight at a time (`project`); survivors are sorted once by
//! depth (`sort`) and appended in that order to tile lists (`bin`); a tile is composited entry by entry on *bricks* of
//! 4 × 4 pixels, one brick to a vector of sixteen lanes (`kernel`). A brick's arithmetic depends on the pixel and the
//! Gaussian alone, so images are bit-identical for every tile size and number of threads.

mod backward;
mod bin;
mod frame;
mod gaussians;
mod kernel;
mod project;
mod rasterizer;
mod resolve;
mod settings;
mod sort;

pub use backward::{Cotangents, Gradients};
pub use frame::{Frame, NO_GAUSSIAN, Statistics};
pub use gaussians::{Gaussians, pack_covariance, unpack_covariance};
pub use rasterizer::Rasterizer;
pub use settings::{Channels, ClipPlane, Settings, TileSize};
