//! `eval reconstruct`: methods compared on captures, M1–M5 as a table (splatting.md §9.3, §9.4).
//!
//! Every training is a reconstruction of its own in `DIR/<capture>/`, so a study that was stopped goes on with the training
//! it was at. The tables are written anew after every training.

mod claims;
mod table;

use std::path::{Path, PathBuf};

use megas_reconstruct::Method;
use serde_json::{Value, json};

use crate::disk::{write_json, write_text};
use crate::reconstruct::{ReconstructJob, ReconstructSettings, reconstruct_here, refused};
use crate::run::in_pool;
use crate::{Event, Failure, Sink};

pub(crate) use claims::{Check, checks};
pub(crate) use table::{Asset, Row};

/// Methods that get all seeds; the others get one unless asked for.
const DECISIVE: [Method; 2] = [Method::Vanilla, Method::Ours];

/// A comparison of methods.
#[derive(Clone, Debug, PartialEq)]
pub struct StudyJob {
    /// Captures, best with a true surface in `mesh/whole.ply`.
    pub captures: Vec<PathBuf>,
    /// Methods.
    pub methods: Vec<Method>,
    /// Trainings with different seeds.
    pub seeds: u32,
    /// All methods get all seeds, not only the decisive ones.
    pub seeds_all: bool,
    /// Everything but method and seed.
    pub settings: ReconstructSettings,
    /// Memory that the views and their decoding may take \[GiB\].
    pub memory_gib: f64,
    /// Folder of the results.
    pub out: PathBuf,
    /// Replace results of other settings.
    pub force: bool,
    /// Worker threads; all cores when absent.
    pub threads: Option<usize>,
}

impl StudyJob {
    /// Seeds of a method.
    fn seeds_of(&self, method: Method) -> u32 {
        if self.seeds_all || DECISIVE.contains(&method) { self.seeds } else { self.seeds.min(1) }
    }

    /// The trainings on one capture.
    fn trainings(&self) -> Vec<(Method, u64)> {
        let all = |m: &Method| (0..self.seeds_of(*m)).map(move |k| (*m, k)).collect::<Vec<_>>();
        self.methods.iter().flat_map(all).map(|(m, k)| (m, self.settings.seed + u64::from(k))).collect()
    }

    /// One of the trainings, into `folder`.
    pub(crate) fn reconstruction(&self, capture: &Path, folder: &Path, method: Method, seed: u64) -> ReconstructJob {
        ReconstructJob {
            settings: ReconstructSettings { method, seed, ..self.settings.clone() },
            preview_every: 0,
            memory_gib: self.memory_gib,
            force: self.force,
            threads: self.threads,
            ..ReconstructJob::new(capture.to_path_buf(), folder.join(format!("{}_seed{seed}.ply", method.name())))
        }
    }

    /// The captures with their names; all must be there before hours are spent on the first.
    fn named_captures(&self, sink: &dyn Sink) -> Result<Vec<(String, &Path)>, Failure> {
        let mut named: Vec<(String, &Path)> = Vec::new();
        for path in &self.captures {
            let loading =
                megas_capture::Options { downscale: self.settings.downscale, eval_every: self.settings.eval_every, ..Default::default() };
            let capture = megas_capture::load_unless(path, &loading, &|| sink.cancelled()).map_err(refused)?;
            if capture.test.is_empty() {
                return Err(Failure::Input(format!("{}: no views are held out, so methods cannot be compared", path.display())));
            }
            let full = path.canonicalize().map_err(|e| crate::disk::explain("find", path, &e))?;
            let name = full.file_name().map_or_else(|| "capture".to_owned(), |n| n.to_string_lossy().into_owned());
            if let Some((_, other)) = named.iter().find(|n| n.0 == name) {
                return Err(Failure::Input(format!(
                    "{} and {} have the same name; give every capture its own study",
                    other.display(),
                    path.display()
                )));
            }
            named.push((name, path));
        }
        Ok(named)
    }

    fn check(&self) -> Result<(), Failure> {
        if self.captures.is_empty() || self.methods.is_empty() || self.seeds == 0 {
            return Err(Failure::Input("nothing to compare: give captures, methods and at least one seed".into()));
        }
        Ok(())
    }
}

