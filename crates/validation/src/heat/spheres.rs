//! Balls: cooled at their surface and by a film, melting inside their own melt, lit by a lamp.

use std::f64::consts::PI;

use megas_math::{Vec3, vec3};
use megas_sim::grid::Grid;
use megas_sim::material::Material;
use megas_sim::source::{Film, HeatSource, Light, Motion, Radiant, Region, Schedule, SourceKind};
use megas_sim::thermal::{AirModel, NodeFields, ThermalOptions, ThermalSolver, Wall};

use super::cloud::{Cloud, simple};
use super::surfaces::shape;
use crate::{Outcome, Plot, Row};

/// Radius of the balls of V15 \[cells\].
const RADIUS: f64 = 16.0;
/// Diffusivity in cells and steps of one.
const ALPHA: f64 = 0.1;

/// Roots of `1 − ζ cot ζ = Bi` between nπ and (n+1)π; infinite Bi gives (n+1)π.
fn root(biot: f64, n: u32) -> f64 {
    let (mut lo, mut hi) = (f64::from(n) * PI, (f64::from(n) + 1.0) * PI);
    if biot.is_infinite() {
        return hi;
    }
    for _ in 0..60 {
        let z = 0.5 * (lo + hi);
        if 1.0 - z / z.tan() < biot { lo = z } else { hi = z }
    }
    0.5 * (lo + hi)
}

/// Temperature of a ball at radius `r` (of one) that started at 1 in surroundings at 0 (Carslaw and Jaeger 1959, §9.4).
fn ball_temperature(biot: f64, fourier: f64, r: f64) -> f64 {
    let term = |n: u32| {
        let z = root(biot, n);
        let c = 4.0 * (z.sin() - z * z.cos()) / (2.0 * z - (2.0 * z).sin());
        let spread = if r > 0.0 { (z * r).sin() / (z * r) } else { 1.0 };
        c * spread * (-z * z * fourier).exp()
    };
    (0..40).map(term).sum()
}

/// Mean temperature of the same ball.
fn ball_mean(biot: f64, fourier: f64) -> f64 {
    let term = |n: u32| {
        let z = root(biot, n);
        let c = 4.0 * (z.sin() - z * z.cos()) / (2.0 * z - (2.0 * z).sin());
        c * 3.0 * (z.sin() - z * z.cos()) / z.powi(3) * (-z * z * fourier).exp()
    };
    (0..40).map(term).sum()
}

struct Ball {
    solver: ThermalSolver,
    cloud: Cloud,
    center: Vec3<f64>,
    walls: Option<Vec<Wall>>,
    done: f64,
}

impl Ball {
    fn new(air: AirModel, held: bool) -> Self {
        let nodes = 2 * RADIUS as usize + 8;
        let grid = Grid { origin: [0.0; 3], spacing: 1.0, nodes: [nodes; 3] };
        let center = [0.5 * nodes as f64; 3];
        let inside = |x: Vec3<f64>| vec3::norm(x) < RADIUS;
        let cloud = shape(&grid, 4.0 / 3.0 * PI * RADIUS.powi(3), [1.0, 0.0, 0.0, 0.0], 1.0, 1.0, inside);
        let distance = |n: usize| vec3::norm(vec3::sub(grid.position(grid.node(n)), center)) - RADIUS;
        let walls = held.then(|| (0..grid.len()).map(|n| if distance(n) > 0.0 { Wall::Fixed(0.0) } else { Wall::Open }).collect());
        let options = ThermalOptions { air, max_subcycles: 2000, ..ThermalOptions::default() };
        Self { solver: ThermalSolver::new(grid, &[simple(1.0, 1.0, ALPHA)], 0.0, options), cloud, center, walls, done: 0.0 }
    }

    /// Goes on until the Fourier number `fourier`, in exchanges of up to eight steps.
    fn until(&mut self, fourier: f64) {
        let end = fourier * RADIUS * RADIUS / ALPHA;
        let steps = ((end - self.done) / 8.0 - 1e-9).ceil();
        for _ in 0..steps as u32 {
            let dt = (end - self.done) / steps;
            self.cloud.step(&mut self.solver, dt, 0.0, &[], self.walls.as_deref());
        }
        self.done = end;
    }

