//! Broken and hostile files: an error in one line, in no time and without memory.
#![allow(missing_docs)]

mod common;

use std::{path::Path, sync::LazyLock};

use common::sample;
use megas_formats::{FormatError, WriteOptions, load_splats, read_mesh_ply, save_splats};
use proptest::prelude::*;
use tempfile::tempdir;

const ROW: [&str; 14] =
    ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"];

fn header(format: &str, count: u64, kind: &str, names: &[&str]) -> String {
    let mut s = format!("ply\nformat {format} 1.0\nelement vertex {count}\n");
    names.iter().for_each(|n| s.push_str(&format!("property {kind} {n}\n")));
    s + "end_header\n"
}

fn load(dir: &Path, name: &str, bytes: impl AsRef<[u8]>) -> Result<megas_formats::SplatFile, FormatError> {
    let path = dir.join(name);
    std::fs::write(&path, bytes).unwrap();
    let result = load_splats(&path);
    if let Err(e) = &result {
        let text = e.to_string();
        assert!(text.contains(name) && !text.contains('\n') && text.len() < 400, "{text}");
    }
    result
}

fn fails(dir: &Path, name: &str, bytes: impl AsRef<[u8]>, parts: &[&str]) {
    let text = load(dir, name, bytes).unwrap_err().to_string();
    for p in parts {
        assert!(text.contains(p), "'{p}' is not in: {text}");
    }
}

#[test]
fn faces_that_claim_long_lists_are_refused() {
    let dir = tempdir().unwrap();
    let path = dir.path().join("m.ply");
    let mut bytes = b"ply\nformat binary_little_endian 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n\
        element face 1\nproperty list uint double vertex_indices\nend_header\n"
        .to_vec();
    bytes.extend([0; 12]);
    bytes.extend(u32::MAX.to_le_bytes());
    bytes.extend([0; 24]);
    std::fs::write(&path, bytes).unwrap();
    let text = read_mesh_ply(&path).unwrap_err().to_string();
    assert!(text.contains("row 0 of element 'face'") && text.contains("4294967295 values claimed"), "{text}");
}

#[test]
fn every_truncation_is_an_error() {
    let dir = tempdir().unwrap();
    let s = sample(1, 300);
    for name in ["a.ply", "a.compressed.ply", "a.splat"] {
        let path = dir.path().join(name);
        save_splats(&path, &s, &WriteOptions::default()).unwrap();
        let whole = std::fs::read(&path).unwrap();
        let body = whole.windows(11).position(|w| w == b"end_header\n").map_or(0, |p| p + 11);
        let cuts = (0..body).chain((body..whole.len()).step_by(97)).chain(whole.len() - 40..whole.len());
        for cut in cuts.filter(|c| name != "a.splat" || c % 32 != 0 || *c == 0) {
            assert!(load(dir.path(), name, &whole[..cut]).is_err(), "{name} cut at {cut} of {}", whole.len());
        }
        assert_eq!(load(dir.path(), name, &whole).unwrap().splats.len(), 300);
    }
    fails(dir.path(), "t.ply", header("binary_little_endian", 10, "float", &ROW) + "few", &["element 'vertex'", "10 rows", "truncated"]);
}

