//! `reconstruct --dry-run`: what would be trained, in what memory, in about what time.

use megas_reconstruct::Method;
use serde_json::{Value, json};

use super::data::TrainingData;
use super::places::Places;
use super::settings::ReconstructJob;
use crate::Failure;
use crate::run::in_pool;

/// Core-seconds of an iteration: in any case, per pixel of a view and per Gaussian.
const CORE_S: [f64; 3] = [0.01, 1.5e-7, 5.0e-7];
/// Gaussians of a scene with its surroundings.
const SURROUNDINGS: usize = 250_000;
/// Bytes per Gaussian (parameters, gradients, two moments, lists) and per pixel of a view while it is trained on.
const BYTES_PER_GAUSSIAN: f64 = 1500.0;
const BYTES_PER_PIXEL: f64 = 300.0;

/// Estimate of the time of a training \[s\].
pub fn training_seconds(iterations: u32, pixels: f64, gaussians: f64, threads: f64) -> f64 {
    (f64::from(iterations) * (CORE_S[0] + CORE_S[1] * pixels + CORE_S[2] * gaussians) / threads).round()
}

/// Estimate of the memory of a training whose views take `bytes` \[MiB\].
pub fn memory_mib(bytes: f64, pixels: f64, gaussians: f64) -> f64 {
    ((bytes + gaussians * BYTES_PER_GAUSSIAN + pixels * BYTES_PER_PIXEL) / f64::from(1 << 20)).round()
}

/// Describes a reconstruction without doing it. The photographs are loaded, so bad ones are found.
pub fn plan_reconstruct(job: &ReconstructJob) -> Result<Value, Failure> {
    in_pool(job.threads, || plan_here(job))
}

/// As [`plan_reconstruct`] in the current pool of threads.
fn plan_here(job: &ReconstructJob) -> Result<Value, Failure> {
    let places = Places::new(&job.output)?;
    let data = TrainingData::load(job, &|| false)?;
    // With `force` a training of other settings would be removed here.
    if !job.force {
        places.open(data.key.clone(), false)?;
    }
    let photos = || data.capture.train.iter().chain(&data.capture.test);
    let bytes: usize = photos().map(|p| p.pixels.len() + p.mask.as_ref().map_or(0, Vec::len)).sum();
    let pixels = photos().map(|p| f64::from(p.camera.width) * f64::from(p.camera.height)).fold(0.0, f64::max);
    let o = &data.options;
    let most = o.refinement.map_or(data.start.len(), |r| r.most);
    let expected = match o.least_cover() {
        Some(least) if o.method == Method::Ours && data.transparent() => 2 * least,
        _ if data.transparent() => 2 * data.start.len(),
        // Surroundings take what they get.
        _ => SURROUNDINGS.max(10 * data.start.len()),
    };
    let expected = expected.max(data.start.len() / 2).min(most) as f64;
    let threads = job.threads.unwrap_or_else(rayon::current_num_threads) as f64;
    let seconds = training_seconds(o.iterations, pixels, expected, threads);
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
        "memory_mib_estimate": memory_mib(bytes as f64, pixels, expected),
        "train_s_estimate": seconds,
        "remarks": data.capture.notes,
    }))
}
