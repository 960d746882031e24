//! Projection of Gaussians to image space (splatting.md §3.1), in double precision and eight at a time.
//!
//! The inverse image covariance `Q` is kept as its whitening factor: with `s₁ = l₁dx + l₂dy`, `s₂ = l₃dy` the exponent is
//! `½dᵀQd·log₂e = s₁² + s₂²`. That is never negative, costs no more than the conic, and stays accurate for needles, where
//! the three terms of the conic cancel. The mean is stored as an integer and a remainder for the same reason.

use fearless_simd::{Level, Simd, dispatch, f64x8, prelude::*};
use megas_math::{Mat3, Vec3, mat3, sh, vec3};
use megas_model::{AMBIENT_K, Camera, Projection};

use crate::settings::BOX;
use crate::{Channels, Gaussians, Settings};

/// Gaussians per projection job.
pub(crate) const CHUNK: usize = 4096;

/// One visible Gaussian as the compositing kernel reads it: one cache line.
#[derive(Clone, Copy, Debug, Default)]
#[repr(C, align(64))]
pub(crate) struct Record {
    /// Integer part of the projected mean \[px\].
    pub base: [f32; 2],
    /// Remainder of the projected mean \[px\].
    pub rest: [f32; 2],
    /// Whitening factor `l₁, l₂, l₃`.
    pub l: [f32; 3],
    /// log₂ of the effective opacity.
    pub log_opacity: f32,
    /// Limit of `s₁² + s₂²` for culling: the exact limit plus what rounding can do to the exponent.
    pub limit: f32,
    /// `argmin` slopes of the exponent: `dx* = slope[0]·dy` for fixed dy, `dy* = slope[1]·dx` for fixed dx.
    pub slope: [f32; 2],
    /// Colour along the viewing direction.
    pub rgb: [f32; 3],
    /// Temperature \[K\].
    pub temperature: f32,
    /// Index in the input.
    pub index: u32,
}

/// What only the geometry channels need.
#[derive(Clone, Copy, Debug, Default)]
#[repr(C, align(32))]
pub(crate) struct Extra {
    /// Depth along z.
    pub z: f32,
    /// Normal turned to the camera, world axes.
    pub normal: [f32; 3],
    /// Signed distance of the Gaussian's plane from the camera centre, `n·(μ − c)`.
    pub plane: f32,
}

/// Tiles touched by the bounding box: columns `x[0]..x[1]`, rows `y[0]..y[1]`.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Bounds {
    pub x: [u16; 2],
    pub y: [u16; 2],
}

/// The survivors of one chunk of Gaussians, in input order.
#[derive(Debug, Default)]
pub(crate) struct Chunk {
    pub keys: Vec<u32>,
    pub records: Vec<Record>,
    pub extras: Vec<Extra>,
    pub bounds: Vec<Bounds>,
}

/// Camera and settings in the form that projection needs.
#[derive(Clone, Copy, Debug)]
pub(crate) struct View {
    pub camera: Camera,
    w: Mat3<f64>,
    t: Vec3<f64>,
    center: Vec3<f64>,
    forward: Vec3<f32>,
    pinhole: bool,
    focal: [f64; 2],
    principal: [f64; 2],
    tangent_min: [f64; 2],
    tangent_max: [f64; 2],
    low_pass: f64,
    anti_aliased: bool,
    z_near: f64,
    alpha_min: f32,
    log_alpha_min: f32,
    clip: Option<crate::ClipPlane>,
    tile: f32,
    /// Tile columns and rows.
    pub tiles: [usize; 2],
    colour: bool,
    thermal: bool,
    geometry: bool,
}

