//! The commands: each brings its stage and those before it up to date.

use std::path::PathBuf;
use std::time::Instant;

use serde_json::{Map, Value, json};

use crate::body::{Bodies, build};
use crate::source::{Source, source};
use crate::stage::{Found, KeyBuilder, StageDir};
use crate::{Event, Failure, LoadedScene, Options, Sink};

/// Brings the bodies up to date and returns their figures.
pub fn fill(scene: &LoadedScene, options: &Options, sink: &dyn Sink) -> Result<Value, Failure> {
    in_pool(options.threads, || Ok(bodies(scene, options, sink)?.figures))
}

/// Brings bodies and simulation up to date and returns the figures of the simulation.
pub fn simulate(scene: &LoadedScene, options: &Options, sink: &dyn Sink) -> Result<Value, Failure> {
    in_pool(options.threads, || {
        let Filled { bodies, key, .. } = bodies(scene, options, sink)?;
        Ok(simulation(scene, &bodies, &key, options, sink)?.0)
    })
}

/// Brings everything up to date and returns the figures of the pictures.
pub fn render(scene: &LoadedScene, options: &Options, sink: &dyn Sink) -> Result<Value, Failure> {
    in_pool(options.threads, || {
        let Filled { bodies, key, .. } = bodies(scene, options, sink)?;
        let (_, path, key) = simulation(scene, &bodies, &key, options, sink)?;
        pictures(scene, &bodies, &path, &key, options, sink)
    })
}

/// As [`render`], with body and simulation in the folder of `base`, which several renderings may share.
pub(crate) fn render_from(scene: &LoadedScene, base: &Options, options: &Options, sink: &dyn Sink) -> Result<Value, Failure> {
    let Filled { bodies, key, .. } = bodies(scene, base, sink)?;
    let (_, path, key) = simulation(scene, &bodies, &key, base, sink)?;
    pictures(scene, &bodies, &path, &key, options, sink)
}

/// The whole job, from the input to the films.
pub fn run(scene: &LoadedScene, options: &Options, sink: &dyn Sink) -> Result<Value, Failure> {
    let start = Instant::now();
    in_pool(options.threads, || {
        let Filled { bodies, key, trained, .. } = bodies(scene, options, sink)?;
        let (simulated, path, key) = simulation(scene, &bodies, &key, options, sink)?;
        let rendered = pictures(scene, &bodies, &path, &key, options, sink)?;
        let mut all = Map::new();
        for part in [simulated, rendered] {
            if let Value::Object(m) = part {
                all.extend(m);
            }
        }
        if let Some(trained) = trained {
            all.insert("training".into(), trained);
        }
        all.insert("seconds".into(), json!(start.elapsed().as_secs_f64()));
        let all = Value::Object(all);
        crate::disk::write_json(&options.out.join("result.json"), &all)?;
        Ok(all)
    })
}

/// Runs `work` with the wanted number of threads.
pub fn in_pool<T: Send>(threads: Option<usize>, work: impl FnOnce() -> Result<T, Failure> + Send) -> Result<T, Failure> {
    let Some(n) = threads else { return work() };
    let pool =
        rayon::ThreadPoolBuilder::new().num_threads(n).build().map_err(|e| Failure::Other(format!("cannot start {n} threads: {e}")))?;
    pool.install(work)
}

/// The bodies with what is known about them.
struct Filled {
    bodies: Bodies,
    figures: Value,
    key: String,
    /// Figures of the training before, if there was one.
    trained: Option<Value>,
}

fn bodies(loaded: &LoadedScene, options: &Options, sink: &dyn Sink) -> Result<Filled, Failure> {
    let s = &loaded.scene;
    let Source { path, figures: trained } = source(loaded, options, sink)?;
    let mut key = KeyBuilder::new("body")
        .settings(&s.input)?
        .settings(&s.objects)?
        .settings(&s.materials)?
        .settings(&s.fill)?
        .settings(&s.air)?
        .settings(&(s.seed, s.cells(), s.sag_ratio(), s.simulation.box_m, s.skin.patch_background))?;
    if let Some(file) = &path {
        key = key.file(file)?;
    }
    for mesh in s.input.bodies.iter().filter_map(|b| b.mesh.as_ref()) {
        key = key.file(&loaded.base_dir.join(mesh))?;
    }
    let key = key.finish();
    let (stage, found) = StageDir::open(options, "body", key.clone())?;
    if let Found::Done(figures) = found {
        sink.event(Event::Note("the body is up to date"));
        return Ok(Filled { bodies: Bodies::read(&stage.path)?, figures, key, trained });
    }
    sink.event(Event::Stage { name: "fill", steps: 0 });
    let start = Instant::now();
    crate::disk::check_writable(&options.out)?;
    let (bodies, figures) = build(loaded, path.as_deref(), sink)?;
    // Only now: a scene that does not work out leaves nothing behind.
    let existed = options.out.exists();
    let written = stage.begin().and_then(|()| {
        crate::disk::write_text(&options.out.join("scene.toml"), &loaded.text)?;
        bodies.write(&stage.path)?;
        stage.finish(&figures)
    });
    if let Err(e) = written {
        let _ = std::fs::remove_dir_all(&stage.path);
        if !existed {
            let _ = std::fs::remove_dir_all(&options.out);
        }
        return Err(e);
    }
    sink.event(Event::StageDone { name: "fill", seconds: start.elapsed().as_secs_f64() });
    Ok(Filled { bodies, figures, key, trained })
}

fn simulation(
    loaded: &LoadedScene,
    bodies: &Bodies,
    body_key: &str,
    options: &Options,
    sink: &dyn Sink,
) -> Result<(Value, PathBuf, String), Failure> {
    let s = &loaded.scene;
    let mut key = KeyBuilder::new("sim")
        .text(body_key)
        .settings(&s.heat)?
        .settings(&s.support)?
        .settings(&s.colliders)?
        .settings(&s.time)?
        .settings(&s.simulation)?;
    for mesh in crate::meshes::files(s, &loaded.base_dir) {
        key = key.file(&mesh)?;
    }
    let key = key.finish();
    let (stage, found) = StageDir::open(options, "sim", key.clone())?;
    let figures = match found {
        Found::Done(figures) => {
            sink.event(Event::Note("the simulation is up to date"));
            figures
        }
        found => crate::simulate::simulate(loaded, bodies, &stage, found, sink)?,
    };
    Ok((figures, stage.path, key))
}

fn pictures(
    loaded: &LoadedScene,
    bodies: &Bodies,
    simulated: &std::path::Path,
    sim_key: &str,
    options: &Options,
    sink: &dyn Sink,
) -> Result<Value, Failure> {
    let s = &loaded.scene;
    let key = KeyBuilder::new("frames")
        .text(sim_key)
        .settings(&s.cameras)?
        .settings(&s.output)?
        .settings(&s.skin)?
        .settings(&s.picture_size())?
        .finish();
    let (stage, found) = StageDir::open(options, "frames", key)?;
    if let Found::Done(figures) = found {
        let whole =
            figures["films"].as_array().is_some_and(|f| f.iter().all(|p| p.as_str().is_some_and(|p| std::path::Path::new(p).exists())));
        if whole {
            sink.event(Event::Note("the pictures are up to date"));
            return Ok(figures);
        }
    }
    crate::render::render(loaded, bodies, simulated, &stage, options, sink)
}
