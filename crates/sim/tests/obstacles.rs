//! Obstacles that move, come and go, and take part in the heat.

#[path = "common/block.rs"]
mod block;

use megas_model::Points;
use megas_sim::collider::{Collider, Conductor, Shape, Thermal};
use megas_sim::grid::Grid;
use megas_sim::material::{Material, Rheology};
use megas_sim::phase::PhaseOptions;
use megas_sim::schedule::{Motion, PoseKey};
use megas_sim::solver::{Coupling, Solver, SolverConfig};
use megas_sim::thermal::ThermalOptions;

const DX: f64 = 5e-3;

fn rubber() -> Material {
    let (shear_modulus, bulk_modulus) = Material::moduli(2e5, 0.3);
    Material {
        name: "rubber".into(),
        shear_modulus,
        bulk_modulus,
        melt_shear_modulus: shear_modulus,
        melt: Rheology { yield_stress: 0.0, consistency: 1.0, index: 1.0 },
        heat_capacity_solid: 1000.0,
        heat_capacity_liquid: 1000.0,
        conductivity_solid: 5.0,
        conductivity_liquid: 5.0,
        ..Material::default()
    }
}

/// A block of rubber on nodes 10–18 of a box of 36³, eight points per cell, 300 K.
fn block() -> (Grid, Points) {
    let grid = Grid { origin: [0.0; 3], spacing: DX, nodes: [36; 3] };
    let points = block::block([10.0; 3], [8; 3], DX, |_| (1, 300.0));
    (grid, points)
}