#[test]
fn bad_rows_are_dropped_and_counted() {
    let dir = tempdir().unwrap();
    let good = "1 2 3  0.1 0.2 0.3  0.5  -3 -4 -5  1 0 0 0\n";
    let text = |rows: &[&str]| header("ascii", rows.len() as u64, "float", &ROW) + &rows.concat();
    let rows = [
        good,
        "nan 2 3  0.1 0.2 0.3  0.5  -3 -4 -5  1 0 0 0\n",
        "1 -inf 3  0.1 0.2 0.3  0.5  -3 -4 -5  1 0 0 0\n",
        "1 2 3  0.1 0.2 0.3  0.5  -3 inf -5  1 0 0 0\n",
        "1 2 3  0.1 0.2 0.3  0.5  -3 -4 -5  0 0 0 0\n",
        "1 2 3  0.1 0.2 0.3  0.5  -3 -4 -5  1 0 -nan(ind) 0\n",
        "1 2 3  0.1 0.2 0.3  nan  -3 -4 -5  1 0 0 0\n",
        "1 2 3  0.1 nan 0.3  0.5  -3 -4 -5  1 0 0 0\n",
        "1 2 3  0.1 0.2 0.3  inf  -inf -40 40  0 1e-30 0 0\n",
    ];
    let f = load(dir.path(), "a.ply", text(&rows)).unwrap();
    assert_eq!((f.report.rows, f.report.count, f.report.dropped_non_finite), (9, 2, 7));
    let s = f.splats;
    assert_eq!(s.mean, [[1.0, 2.0, 3.0]; 2]);
    assert_eq!((s.log_scale[1], s.rotation[1], s.opacity_logit[1]), ([-20.0, -20.0, 20.0], [0.0, 1.0, 0.0, 0.0], f32::INFINITY));
    assert_eq!(s.birth_id, [0, 1]);
    fails(dir.path(), "b.ply", text(&rows[1..8]), &["7 rows, none of them usable", "finite position"]);
    fails(dir.path(), "c.ply", text(&[]), &["no Gaussians"]);
    fails(dir.path(), "d.ply", text(&["1 2 3 0 0 0 0 0 0 0 one 0 0 0\n"]), &["line 19", "'one'", "'rot_0'"]);
    fails(dir.path(), "e.ply", text(&["1 2 3 0 0 0 0 0 0 0 1 0 0         \n"]), &["line 19", "end of the line", "'rot_3'"]);
}

#[test]
fn attributes_out_of_range_get_their_defaults() {
    let dir = tempdir().unwrap();
    let mut names = ROW.to_vec();
    names.extend(["temperature", "object_id", "phase", "origin", "normal_sign", "birth_id", "trained_pixel"]);
    let row = "1 2 3  0.1 0.2 0.3  0.5  -3 -4 -5  1 0 0 0 ";
    let text = header("ascii", 2, "double", &names) + row + "nan 70000 9 3 -5 77 -1\n" + row + "400 65535 3 2 -1 4294967295 0.01\n";
    let f = load(dir.path(), "a.ply", text).unwrap();
    let s = f.splats;
    assert_eq!(f.report.replaced_attributes, 6);
    assert_eq!((&s.temperature[..], &s.object_id[..], &s.phase[..]), (&[293.15, 400.0][..], &[0, 65535][..], &[0, 3][..]));
    assert_eq!((&s.origin[..], &s.normal_sign[..], &s.birth_id[..]), (&[0, 2][..], &[0, -1][..], &[77, u32::MAX][..]));
    assert_eq!(s.trained_pixel, [0.0, 0.01]);
}

#[test]
fn encodings_orders_and_types_agree() {
    let dir = tempdir().unwrap();
    let mut names = ROW.to_vec();
    names.reverse();
    let values: Vec<f64> = (0..14).map(|k| f64::from(k) * 0.25 - 1.0).collect();
    let ascii = header("ascii", 1, "double", &names) + &values.iter().map(|v| format!("{v} ")).collect::<String>();
    let a = load(dir.path(), "a.ply", ascii).unwrap().splats;
    for (format, big) in [("binary_little_endian", false), ("binary_big_endian", true)] {
        for kind in ["double", "float64", "float"] {
            let mut bytes = header(format, 1, kind, &names).replace('\n', "\r\n").into_bytes();
            for v in &values {
                match (kind, big) {
                    ("float", true) => bytes.extend((*v as f32).to_be_bytes()),
                    ("float", false) => bytes.extend((*v as f32).to_le_bytes()),
                    (_, true) => bytes.extend(v.to_be_bytes()),
                    (_, false) => bytes.extend(v.to_le_bytes()),
                }
            }
            assert_eq!(load(dir.path(), "b.ply", bytes).unwrap().splats, a, "{format} {kind}");
        }
    }
    assert_eq!(a.mean[0], [2.25, 2.0, 1.75]);
    assert_eq!(a.rotation[0], [-0.25, -0.5, -0.75, -1.0]);
}

