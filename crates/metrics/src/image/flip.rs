//! The difference that a person perceives when two images alternate: LDR-FLIP (Andersson et al. 2020, "FLIP: A Difference
//! Evaluator for Alternating Images"), written from the formulas of the paper with the published correction of the
//! normalisation of luminance (116 instead of 100).
//!
//! Colour: both images are filtered with the contrast sensitivity of the eye in an opponent space, mapped to a perceptually
//! uniform one, and their distance compressed to [0, 1]. Features: edges and points that exist in only one of them raise
//! the difference.

use megas_math::{Mat3, Vec3, mat3};
use megas_model::Image;
use rayon::prelude::*;

use super::filter::{Border, gaussian, offsets, separable};
use super::{check, clamped, mean};

/// Pixels per degree of visual angle of a 3840 px wide, 0.7 m wide display seen from 0.7 m.
pub const PIXELS_PER_DEGREE: f64 = 67.0;

/// Contrast sensitivity of the opponent channels: sums of `a √(π/b) exp(−π² x²/b)`, `x` in degrees, as `(a, b)`.
const SENSITIVITY: [&[(f64, f64)]; 3] = [&[(1.0, 0.0047)], &[(1.0, 0.0053)], &[(34.1, 0.04), (13.5, 0.025)]];
/// The widest `b`, which sets the size of all filters.
const WIDEST: f64 = 0.04;
/// Compression of the colour distance.
const COLOUR_EXPONENT: f64 = 0.7;
/// Fraction of the largest colour distance below which distances are stretched, and the value it is stretched to.
const KNEE: (f64, f64) = (0.4, 0.95);
/// Width of the feature detectors \[degrees\].
const FEATURE_WIDTH: f64 = 0.082;

/// Mean of [`flip_map`] over the mask or all pixels: 0 for equal images, at most 1; NaN for an empty mask.
pub fn flip(reference: &Image, test: &Image, pixels_per_degree: f64, mask: Option<&[bool]>) -> f64 {
    mean(&flip_map(reference, test, pixels_per_degree), mask)
}

/// Perceived difference of every pixel, in [0, 1]. It is symmetric in the two images.
pub fn flip_map(reference: &Image, test: &Image, pixels_per_degree: f64) -> Vec<f64> {
    check(reference, test);
    let space = Space::new();
    let [a, b] = [reference, test].map(|image| Seen::new(&space, image, pixels_per_degree));
    let largest = space.distance(space.hunt([0.0, 1.0, 0.0]), space.hunt([0.0, 0.0, 1.0])).powf(COLOUR_EXPONENT);
    let (knee, value) = (KNEE.0 * largest, KNEE.1);
    (0..a.colour.len())
        .into_par_iter()
        .map(|i| {
            let d = space.distance(a.colour[i], b.colour[i]).powf(COLOUR_EXPONENT);
            let colour = if d < knee { d * value / knee } else { value + (d - knee) / (largest - knee) * (1.0 - value) };
            let feature = (a.edge[i] - b.edge[i]).abs().max((a.point[i] - b.point[i]).abs());
            colour.powf(1.0 - (feature * std::f64::consts::FRAC_1_SQRT_2).sqrt())
        })
        .collect()
}

/// What the eye makes of one image.
struct Seen {
    /// Filtered colour, L*a*b* with the Hunt effect.
    colour: Vec<Vec3<f64>>,
    /// Strength of edges.
    edge: Vec<f64>,
    /// Strength of points and lines.
    point: Vec<f64>,
}

impl Seen {
    fn new(space: &Space, image: &Image, ppd: f64) -> Self {
        let width = image.width as usize;
        let opponent: Vec<Vec3<f64>> = image
            .data
            .par_chunks_exact(3)
            .map(|p| space.opponent(mat3::mul_vec(space.to_xyz, [p[0], p[1], p[2]].map(|v| linear(clamped(v))))))
            .collect();
        let plane = |c: usize| opponent.iter().map(|v| v[c]).collect::<Vec<f64>>();
        let filtered = [0, 1, 2].map(|c| contrast(&plane(c), width, SENSITIVITY[c], ppd));
        let colour = (0..opponent.len()).into_par_iter().map(|i| {
            let xyz = space.xyz([filtered[0][i], filtered[1][i], filtered[2][i]]);
            space.hunt(mat3::mul_vec(space.to_rgb, xyz).map(|v| v.clamp(0.0, 1.0)))
        });
        let luminance: Vec<f64> = opponent.iter().map(|v| (v[0] + 16.0) / 116.0).collect();
        let [edge, point] = features(&luminance, width, ppd);
        Self { colour: colour.collect(), edge, point }
    }
}

