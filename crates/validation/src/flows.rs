//! V31 and V33: melts that rest and flow between walls (simulation.md §8.4).

use megas_sim::grid::Grid;
use megas_sim::mechanics::{Mechanics, Settings, Wall};
use megas_sim::particles::{FLUID, MAX_FLUID_J, Particles, TAIT_EXPONENT};

use crate::elastic::plane_strain;
use crate::mechanics::{GRAVITY, block};
use crate::{Case, Outcome, Plot, Row, Tier};

/// Cases of this file.
pub const CASES: &[Case] = &[
    Case::new("V31", "hydrostatic column", Tier::B, hydrostatic)
        .proves("the bulk law, in the melt and in the fluid, and walls that only hold")
        .setup("column of 0.1 m in a slip box, K = 10⁵ Pa, 16 cells, settled with drag; Herschel–Bulkley melt and fluid")
        .formula("p = ρgz, fall of the surface ρgH²/2K"),
    Case::new("V33", "yield-stress flow down an incline", Tier::C, incline)
        .proves("Herschel–Bulkley flow and the sticky wall in the full method")
        .setup("layer of 0.05 m on a slope of 30°, τ_{0} = 100 Pa, exactly periodic along the slope; n = 1 with κ = 5 and n = ½ with κ = 40 (16 cells); n = ½ with κ = 10 under 0.6 of the pull (32 cells)")
        .formula("plug speed V = n/(n+1) (ρg sin θ/κ)^{1/n} y_{p}^{(n+1)/n} above the yielded depth y_{p} = H − τ_{0}/(ρg sin θ)"),
];

/// Mean pressure per layer of cells over the depth, and the fall of the top, in a settled column.
fn column(fluid: bool) -> (Vec<[f64; 2]>, f64) {
    let (dx, height, bulk) = (0.1 / 16.0, 0.1, 1e5);
    // The first nodes of the walls lie in the faces of the column.
    let grid = Grid { origin: [-2.0 * dx; 3], spacing: dx, nodes: [9, 9, 24] };
    let shear = if fluid { 0.0 } else { 3e4 };
    let mut p = block(&grid, [0.0; 3], [4.0 * dx, 4.0 * dx, height], 1000.0, shear, bulk);
    if fluid {
        p.law.fill(FLUID);
        p.exponent.fill(TAIT_EXPONENT as f32);
        p.law_constant.fill(MAX_FLUID_J as f32);
        p.viscosity.fill(1.0);
    } else {
        p.yield_stress.fill(0.0);
        p.viscosity.fill(2.0);
    }
    let mut m = Mechanics::new(&grid, Settings { drag: 30.0, isolation: 0.0, ..Settings::default() }, Vec::new());
    // From the mean height of each layer, so that the half cell to the wall's nodes does not count.
    let layers = 32;
    let layer: Vec<usize> = {
        let mut of = vec![0; p.len()];
        for i in 0..p.len() {
            of[p.id[i] as usize] = (p.position(i)[2] / (0.5 * dx)) as usize;
        }
        of
    };
    let mean_heights = |p: &Particles| {
        let mut sum = vec![(0.0, 0.0); layers];
        for i in 0..p.len() {
            let s = &mut sum[layer[p.id[i] as usize]];
            *s = (s.0 + p.position(i)[2], s.1 + 1.0);
        }
        sum.into_iter().map(|(z, n)| z / n).collect::<Vec<f64>>()
    };
    let start = mean_heights(&p);
    for _ in 0..200 {
        let step = m.time_step(&p, 5e-3);
        m.run(&mut p, step.steps, step.dt);
    }
    let end = mean_heights(&p);
    let mut pressure = vec![(0.0, 0.0); 16];
    for i in 0..p.len() {
        let j = f64::from(p.volume_ratio(i));
        let cauchy = if fluid { bulk / TAIT_EXPONENT * (j.powf(-TAIT_EXPONENT) - 1.0) } else { -bulk * j.ln() / j };
        let s = &mut pressure[layer[p.id[i] as usize] / 2];
        *s = (s.0 + cauchy, s.1 + 1.0);
    }
    let top = end[layers - 1] + 0.25 * dx;
    let profile = (0..16).map(|k| [top - 0.5 * (end[2 * k] + end[2 * k + 1]), pressure[k].0 / pressure[k].1]).collect();
    // Falls relative to the lowest layer: where the wall holds it is not the question here.
    (profile, (start[layers - 1] - end[layers - 1]) - (start[0] - end[0]))
}

