//! Natural convection in closed boxes.

use std::f64::consts::PI;

use megas_sim::air::{Face, Lattice, LatticeSettings, Storage};

use super::alone;
use super::flow::vortices;
use crate::{Outcome, Plot, Row};

const PRANDTL: f64 = 0.71;

/// Settings of a cavity of `n` nodes between its hot and cold walls: Ra, and the velocity scale √(gβΔT N).
fn convection(nodes: [usize; 3], n: f64, ra: f64, speed: f64) -> LatticeSettings {
    let alpha = speed * n / (ra * PRANDTL).sqrt();
    let mut s = LatticeSettings::new(nodes, PRANDTL * alpha, alpha);
    s.buoyancy = [0.0, 0.0, speed * speed / n];
    s
}

/// One row of the table of de Vahl Davis: mean Nu, Nu_max (y), Nu_min, u_max (y), v_max (x).
struct Published {
    ra: f64,
    nodes: usize,
    nu: f64,
    nu_max: (f64, f64),
    nu_min: f64,
    u_max: (f64, f64),
    v_max: (f64, f64),
}

const TABLE: [Published; 4] = [
    Published { ra: 1e3, nodes: 32, nu: 1.118, nu_max: (1.505, 0.092), nu_min: 0.692, u_max: (3.649, 0.813), v_max: (3.697, 0.178) },
    Published { ra: 1e4, nodes: 64, nu: 2.243, nu_max: (3.528, 0.143), nu_min: 0.586, u_max: (16.178, 0.823), v_max: (19.617, 0.119) },
    Published { ra: 1e5, nodes: 96, nu: 4.519, nu_max: (7.717, 0.081), nu_min: 0.729, u_max: (34.73, 0.855), v_max: (68.59, 0.066) },
    Published { ra: 1e6, nodes: 160, nu: 8.800, nu_max: (17.925, 0.038), nu_min: 0.989, u_max: (64.63, 0.850), v_max: (219.36, 0.0379) },
];

/// Largest value of samples at (i + ½)/n by a parabola: (value, place).
fn peak(samples: &[f64]) -> (f64, f64) {
    let n = samples.len();
    let best = (1..n - 1).max_by(|a, b| samples[*a].total_cmp(&samples[*b])).unwrap_or(1);
    let (a, b, c) = (samples[best - 1], samples[best], samples[best + 1]);
    let d = 0.5 * (a - c) / (a - 2.0 * b + c);
    (b - 0.25 * (a - c) * d, (best as f64 + 0.5 + d) / n as f64)
}

/// Nusselt number per height on the hot wall at T = ½ from the two nodes next to it.
fn wall_nusselt(lattice: &Lattice, n: f64, j: usize, z: usize) -> f64 {
    let (t0, t1) = (lattice.temperature([0, j, z]), lattice.temperature([1, j, z]));
    n * (8.0 * 0.5 - 9.0 * t0 + t1) / 3.0
}

/// Mean Nusselt number of the volume, 1 + ⟨uT⟩N/α.
fn volume_nusselt(lattice: &Lattice) -> f64 {
    let [nx, ny, nz] = lattice.settings().nodes;
    let mut sum = 0.0;
    for i in 0..nx {
        for j in 0..ny {
            for k in 0..nz {
                sum += lattice.macroscopic([i, j, k]).1[0] * lattice.temperature([i, j, k]);
            }
        }
    }
    1.0 + sum / (nx * ny * nz) as f64 * nx as f64 / lattice.settings().diffusivity
}

/// Runs until the Nusselt number changes by less than 1e-6 in a hundredth of the diffusion time.
fn settle(lattice: &mut Lattice) -> usize {
    let n = lattice.settings().nodes[0] as f64;
    let span = (0.01 * n * n / lattice.settings().diffusivity).ceil() as usize;
    let mut last = f64::NAN;
    for round in 1..=400 {
        for _ in 0..span {
            lattice.step();
        }
        let nu = volume_nusselt(lattice);
        // Early on the number hardly moves because nothing has happened yet.
        if round > 20 && (nu / last - 1.0).abs() < 1e-6 {
            return round * span;
        }
        last = nu;
    }
    400 * span
}

