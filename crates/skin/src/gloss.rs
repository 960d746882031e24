//! Photographed highlights on what melts.

use megas_math::{Vec3, sh};

/// How fast highlights go where it melts at once \[s\].
const TIME: f32 = 0.25;

/// Share of the highlights that is left `dt` seconds of film later: no more than is solid, and none comes back.
pub(crate) fn left(share: f32, liquid: f32, dt: f32) -> f32 {
    let target = share.min(1.0 - liquid);
    target + (share - target) * (-dt / TIME).exp()
}

/// Leaves `share` of the directional part of a Gaussian's `colours` (`[coefficient * 3 + channel]`); its mean over the directions that
/// see a surface with this outward `normal` at rest stays.
///
/// Directional colours are what the light of the photographs did on the surface as it was. The paper turns them with the material; but
/// a melt has no polish to turn along, and where it shines is a matter of its new shape and the light that stands still. The default
/// look gives it a sheen of its own.
pub fn dull(colours: &mut [f32], normal: Vec3<f32>, share: f32) {
    if share >= 1.0 {
        return;
    }
    let seen = sh::seen_dc(colours, normal);
    colours.iter_mut().for_each(|c| *c *= share);
    (0..3).for_each(|channel| colours[channel] += (1.0 - share) * seen[channel]);
}

#[cfg(test)]
mod tests {
    use super::*;
    use megas_math::{rng::Rng, vec3};
    use megas_model::fibonacci_directions;

    #[test]
    fn the_mean_over_what_sees_the_surface_stays() {
        let mut rng = Rng::new(5);
        for _ in 0..20 {
            let normal = rng.direction().map(|v| v as f32);
            // Bright enough that nothing is cut off at black.
            let mut colours: Vec<f32> = (0..48).map(|k| if k < 3 { 6.0 } else { rng.range(-0.3, 0.3) as f32 }).collect();
            let mean = |c: &[f32]| {
                let seen = fibonacci_directions(20_000).into_iter().filter(|d| vec3::dot(*d, normal) < 0.0);
                let (sum, weight) = seen.fold(([0.0f64; 3], 0.0), |(sum, weight), d| {
                    let w = -f64::from(vec3::dot(d, normal));
                    (vec3::add_scaled(sum, sh::colour(3, c, d).map(f64::from), w), weight + w)
                });
                sum.map(|s| s / weight)
            };
            let before = mean(&colours);
            dull(&mut colours, normal, 0.4);
            dull(&mut colours, normal, 0.0);
            assert!(colours[3..].iter().all(|c| *c == 0.0));
            let after = mean(&colours);
            assert!((0..3).all(|c| (before[c] - after[c]).abs() < 2e-3), "{before:?} {after:?}");
        }
        let mut colours = vec![0.3; 12];
        dull(&mut colours, [0.0, 0.0, 1.0], 1.0);
        assert!(colours.iter().all(|c| *c == 0.3));
    }

    #[test]
    fn highlights_go_with_the_melt_and_do_not_come_back() {
        let run = |share: f32, liquid: f32, frames: usize| (0..frames).fold(share, |s, _| left(s, liquid, 1.0 / 24.0));
        assert_eq!(run(1.0, 0.0, 100), 1.0);
        let soft = run(1.0, 0.4, 48);
        assert!((soft - 0.6).abs() < 0.01, "{soft}");
        assert_eq!(run(soft, 0.0, 48), soft);
        assert!(run(soft, 1.0, 48) < 0.01);
        // Several frames pass before it shows.
        assert!(left(1.0, 1.0, 1.0 / 24.0) > 0.8);
    }
}
