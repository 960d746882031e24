//! Triangle meshes of a scene: read, placed, turned into distances.

use std::cell::RefCell;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use megas_formats::load_mesh;
use megas_geometry::{Sheet, mesh_field};
use megas_model::Mesh;
use megas_scene::{ColliderShape, Frame, MeshShape, Placement, Region, Scene};
use megas_sim::collider::Shape;
use megas_sim::grid::Grid;

use crate::Failure;

/// Share of a mesh thinner than two cells above which a person should know.
const THIN: f64 = 0.02;

/// Makes shapes of the meshes of a scene.
pub struct Meshes<'a> {
    /// Folder that relative paths start from.
    pub base_dir: &'a Path,
    /// Scene ↔ metres.
    pub placement: &'a Placement,
    /// The simulation box.
    pub grid: &'a Grid,
    /// What is odd about the meshes so far.
    pub remarks: RefCell<Vec<String>>,
}

impl Meshes<'_> {
    /// The solid of a mesh; `moves` if it may leave the place it was given.
    pub fn shape(&self, frame: Frame, m: &MeshShape, moves: bool) -> Result<Shape, Failure> {
        let (path, mesh) = self.placed(frame, m)?;
        let box_of_nodes = (self.grid.origin, self.grid.position(self.grid.nodes.map(|n| n - 1)));
        let field = mesh_field(&mesh, self.grid.spacing, (!moves).then_some(box_of_nodes))
            .map_err(|e| Failure::Input(format!("{}: {e}", path.display())))?;
        if field.thickened > THIN {
            self.remarks.borrow_mut().push(format!(
                "{}: {:.0} % of the surface bounds parts thinner than two cells; they were made two cells ({:.1} mm) thick; a collider of a single layer \
                 of triangles with thin = true stays where it is",
                path.display(),
                100.0 * field.thickened,
                2e3 * self.grid.spacing
            ));
        } else if !field.closed {
            self.remarks.borrow_mut().push(format!("{}: the mesh is not closed; its holes were closed smoothly", path.display()));
        }
        Ok(Shape::Field(Arc::new(field.field)))
    }

    /// A mesh as a sheet without thickness.
    pub fn sheet(&self, frame: Frame, m: &MeshShape) -> Result<Shape, Failure> {
        let (path, mesh) = self.placed(frame, m)?;
        let sheet = Sheet::new(&mesh).map_err(|e| Failure::Input(format!("{}: {e}", path.display())))?;
        Ok(Shape::Sheet(Arc::new(sheet)))
    }

    /// The path of a mesh and the mesh in metres.
    fn placed(&self, frame: Frame, m: &MeshShape) -> Result<(PathBuf, Mesh), Failure> {
        let path = self.base_dir.join(&m.file);
        let mut mesh = load_mesh(&path).map_err(|e| Failure::Input(e.to_string()))?;
        mesh.positions = self.placement.mesh(frame, m, &mesh.positions);
        Ok((path, mesh))
    }
}

/// The mesh files that a scene names, for the key of a stage.
pub fn files(scene: &Scene, base_dir: &Path) -> Vec<PathBuf> {
    let colliders = scene.colliders.iter().filter_map(|c| match &c.shape {
        ColliderShape::Mesh(m) => Some(m),
        _ => None,
    });
    let regions = scene.heat.iter().flatten().filter_map(|h| match &h.region {
        Region::Mesh(m) => Some(m),
        _ => None,
    });
    colliders.chain(regions).map(|m| base_dir.join(&m.file)).collect()
}
