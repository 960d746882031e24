//! Simulated air around moving, melting material: energy audit, plume, threads, restarts.

use megas_model::Points;
use megas_sim::air::{SimulatedAir, Storage};
use megas_sim::collider::{Collider, Shape, Thermal};
use megas_sim::grid::Grid;
use megas_sim::material::Material;
use megas_sim::phase::PhaseOptions;
use megas_sim::solver::{Checkpoint, Coupling, FrameReport, Solver, SolverConfig};
use megas_sim::thermal::{AirModel, ThermalOptions};

const AMBIENT: f64 = 293.15;
const DX: f64 = 0.005;

fn wax() -> Material {
    Material {
        name: "wax".into(),
        density: 900.0,
        shear_modulus: 2e4,
        bulk_modulus: 4e4,
        heat_capacity_solid: 2100.0,
        heat_capacity_liquid: 2300.0,
        conductivity_solid: 0.24,
        conductivity_liquid: 0.15,
        latent_heat: 2e4,
        solidus: 318.0,
        liquidus: 325.0,
        ..Material::default()
    }
}

/// A cube of 6³ cells at `t` kelvin, its lowest point at `low` cells.
fn cube(t: f32, low: f64) -> Points {
    let mut points = Points::default();
    for i in 0..12 {
        for j in 0..12 {
            for k in 0..12 {
                let at = |first: f64, n: i32| ((first + 0.25 + 0.5 * f64::from(n)) * DX) as f32;
                points.position.push([at(9.0, i), at(9.0, j), at(low, k)].map(Into::into));
                points.volume.push((0.125 * DX.powi(3)) as f32);
                points.temperature.push(t);
                points.normal.push([0.0; 3]);
                points.material.push(0);
                points.object.push(1);
                points.flags.push(0);
                points.id.push(points.id.len() as u32);
            }
        }
    }
    points
}

fn config(air: SimulatedAir, plate: f64, mechanics: bool) -> SolverConfig {
    let mut floor = Collider::new(Shape::HalfSpace { point: [0.0, 0.0, 5.2 * DX], normal: [0.0, 0.0, 1.0] });
    floor.thermal = Thermal::Fixed { kelvin: plate, keyframes: Vec::new() };
    SolverConfig {
        grid: Grid { origin: [0.0; 3], spacing: DX, nodes: [24, 24, 33] },
        materials: vec![wax()],
        sources: Vec::new(),
        colliders: vec![floor],
        gravity: [0.0, 0.0, -9.81],
        ambient: AMBIENT,
        thermal: ThermalOptions { air: AirModel::Simulated(air), ..ThermalOptions::default() },
        phase: PhaseOptions::default(),
        frame_dt: 0.02,
        coupling_step: 0.002,
        courant: 0.4,
        mechanics,
        bounds: Default::default(),
        coupling: Default::default(),
    }
}

fn advance(solver: &mut Solver) -> FrameReport {
    let report = solver.advance_frame(&|| false).expect("a step").expect("not stopped");
    solver.export();
    report
}

#[test]
fn the_audit_closes_while_a_hot_cube_falls_onto_a_plate() {
    let mut solver = Solver::new(config(SimulatedAir::default(), 340.0, true), &cube(330.0, 9.0)).expect("a solver");
    for _ in 0..8 {
        let report = advance(&mut solver);
        let audit = report.audit.expect("an audit");
        let scale = audit.before.abs().max(audit.after.abs()).max(audit.heats());
        assert!(audit.residual.abs() < 1e-5 * scale, "{audit:?}");
        assert_eq!(audit.capped, 0);
    }
    let total = solver.totals().audit.expect("an audit");
    // The cube pushed air away on its way down, the plate heated the air, and some left.
    assert!(total.displaced != 0.0 && total.wall > 0.0 && total.air > 0.0, "{total:?}");
}

