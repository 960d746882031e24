//! `finetune`: a splat from anywhere → one that survives melting, without photographs (splatting.md §5.9).

use std::path::PathBuf;
use std::time::Instant;

use megas_capture::Photo;
use megas_formats::load_splats;
use megas_metrics::splats::{Consistency, Needles};
use megas_metrics::surface::hidden_fraction;
use megas_model::Splats;
use megas_raster::{Channels, Gaussians, Rasterizer, Settings};
use megas_reconstruct::{FinetuneOptions, Teacher};
use megas_scene::Select;
use serde_json::{Value, json};

use super::evaluate::{Evaluation, WHITE};
use super::log::ASPECT;
use super::measure::HIDDEN;
use super::places::{Opened, Places};
use super::plan::{memory_mib, training_seconds};
use super::training::{Preview, TrainingFolder, write_splats};
use crate::body::selection;
use crate::run::in_pool;
use crate::stage::KeyBuilder;
use crate::{Event, Failure, Sink};

/// Bounds of the side of the views \[px\].
const SIZES: std::ops::RangeInclusive<u32> = 32..=4096;
/// Most views of either kind.
const MOST_VIEWS: u32 = 4096;

/// How to fine-tune.
#[derive(Clone, Debug, PartialEq)]
pub struct FinetuneSettings {
    /// Steps.
    pub steps: u32,
    /// Side of the views \[px\].
    pub size: u32,
    /// Training views.
    pub views: u32,
    /// Held-out views.
    pub test_views: u32,
    /// Seed of everything random.
    pub seed: u64,
    /// Simulator cells along the object's longest side: kernels are clamped to half a cell.
    pub cells: Option<u32>,
    /// Most Gaussians.
    pub max_gaussians: usize,
}

impl Default for FinetuneSettings {
    fn default() -> Self {
        let o = FinetuneOptions::default();
        Self {
            steps: o.iterations,
            size: o.size,
            views: o.views,
            test_views: o.test_views,
            seed: o.seed,
            cells: None,
            max_gaussians: o.most,
        }
    }
}

impl FinetuneSettings {
    /// Smaller views and fewer steps: minutes on two cores.
    pub fn preview() -> Self {
        Self { steps: 400, size: 320, ..Self::default() }
    }

    fn options(&self) -> Result<FinetuneOptions, Failure> {
        let within = |name: &str, value: u32, least: u32, most: u32| match (least..=most).contains(&value) {
            true => Ok(value),
            false => Err(Failure::Input(format!("{name}: found {value}, expected {least} to {most}"))),
        };
        Ok(FinetuneOptions {
            iterations: within("steps", self.steps, 1, 1_000_000)?,
            views: within("views", self.views, 2, MOST_VIEWS)?,
            test_views: within("test-views", self.test_views, 0, MOST_VIEWS)?,
            size: within("size", self.size, *SIZES.start(), *SIZES.end())?,
            seed: self.seed,
            cell: None,
            most: self.max_gaussians,
        })
    }
}

/// A fine-tuning from a file to a file.
#[derive(Clone, Debug, PartialEq)]
pub struct FinetuneJob {
    /// Splat file to start from.
    pub input: PathBuf,
    /// Splat file to write.
    pub output: PathBuf,
    /// What of the file is the object, one choice or several; all of it if empty.
    pub select: Vec<Select>,
    /// The direction that points up in the file, for the support plane.
    pub up: [f64; 3],
    /// Write what is not the object too, as it was.
    pub keep_rest: bool,
    /// How.
    pub settings: FinetuneSettings,
    /// Replace an existing file, or a training with other settings.
    pub force: bool,
    /// Worker threads; all cores when absent.
    pub threads: Option<usize>,
}

impl FinetuneJob {
    /// A job with default settings on the whole file.
    pub fn new(input: PathBuf, output: PathBuf) -> Self {
        let settings = FinetuneSettings::default();
        Self { input, output, select: Vec::new(), up: [0.0, 0.0, 1.0], keep_rest: false, settings, force: false, threads: None }
    }
}

