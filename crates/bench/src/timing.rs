//! Wall and process-CPU clocks, medians, and the keys every scene prints.

use std::time::Instant;

/// CPU seconds (user + system, all threads) that this process has used; from the kernel's accounting, 10 ms resolution
/// where nothing finer exists.
pub fn cpu_seconds() -> f64 {
    // Linux: the scheduler's nanosecond counters of every thread; summed, they also count the work of the pool.
    let mut total = 0.0;
    if let Ok(tasks) = std::fs::read_dir("/proc/self/task") {
        for t in tasks.flatten() {
            if let Ok(s) = std::fs::read_to_string(t.path().join("schedstat")) {
                total += s.split_whitespace().next().and_then(|v| v.parse::<f64>().ok()).unwrap_or(0.0) * 1e-9;
            }
        }
    }
    total
}

/// Runs `work` once and returns `(wall, cpu)` seconds.
pub fn measure(work: impl FnOnce()) -> (f64, f64) {
    let (t, c) = (Instant::now(), cpu_seconds());
    work();
    (t.elapsed().as_secs_f64(), cpu_seconds() - c)
}

/// Median; `values` must not be empty.
pub fn median(values: &[f64]) -> f64 {
    let mut v = values.to_vec();
    v.sort_by(f64::total_cmp);
    v[v.len() / 2]
}

/// One-minute load average, or 0 where the system does not tell.
pub fn load() -> f64 {
    std::fs::read_to_string("/proc/loadavg").ok().and_then(|s| s.split_whitespace().next().and_then(|v| v.parse().ok())).unwrap_or(0.0)
}
