//! Gradient checks (splatting.md §10.1). The oracle is the rasterizer and its gradient once more, in double precision and as
//! plainly as possible; the oracle's gradient is checked against central differences of its own forward pass, and the
//! production kernels against the oracle.

use megas_math::{Vec3, mat3, quat, rng::Rng, sh, vec3};
use megas_model::{Camera, Projection, Splats, logit};

use super::chain::{ChainView, Outcome, Parameters, Received, chain};
use super::{Cotangents, Gradients};
use crate::{Channels, Gaussians, Rasterizer, Settings};

/// Channels: colour (3), alpha, depth, normal (3), plane distance, temperature.
const CHANNELS: usize = 10;

/// One Gaussian in double precision.
#[derive(Clone)]
struct G {
    mean: Vec3<f64>,
    log_scale: Vec3<f64>,
    rotation: [f64; 4],
    logit: f64,
    sh: Vec<f64>,
    temperature: f64,
}

/// Parameters in one list: mean, log-scale, quaternion, logit, temperature, coefficients.
impl G {
    fn values(&mut self) -> Vec<&mut f64> {
        let mut v: Vec<&mut f64> = Vec::new();
        v.extend(self.mean.iter_mut());
        v.extend(self.log_scale.iter_mut());
        v.extend(self.rotation.iter_mut());
        v.push(&mut self.logit);
        v.push(&mut self.temperature);
        v.extend(self.sh.iter_mut());
        v
    }
}

fn gradient_values(o: &Outcome<f64>, coefficients: usize) -> Vec<f64> {
    let mut v = Vec::new();
    v.extend(o.mean);
    v.extend(o.log_scale);
    v.extend(o.rotation);
    v.push(o.opacity_logit);
    v.push(o.temperature);
    for y in sh::basis(o.direction).iter().take(coefficients) {
        v.extend(o.colour.map(|c| c * y));
    }
    v
}

/// A smooth step from 0 to 1 around `at`, or the production cut-off.
#[derive(Clone, Copy)]
enum CutOff {
    /// Nothing is cut: no discontinuity at all.
    None,
    /// C¹ step of this width around 1/255.
    Smooth(f64),
}

struct Item {
    i: usize,
    z: f64,
    m: [f64; 2],
    q: [f64; 3],
    opacity: f64,
    f: [f64; CHANNELS],
}

fn degree_of(g: &G) -> u8 {
    match g.sh.len() / 3 {
        1 => 0,
        4 => 1,
        9 => 2,
        _ => 3,
    }
}

