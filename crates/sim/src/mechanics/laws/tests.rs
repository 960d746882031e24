//! Every kernel against its oracle, over strains from nothing to large.

use megas_math::rng::Rng;
use megas_math::{mat3, svd};

use super::*;
use crate::particles::{DRUCKER_PRAGER, FIXED_COROTATED, FLUID, HENCKY, NEO_HOOKEAN, NEO_HOOKEAN_SPLIT, VON_MISES};
use crate::reference::{Law, State, return_map_with, stress, viscous_stress};

fn wide(law: &Law<f32>) -> Law<f64> {
    Law {
        law: law.law,
        shear: law.shear.into(),
        bulk: law.bulk.into(),
        yield_stress: law.yield_stress.into(),
        viscosity: law.viscosity.into(),
        exponent: law.exponent.into(),
        constant: law.constant.into(),
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
    let hencky = Law { law: HENCKY, shear: 3e3f32, bulk: 1e4, yield_stress: f32::INFINITY, viscosity: 1.0, exponent: 1.0, constant: 0.0 };
    let laws = [
        hencky,
        Law { yield_stress: 100.0, viscosity: 0.0, ..hencky },
        Law { yield_stress: 100.0, viscosity: 20.0, ..hencky },
        Law { yield_stress: 10.0, viscosity: 20.0, exponent: 0.4, ..hencky },
        Law { yield_stress: 10.0, viscosity: 3.0, exponent: 1.7, ..hencky },
        Law { yield_stress: 0.0, viscosity: 1e-3, exponent: 0.2, ..hencky },
        Law { law: FIXED_COROTATED, ..hencky },
        Law { law: NEO_HOOKEAN, ..hencky },
        Law { law: NEO_HOOKEAN_SPLIT, ..hencky },
        Law { law: VON_MISES, yield_stress: 100.0, constant: 500.0, ..hencky },
        Law { law: VON_MISES, yield_stress: 100.0, constant: 0.0, ..hencky },
        Law { law: DRUCKER_PRAGER, constant: 0.3, ..hencky },
    ];
    for law in laws {
        for h in gradients(4) {
            let dt = 1e-3;
            let f = mat3::add(mat3::cast(h), mat3::identity());
            // Rubber needs some volume; less is degenerate.
            if [NEO_HOOKEAN, NEO_HOOKEAN_SPLIT].contains(&law.law) && mat3::det(f) < 1.1 * f64::from(strain::MIN_J) {
                continue;
            }
            let past = State { plastic: 0.04f32, gain: 0.02 };
            let mut want_state = State { plastic: f64::from(past.plastic), gain: f64::from(past.gain) };
            let want_f = return_map_with(&wide(&law), f, f64::from(dt), &mut want_state);
            let want = stress(&wide(&law), want_f);
            let mut state = past;
            let (got_h, got) = material_point_with(&law, h, [[0.0; 3]; 3], dt, &mut state);
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
            assert!((f64::from(state.plastic) - want_state.plastic).abs() < 1e-5 * allowed, "{law:?} {h:?}: plastic strain");
            // The smallest eigenvalue of b, s₂², is only known to the rounding of s₀².
            let trace = 2e-6 + 2e-7 * (s[0] / s[2]).powi(2);
            assert!((f64::from(state.gain) - want_state.gain).abs() < trace, "{law:?} {h:?}: volume gain");
        }
    }
}

#[test]
fn strains_far_below_rounding_of_one_keep_their_digits() {
    let law = Law { law: HENCKY, shear: 3e3f32, bulk: 1e5, yield_stress: f32::INFINITY, viscosity: 1.0, exponent: 1.0, constant: 0.0 };
    for law in [HENCKY, FIXED_COROTATED, NEO_HOOKEAN, NEO_HOOKEAN_SPLIT, VON_MISES].map(|l| Law { law: l, ..law }) {
        let h = mat3::diag([-1e-9f32; 3]);
        let (_, t) = material_point(&law, h, 1e-4);
        assert!((t[0][0] / (law.bulk * -3e-9) - 1.0).abs() < 1e-5, "{t:?}");
    }
}

#[test]
fn inverted_and_flat_gradients_give_finite_stress_or_are_degenerate() {
    let mut rng = Rng::new(8);
    let corotated = Law { law: FIXED_COROTATED, shear: 3e3f32, bulk: 1e4, yield_stress: 0.0, viscosity: 1.0, exponent: 1.0, constant: 0.0 };
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

#[test]
fn a_fluid_follows_the_oracle_and_forgets_its_shape() {
    let mut rng = Rng::new(9);
    for exponent in [7.0f32, -1.0, 1.4] {
        let law = Law { law: FLUID, shear: 0.0, bulk: 1e4f32, yield_stress: 0.0, viscosity: 2.0, exponent, constant: 1.001 };
        for _ in 0..200 {
            let j = rng.range(0.5, 1.0) as f32;
            let rate: Mat3<f32> = std::array::from_fn(|_| std::array::from_fn(|_| rng.range(-30.0, 30.0) as f32));
            let mut h = [[0.0f32; 3]; 3];
            h[0][0] = j - 1.0;
            let (after, got) = material_point_with(&law, h, rate, 1e-4, &mut State::default());
            assert_eq!(after, h);
            let law = wide(&law);
            let j = f64::from(h[0][0]) + 1.0;
            let want = mat3::add(stress(&law, mat3::diag([j, 1.0, 1.0])), viscous_stress(&law, j, mat3::cast(rate)));
            let error = mat3::norm(mat3::sub(mat3::cast::<f32, f64>(got), want));
            assert!(error <= 3e-6 * mat3::norm(want), "{law:?} {j}: {got:?} {want:?}");
        }
        // Barely compressed: the pressure keeps its digits.
        let mut h = [[0.0f32; 3]; 3];
        h[0][0] = -1e-7;
        let (_, t) = material_point(&Law { viscosity: 0.0, ..law }, h, 1e-4);
        assert!((t[0][0] / (law.bulk * -1e-7) - 1.0).abs() < 1e-5, "{t:?}");
    }
}

#[test]
fn groups_of_mixed_laws_give_each_lane_its_own() {
    let tags = [HENCKY, FLUID, FIXED_COROTATED, DRUCKER_PRAGER, NEO_HOOKEAN, VON_MISES, NEO_HOOKEAN_SPLIT, HENCKY];
    let gradients = gradients(5);
    let base = Law { law: HENCKY, shear: 3e3f32, bulk: 1e4, yield_stress: 100.0, viscosity: 2.0, exponent: 1.0, constant: 0.3 };
    #[inline(always)]
    fn group<S: Simd>(s: S, tags: &[u8], h: &[Mat3<f32>], base: &Law<f32>) -> Vec<[f32; 6]> {
        let c = |v| Lanes::<S>::splat(s, v);
        let n = Lanes::<S>::LEN.min(tags.len());
        let parameters = Parameters {
            shear: c(base.shear),
            bulk: c(base.bulk),
            yield_stress: c(base.yield_stress),
            viscosity: c(base.viscosity),
            exponent: c(base.exponent),
            constant: c(base.constant),
            plastic: c(0.0),
            gain: c(0.0),
        };
        let matrix: Mat3s<S> = std::array::from_fn(|r| std::array::from_fn(|k| Lanes::<S>::from_fn(s, |i| h[i % n][r][k])));
        let rate = [[c(0.0); 3]; 3];
        let laws = Laws::new(&tags[..n]);
        let r = respond(s, matrix, &rate, &parameters, &laws, Some(Flow { dt: 1e-3, yue: false }));
        (0..n).map(|i| r.stress.map(|v| v[i])).collect()
    }
    for chunk in gradients.chunks_exact(tags.len()) {
        let mut h = chunk.to_vec();
        h[1] = [[h[1][0][0].clamp(-0.3, 0.0), 0.0, 0.0], [0.0; 3], [0.0; 3]];
        let level = fearless_simd::Level::new();
        let got = fearless_simd::dispatch!(level, s => group(s, &tags, &h, &base));
        for (i, t) in got.iter().enumerate() {
            let (_, alone) = material_point(&Law { law: tags[i], ..base }, h[i], 1e-3);
            let alone = [alone[0][0], alone[1][1], alone[2][2], alone[0][1], alone[0][2], alone[1][2]];
            for k in 0..6 {
                let scale = alone.iter().fold(1e-2f32, |m, v| m.max(v.abs()));
                assert!((t[k] - alone[k]).abs() <= 2e-4 * scale, "law {}: {t:?} {alone:?}", tags[i]);
            }
        }
    }
}
