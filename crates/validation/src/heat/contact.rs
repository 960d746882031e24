//! V48: two slabs with a resistance between them (simulation.md §6.3).

use megas_sim::grid::Grid;
use megas_sim::thermal::{ThermalOptions, ThermalSolver, Wall};

use super::cloud::{Cloud, simple};
use super::surfaces::slab_root;
use crate::{Outcome, Plot, Row};

/// Node spacing \[m\], cells per slab, and heat capacity ρc \[J/(m³·K)\].
const DX: f64 = 2e-3;
const CELLS: f64 = 6.0;
const CAPACITY: f64 = 2e6;

/// Tolerance of the resistance, in cells of the poorer conductor: nodes tell the place of a face, and with it the conductors' own part of
/// the way, only to a fraction of a cell.
const FRACTION_OF_CELL: f64 = 0.2;

/// Two slabs of points on 14.5 − 2.5 cells along x, the face between them at `face`; h = 1000 T(x).
fn two(face: f64, t: impl Fn(f64) -> f64) -> Cloud {
    let mut cloud = Cloud::default();
    let mut slab = |from: f64, to: f64, body: u16| {
        let mut points = Cloud::default();
        let sites = (2.0 * CELLS) as usize;
        for i in 0..sites * 36 {
            let across = |s: usize| 0.5 * (s as f64 + 0.5);
            let x = from + (to - from) * ((i / 36) as f64 + 0.5) / sites as f64;
            let volume = (to - from) / CELLS * DX.powi(3) / 8.0;
            points.push([x, across(i / 6 % 6), across(i % 6)], 1e-3 * CAPACITY * volume, volume, body as u8 - 1, 1000.0 * t(x));
        }
        cloud.append(&points, body);
    };
    slab(2.5, face, 1);
    slab(face, 2.5 + 2.0 * CELLS, 2);
    cloud
}

/// A solver for slabs of conductivities `k` \[W/(m·K)\].
fn solver(k: [f64; 2], resistance: f64) -> ThermalSolver {
    let grid = Grid { origin: [0.0; 3], spacing: DX, nodes: [18, 3, 3] };
    let options = ThermalOptions { periodic: [false, true, true], ..ThermalOptions::default() };
    let mut solver = ThermalSolver::new(grid, &k.map(|k| simple(1e-3 * CAPACITY, 1000.0, k)), 0.0, options);
    solver.set_contact_resistance(1, 0.5 * resistance);
    solver.set_contact_resistance(2, 0.5 * resistance);
    solver
}

/// Mean of the temperatures of points between `lo` and `hi` along x.
fn mean(cloud: &Cloud, lo: f64, hi: f64) -> f64 {
    let inside = || cloud.xi.iter().zip(&cloud.h).filter(|(x, _)| x[0] > lo && x[0] < hi);
    inside().map(|(_, h)| 1e-3 * h).sum::<f64>() / inside().count() as f64
}

/// The case.
pub fn slabs() -> Outcome {
    let mut outcome = Outcome::default();
    let plot = Plot::new("slabs between walls 100 K apart, R = 0.005 m²K/W, k = 0.5 and 2 W/(m·K)", "x [cells]", "T − T_{cold} [K]");
    let mut shown = plot;
    for (k, resistance, face) in
        [([1.0, 1.0], 1e-3, 8.5), ([1.0, 1.0], 1e-3, 8.7), ([1.0, 1.0], 1e-2, 9.0), ([0.5, 2.0], 5e-3, 8.5), ([0.5, 2.0], 5e-3, 8.9)]
    {
        let (rows, cloud, exact) = steady(k, resistance, face);
        outcome.rows.extend(rows);
        if k[0] != k[1] && face == 8.5 {
            let points = cloud.xi.iter().zip(&cloud.h).step_by(36).map(|(x, h)| [x[0] - 2.5, 1e-3 * h]).collect();
            shown = shown.function("in series", 0.0, 2.0 * CELLS, |x| exact(x + 2.5)).ours("points", points);
        }
    }
    outcome = outcome.plot(shown);
    let mut cooling = Plot::new("difference of two slabs without walls", "time / (RC/2)", "ΔT/ΔT_{0}").log(false, true);
    for biot in [0.02, 1.0] {
        let (row, seen) = transient(biot);
        outcome.rows.extend(row);
        cooling = cooling
            .function(format!("exact, Bi = {biot}"), 0.0, 1.0, |t| difference(biot, t / biot))
            .ours(format!("points, Bi = {biot}"), seen);
    }
    outcome.plot(cooling)
}

