//! Every codec writes what it can read, within the errors of splatting.md §1.4.
#![allow(missing_docs)]

mod common;

use common::{sample, shared};
use megas_formats::{
    FormatError, RenderMode, SplatFormat, WriteOptions, load_splats, read_mesh_ply, save_splats, write_atomic, write_mesh_ply,
};
use megas_math::quat;
use megas_model::{AMBIENT_K, Mesh, Splats};
use tempfile::tempdir;

fn options() -> WriteOptions {
    WriteOptions::default()
}

#[test]
fn ply_keeps_every_bit_at_every_degree() {
    let dir = tempdir().unwrap();
    for degree in 0..=3 {
        let mut s = sample(degree, 1000);
        s.opacity_logit[3] = f32::INFINITY;
        s.opacity_logit[4] = f32::NEG_INFINITY;
        let path = dir.path().join(format!("d{degree}.ply"));
        save_splats(&path, &s, &WriteOptions { render_mode: RenderMode::Mip, ..options() }).unwrap();
        let f = load_splats(&path).unwrap();
        assert_eq!(f.splats, s);
        let r = f.report;
        assert_eq!((r.format, r.rows, r.count, r.dropped_non_finite, r.replaced_attributes), (SplatFormat::Ply, 1000, 1000, 0, 0));
        assert_eq!((r.render_mode, r.antialiased, r.sh_degree, r.has_temperature), (RenderMode::Mip, true, degree, true));
    }
}

#[test]
fn strict_ply_has_the_classic_row_and_nothing_else() {
    let dir = tempdir().unwrap();
    let s = sample(3, 10);
    let path = dir.path().join("strict.ply");
    save_splats(&path, &s, &WriteOptions { strict: true, ..options() }).unwrap();
    let bytes = std::fs::read(&path).unwrap();
    let text = String::from_utf8_lossy(&bytes).into_owned();
    let header = text.split("end_header\n").next().unwrap();
    assert_eq!(bytes.len(), header.len() + "end_header\n".len() + 10 * 62 * 4);
    assert_eq!(header.lines().nth(2), Some("element vertex 10"));
    assert!(!header.contains("comment") && !header.contains("temperature"));
    let t = load_splats(&path).unwrap();
    assert!(!t.report.has_temperature && t.splats.temperature.iter().all(|v| *v == AMBIENT_K));
    assert_eq!((t.splats.mean, t.splats.sh), (s.mean, s.sh));
}

#[test]
fn normals_are_written_outward_and_zero_where_unknown() {
    let dir = tempdir().unwrap();
    let s = sample(0, 3);
    let path = dir.path().join("n.ply");
    save_splats(&path, &s, &WriteOptions { strict: true, ..options() }).unwrap();
    let bytes = std::fs::read(&path).unwrap();
    let body = &bytes[bytes.len() - 3 * 17 * 4..];
    let at = |row: usize, k: usize| f32::from_le_bytes(body[(row * 17 + k) * 4..][..4].try_into().unwrap());
    for (row, expected) in [s.normal(0), [0.0; 3], s.normal(2)].into_iter().enumerate() {
        assert_eq!([at(row, 3), at(row, 4), at(row, 5)], expected);
    }
}

fn rotation_error_degrees(a: [f32; 4], b: [f32; 4]) -> f64 {
    let (a, b) = (quat::normalize(a.map(f64::from)).unwrap(), quat::normalize(b.map(f64::from)).unwrap());
    let dot: f64 = (0..4).map(|k| a[k] * b[k]).sum::<f64>().abs().min(1.0);
    (2.0 * dot.acos()).to_degrees()
}

/// Largest errors of mean, log-scale, rotation (degrees), colour and opacity between rows `i` of `a` and `order[i]` of `b`.
fn errors(a: &Splats, b: &Splats, order: &[usize]) -> ([f32; 3], f32, f64, f32) {
    let mut e = ([0f32; 3], 0f32, 0f64, 0f32);
    for (i, &j) in order.iter().enumerate() {
        for k in 0..3 {
            e.0[k] = e.0[k].max((a.mean[i][k] - b.mean[j][k]).abs());
            e.1 = e.1.max((a.log_scale[i][k] - b.log_scale[j][k]).abs());
            e.3 = e.3.max((a.base_rgb(i)[k] - b.base_rgb(j)[k]).abs());
        }
        e.2 = e.2.max(rotation_error_degrees(a.rotation[i], b.rotation[j]));
        e.3 = e.3.max((a.opacity(i) - b.opacity(j)).abs());
    }
    e
}

