//! Ground-truth assets and the paper's claims as numbers

pub mod assets;
pub mod image;
pub mod splats;
pub mod surface;
