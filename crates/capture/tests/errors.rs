//! Bad captures: one clear error each, which names the file, the place, what was found and what to do.

mod common;

use std::{fs, path::Path};

use common::*;
use image::{DynamicImage, ImageBuffer, Luma};
use megas_capture::{CaptureError, Downscale, Options, load};
use proptest::prelude::*;

#[track_caller]
fn refused(folder: &Path, parts: &[&str]) {
    refused_with(folder, &Options::default(), parts);
}

#[track_caller]
fn refused_with(folder: &Path, options: &Options, parts: &[&str]) {
    let message = load(folder, options).expect_err("this capture is bad").to_string();
    for part in parts {
        assert!(message.contains(part), "'{part}' is not in: {message}");
    }
    assert!(!message.contains('\n') && message.len() < 700, "{message}");
}

/// A good text capture with one file changed.
#[track_caller]
fn edited(file: &str, from: &str, to: &str, parts: &[&str]) {
    let dir = folder(3);
    write_text(dir.path(), 3);
    let path = at(&dir, "sparse/0").join(file);
    let text = fs::read_to_string(&path).unwrap();
    assert!(text.contains(from), "{from}");
    fs::write(&path, text.replacen(from, to, 1)).unwrap();
    refused(dir.path(), parts);
}

/// A good `transforms.json` with one piece changed.
#[track_caller]
fn json(from: &str, to: &str, parts: &[&str]) {
    let dir = folder(3);
    let text = transforms(&intrinsics(), 0..3, |i| format!("images/{}", name(i)));
    assert!(text.contains(from), "{from}");
    fs::write(at(&dir, "transforms.json"), text.replacen(from, to, 1)).unwrap();
    refused(dir.path(), parts);
}

#[test]
fn folders_that_are_no_captures() {
    let dir = folder(1);
    refused(dir.path(), &["not a capture", "sparse/0", "transforms_train.json", "transforms.json", "COLMAP"]);
    refused(&at(&dir, "nowhere"), &["no such folder"]);
    refused(&at(&dir, "images").join(name(0)), &["this is a file"]);
    refused_with(dir.path(), &Options { downscale: Downscale::Factor(0), ..Options::default() }, &["downscale", "0"]);
}

#[test]
fn a_user_may_stop_the_loading() {
    let dir = capture(5);
    let asked = std::sync::atomic::AtomicUsize::new(0);
    let stopped = || asked.fetch_add(1, std::sync::atomic::Ordering::Relaxed) >= 2;
    let error = megas_capture::load_unless(dir.path(), &Options::default(), &stopped).unwrap_err();
    assert!(matches!(error, CaptureError::Stopped) && error.to_string().contains("nothing was written"), "{error}");
}

#[test]
fn missing_images_are_counted_and_the_first_named() {
    let dir = capture(9);
    (2..9).for_each(|i| fs::remove_file(at(&dir, "images").join(name(i))).unwrap());
    refused(dir.path(), &["7 of 9", "images/shot 14.png, images/shot 21.png, images/shot 28.png, …", "images.bin"]);
    write_images(&at(&dir, "images"), 9, W, H);
    fs::remove_file(at(&dir, "images").join(name(3))).unwrap();
    refused(dir.path(), &["1 of 9", "shot 21.png;"]);
}

#[test]
fn damaged_photographs() {
    let dir = capture(3);
    fs::write(at(&dir, "images").join(name(1)), b"").unwrap();
    refused(dir.path(), &["shot 07.png", "empty file", "copy the photograph again"]);
    fs::write(at(&dir, "images").join(name(1)), b"no image at all").unwrap();
    refused(dir.path(), &["shot 07.png", "PNG or JPEG"]);
    write_images(&at(&dir, "images"), 3, W, H);
    let path = at(&dir, "images").join(name(2));
    let bytes = fs::read(&path).unwrap();
    fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
    refused(dir.path(), &["shot 14.png", "truncated"]);
}