/// The object and what surrounds it.
struct Parts {
    object: Splats,
    rest: Splats,
    antialiased: bool,
}

impl Parts {
    fn load(job: &FinetuneJob) -> Result<Self, Failure> {
        let file = load_splats(&job.input).map_err(|e| Failure::Input(e.to_string()))?;
        let splats = file.splats;
        let mut taken = vec![job.select.is_empty(); splats.len()];
        for s in &job.select {
            let (mask, _) = megas_body::select::select(&splats, &selection(s, job.up));
            taken.iter_mut().zip(mask).for_each(|(t, m)| *t |= m);
        }
        let (inside, outside): (Vec<usize>, Vec<usize>) = (0..splats.len()).partition(|&i| taken[i]);
        if inside.is_empty() {
            let count = splats.len();
            return Err(Failure::Input(format!("{}: nothing of its {count} splats is selected; widen the selection", job.input.display())));
        }
        Ok(Self { object: splats.select(&inside), rest: splats.select(&outside), antialiased: file.report.antialiased })
    }
}

fn same_file(a: &std::path::Path, b: &std::path::Path) -> bool {
    a.canonicalize().ok().zip(b.canonicalize().ok()).is_some_and(|(a, b)| a == b)
}

/// The largest blend weight of every Gaussian over views.
fn largest_weights(splats: &Splats, views: &[Photo]) -> Vec<f32> {
    let gaussians = Gaussians::from_splats(splats);
    let mut rasterizer = Rasterizer::new();
    let mut w_max = vec![0.0f32; splats.len()];
    for view in views {
        let frame = rasterizer.frame(&gaussians, &view.camera, &Settings::default(), Channels::Weights);
        w_max.iter_mut().zip(&frame.statistics.w_max).for_each(|(a, b)| *a = a.max(*b));
    }
    w_max
}

/// What fine-tuning is meant to improve.
struct Shape {
    needle_fraction: f64,
    needle_p99: f64,
    hidden_fraction: f64,
    area_cv: f64,
}

impl Shape {
    fn new(splats: &Splats, views: &[Photo]) -> Self {
        let needles = Needles::new(splats, ASPECT).plain;
        Self {
            // Sums of nothing may be negative zeros.
            needle_fraction: needles.above_1_1_a + 0.0,
            needle_p99: needles.p99,
            hidden_fraction: hidden_fraction(&largest_weights(splats, views), HIDDEN) + 0.0,
            area_cv: Consistency::new(splats).area.cv,
        }
    }
}

/// Fine-tunes a splat and returns the figures of the result.
pub fn finetune(job: &FinetuneJob, sink: &dyn Sink) -> Result<Value, Failure> {
    in_pool(job.threads, || finetune_here(job, sink))
}

