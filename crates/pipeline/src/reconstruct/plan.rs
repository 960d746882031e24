//! `reconstruct --dry-run`: what would be trained, in what memory, in about what time.

use megas_reconstruct::Method;
use serde_json::{Value, json};

use super::Places;
use super::data::TrainingData;
use super::settings::ReconstructJob;
use crate::Failure;
use crate::run::in_pool;
use crate::stage::StageDir;

/// Core-seconds of an iteration: per pixel of a view and per Gaussian.
const CORE_S_PER_PIXEL: f64 = 3.0e-7;
const CORE_S_PER_GAUSSIAN: f64 = 1.0e-6;
/// Bytes per Gaussian (parameters, gradients, two moments, lists) and per pixel of a view while it is trained on.
const BYTES_PER_GAUSSIAN: f64 = 1500.0;
const BYTES_PER_PIXEL: f64 = 300.0;

/// Describes a reconstruction without doing it. The photographs are loaded, so bad ones are found.
pub fn plan_reconstruct(job: &ReconstructJob) -> Result<Value, Failure> {
    in_pool(job.threads, || {
        let places = Places::new(&job.output)?;
        let data = TrainingData::load(job)?;
        // With `force` a training of other settings would be removed here.
        if !job.force {
            let (_, found) = StageDir::open_at(places.folder.clone(), false, data.key.clone())?;
            if !matches!(found, crate::stage::Found::Done(_)) {
                places.check(&found, false)?;
            }
        }
        let photos = || data.capture.train.iter().chain(&data.capture.test);
        let bytes: usize = photos().map(|p| p.pixels.len() + p.mask.as_ref().map_or(0, Vec::len)).sum();
        let pixels = photos().map(|p| f64::from(p.camera.width) * f64::from(p.camera.height)).fold(0.0, f64::max);
        let o = &data.options;
        let most = o.refinement.map_or(data.start.len(), |r| r.most);
        let expected = match o.least_cover() {
            Some(least) if o.method == Method::Ours => 3 * least,
            _ => 4 * data.start.len(),
        };
        let expected = expected.max(data.start.len() / 2).min(most) as f64;
        let threads = job.threads.unwrap_or_else(rayon::current_num_threads) as f64;
        let per_iteration = CORE_S_PER_PIXEL * pixels + CORE_S_PER_GAUSSIAN * expected;
        let first = &data.capture.train[0].camera;
        Ok(json!({
            "stages": ["load", "train", "evaluate"],
            "output": places.output.display().to_string(),
            "folder": places.folder.display().to_string(),
            "capture": data.capture.kind,
            "method": o.method.name(),
            "profile": job.settings.profile.name(),
            "iterations": o.iterations,
            "views": data.capture.train.len(),
            "test_views": data.capture.test.len(),
            "size": [first.width, first.height],
            "extent": o.extent,
            "object_box": o.region.map(|r| json!({ "center": r.center, "half_extent": r.half })),
            "scale_limit": o.scale_limit,
            "seeds": data.start.len(),
            "max_gaussians": most,
            "gaussians_estimate": expected,
            "threads": threads,
            "memory_mib_estimate": ((bytes as f64 + expected * BYTES_PER_GAUSSIAN + pixels * BYTES_PER_PIXEL) / f64::from(1 << 20)).round(),
            "train_s_estimate": (per_iteration * f64::from(o.iterations) / threads).round(),
            "remarks": data.capture.notes,
        }))
    })
}
