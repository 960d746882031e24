//! The laws, written as in the textbooks: singular values, logarithms, bisection (simulation.md §5.1, §5.2).

use megas_math::{Mat3, Real, mat3, svd, vec3};

use crate::particles::{DRUCKER_PRAGER, FIXED_COROTATED, FLUID, NEO_HOOKEAN, NEO_HOOKEAN_SPLIT, VON_MISES};

/// A law with its parameters (units as in [`crate::particles::Particles`]).
#[derive(Clone, Copy, Debug, Default)]
pub struct Law<T> {
    /// One of the tags of [`crate::particles`].
    pub law: u8,
    /// μ.
    pub shear: T,
    /// K.
    pub bulk: T,
    /// σ_Y.
    pub yield_stress: T,
    /// η, or μ_v of a fluid.
    pub viscosity: T,
    /// h, or γ of a fluid.
    pub exponent: T,
    /// H of von Mises, α_f of sand, largest J of a fluid.
    pub constant: T,
}

/// What a point remembers of its plastic past.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct State<T> {
    /// Accumulated plastic strain.
    pub plastic: T,
    /// Volume gain of sand, as a Hencky strain.
    pub gain: T,
}

/// Elastic energy per reference volume \[J/m³\]; zero viscosity. A fluid's gradient holds J in its first entry.
pub fn energy<T: Real>(law: &Law<T>, f: Mat3<T>) -> T {
    let (half, one, two, three) = (T::of(0.5), T::one(), T::of(2.0), T::of(3.0));
    let lambda = law.bulk - T::of(2.0 / 3.0) * law.shear;
    let sum = |v: [T; 3]| v[0] + v[1] + v[2];
    let square = |v: T| v * v;
    let j = if law.law == FLUID { f[0][0] } else { mat3::det(f) };
    let s = svd::svd(f).s;
    match law.law {
        FLUID => {
            // −∫ p dJ of p = (K/γ) (J^{−γ} − 1).
            let g = law.exponent;
            law.bulk / g * ((j.powf(one - g) - one) / (g - one) + (j - one))
        }
        FIXED_COROTATED => law.shear * sum(s.map(|v| square(v - one))) + half * lambda * square(j - one),
        NEO_HOOKEAN => half * law.shear * (sum(s.map(square)) - three - two * j.ln()) + half * lambda * square(j.ln()),
        NEO_HOOKEAN_SPLIT => {
            half * law.shear * (j.powf(T::of(-2.0 / 3.0)) * sum(s.map(square)) - three) + half * law.bulk * (half * (j * j - one) - j.ln())
        }
        _ => {
            let log = s.map(|v| v.max(T::of(0.05)).ln());
            law.shear * sum(log.map(square)) + half * lambda * square(sum(log))
        }
    }
}

/// Kirchhoff stress of `f` \[Pa\], without viscosity.
pub fn stress<T: Real>(law: &Law<T>, f: Mat3<T>) -> Mat3<T> {
    let lambda = law.bulk - T::of(2.0 / 3.0) * law.shear;
    let (one, two) = (T::one(), T::of(2.0));
    if law.law == FLUID {
        let j = f[0][0];
        let p = law.bulk / law.exponent * (j.powf(-law.exponent) - one);
        return mat3::scale(mat3::identity(), -j * p);
    }
    let d = svd::svd(f);
    let j = d.s[0] * d.s[1] * d.s[2];
    let square = d.s.map(|s| s * s);
    let tau = match law.law {
        FIXED_COROTATED => d.s.map(|s| two * law.shear * (s * s - s) + lambda * (j - one) * j),
        NEO_HOOKEAN => square.map(|b| law.shear * (b - one) + lambda * j.ln()),
        NEO_HOOKEAN_SPLIT => {
            let mean = (square[0] + square[1] + square[2]) / T::of(3.0);
            square.map(|b| law.shear * j.powf(T::of(-2.0 / 3.0)) * (b - mean) + T::of(0.5) * law.bulk * (j * j - one))
        }
        _ => {
            let log = d.s.map(|s| s.max(T::of(0.05)).ln());
            let trace = log[0] + log[1] + log[2];
            log.map(|e| two * law.shear * e + lambda * trace)
        }
    };
    mat3::congruence(d.u, mat3::diag(tau))
}

