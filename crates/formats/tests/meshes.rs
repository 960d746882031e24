//! Meshes in every format: round trips, broken files.
#![allow(missing_docs)]

mod common;

use common::Numbers;
use megas_formats::{MeshFormat, load_mesh, read_mesh_obj, save_mesh};
use megas_model::Mesh;
use proptest::prelude::*;
use serde_json::Value;
use tempfile::tempdir;

/// Vertices with every attribute; the colours are what eight bits hold.
fn sample(n: usize) -> Mesh {
    let mut r = Numbers(3);
    let mut m = Mesh::default();
    for k in 0..n {
        m.positions.push([r.within(-1.0, 2.0), r.within(5.0, 6.0), r.within(-1e-3, 1e-3)]);
        let v = [r.within(-1.0, 1.0), r.within(-1.0, 1.0), r.within(0.5, 1.0)];
        let l = v.iter().map(|c| c * c).sum::<f32>().sqrt();
        m.normals.push(v.map(|c| c / l));
        m.colours.push([0, 1, 2].map(|c| ((k * 7 + c * 91) % 256) as f32 / 255.0));
        m.temperature.push(250.0 + r.within(0.0, 1500.0));
    }
    m.triangles = (0..n as u32 - 2).map(|k| [k, k + 1, k + 2]).collect();
    m
}

#[test]
fn ply_and_obj_round_trip() {
    let dir = tempdir().unwrap();
    let m = sample(50);
    for format in [MeshFormat::Ply, MeshFormat::Obj] {
        let path = dir.path().join("m").with_extension(format.extension());
        save_mesh(&path, &m, [0.0, 0.0, 1.0], false).unwrap();
        let back = load_mesh(&path).unwrap();
        assert_eq!((&back.positions, &back.normals, &back.triangles), (&m.positions, &m.normals, &m.triangles));
        let tolerance = if format == MeshFormat::Ply { 0.0 } else { 5e-5 };
        assert!(back.colours.as_flattened().iter().zip(m.colours.as_flattened()).all(|(a, b)| (a - b).abs() <= tolerance));
        if format == MeshFormat::Ply {
            assert_eq!(back.temperature, m.temperature);
        }
        assert!(save_mesh(&path, &m, [0.0, 0.0, 1.0], false).unwrap_err().to_string().contains("already exists"));
    }
    assert!(save_mesh(dir.path().join("m.stl"), &m, [0.0; 3], false).unwrap_err().to_string().contains(".glb"));
    assert!(load_mesh(dir.path().join("m.glb")).is_err());
}

/// Values of accessor `k`, as floats.
fn accessor(json: &Value, bin: &[u8], k: &Value) -> Vec<f64> {
    let a = &json["accessors"][k.as_u64().unwrap() as usize];
    let v = &json["bufferViews"][a["bufferView"].as_u64().unwrap() as usize];
    let (from, length) = (v["byteOffset"].as_u64().unwrap() as usize, v["byteLength"].as_u64().unwrap() as usize);
    let width = match a["type"].as_str().unwrap() {
        "SCALAR" => 1,
        "VEC3" => 3,
        "VEC4" => 4,
        other => panic!("{other}"),
    };
    let bytes = &bin[from..from + length];
    let values: Vec<f64> = match a["componentType"].as_u64().unwrap() {
        5123 => bytes.as_chunks().0.iter().map(|b| f64::from(u16::from_le_bytes(*b)) / 65535.0).collect(),
        5125 => bytes.as_chunks().0.iter().map(|b| f64::from(u32::from_le_bytes(*b))).collect(),
        5126 => bytes.as_chunks().0.iter().map(|b| f64::from(f32::from_le_bytes(*b))).collect(),
        other => panic!("{other}"),
    };
    assert_eq!(values.len(), width * a["count"].as_u64().unwrap() as usize);
    values
}

