//! Outward normals (splatting.md §6.2): the shortest axis of a Gaussian is a line; who sees it first decides its sign.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use megas_math::{Vec3, mat3, vec3};
use megas_model::{Camera, Projection, Splats, fibonacci_directions};
use megas_raster::{self as raster, Channels, Frame, Gaussians, NO_GAUSSIAN, Rasterizer};
use rayon::prelude::*;

use crate::neighbours::Neighbours;

/// Gaussians that are seen less than this fraction as well as the best-seen tenth are buried.
const FRONT_LAYER: f32 = 0.7;

/// Options of the vote.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OrientSettings {
    /// Number of virtual orthographic views, 16–256.
    pub views: usize,
    /// Pixels per side of a view; by default from the size of the Gaussians, within 128–512 (§7.1).
    pub resolution: Option<usize>,
    /// Neighbours of the graph along which signs spread; 10 by default.
    pub neighbours: usize,
}

impl Default for OrientSettings {
    fn default() -> Self {
        Self { views: 64, resolution: None, neighbours: 10 }
    }
}

/// How the signs came about.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct OrientReport {
    /// Signs from the vote.
    pub voted: usize,
    /// Signs taken over from neighbours.
    pub propagated: usize,
    /// Signs of Gaussians without any voted Gaussian in reach: away from the middle.
    pub guessed: usize,
    /// Fraction of the neighbour pairs whose normals oppose each other; above 5 % the filling suffers.
    pub inconsistent: f64,
    /// The same fraction among flat, parallel neighbours only (`S³ < 0.5 S²`, within 60° as lines), where it means an error.
    pub inconsistent_flat: f64,
    /// Pixels per side of a view.
    pub resolution: usize,
}

/// What all views together saw of each Gaussian.
#[derive(Clone, Debug, Default)]
pub struct Visibility {
    /// Σ over the contributions with T > 0.5 before them of weight × direction to the viewer.
    pub vote: Vec<Vec3<f32>>,
    /// Largest blend weight α T over all pixels.
    pub w_max: Vec<f32>,
    /// The views, for asking what they can see.
    views: Vec<DepthView>,
}

/// How far one view sees.
#[derive(Clone, Debug)]
struct DepthView {
    camera: Camera,
    /// Width of a pixel in scene units.
    pixel: f32,
    /// Depth at which the Gaussian with the largest weight answers the ray most, +∞ where less than half of the light is
    /// stopped.
    depth: Vec<f32>,
}

/// What one view sees of the surface. The depth of a centre would not do: along grazing rays a disc answers far from it.
fn depth_view(splats: &Splats, camera: Camera, frame: &Frame) -> DepthView {
    let Projection::Orthographic { scale } = camera.projection else { return DepthView { camera, pixel: 0.0, depth: Vec::new() } };
    // Depth over the image plane, per Gaussian: z = z₀ + Σ_z⊥ Σ_⊥⊥⁻¹ y (§6.4).
    let planes: Vec<[f32; 6]> = (0..splats.len())
        .into_par_iter()
        .map(|i| {
            let p = camera.to_camera(splats.mean[i]);
            let c = mat3::congruence(camera.rotation, splats.covariance(i));
            // The low-pass of the image keeps edge-on discs from infinite slopes.
            let (a, b) = (c[0][0] + 0.3 / (scale * scale), c[1][1] + 0.3 / (scale * scale));
            let det = a * b - c[0][1] * c[0][1];
            let slope = [(c[2][0] * b - c[2][1] * c[0][1]) / det, (c[2][1] * a - c[2][0] * c[0][1]) / det];
            [p[0], p[1], p[2], slope[0], slope[1], 3.0 * c[2][2].max(0.0).sqrt()]
        })
        .collect();
    let width = camera.width as usize;
    let depth = frame
        .argmax
        .par_iter()
        .zip(&frame.transmittance)
        .enumerate()
        .map(|(k, (&i, &t))| {
            if t > 0.5 || i == NO_GAUSSIAN {
                return f32::INFINITY;
            }
            let [x, y, z, dx, dy, reach] = planes[i as usize];
            let at = [((k % width) as f32 + 0.5 - camera.cx) / scale - x, ((k / width) as f32 + 0.5 - camera.cy) / scale - y];
            z + (dx * at[0] + dy * at[1]).clamp(-reach, reach)
        })
        .collect();
    DepthView { camera, pixel: scale.recip(), depth }
}

