//! V41 and V43: what heat does to shape, and what the transfer of heat does to melting (simulation.md §8.5).

use megas_model::{FLAG_INTERNAL, Points};
use megas_sim::collider::{Collider, Mode, Shape};
use megas_sim::grid::Grid;
use megas_sim::material::{Material, PhaseMode, Rheology};
use megas_sim::phase::PhaseOptions;
use megas_sim::solver::{Coupling, Solver, SolverConfig};
use megas_sim::source::{HeatSource, Motion, Region, Schedule, SourceKind};
use megas_sim::thermal::{ThermalOptions, Transfer};

use crate::mechanics::{GRAVITY, slump};
use crate::{Case, Outcome, Plot, Row, Tier};

/// Cases of this file.
pub const CASES: &[Case] = &[
    Case::new("V41", "heating drives a slump", Tier::B, heated_slump)
        .proves("that heat reaches the mechanics, and that a molten block rests where its yield stress says, whatever the way there")
        .setup("the block of V34 (Δx = 10 mm), solid at first, melted within 0.15 s: everywhere, and in its outer half only")
        .formula("the deposit of V34; the cold half keeps its height"),
    Case::new("V43", "paper preset against physical preset", Tier::C, presets)
        .proves("that increments melt as much on any grid, while overwriting temperatures diffuses with every exchange")
        .setup("bar of 64 mm with a hot end, molten share after 10 s, at Δx = 2 and 1 mm and coupling steps of 10 and 1 ms")
        .formula("the same share on both grids within 10 %; the paper's transfer shifts with the coupling step (simulation.md §3.2)"),
];

/// Time in which the block melts \[s\].
const RAMP: f64 = 0.15;

fn failed(what: &str) -> Outcome {
    vec![Row::new(format!("{what} (1 = done)"), 1.0, 0.0, 0.0)].into()
}

/// Points on a lattice of half the spacing in the box `lo`..`hi`.
fn lattice(spacing: f64, lo: [f64; 3], hi: [f64; 3], temperature: f64) -> Points {
    let h = 0.5 * spacing;
    let n: [usize; 3] = std::array::from_fn(|a| ((hi[a] - lo[a]) / h).round() as usize);
    let mut points = Points::default();
    for i in 0..n.iter().product::<usize>() {
        let site = [i / (n[1] * n[2]), i / n[2] % n[1], i % n[2]];
        points.position.push(std::array::from_fn(|a| lo[a] + (site[a] as f64 + 0.5) * h));
        points.volume.push((h * h * h) as f32);
        points.temperature.push(temperature as f32);
        points.normal.push([0.0; 3]);
        points.material.push(0);
        points.object.push(1);
        points.flags.push(FLAG_INTERNAL);
        points.id.push(i as u32);
    }
    points
}

fn source(region: Region, kind: SourceKind, until: Option<f64>) -> HeatSource {
    let schedule = Schedule { intervals: until.map(|t| [0.0, t]).into_iter().collect(), ..Schedule::default() };
    HeatSource { name: String::new(), region, kind, schedule, motion: Motion::default() }
}

fn config(grid: Grid, material: Material, sources: Vec<HeatSource>) -> SolverConfig {
    SolverConfig {
        grid,
        materials: vec![material],
        sources,
        colliders: Vec::new(),
        gravity: [0.0, 0.0, -GRAVITY],
        ambient: 293.15,
        thermal: ThermalOptions::default(),
        phase: PhaseOptions::default(),
        frame_dt: 0.1,
        coupling_step: 0.01,
        courant: 0.4,
        mechanics: true,
        bounds: Default::default(),
        coupling: Coupling::default(),
    }
}

