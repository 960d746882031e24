//! Stress and return map of the isotropic laws in lanes (simulation.md §5.1, §5.2).
//!
//! Everything is a function of the left Cauchy–Green tensor `b = F Fᵀ`, written as `b − I` so that small strains keep
//! their digits. Small strains use power series; lanes with large ones take the eigen-decomposition instead.

use fearless_simd::{Select, Simd, SimdBase, SimdFloat, SimdMask};
use megas_math::Mat3;
use megas_math::simd::elementary::{exp, exp_m1, ln, ln_1p, powf};
use megas_math::simd::symmetric::{EXP_M1, LN_1P, SERIES_P, SQRT_1P_M1, Traceless, contract, eigen, from_eigen};
use megas_math::simd::{Lanes, Mat3s, Sym3, each3, each6};

/// Smallest and largest stretch that is not repaired (simulation.md §7.6).
pub(crate) const STRETCH: (f32, f32) = (0.05, 20.0);
/// Smallest volume ratio that is not repaired.
pub(crate) const MIN_J: f32 = 0.02;

/// A mask over `f32` lanes.
pub(crate) type Mask<S> = <S as Simd>::mask32s;

/// Parameters of the law per lane; units as in [`crate::particles::Particles`].
pub(crate) struct Parameters<S: Simd> {
    pub shear: Lanes<S>,
    pub bulk: Lanes<S>,
    pub yield_stress: Lanes<S>,
    pub viscosity: Lanes<S>,
    pub exponent: Lanes<S>,
    /// Lanes with the fixed corotated law; the others are Hencky.
    pub corotated: Mask<S>,
}

/// What a deformation gradient answers.
pub(crate) struct Response<S: Simd> {
    /// Kirchhoff stress τ \[Pa\].
    pub stress: Sym3<S>,
    /// `F − I` after the return map.
    pub elastic: Mat3s<S>,
    /// Increment of plastic strain.
    pub plastic: Lanes<S>,
    /// Volume ratio J.
    pub volume: Lanes<S>,
    /// Lanes whose gradient is degenerate and must be replaced; their stress is meaningless.
    pub degenerate: Mask<S>,
}

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
struct Principal<S: Simd> {
    /// Principal directions (columns).
    u: Mat3s<S>,
    /// Deviatoric Hencky strains.
    e: [Lanes<S>; 3],
    /// Trace of the Hencky strain.
    trace: Lanes<S>,
    /// `σ_a² − σ_a`, with the sign of det F on the smallest stretch.
    corotated: [Lanes<S>; 3],
    degenerate: Mask<S>,
}

