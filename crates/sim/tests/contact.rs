//! Resistance to heat between bodies that touch.

#[path = "common/block.rs"]
mod block;
#[path = "common/cloud.rs"]
mod cloud;

use block::block;
use cloud::Cloud;
use megas_math::rng::Rng;
use megas_sim::collider::{Collider, Shape};
use megas_sim::grid::Grid;
use megas_sim::material::Material;
use megas_sim::mechanics::Bounds;
use megas_sim::phase::PhaseOptions;
use megas_sim::solver::{Coupling, Solver, SolverConfig};
use megas_sim::thermal::{ThermalOptions, ThermalSolver, Wall};

const DX: f64 = 2e-3;

/// ρ c = 2 MJ/(m³·K), enthalpies from 300 K.
fn solid(conductivity: f64) -> Material {
    Material {
        density: 2000.0,
        heat_capacity_solid: 1000.0,
        heat_capacity_liquid: 1000.0,
        conductivity_solid: conductivity,
        conductivity_liquid: conductivity,
        ..Material::default()
    }
}

/// Jittered points, eight per cell, in the box from `lo` of `cells`; `kind(ξ)` names body, material and temperature over 300 K.
fn cloud(lo: [f64; 3], cells: [usize; 3], seed: u64, kind: impl Fn([f64; 3]) -> (u16, u8, f64)) -> Cloud {
    let mut rng = Rng::new(seed);
    let mut cloud = Cloud::default();
    let [nx, ny, nz] = cells.map(|n| 2 * n);
    for site in 0..nx * ny * nz {
        let site = [site / nz / ny, site / nz % ny, site % nz];
        let xi = std::array::from_fn(|a| lo[a] + 0.5 * (site[a] as f64 + 0.5 + rng.range(-0.25, 0.25)));
        let (object, material, t) = kind(std::array::from_fn(|a| lo[a] + 0.5 * (site[a] as f64 + 0.5)));
        let volume = DX.powi(3) / 8.0;
        cloud.push(xi, (2000.0 * volume) as f32, volume as f32, material, object, 1000.0 * t);
    }
    cloud
}

fn step(cloud: &mut Cloud, solver: &mut ThermalSolver, dt: f64, walls: Option<&[Wall]>) {
    let audit = cloud.step(solver, dt, &[], walls).expect("a step");
    assert!(audit.closes(1e-9), "{audit:?}");
}

/// Mean temperature of a body over 300 K.
fn mean(cloud: &Cloud, object: u16) -> f64 {
    let own = || cloud.h.iter().zip(&cloud.object).filter(|(_, o)| **o == object);
    own().map(|(h, _)| h / 1000.0).sum::<f64>() / own().count() as f64
}

/// Temperature at ξ = 0 and its slope per spacing, fitted to the points between `lo` and `hi` along x.
fn line(cloud: &Cloud, lo: f64, hi: f64) -> [f64; 2] {
    let inside = || cloud.xi.iter().zip(&cloud.h).filter(|(x, _)| x[0] > lo && x[0] < hi).map(|(x, h)| (x[0], h / 1000.0));
    let n = inside().count() as f64;
    let (x, t) = inside().fold((0.0, 0.0), |s, (x, t)| (s.0 + x / n, s.1 + t / n));
    let (xx, xt) = inside().fold((0.0, 0.0), |s, (a, b)| (s.0 + (a - x).powi(2), s.1 + (a - x) * (b - t)));
    [t - xt / xx * x, xt / xx]
}

