//! Structural similarity (Wang et al. 2004) with an 11 × 11 Gaussian window, σ = 1.5 px, zero beyond the border: the same
//! definition as the training loss (splatting.md §4.6).

use megas_model::Image;

use super::filter::{Border, gaussian, separable};
use super::{check, clamped, mean};

/// Mean structural similarity over pixels and channels; 1 for equal images, NaN for an empty mask.
pub fn ssim(rendered: &Image, truth: &Image, mask: Option<&[bool]>) -> f64 {
    check(rendered, truth);
    let width = rendered.width as usize;
    let window = gaussian(1.5, 5);
    let mut map = vec![0.0; rendered.data.len() / 3];
    for c in 0..3 {
        let plane = |image: &Image| image.data.chunks_exact(3).map(|p| clamped(p[c])).collect::<Vec<f64>>();
        let (x, y) = (plane(rendered), plane(truth));
        let smooth = |plane: &[f64]| separable(plane, width, &window, &window, Border::Zero);
        let product = |a: &[f64], b: &[f64]| smooth(&a.iter().zip(b).map(|(a, b)| a * b).collect::<Vec<_>>());
        let (mx, my) = (smooth(&x), smooth(&y));
        let (xx, yy, xy) = (product(&x, &x), product(&y, &y), product(&x, &y));
        for (i, out) in map.iter_mut().enumerate() {
            let luminance = (2.0 * mx[i] * my[i] + 1e-4) / (mx[i] * mx[i] + my[i] * my[i] + 1e-4);
            let variances = xx[i] - mx[i] * mx[i] + yy[i] - my[i] * my[i];
            let structure = (2.0 * (xy[i] - mx[i] * my[i]) + 9e-4) / (variances + 9e-4);
            *out += luminance * structure / 3.0;
        }
    }
    mean(&map, mask)
}

#[cfg(test)]
mod tests {
    use super::super::tests::{constant, noisy, pattern};
    use super::*;

    /// The defining sum at one pixel.
    fn direct(a: &Image, b: &Image, px: i32, py: i32) -> f64 {
        let mut total = 0.0;
        for c in 0..3 {
            let (mut m, mut norm) = ([0.0; 5], 0.0);
            for dy in -5..=5 {
                for dx in -5..=5 {
                    let w = (-f64::from(dx * dx + dy * dy) / 4.5).exp();
                    norm += w;
                    let (x, y) = (px + dx, py + dy);
                    if x >= 0 && y >= 0 && x < a.width as i32 && y < a.height as i32 {
                        let (u, v) = (f64::from(a.pixel(x as u32, y as u32)[c]), f64::from(b.pixel(x as u32, y as u32)[c]));
                        for (m, v) in m.iter_mut().zip([u, v, u * u, v * v, u * v]) {
                            *m += w * v;
                        }
                    }
                }
            }
            let [u, v, uu, vv, uv] = m.map(|m| m / norm);
            let top = (2.0 * u * v + 1e-4) * (2.0 * (uv - u * v) + 9e-4);
            total += top / ((u * u + v * v + 1e-4) * (uu - u * u + vv - v * v + 9e-4)) / 3.0;
        }
        total
    }

    #[test]
    fn it_is_the_defining_sum() {
        let (a, b) = (pattern(0), pattern(3));
        for (x, y) in [(0, 0), (30, 20), (63, 47), (2, 40)] {
            let mask: Vec<bool> = (0..64 * 48).map(|i| i == y * 64 + x).collect();
            let (got, exact) = (ssim(&a, &b, Some(&mask)), direct(&a, &b, x, y));
            assert!((got - exact).abs() < 1e-9, "{x} {y}: {got} {exact}");
        }
        let mean = (0..48).flat_map(|y| (0..64).map(move |x| (x, y))).map(|(x, y)| direct(&a, &b, x, y)).sum::<f64>() / 3072.0;
        assert!((ssim(&a, &b, None) - mean).abs() < 1e-9);
    }

    #[test]
    fn equal_images_symmetry_and_constants() {
        let (a, b) = (pattern(0), noisy(&pattern(0), 0.2));
        assert!((ssim(&a, &a, None) - 1.0).abs() < 1e-12);
        assert!((ssim(&a, &b, None) - ssim(&b, &a, None)).abs() < 1e-12);
        // Far from the border two constants have no structure to compare: only the luminance factor is left.
        let centre: Vec<bool> = (0..64 * 48).map(|i| i == 24 * 64 + 32).collect();
        let s = ssim(&constant([0.2; 3]), &constant([0.6; 3]), Some(&centre));
        assert!((s - (0.24 + 1e-4) / (0.4 + 1e-4)).abs() < 1e-6, "{s}");
    }
}