impl View {
    pub fn new(camera: &Camera, settings: &Settings, channels: Channels) -> Self {
        let w: Mat3<f64> = mat3::cast(camera.rotation);
        let t: Vec3<f64> = vec3::cast(camera.translation);
        let (pinhole, focal) = match camera.projection {
            Projection::Pinhole { fx, fy } => (true, [f64::from(fx), f64::from(fy)]),
            Projection::Orthographic { scale } => (false, [f64::from(scale); 2]),
        };
        let principal = [f64::from(camera.cx), f64::from(camera.cy)];
        let size = [f64::from(camera.width), f64::from(camera.height)];
        let tile = settings.tile.pixels();
        Self {
            camera: *camera,
            w,
            t,
            center: mat3::tmul_vec(w, t).map(|v| -v),
            forward: vec3::normalize_or(camera.rotation[2], [0.0, 0.0, 1.0]),
            pinhole,
            focal,
            principal,
            tangent_min: [0, 1].map(|k| -(principal[k] + 0.15 * size[k]) / focal[k]),
            tangent_max: [0, 1].map(|k| (1.15 * size[k] - principal[k]) / focal[k]),
            low_pass: f64::from(settings.low_pass),
            anti_aliased: settings.anti_aliased,
            z_near: f64::from(settings.z_near),
            alpha_min: settings.least_alpha(),
            log_alpha_min: settings.log_alpha_min(),
            clip: settings.clip,
            tile: tile as f32,
            tiles: [(camera.width as usize).div_ceil(tile), (camera.height as usize).div_ceil(tile)],
            colour: channels != Channels::Weights,
            thermal: matches!(channels, Channels::RgbaTemperature | Channels::Geometry),
            geometry: channels == Channels::Geometry,
        }
    }

    /// Edge of a tile \[px\].
    pub fn tile(&self) -> f32 {
        self.tile
    }
}

/// Projects Gaussians `first..last` (at most [`CHUNK`]) into `out`.
pub(crate) fn project(level: Level, view: &View, g: &Gaussians, first: usize, last: usize, out: &mut Chunk) {
    out.keys.clear();
    out.records.clear();
    out.extras.clear();
    out.bounds.clear();
    dispatch!(level, simd => project_simd(simd, view, g, first, last, out));
}

/// Image-space quantities of eight Gaussians.
struct Lanes {
    z: [f64; 8],
    mean: [[f64; 8]; 2],
    variance: [[f64; 8]; 2],
    l: [[f64; 8]; 3],
    compensation: [f64; 8],
}

#[inline(always)]
fn project_simd<S: Simd>(simd: S, view: &View, g: &Gaussians, first: usize, last: usize, out: &mut Chunk) {
    for start in (first..last).step_by(8) {
        let n = (last - start).min(8);
        let mut mean = [[0.0f64; 8]; 3];
        let mut cov = [[0.0f64; 8]; 6];
        let mut pixel = [0.0f64; 8];
        if let Some(pixels) = g.trained_pixel.get(start..start + n) {
            pixel.iter_mut().zip(pixels).for_each(|(p, v)| *p = f64::from(*v));
        }
        for (k, m) in g.mean[start..start + n].iter().enumerate() {
            for a in 0..3 {
                mean[a][k] = f64::from(m[a]);
            }
        }
        for (k, c) in g.covariance[start..start + n].iter().enumerate() {
            for a in 0..6 {
                cov[a][k] = f64::from(c[a]);
            }
        }
        let lanes = image_space(simd, view, &mean, &cov, &pixel);
        for k in 0..n {
            emit(simd, view, g, start + k, &lanes, k, out);
        }
    }
}

