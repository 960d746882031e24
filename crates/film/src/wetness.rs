//! What a liquid film does to a rough surface: it darkens, because light that the ground scatters is caught under the film and
//! gets another chance to be absorbed (Lekner and Dorf 1988, "Why some things are darker when wet", Applied Optics 27), and it
//! mirrors what is bright around.

/// Refractive index of the film: water, syrup and molten chocolate lie between 1.33 and 1.46.
const INDEX: f32 = 1.38;

/// Share of diffuse light under a film of index `n` that the film's surface sends back: mean Fresnel reflectance from inside,
/// fit of Egan and Hilgeman 1979.
fn diffuse_reflectance_inside(n: f32) -> f32 {
    -1.440 / (n * n) + 0.710 / n + 0.668 + 0.0636 * n
}

/// Reflectance at right angles.
fn reflectance_at_normal(n: f32) -> f32 {
    ((n - 1.0) / (n + 1.0)).powi(2)
}

/// Albedo of a surface with the albedo `dry` under a film: `(1 − R)(1 − p)·a/(1 − p·a)`, R the film's reflectance at right angles
/// and p the share of scattered light that the film sends back.
pub fn wet_albedo(dry: f32) -> f32 {
    let a = dry.clamp(0.0, 1.0);
    let p = diffuse_reflectance_inside(INDEX);
    (1.0 - reflectance_at_normal(INDEX)) * (1.0 - p) * a / (1.0 - p * a)
}

/// Light that a film with the unit normal `n` mirrors to a viewer in the direction `v` (unit, from the surface): Schlick's
/// Fresnel factor times a soft bright sky around `up` with a window in the direction `lamp`. Both vary slowly over the
/// directions, so that normals that tremble do not glitter.
pub fn sheen(n: [f32; 3], v: [f32; 3], up: [f32; 3], lamp: [f32; 3]) -> f32 {
    use megas_math::vec3::{add_scaled, dot, scale};
    let cos = dot(n, v);
    if cos.is_nan() || cos <= 0.0 {
        return 0.0;
    }
    let r = add_scaled(scale(v, -1.0), n, 2.0 * cos);
    let f0 = reflectance_at_normal(INDEX);
    // At grazing angles the normal of a splat says little: the last part of the rise is left out.
    let fresnel = f0 + (1.0 - f0) * (1.0 - cos.max(0.25)).powi(5);
    let t = ((dot(r, lamp) - 0.80) / 0.19).clamp(0.0, 1.0);
    let window = t * t * (3.0 - 2.0 * t);
    fresnel * (0.5 * dot(r, up).max(0.0) + 6.0 * window)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wet_things_are_darker_grey_ones_most() {
        // Water on sand: 0.35 dry becomes about 0.22 (Lekner and Dorf's figure 3, n = 1.33).
        assert!((diffuse_reflectance_inside(1.33) - 0.473).abs() < 0.01);
        let mut last = 0.0;
        for k in 1..=10 {
            let a = 0.1 * k as f32;
            let w = wet_albedo(a);
            assert!(w < a && w > last && w > 0.4 * a, "{a} {w}");
            last = w;
        }
        assert!((0.18..0.24).contains(&wet_albedo(0.35)) && wet_albedo(1.0) > 0.96 && wet_albedo(0.0) == 0.0);
    }

    #[test]
    fn sheen_needs_a_mirror_that_faces_viewer_and_lamp() {
        let up = [0.0, 0.0, 1.0];
        let behind = sheen([0.0, 0.0, -1.0], up, up, up);
        let facing = sheen(up, up, up, up);
        let aside = sheen([1.0, 0.0, 0.0], [1.0, 0.0, 0.0], up, up);
        assert!(behind == 0.0 && facing > 0.1 && facing < 0.3 && aside < 0.01, "{facing} {aside}");
        // Turning the normal by a degree changes nothing to speak of.
        let (s, c) = 1f32.to_radians().sin_cos();
        let most = (0..90)
            .map(|k| {
                let (a, b) = (k as f32).to_radians().sin_cos();
                let n = [a, 0.0, b];
                let m = [a * c + b * s, 0.0, b * c - a * s];
                (sheen(n, up, up, up) - sheen(m, up, up, up)).abs()
            })
            .fold(0.0, f32::max);
        assert!(most < 0.02, "{most}");
    }
}
