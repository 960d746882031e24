//! The closed meshes of a filled model at rest against the true surface (splatting.md §9.3 M10).

use megas_metrics::mesh_quality::{MeshDifference, MeshShape, SAMPLES};
use megas_metrics::surface::MeshDistance;
use megas_skin::imls::{Imls, ImlsSettings, Samples};
use megas_skin::mesh::{MeshSettings, body_mesh};
use serde_json::{Value, json};

use super::model::Filled;
use super::truth::Truth;

/// Figures of the mesh that films get (`skin`: the splats shape it, the particles close it) and of the one of the particles alone.
pub fn meshes(model: &Filled, truth: &Truth) -> Value {
    let samples = Samples {
        position: model.surface.mean.clone(),
        normal: (0..model.surface.len()).map(|i| model.surface.normal(i)).collect(),
        weight: Vec::new(),
    };
    let skin = Imls::new(&samples.raised(model.depth as f32), &ImlsSettings::default());
    json!({ "skin": one(model, skin.as_ref(), truth), "particles": one(model, None, truth) })
}

/// Null where there is no mesh.
fn one(model: &Filled, skin: Option<&Imls>, truth: &Truth) -> Value {
    let l = truth.stage.diagonal;
    let mesh = body_mesh(&model.particles, skin, &MeshSettings::new(model.spacing, l));
    let Ok(distance) = MeshDistance::new(&mesh) else { return Value::Null };
    let shape = MeshShape::new(&mesh, l);
    let (own, right) = ((&mesh, &distance), (&truth.delivered, &truth.surface));
    let (difference, seen) = MeshDifference::with_part(own, right, l, SAMPLES, |x| truth.is_photographed(x));
    json!({
        "triangles": mesh.triangles.len(),
        "chamfer": difference.chamfer,
        "hausdorff": difference.hausdorff,
        "p95": difference.p95,
        "normal_mean_deg": difference.normal_mean.to_degrees(),
        "normal_p95_deg": difference.normal_p95.to_degrees(),
        "seen": {
            "chamfer": seen.chamfer,
            "to_truth": seen.to_truth,
            "outward": seen.outward,
            "p95": seen.p95,
            "normal_mean_deg": seen.normal_mean.to_degrees(),
        },
        "volume_error": (shape.volume - truth.volume).abs() / truth.volume,
        "euler": shape.euler,
        "watertight": shape.watertight,
        "roughness": shape.roughness,
    })
}
