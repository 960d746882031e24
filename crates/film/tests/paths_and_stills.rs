//! Camera paths, PNG and PLY sequences.
#![allow(missing_docs)]

use megas_film::{CameraPath, Distance, Keyframe, KeyframePath, Orbit, PlySequence, write_png};
use megas_formats::{WriteOptions, load_splats};
use megas_math::vec3;
use megas_model::{Image, Splats};
use proptest::prelude::*;
use tempfile::tempdir;

fn orbit(up: [f32; 3]) -> Orbit {
    Orbit { target: [1.0, 2.0, 3.0], distance: Distance::Fixed(4.0), elevation: 20.0, azimuth: 30.0, speed: 45.0, up, fov_y: 40.0 }
}

#[test]
fn an_orbit_looks_at_its_target_from_the_right_place() {
    for up in [[0.0, 0.0, 1.0], [0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 3.0, 4.0]] {
        let n = vec3::normalize_or(up, up);
        let mut last = f64::NAN;
        for t in [0.0, 1.0, 2.0, 8.0, 3608.0] {
            let camera = CameraPath::Orbit(orbit(up)).camera_at(t, 640, 480);
            let [u, v] = camera.project(camera.to_camera([1.0, 2.0, 3.0]));
            assert!((u - 320.0).abs() < 1e-2 && (v - 240.0).abs() < 1e-2);
            let arm = vec3::sub(camera.center(), [1.0, 2.0, 3.0]);
            assert!((vec3::norm(arm) - 4.0).abs() < 1e-4);
            assert!((vec3::dot(arm, n) / 4.0 - 20f32.to_radians().sin()).abs() < 1e-4);
            // Above is above: a point toward `up` is drawn higher.
            let p = camera.project(camera.to_camera(vec3::add_scaled([1.0, 2.0, 3.0], n, 0.5)));
            assert!(p[1] < 240.0 && (p[0] - 320.0).abs() < 1e-2);
            last = f64::from(arm[0]);
        }
        // 3608 s are a whole number of turns.
        assert!((last - f64::from(orbit(up).camera_at(0.0, 640, 480).center()[0] - 1.0)).abs() < 1e-3);
    }
    // Counter-clockwise seen from above, 0° toward +x.
    let o = Orbit { elevation: 0.0, azimuth: 90.0, ..orbit([0.0, 0.0, 1.0]) };
    assert!(vec3::norm(vec3::sub(o.camera_at(0.0, 64, 64).center(), [1.0, 6.0, 3.0])) < 1e-4);
}

#[test]
fn a_fitted_sphere_touches_the_border_of_every_shape() {
    for (w, h) in [(640, 480), (480, 640), (1280, 720), (100, 100)] {
        let o = Orbit { distance: Distance::Fit { radius: 0.7, factor: 1.0 }, ..orbit([0.0, 0.0, 1.0]) };
        let camera = o.camera_at(0.3, w, h);
        // The farthest projection of any point of the sphere, by brute force.
        let mut reach = 0f32;
        for d in megas_model::fibonacci_directions(40_000) {
            let [u, v] = camera.project(camera.to_camera(vec3::add_scaled(o.target, d, 0.7)));
            let (u, v) = ((u - 0.5 * w as f32).abs(), (v - 0.5 * h as f32).abs());
            reach = reach.max(if w < h { u / (0.5 * w as f32) } else { v / (0.5 * h as f32) });
        }
        assert!((reach - 1.0).abs() < 2e-3, "{w}x{h}: {reach}");
    }
}

fn key(time: f64, eye: [f32; 3], fov_y: f32) -> Keyframe {
    Keyframe { time, eye, target: [0.0, 0.0, 0.1 * time as f32], fov_y }
}

#[test]
fn keyframes_are_met_and_never_overshot() {
    let keys = vec![
        key(0.0, [5.0, 0.0, 1.0], 40.0),
        key(1.0, [4.0, 3.0, 1.0], 50.0),
        key(3.0, [4.0, 3.0, 1.0], 50.0),
        key(3.5, [-4.0, 3.5, 2.0], 30.0),
    ];
    let path = KeyframePath::new(keys.clone(), [0.0, 0.0, 1.0]).unwrap();
    for k in &keys {
        let camera = path.camera_at(k.time, 640, 480);
        assert!(vec3::norm(vec3::sub(camera.center(), k.eye)) < 1e-4);
    }
    let center = |t: f64| path.camera_at(t, 640, 480).center();
    let (mut before, mut fastest) = (center(0.0), 0f32);
    for n in 1..=3500 {
        let t = f64::from(n) * 1e-3;
        let c = center(t);
        fastest = fastest.max(vec3::norm(vec3::sub(c, before)));
        before = c;
        if (1.0..=3.0).contains(&t) {
            assert!(vec3::norm(vec3::sub(c, [4.0, 3.0, 1.0])) < 1e-4, "wobbles at {t}");
        }
        assert!((-4.001..=5.001).contains(&c[0]) && (-0.001..=3.501).contains(&c[1]));
    }
    // No jumps: the fastest section moves 8.08 units in 0.5 s, and a cubic peaks at 1.5 times the mean.
    assert!(fastest < 1.55 * 8.08 / 500.0, "{fastest}");
    assert_eq!(path.camera_at(-5.0, 64, 64), path.camera_at(0.0, 64, 64));
    assert_eq!(path.camera_at(99.0, 64, 64), path.camera_at(3.5, 64, 64));
}

