//! M1: an MLS-MPM/APIC block in a unit box, the same work as the peers' scripts (particles on a lattice, slip walls, shear).

use clap::ValueEnum;
use megas_model::Points;
use megas_sim::grid::Grid;
use megas_sim::material::{Law, Material, PhaseMode, Rheology};
use megas_sim::mechanics::{FlowStiffness, Mechanics, Settings};
use megas_sim::particles::{FLUID, Particles};

use crate::block::Size;
use crate::timing;

/// Options.
#[derive(clap::Args)]
pub struct Args {
    /// Nodes per axis
    #[arg(long, default_value_t = 128)]
    grid: usize,
    /// Number of particles
    #[arg(long, value_enum, default_value = "200k")]
    size: Size,
    /// Constitutive law
    #[arg(long, value_enum, default_value = "jelly")]
    mat: Mat,
    /// Order of the particles in memory at the start
    #[arg(long, value_enum, default_value = "lattice")]
    order: Order,
    /// Threads
    #[arg(long, default_value_t = 1)]
    threads: usize,
    /// Report mean_x and ke after this many steps and measure nothing else; default: after all 260
    #[arg(long)]
    nsteps: Option<usize>,
    /// Also integrate the total deformation gradient, as a film does
    #[arg(long)]
    total: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, ValueEnum)]
enum Mat {
    Fluid,
    Jelly,
    Hb,
    NeoHookean,
    VonMises,
    Sand,
    Water,
}

#[derive(Clone, Copy, Debug, PartialEq, ValueEnum)]
enum Order {
    Lattice,
    Shuffle,
}

const DENSITY: f64 = 1000.0;
const YOUNG: f64 = 1e5;
const POISSON: f64 = 0.3;
const DT: f64 = 1e-4;
const SHEAR_RATE: f64 = 20.0;
const WARM_UP: usize = 10;
const REPETITIONS: usize = 5;
const STEPS: usize = 50;

/// Fisher–Yates with the 64-bit linear congruential generator of the benchmark's definition.
fn shuffled(n: usize) -> Vec<usize> {
    let mut p: Vec<usize> = (0..n).collect();
    let mut s = 1u64;
    for i in (1..n).rev() {
        s = s.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        p.swap(i, ((s >> 33) % (i as u64 + 1)) as usize);
    }
    p
}

fn scene(args: &Args) -> Result<(Particles, Grid), String> {
    let dims: [usize; 3] = args.size.sites();
    let dx = 1.0 / args.grid as f64;
    let h = 0.5 * dx;
    let grid = Grid { origin: [0.0; 3], spacing: dx, nodes: [args.grid; 3] };
    let n = dims.iter().product();
    let order = if args.order == Order::Shuffle { shuffled(n) } else { (0..n).collect() };
    // The peers hold positions in f32; the lattice is the same to its last digit.
    let position = |index: usize| -> [f64; 3] {
        let site = [index / (dims[1] * dims[2]), index / dims[2] % dims[1], index % dims[2]];
        std::array::from_fn(|a| {
            let start = if a == 1 { 4.0 * dx } else { 0.5 - dims[a] as f64 * h / 2.0 };
            f64::from(((site[a] as f64 + 0.5) * h + start) as f32)
        })
    };
    let points = Points {
        position: order.iter().map(|&i| position(i)).collect(),
        volume: vec![(h * h * h) as f32; n],
        temperature: vec![300.0; n],
        normal: vec![[0.0; 3]; n],
        material: vec![0; n],
        object: vec![1; n],
        flags: vec![0; n],
        id: (0..n as u32).collect(),
    };
    let (shear, bulk) = Material::moduli(YOUNG, POISSON);
    let material = Material {
        name: "m1".into(),
        law: match args.mat {
            Mat::Jelly => Law::FixedCorotated,
            Mat::Hb => Law::Hencky,
            Mat::NeoHookean => Law::NeoHookean,
            Mat::VonMises => Law::VonMises,
            Mat::Sand => Law::DruckerPrager,
            Mat::Fluid | Mat::Water => Law::Fluid,
        },
        density: DENSITY,
        shear_modulus: shear,
        bulk_modulus: if matches!(args.mat, Mat::Fluid | Mat::Water) { YOUNG } else { bulk },
        solid_yield_stress: 50.0,
        melt_shear_modulus: shear,
        melt: Rheology { yield_stress: 0.0, consistency: 5.0, index: 1.0 },
        arrhenius_k: 0.0,
        softening: 0.0,
        reference_temperature: 300.0,
        heat_capacity_solid: 1.0,
        heat_capacity_liquid: 1.0,
        conductivity_solid: 1.0,
        conductivity_liquid: 1.0,
        latent_heat: 0.0,
        solidus: f64::INFINITY,
        liquidus: f64::INFINITY,
        phase_mode: PhaseMode::Mushy,
        hardening: 0.1 * YOUNG,
        friction_angle: 33f64.to_radians(),
        fluid_viscosity: 0.001,
        ..Material::default()
    };
    let mut particles = Particles::new(&points, &grid, &[material]).map_err(|e| e.to_string())?;
    if args.mat == Mat::Hb {
        particles.viscosity.fill(10.0);
    }
    if args.mat == Mat::Fluid {
        // The peers' fluid: pressure K (1 − J), without viscosity, in tension too.
        particles.law.fill(FLUID);
        particles.viscosity.fill(0.0);
        particles.exponent.fill(-1.0);
        particles.law_constant.fill(f32::INFINITY);
    }
    for i in 0..n {
        let y = particles.position(i)[1];
        particles.set_velocity(i, [(SHEAR_RATE * (y - 4.0 * dx)) as f32, 0.0, 0.0]);
    }
    Ok((particles, grid))
}

