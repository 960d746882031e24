//! Triangle meshes as binary glTF 2.0 (`.glb`): one mesh, +Y up, colours in linear light as the format demands, the
//! temperature as the application-specific attribute `_TEMPERATURE`.

use std::{io::Write, path::Path};

use megas_math::{Mat3, mat3, vec3};
use megas_model::Mesh;

use crate::{
    atomic::write_atomic,
    error::{FormatError, Place, Result},
};

/// Component types of accessors.
const U16: u32 = 5123;
const U32: u32 = 5125;
const F32: u32 = 5126;
/// Targets of buffer views: vertices, indices.
const VERTICES: u32 = 34962;
const INDICES: u32 = 34963;

/// A proper rotation that turns `up` to +Y and keeps one horizontal axis where the two allow it: +Z up becomes the usual
/// `(x, z, −y)`.
fn to_y_up(up: [f32; 3]) -> Mat3<f32> {
    let y = vec3::normalize_or(up, [0.0, 0.0, 1.0]);
    let x = if y[0].abs() < 0.9 { [1.0, 0.0, 0.0] } else { [0.0, 0.0, 1.0] };
    let x = vec3::normalize_or(vec3::add_scaled(x, y, -vec3::dot(x, y)), [1.0, 0.0, 0.0]);
    [x, y, vec3::cross(x, y)]
}

/// Light of an sRGB value.
fn linear(v: f32) -> f32 {
    let v = v.clamp(0.0, 1.0);
    if v <= 0.04045 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) }
}

/// The document under construction: buffer views and accessors, one of each per array.
#[derive(Default)]
struct Document {
    bytes: Vec<u8>,
    views: Vec<String>,
    accessors: Vec<String>,
}

impl Document {
    /// Appends an array; returns the number of its accessor.
    fn add(&mut self, count: usize, target: u32, component: u32, kind: &str, more: &str, fill: impl FnOnce(&mut Vec<u8>)) -> usize {
        let from = self.bytes.len();
        fill(&mut self.bytes);
        let length = self.bytes.len() - from;
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
        self.views.push(format!(r#"{{"buffer":0,"byteOffset":{from},"byteLength":{length},"target":{target}}}"#));
        self.accessors.push(format!(
            r#"{{"bufferView":{},"componentType":{component},"count":{count},"type":"{kind}"{more}}}"#,
            self.views.len() - 1
        ));
        self.accessors.len() - 1
    }
}

fn put(out: &mut Vec<u8>, values: &[f32]) {
    values.iter().for_each(|v| out.extend_from_slice(&v.to_le_bytes()));
}

/// Writes a mesh, atomically, turned so that `up` (in the mesh's axes) points along +Y. The material is unlit
/// (`KHR_materials_unlit`): colours that come from photographs carry their light already. Viewers without that extension
/// see a rough dielectric.
pub fn write_mesh_glb(path: impl AsRef<Path>, mesh: &Mesh, up: [f32; 3], overwrite: bool) -> Result<()> {
    let path = path.as_ref();
    let n = mesh.positions.len();
    if n == 0 || mesh.triangles.is_empty() {
        return Err(FormatError::defect(path, Place::File, "a mesh without triangles", "at least one", "glTF cannot hold an empty mesh"));
    }
    let turn = to_y_up(up);
    let positions: Vec<[f32; 3]> = mesh.positions.iter().map(|p| mat3::mul_vec(turn, *p)).collect();
    let (low, high) = positions.iter().fold(([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]), |(l, h), p| (vec3::min(l, *p), vec3::max(h, *p)));
    let mut d = Document::default();
    let bounds = format!(r#","min":{low:?},"max":{high:?}"#);
    let indices = d.add(3 * mesh.triangles.len(), INDICES, U32, "SCALAR", "", |b| {
        mesh.triangles.as_flattened().iter().for_each(|i| b.extend_from_slice(&i.to_le_bytes()));
    });
    let position = d.add(n, VERTICES, F32, "VEC3", &bounds, |b| put(b, positions.as_flattened()));
    let mut attributes = format!(r#""POSITION":{position}"#);
    if mesh.normals.len() == n {
        let k = d.add(n, VERTICES, F32, "VEC3", "", |b| {
            for v in &mesh.normals {
                put(b, &vec3::normalize_or(mat3::mul_vec(turn, *v), [0.0, 1.0, 0.0]));
            }
        });
        attributes.push_str(&format!(r#","NORMAL":{k}"#));
    }
    if mesh.colours.len() == n {
        let k = d.add(n, VERTICES, U16, "VEC4", r#","normalized":true"#, |b| {
            for c in &mesh.colours {
                let [r, g, bl] = c.map(|v| (linear(v) * 65535.0 + 0.5) as u16);
                [r, g, bl, u16::MAX].iter().for_each(|v| b.extend_from_slice(&v.to_le_bytes()));
            }
        });
        attributes.push_str(&format!(r#","COLOR_0":{k}"#));
    }
    if mesh.temperature.len() == n {
        let k = d.add(n, VERTICES, F32, "SCALAR", "", |b| put(b, &mesh.temperature));
        attributes.push_str(&format!(r#","_TEMPERATURE":{k}"#));
    }
    let mut json = format!(
        concat!(
            r#"{{"asset":{{"version":"2.0","generator":"MeGAS {}"}},"scene":0,"scenes":[{{"nodes":[0]}}],"nodes":[{{"mesh":0}}],"#,
            r#""extensionsUsed":["KHR_materials_unlit"],"materials":[{{"pbrMetallicRoughness":{{"metallicFactor":0,"roughnessFactor":1}},"#,
            r#""extensions":{{"KHR_materials_unlit":{{}}}}}}],"meshes":[{{"primitives":[{{"attributes":{{{}}},"indices":{},"material":0}}]}}],"#,
            r#""buffers":[{{"byteLength":{}}}],"bufferViews":[{}],"accessors":[{}]}}"#
        ),
        env!("CARGO_PKG_VERSION"),
        attributes,
        indices,
        d.bytes.len(),
        d.views.join(","),
        d.accessors.join(","),
    )
    .into_bytes();
    json.resize(json.len().next_multiple_of(4), b' ');
    let total = 12 + 8 + json.len() + 8 + d.bytes.len();
    let Ok(total) = u32::try_from(total) else {
        let found = format!("{total} bytes");
        return Err(FormatError::defect(
            path,
            Place::File,
            found,
            "less than 4 GiB, the limit of .glb",
            "write .ply or choose larger voxels",
        ));
    };
    write_atomic(path, overwrite, |w| {
        w.write_all(b"glTF")?;
        w.write_all(&2u32.to_le_bytes())?;
        w.write_all(&total.to_le_bytes())?;
        w.write_all(&(json.len() as u32).to_le_bytes())?;
        w.write_all(b"JSON")?;
        w.write_all(&json)?;
        w.write_all(&(d.bytes.len() as u32).to_le_bytes())?;
        w.write_all(b"BIN\0")?;
        w.write_all(&d.bytes)
    })
}
