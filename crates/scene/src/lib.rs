//! `scene.toml` ↔ typed scene: presets, materials, validation with helpful errors, JSON Schema.
//!
//! A scene file needs one line, `[input] splat = "thing.ply"`; everything else has a default:
//!
//! ```
//! let scene = megas_scene::Scene::parse("[input]\nasset = \"ice-cream\"\n", "scene.toml").unwrap();
//! assert_eq!(scene.quality, megas_scene::Quality::Default);
//! ```
//!
//! The data's way: text → [`Scene::parse`] checks it against the [`json_schema`] (unknown keys, types, ranges, all reported
//! at once with line and column), reads it into [`Scene`], then checks what no schema can say (references, exclusive keys,
//! materials). Materials leave as [`ResolvedMaterial`] in SI units; regions and positions leave through a [`Placement`].

mod camera;
mod check;
mod collider;
mod diagnostic;
mod heat;
mod input;
mod material;
mod material_checks;
mod object;
mod output;
mod presets;
mod scene;
mod schema;
mod semantic;
mod settings;
mod shape;
mod skin;
mod still;
mod value;

pub use camera::{Camera, CameraKey, Orbit};
pub use collider::{Background, Collider, ColliderMode, ColliderShape, Conducting, Support};
pub use diagnostic::{Diagnostic, SceneError, Severity};
pub use heat::{Heat, HeatKind, MotionKey, Quantity, Region, Schedule};
pub use input::{Backdrop, Finetune, FinetuneSettings, Input, Method, Profile, Reconstruct};
pub use material::{Law, MaterialContext, MaterialError, MaterialSpec, ResolvedMaterial, ResolvedTables};
pub use material_checks::{MaterialReport, StepLimits};
pub use object::{Filling, Object, Select};
pub use output::{Appearance, Clip, Film, MeshKind, Output};
pub use presets::{DEFAULT_MATERIAL, MaterialPreset, material_presets};
pub use scene::{Clock, Scene};
pub use schema::json_schema;
pub use settings::{
    Air, AirMode, AirStorage, Bounds, Fill, HeatTransfer, MomentumTransfer, OpenBottom, PhaseMode, Preset, Quality, Simulation, Time,
};
pub use shape::{BoxShape, Frame, HalfSpace, HeightShape, MeshShape, Placement, Plane, Sphere, Tube};
pub use skin::{CrackKernel, Draw, KernelRadius, Push, Skin, SurfaceNormals, SurfaceRule};
pub use still::{BodyForm, InputBody, Pattern, Table};
pub use value::{Auto, Colour, Up};

/// Offset between degrees Celsius (scene files) and kelvin (everything inside).
pub const CELSIUS_K: f64 = 273.15;
