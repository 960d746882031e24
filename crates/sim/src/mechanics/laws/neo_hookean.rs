//! Neo-Hookean elasticity (simulation.md §5.1): compressible, `τ = μ (b − I) + λ ln J I`, and split into shear and volume
//! (Yue 2015), `τ = μ J^{−2/3} dev b + ½ K (J² − 1) I`. Rational functions of b and J, no decomposition at all.

use fearless_simd::{Select, Simd, SimdBase, SimdFloat};
use megas_math::simd::elementary::{exp, ln_1p};
use megas_math::simd::{Lanes, Sym3};

use super::strain::{MIN_J, STRETCH};
use super::{Laws, Parameters, RUBBER, Response};
use crate::particles::{NEO_HOOKEAN, NEO_HOOKEAN_SPLIT};

/// Stress of the lanes with either form; `strain` is `b − I`, `change` is `J − 1`.
#[inline(always)]
pub(crate) fn respond<S: Simd>(s: S, strain: &Sym3<S>, change: Lanes<S>, law: &Parameters<S>, laws: &Laws, out: &mut Response<S>) {
    let c = |v| Lanes::<S>::splat(s, v);
    let trace = strain[0] + strain[1] + strain[2];
    let rubber = laws.lanes_of(s, RUBBER);
    // Also catches what is not a number.
    let regular = change.simd_ge(c(MIN_J - 1.0)) & trace.simd_le(c(STRETCH.1 * STRETCH.1 - 1.0));
    out.degenerate |= rubber & !regular;
    let log = ln_1p(s, change.max(c(MIN_J - 1.0)));
    if laws.any(NEO_HOOKEAN) {
        let mine = laws.lanes(s, NEO_HOOKEAN);
        let pressure = (law.bulk - law.shear * (2.0 / 3.0)) * log;
        for k in 0..6 {
            let v = if k < 3 { law.shear.mul_add(strain[k], pressure) } else { law.shear * strain[k] };
            out.stress[k] = mine.select(v, out.stress[k]);
        }
    }
    if laws.any(NEO_HOOKEAN_SPLIT) {
        let mine = laws.lanes(s, NEO_HOOKEAN_SPLIT);
        let shear = law.shear * exp(s, log * (-2.0 / 3.0));
        let pressure = law.bulk * 0.5 * change * (change + 2.0);
        let mean = trace * (1.0 / 3.0);
        for k in 0..6 {
            let v = if k < 3 { shear.mul_add(strain[k] - mean, pressure) } else { shear * strain[k] };
            out.stress[k] = mine.select(v, out.stress[k]);
        }
    }
}