/// A square cavity after `steps`, or at rest.
fn settled(p: &Published, storage: Storage, flow_ratio: usize, steps: Option<usize>) -> (Lattice, usize) {
    let n = p.nodes;
    let mut s = LatticeSettings { storage, flow_ratio, ..convection([n, 1, n], n as f64, p.ra, 0.1) };
    s.faces = [[Face::fixed(0.5), Face::fixed(-0.5)], [Face::PERIODIC; 2], [Face::WALL; 2]];
    alone(|| {
        let mut lattice = Lattice::new(s);
        lattice.fill(|x| (1.0, [0.0; 3], 0.5 - (x[0] as f64 + 0.5) / n as f64));
        let steps = match steps {
            None => settle(&mut lattice),
            Some(steps) => {
                (0..steps).for_each(|_| _ = lattice.step());
                steps
            }
        };
        (lattice, steps)
    })
}

/// V22 and V19 again, with populations in half precision.
pub fn half() -> Outcome {
    let mut rows = Vec::new();
    let mut notes = Vec::new();
    let last = |h: &[[f64; 2]]| h.last().map_or(f64::NAN, |p| p[1]);
    for n in [64, 128] {
        let ((single, _), (half, drift)) = (vortices(n, Storage::F32), vortices(n, Storage::F16));
        let error = last(&half) / last(&single) - 1.0;
        notes.push(format!(
            "vortices, N = {n}, u₀ = {:.2}: E/E₀ is off by {:.1} %, the mean density by {drift:.1e}",
            1.28 / n as f64,
            100.0 * error
        ));
        // Slower ones lose more: rounding is relative to the velocity, stress to its gradient.
        if n == 64 {
            rows.push(Row::relative(format!("vortices, N = {n}: E/E₀ against single precision"), last(&single), last(&half), 0.012));
            rows.push(Row::new(format!("vortices, N = {n}: change of the mean density"), 0.0, drift, 1e-5));
        }
    }
    for p in &TABLE[..2] {
        let (single, steps) = settled(p, Storage::F32, 1, None);
        let (half, _) = settled(p, Storage::F16, 1, Some(steps));
        let n = p.nodes;
        let label = format!("Ra = 10^{}", p.ra.log10().round());
        let local = |l: &Lattice| -> Vec<f64> { (0..n).map(|z| wall_nusselt(l, n as f64, 0, z)).collect() };
        let mean = |l: &Lattice| local(l).iter().sum::<f64>() / n as f64;
        let mass = |l: &Lattice| {
            let nodes = (0..n).flat_map(|x| (0..n).map(move |z| [x, 0, z]));
            nodes.map(|x| l.flow(x).0 - 1.0).sum::<f64>() / (n * n) as f64
        };
        rows.push(Row::relative(format!("{label}: Nu of the volume, published"), p.nu, volume_nusselt(&half), 0.01));
        rows.push(Row::relative(
            format!("{label}: the same, against single precision"),
            volume_nusselt(&single),
            volume_nusselt(&half),
            0.01,
        ));
        rows.push(Row::relative(format!("{label}: Nu of the hot wall, published"), p.nu, mean(&half), 0.01));
        rows.push(Row::relative(format!("{label}: the same, against single precision"), mean(&single), mean(&half), 0.01));
        rows.push(Row::relative(
            format!("{label}: largest local Nu, against single precision"),
            peak(&local(&single)).0,
            peak(&local(&half)).0,
            0.01,
        ));
        rows.push(Row::new(format!("{label}: change of the mean density"), 0.0, mass(&half), 1e-4));
        notes.push(format!("{label}: {steps} steps; mean density changed by {:.1e} in single precision", mass(&single)));
    }
    notes.into_iter().fold(Outcome::from(rows), Outcome::note)
}

/// Relative tolerances of the local numbers of V22.
struct Tolerance {
    largest: f64,
    smallest: f64,
    speed: f64,
}

