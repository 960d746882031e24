//! Conduction and transport of temperature on the lattice.

use megas_sim::air::reference::Reference;
use megas_sim::air::{Face, LAMBDA_MATERIAL, LAMBDA_STILL, Lattice, LatticeSettings};
use megas_sim::grid::Grid;
use megas_sim::thermal::{NodeFields, ThermalOptions, ThermalSolver};

use super::{alone, erfc};
use crate::{Outcome, Plot, Row};

fn heat_only(nodes: [usize; 3], k: f64) -> LatticeSettings {
    LatticeSettings { flow: false, lambda_heat: Some(LAMBDA_STILL), ..LatticeSettings::new(nodes, 0.1, k) }
}

fn walls(low: f64, high: f64) -> [[Face; 2]; 3] {
    [[Face::PERIODIC; 2], [Face::PERIODIC; 2], [Face::fixed(low), Face::fixed(high)]]
}

const SIZE: usize = 64;

fn blob(n: [usize; 3]) -> f64 {
    (-n.iter().map(|i| (*i as f64 - 32.0).powi(2)).sum::<f64>() / 50.0).exp()
}

/// Peak, anisotropy of the spread, and the profile along z.
fn blob_rows(label: &str, k: f64, steps: usize, t: impl Fn([usize; 3]) -> f64, rows: &mut Vec<Row>) -> Vec<[f64; 2]> {
    let (mut x2, mut z2, mut sum) = (0.0, 0.0, 0.0);
    for i in 0..SIZE {
        for j in 0..SIZE {
            for l in 0..SIZE {
                let v = t([i, j, l]);
                sum += v;
                x2 += v * (i as f64 - 32.0).powi(2);
                z2 += v * (l as f64 - 32.0).powi(2);
            }
        }
    }
    let peak = (1.0 + 2.0 * k * steps as f64 / 25.0).powf(-1.5);
    rows.push(Row::relative(format!("{label}, K = {k}: peak"), peak, t([32; 3]), 0.005));
    rows.push(Row::new(format!("{label}, K = {k}: σx/σz"), 1.0, ((x2 / sum) / (z2 / sum)).sqrt(), 1e-3));
    (0..SIZE).map(|l| [l as f64 - 32.0, t([32, 32, l])]).collect()
}

/// V05.
pub fn gaussian() -> Outcome {
    let mut rows = Vec::new();
    let mut plot = Plot::new("Profile through the centre when the variance has doubled", "distance [nodes]", "T");
    let exact = |x: f64| 0.5f64.powf(1.5) * (-x * x / 100.0).exp();
    plot = plot.reference("exact", (-32..32).map(|x| [f64::from(x), exact(f64::from(x))]).collect());
    for (k, steps) in [(0.05, 250), (0.2, 62)] {
        let mut lattice = Lattice::new(heat_only([SIZE; 3], k));
        lattice.fill(|n| (1.0, [0.0; 3], blob(n)));
        for _ in 0..steps {
            lattice.step();
        }
        let profile = blob_rows("populations", k, steps, |n| lattice.temperature(n), &mut rows);
        if steps == 250 {
            plot = plot.ours("populations", profile);
        }
    }
    let grid = Grid { origin: [0.0; 3], spacing: 1.0, nodes: [SIZE; 3] };
    let options = ThermalOptions { periodic: [true; 3], ..ThermalOptions::default() };
    let material = crate::heat::simple(1.0, 1.0, 0.15);
    let mut solver = ThermalSolver::new(grid, std::slice::from_ref(&material), 0.0, options);
    let ones = vec![1.0; grid.len()];
    let kinds = vec![0; grid.len()];
    let mut energy: Vec<f64> = (0..grid.len()).map(|i| blob(grid.node(i))).collect();
    // 83 steps of K = 0.15 double the variance as well.
    for _ in 0..83 {
        let mut fields = NodeFields { mass: &ones, volume: &ones, material: &kinds, energy: &mut energy };
        if let Err(e) = solver.step_nodes(&mut fields, 1.0, 0.0, &[], None) {
            rows.push(Row::new(format!("flux links: {e}"), 0.0, f64::NAN, 0.0));
            break;
        }
    }
    let profile = blob_rows("flux links", 0.15, 83, |n| energy[grid.index(n[0], n[1], n[2])], &mut rows);
    plot = plot.ours("flux links", profile);
    Outcome::from(rows).plot(plot)
}

