//! V47: what a second of animation costs, against the matter and against the empty box (simulation.md §8.6). A record, not a gate.

use megas_model::{FLAG_INTERNAL, Points};
use megas_sim::air::{Face, Lattice, LatticeSettings, SimulatedAir, Storage};
use megas_sim::collider::{Collider, Shape, Thermal};
use megas_sim::grid::Grid;
use megas_sim::material::{Law, Material, PhaseMode, Rheology};
use megas_sim::phase::PhaseOptions;
use megas_sim::solver::{Coupling, Solver, SolverConfig};
use megas_sim::source::Film;
use megas_sim::thermal::{AirModel, ThermalOptions};

use crate::timing::{measure, median};
use crate::{Case, Outcome, Plot, Row, Tier};

/// The case of this module.
pub const CASES: &[Case] = &[Case::new("V47", "cost of a second, against matter and empty box", Tier::C, cost)
    .proves("cost follows the matter, not the box; no gate on times, which are those of the machine")
    .setup(
        "a torus of soft wax on a plate of 350 K, 8 points per cell; 16 to 48 cells in a box of twice the size, then 24 cells in \
         boxes up to eight times the size; processor time of all threads",
    )
    .formula("proportional to points · substeps; independent of the box with film air, proportional to it with simulated air")];

/// The benchmark scene c1.
#[derive(Clone, Copy, Debug)]
pub struct Torus {
    /// Cells along it.
    pub cells: usize,
    /// Nodes per axis of the box.
    pub nodes: usize,
    /// Simulated air with this storage instead of a film.
    pub air: Option<Storage>,
}

/// What frames of the scene took.
pub struct Cost {
    /// Number of points.
    pub points: usize,
    /// Substeps per second of animation.
    pub substeps_per_s: f64,
    /// Processor seconds per frame of 1/24 s, the median.
    pub core_s_per_frame: f64,
    /// The solver after the last frame.
    pub solver: Solver,
}

/// Length of the torus \[m\].
const SIZE: f64 = 0.2;

/// A wax of the default visual stiffness for a thing of this size, ρ g H / 0.005.
fn wax() -> Material {
    let (shear_modulus, bulk_modulus) = Material::moduli(1000.0 * 9.81 * SIZE / 0.005, 0.3);
    Material {
        name: "wax".into(),
        law: Law::Hencky,
        density: 1000.0,
        shear_modulus,
        bulk_modulus,
        solid_yield_stress: 2e4,
        melt_shear_modulus: 0.3 * bulk_modulus,
        melt: Rheology { yield_stress: 20.0, consistency: 5.0, index: 1.0 },
        softening: 0.5,
        reference_temperature: 293.0,
        heat_capacity_solid: 2000.0,
        heat_capacity_liquid: 2000.0,
        conductivity_solid: 2.5,
        conductivity_liquid: 2.5,
        latent_heat: 1e3,
        solidus: 329.5,
        liquidus: 330.5,
        phase_mode: PhaseMode::Mushy,
        ..Material::default()
    }
}

impl Torus {
    /// Advances by one frame to warm up and measures the next `frames`.
    ///
    /// # Errors
    /// What the solver says.
    pub fn measure(&self, frames: u32) -> Result<Cost, String> {
        let (config, points) = self.scene();
        let mut solver = Solver::new(config, &points).map_err(|e| e.to_string())?;
        let mut cpu = Vec::new();
        for frame in 0..=frames.max(1) {
            let mut result = Ok(None);
            let (_, seconds) = measure(|| result = solver.advance_frame(&|| false));
            result.map_err(|e| e.to_string())?;
            solver.export();
            if frame > 0 {
                cpu.push(seconds);
            }
        }
        let substeps_per_s = solver.totals().substeps as f64 / f64::from(frames.max(1) + 1) * 24.0;
        Ok(Cost { points: points.position.len(), substeps_per_s, core_s_per_frame: median(&cpu), solver })
    }

