//! What lies under the object and was never seen: a patch of discs on the support plane (splatting.md §5.11).

use megas_math::{Vec3, quat, sh, vec3};
use megas_model::{Origin, Similarity, Splats, logit};
use rayon::prelude::*;

use crate::polygon;
use crate::select::{Plane, RobustBox, robust_bounds};

/// A patch and how it was made.
#[derive(Clone, Debug)]
pub struct Patch {
    /// The discs; degree 0, object 0, origin 2.
    pub splats: Splats,
    /// The plane they lie on.
    pub plane: Plane,
    /// Background Gaussians that gave the colours.
    pub ring: usize,
}

/// Lays discs on a hexagonal grid over the object's footprint on the plane of the background, coloured by inverse-distance
/// interpolation over the background within 0.15 L of the footprint. `up` is scene-up, `spacing` the distance of the discs
/// in scene units (τ_scale). `None` where no plane carries the object or fewer than 20 background Gaussians lie around it.
pub fn patch(object: &Splats, background: &Splats, up: Vec3<f64>, spacing: f64, seed: u64) -> Option<Patch> {
    let rotation = Similarity::rotation_from_up(up);
    let bounds = robust_bounds(object, &vec![true; object.len()], rotation)?;
    let l = bounds.diagonal();
    let plane = plane_under(background, &bounds, up, seed)?;
    let (tx, ty) = vec3::frame_from_normal(plane.normal);
    let flat = |x: Vec3<f32>| {
        let d = vec3::sub(vec3::cast(x), plane.point);
        [vec3::dot(d, tx), vec3::dot(d, ty)]
    };
    let footprint = footprint(object, &plane, l, flat)?;

    let ring: Vec<usize> = (0..background.len())
        .filter(|&i| {
            let m = background.mean[i];
            let away = polygon::distance(&footprint, flat(m));
            background.opacity(i) > 0.1 && plane.height(m).abs() < 0.02 * l && away > 0.0 && away < 0.15 * l
        })
        .collect();
    if ring.len() < 20 {
        return None;
    }
    // Evenly taken, so that every side of the ring has its say.
    let around: Vec<usize> = ring.iter().copied().step_by(ring.len().div_ceil(2000)).collect();

    let positions = hexagonal(&footprint, spacing);
    let thickness = 0.05 * spacing;
    let rotation = quat::between([0.0, 0.0, 1.0], vec3::cast(plane.normal));
    let log_scale = [(spacing as f32).ln(), (spacing as f32).ln(), (thickness as f32).ln()];
    let rows: Vec<(Vec3<f32>, [f32; 3])> = positions
        .par_iter()
        .map(|q| {
            // Just under the plane, so that background that does exist there stays in front.
            let x = vec3::add_scaled(vec3::add_scaled(vec3::add_scaled(plane.point, tx, q[0]), ty, q[1]), plane.normal, -2.0 * thickness);
            let x: Vec3<f32> = vec3::cast(x);
            let (mut sum, mut weight) = ([0.0f32; 3], 0.0f32);
            for &i in &around {
                let d = vec3::sub(background.mean[i], x);
                let d2 = vec3::dot(d, d) + (spacing * spacing) as f32;
                let w = background.opacity(i) / (d2 * d2.sqrt());
                sum = vec3::add_scaled(sum, background.base_rgb(i), w);
                weight += w;
            }
            (x, sum.map(|c| sh::dc_from_rgb(c / weight)))
        })
        .collect();
    let mut splats = Splats::with_capacity(0, rows.len());
    for (x, dc) in rows {
        splats.push(x, log_scale, rotation, logit(0.95), &dc);
    }
    splats.origin.fill(Origin::Patch as u8);
    splats.normal_sign.fill(1);
    (!splats.is_empty()).then_some(Patch { splats, plane, ring: ring.len() })
}

/// The plane of the background near the object, if it passes under it.
fn plane_under(background: &Splats, object: &RobustBox, up: Vec3<f64>, seed: u64) -> Option<Plane> {
    let rotation = Similarity::rotation_from_up(up);
    let (l, center) = (object.diagonal(), object.center());
    let near: Vec<bool> = background
        .mean
        .iter()
        .map(|&m| {
            let x = megas_math::mat3::mul_vec(rotation, vec3::cast(m));
            (0..2).all(|k| x[k] > object.min[k] - 0.3 * l && x[k] < object.max[k] + 0.3 * l) && x[2] < center[2]
        })
        .collect();
    let plane = crate::select::plane_below(background, &near, up, center[2], 0.01 * l, seed)?;
    let foot = megas_math::mat3::tmul_vec(rotation, [center[0], center[1], object.min[2]]);
    let gap = vec3::dot(vec3::sub(foot, plane.point), plane.normal);
    (gap.abs() < 0.15 * l).then_some(plane)
}

/// Hull of the object's means within 0.1 L of the plane, or of all where those span no area.
fn footprint(object: &Splats, plane: &Plane, l: f64, flat: impl Fn(Vec3<f32>) -> [f64; 2]) -> Option<Vec<[f64; 2]>> {
    let hull = |within: f64| {
        let near = object.mean.iter().filter(|&&m| plane.height(m) < within);
        polygon::convex_hull(&near.map(|&m| flat(m)).collect::<Vec<_>>())
    };
    let mut out = hull(0.1 * l);
    if out.len() < 3 || polygon::area(&out) < 1e-4 * l * l {
        out = hull(f64::INFINITY);
    }
    (out.len() >= 3).then_some(out)
}

/// Points of a hexagonal grid inside a polygon or within one spacing of it, at most a million.
fn hexagonal(polygon: &[[f64; 2]], spacing: f64) -> Vec<[f64; 2]> {
    let mut lo = [f64::INFINITY; 2];
    let mut hi = [f64::NEG_INFINITY; 2];
    for q in polygon {
        for k in 0..2 {
            lo[k] = lo[k].min(q[k] - spacing);
            hi[k] = hi[k].max(q[k] + spacing);
        }
    }
    let row_height = spacing * 0.75f64.sqrt();
    let (columns, rows) = (((hi[0] - lo[0]) / spacing).ceil() + 1.0, ((hi[1] - lo[1]) / row_height).ceil() + 1.0);
    if columns * rows > 1e6 || (columns * rows).is_nan() {
        return Vec::new();
    }
    let mut out = Vec::new();
    for r in 0..rows as usize {
        let shift = if r % 2 == 0 { 0.0 } else { 0.5 };
        for c in 0..columns as usize {
            let q = [lo[0] + (c as f64 + shift) * spacing, lo[1] + r as f64 * row_height];
            if polygon::distance(polygon, q) <= spacing {
                out.push(q);
            }
        }
    }
    out
}
