//! Heat and mechanics together (simulation.md §8.5).

use megas_math::rng::Rng;
use megas_math::svd::{polar_rotation, svd};
use megas_math::{Mat3, mat3, quat};
use megas_model::{FLAG_INTERNAL, Points};
use megas_sim::air::SimulatedAir;
use megas_sim::collider::{Collider, Shape};
use megas_sim::grid::Grid;
use megas_sim::material::{Law, Material, PhaseMode, Rheology};
use megas_sim::phase::{PhaseOptions, scale_deviator};
use megas_sim::solver::{Coupling, Solver, SolverConfig};
use megas_sim::source::{Film, HeatSource, Motion, Region, Schedule, SourceKind};
use megas_sim::thermal::{AirModel, ThermalOptions};

use crate::{Case, Outcome, Plot, Row, Tier};

/// The cases of this file.
pub const CASES: &[Case] = &[
    Case::new("V39", "elastic energy at phase switches", Tier::A, switch_energetics)
        .proves("that melting and freezing create no energy, no volume and no rotation")
        .setup("2000 random strains, |e| ≤ 0.1, |tr| ≤ 0.02, melted (μ falls) and frozen (μ rises, share χ of the stress kept)")
        .formula("Δψ ≤ 0, det F and UV^{T} unchanged, F_{after} B = F_{before}"),
    Case::new("V40", "a cube melts and freezes again", Tier::B, melt_and_refreeze)
        .proves("latent heat both ways, hysteresis, and an energy balance that closes")
        .setup("cube of 16³ cells, heated by a fixed power for 2 s until all is liquid, cooled by a film until all is solid")
        .formula("heat in = m (c_{s} 10 K + L + c_{l} 10 K); plateaus of length L between solidus and liquidus"),
    Case::new("V45", "threads and restarts change no bit", Tier::B, determinism)
        .proves("that a film does not depend on the machine's cores nor on being interrupted")
        .setup("cube of 8³ cells melting under a lamp, 200 coupling steps with 1, 2 and 4 threads, and through a checkpoint")
        .formula("equal hashes of the state"),
];

/// A material that melts at 300 K over one kelvin.
pub(crate) fn wax() -> Material {
    let (shear_modulus, bulk_modulus) = Material::moduli(4e4, 0.3);
    Material {
        name: "test wax".into(),
        law: Law::Hencky,
        density: 900.0,
        shear_modulus,
        bulk_modulus,
        solid_yield_stress: 2e3,
        melt_shear_modulus: 0.3 * bulk_modulus,
        melt: Rheology { yield_stress: 5.0, consistency: 1.0, index: 0.8 },
        arrhenius_k: 0.0,
        softening: 0.5,
        reference_temperature: 280.0,
        heat_capacity_solid: 2000.0,
        heat_capacity_liquid: 2200.0,
        conductivity_solid: 0.25,
        conductivity_liquid: 0.2,
        latent_heat: 2e5,
        solidus: 299.5,
        liquidus: 300.5,
        phase_mode: PhaseMode::Mushy,
        ..Material::default()
    }
}

/// A cube of `cells`³ cells of 2 mm with eight points each, on a floor.
pub(crate) fn cube(cells: usize, temperature: f32) -> (Grid, Points, Collider) {
    let spacing = 2e-3;
    let nodes = cells + 2 * 10;
    let grid = Grid { origin: [0.0; 3], spacing, nodes: [nodes; 3] };
    let mut points = Points::default();
    let n = 2 * cells;
    for i in 0..n * n * n {
        let site = [i / (n * n), i / n % n, i % n];
        points.position.push(site.map(|s| (10.0 + 0.5 * (s as f64 + 0.5)) * spacing));
        points.volume.push((spacing / 2.0).powi(3) as f32);
        points.temperature.push(temperature);
        points.normal.push([0.0; 3]);
        points.material.push(0);
        points.object.push(1);
        points.flags.push(FLAG_INTERNAL);
        points.id.push(i as u32);
    }
    let floor = Collider { offset: 0.0, ..Collider::new(Shape::HalfSpace { point: [0.0, 0.0, 10.0 * spacing], normal: [0.0, 0.0, 1.0] }) };
    (grid, points, floor)
}

