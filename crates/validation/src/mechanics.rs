//! V26–V37 and the mechanics of V45: motion, elasticity, flow, friction, determinism (simulation.md §8.4, §8.6).

use megas_math::{Mat3, mat3, vec3};
use megas_sim::collider::{Collider, Shape};
use megas_sim::grid::Grid;
use megas_sim::mechanics::{Mechanics, Settings, Wall, material_point};
use megas_sim::particles::{HENCKY, Particles};
use megas_sim::reference::{self, Law};
use megas_sim::schedule::{Motion, PoseKey};

use crate::{Case, Outcome, Plot, Row, Tier};

/// Cases of this file.
pub const CASES: &[Case] = &[
    Case::new("V26", "free fall", Tier::A, free_fall)
        .proves("the order of the time integration, and that falling strains nothing")
        .setup("block of 8 cells, E = 10⁵ Pa, 0.1 s in 500 substeps")
        .formula("½gt² + ½gtΔt (symplectic Euler), momentum mgt, no stress"),
    Case::new("V29", "period of an axial bar", Tier::A, axial_bar)
        .proves("elastic constants and reference volumes, and that elastic waves keep their energy")
        .setup("free bar of 16, 32 and 64 cells, ν = 0, first axial mode at 10^{−3} of the wave speed, five periods")
        .formula("period 2L/c, c = √(E/ρ); the ratios are those that this discretization has in theory"),
    Case::new("V32", "Herschel–Bulkley flow of one point", Tier::A, shear_flow)
        .proves("the return map and the conversion from rheometer constants")
        .setup("one point under simple shear at a fixed rate for 0.3 s, oracle in f64 and kernel in f32")
        .formula("τ_{xy} = σ_{Y}/√3 + η 2^{−(1+h)/2} γ̇^{h}; det F = 1; after the flow stops |dev τ| = √(2/3) σ_{Y}"),
    Case::new("V34", "plane slump of a yield-stress fluid", Tier::B, plane_slump)
        .proves("the yield stress from end to end: what remains standing is what the melt can carry")
        .setup("half block of 0.1 × 0.1 m between slip walls on a sticky floor, τ_{0} = 20 Pa, μ = 2 Pa s, 8 s, Δx = 10 mm")
        .formula(
            "h = √(2τ_{0}(L − x)/ρg), L = (9ρgA²/8τ_{0})^{1/3} (thin layer at rest); the ratios to it are those of the reference program",
        ),
    Case::new("V34-fine", "plane slump at half the spacing", Tier::C, plane_slump_fine)
        .proves("convergence of V34")
        .setup("as V34 with Δx = 5 mm")
        .formula("as V34"),
    Case::new("V37", "Coulomb friction on an incline", Tier::A, friction)
        .proves("contact and friction of colliders of every shape")
        .setup("elastic block on a plane, a tilted plane, a box and a ball of 2 km, all at 30°")
        .formula("a = g (sin θ − μ cos θ), and rest where μ > tan θ"),
    Case::new("V45", "same bits for any number of threads", Tier::A, determinism)
        .proves("that the mechanics does not depend on how the work is shared")
        .setup("block melting from below, 200 coupling steps with 1, 2 and 4 threads")
        .formula("equal hashes of the state"),
];

pub(crate) const GRAVITY: f64 = 9.81;

/// Points on a regular lattice of half the node spacing that fills the box `min`..`max`, at rest, with the given density
/// and moduli.
pub(crate) fn block(grid: &Grid, min: [f64; 3], max: [f64; 3], density: f64, shear: f64, bulk: f64) -> Particles {
    let h = 0.5 * grid.spacing;
    let count: [usize; 3] = std::array::from_fn(|a| ((max[a] - min[a]) / h).round() as usize);
    let mut p = Particles::blank(grid, count.iter().product());
    let mut i = 0;
    for x in 0..count[0] {
        for y in 0..count[1] {
            for z in 0..count[2] {
                let site = [x, y, z];
                p.set_position(i, std::array::from_fn(|a| min[a] + (site[a] as f64 + 0.5) * h));
                p.id[i] = i as u32;
                i += 1;
            }
        }
    }
    p.volume.fill((h * h * h) as f32);
    p.mass.fill((density * h * h * h) as f32);
    p.shear.fill(shear as f32);
    p.bulk.fill(bulk as f32);
    p.law.fill(HENCKY);
    p
}

