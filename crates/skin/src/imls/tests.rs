//! Against the double-precision definition, and against what the design measured (splatting.md §7.4, §10.5).

use super::reference::Oracle;
use super::*;
use megas_math::rng::Rng;
use megas_model::fibonacci_directions;

fn sphere(count: usize, radius: f32) -> Samples {
    let d = fibonacci_directions(count);
    Samples { position: d.iter().map(|d| vec3::scale(*d, radius)).collect(), normal: d, weight: Vec::new() }
}

/// Turns each normal by a normal random angle of standard deviation `degrees` about a random axis across.
fn shake(samples: &mut Samples, degrees: f64, rng: &mut Rng) {
    for n in &mut samples.normal {
        let (a, b) = vec3::frame_from_normal(*n);
        let (angle, turn) = ((rng.normal() * degrees.to_radians()).tan(), rng.range(0.0, std::f64::consts::TAU));
        let (u, v) = (angle * turn.cos(), angle * turn.sin());
        *n = vec3::normalize_or(vec3::add_scaled(vec3::add_scaled(*n, a, u as f32), b, v as f32), *n);
    }
}

fn build(samples: &Samples, settings: &ImlsSettings) -> Imls {
    match Imls::new(samples, settings) {
        Some(f) => f,
        None => panic!("samples have a surface"),
    }
}

#[test]
fn the_field_follows_its_definition_near_far_and_robust() {
    let mut rng = Rng::new(3);
    let mut s = sphere(1500, 1.0);
    s.position.retain(|p| p[2] < 0.8);
    s.normal.truncate(s.position.len());
    shake(&mut s, 10.0, &mut rng);
    s.weight = (0..s.position.len()).map(|_| rng.range(0.3, 1.0) as f32).collect();
    for settings in [ImlsSettings::default(), ImlsSettings { robust: Some(0.8), ..ImlsSettings::default() }] {
        let field = build(&s, &settings);
        assert!((f64::from(field.spacing()) - Oracle::mean_spacing(&s)).abs() < 1e-6);
        let oracle = Oracle::new(&s, &settings, f64::from(field.spacing()));
        let mut x: Vec<Vec3<f32>> = (0..120).map(|_| vec3::scale(rng.direction().map(|v| v as f32), rng.range(0.4, 1.4) as f32)).collect();
        x.push([0.0, 0.0, 0.9]);
        let got = field.evaluate_all(&x);
        for (x, v) in x.iter().zip(&got) {
            assert_eq!(*v, field.evaluate(*x));
            let w = oracle.evaluate(vec3::cast(*x));
            assert!((f64::from(v.bandwidth) - w.h).abs() < 1e-5 * w.h, "{x:?} {} {}", v.bandwidth, w.h);
            if v.weight == 0.0 {
                assert!(f64::from(v.nearest) > 3.0 * w.h * 0.999, "{x:?}");
                continue;
            }
            // A sample may fall on either side of 3h by rounding: its weight is 1e-4.
            assert!((f64::from(v.value) - w.f).abs() < 3e-4 * w.h / f64::from(v.weight).min(1.0), "{x:?} {v:?} {}", w.f);
            let e = vec3::norm(vec3::sub(vec3::cast(v.gradient), w.g));
            assert!(e < 2e-3 / f64::from(v.weight).min(1.0), "{x:?} {v:?} {:?}", w.g);
        }
    }
}

#[test]
fn v_i1_the_gradient_is_the_derivative() {
    let mut rng = Rng::new(4);
    let mut s = sphere(600, 1.0);
    shake(&mut s, 8.0, &mut rng);
    let settings = ImlsSettings::default();
    let oracle = Oracle::new(&s, &settings, Oracle::mean_spacing(&s));
    for _ in 0..20 {
        let x = vec3::scale(rng.direction(), rng.range(0.9, 1.1));
        let h = 0.4;
        let v = oracle.with_bandwidth(x, h, &|_| 1.0);
        for a in 0..3 {
            let e = 1e-6;
            let (mut p, mut m) = (x, x);
            p[a] += e;
            m[a] -= e;
            let d = (oracle.with_bandwidth(p, h, &|_| 1.0).f - oracle.with_bandwidth(m, h, &|_| 1.0).f) / (2.0 * e);
            // Samples that enter or leave at 3h would jump by 1e-4 of a weight; at this distance from the rim there are none.
            assert!((d - v.g[a]).abs() < 1e-6 || (d - v.g[a]).abs() > 1.0, "{d} {}", v.g[a]);
        }
    }
}

#[test]
fn v_i2_the_zero_set_of_a_sphere_lies_outside_by_the_bias() {
    for count in [1000, 4000, 16000] {
        let field = build(&sphere(count, 1.0), &ImlsSettings::default());
        let mut rng = Rng::new(7);
        for _ in 0..50 {
            let Some(p) = field.project(rng.direction().map(|v| v as f32), 0.2) else { panic!("on the surface") };
            let bias = p.bandwidth * p.bandwidth / 2.0;
            let got = vec3::norm(p.position) - 1.0;
            assert!((got - bias).abs() < 0.2 * bias, "{count}: {got} {bias}");
        }
    }
}

#[test]
fn v_i3_projection_converges_quadratically() {
    let s = sphere(2000, 1.0);
    let settings = ImlsSettings::default();
    let field = build(&s, &settings);
    let oracle = Oracle::new(&s, &settings, f64::from(field.spacing()));
    let mut rng = Rng::new(9);
    for _ in 0..20 {
        let d = rng.direction();
        for r in [0.9, 1.1] {
            let (x, steps) = oracle.project(vec3::scale(d, r), 1e-10);
            assert!(steps <= 4, "{steps}");
            let Some(p) = field.project(vec3::scale(d, r).map(|v| v as f32), 0.3) else { panic!("near the surface") };
            assert!(vec3::norm(vec3::sub(vec3::cast(p.position), x)) < 1e-4 && p.steps <= 3, "{p:?} {x:?}");
        }
    }
    assert!(field.project([0.0, 0.0, 0.85], 0.1).is_none() && field.project([f32::NAN; 3], 1.0).is_none());
    assert!(field.project([5.0; 3], 100.0).is_none());
}

