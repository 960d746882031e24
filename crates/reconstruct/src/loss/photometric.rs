//! `(1 − λ) L1 + λ (1 − SSIM)` and its derivative by the rendered colours (splatting.md §4.6, §5.2).
//!
//! Two passes over rows. The first filters the three moments that involve the render, forms the similarity and the three
//! derivative maps, and filters those along the row while they are still in the innermost cache; the second filters the
//! maps down the columns and assembles the gradient. A row needs nothing from another row of the same pass.

use fearless_simd::{Level, Select, Simd, SimdBase, SimdFloat, dispatch};
use megas_math::simd::Lanes;
use rayon::prelude::*;

use super::target::Target;
use super::window::{BAND, Padded, TAPS, load, reach, splat, store, taps};

/// Stabiliser of the luminance factor, (0.01)².
const K1: f32 = 1e-4;
/// Stabiliser of the contrast factor, (0.03)².
const K2: f32 = 9e-4;

/// Values of one evaluation.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PhotometricLoss {
    /// Mean absolute difference over pixels and channels.
    pub l1: f64,
    /// Mean structural similarity over pixels and channels, 1 for equal images.
    pub ssim: f64,
    /// `(1 − λ) l1 + λ (1 − ssim)`.
    pub total: f64,
}

/// The photometric loss with its working memory; nothing is allocated after the first evaluation at a size.
#[derive(Clone, Debug)]
pub struct Photometric {
    level: Level,
    weights: [f32; TAPS],
    /// `[row][map][float]`: the three derivative maps, filtered along rows.
    maps: Vec<f32>,
    /// Sums of each row: absolute difference, similarity.
    sums: Vec<[f64; 2]>,
    /// Padded rows of each band.
    padded: Vec<[Padded; 3]>,
}

impl Default for Photometric {
    fn default() -> Self {
        Self::new()
    }
}

impl Photometric {
    /// Without any memory yet.
    pub fn new() -> Self {
        Self { level: Level::new(), weights: taps().map(|w| w as f32), maps: Vec::new(), sums: Vec::new(), padded: Vec::new() }
    }

    /// Compares `rendered` (one colour per pixel of the target, any range) with `target` and overwrites `gradient` with
    /// the derivative of the total by each rendered value. Where the target's mask is zero everywhere, all is zero.
    pub fn evaluate(&mut self, rendered: &[[f32; 3]], target: &Target, lambda_ssim: f32, gradient: &mut [[f32; 3]]) -> PhotometricLoss {
        let (height, n) = (target.height(), 3 * target.width());
        assert!(rendered.len() * 3 == n * height && gradient.len() == rendered.len(), "images of different sizes");
        if target.norm() <= 0.0 {
            gradient.fill([0.0; 3]);
            return PhotometricLoss { l1: 0.0, ssim: 1.0, total: 0.0 };
        }
        self.prepare(n, height);
        let samples = 3.0 * target.norm();
        let images = Images { x: rendered.as_flattened(), target, n, height };
        self.first_pass(&images);
        // The similarity enters with a minus sign.
        let scales = [(f64::from(1.0 - lambda_ssim) / samples) as f32, (-f64::from(lambda_ssim) / samples) as f32];
        self.second_pass(&images, scales, gradient.as_flattened_mut());
        let [l1, ssim] = self.sums.iter().fold([0.0; 2], |t, row| [t[0] + row[0], t[1] + row[1]]).map(|sum| sum / samples);
        let lambda = f64::from(lambda_ssim);
        PhotometricLoss { l1, ssim, total: (1.0 - lambda) * l1 + lambda * (1.0 - ssim) }
    }

    fn prepare(&mut self, n: usize, height: usize) {
        self.maps.resize(3 * n * height, 0.0);
        self.sums.resize(height, [0.0; 2]);
        self.padded.resize_with(height.div_ceil(BAND), Default::default);
        self.padded.iter_mut().flatten().for_each(|row| row.resize(n));
    }

    fn first_pass(&mut self, images: &Images) {
        let (level, weights, n) = (self.level, &self.weights, images.n);
        let bands = self.maps.par_chunks_mut(3 * n * BAND).zip(self.sums.par_chunks_mut(BAND)).zip(&mut self.padded);
        bands.enumerate().for_each(|(band, ((maps, sums), padded))| {
            for (i, (maps, sum)) in maps.chunks_exact_mut(3 * n).zip(sums).enumerate() {
                let row = First::new(images, band * BAND + i, weights);
                *sum = dispatch!(level, s => row.run(s, weights, padded, maps));
            }
        });
    }