#[inline(always)]
fn principal<S: Simd>(s: S, strain: Sym3<S>, volume: Lanes<S>, is_corotated: Mask<S>) -> Principal<S> {
    let c = |v| Lanes::<S>::splat(s, v);
    let (w, u) = eigen(s, strain);
    let least = w[0].min(w[1]).min(w[2]);
    let most = w[0].max(w[1]).max(w[2]);
    let (low, high) = (STRETCH.0 * STRETCH.0 - 1.0, STRETCH.1 * STRETCH.1 - 1.0);
    let bounded = most.simd_le(c(high)) & volume.abs().simd_le(c(STRETCH.1.powi(3)));
    let regular = bounded & (is_corotated | (least.simd_ge(c(low)) & volume.simd_ge(c(MIN_J))));
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

/// Ratio `s / s_tr` of the returned to the trial stress norm in lanes that yield (`over = s_tr − s_Y > 0`), and 1 elsewhere:
/// backward Euler of Herschel–Bulkley flow; η = 0 is von Mises.
#[inline(always)]
pub(crate) fn flow_ratio<S: Simd>(
    s: S,
    trial: Lanes<S>,
    over: Lanes<S>,
    stiffness: Lanes<S>,
    viscosity: Lanes<S>,
    exponent: Lanes<S>,
) -> Lanes<S> {
    let c = |v| Lanes::<S>::splat(s, v);
    let yields = over.simd_gt(c(0.0));
    // Bingham: y = over / (1 + stiffness/η) with stiffness = 2 μ̂ Δt.
    let mut y = over * (viscosity / (viscosity + stiffness));
    let curved = yields & !exponent.simd_eq(c(1.0)) & viscosity.simd_gt(c(0.0));
    if curved.any_true() {
        y = curved.select(curved_flow(s, over, stiffness, viscosity, exponent, curved), y);
    }
    yields.select((trial - over + y) / trial, c(1.0))
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

/// Stress of `F = I + H`, after the plastic flow of one step of `flow_dt` seconds where that is given. `yue` replaces μ̂ = μ by
/// Yue's μ tr(b)/3.
#[inline(always)]
pub(crate) fn respond<S: Simd>(
    s: S,
    h: Mat3s<S>,
    law: &Parameters<S>,
    has_hencky: bool,
    has_corotated: bool,
    flow_dt: Option<f32>,
    yue: bool,
) -> Response<S> {
    let c = |v| Lanes::<S>::splat(s, v);
    let zero = c(0.0);
    let strain = left_strain::<S>(&h);
    let change = volume_change::<S>(&h);
    let volume = change + 1.0;
    let mean = (strain[0] + strain[1] + strain[2]) * (1.0 / 3.0);
    let scale = mean + 1.0;
    let inverse = c(1.0) / scale;
    let mut x = strain;
    for k in 0..3 {
        x[k] -= mean;
    }
    let x = Traceless::<S>::new(each6(|k| x[k] * inverse));
    let small = x.p.simd_le(c(SERIES_P)) & scale.simd_ge(c(0.3)) & scale.simd_le(c(4.0)) & volume.simd_gt(c(0.1));
    let large = if small.all_true() {
        None
    } else {
        Some(s.vectorize(
            #[inline(always)]
            || principal(s, strain, volume, law.corotated),
        ))
    };
    let degenerate = large.as_ref().map_or(Mask::<S>::splat(s, false), |p| p.degenerate & !small);

    let mut stress = [zero; 6];
    let mut elastic = h;
    let mut plastic = zero;
    if has_hencky {
        let f = x.series(s, &LN_1P);
        let f = [f[2] * x.p * (-1.0 / 3.0), f[1] * 0.5, f[2] * 0.5];
        let mut e = x.combine(f);
        let mut trace = ln_1p(s, small.select(change, zero));
        if let Some(p) = &large {
            let other = from_eigen::<S>(&p.u, p.e);
            for k in 0..6 {
                e[k] = small.select(e[k], other[k]);
            }
            trace = small.select(trace, p.trace);
        }
        let mut ratio = c(1.0);
        if let Some(dt) = flow_dt {
            let norm = contract::<S>(&e, &e).sqrt();
            let trial = law.shear * norm * 2.0;
            let over = trial - law.yield_stress * (2f32 / 3.0).sqrt();
            let yields = over.simd_gt(zero) & !law.corotated;
            if yields.any_true() {
                let effective = if yue { law.shear * scale } else { law.shear };
                ratio = yields.select(flow_ratio(s, trial, over, effective * (2.0 * dt), law.viscosity, law.exponent), ratio);
                let shrink = ratio - 1.0;
                let a = Traceless::<S>::new(each6(|k| e[k] * shrink));
                let mut m = a.combine(a.series(s, &EXP_M1));
                if let Some(p) = &large {
                    let other = from_eigen::<S>(&p.u, each3(|a| exp_m1(s, p.e[a] * shrink)));
                    for k in 0..6 {
                        m[k] = small.select(m[k], other[k]);
                    }
                }
                // F ← exp((ratio − 1) e) F, so H ← H + M + M H with M = exp(…) − I.
                let full = [[m[0], m[3], m[4]], [m[3], m[1], m[5]], [m[4], m[5], m[2]]];
                for r in 0..3 {
                    for k in 0..3 {
                        let sum = full[r][0].mul_add(h[0][k], full[r][1].mul_add(h[1][k], full[r][2].mul_add(h[2][k], full[r][k])));
                        elastic[r][k] = yields.select(h[r][k] + sum, h[r][k]);
                    }
                }
                plastic = yields.select(norm * shrink * -(2f32 / 3.0).sqrt(), zero);
            }
        }
        let deviatoric = law.shear * ratio * 2.0;
        let pressure = law.bulk * trace;
        for k in 0..6 {
            stress[k] = if k < 3 { deviatoric.mul_add(e[k], pressure) } else { deviatoric * e[k] };
        }
    }
    if has_corotated {
        // b − √b, from √b = √scale (I + Y), Y = √(I + X) − I.
        let root = scale.sqrt();
        let y = x.series(s, &SQRT_1P_M1);
        let f = [mean - mean / (root + 1.0) - root * y[0], scale - root * y[1], -(root * y[2])];
        let mut t = x.combine(f);
        if let Some(p) = &large {
            let other = from_eigen::<S>(&p.u, p.corotated);
            for k in 0..6 {
                t[k] = small.select(t[k], other[k]);
            }
        }
        let lambda = law.bulk - law.shear * (2.0 / 3.0);
        let pressure = lambda * change * volume;
        let twice = law.shear * 2.0;
        for k in 0..6 {
            let v = if k < 3 { twice.mul_add(t[k], pressure) } else { twice * t[k] };
            stress[k] = law.corotated.select(v, stress[k]);
        }
    }
    Response { stress, elastic, plastic, volume, degenerate }
}

/// The production law at one point, for tests and diagnostics: `F − I` after the return map of a step of `dt` seconds, and the
/// Kirchhoff stress \[Pa\]. The gradient must not be degenerate.
pub fn material_point(law: &crate::reference::Law<f32>, h: Mat3<f32>, dt: f32) -> (Mat3<f32>, Mat3<f32>) {
    fearless_simd::dispatch!(fearless_simd::Level::new(), s => one(s, law, h, dt))
}

#[inline(always)]
fn one<S: Simd>(s: S, law: &crate::reference::Law<f32>, h: Mat3<f32>, dt: f32) -> (Mat3<f32>, Mat3<f32>) {
    let c = |v| Lanes::<S>::splat(s, v);
    let corotated = law.law == crate::particles::FIXED_COROTATED;
    let parameters = Parameters {
        shear: c(law.shear),
        bulk: c(law.bulk),
        yield_stress: c(law.yield_stress),
        viscosity: c(law.viscosity),
        exponent: c(law.exponent),
        corotated: Mask::<S>::splat(s, corotated),
    };
    let r = respond(s, h.map(|row| row.map(c)), &parameters, !corotated, corotated, Some(dt), false);
    let t = r.stress.map(|v| v[0]);
    (r.elastic.map(|row| row.map(|v| v[0])), [[t[0], t[3], t[4]], [t[3], t[1], t[5]], [t[4], t[5], t[2]]])
}

#[cfg(test)]
mod tests {
    use megas_math::rng::Rng;
    use megas_math::{mat3, svd};

    use super::*;
    use crate::particles::{FIXED_COROTATED, HENCKY};
    use crate::reference::{Law, return_map, stress};

    fn wide(law: &Law<f32>) -> Law<f64> {
        Law {
            law: law.law,
            shear: law.shear.into(),
            bulk: law.bulk.into(),
            yield_stress: law.yield_stress.into(),
            viscosity: law.viscosity.into(),
            exponent: law.exponent.into(),
        }
    }

    /// Rotations times stretches from tiny to large, as `F − I`.
    fn gradients(seed: u64) -> Vec<Mat3<f32>> {
        let mut rng = Rng::new(seed);
        let mut all = Vec::new();
        for size in [0.0, 1e-6, 1e-4, 1e-2, 0.05, 0.1, 0.3, 1.0, 2.0] {
            for turn in [false, true] {
                for _ in 0..40 {
                    let any: Mat3<f64> = std::array::from_fn(|_| std::array::from_fn(|_| rng.range(-1.0, 1.0)));
                    let d = svd::svd(any);
                    let s: [f64; 3] = std::array::from_fn(|_| (size * rng.range(-1.0, 1.0)).exp());
                    let sym = mat3::congruence(d.u, mat3::diag(s));
                    let f = if turn { mat3::mul(sym, mat3::mul(d.u, mat3::transpose(d.v))) } else { sym };
                    all.push(mat3::cast(mat3::sub(f, mat3::identity())));
                }
            }
        }
        all
    }

    #[test]
    fn stress_and_flow_follow_the_oracle_for_small_and_large_strains() {
        let hencky = Law { law: HENCKY, shear: 3e3f32, bulk: 1e4, yield_stress: f32::INFINITY, viscosity: 1.0, exponent: 1.0 };
        let laws = [
            hencky,
            Law { yield_stress: 100.0, viscosity: 0.0, ..hencky },
            Law { yield_stress: 100.0, viscosity: 20.0, ..hencky },
            Law { yield_stress: 10.0, viscosity: 20.0, exponent: 0.4, ..hencky },
            Law { yield_stress: 10.0, viscosity: 3.0, exponent: 1.7, ..hencky },
            Law { yield_stress: 0.0, viscosity: 1e-3, exponent: 0.2, ..hencky },
            Law { law: FIXED_COROTATED, ..hencky },
        ];
        for law in laws {
            for h in gradients(4) {
                let dt = 1e-3;
                let f = mat3::add(mat3::cast(h), mat3::identity());
                let (want_f, _) = return_map(&wide(&law), f, f64::from(dt));
                let want = stress(&wide(&law), want_f);
                let (got_h, got) = material_point(&law, h, dt);
                let got_f = mat3::add(mat3::cast(got_h), mat3::identity());
                let error = mat3::norm(mat3::sub(got_f, want_f));
                // Working with b = F Fᵀ costs digits where the stretches differ by orders of magnitude.
                let s = svd::svd(f).s;
                let allowed = 1.0 + 0.2 * (s[0] / s[2] - 1.0);
                assert!(error <= 3e-6 * allowed * mat3::norm(want_f), "{law:?} {h:?}: F off by {error:e}");
                // Stress errors: rounding of the strain (also 1 ulp of the rotation inside F) times the stiffness.
                let strain = mat3::norm(mat3::sub(f, mat3::identity())).max(1e-7);
                let size = mat3::norm(want) + 2e4 * strain.min(1.0);
                let error = mat3::norm(mat3::sub(mat3::cast::<f32, f64>(got), want));
                assert!(error <= 5e-6 * size * allowed, "{law:?} {h:?}: stress off by {error:e} of {size:e}");
            }
        }
    }

    #[test]
    fn strains_far_below_rounding_of_one_keep_their_digits() {
        let law = Law { law: HENCKY, shear: 3e3f32, bulk: 1e5, yield_stress: f32::INFINITY, viscosity: 1.0, exponent: 1.0 };
        for law in [law, Law { law: FIXED_COROTATED, ..law }] {
            let h = mat3::diag([-1e-9f32; 3]);
            let (_, t) = material_point(&law, h, 1e-4);
            assert!((t[0][0] / (law.bulk * -3e-9) - 1.0).abs() < 1e-5, "{t:?}");
        }
    }

    #[test]
    fn inverted_and_flat_gradients_give_finite_stress_or_are_degenerate() {
        let mut rng = Rng::new(8);
        let corotated = Law { law: FIXED_COROTATED, shear: 3e3f32, bulk: 1e4, yield_stress: 0.0, viscosity: 1.0, exponent: 1.0 };
        for _ in 0..300 {
            let any: Mat3<f64> = std::array::from_fn(|_| std::array::from_fn(|_| rng.range(-1.0, 1.0)));
            let d = svd::svd(any);
            let f = d.with_values([rng.range(0.0, 3.0), rng.range(0.0, 3.0), rng.range(-2.0, 0.0)]);
            let (_, t) = material_point(&corotated, mat3::cast(mat3::sub(f, mat3::identity())), 1e-4);
            let want = stress(&wide(&corotated), f);
            let error = mat3::norm(mat3::sub(mat3::cast::<f32, f64>(t), want));
            assert!(error <= 1e-4 * mat3::norm(want).max(1e3), "{f:?}: {t:?} instead of {want:?}");
        }
    }
}
