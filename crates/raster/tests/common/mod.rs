//! Shared by the tests: random scenes, and the rasterizer written down a second time as plainly as possible — every pixel
//! visits every Gaussian, in double precision, with the conic, no tiles, no culling (splatting.md §10.6).
#![allow(dead_code)]

use megas_math::{Mat3, Vec3, mat3, rng::Rng, sh, vec3};
use megas_model::{Camera, Projection, Splats, logit};
use megas_raster::{Gaussians, NO_GAUSSIAN, Settings, unpack_covariance};

/// `n` splats in a ball before [`camera`]: degree 3, all attributes random.
pub fn random_splats(seed: u64, n: usize) -> Splats {
    let mut rng = Rng::new(seed);
    let mut s = Splats { sh_degree: 3, ..Splats::default() };
    for _ in 0..n {
        let d = rng.direction();
        let r = 1.5 * rng.unit().cbrt();
        let sh: Vec<f32> = (0..48).map(|k| rng.range(-1.0, 1.0) as f32 * if k < 3 { 1.5 } else { 0.3 }).collect();
        let scale = std::array::from_fn(|_| rng.range(0.02f64.ln(), 0.35f64.ln()) as f32);
        let q = std::array::from_fn(|_| rng.normal() as f32);
        s.push(d.map(|v| (v * r) as f32), scale, q, logit(rng.range(0.02, 0.99) as f32), &sh);
    }
    for t in &mut s.temperature {
        *t = rng.range(250.0, 400.0) as f32;
    }
    s
}

/// A camera before the random scenes, principal point off centre.
pub fn camera(width: u32, height: u32) -> Camera {
    let mut c = Camera::look_at([2.5, -2.0, 1.8], [0.1, 0.0, 0.0], [0.0, 0.0, 1.0], 0.9, width, height);
    c.cx += 1.3;
    c.cy -= 2.1;
    c
}

/// An orthographic camera for the random scenes.
pub fn orthographic(size: u32) -> Camera {
    Camera::orthographic([0.0; 3], [0.4, -0.7, -0.3], [0.0, 0.0, 1.0], 1.7, 5.0, size, size)
}

/// One pixel of the reference.
#[derive(Clone, Debug)]
pub struct Pixel {
    pub rgb: Vec3<f64>,
    pub t: f64,
    pub depth: f64,
    pub planar: f64,
    pub median: f64,
    pub normal: Vec3<f64>,
    pub temperature: f64,
    pub argmax: u32,
    pub best: f64,
    pub second: f64,
    /// Smallest relative distance of any decision (alpha against its limit, transmittance against the stop) from a tie.
    pub margin: f64,
    /// Smallest distance of a transmittance from the gate ½.
    pub gate: f64,
    /// Smallest relative distance of the planar depth's conditions from a tie.
    pub planar_margin: f64,
}

/// The reference's answer.
pub struct Reference {
    pub pixels: Vec<Pixel>,
    pub w_max: Vec<f64>,
    pub w_sum: Vec<f64>,
    pub votes: Vec<Vec3<f64>>,
    /// Weight of the votes whose gate is within rounding of a tie.
    pub vote_slack: Vec<f64>,
    pub blended: Vec<u32>,
}

struct Item {
    index: usize,
    z: f64,
    mean: [f64; 2],
    conic: [f64; 3],
    opacity: f64,
    rgb: Vec3<f64>,
    normal: Vec3<f64>,
    plane: f64,
    temperature: f64,
}

