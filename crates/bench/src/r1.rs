//! R1: the surface of the particle block of M1 as a mesh, the same points and voxels as the peers' script.

use megas_skin::mesh::{MeshSettings, Surface, Topology, particle_mesh};
use serde_json::json;

use crate::block::Size;
use crate::timing;

/// Options.
#[derive(clap::Args)]
pub struct Args {
    /// Number of particles
    #[arg(long, value_enum, default_value = "200k")]
    size: Size,
    /// Threads
    #[arg(long, default_value_t = 1)]
    threads: usize,
    /// Edge of a voxel in grid cells dx; the particles stand half a cell apart
    #[arg(long, default_value_t = 0.5)]
    voxel: f64,
    /// Rounds of smoothing (the peers do none)
    #[arg(long, default_value_t = 0)]
    smoothing: u32,
    /// Random displacement of the particles in units of their distance (0 is the peers' lattice)
    #[arg(long, default_value_t = 0.0)]
    jitter: f64,
    /// Timed repetitions
    #[arg(long, default_value_t = 11)]
    reps: usize,
}

/// Grid cells along the unit box.
const GRID: f64 = 64.0;

fn points(size: Size, jitter: f64) -> Vec<[f32; 3]> {
    let n: [usize; 3] = size.sites();
    let dx = 1.0 / GRID;
    let h = 0.5 * dx;
    let start = [0.5 - n[0] as f64 * h / 2.0, 4.0 * dx, 0.5 - n[2] as f64 * h / 2.0];
    let mut rng = megas_math::rng::Rng::new(1);
    let mut out = Vec::with_capacity(n.iter().product());
    for i in 0..n[0] {
        for j in 0..n[1] {
            for k in 0..n[2] {
                let site = [i, j, k];
                out.push(std::array::from_fn(|a| {
                    let shift = if jitter > 0.0 { rng.range(-jitter, jitter) } else { 0.0 };
                    ((site[a] as f64 + 0.5 + shift) * h + start[a]) as f32
                }));
            }
        }
    }
    out
}

/// Runs the scene and returns its JSON line.
pub fn run(args: &Args) -> String {
    let pool = match rayon::ThreadPoolBuilder::new().num_threads(args.threads).build() {
        Ok(pool) => pool,
        Err(e) => return json!({"scene": "r1", "error": e.to_string()}).to_string(),
    };
    pool.install(|| {
        let points = points(args.size, args.jitter);
        let dx = 1.0 / GRID;
        let settings = MeshSettings { voxel: args.voxel * dx, smoothing: args.smoothing, ..MeshSettings::new(0.5 * dx, 1.0) };
        let (mut wall, mut cpu) = (Vec::new(), Vec::new());
        let mut mesh = particle_mesh(&points, &settings);
        for _ in 0..args.reps.max(1) {
            let (w, c) = timing::measure(|| mesh = particle_mesh(&points, &settings));
            wall.push(w);
            cpu.push(c);
        }
        let (w, c) = (timing::median(&wall), timing::median(&cpu));
        let surface = Surface::of(&mesh);
        json!({
            "scene": "r1", "n": points.len(), "voxel_dx": args.voxel, "jitter": args.jitter, "smoothing": args.smoothing,
            "threads": args.threads, "reps": wall.len(), "median_wall_s": w, "median_cpu_s": c,
            "particles_per_core_s": points.len() as f64 / c, "particles_per_s": points.len() as f64 / w,
            "vertices": mesh.positions.len(), "triangles": mesh.triangles.len(), "volume": surface.volume,
            "watertight": Topology::of(&mesh).watertight(), "load": timing::load(),
            "simd": format!("{:?}", fearless_simd::Level::new()).split('(').next().unwrap_or_default(),
            "version": env!("CARGO_PKG_VERSION"),
        })
        .to_string()
    })
}