/// Shear and bulk modulus.
pub(crate) fn moduli(e: f64, nu: f64) -> (f64, f64) {
    megas_sim::material::Material::moduli(e, nu)
}

fn center(p: &Particles) -> [f64; 3] {
    let sum = (0..p.len()).fold([0.0; 3], |s, i| vec3::add(s, p.position(i)));
    vec3::scale(sum, 1.0 / p.len() as f64)
}

fn free_fall() -> Outcome {
    let grid = Grid { origin: [0.0; 3], spacing: 0.01, nodes: [20, 20, 32] };
    let (shear, bulk) = moduli(1e5, 0.3);
    let mut p = block(&grid, [0.06, 0.06, 0.15], [0.14, 0.14, 0.23], 1000.0, shear, bulk);
    let start: Vec<_> = (0..p.len()).map(|i| p.position(i)).collect();
    let from = center(&p);
    let mass: f64 = p.mass.iter().map(|&m| f64::from(m)).sum();
    let mut m = Mechanics::new(&grid, Settings::default(), Vec::new());
    let (dt, steps) = (2e-4, 500);
    let report = m.run(&mut p, steps, dt);
    let t = dt * steps as f64;
    let fall = from[2] - center(&p)[2];
    let momentum: f64 = (0..p.len()).map(|i| f64::from(p.mass[i]) * f64::from(p.velocity(i)[2])).sum();
    let (mut shape, mut strain) = (0.0f64, 0.0f64);
    for i in 0..p.len() {
        let moved = vec3::sub(p.position(i), start[p.id[i] as usize]);
        shape = shape.max(vec3::norm(vec3::sub(moved, [0.0, 0.0, -fall])) / 0.08);
        strain = strain.max(mat3::norm(mat3::cast::<f32, f64>(p.displacement_gradient(i))));
    }
    vec![
        Row::relative("fall of the centre [m]", 0.5 * GRAVITY * t * t + 0.5 * GRAVITY * t * dt, fall, 1e-5),
        // All points share one velocity, so the rounding of `v + g Δt` in f32 does not average out: up to half an ulp of 1 m/s
        // per g Δt, 1.5e-5.
        Row::relative("momentum [kg m/s]", -mass * GRAVITY * t, momentum, 1.5e-5),
        Row::new("change of shape / side", 0.0, shape, 1e-5),
        Row::new("largest stress / E", 0.0, strain, 1e-5),
        Row::new("repairs", 0.0, report.repairs.capped as f64 + report.repairs.degenerate as f64, 0.0),
    ]
    .into()
}

