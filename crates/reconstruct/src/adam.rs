//! Adam over the parameter arrays of a set of splats (splatting.md §5.3).

use fearless_simd::{Level, Select, Simd, SimdBase, SimdFloat, dispatch};
use megas_math::{sh, simd::Lanes};
use megas_model::Splats;
use megas_raster::Gradients;
use rayon::prelude::*;

const BETA: [f32; 2] = [0.9, 0.999];
const EPSILON: f32 = 1e-15;
/// Splats per job.
const CHUNK: usize = 2048;

/// Learning rates of one step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rates {
    /// Centres \[scene units\].
    pub mean: f32,
    /// Log-scales.
    pub log_scale: f32,
    /// Quaternions.
    pub rotation: f32,
    /// Opacity logits.
    pub opacity: f32,
    /// Constant colour.
    pub dc: f32,
    /// Directional colour.
    pub rest: f32,
}

/// First and second moment of one array.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Moments {
    pub first: Vec<f32>,
    pub second: Vec<f32>,
}

impl Moments {
    fn resize(&mut self, n: usize) {
        self.first.resize(n, 0.0);
        self.second.resize(n, 0.0);
    }

    fn each(&mut self, mut f: impl FnMut(&mut Vec<f32>)) {
        f(&mut self.first);
        f(&mut self.second);
    }

    fn select(&mut self, indices: &[usize], stride: usize) {
        self.each(|v| *v = indices.iter().flat_map(|&i| v[i * stride..(i + 1) * stride].iter().copied()).collect());
    }
}

/// The optimiser's state for one set of splats.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Adam {
    /// Steps taken, for the correction of the bias.
    pub(crate) steps: u64,
    pub(crate) mean: Moments,
    pub(crate) log_scale: Moments,
    pub(crate) rotation: Moments,
    pub(crate) opacity: Moments,
    pub(crate) sh: Moments,
}

impl Adam {
    /// Zero moments for `splats`.
    pub fn new(splats: &Splats) -> Self {
        let mut adam = Self::default();
        adam.grow(splats);
        adam
    }

