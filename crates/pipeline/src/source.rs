//! Stage zero: the splat file that the bodies are made of. Photographs are reconstructed and splats fine-tuned where the scene
//! asks for it; the result stays in the output folder like that of any other stage.

use std::path::PathBuf;

use megas_math::mat3;
use megas_scene::{FinetuneSettings as FinetuneTable, Method as MethodName, Profile as ProfileName, Reconstruct, Select};
use serde_json::Value;

use crate::reconstruct::{
    Backdrop, FinetuneJob, FinetuneSettings, ReconstructJob, ReconstructSettings, Region, finetune_here, reconstruct_here,
};
use crate::{Downscale, Failure, LoadedScene, Method, Options, Profile, Sink};

/// The splats of a scene.
pub struct Source {
    /// Their file; none for an embedded asset.
    pub path: Option<PathBuf>,
    /// Figures of the training, if there was one.
    pub figures: Option<Value>,
}

/// Work to do before the bodies.
pub enum Training {
    /// Photographs to splats.
    Reconstruct(Box<ReconstructJob>),
    /// Splats to splats fit to melt.
    Finetune(Box<FinetuneJob>),
}

/// What has to be trained for a scene, if anything.
pub fn training(loaded: &LoadedScene, options: &Options) -> Option<Training> {
    let scene = &loaded.scene;
    let path = |p: &String| loaded.base_dir.join(p);
    if let Some(folder) = &scene.input.capture {
        let table = scene.input.reconstruct.clone().unwrap_or_default();
        let output = options.out.join("reconstruct").join("splats.ply");
        let mut job = ReconstructJob::new(path(folder), output);
        job.settings = reconstruct_settings(&table, scene.seed, scene.simulation.cells);
        job.memory_gib = table.memory_gib;
        (job.force, job.threads) = (options.force, options.threads);
        return Some(Training::Reconstruct(Box::new(job)));
    }
    let (file, table) = (scene.input.splat.as_ref()?, scene.input.finetuning()?);
    let mut job = FinetuneJob::new(path(file), options.out.join("finetune").join("splats.ply"));
    job.settings = finetune_settings(&table, scene.seed, scene.simulation.cells);
    // One object without a selection is everything.
    let select: Vec<Option<Select>> = scene.objects_or_default().into_iter().map(|o| o.select).collect();
    job.select = if select.iter().any(Option::is_none) { Vec::new() } else { select.into_iter().flatten().collect() };
    job.keep_rest = true;
    job.up = scene.input.up.0;
    (job.force, job.threads) = (options.force, options.threads);
    Some(Training::Finetune(Box::new(job)))
}

/// Brings the splats of a scene up to date.
pub fn source(loaded: &LoadedScene, options: &Options, sink: &dyn Sink) -> Result<Source, Failure> {
    let Some(training) = training(loaded, options) else {
        let path = loaded.scene.input.splat.as_ref().map(|f| loaded.base_dir.join(f));
        return Ok(Source { path, figures: None });
    };
    // Hours of training are not begun for a scene that fails afterwards.
    crate::plan::check_materials(loaded)?;
    let (path, figures) = match training {
        Training::Reconstruct(job) => (job.output.clone(), reconstruct_here(&job, "train", sink)?),
        Training::Finetune(job) => (job.output.clone(), finetune_here(&job, sink)?),
    };
    Ok(Source { path: Some(path), figures: Some(figures) })
}