/// Ratio of the measured to the exact period of the first axial mode, the amplitude left after five periods, and the amplitude
/// over the time in periods.
fn bar(cells: usize) -> (f64, f64, Vec<[f64; 2]>) {
    let dx = 0.01;
    let grid = Grid { origin: [0.0; 3], spacing: dx, nodes: [cells + 16, 20, 20] };
    let (shear, bulk) = moduli(1e5, 0.0);
    let lo = [8.0 * dx, 8.0 * dx, 8.0 * dx];
    let length = cells as f64 * dx;
    let mut p = block(&grid, lo, [lo[0] + length, 12.0 * dx, 12.0 * dx], 1000.0, shear, bulk);
    let c = (1e5f64 / 1000.0).sqrt();
    let mut shape = vec![0.0; p.len()];
    for i in 0..p.len() {
        let k = std::f64::consts::PI / length;
        let x = p.position(i)[0] - lo[0];
        shape[p.id[i] as usize] = (k * x).cos();
        p.set_velocity(i, [(1e-3 * c * (k * x).cos()) as f32, 0.0, 0.0]);
        // The affine matrix of the same field; without it the first transfer would damp it.
        p.set_affine(i, [[(-1e-3 * c * k * (k * x).sin()) as f32, 0.0, 0.0], [0.0; 3], [0.0; 3]]);
    }
    let mut m = Mechanics::new(&grid, Settings { gravity: [0.0; 3], ..Settings::default() }, Vec::new());
    let exact = 2.0 * length / c;
    let per_period = (exact * c / (0.4 * dx)).ceil() as usize;
    let dt = exact / per_period as f64;
    let amplitude = |p: &Particles| (0..p.len()).map(|i| f64::from(p.velocity(i)[0]) * shape[p.id[i] as usize]).sum::<f64>();
    let first = amplitude(&p);
    // The zeros of the mode's velocity give the period.
    let (mut zeros, mut last, mut peak) = (Vec::new(), first, 0.0f64);
    let mut seen = vec![[0.0, 1.0]];
    for k in 1.. {
        m.run(&mut p, 1, dt);
        let t = f64::from(k) * dt;
        let a = amplitude(&p);
        seen.push([t / exact, a / first]);
        if last * a < 0.0 {
            zeros.push(t - dt * a / (a - last));
        }
        last = a;
        if t > 4.75 * exact {
            peak = peak.max(a.abs());
        }
        if t > 5.3 * exact {
            break;
        }
    }
    let period = 2.0 * (zeros[zeros.len() - 1] - zeros[0]) / (zeros.len() - 1) as f64;
    (period / exact, peak / first.abs(), seen)
}

fn axial_bar() -> Outcome {
    let mut rows = Vec::new();
    let mut plot = Plot::new("velocity of the first mode", "t / (2L/c)", "amplitude / start")
        .function("cos 2πt/T", 0.0, 5.3, |t| (std::f64::consts::TAU * t).cos());
    for (cells, ratio, tolerance) in [(16, 1.0039, 5e-3), (32, 1.0010, 2e-3), (64, 1.0002, 1e-3)] {
        let (period, amplitude, seen) = bar(cells);
        if cells == 32 {
            plot = plot.ours("bar of 32 cells", seen);
        }
        rows.push(Row::new(format!("L = {cells} Δx: period / (2L/c)"), ratio, period, tolerance));
        rows.push(Row::new(format!("L = {cells} Δx: amplitude after 5 periods"), 1.0, amplitude, 0.01));
    }
    Outcome::from(rows).plot(plot)
}

