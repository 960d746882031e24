//! Wall and processor time of a training, over interruptions.

use std::time::Instant;

use serde_json::{Value, json};

/// Processor seconds of all threads of this process; `None` where the system does not tell.
fn processor_seconds() -> Option<f64> {
    let mut total = None;
    for task in std::fs::read_dir("/proc/self/task").ok()?.flatten() {
        // A thread may end while its neighbours are counted.
        let Ok(text) = std::fs::read_to_string(task.path().join("schedstat")) else { continue };
        let nanoseconds: Option<f64> = text.split_whitespace().next().and_then(|v| v.parse().ok());
        total = Some(total.unwrap_or(0.0) + nanoseconds.unwrap_or(0.0) * 1e-9);
    }
    total
}

/// Time spent since the training began, in this process and in those before it.
pub struct Clock {
    wall: Instant,
    processor: Option<f64>,
    before: (f64, Option<f64>),
}

impl Clock {
    /// Starts at zero.
    pub fn start() -> Self {
        Self { wall: Instant::now(), processor: processor_seconds(), before: (0.0, Some(0.0)) }
    }

    /// Goes on from what [`Clock::to_json`] gave; from zero if that is not it.
    pub fn resume(saved: &Value) -> Self {
        match saved["seconds"].as_f64() {
            Some(seconds) => Self { before: (seconds, saved["core_seconds"].as_f64()), ..Self::start() },
            None => Self::start(),
        }
    }

    /// Wall time \[s\].
    pub fn seconds(&self) -> f64 {
        self.before.0 + self.wall.elapsed().as_secs_f64()
    }

    /// Processor time of all threads \[s\].
    pub fn core_seconds(&self) -> Option<f64> {
        Some(self.before.1? + processor_seconds()? - self.processor?)
    }

    /// The time, for a resumed training.
    pub fn to_json(&self) -> Value {
        json!({ "seconds": self.seconds(), "core_seconds": self.core_seconds() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn time_goes_on_over_interruptions() {
        let c = Clock::resume(&json!({ "seconds": 100.0, "core_seconds": 150.0 }));
        assert!((100.0..110.0).contains(&c.seconds()));
        assert!(c.core_seconds().is_none_or(|s| (150.0..250.0).contains(&s)));
        // Not known before, not known now.
        assert!(Clock::resume(&json!({ "seconds": 100.0, "core_seconds": null })).core_seconds().is_none());
        let fresh = Clock::resume(&Value::Null);
        assert!(fresh.seconds() < 10.0 && fresh.core_seconds().is_some() == processor_seconds().is_some());
    }
}
