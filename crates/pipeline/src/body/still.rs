//! Bodies of scenes without a capture: procedural solids, sprinkled with splats like the demonstration. Scene units are metres.

use std::collections::HashMap;
use std::sync::Arc;

use megas_formats::load_mesh;
use megas_geometry::{Field, mesh_field};
use megas_math::vec3;
use megas_metrics::assets::{Form, Mixture, Sprinkle, StillLife, Thing};
use megas_model::{Mesh, Similarity};
use megas_scene::{BodyForm, InputBody, Object, Pattern};
use serde_json::Value;

use super::{Bodies, Source, finish, indices, one_body};
use crate::scenery::mark;
use crate::{Failure, LoadedScene, Sink};

/// Least distance of two splats in simulator cells: coarser ones open cracks when the body stretches, finer ones only cost time.
const SPACING_CELLS: f64 = 0.2;
/// Cells of a mesh along its longest side when its distances are sampled.
const MESH_CELLS: f64 = 96.0;
/// Splats of the table along its radius.
const TABLE_SPLATS: f64 = 80.0;

/// Builds procedural bodies.
pub fn build(loaded: &LoadedScene, objects: &[Object], sink: &dyn Sink) -> Result<(Bodies, Value), Failure> {
    let scene = &loaded.scene;
    let mut object_of: HashMap<usize, usize> = HashMap::new();
    for (k, o) in objects.iter().enumerate() {
        for name in &o.parts {
            let Some(body) = scene.input.bodies.iter().position(|b| b.name == *name) else {
                return Err(Failure::Input(format!("object '{}': the input has no body '{name}'", o.name)));
            };
            object_of.entry(body).or_insert(k);
        }
    }
    let things = scene.input.bodies.iter().map(|b| thing(loaded, b)).collect::<Result<Vec<_>, _>>()?;
    let (size_m, _) = scene.size_m();
    let dx_m = size_m / f64::from(scene.cells());
    let table = scene.input.table.unwrap_or_default();
    let (lo, hi) = scene.input.bodies_box(|_| true).unwrap_or_default();
    let longest = (0..3).map(|a| hi[a] - lo[a]).fold(0.0, f64::max);
    let table_radius = table.radius_m.unwrap_or(1.6 * longest);
    let still = StillLife::new(things, table_radius as f32, table.show);
    // Between discs a spacing apart the default size lets a quarter of the light through, and the far side shows as specks; this, a
    // seventh, and of fewer places.
    let settings = Sprinkle { seed: scene.seed.wrapping_add(1), size: 0.85, ..Sprinkle::default() };
    // Bodies that never move need only look closed.
    let spacing = |body: usize| {
        let (lo, hi) = scene.input.bodies[body].bounds();
        let side = vec3::norm(vec3::sub(hi, lo));
        if object_of.contains_key(&body) { (SPACING_CELLS * dx_m) as f32 } else { (side / 90.0) as f32 }
    };
    let splats = still.sprinkle(spacing, (table_radius / TABLE_SPLATS) as f32, &settings);
    let owner = |i: usize| usize::from(splats.object_id[i]).checked_sub(1).and_then(|body| object_of.get(&body)).copied();
    let owners: Vec<Option<usize>> = (0..splats.len()).map(owner).collect();

    let rotation = Similarity::rotation_from_up([0.0, 0.0, 1.0]);
    let similarity = Similarity { metres_per_unit: 1.0, rotation, origin: [0.0; 3] };
    let mut bodies = Vec::new();
    for (k, o) in objects.iter().enumerate() {
        let mine: Vec<bool> = owners.iter().map(|w| *w == Some(k)).collect();
        if !mine.contains(&true) {
            return Err(Failure::Input(format!("object '{}' has no body of its own; parts names bodies of [[input.body]]", o.name)));
        }
        let mut chosen = splats.select(&indices(&mine, true));
        let parts: Vec<usize> = (0..scene.input.bodies.len()).filter(|b| object_of.get(b) == Some(&k)).collect();
        chosen.object_id.fill(k as u16 + 1);
        let mut body = one_body(scene, o, k, &chosen, similarity, dx_m, Source::Asset)?;
        for (i, x) in body.internal.position.iter().enumerate() {
            let nearest = |x: [f32; 3]| {
                let distance = |b: usize| still.things()[b].sdf(x);
                parts.iter().copied().min_by(|a, b| distance(*a).total_cmp(&distance(*b))).unwrap_or(0)
            };
            body.internal.rgb[i] = still.interior_colour(nearest(*x), *x);
        }
        bodies.push(body);
    }
    let mut background = splats.select(&owners.iter().enumerate().filter(|(_, w)| w.is_none()).map(|(i, _)| i).collect::<Vec<_>>());
    mark(&mut background, scene);
    let own = |_: usize, _: [f64; 3], object: usize| object;
    let (mut out, figures) = finish(scene, objects, bodies, background, similarity, dx_m, &own, Some(0.0), sink)?;
    out.meta.antialiased = true;
    Ok((out, figures))
}

