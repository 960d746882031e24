//! Half precision in memory, `f32` in lanes.
//!
//! x86 converts in hardware from AVX2 on; the intrinsics are reached through `fearless_simd::kernel!`, whose token proves that
//! the instruction exists, so nothing here is unsafe. Elsewhere the loops of [`crate::half`] do the same, bit for bit.

use fearless_simd::{Level, Simd, SimdBase};

use super::Lanes;
use crate::half;

#[cfg(target_arch = "x86_64")]
mod x86 {
    use std::arch::x86_64::*;

    use fearless_simd::x86::{Avx2, Avx512};
    use fearless_simd::{SimdInto, f32x8, f32x16, u16x8, u16x16};

    fearless_simd::kernel!(
        #[inline(always)]
        pub(super) fn widen16(token: Avx512, a: u16x16<Avx512>) -> f32x16<Avx512> {
            _mm512_cvtph_ps(a.into()).simd_into(token)
        }
    );
    fearless_simd::kernel!(
        #[inline(always)]
        pub(super) fn narrow16(token: Avx512, a: f32x16<Avx512>) -> u16x16<Avx512> {
            _mm512_cvtps_ph::<{ _MM_FROUND_TO_NEAREST_INT | _MM_FROUND_NO_EXC }>(a.into()).simd_into(token)
        }
    );
    fearless_simd::kernel!(
        #[inline(always)]
        pub(super) fn widen8(token: Avx2, a: u16x8<Avx2>) -> f32x8<Avx2> {
            _mm256_cvtph_ps(a.into()).simd_into(token)
        }
    );
    fearless_simd::kernel!(
        #[inline(always)]
        pub(super) fn narrow8(token: Avx2, a: f32x8<Avx2>) -> u16x8<Avx2> {
            _mm256_cvtps_ph::<_MM_FROUND_TO_NEAREST_INT>(a.into()).simd_into(token)
        }
    );
}

/// The values of the first `LEN` halves of `a`.
#[inline(always)]
pub fn load<S: Simd>(s: S, a: &[u16]) -> Lanes<S> {
    let a = &a[..Lanes::<S>::LEN];
    match s.level() {
        #[cfg(target_arch = "x86_64")]
        Level::Avx512(t) => Lanes::<S>::from_slice(s, x86::widen16(t, fearless_simd::u16x16::from_slice(t, a)).as_slice()),
        #[cfg(target_arch = "x86_64")]
        Level::Avx2(t) => Lanes::<S>::from_slice(s, x86::widen8(t, fearless_simd::u16x8::from_slice(t, a)).as_slice()),
        _ => Lanes::<S>::from_fn(s, |i| half::to_f32(a[i])),
    }
}

/// Rounds to the first `LEN` halves of `a`; returns the values that they have.
#[inline(always)]
pub fn store<S: Simd>(v: Lanes<S>, s: S, a: &mut [u16]) -> Lanes<S> {
    let a = &mut a[..Lanes::<S>::LEN];
    match s.level() {
        #[cfg(target_arch = "x86_64")]
        Level::Avx512(t) => {
            let h = x86::narrow16(t, fearless_simd::f32x16::from_slice(t, v.as_slice()));
            h.store_slice(a);
            Lanes::<S>::from_slice(s, x86::widen16(t, h).as_slice())
        }
        #[cfg(target_arch = "x86_64")]
        Level::Avx2(t) => {
            let h = x86::narrow8(t, fearless_simd::f32x8::from_slice(t, v.as_slice()));
            h.store_slice(a);
            Lanes::<S>::from_slice(s, x86::widen8(t, h).as_slice())
        }
        _ => {
            for (h, x) in a.iter_mut().zip(v.as_slice()) {
                *h = half::from_f32(*x);
            }
            Lanes::<S>::from_fn(s, |i| half::to_f32(a[i]))
        }
    }
}

#[cfg(test)]
mod tests {
    use fearless_simd::dispatch;

    use super::*;

    #[inline(always)]
    fn widen<S: Simd>(s: S, a: &[u16]) -> Vec<u32> {
        a.chunks_exact(Lanes::<S>::LEN).flat_map(|c| load(s, c).as_slice().iter().map(|v| v.to_bits()).collect::<Vec<_>>()).collect()
    }

    #[inline(always)]
    fn narrow<S: Simd>(s: S, a: &[f32]) -> Vec<u16> {
        let mut out = vec![0; a.len()];
        for (c, o) in a.chunks_exact(Lanes::<S>::LEN).zip(out.chunks_exact_mut(Lanes::<S>::LEN)) {
            let kept = store(Lanes::<S>::from_slice(s, c), s, o);
            assert!(kept.as_slice().iter().zip(o.iter()).all(|(k, h)| k.to_bits() == half::to_f32(*h).to_bits()));
        }
        out
    }

    #[test]
    fn lanes_convert_like_the_scalar_code_bit_for_bit() {
        let best = Level::new();
        let levels = [Some(best), best.as_avx2().map(Level::Avx2), best.as_sse4_2().map(Level::Sse4_2)];
        let finite = |h: &u16| h & 0x7fff <= 0x7c00;
        // All halves but NaNs, padded with zeros to whole vectors.
        let mut halves: Vec<u16> = (0..=u16::MAX).filter(finite).collect();
        halves.resize(halves.len().next_multiple_of(16), 0);
        let bits: Vec<u32> = halves.iter().map(|h| half::to_f32(*h).to_bits()).collect();
        // Every exponent, with mantissas on both sides of every tie.
        let mut values = Vec::new();
        for exponent in 0..255u32 {
            for m in 0..2048u32 {
                for low in [0, 1, 0xfff, 0x1000, 0x1001, 0x1fff] {
                    values.push(f32::from_bits(exponent << 23 | (m & 0x3ff) << 13 | low | (m >> 10) << 31));
                }
            }
        }
        let rounded: Vec<u16> = values.iter().map(|v| half::from_f32(*v)).collect();
        for level in levels.into_iter().flatten() {
            assert!(dispatch!(level, s => widen(s, &halves)) == bits, "{level:?}");
            assert!(dispatch!(level, s => narrow(s, &values)) == rounded, "{level:?}");
        }
    }
}
