//! The plane that the object rests on, by random samples with a fixed seed (splatting.md §5.11).

use megas_math::{Vec3, rng::Rng, svd, vec3};
use megas_model::Splats;

use super::robust_bounds;

const TRIALS: usize = 500;
/// A support may be this far from horizontal: cos 30°.
const LEAST_ALIGNMENT: f64 = 0.866;

/// A fitted support plane in scene coordinates.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plane {
    /// A point of the plane.
    pub point: Vec3<f64>,
    /// Unit normal, on the side of scene-up.
    pub normal: Vec3<f64>,
    /// Gaussians within 0.01 L of it.
    pub inliers: usize,
    /// Height above the plane at which a selection is cut: 0.01 L.
    pub cut: f64,
}

impl Plane {
    /// Signed height of a point above the plane.
    pub fn height(&self, x: Vec3<f32>) -> f64 {
        vec3::dot(vec3::sub(vec3::cast(x), self.point), self.normal)
    }
}

/// Finds the plane with the most means within 0.01 L below the middle of the set, among planes at most 30° from
/// horizontal, and fits it to them. `None` where fewer than 30 means or 2 % of the candidates lie on one.
pub fn support_plane(splats: &Splats, mask: &[bool], up: Vec3<f32>, seed: u64) -> Option<Plane> {
    let up = vec3::normalize_or(vec3::cast(up), [0.0, 0.0, 1.0]);
    let rotation = megas_model::Similarity::rotation_from_up(up);
    let bounds = robust_bounds(splats, mask, rotation)?;
    plane_below(splats, mask, up, bounds.center()[2], 0.01 * bounds.diagonal(), seed)
}

/// [`support_plane`] with the height `middle` along the unit vector `up`, below which it is looked for, and its thickness
/// given.
pub(crate) fn plane_below(splats: &Splats, mask: &[bool], up: Vec3<f64>, middle: f64, tolerance: f64, seed: u64) -> Option<Plane> {
    let points: Vec<Vec3<f64>> = (0..splats.len())
        .filter(|&i| mask[i] && splats.opacity(i) > 0.05)
        .map(|i| vec3::cast(splats.mean[i]))
        .filter(|&x: &Vec3<f64>| vec3::dot(x, up) < middle)
        .collect();
    if points.len() < 30 {
        return None;
    }
    // Enough to rank the planes; the winner is refitted to everything.
    let stride = (points.len() / 5000).max(1);
    let sample: Vec<Vec3<f64>> = points.iter().step_by(stride).copied().collect();

    let mut rng = Rng::new(seed ^ 0x0091_a4e5);
    let mut best: Option<(usize, Vec3<f64>, Vec3<f64>)> = None;
    for _ in 0..TRIALS {
        let [a, b, c] = std::array::from_fn(|_| points[rng.below(points.len())]);
        let mut n = vec3::normalize_or(vec3::cross(vec3::sub(b, a), vec3::sub(c, a)), [0.0; 3]);
        if vec3::dot(n, up) < 0.0 {
            n = n.map(|v| -v);
        }
        if vec3::dot(n, up) < LEAST_ALIGNMENT {
            continue;
        }
        let votes = sample.iter().filter(|&&x| vec3::dot(vec3::sub(x, a), n).abs() < tolerance).count();
        if best.is_none_or(|(v, _, _)| votes > v) {
            best = Some((votes, a, n));
        }
    }
    let (_, mut point, mut normal) = best?;
    let mut inliers = 0;
    for _ in 0..3 {
        let near: Vec<Vec3<f64>> = points.iter().copied().filter(|&x| vec3::dot(vec3::sub(x, point), normal).abs() < tolerance).collect();
        inliers = near.len();
        if inliers < 3 {
            return None;
        }
        (point, normal) = fit(&near, up);
    }
    (inliers >= 30 && inliers * 50 >= points.len()).then_some(Plane { point, normal, inliers, cut: tolerance })
}

/// Least-squares plane: mean and direction of least variance.
fn fit(points: &[Vec3<f64>], up: Vec3<f64>) -> (Vec3<f64>, Vec3<f64>) {
    let n = points.len() as f64;
    let mean = vec3::scale(points.iter().fold([0.0; 3], |s, &x| vec3::add(s, x)), 1.0 / n);
    let mut c = [[0.0; 3]; 3];
    for &x in points {
        let d = vec3::sub(x, mean);
        c = megas_math::mat3::add(c, megas_math::mat3::outer(d, d));
    }
    let normal = megas_math::mat3::column(svd::eigen_symmetric(c).1, 2);
    (mean, if vec3::dot(normal, up) < 0.0 { normal.map(|v| -v) } else { normal })
}
