//! Exposure compensation: one affine map of the colours per training view, learnt beside the splats (splatting.md §5.2).
//!
//! Photographs of one scene differ in exposure and white balance. Without maps of their own the splats explain that by
//! colours that change with the direction, or by haze before single cameras. The maps and the colours of the splats share a
//! degree of freedom (all maps twice as bright, all splats half as bright); it is fixed by keeping the mean of all maps at the
//! identity, so that held-out views are those of a mean exposure.

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Three rows of `[r, g, b, 1]`.
type Affine = [f32; 12];

const IDENTITY: Affine = [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0];
/// Pixels per unit of parallel work.
const BLOCK: usize = 8192;
const BETA: [f64; 2] = [0.9, 0.999];
const EPSILON: f64 = 1e-15;

/// Learning rates at the first and the last iteration.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ExposureRates(pub [f32; 2]);

impl Default for ExposureRates {
    fn default() -> Self {
        Self([1e-2, 1e-3])
    }
}

impl ExposureRates {
    /// The rate after the share `t` of all iterations; falls geometrically.
    fn at(self, t: f64) -> f64 {
        let [first, last] = self.0.map(|v| f64::from(v).ln());
        (first * (1.0 - t) + last * t).exp()
    }
}

/// The maps of all training views with the state of their optimiser.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Exposures {
    pub map: Vec<Affine>,
    pub first: Vec<Affine>,
    pub second: Vec<Affine>,
    /// Colours of the current view after its map.
    seen: Vec<[f32; 3]>,
}

impl Exposures {
    /// Identities for `views` views.
    pub fn new(views: usize) -> Self {
        Self { map: vec![IDENTITY; views], first: vec![[0.0; 12]; views], second: vec![[0.0; 12]; views], seen: Vec::new() }
    }

    /// The colours `rgb` as `view` sees them.
    pub fn expose(&mut self, view: usize, rgb: &[[f32; 3]]) -> &[[f32; 3]] {
        let m = self.map[view];
        self.seen.resize(rgb.len(), [0.0; 3]);
        self.seen.par_chunks_mut(BLOCK).zip(rgb.par_chunks(BLOCK)).for_each(|(out, rgb)| {
            for (o, c) in out.iter_mut().zip(rgb) {
                *o = std::array::from_fn(|k| m[4 * k] * c[0] + m[4 * k + 1] * c[1] + m[4 * k + 2] * c[2] + m[4 * k + 3]);
            }
        });
        &self.seen
    }

    /// Takes the gradient by the exposed colours back to that by `rgb`, in place, and returns that by the map.
    pub fn pull_back(&self, view: usize, rgb: &[[f32; 3]], gradient: &mut [[f32; 3]]) -> [f64; 12] {
        let m = self.map[view];
        let blocks: Vec<[f64; 12]> = gradient
            .par_chunks_mut(BLOCK)
            .zip(rgb.par_chunks(BLOCK))
            .map(|(gradient, rgb)| {
                let mut sum = [0.0f64; 12];
                for (g, c) in gradient.iter_mut().zip(rgb) {
                    for k in 0..3 {
                        for (s, x) in sum[4 * k..4 * k + 4].iter_mut().zip([c[0], c[1], c[2], 1.0]) {
                            *s += f64::from(g[k] * x);
                        }
                    }
                    *g = std::array::from_fn(|j| m[j] * g[0] + m[4 + j] * g[1] + m[8 + j] * g[2]);
                }
                sum
            })
            .collect();
        // Block by block, in order.
        blocks.iter().fold([0.0; 12], |s, b| std::array::from_fn(|k| s[k] + b[k]))
    }