/// For each row of `a` the row of `b` that is nearest in the first coordinates.
fn match_rows(a: &Splats, b: &Splats) -> Vec<usize> {
    let distance = |i: usize, j: usize| -> f32 { (0..3).map(|k| (a.mean[i][k] - b.mean[j][k]).powi(2)).sum() };
    (0..a.len()).map(|i| (0..b.len()).min_by(|&x, &y| distance(i, x).total_cmp(&distance(i, y))).unwrap()).collect()
}

#[test]
fn compressed_ply_stays_within_its_quantisation() {
    let dir = tempdir().unwrap();
    let path = dir.path().join("a.compressed.ply");
    for degree in 0..=3 {
        let s = sample(degree, 1000);
        save_splats(&path, &s, &WriteOptions { overwrite: true, ..options() }).unwrap();
        let f = load_splats(&path).unwrap();
        assert_eq!((f.report.format, f.report.sh_degree, f.splats.len()), (SplatFormat::CompressedPly, degree, 1000));
        let order = match_rows(&s, &f.splats);
        let (mean, scale, rotation, colour) = errors(&s, &f.splats, &order);
        // Half a step of the widest possible chunk, plus rounding. The middle axis has 10 bits.
        let (lo, hi) = s.bounds().unwrap();
        for (k, levels) in [2047.0, 1023.0, 2047.0].into_iter().enumerate() {
            assert!(mean[k] <= 0.501 * (hi[k] - lo[k]) / levels + 1e-6, "{mean:?}");
        }
        // Three components off by half a step of √2/1023 each, and the fourth, where all are ½, by their sum: 0.275°, a little
        // more than the 0.2° that splatting.md §1.4 asks for.
        assert!(scale <= 6.0 / 1023.0 && rotation <= 0.275 && colour <= 1.0 / 255.0, "{scale} {rotation} {colour}");
        for (i, &j) in order.iter().enumerate() {
            for (a, b) in s.sh_of(i)[3..].iter().zip(&f.splats.sh_of(j)[3..]) {
                assert!((a - b).abs() <= 4.0 / 256.0 + 1e-6);
            }
        }
        // Writing what was read must be stable: the second generation is no worse than the first.
        let again = dir.path().join("b.compressed.ply");
        save_splats(&again, &f.splats, &WriteOptions { overwrite: true, ..options() }).unwrap();
        let g = load_splats(&again).unwrap().splats;
        let (mean2, scale2, ..) = errors(&s, &g, &match_rows(&s, &g));
        assert!(mean2.iter().zip(mean).all(|(b, a)| *b <= 2.0 * a) && scale2 <= 2.0 * scale);
    }
}

#[test]
fn splat_files_stay_within_eight_bits() {
    let dir = tempdir().unwrap();
    let (a, b) = (dir.path().join("a.splat"), dir.path().join("b.splat"));
    let s = sample(0, 500);
    save_splats(&a, &s, &options()).unwrap();
    let t = load_splats(&a).unwrap().splats;
    let order: Vec<usize> = (0..s.len()).collect();
    let (mean, scale, rotation, colour) = errors(&s, &t, &order);
    assert_eq!(mean, [0.0; 3]);
    assert!(scale < 1e-5 && rotation < 1.0 && colour <= 0.5 / 255.0 + 1e-6, "{scale} {rotation} {colour}");
    save_splats(&b, &t, &options()).unwrap();
    let (a, b) = (std::fs::read(a).unwrap(), std::fs::read(b).unwrap());
    let off = a.chunks(32).zip(b.chunks(32)).filter(|(x, y)| x[..12] != y[..12] || x[24..28] != y[24..28]).count();
    assert_eq!(off, 0, "a second pass changed positions or colours");
}

