//! Changing the size of an image: area average for whole factors, Lanczos-3 otherwise, in sRGB space (splatting.md §2.4).
//!
//! Works on 8-bit rows with one row of floats at a time; colours are weighted by alpha, so that what hides under transparent
//! pixels never bleeds into the object.

use crate::optics::Size;

/// Reconstruction filter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Filter {
    /// Mean over the area an output pixel covers; exact also where it covers fractions of input pixels.
    Area,
    /// Windowed sinc with three lobes.
    Lanczos3,
}

/// The weights of one output pixel, which sum to one.
struct Taps {
    first: usize,
    weights: Vec<f32>,
}

fn taps(from: u32, to: u32, filter: Filter) -> Vec<Taps> {
    let scale = f64::from(from) / f64::from(to);
    let last = f64::from(from - 1);
    (0..to)
        .map(|i| {
            let (lo, hi) = (f64::from(i) * scale, f64::from(i + 1) * scale);
            // Enlarging interpolates with the kernel at its own size; reducing widens it.
            let width = 3.0 * scale.max(1.0);
            let centre = 0.5 * (lo + hi);
            let (first, end) = match filter {
                Filter::Area => (lo.floor(), hi.ceil() - 1.0),
                Filter::Lanczos3 => ((centre - width).floor(), (centre + width).ceil() - 1.0),
            };
            let (first, end) = (first.clamp(0.0, last) as usize, end.clamp(0.0, last) as usize);
            let raw: Vec<f64> = (first..=end)
                .map(|k| match filter {
                    Filter::Area => (hi.min(k as f64 + 1.0) - lo.max(k as f64)).max(0.0),
                    Filter::Lanczos3 => lanczos3((k as f64 + 0.5 - centre) / scale.max(1.0)),
                })
                .collect();
            let sum: f64 = raw.iter().sum();
            Taps { first, weights: raw.iter().map(|w| (w / sum) as f32).collect() }
        })
        .collect()
}

fn lanczos3(x: f64) -> f64 {
    let sinc = |t: f64| if t.abs() < 1e-9 { 1.0 } else { (std::f64::consts::PI * t).sin() / (std::f64::consts::PI * t) };
    if x.abs() < 3.0 { sinc(x) * sinc(x / 3.0) } else { 0.0 }
}

/// Resizes `channels` interleaved 8-bit values per pixel; with four of them the last is straight alpha.
pub(crate) fn resize(pixels: &[u8], channels: usize, from: Size, to: Size, filter: Filter) -> Vec<u8> {
    if from == to {
        return pixels.to_vec();
    }
    let (columns, rows) = (taps(from[0], to[0], filter), taps(from[1], to[1], filter));
    let stride = from[0] as usize * channels;
    let mut out = Vec::with_capacity(to[0] as usize * to[1] as usize * channels);
    let mut row = vec![0f32; stride];
    let mut pixel = vec![0f32; channels];
    for r in &rows {
        row.fill(0.0);
        for (k, w) in r.weights.iter().enumerate() {
            let y = r.first + k;
            accumulate(&mut row, &pixels[y * stride..(y + 1) * stride], channels, *w);
        }
        for c in &columns {
            pixel.fill(0.0);
            for (k, w) in c.weights.iter().enumerate() {
                let x = (c.first + k) * channels;
                pixel.iter_mut().zip(&row[x..x + channels]).for_each(|(p, v)| *p += w * v);
            }
            if channels == 4 {
                let a = pixel[3].clamp(0.0, 255.0);
                let inverse = if a > 1e-3 { 255.0 / a } else { 0.0 };
                out.extend(pixel[..3].iter().map(|v| round(v * inverse)));
                out.push(round(a));
            } else {
                out.extend(pixel.iter().map(|v| round(*v)));
            }
        }
    }
    out
}

/// Adds a weighted row; colours of four-channel images are multiplied by their alpha on the way.
fn accumulate(row: &mut [f32], source: &[u8], channels: usize, weight: f32) {
    if channels == 4 {
        for (out, px) in row.chunks_exact_mut(4).zip(source.chunks_exact(4)) {
            let a = f32::from(px[3]);
            let wa = weight * a / 255.0;
            (0..3).for_each(|k| out[k] += wa * f32::from(px[k]));
            out[3] += weight * a;
        }
    } else {
        row.iter_mut().zip(source).for_each(|(o, v)| *o += weight * f32::from(*v));
    }
}

/// To 8 bits with rounding; negative lobes and overshoots are clamped.
#[inline(always)]
pub(crate) fn round(v: f32) -> u8 {
    (v + 0.5).clamp(0.0, 255.0) as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn area_is_the_mean_of_the_covered_pixels() {
        let pixels: Vec<u8> = (0..24).map(|i| i * 10).collect();
        let half = resize(&pixels, 1, [6, 4], [3, 2], Filter::Area);
        assert_eq!(half[0], ((i32::from(pixels[0]) + 10 + 60 + 70) as f32 / 4.0).round() as u8);
        // Five pixels to two: each covers two and a half.
        let two = resize(&[0, 0, 100, 200, 200], 1, [5, 1], [2, 1], Filter::Area);
        assert_eq!(two, [20, 180]);
    }

    #[test]
    fn constants_and_ramps_survive_every_filter() {
        for filter in [Filter::Area, Filter::Lanczos3] {
            assert!(resize(&[77; 3 * 37 * 23], 3, [37, 23], [16, 10], filter).iter().all(|v| *v == 77));
            assert!(resize(&[77; 37 * 23], 1, [37, 23], [50, 30], filter).iter().all(|v| *v == 77));
            let ramp: Vec<u8> = (0..200).collect();
            let out = resize(&ramp, 1, [200, 1], [77, 1], filter);
            for i in 5..72 {
                let expected = (i as f32 + 0.5) * 200.0 / 77.0 - 0.5;
                assert!((f32::from(out[i]) - expected).abs() <= 1.0, "{filter:?} {i}");
            }
        }
    }

    #[test]
    fn hidden_colours_do_not_bleed() {
        // Red beside green that is fully transparent: the mean is red at half alpha.
        let pixels = [255, 0, 0, 255, 0, 255, 0, 0];
        assert_eq!(resize(&pixels, 4, [2, 1], [1, 1], Filter::Area), [255, 0, 0, 128]);
        let out = resize(&[9, 9, 9, 0].repeat(16), 4, [4, 4], [2, 2], Filter::Area);
        assert!(out.iter().all(|v| *v == 0));
    }
}