/// V07.
pub fn advected() -> Outcome {
    let mut rows = Vec::new();
    let mut plot = Plot::new("Blob of 64 nodes after one crossing", "place [nodes]", "T");
    const U: f64 = 0.05;
    let mut errors = Vec::new();
    for (n, bound) in [(64usize, 4e-2), (128, 1e-2), (256, 4e-3)] {
        let (sigma, k, steps) = (n as f64 / 16.0, 0.01 * n as f64 / 64.0, (n as f64 / U) as usize);
        let settings = LatticeSettings { wind: [0.0, 0.0, U], ..heat_only([1, 1, n], k) };
        let centre = n as f64 / 2.0;
        let t: Vec<f64> = alone(|| {
            let mut lattice = Lattice::new(settings);
            lattice.fill(|x| (1.0, [0.0, 0.0, U], (-(x[2] as f64 - centre).powi(2) / (2.0 * sigma * sigma)).exp()));
            for _ in 0..steps {
                lattice.step();
            }
            (0..n).map(|z| lattice.temperature([0, 0, z])).collect()
        });
        let spread = sigma * sigma + 2.0 * k * steps as f64;
        let exact = |x: f64| sigma / spread.sqrt() * (-(x - centre).powi(2) / (2.0 * spread)).exp();
        let (mut sum, mut first, mut second, mut error, mut norm) = (0.0, 0.0, 0.0, 0.0, 0.0);
        for (z, v) in t.iter().enumerate() {
            let d = z as f64 - centre;
            sum += v;
            first += v * d;
            second += v * d * d;
            error += (v - exact(z as f64)).powi(2);
            norm += exact(z as f64).powi(2);
        }
        let shift = first / sum;
        let diffusivity = (second / sum - shift * shift - sigma * sigma) / (2.0 * k * steps as f64);
        errors.push((error / norm).sqrt());
        rows.push(Row::new(format!("N = {n}: shift of the centre [nodes]"), 0.0, shift, 0.01));
        rows.push(Row::new(format!("N = {n}: D/K"), 1.0 - 4.0 * U * U, diffusivity, 0.005));
        rows.push(Row::new(format!("N = {n}: relative L2 error"), 0.0, (error / norm).sqrt(), bound));
        if n == 64 {
            plot = plot.reference("exact", (0..n).map(|z| [z as f64, exact(z as f64)]).collect());
            plot = plot.ours("lattice", t.iter().enumerate().map(|(z, v)| [z as f64, *v]).collect());
        }
    }
    Outcome::from(rows).plot(plot)
}

/// V08.
pub fn source_slab() -> Outcome {
    const N: usize = 16;
    const S: f64 = 1e-5;
    let mut rows = Vec::new();
    let mut plot = Plot::new("Steady slab with a source, K = 0.02", "y [nodes]", "T 2K/S");
    for k in [0.02, 0.1, 0.5] {
        for (name, lambda) in [("1/6", 1.0 / 6.0), ("1/4", LAMBDA_MATERIAL)] {
            let settings = LatticeSettings { source: S, lambda_heat: Some(lambda), faces: walls(0.0, 0.0), ..heat_only([1, 1, N], k) };
            let exact = |z: usize| S * (z as f64 + 0.5) * (N as f64 - z as f64 - 0.5) / (2.0 * k);
            let mut slow = Reference::new(settings);
            slow.fill(|n| (1.0, [0.0; 3], exact(n[2])));
            for _ in 0..(700.0 / k) as usize {
                slow.step(|_, _| 0.0);
            }
            let error = (0..N).map(|z| slow.t[z] / exact(z) - 1.0).fold(0.0f64, |a, e| if e.abs() > a.abs() { e } else { a });
            let middle = (slow.t[N / 2] - exact(N / 2)) / exact(N / 2);
            if name == "1/6" {
                rows.push(Row::new(format!("K = {k}, Λ = 1/6: largest relative error"), 0.0, error, 1e-10));
            } else {
                // The walls are displaced: the whole parabola is lifted by a constant, 6(Λ − 1/6)/N² of its mean-to-peak scale.
                let lift = 6.0 * (lambda - 1.0 / 6.0) / (N * N) as f64;
                let peak = S * (N * N) as f64 / (8.0 * k);
                rows.push(Row::relative(format!("K = {k}, Λ = 1/4: lift over peak"), lift, middle * exact(N / 2) / peak, 0.05));
            }
            if k == 0.02 {
                let scaled = |t: f64| t * 2.0 * k / S;
                if name == "1/6" {
                    plot = plot.reference("y(N − y)", (0..N).map(|z| [z as f64 + 0.5, scaled(exact(z))]).collect());
                }
                plot = plot.ours(format!("Λ = {name}"), (0..N).map(|z| [z as f64 + 0.5, scaled(slow.t[z])]).collect());
            }
        }
    }
    Outcome::from(rows).plot(plot)
}

