//! The log of a training: one JSON line for every hundred iterations (splatting.md §5.10).

use std::io::Write;
use std::path::PathBuf;

use megas_metrics::splats::{Consistency, Needles};
use megas_model::Splats;
use megas_reconstruct::StepReport;
use serde::{Deserialize, Serialize};
use serde_json::json;

use crate::Failure;
use crate::disk::{explain, write_text};

/// Largest permitted ratio of the two longest axes, `a` of the design.
pub const ASPECT: f64 = 2.0;

/// Iterations between two lines.
const EVERY: u32 = 100;

/// Sums since the last line.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Sums {
    steps: u32,
    loss: f64,
    l1: f64,
    ssim: f64,
    psnr: f64,
    cloned: usize,
    split: usize,
    pruned: usize,
    internal: usize,
}

/// A log being written.
pub struct TrainingLog {
    path: PathBuf,
    sums: Sums,
}

impl TrainingLog {
    /// Continues the log after iteration `done`, with the sums of that time: what a killed training wrote beyond it is taken back.
    pub fn open(path: PathBuf, done: u32, sums: Sums) -> Result<Self, Failure> {
        let step_of = |line: &str| serde_json::from_str::<serde_json::Value>(line).ok().and_then(|v| v["step"].as_u64());
        if let Ok(text) = std::fs::read_to_string(&path) {
            let kept: String = text.lines().filter(|l| step_of(l).is_some_and(|s| s <= u64::from(done))).flat_map(|l| [l, "\n"]).collect();
            if kept != text {
                write_text(&path, &kept)?;
            }
        }
        Ok(Self { path, sums })
    }

    /// What the next line will be made of.
    pub fn sums(&self) -> &Sums {
        &self.sums
    }

    /// Adds an iteration; every hundredth and the `last` one write a line.
    pub fn add(&mut self, r: &StepReport, splats: &Splats, last: bool) -> Result<(), Failure> {
        let s = &mut self.sums;
        s.steps += 1;
        s.loss += r.loss;
        s.l1 += r.l1;
        s.ssim += r.ssim;
        s.psnr += r.psnr;
        if let Some(refined) = &r.refined {
            s.cloned += refined.cloned;
            s.split += refined.split;
            s.pruned += refined.pruned;
        }
        s.internal += r.internal.map_or(0, |(n, _)| n);
        if !(r.step.is_multiple_of(EVERY) || last) {
            return Ok(());
        }
        let s = std::mem::take(s);
        let n = f64::from(s.steps);
        let needles = Needles::new(splats, ASPECT).plain;
        let line = json!({
            "step": r.step,
            "loss": s.loss / n,
            "l1": s.l1 / n,
            "ssim": s.ssim / n,
            "psnr": s.psnr / n,
            "gaussians": r.gaussians,
            "cloned": s.cloned,
            "split": s.split,
            "pruned": s.pruned,
            "pruned_internal": s.internal,
            "needle_p50": needles.p50,
            "needle_p90": needles.p90,
            "needle_p99": needles.p99,
            "area_cv": Consistency::new(splats).area.cv,
        });
        let mut file =
            std::fs::OpenOptions::new().create(true).append(true).open(&self.path).map_err(|e| explain("open", &self.path, &e))?;
        file.write_all(format!("{line}\n").as_bytes()).map_err(|e| explain("write", &self.path, &e))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_resumed_log_has_every_line_once() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("log.jsonl");
        let mut splats = Splats::default();
        splats.push([0.0; 3], [0.0, -1.0, -2.0], [1.0, 0.0, 0.0, 0.0], 0.0, &[0.0; 3]);
        let run = |from: u32, to: u32, sums: Sums| {
            let mut log = TrainingLog::open(path.clone(), from, sums).unwrap();
            for step in from + 1..=to {
                log.add(
                    &StepReport { step, loss: f64::from((step - 1) / 100 + 1), gaussians: 1, ..Default::default() },
                    &splats,
                    step == 350,
                )
                .unwrap();
            }
            log.sums().clone()
        };
        let sums = run(0, 210, Sums::default());
        run(210, 320, sums.clone());
        std::fs::write(&path, std::fs::read_to_string(&path).unwrap() + "{\"step\": 4").unwrap();
        run(210, 350, sums);
        let text = std::fs::read_to_string(&path).unwrap();
        let lines: Vec<serde_json::Value> = text.lines().map(|l| serde_json::from_str(l).unwrap()).collect();
        let steps: Vec<u64> = lines.iter().filter_map(|v| v["step"].as_u64()).collect();
        assert_eq!(steps, [100, 200, 300, 350]);
        // Means over all iterations of their hundred, whenever they were done.
        assert!(lines.iter().all(|v| v["loss"] == v["step"].as_f64().map_or(0.0, |s| (s - 1.0) / 100.0).floor() + 1.0), "{text}");
    }
}