#[test]
fn warm_air_rises_over_a_plate() {
    let mut solver = Solver::new(config(SimulatedAir::default(), 353.15, false), &cube(AMBIENT as f32, 9.0)).expect("a solver");
    for _ in 0..25 {
        advance(&mut solver);
    }
    let air = solver.air().expect("simulated air");
    // Beside the cube, over the plate.
    let near: f64 = air.temperature([4, 12, 6]);
    let above: f64 = air.temperature([4, 12, 12]);
    assert!(near > 5.0 && near < 60.0 && above < near, "{near} {above}");
    let fastest = (0..33).map(|k| air.flow([18, 12, k]).1[2]).fold(f64::MIN, f64::max);
    assert!(fastest > 1e-4, "{fastest}");
}

/// The step of the lattice follows the speed of what moves: long over a plate, where it needs no thicker air, shorter around a cube
/// that falls.
#[test]
fn the_step_of_the_air_follows_its_speed() {
    let run = |plume_steps, mechanics| {
        let air = SimulatedAir { plume_steps, ..SimulatedAir::default() };
        let setup = SolverConfig { coupling_step: 0.004, ..config(air, 353.15, mechanics) };
        let mut solver = Solver::new(setup, &cube(AMBIENT as f32, 16.0)).expect("a solver");
        let steps: Vec<_> = (0..8)
            .map(|_| {
                advance(&mut solver);
                solver.air_step().expect("simulated air")
            })
            .collect();
        let audit = solver.totals().audit.expect("an audit");
        assert!(audit.residual.abs() < 1e-6 * audit.heats(), "{audit:?}");
        steps
    };
    // A plume starts with steps for air that rises through the whole box, about 0.5 m/s; the real one is slower.
    for plume in [0, 10] {
        let steps = run(plume, false);
        assert!(steps.iter().all(|s| s.steps == 1 && s.thickened == 1.0), "{steps:?}");
    }
    let steps: Vec<u32> = run(0, true).iter().map(|s| s.steps).collect();
    assert!(steps[0] <= 2 && steps.windows(2).any(|w| w[1] > w[0]), "{steps:?}");
}

/// What rounding does to a melting cube over a hot plate, and to its audit.
#[test]
fn half_precision_changes_little_around_a_melting_cube() {
    let run = |storage| {
        let mut solver =
            Solver::new(config(SimulatedAir { storage, ..SimulatedAir::default() }, 353.15, false), &cube(AMBIENT as f32, 9.0))
                .expect("a solver");
        for _ in 0..30 {
            advance(&mut solver);
        }
        let total = solver.totals().audit.expect("an audit");
        println!("{storage:?}: {total:?}");
        total
    };
    let (single, half) = (run(Storage::F32), run(Storage::F16));
    assert!((half.air / single.air - 1.0).abs() < 0.01, "{half:?} {single:?}");
    assert!(half.residual.abs() < 1e-7 * half.wall && single.residual.abs() < 1e-7 * half.wall, "{half:?}");
}

#[test]
fn still_air_takes_what_a_cube_loses() {
    let air = SimulatedAir { convection: false, closed: true, ..SimulatedAir::default() };
    let setup = SolverConfig { coupling_step: 0.02, frame_dt: 0.2, ..config(air, AMBIENT, false) };
    let mut solver = Solver::new(setup, &cube(310.0, 12.0)).expect("a solver");
    for _ in 0..30 {
        advance(&mut solver);
    }
    let total = solver.totals().audit.expect("an audit");
    assert!(total.residual.abs() < 1e-5 * total.before.abs(), "{total:?}");
    // A ball of the same surface: q″ = k ΔT (1/R + 1/√(παt)). The nodes that a point reaches lie up to a cell and a half outside
    // the surface, and what is on them has one temperature: the air sees a body that is wider by that much.
    let (area, time, alpha) = (6.0 * (6.0 * DX).powi(2), 6.0f64, 0.026 / 1200.0);
    let radius = (area / (4.0 * std::f64::consts::PI)).sqrt() + 1.25 * DX;
    let area = 4.0 * std::f64::consts::PI * radius * radius;
    let expected = 0.026 * 16.85 * area * (time / radius + 2.0 * (time / (std::f64::consts::PI * alpha)).sqrt());
    let ratio = (total.air - total.wall) / expected;
    assert!((0.8..1.4).contains(&ratio), "{ratio}");
}

