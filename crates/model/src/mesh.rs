//! Triangle meshes.

/// An indexed triangle mesh; optional attributes are empty or as long as `positions`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mesh {
    /// Vertex positions.
    pub positions: Vec<[f32; 3]>,
    /// Unit vertex normals.
    pub normals: Vec<[f32; 3]>,
    /// Vertex colours in [0, 1].
    pub colours: Vec<[f32; 3]>,
    /// Vertex temperatures \[K\].
    pub temperature: Vec<f32>,
    /// Vertex indices, counter-clockwise seen from outside.
    pub triangles: Vec<[u32; 3]>,
}
