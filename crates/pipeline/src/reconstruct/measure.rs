//! What is known about reconstructed splats besides their pictures (splatting.md §9.3 M2–M5).

use std::path::Path;

use megas_formats::read_mesh_ply;
use megas_metrics::splats::SplatReport;
use megas_metrics::surface::{MeshDistance, hidden_fraction};
use megas_model::Splats;
use megas_reconstruct::Region;

use super::log::ASPECT;
use crate::Failure;

/// Blend weight below which a Gaussian counts as hidden.
pub const HIDDEN: f32 = 0.1;

/// Index of the depth 0.02 L among those at which floaters are counted.
pub const TWO_PERCENT: usize = 1;

/// The true surface of a synthetic capture, where there is one: `mesh/whole.ply`.
pub fn true_surface(capture: &Path) -> Result<Option<MeshDistance>, Failure> {
    let path = capture.join("mesh").join("whole.ply");
    if !path.is_file() {
        return Ok(None);
    }
    let mesh = read_mesh_ply(&path).map_err(|e| Failure::Input(e.to_string()))?;
    MeshDistance::new(&mesh).map(Some).map_err(|e| Failure::Input(format!("{}: {e}", path.display())))
}

/// Measures the Gaussians of the object: those in `region`, or all. `w_max` holds the largest blend weights over the
/// training views. Returns the report and the fraction of hidden ones.
pub fn measure(splats: &Splats, w_max: &[f32], region: Option<&Region>, surface: Option<&MeshDistance>) -> (SplatReport, f64) {
    let inside: Vec<usize> = match region {
        Some(r) => (0..splats.len()).filter(|&i| r.contains(splats.mean[i], 1.0)).collect(),
        None => (0..splats.len()).collect(),
    };
    // A box that holds nothing says nothing.
    let inside = if inside.is_empty() { (0..splats.len()).collect() } else { inside };
    let weights: Vec<f32> = inside.iter().map(|&i| w_max[i]).collect();
    (SplatReport::new(&splats.select(&inside), ASPECT, surface), hidden_fraction(&weights, HIDDEN))
}
