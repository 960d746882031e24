//! How much a rendered image differs from the true one (splatting.md §9.3 M1).
//!
//! All measures compare display-referred sRGB with three channels, clamped to [0, 1], and average over the pixels of a
//! mask or over all. Windows see the pixels outside the mask. Everything is computed in double precision.

mod filter;
mod flip;
mod ssim;

pub use flip::{PIXELS_PER_DEGREE, flip, flip_map};
pub use ssim::ssim;

use megas_model::Image;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Differences of one view, or their averages over views.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Quality {
    /// Peak signal-to-noise ratio \[dB\]; ∞ for equal images (`null` in JSON).
    pub psnr: f64,
    /// Structural similarity, 1 for equal images.
    pub ssim: f64,
    /// Perceived difference in [0, 1], 0 for equal images.
    pub flip: f64,
}

impl Quality {
    /// All measures of one view; `mask` selects pixels.
    pub fn of(rendered: &Image, truth: &Image, mask: Option<&[bool]>) -> Self {
        Self { psnr: psnr(rendered, truth, mask), ssim: ssim(rendered, truth, mask), flip: flip(truth, rendered, PIXELS_PER_DEGREE, mask) }
    }

    /// The mean of each measure over views; `None` without any.
    pub fn mean(views: &[Self]) -> Option<Self> {
        let n = (!views.is_empty()).then_some(views.len() as f64)?;
        let mean = |f: fn(&Self) -> f64| views.iter().map(f).sum::<f64>() / n;
        Some(Self { psnr: mean(|q| q.psnr), ssim: mean(|q| q.ssim), flip: mean(|q| q.flip) })
    }
}

/// `−10 log₁₀` of the mean squared difference over pixels and channels \[dB\]; ∞ for equal images, NaN for an empty mask.
pub fn psnr(rendered: &Image, truth: &Image, mask: Option<&[bool]>) -> f64 {
    let map: Vec<f64> = {
        check(rendered, truth);
        let pairs = rendered.data.par_chunks_exact(3).zip(truth.data.par_chunks_exact(3));
        pairs.map(|(a, b)| (0..3).map(|c| (clamped(a[c]) - clamped(b[c])).powi(2)).sum::<f64>() / 3.0).collect()
    };
    -10.0 * mean(&map, mask).log10()
}

/// Pixels within `dilation` pixels (centre to centre) of one with alpha > 0.5: where an object is and its outline shows.
/// The scenes of the design use 4. `rgba` has four channels.
pub fn object_mask(rgba: &Image, dilation: f32) -> Vec<bool> {
    assert_eq!(rgba.channels, 4, "an image with alpha");
    let (width, height) = (rgba.width as usize, rgba.height as usize);
    let solid: Vec<bool> = rgba.data.chunks_exact(4).map(|p| p[3] > 0.5).collect();
    let reach = dilation.max(0.0).floor() as isize;
    // Half widths of the disc, row by row.
    let spans: Vec<(isize, isize)> =
        (-reach..=reach).map(|dy| (dy, (dilation * dilation - (dy * dy) as f32).max(0.0).sqrt().floor() as isize)).collect();
    // Solid pixels before each column, per row: a span is occupied where the count changes over it.
    let counts: Vec<u32> = solid
        .par_chunks(width.max(1))
        .flat_map_iter(|row| {
            let mut count = 0;
            std::iter::once(0).chain(row.iter().map(move |&s| {
                count += u32::from(s);
                count
            }))
        })
        .collect();
    let occupied = |x: usize, y: usize| {
        spans.iter().any(|&(dy, half)| {
            let row = y as isize + dy;
            if row < 0 || row >= height as isize {
                return false;
            }
            let from = (x as isize - half).max(0) as usize;
            let to = (x as isize + half + 1).min(width as isize) as usize;
            let row = &counts[row as usize * (width + 1)..];
            row[to] > row[from]
        })
    };
    (0..width * height).into_par_iter().map(|i| occupied(i % width, i / width)).collect()
}

fn check(a: &Image, b: &Image) {
    assert!(a.channels == 3 && b.channels == 3, "colour without alpha");
    assert!((a.width, a.height) == (b.width, b.height), "images of different sizes");
}

fn clamped(v: f32) -> f64 {
    f64::from(v.clamp(0.0, 1.0))
}

/// Mean over the pixels of a mask, or over all; NaN without any.
fn mean(map: &[f64], mask: Option<&[bool]>) -> f64 {
    let (sum, n) = match mask {
        None => (map.iter().sum::<f64>(), map.len()),
        Some(mask) => {
            assert_eq!(mask.len(), map.len(), "one flag per pixel");
            map.iter().zip(mask).filter(|(_, m)| **m).fold((0.0, 0), |(s, n), (v, _)| (s + v, n + 1))
        }
    };
    sum / n as f64
}

