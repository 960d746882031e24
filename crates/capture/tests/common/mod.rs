//! Tiny captures on disk: the same views as COLMAP text, COLMAP binary and `transforms.json`.

#![allow(dead_code)] // Every test binary uses its own part.

use std::{
    fmt::Write,
    fs,
    path::{Path, PathBuf},
};

use image::{DynamicImage, ImageBuffer, Rgb};
use megas_math::{mat3, quat, vec3};
use megas_model::Camera;

/// Width of the photographs.
pub const W: u32 = 48;
/// Height of the photographs.
pub const H: u32 = 36;
/// fx fy cx cy k1 k2 p1 p2 of the one OPENCV camera.
pub const OPENCV: [f64; 8] = [50.0, 51.0, 24.5, 17.75, 0.15, -0.02, 0.001, -0.0005];

/// Cameras on a ring that look at the origin.
pub fn cameras(n: usize) -> Vec<Camera> {
    let camera = |i: usize| {
        let a = i as f32 * 0.7;
        Camera::look_at([4.0 * a.cos(), 4.0 * a.sin(), 1.0], [0.0; 3], [0.0, 0.0, 1.0], 0.7, W, H)
    };
    (0..n).map(camera).collect()
}

/// Name of an image; not in the order of the numbers, so that sorting shows.
pub fn name(i: usize) -> String {
    format!("shot {:02}.png", (i * 7) % 100)
}

/// Colour images that differ from each other.
pub fn write_images(folder: &Path, n: usize, w: u32, h: u32) {
    fs::create_dir_all(folder).unwrap();
    for i in 0..n {
        let image = ImageBuffer::from_fn(w, h, |x, y| Rgb([(x * 5) as u8, (y * 6) as u8, (i * 20) as u8]));
        DynamicImage::from(image).save(folder.join(name(i))).unwrap();
    }
}

fn pose(c: &Camera) -> ([f64; 4], [f64; 3]) {
    let q = quat::from_mat3(mat3::cast(c.rotation));
    (quat::normalize(q).unwrap(), vec3::cast(c.translation))
}

/// Points of a cloud around the origin.
pub fn points() -> Vec<([f64; 3], [u8; 3])> {
    (0..20).map(|i| ([(f64::from(i) * 0.7).sin() * 0.5, (f64::from(i) * 1.3).cos() * 0.5, 0.02 * f64::from(i)], [i as u8, 2, 3])).collect()
}

/// `sparse/0` as text.
pub fn write_text(folder: &Path, n: usize) {
    let model = folder.join("sparse/0");
    fs::create_dir_all(&model).unwrap();
    let numbers = |v: &[f64]| v.iter().map(|x| format!(" {x:?}")).collect::<String>();
    fs::write(model.join("cameras.txt"), format!("# a comment\n1 OPENCV {W} {H}{}\n", numbers(&OPENCV))).unwrap();
    let mut images = String::from("# two lines each\n");
    for (i, c) in cameras(n).iter().enumerate() {
        let (q, t) = pose(c);
        writeln!(images, "{}{}{} 1 {}", i + 1, numbers(&q), numbers(&t), name(i)).unwrap();
        writeln!(images, "{}", if i % 2 == 0 { "10.5 11.5 -1 3 4 2" } else { "" }).unwrap();
    }
    fs::write(model.join("images.txt"), images).unwrap();
    let rows = points().into_iter().enumerate().map(|(i, (x, c))| format!("{i}{} {} {} {} 0.5 1 0 2 1\n", numbers(&x), c[0], c[1], c[2]));
    fs::write(model.join("points3D.txt"), rows.collect::<String>()).unwrap();
}

