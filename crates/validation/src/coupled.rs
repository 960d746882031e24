//! Heat and mechanics together (simulation.md §8.5).

use megas_math::rng::Rng;
use megas_math::svd::{polar_rotation, svd};
use megas_math::{Mat3, mat3, quat};
use megas_sim::phase::scale_deviator;

use crate::{Case, Row, Tier};

/// The cases of this file.
pub const CASES: &[Case] = &[Case { id: "V39", name: "elastic energy at phase switches", tier: Tier::A, run: switch_energetics }];

/// Random strains melt and freeze: energy may only fall, volume and rotation stay.
fn switch_energetics() -> Vec<Row> {
    let (mu_s, mu_l, bulk) = (4e4, 1e4, 8e4);
    let mut rng = Rng::new(39);
    let energy = |f: Mat3<f64>, mu: f64| {
        let e = svd(f).s.map(f64::ln);
        let tr: f64 = e.iter().sum();
        let deviator: f64 = e.iter().map(|v| (v - tr / 3.0).powi(2)).sum();
        mu * deviator + 0.5 * bulk * tr * tr
    };
    let (mut gain, mut volume, mut rotation, mut rebase) = (f64::MIN, 0.0f64, 0.0f64, 0.0f64);
    for _ in 0..2000 {
        let (u, v) = (rng.direction(), rng.direction());
        let (u, v) = (quat::from_axis_angle(u, rng.range(0.0, 3.0)), quat::from_axis_angle(v, rng.range(0.0, 3.0)));
        let mut e: [f64; 3] = std::array::from_fn(|_| rng.range(-1.0, 1.0));
        let mean = (e[0] + e[1] + e[2]) / 3.0;
        e = e.map(|x| x - mean);
        let scale = rng.range(0.0, 0.1) / e.iter().map(|x| x * x).sum::<f64>().sqrt();
        let tr = rng.range(-0.02, 0.02);
        let s = e.map(|x| (x * scale + tr / 3.0).exp());
        let f = mat3::mul(mat3::mul(quat::to_mat3(u), mat3::diag(s)), mat3::transpose(quat::to_mat3(v)));
        // Melting keeps F and lowers μ.
        let (start, melted) = (energy(f, mu_s), energy(f, mu_l));
        gain = gain.max((melted - start) / start);
        for chi in [0.0, 0.5, 1.0] {
            let factor = chi * mu_l / mu_s;
            let (exact, _) = scale_deviator(f, factor);
            gain = gain.max((energy(exact, mu_s) - melted) / melted);
            // What the simulator stores is single precision.
            let single: Mat3<f32> = mat3::cast(f);
            let (frozen, b) = scale_deviator(single, factor as f32);
            let frozen: Mat3<f64> = mat3::cast(frozen);
            volume = volume.max((mat3::det(frozen) / mat3::det(f) - 1.0).abs());
            rotation = rotation.max(mat3::norm(mat3::sub(polar_rotation(frozen), polar_rotation(f))));
            rebase = rebase.max(mat3::norm(mat3::sub(mat3::mul(frozen, mat3::cast(b)), f)));
        }
    }
    vec![
        Row::new("largest relative gain of elastic energy (≤ 0)", 0.0, gain.max(0.0), 1e-9),
        Row::new("largest change of det F", 0.0, volume, 1e-6),
        Row::new("largest change of the rotation", 0.0, rotation, 1e-6),
        Row::new("F_after B − F_before", 0.0, rebase, 1e-6),
    ]
}

#[cfg(test)]
mod tests {
    #[test]
    fn v39() {
        crate::assert_case("V39");
    }
}