#[test]
fn threads_and_restarts_change_no_bit() {
    for storage in [Storage::F32, Storage::F16] {
        threads_and_restarts(storage, 1);
        threads_and_restarts(storage, 2);
    }
}

/// What a checkpoint holds.
fn snapshot(solver: &Solver) -> (Checkpoint, Vec<Vec<u8>>) {
    let mut arrays: Vec<Vec<u8>> = solver.particles().arrays().into_iter().map(|(_, b)| b.to_vec()).collect();
    arrays.push(bytemuck::cast_slice(&solver.air_state()).to_vec());
    (solver.checkpoint(), arrays)
}

/// All bits of points and air.
fn bits(solver: &Solver) -> (u64, Vec<u32>) {
    (solver.particles().state_hash(), solver.air_state().iter().map(|v| v.to_bits()).collect())
}

/// Substeps ten times too long, so that some frames are repeated with shorter ones after the first steps of their air.
#[test]
fn a_repeated_frame_starts_with_the_air_of_its_start() {
    const STEPS: u32 = 10;
    let setup = SolverConfig { courant: 4.0, coupling_step: 0.004, frame_dt: 0.04, ..config(SimulatedAir::default(), 350.0, true) };
    let points = cube(320.0, 7.0);
    let mut solver = Solver::new(setup.clone(), &points).expect("a solver");
    let (mut repeated, mut adapted) = (0, 0);
    for _ in 0..5 {
        let (mut start, arrays) = snapshot(&solver);
        let lattice = solver.air_step();
        let report = advance(&mut solver);
        assert!(report.audit.expect("an audit").closes(1e-5), "{report:?}");
        if report.rollbacks != 2 {
            continue;
        }
        repeated += 1;
        adapted += u32::from(lattice != solver.air_step());
        // The same from the start of the frame, careful from the first step on.
        let (left, factor) = solver.checkpoint().cautious;
        start.cautious = (left + STEPS, factor);
        let mut careful = Solver::new(setup.clone(), &points).expect("a solver");
        careful.restore(start, &arrays).expect("a checkpoint that fits");
        assert_eq!(advance(&mut careful).rollbacks, 0);
        assert!(bits(&careful) == bits(&solver), "the air or the points are others");
        assert_eq!(careful.checkpoint().cautious, solver.checkpoint().cautious);
    }
    assert!(repeated >= 2 && adapted >= 2, "{repeated} frames repeated, {adapted} with another step of the lattice at their end");
}

/// Exchanges of changing length: the lattice follows.
#[test]
fn air_exchanges_heat_after_every_substep() {
    let coupling = Coupling { heat_every_substep: true, ..Coupling::default() };
    let setup = SolverConfig { coupling, coupling_step: 0.001, frame_dt: 0.002, ..config(SimulatedAir::default(), 350.0, true) };
    let points = cube(320.0, 7.0);
    let run = |restart: Option<usize>| {
        let mut solver = Solver::new(setup.clone(), &points).expect("a solver");
        solver.set_object_velocity(1, [0.0, 0.0, -0.5]);
        for k in 0..8 {
            if restart == Some(k) {
                let (checkpoint, arrays) = snapshot(&solver);
                solver = Solver::new(setup.clone(), &points).expect("a solver");
                solver.restore(checkpoint, &arrays).expect("a checkpoint that fits");
            }
            let audit = advance(&mut solver).audit.expect("an audit");
            assert!(audit.closes(1e-5), "{audit:?}");
        }
        assert!(solver.totals().audit.expect("an audit").air > 0.0);
        bits(&solver)
    };
    assert!(run(None) == run(Some(5)), "a restart differs");
}

