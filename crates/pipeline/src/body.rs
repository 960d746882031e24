//! Stage one: from the input to bodies that can be simulated.

mod still;

use std::collections::HashMap;
use std::path::Path;

use megas_body::fill::{BottomCap, DensityField, Directions, FillMethod, FillSettings, TauAlpha};
use megas_body::orient::OrientSettings;
use megas_body::select::{Selection, robust_bounds};
use megas_body::volumes::{SplatMass, VolumeSettings};
use megas_body::{Body, BodySettings, Placement as BodyPlacement, build_body};
use megas_formats::{WriteOptions, load_splats, save_splats};
use megas_math::{mat3, vec3};
use megas_metrics::assets::{METRES_PER_UNIT, Part, Sprinkle, Sundae};
use megas_model::{Points, Similarity, Splats};
use megas_scene::{Auto, Filling, Object, OpenBottom, Placement, Scene, Select};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use crate::table::Table;
use crate::{Event, Failure, LoadedScene, Sink};

/// One simulated object.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct ObjectInfo {
    /// Name in the scene.
    pub name: String,
    /// Number in points and splats, from 1.
    pub number: u16,
    /// Height along +z \[m\].
    pub height_m: f64,
    /// Volume \[m³\].
    pub volume_m3: f64,
}

/// Everything the later stages need to know about the bodies.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct BodyMeta {
    /// Scene ↔ metres.
    pub similarity: Similarity,
    /// Box of all objects at rest \[m\].
    pub box_min: [f64; 3],
    /// Its other corner \[m\].
    pub box_max: [f64; 3],
    /// Height of the support plane \[m\].
    pub support_z: f64,
    /// Simulator cell \[m\].
    pub dx_m: f64,
    /// The splats are meant to be drawn anti-aliased.
    pub antialiased: bool,
    /// Objects in the order of the scene; the index is also the material's.
    pub objects: Vec<ObjectInfo>,
}

impl BodyMeta {
    /// What turns positions of the scene file into metres.
    pub fn placement(&self) -> Placement {
        Placement { similarity: self.similarity, box_min: self.box_min, box_max: self.box_max }
    }
}

/// The bodies of a scene. Points 0.. are the surface Gaussians, the internal particles follow.
pub struct Bodies {
    /// Facts.
    pub meta: BodyMeta,
    /// Surface Gaussians of all objects.
    pub surface: Splats,
    /// Colours of the internal particles.
    pub internal_rgb: Vec<[f32; 3]>,
    /// Static Gaussians.
    pub background: Splats,
    /// Material points.
    pub points: Points,
}

/// Objects of the embedded asset when the scene names none: every scoop melts, the sauce is chocolate, the rest stays firm.
pub fn asset_objects() -> Vec<Object> {
    let object = |name: &str, parts: &[&str], material: &str| Object {
        name: name.into(),
        parts: parts.iter().map(|p| (*p).to_owned()).collect(),
        material: material.into(),
        ..Object::default()
    };
    vec![
        object("ice-cream", &["strawberry", "pistachio", "vanilla"], "ice-cream"),
        object("sauce", &["sauce"], "milk-chocolate"),
        object("dry", &["bowl", "wafer", "cherry"], "elastic"),
    ]
}

/// The objects of a scene, with the asset's own where the scene has none.
pub fn scene_objects(scene: &Scene) -> Vec<Object> {
    if scene.objects.is_empty() && scene.input.asset.is_some() { asset_objects() } else { scene.objects_or_default() }
}

/// Builds the bodies of a scene, whose splats are in `file` unless they are embedded.
pub fn build(loaded: &LoadedScene, file: Option<&Path>, sink: &dyn Sink) -> Result<(Bodies, Value), Failure> {
    let scene = &loaded.scene;
    let objects = scene_objects(scene);
    if !scene.input.bodies.is_empty() {
        return still::build(loaded, &objects, sink);
    }
    match (file, &scene.input.asset) {
        (Some(file), _) => from_file(scene, file, &objects, sink),
        (None, Some(_)) => from_asset(scene, &objects, sink),
        (None, None) => Err(Failure::Input("the scene has no input: write `splat = \"file.ply\"` or `asset = \"ice-cream\"`".into())),
    }
}

