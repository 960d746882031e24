//! Drucker–Prager yield of dry sand with volume correction (simulation.md §5.2; Klár et al. 2016, Tampubolon et al. 2017).
//!
//! Sand carries no tension: where it is pulled apart the elastic strain vanishes and the opened volume is remembered (`gain`), to be
//! closed again before pressure builds up. Under pressure the deviator is limited to `α_f` times it.

use fearless_simd::{Select, Simd, SimdBase, SimdFloat, SimdMask};
use megas_math::simd::Lanes;
use megas_math::simd::elementary::exp_m1;

use super::hencky::Yielded;
use super::{Mask, Parameters, Response};

/// The rule in the lanes `sand`: `norm` and `trace` are those of the trial strain, `gain` is updated.
#[inline(always)]
pub(crate) fn flow<S: Simd>(
    s: S,
    norm: Lanes<S>,
    trace: Lanes<S>,
    law: &Parameters<S>,
    sand: Mask<S>,
    yielded: &mut Yielded<S>,
    gain: &mut Lanes<S>,
) {
    let c = |v| Lanes::<S>::splat(s, v);
    let (zero, one) = (c(0.0), c(1.0));
    let corrected = trace + *gain;
    let open = corrected.simd_ge(zero);
    // y = |e| + (3λ + 2μ)/(2μ) tr α_f, and 3λ + 2μ = 3K.
    let over = (law.bulk * 1.5 / law.shear * law.constant).mul_add(corrected, norm);
    let slides = over.simd_gt(zero);
    let pressed = slides.select(one - over / norm.max(c(1e-30)), one);
    yielded.ratio = sand.select(open.select(zero, pressed), yielded.ratio);
    yielded.dilation = sand.select(open.select(-trace, *gain), yielded.dilation);
    *gain = sand.select(open.select(corrected, zero), *gain);
}

/// Applies the change of the trace to the gradient: `F ← exp(dilation/3) F`.
#[inline(always)]
pub(crate) fn dilate<S: Simd>(s: S, yielded: &Yielded<S>, out: &mut Response<S>) {
    if !(yielded.dilation.simd_gt(Lanes::<S>::splat(s, 0.0)) | yielded.dilation.simd_lt(Lanes::<S>::splat(s, 0.0))).any_true() {
        return;
    }
    let g = exp_m1(s, yielded.dilation * (1.0 / 3.0));
    for r in 0..3 {
        for k in 0..3 {
            let h = out.elastic[r][k];
            out.elastic[r][k] = if r == k { g.mul_add(h + 1.0, h) } else { g.mul_add(h, h) };
        }
    }
    out.volume *= exp_m1(s, yielded.dilation) + 1.0;
}
