//! Analytic bodies and single-layer shells of discs on them (splatting.md §6.5).
#![allow(dead_code)]

use std::collections::HashMap;

use megas_math::{Vec3, quat, rng::Rng, vec3};
use megas_model::{Splats, logit};

/// A body by its signed distance, negative inside; `skin` says where its surface exists.
pub struct Shape {
    pub name: &'static str,
    pub distance: fn(Vec3<f64>) -> f64,
    pub skin: fn(Vec3<f64>) -> bool,
    pub half: Vec3<f64>,
}

const EVERYWHERE: fn(Vec3<f64>) -> bool = |_| true;

fn sphere(p: Vec3<f64>) -> f64 {
    vec3::norm(p) - 0.5
}

fn torus(p: Vec3<f64>) -> f64 {
    (p[0].hypot(p[1]) - 0.5).hypot(p[2]) - 0.2
}

fn tube(p: Vec3<f64>, radius: f64, lo: f64, hi: f64) -> f64 {
    let d = [p[0].hypot(p[1]) - radius, (p[2] - 0.5 * (lo + hi)).abs() - 0.5 * (hi - lo)];
    d[0].max(d[1]).min(0.0) + d[0].max(0.0).hypot(d[1].max(0.0))
}

/// A cup with walls 0.12 thick, open at the top.
fn cup(p: Vec3<f64>) -> f64 {
    tube(p, 0.4, -0.5, 0.5).max(-tube(p, 0.28, -0.35, 1.0))
}

fn blobs(p: Vec3<f64>) -> f64 {
    let (a, b) = (vec3::norm(vec3::sub(p, [-0.22, 0.0, 0.0])) - 0.3, vec3::norm(vec3::sub(p, [0.25, 0.08, 0.05])) - 0.25);
    // Polynomial smooth minimum.
    let k = 0.15;
    let h = (0.5 + 0.5 * (b - a) / k).clamp(0.0, 1.0);
    b + (a - b) * h - k * h * (1.0 - h)
}

fn dome(p: Vec3<f64>) -> f64 {
    (vec3::norm(p) - 0.5).max(-p[2])
}

/// Four cells of a 56³ grid thick.
fn plate(p: Vec3<f64>) -> f64 {
    let d: Vec3<f64> = std::array::from_fn(|k| p[k].abs() - [0.5, 0.5, 0.036][k]);
    d[0].max(d[1]).max(d[2]).min(0.0) + vec3::norm(d.map(|v| v.max(0.0)))
}

pub const SPHERE: Shape = Shape { name: "sphere", distance: sphere, skin: EVERYWHERE, half: [0.5; 3] };
pub const TORUS: Shape = Shape { name: "torus", distance: torus, skin: EVERYWHERE, half: [0.7, 0.7, 0.2] };
pub const CUP: Shape = Shape { name: "cup", distance: cup, skin: EVERYWHERE, half: [0.4, 0.4, 0.5] };
pub const BLOBS: Shape = Shape { name: "blobs", distance: blobs, skin: EVERYWHERE, half: [0.52, 0.35, 0.32] };
pub const DOME: Shape = Shape { name: "dome", distance: dome, skin: |p| p[2] > 1e-3, half: [0.5; 3] };
pub const PLATE: Shape = Shape { name: "plate", distance: plate, skin: EVERYWHERE, half: [0.5, 0.5, 0.036] };

impl Shape {
    pub fn gradient(&self, p: Vec3<f64>) -> Vec3<f64> {
        let h = 1e-5;
        let g = std::array::from_fn(|k| {
            let (mut a, mut b) = (p, p);
            a[k] += h;
            b[k] -= h;
            (self.distance)(a) - (self.distance)(b)
        });
        vec3::normalize_or(g, [0.0, 0.0, 1.0])
    }
}

/// A shell and the true outward normals.
pub struct Shell {
    pub splats: Splats,
    pub normal: Vec<Vec3<f64>>,
    pub r_min: f64,
}

/// `count` blue-noise discs of radius `size · r_min` and opacity U(0.5, 0.97) on the surface, axes at random within it,
/// quaternions such that half of the shortest axes point inward.
pub fn shell(shape: &Shape, count: usize, size: f64, seed: u64) -> Shell {
    let mut rng = Rng::new(seed);
    // Points in a thin band around the surface, brought onto it, are nearly uniform; their share measures the area.
    let band = 0.02;
    let half = shape.half.map(|h| h + 2.0 * band);
    let mut candidates = Vec::new();
    let mut tried = 0usize;
    while candidates.len() < 20 * count {
        tried += 1;
        let mut p: Vec3<f64> = std::array::from_fn(|k| rng.range(-half[k], half[k]));
        if (shape.distance)(p).abs() > band {
            continue;
        }
        for _ in 0..4 {
            p = vec3::add_scaled(p, shape.gradient(p), -(shape.distance)(p));
        }
        if (shape.distance)(p).abs() < 1e-4 && (shape.skin)(p) {
            candidates.push(p);
        }
    }
    let volume = 8.0 * half[0] * half[1] * half[2];
    let area = candidates.len() as f64 / tried as f64 * volume / (2.0 * band);
    let r_min = (0.5 * area / count as f64).sqrt();
    let mut cells: HashMap<[i64; 3], Vec<Vec3<f64>>> = HashMap::new();
    let mut out = Shell { splats: Splats::default(), normal: Vec::new(), r_min };
    for p in candidates {
        let key = p.map(|v| (v / r_min).floor() as i64);
        let near = (0..27).any(|o| {
            let k = [key[0] + o % 3 - 1, key[1] + o / 3 % 3 - 1, key[2] + o / 9 - 1];
            cells.get(&k).is_some_and(|c| c.iter().any(|&q| vec3::norm(vec3::sub(p, q)) < r_min))
        });
        if near {
            continue;
        }
        cells.entry(key).or_default().push(p);
        let n = shape.gradient(p);
        let facing = if rng.unit() < 0.5 { n } else { n.map(|v| -v) };
        let turn = quat::from_axis_angle([0.0, 0.0, 1.0], rng.range(0.0, std::f64::consts::TAU));
        let q = quat::mul(quat::between([0.0, 0.0, 1.0], facing), turn);
        let s = size * r_min;
        let log_scale = [s, s, 0.05 * s].map(|v| (v as f32).ln());
        let grey = [0.3, 0.1, -0.2];
        out.splats.push(vec3::cast(p), log_scale, q.map(|v| v as f32), logit(rng.range(0.5, 0.97) as f32), &grey);
        out.normal.push(n);
        if out.splats.len() == count {
            break;
        }
    }
    out
}

/// Sets the signs of the normals from the truth.
pub fn orient_truly(shell: &mut Shell) {
    for i in 0..shell.splats.len() {
        shell.splats.normal_sign[i] = 1;
        let n: Vec3<f64> = vec3::cast(shell.splats.normal(i));
        if vec3::dot(n, shell.normal[i]) < 0.0 {
            shell.splats.normal_sign[i] = -1;
        }
    }
}
