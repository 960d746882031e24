//! The part of a picture's opacity that lies at the true surface (splatting.md §9.3 M6).

use megas_math::{mat3, vec3};
use megas_model::{Camera, Projection};
use megas_raster::{Gaussians, Settings, unpack_covariance};
use rayon::prelude::*;

/// Rows that are composited at once.
const BAND: usize = 16;

/// Opacities of one orthographic view.
#[derive(Clone, Debug, PartialEq)]
pub struct FrontLayer {
    /// `A`: accumulated opacity of every pixel.
    pub alpha: Vec<f32>,
    /// `A_f`: the part of it that lies within the window about the true depth.
    pub front: Vec<f32>,
    /// The part that lies nearer than the window: something sticks out before the true surface.
    pub near: Vec<f32>,
}

/// A Gaussian in the image.
struct Record {
    z: f32,
    index: u32,
    mean: [f32; 2],
    /// Inverse of the image covariance: xx, xy, yy.
    conic: [f32; 3],
    /// Change of the depth of the ray's maximum per pixel.
    slope: [f32; 2],
    half: [f32; 2],
    opacity: f32,
}

/// Composites as the rasterizer does, with its default constants, and sorts every contribution by whether the maximum of the
/// Gaussian along the ray lies within `window` of `depth` (of the true surface, ∞ for none; along the camera's z).
pub fn front_layer(g: &Gaussians, camera: &Camera, depth: &[f32], window: f32) -> FrontLayer {
    let Projection::Orthographic { scale } = camera.projection else {
        panic!("cracks are measured with orthographic cameras");
    };
    let (width, height) = (camera.width as usize, camera.height as usize);
    assert_eq!(depth.len(), width * height, "a depth for every pixel");
    let settings = Settings::default();
    let scale = f64::from(scale);
    let w = mat3::cast::<f32, f64>(camera.rotation);
    let record = |i: usize| -> Option<Record> {
        let opacity = g.opacity[i].min(1.0);
        if g.visible.get(i) == Some(&false) || opacity.is_nan() || opacity < settings.alpha_min {
            return None;
        }
        let p = vec3::add(mat3::mul_vec(w, vec3::cast(g.mean[i])), vec3::cast(camera.translation));
        let c = mat3::congruence(w, mat3::cast(unpack_covariance(g.covariance[i])));
        let s2 = scale * scale;
        let q2 = g.trained_pixel.get(i).filter(|p| **p > 0.0).map_or(1.0, |p| s2 * f64::from(*p).powi(2));
        let [own, wide] = settings.blur(q2);
        let (a, b, d) = (s2 * c[0][0] + own, s2 * c[0][1], s2 * c[1][1] + own);
        let smaller = a * d - b * b;
        let (a, d) = (a + wide, d + wide);
        let det = a * d - b * b;
        let opacity = opacity * (smaller / det).max(2.5e-5).sqrt() as f32;
        if opacity < settings.alpha_min {
            return None;
        }
        let usable = p[2] > f64::from(settings.z_near) && det > 0.0 && det.is_finite();
        if !usable {
            return None;
        }
        let conic = [d / det, -b / det, a / det];
        // Mean depth given the place in the image: Σ_z⊥ Σ_⊥⊥⁻¹ y, the maximum along the ray (splatting.md §6.4). The low-pass
        // keeps it bounded for discs seen from the side.
        let across = [scale * c[2][0], scale * c[2][1]];
        let slope = [across[0] * conic[0] + across[1] * conic[1], across[0] * conic[1] + across[1] * conic[2]];
        let reach = (2.0 * f64::from(opacity / settings.alpha_min).ln()).max(0.0).sqrt();
        let mean = [scale * p[0] + f64::from(camera.cx), scale * p[1] + f64::from(camera.cy)];
        let half = [reach * a.sqrt(), reach * d.sqrt()];
        let seen =
            mean[0] + half[0] > 0.0 && mean[0] - half[0] < width as f64 && mean[1] + half[1] > 0.0 && mean[1] - half[1] < height as f64;
        seen.then(|| Record {
            z: p[2] as f32,
            index: i as u32,
            mean: mean.map(|v| v as f32),
            conic: conic.map(|v| v as f32),
            slope: slope.map(|v| v as f32),
            half: half.map(|v| v as f32),
            opacity,
        })
    };
    let mut records: Vec<Record> = (0..g.len()).into_par_iter().with_min_len(256).filter_map(record).collect();
    records.par_sort_unstable_by(|a, b| a.z.total_cmp(&b.z).then(a.index.cmp(&b.index)));
    let bands: Vec<[Vec<f32>; 3]> = (0..height.div_ceil(BAND))
        .into_par_iter()
        .map(|b| {
            let rows = b * BAND..((b + 1) * BAND).min(height);
            let mut transmittance = vec![1.0f32; rows.len() * width];
            let mut done = vec![false; rows.len() * width];
            let mut front = vec![0.0f32; rows.len() * width];
            let mut near = vec![0.0f32; rows.len() * width];
            for r in &records {
                let y0 = ((r.mean[1] - r.half[1] - 0.5).ceil().max(rows.start as f32)) as usize;
                let y1 = ((r.mean[1] + r.half[1] - 0.5).floor() + 1.0).clamp(0.0, rows.end as f32) as usize;
                if y0 >= y1 {
                    continue;
                }
                let x0 = (r.mean[0] - r.half[0] - 0.5).ceil().max(0.0) as usize;
                let x1 = ((r.mean[0] + r.half[0] - 0.5).floor() + 1.0).clamp(0.0, width as f32) as usize;
                for y in y0..y1 {
                    let dy = y as f32 + 0.5 - r.mean[1];
                    let (row, truth) = ((y - rows.start) * width, y * width);
                    for x in x0..x1 {
                        let dx = x as f32 + 0.5 - r.mean[0];
                        let q = r.conic[0] * dx * dx + 2.0 * r.conic[1] * dx * dy + r.conic[2] * dy * dy;
                        let alpha = (r.opacity * (-0.5 * q).exp()).min(settings.alpha_max);
                        if alpha < settings.alpha_min || done[row + x] {
                            continue;
                        }
                        let t = transmittance[row + x];
                        if t * (1.0 - alpha) < settings.t_stop {
                            done[row + x] = true;
                            continue;
                        }
                        let z = r.z + r.slope[0] * dx + r.slope[1] * dy;
                        let behind = z - depth[truth + x];
                        if behind.abs() < window {
                            front[row + x] += alpha * t;
                        } else if behind < 0.0 {
                            near[row + x] += alpha * t;
                        }
                        transmittance[row + x] = t * (1.0 - alpha);
                    }
                }
            }
            [transmittance.into_iter().map(|t| 1.0 - t).collect(), front, near]
        })
        .collect();
    let [alpha, front, near] = [0, 1, 2].map(|k| bands.iter().flat_map(|b| b[k].iter().copied()).collect());
    FrontLayer { alpha, front, near }
}

