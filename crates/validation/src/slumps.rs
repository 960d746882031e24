//! V35, V36 and V38: cylinders that collapse on a rough floor (simulation.md §8.4). A quarter of each, between two mirrors.

use megas_sim::collider::{Collider, Mode, SCENE_CONTACT_OFFSET, Shape};
use megas_sim::grid::Grid;
use megas_sim::material::Material;
use megas_sim::mechanics::{Mechanics, Settings, Wall};
use megas_sim::particles::{DRUCKER_PRAGER, Particles};

use crate::mechanics::{GRAVITY, block};
use crate::{Case, Outcome, Plot, Row, Tier};

/// Cases of this file.
pub const CASES: &[Case] = &[
    Case::new("V35", "axisymmetric spread of a yield-stress fluid", Tier::C, spread)
        .proves("the yield stress in three dimensions, at rest after a long flow")
        .setup("cylinder of 0.25 l, as high as its radius, τ_{0} = 5, 10 and 20 Pa, κ = 2 Pa s, 6 cells in the height of the deposit")
        .formula("R = (225 ρgV²/(128 π² τ_{0}))^{1/5}, height √(2τ_{0}R/ρg) (Roussel & Coussot 2005); R ∝ τ_{0}^{−1/5}"),
    Case::new("V36", "slump of a cylinder", Tier::C, slump_test)
        .proves("the yield stress where it is high: how much of a body stays standing")
        .setup("H = D = 0.1 m on a sticky floor, yield stresses τ* = τ_{0}/ρgH of 0.05–0.2 and 0.6, κ = 20 Pa s, gravity grows over a second, Δx = H/16")
        .formula("slump/H = 1 − aτ*(1 − ln aτ*), between a = √3 (von Mises) and a = 2 (Tresca) (Pashias et al. 1996)"),
    Case::new("V38", "collapse of a sand column", Tier::C, sand)
        .proves("Drucker–Prager friction and its volume correction")
        .setup("φ = 31°, columns of aspect 1 and 2 on a floor with the friction of the sand, tan φ, 20 and 15 cells per radius")
        .formula("run-out (r − r_{0})/r_{0} = 1.24 a below a = 1.7, 1.6 √a above (Lube et al. 2004)"),
];

/// A quarter cylinder of `radius` and `height` at the origin, its solver, and the heights of the deposit over the radius.
struct Quarter {
    p: Particles,
    m: Mechanics,
    dx: f64,
}

impl Quarter {
    fn new(dx: f64, radius: f64, height: f64, reach: f64, density: f64, shear: f64, bulk: f64) -> Self {
        let across = (reach / dx).ceil() as usize + 6;
        // Nodes of the floor lie half a cell below it, where scenes put them: the node at rest above them holds half a cell of melt.
        let grid = Grid {
            origin: [-2.0 * dx, -2.0 * dx, (SCENE_CONTACT_OFFSET - 1e-3 - 2.0) * dx],
            spacing: dx,
            nodes: [across, across, (height / dx) as usize + 8],
        };
        let round = (radius / dx).ceil() * dx;
        let all = block(&grid, [0.0; 3], [round, round, height], density, shear, bulk);
        let inside: Vec<[f64; 3]> = (0..all.len()).map(|i| all.position(i)).filter(|x| x[0].hypot(x[1]) <= radius).collect();
        let mut p = Particles::blank(&grid, inside.len());
        for (i, x) in inside.iter().enumerate() {
            p.set_position(i, *x);
            p.id[i] = i as u32;
        }
        // The lattice does not fill the circle exactly; the points share its volume.
        let volume = 0.25 * std::f64::consts::PI * radius * radius * height / p.len() as f64;
        p.volume.fill(volume as f32);
        p.mass.fill((density * volume) as f32);
        p.shear.fill(shear as f32);
        p.bulk.fill(bulk as f32);
        let walls = [[Wall::Slip; 2]; 3];
        // Mirrors hold both ways; the walls of the box only push, and a stiff quarter topples away from them.
        let mirror = |normal| Collider { mode: Mode::Slip, offset: 1e-3, ..Collider::new(Shape::HalfSpace { point: [0.0; 3], normal }) };
        let floor = Collider { mode: Mode::Sticky, ..Collider::new(Shape::HalfSpace { point: [0.0; 3], normal: [0.0, 0.0, 1.0] }) };
        let colliders = vec![mirror([1.0, 0.0, 0.0]), mirror([0.0, 1.0, 0.0]), floor];
        let m = Mechanics::new(&grid, Settings { walls, track_total: false, ..Settings::default() }, colliders);
        Self { p, m, dx }
    }

