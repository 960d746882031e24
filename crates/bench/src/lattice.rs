//! L1 and L2: lattice Boltzmann air in a periodic box, the flow alone and with temperature.

use std::f64::consts::TAU;

use megas_sim::air::{LAMBDA_AIR, LAMBDA_FLOW, Lattice, LatticeSettings, Storage};

use crate::timing;

/// Options.
#[derive(clap::Args)]
pub struct Args {
    /// Nodes per axis
    #[arg(long, default_value_t = 128)]
    n: usize,
    /// Collision operator: trt, or bgk as the peers have it
    #[arg(long, value_enum, default_value = "trt")]
    operator: Operator,
    /// Number format of the stored populations
    #[arg(long, value_enum, default_value = "f32")]
    storage: Format,
    /// L2: the flow on cells of 2³ nodes
    #[arg(long)]
    coarse_flow: bool,
    /// Threads
    #[arg(long, default_value_t = 1)]
    threads: usize,
}

#[derive(Clone, Copy, Debug, PartialEq, clap::ValueEnum)]
enum Operator {
    Trt,
    Bgk,
}

/// Number format of stored populations.
#[derive(Clone, Copy, Debug, PartialEq, clap::ValueEnum)]
pub enum Format {
    F32,
    F16,
}

impl Format {
    /// As the simulator calls it.
    pub fn storage(self) -> Storage {
        match self {
            Self::F32 => Storage::F32,
            Self::F16 => Storage::F16,
        }
    }
}

const SPEED: f64 = 0.05;
const TAU_FLOW: f64 = 0.56;
const WARM_UP: usize = 5;
const REPETITIONS: usize = 7;
const STEPS: usize = 5;

/// Runs L1 (`heat` = false) or L2 and returns its JSON line.
pub fn run(args: &Args, heat: bool) -> String {
    let scene = if heat { "l2" } else { "l1" };
    match rayon::ThreadPoolBuilder::new().num_threads(args.threads).build() {
        Ok(pool) => pool.install(|| measure(args, heat, scene)),
        Err(e) => serde_json::json!({"scene": scene, "error": e.to_string()}).to_string(),
    }
}

fn measure(args: &Args, heat: bool, scene: &str) -> String {
    let n = args.n;
    let trt = args.operator == Operator::Trt;
    let flow_ratio = if heat && args.coarse_flow { 2 } else { 1 };
    // α 0.02, β 1, g_z −0.0005 with T₀ = 1: the force is 0.0005 (T − 1) upwards.
    let mut lattice = Lattice::new(LatticeSettings {
        heat,
        lambda_flow: trt.then_some(LAMBDA_FLOW),
        lambda_heat: trt.then_some(LAMBDA_AIR),
        buoyancy: [0.0, 0.0, if heat { 0.0005 } else { 0.0 }],
        storage: args.storage.storage(),
        flow_ratio,
        ..LatticeSettings::new([n; 3], (TAU_FLOW - 0.5) / 3.0, 0.02)
    });
    let k = TAU / n as f64;
    lattice.fill(|node| {
        let [x, y, z] = node.map(|i| k * (i as f64 + 0.5));
        let u = [SPEED * x.cos() * y.sin() * z.sin(), -SPEED * x.sin() * y.cos() * z.sin(), 0.0];
        (1.0, u, 0.5 * z.sin())
    });
    let advance = |lattice: &mut Lattice, steps: usize| {
        for _ in 0..steps {
            lattice.step();
        }
    };
    advance(&mut lattice, WARM_UP);
    let times: Vec<(f64, f64)> = (0..REPETITIONS).map(|_| timing::measure(|| advance(&mut lattice, STEPS))).collect();
    let (mut rho, mut ux2, mut t) = (0.0, 0.0, 0.0);
    for i in 0..n {
        for j in 0..n {
            for l in 0..n {
                let (r, u) = lattice.flow([i, j, l]);
                rho += r;
                ux2 += u[0] * u[0];
                t += if heat { lattice.temperature([i, j, l]) } else { 0.0 };
            }
        }
    }
    let nodes = (n * n * n) as f64;
    let wall = timing::median(&times.iter().map(|t| t.0).collect::<Vec<_>>());
    let cpu = timing::median(&times.iter().map(|t| t.1).collect::<Vec<_>>());
    let updates = nodes * STEPS as f64 / 1e6;
    let mut out = serde_json::json!({
        "scene": scene, "n": n, "operator": format!("{:?}", args.operator).to_lowercase(),
        "storage": format!("{:?}", args.storage).to_lowercase(), "flow_ratio": flow_ratio, "threads": args.threads,
        "reps": REPETITIONS, "median_wall_s": wall, "median_cpu_s": cpu, "median_MLUPs": updates / wall,
        "median_MLUP_per_core_s": updates / cpu, "mean_rho": rho / nodes, "ux_rms": (ux2 / nodes).sqrt(),
        "steps": WARM_UP + REPETITIONS * STEPS, "simd": lattice.simd(), "load": timing::load(), "version": env!("CARGO_PKG_VERSION"),
    });
    if heat {
        out["mean_T"] = (1.0 + t / nodes).into();
    }
    out.to_string()
}
