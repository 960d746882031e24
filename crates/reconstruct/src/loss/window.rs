//! The window of the structural similarity: 11 × 11 taps of a Gaussian with σ = 1.5 px, zero outside the image
//! (splatting.md §4.6). It is separable, and works on interleaved rows: the neighbour `k` pixels to the right is three
//! floats further per pixel, the neighbour below is the same place in the next row.

use fearless_simd::{Simd, SimdBase, SimdFloat};
use megas_math::simd::Lanes;

/// Taps along one axis.
pub(super) const TAPS: usize = 11;

/// Taps on either side of the middle.
pub(super) const RADIUS: usize = TAPS / 2;

/// Zeros before and (at least) after the values of a padded row: the reach of the window in floats.
const MARGIN: usize = 3 * RADIUS;

/// Widest vector, in floats.
const WIDEST: usize = 16;

/// Rows per unit of parallel work.
pub(super) const BAND: usize = 8;

/// The weights along one axis; they sum to one.
pub(super) fn taps() -> [f64; TAPS] {
    let weight = |k: usize| {
        let d = (k as f64 - RADIUS as f64) / 1.5;
        (-0.5 * d * d).exp()
    };
    let sum: f64 = (0..TAPS).map(weight).sum();
    std::array::from_fn(|k| weight(k) / sum)
}

/// One interleaved row between zeros wide enough for the window and for whole vectors.
#[derive(Clone, Debug, Default)]
pub(super) struct Padded(Vec<f32>);

impl Padded {
    /// Room for `n` floats.
    pub fn resize(&mut self, n: usize) {
        let length = n.next_multiple_of(WIDEST) + 2 * MARGIN;
        if self.0.len() != length {
            self.0.clear();
            self.0.resize(length, 0.0);
        }
    }

    /// Stores a vector at float `at` of the row. Lanes beyond the end of the row must be zero.
    #[inline(always)]
    pub fn put<S: Simd>(&mut self, v: Lanes<S>, at: usize) {
        v.store_slice(&mut self.0[MARGIN + at..][..Lanes::<S>::LEN]);
    }

    /// The window along the row, at float `at`.
    #[inline(always)]
    pub fn across<S: Simd>(&self, s: S, weights: &[Lanes<S>; TAPS], at: usize) -> Lanes<S> {
        // One slice for all taps, so that one test of bounds serves them all.
        let row = &self.0[at..][..2 * MARGIN + Lanes::<S>::LEN];
        let tap = |k: usize| Lanes::<S>::from_slice(s, &row[3 * k..][..Lanes::<S>::LEN]);
        let mut sum = weights[0] * tap(0);
        for k in 1..TAPS {
            sum = weights[k].mul_add(tap(k), sum);
        }
        sum
    }
}

/// The weights in every lane.
#[inline(always)]
pub(super) fn splat<S: Simd>(s: S, weights: &[f32; TAPS]) -> [Lanes<S>; TAPS] {
    let mut lanes = [Lanes::<S>::splat(s, 0.0); TAPS];
    for k in 0..TAPS {
        lanes[k] = Lanes::<S>::splat(s, weights[k]);
    }
    lanes
}

/// The rows that the window reaches from row `y` of an image of `height` rows, and their weights. A row outside the image
/// is replaced by the nearest inside, with weight zero.
pub(super) fn reach(y: usize, height: usize, weights: &[f32; TAPS]) -> ([usize; TAPS], [f32; TAPS]) {
    let inside = |k: usize| (y + k).checked_sub(RADIUS).filter(|&row| row < height);
    (
        std::array::from_fn(|k| inside(k).unwrap_or(if y + k < RADIUS { 0 } else { height - 1 })),
        std::array::from_fn(|k| if inside(k).is_some() { weights[k] } else { 0.0 }),
    )
}

/// Vector at float `at` of a row without padding; only the last one of a row may be incomplete (`WHOLE` false) and is
/// filled up with zeros.
#[inline(always)]
pub(super) fn load<S: Simd, const WHOLE: bool>(s: S, row: &[f32], at: usize) -> Lanes<S> {
    if WHOLE {
        Lanes::<S>::from_slice(s, &row[at..][..Lanes::<S>::LEN])
    } else {
        let mut v = Lanes::<S>::splat(s, 0.0);
        let rest = &row[at..];
        v.as_mut_slice()[..rest.len()].copy_from_slice(rest);
        v
    }
}

/// Stores what [`load`] loads.
#[inline(always)]
pub(super) fn store<S: Simd, const WHOLE: bool>(v: Lanes<S>, row: &mut [f32], at: usize) {
    if WHOLE {
        v.store_slice(&mut row[at..][..Lanes::<S>::LEN]);
    } else {
        let rest = &mut row[at..];
        let n = rest.len();
        rest.copy_from_slice(&v.as_slice()[..n]);
    }
}
