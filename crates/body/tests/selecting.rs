//! Selection expressions (splatting.md §5.11).

use megas_body::select::{hsv_distance, robust_bounds, support_plane};
use megas_body::{Selection, select};
use megas_math::{Vec3, mat3, quat, rng::Rng, sh, vec3};
use megas_model::{Splats, logit};

fn cloud(n: usize) -> Splats {
    let mut rng = Rng::new(4);
    let mut s = Splats::default();
    for _ in 0..n {
        let p = std::array::from_fn(|_| rng.range(-1.0, 1.0) as f32);
        let c = std::array::from_fn::<f32, 3, _>(|_| sh::dc_from_rgb(rng.unit() as f32));
        s.push(p, [-3.0 + rng.unit() as f32, -3.5, -5.0], [1.0, 0.0, 0.0, 0.0], logit(rng.unit() as f32), &c);
    }
    s
}

fn picked(s: &Splats, selection: &Selection) -> Vec<usize> {
    let (mask, report) = select(s, selection);
    assert_eq!(report.selected, mask.iter().filter(|&&m| m).count());
    (0..s.len()).filter(|&i| mask[i]).collect()
}

/// The selection must be what the predicate says of every Gaussian, and neither empty nor everything.
fn agrees(s: &Splats, selection: &Selection, predicate: impl Fn(usize, Vec3<f32>) -> bool) {
    let expected: Vec<usize> = (0..s.len()).filter(|&i| predicate(i, s.mean[i])).collect();
    assert!(!expected.is_empty() && expected.len() < s.len());
    assert_eq!(picked(s, selection), expected, "{selection:?}");
}

#[test]
fn every_region_is_what_it_says() {
    let s = cloud(2000);
    let turn = quat::from_axis_angle([0.0, 0.0, 1.0], std::f32::consts::FRAC_PI_4);
    let diagonal = Selection::Box { center: [0.0; 3], half: [0.5, 0.2, 2.0], rotation: turn };
    agrees(&s, &diagonal, |_, p| (p[0] + p[1]).abs() / 2f32.sqrt() <= 0.5 && (p[1] - p[0]).abs() / 2f32.sqrt() <= 0.2);
    let ball = Selection::Sphere { center: [0.2, 0.0, 0.0], radius: 0.7 };
    agrees(&s, &ball, |_, p| (p[0] - 0.2).hypot(p[1]).hypot(p[2]) <= 0.7);
    agrees(&s, &Selection::HalfSpace { point: [0.0, 0.1, 0.0], normal: [0.0, 2.0, 0.0] }, |_, p| p[1] >= 0.1);
    let tube = Selection::Cylinder { start: [0.0, 0.0, -0.5], end: [0.0, 0.0, 0.5], radius: 0.4 };
    agrees(&s, &tube, |_, p| p[0].hypot(p[1]) <= 0.4 && p[2].abs() <= 0.5);
    agrees(&s, &Selection::OpacityAbove(0.6), |i, _| s.opacity(i) > 0.6);
    agrees(&s, &Selection::ScaleBelow(0.08), |i, _| s.scale(i)[0] < 0.08);
    let red = Selection::Colour { rgb: [1.0, 0.0, 0.0], distance: 0.4 };
    agrees(&s, &red, |i, _| hsv_distance(s.base_rgb(i), [1.0, 0.0, 0.0]) <= 0.4);
}

#[test]
fn expressions_follow_the_laws_of_sets() {
    let s = cloud(800);
    let a = Selection::Sphere { center: [0.2, 0.0, 0.0], radius: 0.8 };
    let b = Selection::HalfSpace { point: [0.0; 3], normal: [1.0, 1.0, 0.0] };
    let not = |x: &Selection| Selection::Not(Box::new(x.clone()));
    let left = not(&Selection::And(vec![a.clone(), b.clone()]));
    let right = Selection::Or(vec![not(&a), not(&b)]);
    assert_eq!(picked(&s, &left), picked(&s, &right));
    assert_eq!(picked(&s, &Selection::And(vec![])).len(), s.len());
    assert!(picked(&s, &Selection::Or(vec![])).is_empty());
    let (_, report) = select(&s, &Selection::And(vec![a, b]));
    let tools: Vec<_> = report.tools.iter().map(|t| (t.tool, t.depth)).collect();
    assert_eq!(tools, [("sphere", 1), ("half-space", 1), ("and", 0)]);
}