    fn at_center(&self) -> f64 {
        self.solver.sample(self.center).unwrap_or(f64::NAN)
    }

    fn mean(&self) -> f64 {
        self.cloud.h.iter().sum::<f64>() / self.cloud.h.len() as f64
    }

    /// Temperature on the surface: the line through the shells half to one and a half cells below it.
    fn surface(&self) -> f64 {
        let shell = |from: f64, to: f64| {
            let (mut t, mut r, mut n) = (0.0, 0.0, 0.0);
            for (x, h) in self.cloud.xi.iter().zip(&self.cloud.h) {
                let depth = RADIUS - vec3::norm(vec3::sub(*x, self.center));
                if depth >= from && depth < to {
                    (t, r, n) = (t + h, r + depth, n + 1.0);
                }
            }
            [r / n, t / n]
        };
        let (a, b) = (shell(0.5, 1.5), shell(1.5, 2.5));
        a[1] + (b[1] - a[1]) / (b[0] - a[0]) * (0.0 - a[0])
    }

    /// Standard deviation of what the points within a quarter of a cell of the surface have over the exact temperature there.
    fn mottling(&self, biot: f64, fourier: f64) -> f64 {
        let radius = |x: &Vec3<f64>| vec3::norm(vec3::sub(*x, self.center)) / RADIUS;
        let rim = self.cloud.xi.iter().zip(&self.cloud.h).filter(|(x, _)| radius(x) > 1.0 - 0.25 / RADIUS);
        let over: Vec<f64> = rim.map(|(x, h)| h - ball_temperature(biot, fourier, radius(x).min(1.0))).collect();
        let mean = over.iter().sum::<f64>() / over.len() as f64;
        (over.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / over.len() as f64).sqrt()
    }

    /// Every 64th point: radius of one, temperature.
    fn profile(&self) -> Vec<[f64; 2]> {
        let all = self.cloud.xi.iter().zip(&self.cloud.h).step_by(64);
        all.map(|(x, h)| [vec3::norm(vec3::sub(*x, self.center)) / RADIUS, *h]).collect()
    }
}

/// V15 (i): the surface held at the temperature of the bath.
pub fn held_ball() -> Outcome {
    let mut ball = Ball::new(AirModel::None, true);
    let mut rows = Vec::new();
    let mut plot = Plot::new("ball whose surface is held at 0", "radius / R", "T / T_{0}");
    #[allow(clippy::approx_constant)] // a tabulated value of the series, not 1/√2
    for (fourier, centre, mean) in [(0.05, 0.9660, 0.3931), (0.1, 0.7071, 0.2295), (0.2, 0.2771, 0.0845), (0.3, 0.1035, 0.0315)] {
        ball.until(fourier);
        rows.push(Row::new(format!("centre at Fo = {fourier}"), centre, ball.at_center(), 0.04));
        rows.push(Row::new(format!("mean at Fo = {fourier}"), mean, ball.mean(), 0.04));
        plot = plot.function(format!("exact, Fo = {fourier}"), 0.0, 1.0, |r| ball_temperature(f64::INFINITY, fourier, r));
        plot = plot.ours(format!("points, Fo = {fourier}"), ball.profile());
    }
    Outcome::from(rows).plot(plot)
}

