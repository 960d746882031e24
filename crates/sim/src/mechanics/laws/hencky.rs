//! StVK with Hencky strain, `τ = 2 μ ε + λ tr ε I` (simulation.md §5.1), and how plastic flow changes its gradient (§5.2): the
//! yield rules say by how much the deviator shrinks, and for sand what becomes of the trace.

use fearless_simd::{Select, Simd, SimdBase, SimdFloat, SimdMask};
use megas_math::simd::elementary::{exp_m1, ln_1p};
use megas_math::simd::symmetric::{EXP_M1, LN_1P, Traceless, contract, from_eigen};
use megas_math::simd::{Lanes, Mat3s, Sym3, each3, each6};

use super::strain::Spectral;
use super::{Flow, LOGARITHMIC, Laws, Parameters, Response, drucker_prager, herschel_bulkley, von_mises};
use crate::particles::{DRUCKER_PRAGER, HENCKY, VON_MISES};

/// What a yield rule makes of a trial strain.
pub(crate) struct Yielded<S: Simd> {
    /// Factor of the deviator, 0–1.
    pub ratio: Lanes<S>,
    /// Added to the trace.
    pub dilation: Lanes<S>,
}

/// Deviator and trace of the Hencky strain.
#[inline(always)]
fn logarithm<S: Simd>(s: S, spectral: &Spectral<S>, change: Lanes<S>) -> (Sym3<S>, Lanes<S>) {
    let (x, small) = (&spectral.x, spectral.small);
    let f = x.series(s, &LN_1P);
    let f = [f[2] * x.p * (-1.0 / 3.0), f[1] * 0.5, f[2] * 0.5];
    let mut e = x.combine(f);
    let mut trace = ln_1p(s, small.select(change, Lanes::<S>::splat(s, 0.0)).max(Lanes::<S>::splat(s, -0.95)));
    if let Some(p) = &spectral.large {
        let other = from_eigen::<S>(&p.u, p.e);
        for k in 0..6 {
            e[k] = small.select(e[k], other[k]);
        }
        trace = small.select(trace, p.trace);
    }
    (e, trace)
}

/// `exp(factor e) − I` of the deviator `e`.
#[inline(always)]
fn exponential<S: Simd>(s: S, spectral: &Spectral<S>, e: &Sym3<S>, factor: Lanes<S>) -> Mat3s<S> {
    let a = Traceless::<S>::new(each6(|k| e[k] * factor));
    let mut m = a.combine(a.series(s, &EXP_M1));
    if let Some(p) = &spectral.large {
        let other = from_eigen::<S>(&p.u, each3(|a| exp_m1(s, p.e[a] * factor)));
        for k in 0..6 {
            m[k] = spectral.small.select(m[k], other[k]);
        }
    }
    [[m[0], m[3], m[4]], [m[3], m[1], m[5]], [m[4], m[5], m[2]]]
}

/// Flow and stress of the lanes with Hencky strain.
#[inline(always)]
pub(crate) fn respond<S: Simd>(
    s: S,
    h: &Mat3s<S>,
    spectral: &Spectral<S>,
    change: Lanes<S>,
    law: &Parameters<S>,
    laws: &Laws,
    flow: Option<Flow>,
    out: &mut Response<S>,
) {
    let c = |v| Lanes::<S>::splat(s, v);
    let (zero, one) = (c(0.0), c(1.0));
    let (e, mut trace) = logarithm(s, spectral, change);
    let mut ratio = one;
    if let Some(flow) = flow {
        let norm = contract::<S>(&e, &e).sqrt();
        let mut yielded = Yielded { ratio: one, dilation: zero };
        if laws.any(HENCKY) | laws.any(VON_MISES) {
            let flowing = laws.lanes_of(s, 1 << HENCKY | 1 << VON_MISES);
            let effective = if flow.yue { law.shear * spectral.scale } else { law.shear };
            let mut rule = herschel_bulkley::Rule {
                yield_stress: law.yield_stress,
                stiffness: effective * (2.0 * flow.dt),
                viscosity: law.viscosity,
                exponent: law.exponent,
            };
            if laws.any(VON_MISES) {
                von_mises::harden(s, law, laws.lanes(s, VON_MISES), &mut rule);
            }
            yielded.ratio = rule.ratio(s, law.shear * norm * 2.0, flowing);
        }
        if laws.any(DRUCKER_PRAGER) {
            let sand = laws.lanes(s, DRUCKER_PRAGER);
            drucker_prager::flow(s, norm, trace, law, sand, &mut yielded, &mut out.gain);
        }
        let changed = yielded.ratio.simd_lt(one);
        if changed.any_true() {
            let shrink = yielded.ratio - 1.0;
            let m = exponential(s, spectral, &e, shrink);
            // F ← exp((ratio − 1) e) F, so H ← H + M + M H with M = exp(…) − I.
            for r in 0..3 {
                for k in 0..3 {
                    let sum = m[r][0].mul_add(h[0][k], m[r][1].mul_add(h[1][k], m[r][2].mul_add(h[2][k], m[r][k])));
                    out.elastic[r][k] = changed.select(h[r][k] + sum, h[r][k]);
                }
            }
            out.plastic = changed.select(norm * shrink * -(2f32 / 3.0).sqrt(), zero);
        }
        if laws.any(DRUCKER_PRAGER) {
            drucker_prager::dilate(s, &yielded, out);
            trace += yielded.dilation;
        }
        ratio = yielded.ratio;
    }
    let deviatoric = law.shear * ratio * 2.0;
    let pressure = law.bulk * trace;
    let mine = laws.lanes_of(s, LOGARITHMIC);
    for k in 0..6 {
        let v = if k < 3 { deviatoric.mul_add(e[k], pressure) } else { deviatoric * e[k] };
        out.stress[k] = mine.select(v, out.stress[k]);
    }
}
