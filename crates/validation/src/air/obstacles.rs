//! Solids in the air, and air that leaves.

use megas_sim::air::{Face, HeatNode, Lattice, LatticeSettings, NodeState};

use super::{alone, erfc};
use crate::{Outcome, Plot, Row};

const SPEED: f32 = 0.05;

/// u/v over a block of solid nodes that slides, on a resting block of `resting` nodes.
fn sliding(resting: usize) -> Vec<[f64; 2]> {
    const N: usize = 168;
    const TOP: usize = 10;
    let faces = [[Face::PERIODIC; 2], [Face::PERIODIC; 2], [Face::WALL; 2]];
    let settings = LatticeSettings { heat: false, faces, ..LatticeSettings::new([1, 1, N], 0.05, 0.1) };
    alone(|| {
        let mut lattice = Lattice::new(settings);
        let states: Vec<_> = (0..TOP)
            .map(|z| {
                let velocity = if z < resting { [0.0; 3] } else { [SPEED, 0.0, 0.0] };
                ([0, 0, z], NodeState { solid: 1.0, velocity, heat: HeatNode::Air })
            })
            .collect();
        lattice.set_nodes(&states);
        for _ in 0..2000 {
            lattice.step();
        }
        // The plane of half filling lies between the last solid and the first air node.
        (TOP..N - 60).map(|z| [(z - TOP) as f64 + 0.5, lattice.flow([0, 0, z]).1[0] / f64::from(SPEED)]).collect()
    })
}

/// V24.
pub fn saturated() -> Outcome {
    let mut rows = Vec::new();
    let exact = |y: f64| erfc(y / (4.0 * 0.05 * 2000.0f64).sqrt());
    let mut plot = Plot::new("Air dragged along by a solid", "height over the surface [nodes]", "u/v").function("erfc", 0.0, 60.0, exact);
    for (label, resting) in [("sliding solid", 0), ("sliding block on a resting one", 5)] {
        let profile = sliding(resting);
        for y in [2, 10, 20, 30] {
            let [height, u] = profile[y];
            rows.push(Row::new(format!("{label}: u/v at y = {height}"), exact(height), u, 0.03));
        }
        plot = plot.ours(label, profile);
    }
    let (density, drift, finite) = crossing();
    rows.push(Row::new("crossing block: largest |ρ − 1|", 0.0, density, 0.05));
    rows.push(Row::new("crossing block: drift of the mean density", 0.0, drift, 1e-4));
    rows.push(Row::new("crossing block: nodes that are not numbers", 0.0, finite, 0.0));
    Outcome::from(rows).plot(plot)
}

/// A block of 8³ that rises by 20 nodes in a closed box of still air: largest |ρ − 1| in the air, drift of the mean density,
/// nodes that are not numbers.
fn crossing() -> (f64, f64, f64) {
    const SIZE: [usize; 3] = [24, 24, 48];
    let settings = LatticeSettings { heat: false, faces: [[Face::WALL; 2]; 3], ..LatticeSettings::new(SIZE, 0.05, 0.1) };
    let mut lattice = Lattice::new(settings);
    let mean = |l: &Lattice| {
        let (mut sum, mut worst, mut bad) = (0.0, 0.0f64, 0.0);
        for i in 0..SIZE[0] {
            for j in 0..SIZE[1] {
                for k in 0..SIZE[2] {
                    let rho = l.flow([i, j, k]).0;
                    sum += rho;
                    worst = worst.max((rho - 1.0).abs());
                    bad += f64::from(u8::from(!rho.is_finite()));
                }
            }
        }
        (sum / (SIZE[0] * SIZE[1] * SIZE[2]) as f64, worst, bad)
    };
    let (mut worst, mut bad) = (0.0f64, 0.0);
    for step in 0..400 {
        let low = 10.0 + f64::from(SPEED) * f64::from(step);
        let mut states = Vec::new();
        for i in 8..16 {
            for j in 8..16 {
                for k in 0..SIZE[2] {
                    // The share of the cell around node k between low and low + 8.
                    let (a, b) = (k as f64 - 0.5, k as f64 + 0.5);
                    let filled = (b.min(low + 8.0) - a.max(low)).max(0.0);
                    if filled > 0.0 {
                        states.push(([i, j, k], NodeState { solid: filled as f32, velocity: [0.0, 0.0, SPEED], heat: HeatNode::Air }));
                    }
                }
            }
        }
        lattice.set_nodes(&states);
        lattice.step();
        if step % 20 == 19 {
            let (_, w, b) = mean(&lattice);
            (worst, bad) = (worst.max(w), bad + b);
        }
    }
    (worst, (mean(&lattice).0 - 1.0).abs(), bad)
}

