//! The demonstration: the embedded ice cream melts.

use std::path::Path;

use megas_scene::Scene;
use serde_json::Value;

use crate::{Failure, LoadedScene, Options, Sink, run};

/// The scene of the demonstration; also a good start for a scene of one's own.
pub const DEMO_SCENE: &str = include_str!("demo.toml");

/// The demonstration's scene; `quick` is a much smaller one for tests and impatient people.
pub fn demo_scene(quick: bool) -> Result<LoadedScene, Failure> {
    let mut scene = Scene::parse(DEMO_SCENE, "demo.toml").map_err(|e| Failure::Other(e.to_string()))?;
    if quick {
        scene.simulation.cells = Some(14);
        scene.time.duration_s = 0.5;
        scene.time.melt_in_s = Some(0.4);
        (scene.output.width, scene.output.height) = (Some(320), Some(240));
    }
    let text = if quick { scene.to_toml() } else { DEMO_SCENE.to_owned() };
    Ok(LoadedScene { scene, base_dir: Path::new(".").to_path_buf(), text })
}

/// Runs the demonstration.
pub fn demo(options: &Options, quick: bool, sink: &dyn Sink) -> Result<Value, Failure> {
    run(&demo_scene(quick)?, options, sink)
}