#[test]
fn colours_are_compared_in_the_cone() {
    assert_eq!(hsv_distance([0.3, 0.5, 0.7], [0.3, 0.5, 0.7]), 0.0);
    assert!((hsv_distance([1.0, 0.0, 0.0], [0.0, 1.0, 1.0]) - 2.0).abs() < 1e-6, "opposite hues");
    // Nearly black colours are alike whatever their hue.
    assert!(hsv_distance([0.02, 0.0, 0.0], [0.0, 0.02, 0.0]) < 0.05);
    // Across the seam of the hue circle.
    assert!(hsv_distance([1.0, 0.0, 0.05], [1.0, 0.05, 0.0]) < 0.12);
}

#[test]
fn components_by_size_and_by_seed() {
    let mut rng = Rng::new(8);
    let mut s = Splats::default();
    for (center, n, size) in [(-3.0f32, 600, -4.0f32), (0.0, 400, -2.5), (3.0, 500, -4.0)] {
        for _ in 0..n {
            let d = rng.direction();
            let p = vec3::cast(vec3::add_scaled([f64::from(center), 0.0, 0.0], d, rng.range(0.0, 0.8)));
            s.push(p, [size, size, -6.0], [1.0, 0.0, 0.0, 0.0], 1.0, &[0.0; 3]);
        }
    }
    let pick = |seed, cell| picked(&s, &Selection::Component { of: Box::new(Selection::All), seed, cell });
    // The middle one has fewer but larger Gaussians.
    assert_eq!(pick(None, Some(0.4)), (600..1000).collect::<Vec<_>>());
    assert_eq!(pick(Some([2.9, 0.5, 0.0]), Some(0.4)), (1000..1500).collect::<Vec<_>>());
    assert!(pick(Some([-3.0, 0.0, 0.0]), None).len() > 500);
    let none = Selection::Component { of: Box::new(Selection::Or(vec![])), seed: None, cell: None };
    assert!(picked(&s, &none).is_empty());
}

#[test]
fn the_support_plane_is_found_in_noise_and_under_a_tilt() {
    let mut rng = Rng::new(2);
    let tilt = quat::to_mat3(quat::from_axis_angle([1.0, 0.0, 0.0], 0.2f64));
    let mut s = Splats::default();
    let push = |s: &mut Splats, p: Vec3<f64>| {
        s.push(vec3::cast(mat3::mul_vec(tilt, p)), [-4.0; 3], [1.0, 0.0, 0.0, 0.0], 2.0, &[0.0; 3]);
    };
    for _ in 0..3000 {
        push(&mut s, [rng.range(-2.0, 2.0), rng.range(-2.0, 2.0), rng.normal() * 0.004]);
    }
    for _ in 0..2000 {
        let d = rng.direction();
        push(&mut s, vec3::add_scaled([0.0, 0.0, 0.6], d, 0.58));
    }
    for _ in 0..300 {
        push(&mut s, std::array::from_fn(|_| rng.range(-2.0, 2.0)));
    }
    let plane = support_plane(&s, &vec![true; s.len()], [0.0, 0.0, 1.0], 5).expect("a plane");
    let normal = mat3::column(tilt, 2);
    assert!(vec3::dot(plane.normal, normal) > 0.9999, "{plane:?}");
    assert!(vec3::dot(plane.point, normal).abs() < 0.005);
    let above = picked(&s, &Selection::AboveSupport { of: Box::new(Selection::All), up: [0.0, 0.0, 1.0], seed: 5 });
    let ball = above.iter().filter(|&&i| (3000..5000).contains(&i)).count();
    let table = above.iter().filter(|&&i| i < 3000).count();
    assert!(ball > 1900 && table == 0, "{ball} {table}");
    // Nothing flat, no plane: everything stays.
    let few = cloud(20);
    assert!(support_plane(&few, &[true; 20], [0.0, 0.0, 1.0], 5).is_none());
}

#[test]
fn robust_bounds_shrug_off_outliers() {
    let mut s = cloud(2000);
    s.push([1e6, 0.0, 0.0], [-3.0; 3], [1.0, 0.0, 0.0, 0.0], 5.0, &[0.0; 3]);
    s.push([f32::NAN, 0.0, 0.0], [-3.0; 3], [1.0, 0.0, 0.0, 0.0], 5.0, &[0.0; 3]);
    let b = robust_bounds(&s, &vec![true; s.len()], mat3::identity()).expect("a box");
    for k in 0..3 {
        assert!((-1.0..-0.97).contains(&b.min[k]) && (0.97..1.0).contains(&b.max[k]), "{b:?}");
    }
    assert!(robust_bounds(&s, &vec![false; s.len()], mat3::identity()).is_none());
}
