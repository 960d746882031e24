//! What the laws need to know of a deformation gradient: `b − I` of the left Cauchy–Green tensor `b = F Fᵀ`, and functions of it.
//!
//! `b − I` and not `b`, so that small strains keep their digits. Small strains use power series; lanes with large ones take
//! the eigen-decomposition instead.

use fearless_simd::{Select, Simd, SimdBase, SimdFloat, SimdMask};
use megas_math::simd::elementary::ln_1p;
use megas_math::simd::symmetric::{SERIES_P, Traceless, eigen};
use megas_math::simd::{Lanes, Mat3s, Sym3, each3, each6};

use super::Mask;

/// Smallest and largest stretch that is not repaired (simulation.md §7.6).
pub(crate) const STRETCH: (f32, f32) = (0.05, 20.0);
/// Smallest volume ratio that is not repaired.
pub(crate) const MIN_J: f32 = 0.02;

/// `b − I = H + Hᵀ + H Hᵀ` of `H = F − I`.
#[inline(always)]
pub(crate) fn left_strain<S: Simd>(h: &Mat3s<S>) -> Sym3<S> {
    let e = |r: usize, c: usize| h[r][2].mul_add(h[c][2], h[r][1].mul_add(h[c][1], h[r][0].mul_add(h[c][0], h[r][c] + h[c][r])));
    [e(0, 0), e(1, 1), e(2, 2), e(0, 1), e(0, 2), e(1, 2)]
}

/// `det(I + H) − 1` without cancellation.
#[inline(always)]
pub(crate) fn volume_change<S: Simd>(h: &Mat3s<S>) -> Lanes<S> {
    let minor = |r: usize, c: usize, r2: usize, c2: usize| h[r][c] * h[r2][c2] - h[r][c2] * h[r2][c];
    let m0 = minor(1, 1, 2, 2);
    let second = m0 + minor(0, 0, 2, 2) + minor(0, 0, 1, 1);
    let third = h[0][0].mul_add(m0, h[0][2] * minor(1, 0, 2, 1) - h[0][1] * minor(1, 0, 2, 2));
    h[0][0] + h[1][1] + h[2][2] + second + third
}

/// Principal values, for lanes with large strains.
pub(crate) struct Principal<S: Simd> {
    /// Principal directions (columns).
    pub u: Mat3s<S>,
    /// Deviatoric Hencky strains.
    pub e: [Lanes<S>; 3],
    /// Trace of the Hencky strain.
    pub trace: Lanes<S>,
    /// `σ_a² − σ_a`, with the sign of det F on the smallest stretch.
    pub corotated: [Lanes<S>; 3],
    degenerate: Mask<S>,
}

#[inline(always)]
fn principal<S: Simd>(s: S, strain: Sym3<S>, volume: Lanes<S>, survives_inversion: Mask<S>) -> Principal<S> {
    let c = |v| Lanes::<S>::splat(s, v);
    let (w, u) = eigen(s, strain);
    let least = w[0].min(w[1]).min(w[2]);
    let most = w[0].max(w[1]).max(w[2]);
    let (low, high) = (STRETCH.0 * STRETCH.0 - 1.0, STRETCH.1 * STRETCH.1 - 1.0);
    let bounded = most.simd_le(c(high)) & volume.abs().simd_le(c(STRETCH.1.powi(3)));
    let regular = bounded & (survives_inversion | (least.simd_ge(c(low)) & volume.simd_ge(c(MIN_J))));
    let log = each3(|a| ln_1p(s, w[a].max(c(low)).min(c(high))) * 0.5);
    let trace = log[0] + log[1] + log[2];
    let inverted = volume.simd_lt(c(0.0));
    let corotated = each3(|a| {
        let v = w[a];
        let root = (v + 1.0).max(c(0.0)).sqrt();
        // σ² − σ, and σ² + σ for the one stretch that carries the reflection.
        let flip = inverted & v.simd_eq(least);
        let square = (v + 1.0).max(c(0.0));
        flip.select(square + root, root * (v / (root + 1.0)))
    });
    Principal { u, e: each3(|a| log[a] - trace * (1.0 / 3.0)), trace, corotated, degenerate: !regular }
}

/// `b − I` split into mean and traceless part, ready for functions of its eigenvalues.
pub(crate) struct Spectral<S: Simd> {
    /// Mean of the diagonal of `b − I`.
    pub mean: Lanes<S>,
    /// Mean of the diagonal of `b`.
    pub scale: Lanes<S>,
    /// `(b − scale I)/scale`.
    pub x: Traceless<S>,
    /// Lanes for which the series in `x` are exact to rounding.
    pub small: Mask<S>,
    /// Principal values where some lane needs them.
    pub large: Option<Principal<S>>,
    /// Lanes whose gradient is degenerate and must be replaced.
    pub degenerate: Mask<S>,
}

impl<S: Simd> Spectral<S> {
    /// The decomposition in the lanes `wanted`; elsewhere nothing holds. Lanes in `survives_inversion` are never degenerate for
    /// being flat or inside out.
    #[inline(always)]
    pub fn new(s: S, strain: &Sym3<S>, volume: Lanes<S>, wanted: Mask<S>, survives_inversion: Mask<S>) -> Self {
        let c = |v| Lanes::<S>::splat(s, v);
        let strain = *strain;
        let mean = (strain[0] + strain[1] + strain[2]) * (1.0 / 3.0);
        let scale = mean + 1.0;
        let inverse = c(1.0) / scale;
        let mut x = strain;
        for k in 0..3 {
            x[k] -= mean;
        }
        let x = Traceless::<S>::new(each6(|k| x[k] * inverse));
        let small = (x.p.simd_le(c(SERIES_P)) & scale.simd_ge(c(0.3)) & scale.simd_le(c(4.0)) & volume.simd_gt(c(0.1))) | !wanted;
        let large = if small.all_true() {
            None
        } else {
            Some(s.vectorize(
                #[inline(always)]
                || principal(s, strain, volume, survives_inversion),
            ))
        };
        let degenerate = large.as_ref().map_or(Mask::<S>::splat(s, false), |p| p.degenerate & !small);
        Self { mean, scale, x, small, large, degenerate }
    }
}
