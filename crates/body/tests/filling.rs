//! The filling on analytic shells: G2, G3, G4 and G6 of splatting.md §10.4.

mod common;

use common::{BLOBS, CUP, DOME, PLATE, SPHERE, Shape, TORUS, orient_truly, shell};
use megas_body::fill::bvh::{Bvh, trace_all};
use megas_body::fill::columns::cast_axis;
use megas_body::fill::{BottomCap, Cap, DensityField, Directions, FillSettings, Filling, Grid, Shell, TauAlpha, classify, density_filling};
use megas_math::{Mat3, Vec3, mat3, rng::Rng, vec3};
use megas_model::Splats;

const IDENTITY: Mat3<f64> = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

fn normals(s: &Splats) -> Vec<Vec3<f32>> {
    (0..s.len()).map(|i| s.normal(i)).collect()
}

fn prepared(shape: &Shape, size: f64) -> Splats {
    let mut s = shell(shape, 4000, size, 11);
    assert!(s.splats.len() > 3900, "{}: only {} discs", shape.name, s.splats.len());
    orient_truly(&mut s);
    s.splats
}

fn grid(shape: &Shape, n: usize) -> Grid {
    let longest = shape.half.into_iter().fold(0.0, f64::max);
    let spacing = 2.0 * longest / (n - 4) as f64;
    Grid::covering(shape.half.map(|h| -h), shape.half, 2.0 * spacing, spacing, 1)
}

/// Intersection over union with the truth, and recall outside a band of one cell around the surface.
fn score(shape: &Shape, filling: &Filling) -> (f64, f64) {
    let g = &filling.grid;
    let (mut both, mut either, mut deep, mut found) = (0usize, 0usize, 0usize, 0usize);
    for i in 0..g.len() {
        let d = (shape.distance)(g.center(g.cell(i)));
        let (truth, got) = (d < 0.0, filling.inside[i]);
        both += usize::from(truth && got);
        either += usize::from(truth || got);
        deep += usize::from(d < -g.spacing);
        found += usize::from(d < -g.spacing && got);
    }
    (both as f64 / either as f64, found as f64 / deep.max(1) as f64)
}

fn filled(shape: &Shape, splats: &Splats, settings: &FillSettings) -> (f64, f64) {
    let shell = Shell::<f32>::new(splats, &normals(splats), IDENTITY, [0.0; 3]);
    score(shape, &classify(&shell, grid(shape, 56), settings, |_| false))
}

#[test]
fn the_marginal_of_a_gaussian_is_its_response_to_an_axis_ray() {
    // G3: D² and t* of the canonical ray form (§6.3) against the two-dimensional marginal (§6.4), in double precision.
    let mut rng = Rng::new(3);
    for _ in 0..1000 {
        let q: [f64; 4] = std::array::from_fn(|_| rng.normal());
        let r = megas_math::quat::to_mat3(q);
        let s: Vec3<f64> = std::array::from_fn(|_| rng.range(0.1, 2.0));
        let mean: Vec3<f64> = std::array::from_fn(|_| rng.normal());
        let x: Vec3<f64> = std::array::from_fn(|_| rng.normal());
        for k in 0..3 {
            let mut d = [0.0; 3];
            d[k] = 1.0;
            let canonical = |v: Vec3<f64>| {
                let l = mat3::tmul_vec(r, v);
                std::array::from_fn(|a| l[a] / s[a])
            };
            let (o, e): (Vec3<f64>, Vec3<f64>) = (canonical(vec3::sub(x, mean)), canonical(d));
            let t = -vec3::dot(o, e) / vec3::dot(e, e);
            let c = vec3::cross(o, e);
            let d2 = vec3::dot(c, c) / vec3::dot(e, e);

            let cov = mat3::congruence(r, mat3::diag(s.map(|v| v * v)));
            let (a, b) = ((k + 1) % 3, (k + 2) % 3);
            let y = [x[a] - mean[a], x[b] - mean[b]];
            let det = cov[a][a] * cov[b][b] - cov[a][b] * cov[a][b];
            let solved = [(cov[b][b] * y[0] - cov[a][b] * y[1]) / det, (cov[a][a] * y[1] - cov[a][b] * y[0]) / det];
            let marginal = y[0] * solved[0] + y[1] * solved[1];
            let place = mean[k] + cov[k][a] * solved[0] + cov[k][b] * solved[1];
            assert!((marginal - d2).abs() <= 1e-12 * (1.0 + d2), "{marginal} {d2}");
            assert!((place - (x[k] + t)).abs() <= 1e-12 * (1.0 + place.abs()) * 10.0, "{place} {}", x[k] + t);
        }
    }
}