/// One opponent channel as the eye resolves it.
fn contrast(plane: &[f64], width: usize, sensitivity: &[(f64, f64)], ppd: f64) -> Vec<f64> {
    let pi2 = std::f64::consts::PI.powi(2);
    let radius = (3.0 * (WIDEST / (2.0 * pi2)).sqrt() * ppd).ceil() as usize;
    // Each Gaussian is separable; the weights are those of the two-dimensional sum, which is scaled to one as a whole.
    let parts = sensitivity.iter().map(|&(a, b)| {
        let profile: Vec<f64> = offsets(radius).map(|x| (-pi2 * (x / ppd).powi(2) / b).exp()).collect();
        let sum: f64 = profile.iter().sum();
        (a * (std::f64::consts::PI / b).sqrt() * sum * sum, profile.iter().map(|v| v / sum).collect::<Vec<f64>>())
    });
    let parts: Vec<(f64, Vec<f64>)> = parts.collect();
    let total: f64 = parts.iter().map(|p| p.0).sum();
    let mut result = vec![0.0; plane.len()];
    for (weight, profile) in &parts {
        let part = separable(plane, width, profile, profile, Border::Replicate);
        result.iter_mut().zip(part).for_each(|(r, v)| *r += weight / total * v);
    }
    result
}

/// Magnitudes of the first and second derivative of luminance.
fn features(luminance: &[f64], width: usize, ppd: f64) -> [Vec<f64>; 2] {
    let sigma = 0.5 * FEATURE_WIDTH * ppd;
    let radius = (3.0 * sigma).ceil() as usize;
    let smooth = gaussian(sigma, radius);
    let edge: Vec<f64> = offsets(radius).zip(&smooth).map(|(x, g)| -x * g).collect();
    let point: Vec<f64> = offsets(radius).zip(&smooth).map(|(x, g)| (x * x / (sigma * sigma) - 1.0) * g).collect();
    [edge, point].map(|detector| {
        let detector = balanced(&detector);
        let x = separable(luminance, width, &detector, &smooth, Border::Replicate);
        let y = separable(luminance, width, &smooth, &detector, Border::Replicate);
        x.iter().zip(&y).map(|(x, y)| x.hypot(*y)).collect()
    })
}

/// Scales the positive taps to sum to 1 and the negative ones to −1.
fn balanced(taps: &[f64]) -> Vec<f64> {
    let positive: f64 = taps.iter().filter(|t| **t > 0.0).sum();
    let negative: f64 = taps.iter().filter(|t| **t < 0.0).sum();
    taps.iter().map(|t| if *t > 0.0 { t / positive } else { t / -negative }).collect()
}

/// Display value to linear light (IEC 61966-2-1).
fn linear(v: f64) -> f64 {
    if v <= 0.04045 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) }
}

/// Conversions between colour spaces.
struct Space {
    /// Linear RGB → XYZ.
    to_xyz: Mat3<f64>,
    to_rgb: Mat3<f64>,
    /// XYZ of RGB white.
    white: Vec3<f64>,
}

impl Space {
    /// The space of the sRGB primaries and D65, from their chromaticities.
    fn new() -> Self {
        let column = |[x, y]: [f64; 2]| [x / y, 1.0, (1.0 - x - y) / y];
        let primaries = mat3::from_columns(column([0.64, 0.33]), column([0.30, 0.60]), column([0.15, 0.06]));
        let white = column([0.3127, 0.3290]);
        let inverse = mat3::inverse(primaries).expect("three different primaries");
        let to_xyz = mat3::mul(primaries, mat3::diag(mat3::mul_vec(inverse, white)));
        Self { to_xyz, to_rgb: mat3::inverse(to_xyz).expect("an invertible product"), white }
    }