#[test]
fn meshes_round_trip() {
    let dir = tempdir().unwrap();
    let path = dir.path().join("m.ply");
    let mesh = Mesh {
        positions: vec![[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        normals: vec![[0.0, 0.0, 1.0]; 4],
        colours: vec![[1.0, 0.0, 0.2]; 4],
        temperature: vec![300.0, 310.0, 320.0, 330.0],
        triangles: vec![[0, 1, 2], [0, 2, 3]],
    };
    write_mesh_ply(&path, &mesh, false).unwrap();
    assert_eq!(read_mesh_ply(&path).unwrap(), mesh);
    std::fs::write(
        &path,
        "ply\nformat ascii 1.0\nelement vertex 4\nproperty double x\nproperty double y\nproperty double z\nelement face 1\n\
         property uchar flags\nproperty list uchar int vertex_index\nend_header\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n9 4 0 1 2 3\n",
    )
    .unwrap();
    assert_eq!(read_mesh_ply(&path).unwrap().triangles, [[0, 1, 2], [0, 2, 3]]);
}

#[test]
fn nothing_is_overwritten_or_left_behind_unasked() {
    let dir = tempdir().unwrap();
    let path = dir.path().join("a.ply");
    let s = sample(0, 5);
    save_splats(&path, &s, &options()).unwrap();
    let before = std::fs::read(&path).unwrap();
    let e = save_splats(&path, &sample(0, 6), &options()).unwrap_err();
    assert!(matches!(e, FormatError::Exists { .. }), "{e}");
    assert_eq!(std::fs::read(&path).unwrap(), before);
    save_splats(&path, &sample(0, 6), &WriteOptions { overwrite: true, ..options() }).unwrap();
    assert_eq!(load_splats(&path).unwrap().splats.len(), 6);

    let full = dir.path().join("full.bin");
    let e = write_atomic(&full, false, |_| Err(std::io::ErrorKind::StorageFull.into())).unwrap_err();
    assert!(matches!(e, FormatError::DiskFull { .. }) && e.to_string().contains("disk is full"), "{e}");
    let e = write_atomic(dir.path().join("no/such/folder.bin"), false, |_| Ok(())).unwrap_err();
    assert!(e.to_string().contains("folder.bin") && e.to_string().contains("No such file") && !e.to_string().contains(".part"), "{e}");
    assert!(save_splats(dir.path().join("a.obj"), &s, &options()).is_err());
    let names: Vec<_> = std::fs::read_dir(dir.path()).unwrap().map(|f| f.unwrap().file_name()).collect();
    assert_eq!(names, ["a.ply"]);
}

#[test]
fn files_from_the_internet_load() {
    let cases = [
        ("splats/donut/donut.ply", 45_624, 0, [[-0.10, -0.09, 0.0], [0.10, 0.11, 0.08]], 0.02),
        ("splats/biker/biker.compressed.ply", 152_746, 0, [[-0.50, -3.11, -0.48], [0.31, -0.04, 0.54]], 0.15),
        ("splats/playbot/playbot_lod3.converted.ply", 31_000, 2, [[-1.0, -1.03, -1.0], [1.0, 0.01, 1.0]], 0.1),
    ];
    for (name, count, degree, bounds, slack) in cases {
        let Some(path) = shared(name) else { return };
        let f = load_splats(path).unwrap();
        assert_eq!((f.report.count, f.report.sh_degree, f.report.dropped_non_finite), (count, degree, 0), "{name}");
        let (lo, hi) = f.splats.bounds().unwrap();
        for k in 0..3 {
            assert!((lo[k] - bounds[0][k]).abs() < slack && (hi[k] - bounds[1][k]).abs() < slack, "{name} {lo:?} {hi:?}");
        }
        assert!(f.splats.rotation.iter().all(|q| quat::normalize(*q).is_some()));
    }
}

#[test]
fn the_same_three_gaussians_in_two_formats_agree() {
    let Some(ply) = shared("splats/fixtures/test-splat.3-points-from-train.ply") else { return };
    let (a, b) = (load_splats(&ply).unwrap().splats, load_splats(ply.with_extension("splat")).unwrap().splats);
    assert_eq!((a.sh_degree, b.sh_degree), (3, 0));
    let (mean, scale, rotation, colour) = errors(&a, &b, &[0, 1, 2]);
    assert_eq!(mean, [0.0; 3]);
    // The other program truncated to 8 bits.
    assert!(scale < 1e-5 && rotation < 1.5 && colour < 1.01 / 255.0, "{scale} {rotation} {colour}");
    let minimal = load_splats(ply.with_file_name("minimal.splat")).unwrap();
    assert_eq!(minimal.splats.len(), 4);
}

#[test]
fn ground_truth_meshes_are_closed() {
    let Some(path) = shared("synthetic_icecream/mesh/whole.ply") else { return };
    let m = read_mesh_ply(path).unwrap();
    let volume: f64 = m
        .triangles
        .iter()
        .map(|t| {
            let [a, b, c] = t.map(|i| m.positions[i as usize].map(f64::from));
            megas_math::vec3::dot(a, megas_math::vec3::cross(b, c)) / 6.0
        })
        .sum();
    assert!((volume - 1.2083).abs() < 1e-3, "{volume}");
}
