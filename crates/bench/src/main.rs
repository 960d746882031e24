//! Benchmark scenes: one JSON line on standard output, nothing else (see `--help`).

mod block;
mod c1;
mod lattice;
mod m1;
mod r1;
mod s1;
mod t1;
mod timing;

use clap::{Parser, Subcommand};

#[derive(Parser)]
#[command(name = "megas-bench", version, about = "Benchmark scenes of MeGAS; each prints one JSON line")]
struct Cli {
    #[command(subcommand)]
    scene: Scene,
}

#[derive(Subcommand)]
enum Scene {
    /// The whole simulator on a melting torus: cost against matter and against the empty box
    C1(c1::Args),
    /// Lattice Boltzmann air in a periodic box, flow alone
    L1(lattice::Args),
    /// Lattice Boltzmann air in a periodic box, flow and temperature
    L2(lattice::Args),
    /// MLS-MPM/APIC block in a unit box
    M1(m1::Args),
    /// A mesh around the particles of m1
    R1(r1::Args),
    /// Rasterization of random Gaussians, forward and backward
    S1(s1::Args),
    /// Training iterations on the synthetic ice cream
    T1(t1::Args),
}

fn main() {
    let line = match Cli::parse().scene {
        Scene::C1(args) => c1::run(&args).to_string(),
        Scene::L1(args) => lattice::run(&args, false),
        Scene::L2(args) => lattice::run(&args, true),
        Scene::M1(args) => m1::run(&args),
        Scene::R1(args) => r1::run(&args),
        Scene::S1(args) => s1::run(&args),
        Scene::T1(args) => t1::run(&args),
    };
    println!("{line}");
}