    fn scene(&self) -> (SolverConfig, Points) {
        let cells = self.cells as f64;
        let spacing = SIZE / cells;
        let nodes = self.nodes;
        let grid = Grid { origin: [0.0; 3], spacing, nodes: [nodes; 3] };
        let (tube, ring) = (cells / 8.0, 3.0 * cells / 8.0);
        let floor = 6.0;
        let middle = [0.5 * nodes as f64, 0.5 * nodes as f64, floor + tube + 0.5];
        let mut points = Points::default();
        let reach = (ring + tube).ceil() as i64 * 2;
        for i in -reach..reach {
            for j in -reach..reach {
                for k in -(2.0 * tube) as i64 - 1..=(2.0 * tube) as i64 {
                    let x = [i, j, k].map(|c| 0.5 * (c as f64 + 0.5));
                    if (x[0].hypot(x[1]) - ring).hypot(x[2]) < tube {
                        points.position.push(std::array::from_fn(|a| spacing * (middle[a] + x[a])));
                    }
                }
            }
        }
        let n = points.position.len();
        points.volume = vec![(0.5 * spacing).powi(3) as f32; n];
        points.temperature = vec![328.0; n];
        points.normal = vec![[0.0; 3]; n];
        points.material = vec![0; n];
        points.object = vec![1; n];
        points.flags = vec![FLAG_INTERNAL; n];
        points.id = (0..n as u32).collect();
        let table = Collider {
            thermal: Thermal::Fixed { kelvin: 350.0, keyframes: Vec::new() },
            ..Collider::new(Shape::HalfSpace { point: [0.0, 0.0, floor * spacing], normal: [0.0, 0.0, 1.0] })
        };
        let film = Film { ambient: 350.0, coefficient: 10.0, emissivity: 0.9 };
        let air = match self.air {
            None => AirModel::Film(film),
            // The settings that a scene file gets: a film where the boundary layer is thinner than a cell, radiation.
            Some(storage) => AirModel::Simulated(SimulatedAir {
                wall_film: film.coefficient,
                emissivity: film.emissivity,
                temperature_difference: 60.0,
                storage,
                ..SimulatedAir::default()
            }),
        };
        let config = SolverConfig {
            grid,
            materials: vec![wax()],
            sources: Vec::new(),
            colliders: vec![table],
            gravity: [0.0, 0.0, -9.81],
            ambient: 293.15,
            thermal: ThermalOptions { air, ..ThermalOptions::default() },
            phase: PhaseOptions::default(),
            frame_dt: 1.0 / 24.0,
            coupling_step: 2e-3,
            courant: 0.4,
            mechanics: true,
            bounds: Default::default(),
            coupling: Coupling::default(),
        };
        (config, points)
    }
}

/// Million node updates per core-second of flow and temperature in a closed box of 64³ nodes.
fn lattice_rate() -> f64 {
    let settings =
        LatticeSettings { buoyancy: [0.0, 0.0, 1e-5], faces: [[Face::WALL; 2]; 3], ..LatticeSettings::new([64; 3], 0.01, 0.014) };
    let mut lattice = Lattice::new(settings);
    lattice.fill(|n| (1.0, [0.0; 3], if n[2] < 8 { 1.0 } else { 0.0 }));
    let (_, seconds) = measure(|| (0..60).for_each(|_| _ = lattice.step()));
    60.0 * 64.0f64.powi(3) / seconds.max(1e-9) * 1e-6
}

fn cost() -> Outcome {
    let (mut residual, mut failed) = (0.0f64, Vec::new());
    let mut run = |cells: usize, nodes: usize, air: Option<Storage>| match (Torus { cells, nodes, air }).measure(1) {
        Ok(c) => {
            residual = residual.max(c.solver.totals().energy_residual().abs());
            Some(c)
        }
        Err(e) => {
            failed.push(e);
            None
        }
    };
    let matter: Vec<Cost> = [16, 24, 32, 40, 48].into_iter().filter_map(|n| run(n, 2 * n, None)).collect();
    let boxes = [48, 64, 96, 128, 192];
    let small = matter.get(1).map_or(0, |c| c.points);
    let film: Vec<[f64; 2]> =
        boxes.into_iter().filter_map(|n| Some([(n as f64).powi(3), 24.0 * run(24, n, None)?.core_s_per_frame])).collect();
    let flowing: Vec<[f64; 2]> =
        boxes[..4].iter().filter_map(|&n| Some([(n as f64).powi(3), 24.0 * run(24, n, Some(Storage::F32))?.core_s_per_frame])).collect();
    let work = |c: &Cost| c.points as f64 * c.substeps_per_s;
    let measured: Vec<[f64; 2]> = matter.iter().map(|c| [work(c), 24.0 * c.core_s_per_frame]).collect();
    let mut matter_plot = Plot::new("cost of a second, film air", "points · substeps per second", "core-seconds").log(true, true);
    if let (Some([w0, t0]), Some([w1, _])) = (measured.last().copied(), measured.first().copied()) {
        matter_plot = matter_plot.function("proportional", w1, w0, |w| t0 * w / w0);
    }
    let mut outcome = Outcome::from(vec![
        Row::new("runs that failed", 0.0, failed.len() as f64, 0.0),
        Row::new("largest relative residual of the energy audits", 0.0, residual, 1e-6),
    ])
    .plot(matter_plot.ours("torus of 16 to 48 cells", measured))
    .plot(
        Plot::new("cost of a second, 24 cells in larger boxes", "nodes of the box", "core-seconds")
            .log(true, true)
            .ours("film air", film.clone())
            .ours("simulated air", flowing.clone()),
    );
    for c in &matter {
        outcome = outcome.note(format!(
            "{} points, {:.0} substeps per second: {:.3} M point updates per core-second with everything (heat, film, phases)",
            c.points,
            c.substeps_per_s,
            work(c) / (24.0 * c.core_s_per_frame).max(1e-9) * 1e-6
        ));
    }
    for (name, curve) in [("film air", &film), ("simulated air", &flowing)] {
        let list: Vec<String> = curve.iter().map(|[n, s]| format!("{:.0}³: {s:.2}", n.cbrt())).collect();
        outcome = outcome.note(format!("{name}, {small} points, core-seconds per second by box: {}", list.join(", ")));
    }
    outcome.note(format!("lattice of flow and temperature, 64³: {:.0} M node updates per core-second", lattice_rate()))
}
