//! Random points in what photographs see, for captures without points (splatting.md §2.5).

use megas_math::{
    Vec3,
    rng::{Rng, mix},
    vec3,
};
use rayon::prelude::*;

use super::{focus::focus, look::Look};
use crate::extent;

/// Share of the points around the focus; the others lie along random rays, for the surroundings.
const NEAR_SHARE: f64 = 0.7;
/// Half side of the cube around the focus, in units of the cameras' distance from it.
const NEAR_HALF: f64 = 0.6;
/// Depths of the surroundings, in units of the distance from the focus.
const FAR_DEPTHS: [f64; 2] = [0.6, 4.0];
/// Tries per point of the cube before a ray is taken instead.
const TRIES: usize = 32;

/// `count` points in the union of the frusta: most of them in a cube around the common focus where at least two views see
/// them, the others farther out along the rays of random pixels, equally dense in the logarithm of the depth.
pub(super) fn scatter(looks: &[Look<'_>], count: usize, seed: u64) -> Vec<Vec3<f32>> {
    let focus = focus(looks);
    // Without a focus the distance between the cameras is the only length there is.
    let distance = focus.as_ref().map_or(2.0 * extent(looks.iter().map(|l| l.camera)), |f| f.distance);
    let needed = looks.len().min(2);
    let point = |i: usize| {
        let mut rng = Rng::new(mix(seed) ^ i as u64);
        if let Some(f) = &focus
            && rng.unit() < NEAR_SHARE
        {
            for _ in 0..TRIES {
                let x = [0, 1, 2].map(|k| f.point[k] + f.distance * rng.range(-NEAR_HALF, NEAR_HALF) as f32);
                if looks.iter().filter(|l| l.pixel(x).is_some()).take(needed).count() == needed {
                    return x;
                }
            }
        }
        let camera = looks[rng.below(looks.len())].camera;
        let (u, v) = (rng.unit() as f32 * camera.width as f32, rng.unit() as f32 * camera.height as f32);
        let (origin, direction) = camera.ray(u, v);
        let own = focus.as_ref().map_or(distance, |f| vec3::norm(vec3::sub(f.point, origin)));
        let [near, far] = FAR_DEPTHS.map(f64::ln);
        vec3::add_scaled(origin, direction, own * rng.range(near, far).exp() as f32)
    };
    (0..count).into_par_iter().map(point).collect()
}