fn items(gs: &[G], cam: &Camera, s: &Settings) -> Vec<Item> {
    let w = cam.rotation.map(|r| r.map(f64::from));
    let t = cam.translation.map(f64::from);
    let center = mat3::tmul_vec(w, t).map(|v| -v);
    let (wd, ht, cx, cy) = (f64::from(cam.width), f64::from(cam.height), f64::from(cam.cx), f64::from(cam.cy));
    let mut out: Vec<Item> = gs
        .iter()
        .enumerate()
        .map(|(i, g)| {
            let p = vec3::add(mat3::mul_vec(w, g.mean), t);
            let r = quat::to_mat3(g.rotation);
            let e = g.log_scale.map(f64::exp);
            let m = r.map(|row| [row[0] * e[0], row[1] * e[1], row[2] * e[2]]);
            let sigma = mat3::mul(m, mat3::transpose(m));
            let (j, mean) = match cam.projection {
                Projection::Pinhole { fx, fy } => {
                    let (fx, fy) = (f64::from(fx), f64::from(fy));
                    let u = (p[0] / p[2]).clamp(-(cx + 0.15 * wd) / fx, (1.15 * wd - cx) / fx);
                    let v = (p[1] / p[2]).clamp(-(cy + 0.15 * ht) / fy, (1.15 * ht - cy) / fy);
                    ([[fx / p[2], 0.0, -fx * u / p[2]], [0.0, fy / p[2], -fy * v / p[2]]], [fx * p[0] / p[2] + cx, fy * p[1] / p[2] + cy])
                }
                Projection::Orthographic { scale } => {
                    let k = f64::from(scale);
                    ([[k, 0.0, 0.0], [0.0, k, 0.0]], [k * p[0] + cx, k * p[1] + cy])
                }
            };
            let rows = j.map(|row| mat3::tmul_vec(w, row));
            let cov = |a: usize, b: usize| vec3::dot(rows[a], mat3::mul_vec(sigma, rows[b]));
            let (s00, s01, s11) = (cov(0, 0), cov(0, 1), cov(1, 1));
            let (a, c) = (s00 + f64::from(s.low_pass), s11 + f64::from(s.low_pass));
            let det = a * c - s01 * s01;
            let mut opacity = 1.0 / (1.0 + (-g.logit).exp());
            if s.anti_aliased {
                opacity *= ((s00 * s11 - s01 * s01) / det).max(2.5e-5).sqrt();
            }
            let toward = vec3::sub(g.mean, center);
            let pinhole = matches!(cam.projection, Projection::Pinhole { .. });
            let d = if pinhole { vec3::scale(toward, vec3::norm(toward).recip()) } else { w[2] };
            let k = (0..3).min_by(|&a, &b| g.log_scale[a].total_cmp(&g.log_scale[b])).unwrap();
            let n = mat3::column(r, k);
            let n = if vec3::dot(n, d) > 0.0 { n.map(|v| -v) } else { n };
            let rgb = sh::colour(degree_of(g), &g.sh, d);
            Item {
                i,
                z: p[2],
                m: mean,
                q: [c / det, -s01 / det, a / det],
                opacity,
                f: [rgb[0], rgb[1], rgb[2], 1.0, p[2], n[0], n[1], n[2], vec3::dot(n, toward), g.temperature],
            }
        })
        .collect();
    out.sort_by(|a, b| a.z.total_cmp(&b.z));
    out
}

/// `α(ô e^{−q})` and its derivative with the largest alpha and the cut-off.
fn alpha(raw: f64, s: &Settings, cut: CutOff) -> (f64, f64) {
    let (a, mut d) = if raw > f64::from(s.alpha_max) { (f64::from(s.alpha_max), 0.0) } else { (raw, 1.0) };
    let CutOff::Smooth(width) = cut else { return (a, d) };
    let x = ((a - 1.0 / 255.0) / width + 0.5).clamp(0.0, 1.0);
    let (step, slope) = (x * x * (3.0 - 2.0 * x), 6.0 * x * (1.0 - x) / width);
    d *= step + a * slope;
    (a * step, d)
}

/// `Σ g·acc` over all pixels (colour composited), with one set of cotangents per pixel.
fn loss(gs: &[G], cam: &Camera, s: &Settings, cut: CutOff, cot: &[[f64; CHANNELS]]) -> f64 {
    let items = items(gs, cam, s);
    let mut sum = 0.0;
    for (k, g) in cot.iter().enumerate() {
        let x = [(k % cam.width as usize) as f64 + 0.5, (k / cam.width as usize) as f64 + 0.5];
        let mut t = 1.0;
        for e in &items {
            let d = [e.m[0] - x[0], e.m[1] - x[1]];
            let q = 0.5 * (e.q[0] * d[0] * d[0] + e.q[2] * d[1] * d[1]) + e.q[1] * d[0] * d[1];
            let (a, _) = alpha(e.opacity * (-q).exp(), s, cut);
            sum += a * t * (0..CHANNELS).map(|c| g[c] * e.f[c]).sum::<f64>();
            t *= 1.0 - a;
        }
        sum += t * (0..3).map(|c| g[c] * f64::from(s.background[c])).sum::<f64>();
    }
    sum
}

