//! V44 and V46 (i): the gradients that move the splats, and gradients that nothing should survive (simulation.md §8.6).

use megas_math::rng::Rng;
use megas_math::{Mat3, mat3, quat, svd, vec3};
use megas_sim::grid::Grid;
use megas_sim::mechanics::{Mechanics, Settings};
use megas_sim::particles::{
    DRUCKER_PRAGER, FIXED_COROTATED, FLUID, HENCKY, NEO_HOOKEAN, NEO_HOOKEAN_SPLIT, Particles, TAIT_EXPONENT, VON_MISES,
};
use megas_sim::phase::scale_deviator;
use megas_sim::stretch::limit_total;

use crate::mechanics::{block, moduli};
use crate::{Case, Outcome, Row, Tier};

/// Cases of this file.
pub const CASES: &[Case] = &[
    Case::new("V44", "push-forward of the splats", Tier::A, push_forward)
        .proves("that rotation, shear and changes of reference reach the splats as they are")
        .setup("a stress-free block in simple shear to γ = 1; an elastic block thrown about for 1000 substeps; 100 changes of reference")
        .formula("stretches (1.618, 0.618) of the shear; ln det Fᴿ = ∫∇·v dt; FΣFᵀ does not change with the reference"),
    Case::new("V46", "gradients of every kind through every law", Tier::A, any_gradient)
        .proves("that no gradient, flat or inverted, makes a number that is none")
        .setup("rotations around stretches of −2 to 3, zeros among them, one substep, all seven laws")
        .formula("finite velocities and gradients"),
];

fn free() -> Settings {
    Settings { gravity: [0.0; 3], isolation: 0.0, ..Settings::default() }
}

/// Stretches of a block that has been sheared to γ = 1 without stress, as exported: the largest and smallest, averaged.
fn sheared() -> [f64; 2] {
    let grid = Grid { origin: [0.0; 3], spacing: 0.01, nodes: [48, 24, 24] };
    let mut p = block(&grid, [0.12, 0.08, 0.08], [0.2, 0.16, 0.16], 1000.0, 0.0, 0.0);
    for i in 0..p.len() {
        let x = p.position(i);
        p.set_velocity(i, [(x[2] - 0.08) as f32, 0.0, 0.0]);
        p.set_affine(i, [[0.0, 0.0, 1.0], [0.0; 3], [0.0; 3]]);
    }
    let mut m = Mechanics::new(&grid, free(), Vec::new());
    for _ in 0..20 {
        m.run(&mut p, 20, 2.5e-3);
    }
    let mut sum = [0.0; 2];
    for i in 0..p.len() {
        let s = svd::svd(mat3::cast::<f32, f64>(limit_total(p.total(i), false, 0.04).0)).s;
        sum = [sum[0] + s[0] / p.len() as f64, sum[1] + s[2] / p.len() as f64];
    }
    sum
}

/// Largest difference between ln det Fᴿ and ∫ tr C dt, and between F and Fᴿ, of an elastic block in random motion.
fn thrown_about() -> (f64, f64) {
    let grid = Grid { origin: [0.0; 3], spacing: 0.01, nodes: [26, 26, 26] };
    let (shear, bulk) = moduli(1e5, 0.3);
    let mut p = block(&grid, [0.1, 0.1, 0.1], [0.15, 0.15, 0.15], 1000.0, shear, bulk);
    let mut rng = Rng::new(44);
    let spin = rng.direction();
    for i in 0..p.len() {
        let arm = vec3::sub(p.position(i), [0.125; 3]);
        let turn = vec3::cross(vec3::scale(spin, 10.0), arm);
        p.set_velocity(i, std::array::from_fn(|a| (turn[a] + rng.range(-0.05, 0.05)) as f32));
    }
    let mut m = Mechanics::new(&grid, free(), Vec::new());
    let dt = 5e-5;
    let mut growth = vec![0.0; p.len()];
    for _ in 0..1000 {
        m.run(&mut p, 1, dt);
        for i in 0..p.len() {
            growth[p.id[i] as usize] += dt * f64::from(mat3::trace(p.affine(i)));
        }
    }
    let (mut volume, mut elastic) = (0.0f64, 0.0f64);
    for i in 0..p.len() {
        let total: Mat3<f64> = mat3::cast(p.total(i));
        volume = volume.max((mat3::det(total).ln() - growth[p.id[i] as usize]).abs());
        elastic = elastic.max(mat3::norm(mat3::sub(total, mat3::cast(p.elastic(i)))));
    }
    (volume, elastic)
}

