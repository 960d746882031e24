//! The fast substep against the oracle, and the rules around it.

use megas_math::rng::Rng;
use megas_math::{mat3, vec3};

use super::*;
use crate::collider::{Shape, Sheet};
use crate::particles::{DRUCKER_PRAGER, FIXED_COROTATED, FLUID, HENCKY, NEO_HOOKEAN, NEO_HOOKEAN_SPLIT, VON_MISES};
use crate::reference::{self, Law, Point};

const GRID: Grid = Grid { origin: [-0.3, 0.1, 0.0], spacing: 0.02, nodes: [22, 30, 19] };

/// A cloud over most of the box with mixed laws, random motion and strained points.
fn cloud(count: usize, seed: u64) -> Particles {
    let mut rng = Rng::new(seed);
    let mut p = Particles::blank(&GRID, count);
    for i in 0..count {
        p.id[i] = i as u32;
        p.set_position(i, std::array::from_fn(|a| GRID.origin[a] + GRID.spacing * rng.range(4.0, GRID.nodes[a] as f64 - 5.0)));
        p.mass[i] = rng.range(0.5, 2.0) as f32 * 1e-3;
        p.volume[i] = p.mass[i] / 1000.0;
        p.law[i] = [HENCKY, HENCKY, FIXED_COROTATED, FLUID, NEO_HOOKEAN, NEO_HOOKEAN_SPLIT, VON_MISES, DRUCKER_PRAGER][rng.below(8)];
        p.shear[i] = rng.range(1e3, 1e4) as f32;
        p.bulk[i] = rng.range(1e4, 3e4) as f32;
        p.yield_stress[i] = if i % 3 == 0 { f32::INFINITY } else { rng.range(0.0, 300.0) as f32 };
        p.viscosity[i] = rng.range(0.1, 10.0) as f32;
        p.exponent[i] = [1.0, 0.5, 1.5][rng.below(3)];
        match p.law[i] {
            FLUID => (p.exponent[i], p.law_constant[i]) = ([7.0, -1.0][rng.below(2)], 1.05),
            VON_MISES => p.law_constant[i] = 2e3,
            DRUCKER_PRAGER => p.law_constant[i] = 0.3,
            _ => {}
        }
        p.set_velocity(i, [0, 1, 2].map(|_| rng.range(-1.0, 1.0) as f32));
        p.set_affine(i, [0; 3].map(|_| [0; 3].map(|_| rng.range(-3.0, 3.0) as f32)));
        let mut h = [0; 3].map(|_| [0; 3].map(|_| rng.range(-0.1, 0.1) as f32));
        if p.law[i] == FLUID {
            h = [[h[0][0], 0.0, 0.0], [0.0; 3], [0.0; 3]];
        }
        p.set_displacement_gradient(i, h);
    }
    p
}

fn law_of(p: &Particles, i: usize) -> Law<f64> {
    Law {
        law: p.law[i],
        shear: p.shear[i].into(),
        bulk: p.bulk[i].into(),
        yield_stress: p.yield_stress[i].into(),
        viscosity: p.viscosity[i].into(),
        exponent: p.exponent[i].into(),
        constant: p.law_constant[i].into(),
    }
}

/// The stored gradient; of a fluid J in its first entry.
fn gradient(p: &Particles, i: usize) -> megas_math::Mat3<f64> {
    mat3::add(mat3::cast(p.displacement_gradient(i)), mat3::identity())
}

fn points_of(p: &Particles) -> Vec<Point<f64>> {
    (0..p.len())
        .map(|i| Point {
            xi: p.grid_coordinate(i),
            velocity: vec3::cast(p.velocity(i)),
            affine: mat3::cast(p.affine(i)),
            elastic: gradient(p, i),
            mass: p.mass[i].into(),
            volume: p.volume[i].into(),
        })
        .collect()
}

fn free() -> Settings {
    Settings { isolation: 0.0, ..Settings::default() }
}

