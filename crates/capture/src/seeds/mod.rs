//! The first Gaussians of a reconstruction (splatting.md §2.5).

mod carve;
mod focus;
mod frusta;
mod look;
mod neighbours;

use megas_math::rng;
use rayon::prelude::*;

use crate::{Capture, Photo, extent};
use look::Look;

/// Initial Gaussians: isotropic, in the frame of the poses.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Seeds {
    /// Centres.
    pub position: Vec<[f32; 3]>,
    /// sRGB in [0, 1], one per centre.
    pub colour: Vec<[f32; 3]>,
    /// Standard deviation in scene units, one per centre; positive.
    pub sigma: Vec<f32>,
}

/// Floor of the initial size: this part of the scene extent (`√1e-7`).
const SIGMA_FLOOR: f32 = 3.162_277_7e-4;
/// Cap of the initial size: this part of the scene extent.
const SIGMA_CAP: f32 = 0.05;

/// Seeds for a capture: its points if it came with some; else, for objects on a transparent background, at most `count` random
/// points that no training view sees through; else `count` random points in what the training views see.
///
/// Deterministic for a given `seed`, whatever the number of threads.
pub fn seeds(capture: &Capture, count: usize, seed: u64) -> Seeds {
    let (position, colour) = match &capture.points {
        Some(cloud) => (cloud.position.clone(), cloud.colour.iter().map(|c| c.map(|v| f32::from(v) / 255.0)).collect()),
        None => random(&capture.train, count, seed),
    };
    let e = extent(capture.train.iter().map(|p| &p.camera));
    let near = neighbours::mean_square_to_nearest(&position);
    let sigma = near.par_iter().map(|d2| d2.sqrt().clamp(SIGMA_FLOOR * e, SIGMA_CAP * e)).collect();
    Seeds { position, colour, sigma }
}

fn random(photos: &[Photo], count: usize, seed: u64) -> (Vec<[f32; 3]>, Vec<[f32; 3]>) {
    let looks: Vec<Look<'_>> = photos.iter().map(Look::new).collect();
    if looks.is_empty() || count == 0 {
        return Default::default();
    }
    let object = photos.iter().all(|p| p.channels == 4);
    let carved = if object { carve::carve(&looks, count, seed) } else { Vec::new() };
    let position = if carved.is_empty() { frusta::scatter(&looks, count, seed) } else { carved };
    let colour = position.par_iter().enumerate().map(|(i, x)| mean_colour(&looks, *x, seed, i as u64)).collect();
    (position, colour)
}

