//! The nouns that travel between stages. No files, no threads, no physics: just data with checked shapes.

mod camera;
mod image;
mod mesh;
mod points;
mod similarity;
mod splats;

pub use camera::{Camera, Projection, fibonacci_directions};
pub use image::{Image, View};
pub use mesh::Mesh;
pub use points::{FLAG_ESCAPED, FLAG_INTERNAL, FLAG_REPAIRED, FLAG_SPLAT, PointFrame, Points};
pub use similarity::Similarity;
pub use splats::{Origin, Phase, Splats, logit};

/// Room temperature, the default of everything thermal \[K\].
pub const AMBIENT_K: f32 = 293.15;
