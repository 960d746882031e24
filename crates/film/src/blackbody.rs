//! The colour of glowing matter: Planck's law, weighed with the eye's colour matching functions, as linear sRGB.

use std::sync::LazyLock;

/// CIE 1931 standard observer (2°), 380 to 780 nm in steps of 10 nm: x̄, ȳ, z̄ (CIE 018:2019, rounded).
const OBSERVER: [[f64; 3]; 41] = [
    [0.0014, 0.0000, 0.0065],
    [0.0042, 0.0001, 0.0201],
    [0.0143, 0.0004, 0.0679],
    [0.0435, 0.0012, 0.2074],
    [0.1344, 0.0040, 0.6456],
    [0.2839, 0.0116, 1.3856],
    [0.3483, 0.0230, 1.7471],
    [0.3362, 0.0380, 1.7721],
    [0.2908, 0.0600, 1.6692],
    [0.1954, 0.0910, 1.2876],
    [0.0956, 0.1390, 0.8130],
    [0.0320, 0.2080, 0.4652],
    [0.0049, 0.3230, 0.2720],
    [0.0093, 0.5030, 0.1582],
    [0.0633, 0.7100, 0.0782],
    [0.1655, 0.8620, 0.0422],
    [0.2904, 0.9540, 0.0203],
    [0.4334, 0.9950, 0.0087],
    [0.5945, 0.9950, 0.0039],
    [0.7621, 0.9520, 0.0021],
    [0.9163, 0.8700, 0.0017],
    [1.0263, 0.7570, 0.0011],
    [1.0622, 0.6310, 0.0008],
    [1.0026, 0.5030, 0.0003],
    [0.8544, 0.3810, 0.0002],
    [0.6424, 0.2650, 0.0000],
    [0.4479, 0.1750, 0.0000],
    [0.2835, 0.1070, 0.0000],
    [0.1649, 0.0610, 0.0000],
    [0.0874, 0.0320, 0.0000],
    [0.0468, 0.0170, 0.0000],
    [0.0227, 0.0082, 0.0000],
    [0.0114, 0.0041, 0.0000],
    [0.0058, 0.0021, 0.0000],
    [0.0029, 0.0010, 0.0000],
    [0.0014, 0.0005, 0.0000],
    [0.0007, 0.0002, 0.0000],
    [0.0003, 0.0001, 0.0000],
    [0.0002, 0.0001, 0.0000],
    [0.0001, 0.0000, 0.0000],
    [0.0000, 0.0000, 0.0000],
];

/// Second radiation constant hc/k \[m·K\].
const C2: f64 = 0.014_387_768_77;
/// First radiation constant for radiance, 2hc² \[W·m²/sr\].
const C1L: f64 = 1.191_042_972e-16;

/// Spectral radiance of a black body \[W/(m²·sr·m)\] at the wavelength \[m\] and temperature \[K\].
pub fn planck(wavelength: f64, kelvin: f64) -> f64 {
    C1L / (wavelength.powi(5) * (C2 / (wavelength * kelvin)).exp_m1())
}

/// Tristimulus values X, Y, Z of a black body \[W/(m²·sr)\] (683 times Y is its luminance in cd/m²).
pub fn tristimulus(kelvin: f64) -> [f64; 3] {
    let mut sum = [0.0; 3];
    if kelvin > 0.0 {
        // Steps of 1 nm between the tabled values: at low temperatures the radiance changes by a third from one to the next.
        for i in 0..400 {
            let (k, t) = (i / 10, (i % 10) as f64 / 10.0);
            let radiance = planck((380.0 + f64::from(i as u32)) * 1e-9, kelvin) * 1e-9;
            for (a, s) in sum.iter_mut().enumerate() {
                *s += radiance * (OBSERVER[k][a] + t * (OBSERVER[k + 1][a] - OBSERVER[k][a]));
            }
        }
    }
    sum
}

/// XYZ → linear sRGB (IEC 61966-2-1, D65).
pub fn xyz_to_linear_srgb([x, y, z]: [f64; 3]) -> [f64; 3] {
    [
        3.240_969_942 * x - 1.537_383_178 * y - 0.498_610_760 * z,
        -0.969_243_636 * x + 1.875_967_502 * y + 0.041_555_057 * z,
        0.055_630_080 * x - 0.203_976_959 * y + 1.056_971_514 * z,
    ]
}

