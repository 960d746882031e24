//! Heat in points and nodes: conservation, numerical diffusion, fronts, surfaces (simulation.md §8.1, §8.2).

mod cloud;
mod fronts;
mod surfaces;

use std::f64::consts::TAU;

use megas_math::rng::Rng;
use megas_sim::grid::Grid;
use megas_sim::source::{HeatSource, Motion, Region, Schedule, SourceKind};
use megas_sim::thermal::{AirModel, Audit, ThermalOptions, ThermalSolver, Transfer};

use crate::{Case, Outcome, Row, Tier};
use cloud::{Cloud, simple};

/// The cases of this file.
pub const CASES: &[Case] = &[
    Case::new("V01", "conservation of the thermal transfers", Tier::A, conservation),
    Case::new("V03", "numerical diffusion of the thermal transfers", Tier::B, numerical_diffusion),
    Case::new("V04", "blob of heat carried by moving material", Tier::B, moving_blob),
    Case::new("V06", "half space with a wall at fixed temperature", Tier::A, fronts::half_space),
    Case::new("V11", "one-phase Stefan problem on nodes", Tier::B, fronts::stefan_nodes),
    Case::new("V12", "one-phase Stefan problem with points", Tier::B, fronts::stefan_points),
    Case::new("V15", "slab of points cooled by a film", Tier::B, surfaces::slab),
    Case::new("V16", "lumped cooling of a ball by a film", Tier::A, surfaces::lumped_cooling),
    Case::new("V17", "surface area without a mesh", Tier::A, surfaces::area_measure),
];

/// Σ m h on the way to the nodes, through conduction and a source, and back.
fn conservation() -> Outcome {
    let grid = Grid { origin: [0.0; 3], spacing: 0.01, nodes: [32; 3] };
    let mut rng = Rng::new(1);
    let materials = [
        simple(1000.0, 1000.0, 0.5),
        megas_sim::material::Material {
            latent_heat: 2e5,
            solidus: 20.0,
            liquidus: 25.0,
            heat_capacity_liquid: 3000.0,
            ..simple(1000.0, 2000.0, 2.0)
        },
    ];
    let mut rows = Vec::new();
    for (label, transfer) in [
        ("Σmh, affine overwrite (= ΣE_i)", Transfer::AffineOverwrite),
        ("ΣmΔh, increments c_sub=0", Transfer::Increments { relaxation: 0.0 }),
        ("ΣmΔh, increments c_sub=2", Transfer::Increments { relaxation: 2.0 }),
    ] {
        let mut cloud = Cloud::default();
        for _ in 0..10_000 {
            let xi = std::array::from_fn(|_| rng.range(6.0, 26.0));
            let mass = rng.range(0.5, 2.0) * 1e-3;
            cloud.push(xi, mass, mass / 1000.0, rng.below(2) as u8, rng.range(-1e5, 4e5));
            if let Some(g) = cloud.grad_t.last_mut() {
                *g = std::array::from_fn(|_| rng.range(-500.0, 500.0) as f32);
            }
        }
        let source = HeatSource {
            name: String::new(),
            region: Region::Sphere { center: [0.16; 3], radius: 0.06 },
            kind: SourceKind::Power { watts: 1e4 },
            schedule: Schedule::default(),
            motion: Motion::default(),
        };
        let options = ThermalOptions { transfer, ..ThermalOptions::default() };
        let mut solver = ThermalSolver::new(grid, &materials, 0.0, options);
        let mut worst = 0.0f64;
        for step in 0..5 {
            let scale = cloud.mass.iter().zip(&cloud.h).map(|(m, h)| f64::from(*m) * h.abs()).sum::<f64>();
            let audit = cloud.step(&mut solver, 1.0, f64::from(step), std::slice::from_ref(&source), None);
            worst = worst.max((audit.after - audit.before - 1e4).abs() / scale);
        }
        rows.push(Row::new(format!("{label}, relative"), 0.0, worst, 1e-12));
    }
    rows.into()
}

/// A periodic bar of 128 × 4 × 4 nodes full of jittered points, 2 per cell and axis, with temperature `t(x)`.
fn bar(t: impl Fn(f64) -> f64, slope: impl Fn(f64) -> f64) -> Cloud {
    let mut rng = Rng::new(2);
    let mut cloud = Cloud::default();
    for i in 0..256 {
        for j in 0..8 {
            for k in 0..8 {
                let at = |n: i32, rng: &mut Rng| (f64::from(n) + 0.5 + rng.range(-0.3, 0.3)) * 0.5;
                let xi = [at(i, &mut rng), at(j, &mut rng), at(k, &mut rng)];
                cloud.push(xi, 0.125, 0.125, 0, t(xi[0]));
                if let Some(g) = cloud.grad_t.last_mut() {
                    *g = [slope(xi[0]) as f32, 0.0, 0.0];
                }
            }
        }
    }
    cloud
}