fn from_file(scene: &Scene, path: &Path, objects: &[Object], sink: &dyn Sink) -> Result<(Bodies, Value), Failure> {
    let file = load_splats(path).map_err(|e| Failure::Input(e.to_string()))?;
    if file.report.dropped_non_finite > 0 {
        sink.event(Event::Warning(&format!("{}: {} broken rows left out", path.display(), file.report.dropped_non_finite)));
    }
    if objects.iter().any(|o| !o.parts.is_empty()) {
        return Err(Failure::Input("`parts` belong to embedded assets; use `select` for a splat file".into()));
    }
    let mut splats = file.splats;
    tame_highlights(&mut splats);
    let up = scene.input.up.0;
    let mut taken = vec![false; splats.len()];
    let mut masks = Vec::new();
    for o in objects {
        let selection = o.select.as_ref().map_or(Selection::All, |s| selection(s, up));
        let (mut mask, report) = megas_body::select::select(&splats, &selection);
        for (m, t) in mask.iter_mut().zip(&mut taken) {
            *m &= !*t;
            *t |= *m;
        }
        if !mask.contains(&true) {
            let tools: Vec<String> = report.tools.iter().map(|t| format!("{} keeps {}", t.tool, t.selected)).collect();
            return Err(Failure::Input(format!(
                "object '{}' selects none of the {} splats of {} ({}); widen the selection",
                o.name,
                splats.len(),
                path.display(),
                tools.join(", ")
            )));
        }
        masks.push(mask);
    }
    // The scale comes from the object that states its size, or from all of them together.
    let (size_m, sized) = scene.size_m();
    let rotation = Similarity::rotation_from_up(up);
    let reference = sized.map_or(&taken, |i| &masks[i]);
    let bounds = robust_bounds(&splats, reference, rotation)
        .filter(|b| b.longest() > 0.0 && b.longest().is_finite())
        .ok_or_else(|| Failure::Input(format!("{}: the selected splats have no extent", path.display())))?;
    let similarity = Similarity { metres_per_unit: size_m / bounds.longest(), rotation, origin: mat3::tmul_vec(rotation, bounds.center()) };
    let dx_m = size_m / f64::from(scene.cells());
    check_box(scene, &bounds, similarity.metres_per_unit)?;

    let mut bodies = Vec::new();
    for (k, o) in objects.iter().enumerate() {
        let mut chosen = splats.select(&indices(&masks[k], true));
        chosen.object_id.fill(k as u16 + 1);
        bodies.push(one_body(scene, o, k, &chosen, similarity, dx_m, Source::File { bottom: bounds.min[2] - bounds.center()[2] })?);
    }
    let background = splats.select(&indices(&taken, false));
    let material = |_: usize, _: [f64; 3], object: usize| object;
    let (mut bodies, figures) = finish(scene, objects, bodies, background, similarity, dx_m, &material, None, sink)?;
    bodies.meta.antialiased = file.report.antialiased;
    Ok((bodies, figures))
}

