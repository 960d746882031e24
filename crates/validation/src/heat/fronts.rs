//! Walls of fixed temperature and melting fronts behind them.

use megas_sim::grid::Grid;
use megas_sim::material::Material;
use megas_sim::thermal::{Audit, NodeFields, ThermalOptions, ThermalSolver, Wall};

use super::cloud::{Cloud, simple};
use crate::{Outcome, Plot, Row};

/// λ of `λ e^{λ²} erf λ = St/√π` (simulation.md V11).
fn stefan_lambda(st: f64) -> f64 {
    match st {
        0.05 => 0.156821,
        0.1 => 0.220016,
        0.5 => 0.464786,
        1.0 => 0.620063,
        2.0 => 0.800601,
        _ => f64::NAN,
    }
}

/// A material with c = 1, ρ = 1 that melts at zero with latent heat 1/St.
fn stefan_material(st: f64, k: f64) -> Material {
    Material { latent_heat: 1.0 / st, solidus: 0.0, liquidus: 0.0, ..simple(1.0, 1.0, k) }
}

/// Runs on the calling thread alone: the cases here are too small to share.
fn alone<T: Send>(f: impl FnOnce() -> T + Send) -> T {
    match rayon::ThreadPoolBuilder::new().num_threads(1).build() {
        Ok(pool) => pool.install(f),
        Err(_) => f(),
    }
}

/// A row of nodes behind a wall at node 0; the wall's face is half a cell before node 1.
struct Rod {
    solver: ThermalSolver,
    mass: Vec<f64>,
    material: Vec<u8>,
    energy: Vec<f64>,
    walls: Vec<Wall>,
    total: Audit,
}

impl Rod {
    fn new(cells: usize, material: &Material) -> Self {
        let n = cells + 1;
        let grid = Grid { origin: [0.0; 3], spacing: 1.0, nodes: [n, 1, 1] };
        let mut mass = vec![1.0; n];
        mass[0] = 0.0;
        let mut walls = vec![Wall::Open; n];
        walls[0] = Wall::Fixed(1.0);
        let solver = ThermalSolver::new(grid, std::slice::from_ref(material), 0.0, ThermalOptions::default());
        Self { solver, mass, material: vec![0; n], energy: vec![0.0; n], walls, total: Audit::default() }
    }

    fn step(&mut self) {
        let Self { solver, mass, material, energy, walls, total } = self;
        let mut fields = NodeFields { mass, volume: mass, material, energy };
        let audit = solver.step_nodes(&mut fields, 1.0, 0.0, &[], Some(walls)).unwrap_or_else(|e| panic!("{e}"));
        total.append(&audit);
    }
}

/// `T = erfc(x/40)` after 4000 steps at K̃ = 0.1.
pub fn half_space() -> Outcome {
    let mut rod = Rod::new(128, &simple(1.0, 1.0, 0.1));
    alone(|| (0..4000).for_each(|_| rod.step()));
    let t = |x: usize| 0.5 * (rod.energy[x] + rod.energy[x + 1]);
    let rows = [(10, 0.72367), (20, 0.47950), (30, 0.28884), (40, 0.15730), (60, 0.03389)]
        .map(|(x, reference)| Row::new(format!("T at {x} cells"), reference, t(x), 1e-3))
        .to_vec();
    // The series and continued fraction of the error function are not worth their code here: the curve is the integral itself.
    let exact = |x: f64| 1.0 - erf(x / 40.0);
    let plot = Plot::new("temperature behind the wall after 4000 steps", "x [cells]", "T")
        .function("erfc(x/40)", 0.0, 100.0, exact)
        .ours("nodes", (1..100).step_by(3).map(|n| [n as f64 - 0.5, rod.energy[n]]).collect());
    Outcome::from(rows).plot(plot)
}

/// Error function by Simpson's rule; enough for a curve.
fn erf(x: f64) -> f64 {
    const STEPS: u32 = 64;
    let h = x / f64::from(STEPS);
    let at = |k: u32| (-(f64::from(k) * h).powi(2)).exp();
    let weight = |k: u32| if k == 0 || k == STEPS { 1.0 } else { f64::from(2 + 2 * (k % 2)) };
    std::f64::consts::FRAC_2_SQRT_PI * h / 3.0 * (0..=STEPS).map(|k| weight(k) * at(k)).sum::<f64>()
}