/// Runs the scene and returns its JSON line.
pub fn run(args: &Args) -> String {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(args.threads).build();
    let line = match pool {
        Ok(pool) => pool.install(|| measure(args)),
        Err(e) => Err(e.to_string()),
    };
    line.unwrap_or_else(|e| serde_json::json!({"scene": "m1", "error": e}).to_string())
}

fn measure(args: &Args) -> Result<String, String> {
    let (mut particles, grid) = scene(args)?;
    let settings =
        Settings { gravity: [0.0, -9.8, 0.0], flow: FlowStiffness::Yue, track_total: args.total, isolation: 0.0, ..Settings::default() };
    let mut mechanics = Mechanics::new(&grid, settings, Vec::new());
    let mut times = Vec::new();
    let mut steps = args.nsteps.unwrap_or(WARM_UP);
    mechanics.run(&mut particles, steps, DT);
    if args.nsteps.is_none() {
        for _ in 0..REPETITIONS {
            times.push(timing::measure(|| {
                mechanics.run(&mut particles, STEPS, DT);
            }));
            steps += STEPS;
        }
    }
    let n = particles.len();
    let mut mean = [0.0f64; 3];
    let mut kinetic = 0.0;
    for i in 0..n {
        let x = particles.position(i);
        for a in 0..3 {
            mean[a] += x[a] / n as f64;
        }
        let v2: f64 = particles.velocity(i).iter().map(|&v| f64::from(v) * f64::from(v)).sum();
        kinetic += 0.5 * f64::from(particles.mass[i]) * v2;
    }
    let mut out = serde_json::json!({
        "scene": "m1", "grid": args.grid, "n": n, "mat": format!("{:?}", args.mat).to_lowercase(),
        "order": format!("{:?}", args.order).to_lowercase(), "threads": args.threads, "nsteps": steps,
        "mean_x": mean, "ke": kinetic, "simd": mechanics.simd(), "load": timing::load(), "version": env!("CARGO_PKG_VERSION"),
    });
    if !times.is_empty() {
        let wall = timing::median(&times.iter().map(|t| t.0).collect::<Vec<_>>());
        let cpu = timing::median(&times.iter().map(|t| t.1).collect::<Vec<_>>());
        let updates = (n * STEPS) as f64 / 1e6;
        out["reps"] = REPETITIONS.into();
        out["median_wall_s"] = wall.into();
        out["median_cpu_s"] = cpu.into();
        out["median_Mps"] = (updates / wall).into();
        out["median_M_per_core_s"] = (updates / cpu).into();
    }
    Ok(out.to_string())
}