/// The gradient of [`loss`] by §4.1 and the production chain rule in double precision. `production` applies the production
/// cut-offs, with which [`loss`] cannot be differentiated.
fn oracle(gs: &[G], cam: &Camera, s: &Settings, cut: CutOff, production: bool, cot: &[[f64; CHANNELS]]) -> Vec<Outcome<f64>> {
    let items = items(gs, cam, s);
    let mut received = vec![Received::<f64>::default(); gs.len()];
    for (k, g) in cot.iter().enumerate() {
        let x = [(k % cam.width as usize) as f64 + 0.5, (k / cam.width as usize) as f64 + 0.5];
        let mut blended = Vec::new();
        let mut t = 1.0;
        for e in &items {
            let d = [e.m[0] - x[0], e.m[1] - x[1]];
            let q = 0.5 * (e.q[0] * d[0] * d[0] + e.q[2] * d[1] * d[1]) + e.q[1] * d[0] * d[1];
            let raw = e.opacity * (-q).exp();
            let (a, da) = alpha(raw, s, cut);
            if production && a < f64::from(s.alpha_min) {
                continue;
            }
            if production && t * (1.0 - a) < f64::from(s.t_stop) {
                break;
            }
            blended.push((e, d, raw, a, da, t));
            t *= 1.0 - a;
        }
        // Back to front: what lies behind each entry.
        let mut behind = t * (0..3).map(|c| g[c] * f64::from(s.background[c])).sum::<f64>();
        for &(e, d, raw, a, da, t) in blended.iter().rev() {
            let c: f64 = (0..CHANNELS).map(|c| g[c] * e.f[c]).sum();
            let slope = (t * c - behind / (1.0 - a)) * da;
            behind += a * t * c;
            let r = &mut received[e.i];
            let w = a * t;
            for c in 0..3 {
                r.rgb[c] += w * g[c];
                r.normal[c] += w * g[5 + c];
            }
            r.depth += w * g[4];
            r.plane += w * g[8];
            r.temperature += w * g[9];
            r.opacity += raw / e.opacity * slope;
            let gq = -raw * slope;
            let gm = [gq * (e.q[0] * d[0] + e.q[1] * d[1]), gq * (e.q[1] * d[0] + e.q[2] * d[1])];
            let dq = [0.5 * gq * d[0] * d[0], 0.5 * gq * d[0] * d[1], 0.5 * gq * d[1] * d[1]];
            // −Q (∂L/∂Q) Q.
            let [qa, qb, qc] = e.q;
            let u = [[qa * dq[0] + qb * dq[1], qa * dq[1] + qb * dq[2]], [qb * dq[0] + qc * dq[1], qb * dq[1] + qc * dq[2]]];
            r.covariance[0] -= u[0][0] * qa + u[0][1] * qb;
            r.covariance[1] -= u[0][0] * qb + u[0][1] * qc;
            r.covariance[2] -= u[1][0] * qb + u[1][1] * qc;
            for a in 0..2 {
                r.mean[a] += gm[a];
                r.absolute[a] += gm[a].abs();
            }
        }
    }
    let view = ChainView::<f64>::new(cam, s, true);
    gs.iter()
        .zip(&received)
        .map(|(g, r)| {
            let p = Parameters {
                mean: g.mean,
                log_scale: g.log_scale,
                rotation: g.rotation,
                opacity_logit: g.logit,
                degree: degree_of(g),
                sh: &g.sh,
            };
            let rgb = items.iter().find(|e| std::ptr::eq(&gs[e.i], g)).unwrap().f;
            chain(&view, &p, r, [rgb[0] > 0.0, rgb[1] > 0.0, rgb[2] > 0.0])
        })
        .collect()
}