fn bar_solver(transfer: Transfer, k: f64) -> ThermalSolver {
    let grid = Grid { origin: [0.0; 3], spacing: 1.0, nodes: [128, 4, 4] };
    let options = ThermalOptions { transfer, air: AirModel::None, periodic: [true; 3], ..ThermalOptions::default() };
    ThermalSolver::new(grid, &[simple(1.0, 1.0, k)], 0.0, options)
}

/// Decay of a cosine under round trips alone: α_num Δt/Δx².
fn numerical_diffusion() -> Outcome {
    let k = TAU / 32.0;
    let measure = |transfer, trips: u32| {
        let mut cloud = bar(|x| (k * x).cos(), |x| -k * (k * x).sin());
        let mut solver = bar_solver(transfer, 1.0);
        let amplitude = |c: &Cloud| c.xi.iter().zip(&c.h).map(|(x, h)| (k * x[0]).cos() * h).sum::<f64>();
        let start = amplitude(&cloud);
        for _ in 0..trips {
            cloud.step(&mut solver, 0.0, 0.0, &[], None);
        }
        -(amplitude(&cloud) / start).ln() / (f64::from(trips) * k * k)
    };
    vec![
        Row::new("PIC overwrite, α Δt/Δx²", 0.249, measure(Transfer::PicOverwrite, 200), 0.005),
        Row::new("affine overwrite, α Δt/Δx²", 1.05e-3, measure(Transfer::AffineOverwrite, 2000), 0.25e-3),
        Row::new("increments c_sub=0, α Δt/Δx²", 0.0, measure(Transfer::Increments { relaxation: 0.0 }, 200), 1e-7),
    ]
    .into()
}

/// A Gaussian of heat in material that crosses 185 cells while it diffuses.
fn moving_blob() -> Outcome {
    let (sigma, alpha, steps, shift, centre) = (6.0f64, 1e-3, 5000, 0.037, 64.0);
    let profile = |x: f64, t: f64| {
        let variance = sigma * sigma + 2.0 * alpha * t;
        sigma / variance.sqrt() * (-(x - centre).powi(2) / (2.0 * variance)).exp()
    };
    let mut cloud = bar(|x| profile(x, 0.0), |_| 0.0);
    let mut solver = bar_solver(Transfer::default(), alpha);
    let home: Vec<f64> = cloud.xi.iter().map(|x| x[0]).collect();
    let variance = |c: &Cloud| {
        let sum = c.h.iter().sum::<f64>();
        home.iter().zip(&c.h).map(|(x, h)| (x - centre).powi(2) * h).sum::<f64>() / sum
    };
    let start = variance(&cloud);
    let mut total = Audit::default();
    for step in 0..steps {
        for (x, home) in cloud.xi.iter_mut().zip(&home) {
            x[0] = (home + shift * f64::from(step + 1)).rem_euclid(128.0);
        }
        let audit = cloud.step(&mut solver, 1.0, f64::from(step), &[], None);
        total = if step == 0 { audit } else { Audit { before: total.before, residual: total.residual + audit.residual, ..audit } };
    }
    let t = f64::from(steps);
    let error: f64 = home.iter().zip(&cloud.h).map(|(x, h)| (h - profile(*x, t)).powi(2)).sum();
    let size: f64 = home.iter().map(|x| profile(*x, t).powi(2)).sum();
    vec![
        Row::new("α_eff/α", 1.0, (variance(&cloud) - start) / (2.0 * alpha * t), 0.02),
        Row::new("relative L2 error", 0.0, (error / size).sqrt(), 2e-3),
        Row::new("energy drift, relative", 0.0, (total.after - total.before) / total.before, 1e-11),
    ]
    .into()
}

#[cfg(test)]
mod tests {
    use crate::assert_case;

    #[test]
    fn v01() {
        assert_case("V01");
    }

    #[test]
    fn v03() {
        assert_case("V03");
    }

    #[test]
    fn v04() {
        assert_case("V04");
    }

    #[test]
    fn v06() {
        assert_case("V06");
    }

    #[test]
    fn v11() {
        assert_case("V11");
    }

    #[test]
    fn v12() {
        assert_case("V12");
    }

    #[test]
    fn v15() {
        assert_case("V15");
    }

    #[test]
    fn v16() {
        assert_case("V16");
    }

    #[test]
    fn v17() {
        assert_case("V17");
    }
}
