//! Which views are compared with each other.

use megas_math::vec3;
use megas_model::Camera;

/// Neighbours per view at most.
const COUNT: usize = 8;
/// Largest angle between the optical axes, as cosine: 30°.
const MIN_COSINE: f32 = 0.866_025_4;
/// Least and largest baseline in units of the scene extent.
const BASELINE: [f32; 2] = [0.01, 1.5];

/// For every camera the indices of up to 8 others, nearest first, that look in nearly the same direction from a different
/// place, given the scene extent E \[scene units\]. The list of a camera without any is empty.
pub fn neighbours(cameras: &[Camera], extent: f32) -> Vec<Vec<u32>> {
    let centres: Vec<_> = cameras.iter().map(Camera::center).collect();
    let of = |i: usize| {
        let mut found: Vec<(f32, u32)> = (0..cameras.len())
            .filter(|&j| vec3::dot(cameras[i].rotation[2], cameras[j].rotation[2]) > MIN_COSINE)
            .map(|j| (vec3::norm(vec3::sub(centres[i], centres[j])), j as u32))
            .filter(|(d, _)| *d > BASELINE[0] * extent && *d < BASELINE[1] * extent)
            .collect();
        found.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        found.iter().take(COUNT).map(|f| f.1).collect()
    };
    (0..cameras.len()).map(of).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn near_views_in_a_similar_direction() {
        let at = |angle: f32| {
            let (s, c) = angle.to_radians().sin_cos();
            Camera::look_at([3.0 * c, 3.0 * s, 0.0], [0.0; 3], [0.0, 0.0, 1.0], 0.8, 8, 8)
        };
        let cameras: Vec<Camera> = [0.0, 10.0, 29.0, 31.0, 10.01, 180.0].map(at).to_vec();
        let found = neighbours(&cameras, 2.0);
        assert_eq!(found[0], [1, 4, 2]);
        // The fourth is 21° from 10° and 2° from 29°; the fifth is nearly in the same place as the second.
        assert_eq!(found[1], [0, 2, 3]);
        assert!(found[5].is_empty());
        assert_eq!(neighbours(&cameras, 0.3)[0], Vec::<u32>::new(), "10° on a circle of radius 3 is farther than 1.5 E");
        let ring: Vec<Camera> = (0..60).map(|i| at(2.0 * i as f32)).collect();
        let mut nearest = neighbours(&ring, 1.0)[30].clone();
        nearest.sort_unstable();
        assert_eq!(nearest, [26, 27, 28, 29, 31, 32, 33, 34]);
    }
}
