//! A training on disk: its folder with checkpoint, log and previews, and the loop that can stop and go on.

use std::io::{BufReader, Write};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use megas_capture::Photo;
use megas_film::write_png;
use megas_formats::{WriteOptions, save_splats};
use megas_metrics::image::psnr;
use megas_model::Splats;
use megas_reconstruct::Trainer;
use serde_json::{Value, json};

use super::clock::Clock;
use super::evaluate::compared;
use super::log::TrainingLog;
use super::pictures::pair;
use crate::disk::{read_json, write_atomic, write_json};
use crate::stage::Found;
use crate::{Event, Failure, Sink};

/// Wall time between two checkpoints.
const CHECKPOINT_EVERY: Duration = Duration::from_secs(60);
/// Wall time between two reports of live figures.
const LIVE_EVERY: Duration = Duration::from_millis(200);
/// Weight of the newest view in the running PSNR.
const SMOOTHING: f64 = 0.04;

/// The folder of a training.
pub struct TrainingFolder<'a> {
    /// The folder; it exists.
    pub path: &'a Path,
    /// Where an interrupted training leaves what it has so far.
    pub partial: PathBuf,
    /// Name of the training in its progress.
    pub label: &'a str,
}

/// What a training shows while it runs.
pub struct Preview<'a> {
    /// The view; none without one.
    pub view: Option<&'a Photo>,
    /// Iterations between two pictures; 0 for none.
    pub every: u32,
    /// What is behind opaque views.
    pub background: [f32; 3],
}

impl TrainingFolder<'_> {
    fn checkpoint(&self) -> PathBuf {
        self.path.join("checkpoint.bin")
    }

    /// Time spent and the log's sums that belong to the checkpoint.
    fn progress(&self) -> PathBuf {
        self.path.join("progress.json")
    }

    /// Trains until all iterations are done; returns the time it took. `found` says whether there may be a checkpoint.
    pub fn train(&self, trainer: &mut Trainer, found: &Found, preview: &Preview<'_>, sink: &dyn Sink) -> Result<Clock, Failure> {
        let resumed = matches!(found, Found::Partial) && self.resume(trainer, sink)?;
        let progress = if resumed { read_json(&self.progress()).unwrap_or_default() } else { Value::Null };
        let clock = Clock::resume(&progress["time"]);
        let total = trainer.options().iterations;
        // Sums of another iteration are of no use: the training was killed between two writes.
        let sums = (progress["step"] == trainer.step_count()).then(|| serde_json::from_value(progress["log"].clone()).ok()).flatten();
        let mut log = TrainingLog::open(self.path.join("log.jsonl"), trainer.step_count(), sums.unwrap_or_default())?;
        sink.event(Event::Stage { name: self.label, steps: u64::from(total) });
        if resumed {
            sink.event(Event::Note(&format!("continuing after iteration {} of {total}", trainer.step_count())));
        }
        sink.event(Event::Step { done: u64::from(trainer.step_count()) });
        let begin = Instant::now();
        let (mut saved, mut told) = (Instant::now(), Instant::now());
        let mut running: Option<[f64; 2]> = None;
        while !trainer.done() {
            if sink.cancelled() {
                return Err(self.interrupt(trainer, &clock, &log, sink));
            }
            let report = trainer.step();
            if !report.loss.is_finite() {
                return Err(Failure::Other(format!(
                    "the loss is not finite in iteration {}; the log in {} shows how it came to this; check the poses, or use another seed",
                    report.step,
                    self.path.display()
                )));
            }
            let now = [report.loss, report.psnr];
            let [loss, psnr] = running.map_or(now, |r| [0, 1].map(|k| r[k] + SMOOTHING * (now[k] - r[k])));
            running = Some([loss, psnr]);
            log.add(&report, trainer.splats(), trainer.done())?;
            if told.elapsed() >= LIVE_EVERY || trainer.done() {
                told = Instant::now();
                sink.event(Event::Live(&[("loss", loss), ("psnr", psnr), ("gaussians", report.gaussians as f64)]));
            }
            sink.event(Event::Step { done: u64::from(report.step) });
            if preview.every > 0 && report.step.is_multiple_of(preview.every) {
                self.preview(trainer, preview, report.step, sink)?;
            }
            if saved.elapsed() >= CHECKPOINT_EVERY || trainer.done() {
                self.save(trainer, &clock, &log)?;
                saved = Instant::now();
            }
        }
        sink.event(Event::StageDone { name: self.label, seconds: begin.elapsed().as_secs_f64() });
        Ok(clock)
    }

    /// Continues from the checkpoint; false if there is none or it cannot be used.
    fn resume(&self, trainer: &mut Trainer, sink: &dyn Sink) -> Result<bool, Failure> {
        let path = self.checkpoint();
        let Ok(file) = std::fs::File::open(&path) else { return Ok(false) };
        let length = file.metadata().map_err(|e| crate::disk::explain("read", &path, &e))?.len();
        match trainer.load(&mut BufReader::with_capacity(1 << 20, file), length) {
            Ok(()) => Ok(true),
            Err(e) => {
                sink.event(Event::Warning(&format!("{}: {e}; the training starts anew", path.display())));
                Ok(false)
            }
        }
    }

    fn save(&self, trainer: &mut Trainer, clock: &Clock, log: &TrainingLog) -> Result<(), Failure> {
        write_atomic(&self.checkpoint(), |w| {
            trainer.save(w)?;
            w.flush()
        })?;
        let progress = json!({ "step": trainer.step_count(), "time": clock.to_json(), "log": log.sums() });
        write_json(&self.progress(), &progress)
    }

    /// Leaves a checkpoint and what there is so far.
    fn interrupt(&self, trainer: &mut Trainer, clock: &Clock, log: &TrainingLog, sink: &dyn Sink) -> Failure {
        if let Err(e) = self.save(trainer, clock, log) {
            return e;
        }
        if let Err(e) = write_splats(&self.partial, &trainer.export(), true) {
            return e;
        }
        sink.event(Event::File(&self.partial));
        Failure::Interrupted(format!(
            "stopped after iteration {} of {}; the splats so far are in {}; run the same command again to continue",
            trainer.step_count(),
            trainer.options().iterations,
            self.partial.display()
        ))
    }

    /// A render beside its photograph.
    fn preview(&self, trainer: &mut Trainer, preview: &Preview<'_>, step: u32, sink: &dyn Sink) -> Result<(), Failure> {
        let Some(photo) = preview.view else { return Ok(()) };
        let (image, truth) = compared(photo, preview.background, &mut |c, b| trainer.render(c, b));
        let caption = format!("iteration {step}  {:.2} dB", psnr(&image, &truth, None));
        let path = self.path.join(format!("preview_{step:06}.png"));
        write_png(&path, &pair(&image, &truth, [&caption, "photograph"])?, true).map_err(|e| Failure::Input(e.to_string()))?;
        sink.event(Event::File(&path));
        Ok(())
    }

    /// Removes what only an unfinished training needs.
    pub fn tidy(&self) {
        for path in [&self.checkpoint(), &self.progress(), &self.partial] {
            let _ = std::fs::remove_file(path);
        }
    }
}

/// Writes splats in the format of the extension.
pub fn write_splats(path: &Path, splats: &Splats, overwrite: bool) -> Result<(), Failure> {
    let options = WriteOptions { overwrite, ..WriteOptions::default() };
    save_splats(path, splats, &options).map_err(|e| Failure::Input(e.to_string()))
}