/// Front `Σ f_l = 2λ√(K̃t)` on nodes, at 0.7 N.
pub fn stefan_nodes() -> Outcome {
    let (cells, k) = (64, 0.05);
    let mut rows = Vec::new();
    let mut plot = Plot::new("melting front", "√t [√steps]", "front [cells]");
    let mut curves = Vec::new();
    for st in [0.05, 0.1, 0.5, 1.0, 2.0] {
        let lambda = stefan_lambda(st);
        let steps = ((0.7 * cells as f64 / (2.0 * lambda)).powi(2) / k).ceil();
        let mut rod = Rod::new(cells, &stefan_material(st, k));
        let melted = |rod: &Rod| rod.energy.iter().map(|h| rod.solver.liquid_fraction(0, *h)).sum::<f64>();
        let mut seen = Vec::new();
        alone(|| {
            for step in 1..=steps as u64 {
                rod.step();
                if step % (steps as u64 / 25) == 0 {
                    seen.push([(step as f64).sqrt(), melted(&rod)]);
                }
            }
        });
        let front = melted(&rod);
        plot = plot.function(format!("exact, St = {st}"), 0.0, steps.sqrt(), |root| 2.0 * lambda * k.sqrt() * root);
        curves.push((st, seen));
        rows.push(Row::relative(format!("front at St = {st}, N = {cells} [cells]"), 2.0 * lambda * (k * steps).sqrt(), front, 0.002));
        rows.push(Row::new(format!("audit at St = {st}, relative"), 0.0, rod.total.residual / rod.total.after, 1e-10));
    }
    let plot = curves.into_iter().fold(plot, |plot, (st, seen)| plot.ours(format!("nodes, St = {st}"), seen));
    Outcome::from(rows).plot(plot)
}

/// The front with points, 3 per cell and axis.
pub fn stefan_points() -> Outcome {
    alone(|| {
        let mut rows = Vec::new();
        let mut fronts = Plot::new("melting front, 40 cells", "√t [√steps]", "front [cells]");
        let mut errors = Plot::new("error of the front", "front [cells]", "error [cells]").function("none", 0.0, 28.0, |_| 0.0);
        let mut curves = Vec::new();
        for (cells, st) in [(20, 0.1), (20, 0.5), (20, 2.0), (40, 0.5), (40, 2.0)] {
            let (more, seen) = stefan_bar(cells, st);
            rows.extend(more);
            errors = errors.ours(format!("St = {st}, N = {cells}"), seen.iter().map(|[_, front, exact]| [*exact, front - exact]).collect());
            if cells == 40 {
                fronts = fronts.reference(format!("exact, St = {st}"), seen.iter().map(|[root, _, exact]| [*root, *exact]).collect());
                curves.push((st, seen.iter().map(|[root, front, _]| [*root, *front]).collect()));
            }
        }
        let fronts = curves.into_iter().fold(fronts, |plot, (st, seen)| plot.ours(format!("points, St = {st}"), seen));
        Outcome::from(rows).plot(fronts).plot(errors)
    })
}

/// Water and ice: c_l, k_l, c_s, k_s in SI.
const WATER: [f64; 4] = [4186.0, 0.58, 2100.0, 2.2];

/// V13: the two-phase Neumann problem in SI.
pub fn ice() -> Outcome {
    let [c_l, k_l, c_s, k_s] = WATER;
    let material = Material {
        heat_capacity_liquid: c_l,
        conductivity_liquid: k_l,
        latent_heat: 334e3,
        solidus: 273.15,
        liquidus: 273.15,
        ..simple(1000.0, c_s, k_s)
    };
    let (a_l, a_s) = (k_l / (1000.0 * c_l), k_s / (1000.0 * c_s));
    let cases = [(20.0, -10.0, 0.29349, 2.185e-3), (20.0, 0.0, 0.34050, 2.535e-3), (60.0, -10.0, 0.50600, 3.767e-3)];
    let mut rows = Vec::new();
    let mut plot = Plot::new("melting front", "time / s", "thickness of the melt / mm");
    for (wall, start, lambda, end) in cases {
        let (spacing, cells) = (0.25e-3, 80usize);
        let n = cells + 1;
        let grid = Grid { origin: [0.0; 3], spacing, nodes: [n, 1, 1] };
        let mut solver = ThermalSolver::new(grid, std::slice::from_ref(&material), 273.15, ThermalOptions::default());
        let volume = vec![spacing.powi(3); n];
        let mut mass: Vec<f64> = volume.iter().map(|v| 1000.0 * v).collect();
        mass[0] = 0.0;
        let mut energy: Vec<f64> = mass.iter().map(|m| m * c_s * start).collect();
        let mut walls = vec![Wall::Open; n];
        walls[0] = Wall::Fixed((273.15 + wall) as f32);
        let kind = vec![0; n];
        let dt = 5e-3;
        let (mut ours, mut last) = (Vec::new(), 0.0);
        for step in 0..20_000u32 {
            let mut fields = NodeFields { mass: &mass, volume: &volume, material: &kind, energy: &mut energy };
            alone(|| solver.step_nodes(&mut fields, dt, 0.0, &[], Some(&walls))).unwrap_or_else(|e| panic!("{e}"));
            if (step + 1) % 500 == 0 {
                let melted = energy.iter().zip(&mass).skip(1).map(|(e, m)| solver.liquid_fraction(0, e / m)).sum::<f64>();
                last = melted * spacing;
                ours.push([f64::from(step + 1) * dt, 1e3 * last]);
            }
        }
        let label = format!("wall {wall} °C, ice {start} °C");
        rows.push(Row::relative(format!("melt after 100 s, {label} [mm]"), 1e3 * end, 1e3 * last, 0.015));
        // The temperature where the front is not: half way through the melt.
        let x = 0.5 * end;
        let exact = wall * (1.0 - erf(x / (2.0 * (a_l * 100.0).sqrt())) / erf(lambda));
        let at = x / spacing + 0.5;
        let t = |i: usize| solver.temperature(0, energy[i] / mass[i]) - 273.15;
        let got = t(at as usize) + (at - at.floor()) * (t(at as usize + 1) - t(at as usize));
        rows.push(Row::new(format!("half way through the melt, {label} [°C]"), exact, got, 0.015 * wall));
        plot = plot.function(format!("Neumann, {label}"), 0.0, 100.0, |t| 2e3 * lambda * (a_l * t).sqrt()).ours(label, ours);
    }
    let note = format!("α of water {a_l:.3e}, of ice {a_s:.3e} m²/s.");
    Outcome::from(rows).plot(plot).note(note)
}

