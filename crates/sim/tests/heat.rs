//! The heat solver through its public interface: threads, mixtures, bodies, tracers, walls, refusals.

#[path = "common/cloud.rs"]
mod cloud;

use cloud::Cloud;
use megas_math::rng::Rng;
use megas_sim::grid::Grid;
use megas_sim::material::{Law, Material, PhaseMode, Rheology};
use megas_sim::source::{Film, HeatSource, Motion, Region, Schedule, Shape, SourceKind};
use megas_sim::thermal::{AirModel, Audit, ThermalError, ThermalOptions, ThermalSolver, Wall};

fn wax() -> Material {
    Material {
        name: "wax".into(),
        law: Law::Hencky,
        density: 900.0,
        shear_modulus: 4e4,
        bulk_modulus: 8e4,
        solid_yield_stress: f64::INFINITY,
        melt_shear_modulus: 1e4,
        melt: Rheology { yield_stress: 10.0, consistency: 1.0, index: 0.8 },
        arrhenius_k: 0.0,
        softening: 0.0,
        reference_temperature: 293.15,
        heat_capacity_solid: 2100.0,
        heat_capacity_liquid: 2300.0,
        conductivity_solid: 0.24,
        conductivity_liquid: 0.15,
        latent_heat: 2e5,
        solidus: 325.0,
        liquidus: 330.0,
        phase_mode: PhaseMode::Mushy,
        ..Material::default()
    }
}

fn metal() -> Material {
    Material {
        density: 2700.0,
        heat_capacity_solid: 900.0,
        conductivity_solid: 20.0,
        conductivity_liquid: 20.0,
        solidus: f64::INFINITY,
        liquidus: f64::INFINITY,
        ..wax()
    }
}

const DX: f64 = 0.005;

fn grid() -> Grid {
    Grid { origin: [0.0; 3], spacing: DX, nodes: [24; 3] }
}

/// A cube of 12 cells, 8 jittered points per cell; lower half body 0, upper half body 1, of the second material if there is one.
fn two_bodies(solver: &ThermalSolver, materials: &[Material], t: [f64; 2]) -> Cloud {
    let mut rng = Rng::new(11);
    let mut cloud = Cloud::default();
    for i in 0..24 * 24 * 24 {
        let site = [i / 576, i / 24 % 24, i % 24];
        let xi = site.map(|s| 6.0 + 0.5 * (f64::from(s) + 0.5 + rng.range(-0.3, 0.3)));
        let body = usize::from(site[2] >= 12);
        let volume = DX.powi(3) / 8.0;
        let m = (body % materials.len()) as u8;
        cloud.push(xi, (materials[m as usize].density * volume) as f32, volume as f32, m, body as u16, solver.enthalpy(m, t[body]));
    }
    cloud
}

fn source(region: Region, kind: SourceKind) -> HeatSource {
    HeatSource { name: "test".into(), region, kind, schedule: Schedule::default(), motion: Motion::default() }
}

#[test]
fn result_does_not_depend_on_threads() {
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a thread pool");
        pool.install(|| {
            let film = Film { ambient: 280.0, coefficient: 20.0, emissivity: 0.9 };
            let options = ThermalOptions { air: AirModel::Film(film), ..ThermalOptions::default() };
            let materials = [wax(), metal()];
            let mut solver = ThermalSolver::new(grid(), &materials, 293.15, options);
            let mut cloud = two_bodies(&solver, &materials, [300.0, 360.0]);
            let sources = [
                source(Region::Surface(Some(0)), SourceKind::Flux { watts_per_m2: 2e4 }),
                source(Shape::Sphere { center: [0.05; 3], radius: 0.02 }.into(), SourceKind::Temperature { kelvin: 400.0 }),
            ];
            let mut audits = Vec::new();
            for _ in 0..20 {
                audits.push(cloud.step(&mut solver, 0.05, &sources, None).expect("a stable step"));
            }
            assert!(audits.iter().all(|a| a.closes(1e-11) && a.dirichlet > 0.0 && a.film < 0.0 && a.source > 0.0));
            (cloud.h, cloud.grad_t, audits)
        })
    };
    let one = run(1);
    assert_eq!(one, run(2));
    assert_eq!(one, run(3));
}