impl Visibility {
    /// True where every view is blocked at least a pixel's width before it reaches the scene point `x`.
    pub fn hidden(&self, x: Vec3<f32>) -> bool {
        !self.views.is_empty()
            && self.views.iter().all(|v| {
                let p = v.camera.to_camera(x);
                let [u, w] = v.camera.project(p);
                let inside = u >= 0.0 && w >= 0.0 && u < v.camera.width as f32 && w < v.camera.height as f32;
                inside && p[2] - v.pixel > v.depth[w as usize * v.camera.width as usize + u as usize]
            })
    }

    /// Keeps the Gaussians at `indices`.
    pub(crate) fn retain(&mut self, indices: &[usize]) {
        self.vote = indices.iter().map(|&i| self.vote[i]).collect();
        self.w_max = indices.iter().map(|&i| self.w_max[i]).collect();
    }
}

/// Looks at the Gaussians from all sides with orthographic cameras on a Fibonacci sphere (§7.1). Also returns the
/// resolution used.
pub fn visibility(splats: &Splats, settings: &OrientSettings) -> (Visibility, usize) {
    let n = splats.len();
    let mut seen = Visibility { vote: vec![[0.0; 3]; n], w_max: vec![0.0; n], views: Vec::new() };
    let Some((center, radius)) = ball(splats) else { return (seen, 0) };
    let half = 1.05 * radius;
    let resolution = settings.resolution.unwrap_or_else(|| default_resolution(splats, half)).clamp(16, 4096);
    let center: Vec3<f32> = vec3::cast(center);
    // Far enough for every mean to be in front of the camera; nothing else depends on the distance.
    let far = splats.mean.iter().map(|&m| vec3::norm(vec3::sub(m, center))).filter(|d| d.is_finite()).fold(half as f32, f32::max);
    let image = raster::Settings { z_near: 0.0, ..raster::Settings::default() };
    let mut gaussians = Gaussians::from_splats(splats);
    // These views ask where a surface is, not what it looks like: in coarse pixels the usual blur closes the gaps of a thin model.
    gaussians.trained_pixel.clear();
    let mut rasterizer = Rasterizer::new();
    let mut frame = Frame::default();
    for d in fibonacci_directions(settings.views) {
        // Any direction across will do as the image's up.
        let up = vec3::frame_from_normal(d).1;
        let side = resolution as u32;
        let camera = Camera::orthographic(center, d.map(|v| -v), up, half as f32, 2.0 * far, side, side);
        rasterizer.render(&gaussians, &camera, &image, Channels::Weights, &mut frame);
        for i in 0..n {
            seen.vote[i] = vec3::add(seen.vote[i], frame.statistics.votes[i]);
            seen.w_max[i] = seen.w_max[i].max(frame.statistics.w_max[i]);
        }
        seen.views.push(depth_view(splats, camera, &frame));
    }
    (seen, resolution)
}

/// Centre and radius of the ball around the robust box.
fn ball(splats: &Splats) -> Option<(Vec3<f64>, f64)> {
    let b = crate::select::robust_bounds(splats, &vec![true; splats.len()], mat3::identity())?;
    // A point or a line of Gaussians still gets a view of some size.
    let radius = (0.5 * b.diagonal()).max(1e-9);
    Some((b.center(), radius))
}

fn default_resolution(splats: &Splats, half: f64) -> usize {
    let mut s: Vec<f32> = splats
        .log_scale
        .iter()
        .map(|s| {
            let mut s = *s;
            s.sort_by(f32::total_cmp);
            s[1]
        })
        .collect();
    if s.is_empty() {
        return 128;
    }
    let mid = s.len() / 2;
    let typical = f64::from(s.select_nth_unstable_by(mid, f32::total_cmp).1.exp());
    ((2.0 * half / typical.max(1e-12)).ceil() as usize).clamp(128, 512)
}

