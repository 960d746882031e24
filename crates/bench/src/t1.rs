//! Training iterations on the synthetic ice cream: all views shuffled with a fixed seed, a fixed number of splats, no
//! refinement, L1 + D-SSIM + Adam.

use std::path::PathBuf;

use megas_capture::{Options as Loading, extent, load, seeds};
use megas_metrics::image::psnr;
use megas_reconstruct::{Method, Options, Profile, Trainer, Weights, initial_splats};
use serde_json::json;

use crate::timing;

/// Options.
#[derive(clap::Args)]
pub struct Args {
    /// Threads of the pool
    #[arg(long, default_value_t = 1)]
    threads: usize,
    /// Capture to train on
    #[arg(long, default_value = "../shared/data/synthetic_icecream")]
    data: PathBuf,
    /// Splats
    #[arg(long, default_value_t = 30_000)]
    n: usize,
    /// Iterations before the timed ones
    #[arg(long, default_value_t = 100)]
    warm_up: usize,
    /// Timed batches of 50 iterations
    #[arg(long, default_value_t = 6)]
    reps: usize,
}

/// Iterations per timed batch.
const BATCH: u32 = 50;

/// Runs the scene and returns its JSON line.
pub fn run(args: &Args) -> String {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(args.threads).build().map_err(|e| e.to_string());
    let result = pool.and_then(|pool| pool.install(|| train(args)));
    result.unwrap_or_else(|message| json!({ "scene": "t1", "error": message }).to_string())
}

fn train(args: &Args) -> Result<String, String> {
    let capture = load(&args.data, &Loading::default()).map_err(|e| e.to_string())?;
    let start = initial_splats(&seeds(&capture, args.n, 1));
    let size = [capture.train[0].camera.width, capture.train[0].camera.height];
    let mut options = Options::new(Method::Vanilla, Profile::Object, extent(capture.train.iter().map(|p| &p.camera)), None, true, None);
    options.refinement = None;
    options.weights = Weights { alpha: 0.0, ..options.weights };
    let count = start.len();
    let mut trainer = Trainer::new(capture.train, start, options);
    for _ in 0..args.warm_up {
        trainer.step();
    }
    let (mut wall, mut cpu) = (Vec::new(), Vec::new());
    for _ in 0..args.reps.max(1) {
        let (w, c) = timing::measure(|| {
            for _ in 0..BATCH {
                trainer.step();
            }
        });
        wall.push(w / f64::from(BATCH));
        cpu.push(c / f64::from(BATCH));
    }
    let mut sum = 0.0;
    for photo in &capture.test {
        let mut truth = photo.to_image();
        truth.data = truth.data.chunks_exact(4).flat_map(|p| [0, 1, 2].map(|k| p[k] * p[3] + 1.0 - p[3])).collect();
        truth.channels = 3;
        sum += psnr(&trainer.render(&photo.camera, [1.0; 3]), &truth, None);
    }
    Ok(json!({
        "scene": "t1",
        "threads": args.threads,
        "reps": wall.len(),
        "size": size,
        "splats": count,
        "iterations": trainer.step_count(),
        "median_wall_s": timing::median(&wall),
        "median_cpu_s": timing::median(&cpu),
        "core_s_per_iteration": timing::median(&cpu),
        "wall_s_per_iteration": timing::median(&wall),
        "psnr_after": sum / capture.test.len().max(1) as f64,
        "load": timing::load(),
        "simd": format!("{:?}", fearless_simd::Level::new()).split('(').next().unwrap_or_default(),
        "version": env!("CARGO_PKG_VERSION"),
    })
    .to_string())
}