/// V09.
pub fn two_layers() -> Outcome {
    let mut rows = Vec::new();
    let mut plot = Plot::new("Steady temperature through two layers", "y [nodes]", "T");
    for k2 in [0.1, 1.0] {
        let q = 1.0 / (16.0 / 0.01 + 16.0 / k2);
        let media = |z: usize| if z < 16 { (1.0, 0.01) } else { (50.0, k2) };
        let exact = |z: usize| {
            let y = z as f64 + 0.5;
            if z < 16 { 1.0 - q * y / 0.01 } else { q * (32.0 - y) / k2 }
        };
        let mut slow =
            Reference::new(LatticeSettings { faces: walls(1.0, 0.0), lambda_heat: Some(LAMBDA_MATERIAL), ..heat_only([1, 1, 32], 0.01) });
        slow.media = (0..32).map(media).collect();
        slow.fill(|n| (1.0, [0.0; 3], exact(n[2])));
        for _ in 0..40_000 {
            slow.step(|_, _| 0.0);
        }
        let error = (0..32).map(|z| (slow.t[z] - exact(z)).abs()).fold(0.0, f64::max);
        // The last node lies half a node from the cold wall.
        let out = 2.0 * k2 * slow.t[31];
        rows.push(Row::new(format!("K = 0.01 | {k2}: largest error of T"), 0.0, error, 1e-5));
        rows.push(Row::relative(format!("K = 0.01 | {k2}: flux at the cold wall"), q, out, 1e-4));
        plot = plot.reference(format!("exact, K₂ = {k2}"), (0..32).map(|z| [z as f64 + 0.5, exact(z)]).collect());
        plot = plot.ours(format!("lattice, K₂ = {k2}"), (0..32).map(|z| [z as f64 + 0.5, slow.t[z]]).collect());
    }
    Outcome::from(rows).plot(plot)
}

/// V10.
pub fn contact() -> Outcome {
    const N: usize = 400;
    const T: usize = 8000;
    let mut rows = Vec::new();
    let mut plot = Plot::new("Contact of two half spaces, C = 50", "distance from the contact [nodes]", "T");
    for (ratio, bound) in [(1.0f64, 1e-2), (50.0, 1e-3), (1700.0, 1e-3)] {
        let media = |z: usize| if z < N / 2 { (1.0f64, 0.05f64) } else { (ratio, 0.5) };
        let (el, er) = (0.05f64.sqrt(), (0.5 * ratio).sqrt());
        let (contact, reach_l, reach_r) = (el / (el + er), (4.0 * 0.05 * T as f64).sqrt(), (4.0 * 0.5 / ratio * T as f64).sqrt());
        let exact = |z: usize| {
            let y = z as f64 + 0.5 - N as f64 / 2.0;
            if y < 0.0 { 1.0 + (contact - 1.0) * erfc(-y / reach_l) } else { contact * erfc(y / reach_r) }
        };
        let faces = [[Face::PERIODIC; 2], [Face::PERIODIC; 2], [Face::WALL; 2]];
        let settings = LatticeSettings { faces, lambda_heat: Some(LAMBDA_MATERIAL), ..heat_only([1, 1, N], 0.05) };
        let t: Vec<f64> = alone(|| {
            let mut lattice = Lattice::new(settings);
            lattice.set_media(|n| {
                let (c, k) = media(n[2]);
                (c as f32, k as f32)
            });
            lattice.fill(|n| (1.0, [0.0; 3], if n[2] < N / 2 { 1.0 } else { 0.0 }));
            for _ in 0..T {
                lattice.step();
            }
            (0..N).map(|z| lattice.temperature([0, 0, z])).collect()
        });
        let error = (0..N).map(|z| (t[z] - exact(z)).abs()).fold(0.0, f64::max);
        rows.push(Row::new(format!("C = {ratio}: largest error"), 0.0, error, bound));
        // The contact lies between two nodes: fluxes from both sides give its temperature.
        let (a, b) = (t[N / 2 - 1], t[N / 2]);
        rows.push(Row::new(format!("C = {ratio}: contact temperature"), contact, (0.05 * a + 0.5 * b) / 0.55, bound));
        if ratio == 50.0 {
            let span = N / 2 - 60..N / 2 + 40;
            let at = |z: usize| z as f64 + 0.5 - N as f64 / 2.0;
            plot = plot.reference("exact", span.clone().map(|z| [at(z), exact(z)]).collect());
            plot = plot.ours("lattice", span.map(|z| [at(z), t[z]]).collect());
        }
    }
    Outcome::from(rows).plot(plot)
}