/// Sets [`Splats::normal_sign`] of every Gaussian from the vote, spreads it to those that nobody saw, and reports.
pub fn orient(splats: &mut Splats, settings: &OrientSettings) -> OrientReport {
    let (seen, resolution) = visibility(splats, settings);
    let mut report = orient_from(splats, &seen, settings);
    report.resolution = resolution;
    report
}

/// [`orient`] with votes at hand.
pub fn orient_from(splats: &mut Splats, seen: &Visibility, settings: &OrientSettings) -> OrientReport {
    let n = splats.len();
    splats.normal_sign.iter_mut().for_each(|s| *s = 1);
    let axis: Vec<Vec3<f32>> = (0..n).map(|i| splats.normal(i)).collect();
    let mut report = OrientReport::default();
    let mut sign = vec![0i8; n];
    for i in 0..n {
        let (toward, length) = (vec3::dot(axis[i], seen.vote[i]), vec3::norm(seen.vote[i]));
        if length > 0.0 && toward.abs() >= 0.1 * length {
            sign[i] = if toward < 0.0 { -1 } else { 1 };
            report.voted += 1;
        }
    }
    let graph = graph(splats, settings.neighbours.max(1));
    (report.propagated, report.guessed) = spread(splats, &axis, &graph, &mut sign);
    splats.normal_sign = sign;

    let flat: Vec<bool> = (0..n)
        .map(|i| {
            let mut s = splats.log_scale[i];
            s.sort_by(f32::total_cmp);
            s[0] < s[1] - std::f32::consts::LN_2
        })
        .collect();
    let (mut all, mut bad, mut all_flat, mut bad_flat) = (0usize, 0usize, 0usize, 0usize);
    for i in 0..n {
        for &j in &graph[i] {
            let c = vec3::dot(axis[i], axis[j as usize]) * f32::from(splats.normal_sign[i] * splats.normal_sign[j as usize]);
            all += 1;
            bad += usize::from(c < 0.0);
            if flat[i] && flat[j as usize] && c.abs() > 0.5 {
                all_flat += 1;
                bad_flat += usize::from(c < 0.0);
            }
        }
    }
    report.inconsistent = bad as f64 / all.max(1) as f64;
    report.inconsistent_flat = bad_flat as f64 / all_flat.max(1) as f64;
    report
}

/// Normals for the interior test, in scene axes; zero for Gaussians under the skin.
///
/// The design takes the oriented shortest axis of every Gaussian. That holds for shells trained to be flat and free of an
/// interior. Imported splats have layers of buried Gaussians with arbitrary axes, which a ray from inside meets first; and
/// many of their Gaussians are not flat. So:
///
/// * how well a Gaussian is seen is `r = w_max / o`. Those with `r` below 0.7 of the upper decile keep their opacity but get
///   no say. The measure is relative because discs of a clean shell cover each other in part (a median of 0.55
///   there against 0.66 for the decile, so that most pass; on a pretrained donut the decile is 0.9 and a third passes);
/// * the others mean their axis as far as they are flat and the direction they are seen from as far as they are not,
///   averaged over the neighbours that are seen from the same side.
pub fn wall_normals(splats: &Splats, seen: &Visibility, neighbours: usize) -> Vec<Vec3<f32>> {
    let n = splats.len();
    let mut out = vec![[0.0; 3]; n];
    if n == 0 {
        return out;
    }
    let share: Vec<f32> = (0..n).map(|i| seen.w_max[i] / splats.opacity(i).min(0.99)).collect();
    let mut sorted = share.clone();
    let decile = *sorted.select_nth_unstable_by(n * 9 / 10, f32::total_cmp).1;
    let front: Vec<usize> = (0..n).filter(|&i| share[i] >= FRONT_LAYER * decile).collect();
    let own: Vec<Vec3<f32>> = front
        .iter()
        .map(|&i| {
            let mut s = splats.log_scale[i];
            s.sort_by(f32::total_cmp);
            let axis = splats.normal(i);
            let view = vec3::normalize_or(seen.vote[i], axis);
            vec3::normalize_or(vec3::lerp(axis, view, (s[0] - s[1]).exp()), view)
        })
        .collect();
    let Some(tree) = Neighbours::new(&front.iter().map(|&i| splats.mean[i]).collect::<Vec<_>>()) else { return out };
    let smooth: Vec<Vec3<f32>> = (0..front.len())
        .into_par_iter()
        .map(|f| {
            let vote = seen.vote[front[f]];
            let near = tree.nearest(&splats.mean[front[f]], neighbours);
            let same = near.iter().map(|&(j, _)| j as usize).filter(|&j| vec3::dot(vote, seen.vote[front[j]]) >= 0.0);
            vec3::normalize_or(same.fold([0.0; 3], |sum, j| vec3::add(sum, own[j])), own[f])
        })
        .collect();
    for (&i, &v) in front.iter().zip(&smooth) {
        out[i] = v;
    }
    out
}