#[test]
fn sizes_that_do_not_match() {
    let dir = capture(2);
    write_images(&at(&dir, "images"), 2, 50, 36);
    refused(dir.path(), &["images.bin", "image 1 'shot 00.png'", "50 × 36", "48 × 36"]);
    write_images(&at(&dir, "images"), 2, H, W);
    refused(dir.path(), &["36 × 48", "on its side"]);
    write_images(&at(&dir, "images"), 2, W, H);
    fs::create_dir(at(&dir, "masks")).unwrap();
    DynamicImage::from(ImageBuffer::from_pixel(20, 20, Luma([255u8]))).save(at(&dir, "masks").join(name(0))).unwrap();
    refused(dir.path(), &["masks", "20 × 20", "48 × 36"]);
}

#[test]
fn wrong_intrinsics() {
    edited("cameras.txt", " 50.0 ", " -50.0 ", &["image 1", "fx = -50", "calibration"]);
    edited("cameras.txt", " 50.0 ", " NaN ", &["fx = NaN"]);
    edited("cameras.txt", " 24.5 ", " 9000 ", &["principal point cx = 9000"]);
    edited("cameras.txt", " 0.15 ", " inf ", &["distortion"]);
    edited("cameras.txt", " 0.15 ", " -3e9 ", &["leaves no pixel"]);
    edited("cameras.txt", "48 36", "0 36", &["0 × 36"]);
    edited("cameras.txt", "OPENCV", "FOV", &["cameras.txt", "line 2", "'FOV'", "OPENCV_FISHEYE", "image_undistorter"]);
    edited("cameras.txt", "1 OPENCV", "4 OPENCV", &["images.txt", "camera 1", "do not belong together"]);
    json("\"fl_x\": 50.0", "\"fl_x\": 0", &["transforms.json", "frame 0", "fx = 0"]);
    json("\"w\": 48,", "", &["only one of w and h"]);
    json("\"fl_x\": 50.0, \"fl_y\": 51.0,", "", &["no focal length", "camera_angle_x"]);
    json("\"fl_x\": 50.0, \"fl_y\": 51.0,", "\"camera_angle_x\": 3.5,", &["camera_angle_x = 3.5", "π"]);
    json("\"w\"", "\"camera_model\": \"EQUIRECTANGULAR\", \"w\"", &["EQUIRECTANGULAR", "undistort"]);
}

#[test]
fn wrong_poses() {
    edited("images.txt", "1 shot 07", "9 shot 07", &["images.txt", "image 2 'shot 07.png'", "camera 9"]);
    let dir = folder(1);
    write_text(dir.path(), 1);
    let path = at(&dir, "sparse/0/images.txt");
    fs::write(&path, format!("1 0 0 0 0 0 0 1 1 {}\n\n", name(0))).unwrap();
    refused(dir.path(), &["a quaternion of length 0", "length 1"]);
    fs::write(&path, format!("1 1 0 0 0 nan 0 1 1 {}\n\n", name(0))).unwrap();
    refused(dir.path(), &["NaN", "finite"]);
    json("[0, 0, 0, 1]", "[0, 0, 0, 2]", &["frame 0", "last row"]);
    json(", [0, 0, 0, 1]", ", [0, 0, 1]", &["four rows of four numbers"]);
    json("\"transform_matrix\": [[", "\"transform_matrix\": [[9", &["frame 0 'images/shot 00.png'", "no rotation"]);
    json("\"transform_matrix\": [[", "\"transform_matrix\": [[NaN, ", &["transforms.json", "line 1", "NaN"]);
    json("\"transform_matrix\"", "\"matrix\"", &["no transform_matrix"]);
    json("\"file_path\"", "\"path\"", &["frame 0", "no file_path"]);
}

#[test]
fn names_that_leave_the_folder() {
    edited("images.txt", "shot 07.png", "../../etc/passwd", &["image 2", "leaves the folder", "'../../etc/passwd'"]);
    edited("images.txt", "shot 07.png", "/etc/passwd", &["absolute path"]);
    json("images/shot 07.png", "../x.png", &["frame 1", "leaves the folder"]);
    json("images/shot 07.png", "C:\\\\x.png", &["absolute path"]);
    json("\"w\"", "\"ply_file_path\": \"/x.ply\", \"w\"", &["ply_file_path", "absolute path"]);
    json("\"w\"", "\"ply_file_path\": \"x.ply\", \"w\"", &["'x.ply' without a file"]);
    json("\"transform_matrix\"", "\"mask_path\": \"m.png\", \"transform_matrix\"", &["mask_path 'm.png' without a file"]);
}