/// Front position from which the error counts \[cells\].
const START_UP: f64 = 4.0;

/// Rows, and √t, front and exact front along the way.
fn stefan_bar(cells: usize, st: f64) -> (Vec<Row>, Vec<[f64; 3]>) {
    let k = 0.15;
    let lambda = stefan_lambda(st);
    // Nodes 0–2 are the wall, whose face is at ξ = 2.5; four empty layers end the bar.
    let grid = Grid { origin: [0.0; 3], spacing: 1.0, nodes: [cells + 7, 3, 3] };
    let options = ThermalOptions { periodic: [false, true, true], ..ThermalOptions::default() };
    let mut solver = ThermalSolver::new(grid, &[stefan_material(st, k)], 0.0, options);
    let walls: Vec<Wall> = (0..grid.len()).map(|i| if grid.node(i)[0] < 3 { Wall::Fixed(1.0) } else { Wall::Open }).collect();
    let mut cloud = Cloud::default();
    let sites = |n: usize| (0..3 * n).map(|i| (i as f64 + 0.5) / 3.0);
    for x in sites(cells) {
        for y in sites(3) {
            for z in sites(3) {
                cloud.push([2.5 + x, y, z], 1.0 / 27.0, 1.0 / 27.0, 0, 0.0);
            }
        }
    }
    let steps = ((0.7 * cells as f64 / (2.0 * lambda)).powi(2) / k).ceil() as u32;
    let mut total = Audit::default();
    let (mut worst, mut last) = (0.0f64, 0.0f64);
    let mut widest = 0.0f64;
    let mut seen = Vec::new();
    for step in 0..steps {
        total.append(&cloud.step(&mut solver, 1.0, f64::from(step), &[], Some(&walls)));
        if (step + 1) % (steps / 20) == 0 {
            let (mut front, mut mushy) = (0.0, 0.0);
            for h in &cloud.h {
                let f = solver.liquid_fraction(0, *h);
                front += f / 243.0;
                mushy += f64::from(u8::from(f > 0.01 && f < 0.99)) / 243.0;
            }
            let exact = 2.0 * lambda * (k * f64::from(step + 1)).sqrt();
            last = front - exact;
            seen.push([f64::from(step + 1).sqrt(), front, exact]);
            // The first cells are a start-up: the front is narrower than the kernel.
            if exact >= START_UP && last.abs() > worst.abs() {
                worst = last;
            }
            widest = widest.max(mushy);
        }
    }
    let label = format!("St = {st}, N = {cells}");
    let rows = vec![
        Row::new(format!("front error at 0.7 N, {label} [cells]"), 0.0, last, 0.1),
        Row::new(format!("largest front error past {START_UP} cells, {label}"), 0.0, worst, 0.1),
        Row::new(format!("largest mushy width, {label} [cells]"), 1.0, widest, 1.0),
        Row::new(format!("audit, {label}, relative"), 0.0, total.residual / total.after, 1e-10),
    ];
    (rows, seen)
}
