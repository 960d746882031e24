//! Splats carried by a deformation (splatting.md §9.2, §8.2, §8.3).

use megas_math::{Mat3, mat3, svd, vec3};
use megas_model::Splats;
use megas_raster::{Gaussians, pack_covariance};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::{Deformation, Stage};

/// Part of the logarithmic stretch that a viscoplastic return leaves in the elastic gradient.
const RETAINED: f64 = 0.2;

/// Which gradient the shapes of the splats follow.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Carry {
    /// The whole gradient.
    Total,
    /// Its rotation alone.
    Rotation,
    /// `polar(F) V Σ^0.2 Vᵀ`: what a viscoplastic return leaves, and what the paper pushes with.
    ElasticLike,
}

impl Carry {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::ElasticLike, Self::Rotation, Self::Total];

    /// The name in tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Total => "total",
            Self::Rotation => "rotation",
            Self::ElasticLike => "elastic-like",
        }
    }

    /// The gradient that shapes are pushed with, and the rotation of F that appearances turn with.
    pub fn gradient(self, f: Mat3<f64>) -> (Mat3<f64>, Mat3<f64>) {
        let d = svd::svd(f);
        let rotation = mat3::mul(d.u, mat3::transpose(d.v));
        let pushed = match self {
            Self::Total => f,
            Self::Rotation => rotation,
            Self::ElasticLike => d.with_values(d.s.map(|s| s.abs().powf(RETAINED).copysign(s))),
        };
        (pushed, rotation)
    }
}

/// A deformed model.
#[derive(Clone, Debug, Default)]
pub struct Carried {
    /// Ready to draw; in the order of the splats.
    pub gaussians: Gaussians,
    /// Gradient that each shape was pushed with.
    pub gradient: Vec<Mat3<f64>>,
}

/// Carries splats by a deformation. `clamp` may change a pushed covariance, given the one at rest and the whole gradient (the needle
/// clamp of splatting.md §8.4). Normals follow `F^{−T} n` and keep the side that the splats have.
pub fn carry(
    splats: &Splats,
    stage: &Stage,
    deformation: Deformation,
    mode: Carry,
    clamp: impl Fn(Mat3<f64>, Mat3<f64>, Mat3<f64>) -> Mat3<f64> + Sync,
) -> Carried {
    struct One {
        mean: [f32; 3],
        covariance: [f32; 6],
        normal: [f32; 3],
        rotation: [f32; 9],
        gradient: Mat3<f64>,
    }
    let one = |i: usize| {
        let x = vec3::cast::<f32, f64>(splats.mean[i]);
        let f = stage.gradient(deformation, x);
        let (pushed, rotation) = mode.gradient(f);
        let rest = mat3::cast(splats.covariance(i));
        let covariance = clamp(mat3::symmetrize(mat3::congruence(pushed, rest)), rest, f);
        let normal = vec3::cast::<f32, f64>(splats.normal(i));
        // The maps are invertible; a broken splat is hidden by the rasterizer.
        let normal = mat3::inverse(f).map_or(normal, |inverse| mat3::tmul_vec(inverse, normal));
        One {
            mean: vec3::cast(stage.map(deformation, x)),
            covariance: pack_covariance(mat3::cast(covariance)),
            normal: vec3::cast(vec3::normalize_or(normal, [0.0, 0.0, 1.0])),
            rotation: std::array::from_fn(|k| rotation[k / 3][k % 3] as f32),
            gradient: pushed,
        }
    };
    let all: Vec<One> = (0..splats.len()).into_par_iter().with_min_len(64).map(one).collect();
    let gaussians = Gaussians {
        mean: all.iter().map(|o| o.mean).collect(),
        covariance: all.iter().map(|o| o.covariance).collect(),
        opacity: (0..splats.len()).map(|i| splats.opacity(i)).collect(),
        sh_degree: splats.sh_degree,
        sh: splats.sh.clone(),
        normal: all.iter().map(|o| o.normal).collect(),
        view_rotation: all.iter().map(|o| o.rotation).collect(),
        temperature: splats.temperature.clone(),
        visible: Vec::new(),
        trained_pixel: splats.known_pixels().to_vec(),
    };
    Carried { gaussians, gradient: all.into_iter().map(|o| o.gradient).collect() }
}