#[test]
fn empty_and_double_lists() {
    edited("images.txt", "shot 07.png", "shot 00.png", &["image 2", "'shot 00.png' a second time"]);
    json("images/shot 07.png", "images/shot 00.png", &["frame 1", "a second time"]);
    let dir = capture(1);
    fs::write(at(&dir, "sparse/0/images.bin"), 0u64.to_le_bytes()).unwrap();
    refused(dir.path(), &["images.bin", "no images", "overlap"]);
    fs::write(at(&dir, "sparse/0/images.bin"), b"").unwrap();
    refused(dir.path(), &["images.bin", "byte 0", "truncated"]);
    fs::remove_dir_all(at(&dir, "sparse")).unwrap();
    fs::write(at(&dir, "transforms.json"), "{\"frames\": []}").unwrap();
    refused(dir.path(), &["transforms.json", "no frames"]);
    json("\"w\"", "\"train_filenames\": [\"other.png\"], \"w\"", &["train_filenames", "match no frame"]);
}

#[test]
fn too_little_memory_says_what_would_fit() {
    let dir = capture(9);
    let small = |bytes: u64| Options { memory_budget_bytes: bytes, ..Options::default() };
    // Nine views of 48 × 36 with four bytes per pixel, and one of them in work: some 80 kB.
    refused_with(dir.path(), &small(40_000), &["bytes", "40000 bytes", "--downscale 2 would fit"]);
    refused_with(dir.path(), &small(1000), &["raise the budget"]);
    // Enough for one at a time: the same result.
    assert_eq!(load(dir.path(), &small(90_000)).unwrap(), load(dir.path(), &Options::default()).unwrap());
    assert!(
        matches!(load(dir.path(), &small(1)), Err(CaptureError::OverBudget { budget_bytes: 1, need_bytes, .. }) if need_bytes > 62_208)
    );
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 60, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn mutated_models_never_panic(file in 0usize..3, edits in prop::collection::vec((0usize..4000, any::<u8>()), 1..6), cut in 0usize..80) {
        let dir = capture(2);
        let mut bytes = binary(2)[file].clone();
        let n = bytes.len();
        edits.iter().for_each(|(i, v)| bytes[i % n] = *v);
        bytes.truncate(n - cut.saturating_sub(60).min(n));
        fs::write(at(&dir, "sparse/0").join(["cameras.bin", "images.bin", "points3D.bin"][file]), bytes).unwrap();
        // A small budget, so that sizes that are made up have nowhere to go.
        drop(load(dir.path(), &Options { memory_budget_bytes: 1 << 20, ..Options::default() }));
    }

    #[test]
    fn mutated_json_never_panics(edits in prop::collection::vec((0usize..4000, any::<u8>()), 1..6)) {
        let dir = folder(2);
        let mut bytes = transforms(&intrinsics(), 0..2, |i| format!("images/{}", name(i))).into_bytes();
        let n = bytes.len();
        edits.iter().for_each(|(i, v)| bytes[i % n] = *v);
        fs::write(at(&dir, "transforms.json"), bytes).unwrap();
        drop(load(dir.path(), &Options::default()));
    }

    #[test]
    fn mutated_images_never_panic(edits in prop::collection::vec((0usize..4000, any::<u8>()), 1..6)) {
        let dir = capture(1);
        let path = at(&dir, "images").join(name(0));
        let mut bytes = fs::read(&path).unwrap();
        let n = bytes.len();
        edits.iter().for_each(|(i, v)| bytes[i % n] = *v);
        fs::write(&path, bytes).unwrap();
        drop(load(dir.path(), &Options::default()));
    }
}