pub(crate) fn config(grid: Grid, material: Material, sources: Vec<HeatSource>) -> SolverConfig {
    SolverConfig {
        grid,
        materials: vec![material],
        sources,
        colliders: Vec::new(),
        gravity: [0.0, 0.0, -9.81],
        ambient: 293.15,
        thermal: ThermalOptions::default(),
        phase: PhaseOptions::default(),
        frame_dt: 0.02,
        coupling_step: 2e-3,
        courant: 0.4,
        mechanics: true,
        bounds: Default::default(),
        coupling: Coupling::default(),
    }
}

/// V40: heating by power until all is liquid, cooling by a film until all is solid: the heat balance closes, the enthalpy
/// rises by c ΔT and L as it should, and no point changes phase more than once on the way up and once on the way down.
fn melt_and_refreeze() -> Outcome {
    let material = Material { conductivity_solid: 200.0, conductivity_liquid: 200.0, ..wax() };
    let (grid, points, _) = cube(16, 290.0);
    let mass: f64 = points.volume.iter().map(|&v| f64::from(v) * material.density).sum();
    let need = mass * (material.latent_heat + 2000.0 * 10.0 + 2200.0 * 10.0);
    let (up, down) = (2.0, 4.0);
    let on = |interval: [f64; 2]| Schedule { intervals: vec![interval], ..Schedule::default() };
    let area = 6.0 * (16.0f64 * 2e-3).powi(2);
    let source =
        |kind, interval| HeatSource { name: String::new(), region: Region::All, kind, schedule: on(interval), motion: Motion::default() };
    let film = Film { ambient: 250.0, coefficient: 2.5 * need / (area * 45.0 * down), emissivity: 0.0 };
    let sources = vec![
        source(SourceKind::Power { watts: need / up }, [0.0, up]),
        HeatSource { region: Region::Surface(None), ..source(SourceKind::Film(film), [up, up + down]) },
    ];
    let setup = SolverConfig { mechanics: false, frame_dt: 0.1, coupling_step: 0.01, ..config(grid, material.clone(), sources) };
    let Ok(mut solver) = Solver::new(setup, &points) else { return vec![Row::new("the solver starts", 1.0, 0.0, 0.0)].into() };
    let mut phase = vec![0u8; points.len()];
    let mut switches = vec![0u32; points.len()];
    let (mut liquid, mut heat) = (Vec::new(), 0.0);
    let (mut trace, mut history) = (Vec::new(), Vec::new());
    while solver.time() < up + down - 1e-9 {
        let Ok(Some(report)) = solver.advance_frame(&|| false) else { return vec![Row::new("the frame completes", 1.0, 0.0, 0.0)].into() };
        heat += report.audit.map_or(0.0, |a| a.source);
        liquid.push(report.liquid_fraction);
        let frame = solver.export();
        // Mean temperature over mean enthalpy above the solid at the start.
        let mean = frame.temperature.iter().map(|t| f64::from(*t)).sum::<f64>() / frame.temperature.len() as f64;
        let enthalpy: f64 = solver.particles().enthalpy.iter().sum::<f64>() / points.len() as f64;
        trace.push([enthalpy / 1e3, mean]);
        history.push([solver.time(), report.liquid_fraction]);
        for (i, &p) in frame.phase.iter().enumerate() {
            let molten = u8::from(p == 1);
            switches[i] += u32::from(molten != phase[i]);
            phase[i] = molten;
        }
    }
    let highest = liquid.iter().copied().fold(0.0, f64::max);
    let most = switches.iter().copied().max().unwrap_or(0);
    let turn = (up / 0.1) as usize;
    let down_trace = trace.split_off(turn.min(trace.len()));
    let (h_s, h_l) = (2.0 * (299.5 - 293.15), 2.0 * (299.5 - 293.15) + 200.0 + 2.1);
    let law = [[2.0 * (250.0 - 293.15), 250.0], [h_s, 299.5], [h_l, 300.5], [h_l + 2.2 * 12.0, 312.5]].to_vec();
    let plot = Plot::new("temperature over enthalpy", "mean enthalpy [kJ/kg]", "mean temperature [K]")
        .reference("material law", law)
        .ours("heating", trace)
        .ours("cooling", down_trace);
    let melt = Plot::new("share that is liquid", "t [s]", "f_{l}").ours("cube", history);
    Outcome::from(vec![
        Row::relative("heat brought in [J]", need, heat, 1e-6),
        Row::new("liquid fraction when hottest", 1.0, highest, 1e-9),
        Row::new("liquid fraction at the end", 0.0, liquid.last().copied().unwrap_or(1.0), 1e-9),
        Row::new("phase switches of a point", 2.0, f64::from(most), 0.0),
        Row::new("relative residual of the energy audit", 0.0, solver.totals().energy_residual(), 1e-4),
    ])
    .plot(plot)
    .plot(melt)
}