    /// XYZ → YCxCz, the linearised opponent space.
    fn opponent(&self, xyz: Vec3<f64>) -> Vec3<f64> {
        let [x, y, z] = [0, 1, 2].map(|k| xyz[k] / self.white[k]);
        [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)]
    }

    /// YCxCz → XYZ.
    fn xyz(&self, opponent: Vec3<f64>) -> Vec3<f64> {
        let y = (opponent[0] + 16.0) / 116.0;
        let relative = [y + opponent[1] / 500.0, y, y - opponent[2] / 200.0];
        [0, 1, 2].map(|k| relative[k] * self.white[k])
    }

    /// Linear RGB → L*a*b* with chroma that fades with luminance (the Hunt effect).
    fn hunt(&self, rgb: Vec3<f64>) -> Vec3<f64> {
        let xyz = mat3::mul_vec(self.to_xyz, rgb);
        const DELTA: f64 = 6.0 / 29.0;
        let f = |t: f64| if t > DELTA.powi(3) { t.cbrt() } else { t / (3.0 * DELTA * DELTA) + 4.0 / 29.0 };
        let [x, y, z] = [0, 1, 2].map(|k| f(xyz[k] / self.white[k]));
        let l = 116.0 * y - 16.0;
        [l, 0.01 * l * 500.0 * (x - y), 0.01 * l * 200.0 * (y - z)]
    }

    /// HyAB: city block between lightness and chroma, for large distances.
    fn distance(&self, a: Vec3<f64>, b: Vec3<f64>) -> f64 {
        (a[0] - b[0]).abs() + (a[1] - b[1]).hypot(a[2] - b[2])
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{constant, noisy, pattern};
    use super::*;

    fn distance(a: &Image, b: &Image) -> f64 {
        flip(a, b, PIXELS_PER_DEGREE, None)
    }

    #[test]
    fn it_reproduces_the_authors_implementation() {
        // Means and pixels given by the authors' evaluator (67 pixels per degree) for the same images.
        let (a, b) = (pattern(0), pattern(3));
        let map = flip_map(&a, &b, PIXELS_PER_DEGREE);
        assert!((mean(&map, None) - 0.596_939_5).abs() < 2e-5, "{}", mean(&map, None));
        let at = |map: &[f64], x: usize, y: usize| map[y * 64 + x];
        assert!((at(&map, 10, 10) - 0.974_397_5).abs() < 5e-5 && (at(&map, 35, 24) - 0.368_991_9).abs() < 5e-5);
        let mut c = a.clone();
        for y in 20..28 {
            for x in 30..40 {
                c.pixel_mut(x, y).copy_from_slice(&[0.9, 0.1, 0.2]);
            }
        }
        let map = flip_map(&a, &c, PIXELS_PER_DEGREE);
        assert!((mean(&map, None) - 0.037_770_94).abs() < 5e-6, "{}", mean(&map, None));
        assert!((at(&map, 35, 24) - 0.858_840_1).abs() < 5e-5 && at(&map, 10, 10) == 0.0);
    }

    #[test]
    fn extremes_and_symmetry() {
        let (black, white) = (constant([0.0; 3]), constant([1.0; 3]));
        assert!((distance(&black, &white) - 0.967_392).abs() < 2e-5, "{}", distance(&black, &white));
        // By construction green and blue are as different as can be.
        assert!((distance(&constant([0.0, 1.0, 0.0]), &constant([0.0, 0.0, 1.0])) - 1.0).abs() < 1e-9);
        let (a, b) = (pattern(1), noisy(&pattern(1), 0.3));
        assert_eq!(distance(&a, &a), 0.0);
        assert_eq!(distance(&a, &b), distance(&b, &a));
    }

    #[test]
    fn conversions_invert_and_fine_detail_disappears_from_afar() {
        let space = Space::new();
        let xyz = mat3::mul_vec(space.to_xyz, [0.2, 0.7, 0.4]);
        let back = space.xyz(space.opponent(xyz));
        assert!((0..3).all(|k| (back[k] - xyz[k]).abs() < 1e-14));
        assert!((space.hunt([1.0; 3])[0] - 100.0).abs() < 1e-9 && space.hunt([0.5; 3])[1].abs() < 1e-9);
        let (a, b) = (pattern(0), noisy(&pattern(0), 0.3));
        assert!(flip(&a, &b, 200.0, None) < 0.6 * flip(&a, &b, 40.0, None));
    }
}