#[test]
fn bodies_of_different_materials_reach_one_temperature() {
    // Real conductivities would take long; the mixture does not mind others.
    let mut materials = [wax(), metal()];
    for m in &mut materials {
        (m.conductivity_solid, m.conductivity_liquid) = (200.0, 200.0);
    }
    let mut solver = ThermalSolver::new(grid(), &materials, 293.15, ThermalOptions::default());
    let mut cloud = two_bodies(&solver, &materials, [300.0, 420.0]);
    let mut total = Audit::default();
    for step in 0..300 {
        let audit = cloud.step(&mut solver, 1.0, &[], None).expect("a stable step");
        total = if step == 0 { audit } else { Audit { before: total.before, ..audit } };
    }
    assert!((total.after - total.before).abs() < 1e-10 * total.before.abs());
    let t: Vec<f64> = cloud.h.iter().zip(&cloud.material).map(|(h, m)| solver.temperature(*m, *h)).collect();
    let (lo, hi) = t.iter().fold((f64::MAX, f64::MIN), |(lo, hi), t| (lo.min(*t), hi.max(*t)));
    // Wax and metal end inside the wax's melting interval, at one temperature.
    assert!(lo > 325.0 && hi < 330.0 && hi - lo < 0.02, "{lo} … {hi}");
}

#[test]
fn sources_reach_their_body_alone() {
    let materials = [wax()];
    let mut solver = ThermalSolver::new(grid(), &materials, 293.15, ThermalOptions::default());
    let mut cloud = two_bodies(&solver, &materials, [300.0, 300.0]);
    let before = cloud.h.clone();
    let power = SourceKind::Power { watts: 30.0 };
    let sources = [source(Region::Object(1), power.clone()), source(Region::Object(7), power)];
    let audit = cloud.step(&mut solver, 0.5, &sources, None).expect("a stable step");
    assert!((audit.source - 15.0).abs() < 1e-9 && audit.closes(1e-12));
    assert_eq!(solver.reports()[1].nodes, 0);
    for ((h, b), xi) in cloud.h.iter().zip(&before).zip(&cloud.xi) {
        if xi[2] < 9.0 {
            assert!((h - b).abs() < 1e-6 * b, "the lower body must stay cold");
        }
        if xi[2] > 14.0 {
            assert!(h > b);
        }
    }
}

#[test]
fn no_point_gets_hotter_than_what_holds_it() {
    let materials = [metal()];
    let mut solver = ThermalSolver::new(grid(), &materials, 293.15, ThermalOptions::default());
    let mut cloud = two_bodies(&solver, &materials, [300.0; 2]);
    // The top, unevenly; conduction hardly matters in these short steps.
    let top = Shape::Sphere { center: [0.06, 0.06, 0.12], radius: 0.05 };
    let sources = [source(top.into(), SourceKind::Temperature { kelvin: 400.0 })];
    for _ in 0..100 {
        let audit = cloud.step(&mut solver, 1e-4, &sources, None).expect("a stable step");
        assert!(audit.closes(1e-11) && audit.dirichlet > 0.0);
    }
    let hottest = cloud.h.iter().map(|h| solver.temperature(0, *h)).fold(0.0, f64::max);
    assert!(hottest > 399.0 && hottest < 401.0, "{hottest}");
}

#[test]
fn tracers_listen_and_keep_what_they_cannot_hear() {
    let materials = [wax()];
    let mut solver = ThermalSolver::new(grid(), &materials, 293.15, ThermalOptions::default());
    let mut cloud = two_bodies(&solver, &materials, [310.0, 310.0]);
    let n = cloud.h.len();
    cloud.push([12.0, 12.0, 12.0], 0.0, 0.0, 0, 0, -1.0);
    cloud.push([2.0, 2.0, 2.0], 0.0, 0.0, 0, 0, -1.0);
    cloud.push([f64::NAN; 3], 0.0, 0.0, 0, 0, -1.0);
    let audit = cloud.step(&mut solver, 0.1, &[], None).expect("a stable step");
    assert!((solver.temperature(0, cloud.h[n]) - 310.0).abs() < 1e-9);
    assert_eq!(cloud.h[n + 1..], [-1.0, -1.0]);
    assert!((audit.after - audit.before).abs() < 1e-12 * audit.before.abs());
    assert_eq!(solver.sample([2.0; 3]), None);
}