/// The mean of the pixels a point projects to; where no view shows anything, grey with a little noise.
fn mean_colour(looks: &[Look<'_>], x: [f32; 3], seed: u64, id: u64) -> [f32; 3] {
    let (mut sum, mut weight) = ([0f32; 3], 0f32);
    for look in looks {
        let Some((rgb, w)) = look.pixel(x).map(|i| look.colour(i)) else { continue };
        (0..3).for_each(|k| sum[k] += w * rgb[k]);
        weight += w;
    }
    if weight > 0.0 {
        return sum.map(|s| s / weight);
    }
    [0, 1, 2].map(|k| 0.5 + 0.1 * (rng::hash01(seed, id, 90 + k) as f32 - 0.5))
}

#[cfg(test)]
mod tests {
    use megas_model::Camera;

    use super::*;
    use crate::Cloud;

    fn ring(n: usize, channels: u32, paint: impl Fn(&Camera, u32, u32) -> Vec<u8>) -> Vec<Photo> {
        let view = |i: usize| {
            let a = i as f32 / n as f32 * std::f32::consts::TAU;
            let eye = [3.0 * a.cos() + 1.0, 3.0 * a.sin(), 1.5 * (2.0 * a).sin()];
            let camera = Camera::look_at(eye, [1.0, 0.0, 0.0], [0.0, 0.0, 1.0], 0.7, 80, 60);
            let pixels = (0..60).flat_map(|y| (0..80).map(move |x| (x, y))).flat_map(|(x, y)| paint(&camera, x, y)).collect();
            Photo { name: format!("{i:03}"), camera, channels, pixels, mask: None }
        };
        (0..n).map(view).collect()
    }

    /// A red ball of radius 0.4 at (1, 0, 0.1) on a transparent background.
    fn ball(camera: &Camera, x: u32, y: u32) -> Vec<u8> {
        let (o, d) = camera.ray(x as f32 + 0.5, y as f32 + 0.5);
        let to: [f32; 3] = [1.0 - o[0], -o[1], 0.1 - o[2]];
        let along: f32 = (0..3).map(|k| to[k] * d[k]).sum();
        let square: f32 = (0..3).map(|k| to[k] * to[k]).sum();
        let hit = square - along * along < 0.16;
        if hit { vec![200, 20, 30, 255] } else { vec![0; 4] }
    }

    fn capture(train: Vec<Photo>, points: Option<Cloud>) -> Capture {
        Capture { train, test: Vec::new(), points, kind: "test", notes: Vec::new() }
    }

    #[test]
    fn a_ball_is_carved_out_of_its_mattes() {
        let c = capture(ring(24, 4, ball), None);
        let s = seeds(&c, 3000, 5);
        assert_eq!((s.position.len(), s.colour.len(), s.sigma.len()), (3000, 3000, 3000));
        let mut far = 0f32;
        for x in &s.position {
            far = far.max(((x[0] - 1.0).powi(2) + x[1].powi(2) + (x[2] - 0.1).powi(2)).sqrt());
        }
        assert!(far < 0.52 && far > 0.39, "{far}");
        assert!(s.colour.iter().all(|c| (c[0] - 200.0 / 255.0).abs() < 1e-3 && c[1] < 0.1));
        // Some five thousandths of the ball's volume per point: a spacing of about 0.04.
        let mean = s.sigma.iter().sum::<f32>() / 3000.0;
        assert!(mean > 0.015 && mean < 0.06, "{mean}");
        assert_eq!(s, seeds(&c, 3000, 5));
        assert_ne!(s.position, seeds(&c, 3000, 6).position);
    }

    #[test]
    fn threads_do_not_matter() {
        let c = capture(ring(8, 4, ball), None);
        let with = |n: usize| rayon::ThreadPoolBuilder::new().num_threads(n).build().unwrap().install(|| seeds(&c, 500, 1));
        assert_eq!(with(1), with(5));
    }

    #[test]
    fn photographs_without_points_fill_what_they_see() {
        let c = capture(ring(12, 3, |_, _, _| vec![10, 200, 30]), None);
        let s = seeds(&c, 2000, 1);
        assert_eq!(s.position.len(), 2000);
        let from_focus = |x: &[f32; 3]| ((x[0] - 1.0).powi(2) + x[1].powi(2) + x[2].powi(2)).sqrt();
        let near = s.position.iter().filter(|x| from_focus(x) < 3.0).count();
        let far = s.position.iter().filter(|x| from_focus(x) > 4.0).count();
        assert!(near > 1000 && far > 50, "{near} {far}");
        let green = s.colour.iter().filter(|c| (c[1] - 200.0 / 255.0).abs() < 1e-3).count();
        assert_eq!(green, 2000);
    }

    #[test]
    fn points_are_taken_as_they_are_with_bounded_sizes() {
        let photos = ring(4, 3, |_, _, _| vec![0; 3]);
        let e = extent(photos.iter().map(|p| &p.camera));
        let position = vec![[0.0; 3], [0.0; 3], [0.0; 3], [0.0; 3], [100.0, 0.0, 0.0]];
        let colour = vec![[255, 0, 51]; 5];
        let s = seeds(&capture(photos, Some(Cloud { position: position.clone(), colour })), 10, 1);
        assert_eq!(s.position, position);
        assert_eq!(s.colour[0], [1.0, 0.0, 0.2]);
        assert_eq!((s.sigma[0], s.sigma[4]), (SIGMA_FLOOR * e, SIGMA_CAP * e));
    }

    #[test]
    fn odd_captures_still_get_seeds() {
        // One view; mattes that are empty; nothing to seed.
        assert_eq!(seeds(&capture(ring(1, 3, |_, _, _| vec![9; 3]), None), 100, 1).position.len(), 100);
        assert_eq!(seeds(&capture(ring(1, 4, ball), None), 100, 1).sigma.len(), 100);
        let empty = seeds(&capture(ring(6, 4, |_, _, _| vec![0; 4]), None), 100, 1);
        assert_eq!(empty.position.len(), 100);
        assert!(empty.colour.iter().flatten().all(|v| (0.4..0.6).contains(v)));
        assert_eq!(seeds(&capture(Vec::new(), None), 100, 1), Seeds::default());
        assert_eq!(seeds(&capture(ring(3, 3, |_, _, _| vec![9; 3]), None), 0, 1), Seeds::default());
    }
}