#[test]
fn three_substeps_follow_the_oracle() {
    let mut p = cloud(4001, 1);
    p.sort();
    let mut points = points_of(&p);
    let laws: Vec<_> = (0..p.len()).map(|i| law_of(&p, i)).collect();
    let dt = 1e-4;
    let mut states = vec![reference::State::default(); points.len()];
    let mut total: Vec<_> = points.iter().map(|_| mat3::identity::<f64>()).collect();
    for _ in 0..3 {
        let tau: Vec<_> = points
            .iter()
            .zip(&laws)
            .map(|(q, l)| mat3::add(reference::stress(l, q.elastic), reference::viscous_stress(l, q.elastic[0][0], q.affine)))
            .collect();
        let mut nodes = reference::p2g(&GRID, &points, dt, |i| tau[i]);
        reference::update(&mut nodes, dt, [0.0, 0.0, -9.81]);
        for (i, q) in points.iter_mut().enumerate() {
            (q.velocity, q.affine) = reference::g2p(&GRID, &nodes, q.xi);
            q.xi = vec3::add_scaled(q.xi, q.velocity, dt / GRID.spacing);
            let step = mat3::add(mat3::identity(), mat3::scale(q.affine, dt));
            total[i] = mat3::mul(step, total[i]);
            if laws[i].law == FLUID {
                q.elastic[0][0] = (q.elastic[0][0] * (1.0 + dt * mat3::trace(q.affine))).min(laws[i].constant);
            } else {
                q.elastic = reference::return_map_with(&laws[i], mat3::mul(step, q.elastic), dt, &mut states[i]);
            }
        }
    }
    let id = p.id.clone();
    let mut mechanics = Mechanics::new(&GRID, free(), Vec::new());
    let report = mechanics.run(&mut p, 3, dt);
    assert_eq!(report.repairs, Repairs::NONE);
    assert_eq!(p.id, id, "no point crossed a cell in the wrong direction or the test is not comparing like with like");
    for (i, q) in points.iter().enumerate() {
        let x = p.grid_coordinate(i);
        assert!(vec3::norm(vec3::sub(x, q.xi)) < 1e-6);
        let v: Vec3 = vec3::cast(p.velocity(i));
        assert!(vec3::norm(vec3::sub(v, q.velocity)) < 1e-5, "{i}: {v:?} {:?}", q.velocity);
        let c = mat3::sub(mat3::cast(p.affine(i)), q.affine);
        assert!(mat3::norm(c) < 2e-3, "{i}: C off by {:e} of {:e}", mat3::norm(c), mat3::norm(q.affine));
        let f = mat3::sub(gradient(&p, i), q.elastic);
        assert!(mat3::norm(f) < 3e-6, "{i}: F off by {:e}", mat3::norm(f));
        let t = mat3::sub(mat3::cast(p.total(i)), total[i]);
        assert!(mat3::norm(t) < 3e-6, "{i}: total off by {:e}", mat3::norm(t));
        assert!((f64::from(p.plastic_strain[i]) - states[i].plastic).abs() < 3e-6, "{i}: plastic strain");
        assert!((f64::from(p.volume_gain[i]) - states[i].gain).abs() < 3e-6, "{i}: volume gain");
    }
}

type Vec3 = [f64; 3];

#[test]
fn splitting_a_batch_changes_only_rounding_of_the_stress() {
    let mut a = cloud(3000, 2);
    let mut b = a.clone();
    let mut m = Mechanics::new(&GRID, free(), Vec::new());
    m.run(&mut a, 8, 1e-4);
    for _ in 0..2 {
        m.run(&mut b, 4, 1e-4);
    }
    a.sort();
    b.sort();
    for i in 0..a.len() {
        assert!(vec3::norm(vec3::sub(a.velocity(i), b.velocity(i))) < 1e-4, "{i}");
    }
}