/// Six Gaussians of §10.1, in numbers that single precision holds.
fn scene(seed: u64, n: usize, degree: u8) -> Vec<G> {
    let mut rng = Rng::new(seed);
    let mut f = |lo: f64, hi: f64| f64::from(rng.range(lo, hi) as f32);
    (0..n)
        .map(|_| G {
            mean: [f(-0.8, 0.8), f(-0.8, 0.8), f(-0.8, 0.8)],
            log_scale: [f(0.12f64.ln(), 0.35f64.ln()), f(0.12f64.ln(), 0.35f64.ln()), f(0.12f64.ln(), 0.35f64.ln())],
            rotation: [f(-1.0, 1.0), f(-1.0, 1.0), f(-1.0, 1.0), f(-1.0, 1.0)],
            logit: f(f64::from(logit(0.38)), f64::from(logit(0.88))),
            sh: (0..sh::coefficients(degree) * 3).map(|k| f(-1.0, 1.0) * if k < 3 { 1.2 } else { 0.25 }).collect(),
            temperature: f(0.5, 2.0),
        })
        .collect()
}

fn camera(width: u32, height: u32) -> Camera {
    let mut c = Camera::look_at([2.2, -1.6, 1.1], [0.0; 3], [0.0, 0.0, 1.0], 0.9, width, height);
    c.cx += 2.3;
    c.cy -= 1.7;
    c
}

fn cotangents(seed: u64, pixels: usize) -> Vec<[f64; CHANNELS]> {
    let mut rng = Rng::new(seed);
    (0..pixels).map(|_| std::array::from_fn(|_| f64::from(rng.range(-1.0, 1.0) as f32))).collect()
}

/// Largest error measure of §10.1 of the oracle against central differences, over all parameters.
fn check(gs: &[G], cam: &Camera, s: &Settings, cut: CutOff) -> f64 {
    let cot = cotangents(9, (cam.width * cam.height) as usize);
    let analytic = oracle(gs, cam, s, cut, false, &cot);
    let mut worst = 0.0f64;
    for i in 0..gs.len() {
        let an = gradient_values(&analytic[i], gs[i].sh.len() / 3);
        let mut moved = gs.to_vec();
        let fd: Vec<f64> = (0..an.len())
            .map(|k| {
                let x = *moved[i].values()[k];
                let h = 1e-5 * x.abs().max(1.0);
                let mut at = |v: f64| {
                    *moved[i].values()[k] = v;
                    loss(&moved, cam, s, cut, &cot)
                };
                let slope = (at(x + h) - at(x - h)) / (2.0 * h);
                at(x);
                slope
            })
            .collect();
        // Per kind of parameter, as in the document.
        for (from, to) in [(0, 3), (3, 6), (6, 10), (10, 11), (11, 12), (12, an.len())] {
            let largest = an[from..to].iter().fold(0.0f64, |m, v| m.max(v.abs()));
            for k in from..to {
                worst = worst.max((fd[k] - an[k]).abs() / (fd[k].abs() + an[k].abs() + 1e-3 * largest + 1e-12));
            }
        }
    }
    worst
}

fn exact() -> Settings {
    Settings { alpha_min: 0.0, t_stop: 0.0, background: [0.2, 0.5, 0.8], ..Settings::default() }
}

#[test]
fn all_gradients_match_central_differences() {
    for degree in 0..4 {
        let worst = check(&scene(3, 6, degree), &camera(40, 32), &exact(), CutOff::None);
        assert!(worst < 1e-6, "degree {degree}: {worst:e}");
    }
}

#[test]
fn gradients_hold_when_anti_aliased_orthographic_or_cut_smoothly() {
    let gs = scene(4, 6, 3);
    let anti = check(&gs, &camera(40, 32), &Settings { anti_aliased: true, ..exact() }, CutOff::None);
    assert!(anti < 1e-6, "{anti:e}");
    let ortho = Camera::orthographic([0.0; 3], [0.4, -0.7, -0.3], [0.0, 0.0, 1.0], 1.2, 5.0, 32, 32);
    let worst = check(&gs, &ortho, &exact(), CutOff::None);
    assert!(worst < 1e-6, "{worst:e}");
    let cut = check(&gs, &camera(40, 32), &exact(), CutOff::Smooth(1e-3));
    assert!(cut < 1e-5, "{cut:e}");
}

