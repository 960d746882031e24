//! What no schema can say: references, exclusive keys, orders in time, contradictions of materials.

use crate::camera::Camera;
use crate::check::Step;
use crate::collider::{Collider, ColliderShape};
use crate::diagnostic::suggestion;
use crate::heat::{Heat, HeatKind, MotionKey, Region};
use crate::object::{Object, Select};
use crate::presets::material_presets;
use crate::scene::Scene;
use crate::shape::{BoxShape, MeshShape, Tube};
use crate::still::BodyForm;

/// Most thin colliders of a scene.
const MAX_THIN: usize = 16;

/// Something wrong, and where.
pub(crate) struct Problem {
    pub(crate) path: Vec<Step>,
    pub(crate) message: String,
}

/// Collects problems below a path.
struct Report {
    path: Vec<Step>,
    problems: Vec<Problem>,
}

impl Report {
    fn say(&mut self, key: &str, message: impl Into<String>) {
        let mut path = self.path.clone();
        if !key.is_empty() {
            path.extend(key.split('.').map(|k| Step::Key(k.into())));
        }
        self.problems.push(Problem { path, message: message.into() });
    }

    fn inside(&mut self, key: &str, index: Option<usize>, check: impl FnOnce(&mut Self)) {
        let depth = self.path.len();
        self.path.push(Step::Key(key.into()));
        self.path.extend(index.map(Step::Index));
        check(self);
        self.path.truncate(depth);
    }
}

/// All problems of a scene that fits the schema.
pub(crate) fn problems(scene: &Scene) -> Vec<Problem> {
    let mut r = Report { path: Vec::new(), problems: Vec::new() };
    input(scene, &mut r);
    objects(scene, &mut r);
    materials(scene, &mut r);
    for (i, h) in scene.heat.iter().flatten().enumerate() {
        r.inside("heat", Some(i), |r| heat(scene, h, r));
    }
    for (i, c) in scene.colliders.iter().enumerate() {
        r.inside("collider", Some(i), |r| collider(c, r));
        if c.thin && scene.colliders[..i].iter().filter(|c| c.thin).count() == MAX_THIN {
            r.inside("collider", Some(i), |r| {
                r.say("thin", format!("collider.thin: at most {MAX_THIN} colliders can be thin; join meshes"))
            });
        }
    }
    for (i, c) in scene.cameras.iter().enumerate() {
        r.inside("camera", Some(i), |r| camera(c, r));
    }
    unique(scene.cameras.iter().map(|c| c.name.as_str()), "camera", &mut r);
    time_and_space(scene, &mut r);
    output(scene, &mut r);
    r.problems
}

fn input(scene: &Scene, r: &mut Report) {
    let i = &scene.input;
    let sources = [("splat", &i.splat), ("capture", &i.capture), ("asset", &i.asset)];
    let given: Vec<&str> = sources.iter().filter(|s| s.1.is_some()).map(|s| s.0).collect();
    match given[..] {
        [] if !i.bodies.is_empty() => {}
        [] => r.say("input", "input: give splat = \"file.ply\", capture = \"photographs\", asset = \"ice-cream\" or [[input.body]]"),
        [other, ..] if !i.bodies.is_empty() => {
            r.inside("input", None, |r| r.say(other, format!("input: give either {other} or [[input.body]], not both")));
        }
        [_] => {}
        [.., last] => {
            r.inside("input", None, |r| r.say(last, "input: give one of splat (a file), capture (photographs) and asset (embedded)"));
        }
    }
    for (key, value) in sources {
        if value.as_ref().is_some_and(String::is_empty) {
            r.inside("input", None, |r| r.say(key, format!("input.{key} is empty")));
        }
    }
    if i.reconstruct.is_some() && i.capture.is_none() {
        r.say("input.reconstruct", "input.reconstruct says how to train on photographs; it needs capture = \"folder\"");
    }
    if i.finetuning().is_some() && i.splat.is_none() {
        r.say("input.finetune", "input.finetune is for a splat file (splat = \"file.ply\"); other inputs need none");
    }
    if let Some(b) = i.reconstruct.as_ref().and_then(|t| t.object_box.as_ref()) {
        r.inside("input", None, |r| r.inside("reconstruct", None, |r| r.inside("object_box", None, |r| boxed(b, r))));
    }
    if i.table.is_some() && i.bodies.is_empty() {
        r.say("input.table", "input.table stands under procedural bodies; it needs [[input.body]]");
    }
    bodies(scene, r);
    direction(i.up.0, "input.up", r);
}

