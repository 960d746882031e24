//! Real spherical harmonics up to degree 3 in the basis that splat files use (splatting.md §1.2).

use std::sync::OnceLock;

use crate::{Mat3, Real, Vec3, mat3};

/// The constant harmonic.
pub const Y0: f64 = 0.282_094_791_773_878_14;

/// Number of coefficients per colour channel at `degree` (0–3).
pub const fn coefficients(degree: u8) -> usize {
    (degree as usize + 1) * (degree as usize + 1)
}

/// The sixteen basis functions at the unit direction `d` (from camera to Gaussian, world axes).
#[inline(always)]
pub fn basis<T: Real>(d: Vec3<T>) -> [T; 16] {
    let [x, y, z] = d;
    let c = T::of;
    let (xx, yy, zz) = (x * x, y * y, z * z);
    let (a, b) = (c(0.488_602_511_902_919_9), c(1.092_548_430_592_079_2));
    let (e, g) = (c(0.590_043_589_926_643_5), c(0.457_045_799_464_465_8));
    let two = c(2.0);
    let three = c(3.0);
    let four = c(4.0);
    [
        c(Y0),
        -a * y,
        a * z,
        -a * x,
        b * x * y,
        -b * y * z,
        c(0.315_391_565_252_520_05) * (two * zz - xx - yy),
        -b * x * z,
        c(0.546_274_215_296_039_6) * (xx - yy),
        -e * y * (three * xx - yy),
        c(2.890_611_442_640_554) * x * y * z,
        -g * y * (four * zz - xx - yy),
        c(0.373_176_332_590_115_4) * z * (two * zz - three * xx - three * yy),
        -g * x * (four * zz - xx - yy),
        c(1.445_305_721_320_277) * z * (xx - yy),
        -e * x * (xx - three * yy),
    ]
}

/// Gradients of the basis functions with respect to `d`, each as the polynomial it is written as (splatting.md §4.4): `d` is
/// not normalised on the way.
#[inline(always)]
pub fn basis_gradient<T: Real>(d: Vec3<T>) -> [Vec3<T>; 16] {
    let [x, y, z] = d;
    let c = T::of;
    let o = T::zero();
    let (xx, yy, zz) = (x * x, y * y, z * z);
    let (a, b) = (c(0.488_602_511_902_919_9), c(1.092_548_430_592_079_2));
    let (e, g) = (c(0.590_043_589_926_643_5), c(0.457_045_799_464_465_8));
    let (h, i, j) = (c(2.890_611_442_640_554), c(0.373_176_332_590_115_4), c(1.445_305_721_320_277));
    let (p, q) = (c(0.315_391_565_252_520_05), c(0.546_274_215_296_039_6));
    let (two, three, four, six, eight) = (c(2.0), c(3.0), c(4.0), c(6.0), c(8.0));
    [
        [o, o, o],
        [o, -a, o],
        [o, o, a],
        [-a, o, o],
        [b * y, b * x, o],
        [o, -b * z, -b * y],
        [-two * p * x, -two * p * y, four * p * z],
        [-b * z, o, -b * x],
        [two * q * x, -two * q * y, o],
        [-six * e * x * y, -three * e * (xx - yy), o],
        [h * y * z, h * x * z, h * x * y],
        [two * g * x * y, -g * (four * zz - xx - three * yy), -eight * g * y * z],
        [-six * i * x * z, -six * i * y * z, i * (six * zz - three * xx - three * yy)],
        [-g * (four * zz - three * xx - yy), two * g * x * y, -eight * g * x * z],
        [two * j * x * z, -two * j * y * z, j * (xx - yy)],
        [-three * e * (xx - yy), six * e * x * y, o],
    ]
}

/// Colour seen along `d`: `max(0, ½ + Σ Y_k c_k)` per channel, with `coefficients[k * 3 + channel]`.
pub fn colour<T: Real>(degree: u8, coefficients_rgb: &[T], d: Vec3<T>) -> [T; 3] {
    let y = basis(d);
    let mut rgb = [T::of(0.5); 3];
    for k in 0..coefficients(degree) {
        for ch in 0..3 {
            rgb[ch] += y[k] * coefficients_rgb[k * 3 + ch];
        }
    }
    rgb.map(|v| v.max(T::zero()))
}

/// Share of each band, up to degree 3, in the mean over the directions that see a surface, weighted by their cosine (Ramamoorthi and
/// Hanrahan 2001).
const SEEN: [f32; 4] = [1.0, 2.0 / 3.0, 0.25, 0.0];

/// DC coefficients of the mean colour, weighted by the cosine, over the directions that see a surface with this outward normal. The
/// coefficient of the constant harmonic alone is the mean over all directions, of which half are behind the surface and hold anything.
pub fn seen_dc(coefficients_rgb: &[f32], normal: Vec3<f32>) -> [f32; 3] {
    // Directions lead from the camera to the surface.
    let y = basis(normal.map(|v| -v));
    let mut dc = [0.0; 3];
    for (k, c) in coefficients_rgb.chunks_exact(3).enumerate() {
        let weight = SEEN[k.isqrt()] * y[k] / y[0];
        (0..3).for_each(|channel| dc[channel] += weight * c[channel]);
    }
    dc
}

