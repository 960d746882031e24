//! Temperature in false colour, with a legend and the melting iso-line (splatting.md §8.5).

use megas_model::Image;

use crate::{
    colormap::{inferno, unit},
    error::{Result, mismatch},
    isoline::isoline,
    text::{Font, Ink, PLATE, blend, fill},
};

/// Colour of the melting line: the one hue the colour map does not contain.
const MELTING: [f32; 3] = [0.15, 0.95, 1.0];
/// 0 °C \[K\].
const ZERO_CELSIUS: f32 = 273.15;

/// How temperatures are shown.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ThermalStyle {
    /// Temperatures at the ends of the colour map \[K\], the lower one first.
    pub range: [f32; 2],
    /// Draws the iso-line of this temperature \[K\].
    pub melting_point: Option<f32>,
    /// Colour behind the object, sRGB in [0, 1].
    pub background: [f32; 3],
    /// Draws the colour bar with its scale in °C.
    pub legend: bool,
}

impl ThermalStyle {
    /// Dark background, with legend.
    pub fn new(range: [f32; 2], melting_point: Option<f32>) -> Self {
        Self { range, melting_point, background: [0.09, 0.10, 0.12], legend: true }
    }
}

/// An RGB image of a temperature image \[K\] (one channel, already divided by alpha) over the background, weighted with `alpha`
/// (one channel, [0, 1]).
pub fn thermal_image(temperature: &Image, alpha: &Image, style: &ThermalStyle) -> Result<Image> {
    let (w, h) = (temperature.width, temperature.height);
    let [lo, hi] = style.range;
    if (alpha.width, alpha.height) != (w, h) || temperature.channels != 1 || alpha.channels != 1 {
        let found = format!(
            "temperature {w}x{h} with {} channels and alpha {}x{} with {}",
            temperature.channels, alpha.width, alpha.height, alpha.channels
        );
        return Err(mismatch(found, "two images of the same size with one channel each"));
    }
    if !(lo.is_finite() && hi.is_finite() && hi > lo) {
        return Err(mismatch(format!("a temperature range from {lo} K to {hi} K"), "finite ends, the lower one first"));
    }
    let mut image = Image::new(w, h, 3);
    for ((out, &t), &a) in image.data.chunks_exact_mut(3).zip(&temperature.data).zip(&alpha.data) {
        let a = unit(a);
        let colour = inferno((t - lo) / (hi - lo));
        for c in 0..3 {
            out[c] = style.background[c] + a * (colour[c] - style.background[c]);
        }
    }
    if let Some(level) = style.melting_point {
        // One pixel at 480 lines, two at 1080.
        let width = (h as f32 / 480.0).clamp(1.0, 4.0);
        for (out, c) in image.data.chunks_exact_mut(3).zip(isoline(temperature, alpha, level, width)) {
            for k in 0..3 {
                out[k] += c * (MELTING[k] - out[k]);
            }
        }
    }
    if style.legend {
        legend(&mut image, style);
    }
    Ok(image)
}

/// A step of 1, 2 or 5 times a power of ten that divides `span` into at most `most` parts.
fn nice_step(span: f32, most: f32) -> f32 {
    let raw = (span / most).max(f32::MIN_POSITIVE);
    let power = 10f32.powf(raw.log10().floor());
    [1.0, 2.0, 5.0, 10.0].into_iter().map(|m| m * power).find(|s| *s >= 0.999 * raw).unwrap_or(10.0 * power)
}

