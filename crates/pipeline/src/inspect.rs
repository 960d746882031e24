//! `inspect`: what is in a splat file.

use std::path::Path;

use megas_formats::{RenderMode, load_splats};
use serde_json::{Value, json};

use crate::Failure;

/// Reads a splat file and describes it: count, degree, box, what was dropped, and what matters for melting it.
pub fn inspect(path: &Path) -> Result<Value, Failure> {
    let file = load_splats(path).map_err(|e| Failure::Input(e.to_string()))?;
    let (s, r) = (&file.splats, &file.report);
    let (lo, hi) = s.bounds().unwrap_or_default();
    let mut opacity: Vec<f32> = (0..s.len()).map(|i| s.opacity(i)).collect();
    let mut aspect: Vec<f32> = (0..s.len())
        .map(|i| {
            let mut l = s.log_scale[i];
            l.sort_by(|a, b| b.total_cmp(a));
            (l[0] - l[1]).exp()
        })
        .collect();
    let temperature = s.temperature.iter().fold([f32::INFINITY, f32::NEG_INFINITY], |m, &t| [m[0].min(t), m[1].max(t)]);
    let mode = match r.render_mode {
        RenderMode::Default => "default",
        RenderMode::Mip => "mip",
        RenderMode::Flat => "2dgs",
    };
    Ok(json!({
        "file": path.display().to_string(),
        "format": r.format.to_string(),
        "count": r.count,
        "dropped": r.dropped_non_finite,
        "sh_degree": r.sh_degree,
        "bbox": {"min": lo, "max": hi},
        "visible_bbox": robust_box(s),
        "opacity": {"p10": quantile(&mut opacity, 0.1), "p50": quantile(&mut opacity, 0.5), "p90": quantile(&mut opacity, 0.9)},
        "needle": {"p50": quantile(&mut aspect, 0.5), "p99": quantile(&mut aspect, 0.99)},
        "render_mode": mode,
        "antialiased": r.antialiased,
        "temperature_k": r.has_temperature.then_some(temperature),
    }))
}

/// Box of the 1–99 % quantiles of the means of what can be seen (opacity above 0.1).
fn robust_box(s: &megas_model::Splats) -> Value {
    let seen: Vec<usize> = (0..s.len()).filter(|&i| s.opacity(i) > 0.1).collect();
    let side = |q: f64| -> [f32; 3] {
        std::array::from_fn(|a| {
            let mut v: Vec<f32> = seen.iter().map(|&i| s.mean[i][a]).collect();
            quantile(&mut v, q)
        })
    };
    json!({"min": side(0.01), "max": side(0.99)})
}

fn quantile(v: &mut [f32], q: f64) -> f32 {
    if v.is_empty() {
        return f32::NAN;
    }
    let k = ((v.len() - 1) as f64 * q).round() as usize;
    *v.select_nth_unstable_by(k, f32::total_cmp).1
}
