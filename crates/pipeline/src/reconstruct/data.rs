//! The data of a training: views, first splats, the object's box, and what tells one capture from another.

use std::path::Path;

use megas_capture::{Capture, CaptureError, Options as Loading, Photo, extent, load_unless, seeds};
use megas_math::vec3;
use megas_model::Splats;
use megas_reconstruct::{Options, Region, initial_splats};

use super::settings::{ReconstructJob, ReconstructSettings, trainer_options};
use crate::Failure;
use crate::stage::KeyBuilder;

/// Points that the hull is estimated from.
const HULL_POINTS: usize = 8_000;
/// Share of the points on either side that does not count for the box, and how much larger the box is made.
const ROBUST: (f64, f32) = (0.005, 1.05);
/// Largest share of hull points that some view sees through; more means that there is no hull.
const SEEN_THROUGH: f64 = 0.3;
/// Largest `scene.json` that is read \[bytes\].
const MOST_JSON: u64 = 1 << 20;

/// Everything a training starts from.
pub struct TrainingData {
    /// Views to train on and to test with.
    pub capture: Capture,
    /// The first splats.
    pub start: Splats,
    /// The trainer's options.
    pub options: Options,
    /// What all of this was made from; equal keys give equal trainings.
    pub key: String,
}

impl TrainingData {
    /// Loads the capture of a job and prepares its training, unless `stopped`; writes nothing.
    pub fn load(job: &ReconstructJob, stopped: &(dyn Fn() -> bool + Sync)) -> Result<Self, Failure> {
        let s = &job.settings;
        if !(job.memory_gib > 0.0 && job.memory_gib.is_finite()) {
            return Err(Failure::Input(format!("memory budget: found {} GiB, expected more than 0", job.memory_gib)));
        }
        let loading = Loading {
            downscale: s.downscale,
            eval_every: s.eval_every,
            memory_budget_bytes: (job.memory_gib * f64::from(1 << 30)) as u64,
            ..Loading::default()
        };
        let mut capture = load_unless(&job.capture, &loading, stopped).map_err(refused)?;
        if capture.points.is_none() && s.seeds_count == 0 {
            return Err(Failure::Input("seeds-count: found 0, expected at least 1, for the capture has no points".into()));
        }
        let region = object_region(&job.capture, &mut capture, s)?;
        let transparent = capture.train.iter().all(|p| p.channels == 4);
        let mut options = trainer_options(s, extent(capture.train.iter().map(|p| &p.camera)), region, transparent)?;
        options.suit(&capture.train, capture.points.as_ref().map(|c| &c.position[..]));
        if let (Some(r), Some(most)) = (&mut options.refinement, s.max_gaussians) {
            r.most = most;
        }
        // More than there may be in the end would only be thinned out.
        let count = options.refinement.map_or(s.seeds_count, |r| s.seeds_count.min(r.most));
        let start = initial_splats(&seeds(&capture, count, s.seed));
        if start.is_empty() {
            return Err(Failure::Input(format!("{}: nothing to begin with: the views show no common place", job.capture.display())));
        }
        let key = key(&capture, &start, &options)?;
        Ok(Self { capture, start, options, key })
    }

    /// True if all photographs have alpha.
    pub fn transparent(&self) -> bool {
        self.capture.train.iter().all(|p| p.channels == 4)
    }
}

/// What a capture's error means for the command.
pub(crate) fn refused(error: CaptureError) -> Failure {
    match error {
        CaptureError::Stopped => Failure::Interrupted(error.to_string()),
        _ => Failure::Input(error.to_string()),
    }
}

/// Names the training: options, views with their pixels, first splats.
fn key(capture: &Capture, start: &Splats, options: &Options) -> Result<String, Failure> {
    let mut key = KeyBuilder::new("train").settings(options)?;
    for (role, photos) in [("train", &capture.train), ("test", &capture.test)] {
        key = key.text(role);
        for p in photos {
            key = key.text(&p.name).settings(&p.camera)?.bytes(&p.pixels).bytes(p.mask.as_deref().unwrap_or_default());
        }
    }
    Ok(key.bytes(bytemuck::cast_slice(&start.mean)).bytes(bytemuck::cast_slice(&start.sh)).finish())
}

/// Where the object is: as told, inside its mattes, or as the `scene.json` beside the photographs says.
fn object_region(folder: &Path, capture: &mut Capture, s: &ReconstructSettings) -> Result<Option<Region>, Failure> {
    if let Some(r) = s.object_box {
        if !r.center.iter().all(|v| v.is_finite()) || !r.half.iter().all(|v| *v > 0.0 && v.is_finite()) {
            let found = format!("centre {:?} and half extents {:?}", r.center, r.half);
            return Err(Failure::Input(format!("object box: found {found}, expected finite numbers and positive extents")));
        }
        return Ok(Some(r));
    }
    if capture.train.iter().all(|p| p.channels == 4) {
        return Ok(hull_box(capture, s.seed));
    }
    stated_box(&folder.join("scene.json"))
}

