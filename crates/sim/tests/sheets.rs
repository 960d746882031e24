//! Thin sheets: neither matter nor momentum passes, weight and friction are those of a thick obstacle, rims are open.

use std::sync::Arc;

use megas_math::{mat3, quat, vec3};
use megas_model::{FLAG_INTERNAL, Mesh, Points};
use megas_sim::collider::{Collider, Mode, Shape, Sheet};
use megas_sim::grid::Grid;
use megas_sim::material::{Material, Rheology};
use megas_sim::mechanics::{Bounds, Mechanics, Settings, Wall};
use megas_sim::particles::Particles;
use megas_sim::phase::PhaseOptions;
use megas_sim::schedule::{Motion, PoseKey};
use megas_sim::solver::{Coupling, Solver, SolverConfig};
use megas_sim::thermal::ThermalOptions;

const DX: f64 = 0.01;
const NO_TURN: [f64; 4] = [1.0, 0.0, 0.0, 0.0];

/// The rectangle through `center` across axis 2 of `axes`, with half sides `half`.
fn sheet(center: [f64; 3], half: [f64; 2], axes: [[f64; 3]; 3]) -> Shape {
    Shape::Sheet(Arc::new(Sheet::across_box(center, [half[0], half[1], 1e-4], axes).expect("a rectangle")))
}

