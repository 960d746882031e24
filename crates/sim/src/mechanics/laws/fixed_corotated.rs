//! Fixed corotated elasticity, `τ = 2 μ (F − R) Fᵀ + λ (J − 1) J I` (simulation.md §5.1). Defined for flat and inverted elements.

use fearless_simd::{Select, Simd, SimdFloat};
use megas_math::simd::Lanes;
use megas_math::simd::symmetric::{SQRT_1P_M1, from_eigen};

use super::strain::Spectral;
use super::{Mask, Parameters, Response};

/// Stress of the lanes `mine`. `(F − R) Fᵀ = b − √b`, so the rotation itself is not needed.
#[inline(always)]
pub(crate) fn respond<S: Simd>(s: S, spectral: &Spectral<S>, change: Lanes<S>, law: &Parameters<S>, mine: Mask<S>, out: &mut Response<S>) {
    let Spectral { mean, scale, x, small, large, .. } = spectral;
    // √b = √scale (I + Y), Y = √(I + X) − I.
    let root = scale.sqrt();
    let y = x.series(s, &SQRT_1P_M1);
    let f = [*mean - *mean / (root + 1.0) - root * y[0], *scale - root * y[1], -(root * y[2])];
    let mut t = x.combine(f);
    if let Some(p) = large {
        let other = from_eigen::<S>(&p.u, p.corotated);
        for k in 0..6 {
            t[k] = small.select(t[k], other[k]);
        }
    }
    let lambda = law.bulk - law.shear * (2.0 / 3.0);
    let pressure = lambda * change * out.volume;
    let twice = law.shear * 2.0;
    for k in 0..6 {
        let v = if k < 3 { twice.mul_add(t[k], pressure) } else { twice * t[k] };
        out.stress[k] = mine.select(v, out.stress[k]);
    }
}
