//! Wall and processor clocks, medians.

use std::time::Instant;

/// Processor seconds of all threads that this process has now, to the nanosecond; 0 where the system does not tell.
fn cpu_seconds() -> f64 {
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

/// Runs `work` once and returns wall and processor seconds.
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

/// Processor time of this process \[s\], to the hundredth. Threads that have ended count too: cases make their own pools.
pub(crate) fn processor_seconds() -> Option<f64> {
    /// Clock ticks per second in `/proc`, the same on every Linux.
    const TICKS: f64 = 100.0;
    let text = std::fs::read_to_string("/proc/self/stat").ok()?;
    // The name of the program, in parentheses, may hold spaces.
    let mut fields = text.rsplit_once(')')?.1.split_whitespace().skip(11);
    let mut next = || fields.next()?.parse::<f64>().ok();
    Some((next()? + next()?) / TICKS)
}