#[test]
fn same_bits_for_any_number_of_threads_and_after_a_restart() {
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let mut p = cloud(3000, 3);
            let floor = Collider::new(Shape::HalfSpace { point: [0.0, 0.0, 0.12], normal: [0.1, 0.0, 1.0] });
            let moving = Collider {
                motion: crate::schedule::Motion(vec![
                    crate::schedule::PoseKey { time: 0.0, translation: [0.0; 3], rotation: [1.0, 0.0, 0.0, 0.0] },
                    crate::schedule::PoseKey { time: 1.0, translation: [3.0, 0.0, 0.0], rotation: [1.0, 0.3, 0.0, 0.0] },
                ]),
                ..sheet()
            };
            let mut m = Mechanics::new(&GRID, Settings::default(), vec![floor, sheet(), moving]);
            for _ in 0..5 {
                m.run(&mut p, 7, 1e-4);
            }
            (p, m)
        })
    };
    let (one, mut m) = run(1);
    for threads in [2, 4] {
        assert_eq!(one.state_hash(), run(threads).0.state_hash());
    }
    // A checkpoint of the arrays into a fresh solver continues with the same bits.
    let mut restored = Particles::blank(&GRID, one.len());
    for ((name, to), (same, from)) in restored.arrays_mut().into_iter().zip(one.arrays()) {
        assert_eq!(name, same);
        to.copy_from_slice(from);
    }
    let mut continued = one.clone();
    let time = m.time;
    m.run(&mut continued, 9, 1e-4);
    let mut fresh = Mechanics::new(&GRID, m.settings, m.colliders().to_vec());
    fresh.time = time;
    fresh.run(&mut restored, 9, 1e-4);
    assert_eq!(continued.state_hash(), restored.state_hash());
}

#[test]
fn fast_points_are_resorted_before_they_leave_their_tile() {
    let mut p = cloud(500, 4);
    p.bulk.fill(0.0);
    p.shear.fill(0.0);
    for i in 0..p.len() {
        p.set_velocity(i, [1.0, 0.0, 0.0]);
        p.set_affine(i, [[0.0; 3]; 3]);
        let x = p.position(i);
        p.set_position(i, [GRID.origin[0] + 0.08 + 0.02 * (x[0] - GRID.origin[0]), x[1], x[2]]);
    }
    let mut expected: Vec<_> = (0..p.len()).map(|i| (p.id[i], p.position(i)[0] + 0.2)).collect();
    let mut m = Mechanics::new(&GRID, Settings { gravity: [0.0; 3], ..free() }, Vec::new());
    // Ten cells in 50 substeps.
    let report = m.run(&mut p, 50, 0.004);
    assert_eq!(report.repairs, Repairs::NONE);
    let mut got: Vec<_> = (0..p.len()).map(|i| (p.id[i], p.position(i)[0])).collect();
    expected.sort_by_key(|v| v.0);
    got.sort_by_key(|v| v.0);
    for (e, g) in expected.iter().zip(&got) {
        assert!((e.1 - g.1).abs() < 1e-5, "{e:?} {g:?}");
    }
}

#[test]
fn repairs_are_made_and_counted() {
    let mut p = cloud(800, 5);
    p.law.fill(HENCKY);
    let broken = [10, 20, 30];
    p.set_elastic(broken[0], mat3::diag([1.0, 1.0, 1e-3]));
    p.set_elastic(broken[1], mat3::diag([1.0, -0.5, 1.0]));
    p.set_elastic(broken[2], mat3::diag([30.0, 1.0, 1.0]));
    p.set_velocity(40, [f32::NAN, 0.0, 0.0]);
    let bad: Vec<u32> = broken.iter().map(|&i| p.id[i]).collect();
    let mut m = Mechanics::new(&GRID, free(), Vec::new());
    let mut without = p.clone();
    without.set_velocity(40, [0.0; 3]);
    let r = m.run(&mut p, 1, 1e-5);
    assert!(r.repairs.non_finite >= 1);
    let r = m.run(&mut without, 1, 1e-5);
    assert_eq!(r.repairs.degenerate, 3);
    for id in bad {
        let i = (0..without.len()).find(|&i| without.id[i] == id).unwrap();
        let f: megas_math::Mat3<f64> = mat3::cast(without.elastic(i));
        assert!((mat3::det(f) - 1.0).abs() < 1e-5, "{f:?}");
        assert_ne!(without.flags[i] & megas_model::FLAG_REPAIRED, 0);
        assert_ne!(without.rebase[i], [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]);
    }
    // Far too fast: capped to half a cell per substep and held in the box.
    for i in 0..without.len() {
        without.set_velocity(i, [1e4, 0.0, 0.0]);
        without.set_affine(i, [[0.0; 3]; 3]);
    }
    let r = m.run(&mut without, 20, 1e-4);
    assert!(r.repairs.capped > 0);
    for i in 0..without.len() {
        let xi = without.grid_coordinate(i);
        assert!((0..3).all(|a| xi[a] >= 1.4 && xi[a] <= GRID.nodes[a] as f64 - 2.4), "{xi:?}");
    }
}