#[test]
fn a_hot_plate_heats_and_hides_the_face_on_it() {
    let materials = [wax()];
    let film = Film { ambient: 300.0, coefficient: 10.0, emissivity: 0.0 };
    let options = ThermalOptions { air: AirModel::Film(film), ..ThermalOptions::default() };
    let mut solver = ThermalSolver::new(grid(), &materials, 293.15, options);
    let mut free = two_bodies(&solver, &materials, [300.0, 300.0]);
    let mut held = free.clone();
    let open = free.step(&mut solver, 0.1, &[], None).expect("a stable step").surface;
    let plate = |k: usize, wall: Wall| if k < 6 { wall } else { Wall::Open };
    let walls = |w: Wall| (0..grid().len()).map(|i| plate(grid().node(i)[2], w)).collect::<Vec<_>>();
    let audit = held.step(&mut solver, 0.1, &[], Some(&walls(Wall::Adiabatic))).expect("a stable step");
    let face = (12.0 * DX).powi(2);
    // The rounded edges around the face stay exposed.
    assert!((open - audit.surface - face).abs() < 0.25 * face, "{} of {face}", open - audit.surface);
    assert_eq!(audit.wall, 0.0);
    let mut wall = 0.0;
    for _ in 0..100 {
        let hot = held.step(&mut solver, 5.0, &[], Some(&walls(Wall::Fixed(350.0)))).expect("a stable step");
        assert!(hot.wall > 0.0 && hot.closes(1e-11));
        wall += hot.wall;
    }
    // A half space under a step of 50 K takes 2 ΔT √(kρct/π) per area; here half a cell of gap and melting (little) intervene.
    let half_space = 2.0 * 50.0 * (0.24 * 900.0 * 2100.0 * 500.0 / std::f64::consts::PI).sqrt() * face;
    assert!(wall > 0.6 * half_space && wall < 1.1 * half_space, "{wall} of {half_space}");
    let hottest = |low: f64, high: f64| {
        let inside = held.h.iter().zip(&held.xi).filter(|(_, x)| x[2] > low && x[2] < high);
        inside.map(|(h, _)| solver.temperature(0, *h)).fold(f64::MIN, f64::max)
    };
    assert!(hottest(6.0, 6.5) > 310.0 && hottest(6.0, 6.5) < 351.0 && hottest(15.0, 19.0) < 300.1);
}

#[test]
fn refusals_leave_the_points_alone() {
    let materials = [metal()];
    let mut solver = ThermalSolver::new(grid(), &materials, 293.15, ThermalOptions::default());
    let mut cloud = two_bodies(&solver, &materials, [300.0, 400.0]);
    let before = cloud.h.clone();
    assert!(matches!(cloud.step(&mut solver, 1e4, &[], None), Err(ThermalError::TooFast { .. })));
    assert!(matches!(cloud.step(&mut solver, 0.1, &[], Some(&[Wall::Open])), Err(ThermalError::Input(_))));
    cloud.material[0] = 9;
    assert!(matches!(cloud.step(&mut solver, 0.1, &[], None), Err(ThermalError::Input(_))));
    cloud.material[0] = 0;
    assert_eq!(cloud.h, before);
    cloud.xi[5] = [f64::INFINITY; 3];
    let audit = cloud.step(&mut solver, 0.1, &[], None).expect("a stable step");
    assert_eq!((audit.skipped, cloud.h[5]), (1, before[5]));
    assert!(audit.closes(1e-11) && cloud.h.iter().all(|h| h.is_finite()));
}

#[test]
fn nothing_at_all_is_a_legal_scene() {
    let options = ThermalOptions { air: AirModel::Film(Film::default()), ..ThermalOptions::default() };
    let mut solver = ThermalSolver::new(grid(), &[], 293.15, options);
    let audit = Cloud::default().step(&mut solver, 0.1, &[], None).expect("an empty step");
    assert_eq!((audit.after, audit.subcycles), (0.0, 1));
}