/// Coldest and hottest temperature of the table \[K\], and its step.
const TABLE: (f64, f64, f64) = (600.0, 6000.0, 10.0);

/// For each temperature: ln Y, and the colour for Y = 1 brought into the gamut.
static GLOW: LazyLock<Vec<(f32, [f32; 3])>> = LazyLock::new(|| {
    let n = ((TABLE.1 - TABLE.0) / TABLE.2) as usize;
    (0..=n)
        .map(|k| {
            let xyz = tristimulus(TABLE.0 + k as f64 * TABLE.2);
            let rgb = xyz_to_linear_srgb(xyz).map(|v| v / xyz[1]);
            // Glowing red is too pure for a screen: mix in white of the same luminance until no channel is negative.
            let least = rgb.into_iter().fold(0.0, f64::min);
            let mix = -least / (1.0 - least);
            (xyz[1].ln() as f32, rgb.map(|v| (v + mix * (1.0 - v)) as f32))
        })
        .collect()
});

/// ln of the luminance relative to that at `white` kelvin, and the linear sRGB colour of luminance 1; `None` below 600 K,
/// where nothing can be seen.
pub fn glow(kelvin: f32, white: f32) -> Option<(f32, [f32; 3])> {
    let at = |kelvin: f32| {
        let x = ((kelvin - TABLE.0 as f32) / TABLE.2 as f32).clamp(0.0, (GLOW.len() - 1) as f32);
        let k = (x as usize).min(GLOW.len() - 2);
        let (t, (a, b)) = (x - k as f32, (&GLOW[k], &GLOW[k + 1]));
        (a.0 + t * (b.0 - a.0), [0, 1, 2].map(|c| a.1[c] + t * (b.1[c] - a.1[c])))
    };
    if kelvin.is_nan() || kelvin < TABLE.0 as f32 {
        return None;
    }
    let (l, colour) = at(kelvin);
    Some((l - at(white).0, colour))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Published chromaticities of the Planckian locus (Wyszecki and Stiles 1982, table 1(3.11); CIE illuminant A).
    #[test]
    fn chromaticities_lie_on_the_published_locus() {
        for (kelvin, x, y) in [
            (1000.0, 0.6528, 0.3444),
            (1500.0, 0.5857, 0.3931),
            (2000.0, 0.5267, 0.4133),
            (2855.5, 0.4476, 0.4074),
            (4000.0, 0.3805, 0.3768),
            (6500.0, 0.3135, 0.3237),
            (10_000.0, 0.2807, 0.2884),
        ] {
            let v = tristimulus(kelvin);
            let sum = v[0] + v[1] + v[2];
            let (dx, dy) = (v[0] / sum - x, v[1] / sum - y);
            assert!(dx.abs() < 1e-3 && dy.abs() < 1e-3, "{kelvin} K: {dx:+.5} {dy:+.5}");
        }
        // Luminance of platinum's freezing point, 2042 K: the old candle was defined as 60 cd/cm².
        let candle = 683.0 * tristimulus(2042.0)[1] / 1e4;
        assert!((candle / 60.0 - 1.0).abs() < 0.02, "{candle}");
        // White on screens is 6504 K of daylight, a little green of the locus.
        let white = xyz_to_linear_srgb([0.950_47, 1.0, 1.088_83]);
        assert!(white.iter().all(|v| (v - 1.0).abs() < 1e-3));
    }

    #[test]
    fn glowing_gets_brighter_and_whiter() {
        assert_eq!(glow(500.0, 1500.0), None);
        assert!(glow(1500.0, 1500.0).is_some_and(|(l, _)| l == 0.0));
        let mut last = (f32::NEG_INFINITY, 0.0);
        for k in 6..50 {
            let Some((l, c)) = glow(100.0 * k as f32, 1500.0) else { panic!("visible") };
            let luminance = 0.2126 * c[0] + 0.7152 * c[1] + 0.0722 * c[2];
            assert!(l > last.0 && c[1] / c[0] >= last.1 && (luminance - 1.0).abs() < 2e-3, "{k} {l} {c:?} {luminance}");
            assert!(c.iter().all(|v| *v >= -1e-6));
            last = (l, c[1] / c[0]);
        }
    }
}
