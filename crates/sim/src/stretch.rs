//! The limited total deformation gradient that splats may follow (simulation.md §7.3).

use megas_math::{Mat3, mat3, svd};

/// Bounds of an exported stretch. The design's lower bound is 0.5, but a long kernel that stood on a leg must be able to lie
/// flat in the puddle that the leg becomes: with 0.5 it sticks out as a needle.
const STRETCH: (f64, f64) = (0.2, 2.0);
/// Bounds of an exported volume ratio.
const VOLUME: (f64, f64) = (0.5, 2.0);
/// Memory of old stretch in a melt \[s\].
const RELAXATION_TIME: f64 = 1.0;

/// Limits `total` for export. Returns `(exported, stored)`: a solid keeps its unlimited gradient, a liquid stores the limited
/// one with its elongation faded over `frame_dt` seconds. Compression is kept (unlike in the design): were it to fade, a kernel
/// that the flow has pressed flat would grow back to its old length, straight out of a surface that no longer moves.
pub fn limit_total(total: Mat3<f32>, liquid: bool, frame_dt: f64) -> (Mat3<f32>, Mat3<f32>) {
    let d = svd::svd(mat3::cast::<f32, f64>(total));
    let clamp = |s: f64| s.clamp(STRETCH.0, STRETCH.1);
    let mut s = d.s.map(|v| clamp(v.abs()));
    let volume = (d.s[0] * d.s[1] * d.s[2]).clamp(VOLUME.0, VOLUME.1);
    let correction = (volume / (s[0] * s[1] * s[2])).cbrt();
    s = s.map(|v| clamp(v * correction));
    let exported = mat3::cast(d.with_values(s));
    let stored = if liquid {
        let fade = (-frame_dt / RELAXATION_TIME).exp();
        mat3::cast(d.with_values(s.map(|v| if v > 1.0 { v.powf(fade) } else { v })))
    } else {
        total
    };
    (exported, stored)
}

#[cfg(test)]
mod tests {
    use super::*;
    use megas_math::{quat, rng::Rng};

    #[test]
    fn moderate_stretch_is_exported_as_it_is() {
        let mut rng = Rng::new(4);
        for _ in 0..100 {
            let r = quat::to_mat3::<f64>(std::array::from_fn(|_| rng.range(-1.0, 1.0)));
            let f = mat3::cast(mat3::mul(r, mat3::diag([1.6, 0.8, 0.9])));
            let (out, kept) = limit_total(f, false, 0.04);
            assert!(mat3::norm(mat3::sub(out, f)) < 1e-5);
            assert_eq!(kept, f);
        }
    }

    #[test]
    fn needles_are_bounded_and_liquids_forget() {
        let f = mat3::diag([8.0f32, 0.5, 0.25]);
        let (out, kept) = limit_total(f, true, 1.0);
        let s = svd::svd(out).s;
        assert!(s[0] <= 2.0 + 1e-5 && s[2] >= 0.2 - 1e-5);
        let k = svd::svd(kept).s;
        assert!((k[0].ln() / s[0].ln() - (-1f32).exp()).abs() < 1e-3);
        assert!((k[2] - s[2]).abs() < 1e-5, "a kernel that was pressed flat stays flat");
        // Inverted and broken gradients still export something finite.
        for bad in [mat3::diag([1.0f32, 1.0, -1.0]), [[0.0; 3]; 3]] {
            assert!(limit_total(bad, true, 0.04).0.iter().flatten().all(|v| v.is_finite()));
        }
    }
}
