//! Captures made by photographing ground-truth assets, and sinks that stop.

#![allow(dead_code)] // Every test binary uses its own part.

use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};

use megas_math::{mat3, vec3};
use megas_metrics::assets::{Solid, camera_rig, photograph};
use megas_model::{Camera, Projection, fibonacci_directions};
use megas_pipeline::{Event, Sink};
use serde_json::{Value, json};

/// Photographs `solid` from `train` + `test` places above it.
pub fn capture(folder: &Path, solid: &impl Solid, train: usize, test: usize, side: u32) {
    write(folder, solid, &camera_rig(solid.bounds(), train, test, side, side), test);
}

/// Photographs `solid` from `train` + `test` places all around it.
pub fn capture_around(folder: &Path, solid: &impl Solid, train: usize, test: usize, side: u32) {
    let (lo, hi) = solid.bounds();
    let centre = vec3::scale(vec3::add(lo, hi), 0.5);
    let distance = 2.0 * vec3::norm(vec3::sub(hi, lo));
    let at = |d: [f32; 3]| Camera::look_at(vec3::add_scaled(centre, d, distance), centre, [0.1, 0.2, 1.0], 0.6, side, side);
    let cameras: Vec<Camera> = fibonacci_directions(train).into_iter().chain(fibonacci_directions(test)).map(at).collect();
    write(folder, solid, &cameras, test);
}

/// A folder with `transforms_train.json` and `transforms_test.json`, for the last `test` cameras.
fn write(folder: &Path, solid: &impl Solid, cameras: &[Camera], test: usize) {
    std::fs::create_dir_all(folder.join("images")).unwrap();
    let train = cameras.len() - test;
    for (role, cameras) in [("train", &cameras[..train]), ("test", &cameras[train..])] {
        let frames: Vec<Value> =
            cameras.iter().enumerate().map(|(k, c)| frame(folder, solid, c, &format!("images/{role}_{k:02}.png"))).collect();
        let text = json!({ "frames": frames }).to_string();
        std::fs::write(folder.join(format!("transforms_{role}.json")), text).unwrap();
    }
}

fn frame(folder: &Path, solid: &impl Solid, camera: &Camera, name: &str) -> Value {
    let view = photograph(solid, camera, 2, name);
    image::save_buffer(folder.join(name), &view.image.to_u8(), camera.width, camera.height, image::ColorType::Rgba8).unwrap();
    // Camera to world, with y up and z backwards.
    let (to_world, eye) = (mat3::transpose(camera.rotation), camera.center());
    let row = |r: usize| [to_world[r][0], -to_world[r][1], -to_world[r][2], eye[r]];
    let Projection::Pinhole { fx, fy } = camera.projection else { panic!("a pinhole camera") };
    json!({
        "file_path": name,
        "transform_matrix": [row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]],
        "fl_x": fx, "fl_y": fy, "cx": camera.cx, "cy": camera.cy, "w": camera.width, "h": camera.height,
    })
}

/// Stops once a stage has done `stop_at` of its steps.
pub struct Impatient {
    stop_at: u64,
    done: AtomicU64,
}

impl Impatient {
    /// Stops after so many steps.
    pub fn after(stop_at: u64) -> Self {
        Self { stop_at, done: AtomicU64::new(0) }
    }

    /// Never stops.
    pub fn never() -> Self {
        Self::after(u64::MAX)
    }
}

impl Sink for Impatient {
    fn event(&self, event: Event<'_>) {
        if let Event::Step { done } = event {
            self.done.store(done, Ordering::Relaxed);
        }
    }

    fn cancelled(&self) -> bool {
        self.done.load(Ordering::Relaxed) >= self.stop_at
    }
}
