//! From the scene's colliders to the simulator's.

use megas_scene::{CELSIUS_K, ColliderMode, ColliderShape, Frame, Scene};
use megas_sim::collider::{Collider, Mode, Shape, Thermal};

use crate::Failure;
use crate::body::BodyMeta;

/// The support plane first, then the scene's own colliders.
pub fn colliders(scene: &Scene, meta: &BodyMeta) -> Result<Vec<Collider>, Failure> {
    let mut out = Vec::new();
    let support = &scene.support;
    if support.enabled {
        let shape = Shape::HalfSpace { point: [0.0, 0.0, support_height(scene, meta)], normal: [0.0, 0.0, 1.0] };
        out.push(Collider {
            name: "support".into(),
            mode: mode(support.mode),
            friction: support.friction,
            melt_sticks: support.melt_sticks,
            thermal: thermal(support.temperature_c),
            ..Collider::new(shape)
        });
    }
    for (k, c) in scene.colliders.iter().enumerate() {
        out.push(Collider {
            name: if c.name.is_empty() { format!("number {}", k + 1) } else { format!("'{}'", c.name) },
            mode: mode(c.mode),
            friction: c.friction,
            melt_sticks: c.melt_sticks,
            thermal: thermal(c.temperature_c),
            ..Collider::new(shape(&c.shape, c.frame, meta))
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

fn thermal(temperature_c: Option<f64>) -> Thermal {
    temperature_c.map_or(Thermal::Adiabatic, |c| Thermal::Fixed { kelvin: c + CELSIUS_K, keyframes: Vec::new() })
}

fn shape(s: &ColliderShape, frame: Frame, meta: &BodyMeta) -> Shape {
    let p = meta.placement();
    match s {
        ColliderShape::Plane(plane) => Shape::HalfSpace { point: p.point(frame, plane.point), normal: p.direction(frame, plane.normal) },
        ColliderShape::Box(b) => p.boxed(frame, b),
        ColliderShape::Sphere(s) => p.sphere(frame, s),
        ColliderShape::Cylinder(t) => p.cylinder(frame, t),
        ColliderShape::Capsule(t) => p.capsule(frame, t),
    }
}