    /// The floor holds by friction alone, in place of sticking.
    fn on_friction(mut self, friction: f64) -> Self {
        let mut colliders = self.m.colliders().to_vec();
        if let Some(floor) = colliders.last_mut() {
            *floor = Collider { friction, melt_sticks: false, ..Collider::new(floor.shape.clone()) };
        }
        self.m = Mechanics::new(self.p.grid(), self.m.settings, colliders);
        self
    }

    fn bingham(&mut self, tau_0: f64, kappa: f64) {
        self.p.yield_stress.fill((3f64.sqrt() * tau_0) as f32);
        self.p.viscosity.fill((2.0 * kappa) as f32);
    }

    fn run(&mut self, seconds: f64) {
        self.release(0.0, seconds);
    }

    /// Gravity grows for `ramp` seconds and stays for the rest.
    fn release(&mut self, ramp: f64, seconds: f64) {
        for k in 0..(seconds / 0.01) as usize {
            let share = if ramp > 0.0 { (k as f64 * 0.01 / ramp).min(1.0) } else { 1.0 };
            self.m.settings.gravity = [0.0, 0.0, -GRAVITY * share];
            let step = self.m.time_step(&self.p, 0.01);
            self.m.run(&mut self.p, step.steps, step.dt);
        }
    }

    /// Radius within which this share of the points lies.
    fn radius(&self, share: f64) -> f64 {
        let mut r: Vec<f64> = (0..self.p.len()).map(|i| self.p.position(i)).map(|x| x[0].hypot(x[1])).collect();
        r.sort_by(f64::total_cmp);
        r[((r.len() as f64 * share) as usize).min(r.len() - 1)] + 0.25 * self.dx
    }

    /// Height over the axis.
    fn top(&self) -> f64 {
        let near = (0..self.p.len()).map(|i| self.p.position(i)).filter(|x| x[0].hypot(x[1]) < 1.5 * self.dx);
        near.map(|x| x[2]).fold(0.0, f64::max) + 0.25 * self.dx
    }

    /// Highest points over the radius.
    fn contour(&self) -> Vec<[f64; 2]> {
        let mut heights: Vec<f64> = Vec::new();
        for i in 0..self.p.len() {
            let [x, y, z] = self.p.position(i);
            let ring = (x.hypot(y) / self.dx) as usize;
            if heights.len() <= ring {
                heights.resize(ring + 1, 0.0);
            }
            heights[ring] = heights[ring].max(z + 0.25 * self.dx);
        }
        heights.into_iter().enumerate().map(|(k, h)| [(k as f64 + 0.5) * self.dx, h]).collect()
    }
}

fn spread() -> Outcome {
    let volume = 2.5e-4f64;
    let side = (volume / std::f64::consts::PI).cbrt();
    let rho_g = 1000.0 * GRAVITY;
    let mut rows = Vec::new();
    let mut plot = Plot::new("the deposit at rest", "radius [m]", "height [m]");
    let mut found = Vec::new();
    let mut shapes = Vec::new();
    for tau_0 in [5.0, 10.0, 20.0] {
        let exact = (225.0 * rho_g * volume * volume / (128.0 * std::f64::consts::PI.powi(2) * tau_0)).powf(0.2);
        let deposit = (2.0 * tau_0 * exact / rho_g).sqrt();
        let mut q = Quarter::new(deposit / 6.0, side, side, 1.5 * exact, 1000.0, 1e4, 3e4);
        q.bingham(tau_0, 2.0);
        q.run(4.0);
        let radius = q.radius(0.995);
        found.push((tau_0, radius));
        rows.push(Row::relative(format!("τ_0 {tau_0} Pa: radius [m]"), exact, radius, 0.1));
        if tau_0 == 10.0 {
            rows.push(Row::relative("τ_0 10 Pa: height of the centre [m]", deposit, q.top(), 0.1));
        }
        plot = plot.function(format!("τ_{{0}} = {tau_0} Pa"), 0.0, exact, move |r| (2.0 * tau_0 * (exact - r).max(0.0) / rho_g).sqrt());
        shapes.push((tau_0, q.contour()));
    }
    let exponent = (found[2].1 / found[0].1).ln() / (found[2].0 / found[0].0).ln();
    rows.push(Row::new("exponent of the radius over τ_0", -0.2, exponent, 0.03));
    for (tau_0, shape) in shapes {
        plot = plot.ours(format!("τ_{{0}} = {tau_0} Pa"), shape);
    }
    Outcome::from(rows).plot(plot)
}