#[test]
fn gradients_hold_with_clamped_tangents_and_opaque_gaussians() {
    // Half outside the frustum: the tangent is clamped, and the projected mean is not.
    let mut gs = scene(5, 1, 3);
    gs[0].log_scale = gs[0].log_scale.map(|l| l + 0.9);
    let mut cam = camera(40, 32);
    cam.cx += 27.0;
    let worst = check(&gs, &cam, &exact(), CutOff::None);
    assert!(worst < 1e-6, "{worst:e}");
    let view = ChainView::<f64>::new(&cam, &exact(), true);
    let p = vec3::add(mat3::mul_vec(cam.rotation.map(|r| r.map(f64::from)), gs[0].mean), cam.translation.map(f64::from));
    assert!(view.clamps(p), "the scene misses its point");
    // So opaque that the largest alpha holds in the middle: no gradient comes from there.
    gs[0].logit = 9.0;
    let worst = check(&gs, &camera(40, 32), &exact(), CutOff::None);
    assert!(worst < 2e-3, "{worst:e}: the derivative jumps at the rim of the plateau, so differences are rough");
}

/// Relative L2 distance of production gradients from the oracle, per array.
fn compare(gs: &[G], cam: &Camera, s: &Settings, channels: Channels) -> Vec<(&'static str, f64)> {
    let geometry = channels == Channels::Geometry;
    let mut splats = Splats { sh_degree: degree_of(&gs[0]), ..Splats::default() };
    for g in gs {
        let sh: Vec<f32> = g.sh.iter().map(|&v| v as f32).collect();
        splats.push(g.mean.map(|v| v as f32), g.log_scale.map(|v| v as f32), g.rotation.map(|v| v as f32), g.logit as f32, &sh);
    }
    splats.temperature = gs.iter().map(|g| g.temperature as f32).collect();
    let pixels = (cam.width * cam.height) as usize;
    let mut cot = cotangents(11, pixels);
    if !geometry {
        cot.iter_mut().for_each(|c| c[4..].fill(0.0));
    }
    let mut raster = Rasterizer::new();
    let frame = raster.frame(&Gaussians::from_splats(&splats), cam, s, channels);
    let column = |k: usize| cot.iter().map(|c| c[k] as f32).collect::<Vec<f32>>();
    let triple = |k: usize| cot.iter().map(|c| [c[k] as f32, c[k + 1] as f32, c[k + 2] as f32]).collect::<Vec<_>>();
    let given =
        Cotangents { rgb: triple(0), alpha: column(3), depth: column(4), normal: triple(5), plane: column(8), temperature: column(9) };
    let mut got = Gradients::default();
    raster.backward(&splats, cam, s, channels, &frame, &given, &mut got);
    // A rasterizer that was used before, and other tiles, give the same to the last bit or to rounding.
    let mut again = Gradients::default();
    raster.backward(&splats, cam, s, channels, &frame, &given, &mut again);
    assert!(got == again);
    let want = oracle(gs, cam, s, CutOff::None, true, &cot);
    let mut out = Vec::new();
    let mut push = |name: &'static str, pairs: Vec<(f64, f64)>| {
        let difference: f64 = pairs.iter().map(|(a, b)| (a - b).powi(2)).sum();
        let norm: f64 = pairs.iter().map(|(_, b)| b * b).sum();
        out.push((name, (difference / norm.max(1e-30)).sqrt()));
    };
    let n = gs.len();
    push("mean", (0..n).flat_map(|i| (0..3).map(move |a| (i, a))).map(|(i, a)| (f64::from(got.mean[i][a]), want[i].mean[a])).collect());
    push(
        "scale",
        (0..n).flat_map(|i| (0..3).map(move |a| (i, a))).map(|(i, a)| (f64::from(got.log_scale[i][a]), want[i].log_scale[a])).collect(),
    );
    push(
        "rotation",
        (0..n).flat_map(|i| (0..4).map(move |a| (i, a))).map(|(i, a)| (f64::from(got.rotation[i][a]), want[i].rotation[a])).collect(),
    );
    push("opacity", (0..n).map(|i| (f64::from(got.opacity_logit[i]), want[i].opacity_logit)).collect());
    push(
        "sh",
        (0..n)
            .flat_map(|i| {
                let (a, b) = (got.sh(i), sh::basis(want[i].direction).map(|y| want[i].colour.map(|c| c * y)));
                (0..48).map(move |k| (f64::from(a[k / 3][k % 3]), b[k / 3][k % 3])).collect::<Vec<_>>()
            })
            .collect(),
    );
    push(
        "screen",
        (0..n).flat_map(|i| (0..2).map(move |a| (i, a))).map(|(i, a)| (f64::from(got.screen[i][a]), want[i].screen[a])).collect(),
    );
    if geometry {
        push("temperature", (0..n).map(|i| (f64::from(got.temperature[i]), want[i].temperature)).collect());
    }
    out
}