    /// Every array with its name and its values per splat, for checkpoints.
    pub(crate) fn arrays(&mut self, sh_stride: usize) -> [(&'static str, &mut Moments, usize); 5] {
        [
            ("mean", &mut self.mean, 3),
            ("log_scale", &mut self.log_scale, 3),
            ("rotation", &mut self.rotation, 4),
            ("opacity", &mut self.opacity, 1),
            ("sh", &mut self.sh, sh_stride),
        ]
    }

    /// Zero moments for splats that were appended.
    pub fn grow(&mut self, splats: &Splats) {
        for (_, moments, stride) in self.arrays(splats.sh_stride()) {
            moments.resize(splats.len() * stride);
        }
    }

    /// Keeps the moments of the splats `indices`, in that order.
    pub fn select(&mut self, indices: &[usize], sh_stride: usize) {
        for (_, moments, stride) in self.arrays(sh_stride) {
            moments.select(indices, stride);
        }
    }

    /// Forgets the moments of the opacities (after a reset).
    pub fn forget_opacity(&mut self) {
        self.opacity.each(|v| v.fill(0.0));
    }

    /// Widens the moments of the colours from `old` to `new` values per splat.
    pub fn widen_sh(&mut self, old: usize, new: usize) {
        self.sh.each(|v| {
            *v = v.chunks_exact(old).flat_map(|c| c.iter().copied().chain(std::iter::repeat_n(0.0, new - old))).collect();
        });
    }

    /// One step down the gradient. Every splat is updated, seen or not, as the moments decay either way.
    pub fn step(&mut self, level: Level, splats: &mut Splats, gradients: &Gradients, rates: &Rates) {
        self.steps += 1;
        let correction = BETA.map(|b| (1.0 / (1.0 - f64::from(b).powi(self.steps.min(1 << 20) as i32))) as f32);
        let stride = splats.sh_stride();
        let flat = |p: &mut [f32], g: &[f32], m: &mut Moments, rate: f32, stride: usize| {
            let chunk = CHUNK * stride;
            let moments = m.first.par_chunks_mut(chunk).zip(m.second.par_chunks_mut(chunk));
            p.par_chunks_mut(chunk).zip(g.par_chunks(chunk)).zip(moments).for_each(|((p, g), (m, v))| {
                dispatch!(level, s => update(s, p, g, m, v, rate, correction));
            });
        };
        // Colours first: their gradient is expanded along the direction of this step's view.
        let rate: [f32; 48] = std::array::from_fn(|k| if k < 3 { rates.dc } else { rates.rest });
        let moments = self.sh.first.par_chunks_mut(CHUNK * stride).zip(self.sh.second.par_chunks_mut(CHUNK * stride));
        splats.sh.par_chunks_mut(CHUNK * stride).zip(moments).enumerate().for_each(|(c, (p, (m, v)))| {
            dispatch!(level, s => colours(s, p, m, v, c * CHUNK, gradients, &rate, correction, stride));
        });
        flat(splats.mean.as_flattened_mut(), gradients.mean.as_flattened(), &mut self.mean, rates.mean, 3);
        flat(splats.log_scale.as_flattened_mut(), gradients.log_scale.as_flattened(), &mut self.log_scale, rates.log_scale, 3);
        flat(splats.rotation.as_flattened_mut(), gradients.rotation.as_flattened(), &mut self.rotation, rates.rotation, 4);
        flat(&mut splats.opacity_logit, &gradients.opacity_logit, &mut self.opacity, rates.opacity, 1);
    }
}

/// One vector of parameters: returns the new value and moments.
#[inline(always)]
fn lanes<S: Simd>(s: S, p: Lanes<S>, g: Lanes<S>, m: Lanes<S>, v: Lanes<S>, rate: Lanes<S>, correction: [f32; 2]) -> [Lanes<S>; 3] {
    let c = |x: f32| Lanes::<S>::splat(s, x);
    let m = m.mul_add(c(BETA[0]), g * c(1.0 - BETA[0]));
    let v = v.mul_add(c(BETA[1]), g * g * c(1.0 - BETA[1]));
    // Moments of splats that are not seen decay for ever: denormal numbers would slow the whole step down.
    let m = m.abs().simd_lt(c(1e-30)).select(c(0.0), m);
    let v = v.simd_lt(c(1e-36)).select(c(0.0), v);
    let root = (v * c(correction[1])).sqrt() + c(EPSILON);
    [p - rate * (m * c(correction[0])) / root, m, v]
}

#[inline(always)]
fn update<S: Simd>(s: S, p: &mut [f32], g: &[f32], m: &mut [f32], v: &mut [f32], rate: f32, correction: [f32; 2]) {
    let width = Lanes::<S>::LEN;
    let rates = Lanes::<S>::splat(s, rate);
    let whole = p.len() / width * width;
    for at in (0..whole).step_by(width) {
        let load = |a: &[f32]| Lanes::<S>::from_slice(s, &a[at..at + width]);
        let [np, nm, nv] = lanes(s, load(p), load(g), load(m), load(v), rates, correction);
        np.store_slice(&mut p[at..at + width]);
        nm.store_slice(&mut m[at..at + width]);
        nv.store_slice(&mut v[at..at + width]);
    }
    for at in whole..p.len() {
        let one = |x: f32| Lanes::<S>::splat(s, x);
        let [np, nm, nv] = lanes(s, one(p[at]), one(g[at]), one(m[at]), one(v[at]), rates, correction);
        (p[at], m[at], v[at]) = (np[0], nm[0], nv[0]);
    }
}

/// The colours of the splats from `first`: the gradient is an outer product that never reaches memory.
#[inline(always)]
fn colours<S: Simd>(
    s: S,
    p: &mut [f32],
    m: &mut [f32],
    v: &mut [f32],
    first: usize,
    gradients: &Gradients,
    rate: &[f32; 48],
    correction: [f32; 2],
    stride: usize,
) {
    let width = Lanes::<S>::LEN;
    let mut g = [0.0f32; 48];
    for (k, p) in p.chunks_exact_mut(stride).enumerate() {
        let (i, at) = (first + k, k * stride);
        let colour = gradients.colour[i];
        if colour == [0.0; 3] {
            g = [0.0; 48];
        } else {
            for (out, y) in g.as_chunks_mut::<3>().0.iter_mut().zip(sh::basis(gradients.direction[i])) {
                *out = colour.map(|c| y * c);
            }
        }
        let (m, v) = (&mut m[at..at + stride], &mut v[at..at + stride]);
        let whole = stride / width * width;
        for at in (0..whole).step_by(width) {
            let load = |a: &[f32]| Lanes::<S>::from_slice(s, &a[at..at + width]);
            let [np, nm, nv] = lanes(s, load(p), load(&g), load(m), load(v), load(rate), correction);
            np.store_slice(&mut p[at..at + width]);
            nm.store_slice(&mut m[at..at + width]);
            nv.store_slice(&mut v[at..at + width]);
        }
        for at in whole..stride {
            let one = |x: f32| Lanes::<S>::splat(s, x);
            let [np, nm, nv] = lanes(s, one(p[at]), one(g[at]), one(m[at]), one(v[at]), one(rate[at]), correction);
            (p[at], m[at], v[at]) = (np[0], nm[0], nv[0]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_match_the_formula_in_double_precision() {
        let mut splats = Splats { sh_degree: 2, ..Splats::default() };
        for i in 0..5 {
            let sh: Vec<f32> = (0..27).map(|k| (i * 27 + k) as f32 * 0.01).collect();
            splats.push([i as f32, 0.5, -1.0], [-3.0; 3], [1.0, 0.1, 0.2, 0.3], 0.3, &sh);
        }
        let mut adam = Adam::new(&splats);
        let n = splats.len();
        let rates = Rates { mean: 1e-2, log_scale: 5e-3, rotation: 1e-3, opacity: 5e-2, dc: 2.5e-3, rest: 1.25e-4 };
        let (mut p, mut m, mut v) = (splats.mean.as_flattened().iter().map(|&x| f64::from(x)).collect::<Vec<_>>(), [0.0; 15], [0.0; 15]);
        let (mut q, mut mq, mut vq) = (f64::from(splats.sh[27 + 5]), 0.0, 0.0);
        let mut rng = megas_math::rng::Rng::new(1);
        for step in 1..=20 {
            let mut triple = || -> Vec<[f32; 3]> { (0..n).map(|_| std::array::from_fn(|_| rng.range(-1e-3, 1e-3) as f32)).collect() };
            let g = Gradients {
                mean: triple(),
                log_scale: triple(),
                rotation: vec![[1e-3; 4]; n],
                opacity_logit: vec![1e-3; n],
                colour: triple(),
                direction: vec![[0.36, 0.48, 0.8]; n],
                ..Gradients::default()
            };
            let adapt = |p: &mut f64, m: &mut f64, v: &mut f64, g: f64, rate: f64| {
                *m = 0.9 * *m + 0.1 * g;
                *v = 0.999 * *v + 0.001 * g * g;
                *p -= rate * (*m / (1.0 - 0.9f64.powi(step))) / ((*v / (1.0 - 0.999f64.powi(step))).sqrt() + 1e-15);
            };
            for k in 0..15 {
                adapt(&mut p[k], &mut m[k], &mut v[k], f64::from(g.mean.as_flattened()[k]), f64::from(rates.mean));
            }
            adapt(&mut q, &mut mq, &mut vq, f64::from(g.sh(1)[1][2]), f64::from(rates.rest));
            adam.step(Level::new(), &mut splats, &g, &rates);
        }
        for (a, b) in splats.mean.as_flattened().iter().zip(&p) {
            assert!((f64::from(*a) - b).abs() < 2e-6, "{a} {b}");
        }
        assert!((f64::from(splats.sh[27 + 5]) - q).abs() < 1e-6, "{} {q}", splats.sh[27 + 5]);
        let state = adam.clone();
        adam.select(&[3, 1], 27);
        assert_eq!(adam.mean.first, [&state.mean.first[9..12], &state.mean.first[3..6]].concat());
        assert_eq!(adam.sh.second[..27], state.sh.second[81..108]);
        adam.widen_sh(27, 48);
        assert_eq!((adam.sh.first.len(), adam.sh.first[48]), (96, state.sh.first[27]));
    }
}