/// What the velocity gradient `c` \[1/s\] adds to the stress of a fluid at volume ratio `j`.
pub fn viscous_stress<T: Real>(law: &Law<T>, j: T, c: Mat3<T>) -> Mat3<T> {
    if law.law != FLUID {
        return mat3::scale(mat3::identity(), T::zero());
    }
    let d = mat3::scale(mat3::add(c, mat3::transpose(c)), T::of(0.5));
    let deviator = mat3::sub(d, mat3::scale(mat3::identity(), mat3::trace(d) / T::of(3.0)));
    mat3::scale(deviator, T::of(2.0) * law.viscosity * j)
}

/// The gradient after plastic flow during `dt` from a state without past, and the increment of plastic strain.
pub fn return_map<T: Real>(law: &Law<T>, f: Mat3<T>, dt: T) -> (Mat3<T>, T) {
    let mut state = State { plastic: T::zero(), gain: T::zero() };
    let f = return_map_with(law, f, dt, &mut state);
    (f, state.plastic)
}

/// The gradient after plastic flow during `dt`; `state` is updated.
pub fn return_map_with<T: Real>(law: &Law<T>, f: Mat3<T>, dt: T, state: &mut State<T>) -> Mat3<T> {
    if [FIXED_COROTATED, FLUID, NEO_HOOKEAN, NEO_HOOKEAN_SPLIT].contains(&law.law) {
        return f;
    }
    let (zero, one, two, three) = (T::zero(), T::one(), T::of(2.0), T::of(3.0));
    let root = T::of(2.0 / 3.0).sqrt();
    let d = svd::svd(f);
    let log = d.s.map(|s| s.max(T::of(0.05)).ln());
    let trace = log[0] + log[1] + log[2];
    let e = log.map(|v| v - trace / three);
    let norm = vec3::norm(e);
    // The factor of the deviator and the new trace.
    let (ratio, volume) = if law.law == DRUCKER_PRAGER {
        let corrected = trace + state.gain;
        if corrected >= zero {
            state.gain = corrected;
            (zero, zero)
        } else {
            state.gain = zero;
            let over = norm + three * law.bulk / (two * law.shear) * corrected * law.constant;
            (if over > zero { one - over / norm } else { one }, corrected)
        }
    } else {
        let trial = two * law.shear * norm;
        let metal = law.law == VON_MISES;
        let yield_stress = if metal { law.yield_stress + law.constant * state.plastic } else { law.yield_stress };
        let over = trial - root * yield_stress;
        if over <= zero || over.is_nan() {
            return f;
        }
        let y = if metal {
            // s = s_tr − 2 μ Δγ = √(2/3) σ_Y + (2/3) H Δγ.
            let gamma = over / (two * law.shear + T::of(2.0 / 3.0) * law.constant);
            T::of(2.0 / 3.0) * law.constant * gamma
        } else {
            excess(law, over, two * law.shear * dt)
        };
        ((root * yield_stress + y) / trial, trace)
    };
    state.plastic += root * norm * (one - ratio);
    d.with_values(e.map(|v| (v * ratio + volume / three).exp()))
}

/// Solves `y + k (y/η)^{1/h} = over` by bisection.
fn excess<T: Real>(law: &Law<T>, over: T, k: T) -> T {
    if law.viscosity == T::zero() {
        return T::zero();
    }
    let (mut lo, mut hi) = (T::zero(), over);
    for _ in 0..200 {
        let y = (lo + hi) / T::of(2.0);
        if y + k * (y / law.viscosity).powf(law.exponent.recip()) > over {
            hi = y;
        } else {
            lo = y;
        }
    }
    (lo + hi) / T::of(2.0)
}

