//! A closed mesh of the body, frame by frame (splatting.md §7.7).

mod cells;
mod centre_distance;
mod clean;
mod measure;
mod nets;
mod patches;
mod volume;

pub use measure::{Surface, Topology};

use cells::Cells;
use centre_distance::CentreDistance;
use megas_model::Mesh;
use rayon::prelude::*;
use volume::Volume;

/// How a mesh is made.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeshSettings {
    /// Spacing Δ of the particles at rest \[scene units\].
    pub spacing: f64,
    /// Edge of the voxels \[scene units\], at most 2Δ. The grid stands still in the scene, so keep it the same for all frames.
    pub voxel: f64,
    /// Distance of the surface from the outermost particles in units of Δ. 0.55 keeps the volume of lattices within 1 %; the
    /// design's 0.62 makes a ball of radius 12Δ 3.4 % too large.
    pub offset: f32,
    /// Rounds of Taubin smoothing.
    pub smoothing: u32,
    /// Parts with a smaller share of the area and fewer than 100 triangles are removed.
    pub speck_area: f64,
}

impl MeshSettings {
    /// The defaults for particles of this spacing in a body with the diagonal `size`: voxels of Δ/2, or 1/512 of the body
    /// where that is more.
    pub fn new(spacing: f64, size: f64) -> Self {
        let voxel = (0.5 * spacing).max(size / 512.0).min(2.0 * spacing);
        Self { spacing, voxel, offset: 0.55, smoothing: 5, speck_area: 0.01 }
    }
}

/// Parts below this number of triangles may be specks.
const SPECK_TRIANGLES: usize = 100;
/// Hollows smaller than a cube of so many spacings are holes of the sampling.
const VOID: f64 = 3.0;
/// Shortest edge that stays \[voxels\].
const SHORTEST: f32 = 0.05;
/// Farthest that the Newton step moves a vertex \[voxels\].
const STEP: f32 = 0.5;

/// Positions in voxels relative to a corner that is a multiple of a block, so that voxels stand still in the scene.
struct Frame {
    voxel: f64,
    /// \[voxels\]
    corner: [f64; 3],
}

impl Frame {
    fn new(points: &[[f32; 3]], voxel: f64) -> Self {
        let low = points.iter().fold([f32::INFINITY; 3], |l, p| megas_math::vec3::min(l, *p));
        let corner = low.map(|v| if v.is_finite() { (f64::from(v) / voxel / 64.0).floor() * 64.0 } else { 0.0 });
        Self { voxel, corner }
    }

    fn to_voxels(&self, p: [f32; 3]) -> [f32; 3] {
        std::array::from_fn(|a| (f64::from(p[a]) / self.voxel - self.corner[a]) as f32)
    }

    fn to_scene(&self, p: [f32; 3]) -> [f32; 3] {
        std::array::from_fn(|a| ((f64::from(p[a]) + self.corner[a]) * self.voxel) as f32)
    }
}

/// Largest extent of the particles \[voxels\]: what fits into the keys of blocks with room to spare.
const LARGEST: f32 = 4.0e6;

/// The surface of a cloud of particles: closed, outward, with normals. Particles that are not finite are left out, and
/// those absurdly far (four million voxels) from the others.
pub fn particle_mesh(points: &[[f32; 3]], settings: &MeshSettings) -> Mesh {
    let finite: Vec<[f32; 3]> = points.iter().filter(|p| p.iter().all(|v| v.is_finite())).copied().collect();
    if finite.is_empty() || !(settings.voxel > 0.0 && settings.spacing > 0.0) {
        return Mesh::default();
    }
    let voxel = settings.voxel.min(2.0 * settings.spacing);
    let frame = Frame::new(&finite, voxel);
    let local: Vec<[f32; 3]> = finite.par_iter().map(|p| frame.to_voxels(*p)).filter(|p| p.iter().all(|v| *v < LARGEST)).collect();
    let spacing = (settings.spacing / voxel) as f32;
    let cells = Cells::new(&local, 2.0 * spacing);
    let field = CentreDistance::new(spacing, settings.offset);
    let volume = Volume::new(&cells, |node, wanted, out| field.at_nodes(&cells, node, wanted, out));
    let mut net = nets::surface_net(&volume, &cells, |x| newton(x, field.at(&cells, x)));
    drop(volume);
    let void = (VOID * settings.spacing / voxel).powi(3);
    clean::remove_specks(&mut net, settings.speck_area, SPECK_TRIANGLES, void);
    clean::collapse_short_edges(&mut net, SHORTEST);
    clean::taubin(&mut net, settings.smoothing);
    let normals = clean::normals(&net.vertices, &net.triangles);
    let positions = net.vertices.par_iter().map(|p| frame.to_scene(*p)).collect();
    Mesh { positions, normals, triangles: net.triangles, ..Mesh::default() }
}

/// One Newton step towards the zero set, at most half a voxel long.
fn newton(x: [f32; 3], field: Option<(f32, [f32; 3])>) -> [f32; 3] {
    let Some((value, g)) = field else { return x };
    let g2 = megas_math::vec3::dot(g, g);
    let step = megas_math::vec3::scale(g, -value / g2.max(1e-6));
    let length = megas_math::vec3::norm(step);
    megas_math::vec3::add_scaled(x, step, if length > STEP { STEP / length } else { 1.0 })
}

#[cfg(test)]
mod tests;
