//! Runs cases one after the other and keeps what came out; a case that panics fails alone.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

use serde_json::{Value, json};

use crate::timing::processor_seconds;
use crate::{Case, Outcome, Row, Tier};

/// A case that ran.
#[derive(Clone, Debug, serde::Serialize)]
pub struct Finished {
    /// `V01` …
    pub id: &'static str,
    /// What was simulated.
    pub name: &'static str,
    /// Cost.
    pub tier: Tier,
    /// What a pass shows about the simulator.
    pub proves: &'static str,
    /// Geometry, grid, parameters.
    pub setup: &'static str,
    /// The reference.
    pub formula: &'static str,
    /// Wall time \[s\].
    pub seconds: f64,
    /// Processor time of all threads \[s\]; `None` where the system does not tell.
    pub core_seconds: Option<f64>,
    /// True when there is at least one row and every row is inside its tolerance.
    pub passed: bool,
    /// Why the case ended early.
    pub panic: Option<String>,
    /// Rows, figures, remarks.
    #[serde(flatten)]
    pub outcome: Outcome,
}

impl Finished {
    /// Rows inside their tolerance.
    pub fn rows_passed(&self) -> usize {
        self.outcome.rows.iter().filter(|r| r.passed()).count()
    }

    /// `V12 one-phase Stefan problem with points`.
    pub fn title(&self) -> String {
        format!("{} {}", self.id, self.name)
    }

    /// Largest |error| / tolerance of the rows that have a tolerance; `None` if there is none.
    pub fn worst(&self) -> Option<f64> {
        self.outcome.rows.iter().filter_map(margin).reduce(f64::max)
    }

    /// What a line of `--json` tells; figures stay in the file.
    pub fn brief(&self) -> Value {
        let row = |r: &Row| {
            json!({
                "quantity": r.quantity, "reference": r.reference, "ours": r.ours, "error": r.error(),
                "tolerance": r.tolerance, "passed": r.passed(),
            })
        };
        json!({
            "case": self.id, "name": self.name, "tier": self.tier, "passed": self.passed, "seconds": self.seconds,
            "core_seconds": self.core_seconds, "panic": self.panic, "notes": self.outcome.notes,
            "rows": self.outcome.rows.iter().map(row).collect::<Vec<_>>(),
        })
    }
}

/// |error| / tolerance, infinite for what is no number; `None` for a row that must be met exactly and is.
pub fn margin(row: &Row) -> Option<f64> {
    match row.tolerance {
        t if t > 0.0 => Some(row.error().abs() / t).map(|m| if m.is_nan() { f64::INFINITY } else { m }),
        _ if row.passed() => None,
        _ => Some(f64::INFINITY),
    }
}

/// Runs one case.
pub fn run(case: &Case) -> Finished {
    // The default hook would write into the table; the place of the panic belongs to the case.
    let place = Arc::new(Mutex::new(None));
    let seen = Arc::clone(&place);
    let hook = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |info| {
        // The first panic is the cause; others follow from it.
        seen.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert_with(|| info.to_string().replace('\n', " "));
    }));
    let (clock, processor) = (Instant::now(), processor_seconds());
    let outcome = catch_unwind(AssertUnwindSafe(case.run));
    let seconds = clock.elapsed().as_secs_f64();
    let core_seconds = processor_seconds().zip(processor).map(|(b, a)| b - a);
    std::panic::set_hook(hook);
    let panic = outcome.is_err().then(|| {
        let text = place.lock().unwrap_or_else(PoisonError::into_inner).take();
        text.unwrap_or_else(|| "the case panicked".into())
    });
    let outcome = outcome.unwrap_or_default();
    let passed = panic.is_none() && !outcome.rows.is_empty() && outcome.rows.iter().all(Row::passed);
    let &Case { id, name, tier, proves, setup, formula, .. } = case;
    Finished { id, name, tier, proves, setup, formula, seconds, core_seconds, passed, panic, outcome }
}

/// Runs `work` on `threads` worker threads, or on as many as there are cores.
pub fn in_pool<R: Send>(threads: Option<usize>, work: impl FnOnce() -> R + Send) -> R {
    match rayon::ThreadPoolBuilder::new().num_threads(threads.unwrap_or(0)).build() {
        Ok(pool) => pool.install(work),
        Err(_) => work(),
    }
}

/// Results of a whole run.
#[derive(Clone, Debug, serde::Serialize)]
pub struct Results {
    /// Version of the program.
    pub version: &'static str,
    /// Wall time of all cases \[s\].
    pub seconds: f64,
    /// Processor time of all cases \[s\].
    pub core_seconds: Option<f64>,
    /// The cases in the order of their ids.
    pub cases: Vec<Finished>,
}

impl Results {
    /// Collects the cases.
    pub fn new(cases: Vec<Finished>) -> Self {
        Self {
            version: env!("CARGO_PKG_VERSION"),
            seconds: cases.iter().map(|c| c.seconds).sum(),
            core_seconds: cases.iter().map(|c| c.core_seconds).sum(),
            cases,
        }
    }

    /// Titles of the cases that failed.
    pub fn failed(&self) -> Vec<String> {
        self.cases.iter().filter(|c| !c.passed).map(Finished::title).collect()
    }

    /// The figures that a machine asks for.
    pub fn summary(&self) -> Value {
        let failed = self.failed();
        json!({
            "total": self.cases.len(),
            "passed": self.cases.len() - failed.len(),
            "failed": failed,
            "rows": self.cases.iter().map(|c| c.outcome.rows.len()).sum::<usize>(),
            "rows_passed": self.cases.iter().map(Finished::rows_passed).sum::<usize>(),
            "seconds": self.seconds,
            "core_seconds": self.core_seconds,
        })
    }

    /// Everything, as kept in `validation.json`.
    pub fn to_json(&self) -> Value {
        let mut all = self.summary();
        all["version"] = self.version.into();
        all["cases"] = serde_json::to_value(&self.cases).unwrap_or_default();
        all
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_fails_its_case_alone() {
        fn bad() -> Outcome {
            panic!("node 7 has no mass")
        }
        fn empty() -> Outcome {
            Outcome::default()
        }
        fn good() -> Outcome {
            vec![Row::new("one", 1.0, 1.05, 0.1), Row::new("exact", 2.0, 2.0, 0.0)].into()
        }
        let cases =
            [Case::new("X1", "bad", Tier::A, bad), Case::new("X2", "empty", Tier::A, empty), Case::new("X3", "good", Tier::A, good)];
        let results = Results::new(cases.iter().map(run).collect());
        assert!(results.cases[0].panic.as_deref().unwrap().contains("node 7 has no mass"));
        assert!(results.cases[0].panic.as_deref().unwrap().contains("run.rs"), "the place is told");
        assert_eq!(results.failed(), ["X1 bad", "X2 empty"], "a case without rows proves nothing");
        assert!((results.cases[2].worst().unwrap() - 0.5).abs() < 1e-9);
        let summary = results.summary();
        assert_eq!((&summary["total"], &summary["passed"], &summary["rows"]), (&json!(3), &json!(1), &json!(2)));
        assert_eq!(results.to_json()["cases"][2]["rows"][0]["quantity"], "one");
    }

    #[test]
    fn not_a_number_is_no_margin_of_a_pass() {
        let row = Row::new("x", 0.0, f64::NAN, 1.0);
        assert!(!row.passed() && margin(&row).unwrap().is_infinite());
        assert!(margin(&Row::new("x", 1.0, 2.0, 0.0)).unwrap().is_infinite());
    }
}
