//! Light for the demonstration scene: a large soft key light, a sky and a warm rim, each a bundle of directions whose visibility
//! is traced through a coarse distance volume with soft cones. Smooth everywhere, so neither photographs nor splats get grain.

use megas_math::{Vec3, vec3};
use megas_model::fibonacci_directions;
use rayon::prelude::*;

use super::noise::smoothstep;

/// How a part answers light.
#[derive(Clone, Copy, Debug)]
pub struct Finish {
    /// How far diffuse light reaches around the terminator, 0–1.
    pub wrap: f32,
    /// Strength of the mirror-like coat, 0–1.
    pub gloss: f32,
    /// How much light leaks through shadowed parts (ice cream: a lot), 0–1.
    pub translucency: f32,
}

struct Ray {
    direction: Vec3<f32>,
    radiance: [f32; 3],
    /// Tangent of the half-angle of the cone that the direction stands for.
    spread: f32,
}

/// What arrives at a point: per direction the share of light that is not blocked, and the normal used for soft diffuse light.
pub struct Received {
    visible: [f32; RAYS],
    smooth: Vec3<f32>,
}

/// The lights and the distance volume they are traced through.
pub struct Light {
    rays: Vec<Ray>,
    origin: Vec3<f32>,
    count: [usize; 3],
    distance: Vec<f32>,
    table: fn(Vec3<f32>) -> f32,
    /// Height and radius of the table top.
    table_top: (f32, f32),
}

const CELL: f32 = 0.02;
/// Empty space kept around the object so that distances near the border are plain.
const MARGIN: f32 = 0.16;
const SKY: usize = 56;
const KEY_RAYS: usize = 12;
const RIM_RAYS: usize = 6;
const RAYS: usize = KEY_RAYS + RIM_RAYS + SKY;
const KEY: Vec3<f32> = [-0.52, -0.50, 0.69];
const RIM_LIGHT: Vec3<f32> = [0.55, 0.72, 0.42];

impl Light {
    /// A light without a volume, to be replaced.
    pub fn empty() -> Self {
        Self { rays: Vec::new(), origin: [0.0; 3], count: [0; 3], distance: Vec::new(), table: |_| f32::INFINITY, table_top: (0.0, 0.0) }
    }

    /// Samples the object's distance inside `bounds`; the table is evaluated directly.
    pub fn new(
        bounds: (Vec3<f32>, Vec3<f32>),
        sdf: impl Fn(Vec3<f32>) -> f32 + Sync,
        table: fn(Vec3<f32>) -> f32,
        table_top: (f32, f32),
    ) -> Self {
        let origin = bounds.0.map(|v| v - MARGIN);
        let count: [usize; 3] = std::array::from_fn(|a| ((bounds.1[a] + MARGIN - origin[a]) / CELL).ceil() as usize + 1);
        let distance = (0..count[2] * count[1])
            .into_par_iter()
            .flat_map_iter(|row| {
                let (j, k) = (row % count[1], row / count[1]);
                let sdf = &sdf;
                (0..count[0]).map(move |i| sdf(vec3::add_scaled(origin, [i as f32, j as f32, k as f32], CELL)))
            })
            .collect();
        let mut rays = Vec::new();
        lamp(&mut rays, KEY, 0.30, KEY_RAYS, [3.35, 3.18, 2.92]);
        lamp(&mut rays, RIM_LIGHT, 0.25, RIM_RAYS, [0.75, 0.80, 0.90]);
        for d in fibonacci_directions(SKY) {
            let up = 0.5 + 0.5 * d[2];
            let sky = vec3::lerp([0.46, 0.43, 0.41], [0.86, 0.91, 1.0], up);
            rays.push(Ray { direction: d, radiance: sky.map(|v| v * 4.0 / SKY as f32 * 0.60), spread: 0.26 });
        }
        Self { rays, origin, count, distance, table, table_top }
    }

