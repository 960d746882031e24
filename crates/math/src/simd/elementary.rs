//! Exponential and logarithm of `f32` lanes, accurate to 2 ulp, including near the identity where strains live.

use fearless_simd::{Bytes, Select, Simd, SimdBase, SimdFloat, SimdInt};

use super::Lanes;

const LN2_HI: f32 = 0.693_359_375;
const LN2_LO: f32 = -2.121_944_4e-4;

/// `(2ⁿ, eʳ − 1)` with `x = n ln 2 + r`, `|r| ≤ ½ ln 2`; `x` is clamped to where `2ⁿ` is a normal number.
#[inline(always)]
fn split_exp<S: Simd>(s: S, x: Lanes<S>) -> (Lanes<S>, Lanes<S>) {
    let c = |v| Lanes::<S>::splat(s, v);
    let x = x.max(c(-87.0)).min(c(88.0));
    let n = (x * c(std::f32::consts::LOG2_E)).round_ties_even();
    let r = n.mul_add(c(-LN2_LO), n.mul_add(c(-LN2_HI), x));
    let q = r.mul_add(c(1.0 / 5040.0), c(1.0 / 720.0));
    let q = q.mul_add(r, c(1.0 / 120.0)).mul_add(r, c(1.0 / 24.0)).mul_add(r, c(1.0 / 6.0)).mul_add(r, c(0.5));
    let p = (r * r).mul_add(q, r);
    let bits: S::i32s = (n + c(127.0)).to_int::<S::i32s>() << 23;
    (bits.bitcast(), p)
}

/// `eˣ`; saturates at e⁻⁸⁷ and e⁸⁸.
#[inline(always)]
pub fn exp<S: Simd>(s: S, x: Lanes<S>) -> Lanes<S> {
    let (scale, p) = split_exp(s, x);
    scale.mul_add(p, scale)
}

/// `eˣ − 1` without cancellation near 0.
#[inline(always)]
pub fn exp_m1<S: Simd>(s: S, x: Lanes<S>) -> Lanes<S> {
    let (scale, p) = split_exp(s, x);
    scale.mul_add(p, scale - 1.0)
}

/// `ln` of `u`, where `f` replaces `u − 1` wherever `u` lies in `[√½, √2)`.
#[inline(always)]
fn ln_with<S: Simd>(s: S, u: Lanes<S>, near_one: Option<Lanes<S>>) -> Lanes<S> {
    let c = |v| Lanes::<S>::splat(s, v);
    // Bits of √½: subtracting them before taking the exponent centres the mantissa on 1.
    const SQRT_HALF: i32 = 0x3f35_04f3;
    let bits: S::i32s = u.bitcast();
    let shifted = bits + (0x3f80_0000 - SQRT_HALF);
    let exponent = (shifted >> 23) - 127;
    let k: Lanes<S> = exponent.to_float();
    let mantissa: Lanes<S> = ((shifted & 0x007f_ffff) + SQRT_HALF).bitcast();
    let mut f = mantissa - 1.0;
    if let Some(e) = near_one {
        f = k.simd_eq(c(0.0)).select(e, f);
    }
    // ln(1+f) = f − f²/2 + t (f²/2 + R(t²)), t = f/(2+f): the error of the division only touches the small part.
    let t = f / (f + 2.0);
    let z = t * t;
    let half = f * f * 0.5;
    let r = z * z.mul_add(c(2.0 / 9.0), c(2.0 / 7.0)).mul_add(z, c(2.0 / 5.0)).mul_add(z, c(2.0 / 3.0));
    let tail = k.mul_add(c(LN2_LO), t * (half + r));
    k.mul_add(c(LN2_HI), f - (half - tail))
}

/// `ln x` of normal positive `x`.
#[inline(always)]
pub fn ln<S: Simd>(s: S, x: Lanes<S>) -> Lanes<S> {
    ln_with(s, x, None)
}

/// `ln(1 + x)` for `x > −1`, accurate relative to `x` however small.
#[inline(always)]
pub fn ln_1p<S: Simd>(s: S, x: Lanes<S>) -> Lanes<S> {
    ln_with(s, x + 1.0, Some(x))
}

/// `xᵖ` of normal positive `x`; saturates at e⁻⁸⁷ and e⁸⁸.
#[inline(always)]
pub fn powf<S: Simd>(s: S, x: Lanes<S>, p: Lanes<S>) -> Lanes<S> {
    exp(s, p * ln(s, x))
}

#[cfg(test)]
mod tests {
    use fearless_simd::{Level, dispatch};

    use super::*;

    fn map(x: &[f32], f: impl Fn(&mut Vec<f32>, &[f32])) -> Vec<f32> {
        let mut out = Vec::new();
        f(&mut out, x);
        out
    }

    #[inline(always)]
    fn apply<S: Simd>(s: S, out: &mut Vec<f32>, x: &[f32], f: impl Fn(S, Lanes<S>) -> Lanes<S>) {
        for chunk in x.chunks(Lanes::<S>::LEN) {
            let v = Lanes::<S>::from_fn(s, |i| chunk.get(i).copied().unwrap_or(0.5));
            out.extend_from_slice(&f(s, v).as_slice()[..chunk.len()]);
        }
    }

    fn check(name: &str, x: &[f32], got: &[f32], exact: impl Fn(f64) -> f64, tol: f64) {
        assert_eq!(x.len(), got.len());
        for (&x, &y) in x.iter().zip(got) {
            let r = exact(f64::from(x));
            assert!((f64::from(y) - r).abs() <= tol * r.abs(), "{name}({x:e}) = {y:e}, expected {r:e}");
        }
    }

    #[test]
    fn exponential_and_logarithm_follow_double_precision() {
        let level = Level::new();
        let mut x = vec![0.0f32, 1e-30, -1e-30];
        for i in 0..4000 {
            let m = 1e-9f32 * 1.006f32.powi(i);
            if m < 80.0 {
                x.extend([m, -m]);
            }
        }
        let got = map(&x, |o, x| dispatch!(level, s => apply(s, o, x, exp)));
        check("exp", &x, &got, f64::exp, 2e-7);
        let got = map(&x, |o, x| dispatch!(level, s => apply(s, o, x, exp_m1)));
        check("exp_m1", &x, &got, f64::exp_m1, 3e-7);
        let y: Vec<f32> = x.iter().copied().filter(|&v| v > -0.999).collect();
        let got = map(&y, |o, x| dispatch!(level, s => apply(s, o, x, ln_1p)));
        check("ln_1p", &y, &got, f64::ln_1p, 2.5e-7);
        let y: Vec<f32> = x.iter().copied().filter(|&v| v > 1e-37).collect();
        let got = map(&y, |o, x| dispatch!(level, s => apply(s, o, x, ln)));
        check("ln", &y, &got, f64::ln, 2.5e-7);
    }

    #[inline(always)]
    fn power<S: Simd>(s: S, v: Lanes<S>, p: f32) -> Lanes<S> {
        powf(s, v, Lanes::<S>::splat(s, p))
    }

    #[test]
    fn power_matches() {
        let level = Level::new();
        let x: Vec<f32> = (1..500).map(|i| i as f32 * 0.01).collect();
        for p in [0.2f32, 0.5, 2.0, 5.0] {
            let got = map(&x, |o, x| dispatch!(level, s => apply(s, o, x, |s, v| power(s, v, p))));
            check("powf", &x, &got, |v| v.powf(f64::from(p)), 2e-6);
        }
    }
}