fn from_asset(scene: &Scene, objects: &[Object], sink: &dyn Sink) -> Result<(Bodies, Value), Failure> {
    let sundae = Sundae::new();
    let mut object_of_part: HashMap<u16, usize> = HashMap::new();
    for (k, o) in objects.iter().enumerate() {
        if o.select.is_some() {
            return Err(Failure::Input(format!("object '{}' uses `select`; objects of an asset are chosen by `parts`", o.name)));
        }
        for name in &o.parts {
            let part = Part::ALL.into_iter().find(|p| p.name() == name);
            let Some(part) = part.filter(|p| *p != Part::Table) else {
                let names: Vec<&str> = Part::ALL.iter().skip(1).map(|p| p.name()).collect();
                return Err(Failure::Input(format!(
                    "object '{}': the asset has no part '{name}'; its parts are {}",
                    o.name,
                    names.join(", ")
                )));
            };
            object_of_part.entry(part as u16).or_insert(k);
        }
    }
    if object_of_part.is_empty() {
        return Err(Failure::Input("no object of the scene names a part of the asset".into()));
    }
    let (size_m, _) = scene.size_m();
    let (lo, hi) = sundae.object_bounds();
    let longest = (0..3).map(|a| f64::from(hi[a] - lo[a])).fold(0.0, f64::max);
    let natural = f64::from(METRES_PER_UNIT) * longest;
    let size_m = if scene.objects.iter().any(|o| o.size_m.is_some()) { size_m } else { natural };
    // About six splats along a simulator cell: coarser ones open cracks, finer ones only cost time.
    let spacing = ((longest / f64::from(scene.cells())) as f32 * 0.152).clamp(0.0085, 0.02);
    let sprinkle = Sprinkle { spacing, seed: scene.seed.wrapping_add(1), ..Sprinkle::default() };
    let splats = sundae.sprinkle(&sprinkle);
    let simulated: Vec<bool> = splats.object_id.iter().map(|id| object_of_part.contains_key(id)).collect();
    let chosen = splats.select(&indices(&simulated, true));
    let background = splats.select(&indices(&simulated, false));
    let rotation = Similarity::rotation_from_up([0.0, 0.0, 1.0]);
    let origin = std::array::from_fn(|a| 0.5 * f64::from(lo[a] + hi[a]));
    let similarity = Similarity { metres_per_unit: size_m / longest, rotation, origin };
    let dx_m = size_m / f64::from(scene.cells());
    let part_of_birth: HashMap<u32, u16> = chosen.birth_id.iter().copied().zip(chosen.object_id.iter().copied()).collect();
    let mut body = one_body(scene, &objects[0], 0, &chosen, similarity, dx_m, Source::Asset)?;
    for (i, x) in body.internal.position.iter().enumerate() {
        body.internal.rgb[i] = sundae.interior_colour(*x);
    }
    let births = body.surface.birth_id.clone();
    let part_object = |i: usize, scene_position: [f64; 3], _: usize| {
        let part = match births.get(i).and_then(|b| part_of_birth.get(b)) {
            Some(part) => *part,
            None => sundae.part(scene_position.map(|v| v as f32)) as u16,
        };
        // The nearest simulated part takes what lies in a part that is not simulated.
        object_of_part.get(&part).copied().unwrap_or(0)
    };
    let floor = similarity.to_si([0.0, 0.0, f64::from(megas_metrics::assets::TABLE_HEIGHT)])[2];
    let (mut bodies, figures) = finish(scene, objects, vec![body], background, similarity, dx_m, &part_object, Some(floor), sink)?;
    bodies.meta.antialiased = true;
    Ok((bodies, figures))
}

fn indices(mask: &[bool], flag: bool) -> Vec<usize> {
    (0..mask.len()).filter(|&i| mask[i] == flag).collect()
}

/// Refuses an object that does not fit the box that the scene asks for.
fn check_box(scene: &Scene, bounds: &megas_body::select::RobustBox, metres_per_unit: f64) -> Result<(), Failure> {
    let Some(room) = scene.simulation.box_m else { return Ok(()) };
    for a in 0..3 {
        let size = (bounds.max[a] - bounds.min[a]) * metres_per_unit;
        if size > room[a] {
            return Err(Failure::Input(format!(
                "the objects are {size:.3} m along {}, more than simulation.box_m = {:?} allows; enlarge the box or reduce size_m",
                ["x", "y", "z"][a],
                room
            )));
        }
    }
    Ok(())
}

/// Splats of a file that no view sees with at least this blend weight are left out: hidden now, they would come to light as
/// specks when the surface opens (splatting.md §5.6).
const PRUNE_BELOW: f32 = 0.06;

/// Largest base colour kept. Trained models make highlights of faint splats that are many times brighter than white; carried
/// away from what covers them, they glow.
const BRIGHTEST: f32 = 1.1;

/// Cuts colours beyond [`BRIGHTEST`] in the first coefficient.
fn tame_highlights(splats: &mut Splats) {
    let (stride, most) = (splats.sh_stride(), megas_math::sh::dc_from_rgb(BRIGHTEST));
    for c in splats.sh.chunks_exact_mut(stride) {
        for dc in &mut c[..3] {
            *dc = dc.min(most);
        }
    }
}

/// Where splats come from.
#[derive(Clone, Copy)]
enum Source {
    /// A file; the lowest height of the objects in the filling frame.
    File { bottom: f64 },
    /// The embedded asset or procedural bodies, whose every splat is known to lie on the surface.
    Asset,
}