fn bodies(scene: &Scene, r: &mut Report) {
    let i = &scene.input;
    r.inside("input", None, |r| {
        unique(i.bodies.iter().map(|b| b.name.as_str()), "body", r);
        for (k, b) in i.bodies.iter().enumerate() {
            r.inside("body", Some(k), |r| {
                let [x, y, z] = b.size_m;
                if !b.size_m.iter().all(|s| (1e-4..=100.0).contains(s)) {
                    r.say("size_m", format!("input.body.size_m = [{x}, {y}, {z}]: every side must be 0.0001 to 100 metres"));
                }
                if b.form == BodyForm::Torus && z >= 0.5 * x {
                    r.say("size_m", format!("input.body.size_m: a ring of {x} m must be thinner than {} m, not {z} m", 0.5 * x));
                }
                match (b.form == BodyForm::Mesh, b.mesh.is_some()) {
                    (true, false) => r.say("form", "input.body: form = \"mesh\" needs mesh = \"file.ply\""),
                    (false, true) => r.say("mesh", "input.body.mesh is for form = \"mesh\""),
                    _ => {}
                }
                motion(&b.motion, r);
                let simulated = scene.simulates(b);
                if simulated && !b.motion.is_empty() {
                    r.say("motion", "input.body.motion is for scenery, and this body is simulated; list the others in [[object]] parts");
                }
                if simulated && b.temperature_c.is_some() {
                    r.say("temperature_c", "input.body.temperature_c is for scenery; a simulated body has object.initial_temperature_c");
                }
            });
        }
    });
}

fn direction(d: [f64; 3], key: &str, r: &mut Report) {
    if d.iter().all(|c| *c == 0.0) {
        r.say(key, format!("{} = [0, 0, 0] is no direction", key.rsplit('.').next().unwrap_or(key)));
    }
}

fn unique<'a>(names: impl Iterator<Item = &'a str>, what: &str, r: &mut Report) {
    let mut seen: Vec<&str> = Vec::new();
    for (i, name) in names.enumerate() {
        if seen.contains(&name) {
            let message = format!("{what}.name = \"{name}\" is taken by an earlier {what}; names must differ");
            r.inside(what, Some(i), |r| r.say("name", message));
        }
        seen.push(name);
    }
}

fn objects(scene: &Scene, r: &mut Report) {
    unique(scene.objects.iter().map(|o| o.name.as_str()), "object", r);
    if scene.objects.len() > 255 {
        r.say("object", format!("{} objects are too many; at most 255", scene.objects.len()));
    }
    let mut sized = None;
    for (i, o) in scene.objects.iter().enumerate() {
        r.inside("object", Some(i), |r| object(scene, o, &mut sized, r));
    }
}

fn object<'s>(scene: &'s Scene, o: &'s Object, sized: &mut Option<&'s str>, r: &mut Report) {
    if o.name.is_empty() || o.name == "all" {
        r.say("name", format!("object.name = \"{}\" is not possible; choose another one", o.name));
    }
    if o.select.is_some() && !o.parts.is_empty() {
        r.say("parts", "object: give either select or parts, not both");
    }
    let bodies: Vec<&str> = scene.input.bodies.iter().map(|b| b.name.as_str()).collect();
    if !o.parts.is_empty() && scene.input.asset.is_none() && bodies.is_empty() {
        r.say("parts", "object.parts names parts of an embedded asset or procedural bodies; for a splat file use select");
    }
    if !bodies.is_empty() {
        if o.select.is_some() {
            r.say("select", "object.select chooses splats of a file; procedural bodies are named by parts");
        } else if o.parts.is_empty() {
            r.say("name", format!("object \"{}\": parts must name bodies of the input ({})", o.name, bodies.join(", ")));
        }
        if o.size_m.is_some() {
            r.say("size_m", "object.size_m is for captures; procedural bodies have their size in [[input.body]]");
        }
        for p in o.parts.iter().filter(|p| !bodies.contains(&p.as_str())) {
            r.say("parts", format!("object.parts: there is no input body \"{p}\"{}", suggestion(p, &bodies)));
        }
    }
    if scene.material(&o.material).is_none() {
        let known: Vec<&str> = scene.materials.keys().map(String::as_str).chain(material_presets().iter().map(|p| p.name)).collect();
        r.say(
            "material",
            format!("object.material = \"{}\" is no preset and no [materials] table{}", o.material, suggestion(&o.material, &known)),
        );
    }
    if o.size_m.is_some() {
        match *sized {
            Some(first) => {
                r.say("size_m", format!("object.size_m: \"{first}\" already gives the real size; one is enough, all are scaled by it"))
            }
            None => *sized = Some(&o.name),
        }
    }
    if let Some(s) = &o.select {
        r.inside("select", None, |r| select(s, r));
    }
}

