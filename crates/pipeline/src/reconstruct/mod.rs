//! `reconstruct`: posed photographs → splats (splatting.md §5).
//!
//! Beside the splat file lies a folder with everything else: checkpoint, log, previews, evaluation and contact sheet.

mod clock;
mod data;
mod evaluate;
mod finetune;
mod log;
mod measure;
pub(crate) mod pictures;
mod places;
mod plan;
mod settings;
mod training;

use std::time::Instant;

use megas_reconstruct::{Background, Trainer};
use serde_json::{Value, json};

use crate::run::in_pool;
use crate::{Event, Failure, Sink};

use data::TrainingData;
use evaluate::Evaluation;
use measure::{TWO_PERCENT, measure, true_surface};
use places::{Opened, Places};
use training::{Preview, TrainingFolder, write_splats};

pub(crate) use data::refused;
pub(crate) use finetune::finetune_here;
pub use finetune::{FinetuneJob, FinetuneSettings, finetune, plan_finetune};
pub use log::ASPECT;
pub use megas_reconstruct::Region;
pub use plan::plan_reconstruct;
pub use settings::{Backdrop, ReconstructJob, ReconstructSettings, TauPrune};

/// Trains splats on a capture and returns the figures of the result.
pub fn reconstruct(job: &ReconstructJob, sink: &dyn Sink) -> Result<Value, Failure> {
    in_pool(job.threads, || reconstruct_here(job, "train", sink))
}

/// As [`reconstruct`] in the current pool of threads; `label` names the training in its progress.
pub(crate) fn reconstruct_here(job: &ReconstructJob, label: &str, sink: &dyn Sink) -> Result<Value, Failure> {
    let places = Places::new(&job.output)?;
    sink.event(Event::Stage { name: "load", steps: 0 });
    let begin = Instant::now();
    let data = TrainingData::load(job, &|| sink.cancelled())?;
    let surface = true_surface(&job.capture)?;
    sink.event(Event::StageDone { name: "load", seconds: begin.elapsed().as_secs_f64() });
    let (stage, found) = match places.open(data.key.clone(), job.force)? {
        Opened::Done(figures) => {
            sink.event(Event::Note("the reconstruction is up to date"));
            return Ok(figures);
        }
        Opened::Todo(stage, found) => (stage, found),
    };
    tell(&data, sink);
    places.begin(&stage)?;
    let folder = TrainingFolder { path: &stage.path, partial: places.partial.clone(), label };
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
    let evaluation = Evaluation::new(&capture.test, "photograph", background, |c, b| trainer.render(c, b))?;
    let w_max = trainer.largest_weights();
    let region = trainer.options().region.filter(|_| !transparent);
    let (report, hidden) = measure(trainer.splats(), &w_max, region.as_ref(), surface.as_ref());
    let sheet = evaluation.write(&stage.path, sink)?;
    sink.event(Event::StageDone { name: "evaluate", seconds: begin.elapsed().as_secs_f64() });
    let quality = evaluation.mean;
    // Sums of nothing may be negative zeros.
    let figures = json!({
        "psnr": quality.map(|q| q.psnr),
        "ssim": quality.map(|q| q.ssim),
        "flip": quality.map(|q| q.flip),
        "gaussians": trainer.splats().len(),
        "iterations": trainer.step_count(),
        "seconds": clock.seconds(),
        "core_seconds": clock.core_seconds(),
        "needle_p99": report.needles.plain.p99,
        "needle_fraction": report.needles.plain.above_1_1_a + 0.0,
        "internal_fraction": hidden + 0.0,
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