fn thing(loaded: &LoadedScene, b: &InputBody) -> Result<Thing, Failure> {
    let first = b.colour.0;
    let second = b.second_colour.map_or(first.map(|c| 0.72 * c), |c| c.0);
    let form = match (b.form, &b.mesh) {
        (BodyForm::Box, _) => Form::Box,
        (BodyForm::Ball, _) => Form::Ball,
        (BodyForm::Cylinder, _) => Form::Cylinder,
        (BodyForm::Cone, _) => Form::Cone,
        (BodyForm::Torus, _) => Form::Torus,
        (BodyForm::Mesh, Some(file)) => Form::Field(Arc::new(field(loaded, b, file)?)),
        (BodyForm::Mesh, None) => return Err(Failure::Input(format!("input body '{}' needs mesh = \"file.ply\"", b.name))),
    };
    Ok(Thing {
        form,
        half: b.sides().map(|s| (0.5 * s) as f32),
        center: b.center().map(|c| c as f32),
        axes: b.axes().map(|r| r.map(|v| v as f32)),
        rounding: b.rounding() as f32,
        colours: [first, second],
        mixture: match b.pattern {
            Pattern::Marble => Mixture::Marble,
            Pattern::Speckle => Mixture::Speckle,
            Pattern::Layers => Mixture::Layers,
            Pattern::Plain => Mixture::Plain,
        },
        gloss: b.gloss as f32,
        translucency: b.translucency as f32,
    })
}

/// Distances of a mesh that has been centred and scaled into the body's box.
fn field(loaded: &LoadedScene, b: &InputBody, file: &str) -> Result<Field, Failure> {
    let path = loaded.base_dir.join(file);
    let fail = |e: String| Failure::Input(format!("input body '{}': {}: {e}", b.name, path.display()));
    let mut mesh = load_mesh(&path).map_err(|e| Failure::Input(e.to_string()))?;
    fit(&mut mesh, b.sides()).ok_or_else(|| fail("the mesh has no extent".into()))?;
    let longest = b.sides().into_iter().fold(0.0, f64::max);
    Ok(mesh_field(&mesh, longest / MESH_CELLS, None).map_err(|e| fail(e.to_string()))?.field)
}

/// Moves a mesh to the origin and scales it evenly until it touches the first pair of sides of the box.
fn fit(mesh: &mut Mesh, sides: [f64; 3]) -> Option<()> {
    let (mut lo, mut hi) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    for x in &mesh.positions {
        (lo, hi) = (vec3::min(lo, *x), vec3::max(hi, *x));
    }
    let scale = (0..3).map(|a| sides[a] as f32 / (hi[a] - lo[a])).fold(f32::INFINITY, f32::min);
    let middle = vec3::scale(vec3::add(lo, hi), 0.5);
    for x in &mut mesh.positions {
        *x = vec3::scale(vec3::sub(*x, middle), scale);
    }
    (scale.is_finite() && scale > 0.0).then_some(())
}
