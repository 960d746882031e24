//! From the scene's colliders to the simulator's.

use std::sync::Arc;

use megas_scene::{Background, CELSIUS_K, ColliderMode, ColliderShape, Scene};
use megas_sim::collider::{Collider, Conductor, Mode, Shape, Sheet, Thermal};

use crate::Failure;
use crate::background::background_shape;
use crate::body::{Bodies, BodyMeta};
use crate::convert::motion;
use crate::meshes::Meshes;

/// The support first, then the scene's own colliders.
pub fn colliders(scene: &Scene, bodies: &Bodies, meshes: &Meshes<'_>) -> Result<Vec<Collider>, Failure> {
    let meta = &bodies.meta;
    let mut out = Vec::new();
    let support = &scene.support;
    let height = support_height(scene, meta);
    let plane = || Shape::HalfSpace { point: [0.0, 0.0, height], normal: [0.0, 0.0, 1.0] };
    let standing = match support.background {
        _ if !support.enabled => None,
        Background::None => None,
        Background::Plane => Some(plane()),
        Background::Collider => Some(background_shape(bodies, meshes.grid, height).unwrap_or_else(|| {
            meshes.remarks.borrow_mut().push("support.background = \"collider\": there are no background splats; the plane is used".into());
            plane()
        })),
    };
    if let Some(shape) = standing {
        out.push(Collider {
            name: "support".into(),
            mode: mode(support.mode),
            friction: support.friction,
            melt_sticks: support.melt_sticks,
            thermal: support.temperature_c.map_or(Thermal::Adiabatic, |c| fixed(c, &[])),
            ..Collider::new(shape)
        });
    }
    for (k, c) in scene.colliders.iter().enumerate() {
        let shape = if c.thin { sheet(c, meta, meshes)? } else { shape(c, meta, meshes)? };
        out.push(Collider {
            name: if c.name.is_empty() { format!("number {}", k + 1) } else { format!("'{}'", c.name) },
            mode: mode(c.mode),
            friction: c.friction,
            melt_sticks: c.melt_sticks,
            thermal: thermal(c, scene.ambient_k()),
            motion: motion(&c.motion, c.frame, &meta.placement()),
            active: c.active_s.clone(),
            ..Collider::new(shape)
        });
    }
    Ok(out)
}

/// Height of the support plane \[m\].
pub fn support_height(scene: &Scene, meta: &BodyMeta) -> f64 {
    let longest = (0..3).map(|a| meta.box_max[a] - meta.box_min[a]).fold(0.0, f64::max);
    meta.support_z + scene.support.raise * longest
}

fn mode(m: ColliderMode) -> Mode {
    match m {
        ColliderMode::Separate => Mode::Separate,
        ColliderMode::Slip => Mode::Slip,
        ColliderMode::Sticky => Mode::Sticky,
    }
}

fn fixed(celsius: f64, keyframes: &[[f64; 2]]) -> Thermal {
    Thermal::Fixed { kelvin: celsius + CELSIUS_K, keyframes: keyframes.iter().map(|k| [k[0], k[1] + CELSIUS_K]).collect() }
}

fn thermal(c: &megas_scene::Collider, ambient_k: f64) -> Thermal {
    match (c.temperature_c, c.temperature_keyframes.first(), &c.conducting) {
        (Some(celsius), ..) => fixed(celsius, &[]),
        (None, Some(first), _) => fixed(first[1], &c.temperature_keyframes),
        (None, None, Some(inside)) => Thermal::Conducting(Conductor {
            kelvin: inside.initial_temperature_c.map_or(ambient_k, |c| c + CELSIUS_K),
            volumetric_capacity: inside.density_kg_m3 * inside.heat_capacity_j_kgk,
            conductivity: inside.conductivity_w_mk,
            watts: inside.power_w,
        }),
        (None, None, None) => Thermal::Adiabatic,
    }
}

/// A thin collider.
fn sheet(c: &megas_scene::Collider, meta: &BodyMeta, meshes: &Meshes<'_>) -> Result<Shape, Failure> {
    if let ColliderShape::Mesh(m) = &c.shape {
        return meshes.sheet(c.frame, m);
    }
    let Shape::Box { center, half, axes } = shape(c, meta, meshes)? else {
        return Err(Failure::Input("collider.thin: only a mesh or a box can be thin".into()));
    };
    let sheet = Sheet::across_box(center, half, axes).map_err(|e| Failure::Input(format!("collider.shape.box: {e}")))?;
    Ok(Shape::Sheet(Arc::new(sheet)))
}

fn shape(c: &megas_scene::Collider, meta: &BodyMeta, meshes: &Meshes<'_>) -> Result<Shape, Failure> {
    let (p, frame) = (meta.placement(), c.frame);
    Ok(match &c.shape {
        ColliderShape::Plane(plane) => Shape::HalfSpace { point: p.point(frame, plane.point), normal: p.direction(frame, plane.normal) },
        ColliderShape::Box(b) => p.boxed(frame, b),
        ColliderShape::Sphere(s) => p.sphere(frame, s),
        ColliderShape::Cylinder(t) => p.cylinder(frame, t),
        ColliderShape::Capsule(t) => p.capsule(frame, t),
        ColliderShape::Mesh(m) => meshes.shape(frame, m, !c.motion.is_empty())?,
        ColliderShape::Heightfield(h) => {
            p.heightfield(frame, h).ok_or_else(|| Failure::Input("heightfield: the heights are not a rectangle of numbers".into()))?
        }
    })
}
