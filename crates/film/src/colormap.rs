//! A perceptually uniform colour map: black, violet, red, orange, pale yellow, with lightness rising evenly.
//!
//! The anchors are ten equally spaced entries of "inferno" by S. van der Walt and N. Smith (matplotlib, released as CC0). Between
//! them this module interpolates in Oklab (B. Ottosson), which keeps the steps even to the eye.

use std::sync::LazyLock;

const ANCHORS: [u32; 10] = [0x000004, 0x1b0c41, 0x4a0c6b, 0x781c6d, 0xa52c60, 0xcf4446, 0xed6925, 0xfb9b06, 0xf7d13d, 0xfcffa4];

static TABLE: LazyLock<[[f32; 3]; 256]> = LazyLock::new(table);

/// Display-referred sRGB of the fraction `t` of the range; clamped, not-a-number is the lower end.
pub fn inferno(t: f32) -> [f32; 3] {
    let x = unit(t) * 255.0;
    let i = (x as usize).min(254);
    let f = x - i as f32;
    let (a, b) = (TABLE[i], TABLE[i + 1]);
    std::array::from_fn(|c| a[c] + f * (b[c] - a[c]))
}

/// Clamped to [0, 1]; not-a-number becomes 0.
#[inline(always)]
pub(crate) fn unit(v: f32) -> f32 {
    if v > 0.0 { v.min(1.0) } else { 0.0 }
}

fn table() -> [[f32; 3]; 256] {
    let anchors = ANCHORS.map(|hex| oklab([16, 8, 0].map(|s| f64::from(hex >> s & 255) / 255.0)));
    let last = anchors.len() - 1;
    std::array::from_fn(|k| {
        let x = k as f64 / 255.0 * last as f64;
        let i = (x as usize).min(last - 1);
        let t = x - i as f64;
        let at = |j: isize| anchors[(i as isize + j).clamp(0, last as isize) as usize];
        let (p0, p1, p2, p3) = (at(-1), at(0), at(1), at(2));
        srgb(std::array::from_fn(|c| {
            // Uniform Catmull–Rom.
            let (a, b) = (0.5 * (p2[c] - p0[c]), 0.5 * (p3[c] - p1[c]));
            let d = p2[c] - p1[c];
            p1[c] + t * (a + t * ((3.0 * d - 2.0 * a - b) + t * (a + b - 2.0 * d)))
        }))
        .map(|v| v as f32)
    })
}

fn oklab(rgb: [f64; 3]) -> [f64; 3] {
    let [r, g, b] = rgb.map(|v| if v <= 0.04045 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) });
    let l = (0.412_221_470_8 * r + 0.536_332_536_3 * g + 0.051_445_992_9 * b).cbrt();
    let m = (0.211_903_498_2 * r + 0.680_699_545_1 * g + 0.107_396_956_6 * b).cbrt();
    let s = (0.088_302_461_9 * r + 0.281_718_837_6 * g + 0.629_978_700_5 * b).cbrt();
    [
        0.210_454_255_3 * l + 0.793_617_785_0 * m - 0.004_072_046_8 * s,
        1.977_998_495_1 * l - 2.428_592_205_0 * m + 0.450_593_709_9 * s,
        0.025_904_037_1 * l + 0.782_771_766_2 * m - 0.808_675_766_0 * s,
    ]
}

fn srgb(lab: [f64; 3]) -> [f64; 3] {
    let [light, a, b] = lab;
    let l = (light + 0.396_337_777_4 * a + 0.215_803_757_3 * b).powi(3);
    let m = (light - 0.105_561_345_8 * a - 0.063_854_172_8 * b).powi(3);
    let s = (light - 0.089_484_177_5 * a - 1.291_485_548_0 * b).powi(3);
    let linear = [
        4.076_741_662_1 * l - 3.307_711_591_3 * m + 0.230_969_929_2 * s,
        -1.268_438_004_6 * l + 2.609_757_401_1 * m - 0.341_319_396_5 * s,
        -0.004_196_086_3 * l - 0.703_418_614_7 * m + 1.707_614_701_0 * s,
    ];
    linear.map(|v| if v <= 0.003_130_8 { 12.92 * v.max(0.0) } else { (1.055 * v.powf(1.0 / 2.4) - 0.055).min(1.0) })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ends_and_middle_are_those_of_the_original() {
        let bytes = |t: f32| inferno(t).map(|v| (v * 255.0).round() as i32);
        assert_eq!(bytes(0.0), [0, 0, 4]);
        assert_eq!(bytes(1.0), [252, 255, 164]);
        // The original's entry in the middle, which is no anchor, is (188, 55, 84).
        for (ours, theirs) in bytes(0.5).into_iter().zip([188, 55, 84]) {
            assert!((ours - theirs).abs() <= 4, "{:?}", bytes(0.5));
        }
        assert_eq!(inferno(f32::NAN), inferno(0.0));
        assert_eq!(inferno(f32::INFINITY), inferno(1.0));
    }

    #[test]
    fn lightness_rises_and_steps_are_even() {
        let lab = |k: usize| oklab(TABLE[k].map(f64::from));
        let mut steps = Vec::new();
        for k in 8..248 {
            let (a, b) = (lab(k), lab(k + 1));
            assert!(b[0] > a[0], "lightness falls at {k}");
            steps.push((0..3).map(|c| (b[c] - a[c]).powi(2)).sum::<f64>().sqrt());
        }
        steps.sort_by(f64::total_cmp);
        assert!(steps[steps.len() - 1] < 3.0 * steps[0], "{} {}", steps[0], steps[steps.len() - 1]);
    }
}