#[test]
fn flat_gaussians_get_a_thickness_and_comments_are_honoured() {
    let dir = tempdir().unwrap();
    let flat: Vec<&str> = ROW.iter().copied().filter(|n| *n != "scale_2").collect();
    let f = load(dir.path(), "a.ply", header("ascii", 1, "float", &flat) + "1 2 3  0.1 0.2 0.3  0.5  -3 -4  1 0 0 0\n").unwrap();
    assert!((f.splats.log_scale[0][2] - (0.01f32 * (-4f32).exp()).ln()).abs() < 1e-5);
    assert_eq!(f.report.render_mode, megas_formats::RenderMode::Flat);
    let text = header("ascii", 1, "float", &ROW).replace("element", "comment antialiased 1\ncomment SplatRenderMode: default\nelement");
    let f = load(dir.path(), "b.ply", text + "1 2 3  0.1 0.2 0.3  0.5  -3 -4 -5  1 0 0 0\n").unwrap();
    assert!(f.report.antialiased && f.report.render_mode == megas_formats::RenderMode::Default);
}

#[test]
fn wrong_kinds_of_files_are_named() {
    let dir = tempdir().unwrap();
    let d = dir.path();
    fails(d, "a.ply", "", &["an empty file"]);
    fails(d, "b.ply", "plop", &["'plop'"]);
    fails(d, "b.spz", [0x1f, 0x8b, 8, 0], &["SPZ", "convert"]);
    fails(d, "c.splat", [0; 33], &["1 bytes after the last whole record"]);
    fails(d, "d.ply", header("ascii", 1, "float", &["x", "y", "z"]) + "1 2 3", &["'f_dc_0'", "point cloud"]);
    let mut names: Vec<String> = ROW.iter().map(|s| (*s).to_owned()).collect();
    names.extend((0..12).map(|k| format!("f_rest_{k}")));
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    fails(d, "e.ply", header("ascii", 1, "float", &names), &["f_rest_*", "12 properties", "0, 9, 24 or 45"]);
    fails(d, "f.ply", header("ascii", 1, "float16", &ROW), &["line 4", "'property float16 x'"]);
    fails(d, "g.ply", "ply\nformat ascii 1.0\n".to_owned() + &"comment x\n".repeat(20_000), &["end_header"]);
    fails(d, "h.ply", "ply\nformat ascii 1.0\n".to_owned() + &"\n".repeat(200_000), &["end_header"]);
    assert!(load_splats(d.join("missing.ply")).unwrap_err().to_string().contains("cannot open for reading"));
    assert!(load_splats(d).unwrap_err().to_string().contains("a folder"));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    /// Whatever the bytes, the answer is a value or an error.
    #[test]
    fn damaged_files_never_panic(kind in 0usize..3, edits in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6)) {
        let name = ["p.ply", "p.compressed.ply", "p.splat"][kind];
        static WHOLE: LazyLock<[Vec<u8>; 3]> = LazyLock::new(|| {
            let dir = tempdir().unwrap();
            ["p.ply", "p.compressed.ply", "p.splat"].map(|name| {
                save_splats(dir.path().join(name), &sample(1, 9), &WriteOptions::default()).unwrap();
                std::fs::read(dir.path().join(name)).unwrap()
            })
        });
        let dir = tempdir().unwrap();
        let mut bytes = WHOLE[kind].clone();
        for (at, value) in edits {
            // Half of the edits hit the header.
            let range = if value % 2 == 0 { bytes.len() } else { bytes.len().min(600) };
            bytes[at.index(range)] = value;
        }
        if let Ok(f) = load(dir.path(), name, &bytes) {
            prop_assert!(f.splats.mean.iter().flatten().all(|v| v.is_finite()));
        }
        let _ = read_mesh_ply(dir.path().join(name));
    }

    /// Headers made of the right words in any order.
    #[test]
    fn arbitrary_headers_never_panic(lines in prop::collection::vec(prop::sample::select(vec![
        "format ascii 1.0", "format binary_little_endian 1.0", "format binary_big_endian 1.0", "format", "comment", "element vertex 3",
        "element vertex 0", "element vertex 99999999999", "element face 2", "element chunk 1", "element vertex -1", "property float x",
        "property list uchar int vertex_indices", "property list float int v", "property uchar y", "property double z", "property",
        "property uint packed_position", "obj_info", "", "end_header", "1 2 3", "3 0 1 2", "\u{fffd}\0",
    ]), 0..24)) {
        let dir = tempdir().unwrap();
        let _ = load(dir.path(), "h.ply", format!("ply\n{}\n", lines.join("\n")));
        let _ = read_mesh_ply(dir.path().join("h.ply"));
    }
}