    fn second_pass(&self, images: &Images, scales: [f32; 2], gradient: &mut [f32]) {
        let (level, weights, n) = (self.level, &self.weights, images.n);
        gradient.par_chunks_mut(n).enumerate().with_min_len(BAND).for_each(|(y, out)| {
            let (rows, down) = reach(y, images.height, weights);
            let maps = rows.map(|r| &self.maps[r * 3 * n..(r + 1) * 3 * n]);
            dispatch!(level, s => second(s, images, y, &maps, &down, scales, out));
        });
    }
}

/// The two images; `n` floats per row.
struct Images<'a> {
    x: &'a [f32],
    target: &'a Target,
    n: usize,
    height: usize,
}

impl Images<'_> {
    /// Row `y` of an image.
    #[inline(always)]
    fn row<'b>(&self, image: &'b [f32], y: usize) -> &'b [f32] {
        &image[y * self.n..(y + 1) * self.n]
    }

    /// Weights of row `y`; empty without a mask.
    #[inline(always)]
    fn weight(&self, y: usize) -> &[f32] {
        let weight = self.target.weight();
        if weight.is_empty() { weight } else { self.row(weight, y) }
    }
}

/// One row of the first pass.
struct First<'a> {
    x: [&'a [f32]; TAPS],
    y: [&'a [f32]; TAPS],
    down: [f32; TAPS],
    mean: &'a [f32],
    variance: &'a [f32],
    weight: &'a [f32],
}

impl<'a> First<'a> {
    fn new(images: &'a Images, y: usize, weights: &[f32; TAPS]) -> Self {
        let (rows, down) = reach(y, images.height, weights);
        let (x, target) = (images.x, images.target.rgb().as_flattened());
        Self {
            x: rows.map(|r| images.row(x, r)),
            y: rows.map(|r| images.row(target, r)),
            down,
            mean: images.row(images.target.mean(), y),
            variance: images.row(images.target.variance(), y),
            weight: images.weight(y),
        }
    }

    /// Sums of the row; `maps` receives the derivative maps filtered along the row.
    #[inline(always)]
    fn run<S: Simd>(&self, s: S, weights: &[f32; TAPS], padded: &mut [Padded; 3], maps: &mut [f32]) -> [f64; 2] {
        let (n, step) = (self.mean.len(), Lanes::<S>::LEN);
        let whole = n - n % step;
        let (down, across) = (splat(s, &self.down), splat(s, weights));
        for at in (0..whole).step_by(step) {
            self.down::<S, true>(s, &down, padded, at);
        }
        if whole < n {
            self.down::<S, false>(s, &down, padded, whole);
        }
        let mut sums = [Lanes::<S>::splat(s, 0.0); 2];
        let masked = !self.weight.is_empty();
        for at in (0..whole).step_by(step) {
            if masked {
                self.similarity::<S, true, true>(s, &across, padded, maps, &mut sums, at);
            } else {
                self.similarity::<S, true, false>(s, &across, padded, maps, &mut sums, at);
            }
        }
        if whole < n {
            if masked {
                self.similarity::<S, false, true>(s, &across, padded, maps, &mut sums, whole);
            } else {
                self.similarity::<S, false, false>(s, &across, padded, maps, &mut sums, whole);
            }
        }
        // The maps wait in their place of the output until the moments of the whole row are used up.
        let mut rest = &*maps;
        for row in padded.iter_mut() {
            let (map, tail) = rest.split_at(n);
            rest = tail;
            for at in (0..whole).step_by(step) {
                row.put::<S>(load::<S, true>(s, map, at), at);
            }
            if whole < n {
                row.put::<S>(load::<S, false>(s, map, whole), whole);
            }
        }
        for (row, map) in padded.iter().zip(maps.chunks_exact_mut(n)) {
            for at in (0..whole).step_by(step) {
                store::<S, true>(row.across(s, &across, at), map, at);
            }
            if whole < n {
                store::<S, false>(row.across(s, &across, whole), map, whole);
            }
        }
        [sum::<S>(sums[0]), sum::<S>(sums[1])]
    }

    /// Moments down the columns: x, x², xy.
    #[inline(always)]
    fn down<S: Simd, const WHOLE: bool>(&self, s: S, down: &[Lanes<S>; TAPS], padded: &mut [Padded; 3], at: usize) {
        let zero = Lanes::<S>::splat(s, 0.0);
        let (mut first, mut second, mut cross) = (zero, zero, zero);
        for k in 0..TAPS {
            let x = load::<S, WHOLE>(s, self.x[k], at);
            let y = load::<S, WHOLE>(s, self.y[k], at);
            let weighted = down[k] * x;
            first += weighted;
            second = weighted.mul_add(x, second);
            cross = weighted.mul_add(y, cross);
        }
        padded[0].put::<S>(first, at);
        padded[1].put::<S>(second, at);
        padded[2].put::<S>(cross, at);
    }

    /// Similarity and its derivative by the three moments of the render, times the mask.
    #[inline(always)]
    fn similarity<S: Simd, const WHOLE: bool, const MASKED: bool>(
        &self,
        s: S,
        across: &[Lanes<S>; TAPS],
        padded: &[Padded; 3],
        maps: &mut [f32],
        sums: &mut [Lanes<S>; 2],
        at: usize,
    ) {
        let c = |v: f32| Lanes::<S>::splat(s, v);
        let mx = padded[0].across(s, across, at);
        let xx = padded[1].across(s, across, at) - mx * mx;
        let my = load::<S, WHOLE>(s, self.mean, at);
        let xy = padded[2].across(s, across, at) - mx * my;
        let yy = load::<S, WHOLE>(s, self.variance, at);
        let a1 = (mx * my) * c(2.0) + c(K1);
        let a2 = xy * c(2.0) + c(K2);
        let b1 = mx * mx + my * my + c(K1);
        let b2 = xx + yy + c(K2);
        let inverse = c(1.0) / (b1 * b2);
        let value = a1 * a2 * inverse;
        let d_mean = (my * (a2 - a1) - mx * value * (b2 - b1)) * inverse * c(2.0);
        let d_square = -value * b1 * inverse;
        let d_cross = a1 * inverse * c(2.0);
        // Vectors are padded with equal (zero) pixels, which are perfectly similar but do not count.
        let count = if MASKED {
            load::<S, WHOLE>(s, self.weight, at)
        } else if WHOLE {
            c(1.0)
        } else {
            let left = self.mean.len() - at;
            Lanes::<S>::from_fn(s, |i| if i < left { 1.0 } else { 0.0 })
        };
        let difference = (load::<S, WHOLE>(s, self.x[TAPS / 2], at) - load::<S, WHOLE>(s, self.y[TAPS / 2], at)).abs();
        sums[0] = count.mul_add(difference, sums[0]);
        sums[1] = count.mul_add(value, sums[1]);
        let n = self.mean.len();
        for (k, map) in [d_mean, d_square, d_cross].into_iter().enumerate() {
            let map = if MASKED { map * count } else { map };
            store::<S, WHOLE>(map, &mut maps[k * n..(k + 1) * n], at);
        }
    }
}

/// Sum of all lanes in double precision.
#[inline(always)]
fn sum<S: Simd>(v: Lanes<S>) -> f64 {
    v.as_slice().iter().map(|&x| f64::from(x)).sum()
}

/// One row of the second pass: `gradient = scales[0] sgn(x − y) + scales[1] (⊛D_μ + 2x ⊛D_xx + y ⊛D_xy)`.
#[inline(always)]
fn second<S: Simd>(s: S, images: &Images, y: usize, maps: &[&[f32]; TAPS], down: &[f32; TAPS], scales: [f32; 2], out: &mut [f32]) {
    let (n, step) = (images.n, Lanes::<S>::LEN);
    let whole = n - n % step;
    let row = Second {
        maps: [0, 1, 2].map(|m| maps.map(|rows| &rows[m * n..(m + 1) * n])),
        x: images.row(images.x, y),
        y: images.row(images.target.rgb().as_flattened(), y),
        weight: images.weight(y),
    };
    let (down, scales) = (splat(s, down), [Lanes::<S>::splat(s, scales[0]), Lanes::<S>::splat(s, scales[1])]);
    for at in (0..whole).step_by(step) {
        row.gradient::<S, true>(s, &down, &scales, out, at);
    }
    if whole < n {
        row.gradient::<S, false>(s, &down, &scales, out, whole);
    }
}

/// What the second pass reads for one row.
struct Second<'a> {
    maps: [[&'a [f32]; TAPS]; 3],
    x: &'a [f32],
    y: &'a [f32],
    weight: &'a [f32],
}

impl Second<'_> {
    #[inline(always)]
    fn gradient<S: Simd, const WHOLE: bool>(&self, s: S, down: &[Lanes<S>; TAPS], scales: &[Lanes<S>; 2], out: &mut [f32], at: usize) {
        let zero = Lanes::<S>::splat(s, 0.0);
        let mut filtered = [zero; 3];
        for m in 0..3 {
            for k in 0..TAPS {
                filtered[m] = down[k].mul_add(load::<S, WHOLE>(s, self.maps[m][k], at), filtered[m]);
            }
        }
        let x = load::<S, WHOLE>(s, self.x, at);
        let y = load::<S, WHOLE>(s, self.y, at);
        let similarity = y.mul_add(filtered[2], (x + x).mul_add(filtered[1], filtered[0]));
        let mut step = scales[0];
        if !self.weight.is_empty() {
            step *= load::<S, WHOLE>(s, self.weight, at);
        }
        let sign = x.simd_gt(y).select(step, x.simd_lt(y).select(-step, zero));
        store::<S, WHOLE>(scales[1].mul_add(similarity, sign), out, at);
    }
}

#[cfg(test)]
mod tests;
