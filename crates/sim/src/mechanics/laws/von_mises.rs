//! Von Mises yield with linear hardening, `σ_Y(ε_p) = σ_Y + H ε_p` (simulation.md §5.2; radial return of Simo & Hughes).
//!
//! The returned stress obeys `s = s_tr − 2 μ Δγ` and `s = √(2/3) (σ_Y + H ε_p) + (2/3) H Δγ`: a Bingham step whose viscosity
//! is (2/3) H and whose stiffness is 2 μ, so it takes the path of [`super::herschel_bulkley`]. The design adds the hardening
//! after the return; the implicit form costs the same and does not depend on the step.

use fearless_simd::{Select, Simd};
use megas_math::simd::Lanes;

use super::herschel_bulkley::Rule;
use super::{Mask, Parameters};
use fearless_simd::SimdBase;

/// Turns the rule of the lanes `metal` into hardening von Mises.
#[inline(always)]
pub(crate) fn harden<S: Simd>(s: S, law: &Parameters<S>, metal: Mask<S>, rule: &mut Rule<S>) {
    rule.yield_stress = metal.select(law.constant * law.plastic + law.yield_stress, rule.yield_stress);
    rule.stiffness = metal.select(law.shear * 2.0, rule.stiffness);
    rule.viscosity = metal.select(law.constant * (2.0 / 3.0), rule.viscosity);
    rule.exponent = metal.select(Lanes::<S>::splat(s, 1.0), rule.exponent);
}
