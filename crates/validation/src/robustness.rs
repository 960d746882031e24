//! V46: bad input and bad settings end well (simulation.md §8.6, §9.3).

use megas_math::rng::Rng;
use megas_math::{Mat3, mat3, quat};
use megas_model::Points;
use megas_sim::collider::{Collider, Shape};
use megas_sim::grid::Grid;
use megas_sim::mechanics::material_point;
use megas_sim::particles::{DRUCKER_PRAGER, FIXED_COROTATED, FLUID, HENCKY, NEO_HOOKEAN, NEO_HOOKEAN_SPLIT, VON_MISES};
use megas_sim::reference::Law;
use megas_sim::solver::{SimError, Solver, SolverConfig, repaired};
use megas_sim::source::{HeatSource, Motion, Region, Schedule, SourceKind};

use crate::coupled::{config, cube, wax};
use crate::{Case, Outcome, Plot, Row, Tier};

/// The case of this file.
pub const CASES: &[Case] = &[Case::new("V46", "robustness", Tier::B, robustness)
    .proves("that no input and no setting lets a number that is none reach the pictures")
    .setup(
        "(i) 20 000 random gradients with stretches of −2 to 3, zeros among them, through every law; (ii) a block dropped from 1 m; \
         (iii) a source of 3000 K; (iv) points outside the box and points shot at its wall; (v) substeps five times too long; (vi) a \
         point whose velocity is not a number",
    )
    .formula("finite stress, finite states, roll-backs where they are due, repairs counted, errors that name the point")];

fn robustness() -> Outcome {
    let mut rows = vec![Row::new("(i) laws: gradients without finite stress", 0.0, random_gradients() as f64, 0.0)];
    let (drop, plot) = dropped_block();
    rows.extend(drop);
    rows.extend(furnace());
    rows.extend(outside());
    rows.extend(long_steps());
    rows.extend(not_a_number());
    Outcome::from(rows).plot(plot)
}

/// Every law on gradients far outside what it is made for.
fn random_gradients() -> u32 {
    let mut rng = Rng::new(46);
    let mut bad = 0;
    for k in 0..20_000 {
        let turn = |rng: &mut Rng| quat::to_mat3(quat::from_axis_angle(rng.direction(), rng.range(0.0, 3.1)));
        let (u, v) = (turn(&mut rng), turn(&mut rng));
        let mut s: [f64; 3] = std::array::from_fn(|_| rng.range(-2.0, 3.0));
        if k % 5 == 0 {
            s[k / 5 % 3] = 0.0;
        }
        let f = mat3::mul(mat3::mul(u, mat3::diag(s)), mat3::transpose(v));
        let h: Mat3<f32> = mat3::cast(mat3::sub(f, mat3::identity()));
        // Each law with a constant of its own kind: hardening, friction, largest J.
        for (law, constant) in [
            (HENCKY, 0.0),
            (FIXED_COROTATED, 0.0),
            (FLUID, 1.001),
            (NEO_HOOKEAN, 0.0),
            (NEO_HOOKEAN_SPLIT, 0.0),
            (VON_MISES, 100.0),
            (DRUCKER_PRAGER, 0.3),
        ] {
            for (yield_stress, viscosity, exponent) in [(f32::INFINITY, 0.0, 1.0), (10.0, 5.0, 0.5), (0.0, 1.0, 1.0), (50.0, 0.0, 1.0)] {
                let law = Law { law, shear: 1e4, bulk: 3e4, yield_stress, viscosity, exponent, constant };
                let (after, tau) = material_point(&law, h, 1e-4);
                bad += u32::from(!after.iter().chain(&tau).flatten().all(|x| x.is_finite()));
            }
        }
    }
    bad
}

fn finite(solver: &Solver) -> bool {
    let p = solver.particles();
    (0..p.len()).all(|i| {
        p.velocity(i).iter().chain(p.elastic(i).iter().flatten()).chain(p.total(i).iter().flatten()).all(|v| v.is_finite())
            && p.position(i).iter().all(|v| v.is_finite())
            && p.enthalpy[i].is_finite()
    })
}

