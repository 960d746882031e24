//! Generated captures: every flavour of the lists gives the same views.

mod common;

use std::fs;

use common::*;
use image::{DynamicImage, ImageBuffer, Luma, Rgba};
use megas_capture::{Capture, Downscale, Options, Photo, extent, load};
use megas_model::Projection;

fn all() -> Options {
    Options { eval_every: 0, ..Options::default() }
}

fn close(a: &Photo, b: &Photo) -> bool {
    let flat = |p: &Photo| {
        let c = p.camera;
        let Projection::Pinhole { fx, fy } = c.projection else { return Vec::new() };
        [c.rotation.as_flattened(), &c.translation, &[fx, fy, c.cx, c.cy, c.width as f32, c.height as f32]].concat()
    };
    let same = flat(a).iter().zip(flat(b)).all(|(x, y)| (x - y).abs() <= 1e-5 * x.abs().max(1.0));
    same && a.channels == b.channels && a.pixels == b.pixels && a.mask == b.mask
}

fn names(photos: &[Photo]) -> Vec<&str> {
    photos.iter().map(|p| &*p.name).collect()
}

#[test]
fn text_binary_and_json_are_the_same_views() {
    let n = 9;
    let (bin, txt, json) = (capture(n), folder(n), folder(n));
    write_text(txt.path(), n);
    fs::write(at(&json, "transforms.json"), transforms(&intrinsics(), 0..n, |i| format!("./images/{}", name(i)))).unwrap();
    let [bin, txt, json] = [&bin, &txt, &json].map(|d| load(d.path(), &Options::default()).unwrap());
    assert_eq!((bin.kind, txt.kind, json.kind), ("colmap (binary)", "colmap (text)", "transforms.json"));
    assert_eq!((&bin.train, &bin.test, &bin.points), (&txt.train, &txt.test, &txt.points));
    assert_eq!(bin.points.as_ref().map(|c| (c.position.len(), c.colour[7])), Some((20, [7, 2, 3])));
    // Every eighth in the order of the names.
    assert_eq!(names(&bin.test), ["shot 00.png", "shot 56.png"]);
    assert_eq!(names(&bin.train).len(), 7);
    assert!(bin.train.is_sorted_by(|a, b| a.name < b.name));
    assert!(bin.train.iter().zip(&json.train).all(|(a, b)| close(a, b) && b.name == format!("images/{}", a.name)));
    assert!(bin.notes.is_empty(), "{:?}", bin.notes);
    // The lens leaves a part of the frame without light; everything else is the pinhole camera of the list.
    let p = &bin.train[0];
    assert!(p.mask.as_ref().is_some_and(|m| m.contains(&0) && m.iter().filter(|v| **v == 255).count() > 1500));
    assert_eq!((p.camera.projection, p.camera.cx), (Projection::Pinhole { fx: 50.0, fy: 51.0 }, 24.5));
    let image = p.to_image();
    assert_eq!((image.width, image.height, image.channels, image.data.len()), (W, H, 3, (W * H * 3) as usize));
    assert!(image.data.iter().all(|v| (0.0..=1.0).contains(v)));
}

#[test]
fn the_model_may_lie_in_other_folders() {
    let n = 3;
    let whole = capture(n);
    let expected = load(whole.path(), &all()).unwrap().train;
    // The model's folder itself, with images two folders up.
    assert_eq!(load(&at(&whole, "sparse/0"), &all()).unwrap().train, expected);
    // sparse/ without a number.
    let flat = folder(n);
    fs::create_dir(at(&flat, "sparse")).unwrap();
    for (file, bytes) in ["cameras.bin", "images.bin", "points3D.bin"].iter().zip(binary(n)) {
        fs::write(at(&flat, "sparse").join(file), bytes).unwrap();
    }
    assert_eq!(load(flat.path(), &all()).unwrap().train, expected);
    // Everything in one folder, images included; the points are missing.
    let heap = tempfile::tempdir().unwrap();
    write_images(heap.path(), n, W, H);
    for (file, bytes) in ["cameras.bin", "images.bin"].iter().zip(binary(n)) {
        fs::write(heap.path().join(file), bytes).unwrap();
    }
    let heap = load(heap.path(), &all()).unwrap();
    assert!(heap.train == expected && heap.points.is_none() && heap.notes.len() == 1);
}

