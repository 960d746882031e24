//! Extra samples where the skin has torn wide open (splatting.md §7.4, wide gaps): the particles that have come to light there,
//! with the direction in which they thin out as normal.

use megas_math::{Vec3, vec3};
use rayon::prelude::*;

use super::{Imls, Samples};
use crate::rows::Rows;

/// Weight of an extra sample.
const WEIGHT: f32 = 0.5;
/// Distance from the nearest skin sample, in spacings, beyond which a particle becomes a sample.
const FAR_FROM_SKIN: f32 = 5.0;

/// Samples at those of the `exposed` particles (indices into `particles`) that are farther than 5 d̄ from the skin, with normal
/// `−∇c/‖∇c‖` of the colour field `c(x) = Σ_k W(‖x−p_k‖)` of all `particles` (cubic spline with support `2Δ`, `spacing` = Δ).
/// Particles whose neighbours are all around have no normal and are left out.
pub fn gap_samples(skin: &Imls, particles: &[Vec3<f32>], exposed: &[u32], spacing: f32) -> Samples {
    let places: Vec<Vec3<f32>> = exposed.iter().map(|&j| particles[j as usize]).collect();
    let reach = FAR_FROM_SKIN * skin.spacing();
    let far: Vec<Vec3<f32>> = skin.distance_all(&places, reach).iter().zip(&places).filter(|(d, _)| d.is_none()).map(|(_, p)| *p).collect();
    let mut out = Samples::default();
    if far.is_empty() {
        return out;
    }
    let rows = Rows::new(particles, spacing);
    let normals: Vec<Vec3<f32>> = far.par_iter().with_min_len(64).map(|&x| thinning(&rows, x, spacing)).collect();
    for (x, n) in far.iter().zip(normals) {
        if n != [0.0; 3] {
            out.position.push(*x);
            out.normal.push(n);
            out.weight.push(WEIGHT);
        }
    }
    out
}

/// `−∇c/‖∇c‖`, zero where the particles are even.
fn thinning(rows: &Rows, x: Vec3<f32>, spacing: f32) -> Vec3<f32> {
    let (mut g, mut total) = ([0.0f32; 3], 0.0f32);
    rows.within(x, 2.0 * spacing, |_, d, d2| {
        let r = d2.sqrt();
        if r > 1e-6 * spacing {
            let w = spline_slope(r / spacing);
            g = vec3::add_scaled(g, d, w / r);
            total += w;
        }
    });
    // A half space gives about a third; noise in the middle of the body a few percent.
    if vec3::norm(g) > 0.1 * total { vec3::normalize_or(g, [0.0; 3]) } else { [0.0; 3] }
}

/// `−dW/dq` of the cubic spline with support 2, up to a factor.
fn spline_slope(q: f32) -> f32 {
    if q < 1.0 {
        3.0 * q - 2.25 * q * q
    } else if q < 2.0 {
        0.75 * (2.0 - q) * (2.0 - q)
    } else {
        0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::imls::ImlsSettings;

    #[test]
    fn a_bare_cap_of_a_ball_gets_samples_that_point_outwards() {
        // Particles fill the unit ball; the skin covers only z < 0.3.
        let delta = 0.1f32;
        let mut particles = Vec::new();
        for i in -10..=10 {
            for j in -10..=10 {
                for k in -10..=10 {
                    let p = [i as f32 * delta, j as f32 * delta, k as f32 * delta];
                    if vec3::norm(p) < 0.97 {
                        particles.push(p);
                    }
                }
            }
        }
        let mut skin = Samples::default();
        for d in megas_model::fibonacci_directions(4000).into_iter().filter(|d| d[2] < 0.3) {
            skin.position.push(d);
            skin.normal.push(d);
        }
        let Some(field) = Imls::new(&skin, &ImlsSettings::default()) else { panic!("a surface") };
        let exposed: Vec<u32> = (0..particles.len() as u32).filter(|&i| vec3::norm(particles[i as usize]) > 0.87).collect();
        let extra = gap_samples(&field, &particles, &exposed, delta);
        assert!(extra.position.len() > 50);
        for (x, n) in extra.position.iter().zip(&extra.normal) {
            assert!(x[2] > 0.3, "{x:?}");
            assert!(vec3::dot(*n, vec3::normalize_or(*x, [0.0; 3])) > 0.8, "{x:?} {n:?}");
        }
        // The middle of the cap was beyond the field; now it has a surface with the right normal.
        let top = [0.0, 0.0, 0.93];
        assert!(field.project(top, 0.2).is_none_or(|p| p.normal[2] < 0.99));
        skin.extend(&extra);
        let Some(whole) = Imls::new(&skin, &ImlsSettings { spacing: Some(field.spacing()), ..ImlsSettings::default() }) else {
            panic!("a surface")
        };
        let Some(p) = whole.project(top, 0.2) else { panic!("the gap is covered") };
        assert!(p.normal[2] > 0.97 && (p.position[2] - 0.93).abs() < 0.08, "{p:?}");
    }
}
