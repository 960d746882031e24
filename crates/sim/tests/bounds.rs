//! Matter that leaves the box.

#[path = "common/block.rs"]
mod block;

use block::block;
use megas_model::{FLAG_ESCAPED, Points};
use megas_sim::collider::{Collider, Mode, Shape};
use megas_sim::grid::Grid;
use megas_sim::material::{Material, Rheology};
use megas_sim::mechanics::Bounds;
use megas_sim::phase::PhaseOptions;
use megas_sim::solver::{Coupling, Solver, SolverConfig};
use megas_sim::source::Film;
use megas_sim::thermal::{AirModel, ThermalOptions};

const DX: f64 = 5e-3;
const GRID: Grid = Grid { origin: [0.0; 3], spacing: DX, nodes: [40, 20, 24] };

/// Thin and molten at 340 K.
fn melt() -> Material {
    let (shear_modulus, bulk_modulus) = Material::moduli(2e4, 0.4);
    Material {
        name: "melt".into(),
        shear_modulus,
        bulk_modulus,
        melt_shear_modulus: 500.0,
        melt: Rheology { yield_stress: 1.0, consistency: 0.5, index: 1.0 },
        solidus: 300.0,
        liquidus: 305.0,
        latent_heat: 1e5,
        ..Material::default()
    }
}

/// A pool at the left of a table that ends in the middle of the box, and its solver; it runs to the right, over the edge and down.
fn stream(bounds: Bounds) -> (SolverConfig, Points) {
    let points = block([6.0, 6.0, 11.0], [8; 3], DX, |_| (1, 340.0));
    let table = Collider { mode: Mode::Slip, ..Collider::new(Shape::aligned_box([-1.0, -1.0, -1.0], [20.0 * DX, 1.0, 10.5 * DX])) };
    let film = Film { ambient: 290.0, coefficient: 50.0, emissivity: 0.9 };
    let config = SolverConfig {
        grid: GRID,
        materials: vec![melt()],
        sources: Vec::new(),
        colliders: vec![table],
        gravity: [0.0, 0.0, -9.81],
        ambient: 290.0,
        thermal: ThermalOptions { air: AirModel::Film(film), ..ThermalOptions::default() },
        phase: PhaseOptions::default(),
        frame_dt: 0.02,
        coupling_step: 2e-3,
        courant: 0.4,
        mechanics: true,
        bounds,
        coupling: Coupling::default(),
    };
    (config, points)
}

fn start(bounds: Bounds) -> Solver {
    let (config, points) = stream(bounds);
    let mut solver = Solver::new(config, &points).expect("a solver");
    solver.set_object_velocity(1, [0.8, 0.0, 0.0]);
    solver
}

fn mass(solver: &Solver) -> f64 {
    solver.particles().mass.iter().map(|m| f64::from(*m)).sum()
}

#[test]
fn what_runs_off_a_table_is_gone_and_booked() {
    let mut solver = start(Bounds::Delete);
    let before = mass(&solver);
    let mut last = 0;
    for _ in 0..13 {
        let report = solver.advance_frame(&|| false).expect("a step").expect("not stopped");
        assert_eq!((report.repairs.out_of_box, report.rollbacks), (0, 0), "{report:?}");
        assert!(report.audit.expect("an audit").closes(1e-11));
        let frame = solver.export();
        let gone = frame.flags.iter().filter(|f| **f & FLAG_ESCAPED != 0).count() as u64;
        let lost = solver.totals().escaped;
        assert_eq!(gone, lost.points);
        assert!(gone >= last && (lost.mass + mass(&solver) - before).abs() < 1e-9 * before, "{lost:?}");
        last = gone;
        // Those that are left are inside: nobody stands at a side as at a wall.
        for (x, _) in frame.position.iter().zip(&frame.flags).filter(|(_, f)| **f & FLAG_ESCAPED == 0) {
            assert!((0..3).all(|a| f64::from(x[a]) > 1.49 * DX && f64::from(x[a]) < (GRID.nodes[a] as f64 - 2.49) * DX), "{x:?}");
        }
    }
    let (lost, audit) = (solver.totals().escaped, solver.totals().audit.expect("an audit"));
    assert!(lost.points > 1000 && lost.points < 4000, "{lost:?}");
    assert!(lost.heat > 0.0 && audit.escaped == -lost.heat, "{audit:?}");
    // From the first frame to the last.
    let balance = audit.after - audit.before - audit.film - audit.escaped;
    assert!(balance.abs() < 1e-9 * audit.scale(), "{audit:?}: {balance}");
}

#[test]
fn walls_hold_what_would_leave() {
    let mut solver = start(Bounds::Clamp);
    let before = mass(&solver);
    for _ in 0..13 {
        solver.advance_frame(&|| false).expect("a step").expect("not stopped");
        solver.export();
    }
    assert_eq!((mass(&solver), solver.totals().escaped.points), (before, 0));
}

#[test]
fn threads_and_restarts_lose_the_same_points() {
    let run = |threads: usize, restart: Option<u32>| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a thread pool");
        pool.install(|| {
            let mut solver = start(Bounds::Delete);
            for k in 0..14 {
                if restart == Some(k) {
                    let arrays: Vec<Vec<u8>> = solver.particles().arrays().into_iter().map(|(_, b)| b.to_vec()).collect();
                    let checkpoint = solver.checkpoint();
                    solver = start(Bounds::Delete);
                    solver.restore(checkpoint, &arrays).expect("a checkpoint that fits");
                }
                solver.advance_frame(&|| false).expect("a step").expect("not stopped");
                solver.export();
            }
            (solver.particles().state_hash(), solver.totals().escaped)
        })
    };
    let one = run(1, None);
    assert!(one.1.points > 0, "{:?}", one.1);
    assert!(one == run(3, None) && one == run(2, Some(11)), "{:?}", one.1);
}
