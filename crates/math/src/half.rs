//! Half precision as storage: IEEE 754 binary16 ↔ `f32`, rounded to nearest, ties to even.

/// Exponent of infinities and NaNs, in place.
const SPECIAL: u32 = 0x7c00;

/// The value of a half; exact.
#[inline(always)]
pub fn to_f32(half: u16) -> f32 {
    // 2¹¹²: the exponent of an f32 counts from −127, that of a half from −15. The product makes subnormal halves normal.
    let scale = f32::from_bits((127 + 112) << 23);
    let magnitude = u32::from(half & 0x7fff);
    let bits = (f32::from_bits(magnitude << 13) * scale).to_bits();
    let bits = if magnitude >= SPECIAL { (magnitude << 13) | 0x7f80_0000 } else { bits };
    f32::from_bits(bits | (u32::from(half) & 0x8000) << 16)
}

/// The nearest half, ties to even; infinity beyond 65 520, subnormal below 2⁻¹⁴. A NaN stays one, quiet.
#[inline(always)]
pub fn from_f32(value: f32) -> u16 {
    let bits = value.to_bits();
    let sign = (bits >> 16) & 0x8000;
    let a = bits & 0x7fff_ffff;
    let magnitude = if a > 0x7f80_0000 {
        SPECIAL | 0x200 | (a >> 13) & 0x3ff
    } else if a >= 0x477f_f000 {
        SPECIAL
    } else if a < 0x3880_0000 {
        // Between ½ and 1 an f32 counts in steps of 2⁻²⁴, as a subnormal half does: the addition rounds.
        (f32::from_bits(a) + 0.5).to_bits() - 0.5f32.to_bits()
    } else {
        (a + 0xfff + ((a >> 13) & 1) - (112 << 23)) >> 13
    };
    (sign | magnitude) as u16
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The definition of binary16 in double precision.
    fn value(half: u16) -> f64 {
        let (e, m) = (i32::from(half >> 10 & 31), f64::from(half & 0x3ff));
        let magnitude = match e {
            0 => m * 2f64.powi(-24),
            31 if m == 0.0 => f64::INFINITY,
            31 => f64::NAN,
            _ => (1.0 + m / 1024.0) * 2f64.powi(e - 15),
        };
        if half & 0x8000 != 0 { -magnitude } else { magnitude }
    }

    #[test]
    fn all_halves_have_their_value_and_come_back() {
        for h in 0..=u16::MAX {
            let (got, exact) = (to_f32(h), value(h));
            if exact.is_nan() {
                assert!(got.is_nan() && to_f32(from_f32(got)).is_nan(), "{h:#x}");
                continue;
            }
            assert_eq!(f64::from(got), exact, "{h:#x}");
            assert_eq!(got.is_sign_negative(), h & 0x8000 != 0);
            assert_eq!(from_f32(got), h, "{h:#x}");
        }
    }

    /// Distance decides, and the even mantissa where it does not. `low` and `low + 1` enclose |x|.
    fn nearest(x: f32, low: u16) -> u16 {
        let next = if low + 1 == 0x7c00 { 65536.0 } else { value(low + 1) };
        let (below, above) = (f64::from(x) - value(low), next - f64::from(x));
        if below < above || (below == above && low & 1 == 0) { low } else { low + 1 }
    }

    #[test]
    fn values_round_to_the_nearest_half_and_ties_to_even() {
        for low in 0..0x7c00u16 {
            let next = if low + 1 == 0x7c00 { 65536.0 } else { value(low + 1) };
            let middle = (0.5 * (value(low) + next)) as f32;
            let quarter = (0.75 * value(low) + 0.25 * next) as f32;
            for x in [middle, middle.next_down(), middle.next_up(), quarter, to_f32(low).next_up()] {
                let expected = nearest(x, low);
                assert_eq!(from_f32(x), expected, "{x:e}");
                assert_eq!(from_f32(-x), expected | 0x8000, "{x:e}");
            }
        }
        assert_eq!(from_f32(f32::MAX), 0x7c00);
        assert_eq!(from_f32(f32::NEG_INFINITY), 0xfc00);
        assert_eq!(from_f32(f32::MIN_POSITIVE), 0);
    }
}