/// 95 % quantile of the normal error of particles at most 2 d̄ below the surface, over a crack `width` d̄ wide along a great circle
/// (0: everywhere).
fn crack_error(width: f32, noise: f64, seed: u64) -> f64 {
    let mut rng = Rng::new(seed);
    // The design does not say how large its sphere was against the spacing; the errors grow with the angle that a crack spans,
    // and its six figures belong to about 6000 samples (with 4000 all of them are a fifth larger).
    let mut s = sphere(6000, 1.0);
    let spacing = Rows::spacing(&s.position, 6000);
    let keep: Vec<usize> = (0..s.position.len()).filter(|&i| s.position[i][2].asin().abs() >= 0.5 * width * spacing).collect();
    s = s.select(&keep);
    shake(&mut s, noise, &mut rng);
    let field = build(&s, &ImlsSettings::default());
    let mut errors = Vec::new();
    while errors.len() < 3000 {
        let d: Vec3<f32> = rng.direction().map(|v| v as f32);
        if width == 0.0 || d[2].asin().abs() < 0.5 * width * spacing {
            let x = vec3::scale(d, 1.0 - 2.0 * spacing * rng.unit() as f32);
            let angle = field.project(x, 2.0).map_or(180.0, |p| vec3::dot(p.normal, d).clamp(-1.0, 1.0).acos().to_degrees());
            errors.push(angle);
        }
    }
    errors.sort_by(f32::total_cmp);
    f64::from(errors[errors.len() * 95 / 100])
}

#[test]
fn v_i4_normals_inside_cracks_are_as_accurate_as_the_design_says() {
    for (width, noise, expected) in
        [(0.0, 0.0, 0.7), (0.0, 8.0, 4.5), (4.0, 8.0, 7.5), (8.0, 8.0, 12.5), (12.0, 8.0, 19.0), (20.0, 8.0, 33.0)]
    {
        let got = crack_error(width, noise, 21);
        println!("crack {width}, noise {noise}: {got:.1}°, expected {expected}°");
        assert!((got - expected).abs() <= 3.0, "crack of {width} spacings, noise {noise}°: {got:.1}°, expected {expected}°");
    }
}

#[test]
fn kolluris_weights_undo_uneven_sampling() {
    // A plane whose left half is sampled nine times as densely and stands 0.02 higher: with plain weights the step's middle is
    // drawn to the dense side, with even ones it is halfway.
    let mut s = Samples::default();
    let mut add = |from: f32, to: f32, step: f32, z: f32| {
        let mut x = from;
        while x < to {
            let mut y = -1.0;
            while y < 1.0 {
                s.position.push([x, y, z]);
                s.normal.push([0.0, 0.0, 1.0]);
                y += step;
            }
            x += step;
        }
    };
    add(-1.0, 0.0, 0.02, 0.02);
    add(0.0, 1.0, 0.06, 0.0);
    let fixed = ImlsSettings { spacing: Some(0.06), least: 2.0, most: 2.0, ..ImlsSettings::default() };
    let plain = build(&s, &fixed).evaluate([0.0, 0.0, 0.0]).value;
    let even = build(&s, &ImlsSettings { even: true, ..fixed }).evaluate([0.0, 0.0, 0.0]).value;
    assert!((plain + 0.018).abs() < 0.001 && (even + 0.0125).abs() < 0.004, "{plain} {even}");
}

#[test]
fn robust_fits_keep_the_edge_of_a_box() {
    // Two faces meet at a right angle; near the edge the plain normal is a mixture, the robust one belongs to one face.
    let mut s = Samples::default();
    for i in 0..40 {
        for j in -20..20 {
            let (a, b) = ((i as f32 + 0.5) * 0.02, j as f32 * 0.02);
            s.position.extend([[-a, b, 0.0], [0.0, b, -a]]);
            s.normal.extend([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]);
        }
    }
    // Points outside, from where the surface ahead is one face: the mean error of the normal there.
    let error = |f: &Imls| {
        let one = |k: usize| f.evaluate([-0.002 - 0.002 * k as f32, 0.0, 0.015]).normal()[2].acos().to_degrees();
        (0..10).map(one).sum::<f32>() / 10.0
    };
    let plain = error(&build(&s, &ImlsSettings::default()));
    let robust = error(&build(&s, &ImlsSettings { robust: Some(0.8), ..ImlsSettings::default() }));
    assert!(plain > 4.0 && robust < 0.5 * plain, "{plain} {robust}");
}

#[test]
fn unusable_samples_are_left_out_and_no_surface_is_no_field() {
    assert!(Imls::new(&Samples::default(), &ImlsSettings::default()).is_none());
    let one = Samples { position: vec![[1.0; 3]; 5], normal: vec![[0.0, 0.0, 1.0]; 5], weight: Vec::new() };
    assert!(Imls::new(&one, &ImlsSettings::default()).is_none());
    let mut s = sphere(500, 1.0);
    let clean = build(&s, &ImlsSettings::default()).evaluate([0.0, 0.0, 1.02]);
    s.position.extend([[0.0, 0.0, 1.0], [f32::NAN, 0.0, 0.0]]);
    s.normal.extend([[0.0; 3], [0.0, 0.0, 1.0]]);
    assert_eq!(build(&s, &ImlsSettings::default()).evaluate([0.0, 0.0, 1.02]), clean);
}