/// Resistance \[m²K/W\] of two touching slabs of conductivity `k` between walls 100 K apart, between the lines through their
/// temperatures. The face is `offset` beyond the middle between two nodes.
fn steady(k: [f64; 2], resistance: f64, offset: f64) -> f64 {
    let grid = Grid { origin: [0.0; 3], spacing: DX, nodes: [18, 3, 3] };
    let options = ThermalOptions { periodic: [false, true, true], ..ThermalOptions::default() };
    let mut solver = ThermalSolver::new(grid, &k.map(solid), 300.0, options);
    solver.set_contact_resistance(2, resistance);
    let wall = |i: usize| match grid.node(i)[0] {
        0..3 => Wall::Fixed(400.0),
        15.. => Wall::Fixed(300.0),
        _ => Wall::Open,
    };
    let walls: Vec<Wall> = (0..grid.len()).map(wall).collect();
    let face = 8.5 + offset;
    let lengths = [face - 2.5, 14.5 - face];
    let flux = 100.0 / (lengths[0] * DX / k[0] + resistance + lengths[1] * DX / k[1]);
    // A lattice of points for each slab, stretched to end at the face.
    let mut cloud = cloud([2.5, 0.0, 0.0], [12, 3, 3], 7, |x| (1 + u16::from(x[0] > 8.5), u8::from(x[0] > 8.5), 0.0));
    for i in 0..cloud.xi.len() {
        let side = usize::from(cloud.material[i]);
        let stretch = lengths[side] / 6.0;
        let end = [2.5, 14.5][side];
        cloud.xi[i][0] = end + (cloud.xi[i][0] - end) * stretch;
        cloud.mass[i] *= stretch as f32;
        cloud.volume[i] *= stretch as f32;
        let depth = (cloud.xi[i][0] - end).abs() * DX;
        cloud.h[i] = 1000.0 * (if side == 0 { 100.0 - flux * depth / k[0] } else { flux * depth / k[1] });
    }
    let dt = 0.04 * DX * DX * 2e6 / k[0].max(k[1]);
    for _ in 0..2500 {
        step(&mut cloud, &mut solver, dt, Some(&walls));
    }
    let (a, b) = (line(&cloud, 3.5, face - 1.0), line(&cloud, face + 1.0, 13.5));
    let q = 0.5 * (-k[0] * a[1] - k[1] * b[1]) / DX;
    ((a[0] + a[1] * face) - (b[0] + b[1] * face)) / q
}

#[test]
fn slabs_in_contact_conduct_as_in_series_with_the_resistance() {
    // The place of a face is known to a fraction of a cell: no better is the resistance.
    for (k, resistance, offset) in [([1.0, 1.0], 1e-3, 0.25), ([1.0, 1.0], 1e-2, 0.0), ([0.5, 2.0], 5e-3, 0.5)] {
        let got = steady(k, resistance, offset);
        let cell = DX / k[0].min(k[1]);
        assert!((got - resistance).abs() < 0.2 * cell, "{k:?}, {resistance} at {offset}: {got}");
    }
}

/// The halves of a cube of 12 cells, cut through its middle across `normal`, 100 K apart; and the rate \[1/s\] at which they become
/// equally warm.
fn halves(normal: [f64; 3], resistance: f64) -> (Cloud, f64) {
    let grid = Grid { origin: [0.0; 3], spacing: DX, nodes: [20; 3] };
    let mut solver = ThermalSolver::new(grid, &[solid(200.0)], 300.0, ThermalOptions::default());
    // One side may have more of it than the other.
    solver.set_contact_resistance(1, 0.25 * resistance);
    solver.set_contact_resistance(2, 0.75 * resistance);
    let mut cloud = cloud([3.7, 3.6, 3.4], [12; 3], 3, |x| {
        let right = normal[0] * (x[0] - 9.7) + normal[1] * (x[1] - 9.6) + normal[2] * (x[2] - 9.4) > 0.0;
        (1 + u16::from(right), 0, if right { 0.0 } else { 100.0 })
    });
    let dt = 0.01;
    let difference: Vec<f64> = (0..40)
        .map(|_| {
            step(&mut cloud, &mut solver, dt, None);
            mean(&cloud, 1) - mean(&cloud, 2)
        })
        .collect();
    let rate = (difference[19] / difference[39]).ln() / (20.0 * dt);
    (cloud, rate)
}

#[test]
fn tilted_faces_have_their_area() {
    let side = 12.0 * DX;
    let cuts =
        [([1.0, 0.0, 0.0], 1.0), ([1.0, 1.0, 0.0], 2f64.sqrt()), ([1.0, 1.0, 1.0], 0.75 * 3f64.sqrt()), ([2.0, 1.0, 0.0], 1.25f64.sqrt())];
    for (normal, area) in cuts {
        let exact = area * side.powi(2) / 1e-2 * 4.0 / (2e6 * side.powi(3));
        let (_, rate) = halves(normal, 1e-2);
        // Of 12 cells the rim, half a cell wide, is a tenth.
        assert!((rate / exact - 1.0).abs() < 0.08, "{normal:?}: {rate} for {exact}");
    }
}