#[test]
fn cropping_leaves_only_what_the_lens_showed() {
    let dir = capture(2);
    let cropped = load(dir.path(), &Options { crop_undistorted: true, ..all() }).unwrap();
    let whole = load(dir.path(), &all()).unwrap();
    let (c, w) = (&cropped.train[0], &whole.train[0]);
    assert!(c.mask.is_none() && c.camera.width < W && c.camera.width > W - 8, "{:?}", c.camera);
    // The same pixels, shifted by the principal point.
    let [dx, dy] = [w.camera.cx - c.camera.cx, w.camera.cy - c.camera.cy].map(|v| v as u32);
    let (a, b) = (c.to_image(), w.to_image());
    for (x, y) in [(0, 0), (5, 9), (c.camera.width - 1, c.camera.height - 1)] {
        assert_eq!(a.pixel(x, y), b.pixel(x + dx, y + dy));
    }
}

#[test]
fn downscaling_moves_the_intrinsics_by_the_exact_ratio() {
    let n = 2;
    let dir = capture(n);
    let options = |r: u32| Options { downscale: Downscale::Factor(r), ..all() };
    let p = load(dir.path(), &options(5)).unwrap().train.remove(0).camera;
    // 48 / 5 = 9.6 and 36 / 5 = 7.2 pixels.
    assert_eq!((p.width, p.height), (10, 7));
    let Projection::Pinhole { fx, fy } = p.projection else { panic!() };
    assert!((fx - 50.0 * 10.0 / 48.0).abs() < 1e-5 && (fy - 51.0 * 7.0 / 36.0).abs() < 1e-5);
    assert!((p.cx - 24.5 * 10.0 / 48.0).abs() < 1e-5 && (p.cy - 17.75 * 7.0 / 36.0).abs() < 1e-5);
    // Somebody's own reduction is preferred if it is exact.
    write_images(&at(&dir, "images_2"), n, W / 2, H / 2);
    let c = load(dir.path(), &options(2)).unwrap();
    assert_eq!((c.train[0].camera.width, c.train[0].camera.cx), (24, 12.25));
    assert!(c.notes.iter().any(|n| n.contains("reduced already")), "{:?}", c.notes);
    assert_ne!(c.train[0].pixels, load(dir.path(), &options(1)).unwrap().train[0].pixels);
    // Not complete: made from the full images instead, and said so.
    fs::remove_file(at(&dir, "images_2").join(name(0))).unwrap();
    let c = load(dir.path(), &options(2)).unwrap();
    assert!(c.notes.iter().any(|n| n.contains("lacks 1 of 2")), "{:?}", c.notes);
    assert_eq!(c.train[0].camera.width, 24);
    // Not the factor it claims.
    write_images(&at(&dir, "images_2"), n, W / 4, H / 4);
    let c = load(dir.path(), &options(2)).unwrap();
    assert!(c.notes.iter().any(|n| n.contains("not used")) && c.train[0].camera.width == 24, "{:?}", c.notes);
}

#[test]
fn only_the_reduced_images_may_be_there() {
    let dir = tempfile::tempdir().unwrap();
    write_images(&at(&dir, "images_4"), 2, W / 4, H / 4);
    write_binary(dir.path(), 2);
    let c = load(dir.path(), &Options { downscale: Downscale::Factor(4), ..all() }).unwrap();
    assert_eq!(c.train[0].camera.width, W / 4);
    let message = load(dir.path(), &all()).unwrap_err().to_string();
    assert!(message.contains("--downscale 4"), "{message}");
}

#[test]
fn images_smaller_than_the_poses_say_are_recognised() {
    let dir = tempfile::tempdir().unwrap();
    write_images(&at(&dir, "images"), 2, W / 2, H / 2);
    write_binary(dir.path(), 2);
    let c = load(dir.path(), &all()).unwrap();
    assert_eq!((c.train[0].camera.width, c.train[0].camera.cx), (24, 12.25));
    assert!(c.notes.iter().any(|n| n.contains("exact factor")), "{:?}", c.notes);
}