#[inline(always)]
fn image_space<S: Simd>(simd: S, view: &View, mean: &[[f64; 8]; 3], cov: &[[f64; 8]; 6], pixel: &[f64; 8]) -> Lanes {
    let v = |x: f64| f64x8::splat(simd, x);
    let load = |a: &[f64; 8]| f64x8::load_array_ref(simd, a);
    let x: [f64x8<S>; 3] = [load(&mean[0]), load(&mean[1]), load(&mean[2])];
    let c: [f64x8<S>; 6] = [load(&cov[0]), load(&cov[1]), load(&cov[2]), load(&cov[3]), load(&cov[4]), load(&cov[5])];
    let mut p = [v(0.0); 3];
    for r in 0..3 {
        p[r] = x[0].mul_add(v(view.w[r][0]), x[1].mul_add(v(view.w[r][1]), x[2].mul_add(v(view.w[r][2]), v(view.t[r]))));
    }
    let row = |r: usize| -> [f64x8<S>; 3] { [v(view.w[r][0]), v(view.w[r][1]), v(view.w[r][2])] };
    let mut magnification = [v(view.focal[0]), v(view.focal[1])];
    let (rows, m) = if view.pinhole {
        let iz = v(1.0) / p[2];
        let forward = row(2);
        let mut rows = [row(0), row(1)];
        let mut m = [v(0.0); 2];
        for k in 0..2 {
            let tan = p[k] * iz;
            m[k] = tan.mul_add(v(view.focal[k]), v(view.principal[k]));
            let tan = tan.max(v(view.tangent_min[k])).min(v(view.tangent_max[k]));
            let f = iz * v(view.focal[k]);
            magnification[k] = f;
            for a in 0..3 {
                rows[k][a] = (rows[k][a] - tan * forward[a]) * f;
            }
        }
        (rows, m)
    } else {
        let mut rows = [row(0), row(1)];
        let mut m = [v(0.0); 2];
        for k in 0..2 {
            let f = v(view.focal[k]);
            m[k] = p[k].mul_add(f, v(view.principal[k]));
            for a in 0..3 {
                rows[k][a] *= f;
            }
        }
        (rows, m)
    };
    let times = |r: &[f64x8<S>; 3]| -> [f64x8<S>; 3] {
        [
            c[0].mul_add(r[0], c[1].mul_add(r[1], c[2] * r[2])),
            c[1].mul_add(r[0], c[3].mul_add(r[1], c[4] * r[2])),
            c[2].mul_add(r[0], c[4].mul_add(r[1], c[5] * r[2])),
        ]
    };
    let dot = |a: &[f64x8<S>; 3], b: &[f64x8<S>; 3]| a[0].mul_add(b[0], a[1].mul_add(b[1], a[2] * b[2]));
    let (v0, v1) = (times(&rows[0]), times(&rows[1]));
    let (s00, s01, s11) = (dot(&rows[0], &v0), dot(&rows[1], &v0), dot(&rows[1], &v1));
    let eps = v(view.low_pass);
    let (mut a, mut b) = (s00 + eps, s11 + eps);
    let mut smaller = v(1.0);
    if pixel.iter().any(|p| *p > 0.0) {
        let p = load(pixel);
        let known = p.simd_gt(v(0.0));
        let q = magnification.map(|m| (m * p) * (m * p));
        let own = [eps.mul_add(q[0], s00), eps.mul_add(q[1], s11)];
        let wide = [0, 1].map(|k| (v(1.0) - q[k]).max(v(0.0)).mul_add(v(BOX), own[k]));
        let off = s01 * s01;
        smaller = known.select(own[0].mul_sub(own[1], off) / wide[0].mul_sub(wide[1], off), smaller);
        (a, b) = (known.select(wide[0], a), known.select(wide[1], b));
    }
    let det = a.mul_sub(b, s01 * s01);
    // √(½ log₂ e) turns the exponent into a power of two.
    let k = v((0.5 * std::f64::consts::LOG2_E).sqrt());
    let r1 = k / b.sqrt();
    let rd = r1 / det.sqrt();
    let compensation = if view.anti_aliased {
        let det0 = s00.mul_sub(s11, s01 * s01);
        (det0 / det).max(v(2.5e-5)).sqrt()
    } else {
        smaller.max(v(2.5e-5)).sqrt()
    };
    Lanes {
        z: p[2].to_array(),
        mean: [m[0].to_array(), m[1].to_array()],
        variance: [a.to_array(), b.to_array()],
        l: [(b * rd).to_array(), (-s01 * rd).to_array(), r1.to_array()],
        compensation: compensation.to_array(),
    }
}