#[test]
fn lone_points_fly_and_tracers_follow_without_pulling() {
    let mut p = cloud(2, 6);
    p.set_position(0, [-0.1, 0.4, 0.2]);
    p.set_position(1, [-0.2, 0.3, 0.2]);
    p.law.fill(HENCKY);
    p.volume.fill(1e-6);
    p.mass.fill(1e-3);
    for i in 0..2 {
        p.set_affine(i, [[0.0; 3]; 3]);
        p.set_velocity(i, [0.0; 3]);
    }
    let mut m = Mechanics::new(&GRID, Settings::default(), Vec::new());
    let r = m.run(&mut p, 10, 1e-3);
    assert_eq!(r.repairs.isolated, 20);
    assert!((p.velocity(0)[2] + 0.0981).abs() < 1e-5, "{:?}", p.velocity(0));
    // The same pair with a tracer beside the first point.
    let mut q = cloud(2, 6);
    q.set_position(0, [-0.1, 0.4, 0.2]);
    q.set_position(1, [-0.1, 0.401, 0.2]);
    q.mass[1] = 0.0;
    q.volume[1] = 0.0;
    for i in 0..2 {
        q.set_affine(i, [[0.0; 3]; 3]);
        q.set_velocity(i, [0.0; 3]);
    }
    let mut m = Mechanics::new(&GRID, free(), Vec::new());
    q.set_displacement_gradient(0, [[0.0; 3]; 3]);
    m.run(&mut q, 10, 1e-3);
    for i in 0..2 {
        assert!((q.velocity(i)[2] + 0.0981).abs() < 1e-5, "{:?}", q.velocity(i));
    }
}

#[test]
fn normals_turn_with_the_total_gradient() {
    let mut p = cloud(3000, 7);
    p.bulk.fill(0.0);
    p.shear.fill(0.0);
    // Rigid rotation about the centre of the cloud, round z.
    let center = [GRID.origin[0] + 0.21, GRID.origin[1] + 0.29, 0.0];
    for i in 0..p.len() {
        let r = vec3::sub(p.position(i), center);
        p.set_velocity(i, [-r[1] as f32, r[0] as f32, 0.0]);
        p.set_affine(i, [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0; 3]]);
        p.normal[i] = if i % 2 == 0 { [1.0, 0.0, 0.0] } else { [0.0; 3] };
    }
    let mut m = Mechanics::new(&GRID, Settings { gravity: [0.0; 3], ..free() }, Vec::new());
    m.run(&mut p, 10, 1e-3);
    for i in 0..p.len() {
        if p.id[i].is_multiple_of(2) {
            let n = p.normal[i];
            assert!((n[1].atan2(n[0]) - 0.01).abs() < 1e-4 && (vec3::norm(n) - 1.0).abs() < 1e-6, "{n:?}");
        } else {
            assert_eq!(p.normal[i], [0.0; 3]);
        }
    }
}