#[cfg(test)]
mod tests {
    use megas_math::rng::Rng;

    use super::*;

    /// Two images made of integers, the same on every machine.
    pub(super) fn pattern(k: usize) -> Image {
        let mut image = Image::new(64, 48, 3);
        for y in 0..48 {
            for x in 0..64 {
                for c in 0..3 {
                    let check = if (x / 8 + y / 8 + k) % 2 == 1 { 40 } else { 0 };
                    let v = (x * 7 + y * 13 + c * 29 + (x * y) % (17 + k) + check) % 256;
                    image.pixel_mut(x as u32, y as u32)[c] = v as f32 / 255.0;
                }
            }
        }
        image
    }

    pub(super) fn constant(rgb: [f32; 3]) -> Image {
        Image { width: 64, height: 48, channels: 3, data: rgb.repeat(64 * 48) }
    }

    pub(super) fn noisy(image: &Image, amount: f32) -> Image {
        let mut rng = Rng::new(5);
        let data = image.data.iter().map(|v| v + amount * (rng.unit() as f32 - 0.5)).collect();
        Image { data, ..image.clone() }
    }

    #[test]
    fn psnr_of_known_differences() {
        let (a, b) = (constant([0.5; 3]), constant([0.6, 0.5, 0.5]));
        assert!((psnr(&a, &b, None) - -10.0 * (0.01f64 / 3.0).log10()).abs() < 1e-5);
        assert_eq!(psnr(&a, &a, None), f64::INFINITY);
        assert!((psnr(&constant([-1.0; 3]), &constant([2.0; 3]), None)).abs() < 1e-12, "out of range is clamped");
        // Uniform noise of width w has variance w²/12.
        let expected = -10.0 * (0.01f64 / 12.0).log10();
        assert!((psnr(&noisy(&a, 0.1), &a, None) - expected).abs() < 0.1);
    }

    #[test]
    fn every_measure_orders_noise_and_respects_the_mask() {
        let truth = pattern(0);
        let q = [0.02, 0.1, 0.4].map(|n| Quality::of(&noisy(&truth, n), &truth, None));
        assert!(q[0].psnr > q[1].psnr + 5.0 && q[1].psnr > q[2].psnr + 5.0);
        assert!(q[0].ssim > q[1].ssim && q[1].ssim > q[2].ssim, "{q:?}");
        assert!(q[0].flip < q[1].flip && q[1].flip < q[2].flip, "{q:?}");
        // Noise in the right half only; the windows reach less than 24 px.
        let mut half = noisy(&truth, 0.3);
        for y in 0..48 {
            for x in 0..32 {
                half.pixel_mut(x, y).copy_from_slice(truth.pixel(x, y));
            }
        }
        let left: Vec<bool> = (0..64 * 48).map(|i| i % 64 < 8).collect();
        let right: Vec<bool> = (0..64 * 48).map(|i| i % 64 >= 32).collect();
        let (clean, dirty) = (Quality::of(&half, &truth, Some(&left)), Quality::of(&half, &truth, Some(&right)));
        assert!(clean.psnr == f64::INFINITY && clean.flip == 0.0 && (clean.ssim - 1.0).abs() < 1e-12);
        let all = Quality::of(&half, &truth, None);
        assert!(dirty.psnr < all.psnr - 2.9 && dirty.ssim < all.ssim && dirty.flip > all.flip);
        let average = Quality::mean(&[dirty, all]).unwrap();
        assert!((average.ssim - 0.5 * (dirty.ssim + all.ssim)).abs() < 1e-15);
        assert_eq!(Quality::mean(&[]), None);
    }

    #[test]
    fn a_dilated_pixel_is_a_disc() {
        let mut rgba = Image::new(20, 15, 4);
        rgba.pixel_mut(8, 6)[3] = 1.0;
        rgba.pixel_mut(19, 14)[3] = 0.5;
        let mask = object_mask(&rgba, 4.0);
        for y in 0..15i32 {
            for x in 0..20i32 {
                let inside = (x - 8).pow(2) + (y - 6).pow(2) <= 16;
                assert_eq!(mask[(y * 20 + x) as usize], inside, "{x} {y}");
            }
        }
        assert_eq!(object_mask(&rgba, 0.0).iter().filter(|m| **m).count(), 1);
        rgba.pixel_mut(19, 14)[3] = 0.51;
        let corner = object_mask(&rgba, 2.0);
        assert_eq!(corner.iter().enumerate().filter(|(i, m)| **m && i % 20 > 12).count(), 6);
    }
}