/// The deposit of a block heated in `region`: reach, top at the mirror, contour.
fn melted(region: Region, seconds: f64) -> Option<(f64, f64, Vec<[f64; 2]>)> {
    let dx = 0.01;
    let grid = Grid { origin: [-2.0 * dx, -2.5 * dx, -2.0 * dx], spacing: dx, nodes: [52, 8, 20] };
    let material = Material {
        shear_modulus: 3e4,
        bulk_modulus: 1e5,
        melt_shear_modulus: 3e3,
        melt: Rheology { yield_stress: 20.0, consistency: 2.0, index: 1.0 },
        heat_capacity_solid: 1000.0,
        heat_capacity_liquid: 1000.0,
        conductivity_solid: 1e-3,
        conductivity_liquid: 1e-3,
        latent_heat: 1e4,
        solidus: 300.0,
        liquidus: 301.0,
        reference_temperature: 290.0,
        ..Material::default()
    };
    // From 295 K to 311 K, faster than the block falls: V34 starts liquid, and its fall carries it a little beyond where a slow slump stops.
    let heat = SourceKind::Volume { watts_per_m3: 1000.0 * (1e4 + 1000.0 * 16.0) / RAMP };
    let floor =
        Collider { mode: Mode::Sticky, offset: 1e-3, ..Collider::new(Shape::HalfSpace { point: [0.0; 3], normal: [0.0, 0.0, 1.0] }) };
    let setup = SolverConfig { colliders: vec![floor], ..config(grid, material, vec![source(region, heat, Some(RAMP))]) };
    let points = lattice(dx, [0.0; 3], [0.1, 2.0 * dx, 0.1], 295.0);
    let mut solver = Solver::new(setup, &points).ok()?;
    while solver.time() < seconds - 1e-9 {
        solver.advance_frame(&|| false).ok()??;
    }
    let p = solver.particles();
    let x: Vec<[f64; 3]> = (0..p.len()).map(|i| p.position(i)).collect();
    let mut along: Vec<f64> = x.iter().map(|x| x[0]).collect();
    along.sort_by(f64::total_cmp);
    let reach = along[(along.len() as f64 * 0.995) as usize] + 0.25 * dx;
    let top = x.iter().filter(|x| x[0] < 1.5 * dx).map(|x| x[2]).fold(0.0, f64::max) + 0.25 * dx;
    let mut contour = vec![0.0f64; 48];
    for x in &x {
        let h = &mut contour[((x[0] / dx).max(0.0) as usize).min(47)];
        *h = h.max(x[2] + 0.25 * dx);
    }
    Some((reach, top, contour.iter().enumerate().filter(|c| *c.1 > 0.0).map(|(k, h)| [(k as f64 + 0.5) * dx, *h]).collect()))
}

fn heated_slump() -> Outcome {
    let (reach, top, contour) = slump(0.01, 20.0, 8.0);
    let Some((warm_reach, warm_top, warm)) = melted(Region::All, 9.0) else { return failed("melting everywhere") };
    // Surfaces of half-spaces face outwards: this one is x > 0.05 m.
    let outer = Region::Shape(Shape::HalfSpace { point: [0.05, 0.0, 0.0], normal: [-1.0, 0.0, 0.0] });
    let Some((_, cold_top, half)) = melted(outer, 9.0) else { return failed("melting one half") };
    let plot = Plot::new("deposits", "x [m]", "height [m]")
        .equal_axes()
        .reference("V34: liquid from the start", contour)
        .ours("melted everywhere", warm)
        .ours("melted at x > 0.05 m", half);
    Outcome::from(vec![
        Row::relative("length, melted over liquid from the start [m]", reach, warm_reach, 0.05),
        Row::relative("height, melted over liquid from the start [m]", top, warm_top, 0.05),
        Row::relative("height of the cold half [m]", 0.1, cold_top, 0.02),
    ])
    .plot(plot)
    .note("Melted within one second instead, the block stops 4 % shorter and 5 % higher: it slumps without the inertia of a sudden fall.")
}

