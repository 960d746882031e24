//! Mesh files by name: the ending of the name says which format.

use std::path::Path;

use megas_model::Mesh;

use crate::{
    error::{FormatError, Place, Result, quoted},
    mesh_glb::write_mesh_glb,
    mesh_obj::{read_mesh_obj, write_mesh_obj},
    mesh_ply::{read_mesh_ply, write_mesh_ply},
};

/// A format of mesh files.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum MeshFormat {
    /// Binary PLY: colours (8 bits), normals, temperature; scene axes.
    Ply,
    /// Wavefront OBJ: colours behind the positions, normals; no temperature; scene axes.
    Obj,
    /// Binary glTF 2.0: colours, normals, `_TEMPERATURE`; +Y up.
    Glb,
}

impl MeshFormat {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Ply, Self::Obj, Self::Glb];

    /// Ending of file names, without the dot.
    pub fn extension(self) -> &'static str {
        match self {
            Self::Ply => "ply",
            Self::Obj => "obj",
            Self::Glb => "glb",
        }
    }

    /// The format that the ending of a name stands for.
    pub fn of_path(path: &Path) -> Option<Self> {
        let ending = path.extension()?.to_str()?;
        Self::ALL.into_iter().find(|f| ending.eq_ignore_ascii_case(f.extension()))
    }
}

/// Reads a mesh, `.ply` or `.obj`. Polygons become fans of triangles; every index is valid.
pub fn load_mesh(path: impl AsRef<Path>) -> Result<Mesh> {
    let path = path.as_ref();
    match MeshFormat::of_path(path) {
        Some(MeshFormat::Ply) => read_mesh_ply(path),
        Some(MeshFormat::Obj) => read_mesh_obj(path),
        _ => {
            let name = path.file_name().unwrap_or_default().to_string_lossy();
            Err(FormatError::defect(path, Place::File, quoted(&name), "a name that ends in .ply or .obj", "convert the mesh"))
        }
    }
}

/// Writes a mesh, atomically, in the format that the name asks for. `up` is the direction in the mesh's own axes that
/// points upward; glTF files are turned so that it becomes +Y, the others keep the axes.
pub fn save_mesh(path: impl AsRef<Path>, mesh: &Mesh, up: [f32; 3], overwrite: bool) -> Result<()> {
    let path = path.as_ref();
    match MeshFormat::of_path(path) {
        Some(MeshFormat::Ply) => write_mesh_ply(path, mesh, overwrite),
        Some(MeshFormat::Obj) => write_mesh_obj(path, mesh, overwrite),
        Some(MeshFormat::Glb) => write_mesh_glb(path, mesh, up, overwrite),
        None => {
            let name = path.file_name().unwrap_or_default().to_string_lossy();
            let expected = "a name that ends in .ply, .obj or .glb";
            Err(FormatError::defect(path, Place::File, quoted(&name), expected, "choose another name"))
        }
    }
}
