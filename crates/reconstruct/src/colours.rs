//! Directional colours where nobody looked.
//!
//! Photographs show a Gaussian from a part of the sphere. Its spherical harmonics meet these views and are anything elsewhere:
//! blotches on an underside that comes up, and on everything that turns while it melts, because colours turn with it
//! (splatting.md §8.3). A training ends by the smallest change of the views that calms the rest: with the views' weights w and
//! directions d, coefficients c become those of `min_c' Σ w |Y(d)·(c' − c)|² + λ A₀₀ Σ_{k≥1} c'_k²`, A = Σ w Y Yᵀ.

use megas_math::{sh, vec3};
use megas_model::{Camera, Splats};
use rayon::prelude::*;

/// Coefficients per channel at degree 3, and the entries of a triangle of that size.
const MOST: usize = 16;
const TRIANGLE: usize = MOST * (MOST + 1) / 2;
/// Gaussians that are handled at once: 64 MB.
pub(crate) const BATCH: usize = 120_000;

/// Where the Gaussians of a batch were looked at from: the lower triangles of A.
pub(crate) struct Looks {
    first: usize,
    count: usize,
    sums: Vec<[f32; TRIANGLE]>,
}

impl Looks {
    /// None yet, for the Gaussians from `first`.
    pub(crate) fn new(splats: &Splats, first: usize) -> Self {
        let len = BATCH.min(splats.len() - first);
        Self { first, count: splats.sh_stride() / 3, sums: vec![[0.0; TRIANGLE]; len] }
    }

    /// Adds a view with the sum of the blend weights of every Gaussian.
    pub(crate) fn add(&mut self, camera: &Camera, splats: &Splats, weights: &[f32]) {
        let (eye, first, count) = (camera.center(), self.first, self.count);
        self.sums.par_iter_mut().enumerate().with_min_len(1024).for_each(|(i, sums)| {
            let w = weights[first + i];
            let d = vec3::sub(splats.mean[first + i], eye);
            let length = vec3::norm(d);
            if w > 0.0 && length > 0.0 {
                let y = sh::basis(vec3::scale(d, 1.0 / length));
                for r in 0..count {
                    for c in 0..=r {
                        sums[r * (r + 1) / 2 + c] += w * y[r] * y[c];
                    }
                }
            }
        });
    }

    /// Calms the colours of the batch with strength `lambda`.
    pub(crate) fn settle(&self, splats: &mut Splats, lambda: f64) {
        let (stride, count) = (splats.sh_stride(), self.count);
        let batch = &mut splats.sh[self.first * stride..][..self.sums.len() * stride];
        batch.par_chunks_exact_mut(stride).zip(&self.sums).with_min_len(256).for_each(|(sh, sums)| {
            let penalty = lambda * f64::from(sums[0]);
            if penalty > 0.0 {
                settle(sh, sums, count, penalty);
            }
        });
    }
}

/// `c −= (A + Λ)⁻¹ Λ c` with Λ = `penalty` for all but the constant, for the three channels of one Gaussian.
fn settle(sh: &mut [f32], sums: &[f32; TRIANGLE], count: usize, penalty: f64) {
    let mut l = [[0.0f64; MOST]; MOST];
    for r in 0..count {
        for c in 0..=r {
            let mut v = f64::from(sums[r * (r + 1) / 2 + c]) + if r == c && r > 0 { penalty } else { 0.0 };
            for k in 0..c {
                v -= l[r][k] * l[c][k];
            }
            // A + Λ is positive: A₀₀ is, and every other diagonal entry exceeds what A alone would have.
            l[r][c] = if r == c { v.max(1e-3 * penalty).sqrt() } else { v / l[c][c] };
        }
    }
    for channel in 0..3 {
        let mut x = [0.0f64; MOST];
        for r in 0..count {
            let b = if r > 0 { penalty * f64::from(sh[3 * r + channel]) } else { 0.0 };
            x[r] = (b - (0..r).map(|k| l[r][k] * x[k]).sum::<f64>()) / l[r][r];
        }
        for r in (0..count).rev() {
            x[r] = (x[r] - (r + 1..count).map(|k| l[k][r] * x[k]).sum::<f64>()) / l[r][r];
            sh[3 * r + channel] -= x[r] as f32;
        }
    }
}

#[cfg(test)]
mod tests {
    use megas_model::fibonacci_directions;

    use super::*;

    /// A Gaussian that was seen from above and is anything below.
    #[test]
    fn colours_stay_where_they_were_seen_and_rest_elsewhere() {
        let mut splats = Splats { sh_degree: 3, ..Splats::default() };
        let mut rng = megas_math::rng::Rng::new(3);
        let coefficients: Vec<f32> = (0..48).map(|k| if k < 3 { 0.3 } else { 0.2 * rng.normal() as f32 }).collect();
        splats.push([0.0; 3], [-3.0; 3], [1.0, 0.0, 0.0, 0.0], 2.0, &coefficients);
        let all = fibonacci_directions(400);
        let mut looks = Looks::new(&splats, 0);
        for d in all.iter().filter(|d| d[2] > 0.2) {
            let camera = Camera::look_at(vec3::scale(*d, 4.0), [0.0; 3], [0.0, 1.0, 0.1], 0.7, 10, 10);
            looks.add(&camera, &splats, &[0.5]);
        }
        let before = splats.clone();
        looks.settle(&mut splats, 0.02);
        // Seen along −d.
        let value = |s: &Splats, d: &[f32; 3]| (0..16).map(|k| sh::basis(vec3::scale(*d, -1.0))[k] * s.sh[3 * k]).sum::<f32>();
        let rms = |f: &dyn Fn(&[f32; 3]) -> f32, keep: &dyn Fn(&[f32; 3]) -> bool| {
            let v: Vec<f32> = all.iter().filter(|d| keep(d)).map(|d| f(d).powi(2)).collect();
            (v.iter().sum::<f32>() / v.len() as f32).sqrt()
        };
        let above = |d: &[f32; 3]| d[2] > 0.2;
        let below = |d: &[f32; 3]| d[2] < -0.3;
        let changed = rms(&|d| value(&splats, d) - value(&before, d), &above);
        let contrast = rms(&|d| value(&before, d) - 0.3 * sh::Y0 as f32, &above);
        assert!(changed < 0.1 * contrast, "{changed} of {contrast}");
        let mean = all.iter().filter(|d| above(d)).map(|d| value(&before, d)).sum::<f32>() / all.iter().filter(|d| above(d)).count() as f32;
        let [was, is] = [&before, &splats].map(|s| rms(&|d| value(s, d) - mean, &below));
        assert!(is < 0.7 * was, "{was} {is}");
        // What was never seen stays.
        let mut other = before.clone();
        Looks::new(&other, 0).settle(&mut other, 0.02);
        assert_eq!(other, before);
    }
}