#[cfg(test)]
mod tests {
    use megas_math::rng::Rng;

    use super::*;
    use crate::particles::HENCKY;

    const BASE: Law<f64> =
        Law { law: HENCKY, shear: 3e3, bulk: 1e4, yield_stress: f64::INFINITY, viscosity: 0.0, exponent: 7.0, constant: 0.0 };

    /// `τ = ∂ψ/∂F Fᵀ` by central differences.
    #[test]
    fn stress_is_the_derivative_of_the_energy_for_every_law() {
        let mut rng = Rng::new(11);
        for law in [HENCKY, FIXED_COROTATED, NEO_HOOKEAN, NEO_HOOKEAN_SPLIT, VON_MISES, DRUCKER_PRAGER, FLUID] {
            let law = Law { law, ..BASE };
            for _ in 0..50 {
                let mut f: Mat3<f64> = std::array::from_fn(|r| std::array::from_fn(|c| f64::from(u8::from(r == c)) + rng.range(-0.3, 0.3)));
                if law.law == FLUID {
                    f = mat3::diag([f[0][0], 1.0, 1.0]);
                }
                let mut p = [[0.0; 3]; 3];
                let d = 1e-6;
                for r in 0..3 {
                    for c in 0..3 {
                        let at = |sign: f64| {
                            let mut g = f;
                            g[r][c] += sign * d;
                            energy(&law, g)
                        };
                        p[r][c] = (at(1.0) - at(-1.0)) / (2.0 * d);
                    }
                }
                let tau = stress(&law, f);
                if law.law == FLUID {
                    assert!((p[0][0] * f[0][0] - tau[0][0]).abs() < 1e-5 * law.bulk, "{f:?}");
                    continue;
                }
                let expected = mat3::mul(p, mat3::transpose(f));
                assert!(mat3::norm(mat3::sub(tau, expected)) < 1e-6 * mat3::norm(tau).max(1e3), "{law:?} {f:?}: {tau:?} {expected:?}");
            }
        }
    }

    #[test]
    fn all_laws_agree_at_small_strain() {
        let h = [[1e-5, 2e-5, 0.0], [-1e-5, -3e-5, 1e-5], [2e-5, 0.0, 1e-5]];
        let f = mat3::add(h, mat3::identity());
        let hooke = stress(&BASE, f);
        for law in [FIXED_COROTATED, NEO_HOOKEAN, NEO_HOOKEAN_SPLIT] {
            let t = stress(&Law { law, ..BASE }, f);
            assert!(mat3::norm(mat3::sub(t, hooke)) < 1e-4 * mat3::norm(hooke), "{law}");
        }
    }

    /// Uniaxial stress–strain curve: the slope past yield is the tangent modulus E H/(E + H), exactly in logarithmic strain.
    #[test]
    fn von_mises_hardens_along_its_tangent_modulus() {
        let (e, nu, yield_stress, hardening) = (1e6f64, 0.3f64, 2e3f64, 1e5f64);
        let law = Law {
            law: VON_MISES,
            shear: e / (2.0 * (1.0 + nu)),
            bulk: e / (3.0 * (1.0 - 2.0 * nu)),
            yield_stress,
            constant: hardening,
            ..BASE
        };
        let mut f = mat3::identity();
        let mut state = State::default();
        let axial = |strain: f64, f: &mut Mat3<f64>, state: &mut State<f64>| {
            // Axial strain is prescribed in steps, the lateral stretch is relaxed until the lateral stress vanishes.
            for k in 1..=100 {
                let target = (strain * f64::from(k) / 100.0).exp();
                let start = (*f, *state);
                let mut lateral = 0.0f64;
                let (mut lo, mut hi) = (-0.01, 0.01);
                for _ in 0..80 {
                    lateral = 0.5 * (lo + hi);
                    (*f, *state) = start;
                    let before = if k == 1 { 1.0 } else { (strain * f64::from(k - 1) / 100.0).exp() };
                    let step = mat3::diag([target / before, lateral.exp(), lateral.exp()]);
                    *f = return_map_with(&law, mat3::mul(step, *f), 0.0, state);
                    if stress(&law, *f)[1][1] > 0.0 { hi = lateral } else { lo = lateral }
                }
                assert!(lateral < 0.0);
            }
            stress(&law, *f)[0][0]
        };
        let strain = 0.02;
        let got = axial(strain, &mut f, &mut state);
        let exact = yield_stress + (strain - yield_stress / e) * e * hardening / (e + hardening);
        assert!((got / exact - 1.0).abs() < 1e-9, "{got} {exact}");
        assert!((state.plastic - (got - yield_stress) / hardening).abs() < 1e-12);
    }