#[test]
fn mixed_sizes_are_legal_when_the_frames_say_so() {
    let dir = folder(1);
    let wide = ImageBuffer::from_pixel(60, 20, Luma([9u16]));
    DynamicImage::from(wide).save(at(&dir, "images/wide.png")).unwrap();
    let c = cameras(2);
    let frame = |file: &str, w: u32, h: u32, c| {
        format!("{{\"file_path\":\"images/{file}\",\"w\":{w},\"h\":{h},\"fl_x\":{w},\"transform_matrix\":{}}}", opengl(c))
    };
    let text = format!("{{\"frames\":[{},{}]}}", frame(&name(0), W, H, &c[0]), frame("wide.png", 60, 20, &c[1]));
    fs::write(at(&dir, "transforms.json"), text).unwrap();
    let c = load(dir.path(), &all()).unwrap();
    assert_eq!(c.train.iter().map(|p| (p.camera.width, p.camera.cx)).collect::<Vec<_>>(), [(48, 24.0), (60, 30.0)]);
}

fn write_rgba(path: std::path::PathBuf, alpha: impl Fn(u32, u32) -> u8) {
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    DynamicImage::from(ImageBuffer::from_fn(W, H, |x, y| Rgba([200u8, 100, 50, alpha(x, y)]))).save(path).unwrap();
}

#[test]
fn split_files_and_paths_without_extension() {
    let dir = tempfile::tempdir().unwrap();
    for (file, views) in [("train", 0..3usize), ("val", 3..4), ("test", 4..6)] {
        let text = transforms("\"camera_angle_x\": 0.7", views.clone(), |i| format!("./{file}/r_{i}"));
        fs::write(at(&dir, &format!("transforms_{file}.json")), text).unwrap();
        views.for_each(|i| write_rgba(at(&dir, &format!("{file}/r_{i}.png")), |x, _| if x < 10 { 0 } else { 255 }));
    }
    let c = load(dir.path(), &Options::default()).unwrap();
    assert_eq!(
        (names(&c.train), names(&c.test)),
        (vec!["train/r_0.png", "train/r_1.png", "train/r_2.png"], vec!["test/r_4.png", "test/r_5.png"])
    );
    assert!(c.train[0].channels == 4 && c.train[0].mask.is_none());
    assert!(c.notes.len() == 1 && c.notes[0].contains("transforms_val.json"), "{:?}", c.notes);
    let Projection::Pinhole { fx, .. } = c.train[0].camera.projection else { panic!() };
    assert!((fx - 24.0 / 0.35f32.tan()).abs() < 1e-3);
    assert_eq!(load(dir.path(), &all()).unwrap().train.len(), 5);
    // Without a test file the validation views serve.
    fs::remove_file(at(&dir, "transforms_test.json")).unwrap();
    assert_eq!(names(&load(dir.path(), &Options::default()).unwrap().test), ["val/r_3.png"]);
}

#[test]
fn lists_of_names_split() {
    let dir = folder(4);
    let image = |i: usize| format!("images/{}", name(i));
    let members = format!(
        "\"fl_x\": 50, \"train_filenames\": [\"./{}\", \"{}\"], \"val_filenames\": [\"{}\"], \"test_filenames\": []",
        image(0),
        image(1),
        image(2)
    );
    fs::write(at(&dir, "transforms.json"), transforms(&members, 0..4, image)).unwrap();
    let c = load(dir.path(), &Options::default()).unwrap();
    assert_eq!((names(&c.train), names(&c.test)), (vec!["images/shot 00.png", "images/shot 07.png"], vec!["images/shot 14.png"]));
    assert!(c.notes[0].contains("1 of 4 frames"), "{:?}", c.notes);
}

#[test]
fn opaque_alpha_is_ignored() {
    let dir = tempfile::tempdir().unwrap();
    (0..2).for_each(|i| write_rgba(at(&dir, &format!("a/{i}.png")), |_, _| 255));
    fs::write(at(&dir, "transforms.json"), transforms("\"fl_x\": 50", 0..2, |i| format!("a/{i}"))).unwrap();
    let c = load(dir.path(), &all()).unwrap();
    assert!(c.train.iter().all(|p| p.channels == 3 && p.pixels[..3] == [200, 100, 50]));
    assert!(c.notes[0].contains("opaque"), "{:?}", c.notes);
}

#[test]
fn alpha_is_premultiplied_when_reducing() {
    let dir = tempfile::tempdir().unwrap();
    write_rgba(at(&dir, "a.png"), |x, _| if x % 2 == 0 { 255 } else { 0 });
    fs::write(at(&dir, "transforms.json"), transforms("\"fl_x\": 50", 0..1, |_| "a".into())).unwrap();
    let c = load(dir.path(), &Options { downscale: Downscale::Factor(2), ..all() }).unwrap();
    assert!(c.train[0].pixels.chunks(4).all(|p| *p == [200, 100, 50, 128]));
}