#[test]
fn nothing_leaks_past_the_resistance() {
    let (cloud, rate) = halves([1.0, 1.0, 0.0], 1e9);
    assert!(rate < 1e-12, "{rate}");
    assert!(cloud.h.iter().zip(&cloud.object).all(|(h, o)| (h - if *o == 1 { 1e5 } else { 0.0 }).abs() < 1e-3));
}

#[test]
fn no_resistance_is_as_before_and_threads_change_no_bit() {
    let run = |threads: usize, resistances: &[(u16, f64)]| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a thread pool");
        pool.install(|| {
            let grid = Grid { origin: [0.0; 3], spacing: DX, nodes: [20; 3] };
            let mut solver = ThermalSolver::new(grid, &[solid(2.0), solid(0.2)], 300.0, ThermalOptions::default());
            let body = |x: [f64; 3]| u16::from(x[0] > 9.0) + u16::from(x[1] > 11.0);
            let mut cloud = cloud([4.0; 3], [12; 3], 5, |x| (body(x), (body(x) % 2) as u8, 50.0 * f64::from(body(x))));
            for (body, resistance) in resistances {
                solver.set_contact_resistance(*body, *resistance);
                // What comes does not depend on what was.
                step(&mut cloud.clone(), &mut solver, 0.1, None);
            }
            for _ in 0..10 {
                step(&mut cloud, &mut solver, 0.1, None);
            }
            cloud.h.iter().map(|h| h.to_bits()).collect::<Vec<_>>()
        })
    };
    let resistances = [(1, 1e-3), (2, 2e-3)];
    assert!(run(1, &resistances) == run(3, &resistances), "threads");
    assert!(run(1, &[]) == run(2, &[(1, 0.0), (2, 3e-3), (2, 0.0)]), "no resistance");
    assert!(run(1, &[]) != run(1, &resistances), "a resistance");
}

/// Two blocks of 8 cells, one standing on the other under its weight: their points leave a gap, which is none.
#[test]
fn a_block_that_stands_on_another_meets_the_resistance() {
    const RESISTANCE: f64 = 5e-3;
    let (shear_modulus, bulk_modulus) = Material::moduli(1e5, 0.3);
    let rubber = Material { shear_modulus, bulk_modulus, melt_shear_modulus: shear_modulus, ..solid(50.0) };
    let points = block([6.0, 6.0, 5.0], [8, 8, 16], DX, |site| if site[2] >= 16 { (2, 310.0) } else { (1, 300.0) });
    let config = SolverConfig {
        grid: Grid { origin: [0.0; 3], spacing: DX, nodes: [20, 20, 28] },
        materials: vec![rubber],
        sources: Vec::new(),
        colliders: vec![Collider::new(Shape::HalfSpace { point: [0.0, 0.0, 5.0 * DX], normal: [0.0, 0.0, 1.0] })],
        gravity: [0.0, 0.0, -9.81],
        ambient: 300.0,
        thermal: ThermalOptions::default(),
        phase: PhaseOptions::default(),
        frame_dt: 0.1,
        coupling_step: 5e-3,
        courant: 0.4,
        mechanics: true,
        bounds: Bounds::Clamp,
        coupling: Coupling::default(),
    };
    let mut solver = Solver::new(config, &points).expect("a solver");
    solver.set_contact_resistance(2, RESISTANCE);
    let apart = |solver: &Solver| {
        let p = solver.particles();
        let mean = |o: u16| (0..p.len()).filter(|i| p.object[*i] == o).map(|i| p.enthalpy[i]).sum::<f64>();
        mean(2) - mean(1)
    };
    let start = apart(&solver);
    for _ in 0..10 {
        let report = solver.advance_frame(&|| false).expect("a step").expect("not stopped");
        assert!(report.audit.expect("an audit").closes(1e-9));
        solver.export();
    }
    let side = 8.0 * DX;
    // Bi = 2L/kR = 0.13: the blocks' own resistance adds 2L/3k.
    let exact = 2.0 / ((RESISTANCE + 2.0 * side / (3.0 * 50.0)) * 2e6 * side);
    let rate = (start / apart(&solver)).ln();
    assert!((rate / exact - 1.0).abs() < 0.15, "{rate} for {exact}");
}
