//! Where solid things are, as signed distances: simple shapes, height fields, triangle meshes, fields sampled on a grid
//! (simulation.md §4.7, §6.1).
//!
//! One [`Shape`] serves colliders, heat regions and selections. A triangle mesh becomes one through [`mesh_field`]:
//! distances by a tree of boxes, the sign by generalised winding numbers, so that holes do no harm.

mod bvh;
mod distance;
mod field;
mod heightfield;
mod mesh_field;
mod shape;
mod sheet;
mod sweep;
mod winding;

pub use distance::{Closest, MeshDistance, MeshError};
pub use field::Field;
pub use heightfield::Heightfield;
pub use mesh_field::{MeshField, mesh_field};
pub use shape::Shape;
pub use sheet::{OnSheet, Sheet};