/// The box of what no view sees through; `None` if the mattes leave nothing.
fn hull_box(capture: &mut Capture, seed: u64) -> Option<Region> {
    // Points that came with the poses would be taken as they are.
    let points = capture.points.take();
    let hull = seeds(capture, HULL_POINTS, seed).position;
    capture.points = points;
    let through = hull.iter().filter(|x| capture.train.iter().any(|p| sees_through(p, **x))).count();
    if hull.is_empty() || through as f64 > SEEN_THROUGH * hull.len() as f64 {
        return None;
    }
    let quantiles = |axis: usize| {
        let mut v: Vec<f32> = hull.iter().map(|x| x[axis]).collect();
        v.sort_by(f32::total_cmp);
        let at = |q: f64| v[((v.len() - 1) as f64 * q).round() as usize];
        [at(ROBUST.0), at(1.0 - ROBUST.0)]
    };
    let [x, y, z] = [0, 1, 2].map(quantiles);
    let mut region = Region::aligned([x[0], y[0], z[0]], [x[1], y[1], z[1]]);
    region.half = region.half.map(|h| ROBUST.1 * h);
    (region.half.iter().all(|h| *h > 0.0)).then_some(region)
}

/// True if a view shows `x` in front of a wholly transparent pixel.
fn sees_through(photo: &Photo, x: [f32; 3]) -> bool {
    let c = &photo.camera;
    let p = c.to_camera(x);
    if p[2].is_nan() || p[2] <= 0.0 {
        return false;
    }
    let [u, v] = c.project(p);
    if !(u >= 0.0 && v >= 0.0 && u < c.width as f32 && v < c.height as f32) {
        return false;
    }
    let i = v as usize * c.width as usize + u as usize;
    photo.mask.as_ref().is_none_or(|m| m[i] > 0) && photo.pixels[4 * i + 3] == 0
}

/// `object_box` of a `scene.json`; `None` where there is no such file or key.
fn stated_box(path: &Path) -> Result<Option<Region>, Failure> {
    let Ok(meta) = std::fs::metadata(path) else { return Ok(None) };
    if !meta.is_file() || meta.len() > MOST_JSON {
        return Ok(None);
    }
    let text = std::fs::read(path).map_err(|e| crate::disk::explain("read", path, &e))?;
    let bad = |what: String| {
        let shape = "object_box = {center: [x, y, z], axes: three unit vectors, half_extent: [x, y, z]}";
        Failure::Input(format!("{}: {what}, expected {shape}; correct it or give --object-box", path.display()))
    };
    let json: serde_json::Value = serde_json::from_slice(&text).map_err(|e| bad(format!("not JSON ({e})")))?;
    let Some(b) = json.get("object_box") else { return Ok(None) };
    let triple = |v: &serde_json::Value| -> Option<[f32; 3]> {
        let a = v.as_array().filter(|a| a.len() == 3)?;
        let [x, y, z] = [0, 1, 2].map(|k| a[k].as_f64().map(|v| v as f32));
        Some([x?, y?, z?])
    };
    let center = triple(&b["center"]).ok_or_else(|| bad("object_box.center cannot be used".into()))?;
    let half = triple(&b["half_extent"])
        .filter(|h| h.iter().all(|v| *v > 0.0))
        .ok_or_else(|| bad("object_box.half_extent cannot be used".into()))?;
    let axes = match b.get("axes").and_then(|a| a.as_array()) {
        None => Region::aligned([0.0; 3], [0.0; 3]).axes,
        Some(rows) => {
            let rows: Vec<[f32; 3]> = rows.iter().filter_map(triple).filter(|r| (vec3::norm(*r) - 1.0).abs() < 1e-2).collect();
            let across = |i: usize, j: usize| vec3::dot(rows[i], rows[j]).abs() < 1e-2;
            match rows[..] {
                [x, y, z] if across(0, 1) && across(1, 2) && across(0, 2) => [x, y, z],
                _ => return Err(bad("object_box.axes cannot be used".into())),
            }
        }
    };
    Ok(Some(Region { center, axes, half }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stated_box_is_read_or_explained() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("scene.json");
        assert_eq!(stated_box(&path).unwrap(), None);
        std::fs::write(&path, r#"{"up": [0, 0, 1]}"#).unwrap();
        assert_eq!(stated_box(&path).unwrap(), None);
        let text = r#"{"object_box": {"center": [1, 2, 3], "axes": [[0, 1, 0], [1, 0, 0], [0, 0, -1]], "half_extent": [1, 2, 0.5]}}"#;
        std::fs::write(&path, text).unwrap();
        let r = stated_box(&path).unwrap().unwrap();
        assert_eq!((r.center, r.half, r.axes[0]), ([1.0, 2.0, 3.0], [1.0, 2.0, 0.5], [0.0, 1.0, 0.0]));
        for wrong in ["{", r#"{"object_box": 3}"#, &text.replace("0.5", "-1"), &text.replace("[1, 0, 0]", "[0, 1, 0]")] {
            std::fs::write(&path, wrong).unwrap();
            assert!(stated_box(&path).is_err_and(|e| e.to_string().contains("--object-box")), "{wrong}");
        }
    }
}
