//! Weakly compressible Newtonian fluid (simulation.md §5.1): `τ = −J p I + 2 μ_v J dev D` with Tait's pressure
//! `p = (K/γ) (J^{−γ} − 1)`. It remembers nothing but J, stored as `J − 1` in the first entry of the gradient.
//!
//! Parameters: `viscosity` is μ_v, `exponent` is γ (−1 is the linear law `p = K (1 − J)`), `constant` the largest J: a fluid that
//! is pulled apart opens instead of pulling.

use fearless_simd::{Select, Simd, SimdBase, SimdFloat, SimdMask};
use megas_math::simd::elementary::{exp_m1, ln_1p};
use megas_math::simd::{Lanes, Mat3s, each9};

use super::{Mask, Parameters, Response};

/// Smallest J: at γ = 7 the pressure is then beyond 600 K, and the gradient counts as degenerate.
pub(crate) const MIN_FLUID_J: f32 = 0.3;

/// `J ← min(J (1 + Δt tr C), J_max)` in the lanes `fluid`; the others keep the trial gradient `h`. `before` is the stored gradient and
/// `increment` is `Δt C`. Also gives the lanes that were squeezed below [`MIN_FLUID_J`] and were held there.
#[inline(always)]
pub(crate) fn advance<S: Simd>(
    s: S,
    h: &Mat3s<S>,
    before: &Mat3s<S>,
    increment: &Mat3s<S>,
    most: Lanes<S>,
    fluid: Mask<S>,
) -> (Mat3s<S>, Mask<S>) {
    let zero = Lanes::<S>::splat(s, 0.0);
    let least = Lanes::<S>::splat(s, MIN_FLUID_J - 1.0);
    let trace = increment[0][0] + increment[1][1] + increment[2][2];
    let change = trace.mul_add(before[0][0] + 1.0, before[0][0]).min(most - 1.0);
    let squeezed = !change.simd_ge(least) & fluid;
    let change = change.max(least);
    let out = each9(
        #[inline(always)]
        |r, c| fluid.select(if r == 0 && c == 0 { change } else { zero }, h[r][c]),
    );
    (out, squeezed)
}

/// Stress of the lanes `fluid`; `rate` is the velocity gradient.
#[inline(always)]
pub(crate) fn respond<S: Simd>(s: S, h: &Mat3s<S>, rate: &Mat3s<S>, law: &Parameters<S>, fluid: Mask<S>, out: &mut Response<S>) {
    let c = |v| Lanes::<S>::splat(s, v);
    // A start may be anything; from the first step on `advance` keeps J in its range.
    let change = fluid.select(h[0][0], c(0.0)).max(c(MIN_FLUID_J - 1.0));
    let j = change + 1.0;
    let linear = law.exponent.simd_eq(c(-1.0)) | !fluid;
    // τ = −J p. Written with exp_m1 and ln_1p, so that nearly uncompressed water keeps its digits.
    let mut pressure = law.bulk * change * j;
    if linear.any_false() {
        let gamma = linear.select(c(1.0), law.exponent);
        let tait = exp_m1(s, -(gamma * ln_1p(s, change))) * (law.bulk / gamma) * -j;
        pressure = linear.select(pressure, tait);
    }
    let twice = law.viscosity * j * 2.0;
    let mean = (rate[0][0] + rate[1][1] + rate[2][2]) * (1.0 / 3.0);
    let d = |r: usize, k: usize| (rate[r][k] + rate[k][r]) * 0.5;
    let viscous = [d(0, 0) - mean, d(1, 1) - mean, d(2, 2) - mean, d(0, 1), d(0, 2), d(1, 2)];
    for k in 0..6 {
        let v = if k < 3 { twice.mul_add(viscous[k], pressure) } else { twice * viscous[k] };
        out.stress[k] = fluid.select(v, out.stress[k]);
    }
    out.volume = fluid.select(j, out.volume);
    for r in 0..3 {
        for k in 0..3 {
            out.elastic[r][k] = fluid.select(h[r][k], out.elastic[r][k]);
        }
    }
    out.degenerate &= !fluid;
}
