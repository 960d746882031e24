//! V27: a ball that spins freely (simulation.md §8.4).

use megas_math::{Mat3, mat3, vec3};
use megas_sim::grid::Grid;
use megas_sim::mechanics::{Mechanics, Settings};
use megas_sim::particles::Particles;

use crate::mechanics::{block, moduli};
use crate::{Case, Outcome, Plot, Row, Tier};

/// Cases of this file.
pub const CASES: &[Case] = &[Case::new("V27", "spinning ball", Tier::B, spinning_ball)
    .proves("the affine transfer and the update of F under large rotations")
    .setup("ball of 8 cells per radius, E = 10⁶ Pa, ω = 10 rad/s about an oblique axis, two turns without gravity")
    .formula("constant momenta; the rotation of polar(F) is ωt")];

/// Angular velocity \[rad/s\].
const OMEGA: f64 = 10.0;

/// Linear and angular momentum about the origin, with the affine part `Σ m (Δx²/4) ε : Cᵀ`.
fn momenta(p: &Particles) -> ([f64; 3], [f64; 3]) {
    let d = 0.25 * p.grid().spacing.powi(2);
    let (mut linear, mut angular) = ([0.0; 3], [0.0; 3]);
    for i in 0..p.len() {
        let m = f64::from(p.mass[i]);
        let v = p.velocity(i).map(f64::from);
        let c: Mat3<f64> = mat3::cast(p.affine(i));
        let spin = [c[2][1] - c[1][2], c[0][2] - c[2][0], c[1][0] - c[0][1]];
        linear = vec3::add_scaled(linear, v, m);
        angular = vec3::add_scaled(angular, vec3::add_scaled(vec3::cross(p.position(i), v), spin, d), m);
    }
    (linear, angular)
}

fn spinning_ball() -> Outcome {
    let (dx, cells) = (0.01, 8.0);
    let n = 2 * cells as usize + 12;
    let grid = Grid { origin: [0.0; 3], spacing: dx, nodes: [n; 3] };
    let center = [0.5 * (n - 1) as f64 * dx; 3];
    let (shear, bulk) = moduli(1e6, 0.3);
    let radius = cells * dx;
    let all = block(&grid, center.map(|c| c - radius), center.map(|c| c + radius), 1000.0, shear, bulk);
    let inside: Vec<usize> = (0..all.len()).filter(|&i| vec3::norm(vec3::sub(all.position(i), center)) < radius).collect();
    let mut p = Particles::blank(&grid, inside.len());
    let axis = [0.6, 0.0, 0.8];
    let w = vec3::scale(axis, OMEGA);
    let spin = [[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]];
    // A drift shows lost linear momentum, which would be zero otherwise.
    let drift = [0.01, 0.0, 0.0];
    for (k, &i) in inside.iter().enumerate() {
        let x = all.position(i);
        p.set_position(k, x);
        p.id[k] = k as u32;
        let v = vec3::add(drift, mat3::mul_vec(spin, vec3::sub(x, center)));
        p.set_velocity(k, vec3::cast(v));
        p.set_affine(k, mat3::cast(spin));
    }
    p.volume.fill(all.volume[0]);
    p.mass.fill(all.mass[0]);
    p.shear.fill(shear as f32);
    p.bulk.fill(bulk as f32);
    let (linear, angular) = momenta(&p);
    let mut m = Mechanics::new(&grid, Settings { gravity: [0.0; 3], ..Settings::default() }, Vec::new());
    let end = 2.0 * std::f64::consts::TAU / OMEGA;
    let chunks = 32;
    let mut history = vec![[0.0, 1.0]];
    let along = |l: [f64; 3]| vec3::dot(l, angular) / vec3::dot(angular, angular);
    // The centre moves with the drift: its own angular momentum about the origin is constant.
    for k in 1..=chunks {
        let step = m.time_step(&p, end / f64::from(chunks));
        m.run(&mut p, step.steps, step.dt);
        history.push([f64::from(k) / f64::from(chunks) * 2.0, along(momenta(&p).1)]);
    }
    let (linear_after, angular_after) = momenta(&p);
    let r = megas_math::quat::to_mat3(megas_math::quat::from_axis_angle(axis, OMEGA * end));
    let (mut mean, mut worst) = ([[0.0; 3]; 3], 0.0f64);
    for i in 0..p.len() {
        let f = mat3::add(mat3::identity(), mat3::cast::<f32, f64>(p.displacement_gradient(i)));
        let rotation = megas_math::svd::polar_rotation(f);
        worst = worst.max(angle(mat3::mul(mat3::transpose(r), rotation)));
        mean = mat3::add(mean, mat3::scale(rotation, 1.0 / p.len() as f64));
    }
    let behind = angle(mat3::mul(mat3::transpose(r), megas_math::svd::polar_rotation(mean)));
    let plot = Plot::new("angular momentum", "turns", "L / L_{0}").function("exact", 0.0, 2.0, |_| 1.0).ours("ours", history);
    let mass: f64 = p.mass.iter().map(|&m| f64::from(m)).sum();
    let momentum = vec3::norm(vec3::sub(linear_after, linear)) / (mass * OMEGA * radius);
    Outcome::from(vec![
        Row::new("loss of angular momentum", 0.0, 1.0 - along(angular_after), 0.01),
        Row::new("change of linear momentum / MωR", 0.0, momentum, 1e-6),
        Row::new("mean rotation of polar(F) off ωt after two turns [°]", 0.0, behind, 1.0),
        Row::new("the same, worst point [°]", 0.0, worst, 5.0),
    ])
    .plot(plot)
}

/// Angle of a rotation \[°\].
fn angle(r: Mat3<f64>) -> f64 {
    (0.5 * (r[0][0] + r[1][1] + r[2][2] - 1.0)).clamp(-1.0, 1.0).acos().to_degrees()
}