fn items(g: &Gaussians, cam: &Camera, s: &Settings) -> Vec<Item> {
    let w: Mat3<f64> = mat3::cast(cam.rotation);
    let t: Vec3<f64> = vec3::cast(cam.translation);
    let center = mat3::tmul_vec(w, t).map(|v| -v);
    let (wd, ht, cx, cy) = (f64::from(cam.width), f64::from(cam.height), f64::from(cam.cx), f64::from(cam.cy));
    let mut out = Vec::new();
    for i in 0..g.len() {
        let mean: Vec3<f64> = vec3::cast(g.mean[i]);
        let p = vec3::add(mat3::mul_vec(w, mean), t);
        if p[2] <= f64::from(s.z_near) {
            continue;
        }
        let (j, m) = match cam.projection {
            Projection::Pinhole { fx, fy } => {
                let (fx, fy) = (f64::from(fx), f64::from(fy));
                let u = (p[0] / p[2]).clamp(-(cx + 0.15 * wd) / fx, (1.15 * wd - cx) / fx);
                let v = (p[1] / p[2]).clamp(-(cy + 0.15 * ht) / fy, (1.15 * ht - cy) / fy);
                let j = [[fx / p[2], 0.0, -fx * u / p[2]], [0.0, fy / p[2], -fy * v / p[2]]];
                (j, [fx * p[0] / p[2] + cx, fy * p[1] / p[2] + cy])
            }
            Projection::Orthographic { scale } => {
                let k = f64::from(scale);
                ([[k, 0.0, 0.0], [0.0, k, 0.0]], [k * p[0] + cx, k * p[1] + cy])
            }
        };
        let rows = j.map(|r| mat3::tmul_vec(w, r));
        let sigma: Mat3<f64> = mat3::cast(unpack_covariance(g.covariance[i]));
        let cov = |a: usize, b: usize| vec3::dot(rows[a], mat3::mul_vec(sigma, rows[b]));
        let (s00, s01, s11) = (cov(0, 0), cov(0, 1), cov(1, 1));
        let pixel = g.trained_pixel.get(i).map_or(0.0, |p| f64::from(*p));
        let magnification = match cam.projection {
            Projection::Pinhole { fx, fy } => [fx, fy].map(|f| f64::from(f) / p[2]),
            Projection::Orthographic { scale } => [f64::from(scale); 2],
        };
        let q = magnification.map(|m| if pixel > 0.0 { m * pixel } else { 1.0 });
        let own = [s00 + f64::from(s.low_pass) * q[0] * q[0], s11 + f64::from(s.low_pass) * q[1] * q[1]];
        let [a, c] = [0, 1].map(|k| own[k] + (1.0 - q[k] * q[k]).max(0.0) / 12.0);
        let det = a * c - s01 * s01;
        let mut opacity = f64::from(g.opacity[i]);
        if pixel > 0.0 && !s.anti_aliased {
            opacity *= ((own[0] * own[1] - s01 * s01) / det).max(2.5e-5).sqrt();
        }
        if s.anti_aliased {
            opacity *= ((s00 * s11 - s01 * s01) / det).max(2.5e-5).sqrt();
        }
        let toward = vec3::sub(mean, center);
        let pinhole = matches!(cam.projection, Projection::Pinhole { .. });
        let d = if pinhole { vec3::scale(toward, vec3::norm(toward).recip()) } else { w[2] };
        let d_colour = g.view_rotation.get(i).map_or(d, |r| {
            let r: [f64; 9] = r.map(f64::from);
            mat3::tmul_vec([[r[0], r[1], r[2]], [r[3], r[4], r[5]], [r[6], r[7], r[8]]], d)
        });
        let coefficients: Vec<f64> = g.sh[i * g.sh_stride()..(i + 1) * g.sh_stride()].iter().map(|&v| f64::from(v)).collect();
        let n: Vec3<f64> = g.normal.get(i).map_or([0.0; 3], |n| vec3::cast(*n));
        let n = if vec3::dot(n, d) > 0.0 { n.map(|v| -v) } else { n };
        out.push(Item {
            index: i,
            z: p[2],
            mean: m,
            conic: [c / det, -s01 / det, a / det],
            opacity,
            rgb: sh::colour(g.sh_degree, &coefficients, d_colour),
            normal: n,
            plane: vec3::dot(n, toward),
            temperature: g.temperature.get(i).map_or(f64::from(megas_model::AMBIENT_K), |&t| f64::from(t)),
        });
    }
    // Depth is compared as the rasterizer's sort key is: in single precision.
    out.sort_by(|a, b| (a.z as f32).total_cmp(&(b.z as f32)).then(a.index.cmp(&b.index)));
    out
}