/// Trains what is missing and writes `table.md` and `table.json`; returns the figures of the whole study.
pub fn study(job: &StudyJob, sink: &dyn Sink) -> Result<Value, Failure> {
    in_pool(job.threads, || study_here(job, sink))
}

fn study_here(job: &StudyJob, sink: &dyn Sink) -> Result<Value, Failure> {
    job.check()?;
    let captures = job.named_captures(sink)?;
    let trainings = job.trainings();
    let planned = captures.len() * trainings.len();
    let mut assets: Vec<Asset> = Vec::new();
    let mut done = 0;
    for (name, path) in &captures {
        let folder = job.out.join(name);
        let mut rows: Vec<Row> = Vec::new();
        for &(method, seed) in &trainings {
            done += 1;
            let label = format!("{name} {} seed {seed} ({done} of {planned})", method.name());
            let figures = reconstruct_here(&job.reconstruction(path, &folder, method, seed), &label, sink)?;
            match rows.last_mut().filter(|r| r.method == method) {
                Some(row) => row.runs.push(figures),
                None => rows.push(Row { method, runs: vec![figures] }),
            }
            let now = Asset { name: name.clone(), rows: rows.clone() };
            let so_far: Vec<Asset> = assets.iter().cloned().chain([now]).collect();
            write_tables(job, &so_far, done, planned)?;
        }
        assets.push(Asset { name: name.clone(), rows });
    }
    let table = job.out.join("table.md");
    sink.event(Event::File(&table));
    let checks: Vec<claims::Check> = assets.iter().flat_map(claims::checks).collect();
    let seconds = |key: &str| assets.iter().flat_map(|a| &a.rows).flat_map(|r| &r.runs).filter_map(|f| f[key].as_f64()).sum::<f64>();
    Ok(json!({
        "captures": captures.iter().map(|c| c.0.clone()).collect::<Vec<_>>(),
        "trainings": planned,
        "seconds": seconds("seconds"),
        "core_seconds": seconds("core_seconds"),
        "orderings": checks.len(),
        "orderings_that_hold": checks.iter().filter(|c| c.holds).count(),
        "fails": checks.iter().filter(|c| !c.holds).map(claims::Check::line).collect::<Vec<_>>(),
        "table": table.display().to_string(),
    }))
}

fn write_tables(job: &StudyJob, assets: &[Asset], done: usize, planned: usize) -> Result<(), Failure> {
    let s = &job.settings;
    let settings = json!({
        "profile": s.profile.name(),
        "iterations": s.iterations.unwrap_or(s.profile.iterations()),
        "seeds": job.seeds,
        "first_seed": s.seed,
        "trainings_done": done,
        "trainings_planned": planned,
    });
    let mut json = table::to_json(assets);
    json["settings"] = settings.clone();
    write_json(&job.out.join("table.json"), &json)?;
    write_text(&job.out.join("table.md"), &table::to_markdown(assets, &settings))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn decisive_methods_get_all_seeds() {
        let job = StudyJob {
            captures: Vec::new(),
            methods: vec![Method::Vanilla, Method::Pgsr, Method::Ours],
            seeds: 2,
            seeds_all: false,
            settings: ReconstructSettings { seed: 5, ..Default::default() },
            memory_gib: 1.0,
            out: PathBuf::from("d"),
            force: false,
            threads: None,
        };
        let all: Vec<(&str, u64)> = job.trainings().into_iter().map(|(m, s)| (m.name(), s)).collect();
        assert_eq!(all, [("vanilla", 5), ("vanilla", 6), ("pgsr", 5), ("ours", 5), ("ours", 6)]);
        assert_eq!(StudyJob { seeds_all: true, ..job.clone() }.trainings().len(), 6);
        assert!(job.check().is_err());
        let r = job.reconstruction(Path::new("c"), Path::new("d/c"), Method::Pgsr, 5);
        assert_eq!((r.output, r.settings.method), (PathBuf::from("d/c/pgsr_seed5.ply"), Method::Pgsr));
    }
}
