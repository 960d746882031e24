//! Wall and process-CPU clocks, medians, and the keys every scene prints.

pub use megas_validation::timing::{measure, median};

/// One-minute load average, or 0 where the system does not tell.
pub fn load() -> f64 {
    std::fs::read_to_string("/proc/loadavg").ok().and_then(|s| s.split_whitespace().next().and_then(|v| v.parse().ok())).unwrap_or(0.0)
}
