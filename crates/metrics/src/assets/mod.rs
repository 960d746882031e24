//! Ground-truth assets (splatting.md §9.1): things defined as signed distance plus a procedural solid colour, which can be
//! photographed (posed RGBA views with depth and normals) and sprinkled with surface splats.
//!
//! [`Sundae`] is the embedded demonstration scene, [`Shape`] the analytic bodies of the tests. Everything is a pure function of
//! its arguments: same seed, same bits, for any number of threads.

mod blue_noise;
mod light;
mod noise;
mod photograph;
mod primitives;
mod shapes;
mod solid;
mod sprinkle;
mod still_life;
mod sundae;
mod sundae_colour;

pub use blue_noise::{SurfacePoint, blue_noise};
pub use light::to_display;
pub use photograph::{camera_rig, photograph};
pub use shapes::{Shape, Shell};
pub use solid::{Hit, Solid, volume};
pub use sprinkle::Sprinkle;
pub use still_life::{Form, Mixture, StillLife, Thing};
pub use sundae::{METRES_PER_UNIT, Part, Sundae, TABLE_HEIGHT, TABLE_RADIUS};
