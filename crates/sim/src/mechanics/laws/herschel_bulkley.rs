//! Herschel–Bulkley flow: how far the stress of one step relaxes towards the yield surface (simulation.md §5.2, Yue 2015).
//!
//! The same map without viscosity is von Mises yield; with a "viscosity" of two thirds of the hardening modulus and a
//! "stiffness" of 2 μ it is von Mises yield with linear hardening ([`super::von_mises`]).

use fearless_simd::{Select, Simd, SimdBase, SimdFloat, SimdMask};
use megas_math::simd::Lanes;
use megas_math::simd::elementary::{exp, ln, powf};

use super::Mask;

/// The yield surface and the flow beyond it.
pub(crate) struct Rule<S: Simd> {
    /// Uniaxial yield stress σ_Y \[Pa\].
    pub yield_stress: Lanes<S>,
    /// Fall of the stress norm per unit of plastic rate over the step, 2 μ̂ Δt \[Pa·s\].
    pub stiffness: Lanes<S>,
    /// η \[Pa·sʰ\].
    pub viscosity: Lanes<S>,
    /// h.
    pub exponent: Lanes<S>,
}

impl<S: Simd> Rule<S> {
    /// Ratio `s / s_tr` of the returned to the trial stress norm in the lanes `of` that yield, and 1 elsewhere: backward Euler;
    /// η = 0 is von Mises.
    #[inline(always)]
    pub fn ratio(&self, s: S, trial: Lanes<S>, of: Mask<S>) -> Lanes<S> {
        let c = |v| Lanes::<S>::splat(s, v);
        let over = trial - self.yield_stress * (2f32 / 3.0).sqrt();
        let yields = over.simd_gt(c(0.0)) & of;
        if !yields.any_true() {
            return c(1.0);
        }
        // Bingham: y = over / (1 + stiffness/η).
        let mut y = over * (self.viscosity / (self.viscosity + self.stiffness));
        let curved = yields & !self.exponent.simd_eq(c(1.0)) & self.viscosity.simd_gt(c(0.0));
        if curved.any_true() {
            y = curved.select(curved_flow(s, over, self.stiffness, self.viscosity, self.exponent, curved), y);
        }
        yields.select((trial - over + y) / trial, c(1.0))
    }
}

/// Solves `y + stiffness (y/η)^{1/h} = over` for y where `active` (simulation.md §5.2): Newton on the convex form from its
/// upper bound, which converges monotonically.
#[inline(always)]
fn curved_flow<S: Simd>(s: S, over: Lanes<S>, stiffness: Lanes<S>, viscosity: Lanes<S>, exponent: Lanes<S>, active: Mask<S>) -> Lanes<S> {
    let c = |v| Lanes::<S>::splat(s, v);
    let one = c(1.0);
    let (over, viscosity) = (active.select(over, one).max(c(1e-30)), active.select(viscosity, one));
    let h = active.select(exponent, one);
    let inverse = one / h;
    // t = y/over obeys t + k t^{1/h} = 1; for h > 1 the convex unknown is z = t^{1/h}: k z + z^h = 1.
    let log_k = (ln(s, stiffness / over) + inverse * (ln(s, over) - ln(s, viscosity))).max(c(-80.0)).min(c(80.0));
    let k = exp(s, log_k);
    let steep = h.simd_gt(one);
    let (a, b) = (steep.select(k, one), steep.select(one, k));
    let log_b = steep.select(c(0.0), log_k);
    let q = steep.select(h, inverse);
    let top = (one / a).min(exp(s, -(log_b / q)));
    let mut u = top;
    let mut done = !active;
    for _ in 0..20 {
        let power = powf(s, u, q - 1.0);
        let residual = u.mul_add(b.mul_add(power, a), c(-1.0));
        let slope = (b * q).mul_add(power, a);
        let next = (u - residual / slope).max(u * 0.1).min(top);
        let converged = (next - u).abs().simd_le(next * 1e-6);
        u = done.select(u, next);
        done |= converged;
        if done.all_true() {
            break;
        }
    }
    over * steep.select(powf(s, u, h), u)
}
