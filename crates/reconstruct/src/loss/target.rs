//! What is constant about a target view: its colours and the local moments that the structural similarity needs of them.

use fearless_simd::{Level, Simd, SimdBase, SimdFloat, dispatch};
use megas_math::simd::Lanes;
use rayon::prelude::*;

use super::window::{BAND, Padded, TAPS, load, reach, splat, store, taps};

/// A target image, prepared for [`super::Photometric`]. Build it once per training image, or refill one for every
/// iteration where the background under a transparent image changes.
#[derive(Clone, Debug, Default)]
pub struct Target {
    width: usize,
    height: usize,
    rgb: Vec<[f32; 3]>,
    /// Weight of each pixel, repeated for its three channels; empty without a mask.
    weight: Vec<f32>,
    /// Sum over pixels of the mask, or the number of pixels.
    norm: f64,
    /// Window mean `μy`.
    mean: Vec<f32>,
    /// Window variance `⊛y² − μy²`.
    variance: Vec<f32>,
}

impl Target {
    /// A target of `width × height` pixels from its colours, display-referred sRGB in [0, 1].
    pub fn new(width: usize, height: usize, rgb: &[[f32; 3]]) -> Self {
        let mut target = Self::default();
        target.set(width, height, rgb);
        target
    }

    /// Width \[px\].
    pub fn width(&self) -> usize {
        self.width
    }

    /// Height \[px\].
    pub fn height(&self) -> usize {
        self.height
    }

    /// The colours that renders are compared with.
    pub fn rgb(&self) -> &[[f32; 3]] {
        &self.rgb
    }

    /// Replaces the image. A mask stays if the size does.
    pub fn set(&mut self, width: usize, height: usize, rgb: &[[f32; 3]]) {
        assert_eq!(rgb.len(), width * height, "one colour per pixel");
        self.fill(width, height, |first, row| row.copy_from_slice(&rgb[first..first + row.len()]));
    }

    /// Replaces the image by 8-bit RGB.
    pub fn set_u8(&mut self, width: usize, height: usize, rgb: &[u8]) {
        assert_eq!(rgb.len(), 3 * width * height, "three bytes per pixel");
        self.fill(width, height, |first, row| {
            for (out, px) in row.iter_mut().zip(rgb[3 * first..].chunks_exact(3)) {
                *out = [px[0], px[1], px[2]].map(|v| f32::from(v) / 255.0);
            }
        });
    }

    /// Replaces the image by 8-bit RGBA (straight alpha) over `background`.
    pub fn composite_u8(&mut self, width: usize, height: usize, rgba: &[u8], background: [f32; 3]) {
        assert_eq!(rgba.len(), 4 * width * height, "four bytes per pixel");
        self.fill(width, height, |first, row| {
            for (out, px) in row.iter_mut().zip(rgba[4 * first..].chunks_exact(4)) {
                *out = over([px[0], px[1], px[2], px[3]].map(|v| f32::from(v) / 255.0), background);
            }
        });
    }

    /// Replaces the image by RGBA (straight alpha, interleaved) over `background`.
    pub fn composite(&mut self, width: usize, height: usize, rgba: &[f32], background: [f32; 3]) {
        assert_eq!(rgba.len(), 4 * width * height, "four values per pixel");
        self.fill(width, height, |first, row| {
            for (out, px) in row.iter_mut().zip(rgba[4 * first..].chunks_exact(4)) {
                *out = over([px[0], px[1], px[2], px[3]], background);
            }
        });
    }

    /// Weight ≥ 0 of every pixel in both parts of the photometric loss; `None` for 1 everywhere. The loss is the weighted
    /// mean. The windows of the structural similarity still see what lies outside the mask.
    pub fn set_mask(&mut self, mask: Option<&[f32]>) {
        self.weight.clear();
        self.norm = (self.width * self.height) as f64;
        if let Some(mask) = mask {
            assert_eq!(mask.len(), self.width * self.height, "one weight per pixel");
            self.weight.extend(mask.iter().flat_map(|&m| [m; 3]));
            self.norm = mask.iter().map(|&m| f64::from(m)).sum();
        }
    }

    /// Weight of each float of the image; empty where all are 1.
    pub(super) fn weight(&self) -> &[f32] {
        &self.weight
    }

    /// Sum of the weights of all pixels.
    pub(super) fn norm(&self) -> f64 {
        self.norm
    }

    /// `μy` of each float of the image.
    pub(super) fn mean(&self) -> &[f32] {
        &self.mean
    }

    /// `σy²` of each float of the image.
    pub(super) fn variance(&self) -> &[f32] {
        &self.variance
    }

    /// Colours from `colour(first pixel, row)`, then the moments.
    fn fill(&mut self, width: usize, height: usize, colour: impl Fn(usize, &mut [[f32; 3]]) + Sync) {
        assert!(width > 0 && height > 0, "an image has pixels");
        if (self.width, self.height) != (width, height) {
            (self.width, self.height) = (width, height);
            self.set_mask(None);
        }
        self.rgb.resize(width * height, [0.0; 3]);
        let rows = self.rgb.par_chunks_mut(width).enumerate().with_min_len(BAND);
        rows.for_each(|(y, row)| colour(y * width, row));
        self.find_moments(Level::new());
    }