#[test]
fn impossible_paths_are_refused() {
    let up = [0.0, 0.0, 1.0];
    let a = key(0.0, [5.0, 0.0, 1.0], 40.0);
    for keys in [
        vec![],
        vec![a, a],
        vec![key(1.0, a.eye, 40.0), a],
        vec![key(0.0, a.eye, 0.0)],
        vec![key(f64::NAN, a.eye, 40.0)],
        vec![key(0.0, [f32::NAN; 3], 40.0)],
        vec![key(0.0, [0.0; 3], 40.0)],
    ] {
        assert!(KeyframePath::new(keys, up).is_err());
    }
}

proptest! {
    #[test]
    fn coordinates_stay_between_their_keyframes(eyes in prop::collection::vec(prop::array::uniform3(-10f32..10.0), 1..6), s in 0f64..1.0) {
        let keys: Vec<_> = eyes.iter().enumerate().map(|(k, e)| key(k as f64 * 0.7, [e[0], e[1], e[2] + 20.0], 40.0)).collect();
        let path = KeyframePath::new(keys.clone(), [0.0, 0.0, 1.0]).unwrap();
        let t = s * 0.7 * (keys.len() - 1) as f64;
        let i = ((t / 0.7) as usize).min(keys.len() - 1);
        let (a, b) = (keys[i].eye, keys[(i + 1).min(keys.len() - 1)].eye);
        let c = path.camera_at(t, 64, 64).center();
        for k in 0..3 {
            prop_assert!(c[k] >= a[k].min(b[k]) - 1e-3 && c[k] <= a[k].max(b[k]) + 1e-3);
        }
    }
}

#[test]
fn png_files_hold_the_rounded_values() {
    let dir = tempdir().unwrap();
    for (channels, colour) in [(1, png::ColorType::Grayscale), (3, png::ColorType::Rgb), (4, png::ColorType::Rgba)] {
        let mut image = Image::new(7, 5, channels);
        image.data.iter_mut().enumerate().for_each(|(k, v)| *v = k as f32 / 100.0 - 0.1);
        image.data[3] = f32::NAN;
        let path = dir.path().join(format!("{channels}.png"));
        write_png(&path, &image, false).unwrap();
        let mut reader = png::Decoder::new(std::io::BufReader::new(std::fs::File::open(&path).unwrap())).read_info().unwrap();
        let mut bytes = vec![0; reader.output_buffer_size().unwrap()];
        let info = reader.next_frame(&mut bytes).unwrap();
        assert_eq!((info.width, info.height, info.color_type), (7, 5, colour));
        assert_eq!(bytes, image.to_u8());
        assert!(write_png(&path, &image, false).is_err());
        write_png(&path, &image, true).unwrap();
    }
    assert!(write_png(dir.path().join("x.png"), &Image::new(2, 2, 2), false).is_err());
    assert!(write_png(dir.path().join("y.png"), &Image::new(0, 2, 3), false).is_err());
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 3);
}

#[test]
fn sequences_are_numbered_and_carry_temperature() {
    let dir = tempdir().unwrap();
    let folder = dir.path().join("a/b");
    let sequence = PlySequence::create(&folder, WriteOptions::default()).unwrap();
    let mut s = Splats::default();
    s.push([1.0, 2.0, 3.0], [-3.0; 3], [1.0, 0.0, 0.0, 0.0], 1.0, &[0.1, 0.2, 0.3]);
    for k in 0..3 {
        s.temperature[0] = 300.0 + k as f32;
        let path = sequence.write(k, &s).unwrap();
        assert_eq!(path, folder.join(format!("frame_0000{k}.ply")));
        assert_eq!(load_splats(path).unwrap().splats, s);
    }
    assert!(sequence.write(1, &s).is_err());
}