    /// One step of Adam on the map of `view`, its `count`-th (from 1), after the share `t` of all iterations; then all maps
    /// are shifted alike so that their mean is the identity again.
    pub fn step(&mut self, view: usize, gradient: &[f64; 12], rates: ExposureRates, count: u32, t: f64) {
        let rate = rates.at(t);
        let correction = BETA.map(|b| 1.0 - b.powi(count as i32));
        for k in 0..12 {
            let (m, v) = (&mut self.first[view][k], &mut self.second[view][k]);
            *m = (BETA[0] * f64::from(*m) + (1.0 - BETA[0]) * gradient[k]) as f32;
            *v = (BETA[1] * f64::from(*v) + (1.0 - BETA[1]) * gradient[k] * gradient[k]) as f32;
            let (m, v) = (f64::from(*m) / correction[0], f64::from(*v) / correction[1]);
            self.map[view][k] -= (rate * m / (v.sqrt() + EPSILON)) as f32;
        }
        let n = self.map.len() as f64;
        for k in 0..12 {
            let mean = self.map.iter().map(|m| f64::from(m[k])).sum::<f64>() / n;
            let shift = (f64::from(IDENTITY[k]) - mean) as f32;
            self.map.iter_mut().for_each(|m| m[k] += shift);
        }
    }
}

#[cfg(test)]
mod tests {
    use megas_math::rng::Rng;

    use super::*;

    #[test]
    fn gradients_are_the_derivatives() {
        let mut rng = Rng::new(4);
        let n = 20_000;
        let mut colours = || -> Vec<[f32; 3]> { (0..n).map(|_| [(); 3].map(|_| rng.unit() as f32)).collect() };
        let (rgb, weight) = (colours(), colours());
        let mut e = Exposures::new(2);
        e.map[1] = [0.9, 0.1, 0.0, 0.05, -0.1, 1.2, 0.1, 0.0, 0.0, 0.2, 0.8, -0.05];
        // The loss is the weighted sum of the exposed colours.
        let value = |m: &Affine, rgb: &[[f32; 3]]| -> f64 {
            let one = |(c, w): (&[f32; 3], &[f32; 3])| -> f64 {
                let x = [c[0], c[1], c[2], 1.0].map(f64::from);
                (0..3).map(|k| f64::from(w[k]) * (0..4).map(|j| f64::from(m[4 * k + j]) * x[j]).sum::<f64>()).sum()
            };
            rgb.iter().zip(&weight).map(one).sum()
        };
        let seen: f64 = e.expose(1, &rgb).iter().zip(&weight).flat_map(|(a, w)| (0..3).map(|k| f64::from(a[k] * w[k]))).sum();
        assert!((seen - value(&e.map[1], &rgb)).abs() < 1e-6 * seen.abs());
        let mut g = weight.clone();
        let by_map = e.pull_back(1, &rgb, &mut g);
        for k in 0..12 {
            let mut m = e.map[1];
            m[k] += 0.5;
            let slope = (value(&m, &rgb) - value(&e.map[1], &rgb)) / 0.5;
            assert!((slope - by_map[k]).abs() < 1e-5 * slope.abs(), "{k}: {slope} {}", by_map[k]);
        }
        for i in [0, 9000, n - 1] {
            for k in 0..3 {
                let mut other = rgb.clone();
                other[i][k] += 1.0;
                let slope = value(&e.map[1], &other) - value(&e.map[1], &rgb);
                assert!((slope - f64::from(g[i][k])).abs() < 1e-5, "{slope} {}", g[i][k]);
            }
        }
    }

    #[test]
    fn two_exposures_are_told_apart_and_their_mean_stays() {
        // View 0 is a quarter darker, view 1 a quarter brighter than what is there.
        let mut rng = Rng::new(9);
        let rgb: Vec<[f32; 3]> = (0..5000).map(|_| [(); 3].map(|_| rng.unit() as f32)).collect();
        let gain = [0.75f32, 1.25];
        let mut e = Exposures::new(2);
        for step in 0..4000u32 {
            let view = (step % 2) as usize;
            let mut g: Vec<[f32; 3]> =
                e.expose(view, &rgb).iter().zip(&rgb).map(|(a, c)| std::array::from_fn(|k| (a[k] - gain[view] * c[k]) / 5000.0)).collect();
            let by_map = e.pull_back(view, &rgb, &mut g);
            e.step(view, &by_map, ExposureRates::default(), step / 2 + 1, f64::from(step) / 4000.0);
        }
        for k in 0..12 {
            let mean = 0.5 * (e.map[0][k] + e.map[1][k]);
            assert!((mean - IDENTITY[k]).abs() < 1e-5, "{k}: {mean}");
            for view in 0..2 {
                assert!((e.map[view][k] - gain[view] * IDENTITY[k]).abs() < 0.02, "{view} {k}: {:?}", e.map[view]);
            }
        }
    }
}
