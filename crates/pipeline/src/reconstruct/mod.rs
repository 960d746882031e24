//! `reconstruct`: posed photographs → splats (splatting.md §5).
//!
//! Beside the splat file lies a folder with everything else: checkpoint, log, previews, evaluation and contact sheet.

mod clock;
mod data;
mod evaluate;
mod log;
mod measure;
mod pictures;
mod plan;
mod settings;
mod training;

use std::path::{Path, PathBuf};
use std::time::Instant;

use megas_film::write_png;
use megas_reconstruct::{Background, Trainer};
use serde_json::{Value, json};

use crate::disk::{check_writable, create_dir, write_json};
use crate::run::in_pool;
use crate::stage::{Found, StageDir};
use crate::{Event, Failure, Sink};

use data::TrainingData;
use evaluate::Evaluation;
use measure::{TWO_PERCENT, measure, true_surface};
use training::{Preview, TrainingFolder, write_splats};

pub use plan::plan_reconstruct;
pub use settings::{Backdrop, ReconstructJob, ReconstructSettings};

/// Files of a reconstruction.
struct Places {
    /// The splats.
    output: PathBuf,
    /// The splats of an interrupted training.
    partial: PathBuf,
    /// The folder of the training.
    folder: PathBuf,
}

impl Places {
    fn new(output: &Path) -> Result<Self, Failure> {
        let bad = |why: &str| Failure::Input(format!("{}: {why}; give a file like scene.ply with -o", output.display()));
        let name = output.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
        let lower = name.to_ascii_lowercase();
        let extension = [".compressed.ply", ".ply", ".splat"].into_iter().find(|e| lower.ends_with(e) && lower.len() > e.len());
        let Some(extension) = extension else { return Err(bad("not a .ply, .compressed.ply or .splat file")) };
        if output.is_dir() {
            return Err(bad("this is a folder"));
        }
        let (stem, extension) = name.split_at(name.len() - extension.len());
        let beside = |name: String| output.with_file_name(name);
        let partial = beside(format!("{stem}.partial{extension}"));
        Ok(Self { output: output.to_path_buf(), partial, folder: beside(format!("{stem}.train")) })
    }

    /// Refuses to start where something would be lost in the end.
    fn check(&self, found: &Found, force: bool) -> Result<(), Failure> {
        let fresh = matches!(found, Found::Nothing);
        let in_the_way = [Some(&self.output), fresh.then_some(&self.partial)].into_iter().flatten().find(|p| p.exists());
        match in_the_way {
            Some(path) if !force => {
                Err(Failure::Input(format!("{} exists; use --force to replace it, or another file with -o", path.display())))
            }
            _ => Ok(()),
        }
    }
}

/// Trains splats on a capture and returns the figures of the result.
pub fn reconstruct(job: &ReconstructJob, sink: &dyn Sink) -> Result<Value, Failure> {
    in_pool(job.threads, || reconstruct_here(job, sink))
}

/// As [`reconstruct`] in the current pool of threads.
fn reconstruct_here(job: &ReconstructJob, sink: &dyn Sink) -> Result<Value, Failure> {
    let places = Places::new(&job.output)?;
    sink.event(Event::Stage { name: "load", steps: 0 });
    let begin = Instant::now();
    let data = TrainingData::load(job)?;
    let surface = true_surface(&job.capture)?;
    sink.event(Event::StageDone { name: "load", seconds: begin.elapsed().as_secs_f64() });
    let (stage, found) = match StageDir::open_at(places.folder.clone(), job.force, data.key.clone())? {
        (_, Found::Done(figures)) if places.output.exists() => {
            sink.event(Event::Note("the reconstruction is up to date"));
            return Ok(figures);
        }
        // Somebody took the result away: it is made again.
        (stage, Found::Done(_)) => (stage, Found::Nothing),
        other => other,
    };
    places.check(&found, job.force)?;
    tell(&data, sink);
    check_writable(&places.folder)?;
    if let Some(parent) = places.output.parent().filter(|p| !p.as_os_str().is_empty()) {
        create_dir(parent)?;
    }
    stage.begin()?;

    let folder = TrainingFolder { path: &stage.path, partial: Some(places.partial.clone()), again: "run the same command again" };
    let transparent = data.transparent();
    let background = match data.options.background {
        Background::Fixed(c) => c,
        Background::Random => [0.0; 3],
    };
    let TrainingData { capture, start, options, .. } = data;
    let (views, size) = (capture.train.len(), [capture.train[0].camera.width, capture.train[0].camera.height]);
    let shown = capture.test.first().or(capture.train.first()).cloned();
    let mut trainer = Trainer::new(capture.train, start, options);
    let preview = Preview { view: shown.as_ref(), every: job.preview_every, background };
    let clock = folder.train(&mut trainer, &found, &preview, sink)?;

    sink.event(Event::Stage { name: "evaluate", steps: 0 });
    let begin = Instant::now();
    let evaluation = Evaluation::new(&capture.test, background, |c, b| trainer.render(c, b))?;
    let w_max = trainer.largest_weights();
    let region = trainer.options().region.filter(|_| !transparent);
    let (report, hidden) = measure(trainer.splats(), &w_max, region.as_ref(), surface.as_ref());
    write_json(&stage.path.join("evaluation.json"), &evaluation.to_json())?;
    let mut sheet = None;
    if let Some(image) = &evaluation.sheet {
        let path = stage.path.join("contact_sheet.png");
        write_png(&path, image, true).map_err(|e| Failure::Input(e.to_string()))?;
        sink.event(Event::File(&path));
        sheet = Some(path);
    }
    sink.event(Event::StageDone { name: "evaluate", seconds: begin.elapsed().as_secs_f64() });
    let quality = evaluation.mean;
    let figures = json!({
        "psnr": quality.map(|q| q.psnr),
        "ssim": quality.map(|q| q.ssim),
        "flip": quality.map(|q| q.flip),
        "gaussians": trainer.splats().len(),
        "iterations": trainer.step_count(),
        "seconds": clock.seconds(),
        "core_seconds": clock.core_seconds(),
        "needle_p99": report.needles.plain.p99,
        "needle_fraction": report.needles.plain.above_1_1_a,
        "internal_fraction": hidden,
        "floaters": report.floaters.map(|f| f.opacity[TWO_PERCENT]),
        "area_cv": report.consistency.area.cv,
        "method": trainer.options().method.name(),
        "profile": job.settings.profile.name(),
        "seed": job.settings.seed,
        "capture": capture.kind,
        "views": views,
        "test_views": capture.test.len(),
        "size": size,
        "measures": report,
        "output": places.output.display().to_string(),
        "contact_sheet": sheet.map(|p| p.display().to_string()),
        "folder": stage.path.display().to_string(),
    });
    write_splats(&places.output, &trainer.export(), job.force)?;
    sink.event(Event::File(&places.output));
    stage.finish(&figures)?;
    folder.tidy();
    Ok(figures)
}

/// What the user should know before the training.
fn tell(data: &TrainingData, sink: &dyn Sink) {
    for note in &data.capture.notes {
        sink.event(Event::Note(note));
    }
    let most = data.options.refinement.map(|r| r.most);
    if let (Some(least), Some(most)) = (data.options.least_cover(), most)
        && (most as f64) < 1.5 * least as f64
    {
        sink.event(Event::Warning(&format!(
            "{most} Gaussians may be too few: kernels this small need about {least} to cover the object; allow more with --max-gaussians"
        )));
    }
    if data.capture.test.is_empty() {
        sink.event(Event::Warning("no views are held out: the result cannot be judged"));
    }
}