/// Molten share over time of a bar with a hot end.
fn melt_curve(dx: f64, coupling_step: f64, paper: bool) -> Option<Vec<[f64; 2]>> {
    let (length, width) = (0.064, 8e-3);
    let margin = 4.0 * dx;
    let nodes = [length, width, width].map(|l| (l / dx).round() as usize + 9);
    let grid = Grid { origin: [-margin; 3], spacing: dx, nodes };
    let (phase_mode, latent_heat, delta_t, transfer) =
        if paper { (PhaseMode::Binary, 0.0, 0.0, Transfer::AffineOverwrite) } else { (PhaseMode::Mushy, 5e4, 1.0, Transfer::default()) };
    let material = Material {
        density: 900.0,
        heat_capacity_solid: 2000.0,
        heat_capacity_liquid: 2000.0,
        conductivity_solid: 20.0,
        conductivity_liquid: 20.0,
        latent_heat,
        solidus: 299.5,
        liquidus: 300.5,
        phase_mode,
        ..Material::default()
    };
    let hot = Region::Shape(Shape::HalfSpace { point: [4e-3, 0.0, 0.0], normal: [1.0, 0.0, 0.0] });
    let heat = source(hot, SourceKind::Temperature { kelvin: 340.0 }, None);
    let setup = SolverConfig {
        mechanics: false,
        frame_dt: 0.5,
        coupling_step,
        thermal: ThermalOptions { transfer, ..ThermalOptions::default() },
        phase: PhaseOptions { delta_t, ..PhaseOptions::default() },
        ..config(grid, material, vec![heat])
    };
    let points = lattice(dx, [0.0; 3], [length, width, width], 290.0);
    let mut solver = Solver::new(setup, &points).ok()?;
    let mut curve = vec![[0.0, 0.0]];
    while solver.time() < 10.0 - 1e-9 {
        solver.advance_frame(&|| false).ok()??;
        let frame = solver.export();
        let molten = frame.temperature.iter().filter(|t| **t >= 300.0).count() as f64 / frame.temperature.len() as f64;
        curve.push([solver.time(), molten]);
    }
    Some(curve)
}

fn presets() -> Outcome {
    let run = |paper: bool| -> Option<[Vec<[f64; 2]>; 3]> {
        Some([melt_curve(2e-3, 0.01, paper)?, melt_curve(1e-3, 0.01, paper)?, melt_curve(2e-3, 1e-3, paper)?])
    };
    let (Some(physical), Some(paper)) = (run(false), run(true)) else { return failed("melting the bar") };
    let end = |curve: &[[f64; 2]]| curve.last().map_or(f64::NAN, |c| c[1]);
    let ratio = |curves: &[Vec<[f64; 2]>; 3], k: usize| end(&curves[k]) / end(&curves[0]);
    let mut plot = Plot::new("molten share of a bar with a hot end", "time [s]", "molten share");
    for (name, curves) in [("physical", &physical), ("paper", &paper)] {
        for (curve, what) in curves.iter().zip(["Δx 2 mm, Δt_{c} 10 ms", "Δx 1 mm, Δt_{c} 10 ms", "Δx 2 mm, Δt_{c} 1 ms"]) {
            plot = plot.ours(format!("{name}, {what}"), curve.clone());
        }
    }
    let shift = |curves| (ratio(curves, 2) - 1.0).abs();
    Outcome::from(vec![
        Row::new("physical: molten share after 10 s, Δx/2 over Δx", 1.0, ratio(&physical, 1), 0.1),
        Row::new("physical: molten share after 10 s, Δt_c/10 over Δt_c", 1.0, ratio(&physical, 2), 0.1),
        Row::new(
            "the paper's transfer shifts more with Δt_c (1 = yes)",
            1.0,
            f64::from(u8::from(shift(&paper) > 2.0 * shift(&physical))),
            0.0,
        ),
    ])
    .plot(plot)
    .note(format!(
        "The paper's transfer melts {:.3} times as much with a coupling step ten times shorter, the physical preset {:.3} times.",
        ratio(&paper, 2),
        ratio(&physical, 2)
    ))
}

#[cfg(test)]
mod tests {
    #[test]
    #[ignore = "a minute on a busy machine"]
    fn v41() {
        crate::assert_case("V41");
    }
}