fn config(grid: Grid, colliders: Vec<Collider>) -> SolverConfig {
    SolverConfig {
        grid,
        materials: vec![rubber()],
        sources: Vec::new(),
        colliders,
        gravity: [0.0; 3],
        ambient: 290.0,
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

fn run(solver: &mut Solver, frames: usize) {
    for _ in 0..frames {
        let report = solver.advance_frame(&|| false).unwrap().unwrap();
        let audit = report.audit.unwrap();
        assert!(audit.closes(1e-9), "{audit:?}");
    }
}

fn mean(solver: &Solver, f: impl Fn(usize) -> f64) -> f64 {
    let n = solver.particles().len();
    (0..n).map(f).sum::<f64>() / n as f64
}

fn slide(time: f64, x: f64) -> PoseKey {
    PoseKey { time, translation: [x, 0.0, 0.0], rotation: [1.0, 0.0, 0.0, 0.0] }
}

/// A plate that waits left of the block and then moves right at 0.25 m/s.
fn piston(shape: Shape) -> Collider {
    Collider { friction: 0.0, motion: Motion(vec![slide(0.0, 0.0), slide(0.4, 0.1)]), ..Collider::new(shape) }
}

fn plate() -> Shape {
    Shape::aligned_box([5.0 * DX, 4.0 * DX, 4.0 * DX], [9.0 * DX, 24.0 * DX, 24.0 * DX])
}

#[test]
fn a_piston_pushes_and_what_it_pushed_flies_on() {
    let (grid, points) = block();
    let mut solver = Solver::new(config(grid, vec![piston(plate())]), &points).unwrap();
    let start = mean(&solver, |i| solver.particles().position(i)[0]);
    run(&mut solver, 6);
    // The face was a cell away (and half a cell of contact) from the block and has moved six cells; the block has not reached
    // the wall of the box yet.
    let p = solver.particles();
    let rear = (0..p.len()).map(|i| p.position(i)[0]).fold(f64::INFINITY, f64::min);
    let face = 9.0 * DX + 0.12 * 0.25;
    assert!(rear > face - 0.6 * DX, "{rear} {face}");
    let moved = mean(&solver, |i| p.position(i)[0]) - start;
    assert!(moved > 0.12 * 0.25 - 2.0 * DX, "{moved}");
    let speed = mean(&solver, |i| f64::from(p.velocity(i)[0]));
    // An elastic body leaves faster than it was hit, by up to twice the speed.
    assert!(speed > 0.24 && speed < 0.51, "{speed}");
}

#[test]
fn a_turning_paddle_carries_what_sticks_to_it() {
    use megas_sim::collider::Mode;
    let (grid, points) = block();
    let centre = [14.0 * DX; 3];
    let half = std::f64::consts::FRAC_1_SQRT_2;
    let keys = vec![slide(0.0, 0.0), PoseKey { time: 0.5, translation: [0.0; 3], rotation: [half, 0.0, 0.0, half] }];
    // A post through the middle of the block: everything turns with it, a quarter turn in half a second.
    let post = Collider {
        mode: Mode::Sticky,
        motion: Motion(keys),
        ..Collider::new(Shape::Cylinder { a: [centre[0], centre[1], 6.0 * DX], b: [centre[0], centre[1], 22.0 * DX], radius: 3.2 * DX })
    };
    let mut solver = Solver::new(config(grid, vec![post]), &points).unwrap();
    run(&mut solver, 10);
    // Angular momentum per mass and radius: rigid rotation at π rad/s.
    let p = solver.particles();
    let (mut spin, mut inertia) = (0.0, 0.0);
    for i in 0..p.len() {
        let (x, v) = (p.position(i), p.velocity(i));
        let r = [x[0] - centre[0], x[1] - centre[1]];
        spin += r[0] * f64::from(v[1]) - r[1] * f64::from(v[0]);
        inertia += r[0] * r[0] + r[1] * r[1];
    }
    let rate = spin / inertia;
    assert!((rate / std::f64::consts::PI - 1.0).abs() < 0.1, "{rate}");
}

#[test]
fn an_obstacle_holds_only_while_it_exists() {
    let (grid, points) = block();
    let floor = Collider {
        active: vec![[0.0, 0.1]],
        offset: 0.0,
        ..Collider::new(Shape::HalfSpace { point: [0.0, 0.0, 10.0 * DX], normal: [0.0, 0.0, 1.0] })
    };
    let setup = SolverConfig { gravity: [0.0, 0.0, -2.0], ..config(grid, vec![floor]) };
    let mut solver = Solver::new(setup, &points).unwrap();
    let height = |s: &Solver| mean(s, |i| s.particles().position(i)[2]);
    let start = height(&solver);
    run(&mut solver, 5);
    let held = height(&solver);
    assert!(start - held < 0.6 * DX, "{}", start - held);
    let speed = mean(&solver, |i| f64::from(solver.particles().velocity(i)[2]));
    run(&mut solver, 5);
    let fallen = held - height(&solver) + speed * 0.1;
    assert!((fallen / (0.5 * 2.0 * 0.01) - 1.0).abs() < 0.05, "{fallen}");
}

/// A slab under the block, two cells of it: it starts 100 K warmer.
fn slab() -> Collider {
    let conductor = Conductor { kelvin: 400.0, volumetric_capacity: 5e5, conductivity: 50.0, watts: 0.0 };
    Collider {
        thermal: Thermal::Conducting(conductor),
        offset: 0.0,
        ..Collider::new(Shape::aligned_box([9.5 * DX, 9.5 * DX, 7.5 * DX], [18.5 * DX, 18.5 * DX, 9.5 * DX]))
    }
}

#[test]
fn slab_and_block_reach_the_temperature_of_the_mixture() {
    let (grid, points) = block();
    let setup = SolverConfig { mechanics: false, frame_dt: 20.0, coupling_step: 1.0, ..config(grid, vec![slab()]) };
    let mut solver = Solver::new(setup, &points).unwrap();
    run(&mut solver, 40);
    let stuff = 512.0 * DX.powi(3) * 1000.0 * 1000.0;
    let metal = 162.0 * DX.powi(3) * 5e5;
    let mixed = (stuff * 300.0 + metal * 400.0) / (stuff + metal);
    let frame = solver.export();
    for t in &frame.temperature {
        assert!((f64::from(*t) - mixed).abs() < 0.05, "{t} {mixed}");
    }
    let audit = solver.totals().audit.unwrap();
    assert!((audit.solid / (stuff * (mixed - 300.0)) - 1.0).abs() < 1e-3 && audit.wall == 0.0, "{audit:?}");
}

#[test]
fn runs_with_conducting_obstacles_restart_bitwise() {
    let (grid, points) = block();
    let poker = Collider {
        thermal: Thermal::Conducting(Conductor { kelvin: 600.0, volumetric_capacity: 4e6, conductivity: 50.0, watts: 2.0 }),
        ..piston(plate())
    };
    let setup = config(grid, vec![slab(), poker]);
    let mut whole = Solver::new(setup.clone(), &points).unwrap();
    run(&mut whole, 2);
    let _ = whole.export();
    let (checkpoint, arrays) = {
        let arrays: Vec<Vec<u8>> = whole.particles().arrays().into_iter().map(|(_, bytes)| bytes.to_vec()).collect();
        (whole.checkpoint(), arrays)
    };
    assert_eq!(checkpoint.solids.len(), 162 + 1);
    let mut again = Solver::new(setup, &points).unwrap();
    again.restore(checkpoint.clone(), &arrays).unwrap();
    run(&mut whole, 2);
    run(&mut again, 2);
    assert_eq!(whole.checkpoint(), again.checkpoint());
    assert_eq!(whole.export().temperature, again.export().temperature);
    let mut misfit = checkpoint;
    misfit.solids.pop();
    assert!(again.restore(misfit, &arrays).is_err());
}
