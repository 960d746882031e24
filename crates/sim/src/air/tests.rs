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

#[test]
fn a_step_in_half_precision_is_a_rounded_step_in_single_precision() {
    let states = obstacles();
    let settings = box_of_everything(mixed(), 0.1);
    let mut half = Lattice::new(LatticeSettings { storage: Storage::F16, ..settings.clone() });
    let mut single = Lattice::new(settings);
    let mut rng = Rng::new(9);
    let initial = start(&mut rng, 11 * 9 * 21);
    half.set_nodes(&states);
    half.fill(|x| initial[(x[0] * 9 + x[1]) * 21 + x[2]]);
    for step in 0..6 {
        assert!(single.restore(&half.save()));
        single.set_nodes(&states);
        half.set_nodes(&states);
        half.step();
        single.step();
        let (a, b) = (half.save(), single.save());
        let largest = b.chunks_exact(32).flat_map(|b| &b[20..26]).fold(0.0f32, |m, g| m.max(g.abs()));
        for (n, (a, b)) in a.chunks_exact(32).zip(b.chunks_exact(32)).enumerate() {
            for (k, (h, s)) in a[..26].iter().zip(&b[..26]).enumerate() {
                // Half a unit of the last of 11 digits, at most two roundings (in the air and at a wall), and the smallest number.
                let (share, least) = (1.1 / 2048.0, if k < 19 { 2f32.powi(-39) } else { 2f32.powi(-24) });
                // At a wall the first rounding is relative to what left, up to the largest population nearby; what rests keeps
                // the errors of the six that left.
                let wall = if k < 19 { 0.05 } else { 0.3 } * f32::from(u8::from(on_rim(n) || near_obstacle(&states, n)));
                let size = if k == 19 { 6.0 * largest } else { s.abs().max(wall) };
                assert!((h - s).abs() <= share * size + least, "step {step}, node {n}, population {k}: {h:e} and {s:e}");
            }
        }
    }
}

fn on_rim(n: usize) -> bool {
    let x = [n / 21 / 9, n / 21 % 9, n % 21];
    (0..3).any(|a| x[a] == 0 || x[a] + 1 == [11, 9, 21][a])
}

fn near_obstacle(states: &[([usize; 3], NodeState)], n: usize) -> bool {
    let x = [n / 21 / 9, n / 21 % 9, n % 21];
    states.iter().any(|(s, _)| (0..3).all(|a| s[a].abs_diff(x[a]) <= 1))
}

#[test]
fn half_precision_does_not_depend_on_threads_or_restarts() {
    let settings = LatticeSettings { storage: Storage::F16, ..box_of_everything(ROOM, 0.1) };
    let run = |threads: usize, restart: bool| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a thread pool");
        pool.install(|| {
            let mut lattice = Lattice::new(settings.clone());
            lattice.set_nodes(&obstacles());
            for step in 0..21 {
                if restart && step == 11 {
                    let state = lattice.save();
                    lattice = Lattice::new(settings.clone());
                    assert!(lattice.restore(&state));
                    lattice.set_nodes(&obstacles());
                }
                lattice.step_with(|links, flux| flux.iter_mut().zip(links).for_each(|(q, l)| *q = 1e-4 * l.other as f32));
            }
            lattice.save().iter().map(|v| v.to_bits()).collect::<Vec<u32>>()
        })
    };
    let one = run(1, false);
    assert!(one == run(3, false), "three threads differ from one");
    assert!(one == run(2, true), "a restart differs");
}

/// Links bring less per step than half a digit of what they add it to; all of it must arrive nevertheless.
#[test]
fn small_heat_arrives_in_half_precision() {
    let mut settings = LatticeSettings::new([12, 12, 12], 0.02, 0.02);
    settings.storage = Storage::F16;
    settings.faces = [[Face::WALL; 2]; 3];
    let mut lattice = Lattice::new(settings);
    lattice.fill(|_| (1.0, [0.0; 3], 20.0));
    lattice.set_nodes(&[([5, 5, 5], NodeState { solid: 1.0, velocity: [0.0; 3], heat: HeatNode::Exchange(0) })]);
    let before = lattice.total_enthalpy();
    let mut brought = 0.0;
    for _ in 0..500 {
        brought += lattice.step_with(|_, flux| flux.fill(2e-4)).exchanged;
    }
    let gained = lattice.total_enthalpy() - before;
    println!("brought {brought}, gained {gained}");
    assert!((gained / brought - 1.0).abs() < 0.01, "{gained} of {brought}");
}

/// What rounding does to mass and heat of a closed box that nothing enters.
#[test]
fn half_precision_keeps_mass_and_heat_of_a_closed_box() {
    for storage in [Storage::F32, Storage::F16] {
        let mut settings = LatticeSettings::new([32, 32, 32], 0.02, 0.02);
        settings.storage = storage;
        settings.faces = [[Face::WALL; 2]; 3];
        settings.buoyancy = [0.0, 0.0, 1e-4];
        let mut lattice = Lattice::new(settings);
        lattice.fill(|x| (1.0, [0.0; 3], if x.iter().all(|v| (8..24).contains(v)) { 20.0 } else { 0.0 }));
        let mass = |l: &Lattice| l.every().map(|x| l.flow(x).0 - 1.0).sum::<f64>() / 32f64.powi(3);
        let before = (mass(&lattice), lattice.total_enthalpy());
        for _ in 0..400 {
            lattice.step();
        }
        let (drift, heat) = (mass(&lattice) - before.0, lattice.total_enthalpy() / before.1 - 1.0);
        println!("{storage:?}: mean density {drift:e}, heat {heat:e}, speed {:e}", lattice.flow([16, 16, 16]).1[2]);
        let (dm, dh) = if storage == Storage::F32 { (1e-7, 1e-6) } else { (1e-6, 1e-6) };
        assert!(drift.abs() < dm && heat.abs() < dh, "{storage:?}: {drift:e} {heat:e}");
    }
}