/// Appends Gaussian `i` (lane `k`) if any pixel can see it.
#[inline(always)]
fn emit<S: Simd>(_: S, view: &View, g: &Gaussians, i: usize, lanes: &Lanes, k: usize, out: &mut Chunk) {
    let z = lanes.z[k];
    // Written so that NaN fails every test.
    if !(z > view.z_near && z < 1e10) || g.visible.get(i) == Some(&false) {
        return;
    }
    let opacity = g.opacity[i].min(1.0) * lanes.compensation[k] as f32;
    if !(opacity >= view.alpha_min && g.opacity[i] <= 1e6) {
        return;
    }
    let l = [lanes.l[0][k] as f32, lanes.l[1][k] as f32, lanes.l[2][k] as f32];
    let m = [lanes.mean[0][k], lanes.mean[1][k]];
    if !(l[0] > 0.0 && l[2] > 0.0 && l[0].is_finite() && l[1].is_finite() && l[2].is_finite() && m[0].abs() < 1e7 && m[1].abs() < 1e7) {
        return;
    }
    let log_opacity = opacity.log2();
    let q = (log_opacity - view.log_alpha_min).max(0.0);
    // Half sizes of the support, a hair too large; then what rounding can add to s₁ and s₂ inside it.
    let reach = (2.0 * std::f32::consts::LN_2 * q).sqrt();
    let half = [0, 1].map(|a| reach * (lanes.variance[a][k] as f32).sqrt() * 1.00001 + 0.01);
    let slack = 1e-6 * (l[0] * (half[0] + 8.0) + (l[1].abs() + l[2]) * (half[1] + 8.0)) + 1e-5;
    let limit = (q.sqrt() + slack) * (q.sqrt() + slack) * 1.00001 + 1e-5;
    let mut bounds = Bounds::default();
    for (a, range) in [&mut bounds.x, &mut bounds.y].into_iter().enumerate() {
        let end = view.tiles[a] as f32;
        let m = m[a] as f32;
        let lo = ((m - half[a] - 0.5) / view.tile).floor().max(0.0);
        let hi = ((m + half[a] - 0.5) / view.tile).floor().min(end - 1.0) + 1.0;
        if lo >= hi {
            return;
        }
        *range = [lo as u16, hi as u16];
    }
    if let Some(cut) = view.clip
        && vec3::dot(cut.normal, g.mean[i]) > cut.offset
    {
        return;
    }
    let toward = [0, 1, 2].map(|a| (f64::from(g.mean[i][a]) - view.center[a]) as f32);
    let rgb = if view.colour { colour(view, g, i, toward) } else { [0.0; 3] };
    let temperature = if view.thermal { g.temperature.get(i).copied().unwrap_or(AMBIENT_K) } else { 0.0 };
    if !(rgb[0].is_finite() && rgb[1].is_finite() && rgb[2].is_finite() && temperature.is_finite()) {
        return;
    }
    if view.geometry {
        let n = g.normal.get(i).copied().unwrap_or([0.0; 3]);
        let plane = vec3::dot(n, toward);
        let facing = if view.pinhole { plane } else { vec3::dot(n, view.forward) };
        if !(plane.is_finite() && facing.is_finite()) {
            return;
        }
        let s = if facing > 0.0 { -1.0 } else { 1.0 };
        out.extras.push(Extra { z: z as f32, normal: n.map(|v| v * s), plane: plane * s });
    }
    let base = m.map(f64::floor);
    out.keys.push((z as f32).to_bits());
    out.bounds.push(bounds);
    out.records.push(Record {
        base: base.map(|v| v as f32),
        rest: [(m[0] - base[0]) as f32, (m[1] - base[1]) as f32],
        l,
        log_opacity,
        limit,
        slope: {
            let [l1, l2, l3] = [lanes.l[0][k], lanes.l[1][k], lanes.l[2][k]];
            [(-l2 / l1) as f32, (-l1 * l2 / (l2 * l2 + l3 * l3)) as f32]
        },
        rgb,
        temperature,
        index: i as u32,
    });
}

/// Colour of Gaussian `i`, `toward` pointing from the camera to it.
#[inline(always)]
fn colour(view: &View, g: &Gaussians, i: usize, toward: Vec3<f32>) -> [f32; 3] {
    let n = g.sh_stride();
    let c = &g.sh[i * n..(i + 1) * n];
    // The clamp at zero would hide NaN: this is zero where everything is finite, and NaN otherwise.
    let poison = |v: &[f32]| v.iter().map(|x| x * 0.0).sum::<f32>();
    if g.sh_degree == 0 {
        let nan = poison(c);
        return [c[0], c[1], c[2]].map(|c| (c * sh::Y0 as f32 + 0.5).max(0.0) + nan);
    }
    let mut d = if view.pinhole { vec3::normalize_or(toward, view.forward) } else { view.forward };
    if let Some(r) = g.view_rotation.get(i) {
        d = [0, 1, 2].map(|a| r[a] * d[0] + r[3 + a] * d[1] + r[6 + a] * d[2]);
    }
    let nan = poison(c) + poison(&d);
    sh::colour(g.sh_degree, c, d).map(|v| v + nan)
}