fn hydrostatic() -> Outcome {
    let mut rows = Vec::new();
    let mut plot =
        Plot::new("pressure in a column at rest", "depth [m]", "pressure [Pa]").function("ρgz", 0.0, 0.1, |z| 1000.0 * GRAVITY * z);
    for (fluid, name) in [(false, "melt"), (true, "fluid")] {
        let (profile, fall) = column(fluid);
        let worst = profile[2..14]
            .iter()
            .map(|d| d[1] / (1000.0 * GRAVITY * d[0]) - 1.0)
            .fold(0.0, |m: f64, e| if e.abs() > m.abs() { e } else { m });
        rows.push(Row::new(format!("{name}: largest relative error of the pressure, two cells off the ends"), 0.0, worst, 0.03));
        rows.push(Row::relative(format!("{name}: fall of the surface [m]"), 1000.0 * GRAVITY * 0.01 / 2e5, fall, 0.05));
        plot = plot.ours(name, profile);
    }
    Outcome::from(rows).plot(plot)
}

/// A layer that flows down a slope, three periods of it side by side: after every substep the outer ones become copies of the middle
/// one. Forces reach a cell and a half, so the middle period knows no ends.
struct Layer {
    p: Particles,
    period: f64,
    count: usize,
    index: Vec<usize>,
}

impl Layer {
    fn new(grid: &Grid, cells: usize, height: f64, thickness: f64) -> Self {
        let period = cells as f64 * grid.spacing;
        let one = block(grid, [0.0; 3], [period, thickness, height], 1000.0, 1e4, 1e5);
        let count = one.len();
        let mut p = Particles::blank(grid, 3 * count);
        for i in 0..count {
            for copy in 0..3 {
                p.set_position(copy * count + i, one.position(i));
            }
        }
        for i in 0..3 * count {
            p.id[i] = i as u32;
        }
        p.mass.fill(one.mass[0]);
        p.volume.fill(one.volume[0]);
        p.shear.fill(1e4);
        p.bulk.fill(1e5);
        let mut layer = Self { p, period, count, index: vec![0; 3 * count] };
        layer.copy();
        layer
    }

    /// Wraps the middle period and copies it to both sides.
    fn copy(&mut self) {
        let p = &mut self.p;
        for i in 0..p.len() {
            self.index[p.id[i] as usize] = i;
        }
        for k in 0..self.count {
            let i = self.index[k];
            let [x, y, z] = p.position(i);
            let x = x.rem_euclid(self.period);
            p.set_position(i, [x, y, z]);
            for (copy, shift) in [(1, -self.period), (2, self.period)] {
                let j = self.index[copy * self.count + k];
                p.set_position(j, [x + shift, y, z]);
                let (v, c, h) = (p.velocity(i), p.affine(i), p.displacement_gradient(i));
                p.set_velocity(j, v);
                p.set_affine(j, c);
                p.set_displacement_gradient(j, h);
            }
        }
    }
}

/// Speed along the slope over the distance from the wall, after `seconds`, under a `share` of the pull of gravity along the slope, in a
/// layer of `cells` cells.
fn flow_down(index: f64, kappa: f64, share: f64, seconds: f64, cells: usize) -> Vec<[f64; 2]> {
    let height = 0.05;
    let dx = height / cells as f64;
    let thickness = 2.0 * dx;
    let grid = Grid { origin: [-8.0 * dx, -2.5 * dx, -2.0 * dx], spacing: dx, nodes: [21, 8, cells + 8] };
    let mut layer = Layer::new(&grid, 4, height, thickness);
    layer.p.yield_stress.fill((3f64.sqrt() * 100.0) as f32);
    layer.p.viscosity.fill((kappa * 2f64.powf(0.5 * (1.0 + index))) as f32);
    layer.p.exponent.fill(index as f32);
    let mut walls = [[Wall::Slip; 2]; 3];
    walls[2][0] = Wall::Sticky;
    let (sin, cos) = 30f64.to_radians().sin_cos();
    let gravity = [share * GRAVITY * sin, 0.0, -GRAVITY * cos];
    let mut m = Mechanics::new(
        &grid,
        Settings { gravity, walls, track_total: false, isolation: 0.0, ..Settings::default() },
        vec![plane_strain(dx)],
    );
    for _ in 0..(seconds / 0.01) as usize {
        let step = m.time_step(&layer.p, 0.01);
        for _ in 0..step.steps {
            m.run(&mut layer.p, 1, step.dt);
            layer.copy();
        }
    }
    let mut sum = vec![[0.0; 3]; 2 * cells];
    let mut order: Vec<(f64, f64)> = (0..layer.p.len()).map(|i| (layer.p.position(i)[2], f64::from(layer.p.velocity(i)[0]))).collect();
    order.sort_by(|a, b| a.0.total_cmp(&b.0));
    let per = order.len() / sum.len();
    for (k, (z, v)) in order.into_iter().enumerate() {
        let s = &mut sum[(k / per).min(2 * cells - 1)];
        *s = [s[0] + z, s[1] + v, s[2] + 1.0];
    }
    sum.into_iter().map(|s| [s[0] / s[2], s[1] / s[2]]).collect()
}

