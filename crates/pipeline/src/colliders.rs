//! From the scene's colliders to the simulator's.

use megas_math::vec3;
use megas_scene::{CELSIUS_K, ColliderMode, ColliderShape, Scene, SiShape};
use megas_sim::collider::{Collider, Mode, Shape};

use crate::Failure;
use crate::body::BodyMeta;

/// The support plane first, then the scene's own colliders; with the temperature \[K\] of those that have one.
pub fn colliders(scene: &Scene, meta: &BodyMeta) -> Result<(Vec<Collider>, Vec<Option<f32>>), Failure> {
    let mut out = Vec::new();
    let mut temperature = Vec::new();
    let kelvin = |c: Option<f64>| c.map(|c| (c + CELSIUS_K) as f32);
    let support = &scene.support;
    if support.enabled {
        let shape = Shape::Plane { point: [0.0, 0.0, support_height(scene, meta)], normal: [0.0, 0.0, 1.0] };
        out.push(Collider {
            mode: mode(support.mode),
            friction: support.friction,
            melt_sticks: support.melt_sticks,
            ..Collider::new(shape)
        });
        temperature.push(kelvin(support.temperature_c));
    }
    for (k, c) in scene.colliders.iter().enumerate() {
        let name = if c.name.is_empty() { format!("number {}", k + 1) } else { format!("'{}'", c.name) };
        let shape = shape(&c.shape, c.frame, meta).map_err(|what| Failure::Input(format!("collider {name}: {what}")))?;
        out.push(Collider { mode: mode(c.mode), friction: c.friction, melt_sticks: c.melt_sticks, ..Collider::new(shape) });
        temperature.push(kelvin(c.temperature_c));
    }
    Ok((out, temperature))
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

fn shape(s: &ColliderShape, frame: megas_scene::Frame, meta: &BodyMeta) -> Result<Shape, &'static str> {
    let p = meta.placement();
    let si = match s {
        ColliderShape::Plane(plane) => {
            return Ok(Shape::Plane { point: p.point(frame, plane.point), normal: p.direction(frame, plane.normal) });
        }
        ColliderShape::Box(b) => p.boxed(frame, b),
        ColliderShape::Sphere(s) => p.sphere(frame, s),
        ColliderShape::Cylinder(t) => p.cylinder(frame, t),
        ColliderShape::Capsule(t) => p.capsule(frame, t),
    };
    match si {
        SiShape::Sphere { center, radius } => Ok(Shape::Sphere { center, radius }),
        SiShape::Capsule { from, to, radius } => Ok(Shape::Capsule { a: from, b: to, radius }),
        SiShape::Box { center, half, axes } => {
            // Right angles permute the axes; anything else is not an axis-aligned box any more.
            let straight = axes.iter().flatten().all(|v| v.abs() < 1e-6 || (v.abs() - 1.0).abs() < 1e-6);
            if !straight {
                return Err("boxes must be aligned with the simulator's axes (z up); turn it by multiples of 90° or use the object frame");
            }
            let h: [f64; 3] = std::array::from_fn(|a| (0..3).map(|b| axes[a][b].abs() * half[b]).sum());
            Ok(Shape::Box { min: vec3::sub(center, h), max: vec3::add(center, h) })
        }
        SiShape::Cylinder { from, to, radius } => {
            let d = vec3::sub(to, from);
            if d[0].hypot(d[1]) > 1e-6 * d[2].abs() {
                return Err("cylinders must stand upright; use a capsule for other directions");
            }
            Ok(Shape::Cylinder { base: if d[2] > 0.0 { from } else { to }, radius, height: d[2].abs() })
        }
        SiShape::HalfSpace { .. } => Err("use a plane"),
    }
}
