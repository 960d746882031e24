//! Photographs of a body by sphere tracing: RGBA with straight alpha, depth and world normals (splatting.md §9.1).

use megas_math::{Vec3, vec3};
use megas_model::{Camera, Image, View, fibonacci_directions};
use rayon::prelude::*;

use super::solid::{Hit, Solid};

/// Share of the distance that one step dares to go: relief makes the distance up to a third too large.
const STEP: f32 = 0.75;
const MAX_STEPS: usize = 220;

struct Pixel {
    rgba: [f32; 4],
    depth: f32,
    normal: Vec3<f32>,
}

/// Takes a picture with `samples` × `samples` rays a pixel (≥ 1). Colour is averaged over the rays that hit, alpha is their
/// share; depth (camera z) and normal belong to the ray through the middle of the pixel: +∞ and 0 where it misses.
pub fn photograph(solid: &impl Solid, camera: &Camera, samples: u32, name: &str) -> View {
    let (w, h) = (camera.width as usize, camera.height as usize);
    let pixels: Vec<Pixel> = (0..w * h).into_par_iter().map(|i| pixel(solid, camera, (i % w) as f32, (i / w) as f32, samples)).collect();
    let mut image = Image::new(camera.width, camera.height, 4);
    let mut depth = Image::new(camera.width, camera.height, 1);
    let mut normal = Image::new(camera.width, camera.height, 3);
    for (i, p) in pixels.iter().enumerate() {
        image.data[4 * i..4 * i + 4].copy_from_slice(&p.rgba);
        depth.data[i] = p.depth;
        normal.data[3 * i..3 * i + 3].copy_from_slice(&p.normal);
    }
    View { name: name.to_owned(), camera: *camera, image, depth: Some(depth), normal: Some(normal) }
}

fn pixel(solid: &impl Solid, camera: &Camera, i: f32, j: f32, samples: u32) -> Pixel {
    let n = samples.max(1);
    let mut hits = Vec::with_capacity((n * n) as usize);
    for k in 0..n * n {
        // The samples form a grid turned a little, so that edges along the pixel rows get all the grey levels.
        let (a, b) = ((k % n) as f32 + 0.5, (k / n) as f32 + 0.5);
        let (u, v) = (a / n as f32 - 0.5, b / n as f32 - 0.5);
        let (u, v) = if n > 1 { (0.9 * u - 0.4 * v, 0.4 * u + 0.9 * v) } else { (u, v) };
        let (o, d) = camera.ray(i + 0.5 + u, j + 0.5 + v);
        if let Some(t) = trace(solid, o, d) {
            let x = vec3::add_scaled(o, d, t);
            hits.push(Hit { position: x, normal: solid.normal(x), direction: d });
        }
    }
    let rgb = solid.shade(&hits);
    let (o, d) = camera.ray(i + 0.5, j + 0.5);
    let (depth, normal) = match trace(solid, o, d) {
        Some(t) => {
            let x = vec3::add_scaled(o, d, t);
            (camera.to_camera(x)[2], solid.normal(x))
        }
        None => (f32::INFINITY, [0.0; 3]),
    };
    Pixel { rgba: [rgb[0], rgb[1], rgb[2], hits.len() as f32 / (n * n) as f32], depth, normal }
}

/// Distance along the ray to the first surface, if any.
pub(super) fn trace(solid: &impl Solid, o: Vec3<f32>, d: Vec3<f32>) -> Option<f32> {
    let (lo, hi) = solid.bounds();
    let (mut t, mut end) = (0.0f32, f32::INFINITY);
    for a in 0..3 {
        let inv = 1.0 / d[a];
        let (t0, t1) = ((lo[a] - 0.01 - o[a]) * inv, (hi[a] + 0.01 - o[a]) * inv);
        t = t.max(t0.min(t1));
        end = end.min(t0.max(t1));
    }
    if t > end {
        return None;
    }
    let mut before = t;
    for _ in 0..MAX_STEPS {
        let dist = solid.sdf(vec3::add_scaled(o, d, t));
        if dist < 0.0 {
            // Steep relief let a step go through: the surface lies between the last two places.
            let (mut outside, mut inside) = (before, t);
            for _ in 0..10 {
                let middle = 0.5 * (outside + inside);
                if solid.sdf(vec3::add_scaled(o, d, middle)) < 0.0 { inside = middle } else { outside = middle }
            }
            return Some(inside);
        }
        if dist < 1e-4 * t.max(0.1) {
            return Some(t);
        }
        before = t;
        t += dist * STEP;
        if t > end {
            return None;
        }
    }
    None
}

/// Cameras on the upper half-sphere around the middle of `bounds`, far enough to see all of it: `train` well-spread ones, then
/// `test` others in between. `up` is +z, the vertical field of view 35°.
pub fn camera_rig(bounds: (Vec3<f32>, Vec3<f32>), train: usize, test: usize, width: u32, height: u32) -> Vec<Camera> {
    const FOV: f32 = 35.0 * std::f32::consts::PI / 180.0;
    let centre = vec3::scale(vec3::add(bounds.0, bounds.1), 0.5);
    let radius = 0.5 * vec3::norm(vec3::sub(bounds.1, bounds.0));
    let narrow = FOV * (width as f32 / height as f32).min(1.0);
    let distance = 0.95 * radius / (0.5 * narrow).sin();
    let ring = |n: usize, turn: f32| {
        let (s, c) = turn.sin_cos();
        fibonacci_directions(2 * n).into_iter().take(n).map(move |d| {
            // From straight above down to five degrees over the horizon.
            let d = vec3::normalize_or([c * d[0] - s * d[1], s * d[0] + c * d[1], d[2].max(0.087)], [0.0, 0.0, 1.0]);
            Camera::look_at(vec3::add_scaled(centre, d, distance), centre, [0.0, 0.0, 1.0], FOV, width, height)
        })
    };
    ring(train, 0.0).chain(ring(test, 0.61)).collect()
}