/// V25.
pub fn plume() -> Outcome {
    const SIZE: [usize; 3] = [48, 48, 96];
    let mut settings = LatticeSettings::new(SIZE, 0.02, 0.02 / 0.71);
    settings.buoyancy = [0.0, 0.0, 2.6e-5];
    settings.faces = [[Face::OPEN; 2], [Face::OPEN; 2], [Face::WALL, Face::OPEN]];
    settings.sponge_layers = 6;
    let mut lattice = Lattice::new(settings);
    let mut states = Vec::new();
    for i in 0..SIZE[0] {
        for j in 0..SIZE[1] {
            for k in 0..SIZE[2] {
                let d2 = (i as f64 - 23.5).powi(2) + (j as f64 - 23.5).powi(2) + (k as f64 - 10.0).powi(2);
                if d2 <= 36.0 {
                    states.push(([i, j, k], NodeState { solid: 1.0, velocity: [0.0; 3], heat: HeatNode::Fixed(1.0) }));
                }
            }
        }
    }
    lattice.set_nodes(&states);
    let every = || (0..SIZE[0]).flat_map(|i| (0..SIZE[1]).flat_map(move |j| (0..SIZE[2]).map(move |k| [i, j, k])));
    let inside = |n: [usize; 3]| states.binary_search_by(|s| s.0.cmp(&n)).is_ok();
    let stored = |l: &Lattice| every().filter(|n| !inside(*n)).map(|n| l.enthalpy(n)).sum::<f64>();
    let mass = |l: &Lattice| every().map(|n| l.flow(n).0).sum::<f64>() / (SIZE[0] * SIZE[1] * SIZE[2]) as f64;
    let start = stored(&lattice);
    let (mut wall, mut open) = (0.0, 0.0);
    for _ in 0..4000 {
        let r = lattice.step();
        wall += r.wall;
        open += r.open;
    }
    let (mut worst_t, mut worst_u, mut scale_u) = (0.0f64, 0.0f64, 0.0f64);
    for n in every() {
        let (t, u) = (lattice.temperature(n), lattice.flow(n).1[2]);
        scale_u = scale_u.max(u.abs());
        for m in [[47 - n[0], n[1], n[2]], [n[0], 47 - n[1], n[2]], [n[1], n[0], n[2]]] {
            worst_t = worst_t.max((t - lattice.temperature(m)).abs());
            worst_u = worst_u.max((u - lattice.flow(m).1[2]).abs());
        }
    }
    let gained = stored(&lattice) - start;
    let rows = vec![
        Row::new("asymmetry of T over its largest value", 0.0, worst_t, 1e-4),
        Row::new("asymmetry of u_{z} over its largest value", 0.0, worst_u / scale_u, 1e-4),
        Row::new("drift of the mean density", 1.0, mass(&lattice), 1e-3),
        Row::relative("heat stored + heat out, over heat in", 1.0, (gained - open) / wall, 0.01),
    ];
    let axis = |z: usize| 0.25 * [[23, 23], [23, 24], [24, 23], [24, 24]].iter().map(|x| lattice.temperature([x[0], x[1], z])).sum::<f64>();
    let up = |z: usize| lattice.flow([23, 23, z]).1[2] / scale_u;
    let plot = Plot::new("On the axis of the plume", "height [nodes]", "T, u_{z}/max")
        .ours("T", (0..SIZE[2]).map(|z| [z as f64, axis(z)]).collect())
        .ours("u_{z}", (0..SIZE[2]).map(|z| [z as f64, up(z)]).collect());
    Outcome::from(rows)
        .plot(plot)
        .note(format!("largest rise {scale_u:.4} nodes per step; {wall:.1} in, {:.1} out, {gained:.1} stored", -open))
}
