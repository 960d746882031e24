//! C1: the whole simulator (mechanics, heat, film air, phases, checks) on a torus of soft wax that melts on a floor.

use megas_model::{FLAG_INTERNAL, Points};
use megas_sim::air::SimulatedAir;
use megas_sim::collider::{Collider, Shape, Thermal};
use megas_sim::grid::Grid;
use megas_sim::material::{Law, Material, PhaseMode, Rheology};
use megas_sim::phase::PhaseOptions;
use megas_sim::solver::{Coupling, Solver, SolverConfig};
use megas_sim::source::Film;
use megas_sim::thermal::{AirModel, ThermalOptions};

use crate::timing;

/// Options.
#[derive(clap::Args)]
pub struct Args {
    /// Cells along the torus (48 gives 102 000 points at 8 per cell)
    #[arg(long, default_value_t = 48)]
    cells: usize,
    /// Nodes per axis of the box; default: the torus and the clearance that a film gives it
    #[arg(long)]
    nodes: Option<usize>,
    /// Frames of 1/24 s to measure, after one to warm up
    #[arg(long, default_value_t = 4)]
    frames: u32,
    /// What surrounds the torus: a film, or simulated air of which the box is full
    #[arg(long, value_enum, default_value = "film")]
    air: Air,
    /// Number format of simulated air
    #[arg(long, value_enum, default_value = "f32")]
    storage: crate::lattice::Format,
    /// Threads
    #[arg(long, default_value_t = 1)]
    threads: usize,
}

#[derive(Clone, Copy, Debug, PartialEq, clap::ValueEnum)]
enum Air {
    Film,
    Lbm,
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

/// Runs and describes the measurement.
pub fn run(args: &Args) -> serde_json::Value {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(args.threads).build();
    match pool {
        Ok(pool) => pool.install(|| measure(args)),
        Err(_) => measure(args),
    }
}

fn measure(args: &Args) -> serde_json::Value {
    let cells = args.cells as f64;
    let spacing = SIZE / cells;
    let nodes = args.nodes.unwrap_or(2 * args.cells);
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
    let air = match args.air {
        Air::Film => AirModel::Film(film),
        // The settings that a scene file gets: a film where the boundary layer is thinner than a cell, radiation.
        Air::Lbm => AirModel::Simulated(SimulatedAir {
            wall_film: film.coefficient,
            emissivity: film.emissivity,
            temperature_difference: 60.0,
            storage: args.storage.storage(),
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
        coupling: Coupling::default(),
    };
    let mut solver = match Solver::new(config, &points) {
        Ok(s) => s,
        Err(e) => return serde_json::json!({ "error": e.to_string() }),
    };
    let mut cpu = Vec::new();
    let mut error = None;
    for frame in 0..=args.frames {
        let (_, seconds) = timing::measure(|| error = solver.advance_frame(&|| false).err());
        if let Some(e) = &error {
            return serde_json::json!({ "error": e.to_string() });
        }
        solver.export();
        if frame > 0 {
            cpu.push(seconds);
        }
    }
    let per_frame = timing::median(&cpu);
    let substeps = solver.totals().substeps as f64 / f64::from(args.frames + 1);
    serde_json::json!({
        "scene": "c1", "points": n, "cells": args.cells, "nodes": nodes, "threads": args.threads,
        "air": format!("{:?}", args.air).to_lowercase(), "storage": format!("{:?}", args.storage).to_lowercase(),
        "substeps_per_s": substeps * 24.0,
        "core_s_per_frame": per_frame,
        "core_s_per_s": per_frame * 24.0,
        "ns_per_point_substep": per_frame / (substeps * n as f64) * 1e9,
        "air_steps_per_coupling_step": solver.air_step().map(|s| s.steps), "air_thickened": solver.air_step().map(|s| s.thickened),
        "rollbacks": solver.totals().rollbacks,
        "energy_residual": solver.totals().energy_residual(),
        "load": timing::load(),
    })
}