fn one_body(
    scene: &Scene,
    object: &Object,
    index: usize,
    splats: &Splats,
    similarity: Similarity,
    dx_m: f64,
    source: Source,
) -> Result<Body, Failure> {
    let f = &scene.fill;
    let bottom = match source {
        Source::File { bottom } => Some(bottom),
        Source::Asset => None,
    };
    let settings = BodySettings {
        selection: Selection::All,
        placement: BodyPlacement::Given { similarity, dx_m },
        object: index as u16 + 1,
        material: index as u8,
        temperature_k: None,
        first_id: 0,
        prune_below: match source {
            Source::Asset => None,
            Source::File { .. } => Some(PRUNE_BELOW),
        },
        split: None,
        orient: OrientSettings { views: f.normal_views.next_multiple_of(2).max(16) as usize, ..OrientSettings::default() },
        fill: FillSettings {
            method: match object.filling {
                Filling::Rays => FillMethod::Rays,
                Filling::DensityField => FillMethod::DensityField(DensityField::default()),
            },
            tau_alpha: match f.tau_alpha {
                Auto::Auto => TauAlpha::Auto,
                Auto::Value(v) => TauAlpha::Fixed(v as f32),
            },
            directions: if f.directions == 14 { Directions::AxesAndDiagonals } else { Directions::Axes },
            cap: match f.open_bottom {
                OpenBottom::Auto => BottomCap::Auto,
                OpenBottom::Cap => bottom.map_or(BottomCap::Auto, BottomCap::At),
                OpenBottom::Open => BottomCap::Off,
            },
            ..FillSettings::default()
        },
        volumes: VolumeSettings {
            jitter: f.jitter,
            splat_mass: match f.tracers {
                None => SplatMass::Auto,
                Some(true) => SplatMass::Never,
                Some(false) => SplatMass::Always,
            },
            ..VolumeSettings::default()
        },
        patch: scene.skin.patch_background,
        seed: scene.seed,
    };
    build_body(splats, &settings).map_err(|e| Failure::Input(format!("object '{}': {e}", object.name)))
}

/// Leaves out surface Gaussians that have no material near them: nothing would carry them, they would hang in the air.
fn without_loose(mut body: Body) -> Body {
    if body.loose.is_empty() {
        return body;
    }
    let n = body.surface.len();
    let mut keep = vec![true; body.points.len()];
    body.loose.iter().for_each(|&i| keep[i as usize] = false);
    let surface: Vec<usize> = (0..n).filter(|&i| keep[i]).collect();
    body.surface = body.surface.select(&surface);
    fn thin<T: Copy>(v: &mut Vec<T>, keep: &[bool]) {
        let mut k = keep.iter();
        v.retain(|_| k.next().copied().unwrap_or(true));
    }
    let p = &mut body.points;
    thin(&mut p.position, &keep);
    thin(&mut p.volume, &keep);
    thin(&mut p.temperature, &keep);
    thin(&mut p.normal, &keep);
    thin(&mut p.material, &keep);
    thin(&mut p.object, &keep);
    thin(&mut p.flags, &keep);
    thin(&mut p.id, &keep);
    body
}

/// Joins the bodies: all surfaces first, then all insides; objects, materials and temperatures per point.
fn finish(
    scene: &Scene,
    objects: &[Object],
    bodies: Vec<Body>,
    background: Splats,
    similarity: Similarity,
    dx_m: f64,
    object_of: &dyn Fn(usize, [f64; 3], usize) -> usize,
    floor: Option<f64>,
    sink: &dyn Sink,
) -> Result<(Bodies, Value), Failure> {
    let mut out = Bodies {
        meta: BodyMeta {
            similarity,
            box_min: [f64::INFINITY; 3],
            box_max: [f64::NEG_INFINITY; 3],
            support_z: 0.0,
            dx_m,
            antialiased: false,
            objects: Vec::new(),
        },
        surface: Splats { sh_degree: bodies.iter().map(|b| b.surface.sh_degree).max().unwrap_or(0), ..Splats::default() },
        internal_rgb: Vec::new(),
        background,
        points: Points::default(),
    };
    let mut reports = Vec::new();
    let bodies: Vec<Body> = bodies.into_iter().map(without_loose).collect();
    for (k, body) in bodies.iter().enumerate() {
        for warning in &body.report.warnings {
            sink.event(Event::Warning(&format!("{}: {warning}", objects[k].name)));
        }
        let r = &body.report;
        reports.push(json!({
            "selected": r.selection.selected, "unseen": r.unseen, "surface": r.counts[0], "internal": r.counts[1],
            "volume_m3": r.volume_m3, "opposing_normals": r.orient.inconsistent, "tau_alpha": r.fill.tau_alpha,
            "tracers": r.volumes.tracers, "loose": body.loose.len(), "volume_ratio_max_to_median": r.volumes.max / r.volumes.median,
        }));
        out.background.append(&body.background);
    }
    for inside in [false, true] {
        for (k, body) in bodies.iter().enumerate() {
            let n = body.surface.len();
            let range = if inside { n..body.points.len() } else { 0..n };
            for i in range {
                let x = body.points.position[i];
                let object = object_of(i, similarity.to_scene(x), k);
                out.points.position.push(x);
                out.points.volume.push(body.points.volume[i]);
                out.points.normal.push(body.points.normal[i]);
                out.points.flags.push(body.points.flags[i]);
                out.points.temperature.push(body.points.temperature[i]);
                out.points.object.push(object as u16 + 1);
                out.points.material.push(object as u8);
                if inside {
                    out.internal_rgb.push(body.internal.rgb[i - n]);
                }
            }
            if !inside {
                out.surface.append(&body.surface);
            }
        }
    }
    let n = out.points.len();
    out.points.id = (0..n as u32).collect();
    let surface = out.surface.len();
    out.surface.object_id.copy_from_slice(&out.points.object[..surface]);
    measure(&mut out, objects, floor)?;
    start_temperatures(scene, objects, &mut out)?;
    let figures = json!({
        "objects": out.meta.objects, "surface": surface, "internal": n - surface, "background": out.background.len(), "bodies": reports,
    });
    Ok((out, figures))
}