fn heater(kind: SourceKind) -> HeatSource {
    let region = Region::Shape(Shape::Sphere { center: [0.028; 3], radius: 0.012 });
    HeatSource { name: String::new(), region, kind, schedule: Schedule::default(), motion: Motion::default() }
}

/// Runs `frames` frames and tells how it ended.
fn run(solver: &mut Solver, frames: u32) -> Result<(), SimError> {
    for _ in 0..frames {
        solver.advance_frame(&|| false)?;
        solver.export();
    }
    Ok(())
}

/// A soft block falls one metre onto a floor.
fn dropped_block() -> (Vec<Row>, Plot) {
    let spacing = 0.02;
    let grid = Grid { origin: [0.0; 3], spacing, nodes: [28, 28, 76] };
    let mut points = Points::default();
    for i in 0..8usize.pow(3) * 8 {
        let site = [i / 256, i / 16 % 16, i % 16];
        let lift = [10.0, 10.0, 55.0];
        points.position.push(std::array::from_fn(|a| (lift[a] + 0.5 * (site[a] as f64 + 0.5)) * spacing));
        points.volume.push((spacing / 2.0).powi(3) as f32);
        points.temperature.push(280.0);
        points.normal.push([0.0; 3]);
        points.material.push(0);
        points.object.push(1);
        points.flags.push(megas_model::FLAG_INTERNAL);
        points.id.push(i as u32);
    }
    let floor = Collider { offset: 0.0, ..Collider::new(Shape::HalfSpace { point: [0.0, 0.0, 5.0 * spacing], normal: [0.0, 0.0, 1.0] }) };
    let setup = SolverConfig { colliders: vec![floor], ..config(grid, wax(), Vec::new()) };
    let Ok(mut solver) = Solver::new(setup, &points) else { return (failed("(ii) the solver starts"), Plot::default()) };
    let (bottom, g) = (55.0 * spacing - 5.0 * spacing, 9.81f64);
    let mut seen = Vec::new();
    let mut fastest = 0.0f64;
    for _ in 0..40 {
        let Ok(Some(report)) = solver.advance_frame(&|| false) else { return (failed("(ii) the frame completes"), Plot::default()) };
        fastest = fastest.max(report.max_speed);
        let p = solver.particles();
        seen.push([solver.time(), (0..p.len()).map(|i| p.position(i)[2]).fold(f64::INFINITY, f64::min) - 5.0 * spacing]);
        solver.export();
    }
    let repairs = repaired(&solver.totals().repairs);
    let plot = Plot::new("(ii) lowest point of a soft block dropped from 1 m", "t [s]", "height above the floor [m]")
        .function("bottom in free fall", 0.0, (2.0 * bottom / g).sqrt(), |t| bottom - 0.5 * g * t * t)
        .ours("block", seen);
    let rows = vec![
        Row::new("(ii) drop: largest speed over that of the fall", 1.0, fastest / (2.0 * g * bottom).sqrt(), 0.25),
        Row::new("(ii) drop: repairs", 0.0, repairs as f64, 0.0),
        Row::new("(ii) drop: state not finite", 0.0, f64::from(u8::from(!finite(&solver))), 0.0),
    ];
    (rows, plot)
}

/// Wax, which melts at 300 K, around a source of 3000 K.
fn furnace() -> Vec<Row> {
    let (grid, points, floor) = cube(8, 290.0);
    let setup = SolverConfig { colliders: vec![floor], ..config(grid, wax(), vec![heater(SourceKind::Temperature { kelvin: 3000.0 })]) };
    let Ok(mut solver) = Solver::new(setup, &points) else { return failed("(iii) the solver starts") };
    if run(&mut solver, 10).is_err() {
        return failed("(iii) the frames complete");
    }
    let hottest = solver.export().temperature.iter().fold(0.0f32, |a, b| a.max(*b));
    vec![
        Row::new("(iii) 3000 K: hottest point [K]", 3000.0, f64::from(hottest), 30.0),
        Row::new("(iii) 3000 K: residual of the energy audit", 0.0, solver.totals().energy_residual(), 1e-5),
        Row::new("(iii) 3000 K: state not finite", 0.0, f64::from(u8::from(!finite(&solver))), 0.0),
    ]
}

