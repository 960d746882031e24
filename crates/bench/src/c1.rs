//! C1: the whole simulator (mechanics, heat, film air, phases, checks) on a torus of soft wax that melts on a floor.

use megas_validation::cost::Torus;

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

/// Runs and describes the measurement.
pub fn run(args: &Args) -> serde_json::Value {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(args.threads).build();
    match pool {
        Ok(pool) => pool.install(|| measure(args)),
        Err(_) => measure(args),
    }
}

fn measure(args: &Args) -> serde_json::Value {
    let air = matches!(args.air, Air::Lbm).then(|| args.storage.storage());
    let nodes = args.nodes.unwrap_or(2 * args.cells);
    let cost = match (Torus { cells: args.cells, nodes, air }).measure(args.frames) {
        Ok(c) => c,
        Err(e) => return serde_json::json!({ "error": e }),
    };
    let (n, step) = (cost.points, cost.solver.air_step());
    serde_json::json!({
        "scene": "c1", "points": n, "cells": args.cells, "nodes": nodes, "threads": args.threads,
        "air": format!("{:?}", args.air).to_lowercase(), "storage": format!("{:?}", args.storage).to_lowercase(),
        "substeps_per_s": cost.substeps_per_s,
        "core_s_per_frame": cost.core_s_per_frame,
        "core_s_per_s": cost.core_s_per_frame * 24.0,
        "ns_per_point_substep": cost.core_s_per_frame * 24.0 / (cost.substeps_per_s * n as f64) * 1e9,
        "air_steps_per_coupling_step": step.map(|s| s.steps), "air_thickened": step.map(|s| s.thickened),
        "rollbacks": cost.solver.totals().rollbacks,
        "energy_residual": cost.solver.totals().energy_residual(),
        "load": timing::load(),
    })
}