/// Box, support plane, heights and volumes.
fn measure(out: &mut Bodies, objects: &[Object], floor: Option<f64>) -> Result<(), Failure> {
    let quantile = |values: &mut Vec<f64>, q: f64| {
        let k = ((values.len() - 1) as f64 * q).round() as usize;
        *values.select_nth_unstable_by(k, f64::total_cmp).1
    };
    let n = out.surface.len();
    for a in 0..3 {
        let mut v: Vec<f64> = out.points.position[..n].iter().map(|x| x[a]).collect();
        out.meta.box_min[a] = quantile(&mut v, 0.005);
        out.meta.box_max[a] = quantile(&mut v, 0.995);
    }
    out.meta.support_z = floor.unwrap_or(out.meta.box_min[2]);
    for (k, o) in objects.iter().enumerate() {
        let number = k as u16 + 1;
        let mine: Vec<usize> = (0..out.points.len()).filter(|&i| out.points.object[i] == number).collect();
        if mine.is_empty() {
            return Err(Failure::Input(format!(
                "object '{}' has no material points; it is hidden inside other objects or too thin",
                o.name
            )));
        }
        let mut z: Vec<f64> = mine.iter().map(|&i| out.points.position[i][2]).collect();
        let height_m = (quantile(&mut z, 0.995) - quantile(&mut z, 0.005)).max(out.meta.dx_m);
        let volume_m3 = mine.iter().map(|&i| f64::from(out.points.volume[i])).sum();
        out.meta.objects.push(ObjectInfo { name: o.name.clone(), number, height_m, volume_m3 });
    }
    Ok(())
}

/// Initial temperatures: the object's own, the file's, or `min(ambient, solidus − 10 K)` (simulation.md §1.1).
fn start_temperatures(scene: &Scene, objects: &[Object], out: &mut Bodies) -> Result<(), Failure> {
    let height = total_height(&out.meta);
    for (k, o) in objects.iter().enumerate() {
        let material = crate::convert::resolve_material(scene, o, height)?;
        let start =
            o.initial_temperature_c.map_or(material.initial_temperature_k(scene.ambient_k()), |c| c + megas_scene::CELSIUS_K) as f32;
        for i in 0..out.points.len() {
            if out.points.object[i] == k as u16 + 1 {
                out.points.temperature[i] = start;
            }
        }
    }
    Ok(())
}

/// Height of everything that stands on the support: what stiffness must carry.
pub fn total_height(meta: &BodyMeta) -> f64 {
    (meta.box_max[2] - meta.box_min[2]).max(meta.dx_m)
}

