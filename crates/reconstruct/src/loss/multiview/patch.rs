//! How well a patch of the reference photograph correlates with the neighbour's, carried over by the plane of its pixel.
//!
//! With the plane `N·X = m` (both raw, `X` from the reference's centre) the ray `ρ` of a pixel meets it at `X = ρ m/(N·ρ)`;
//! seen from the neighbour, whose centre lies at `−b`, that is the direction `ρ + b (N·ρ)/m`. This is the homography
//! `K_n (R − t Nᵀ/δ) K_r⁻¹` with `δ = −m`. It is linear in the pixel, and everything here is in the neighbour's axes.

use megas_math::{Real, Vec3, mat3, vec3};

use super::{Pinhole, bilinear, bilinear_slope};

/// Half size of a patch \[px\].
const HALF: usize = 3;

/// Pixels of a patch.
const SIDE: usize = 2 * HALF + 1;
const COUNT: usize = SIDE * SIDE;

/// Added to the product of the two sums of squared deviations, so that flat patches correlate with nothing.
const FLAT: f64 = 1e-8;

/// Patches that correlate worse are taken to show something else.
const LIMIT: f64 = 0.9;

/// A patch that was found again.
#[derive(Clone, Copy, Debug)]
pub(super) struct Match<T> {
    /// `1 − NCC²`, in [0, 0.9).
    pub value: T,
    /// Its derivative by the raw normal.
    pub by_normal: Vec3<T>,
    /// Its derivative by the raw plane.
    pub by_plane: T,
}

/// Two photographs and how the one's rays look from the other.
pub(super) struct Warp<'a, T> {
    r: &'a Pinhole<T>,
    n: &'a Pinhole<T>,
    grey: &'a [T],
    neighbour: &'a [T],
    /// The viewing ray of the reference's pixel (0, 0), and its change per column and row.
    ray: Vec3<T>,
    column: Vec3<T>,
    row: Vec3<T>,
    /// The reference's centre.
    baseline: Vec3<T>,
}

impl<'a, T: Real> Warp<'a, T> {
    pub fn new([r, n]: [&'a Pinhole<T>; 2], [grey, neighbour]: [&'a [T]; 2]) -> Self {
        assert!(grey.len() == r.width * r.height && neighbour.len() == n.width * n.height, "one brightness per pixel");
        let turn = |v: Vec3<T>| mat3::mul_vec(n.axes, v);
        let [column, row] = [0, 1].map(|k| turn(vec3::scale(r.axes[k], r.focal[k].recip())));
        let half = T::of(0.5);
        let corner = vec3::add_scaled(turn(r.axes[2]), column, half - r.principal[0]);
        let ray = vec3::add_scaled(corner, row, half - r.principal[1]);
        Self { r, n, grey, neighbour, ray, column, row, baseline: turn(vec3::sub(r.center, n.center)) }
    }

    /// Compares the patch around pixel `[x, y]` of the reference, given the raw plane of that pixel. `None` where the patch
    /// leaves either image or hardly correlates.
    pub fn compare(&self, [x, y]: [usize; 2], normal: Vec3<T>, plane: T) -> Option<Match<T>> {
        let (r, n) = (self.r, self.n);
        if x < HALF || y < HALF || x + HALF >= r.width || y + HALF >= r.height {
            return None;
        }
        let (x, y) = (x - HALF, y - HALF);
        let of = |i: usize| T::of(i as f64);
        let inverse = plane.recip();
        let tilt = vec3::scale(mat3::mul_vec(n.axes, normal), inverse);
        let first = vec3::add_scaled(vec3::add_scaled(self.ray, self.column, of(x)), self.row, of(y));
        let warp = |v: Vec3<T>| vec3::add_scaled(v, self.baseline, vec3::dot(tilt, v));
        let (start, column, row) = (warp(first), warp(self.column), warp(self.row));

        let (mut own, mut found) = ([T::zero(); COUNT], [T::zero(); COUNT]);
        // By each value found: how it changes with the multiple of the baseline.
        let mut slopes = [T::zero(); COUNT];
        for j in 0..SIDE {
            let line = vec3::add_scaled(start, row, of(j));
            let own_row = &self.grey[(y + j) * r.width + x..][..SIDE];
            for i in 0..SIDE {
                let k = j * SIDE + i;
                own[k] = own_row[i];
                let there = vec3::add_scaled(line, column, of(i));
                if there[2] <= T::zero() {
                    return None;
                }
                let near = there[2].recip();
                let (u, v) = (there[0] * near, there[1] * near);
                let (cell, fraction) = n.cell([n.focal[0] * u + n.principal[0], n.focal[1] * v + n.principal[1]])?;
                let (above, below) = (&self.neighbour[cell..][..2], &self.neighbour[cell + n.width..][..2]);
                let values = [above[0], above[1], below[0], below[1]];
                let w = bilinear(fraction);
                found[k] = values[0] * w[0] + values[1] * w[1] + values[2] * w[2] + values[3] * w[3];
                let slope = bilinear_slope(fraction, values);
                let (a, b) = (slope[0] * n.focal[0], slope[1] * n.focal[1]);
                slopes[k] = near * (a * (self.baseline[0] - u * self.baseline[2]) + b * (self.baseline[1] - v * self.baseline[2]));
            }
        }

        let mean = |v: &[T; COUNT]| v.iter().fold(T::zero(), |s, v| s + *v) / T::of(COUNT as f64);
        let (own_mean, found_mean) = (mean(&own), mean(&found));
        let (mut cross, mut own_square, mut found_square) = (T::zero(), T::zero(), T::zero());
        for k in 0..COUNT {
            let (a, b) = (own[k] - own_mean, found[k] - found_mean);
            cross += a * b;
            own_square += a * a;
            found_square += b * b;
        }
        let scale = (own_square * found_square + T::of(FLAT)).recip();
        let value = (T::one() - cross * cross * scale).max(T::zero());
        (value < T::of(LIMIT)).then(|| {
            // Rays are linear in the pixel, so three sums say how the value changes with the tilt.
            let (mut all, mut columns, mut rows) = (T::zero(), T::zero(), T::zero());
            for k in 0..COUNT {
                let (a, b) = (own[k] - own_mean, found[k] - found_mean);
                let g = -T::of(2.0) * cross * scale * (a - cross * scale * own_square * b) * slopes[k];
                all += g;
                columns += g * of(k % SIDE);
                rows += g * of(k / SIDE);
            }
            let by_tilt = vec3::add_scaled(vec3::add_scaled(vec3::scale(first, all), self.column, columns), self.row, rows);
            Match { value, by_normal: vec3::scale(mat3::tmul_vec(n.axes, by_tilt), inverse), by_plane: -vec3::dot(by_tilt, tilt) * inverse }
        })
    }
}
