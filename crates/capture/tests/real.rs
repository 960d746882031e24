//! Real and synthetic captures of the data folder; a test says so and passes where they are absent.

use std::{path::PathBuf, time::Instant};

use megas_capture::{Capture, Options, Photo, Seeds, extent, load, seeds};
use megas_model::Projection;

fn loaded(name: &str, options: &Options) -> Option<(PathBuf, Capture)> {
    let folder = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data").join(name);
    if !folder.is_dir() {
        println!("skipped: {} is absent", folder.display());
        return None;
    }
    let start = Instant::now();
    let capture = load(&folder, options).unwrap();
    println!("{name}: {} in {:.3} s, notes {:?}", capture.kind, start.elapsed().as_secs_f64(), capture.notes);
    Some((folder, capture))
}

fn seeded(capture: &Capture, count: usize) -> Seeds {
    let start = Instant::now();
    let s = seeds(capture, count, 1);
    let mean = s.sigma.iter().sum::<f32>() / s.sigma.len() as f32;
    println!("{} seeds in {:.3} s, mean sigma {mean:.4}", s.position.len(), start.elapsed().as_secs_f64());
    assert!(s.sigma.iter().all(|v| *v > 0.0) && s.position.iter().flatten().chain(s.colour.iter().flatten()).all(|v| v.is_finite()));
    s
}

/// Share of the points that a view has inside its image.
fn share_inside(photo: &Photo, points: &[[f32; 3]]) -> f64 {
    let c = &photo.camera;
    let inside = |x: &&[f32; 3]| {
        let p = c.to_camera(**x);
        let [u, v] = c.project(p);
        p[2] > 0.0 && u >= 0.0 && v >= 0.0 && u <= c.width as f32 && v <= c.height as f32
    };
    points.iter().filter(inside).count() as f64 / points.len() as f64
}

#[test]
fn fox_loads_with_its_lens_taken_out() {
    let Some((_, c)) = loaded("fox", &Options::default()) else { return };
    assert_eq!((c.train.len(), c.test.len(), c.points.is_none()), (43, 7, true));
    assert!(c.notes.is_empty(), "{:?}", c.notes);
    let p = &c.train[0];
    assert_eq!((p.camera.width, p.camera.height, p.channels), (450, 800, 3));
    let masked = p.mask.as_ref().unwrap().iter().filter(|v| **v == 0).count() as f64 / 360_000.0;
    assert!(masked > 0.001 && masked < 0.05, "{masked}");
    let s = seeded(&c, 20_000);
    assert_eq!(s.position.len(), 20_000);
    // Nearly everything is seen by some view, most of it by many.
    let seen: f64 = c.train.iter().map(|p| share_inside(p, &s.position)).sum::<f64>() / c.train.len() as f64;
    assert!(seen > 0.3, "{seen}");
    let grey = s.colour.iter().filter(|c| c.iter().all(|v| (0.44..0.56).contains(v))).count();
    assert!(grey < 5_000, "{grey}");

    let cropped = loaded("fox", &Options { crop_undistorted: true, ..Options::default() }).unwrap().1;
    let q = &cropped.train[0];
    assert!(q.mask.is_none() && q.camera.width > 430 && q.camera.width < 450, "{:?}", q.camera);
}

fn colmap(name: &str, views: usize, size: [u32; 2], points: usize) {
    let Some((folder, c)) = loaded(name, &Options::default()) else { return };
    assert_eq!((c.train.len() + c.test.len(), c.test.len()), (views, views.div_ceil(8)));
    assert!(c.kind == "colmap (binary)" && c.notes.is_empty(), "{:?}", c.notes);
    let cloud = c.points.as_ref().unwrap();
    assert_eq!((cloud.position.len(), cloud.colour.len()), (points, points));
    for p in c.train.iter().chain(&c.test) {
        assert!([p.camera.width, p.camera.height] == size && p.mask.is_none(), "{}", p.name);
        let share = share_inside(p, &cloud.position);
        assert!(share > 0.5, "{}: {share}", p.name);
    }
    let text = std::fs::read_to_string(folder.join("scene.json")).unwrap();
    let scene: serde_json::Value = serde_json::from_str(&text).unwrap();
    let distance = scene["median_camera_distance"].as_f64().unwrap() as f32;
    let e = extent(c.train.iter().map(|p| &p.camera));
    assert!(e > 0.3 * distance && e < 3.0 * distance, "{e} {distance}");
    assert_eq!(seeded(&c, 0).position.len(), points);
}

#[test]
fn banana_loads() {
    colmap("banana", 14, [797, 530], 4771);
}

#[test]
fn kitchen_loads() {
    colmap("kitchen", 24, [797, 532], 1970);
}

fn synthetic(name: &str, train: usize, test: usize) {
    let Some((folder, c)) = loaded(name, &Options::default()) else { return };
    assert_eq!((c.train.len(), c.test.len(), c.kind), (train, test, "transforms_train.json"));
    assert!(c.train.iter().all(|p| p.channels == 4 && p.mask.is_none() && p.camera.width == 400));
    let Projection::Pinhole { fx, .. } = c.train[0].camera.projection else { panic!() };
    assert!((fx - 555.5555).abs() < 1e-3);
    let e = extent(c.train.iter().map(|p| &p.camera));
    assert!(e > 3.0 && e < 6.0, "{e}");
    let s = seeded(&c, 100_000);
    assert_eq!(s.position.len(), 100_000);
    let text = std::fs::read_to_string(folder.join("meta.json")).unwrap();
    let meta: serde_json::Value = serde_json::from_str(&text).unwrap();
    let bounds = &meta["meshes"]["whole"]["bounds"];
    let (mut low, mut high) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    for x in &s.position {
        (0..3).for_each(|k| (low[k], high[k]) = (low[k].min(x[k]), high[k].max(x[k])));
    }
    println!("seeds {low:?} {high:?}, mesh {bounds}");
    for k in 0..3 {
        let [a, b] = [0, 1].map(|side| bounds[side][k].as_f64().unwrap() as f32);
        let room = 0.06 * (b - a);
        assert!(low[k] > a - room && high[k] < b + room, "axis {k}: {} {} in {a} {b}", low[k], high[k]);
        assert!(low[k] < a + 2.0 * room && high[k] > b - 2.0 * room, "axis {k}: {} {} fills {a} {b}", low[k], high[k]);
    }
}

#[test]
fn icecream_loads_and_is_carved() {
    synthetic("synthetic_icecream", 60, 20);
}

#[test]
fn choco_cow_loads_and_is_carved() {
    synthetic("synthetic_choco_cow", 44, 12);
}