const SQUARE: Tolerance = Tolerance { largest: 0.01, smallest: 0.02, speed: 0.015 };
/// With half the nodes across a boundary layer. Worst is the corner where the flow leaves the wall: between its cells the flow is
/// interpolated and not free of sources, and little is carried there to make up for it.
const COARSE: Tolerance = Tolerance { largest: 0.02, smallest: 0.2, speed: 0.025 };

/// V22 with the flow on cells of twice the size.
pub fn coarse() -> Outcome {
    square(&TABLE[..3], 2)
}

fn square(cases: &[Published], flow_ratio: usize) -> Outcome {
    let mut outcome = Outcome::default();
    let tolerance = if flow_ratio == 1 { SQUARE } else { COARSE };
    for p in cases {
        let n = p.nodes;
        let (lattice, steps) = settled(p, Storage::F32, flow_ratio, None);
        let unit = n as f64 / lattice.settings().diffusivity;
        let h = n / 2;
        let mean = |a, b, axis: usize| 0.5 * unit * (lattice.macroscopic(a).1[axis] + lattice.macroscopic(b).1[axis]);
        let u: Vec<f64> = (0..n).map(|z| mean([h - 1, 0, z], [h, 0, z], 0)).collect();
        let v: Vec<f64> = (0..n).map(|x| mean([x, 0, h - 1], [x, 0, h], 2)).collect();
        let local: Vec<f64> = (0..n).map(|z| wall_nusselt(&lattice, n as f64, 0, z)).collect();
        let wall = local.iter().sum::<f64>() / n as f64;
        let label = format!("Ra = 10^{}", p.ra.log10().round());
        let (nu_max, nu_y) = peak(&local);
        let ((u_max, u_y), (v_max, v_x)) = (peak(&u), peak(&v));
        let least = local.iter().copied().fold(f64::INFINITY, f64::min);
        let relative = |what: &str, published, ours, tolerance| Row::relative(format!("{label}: {what}"), published, ours, tolerance);
        let absolute = |what: &str, published, ours, tolerance| Row::new(format!("{label}: {what}"), published, ours, tolerance);
        outcome.rows.extend([
            relative("Nu of the volume", p.nu, volume_nusselt(&lattice), 0.01),
            relative("Nu of the hot wall", p.nu, wall, 0.01),
            relative("largest local Nu", p.nu_max.0, nu_max, tolerance.largest),
            relative("smallest local Nu", p.nu_min, least, tolerance.smallest),
            relative("largest u on x = ½", p.u_max.0, u_max, tolerance.speed),
            absolute("its height", p.u_max.1, u_y, 0.01),
            relative("largest v on y = ½", p.v_max.0, v_max, tolerance.speed),
            absolute("its place", p.v_max.1, v_x, 0.01),
        ]);
        if flow_ratio == 1 {
            // Flat against the ripple of an interpolated flow.
            outcome.rows.push(absolute("height of the largest local Nu", p.nu_max.1, nu_y, 0.02));
        }
        let place = |i: usize| (i as f64 + 0.5) / n as f64;
        outcome = outcome
            .plot(
                Plot::new(format!("{label}: local Nusselt number on the hot wall"), "height", "Nu")
                    .reference("published largest and smallest", vec![[p.nu_max.1, p.nu_max.0], [1.0, p.nu_min]])
                    .ours("lattice", local.iter().enumerate().map(|(i, v)| [place(i), *v]).collect()),
            )
            .note(format!("{label}: {n}² nodes, {steps} steps"));
    }
    outcome
}

/// V22, small.
pub fn square_small() -> Outcome {
    square(&TABLE[..2], 1)
}

/// V22, thin boundary layers.
pub fn square_large() -> Outcome {
    square(&TABLE[2..3], 1)
}

/// V22, thinner ones.
pub fn square_largest() -> Outcome {
    square(&TABLE[3..], 1)
}