fn select(s: &Select, r: &mut Report) {
    if let Some(b) = &s.in_box {
        r.inside("box", None, |r| boxed(b, r));
    }
    if let Some(t) = &s.cylinder {
        r.inside("cylinder", None, |r| tube(t, r));
    }
    if let Some(h) = &s.half_space {
        direction(h.direction, "half_space.direction", r);
    }
    if s.seed.is_some() && s.largest_component {
        r.say("seed", "select: seed and largest_component both choose a component; give one");
    }
    for (i, inner) in s.all.iter().enumerate() {
        r.inside("all", Some(i), |r| select(inner, r));
    }
    for (i, inner) in s.any.iter().enumerate() {
        r.inside("any", Some(i), |r| select(inner, r));
    }
    if let Some(inner) = &s.not {
        r.inside("not", None, |r| select(inner, r));
    }
}

fn boxed(b: &BoxShape, r: &mut Report) {
    for axis in 0..3 {
        if b.min[axis] >= b.max[axis] {
            let name = ["x", "y", "z"][axis];
            r.say("min", format!("box: min {} is not below max {} along {name}", b.min[axis], b.max[axis]));
        }
    }
}

fn tube(t: &Tube, r: &mut Report) {
    if t.from == t.to {
        r.say("to", "from and to are the same point; give the two ends of the axis");
    }
}

fn materials(scene: &Scene, r: &mut Report) {
    let (size, _) = scene.size_m();
    let probe = scene.objects.first().cloned().unwrap_or_default();
    let context = scene.material_context(&probe, size);
    for (name, spec) in &scene.materials {
        let Err(e) = spec.resolve(name, &context) else { continue };
        let presets: Vec<&str> = material_presets().iter().map(|p| p.name).collect();
        let hint = match (e.key, &spec.preset) {
            ("preset", Some(p)) => suggestion(p, &presets),
            _ => String::new(),
        };
        r.inside("materials", None, |r| r.inside(name, None, |r| r.say(e.key, format!("materials.{name}.{e}{hint}"))));
    }
}