/// V15 (ii): a film, Bi = 1 and 10.
pub fn filmed_ball() -> Outcome {
    let mut rows = Vec::new();
    let mut plots = Vec::new();
    let one: &[(f64, f64)] = &[(0.05, 0.9969), (0.1, 0.9493), (0.2, 0.7723), (0.5, 0.3708), (1.0, 0.1080)];
    let ten: &[(f64, f64)] = &[(0.05, 0.9826), (0.1, 0.7958), (0.2, 0.3827), (0.5, 0.0345)];
    let surface = [0.7477, 0.6432, 0.4959, 0.2360, 0.0687];
    for (biot, times, tolerance) in [(1.0, one, 0.03), (10.0, ten, 0.08)] {
        let film = Film { ambient: 0.0, coefficient: biot * ALPHA / RADIUS, emissivity: 0.0 };
        let mut ball = Ball::new(AirModel::Film(film), false);
        let mut plot = Plot::new(format!("ball under a film, Bi = {biot}"), "radius / R", "T / T_{0}");
        for (k, &(fourier, centre)) in times.iter().enumerate() {
            ball.until(fourier);
            rows.push(Row::relative(format!("centre, Bi = {biot}, Fo = {fourier}"), centre, ball.at_center(), tolerance));
            if biot == 1.0 {
                rows.push(Row::relative(format!("surface, Bi = 1, Fo = {fourier}"), surface[k], ball.surface(), tolerance));
            }
            rows.push(Row::relative(format!("mean, Bi = {biot}, Fo = {fourier}"), ball_mean(biot, fourier), ball.mean(), tolerance));
            if biot == 10.0 && fourier == 0.05 {
                // Twice as much while the nodes outside the rim had to wait for conduction.
                let name = "spread of the temperature over the surface, Bi = 10, Fo = 0.05";
                rows.push(Row::new(name, 0.0, ball.mottling(biot, fourier), 0.012));
            }
            plot = plot.function(format!("exact, Fo = {fourier}"), 0.0, 1.0, |r| ball_temperature(biot, fourier, r));
            plot = plot.ours(format!("points, Fo = {fourier}"), ball.profile());
        }
        plots.push(plot);
    }
    plots.into_iter().fold(Outcome::from(rows), Outcome::plot)
}

/// A ball of `radius` that melts inside its melt, which is held at 1 on a sphere of radius `outer`, solved along the radius in shells
/// of half a cell: when it has melted, and along the way time and radius. Heat capacity 1, latent heat 1/`stefan`, conductivity `k`;
/// the melt starts with the steady profile.
fn radial_melting(radius: f64, outer: f64, stefan: f64, k: f64) -> (f64, Vec<[f64; 2]>) {
    let dr = 0.5;
    let n = (outer / dr).round() as usize;
    let dt = 0.2 * dr * dr / k;
    let volume = |i: usize| (((i + 1) as f64 * dr).powi(3) - (i as f64 * dr).powi(3)) / 3.0;
    let latent = 1.0 / stefan;
    let mut h: Vec<f64> = (0..n)
        .map(|i| (i as f64 + 0.5) * dr)
        .map(|r| if r > radius { latent + (1.0 / radius - 1.0 / r) / (1.0 / radius - 1.0 / outer) } else { 0.0 })
        .collect();
    let (mut time, mut seen) = (0.0, Vec::new());
    loop {
        let t: Vec<f64> = h.iter().map(|h| (h - latent).max(0.0)).collect();
        let (mut solid, mut inner) = (0.0, 0.0);
        for i in 0..n {
            let flux = if i + 1 < n { k * (t[i + 1] - t[i]) / dr } else { 2.0 * k * (1.0 - t[i]) / dr };
            let through = flux * ((i + 1) as f64 * dr).powi(2);
            h[i] += dt * (through - inner) / volume(i);
            inner = through;
            solid += (1.0 - h[i] * stefan).clamp(0.0, 1.0) * volume(i);
        }
        time += dt;
        let r = (3.0 * solid).cbrt();
        seen.push([time, r]);
        if r < 0.02 * radius {
            return (time, seen);
        }
    }
}