fn legend(image: &mut Image, style: &ThermalStyle) {
    let ink = Ink::on(style.background);
    let font = Font::for_height(image.height);
    let line = font.line();
    let [lo, hi] = style.range.map(|k| k - ZERO_CELSIUS);
    let (w, h) = (image.width as i32, image.height as i32);
    let (top, bottom) = (h / 5, h - h / 5);
    let length = bottom - top;
    let step = nice_step(hi - lo, (length / (2 * line)).max(1) as f32);
    let decimals = (-step.log10().floor()).max(0.0) as usize;
    let label = |v: f32| format!("{v:.decimals$}");
    let melting = style.melting_point.map(|k| k - ZERO_CELSIUS).filter(|v| (lo..=hi).contains(v));
    let melting_label = melting.map(|v| {
        let text = format!("melts {v:.1}");
        text.strip_suffix(".0").map(str::to_owned).unwrap_or(text)
    });

    let first = (lo / step).ceil() as i64;
    let ticks: Vec<f32> = (first..).map(|k| k as f32 * step).take_while(|v| *v <= hi * (1.0 + 1e-6) + 1e-6 * step).take(64).collect();
    // "-0" is no number to show.
    let ticks: Vec<(f32, String)> = ticks.into_iter().map(|v| (v, label(if v == 0.0 { 0.0 } else { v }))).collect();
    let widest = ticks.iter().map(|(_, t)| t).chain(&melting_label).map(|t| font.width(t)).max().unwrap_or(0).max(font.width("°C"));

    let bar = (w / 45).clamp(8, 40);
    let (margin, gap) = (line / 2, line / 3);
    let right = w - margin - gap;
    let left = right - bar;
    let plate = [left - 2 * gap - widest - gap, top - 2 * line, w - margin, bottom + line];
    fill(image, plate, ink.plate, PLATE);
    font.draw(image, left - 2 * gap - font.width("°C"), top - line - line / 2, "°C", ink.text);

    let row_of = |v: f32| top as f32 + (hi - v) / (hi - lo) * (length - 1) as f32;
    for y in top..bottom {
        let colour = inferno(1.0 - (y - top) as f32 / (length - 1).max(1) as f32);
        (left..right).for_each(|x| blend(image, x, y, colour, 1.0));
    }
    for (x0, y0, x1, y1) in [
        (left - 1, top - 1, right + 1, top),
        (left - 1, bottom, right + 1, bottom + 1),
        (left - 1, top, left, bottom),
        (right, top, right + 1, bottom),
    ] {
        fill(image, [x0, y0, x1, y1], ink.text, 1.0);
    }
    let mut write = |value: f32, text: &str, colour: [f32; 3], from: i32| {
        let y = row_of(value).round() as i32;
        fill(image, [from, y, left, y + 1], colour, 1.0);
        font.draw(image, left - 2 * gap - font.width(text), y - line / 2, text, colour);
    };
    for (v, text) in &ticks {
        let hidden = melting.is_some_and(|m| (row_of(m) - row_of(*v)).abs() < line as f32);
        if !hidden {
            write(*v, text, ink.text, left - gap);
        }
    }
    if let (Some(v), Some(text)) = (melting, &melting_label) {
        // Readable on white, too.
        let colour = if ink.text[0] > 0.5 { MELTING } else { [0.0, 0.45, 0.55] };
        write(v, text, colour, left - gap);
        let y = row_of(v).round() as i32;
        fill(image, [left, y, right, y + (h / 480).clamp(1, 4)], MELTING, 1.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_are_round() {
        for (span, most, expected) in [(100.0, 8.0, 20.0), (30.0, 8.0, 5.0), (7.0, 8.0, 1.0), (0.5, 8.0, 0.1), (1500.0, 8.0, 200.0)] {
            let s = nice_step(span, most);
            assert!((s - expected).abs() < 1e-3 * expected, "{span} {most} {s}");
        }
    }

    #[test]
    fn colours_follow_temperature_and_alpha() {
        let (mut t, mut a) = (Image::new(40, 40, 1), Image::new(40, 40, 1));
        t.data.fill(300.0);
        a.data.fill(1.0);
        t.data[5] = f32::NAN;
        a.data[7] = 0.0;
        a.data[8] = 0.5;
        let style = ThermalStyle { legend: false, ..ThermalStyle::new([290.0, 310.0], Some(400.0)) };
        let image = thermal_image(&t, &a, &style).unwrap();
        assert!(image.pixel(0, 0).iter().zip(inferno(0.5)).all(|(a, b)| (a - b).abs() < 1e-6));
        assert!(image.pixel(5, 0).iter().zip(inferno(0.0)).all(|(a, b)| (a - b).abs() < 1e-6));
        assert_eq!(image.pixel(7, 0), style.background);
        assert!((image.pixel(8, 0)[0] - 0.5 * (inferno(0.5)[0] + style.background[0])).abs() < 1e-6);
        assert!(thermal_image(&t, &Image::new(40, 41, 1), &style).is_err());
        assert!(thermal_image(&t, &a, &ThermalStyle { range: [300.0, 300.0], ..style }).is_err());
    }

    #[test]
    fn the_legend_survives_every_size_and_range() {
        for (w, h) in [(1, 1), (16, 16), (64, 200), (640, 480), (1280, 720), (3840, 2160)] {
            for range in [[293.0, 294.0], [250.0, 1800.0], [-1e6, 1e6], [300.0, 300.0001]] {
                let (t, a) = (Image::new(w, h, 1), Image::new(w, h, 1));
                thermal_image(&t, &a, &ThermalStyle::new(range, Some(range[0]))).unwrap();
            }
        }
    }
}
