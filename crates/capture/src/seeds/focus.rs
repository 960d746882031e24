//! What the cameras look at together.

use megas_math::{Vec3, mat3, svd, vec3};

use super::look::Look;

/// The common focus and how far the cameras stand from it.
pub(super) struct Focus {
    /// The point nearest to all optical axes, in the least-squares sense.
    pub point: Vec3<f32>,
    /// Median distance of the cameras from it.
    pub distance: f32,
}

/// Least eigenvalue of the mean of `1 − ddᵀ` at which the axes still meet: below it they are parallel within some three degrees.
const PARALLEL: f64 = 1e-3;

/// The focus of views that look at something together; `None` if their axes are parallel or meet behind most of them.
pub(super) fn focus(looks: &[Look<'_>]) -> Option<Focus> {
    let (mut a, mut b) = ([[0.0f64; 3]; 3], [0.0f64; 3]);
    let rays = looks.iter().map(|l| (vec3::cast::<_, f64>(l.camera.center()), vec3::cast::<_, f64>(l.camera.rotation[2])));
    for (c, d) in rays.clone() {
        let across = mat3::sub(mat3::identity(), mat3::outer(d, d));
        a = mat3::add(a, across);
        b = vec3::add(b, mat3::mul_vec(across, c));
    }
    let n = looks.len() as f64;
    let (values, _) = svd::eigen_symmetric(mat3::scale(a, 1.0 / n));
    if values.iter().copied().fold(f64::INFINITY, f64::min) < PARALLEL {
        return None;
    }
    let point = mat3::mul_vec(mat3::inverse(a)?, b);
    let ahead = rays.clone().filter(|(c, d)| vec3::dot(vec3::sub(point, *c), *d) > 0.0).count();
    let mut distances: Vec<f64> = rays.map(|(c, _)| vec3::norm(vec3::sub(point, c))).collect();
    distances.sort_by(f64::total_cmp);
    let distance = distances[distances.len() / 2] as f32;
    let point = vec3::cast::<_, f32>(point);
    let usable = 2 * ahead > looks.len() && distance > 0.0 && distance.is_finite() && point.iter().all(|v| v.is_finite());
    usable.then_some(Focus { point, distance })
}