#[test]
fn glb_files_hold_the_mesh_with_y_up() {
    let dir = tempdir().unwrap();
    let m = sample(41);
    // Where the axes of the mesh end up: +Z up is the usual (x, z, −y); −Y up turns around x.
    let cases: [([f32; 3], fn([f32; 3]) -> [f32; 3]); 3] =
        [([0.0, 0.0, 2.0], |p| [p[0], p[2], -p[1]]), ([0.0, 1.0, 0.0], |p| p), ([0.0, -1.0, 0.0], |p| [p[0], -p[1], -p[2]])];
    for (k, (up, turned)) in cases.into_iter().enumerate() {
        let path = dir.path().join(format!("{k}.glb"));
        save_mesh(&path, &m, up, false).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        let word = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
        assert_eq!((&bytes[..4], word(4), word(8)), (&b"glTF"[..], 2, bytes.len()));
        let length = word(12);
        assert_eq!(&bytes[16..20], b"JSON");
        let json: Value = serde_json::from_slice(&bytes[20..20 + length]).unwrap();
        let bin = &bytes[28 + length..];
        assert_eq!((word(20 + length), &bytes[24 + length..28 + length]), (bin.len(), &b"BIN\0"[..]));
        assert_eq!(json["buffers"][0]["byteLength"].as_u64().unwrap() as usize, bin.len());
        let primitive = &json["meshes"][0]["primitives"][0];
        let get = |name: &str| accessor(&json, bin, &primitive["attributes"][name]);
        let indices = accessor(&json, bin, &primitive["indices"]);
        assert!(indices.iter().zip(m.triangles.as_flattened()).all(|(a, b)| *a as u32 == *b));
        for (name, values) in [("POSITION", &m.positions), ("NORMAL", &m.normals)] {
            for (got, v) in get(name).chunks(3).zip(values) {
                assert!((0..3).all(|c| (got[c] - f64::from(turned(*v)[c])).abs() < 1e-6), "{name} {got:?} {v:?}");
            }
        }
        assert!(get("_TEMPERATURE").iter().zip(&m.temperature).all(|(a, b)| *a == f64::from(*b)));
        for (got, c) in get("COLOR_0").chunks(4).zip(&m.colours) {
            for k in 0..3 {
                let x = got[k];
                let srgb = if x <= 0.003_130_8 { 12.92 * x } else { 1.055 * x.powf(1.0 / 2.4) - 0.055 };
                assert!((srgb - f64::from(c[k])).abs() < 1e-3 && got[3] == 1.0);
            }
        }
        let a = &json["accessors"][primitive["attributes"]["POSITION"].as_u64().unwrap() as usize];
        let p = get("POSITION");
        for c in 0..3 {
            let least = p.iter().skip(c).step_by(3).copied().fold(f64::INFINITY, f64::min);
            assert!((a["min"][c].as_f64().unwrap() - least).abs() < 1e-6);
        }
    }
    assert!(save_mesh(dir.path().join("e.glb"), &Mesh::default(), [0.0; 3], false).is_err());
}

fn obj(text: &str) -> Result<Mesh, String> {
    let dir = tempdir().unwrap();
    let path = dir.path().join("hostile.obj");
    std::fs::write(&path, text).unwrap();
    read_mesh_obj(&path).map_err(|e| {
        let text = e.to_string();
        assert!(text.contains("hostile.obj") && !text.contains('\n') && text.len() < 400, "{text}");
        text
    })
}

#[test]
fn objs_of_other_programs_are_read() {
    let text = "# comment\nmtllib a.mtl\no thing\nv 0 0 0\nv 1 0 0 # tail\nv 1 1 0 1.0\nv 0 1 0\nvt 0 0\nvn 0 0 1\ng a\nusemtl m\ns off\n\
                f 1/1/1 2/1/1 \\\n3/1/1 4/1/1\r\nf -4 -3 -1\nl 1 2\n";
    let m = obj(text).unwrap();
    assert_eq!(m.triangles, [[0, 1, 2], [0, 2, 3], [0, 1, 3]]);
    assert_eq!((m.positions[2], m.normals.len(), m.colours.len()), ([1.0, 1.0, 0.0], 0, 0));
    let m = obj("v 0 0 0 1 0 0\nv 1 0 0 0 1 0\nv 0 1 0 0 0 1\nf 1 2 3").unwrap();
    assert_eq!(m.colours[1], [0.0, 1.0, 0.0]);
}

#[test]
fn broken_objs_say_where() {
    for (text, parts) in [
        ("", &["no vertices"][..]),
        ("v 0 0", &["line 1", "three coordinates"]),
        ("v 0 0 nan", &["line 1", "'nan'"]),
        ("v 0 0 0 1 1 1 1 1", &["line 1"]),
        ("v 0 0 0\nf 1 1 2", &["line 2", "'2'", "from 1 to 1"]),
        ("v 0 0 0\nf 0 1 1", &["line 2", "'0'"]),
        ("v 0 0 0\nf -2 1 1", &["line 2", "'-2'"]),
        ("v 0 0 0\nf 1 1", &["line 2", "three or more"]),
        ("v 0 0 0\nf 1 1 99999999999999999999", &["line 2"]),
        ("v 0 0 0\nvn 1 2", &["line 2", "vn X Y Z"]),
    ] {
        let message = obj(text).unwrap_err();
        assert!(parts.iter().all(|p| message.contains(p)), "{text:?}: {message}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]
    #[test]
    fn any_text_ends_in_a_mesh_or_an_error(text in "([vfn#\\\\ /.0-9e-]{0,12}\n){0,20}") {
        if let Ok(m) = obj(&text) {
            prop_assert!(m.triangles.as_flattened().iter().all(|i| (*i as usize) < m.positions.len()));
        }
    }
}