/// V45: a melting, slumping cube, 200 coupling steps with 1, 2 and 4 threads, and once more through a checkpoint.
fn determinism() -> Outcome {
    let (grid, points, floor) = cube(8, 299.0);
    let lamp = HeatSource {
        name: String::new(),
        region: Shape::Sphere { center: [0.022, 0.028, 0.034], radius: 0.014 }.into(),
        kind: SourceKind::Flux { watts_per_m2: 4e6 },
        schedule: Schedule::default(),
        motion: Motion::default(),
    };
    let setup = SolverConfig { colliders: vec![floor], ..config(grid, wax(), vec![lamp]) };
    let frames = 20;
    let flowing =
        SolverConfig { thermal: ThermalOptions { air: AirModel::Simulated(SimulatedAir::default()), ..setup.thermal }, ..setup.clone() };
    let run = |setup: &SolverConfig, frames: u64, threads: usize, restart: Option<u64>| -> Option<(u64, f64)> {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().ok()?;
        pool.install(|| {
            let mut solver = Solver::new(setup.clone(), &points).ok()?;
            let mut liquid = 0.0;
            for k in 0..frames {
                if restart == Some(k) {
                    let mut arrays: Vec<Vec<u8>> = solver.particles().arrays().into_iter().map(|(_, b)| b.to_vec()).collect();
                    let air = solver.air_state();
                    if !air.is_empty() {
                        arrays.push(air.iter().flat_map(|v| v.to_ne_bytes()).collect());
                    }
                    let checkpoint = solver.checkpoint();
                    solver = Solver::new(setup.clone(), &points).ok()?;
                    solver.restore(checkpoint, &arrays).ok()?;
                }
                liquid = solver.advance_frame(&|| false).ok()??.liquid_fraction;
                solver.export();
            }
            let air = solver
                .air_state()
                .iter()
                .fold(solver.particles().state_hash(), |h, v| (h ^ u64::from(v.to_bits())).wrapping_mul(0x0000_0100_0000_01b3));
            Some((air, liquid))
        })
    };
    let one = run(&setup, frames, 1, None);
    let airy = run(&flowing, 6, 1, None);
    let differs = |other: Option<(u64, f64)>, one: Option<(u64, f64)>| f64::from(u8::from(one.is_none() || other != one));
    vec![
        Row::new("liquid fraction at the end (some, not all)", 0.5, one.map_or(0.0, |o| o.1), 0.45),
        Row::new("two threads differ from one", 0.0, differs(run(&setup, frames, 2, None), one), 0.0),
        Row::new("four threads differ from one", 0.0, differs(run(&setup, frames, 4, None), one), 0.0),
        Row::new("a restart at frame 9 differs", 0.0, differs(run(&setup, frames, 2, Some(9)), one), 0.0),
        Row::new("simulated air: two threads differ from one", 0.0, differs(run(&flowing, 6, 2, None), airy), 0.0),
        Row::new("simulated air: a restart at frame 3 differs", 0.0, differs(run(&flowing, 6, 2, Some(3)), airy), 0.0),
    ]
    .into()
}

/// Random strains melt and freeze: energy may only fall, volume and rotation stay.
fn switch_energetics() -> Outcome {
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
    .into()
}

#[cfg(test)]
mod tests {
    #[test]
    fn v40() {
        crate::assert_case("V40");
    }

    #[test]
    fn v45() {
        crate::assert_case("V45");
    }

    #[test]
    fn v39() {
        crate::assert_case("V39");
    }
}