/// Steady temperatures between walls: rows for resistance and flux, the points, and T(x) as in series.
fn steady(k: [f64; 2], resistance: f64, face: f64) -> (Vec<Row>, Cloud, impl Fn(f64) -> f64) {
    let [start, end] = [2.5, 2.5 + 2.0 * CELLS];
    let flux = 100.0 / ((face - start) * DX / k[0] + resistance + (end - face) * DX / k[1]);
    let exact = move |x: f64| if x < face { 100.0 - flux * (x - start) * DX / k[0] } else { flux * (end - x) * DX / k[1] };
    let mut cloud = two(face, exact);
    let mut solver = solver(k, resistance);
    let wall = |plane: usize| match plane as f64 {
        x if x < start => Wall::Fixed(100.0),
        x if x > end => Wall::Fixed(0.0),
        _ => Wall::Open,
    };
    let walls: Vec<Wall> = (0..18 * 9).map(|node| wall(node / 9)).collect();
    let dt = 0.04 * DX * DX * CAPACITY / k[0].max(k[1]);
    for step in 0..2500 {
        cloud.step(&mut solver, dt, f64::from(step) * dt, &[], Some(&walls));
    }
    // Lines through two layers of points in either slab, away from its faces.
    let line = |lo: f64, hi: f64| {
        let middle = 0.5 * (lo + hi);
        let [a, b] = [(lo, middle), (middle, hi)].map(|(lo, hi)| {
            let x = cloud.xi.iter().map(|x| x[0]).filter(|x| *x > lo && *x < hi);
            (x.clone().sum::<f64>() / x.count() as f64, mean(&cloud, lo, hi))
        });
        let slope = (b.1 - a.1) / (b.0 - a.0);
        (a.1 + slope * (face - a.0), slope)
    };
    let ((hot, down), (cold, further)) = (line(start + 1.0, face - 1.0), line(face + 1.0, end - 1.0));
    let got = -0.5 * (k[0] * down + k[1] * further) / DX;
    let label = format!("k = {} and {}, R = {resistance}, face at {face}", k[0], k[1]);
    let rows = vec![
        Row::new(format!("R, {label} [m²K/W]"), resistance, (hot - cold) / got, FRACTION_OF_CELL * DX / k[0].min(k[1])),
        Row::relative(format!("flux, {label} [W/m²]"), flux, got, 0.02),
    ];
    (rows, cloud, exact)
}

/// Difference of the means of two slabs over that of the start at `fo` = αt/L².
fn difference(biot: f64, fo: f64) -> f64 {
    // Each slab is cooled by a film to the face's own temperature, which stays.
    let term = |n: u32| {
        let z = slab_root(biot, n);
        2.0 * z.sin().powi(2) / (z * (z + z.sin() * z.cos())) * (-z * z * fo).exp()
    };
    (0..40).map(term).sum()
}

/// Two slabs alone until RC/2: a row, and the difference on the way.
fn transient(biot: f64) -> (Vec<Row>, Vec<[f64; 2]>) {
    let (k, length) = (1.0, CELLS * DX);
    let resistance = 2.0 * length / (k * biot);
    let unit = 0.5 * resistance * CAPACITY * length;
    let mut solver = solver([k; 2], resistance);
    let face = 2.5 + CELLS;
    let mut cloud = two(face, |x| if x < face { 100.0 } else { 0.0 });
    let steps = (unit / (0.3 * DX * DX * CAPACITY / k)).ceil().max(400.0);
    let dt = unit / steps;
    let mut seen = Vec::new();
    for step in 1..=steps as u32 {
        cloud.step(&mut solver, dt, f64::from(step) * dt, &[], None);
        if step % (steps as u32 / 20) == 0 {
            let apart = mean(&cloud, 0.0, face) - mean(&cloud, face, 99.0);
            seen.push([f64::from(step) * dt / unit, 0.01 * apart]);
        }
    }
    let rows = [0.25, 0.5, 1.0].map(|t| {
        let nearest = seen.iter().min_by(|a, b| (a[0] - t).abs().total_cmp(&(b[0] - t).abs())).copied().unwrap_or([f64::NAN; 2]);
        Row::relative(format!("ΔT/ΔT₀ at {t} RC/2, Bi = {biot}"), difference(biot, nearest[0] / biot), nearest[1], 0.02)
    });
    (rows.to_vec(), seen)
}

#[cfg(test)]
mod tests {
    #[test]
    fn slabs_in_contact() {
        crate::assert_case("V48");
    }

    #[test]
    fn the_exact_difference_starts_at_one_and_falls_like_a_lumped_body() {
        assert!((super::difference(1.0, 0.0) - 1.0).abs() < 1e-3);
        assert!((super::difference(1e-3, 1e3) - (-1f64).exp()).abs() < 1e-3);
    }
}
