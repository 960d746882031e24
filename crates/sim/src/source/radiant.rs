//! Light: how much of it falls on a surface, and what stands in its way (simulation.md §4.7).

use std::f64::consts::TAU;

use megas_math::{Vec3, vec3};

use crate::schedule::Pose;
use crate::source::Light;

/// Height above a surface from which the light must be seen \[node spacings\], so that a surface does not shade itself by its own
/// roughness. It shrinks to nothing along the first [`CLEAR`] spacings of the ray: what is further away throws its true shadow.
pub(crate) const CLEARANCE: f64 = 1.0;
pub(crate) const CLEAR: f64 = 8.0;
/// Steps of the march towards the light \[node spacings\].
pub(crate) const STRIDE: f64 = 0.5;
/// Least half width of the soft edge of a cone \[rad\].
const EDGE: f64 = 0.02;

/// A light where it is now.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Placed {
    light: Light,
    strength: f64,
}

/// What arrives at a point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Arriving {
    /// Unit direction to the light.
    pub toward: Vec3<f64>,
    /// Irradiance across that direction \[W/m²\].
    pub irradiance: f64,
    /// Way to the light \[m\], infinite for parallel rays.
    pub distance: f64,
}

impl Light {
    /// The point about which a motion turns it.
    pub(crate) fn pivot(&self) -> Vec3<f64> {
        match self {
            Light::Sun { .. } => [0.0; 3],
            Light::Torch { position, .. } => *position,
        }
    }

    /// The light moved by `pose` with the given irradiance \[W/m²\] or power \[W\].
    pub(crate) fn placed(&self, pose: &Pose, strength: f64) -> Placed {
        const DOWN: Vec3<f64> = [0.0, 0.0, -1.0];
        let turn = |d: Vec3<f64>| pose.turned(vec3::normalize_or(d, DOWN));
        let light = match *self {
            Light::Sun { direction } => Light::Sun { direction: turn(direction) },
            Light::Torch { position, direction, half_angle } => {
                Light::Torch { position: pose.now(position), direction: turn(direction), half_angle }
            }
        };
        Placed { light, strength }
    }
}

impl Placed {
    /// The light at `x` \[m\]; `None` outside the cone. Its edge is as wide as `spacing` \[m\], so that the nodes add up to its power.
    pub(crate) fn at(&self, x: Vec3<f64>, spacing: f64) -> Option<Arriving> {
        match self.light {
            Light::Sun { direction } => {
                Some(Arriving { toward: vec3::scale(direction, -1.0), irradiance: self.strength, distance: f64::INFINITY })
            }
            Light::Torch { position, direction, half_angle } => {
                let way = vec3::sub(position, x);
                let distance = vec3::norm(way);
                if distance <= 0.0 {
                    return None;
                }
                let toward = vec3::scale(way, 1.0 / distance);
                let angle = (-vec3::dot(toward, direction)).clamp(-1.0, 1.0).acos();
                let whole = half_angle >= std::f64::consts::PI - EDGE;
                let edge = EDGE.max(spacing / distance).min(half_angle);
                let t = if whole { 1.0 } else { ((half_angle + edge - angle) / (2.0 * edge)).clamp(0.0, 1.0) };
                // The soft edge lets more through outside than it takes away inside, by its variance.
                let wider = if whole { 1.0 } else { 1.0 + 0.2 * (edge / half_angle).powi(2) };
                let solid_angle = TAU * (1.0 - half_angle.cos()) * wider;
                let irradiance = t * t * (3.0 - 2.0 * t) * self.strength / (solid_angle * distance * distance);
                (irradiance != 0.0).then_some(Arriving { toward, irradiance, distance })
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_torch_puts_its_power_into_its_cone() {
        let torch = Light::Torch { position: [0.0, 0.0, 2.0], direction: [0.0, 0.0, -3.0], half_angle: 0.5 };
        let placed = torch.placed(&Pose::REST, 100.0);
        // Power through a plane at distance 2, in rings.
        let rings = 4000;
        let mut power = 0.0;
        for i in 0..rings {
            let r = 2.0 * (f64::from(i) + 0.5) / f64::from(rings);
            if let Some(a) = placed.at([r, 0.0, 0.0], 0.05) {
                power += a.irradiance * a.toward[2] * TAU * r * 2.0 / f64::from(rings);
            }
        }
        assert!((power - 100.0).abs() < 0.5, "{power}");
        assert!(placed.at([5.0, 0.0, 0.0], 0.05).is_none() && placed.at([0.0, 0.0, 3.0], 0.05).is_none());
        let everywhere = Light::Torch { position: [0.0; 3], direction: [0.0, 0.0, 1.0], half_angle: std::f64::consts::PI };
        let a = everywhere.placed(&Pose::REST, 100.0).at([0.0, 0.0, -0.5], 0.05).unwrap();
        assert!((a.irradiance - 100.0 / (TAU * 2.0 * 0.25)).abs() < 1e-9 && a.toward == [0.0, 0.0, 1.0]);
    }
}