/// A sheet across x at `x`, larger than any grid here.
fn wall(x: f64) -> Shape {
    sheet([x, 0.1, 0.1], [1.0, 1.0], [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
}

fn slip(shape: Shape) -> Collider {
    Collider { mode: Mode::Slip, offset: 0.0, ..Collider::new(shape) }
}

/// Elastic points, eight per cell, in boxes from `low` to `high` \[m\]; the object tells the box.
fn boxes(grid: &Grid, ranges: &[([f64; 3], [f64; 3])], shear: f32, bulk: f32) -> Particles {
    let h = 0.5 * grid.spacing;
    let mut places: Vec<([f64; 3], u16)> = Vec::new();
    for (k, (low, high)) in ranges.iter().enumerate() {
        let n: [usize; 3] = std::array::from_fn(|a| ((high[a] - low[a]) / h).round() as usize);
        for i in 0..n[0] * n[1] * n[2] {
            let site = [i / n[2] / n[1], i / n[2] % n[1], i % n[2]];
            places.push((std::array::from_fn(|a| low[a] + h * (site[a] as f64 + 0.5)), k as u16 + 1));
        }
    }
    let mut p = Particles::blank(grid, places.len());
    for (i, (x, object)) in places.into_iter().enumerate() {
        p.id[i] = i as u32;
        p.object[i] = object;
        p.set_position(i, x);
        p.volume[i] = h.powi(3) as f32;
        p.mass[i] = p.volume[i] * 1000.0;
        (p.shear[i], p.bulk[i]) = (shear, bulk);
    }
    p
}

fn run(m: &mut Mechanics, p: &mut Particles, seconds: f64) {
    let coupling = 5e-3;
    for _ in 0..(seconds / coupling).round() as usize {
        let step = m.time_step(p, coupling);
        m.run(p, step.steps, step.dt);
    }
}

fn momentum(p: &Particles, object: u16) -> [f64; 3] {
    let own = (0..p.len()).filter(|&i| p.object[i] == object);
    own.fold([0.0; 3], |s, i| vec3::add_scaled(s, vec3::cast(p.velocity(i)), f64::from(p.mass[i])))
}

fn free() -> Settings {
    Settings { gravity: [0.0; 3], ..Settings::default() }
}

#[test]
fn what_is_pushed_on_one_side_is_not_felt_on_the_other() {
    let grid = Grid { origin: [0.0; 3], spacing: DX, nodes: [40, 24, 24] };
    for mode in [Mode::Separate, Mode::Slip, Mode::Sticky] {
        // A quarter of a cell from the first points to the sheet on either side.
        let ranges = [([0.1, 0.08, 0.08], [0.2, 0.16, 0.16]), ([0.2, 0.08, 0.08], [0.3, 0.16, 0.16])];
        let mut p = boxes(&grid, &ranges, 1e4, 3e4);
        for i in 0..p.len() {
            if p.object[i] == 1 {
                p.set_velocity(i, [0.3, 0.1, 0.0]);
            }
        }
        let mass: f64 = p.mass.iter().map(|m| f64::from(*m)).sum();
        let pushed = momentum(&p, 1)[0];
        let blade = Collider { mode, friction: 0.3, ..slip(wall(0.2)) };
        let mut m = Mechanics::new(&grid, free(), vec![blade]);
        run(&mut m, &mut p, 0.05);
        assert!((p.mass.iter().map(|m| f64::from(*m)).sum::<f64>() / mass - 1.0).abs() < 1e-12);
        for i in 0..p.len() {
            let x = p.position(i)[0];
            assert!((x - 0.2).abs() > 4.0 * DX || p.side(i, 0) != 0, "{x}");
            match p.object[i] {
                1 => assert!(x < 0.2 + 1e-6, "{mode:?} {x}"),
                _ => assert!(x > 0.2 && p.velocity(i) == [0.0; 3], "{mode:?}: {:?}", p.velocity(i)),
            }
        }
        // It bounced off or was held; the sheet took the difference.
        assert!(momentum(&p, 1)[0] < 0.2 * pushed, "{mode:?}");
    }
}

/// A melt between a slip wall and a vertical sheet at `face` (or a thick wall there): pressure over ρgz, of all that is more than
/// two cells below the surface and above the floor, and how far the farthest point is beyond the sheet \[cells\].
fn column(face: f64, thick: bool) -> (f64, f64) {
    // Faces of the box lie at nodes 2.
    let grid = Grid { origin: [-2.0 * DX; 3], spacing: DX, nodes: [20, 8, 24] };
    let (width, height, bulk) = (6.0 * DX, 14.0 * DX, 1e5);
    let mut p = boxes(&grid, &[([0.0; 3], [width, 3.0 * DX, height])], 0.0, bulk as f32);
    p.yield_stress.fill(0.0);
    p.viscosity.fill(4.0);
    p.liquid.fill(1.0);
    let shape = if thick { Shape::HalfSpace { point: [face, 0.0, 0.0], normal: [-1.0, 0.0, 0.0] } } else { wall(face) };
    let held = Collider { offset: 0.5, ..slip(shape) };
    let mut m = Mechanics::new(&grid, Settings { walls: [[Wall::Slip; 2]; 3], drag: 20.0, ..Settings::default() }, vec![held]);
    run(&mut m, &mut p, 0.6);
    let mut z: Vec<f64> = (0..p.len()).map(|i| p.position(i)[2]).collect();
    z.sort_by(f64::total_cmp);
    let top = z[z.len() - 36] + 0.25 * DX;
    let (mut pressure, mut weight, mut farthest) = (0.0, 0.0, f64::NEG_INFINITY);
    for i in 0..p.len() {
        let [x, _, z] = p.position(i);
        farthest = f64::max(farthest, (x - face) / DX);
        if z > 2.0 * DX && top - z > 2.0 * DX {
            pressure += bulk * (1.0 - f64::from(p.volume_ratio(i)));
            weight += 1000.0 * 9.81 * (top - z);
        }
    }
    println!("pressure {:.4} of the weight, farthest {farthest:.3} cells, top {:.3}", pressure / weight, top / DX);
    (pressure / weight, farthest)
}

#[test]
fn a_column_of_melt_stays_behind_a_sheet_under_its_hydrostatic_pressure() {
    let (pressure, farthest) = column(6.3 * DX, false);
    assert!((pressure - 1.0).abs() < 0.03 && farthest <= 1e-6, "{pressure} {farthest}");
    // Nodes half a cell behind the sheet hold it: the melt spreads first, as before a thick wall, but not beyond the sheet.
    let ((thin, farthest), (thick, beyond)) = (column(6.55 * DX, false), column(6.55 * DX, true));
    assert!((thin - thick).abs() < 0.02 && farthest <= 1e-6 && beyond > 0.05, "{thin} {thick} {farthest} {beyond}");
}

/// Acceleration of a block along a slope of 30°, a sheet or thick, and its way in cells, over `seconds`; the slope is tilted, or
/// gravity is. `level` is that of contact \[cells\].
fn slide(friction: f64, seconds: f64, tilt: bool, thick: bool, level: f64) -> (f64, f64) {
    let dx = 0.02;
    let grid = Grid { origin: [-0.5, -0.3, -0.9], spacing: dx, nodes: [90, 30, 75] };
    let (sin, cos) = 30f64.to_radians().sin_cos();
    let tilted = if tilt { [[cos, 0.0, sin], [0.0, 1.0, 0.0], [-sin, 0.0, cos]] } else { mat3::identity() };
    let gravity = if tilt { [0.0, 0.0, -9.81] } else { [9.81 * sin, 0.0, -9.81 * cos] };
    let mut p = boxes(&grid, &[([-0.08, -0.08, 0.0], [0.08, 0.08, 0.08])], 3.85e5, 8.33e5);
    for i in 0..p.len() {
        let x = p.position(i);
        p.set_position(i, mat3::mul_vec(tilted, x));
    }
    let [down, _, out] = [0, 1, 2].map(|a| mat3::column(tilted, a));
    let shape = if thick { Shape::HalfSpace { point: [0.0; 3], normal: out } } else { sheet([0.0; 3], [2.0, 1.0], tilted) };
    let slope = Collider { friction, offset: level, melt_sticks: false, ..Collider::new(shape) };
    let mut m = Mechanics::new(&grid, Settings { gravity, drag: 20.0, ..Settings::default() }, vec![slope]);
    run(&mut m, &mut p, 0.2);
    m.settings.drag = 0.0;
    let mean = |p: &Particles, f: &dyn Fn(usize) -> f64| (0..p.len()).map(f).sum::<f64>() / p.len() as f64;
    let speed = |p: &Particles| mean(p, &|i| vec3::dot(vec3::cast(p.velocity(i)), down));
    let along = |p: &Particles| mean(p, &|i| vec3::dot(p.position(i), down));
    let (v, x) = (speed(&p), along(&p));
    run(&mut m, &mut p, seconds);
    let lowest = (0..p.len()).map(|i| vec3::dot(p.position(i), out)).fold(1.0, f64::min);
    let found = ((speed(&p) - v) / seconds, (along(&p) - x) / dx);
    println!("friction {friction}, tilt {tilt}, thick {thick}: {found:?}, lowest point {:.3} cells over it", lowest / dx);
    assert!(thick || lowest >= -1e-6);
    found
}

#[test]
fn a_block_slides_and_rests_as_on_a_thick_slope() {
    let exact = 9.81 * (0.5 - 0.3 * 0.75f64.sqrt());
    for (tilt, level) in [(false, 0.0), (false, 0.5), (true, 0.5)] {
        let (thin, thick) = (slide(0.3, 0.3, tilt, false, level).0, slide(0.3, 0.3, tilt, true, level).0);
        assert!((thin / exact - 1.0).abs() < 0.05 && (thin / thick - 1.0).abs() < 0.01, "{thin} {thick} for {exact}");
    }
    let rest = slide(0.7, 0.5, false, false, 0.0).1;
    assert!(rest.abs() < 0.1, "{rest}");
}

#[test]
fn beyond_the_rim_matter_moves_freely() {
    let grid = Grid { origin: [0.0; 3], spacing: DX, nodes: [50, 24, 40] };
    // The sheet reaches up to z = 0.1; the block flies three cells above it.
    let blade = slip(sheet([0.25, 0.12, 0.0], [0.5, 0.1], [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]));
    let mut p = boxes(&grid, &[([0.1, 0.08, 0.13], [0.18, 0.16, 0.21])], 1e4, 3e4);
    let mut q = p.clone();
    for i in 0..p.len() {
        p.set_velocity(i, [1.0, 0.0, 0.0]);
        q.set_velocity(i, [1.0, 0.0, 0.0]);
    }
    run(&mut Mechanics::new(&grid, free(), vec![blade]), &mut p, 0.15);
    run(&mut Mechanics::new(&grid, free(), Vec::new()), &mut q, 0.15);
    for i in 0..p.len() {
        assert_eq!(p.position(i), q.position(i));
        assert_eq!(p.side(i, 0), 0);
    }
    assert!(p.position(0)[0] > 0.24);
}

fn key(time: f64, translation: [f64; 3], rotation: [f64; 4]) -> PoseKey {
    PoseKey { time, translation, rotation }
}

#[test]
fn a_piston_pushes_without_a_leak() {
    let grid = Grid { origin: [0.0; 3], spacing: DX, nodes: [50, 24, 24] };
    let mut p = boxes(&grid, &[([0.12, 0.08, 0.08], [0.2, 0.16, 0.16])], 2e4, 5e4);
    let piston = Collider { motion: Motion(vec![key(0.0, [0.0; 3], NO_TURN), key(0.5, [0.2, 0.0, 0.0], NO_TURN)]), ..slip(wall(0.11)) };
    let mut m = Mechanics::new(&grid, Settings { drag: 10.0, ..free() }, vec![Collider { mode: Mode::Separate, ..piston }]);
    run(&mut m, &mut p, 0.5);
    let lowest = (0..p.len()).map(|i| p.position(i)[0]).fold(1.0, f64::min);
    println!("lowest {:.3} cells before the piston", (lowest - 0.31) / DX);
    assert!((-1e-6..1.5).contains(&((lowest - 0.31) / DX)), "{lowest}");
}

#[test]
fn a_blade_cuts_a_soft_block() {
    let grid = Grid { origin: [0.0; 3], spacing: DX, nodes: [40, 24, 36] };
    let low = [0.12, 0.08, 0.05];
    let mut p = boxes(&grid, &[(low, [0.24, 0.16, 0.13])], 0.0, 5e4);
    for i in 0..p.len() {
        (p.shear[i], p.yield_stress[i], p.viscosity[i]) = (1e4, 300.0, 10.0);
    }
    let floor = Collider { offset: 0.0, ..Collider::new(Shape::HalfSpace { point: [0.0, 0.0, 0.05], normal: [0.0, 0.0, 1.0] }) };
    // Down through the block in half a second, then aside.
    let axes = [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
    let blade = Collider {
        motion: Motion(vec![key(0.0, [0.0; 3], NO_TURN), key(0.5, [0.0, 0.0, -0.14], NO_TURN), key(1.0, [0.05, 0.0, -0.14], NO_TURN)]),
        friction: 0.1,
        ..Collider::new(sheet([0.18, 0.12, 0.245], [0.2, 0.08], axes))
    };
    let mut m = Mechanics::new(&grid, Settings::default(), vec![floor, blade]);
    run(&mut m, &mut p, 0.5);
    let mut side = vec![false; p.len()];
    for i in 0..p.len() {
        side[p.id[i] as usize] = p.position(i)[0] < 0.18;
    }
    let left = side.iter().filter(|l| **l).count();
    assert!((0.49..0.51).contains(&(left as f64 / p.len() as f64)), "{left} of {}", p.len());
    run(&mut m, &mut p, 0.5);
    let (mut last, mut first) = (f64::NEG_INFINITY, f64::INFINITY);
    for i in 0..p.len() {
        let x = p.position(i)[0];
        if side[p.id[i] as usize] { last = last.max(x) } else { first = first.min(x) }
    }
    println!(
        "last point {:.3} cells before the place of the cut, first {:.3} cells behind the blade",
        (last - 0.18) / DX,
        (first - 0.23) / DX
    );
    assert!(last < 0.185 && first > 0.23 - 1e-6, "{last} {first}");
}

fn jelly() -> Material {
    let (shear_modulus, bulk_modulus) = Material::moduli(5e4, 0.3);
    Material {
        shear_modulus,
        bulk_modulus,
        melt_shear_modulus: shear_modulus,
        melt: Rheology { yield_stress: 0.0, consistency: 1.0, index: 1.0 },
        ..Material::default()
    }
}

/// A block that falls onto an edge-on blade and a curved bowl that turns.
fn scene() -> (SolverConfig, Points) {
    let grid = Grid { origin: [0.0; 3], spacing: DX, nodes: [36; 3] };
    let mut points = Points::default();
    let h = 0.5 * DX;
    for i in 0..16usize.pow(3) {
        let site = [i / 256, i / 16 % 16, i % 16];
        points
            .position
            .push([0.14, 0.14, 0.16].iter().zip(site).map(|(l, s)| l + h * (s as f64 + 0.5)).collect::<Vec<_>>().try_into().unwrap());
        points.volume.push(h.powi(3) as f32);
        points.temperature.push(300.0);
        points.normal.push([0.0; 3]);
        points.material.push(0);
        points.object.push(1);
        points.flags.push(FLAG_INTERNAL);
        points.id.push(i as u32);
    }
    let mut bowl = Mesh::default();
    let n = 12;
    for i in 0..=n {
        for j in 0..=n {
            let (u, v) = (2.0 * i as f32 / n as f32 - 1.0, 2.0 * j as f32 / n as f32 - 1.0);
            bowl.positions.push([0.18 + 0.12 * u, 0.18 + 0.12 * v, 0.1 + 0.05 * (u * u + v * v)]);
        }
    }
    for i in 0..n as u32 {
        for j in 0..n as u32 {
            let a = i * (n as u32 + 1) + j;
            let b = a + n as u32 + 1;
            bowl.triangles.extend([[a, b, b + 1], [a, b + 1, a + 1]]);
        }
    }
    let bowl = Collider {
        motion: Motion(vec![key(0.0, [0.0; 3], NO_TURN), key(0.5, [0.0; 3], quat::from_axis_angle([1.0, 0.0, 0.0], 0.5))]),
        ..Collider::new(Shape::Sheet(Arc::new(Sheet::new(&bowl).expect("a bowl"))))
    };
    let blade = sheet([0.2, 0.18, 0.1], [0.2, 0.055], [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]);
    let config = SolverConfig {
        grid,
        materials: vec![jelly()],
        sources: Vec::new(),
        colliders: vec![Collider::new(blade), Collider { active: vec![[0.0, 0.3]], ..bowl }],
        gravity: [0.0, 0.0, -9.81],
        ambient: 290.0,
        thermal: ThermalOptions::default(),
        phase: PhaseOptions::default(),
        frame_dt: 0.02,
        coupling_step: 4e-3,
        courant: 0.4,
        mechanics: true,
        bounds: Bounds::Clamp,
        coupling: Coupling::default(),
    };
    (config, points)
}

#[test]
fn runs_restart_bitwise_and_threads_change_no_bit() {
    let (config, points) = scene();
    let frames = |solver: &mut Solver, n: usize| {
        for _ in 0..n {
            solver.advance_frame(&|| false).expect("a step").expect("not stopped");
            let _ = solver.export();
        }
    };
    let run = |threads: usize, n: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a thread pool");
        pool.install(|| {
            let mut solver = Solver::new(config.clone(), &points).expect("a solver");
            frames(&mut solver, n);
            solver
        })
    };
    let mut half = run(1, 5);
    assert!((0..half.particles().len()).any(|i| half.particles().side(i, 1) != 0));
    let arrays: Vec<Vec<u8>> = half.particles().arrays().into_iter().map(|(_, bytes)| bytes.to_vec()).collect();
    let mut again = Solver::new(config.clone(), &points).expect("a solver");
    again.restore(half.checkpoint(), &arrays).expect("a checkpoint that fits");
    frames(&mut half, 5);
    frames(&mut again, 5);
    assert_eq!(half.particles().state_hash(), again.particles().state_hash());
    assert_eq!(half.particles().state_hash(), run(2, 10).particles().state_hash());
}