#[test]
fn columns_hierarchy_and_brute_force_agree() {
    // G2, in double precision, with and without a cap.
    let splats = prepared(&CUP, 1.1);
    let shell = Shell::<f64>::new(&splats, &normals(&splats), IDENTITY, [0.0; 3]);
    let g = grid(&CUP, 40);
    let [nx, ny, _] = g.dims;
    let cap = Cap {
        height: -0.2,
        origin: [g.origin[0], g.origin[1]],
        spacing: g.spacing,
        dims: [nx, ny],
        columns: (0..nx * ny).map(|i| i % 3 == 0).collect(),
    };
    for cap in [None, Some(&cap)] {
        let columns: Vec<_> = (0..3).map(|axis| cast_axis(&shell, &g, axis, cap, |_, p| Some(p))).collect();
        let tree = Bvh::new(&shell);
        let mut rng = Rng::new(5);
        let (mut hits, mut met) = (Vec::new(), 0);
        for _ in 0..1000 {
            let (i, axis, up) = (rng.below(g.len()), rng.below(3), rng.unit() < 0.5);
            let p = columns[axis][i].expect("every point is visited");
            let mut d = [0.0; 3];
            d[axis] = if up { 1.0 } else { -1.0 };
            let x = g.center(g.cell(i));
            let (fast, slow) = (tree.trace(x, d, cap, &mut hits), trace_all(&shell, x, d, cap));
            let (alpha, facing) = if up { (p.alpha_up, p.facing_up) } else { (p.alpha_down, p.facing_down) };
            assert!((alpha - slow.alpha).abs() < 1e-6 && (facing - vec3::dot(slow.normal, d)).abs() < 1e-6, "{p:?} {slow:?}");
            assert!((fast.alpha - slow.alpha).abs() < 1e-6);
            assert!(vec3::norm(vec3::sub(fast.normal, slow.normal)) < 1e-6);
            met += usize::from(slow.alpha > 0.01);
        }
        assert!(met > 300, "too few rays met anything: {met}");
        // Any direction.
        for _ in 0..300 {
            let x = std::array::from_fn(|_| rng.range(-0.6, 0.6));
            let d = rng.direction();
            let (fast, slow) = (tree.trace(x, d, cap, &mut hits), trace_all(&shell, x, d, cap));
            assert!((fast.alpha - slow.alpha).abs() < 1e-6 && vec3::norm(vec3::sub(fast.normal, slow.normal)) < 1e-6);
        }
    }
}

#[test]
fn shells_fill_as_the_design_measured() {
    // G4: the column for τ = 0.5 within 0.03 or better and recall ≥ 0.99.
    let table: [(&Shape, f64, f64); 7] = [
        (&SPHERE, 0.8, 0.993),
        (&SPHERE, 1.1, 0.990),
        (&TORUS, 0.8, 0.973),
        (&CUP, 0.8, 0.929),
        (&BLOBS, 1.1, 0.990),
        (&DOME, 1.1, 0.993),
        (&PLATE, 0.8, 0.938),
    ];
    for (shape, size, expected) in table {
        let splats = prepared(shape, size);
        let (iou, recall) = filled(shape, &splats, &FillSettings::default());
        println!("{} {size}: IoU {iou:.3} (design {expected}), recall {recall:.4}", shape.name);
        assert!(iou >= expected - 0.03, "{} {size}: IoU {iou}", shape.name);
        assert!(recall >= 0.99, "{} {size}: recall {recall}", shape.name);
    }
}