fn shear_flow() -> Outcome {
    let mut rows = Vec::new();
    let cases = [(1e4, 100.0, 20.0, 1.0, 10.0, 157.735), (1e4, 100.0, 20.0, 0.5, 10.0, 95.341), (1e4, 0.0, 2.0, 1.0, 50.0, 50.0)];
    for (shear, yield_stress, viscosity, exponent, rate, reference) in cases {
        let law = Law { law: HENCKY, shear, bulk: 3e4, yield_stress, viscosity, exponent, constant: 0.0 };
        let name = format!("σ_Y {yield_stress}, η {viscosity}, h {exponent}: τ_xy [Pa]");
        for dt in [1e-3, 1e-4] {
            let mut f = mat3::identity::<f64>();
            for _ in 0..(0.3 / dt) as usize {
                f = reference::return_map(&law, mat3::mul([[1.0, rate * dt, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], f), dt).0;
            }
            rows.push(Row::relative(format!("f64, Δt {dt:.0e}, {name}"), reference, reference::stress(&law, f)[0][1], 2e-3));
            rows.push(Row::new(format!("f64, Δt {dt:.0e}: det F"), 1.0, mat3::det(f), 1e-9));
            if yield_stress > 0.0 && dt == 1e-3 {
                // At rest the stress relaxes to the yield surface.
                for _ in 0..20_000 {
                    f = reference::return_map(&law, f, dt).0;
                }
                let t = reference::stress(&law, f);
                let mean = mat3::trace(t) / 3.0;
                let s = mat3::norm(mat3::sub(t, mat3::scale(mat3::identity(), mean)));
                rows.push(Row::relative("f64: residual |dev τ| [Pa]", (2.0f64 / 3.0).sqrt() * yield_stress, s, 2e-3));
            }
        }
        // The production kernel, one point in f32.
        let law = Law {
            law: HENCKY,
            shear: shear as f32,
            bulk: 3e4,
            yield_stress: yield_stress as f32,
            viscosity: viscosity as f32,
            exponent: exponent as f32,
            constant: 0.0,
        };
        let dt = 1e-4f32;
        let mut h: Mat3<f32> = [[0.0; 3]; 3];
        let mut tau = h;
        for _ in 0..3000 {
            let g = rate as f32 * dt;
            for c in 0..3 {
                h[0][c] += g * (h[1][c] + f32::from(u8::from(c == 1)));
            }
            (h, tau) = material_point(&law, h, dt);
        }
        rows.push(Row::relative(format!("f32, Δt 1e-4, {name}"), reference, tau[0][1].into(), 2e-3));
        let f: Mat3<f64> = mat3::add(mat3::cast(h), mat3::identity());
        rows.push(Row::new("f32: det F after 3000 yielding steps", 1.0, mat3::det(f), 2e-5));
    }
    Outcome::from(rows).plot(flow_curves())
}

/// Steady shear stress over the shear rate: the law and the kernel.
fn flow_curves() -> Plot {
    let fluids = [(100.0, 20.0, 1.0, "σ_{Y} 100, η 20, h 1"), (100.0, 20.0, 0.5, "σ_{Y} 100, η 20, h ½"), (0.0, 2.0, 1.0, "η 2, h 1")];
    let mut plot = Plot::new("flow curves", "shear rate [1/s]", "τ_{xy} [Pa]").log(true, true);
    for (yield_stress, viscosity, exponent, label) in fluids {
        let (sy, eta, h): (f64, f64, f64) = (yield_stress, viscosity, exponent);
        plot =
            plot.function(format!("law, {label}"), 0.1, 100.0, |rate| sy / 3f64.sqrt() + eta * 2f64.powf(-(1.0 + h) / 2.0) * rate.powf(h));
    }
    for (yield_stress, viscosity, exponent, label) in fluids {
        let law = Law {
            law: HENCKY,
            shear: 1e4f32,
            bulk: 3e4,
            yield_stress: yield_stress as f32,
            viscosity: viscosity as f32,
            exponent: exponent as f32,
            constant: 0.0,
        };
        let stress = |rate: f64| {
            let mut h: Mat3<f32> = [[0.0; 3]; 3];
            let mut tau = h;
            // Long enough to reach the steady stress: a strain of one, and a hundred relaxation times.
            let dt = (1e-2 / rate).min(1e-3) as f32;
            for _ in 0..((1.0 / rate).max(0.3) / f64::from(dt)) as usize {
                let g = rate as f32 * dt;
                for c in 0..3 {
                    h[0][c] += g * (h[1][c] + f32::from(u8::from(c == 1)));
                }
                (h, tau) = material_point(&law, h, dt);
            }
            f64::from(tau[0][1])
        };
        plot =
            plot.ours(format!("kernel, {label}"), (0..10).map(|k| 10f64.powf(-1.0 + f64::from(k) / 3.0)).map(|r| [r, stress(r)]).collect());
    }
    plot
}

/// Length and height of the deposit of a half block 0.1 m × 0.1 m with yield stress `tau_0`, after `seconds`, and its contour.
pub(crate) fn slump(dx: f64, tau_0: f64, seconds: f64) -> (f64, f64, Vec<[f64; 2]>) {
    // A slab two cells thick between slip walls; the padding layers are the walls, node 2 is the first free plane.
    let (length, thickness) = (0.46, 2.0 * dx);
    let nodes = [(length / dx) as usize + 6, 8, (0.14 / dx) as usize + 6];
    let grid = Grid { origin: [-2.0 * dx, -2.0 * dx - 0.5 * dx, -2.0 * dx], spacing: dx, nodes };
    let mut p = block(&grid, [0.0, 0.0, 0.0], [0.1, thickness, 0.1], 1000.0, 3e3, 1e5);
    p.yield_stress.fill((3f64.sqrt() * tau_0) as f32);
    p.viscosity.fill(2.0 * 2.0);
    let mut walls = [[Wall::Slip; 2]; 3];
    walls[2][0] = Wall::Sticky;
    let mut m = Mechanics::new(&grid, Settings { walls, ..Settings::default() }, Vec::new());
    let coupling = 0.01;
    for _ in 0..(seconds / coupling) as usize {
        let step = m.time_step(&p, coupling);
        m.run(&mut p, step.steps, step.dt);
    }
    // The 99.5 % quantile of x and the top at the symmetry plane, plus half a point spacing each.
    let mut x: Vec<f64> = (0..p.len()).map(|i| p.position(i)[0]).collect();
    x.sort_by(f64::total_cmp);
    let reach = x[(x.len() as f64 * 0.995) as usize] + 0.25 * dx;
    let top = (0..p.len()).filter(|&i| p.position(i)[0] < 1.5 * dx).map(|i| p.position(i)[2]).fold(0.0, f64::max) + 0.25 * dx;
    // The highest point of every cell along the slump.
    let mut contour = vec![0.0f64; (length / dx) as usize];
    for i in 0..p.len() {
        let [x, _, z] = p.position(i);
        if let Some(h) = contour.get_mut((x / dx).max(0.0) as usize) {
            *h = h.max(z + 0.25 * dx);
        }
    }
    let contour = contour.iter().enumerate().filter(|c| *c.1 > 0.0).map(|(k, h)| [(k as f64 + 0.5) * dx, *h]).collect();
    (reach, top, contour)
}

/// Rows and figure of a slump against the thin-layer theory, at the ratios that the reference program reached (V34 of the design).
fn slump_outcome(dx: f64, length_ratio: f64, height_ratio: f64) -> Outcome {
    let tau_0 = 20.0f64;
    let area = 0.01;
    let rho_g = 1000.0 * GRAVITY;
    let length = (9.0 * rho_g * area * area / (8.0 * tau_0)).cbrt();
    let height = (2.0 * tau_0 * length / rho_g).sqrt();
    let (reach, top, contour) = slump(dx, tau_0, 8.0);
    let plot = Plot::new("the deposit at rest", "x [m]", "height [m]")
        .equal_axes()
        .function("h = √(2τ_{0}(L − x)/ρg)", 0.0, length, |x| (2.0 * tau_0 * (length - x).max(0.0) / rho_g).sqrt())
        .reference("the block at the start", vec![[0.0, 0.1], [0.1, 0.1], [0.1, 0.0]])
        .ours(format!("highest points, Δx = {} mm", dx * 1e3), contour);
    Outcome::from(vec![
        Row::new(format!("Δx {} mm: length / theory", dx * 1e3), length_ratio, reach / length, 0.08),
        Row::new(format!("Δx {} mm: height / theory", dx * 1e3), height_ratio, top / height, 0.08),
    ])
    .plot(plot)
}

fn plane_slump() -> Outcome {
    slump_outcome(0.01, 0.928, 1.108)
}

fn plane_slump_fine() -> Outcome {
    slump_outcome(0.005, 1.019, 0.973)
}

/// Acceleration of an elastic block along the slope over `seconds`, its way, and the node spacing. The columns of `frame` point
/// down the slope, across it and out of it.
fn slide(shape: Shape, friction: f64, gravity: [f64; 3], frame: Mat3<f64>, seconds: f64) -> (f64, f64, f64) {
    slide_on(Collider { friction, offset: 0.0, melt_sticks: false, ..Collider::new(shape) }, gravity, frame, seconds)
}

/// The box of [`slide`].
const SLIDE: Grid = Grid { origin: [-0.5, -0.3, -0.9], spacing: 0.02, nodes: [90, 30, 75] };

/// Time after which the block of [`slide`] lies still \[s\].
const SETTLED: f64 = 0.2;

/// The same on any obstacle.
pub(crate) fn slide_on(collider: Collider, gravity: [f64; 3], frame: Mat3<f64>, seconds: f64) -> (f64, f64, f64) {
    let (grid, dx) = (SLIDE, SLIDE.spacing);
    let (shear, bulk) = moduli(1e6, 0.3);
    let mut p = block(&grid, [-0.08, -0.08, 0.0], [0.08, 0.08, 0.08], 1000.0, shear, bulk);
    for i in 0..p.len() {
        let x = p.position(i);
        p.set_position(i, mat3::mul_vec(frame, x));
    }
    let down = mat3::column(frame, 0);
    // Flat enough not to tip over. It falls half a cell until its nodes feel the slope; drag lets it settle without bouncing,
    // and the acceleration is that of the part without drag.
    let mut m = Mechanics::new(&grid, Settings { gravity, drag: 20.0, ..Settings::default() }, vec![collider]);
    let along = |p: &Particles| vec3::dot(center(p), down);
    let speed = |p: &Particles| (0..p.len()).map(|i| vec3::dot(vec3::cast(p.velocity(i)), down)).sum::<f64>() / p.len() as f64;
    let run = |m: &mut Mechanics, p: &mut Particles, time: f64| {
        let coupling = 5e-3;
        for _ in 0..(time / coupling).round() as usize {
            let step = m.time_step(p, coupling);
            m.run(p, step.steps, step.dt);
        }
    };
    run(&mut m, &mut p, SETTLED);
    m.settings.drag = 0.0;
    let (v0, x0) = (speed(&p), along(&p));
    run(&mut m, &mut p, seconds);
    ((speed(&p) - v0) / seconds, along(&p) - x0, dx)
}

/// A slab below z = 0 as a mesh, turned by `frame`, and its distances on a grid.
fn mesh_slab(frame: Mat3<f64>) -> Shape {
    let corner = |i: usize| {
        let x: [f64; 3] = std::array::from_fn(|a| if i >> a & 1 == 1 { [2.0, 1.0, 0.0][a] } else { [-2.0, -1.0, -0.5][a] });
        vec3::cast(mat3::mul_vec(frame, x))
    };
    let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let triangles = quads.iter().flat_map(|q| [[q[0], q[1], q[2]], [q[0], q[2], q[3]]]).collect();
    let mesh = megas_model::Mesh { positions: (0..8).map(corner).collect(), triangles, ..Default::default() };
    let within = (SLIDE.origin, SLIDE.position(SLIDE.nodes.map(|n| n - 1)));
    let field = megas_geometry::mesh_field(&mesh, SLIDE.spacing, Some(within)).unwrap_or_else(|e| panic!("{e}"));
    Shape::Field(std::sync::Arc::new(field.field))
}

/// The acceleration of a block on a belt that starts to run \[m/s²\].
fn belt() -> f64 {
    let key = |time, x| PoseKey { time, translation: [x, 0.0, 0.0], rotation: [1.0, 0.0, 0.0, 0.0] };
    let belt = Collider {
        friction: 0.3,
        offset: 0.0,
        melt_sticks: false,
        motion: Motion(vec![key(SETTLED, 0.0), key(SETTLED + 1.0, 2.0)]),
        ..Collider::new(Shape::HalfSpace { point: [0.0; 3], normal: [0.0, 0.0, 1.0] })
    };
    slide_on(belt, [0.0, 0.0, -GRAVITY], mat3::identity(), 0.3).0
}

fn friction() -> Outcome {
    let theta = 30f64.to_radians();
    let (sin, cos) = theta.sin_cos();
    let level = mat3::identity::<f64>();
    // Down the slope, across, out of it, for a plane tilted about y.
    let tilted = [[cos, 0.0, sin], [0.0, 1.0, 0.0], [-sin, 0.0, cos]];
    let pull = [GRAVITY * sin, 0.0, -GRAVITY * cos];
    let weight = [0.0, 0.0, -GRAVITY];
    let plane = Shape::HalfSpace { point: [0.0; 3], normal: [0.0, 0.0, 1.0] };
    let slope = Shape::HalfSpace { point: [0.0; 3], normal: [sin, 0.0, cos] };
    let table = Shape::aligned_box([-2.0, -2.0, -1.0], [4.0, 2.0, 0.0]);
    let ball = Shape::Sphere { center: [0.0, 0.0, -2000.0], radius: 2000.0 };
    let exact = GRAVITY * (sin - 0.3 * cos);
    let flat = slide(plane.clone(), 0.3, pull, level, 0.3).0;
    let mut rows = vec![
        Row::relative("plane, μ 0.3: acceleration [m/s²]", exact, flat, 0.05),
        Row::relative("tilted plane, μ 0.3: acceleration [m/s²]", exact, slide(slope, 0.3, weight, tilted, 0.3).0, 0.05),
        Row::relative("box: acceleration, against the plane", flat, slide(table, 0.3, pull, level, 0.3).0, 0.01),
        Row::relative("mesh: acceleration, against the plane", flat, slide(mesh_slab(level), 0.3, pull, level, 0.3).0, 0.01),
        Row::relative("tilted mesh: acceleration, against the plane", flat, slide(mesh_slab(tilted), 0.3, weight, tilted, 0.3).0, 0.01),
        Row::relative("running belt, μ 0.3: acceleration of what lies on it [m/s²]", 0.3 * GRAVITY, belt(), 0.05),
        Row::relative("ball of 2 km: acceleration, against the plane", flat, slide(ball, 0.3, pull, level, 0.3).0, 0.01),
    ];
    let (_, moved, dx) = slide(plane, 0.7, pull, level, 0.5);
    rows.push(Row::new("plane, μ 0.7: way in 0.5 s / Δx", 0.0, moved / dx, 0.1));
    rows.into()
}

fn determinism() -> Outcome {
    let run = |threads: usize| -> Option<u64> {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().ok()?;
        Some(pool.install(|| {
            let grid = Grid { origin: [0.0; 3], spacing: 0.01, nodes: [24, 24, 24] };
            let mut p = block(&grid, [0.07, 0.07, 0.05], [0.16, 0.16, 0.14], 1000.0, 3e4, 8e4);
            p.viscosity.fill(1.0);
            let floor = Collider::new(Shape::HalfSpace { point: [0.0, 0.0, 0.05], normal: [0.0, 0.0, 1.0] });
            let mut m = Mechanics::new(&grid, Settings::default(), vec![floor]);
            for step in 0..200 {
                // A front that melts the block from below.
                for i in 0..p.len() {
                    let molten = p.position(i)[2] < 0.05 + 0.0005 * f64::from(step);
                    p.liquid[i] = f32::from(u8::from(molten));
                    p.yield_stress[i] = if molten { 5.0 } else { f32::INFINITY };
                    p.shear[i] = if molten { 8e3 } else { 3e4 };
                }
                let t = m.time_step(&p, 1e-3);
                m.run(&mut p, t.steps, t.dt);
            }
            p.state_hash() >> 12
        }))
    };
    let one = run(1).map_or(f64::NAN, |h| h as f64);
    [2, 4]
        .into_iter()
        .map(|n| Row::new(format!("state hash with {n} threads"), one, run(n).map_or(f64::NAN, |h| h as f64), 0.0))
        .collect::<Vec<_>>()
        .into()
}

#[cfg(test)]
mod tests {
    #[test]
    fn v26_free_fall() {
        crate::assert_case("V26");
    }

    #[test]
    fn v29_axial_bar() {
        crate::assert_case("V29");
    }

    #[test]
    fn v32_shear_flow() {
        crate::assert_case("V32");
    }

    #[test]
    fn v34_plane_slump() {
        crate::assert_case("V34");
    }

    #[test]
    fn v37_friction() {
        crate::assert_case("V37");
    }
}
