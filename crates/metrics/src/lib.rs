//! Ground-truth assets and the paper's claims as numbers

pub mod assets;
pub mod consistency;
pub mod cracks;
pub mod deform;
pub mod fidelity;
pub mod filling;
pub mod image;
pub mod mesh_quality;
pub mod mesh_view;
pub mod splats;
pub mod surface;
#[cfg(test)]
mod test_shapes;
