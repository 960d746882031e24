//! The fast lattice against the oracle, step by step, on boxes with every kind of node and face.

use megas_math::rng::Rng;

use super::reference::Reference;
use super::*;

fn box_of_everything(faces: [[Face; 2]; 3], smagorinsky: f64) -> LatticeSettings {
    LatticeSettings {
        force: [1e-5, -2e-5, 3e-5],
        buoyancy: [0.0, 1e-4, 2e-3],
        buoyancy_limit: 0.3,
        source: 1e-4,
        smagorinsky,
        faces,
        sponge_layers: 3,
        ..LatticeSettings::new([11, 9, 21], 0.004, 0.03)
    }
}

/// Obstacles: a block at rest that holds a temperature, an adiabatic one, a moving one that exchanges heat, half-full nodes.
fn obstacles() -> Vec<([usize; 3], NodeState)> {
    let mut out = Vec::new();
    for i in 0..11 {
        for j in 0..9 {
            for k in 0..21 {
                let state = match (i, j, k) {
                    (2..=5, 2..=5, 3..=6) => NodeState { solid: 1.0, velocity: [0.0; 3], heat: HeatNode::Fixed(0.5) },
                    (7..=8, 1..=2, 4) => NodeState { solid: 1.0, velocity: [0.0; 3], heat: HeatNode::Adiabatic },
                    (3..=6, 3..=6, 10..=13) => NodeState { solid: 1.0, velocity: [0.02, 0.0, -0.03], heat: HeatNode::Exchange(7) },
                    (8, 4..=7, 12) => NodeState { solid: 0.4, velocity: [0.01, 0.02, 0.0], heat: HeatNode::Exchange(3) },
                    (9, 7, 17) => NodeState { solid: 0.7, velocity: [0.0; 3], heat: HeatNode::Air },
                    _ => continue,
                };
                out.push(([i, j, k], state));
            }
        }
    }
    out
}

fn start(rng: &mut Rng, n: usize) -> Vec<(f64, [f64; 3], f64)> {
    (0..n).map(|_| (rng.range(0.98, 1.02), std::array::from_fn(|_| rng.range(-0.05, 0.05)), rng.range(-0.5, 0.5))).collect()
}

fn compare(settings: LatticeSettings, media: bool, steps: usize) {
    let states = obstacles();
    let mut rng = Rng::new(4);
    let mut slow = Reference::new(settings.clone());
    let n = slow.f.len();
    let initial = start(&mut rng, n);
    let mut fast = Lattice::new(settings.clone());
    if media {
        let values: Vec<(f32, f32)> = (0..n).map(|_| (rng.range(1.0, 20.0) as f32, rng.range(0.01, 0.2) as f32)).collect();
        slow.media = values.iter().map(|(c, k)| (f64::from(*c), f64::from(*k))).collect();
        let index = |x: [usize; 3]| (x[0] * settings.nodes[1] + x[1]) * settings.nodes[2] + x[2];
        fast.set_media(|x| values[index(x)]);
    }
    for (x, s) in &states {
        let i = slow.index(*x);
        slow.states[i] = *s;
    }
    fast.set_nodes(&states);
    slow.fill(|x| initial[(x[0] * settings.nodes[1] + x[1]) * settings.nodes[2] + x[2]]);
    let index = |x: [usize; 3]| (x[0] * settings.nodes[1] + x[1]) * settings.nodes[2] + x[2];
    fast.fill(|x| initial[index(x)]);
    for (x, s) in &states {
        if let HeatNode::Fixed(t) = s.heat {
            fast.set_temperature(*x, t);
        }
    }
    for step in 0..steps {
        let before = slow.clone();
        slow.step(|air, other| {
            // The temperature that the collision of this step sees.
            let _ = before.t[air];
            1e-4 * f64::from(other)
        });
        let report = fast.step_with(|links, flux| {
            for (q, l) in flux.iter_mut().zip(links) {
                *q = 1e-4 * l.other as f32;
            }
        });
        let (mut df, mut dt) = (0.0f64, 0.0f64);
        for i in 0..n {
            let [_, ny, nz] = settings.nodes;
            let x = [i / nz / ny, i / nz % ny, i % nz];
            let ((r, u), (rr, v)) = (fast.flow(x), slow.flow(x));
            df = df.max((r - rr).abs()).max((0..3).map(|a| (u[a] - v[a]).abs()).fold(0.0, f64::max));
            dt = dt.max((fast.temperature(x) - slow.temperature(x)).abs());
        }
        let limit = 2e-6 * (step + 2) as f64;
        assert!(df < limit && dt < limit, "step {step}: flow differs by {df:e}, temperature by {dt:e}");
        assert!((report.wall - slow.gained[0]).abs() < 1e-4, "{} {}", report.wall, slow.gained[0]);
        assert!((report.open - slow.gained[1]).abs() < 1e-4, "{} {}", report.open, slow.gained[1]);
    }
}

const ROOM: [[Face; 2]; 3] = [[Face::OPEN; 2], [Face::OPEN; 2], [Face::WALL, Face::OPEN]];

fn mixed() -> [[Face; 2]; 3] {
    let lid = Face { flow: FlowFace::Moving([0.05, -0.02, 0.0]), heat: HeatFace::Fixed(0.4) };
    let mirror = Face { flow: FlowFace::FreeSlip, heat: HeatFace::Flux(1e-3) };
    [[Face::PERIODIC; 2], [mirror, Face::OPEN], [Face::fixed(-0.3), lid]]
}

#[test]
fn matches_the_oracle_in_a_room() {
    compare(box_of_everything(ROOM, 0.0), false, 8);
}

#[test]
fn matches_the_oracle_with_mixed_faces_and_eddies() {
    compare(box_of_everything(mixed(), 0.15), false, 8);
}

#[test]
fn matches_the_oracle_in_a_periodic_box_of_several_media() {
    compare(box_of_everything([[Face::PERIODIC; 2]; 3], 0.0), true, 8);
}

#[test]
fn matches_the_oracle_with_one_relaxation_time() {
    let settings = LatticeSettings { lambda_flow: None, lambda_heat: None, ..box_of_everything(mixed(), 0.1) };
    compare(settings, false, 5);
}

#[test]
fn corners_of_mirrors_are_mirrors() {
    let mirror = Face { flow: FlowFace::FreeSlip, heat: HeatFace::Adiabatic };
    compare(box_of_everything([[mirror; 2], [mirror; 2], [Face::PERIODIC; 2]], 0.0), false, 6);
}

#[test]
fn the_result_does_not_depend_on_threads() {
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a thread pool");
        pool.install(|| {
            let mut lattice = Lattice::new(box_of_everything(ROOM, 0.1));
            lattice.set_nodes(&obstacles());
            let mut sum = Vec::new();
            for _ in 0..20 {
                let r = lattice.step();
                sum.push((r.open.to_bits(), r.seen.speed2.to_bits()));
            }
            for i in 0..11 {
                sum.push((lattice.temperature([i, 4, 8]).to_bits(), lattice.flow([i, 4, 8]).0.to_bits() as u32));
            }
            sum
        })
    };
    assert_eq!(run(1), run(3));
}
