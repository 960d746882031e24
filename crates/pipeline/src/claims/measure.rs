//! One method on one object: M1–M8, M10, M11 (splatting.md §9.3), and its pictures for the sheet.

use std::path::{Path, PathBuf};
use std::time::Instant;

use megas_film::write_png;
use megas_formats::load_splats;
use megas_metrics::deform::{Carry, Deformation};
use megas_metrics::fidelity::draw;
use megas_metrics::splats::{Needles, SplatReport};
use megas_raster::{Frame, Rasterizer};
use megas_skin::{DEPTH_IN_PIXELS, bake_splats};
use serde_json::{Map, Value, json};

use super::coherence::coherence;
use super::mesh::meshes;
use super::methods::Contender;
use super::model::{Filled, filled, posed};
use super::truth::Truth;
use super::{SHEET_MODE, Scope};
use crate::reconstruct::ASPECT;
use crate::{Event, Failure, Sink};

/// The rows of a deformed model: at rest and D1 to D6.
pub fn states() -> impl Iterator<Item = Deformation> {
    std::iter::once(Deformation::Rest).chain(Deformation::ALL)
}

/// Where the picture of a deformation is.
pub fn tile(folder: &Path, d: Deformation) -> PathBuf {
    folder.join(format!("{}.png", d.id()))
}

/// Measures a method. `trained` holds the figures of its training.
pub fn measure(
    method: Contender,
    model: &Path,
    trained: &Value,
    truth: &mut Truth,
    scope: &Scope,
    folder: &Path,
    sink: &dyn Sink,
) -> Result<Value, Failure> {
    let begin = Instant::now();
    let mut splats = load_splats(model).map_err(|e| Failure::Input(e.to_string()))?.splats;
    if method.least_opacity() > 0.0 {
        let keep: Vec<usize> = (0..splats.len()).filter(|&i| splats.opacity(i) > method.least_opacity()).collect();
        splats = splats.select(&keep);
    }
    // Ours knows how large the pixels were that it was trained on; the others are drawn as they are in the literature.
    splats.trained_pixel = vec![if method.knows_pixels() { truth.pixel as f32 } else { 0.0 }; splats.len()];
    let report = SplatReport::new(&splats, ASPECT, Some(&truth.surface));
    let mut own = filled(&splats, method.fills_by_density(), &truth.surface, truth.volume);
    own.depth = DEPTH_IN_PIXELS * truth.pixel;
    if let Some(why) = &own.failed {
        sink.event(Event::Note(&format!("{}: {why}", method.id())));
    }
    // How much of the gap between the fillings is the model's.
    let by_rays = (method == Contender::B0).then(|| filled(&splats, false, &truth.surface, truth.volume).quality);
    // B6 has the mesh of B5.
    let meshes = (method == Contender::B5).then(|| meshes(&own, truth));
    let coherence = (method == Contender::B6).then(|| coherence(&own, truth));
    let mut deformed = Map::new();
    let mut rasterizer = Rasterizer::new();
    for (k, d) in states().enumerate() {
        let mut modes = Map::new();
        for &mode in &scope.modes {
            // At rest all modes are the same.
            if d == Deformation::Rest && mode != SHEET_MODE {
                continue;
            }
            if sink.cancelled() {
                return Err(Failure::Interrupted(format!("stopped at {}; run the same command again to go on", method.id())));
            }
            let figures = one(method, &own, truth, d, mode, scope, folder, &mut rasterizer)?;
            modes.insert(mode.name().to_owned(), figures);
        }
        deformed.insert(d.id().to_owned(), Value::Object(modes));
        sink.event(Event::Step { done: k as u64 + 1 });
    }
    Ok(json!({
        "method": method.id(),
        "name": method.name(),
        "training": method.training().name(),
        "psnr": trained["psnr"],
        "ssim": trained["ssim"],
        "flip": trained["flip"],
        "gaussians": splats.len(),
        "splats": report,
        "filling": own.quality,
        "filling_by": if method.fills_by_density() { "density field" } else { "rays" },
        "filling_by_rays": by_rays,
        "filling_failed": own.failed,
        "internal": own.particles.len(),
        "meshes": meshes,
        "coherence": coherence,
        "deformed": deformed,
        "seconds": begin.elapsed().as_secs_f64(),
    }))
}

/// One deformation: cracks, fidelity, needles, and how many Gaussians are drawn.
fn one(
    method: Contender,
    model: &Filled,
    truth: &mut Truth,
    d: Deformation,
    mode: Carry,
    scope: &Scope,
    folder: &Path,
    rasterizer: &mut Rasterizer,
) -> Result<Value, Failure> {
    let stage = truth.stage;
    let gaussians = posed(method, model, &stage, d, mode);
    let state = truth.state(d);
    if mode == SHEET_MODE {
        let image = draw(&gaussians, &state.portrait.camera, rasterizer, &mut Frame::default());
        write_png(tile(folder, d), &image, true).map_err(|e| Failure::Other(e.to_string()))?;
    }
    // Kernels of the inside are round: needles are a matter of the surface.
    let shown = gaussians.len();
    let mut surface = gaussians.clone();
    surface.truncate(model.surface.len());
    let needles = Needles::new(&bake_splats(&surface, model.surface.len()), ASPECT).plain;
    Ok(json!({
        "cracks": state.cracks.measure(&gaussians),
        "fidelity": state.views.measure(&gaussians, scope.perceptual, rasterizer),
        "needle_p99": needles.p99,
        "needles_above_2a": needles.above_2_a,
        "drawn": shown,
    }))
}