#[test]
fn masks_multiply_what_the_lens_showed() {
    let dir = capture(3);
    fs::create_dir(at(&dir, "masks")).unwrap();
    let half = |w: u32, h: u32| DynamicImage::from(ImageBuffer::from_fn(w, h, |x, _| Luma([if 2 * x < w { 255u8 } else { 0 }])));
    // Both ways of naming, and a mask of half the size.
    half(W, H).save(at(&dir, "masks").join(format!("{}.png", name(0)))).unwrap();
    half(W / 2, H / 2).save(at(&dir, "masks").join(name(1))).unwrap();
    let c = load(dir.path(), &all()).unwrap();
    for k in 0..2 {
        let m = c.train[k].mask.as_ref().unwrap();
        assert!((m[18 * 48 + 10], m[18 * 48 + 40], m[0]) == (255, 0, 0), "{k}");
    }
    assert!(c.train[2].mask.as_ref().unwrap()[18 * 48 + 40] == 255);
    assert!(c.notes.iter().any(|n| n.contains("1 of 3 views have no mask")), "{:?}", c.notes);
    // Masks that belong to nothing.
    fs::remove_dir_all(at(&dir, "masks")).unwrap();
    fs::create_dir(at(&dir, "masks")).unwrap();
    assert!(load(dir.path(), &all()).unwrap().notes.iter().any(|n| n.contains("no mask belongs")));
    // A mask that the list names.
    let json = folder(1);
    half(W, H).save(at(&json, "m.png")).unwrap();
    let text = transforms("\"fl_x\": 50", 0..1, |i| format!("images/{}\", \"mask_path\": \"m.png", name(i)));
    fs::write(at(&json, "transforms.json"), text).unwrap();
    let c = load(json.path(), &all()).unwrap();
    assert_eq!(c.train[0].mask.as_ref().unwrap()[20..30], [255, 255, 255, 255, 0, 0, 0, 0, 0, 0]);
}

fn with_cloud(offset: f32) -> Capture {
    let dir = folder(4);
    let mut ply = String::from("ply\nformat ascii 1.0\nelement vertex 20\nproperty float x\nproperty float y\nproperty float z\n");
    ply += "property uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n";
    points().iter().for_each(|(x, c)| ply += &format!("{} {} {} {} {} {}\n", x[0] as f32 + offset, x[1], x[2], c[0], c[1], c[2]));
    fs::write(at(&dir, "sparse_pc.ply"), ply).unwrap();
    let members = "\"fl_x\": 50, \"ply_file_path\": \"sparse_pc.ply\"";
    fs::write(at(&dir, "transforms.json"), transforms(members, 0..4, |i| format!("images/{}", name(i)))).unwrap();
    load(dir.path(), &all()).unwrap()
}

#[test]
fn point_clouds_beside_the_poses_are_checked() {
    let good = with_cloud(0.0);
    assert_eq!(good.points.as_ref().map(|p| (p.position.len(), p.colour[4])), Some((20, [4, 2, 3])));
    assert!(good.notes.is_empty(), "{:?}", good.notes);
    let bad = with_cloud(30.0);
    assert!(bad.notes[0].contains("different frames"), "{:?}", bad.notes);
}

#[test]
fn the_extent_is_that_of_the_design() {
    // Of two cameras the mean is the middle: 1.1 times half of their distance, which is a chord of 0.7 rad here.
    let c = cameras(2);
    let e = extent(c.iter());
    assert!((e - 1.1 * 4.0 * 0.35f32.sin()).abs() < 1e-4, "{e}");
    assert_eq!(extent(c[..1].iter()), 1.0);
    assert_eq!(extent([].iter()), 1.0);
}

#[test]
fn the_number_of_threads_changes_nothing() {
    let dir = capture(6);
    let options = Options { downscale: Downscale::Factor(3), ..Options::default() };
    let with = |n: usize| rayon::ThreadPoolBuilder::new().num_threads(n).build().unwrap().install(|| load(dir.path(), &options).unwrap());
    assert_eq!(with(1), with(4));
}