#[cfg(test)]
mod tests {
    use megas_math::{quat, rng::Rng};
    use megas_raster::unpack_covariance;

    use super::*;

    fn stage() -> Stage {
        Stage { axes: quat::to_mat3([0.9, 0.1, 0.3, -0.2]), origin: [0.1, 0.2, -0.3], height: 1.8, diagonal: 2.5, amount: 1.0 }
    }

    fn splats(count: usize) -> Splats {
        let mut rng = Rng::new(8);
        let mut s = Splats::default();
        for _ in 0..count {
            let q = std::array::from_fn(|_| rng.range(-1.0, 1.0) as f32);
            let x = stage().scene([rng.range(-0.5, 0.5), rng.range(-0.5, 0.5), rng.range(0.0, 1.8)]);
            s.push(vec3::cast(x), [-3.0, -3.5, -6.0], q, 1.0, &[0.1, 0.2, 0.3]);
        }
        s
    }

    #[test]
    fn modes_keep_what_they_promise() {
        let f = stage().gradient(Deformation::Twist, [0.4, 0.3, 0.2]);
        let r = svd::polar_rotation(f);
        let (total, _) = Carry::Total.gradient(f);
        let (rotation, turned) = Carry::Rotation.gradient(f);
        let (elastic, _) = Carry::ElasticLike.gradient(f);
        assert!(mat3::norm(mat3::sub(total, f)) < 1e-14 && mat3::norm(mat3::sub(rotation, r)) < 1e-12 && rotation == turned);
        let (a, b) = (svd::svd(f).s, svd::svd(elastic).s);
        assert!((0..3).all(|k| (b[k] - a[k].powf(0.2)).abs() < 1e-12));
        assert!(mat3::norm(mat3::sub(svd::polar_rotation(elastic), r)) < 1e-10);
    }

    #[test]
    fn rest_changes_nothing_and_total_maps_covariances() {
        let (s, stage) = (splats(50), stage());
        let still = Gaussians::from_splats(&s);
        let rest = carry(&s, &stage, Deformation::Rest, Carry::ElasticLike, |c, _, _| c).gaussians;
        for i in 0..s.len() {
            assert!(vec3::norm(vec3::sub(rest.mean[i], still.mean[i])) < 1e-6);
            assert!((0..6).all(|k| (rest.covariance[i][k] - still.covariance[i][k]).abs() < 1e-8));
            assert!(vec3::dot(rest.normal[i], still.normal[i]) > 1.0 - 1e-5);
        }
        let slump = carry(&s, &stage, Deformation::Slump, Carry::Total, |c, _, _| c);
        for i in 0..s.len() {
            let f = stage.gradient(Deformation::Slump, vec3::cast(s.mean[i]));
            let expected = mat3::congruence(f, mat3::cast::<f32, f64>(s.covariance(i)));
            let got = mat3::cast::<f32, f64>(unpack_covariance(slump.gaussians.covariance[i]));
            assert!(mat3::norm(mat3::sub(got, expected)) < 1e-5 * mat3::norm(expected));
            // A vector of the disc stays perpendicular to the transported normal.
            let along = mat3::column(mat3::cast::<f32, f64>(s.axes(i)), 0);
            let n: [f64; 3] = vec3::cast(slump.gaussians.normal[i]);
            assert!(vec3::dot(mat3::mul_vec(f, along), n).abs() < 1e-5);
        }
        let clamped = carry(&s, &stage, Deformation::Slump, Carry::Total, |_, rest, _| rest).gaussians;
        assert!((0..6).all(|k| (clamped.covariance[7][k] - still.covariance[7][k]).abs() < 1e-8));
    }
}