#[cfg(test)]
mod tests {
    use megas_math::rng::Rng;
    use megas_model::{Splats, logit};
    use megas_raster::{Channels, Rasterizer};

    use super::*;

    #[test]
    fn opacity_is_the_rasterizers() {
        let mut rng = Rng::new(6);
        let mut s = Splats::default();
        for _ in 0..800 {
            let q = std::array::from_fn(|_| rng.range(-1.0, 1.0) as f32);
            let scale = std::array::from_fn(|_| rng.range(-4.5, -2.0) as f32);
            s.push(rng.direction().map(|v| v as f32), scale, q, rng.range(-3.0, 5.0) as f32, &[0.0; 3]);
        }
        // Some of them trained on smaller pixels than the picture's, some on larger ones.
        s.trained_pixel = (0..s.len()).map(|i| [0.0, 0.004, 0.03][i % 3]).collect();
        let g = Gaussians::from_splats(&s);
        let camera = Camera::orthographic([0.1, 0.0, 0.0], [0.3, 0.8, -0.5], [0.0, 0.0, 1.0], 1.3, 4.0, 100, 70);
        let expected = Rasterizer::new().frame(&g, &camera, &Settings::default(), Channels::Rgba);
        let all = front_layer(&g, &camera, &vec![4.0; 7000], 100.0);
        for i in 0..7000 {
            assert!((all.alpha[i] - expected.alpha(i)).abs() < 2e-4, "{i} {} {}", all.alpha[i], expected.alpha(i));
            assert!((all.front[i] - all.alpha[i]).abs() < 1e-5);
        }
        let none = front_layer(&g, &camera, &vec![f32::INFINITY; 7000], 0.1);
        assert!(none.front.iter().all(|f| *f == 0.0) && none.alpha == all.alpha);
    }

    #[test]
    fn the_depth_of_a_slanted_disc_follows_its_plane() {
        // One large disc at 45° about y: depth grows with x; a narrow window keeps the strip where it agrees.
        let mut s = Splats::default();
        let q = megas_math::quat::between([0.0, 0.0, 1.0], [0.5f32.sqrt(), 0.0, -0.5f32.sqrt()]);
        s.push([0.0; 3], [0.0, 0.0, -9.0], q, logit(0.9), &[0.0; 3]);
        let g = Gaussians::from_splats(&s);
        let camera = Camera::orthographic([0.0; 3], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0], 1.0, 5.0, 64, 64);
        let f = front_layer(&g, &camera, &vec![5.25; 64 * 64], 0.05);
        for x in 0..64 {
            let world = camera.ray(x as f32 + 0.5, 32.5).0[0];
            // On the plane n·x = 0 the depth is 5 + x, in whichever way the image's x points.
            let expected = (5.0 + world - 5.25f32).abs() < 0.05;
            let edge = ((5.0 + world - 5.25f32).abs() - 0.05).abs() < 0.005;
            assert!(edge || (f.front[32 * 64 + x] > 0.1) == expected, "{x} {world} {}", f.front[32 * 64 + x]);
        }
    }
}