#[test]
fn production_kernels_agree_with_the_oracle() {
    let mut gs = scene(6, 2000, 3);
    let mut rng = Rng::new(8);
    for g in &mut gs {
        let small = f64::from(rng.range(0.05, 0.5) as f32);
        g.log_scale = g.log_scale.map(|l| f64::from((l + small.ln()) as f32));
    }
    let cam = camera(128, 128);
    let settings = Settings { background: [0.2, 0.5, 0.8], ..Settings::default() };
    for channels in [Channels::Rgba, Channels::Geometry] {
        for (name, error) in compare(&gs, &cam, &settings, channels) {
            assert!(error < 1e-3, "{channels:?} {name}: {error:e}");
        }
    }
    for (name, error) in compare(&gs, &cam, &Settings { anti_aliased: true, ..settings }, Channels::Geometry) {
        assert!(error < 1e-3, "anti-aliased {name}: {error:e}");
    }
}

#[test]
fn gradients_do_not_depend_on_threads_or_tiles() {
    let gs = scene(7, 500, 2);
    let cam = camera(97, 75);
    let mut splats = Splats { sh_degree: 2, ..Splats::default() };
    for g in &gs {
        let sh: Vec<f32> = g.sh.iter().map(|&v| v as f32).collect();
        splats.push(g.mean.map(|v| v as f32), g.log_scale.map(|v| v as f32 - 1.0), g.rotation.map(|v| v as f32), g.logit as f32, &sh);
    }
    let cot = Cotangents {
        rgb: cotangents(3, 97 * 75).iter().map(|c| [c[0] as f32, c[1] as f32, c[2] as f32]).collect(),
        ..Cotangents::default()
    };
    let run = |threads: usize, tile: crate::TileSize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let settings = Settings { tile, ..Settings::default() };
            let mut raster = Rasterizer::new();
            let frame = raster.frame(&Gaussians::from_splats(&splats), &cam, &settings, Channels::Rgba);
            let mut out = Gradients::default();
            raster.backward(&splats, &cam, &settings, Channels::Rgba, &frame, &cot, &mut out);
            out
        })
    };
    let first = run(1, crate::TileSize::T16);
    assert!(first == run(3, crate::TileSize::T16));
    for tile in [crate::TileSize::T8, crate::TileSize::T32] {
        let other = run(2, tile);
        let scale = first.mean.iter().flatten().fold(0.0f32, |m, v| m.max(v.abs()));
        for (a, b) in first.mean.iter().flatten().zip(other.mean.iter().flatten()) {
            assert!((a - b).abs() < 1e-5 * scale, "{a} {b}");
        }
    }
}