#[test]
fn melt_sticks_where_a_solid_slides() {
    let slide = |liquid: f32| {
        let mut p = cloud(6000, 8);
        for i in 0..p.len() {
            p.set_velocity(i, [0.3, 0.0, -0.2]);
            p.set_affine(i, [[0.0; 3]; 3]);
            p.set_displacement_gradient(i, [[0.0; 3]; 3]);
        }
        p.law.fill(HENCKY);
        p.yield_stress.fill(f32::INFINITY);
        p.liquid.fill(liquid);
        let shape = Shape::HalfSpace { point: [0.0, 0.0, 0.1], normal: [0.0, 0.0, 1.0] };
        let floor = Collider { friction: 0.0, offset: 0.0, ..Collider::new(shape) };
        let mut m = Mechanics::new(&GRID, Settings { gravity: [0.0; 3], ..free() }, vec![floor]);
        m.run(&mut p, 1, 1e-4);
        let mut fastest: f32 = 0.0;
        m.for_each_node(|node, _, v| {
            if node[2] <= 4 {
                fastest = fastest.max(v[0].abs());
            }
        });
        fastest
    };
    assert!(slide(0.0) > 0.29);
    assert_eq!(slide(1.0), 0.0);
}

#[test]
fn substeps_follow_wave_and_speed() {
    let mut p = cloud(100, 9);
    p.law.fill(HENCKY);
    p.shear.fill(6e3);
    p.bulk.fill(8e3);
    for i in 0..p.len() {
        p.set_displacement_gradient(i, [[0.0; 3]; 3]);
        p.set_velocity(i, [0.0, 0.5, 0.0]);
    }
    let m = Mechanics::new(&GRID, Settings::default(), Vec::new());
    let t = m.time_step(&p, 0.05);
    // c = 4 m/s: dt ≤ 0.4 · 0.02 / 4.5.
    assert!((t.wave_speed - 4.0).abs() < 1e-5 && (t.max_speed - 0.5).abs() < 1e-6);
    assert_eq!(t.steps, (0.05f64 / (0.4 * 0.02 / 4.5)).ceil() as usize);
    assert!((t.dt * t.steps as f64 - 0.05).abs() < 1e-12);
    p.set_elastic(3, mat3::diag([1.0, 1.0, 0.5]));
    let s = m.time_step(&p, 0.05).stiffening;
    assert!((2.0..=3.0).contains(&s), "{s}");
}

/// A tilted rectangle through the middle of [`GRID`], beyond all points of a cloud.
fn sheet() -> Collider {
    let (sin, cos) = 0.4f64.sin_cos();
    let axes = [[cos, 0.0, sin], [0.0, 1.0, 0.0], [-sin, 0.0, cos]];
    let sheet = Sheet::across_box([-0.09, 0.39, 0.185], [1.0, 1.0, 0.01], axes).unwrap();
    Collider { friction: 0.3, offset: 0.0, melt_sticks: false, ..Collider::new(Shape::Sheet(std::sync::Arc::new(sheet))) }
}