/// As [`finetune`] in the current pool of threads.
pub(crate) fn finetune_here(job: &FinetuneJob, sink: &dyn Sink) -> Result<Value, Failure> {
    let places = Places::new(&job.output)?;
    if same_file(&job.input, &job.output) {
        return Err(Failure::Input(format!("{} would be overwritten by itself; give another file with -o", job.input.display())));
    }
    let mut options = job.settings.options()?;
    let parts = Parts::load(job)?;
    let key = KeyBuilder::new("finetune")
        .file(&job.input)?
        .settings(&(&job.select, job.up, job.keep_rest, job.settings.cells))?
        .settings(&options)?
        .finish();
    let (stage, found) = match places.open(key, job.force)? {
        Opened::Done(figures) => {
            sink.event(Event::Note("the fine-tuning is up to date"));
            return Ok(figures);
        }
        Opened::Todo(stage, found) => (stage, found),
    };
    if parts.antialiased {
        sink.event(Event::Warning(
            "the file asks for anti-aliased rendering, which fine-tuning does not know: small Gaussians may look too strong",
        ));
    }
    places.begin(&stage)?;

    let object = &parts.object;
    sink.event(Event::Stage { name: "photograph", steps: u64::from(options.views + options.test_views) });
    let begin = Instant::now();
    let teacher = Teacher::new(object, &options, |done, _| sink.event(Event::Step { done: done as u64 }));
    let longest = 2.0 * teacher.region.half.into_iter().fold(0.0, f32::max);
    options.cell = job.settings.cells.map(|n| longest / n.max(1) as f32);
    let mut training = teacher.options(&options);
    // Nothing can be learnt beyond what the teacher shows.
    training.sh_degree = object.sh_degree;
    let before = Shape::new(object, &teacher.train);
    let (mut trainer, test) = teacher.student(object, training);
    sink.event(Event::StageDone { name: "photograph", seconds: begin.elapsed().as_secs_f64() });
    let folder = TrainingFolder { path: &stage.path, partial: places.partial.clone(), label: "finetune" };
    let preview = Preview { view: test.first(), every: 0, background: WHITE };
    let clock = folder.train(&mut trainer, &found, &preview, sink)?;

    sink.event(Event::Stage { name: "evaluate", steps: 0 });
    let begin = Instant::now();
    let evaluation = Evaluation::new(&test, "original", WHITE, |c, b| trainer.render(c, b))?;
    let sheet = evaluation.write(&stage.path, sink)?;
    let after = Shape::new(trainer.splats(), trainer.views());
    sink.event(Event::StageDone { name: "evaluate", seconds: begin.elapsed().as_secs_f64() });
    let quality = evaluation.mean;
    let figures = json!({
        "psnr": quality.map(|q| q.psnr),
        "ssim": quality.map(|q| q.ssim),
        "flip": quality.map(|q| q.flip),
        "gaussians_before": object.len(),
        "gaussians": trainer.splats().len(),
        "needle_fraction_before": before.needle_fraction,
        "needle_fraction": after.needle_fraction,
        "needle_p99_before": before.needle_p99,
        "needle_p99": after.needle_p99,
        "hidden_fraction_before": before.hidden_fraction,
        "hidden_fraction": after.hidden_fraction,
        "area_cv_before": before.area_cv,
        "area_cv": after.area_cv,
        "steps": trainer.step_count(),
        "size": job.settings.size,
        "views": job.settings.views,
        "test_views": job.settings.test_views,
        "seconds": clock.seconds(),
        "core_seconds": clock.core_seconds(),
        "output": places.output.display().to_string(),
        "contact_sheet": sheet.map(|p| p.display().to_string()),
        "folder": stage.path.display().to_string(),
    });
    let mut splats = trainer.export();
    if job.keep_rest {
        splats.append(&parts.rest);
        splats.birth_id = (0..splats.len() as u32).collect();
    }
    write_splats(&places.output, &splats, job.force)?;
    sink.event(Event::File(&places.output));
    stage.finish(&figures)?;
    folder.tidy();
    Ok(figures)
}

/// Describes a fine-tuning without doing it.
pub fn plan_finetune(job: &FinetuneJob) -> Result<Value, Failure> {
    let places = Places::new(&job.output)?;
    let options = job.settings.options()?;
    let parts = Parts::load(job)?;
    let threads = job.threads.unwrap_or_else(rayon::current_num_threads) as f64;
    let pixels = f64::from(options.size).powi(2);
    let gaussians = (2.0 * parts.object.len() as f64).min(options.most as f64);
    let bytes = 4.0 * pixels * f64::from(options.views + options.test_views);
    Ok(json!({
        "stages": ["photograph", "finetune", "evaluate"],
        "output": places.output.display().to_string(),
        "folder": places.folder.display().to_string(),
        "object_splats": parts.object.len(),
        "other_splats": parts.rest.len(),
        "steps": options.iterations,
        "size": options.size,
        "views": options.views,
        "test_views": options.test_views,
        "threads": threads,
        "memory_mib_estimate": memory_mib(bytes, pixels, gaussians),
        "train_s_estimate": training_seconds(options.iterations, pixels, gaussians, threads),
    }))
}