/// `cameras.bin`, `images.bin`, `points3D.bin`.
pub fn binary(n: usize) -> [Vec<u8>; 3] {
    let f64s = |b: &mut Vec<u8>, v: &[f64]| v.iter().for_each(|x| b.extend(x.to_le_bytes()));
    let mut cams = 1u64.to_le_bytes().to_vec();
    cams.extend([1i32, 4].iter().flat_map(|v| v.to_le_bytes()));
    cams.extend([u64::from(W), u64::from(H)].iter().flat_map(|v| v.to_le_bytes()));
    f64s(&mut cams, &OPENCV);
    let mut images = (n as u64).to_le_bytes().to_vec();
    for (i, c) in cameras(n).iter().enumerate() {
        let (q, t) = pose(c);
        images.extend((i as i32 + 1).to_le_bytes());
        f64s(&mut images, &q);
        f64s(&mut images, &t);
        images.extend(1i32.to_le_bytes());
        images.extend(name(i).as_bytes());
        images.push(0);
        images.extend(1u64.to_le_bytes());
        f64s(&mut images, &[1.5, 2.5]);
        images.extend((-1i64).to_le_bytes());
    }
    let all = points();
    let mut cloud = (all.len() as u64).to_le_bytes().to_vec();
    for (i, (x, c)) in all.iter().enumerate() {
        cloud.extend((i as u64).to_le_bytes());
        f64s(&mut cloud, x);
        cloud.extend(c);
        f64s(&mut cloud, &[0.5]);
        cloud.extend(1u64.to_le_bytes());
        cloud.extend([0u8; 8]);
    }
    [cams, images, cloud]
}

/// `sparse/0` in binary.
pub fn write_binary(folder: &Path, n: usize) {
    let model = folder.join("sparse/0");
    fs::create_dir_all(&model).unwrap();
    for (file, bytes) in ["cameras.bin", "images.bin", "points3D.bin"].iter().zip(binary(n)) {
        fs::write(model.join(file), bytes).unwrap();
    }
}

/// Camera→world with OpenGL axes as JSON rows.
pub fn opengl(c: &Camera) -> String {
    let r: [[f64; 3]; 3] = mat3::cast(c.rotation);
    let (q, t) = pose(c);
    // From the same quaternion as the COLMAP files, so that rounding does not tell them apart.
    let r = if mat3::norm(mat3::sub(r, quat::to_mat3(q))) < 1e-5 { quat::to_mat3(q) } else { r };
    let eye = vec3::scale(mat3::tmul_vec(r, t), -1.0);
    let row = |k: usize| format!("[{:?}, {:?}, {:?}, {:?}]", r[0][k], -r[1][k], -r[2][k], eye[k]);
    format!("[{}, {}, {}, [0, 0, 0, 1]]", row(0), row(1), row(2))
}

/// The intrinsics of [`OPENCV`] as JSON members.
pub fn intrinsics() -> String {
    let names = ["fl_x", "fl_y", "cx", "cy", "k1", "k2", "p1", "p2"];
    let all: Vec<String> = names.iter().zip(OPENCV).map(|(n, v)| format!("\"{n}\": {v:?}")).collect();
    format!("\"w\": {W}, \"h\": {H}, {}", all.join(", "))
}

/// Text of a `transforms.json` with these members besides the frames, and the path written for every image.
pub fn transforms(members: &str, views: std::ops::Range<usize>, path: impl Fn(usize) -> String) -> String {
    let all = cameras(views.end);
    let frame = |i: usize| format!("{{\"file_path\": \"{}\", \"transform_matrix\": {}}}", path(i), opengl(&all[i]));
    let comma = if members.is_empty() { "" } else { ", " };
    format!("{{{members}{comma}\"frames\": [{}]}}", views.map(frame).collect::<Vec<_>>().join(",\n"))
}

/// A folder with images and nothing else.
pub fn folder(n: usize) -> tempfile::TempDir {
    let dir = tempfile::tempdir().unwrap();
    write_images(&dir.path().join("images"), n, W, H);
    dir
}

/// A complete binary capture.
pub fn capture(n: usize) -> tempfile::TempDir {
    let dir = folder(n);
    write_binary(dir.path(), n);
    dir
}

/// A path inside.
pub fn at(dir: &tempfile::TempDir, path: &str) -> PathBuf {
    dir.path().join(path)
}