    /// Distance of the object from the volume; `x` outside of it is moved to its border.
    #[inline(always)]
    fn sample(&self, x: Vec3<f32>) -> f32 {
        // The cell must have a successor on every axis: stay a hair below the last node.
        let at = |a: usize| ((x[a] - self.origin[a]) * (1.0 / CELL)).clamp(0.0, self.count[a] as f32 - 1.001);
        let (gx, gy, gz) = (at(0), at(1), at(2));
        let (i, j, k) = (gx as i32 as usize, gy as i32 as usize, gz as i32 as usize);
        let (fx, fy, fz) = (gx - i as f32, gy - j as f32, gz - k as f32);
        let sy = self.count[0];
        let base = i + sy * (j + self.count[1] * k);
        let layer = |o: usize| {
            let d = &self.distance[base + o..][..sy + 2];
            let (a, b) = (d[0] + (d[1] - d[0]) * fx, d[sy] + (d[sy + 1] - d[sy]) * fx);
            a + (b - a) * fy
        };
        let (a, b) = (layer(0), layer(sy * self.count[1]));
        a + (b - a) * fz
    }

    /// Share of the cone along `d` that the scene leaves open.
    #[inline]
    fn visibility(&self, x: Vec3<f32>, d: Vec3<f32>, spread: f32) -> f32 {
        let mut seen = self.table_visibility(x, d, spread);
        // Only the stretch inside the object's box can be blocked by it.
        let (mut t, mut end) = (0.03f32, 4.0f32);
        for a in 0..3 {
            let inv = 1.0 / d[a];
            let hi = self.origin[a] + (self.count[a] - 1) as f32 * CELL;
            let (t0, t1) = ((self.origin[a] - x[a]) * inv, (hi - x[a]) * inv);
            t = t.max(t0.min(t1));
            end = end.min(t0.max(t1));
        }
        while t < end && seen > 0.0 {
            let h = self.sample(vec3::add_scaled(x, d, t));
            seen = seen.min(0.5 + 0.5 * h / (spread * t));
            t += h.max(0.5 * spread * t).max(0.02);
        }
        smoothstep(0.0, 1.0, seen)
    }

    /// The table's share: above it a disc, from below the top shades everything that looks up.
    fn table_visibility(&self, x: Vec3<f32>, d: Vec3<f32>, spread: f32) -> f32 {
        let top = self.table_top;
        if x[2] > top.0 - 1e-3 {
            if d[2] >= 0.0 {
                return 1.0;
            }
            let t = (x[2] - top.0) / -d[2];
            let rho = ((x[0] + d[0] * t).powi(2) + (x[1] + d[1] * t).powi(2)).sqrt();
            return 0.5 + 0.5 * (rho - top.1) / (spread * t + 1e-3);
        }
        let mut seen = 1.0f32;
        let mut t = 0.03;
        while t < 2.0 && seen > 0.0 {
            let h = (self.table)(vec3::add_scaled(x, d, t));
            seen = seen.min(0.5 + 0.5 * h / (spread * t));
            t += h.max(0.5 * spread * t).max(0.03);
        }
        seen
    }

    /// What arrives at the surface point `x` with normal `n`.
    pub fn receive(&self, x: Vec3<f32>, n: Vec3<f32>) -> Received {
        let from = vec3::add_scaled(x, n, 0.012);
        let mut visible = [0.0; RAYS];
        for (v, r) in visible.iter_mut().zip(&self.rays) {
            // Nothing arrives from farther behind the surface than diffuse wrapping reaches.
            if vec3::dot(r.direction, n) > -0.3 {
                *v = self.visibility(from, r.direction, r.spread);
            }
        }
        // Translucent matter blurs its own relief: a normal taken over a few millimetres, for the object only.
        let h = 0.03;
        let g: Vec3<f32> = std::array::from_fn(|a| {
            let (mut p, mut m) = (x, x);
            p[a] += h;
            m[a] -= h;
            self.sample(p) - self.sample(m)
        });
        let s = vec3::normalize_or(g, n);
        let smooth = if self.sample(x) < 0.03 && vec3::dot(s, n) > 0.0 { s } else { n };
        Received { visible, smooth }
    }

