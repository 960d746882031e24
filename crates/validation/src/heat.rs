//! Heat in points and nodes: conservation, numerical diffusion, fronts, surfaces (simulation.md §8.1, §8.2).

mod cloud;
mod contact;
mod fronts;
mod melting_time;
mod spheres;
mod surfaces;

use std::f64::consts::TAU;

use megas_math::rng::Rng;
use megas_sim::grid::Grid;
use megas_sim::source::{HeatSource, Motion, Schedule, Shape, SourceKind};
use megas_sim::thermal::{AirModel, Audit, ThermalOptions, ThermalSolver, Transfer};

use crate::{Case, Outcome, Plot, Row, Tier};
use cloud::Cloud;
pub(crate) use cloud::simple;

/// The cases of this file.
pub const CASES: &[Case] = &[
    Case::new("V01", "conservation of the thermal transfers", Tier::A, conservation)
        .proves("that no heat is lost between points and nodes, whatever the transfer")
        .setup("10⁴ points of two materials at random places, random enthalpies and gradients, a source of 10 kW, five exchanges")
        .formula("Σ m h after = Σ m h before + heat of the source"),
    Case::new("V03", "numerical diffusion of the thermal transfers", Tier::B, numerical_diffusion)
        .proves("that the transfer itself conducts no heat: material may move for ever without smearing its temperature")
        .setup("periodic bar of 128 × 4 × 4 cells, jittered points, T = cos(2πx/32Δx), no conduction, only round trips")
        .formula("α_{num} = −ln(amplitude)/(N k²): Δx²/4Δt for PIC, 10^{−3} for the affine transfer of the paper, 0 for increments"),
    Case::new("V04", "blob of heat carried by moving material", Tier::B, moving_blob)
        .proves("that heat travels with the material once, not twice, and diffuses at the right rate on the way")
        .setup("periodic bar full of material that crosses 185 cells in 5000 steps; a Gaussian of σ = 6Δx with α = 10^{−3} Δx²/Δt")
        .formula("T = σ/√(σ² + 2αt) · exp(−x²/2(σ² + 2αt)) in the frame of the material"),
    Case::new("V06", "half space with a wall at fixed temperature", Tier::A, fronts::half_space)
        .proves("the place of the wall (half a cell before the first node) and the diffusivity")
        .setup("128 nodes, T = 0 at first, wall at T_{w} = 1, K = 0.1, 4000 steps")
        .formula("T = erfc(x/√(4Kt)) = erfc(x/40)"),
    Case::new("V11", "one-phase Stefan problem on nodes", Tier::B, fronts::stefan_nodes)
        .proves("latent heat on the nodes")
        .setup("64 cells of solid at its melting point behind a wall at T_{w} = 1, L = 1/St, until the front is at 0.7 N")
        .formula("s = 2λ√(αt), λ e^{λ²} erf λ = St/√π"),
    Case::new("V12", "one-phase Stefan problem with points", Tier::B, fronts::stefan_points)
        .proves("the whole thermal chain: points, nodes, latent heat, and back")
        .setup("27 points per cell, bars of 20 and 40 cells, walls and materials as in V11")
        .formula("s = 2λ√(αt), λ e^{λ²} erf λ = St/√π"),
    Case::new("V13", "melting of ice behind a warm wall, in SI", Tier::B, fronts::ice)
        .proves("units, latent heat, different conductivities and heat capacities of solid and melt")
        .setup("slab of 20 mm in cells of 0.25 mm, ice behind a wall of 20 and 60 °C, ρ = 1000 kg/m³ in both phases, 100 s")
        .formula("Neumann: s = 2λ√(α_{l}t), k_{l}(T_{w} − T_{m})/√α_{l} e^{−λ²}/erf λ − k_{s}(T_{m} − T_{i})/√α_{s} e^{−λ²α_{l}/α_{s}}/erfc(λ√(α_{l}/α_{s})) = ρLλ√(πα_{l})"),
    Case::new("V14", "ball that melts inside its own melt", Tier::C, spheres::melting_ball)
        .proves("latent heat at a curved front that moves in three dimensions")
        .setup("solid ball of 12 cells at its melting point, melt around it held 1 K warmer on a sphere of 48 cells, St = 0.02")
        .formula("the same problem solved along the radius; without the heat of the melt ½R² − R³/3R_{o} would fall linearly, t_{melt} = ρLR_{0}²/(kΔT) (½ − R_{0}/3R_{o})"),
    Case::new("V15", "ball of points whose surface is held", Tier::B, spheres::held_ball)
        .proves("conduction up to a curved wall of fixed temperature")
        .setup("ball of 16 cells radius made of jittered points, all nodes outside at T = 0")
        .formula("T(r) = 2 Σ_{n} (−1)^{n+1} sin(nπr)/(nπr) e^{−n²π²Fo}"),
    Case::new("V15", "ball of points cooled by a film", Tier::B, spheres::filmed_ball)
        .proves("the film on a curved surface: area, depth correction, time units")
        .setup("ball of 16 cells radius made of jittered points, Bi = hR/k = 1 and 10")
        .formula("T(r) = Σ_{n} 4(sin ζ_{n} − ζ_{n} cos ζ_{n})/(2ζ_{n} − sin 2ζ_{n}) · sin(ζ_{n}r)/(ζ_{n}r) e^{−ζ²Fo}, 1 − ζ_{n} cot ζ_{n} = Bi"),
    Case::new("V15", "slab of points cooled by a film", Tier::B, surfaces::slab)
        .proves("the film: surface area, depth correction, time units")
        .setup("slab of 16 cells between two films, Bi = hL/k = 1 and 10, 8 and 27 points per cell, three offsets to the grid, Fo = 0.5")
        .formula("T(ξ) = Σ_{n} 2 sin ζ_{n}/(ζ_{n} + sin ζ_{n} cos ζ_{n}) · cos(ζ_{n}ξ) e^{−ζ²Fo}, ζ_{n} tan ζ_{n} = Bi"),
    Case::new("V16", "lumped cooling of a ball by a film", Tier::A, surfaces::lumped_cooling)
        .proves("the total surface area that the film sees")
        .setup("aluminium ball of 20 mm, 12 cells across, film of 20 W/m²K, 60 K above the air")
        .formula("T − T_{∞} = 60 K · e^{−t/τ}, τ = ρcR/3h = 405 s"),
    Case::new("V17", "surface area without a mesh", Tier::A, surfaces::area_measure)
        .proves("the area measure |∇φ|Δx on which films, torches and fluxes act")
        .setup("balls of 8 and 16 cells radius, cubes of 16 and 32 cells, straight and turned, made of jittered points")
        .formula("4πR² and 6a²"),
    Case::new("V17-light", "light on balls, and shadows", Tier::A, spheres::lit_balls)
        .proves("direction of the surface, visibility, and the power of suns and torches")
        .setup("balls of 12 cells radius made of jittered points, absorptivity 0.8, one of them in the shadow of the other")
        .formula("0.8 I π R²; a torch: 0.8 P times the share of its cone that the ball fills"),
    Case::new("V42", "melting times of balls of two sizes", Tier::B, melting_time::scaling)
        .proves("that latent heat, area and film together give the melting time, and how it grows with size")
        .setup("balls of 6 and 12 cells per radius (1 mm) at their melting point in air 20 K warmer, good conductors (Bi ≤ 0.012)")
        .formula("t = ρLR/(3h_{f}ΔT) while the melt stays; ratios 2, 4 and 2^{5/4} for h_{f} constant, ∝ 1/D and ∝ D^{−1/4}"),
    Case::new("V48", "two slabs with a contact resistance", Tier::B, contact::slabs)
        .proves("that heat between bodies that touch meets the resistance they are given, neither less by a short circuit nor more")
        .setup("slabs of 6 cells of 2 mm made of points: between walls 100 K apart, faces at five places of a cell, alike and with conductivities 1 : 4; and alone, one 100 K warmer, Bi = 0.02 and 1")
        .formula("q = ΔT/(L_{1}/k_{1} + R + L_{2}/k_{2}); ΔT = ΔT_{0} Σ_{n} 2 sin²ζ_{n}/(ζ_{n}(ζ_{n} + sin ζ_{n} cos ζ_{n})) e^{−ζ²Fo}, ζ_{n} tan ζ_{n} = Bi = 2L/kR, for Bi → 0 e^{−2t/RC}"),
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
            region: Shape::Sphere { center: [0.16; 3], radius: 0.06 }.into(),
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
    // The numerical diffusivity, and what is left of the amplitude after each of forty parts of the trips.
    let measure = |transfer, trips: u32| {
        let mut cloud = bar(|x| (k * x).cos(), |x| -k * (k * x).sin());
        let mut solver = bar_solver(transfer, 1.0);
        let amplitude = |c: &Cloud| c.xi.iter().zip(&c.h).map(|(x, h)| (k * x[0]).cos() * h).sum::<f64>();
        let start = amplitude(&cloud);
        let mut left = vec![[0.0, 1.0]];
        for n in 1..=trips {
            cloud.step(&mut solver, 0.0, 0.0, &[], None);
            if n % (trips / 40) == 0 {
                left.push([f64::from(n), amplitude(&cloud) / start]);
            }
        }
        (-(amplitude(&cloud) / start).ln() / (f64::from(trips) * k * k), left)
    };
    let pic = measure(Transfer::PicOverwrite, 200);
    let affine = measure(Transfer::AffineOverwrite, 2000);
    let increments = measure(Transfer::Increments { relaxation: 0.0 }, 200);
    let plot = Plot::new("what is left of a wave of 32 cells that nothing conducts", "round trips", "amplitude")
        .function("no diffusion", 0.0, 2000.0, |_| 1.0)
        .ours("PIC", pic.1)
        .ours("affine (the paper's)", affine.1)
        .ours("increments (ours)", increments.1);
    Outcome::from(vec![
        Row::new("PIC overwrite, α Δt/Δx²", 0.249, pic.0, 0.005),
        Row::new("affine overwrite, α Δt/Δx²", 1.05e-3, affine.0, 0.25e-3),
        Row::new("increments c_sub=0, α Δt/Δx²", 0.0, increments.0, 1e-7),
    ])
    .plot(plot)
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
    let mut shown: Vec<[f64; 2]> = home.iter().zip(&cloud.h).step_by(64).map(|(x, h)| [x - centre, *h]).collect();
    shown.retain(|p| p[0].abs() < 30.0);
    shown.sort_by(|a, b| a[0].total_cmp(&b[0]));
    let plot = Plot::new("the blob after 185 cells of travel, in the frame of the material", "x [cells]", "T")
        .function("at the start", -30.0, 30.0, |x| profile(centre + x, 0.0))
        .function("exact", -30.0, 30.0, |x| profile(centre + x, t))
        .ours("points", shown);
    Outcome::from(vec![
        Row::new("α_eff/α", 1.0, (variance(&cloud) - start) / (2.0 * alpha * t), 0.02),
        Row::new("relative L2 error", 0.0, (error / size).sqrt(), 2e-3),
        Row::new("energy drift, relative", 0.0, (total.after - total.before) / total.before, 1e-11),
    ])
    .plot(plot)
}

#[cfg(test)]
mod tests {
    use crate::assert_case;

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
    fn v13() {
        assert_case("V13");
    }

    #[test]
    #[ignore = "a minute; megas validate runs it"]
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

    #[test]
    fn v17_light() {
        assert_case("V17-light");
    }
}