/// V14: a solid ball at its melting point inside its own melt, which is held 1 K warmer on a sphere of four radii.
pub fn melting_ball() -> Outcome {
    let (radius, stefan, k) = (12.0f64, 0.02f64, 0.15f64);
    let outer = 4.0 * radius;
    let nodes = 2 * (outer as usize + 2) + 1;
    let grid = Grid { origin: [0.0; 3], spacing: 1.0, nodes: [nodes; 3] };
    let center = [0.5 * (nodes - 1) as f64; 3];
    let material = Material { latent_heat: 1.0 / stefan, solidus: 0.0, liquidus: 0.0, ..simple(1.0, 1.0, k) };
    let mut solver = ThermalSolver::new(grid, std::slice::from_ref(&material), 0.0, ThermalOptions::default());
    let distance: Vec<f64> = (0..grid.len()).map(|n| vec3::norm(vec3::sub(grid.position(grid.node(n)), center))).collect();
    let mass: Vec<f64> = distance.iter().map(|r| if *r < outer { 1.0 } else { 0.0 }).collect();
    let walls: Vec<Wall> = distance.iter().map(|r| if *r < outer { Wall::Open } else { Wall::Fixed(1.0) }).collect();
    // Outside the ball the steady profile of conduction, inside solid at its melting point; the surface cells in part.
    let steady = |r: f64| (1.0 / radius - 1.0 / r) / (1.0 / radius - 1.0 / outer);
    let mut energy: Vec<f64> = distance
        .iter()
        .map(|&r| {
            let liquid = (r - radius + 0.5).clamp(0.0, 1.0);
            liquid / stefan + if r > radius { steady(r).min(1.0) } else { 0.0 }
        })
        .collect();
    let kind = vec![0u8; grid.len()];
    let solid = |energy: &[f64]| -> f64 { energy.iter().zip(&mass).map(|(h, m)| m * (1.0 - (h * stefan).clamp(0.0, 1.0))).sum() };
    let of_volume = |v: f64| (v / (4.0 / 3.0 * PI)).cbrt();
    let start = of_volume(solid(&energy));
    let whole = (0.5 - start / (3.0 * outer)) * start * start / (stefan * k);
    // ½R² − R³/3R_o falls linearly.
    let measure = |r: f64| 0.5 * r * r - r.powi(3) / (3.0 * outer);
    let (exact, path) = radial_melting(radius, outer, stefan, k);
    let (mut time, mut melted) = (0.0, f64::NAN);
    let (mut ours, mut worst) = (Vec::new(), 0.0f64);
    while time < 1.3 * whole {
        let dt = 4.0;
        let mut fields = NodeFields { mass: &mass, volume: &mass, material: &kind, energy: &mut energy };
        if let Err(e) = solver.step_nodes(&mut fields, dt, time, &[], Some(&walls)) {
            return Outcome::from(vec![Row::new("the step completes", 1.0, 0.0, 0.0)]).note(e.to_string());
        }
        time += dt;
        let r = of_volume(solid(&energy));
        if ours.len() < (40.0 * time / whole) as usize {
            ours.push([time / whole, measure(r) / measure(start)]);
            if time < 0.9 * whole {
                let at = path.partition_point(|p| p[0] < time).min(path.len() - 1);
                worst = worst.max((measure(r) / measure(start) - measure(path[at][1]) / measure(radius)).abs());
            }
        }
        if r < 0.02 * start {
            melted = time;
            break;
        }
    }
    let plot = Plot::new("what is left of a ball that melts inside its melt", "t / t_{melt}", "(½R² − R³/3R_{o}) over its start")
        .reference("quasi-steady solution", vec![[0.0, 1.0], [1.0, 0.0]])
        .reference(
            "radial solution, St = 0.02",
            path.iter().step_by(path.len() / 100).map(|p| [p[0] / whole, measure(p[1]) / measure(radius)]).collect(),
        )
        .ours("nodes", ours);
    let rows = vec![
        Row::relative("melting time [steps]", exact, melted, 0.04),
        Row::new("largest departure of ½R² − R³/3R_o from the radial solution before 0.9 t_melt", 0.0, worst, 0.04),
    ];
    Outcome::from(rows).plot(plot).note(format!(
        "the quasi-steady formula gives {whole:.0}: it leaves out the heat that the melt takes up, a fifth of the latent heat of the ball at \
         St = 0.02, and ends {:.1} % early; the reference is the same problem solved along the radius",
        100.0 * (exact / whole - 1.0)
    ))
}