#[test]
fn full_opacity_collapses_on_translucent_shells() {
    // The ordering of the other columns of the table.
    let splats = prepared(&SPHERE, 0.8);
    let at = |tau: f32| filled(&SPHERE, &splats, &FillSettings { tau_alpha: TauAlpha::Fixed(tau), ..FillSettings::default() }).0;
    let (half, high, full) = (at(0.5), at(0.8), at(0.95));
    println!("sphere 0.8: {half:.3} {high:.3} {full:.3}");
    assert!(half > high && high > full && full < 0.1);
    let auto = filled(&SPHERE, &splats, &FillSettings { tau_alpha: TauAlpha::Auto, ..FillSettings::default() });
    assert!(auto.0 > 0.96, "{auto:?}");
}

#[test]
fn the_density_field_leaves_shells_hollow() {
    // The last column of the table: 0 / 0.03 on the sphere at 0.8; the paper's ablation.
    let splats = prepared(&SPHERE, 0.8);
    let shell = Shell::<f32>::new(&splats, &normals(&splats), IDENTITY, [0.0; 3]);
    for field in [DensityField::default(), DensityField { dense: 0.3, wall: 0.15 }] {
        let (iou, recall) = score(&SPHERE, &density_filling(&shell, grid(&SPHERE, 56), 1.0, &field));
        println!("density field {field:?}: IoU {iou:.3}, recall {recall:.3}");
        assert!(recall < 0.5, "{field:?}: {recall}");
    }
    // A body that is full of Gaussians is what it was made for.
    let mut rng = Rng::new(2);
    let mut full = Shell::<f32>::default();
    while full.len() < 60_000 {
        let x: Vec3<f64> = std::array::from_fn(|_| rng.range(-0.5, 0.5));
        if (SPHERE.distance)(x) < -0.02 {
            full.push(vec3::cast(x), mat3::diag([0.02f32.powi(2); 3]), [0.0; 3], 0.9);
        }
    }
    let (iou, recall) = score(&SPHERE, &density_filling(&full, grid(&SPHERE, 56), 1.0, &DensityField::default()));
    println!("full sphere: IoU {iou:.3}, recall {recall:.3}");
    assert!(iou > 0.9 && recall > 0.99);
}

#[test]
fn open_domes_fill_and_a_cap_helps() {
    // G6. The dome stands on its opening; points within a cell of it count as surface.
    let splats = prepared(&DOME, 1.1);
    let with = |cap| filled(&DOME, &splats, &FillSettings { cap, ..FillSettings::default() });
    let (off, at, auto) = (with(BottomCap::Off), with(BottomCap::At(0.0)), with(BottomCap::Auto));
    println!("dome: {off:?} cap {at:?} auto {auto:?}");
    assert!(off.1 >= 0.97 && at.1 >= 0.99 && auto.1 >= 0.99);
    assert!(at.0 >= off.0 - 1e-3);
}

#[test]
fn fourteen_directions_agree_with_six_on_a_closed_body() {
    let splats = prepared(&BLOBS, 1.1);
    let (iou, recall) = filled(&BLOBS, &splats, &FillSettings { directions: Directions::AxesAndDiagonals, ..FillSettings::default() });
    assert!(iou > 0.96 && recall > 0.99, "{iou} {recall}");
}

#[test]
fn results_do_not_depend_on_the_number_of_threads() {
    let splats = prepared(&TORUS, 0.8);
    let shell = Shell::<f32>::new(&splats, &normals(&splats), IDENTITY, [0.0; 3]);
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
        pool.install(|| classify(&shell, grid(&TORUS, 48), &FillSettings::default(), |_| false))
    };
    let (a, b) = (run(1), run(5));
    assert!(a.inside == b.inside && a.votes == b.votes);
}