/// A point outside is refused by name; points shot at the wall stay inside.
fn outside() -> Vec<Row> {
    let (grid, mut points, _) = cube(6, 290.0);
    points.position[17] = [0.5, 0.0, 0.0];
    let refused = match Solver::new(config(grid, wax(), Vec::new()), &points) {
        Err(e) => e.to_string().contains("point 17"),
        Ok(_) => false,
    };
    let (grid, points, _) = cube(6, 290.0);
    let Ok(mut solver) = Solver::new(config(grid, wax(), Vec::new()), &points) else { return failed("(iv) the solver starts") };
    solver.set_object_velocity(1, [8.0, 0.0, 0.0]);
    let completed = run(&mut solver, 4).is_ok();
    let p = solver.particles();
    let far = (grid.nodes[0] - 2) as f64 * grid.spacing;
    let out = (0..p.len()).filter(|&i| !(0.0..=far).contains(&p.position(i)[0])).count();
    vec![
        Row::new("(iv) a point outside is refused by name", 1.0, f64::from(u8::from(refused)), 0.0),
        Row::new("(iv) shot at the wall: completes", 1.0, f64::from(u8::from(completed && finite(&solver))), 0.0),
        Row::new("(iv) shot at the wall: points outside", 0.0, out as f64, 0.0),
    ]
}

/// Substeps five times too long are noticed and shortened, and a restart in the middle of that changes no bit.
fn long_steps() -> Vec<Row> {
    let (grid, points, floor) = cube(8, 299.0);
    let lamp = heater(SourceKind::Flux { watts_per_m2: 4e6 });
    let setup = SolverConfig { colliders: vec![floor], courant: 2.0, ..config(grid, wax(), vec![lamp]) };
    let run = |restart: Option<u32>| -> Option<(u64, u64, bool)> {
        let mut solver = Solver::new(setup.clone(), &points).ok()?;
        for k in 0..8 {
            if restart == Some(k) {
                let arrays: Vec<Vec<u8>> = solver.particles().arrays().into_iter().map(|(_, b)| b.to_vec()).collect();
                let checkpoint = solver.checkpoint();
                solver = Solver::new(setup.clone(), &points).ok()?;
                solver.restore(checkpoint, &arrays).ok()?;
            }
            solver.advance_frame(&|| false).ok()??;
            solver.export();
        }
        Some((solver.particles().state_hash(), solver.totals().rollbacks, finite(&solver)))
    };
    let straight = run(None);
    let differs = straight.is_none() || (1..8).any(|k| run(Some(k)).map(|r| r.0) != straight.map(|s| s.0));
    let (_, rollbacks, fine) = straight.unwrap_or((0, 0, false));
    vec![
        Row::new("(v) Δt five times too long: completes", 1.0, f64::from(u8::from(fine)), 0.0),
        Row::new("(v) rolled back (1 = at least once)", 1.0, f64::from(u8::from(rollbacks > 0)), 0.0),
        Row::new("(v) restarts while steps are short differ", 0.0, f64::from(u8::from(differs)), 0.0),
    ]
}

/// What no smaller step cures ends with a report that names the point, its object, its material and the limit.
fn not_a_number() -> Vec<Row> {
    let (grid, mut points, floor) = cube(6, 290.0);
    points.object[40] = 7;
    let Ok(mut solver) = Solver::new(SolverConfig { colliders: vec![floor], ..config(grid, wax(), Vec::new()) }, &points) else {
        return failed("(vi) the solver starts");
    };
    solver.set_object_velocity(7, [f32::NAN, 0.0, 0.0]);
    let named = match solver.advance_frame(&|| false) {
        Err(SimError::Unstable { culprit, .. }) => culprit.point == 40 && culprit.object == 7 && culprit.material == "test wax",
        _ => false,
    };
    vec![Row::new("(vi) a velocity that is no number is named", 1.0, f64::from(u8::from(named)), 0.0)]
}

fn failed(what: &str) -> Vec<Row> {
    vec![Row::new(what, 1.0, 0.0, 0.0)]
}

#[cfg(test)]
mod tests {
    #[test]
    fn v46() {
        crate::assert_case("V46");
    }
}