fn slump_test() -> Outcome {
    let height = 0.1;
    let theory = |a: f64, t: f64| if a * t < 1.0 { 1.0 - a * t * (1.0 - (a * t).ln()) } else { 0.0 };
    let mut rows = Vec::new();
    let mut measured = Vec::new();
    for t in [0.05, 0.1, 0.15, 0.2, 0.6] {
        let mut q = Quarter::new(height / 16.0, 0.05, height, 0.16, 1000.0, 3e4, 1e5);
        q.bingham(t * 1000.0 * GRAVITY * height, 20.0);
        q.release(1.0, 4.0);
        let slump = 1.0 - q.top() / height;
        measured.push([t, slump]);
        if t < 0.5 {
            let (mises, tresca) = (theory(3f64.sqrt(), t), theory(2.0, t));
            let (middle, half) = (0.5 * (mises + tresca), 0.5 * (mises - tresca));
            rows.push(Row::new(format!("τ* = {t}: slump / H"), middle, slump, half + 0.08));
        } else {
            rows.push(Row::new(format!("τ* = {t}: slump / H"), 0.0, slump, 0.03));
        }
    }
    let plot = Plot::new("slump of a cylinder", "τ_{0}/ρgH", "slump / H")
        .function("von Mises", 0.02, 0.6, move |t| theory(3f64.sqrt(), t))
        .function("Tresca", 0.02, 0.6, move |t| theory(2.0, t))
        .ours("ours", measured);
    Outcome::from(rows).plot(plot).note(
        "V35 and V36 depend on the place of the floor between two nodes. Where it coincides with nodes, these hold half a cell of melt above it at rest: \
         τ* = 0.05 then slumps by 0.568 on H/16 and 0.598 on H/28, and the deposits of V35 stop 15 % short on 3 mm. Scenes put the floor half-way \
         between nodes, and so do these cases.",
    )
}

fn sand() -> Outcome {
    let (phi, e, nu) = (31f64, 2e5, 0.3);
    let (shear, bulk) = crate::mechanics::moduli(e, nu);
    let slope = Material { friction_angle: phi.to_radians(), ..Material::default() }.friction_slope();
    let mut rows = Vec::new();
    let mut plot = Plot::new("heaps of sand", "radius [m]", "height [m]").equal_axes();
    for (aspect, cells) in [(1.0f64, 20.0), (2.0, 15.0)] {
        let (height, r_0) = (0.1, 0.1 / aspect);
        let reach = r_0 * (2.3 + 0.5 * aspect);
        let mut q = Quarter::new(r_0 / cells, r_0, height, reach, 1600.0, shear, bulk).on_friction(phi.to_radians().tan());
        q.p.law.fill(DRUCKER_PRAGER);
        q.p.law_constant.fill(slope as f32);
        q.run(0.6);
        let runout = if aspect < 1.7 { 1.24 * aspect } else { 1.6 * aspect.sqrt() };
        rows.push(Row::relative(format!("a = {aspect}: run-out / r_0"), runout, q.radius(0.999) / r_0 - 1.0, 0.2));
        let contour = q.contour();
        let top = contour.iter().map(|c| c[1]).fold(0.0, f64::max);
        let at = |share: f64| contour.iter().rev().find(|c| c[1] >= share * top).map_or(0.0, |c| c[0]);
        let angle = (0.6 * top / (at(0.2) - at(0.8))).atan().to_degrees();
        rows.push(Row::new(format!("a = {aspect}: slope beyond φ + 2° [°]"), 0.0, (angle - phi - 2.0).max(0.0), 1e-9));
        let (mut volume, mut reference) = (0.0, 0.0);
        for i in 0..q.p.len() {
            volume += f64::from(q.p.volume[i]) * f64::from(q.p.volume_ratio(i));
            reference += f64::from(q.p.volume[i]);
        }
        rows.push(Row::new(format!("a = {aspect}: gain of volume"), 0.0, volume / reference - 1.0, 0.03));
        plot = plot
            .reference(format!("column, a = {aspect}"), vec![[0.0, height], [r_0, height], [r_0, 0.0]])
            .ours(format!("a = {aspect}"), contour);
    }
    Outcome::from(rows).plot(plot).note(
        "The published radius is the edge of the deposit, so the run-out is that of 99.9 % of the sand: in a cone the last thousandth begins 2 % before the edge, the last \
         hundredth 6 %. Before, the case took 99 % of the sand on a sticky floor and missed by 26 and 30 %. At a = 1 (H/20) that measure gives 0.91, 99.9 % gives \
         0.98, and a floor with friction gives 1.06. At a = 2 with 10 cells per radius a floor with friction gives 1.77; with 15 cells a sticky \
         floor gives 1.78 and friction 2.03. A sticky floor forces the shear of the lowest grains into the first cells, which are as deep as the front; sand on \
         rough ground slides there at tan φ, and the experiments found no influence of the ground. The cone of the yield law meets Mohr–Coulomb in simple \
         shear, where the design's meets it in triaxial compression: with that one sand slides at up to 36° instead of 31°.",
    )
}