fn incline() -> Outcome {
    let (height, tau_0) = (0.05, 100.0);
    let mut rows = Vec::new();
    let mut plot = Plot::new("speed of a layer on a slope", "distance from the wall [m]", "speed / plug speed");
    let mut measured = Vec::new();
    for (n, kappa, share, cells) in [(1.0, 5.0, 1.0, 16usize), (0.5, 40.0, 1.0, 16), (0.5, 10.0, 0.6, 32)] {
        let pull = share * 1000.0 * GRAVITY * 0.5;
        let yielded = height - tau_0 / pull;
        let k = n / (n + 1.0);
        let q: f64 = 1.0 + 1.0 / n;
        let plug = k * (pull / kappa).powf(1.0 / n) * yielded.powf(q);
        let exact = move |z: f64| plug * (1.0 - (1.0 - z / yielded).max(0.0).powf(q));
        let profile = flow_down(n, kappa, share, 1.5, cells);
        let speed = profile[profile.len() - cells / 2..].iter().map(|v| v[1]).sum::<f64>() / (cells / 2) as f64;
        // (1 − v/V)^{1/q} falls linearly to zero at the yielded depth.
        let fit: Vec<[f64; 2]> = profile
            .iter()
            .filter(|v| v[1] > 0.1 * speed && v[1] < 0.9 * speed)
            .map(|v| [v[0], (1.0 - v[1] / speed).powf(1.0 / q)])
            .collect();
        let mean = |f: &dyn Fn(&[f64; 2]) -> f64| fit.iter().map(f).sum::<f64>() / fit.len() as f64;
        let (mx, my) = (mean(&|v| v[0]), mean(&|v| v[1]));
        let slope = mean(&|v| (v[0] - mx) * (v[1] - my)) / mean(&|v| (v[0] - mx).powi(2));
        let flux = height * profile.iter().map(|v| v[1]).sum::<f64>() / profile.len() as f64;
        let name = if n == 1.0 { "n = 1, κ = 5".to_owned() } else { format!("n = ½, κ = {kappa}") };
        rows.push(Row::relative(format!("{name}: plug speed [m/s]"), plug, speed, 0.05));
        rows.push(Row::relative(format!("{name}: yielded depth [m]"), yielded, mx - my / slope, 0.05));
        rows.push(Row::relative(format!("{name}: flux [m²/s]"), plug * (height - yielded / (q + 1.0)), flux, 0.05));
        plot = plot.function(name.clone(), 0.0, height, move |z| exact(z) / plug);
        measured.push((name, profile.into_iter().map(|v| [v[0], v[1] / plug]).collect::<Vec<_>>()));
    }
    for (name, profile) in measured {
        plot = plot.ours(name, profile);
    }
    Outcome::from(rows).plot(plot).note(
        "The design asks for κ = 10 on 16 cells and allows 0.6 of the pull, which here needs 32 cells. Under the full pull (V = 2.08 m/s) that melt is too thin for \
         16 cells. The run gives 1.172 m/s after 1.5 s and is not yet steady; a model of the layer in one dimension, with APIC and the flow rule \
         but without pressure, gives 1.174 m/s. So the cause is the transfer, not the volume. Steady plug speeds of the model over the exact one: 0.68 on 16 cells, 0.88 \
         on 32, 0.97 on 64; on 16 cells 0.42 with a quarter of the substep and 0.80 with twice; under 0.6 of the pull 0.83 on 16 and 0.99 on 32. Two things smooth \
         velocities once per substep: hidden nodes at rest take momentum from the first cell over a sticky wall, and APIC damps curvature, both like a \
         viscosity that grows with ρΔx²/Δt. Two remedies were tried. Nodes that mirror the first cell give 0.88 on 16 and 0.97 on 32 cells in the model, but in three \
         dimensions the points on 32 cells lose their order at 1.4 m/s and the plug sinks by 4 %. Adding the changes of the nodes to the points' own \
         velocities gives 0.96 on 16 cells for any substep in the model, but in three dimensions the plug sinks by 12 % within 6 s. Neither is used. For scenes: \
         a Newtonian layer of N cells (model, N = 4, 8, 16) on a sticky face of the box keeps 90 % of the speed that its grid gives thick melts if its viscosity \
         is at least about 0.5 ρcΔx/N, c the wave speed. Thinner melts flow too slowly, not too fast; at rest this drag vanishes.",
    )
}