/// The value keys of a kind: (key, given, used by this kind, needed by it).
fn value_keys(h: &Heat) -> [(&'static str, bool, bool, bool); 11] {
    use HeatKind::*;
    let k = h.kind;
    let (torch, sun) = (k == Radiant && h.position.is_some(), k == Radiant && h.position.is_none());
    [
        ("temperature_c", h.temperature_c.is_some(), matches!(k, Temperature | Film | Radiation), matches!(k, Film | Radiation)),
        ("power_w", h.power_w.is_some(), k == Power || torch, k == Power || torch),
        ("volume_w_m3", h.volume_w_m3.is_some(), k == Volume, k == Volume),
        ("flux_w_m2", h.flux_w_m2.is_some(), k == Flux, k == Flux),
        ("film_coefficient_w_m2k", h.film_coefficient_w_m2k.is_some(), k == Film, false),
        ("emissivity", h.emissivity.is_some(), k == Radiation, false),
        ("intensity_w_m2", h.intensity_w_m2.is_some(), sun, sun),
        ("absorptivity", h.absorptivity.is_some(), k == Radiant, false),
        ("direction", h.direction.is_some(), k == Radiant, false),
        ("position", h.position.is_some(), k == Radiant, false),
        ("cone_deg", h.cone_deg.is_some(), torch, false),
    ]
}

fn heat(scene: &Scene, h: &Heat, r: &mut Report) {
    let kind = format!("{:?}", h.kind).to_lowercase();
    let keyframed = !h.schedule.keyframes.is_empty();
    for (key, given, used, needed) in value_keys(h) {
        if given && !used {
            r.say(key, format!("heat.{key} means nothing for kind = \"{kind}\"; remove it or change the kind"));
        } else if needed && !given && !keyframed {
            r.say("kind", format!("heat: kind = \"{kind}\" needs {key} (or schedule.keyframes)"));
        } else if needed && given && keyframed {
            r.say(key, format!("heat: {key} and schedule.keyframes both give the value; remove one"));
        }
    }
    match &h.region {
        Region::Object(name) | Region::Surface(name) => {
            let known: Vec<&str> = scene.objects.iter().map(|o| o.name.as_str()).chain(["all"]).collect();
            // The objects of an asset are not known here; the asset checks its own names.
            let own_objects = scene.objects.is_empty() && (scene.input.asset.is_some() || !scene.input.bodies.is_empty());
            if !own_objects && !known.contains(&name.as_str()) {
                r.say("region", format!("heat.region: there is no object \"{name}\"{}", suggestion(name, &known)));
            }
        }
        Region::Box(b) => r.inside("region", None, |r| r.inside("box", None, |r| boxed(b, r))),
        Region::Cylinder(t) => r.inside("region", None, |r| r.inside("cylinder", None, |r| tube(t, r))),
        Region::HalfSpace(p) => direction(p.direction, "region.half_space.direction", r),
        Region::Mesh(m) => r.inside("region", None, |r| mesh(m, r)),
        Region::Sphere(_) | Region::Capsule(_) => {}
    }
    if let Some(d) = h.direction {
        direction(d, "direction", r);
    }
    if h.kind == HeatKind::Temperature && matches!(h.region, Region::Surface(_)) {
        r.say("region", "heat.region: kind = \"temperature\" holds a volume; use object instead of surface, or kind = \"film\"");
    }
    let s = &h.schedule;
    if s.end_s.is_some_and(|end| end <= s.start_s) {
        r.say("schedule.end_s", format!("heat.schedule.end_s = {} must be after start_s = {}", s.end_s.unwrap_or(0.0), s.start_s));
    }
    if s.duty.is_some() && s.period_s.is_none() {
        r.say("schedule.duty", "heat.schedule.duty needs period_s");
    }
    if s.keyframes.windows(2).any(|w| w[0][0] >= w[1][0]) {
        r.say("schedule.keyframes", "heat.schedule.keyframes: times must increase");
    }
    if matches!(h.kind, HeatKind::Temperature | HeatKind::Film | HeatKind::Radiation) && s.keyframes.iter().any(|k| k[1] < -273.15) {
        r.say("schedule.keyframes", "heat.schedule.keyframes: temperatures in °C, at least -273.15");
    }
    motion(&h.motion, r);
}

fn motion(keys: &[MotionKey], r: &mut Report) {
    if keys.windows(2).any(|w| w[0].time_s >= w[1].time_s) {
        r.say("motion", "motion: times must increase from keyframe to keyframe");
    }
    for (i, key) in keys.iter().enumerate() {
        r.inside("motion", Some(i), |r| direction(key.axis, "axis", r));
    }
}

fn mesh(m: &MeshShape, r: &mut Report) {
    r.inside("mesh", None, |r| {
        if m.file.is_empty() {
            r.say("file", "mesh.file is empty; give the path of a .ply, .obj or .glb file");
        }
        direction(m.up.0, "up", r);
    });
}

fn collider(c: &Collider, r: &mut Report) {
    match &c.shape {
        ColliderShape::Plane(p) => direction(p.normal, "shape.plane.normal", r),
        ColliderShape::Box(b) => r.inside("shape", None, |r| r.inside("box", None, |r| boxed(b, r))),
        ColliderShape::Cylinder(t) => r.inside("shape", None, |r| r.inside("cylinder", None, |r| tube(t, r))),
        ColliderShape::Mesh(m) => r.inside("shape", None, |r| mesh(m, r)),
        ColliderShape::Heightfield(h) => {
            if h.count().is_none() {
                r.say("shape.heightfield.heights", "heightfield.heights: write two or more lists, all with the same number of heights");
            }
            if (0..2).any(|a| h.min[a] >= h.max[a]) {
                r.say("shape.heightfield.min", "heightfield: min must lie below max along x and y");
            }
            if !c.motion.is_empty() {
                r.say("motion", "collider.motion: a heightfield has no end and cannot move; use a mesh");
            }
        }
        ColliderShape::Sphere(_) | ColliderShape::Capsule(_) => {}
    }
    if c.thin && !matches!(c.shape, ColliderShape::Mesh(_) | ColliderShape::Box(_)) {
        r.say("thin", "collider.thin: only a mesh (one open layer of triangles) or a box can be thin; leave out thin or use one of them");
    }
    let given = [
        ("temperature_c", c.temperature_c.is_some()),
        ("temperature_keyframes", !c.temperature_keyframes.is_empty()),
        ("conducting", c.conducting.is_some()),
    ];
    let given: Vec<&str> = given.iter().filter(|g| g.1).map(|g| g.0).collect();
    if let [first, .., last] = given[..] {
        r.say(last, format!("collider: {first} and {last} exclude each other; give one"));
    }
    if let (true, [first, ..]) = (c.thin, &given[..]) {
        r.say(first, format!("collider.{first}: heat passes a thin collider as if it were not there; leave out {first} or thin"));
    }
    let k = &c.temperature_keyframes;
    if k.windows(2).any(|w| w[0][0] >= w[1][0]) {
        r.say("temperature_keyframes", "collider.temperature_keyframes: times must increase");
    }
    if k.iter().any(|k| k[1] < -273.15) {
        r.say("temperature_keyframes", "collider.temperature_keyframes: temperatures in °C, at least -273.15");
    }
    if c.conducting.is_some() && matches!(c.shape, ColliderShape::Plane(_)) && !c.motion.is_empty() {
        r.say("conducting", "collider.conducting: a plane has no end, and so no heat content of its own, while it moves; use a box");
    }
    motion(&c.motion, r);
    if c.active_s.iter().any(|i| i[0] >= i[1]) {
        r.say("active_s", "collider.active_s: write [[from, until], …] with from before until");
    }
}

fn camera(c: &Camera, r: &mut Report) {
    let legal = |b: char| b.is_ascii_alphanumeric() || b == '-' || b == '_';
    if c.name.is_empty() || !c.name.chars().all(legal) {
        r.say("name", format!("camera.name = \"{}\" becomes part of file names; use letters, digits, - and _", c.name));
    }
    if c.orbit.is_some() && !c.keyframes.is_empty() {
        r.say("keyframes", "camera: give either orbit or keyframes, not both");
    }
    if c.keyframes.windows(2).any(|w| w[0].time_s >= w[1].time_s) {
        r.say("keyframes", "camera.keyframes: times must increase");
    }
    for (i, key) in c.keyframes.iter().enumerate() {
        if key.eye == key.target {
            r.inside("keyframes", Some(i), |r| r.say("target", "camera.keyframes: eye and target are the same point"));
        }
    }
}

fn time_and_space(scene: &Scene, r: &mut Report) {
    let t = &scene.time;
    if t.melt_in_s.is_some() && t.acceleration.is_some() {
        r.say("time.melt_in_s", "time: melt_in_s and acceleration both set the thermal clock; give one");
    }
    if t.duration_s * t.fps > 100_000.0 {
        r.say("time.duration_s", format!("time: {:.0} frames are too many; at most 100000", t.duration_s * t.fps));
    }
    let (size, _) = scene.size_m();
    if let Some(b) = scene.simulation.box_m {
        if b.iter().any(|side| *side <= 0.0 || *side > 1e4) {
            r.say("simulation.box_m", format!("simulation.box_m = {b:?}: sides must lie in 0 to 10000 m"));
        } else if b.iter().all(|side| *side < size) {
            let message =
                format!("simulation.box_m = {b:?}: the object's longest side of {size} m does not fit; leave box_m out or make it larger");
            r.say("simulation.box_m", message);
        }
    }
    if let crate::Auto::Value(v) = scene.fill.tau_alpha
        && v > 1.0
    {
        r.say("fill.tau_alpha", format!("fill.tau_alpha = {v}: out of range; allowed: 0 to 1, or \"auto\""));
    }
}

fn output(scene: &Scene, r: &mut Report) {
    let o = &scene.output;
    for (key, value) in [("output.width", o.width), ("output.height", o.height)] {
        if let Some(v) = value
            && v % 2 == 1
            && !o.films.is_empty()
        {
            r.say(key, format!("{key} = {v}: films need an even number of pixels; use {} or {}", v - 1, v + 1));
        }
    }
    if let Some([low, high]) = o.thermal_range_c
        && (low >= high || low < -273.15)
    {
        r.say("output.thermal_range_c", format!("output.thermal_range_c = [{low}, {high}]: write [coldest, hottest] in °C"));
    }
    if (1..o.films.len()).any(|i| o.films[..i].contains(&o.films[i])) {
        r.say("output.films", "output.films: a film is named twice");
    }
    if (1..o.mesh.len()).any(|i| o.mesh[..i].contains(&o.mesh[i])) {
        r.say("output.mesh", "output.mesh: a format is named twice");
    }
    if let Some(c) = &o.clip {
        direction(c.normal, "output.clip.normal", r);
    }
}
