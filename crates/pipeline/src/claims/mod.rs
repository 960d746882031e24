//! `eval claims`: what the paper says about deformed objects, as numbers (splatting.md chapter 9).
//!
//! Models are trained or taken from a folder where `eval reconstruct` left them. Every method and seed has a folder of its
//! own in `DIR`, so that a study that was stopped goes on; tables and sheet are written anew after each.

mod coherence;
mod measure;
mod mesh;
mod methods;
mod model;
mod orderings;
mod sheet;
mod table;
mod truth;

use std::path::{Path, PathBuf};

use megas_film::write_png;
use megas_metrics::deform::{Carry, Deformation};
use megas_model::Image;
use serde_json::{Value, json};

use crate::disk::{read_json, write_json, write_text};
use crate::reconstruct::{ReconstructSettings, reconstruct_here};
use crate::run::in_pool;
use crate::stage::{Found, KeyBuilder, StageDir};
use crate::study::{Asset, Check, Row, StudyJob};
use crate::{Event, Failure, Sink};

pub use methods::Contender;
pub(crate) use sheet::{captioned, place};
use table::Results;
use truth::Truth;

/// The mode whose pictures go on the sheet.
const SHEET_MODE: Carry = Carry::ElasticLike;
/// Bumped when figures change their meaning.
const FORMAT: u32 = 4;

/// How much is measured.
#[derive(Clone, Debug, PartialEq)]
pub struct Scope {
    /// Gradients that shapes follow; the first claims are about elastic-like ones.
    pub modes: Vec<Carry>,
    /// Pictures that are compared per deformation.
    pub views: usize,
    /// Structural similarity and FLIP too.
    pub perceptual: bool,
}

/// A comparison of methods on one object.
#[derive(Clone, Debug, PartialEq)]
pub struct ClaimsJob {
    /// A capture with its true surface in `mesh/whole.ply`.
    pub capture: PathBuf,
    /// Folder of trained models, as `eval reconstruct` writes it; they are trained here if absent.
    pub models: Option<PathBuf>,
    /// Methods.
    pub methods: Vec<Contender>,
    /// Trainings with different seeds.
    pub seeds: u32,
    /// How to train; method and seed are set.
    pub settings: ReconstructSettings,
    /// What to measure.
    pub scope: Scope,
    /// Memory that the views and their decoding may take \[GiB\].
    pub memory_gib: f64,
    /// Folder of the results.
    pub out: PathBuf,
    /// Replace results of other settings.
    pub force: bool,
    /// Worker threads; all cores when absent.
    pub threads: Option<usize>,
}

/// A method that has been measured.
struct Measured {
    method: Contender,
    folder: PathBuf,
    figures: Value,
    trained: Value,
}

impl ClaimsJob {
    fn key(&self, method: Contender, model: &Path) -> Result<String, Failure> {
        let s = &self.scope;
        let modes: Vec<&str> = s.modes.iter().map(|m| m.name()).collect();
        KeyBuilder::new("claims")
            .settings(&(FORMAT, method.id(), modes, s.views, s.perceptual))?
            .file(model)?
            .file(&self.capture.join("mesh").join("whole.ply"))
            .map(KeyBuilder::finish)
    }

    /// The splats of a training and its figures; `None` where the folder does not have them.
    fn model(&self, name: &str, method: Contender, seed: u64, sink: &dyn Sink) -> Result<Option<(PathBuf, Value)>, Failure> {
        if let Some(folder) = &self.models {
            let stem = format!("{}_seed{seed}", method.training().name());
            let path = folder.join(name).join(format!("{stem}.ply"));
            if !path.is_file() {
                sink.event(Event::Note(&format!("{} seed {seed} is left out: there is no {}", method.id(), path.display())));
                return Ok(None);
            }
            let marker = read_json(&folder.join(name).join(format!("{stem}.train")).join("stage.json"));
            return Ok(Some((path, marker.map(|m| m["figures"].clone()).unwrap_or_default())));
        }
        let study = StudyJob {
            captures: vec![self.capture.clone()],
            methods: vec![method.training()],
            seeds: self.seeds,
            seeds_all: true,
            settings: self.settings.clone(),
            memory_gib: self.memory_gib,
            out: self.out.clone(),
            force: self.force,
            threads: self.threads,
        };
        let job = study.reconstruction(&self.capture, &self.out.join("models").join(name), method.training(), seed);
        let figures = reconstruct_here(&job, &format!("{} seed {seed}", method.training().name()), sink)?;
        Ok(Some((job.output, figures)))
    }
}

/// Measures what is missing, writes `claims.md`, `claims.json` and `claims.png`, and returns the figures.
pub fn claims(job: &ClaimsJob, sink: &dyn Sink) -> Result<Value, Failure> {
    in_pool(job.threads, || claims_here(job, sink))
}