/// V23.
pub fn cube() -> Outcome {
    const N: usize = 32;
    let mut s = convection([N; 3], N as f64, 1e4, 0.1);
    s.faces = [[Face::fixed(0.5), Face::fixed(-0.5)], [Face::WALL; 2], [Face::WALL; 2]];
    let mut lattice = Lattice::new(s);
    lattice.fill(|x| (1.0, [0.0; 3], 0.5 - (x[0] as f64 + 0.5) / N as f64));
    let steps = settle(&mut lattice);
    let mut local = vec![0.0; N];
    let mut wall = 0.0;
    for j in 0..N {
        for z in 0..N {
            wall += wall_nusselt(&lattice, N as f64, j, z) / (N * N) as f64;
        }
    }
    for (z, l) in local.iter_mut().enumerate() {
        *l = 0.5 * (wall_nusselt(&lattice, N as f64, N / 2 - 1, z) + wall_nusselt(&lattice, N as f64, N / 2, z));
    }
    let middle = local.iter().sum::<f64>() / N as f64;
    let rows = vec![
        Row::relative("Nu of the volume", 2.0542, volume_nusselt(&lattice), 0.015),
        Row::relative("Nu of the hot wall", 2.0542, wall, 0.015),
        Row::relative("Nu of the hot wall in the mid-plane (2.270 by another lattice)", 2.270, middle, 0.01),
    ];
    let place = |i: usize| (i as f64 + 0.5) / N as f64;
    let plot = Plot::new("Local Nusselt number on the hot wall, mid-plane", "height", "Nu")
        .ours("lattice", local.iter().enumerate().map(|(i, v)| [place(i), *v]).collect());
    Outcome::from(rows).plot(plot).note(format!("{steps} steps"))
}

/// V21.
pub fn onset() -> Outcome {
    const H: usize = 32;
    const W: usize = 64;
    const CRITICAL: f64 = 1707.76;
    // Small against saturation (0.3), yet its growth per step, 1e-7, is more than single precision rounds away.
    const SEED: f64 = 5e-3;
    let mut points = Vec::new();
    for ra in [1600.0, 1680.0, 1740.0, 1820.0] {
        let mut s = convection([W, 1, H], H as f64, ra, 0.03);
        s.faces = [[Face::PERIODIC; 2], [Face::PERIODIC; 2], [Face::fixed(0.5), Face::fixed(-0.5)]];
        // Relative to the conducting profile buoyancy only compresses the air; the pressure takes it.
        let rate = alone(|| {
            let mut lattice = Lattice::new(s);
            let wave = |x: usize| (2.0 * PI * x as f64 / W as f64).cos();
            lattice.fill(|n| {
                let y = (n[2] as f64 + 0.5) / H as f64;
                (1.0, [0.0; 3], 0.5 - y + SEED * wave(n[0]) * (PI * y).sin())
            });
            let amplitude = |l: &Lattice| {
                let mut a = 0.0;
                for x in 0..W {
                    for z in 0..H {
                        a += wave(x) * (l.temperature([x, 0, z]) - 0.5 + (z as f64 + 0.5) / H as f64);
                    }
                }
                a
            };
            const SETTLE: usize = 20_000;
            const MEASURE: usize = 30_000;
            for _ in 0..SETTLE {
                lattice.step();
            }
            let before = amplitude(&lattice);
            for _ in 0..MEASURE {
                lattice.step();
            }
            (amplitude(&lattice) / before).ln() / MEASURE as f64
        });
        points.push([ra, rate]);
    }
    let n = points.len() as f64;
    let (mx, my) = (points.iter().map(|p| p[0]).sum::<f64>() / n, points.iter().map(|p| p[1]).sum::<f64>() / n);
    let slope = points.iter().map(|p| (p[0] - mx) * (p[1] - my)).sum::<f64>() / points.iter().map(|p| (p[0] - mx).powi(2)).sum::<f64>();
    let zero = mx - my / slope;
    let plot = Plot::new("Growth rate of the first mode", "Ra", "rate [1/step]")
        .reference("zero at 1707.76, fitted slope", vec![[1600.0, slope * (1600.0 - CRITICAL)], [1820.0, slope * (1820.0 - CRITICAL)]])
        .ours("lattice", points);
    Outcome::from(vec![Row::relative("critical Rayleigh number", CRITICAL, zero, 0.01)]).plot(plot)
}
