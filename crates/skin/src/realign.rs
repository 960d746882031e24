//! Local refitting: molten surface Gaussians turn towards the surface that they have come to lie in (splatting.md §7.5).

use megas_math::{Mat3, Vec3, mat3, quat, svd, vec3};

/// Angle between disc and surface that is left alone, and how fast the rest goes (10° a frame at 24 frames a second).
const DEAD_ZONE: f64 = 20.0 / 180.0 * std::f64::consts::PI;
const SPEED_RAD_S: f64 = 240.0 / 180.0 * std::f64::consts::PI;
/// sin² of the dead zone.
const SIN2_DEAD_ZONE: f64 = 0.116;
/// Discs thicker than this share of their middle axis have no plane to turn.
const FLAT: f64 = 0.6;
/// Gaussians longer than this in middle axes are needles: turned about, they stick out of curved surfaces.
const LONG: f64 = 2.5;

/// Rotation that turns the disc `covariance` towards the surface `normal` within `dt` seconds; `None` where it lies well enough.
pub(crate) fn turn(covariance: Mat3<f64>, normal: Vec3<f64>, dt: f64) -> Option<Mat3<f64>> {
    if crate::densify::is_axis_within(covariance, vec3::cast(normal), SIN2_DEAD_ZONE) {
        return None;
    }
    let (w, r) = svd::eigen_symmetric(covariance);
    if w[2] > FLAT * FLAT * w[1] || w[0] > LONG * LONG * w[1] {
        return None;
    }
    let axis = mat3::column(r, 2);
    let axis = if vec3::dot(axis, normal) < 0.0 { axis.map(|v| -v) } else { axis };
    let angle = vec3::dot(axis, normal).clamp(-1.0, 1.0).acos();
    if angle <= DEAD_ZONE {
        return None;
    }
    let step = (angle - DEAD_ZONE).min(SPEED_RAD_S * dt);
    Some(quat::to_mat3(quat::slerp([1.0, 0.0, 0.0, 0.0], quat::between(axis, normal), step / angle)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tilted_disc_comes_within_the_dead_zone_and_round_ones_stay() {
        let mut c = mat3::diag([1.0, 0.9, 0.01]);
        let n: Vec3<f64> = vec3::normalize_or([1.0, 0.3, 0.6], [0.0; 3]);
        let mut frames = 0;
        while let Some(q) = turn(c, n, 1.0 / 24.0) {
            c = mat3::congruence(q, c);
            frames += 1;
            assert!(frames < 20);
        }
        let axis = mat3::column(svd::eigen_symmetric(c).1, 2);
        assert!((vec3::dot(axis, n).abs().acos() - DEAD_ZONE).abs() < 1e-6 && frames >= 4, "{frames}");
        assert!(turn(mat3::diag([1.0, 0.9, 0.8]), n, 1.0).is_none());
    }
}