/// Renders everything that the rasterizer can produce.
pub fn render(g: &Gaussians, cam: &Camera, s: &Settings) -> Reference {
    let items = items(g, cam, s);
    let n = g.len();
    let mut out = Reference {
        pixels: Vec::new(),
        w_max: vec![0.0; n],
        w_sum: vec![0.0; n],
        votes: vec![[0.0; 3]; n],
        vote_slack: vec![0.0; n],
        blended: vec![0; n],
    };
    let (alpha_min, alpha_max, t_stop) = (f64::from(s.alpha_min), f64::from(s.alpha_max), f64::from(s.t_stop));
    let w: Mat3<f64> = mat3::cast(cam.rotation);
    for y in 0..cam.height {
        for x in 0..cam.width {
            let (px, py) = (f64::from(x) + 0.5, f64::from(y) + 0.5);
            let (u, v) = (px - f64::from(cam.cx), py - f64::from(cam.cy));
            let ray = match cam.projection {
                Projection::Pinhole { fx, fy } => mat3::tmul_vec(w, [u / f64::from(fx), v / f64::from(fy), 1.0]),
                Projection::Orthographic { .. } => w[2],
            };
            let unit = vec3::scale(ray, vec3::norm(ray).recip());
            let mut p = Pixel {
                rgb: [0.0; 3],
                t: 1.0,
                depth: 0.0,
                planar: f64::INFINITY,
                median: 0.0,
                normal: [0.0; 3],
                temperature: 0.0,
                argmax: NO_GAUSSIAN,
                best: 0.0,
                second: 0.0,
                margin: 1.0,
                gate: 1.0,
                planar_margin: 1.0,
            };
            let mut plane = 0.0;
            for e in &items {
                let (dx, dy) = (e.mean[0] - px, e.mean[1] - py);
                let q = 0.5 * (e.conic[0] * dx * dx + e.conic[2] * dy * dy) + e.conic[1] * dx * dy;
                let alpha = (e.opacity * (-q).exp()).min(alpha_max);
                p.margin = p.margin.min((alpha / alpha_min - 1.0).abs());
                if alpha < alpha_min {
                    continue;
                }
                let after = p.t * (1.0 - alpha);
                p.margin = p.margin.min((after / t_stop - 1.0).abs());
                if after < t_stop {
                    break;
                }
                let wt = alpha * p.t;
                p.rgb = vec3::add_scaled(p.rgb, e.rgb, wt);
                p.depth += wt * e.z;
                p.normal = vec3::add_scaled(p.normal, e.normal, wt);
                plane += wt * e.plane;
                p.temperature += wt * e.temperature;
                p.gate = p.gate.min((p.t - 0.5).abs());
                if (p.t - 0.5).abs() < 1e-5 {
                    out.vote_slack[e.index] += wt;
                }
                if p.t > 0.5 {
                    p.median = e.z;
                    out.votes[e.index] = vec3::add_scaled(out.votes[e.index], unit, -wt);
                }
                if wt > p.best {
                    p.second = p.best;
                    (p.best, p.argmax) = (wt, e.index as u32);
                } else {
                    p.second = p.second.max(wt);
                }
                out.w_max[e.index] = out.w_max[e.index].max(wt);
                out.w_sum[e.index] += wt;
                out.blended[e.index] += 1;
                p.t = after;
            }
            let alpha = 1.0 - p.t;
            p.rgb = vec3::add_scaled(p.rgb, vec3::cast(s.background), p.t);
            p.depth /= alpha.max(1e-6);
            let facing = vec3::dot(p.normal, ray);
            p.planar_margin = (alpha - 0.5).abs().min((facing + 1e-3 * alpha).abs());
            if alpha >= 0.5 && facing <= -1e-3 * alpha {
                let offset = match cam.projection {
                    Projection::Pinhole { .. } => 0.0,
                    Projection::Orthographic { scale } => {
                        let k = f64::from(scale);
                        vec3::dot(p.normal, mat3::tmul_vec(w, [u / k, v / k, 0.0]))
                    }
                };
                p.planar = (plane - offset) / facing;
            }
            out.pixels.push(p);
        }
    }
    out
}