    /// Colour of a surface with normal `n` and sRGB colour `albedo` seen along `d` (from the camera), display-referred.
    pub fn shade(&self, lit: &Received, n: Vec3<f32>, d: Vec3<f32>, albedo: [f32; 3], finish: Finish) -> [f32; 3] {
        let base = albedo.map(to_linear);
        let mut direct = [0.0f32; 3];
        let mut blocked = [0.0f32; 3];
        // Red travels farther than blue inside food: per channel another blend of sharp and smooth normal.
        let soft = [0.75, 0.55, 0.40].map(|k| k * finish.translucency);
        for (r, &v) in self.rays.iter().zip(&lit.visible) {
            let (sharp, smooth) = (vec3::dot(n, r.direction), vec3::dot(lit.smooth, r.direction));
            for c in 0..3 {
                let cosine = sharp + (smooth - sharp) * soft[c];
                let w = ((cosine + finish.wrap) / (1.0 + finish.wrap)).max(0.0) * r.radiance[c];
                direct[c] += w * v;
                blocked[c] += w * (1.0 - v);
            }
        }
        let mut out: [f32; 3] = std::array::from_fn(|c| {
            // Light that hits a neighbour first arrives after one more bounce off much the same colour.
            let bounce = 0.16 + 0.34 * base[c] + 0.25 * finish.translucency * base[c];
            base[c] * (direct[c] + bounce * blocked[c]) / std::f32::consts::PI
        });
        if finish.gloss > 0.0 {
            let s = self.reflection(lit, n, d);
            for c in 0..3 {
                out[c] += finish.gloss * s[c];
            }
        }
        out.map(to_display)
    }

    /// Light mirrored by a clear coat. The sharp image of the lamps is painted on: it is the one that a viewer in front of the
    /// point at eye level sees, because harmonics of low degree cannot hold it. The broad sheen follows the viewer.
    fn reflection(&self, lit: &Received, n: Vec3<f32>, d: Vec3<f32>) -> [f32; 3] {
        let viewer = vec3::normalize_or([n[0], n[1], 0.30 + 0.5 * n[2].max(0.0)], [0.0, 0.0, 1.0]);
        let mirror = |v: Vec3<f32>| vec3::add_scaled(vec3::scale(v, -1.0), n, 2.0 * vec3::dot(n, v));
        let (lamp, moving) = (mirror(viewer), mirror(vec3::scale(d, -1.0)));
        let cosine = (-vec3::dot(n, d)).clamp(0.0, 1.0);
        let fresnel = 0.04 + 0.30 * (1.0 - cosine).powi(4);
        let mut s = [0.0; 3];
        for (k, (r, &v)) in self.rays.iter().zip(&lit.visible).enumerate() {
            let broad = vec3::dot(moving, r.direction).max(0.0).powi(5) * 0.8 * fresnel;
            let sharp = if k < KEY_RAYS + RIM_RAYS { 0.85 * vec3::dot(lamp, r.direction).max(0.0).powi(70) } else { 0.0 };
            for c in 0..3 {
                s[c] += (broad + sharp) * v * r.radiance[c];
            }
        }
        s
    }

    /// Colour of newly exposed material under the average light.
    pub fn interior(&self, albedo: [f32; 3]) -> [f32; 3] {
        let mean: [f32; 3] = std::array::from_fn(|c| self.rays.iter().map(|r| r.radiance[c]).sum::<f32>() * 0.36);
        let base = albedo.map(to_linear);
        std::array::from_fn(|c| to_display(base[c] * mean[c] / std::f32::consts::PI))
    }
}

/// Adds a round lamp: `count` directions on a disc of angular radius `size` around `towards`, with the total `power`.
fn lamp(rays: &mut Vec<Ray>, towards: Vec3<f32>, size: f32, count: usize, power: [f32; 3]) {
    let axis = vec3::normalize_or(towards, [0.0, 0.0, 1.0]);
    let (a, b) = vec3::frame_from_normal(axis);
    for i in 0..count {
        let r = size * ((i as f32 + 0.5) / count as f32).sqrt();
        let (s, c) = (2.399_963 * i as f32).sin_cos();
        let d = vec3::add_scaled(vec3::add_scaled(axis, a, r * c), b, r * s);
        let direction = vec3::normalize_or(d, axis);
        rays.push(Ray { direction, radiance: power.map(|p| p / count as f32), spread: 0.12 });
    }
}

/// sRGB → linear light.
pub fn to_linear(v: f32) -> f32 {
    if v <= 0.040_45 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) }
}

/// Linear light → display: a soft shoulder above 0.6, then the sRGB curve.
pub fn to_display(v: f32) -> f32 {
    const KNEE: f32 = 0.6;
    let v = v.max(0.0);
    let v = if v > KNEE { KNEE + (1.0 - KNEE) * (1.0 - (-(v - KNEE) / (1.0 - KNEE)).exp()) } else { v };
    if v <= 0.003_130_8 { v * 12.92 } else { 1.055 * v.powf(1.0 / 2.4) - 0.055 }
}
