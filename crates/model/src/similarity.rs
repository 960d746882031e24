//! Scene units ↔ metres (simulation.md §0.1): `x = s · R_a · (X − O)`.

use megas_math::{Mat3, Vec3, mat3, vec3};
use serde::{Deserialize, Serialize};

/// The one transform between scene axes (X) and simulator axes (x, SI, +z up).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Similarity {
    /// Metres per scene unit `s`, positive.
    pub metres_per_unit: f64,
    /// Rotation `R_a` that maps scene-up to +z.
    pub rotation: [[f64; 3]; 3],
    /// Scene point `O` that becomes the origin.
    pub origin: [f64; 3],
}

impl Similarity {
    /// Scene position → metres.
    pub fn to_si(&self, scene: Vec3<f64>) -> Vec3<f64> {
        vec3::scale(mat3::mul_vec(self.rotation, vec3::sub(scene, self.origin)), self.metres_per_unit)
    }

    /// Metres → scene position.
    pub fn to_scene(&self, si: Vec3<f64>) -> Vec3<f64> {
        vec3::add(mat3::tmul_vec(self.rotation, vec3::scale(si, self.metres_per_unit.recip())), self.origin)
    }

    /// Scene direction → simulator axes (no scaling).
    pub fn direction_to_si(&self, scene: Vec3<f64>) -> Vec3<f64> {
        mat3::mul_vec(self.rotation, scene)
    }

    /// Simulator direction → scene axes (no scaling).
    pub fn direction_to_scene(&self, si: Vec3<f64>) -> Vec3<f64> {
        mat3::tmul_vec(self.rotation, si)
    }

    /// A linear map (F, B, …) from simulator axes to scene axes: `R_aᵀ M R_a`.
    pub fn map_to_scene(&self, m: Mat3<f64>) -> Mat3<f64> {
        let rt = mat3::transpose(self.rotation);
        mat3::mul(mat3::mul(rt, m), self.rotation)
    }

    /// A rotation that maps the unit vector `up` to +z.
    pub fn rotation_from_up(up: Vec3<f64>) -> Mat3<f64> {
        let q = megas_math::quat::between(vec3::normalize_or(up, [0.0, 0.0, 1.0]), [0.0, 0.0, 1.0]);
        megas_math::quat::to_mat3(q)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn round_trip_and_up() {
        for up in [[0.0, 0.0, 1.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [0.6, 0.0, 0.8]] {
            let s = Similarity { metres_per_unit: 0.1, rotation: Similarity::rotation_from_up(up), origin: [1.0, 2.0, 3.0] };
            let z = s.direction_to_si(up);
            assert!((z[2] - 1.0).abs() < 1e-12);
            let x = [4.0, -5.0, 6.0];
            assert!(vec3::norm(vec3::sub(s.to_scene(s.to_si(x)), x)) < 1e-12);
        }
    }
}
