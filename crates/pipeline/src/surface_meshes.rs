//! Closed, coloured meshes of the simulated objects, one file per frame, with their volumes (splatting.md §7.7).

use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::{Path, PathBuf};

use megas_film::MeshSequence;
use megas_formats::MeshFormat;
use megas_math::vec3;
use megas_model::{FLAG_ESCAPED, Mesh, PointFrame};
use megas_scene::{MeshKind, Scene};
use megas_skin::imls::{Imls, ImlsSettings, Samples};
use megas_skin::mesh::attributes::{Carriers, colour, temperature};
use megas_skin::mesh::{MeshSettings, Surface, body_mesh};
use serde_json::{Value, json};

use crate::Failure;
use crate::body::Bodies;
use crate::disk::write_text;
use crate::skin::depth;

/// What was measured on the mesh of a frame, SI.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Measure {
    volume_m3: f64,
    area_m2: f64,
    triangles: usize,
}

/// The meshes of a run.
pub struct SurfaceMeshes {
    sequence: MeshSequence,
    every: u64,
    settings: MeshSettings,
    depth: f32,
    table: PathBuf,
    measures: BTreeMap<u64, Measure>,
}

impl SurfaceMeshes {
    /// `None` where the scene asks for no meshes. Measures of frames that are already there are read back.
    pub fn create(scene: &Scene, bodies: &Bodies, out: &Path) -> Result<Option<Self>, Failure> {
        let o = &scene.output;
        if o.mesh.is_empty() {
            return Ok(None);
        }
        let m = &bodies.meta;
        let formats: Vec<MeshFormat> = o.mesh.iter().map(|k| format_of(*k)).collect();
        let up = vec3::cast::<f64, f32>(m.similarity.direction_to_scene([0.0, 0.0, 1.0]));
        let folder = out.join("meshes");
        let sequence = MeshSequence::create(&folder, &formats, up).map_err(|e| Failure::Input(e.to_string()))?;
        let mut settings = mesh_settings(bodies);
        settings.voxel = (settings.voxel * o.mesh_voxel).min(2.0 * settings.spacing);
        let table = folder.join("measures.csv");
        let measures = read_table(&table);
        let depth = depth(scene, bodies) as f32;
        Ok(Some(Self { sequence, every: u64::from(o.mesh_every.max(1)), settings, depth, table, measures }))
    }

    /// Whether frame `k` is still to be written.
    pub fn wants(&self, k: u64) -> bool {
        k.is_multiple_of(self.every) && !(self.sequence.has(k as u32) && self.measures.contains_key(&k))
    }

    /// Makes and writes the mesh of frame `k`.
    pub fn write(&mut self, k: u64, bodies: &Bodies, frame: &PointFrame) -> Result<(), Failure> {
        let mut whole = Mesh::default();
        let unit = bodies.meta.similarity.metres_per_unit;
        let mut measure = Measure { volume_m3: 0.0, area_m2: 0.0, triangles: 0 };
        for o in &bodies.meta.objects {
            let mesh = object_mesh(bodies, frame, o.number, &self.settings, Some(self.depth));
            let s = Surface::of(&mesh);
            measure.volume_m3 += s.volume * unit.powi(3);
            measure.area_m2 += s.area * unit.powi(2);
            append(&mut whole, mesh);
        }
        measure.triangles = whole.triangles.len();
        // Everything has left: an empty frame has no file, and says so in the table.
        if !whole.triangles.is_empty() {
            self.sequence.write(k as u32, &whole).map_err(|e| Failure::Input(e.to_string()))?;
        }
        self.measures.insert(k, measure);
        let mut text = String::from("frame,volume_m3,area_m2,triangles\n");
        for (k, m) in &self.measures {
            let _ = writeln!(text, "{k},{:e},{:e},{}", m.volume_m3, m.area_m2, m.triangles);
        }
        write_text(&self.table, &text)
    }

    /// Figures for the result: how far the volume strays from that of the first mesh, a check of the physics.
    pub fn figures(&self) -> Value {
        let first = self.measures.values().next().map_or(0.0, |m| m.volume_m3);
        let ratio = |m: &Measure| if first > 0.0 { m.volume_m3 / first } else { 0.0 };
        let ratios: Vec<f64> = self.measures.values().map(ratio).collect();
        json!({
            "files": self.measures.len(),
            "volume_first_m3": first,
            "volume_last_ratio": ratios.last(),
            "volume_least_ratio": ratios.iter().copied().fold(f64::INFINITY, f64::min),
            "volume_most_ratio": ratios.iter().copied().fold(0.0, f64::max),
            "measures": self.table.display().to_string(),
        })
    }
}