#[test]
fn transfers_at_a_sheet_follow_the_oracle_and_keep_their_books() {
    let mut p = cloud(4001, 11);
    p.law.fill(HENCKY);
    p.yield_stress.fill(f32::INFINITY);
    let blade = sheet();
    let Shape::Sheet(plane) = &blade.shape else { unreachable!() };
    let (sin, cos) = 0.4f64.sin_cos();
    let normal = [sin, 0.0, cos];
    let distance = |x: Vec3| vec3::dot(vec3::sub(x, [-0.09, 0.39, 0.185]), normal);
    let up = plane.near([0.0, 0.39, 0.35], 1.0).unwrap().distance.signum();
    // What gets through within these steps is put back, which the oracle does not do.
    for i in 0..p.len() {
        let x = p.position(i);
        if distance(x).abs() < 0.05 * GRID.spacing {
            p.set_position(i, vec3::add_scaled(x, normal, 0.1 * GRID.spacing * distance(x).signum()));
        }
    }
    p.sort();
    let mut points = points_of(&p);
    let laws: Vec<_> = (0..p.len()).map(|i| law_of(&p, i)).collect();
    let above: Vec<bool> = (0..p.len()).map(|i| distance(p.position(i)) >= 0.0).collect();
    let node_above: Vec<bool> = (0..GRID.len()).map(|n| distance(GRID.position(GRID.node(n))) >= 0.0).collect();
    // Set 0 holds the nodes of their own side, 1 those that points above find below, 2 those that points below find above.
    let set = |point: bool, node: usize| if point == node_above[node] { 0 } else { 2 - usize::from(point) };
    let dt = 1e-4;
    let mut pressed = [0.0; 3];
    for _ in 0..3 {
        let tau: Vec<_> = points.iter().zip(&laws).map(|(q, l)| reference::stress(l, q.elastic)).collect();
        let mut nodes: [_; 3] = reference::p2g_parted(&GRID, &points, dt, |i| tau[i], |i, n| set(above[i], n));
        let sum = |sets: &[reference::Nodes<f64>], moving: bool| {
            let mut total = ([0.0; 3], 0.0);
            for s in sets {
                for (m, v) in s.mass.iter().zip(&s.motion) {
                    total = (vec3::add_scaled(total.0, *v, if moving { *m } else { 1.0 }), total.1 + m);
                }
            }
            total
        };
        let mass: f64 = points.iter().map(|q| q.mass).sum();
        let momentum = points.iter().fold([0.0; 3], |s, q| vec3::add_scaled(s, q.velocity, q.mass));
        let before = sum(&nodes, false);
        assert!((before.1 / mass - 1.0).abs() < 1e-12 && vec3::norm(vec3::sub(before.0, momentum)) < 1e-12 * mass);
        for (k, n) in nodes.iter_mut().enumerate() {
            reference::update(n, dt, [0.0, 0.0, -9.81]);
            let out = if k == 1 { 1.0 } else { -1.0 };
            for (m, v) in n.mass.iter().zip(&mut n.motion).filter(|_| k > 0) {
                let vn = out * vec3::dot(*v, normal);
                if vn < 0.0 {
                    let tangential = vec3::add_scaled(*v, normal, -out * vn);
                    let keep = (1.0 + 0.3 * vn / vec3::norm(tangential)).max(0.0);
                    let held = vec3::scale(tangential, keep);
                    pressed = vec3::add_scaled(pressed, vec3::sub(held, *v), *m);
                    *v = held;
                }
            }
        }
        for (i, q) in points.iter_mut().enumerate() {
            (q.velocity, q.affine) = reference::g2p_parted(&GRID, &nodes, q.xi, |n| set(above[i], n));
            q.xi = vec3::add_scaled(q.xi, q.velocity, dt / GRID.spacing);
            q.elastic = mat3::mul(mat3::add(mat3::identity(), mat3::scale(q.affine, dt)), q.elastic);
        }
    }
    let momentum = |p: &Particles| (0..p.len()).fold([0.0; 3], |s, i| vec3::add_scaled(s, vec3::cast(p.velocity(i)), p.mass[i].into()));
    let mass: f64 = p.mass.iter().map(|m| f64::from(*m)).sum();
    let start = momentum(&p);
    let mut mechanics = Mechanics::new(&GRID, free(), vec![blade]);
    let report = mechanics.run(&mut p, 3, dt);
    assert_eq!(report.repairs, Repairs::NONE);
    let mut near = 0;
    for (i, q) in points.iter().enumerate() {
        let side = p.side(i, 0) as f64 * up;
        assert!(side == 0.0 || (side > 0.0) == above[i]);
        near += usize::from(side != 0.0);
        assert!(vec3::norm(vec3::sub(p.grid_coordinate(i), q.xi)) < 1e-6);
        let v: Vec3 = vec3::cast(p.velocity(i));
        assert!(vec3::norm(vec3::sub(v, q.velocity)) < 1e-5, "{i}: {v:?} {:?}", q.velocity);
        let c = mat3::sub(mat3::cast(p.affine(i)), q.affine);
        assert!(mat3::norm(c) < 2e-3, "{i}: C off by {:e} of {:e}", mat3::norm(c), mat3::norm(q.affine));
        assert!(mat3::norm(mat3::sub(gradient(&p, i), q.elastic)) < 3e-6, "{i}");
    }
    assert!(near > 1000, "{near}");
    // What the points got is what gravity and the sheet gave.
    let gained = vec3::sub(vec3::sub(momentum(&p), start), [0.0, 0.0, -9.81 * 3.0 * dt * mass]);
    assert!(vec3::norm(vec3::sub(gained, pressed)) < 1e-5 * vec3::norm(pressed), "{gained:?} {pressed:?} {mass}");
}