/// Largest relative change of a splat's covariance over 100 changes of reference, and of a rotated one's eigenvalues.
fn references() -> (f64, f64) {
    let mut rng = Rng::new(45);
    let (mut worst, mut turned) = (0.0f64, 0.0f64);
    for _ in 0..50 {
        let q = quat::to_mat3::<f64>(quat::from_axis_angle(rng.direction(), rng.range(0.0, 3.0)));
        let mut f: Mat3<f64> = mat3::mul(q, mat3::diag([1.1, 0.95, 1.02]));
        let mut sigma = mat3::diag([1.0, 0.04, 0.01]);
        let seen = mat3::congruence(f, sigma);
        for _ in 0..100 {
            let (after, b) = scale_deviator(f, rng.range(0.7, 1.0));
            sigma = mat3::congruence(b, sigma);
            f = after;
        }
        worst = worst.max(mat3::norm(mat3::sub(mat3::congruence(f, sigma), seen)) / mat3::norm(seen));
        let rotation: Mat3<f32> = mat3::cast(q);
        let exported = limit_total(rotation, true, 0.04).0;
        turned = turned.max(f64::from(mat3::norm(mat3::sub(exported, rotation))));
    }
    (worst, turned)
}

fn push_forward() -> Outcome {
    let [longest, shortest] = sheared();
    let (volume, elastic) = thrown_about();
    let (reference, turned) = references();
    let golden = 0.5 * (1.0 + 5f64.sqrt());
    vec![
        Row::new("simple shear, γ = 1: longest stretch", golden, longest, 1e-4),
        Row::new("simple shear, γ = 1: shortest stretch", golden - 1.0, shortest, 1e-4),
        Row::new("1000 substeps: |ln det Fᴿ − ∫∇·v dt|", 0.0, volume, 1e-3),
        Row::new("1000 substeps: |F − Fᴿ| of an elastic body", 0.0, elastic, 1e-4),
        Row::new("100 changes of reference: change of the covariance", 0.0, reference, 1e-6),
        Row::new("a rotation after the limiter: change", 0.0, turned, 1e-6),
    ]
    .into()
}

fn any_gradient() -> Outcome {
    let grid = Grid { origin: [0.0; 3], spacing: 0.01, nodes: [26, 26, 26] };
    let (shear, bulk) = moduli(1e5, 0.3);
    let mut rng = Rng::new(46);
    let mut rows = Vec::new();
    let laws = [
        (HENCKY, "StVK–Hencky"),
        (FIXED_COROTATED, "fixed corotated"),
        (FLUID, "fluid"),
        (NEO_HOOKEAN, "neo-Hookean"),
        (NEO_HOOKEAN_SPLIT, "neo-Hookean, split"),
        (VON_MISES, "von Mises"),
        (DRUCKER_PRAGER, "Drucker–Prager"),
    ];
    for (law, name) in laws {
        let mut p: Particles = block(&grid, [0.08; 3], [0.18; 3], 1000.0, shear, bulk);
        p.law.fill(law);
        p.viscosity.fill(1.0);
        for i in 0..p.len() {
            match law {
                FLUID => (p.exponent[i], p.law_constant[i]) = (TAIT_EXPONENT as f32, 1.001),
                VON_MISES => (p.yield_stress[i], p.law_constant[i]) = (100.0, 1e4),
                DRUCKER_PRAGER => p.law_constant[i] = 0.3,
                _ => p.yield_stress[i] = if i % 2 == 0 { f32::INFINITY } else { 100.0 },
            }
            let turn = |rng: &mut Rng| quat::to_mat3::<f64>(quat::from_axis_angle(rng.direction(), rng.range(0.0, 3.0)));
            let s: [f64; 3] = std::array::from_fn(|_| if rng.below(8) == 0 { 0.0 } else { rng.range(-2.0, 3.0) });
            let (u, v) = (turn(&mut rng), turn(&mut rng));
            p.set_elastic(i, mat3::cast(mat3::mul(mat3::mul(u, mat3::diag(s)), mat3::transpose(v))));
        }
        let mut m = Mechanics::new(&grid, free(), Vec::new());
        let report = m.run(&mut p, 20, 1e-6);
        let finite = (0..p.len()).all(|i| p.velocity(i).iter().chain(p.displacement_gradient(i).iter().flatten()).all(|v| v.is_finite()));
        rows.push(Row::new(format!("{name}: everything finite (1 = yes)"), 1.0, f64::from(u8::from(finite)), 0.0));
        rows.push(Row::new(format!("{name}: velocities that were no numbers"), 0.0, report.repairs.non_finite as f64, 0.0));
    }
    rows.into()
}

#[cfg(test)]
mod tests {
    #[test]
    fn v44() {
        crate::assert_case("V44");
    }
}