/// The lower half of a cube is another, hotter body, with and without a resistance between them.
#[test]
fn bodies_with_a_contact_resistance_share_the_air() {
    let mut points = cube(300.0, 5.0);
    for i in 0..points.id.len() {
        (points.object[i], points.temperature[i]) = if i % 12 < 6 { (1, 316.0) } else { (2, 300.0) };
    }
    let run = |threads: usize, resistance: f64| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a thread pool");
        pool.install(|| {
            let air = SimulatedAir { wall_film: 10.0, emissivity: 0.9, ..SimulatedAir::default() };
            let setup = SolverConfig { coupling_step: 0.01, frame_dt: 0.2, ..config(air, 350.0, false) };
            let mut solver = Solver::new(setup, &points).expect("a solver");
            solver.set_contact_resistance(2, resistance);
            let upper = |solver: &Solver| {
                let p = solver.particles();
                (0..p.len()).filter(|i| p.object[*i] == 2).map(|i| p.enthalpy[i]).sum::<f64>()
            };
            let start = upper(&solver);
            for _ in 0..10 {
                let audit = advance(&mut solver).audit.expect("an audit");
                assert!(audit.closes(1e-6), "{audit:?}");
            }
            (upper(&solver) - start, bits(&solver))
        })
    };
    let (joined, (parted, one)) = (run(1, 0.0).0, run(1, 10.0));
    // Nearly all of the heat of the upper half comes from the lower one.
    assert!(parted.abs() < 0.1 * joined, "{parted} of {joined}");
    assert!(one == run(3, 10.0).1, "threads");
}

fn threads_and_restarts(storage: Storage, flow_ratio: usize) {
    let air = SimulatedAir { wall_film: 10.0, emissivity: 0.9, plume_steps: 5, storage, flow_ratio, ..SimulatedAir::default() };
    let setup = config(air, 350.0, true);
    let points = cube(320.0, 7.0);
    let run = |threads: usize, restart: Option<usize>| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a thread pool");
        pool.install(|| {
            let mut solver = Solver::new(setup.clone(), &points).expect("a solver");
            for k in 0..6 {
                if restart == Some(k) {
                    let (checkpoint, arrays) = snapshot(&solver);
                    solver = Solver::new(setup.clone(), &points).expect("a solver");
                    solver.restore(checkpoint, &arrays).expect("a checkpoint that fits");
                }
                advance(&mut solver);
            }
            bits(&solver)
        })
    };
    let one = run(1, None);
    assert!(one == run(2, None), "two threads differ from one");
    assert!(one == run(2, Some(3)), "a restart differs");
}

/// With the flow on cells of twice the size a hot plate warms a cube and its air about as much, and the books
/// close.
#[test]
fn a_coarse_flow_warms_alike() {
    let setup = |flow_ratio| config(SimulatedAir { flow_ratio, plume_steps: 5, ..SimulatedAir::default() }, 353.15, true);
    let warmed = |flow_ratio| {
        let mut solver = Solver::new(setup(flow_ratio), &cube(AMBIENT as f32, 9.0)).expect("a solver");
        (0..25).for_each(|_| _ = advance(&mut solver));
        solver
    };
    let (fine, coarse) = (warmed(1), warmed(2));
    let [a, b] = [&fine, &coarse].map(|s| s.totals().audit.expect("an audit"));
    // Its lattice is thicker here, 2.8 instead of 1.4 times as viscous as real air, and fluxes go with the fourth root of that.
    let thick = [&fine, &coarse].map(|s| s.air_step().expect("simulated air").thickened);
    assert!((thick[1] / thick[0] - 2.0).abs() < 1e-9, "{thick:?}");
    assert!((b.wall / a.wall - 0.9).abs() < 0.05 && (b.air / a.air - 0.9).abs() < 0.05, "{a:?} {b:?}");
    assert!(b.residual.abs() < 1e-6 * b.heats(), "{b:?}");
    let air = coarse.air().expect("simulated air");
    let fastest = (0..33).map(|k| air.flow([18, 12, k]).1[2]).fold(f64::MIN, f64::max);
    assert!(fastest > 1e-4, "{fastest}");
}