/// The `k` nearest neighbours of every Gaussian, itself excluded.
fn graph(splats: &Splats, k: usize) -> Vec<Vec<u32>> {
    let Some(tree) = Neighbours::new(&splats.mean) else { return vec![Vec::new(); splats.len()] };
    splats
        .mean
        .par_iter()
        .enumerate()
        .map(|(i, m)| tree.nearest(m, k + 1).into_iter().map(|n| n.0).filter(|&j| j as usize != i).take(k).collect())
        .collect()
}

/// Grows a minimum spanning forest on `1 − |n_i·n_j|` from the known signs; islands without one start at the Gaussian
/// farthest from the middle, pointing away from it. Returns how many signs were propagated and guessed.
fn spread(splats: &Splats, axis: &[Vec3<f32>], graph: &[Vec<u32>], sign: &mut [i8]) -> (usize, usize) {
    let n = sign.len();
    // Neighbourhood is not symmetric; the graph is.
    let mut edges: Vec<Vec<u32>> = graph.to_vec();
    for (i, list) in graph.iter().enumerate() {
        for &j in list {
            if !graph[j as usize].contains(&(i as u32)) {
                edges[j as usize].push(i as u32);
            }
        }
    }
    let mut heap: BinaryHeap<Reverse<(u32, u32, u32)>> = BinaryHeap::new();
    let offer = |heap: &mut BinaryHeap<_>, sign: &[i8], i: usize| {
        for &j in &edges[i] {
            if sign[j as usize] == 0 {
                let cost = 1.0 - vec3::dot(axis[i], axis[j as usize]).abs().min(1.0);
                // Bits of a non-negative float sort like the float.
                heap.push(Reverse((cost.to_bits(), j, i as u32)));
            }
        }
    };
    for i in 0..n {
        if sign[i] != 0 {
            offer(&mut heap, sign, i);
        }
    }
    let middle = ball(splats).map_or([0.0; 3], |b| vec3::cast(b.0));
    let mut islands: Vec<u32> = (0..n as u32).filter(|&i| sign[i as usize] == 0).collect();
    let away = |i: u32| vec3::sub(splats.mean[i as usize], middle);
    islands.sort_by(|&p, &q| vec3::norm(away(p)).total_cmp(&vec3::norm(away(q))).then(q.cmp(&p)));
    let (mut propagated, mut guessed) = (0, 0);
    loop {
        while let Some(Reverse((_, j, i))) = heap.pop() {
            let (i, j) = (i as usize, j as usize);
            if sign[j] == 0 {
                sign[j] = if vec3::dot(axis[i], axis[j]) < 0.0 { -sign[i] } else { sign[i] };
                propagated += 1;
                offer(&mut heap, sign, j);
            }
        }
        let Some(i) = islands.pop() else { return (propagated, guessed) };
        if sign[i as usize] == 0 {
            sign[i as usize] = if vec3::dot(axis[i as usize], away(i)) < 0.0 { -1 } else { 1 };
            guessed += 1;
            offer(&mut heap, sign, i as usize);
        }
    }
}
