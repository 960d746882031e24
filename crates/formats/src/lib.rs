//! Bytes to nouns and back: the PLY family, `.splat` and meshes (splatting.md §1.3, §1.4).
//!
//! Whatever comes from outside is compared with the length of its file before anything is allocated for it; errors say in one
//! line which file, where, what was found, what was expected and what to do. Files are written atomically.

mod atomic;
mod compressed_ply;
mod error;
mod gather;
mod mesh_file;
mod mesh_glb;
mod mesh_obj;
mod mesh_ply;
mod ply;
mod source;
mod splat_bin;
mod splat_file;
mod splat_ply;

pub use atomic::{AtomicFile, write_atomic};
pub use error::{Defect, FormatError, Place, Result};
pub use mesh_file::{MeshFormat, load_mesh, save_mesh};
pub use mesh_glb::write_mesh_glb;
pub use mesh_obj::{read_mesh_obj, write_mesh_obj};
pub use mesh_ply::{read_mesh_ply, write_mesh_ply};
pub use splat_file::{LoadReport, RenderMode, SplatFile, SplatFormat, WriteOptions, load_splats, save_splats};
