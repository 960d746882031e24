//! Outward normals (splatting.md §6.2): the shortest axis of a Gaussian is a line; who sees it first decides its sign.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use megas_math::{Mat3, Vec3, mat3, vec3};
use megas_model::{Splats, fibonacci_directions};
use rayon::prelude::*;

use crate::fill::columns::sweep;
use crate::fill::{Grid, Shell};
use crate::neighbours::Neighbours;

/// Options of the vote.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OrientSettings {
    /// Number of virtual orthographic views, even, 16–256. Each line of sight serves two opposite views.
    pub views: usize,
    /// Rays per side of a view; by default from the spacing of the Gaussians, within 128–512 (§7.1).
    pub resolution: Option<usize>,
    /// Only contributions with more transmittance than this before them may vote; 0.5 by default.
    pub gate: f32,
    /// Neighbours of the graph along which signs spread; 10 by default.
    pub neighbours: usize,
}

impl Default for OrientSettings {
    fn default() -> Self {
        Self { views: 64, resolution: None, gate: 0.5, neighbours: 10 }
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
    /// Rays per side of a view.
    pub resolution: usize,
}

/// What all views together saw of each Gaussian.
#[derive(Clone, Debug, Default)]
pub struct Visibility {
    /// Σ over the front-layer contributions of weight × direction to the viewer.
    pub vote: Vec<Vec3<f32>>,
    /// Largest blend weight α T over all rays.
    pub w_max: Vec<f32>,
}

/// Looks at the Gaussians from all sides with parallel rays, depth-sorted exactly on every ray, with the rasterizer's
/// low-pass of 0.3 px² so that no Gaussian falls between the rays.
pub fn visibility(splats: &Splats, settings: &OrientSettings) -> (Visibility, usize) {
    let n = splats.len();
    let mut seen = Visibility { vote: vec![[0.0; 3]; n], w_max: vec![0.0; n] };
    let Some((center, radius)) = ball(splats) else { return (seen, 0) };
    let half = 1.05 * radius;
    let resolution = settings.resolution.unwrap_or_else(|| default_resolution(splats, half)).clamp(16, 4096);
    let pixel = 2.0 * half / resolution as f64;
    // Both ends of one line are views, so that half as many sweeps do.
    let lines: Vec<Vec3<f32>> = fibonacci_directions(2 * settings.views.div_ceil(2)).into_iter().take(settings.views.div_ceil(2)).collect();
    for batch in lines.chunks(8) {
        let parts: Vec<[Vec<f32>; 3]> =
            batch.par_iter().map(|&d| look_along(splats, center, d, half, pixel, resolution, settings.gate)).collect();
        for (d, [up, down, w_max]) in batch.iter().zip(parts) {
            seen.vote.par_iter_mut().zip(&mut seen.w_max).enumerate().for_each(|(i, (v, w))| {
                // `up` was seen by a viewer far along +d, so that +d points to the viewer.
                *v = vec3::add_scaled(*v, *d, up[i] - down[i]);
                *w = w.max(w_max[i]);
            });
        }
    }
    (seen, resolution)
}

/// Front-layer weights seen from +d, from −d, and the largest weight of either.
fn look_along(splats: &Splats, center: Vec3<f64>, d: Vec3<f32>, half: f64, pixel: f64, resolution: usize, gate: f32) -> [Vec<f32>; 3] {
    let z: Vec3<f64> = vec3::cast(d);
    let (x, y) = vec3::frame_from_normal(z);
    let rotation: Mat3<f64> = [x, y, z];
    let mut shell = Shell::<f32>::default();
    let mut index = Vec::with_capacity(splats.len());
    push_all(&mut shell, &mut index, splats, rotation, center, (0.3 * pixel * pixel) as f32);
    let grid = Grid { origin: [-half, -half, 0.0], spacing: pixel, dims: [resolution, resolution, 1] };
    let mut out = [vec![0.0; splats.len()], vec![0.0; splats.len()], vec![0.0f32; splats.len()]];
    sweep(&shell, &grid, 2, |hits| {
        for side in 0..2 {
            let mut through = 1.0f32;
            for k in 0..hits.len() {
                let h = &hits[if side == 0 { hits.len() - 1 - k } else { k }];
                let i = index[h.item as usize] as usize;
                let w = h.alpha * through;
                if through > gate {
                    out[side][i] += w;
                }
                out[2][i] = out[2][i].max(w);
                through *= 1.0 - h.alpha;
                if through < 1e-3 {
                    break;
                }
            }
        }
    });
    out
}

/// The Gaussians in a view's frame, widened by the low-pass.
fn push_all(shell: &mut Shell<f32>, index: &mut Vec<u32>, splats: &Splats, rotation: Mat3<f64>, center: Vec3<f64>, low_pass: f32) {
    let r: Mat3<f32> = mat3::cast(rotation);
    for i in 0..splats.len() {
        let opacity = splats.opacity(i);
        let mut cov = mat3::congruence(r, splats.covariance(i));
        for k in 0..2 {
            cov[k][k] += low_pass;
        }
        let usable = opacity > 1.0 / 255.0 && cov.iter().flatten().all(|v| v.is_finite());
        let mean = mat3::mul_vec(rotation, vec3::sub(vec3::cast(splats.mean[i]), center));
        if usable && mean.iter().all(|v| v.is_finite()) {
            shell.push(vec3::cast(mean), cov, [0.0; 3], opacity);
            index.push(i as u32);
        }
    }
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