fn claims_here(job: &ClaimsJob, sink: &dyn Sink) -> Result<Value, Failure> {
    if job.methods.is_empty() || job.seeds == 0 || job.scope.views == 0 || !job.scope.modes.contains(&SHEET_MODE) {
        return Err(Failure::Input("nothing to compare: give methods, at least one seed and one view".into()));
    }
    let full = job.capture.canonicalize().map_err(|e| crate::disk::explain("find", &job.capture, &e))?;
    let name = full.file_name().map_or_else(|| "capture".to_owned(), |n| n.to_string_lossy().into_owned());
    let loading = megas_capture::Options {
        downscale: job.settings.downscale,
        eval_every: job.settings.eval_every,
        memory_budget_bytes: (job.memory_gib * f64::from(1u32 << 30)) as u64,
        ..Default::default()
    };
    let capture = megas_capture::load(&job.capture, &loading).map_err(|e| Failure::Input(e.to_string()))?;
    sink.event(Event::Stage { name: "true surface", steps: 0 });
    let begin = std::time::Instant::now();
    let mut truth = Truth::new(&job.capture, &capture.train, &capture.test, job.scope.views)?;
    drop(capture);
    sink.event(Event::StageDone { name: "true surface", seconds: begin.elapsed().as_secs_f64() });
    let mut done: Vec<Measured> = Vec::new();
    for &method in &job.methods {
        for seed in (0..job.seeds).map(|k| job.settings.seed + u64::from(k)) {
            let Some((model, trained)) = job.model(&name, method, seed, sink)? else { continue };
            let folder = job.out.join(&name).join(format!("{}_seed{seed}", method.id()));
            let (stage, found) = StageDir::open_at(folder.clone(), job.force, job.key(method, &model)?)?;
            let figures = match found {
                Found::Done(figures) => figures,
                Found::Nothing | Found::Partial => {
                    stage.begin()?;
                    let label = format!("{name} {} seed {seed}", method.id());
                    sink.event(Event::Stage { name: &label, steps: measure::states().count() as u64 });
                    let begin = std::time::Instant::now();
                    let figures = measure::measure(method, &model, &trained, &mut truth, &job.scope, &folder, sink)?;
                    stage.finish(&figures)?;
                    sink.event(Event::StageDone { name: &label, seconds: begin.elapsed().as_secs_f64() });
                    figures
                }
            };
            done.push(Measured { method, folder, figures, trained });
            write(job, &name, &mut truth, &done)?;
        }
    }
    if done.is_empty() {
        return Err(Failure::Input(format!(
            "no model of {name} was found; give --models the folder that `eval reconstruct -o` wrote, or leave it out to train"
        )));
    }
    let written = write(job, &name, &mut truth, &done)?;
    sink.event(Event::File(&job.out.join(&name).join("claims.md")));
    sink.event(Event::File(&job.out.join(&name).join("claims.png")));
    Ok(written)
}

/// Tables, sheet and figures of what is done.
fn write(job: &ClaimsJob, name: &str, truth: &mut Truth, done: &[Measured]) -> Result<Value, Failure> {
    let mut results = Results { name: name.to_owned(), rows: Vec::new() };
    let mut asset = Asset { name: name.to_owned(), rows: Vec::new() };
    for m in done {
        match results.rows.iter_mut().find(|r| r.0 == m.method) {
            Some(row) => row.1.push(m.figures.clone()),
            None => results.rows.push((m.method, vec![m.figures.clone()])),
        }
        // B5, B6 and A1 share their training, which counts once.
        if matches!(m.method, Contender::B6 | Contender::A1) || m.trained.is_null() {
            continue;
        }
        match asset.rows.iter_mut().find(|r| r.method == m.method.training()) {
            Some(row) => row.runs.push(m.trained.clone()),
            None => asset.rows.push(Row { method: m.method.training(), runs: vec![m.trained.clone()] }),
        }
    }
    let checks: Vec<Check> = crate::study::checks(&asset).into_iter().chain(orderings::checks(&results)).collect();
    let settings = json!({
        "views": job.scope.views,
        "modes": job.scope.modes.iter().map(|m| m.name()).collect::<Vec<_>>(),
        "cells": model::CELLS,
        "truth_psnr": truth.psnr,
        "photographed": truth.photographed(),
    });
    let folder = job.out.join(name);
    write_text(&folder.join("claims.md"), &results.to_markdown(&checks, &settings))?;
    let runs: Vec<Value> = done.iter().map(|m| m.figures.clone()).collect();
    let json = json!({ "settings": settings, "methods": results.to_json(), "orderings": checks, "runs": runs });
    write_json(&folder.join("claims.json"), &json)?;
    let portraits: Vec<(Deformation, Image)> = Deformation::ALL.map(|d| (d, truth.state(d).portrait.image.clone())).into();
    let mut columns: Vec<(Contender, &Path)> = Vec::new();
    for m in done {
        if columns.iter().all(|c| c.0 != m.method) {
            columns.push((m.method, &m.folder));
        }
    }
    if let Some(image) = sheet::sheet(&portraits, &columns)? {
        write_png(folder.join("claims.png"), &image, true).map_err(|e| Failure::Other(e.to_string()))?;
    }
    Ok(json!({
        "capture": name,
        "methods": results.to_json(),
        "orderings": checks.len(),
        "orderings_that_hold": checks.iter().filter(|c| c.holds).count(),
        "fails": checks.iter().filter(|c| !c.holds).map(Check::line).collect::<Vec<_>>(),
        "truth_psnr": truth.psnr,
        "table": folder.join("claims.md").display().to_string(),
        "contact_sheet": folder.join("claims.png").display().to_string(),
    }))
}