/// The scene's selection in the words of the body crate (scene.toml applies filters, then the support plane, then components).
pub fn selection(s: &Select, up: [f64; 3]) -> Selection {
    let f = |v: [f64; 3]| v.map(|c| c as f32);
    let mut parts = Vec::new();
    if let Some(b) = &s.in_box {
        let (center, half, axes) = b.oriented();
        parts.push(Selection::Box { center: f(center), half: f(half), rotation: megas_math::quat::from_mat3(axes).map(|v| v as f32) });
    }
    if let Some(b) = &s.sphere {
        parts.push(Selection::Sphere { center: f(b.center), radius: b.radius as f32 });
    }
    if let Some(t) = &s.cylinder {
        parts.push(Selection::Cylinder { start: f(t.from), end: f(t.to), radius: t.radius as f32 });
    }
    if let Some(h) = &s.half_space {
        parts.push(Selection::HalfSpace { point: f(h.point), normal: f(h.direction) });
    }
    if let Some(o) = s.min_opacity {
        parts.push(Selection::OpacityAbove(o as f32));
    }
    if let Some(m) = s.max_scale {
        parts.push(Selection::ScaleBelow(m as f32));
    }
    parts.extend(s.all.iter().map(|p| selection(p, up)));
    if !s.any.is_empty() {
        parts.push(Selection::Or(s.any.iter().map(|p| selection(p, up)).collect()));
    }
    if let Some(n) = &s.not {
        parts.push(Selection::Not(Box::new(selection(n, up))));
    }
    let mut out = Selection::And(parts);
    if s.above_support_plane {
        out = Selection::AboveSupport { of: Box::new(out), up: f(vec3::normalize_or(up, [0.0, 0.0, 1.0])), seed: 1 };
    }
    if s.seed.is_some() || s.largest_component {
        out = Selection::Component { of: Box::new(out), seed: s.seed.map(f), cell: None };
    }
    out
}

impl Bodies {
    /// Writes the stage's files.
    pub fn write(&self, folder: &Path) -> Result<(), Failure> {
        let options = WriteOptions { overwrite: true, ..WriteOptions::default() };
        let save = |name: &str, s: &Splats| save_splats(folder.join(name), s, &options).map_err(|e| Failure::Input(e.to_string()));
        save("surface.ply", &self.surface)?;
        if !self.background.is_empty() {
            save("background.ply", &self.background)?;
        }
        let p = &self.points;
        let meta = serde_json::to_value(&self.meta).map_err(|e| Failure::Other(e.to_string()))?;
        let mut t = Table::new(json!({"meta": meta, "points": p.len(), "internal": self.internal_rgb.len()}));
        t.push("position", &p.position);
        t.push("volume", &p.volume);
        t.push("temperature", &p.temperature);
        t.push("normal", &p.normal);
        t.push("material", &p.material);
        t.push("object", &p.object);
        t.push("flags", &p.flags);
        t.push("id", &p.id);
        t.push("internal_rgb", &self.internal_rgb);
        t.write(&folder.join("points.bin"))
    }

    /// Reads the stage's files back.
    pub fn read(folder: &Path) -> Result<Self, Failure> {
        let path = folder.join("points.bin");
        let mut t = Table::read(&path)?;
        let bad = |e: String| Failure::Input(format!("{}: {e}; use --force to compute it again", path.display()));
        let meta: BodyMeta = serde_json::from_value(t.meta["meta"].take()).map_err(|e| bad(e.to_string()))?;
        let n = t.meta["points"].as_u64().unwrap_or(0) as usize;
        let internal = t.meta["internal"].as_u64().unwrap_or(0) as usize;
        let points = Points {
            position: t.take_rows("position", n).map_err(bad)?,
            volume: t.take_rows("volume", n).map_err(bad)?,
            temperature: t.take_rows("temperature", n).map_err(bad)?,
            normal: t.take_rows("normal", n).map_err(bad)?,
            material: t.take_rows("material", n).map_err(bad)?,
            object: t.take_rows("object", n).map_err(bad)?,
            flags: t.take_rows("flags", n).map_err(bad)?,
            id: t.take_rows("id", n).map_err(bad)?,
        };
        let internal_rgb = t.take_rows("internal_rgb", internal).map_err(bad)?;
        let load = |name: &str| load_splats(folder.join(name)).map(|f| f.splats).map_err(|e| Failure::Input(e.to_string()));
        let surface = load("surface.ply")?;
        if surface.len() + internal != n {
            return Err(bad(format!("{} surface splats and {internal} internal points do not make {n} points", surface.len())));
        }
        let background = if folder.join("background.ply").exists() { load("background.ply")? } else { Splats::default() };
        Ok(Self { meta, surface, internal_rgb, background, points })
    }
}