fn reconstruct_settings(t: &Reconstruct, seed: u64, cells: Option<u32>) -> ReconstructSettings {
    ReconstructSettings {
        method: match t.method {
            MethodName::Vanilla => Method::Vanilla,
            MethodName::Physgaussian => Method::Physgaussian,
            MethodName::Vrdoh => Method::Vrdoh,
            MethodName::Pgsr => Method::Pgsr,
            MethodName::PgsrPrune => Method::PgsrPrune,
            MethodName::Ours => Method::Ours,
        },
        profile: match t.profile {
            ProfileName::Tiny => Profile::Tiny,
            ProfileName::Object => Profile::Object,
            ProfileName::Full => Profile::Full,
            ProfileName::RealHq => Profile::RealHq,
        },
        iterations: t.iterations,
        downscale: t.downscale.map_or(Downscale::Auto, Downscale::Factor),
        eval_every: t.eval_every,
        seed,
        seeds_count: t.seeds_count as usize,
        max_gaussians: t.max_gaussians.map(|n| n as usize),
        background: t.background.map(|b| match b {
            megas_scene::Backdrop::Black => Backdrop::Black,
            megas_scene::Backdrop::White => Backdrop::White,
            megas_scene::Backdrop::Random => Backdrop::Random,
        }),
        object_box: t.object_box.as_ref().map(|b| {
            let (center, half, axes) = b.oriented();
            let rows = mat3::transpose(axes);
            Region { center: center.map(|v| v as f32), half: half.map(|v| v as f32), axes: rows.map(|r| r.map(|v| v as f32)) }
        }),
        cells,
        mcmc: t.mcmc,
        exposure: t.exposure,
        tau_prune: None,
    }
}

fn finetune_settings(t: &FinetuneTable, seed: u64, cells: Option<u32>) -> FinetuneSettings {
    FinetuneSettings {
        steps: t.steps,
        size: t.size,
        views: t.views,
        seed,
        cells,
        max_gaussians: t.max_gaussians as usize,
        ..FinetuneSettings::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use megas_scene::Scene;

    fn loaded(text: &str) -> LoadedScene {
        let scene = Scene::parse(text, "s.toml").unwrap();
        LoadedScene { scene, base_dir: PathBuf::from("base"), text: text.into() }
    }

    fn options() -> Options {
        Options { out: PathBuf::from("out"), force: true, threads: Some(3) }
    }

    #[test]
    fn the_scene_says_what_is_trained() {
        let text = "seed = 4\n[input]\ncapture = \"photos\"\n[input.reconstruct]\nmethod = \"pgsr-prune\"\ndownscale = 2\n\
                    object_box = { min = [0, 0, 0], max = [2, 4, 6], rotation_deg = [0, 0, 90] }\n[simulation]\ncells = 40";
        let Some(Training::Reconstruct(job)) = training(&loaded(text), &options()) else { panic!("nothing to train") };
        assert_eq!((job.capture.as_path(), job.output.as_path()), ("base/photos".as_ref(), "out/reconstruct/splats.ply".as_ref()));
        let s = &job.settings;
        assert_eq!((s.method, s.downscale, s.seed, s.cells), (Method::PgsrPrune, Downscale::Factor(2), 4, Some(40)));
        let r = s.object_box.unwrap();
        // Turned by a quarter about z: the first axis of the box lies along +y.
        assert!(r.center == [1.0, 2.0, 3.0] && (r.axes[0][1] - 1.0).abs() < 1e-6 && job.force, "{r:?}");

        let text = "[input]\nsplat = \"a.ply\"\nfinetune = true\n[[object]]\nname = \"a\"\nselect.largest_component = true\n[[object]]\n\
                    name = \"b\"\nselect.min_opacity = 0.5";
        let Some(Training::Finetune(job)) = training(&loaded(text), &options()) else { panic!("nothing to tune") };
        assert!(job.select.len() == 2 && job.keep_rest && job.settings == FinetuneSettings::default());
        let whole = "[input]\nsplat = \"a.ply\"\nfinetune = true\n[[object]]\nname = \"a\"\nselect.largest_component = true\n[[object]]\nname = \"b\"";
        assert!(matches!(training(&loaded(whole), &options()), Some(Training::Finetune(j)) if j.select.is_empty()));
        assert!(training(&loaded("[input]\nsplat = \"a.ply\""), &options()).is_none());
        assert!(training(&loaded("[input]\nasset = \"ice-cream\""), &options()).is_none());
    }
}