    /// Mean and variance under the window of every float.
    pub(super) fn find_moments(&mut self, level: Level) {
        let (n, height) = (3 * self.width, self.height);
        self.mean.resize(n * height, 0.0);
        self.variance.resize(n * height, 0.0);
        let weights = taps().map(|w| w as f32);
        let image = self.rgb.as_flattened();
        let rows = self.mean.par_chunks_mut(n).zip(self.variance.par_chunks_mut(n)).enumerate().with_min_len(BAND);
        rows.for_each_init(
            || {
                let mut rows = [Padded::default(), Padded::default()];
                rows.iter_mut().for_each(|r| r.resize(n));
                rows
            },
            |padded, (y, (mean, variance))| {
                let (rows, down) = reach(y, height, &weights);
                let rows = rows.map(|r| &image[r * n..(r + 1) * n]);
                dispatch!(level, s => moments(s, &rows, &down, &weights, padded, mean, variance));
            },
        );
    }
}

/// A colour with straight alpha over an opaque one.
#[inline(always)]
fn over(rgba: [f32; 4], background: [f32; 3]) -> [f32; 3] {
    let a = rgba[3];
    [0, 1, 2].map(|c| rgba[c] * a + background[c] * (1.0 - a))
}

/// Window mean and variance of one row.
#[inline(always)]
fn moments<S: Simd>(
    s: S,
    rows: &[&[f32]; TAPS],
    down: &[f32; TAPS],
    across: &[f32; TAPS],
    padded: &mut [Padded; 2],
    mean: &mut [f32],
    variance: &mut [f32],
) {
    let (n, step) = (mean.len(), Lanes::<S>::LEN);
    let whole = n - n % step;
    let (down, across) = (splat(s, down), splat(s, across));
    for at in (0..whole).step_by(step) {
        moments_down::<S, true>(s, rows, &down, padded, at);
    }
    if whole < n {
        moments_down::<S, false>(s, rows, &down, padded, whole);
    }
    for at in (0..whole).step_by(step) {
        moments_across::<S, true>(s, padded, &across, mean, variance, at);
    }
    if whole < n {
        moments_across::<S, false>(s, padded, &across, mean, variance, whole);
    }
}

#[inline(always)]
fn moments_down<S: Simd, const WHOLE: bool>(s: S, rows: &[&[f32]; TAPS], down: &[Lanes<S>; TAPS], padded: &mut [Padded; 2], at: usize) {
    let mut first = Lanes::<S>::splat(s, 0.0);
    let mut second = first;
    for k in 0..TAPS {
        let y = load::<S, WHOLE>(s, rows[k], at);
        let weighted = down[k] * y;
        first += weighted;
        second = weighted.mul_add(y, second);
    }
    padded[0].put::<S>(first, at);
    padded[1].put::<S>(second, at);
}

#[inline(always)]
fn moments_across<S: Simd, const WHOLE: bool>(
    s: S,
    padded: &[Padded; 2],
    across: &[Lanes<S>; TAPS],
    mean: &mut [f32],
    variance: &mut [f32],
    at: usize,
) {
    let first = padded[0].across(s, across, at);
    let second = padded[1].across(s, across, at);
    store::<S, WHOLE>(first, mean, at);
    store::<S, WHOLE>(second - first * first, variance, at);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_source_gives_the_same_target() {
        let (width, height) = (7, 5);
        let bytes: Vec<u8> = (0..width * height * 4).map(|i| (i * 37 % 256) as u8).collect();
        let background = [0.2, 0.5, 0.8];
        let floats: Vec<f32> = bytes.iter().map(|&b| f32::from(b) / 255.0).collect();
        let mut a = Target::default();
        a.composite_u8(width, height, &bytes, background);
        let mut b = Target::default();
        b.composite(width, height, &floats, background);
        let c = Target::new(width, height, a.rgb());
        assert_eq!(a.rgb(), b.rgb());
        assert!(a.mean() == c.mean() && a.variance() == c.variance());
        let px = [bytes[4], bytes[5], bytes[6], bytes[7]].map(|v| f32::from(v) / 255.0);
        for k in 0..3 {
            assert!((a.rgb()[1][k] - (px[k] * px[3] + background[k] * (1.0 - px[3]))).abs() < 1e-6);
        }
        let opaque: Vec<u8> = bytes.chunks_exact(4).flat_map(|p| [p[0], p[1], p[2]]).collect();
        b.set_u8(width, height, &opaque);
        assert_eq!(b.rgb()[3], [bytes[12], bytes[13], bytes[14]].map(|v| f32::from(v) / 255.0));
    }

    #[test]
    fn a_mask_survives_a_new_image_of_the_same_size_only() {
        let mut t = Target::new(4, 3, &[[0.5; 3]; 12]);
        t.set_mask(Some(&[0.25; 12]));
        t.set(4, 3, &[[0.1; 3]; 12]);
        assert_eq!((t.norm(), t.weight().len()), (3.0, 36));
        t.set(3, 4, &[[0.1; 3]; 12]);
        assert_eq!((t.norm(), t.weight().len()), (12.0, 0));
    }
}
