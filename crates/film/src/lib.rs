//! Frames to PNG, MP4, splat and mesh sequences: camera paths, false colour, legends, glow and wetness.

mod appearance;
pub mod blackbody;
mod camera_path;
mod colormap;
mod compose;
mod error;
mod isoline;
mod mp4;
mod sequence;
mod still;
mod text;
mod thermal;
pub mod wetness;
mod yuv;

pub use appearance::Appearance;
pub use camera_path::{CameraPath, Distance, FIT_FACTOR, Keyframe, KeyframePath, Orbit};
pub use colormap::inferno;
pub use compose::{Captions, side_by_side, stamp_time};
pub use error::{FilmError, Result};
pub use mp4::{FilmStats, Mp4Writer};
pub use sequence::{MeshSequence, PlySequence, frame_name};
pub use still::write_png;
pub use thermal::{ThermalStyle, thermal_image};