/// DC coefficient of a base colour in [0, 1].
pub fn dc_from_rgb(rgb: f32) -> f32 {
    (rgb - 0.5) / Y0 as f32
}

/// Base colour of a DC coefficient.
pub fn rgb_from_dc(dc: f32) -> f32 {
    0.5 + dc * Y0 as f32
}

const FIT: usize = 32;

/// Fixed fitting directions and, per degree 1..=3, the pseudo-inverse of the basis on them.
fn fit() -> &'static (Vec<Vec3<f64>>, [Vec<f64>; 3]) {
    static CELL: OnceLock<(Vec<Vec3<f64>>, [Vec<f64>; 3])> = OnceLock::new();
    CELL.get_or_init(|| {
        let golden = std::f64::consts::PI * (1.0 + 5f64.sqrt());
        let dirs: Vec<Vec3<f64>> = (0..FIT)
            .map(|k| {
                let z = 1.0 - (2.0 * k as f64 + 1.0) / FIT as f64;
                let (s, c) = (golden * k as f64).sin_cos();
                let r = (1.0 - z * z).sqrt();
                [r * c, r * s, z]
            })
            .collect();
        let inverse = [1usize, 2, 3].map(|l| pseudo_inverse(&dirs, l));
        (dirs, inverse)
    })
}

/// `(BᵀB)⁻¹Bᵀ` for the band `l` (n = 2l+1 columns), row-major n × FIT, by Gauss–Jordan on the small normal matrix.
fn pseudo_inverse(dirs: &[Vec3<f64>], l: usize) -> Vec<f64> {
    let n = 2 * l + 1;
    let rows: Vec<Vec<f64>> = dirs.iter().map(|&d| basis(d)[l * l..l * l + n].to_vec()).collect();
    let width = n + dirs.len();
    let mut m = vec![0.0; n * width];
    for i in 0..n {
        for j in 0..n {
            m[i * width + j] = rows.iter().map(|r| r[i] * r[j]).sum();
        }
        for (k, r) in rows.iter().enumerate() {
            m[i * width + n + k] = r[i];
        }
    }
    for i in 0..n {
        let p = m[i * width + i];
        for j in 0..width {
            m[i * width + j] /= p;
        }
        for r in 0..n {
            if r != i {
                let f = m[r * width + i];
                for j in 0..width {
                    m[r * width + j] -= f * m[i * width + j];
                }
            }
        }
    }
    (0..n).flat_map(|i| m[i * width + n..(i + 1) * width].to_vec()).collect()
}

/// Re-expresses coefficients after the Gaussian has been turned by the rotation `r`:
/// `Σ Y(d) c' = Σ Y(rᵀ d) c` for every direction (splatting.md §1.2). Works in place on `[coefficient][channel]`.
pub fn rotate(degree: u8, coefficients_rgb: &mut [f32], r: Mat3<f64>) {
    let (dirs, inverse) = fit();
    let turned: Vec<[f64; 16]> = dirs.iter().map(|&d| basis(mat3::tmul_vec(r, d))).collect();
    for l in 1..=usize::from(degree) {
        let n = 2 * l + 1;
        let first = l * l;
        for ch in 0..3 {
            let mut out = [0.0f64; 7];
            for (k, y) in turned.iter().enumerate() {
                let value: f64 = (0..n).map(|j| y[first + j] * f64::from(coefficients_rgb[(first + j) * 3 + ch])).sum();
                for i in 0..n {
                    out[i] += inverse[l - 1][i * FIT + k] * value;
                }
            }
            for i in 0..n {
                coefficients_rgb[(first + i) * 3 + ch] = out[i] as f32;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn basis_gradients_match_finite_differences() {
        let d = [0.37, -0.58, 0.81];
        let g = basis_gradient::<f64>(d);
        for a in 0..3 {
            let step = |h: f64| {
                let mut d = d;
                d[a] += h;
                basis(d)
            };
            let (hi, lo) = (step(1e-5), step(-1e-5));
            for k in 0..16 {
                assert!(((hi[k] - lo[k]) / 2e-5 - g[k][a]).abs() < 1e-9, "{k} {a}");
            }
        }
    }
    use crate::{quat, rng::Rng};

    #[test]
    fn rotated_coefficients_reproduce_the_turned_function() {
        let mut rng = Rng::new(5);
        for _ in 0..20 {
            let r = quat::to_mat3::<f64>(std::array::from_fn(|_| rng.range(-1.0, 1.0)));
            let c: Vec<f32> = (0..48).map(|_| rng.range(-1.0, 1.0) as f32).collect();
            let mut t = c.clone();
            rotate(3, &mut t, r);
            for _ in 0..10 {
                let d = rng.direction();
                let (a, b) = (basis(d), basis(mat3::tmul_vec(r, d)));
                for ch in 0..3 {
                    let lhs: f64 = (0..16).map(|k| a[k] * f64::from(t[k * 3 + ch])).sum();
                    let rhs: f64 = (0..16).map(|k| b[k] * f64::from(c[k * 3 + ch])).sum();
                    assert!((lhs - rhs).abs() < 2e-6);
                }
            }
        }
    }
}