fn format_of(kind: MeshKind) -> MeshFormat {
    match kind {
        MeshKind::Ply => MeshFormat::Ply,
        MeshKind::Obj => MeshFormat::Obj,
        MeshKind::Glb => MeshFormat::Glb,
    }
}

/// Rows that cannot be read are measured again.
fn read_table(path: &Path) -> BTreeMap<u64, Measure> {
    let text = std::fs::read_to_string(path).unwrap_or_default();
    let row = |line: &str| {
        let mut f = line.split(',');
        let k = f.next()?.parse().ok()?;
        let (v, a, t) = (f.next()?.parse().ok()?, f.next()?.parse().ok()?, f.next()?.parse().ok()?);
        Some((k, Measure { volume_m3: v, area_m2: a, triangles: t }))
    };
    text.lines().filter_map(row).collect()
}

fn append(whole: &mut Mesh, part: Mesh) {
    let base = whole.positions.len() as u32;
    whole.positions.extend(part.positions);
    whole.normals.extend(part.normals);
    whole.colours.extend(part.colours);
    whole.temperature.extend(part.temperature);
    whole.triangles.extend(part.triangles.iter().map(|t| t.map(|i| i + base)));
}

/// Voxels of films' meshes.
fn mesh_settings(bodies: &Bodies) -> MeshSettings {
    let m = &bodies.meta;
    let unit = m.similarity.metres_per_unit;
    let size: [f64; 3] = std::array::from_fn(|a| m.box_max[a] - m.box_min[a]);
    MeshSettings::new(0.5 * m.dx_m / unit, vec3::norm(size) / unit)
}

/// The meshes of all objects in one, for pictures. Without `skin` they are those of the particles alone.
pub fn whole_mesh(scene: &Scene, bodies: &Bodies, frame: &PointFrame, skin: bool) -> Mesh {
    let settings = mesh_settings(bodies);
    let skin = skin.then(|| depth(scene, bodies) as f32);
    let mut whole = Mesh::default();
    for o in &bodies.meta.objects {
        append(&mut whole, object_mesh(bodies, frame, o.number, &settings, skin));
    }
    whole
}

/// The mesh of one object: its particles close it, and with `skin` (how deep they lie below the surface) the oriented splats shape it
/// where they are dense enough.
fn object_mesh(bodies: &Bodies, frame: &PointFrame, number: u16, settings: &MeshSettings, skin: Option<f32>) -> Mesh {
    let n = bodies.surface.len();
    let similarity = &bodies.meta.similarity;
    let mine = |i: &usize| bodies.points.object[*i] == number && frame.flags[*i] & FLAG_ESCAPED == 0;
    let place = |i: usize| vec3::cast::<f64, f32>(similarity.to_scene(frame.position[i].map(f64::from)));
    let outer: Vec<usize> = (0..n).filter(mine).collect();
    let core: Vec<usize> = (n..frame.position.len()).filter(mine).collect();
    let skin_at: Vec<[f32; 3]> = outer.iter().map(|i| place(*i)).collect();
    let core_at: Vec<[f32; 3]> = core.iter().map(|i| place(*i)).collect();
    let normal = outer.iter().map(|i| vec3::cast(similarity.direction_to_scene(frame.normal[*i].map(f64::from)))).collect();
    let samples = Samples { position: skin_at.clone(), normal, weight: Vec::new() };
    let imls = skin.and_then(|depth| Imls::new(&samples.raised(depth), &ImlsSettings::default()));
    let mut mesh = body_mesh(&core_at, imls.as_ref(), settings);
    let spacing = settings.spacing as f32;
    let rgb = |i: &usize| bodies.surface.seen_rgb(*i).map(|v| v.clamp(0.0, 1.0));
    let skin_rgb: Vec<[f32; 3]> = outer.iter().map(rgb).collect();
    let core_rgb: Vec<[f32; 3]> = core.iter().map(|i| bodies.internal_rgb[*i - n]).collect();
    colour(&mut mesh, Carriers { position: &skin_at, value: &skin_rgb }, Carriers { position: &core_at, value: &core_rgb }, spacing);
    let all: Vec<[f32; 3]> = core_at.iter().chain(&skin_at).copied().collect();
    let kelvin: Vec<f32> = core.iter().chain(&outer).map(|i| frame.temperature[*i]).collect();
    temperature(&mut mesh, Carriers { position: &all, value: &kelvin }, spacing);
    mesh
}