    /// Triaxial compression at the limit: σ₁/σ₃ = (1 + sin φ)/(1 − sin φ).
    #[test]
    fn sand_yields_at_the_angle_of_friction_and_carries_no_tension() {
        let phi = 33f64.to_radians();
        let slope = (2.0f64 / 3.0).sqrt() * 2.0 * phi.sin() / (3.0 - phi.sin());
        let law = Law { law: DRUCKER_PRAGER, constant: slope, ..BASE };
        let mut state = State::default();
        let f = return_map_with(&law, mat3::diag([0.8, 1.08, 1.08]), 0.0, &mut state);
        let t = stress(&law, f);
        assert!((t[0][0] / t[1][1] - (1.0 + phi.sin()) / (1.0 - phi.sin())).abs() < 1e-9, "{t:?}");
        assert!((mat3::det(f) - 0.8 * 1.08 * 1.08).abs() < 1e-12, "sliding keeps the volume");
        // Opened by 3 %, the same volume must close again before there is pressure.
        let opened = return_map_with(&law, mat3::scale(f, (1.03 / mat3::det(f)).cbrt()), 0.0, &mut state);
        assert!(mat3::norm(stress(&law, opened)) < 1e-9);
        assert!((state.gain - 1.03f64.ln()).abs() < 1e-12);
        let closing = return_map_with(&law, mat3::scale(opened, 0.98f64.cbrt()), 0.0, &mut state);
        assert!(mat3::norm(stress(&law, closing)) < 1e-9 && (state.gain - (1.03f64 * 0.98).ln()).abs() < 1e-12);
        let pressed = return_map_with(&law, mat3::scale(closing, 0.96f64.cbrt()), 0.0, &mut state);
        assert!((stress(&law, pressed)[0][0] - law.bulk * (1.03f64 * 0.98 * 0.96).ln()).abs() < 1e-9 && state.gain == 0.0);
    }

    #[test]
    fn a_fluid_follows_tait_and_newton() {
        let law = Law { law: FLUID, viscosity: 2.0, ..BASE };
        let p = -stress(&law, mat3::diag([0.9, 1.0, 1.0]))[0][0] / 0.9;
        assert!((p - 1e4 / 7.0 * (0.9f64.powi(-7) - 1.0)).abs() < 1e-9);
        // Simple shear at 3/s: τ_xy = μ_v γ̇; pure dilation: nothing.
        assert!((viscous_stress(&law, 1.0, [[0.0, 3.0, 0.0], [0.0; 3], [0.0; 3]])[0][1] - 6.0).abs() < 1e-12);
        assert!(mat3::norm(viscous_stress(&law, 1.0, mat3::diag([2.0, 2.0, 2.0]))) < 1e-12);
        // γ = −1 is the linear law.
        let linear = Law { exponent: -1.0, ..law };
        assert!((stress(&linear, mat3::diag([0.9, 1.0, 1.0]))[0][0] - 1e4 * 0.9 * -0.1).abs() < 1e-9);
    }
}