/// V17: the power that a lit ball takes, and what stands in its shadow.
pub fn lit_balls() -> Outcome {
    let radius = 12.0;
    let grid = Grid { origin: [0.0; 3], spacing: 1.0, nodes: [34, 34, 74] };
    let material = simple(1.0, 1.0, 1e-3);
    // Two balls, one above the other; `shape` centres at the middle of the grid.
    let ball = |z: f64| move |x: Vec3<f64>| vec3::norm(vec3::sub(x, [0.0, 0.0, z])) < radius;
    let volume = 4.0 / 3.0 * PI * radius.powi(3);
    let straight = [1.0, 0.0, 0.0, 0.0];
    let (upper, lower) = (shape(&grid, volume, straight, 1.0, 0.0, ball(18.0)), shape(&grid, volume, straight, 1.0, 0.0, ball(-18.0)));
    let mut both = upper.clone();
    both.append(&lower, 1);
    let power = |cloud: &Cloud, light: Light, strength: f64, region: Region| {
        let mut solver = ThermalSolver::new(grid, std::slice::from_ref(&material), 0.0, ThermalOptions::default());
        let source = HeatSource {
            name: String::new(),
            region,
            kind: SourceKind::Radiant(Radiant { light, strength, absorptivity: 0.8 }),
            schedule: Schedule::default(),
            motion: Motion::default(),
        };
        cloud.clone().step(&mut solver, 1e-3, 0.0, &[source], None).source / 1e-3
    };
    let down = Light::Sun { direction: [0.0, 0.0, -2.0] };
    let disc = PI * radius * radius;
    let middle = [17.0, 17.0, 37.0];
    let torch =
        |z: f64, half_angle: f64| Light::Torch { position: vec3::add(middle, [0.0, 0.0, z]), direction: [0.0, 0.0, -1.0], half_angle };
    // The ball fills this part of a cone that is wider than it, seen from 30 cells.
    let seen = 1.0 - (1.0 - (radius / 30.0f64).powi(2)).sqrt();
    let cone = 0.6f64;
    let mut rows = vec![
        Row::relative("sun on one ball, over 0.8 I π R²", 1.0, power(&upper, down, 500.0, Region::All) / (0.8 * 500.0 * disc), 0.03),
        Row::relative(
            "slanting sun on one ball, over 0.8 I π R²",
            1.0,
            power(&upper, Light::Sun { direction: [1.0, 0.4, -0.7] }, 500.0, Region::All) / (0.8 * 500.0 * disc),
            0.03,
        ),
        Row::relative(
            "sun on two balls, one behind the other, over 0.8 I π R²",
            1.0,
            power(&both, down, 500.0, Region::All) / (0.8 * 500.0 * disc),
            0.03,
        ),
        Row::new(
            "sun on the ball in the shadow, over 0.8 I π R²",
            0.0,
            power(&both, down, 500.0, Region::Object(1)) / (0.8 * 500.0 * disc),
            0.01,
        ),
        Row::relative(
            "torch in a cone wider than the ball, over its share",
            1.0,
            power(&upper, torch(18.0 + 30.0, cone), 100.0, Region::All) / (0.8 * 100.0 * seen / (1.0 - cone.cos())),
            0.03,
        ),
    ];
    let narrow = power(&upper, torch(18.0 + 30.0, 0.1), 100.0, Region::All) / (0.8 * 100.0);
    rows.push(Row::relative("torch in a cone narrower than the ball, over its power", 1.0, narrow, 0.05));
    rows.into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_series_give_the_published_values() {
        for (fourier, centre, mean) in [(0.05, 0.9660, 0.3931), (0.3, 0.1035, 0.0315)] {
            assert!((ball_temperature(f64::INFINITY, fourier, 0.0) - centre).abs() < 1e-4);
            assert!((ball_mean(f64::INFINITY, fourier) - mean).abs() < 1e-4);
        }
        for (biot, fourier, centre) in [(1.0, 0.1, 0.9493), (1.0, 1.0, 0.1080), (10.0, 0.2, 0.3827), (10.0, 0.5, 0.0345)] {
            assert!((ball_temperature(biot, fourier, 0.0) - centre).abs() < 1e-4, "{biot} {fourier}");
        }
        assert!((ball_temperature(1.0, 0.2, 1.0) - 0.4959).abs() < 1e-4);
    }
}
