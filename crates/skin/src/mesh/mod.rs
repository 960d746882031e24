//! A closed mesh of the body, frame by frame (splatting.md §7.7).

pub mod attributes;
mod cells;
mod centre_distance;
mod clean;
mod measure;
mod nets;
mod patches;
mod volume;

pub use centre_distance::ParticleField;
pub use measure::{Surface, Topology};

use crate::imls::{FieldValue, Imls};
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
    /// The field of the particles.
    pub field: ParticleField,
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
        Self { spacing, voxel, offset: 0.55, field: ParticleField::AveragedCentre, smoothing: 5, speck_area: 0.01 }
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

/// Beyond so many spacings of the particles (or twice as many of the samples) from the nearest sample the skin says nothing.
const SKIN_REACH: f32 = 1.5;

/// The skin is asked where the particles' field is within so many spacings of zero.
const SKIN_BAND: f32 = 2.5;

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
    body_mesh(points, None, settings)
}

/// As [`particle_mesh`], but the surface follows the implicit surface of the skin where that is defined: `F = βf + (1−β)g`,
/// β falling with the sideways distance to the nearest sample (splatting.md §7.7, step 2). Particles of the inside
/// keep it closed everywhere else.
pub fn body_mesh(points: &[[f32; 3]], skin: Option<&Imls>, settings: &MeshSettings) -> Mesh {
    let finite: Vec<[f32; 3]> = points.iter().filter(|p| p.iter().all(|v| v.is_finite())).copied().collect();
    if finite.is_empty() || !(settings.voxel > 0.0 && settings.spacing > 0.0) {
        return Mesh::default();
    }
    let voxel = settings.voxel.min(2.0 * settings.spacing);
    let frame = Frame::new(&finite, voxel);
    let local: Vec<[f32; 3]> = finite.par_iter().map(|p| frame.to_voxels(*p)).filter(|p| p.iter().all(|v| *v < LARGEST)).collect();
    let spacing = (settings.spacing / voxel) as f32;
    let cells = Cells::new(&local, 2.0 * spacing);
    let field = CentreDistance::new(spacing, settings.offset, settings.field);
    let skin = skin.map(|imls| Skin { imls, reach: SKIN_REACH * (settings.spacing as f32).max(2.0 * imls.spacing()) });
    let volume = Volume::new(&cells, |node, wanted, out| {
        field.at_nodes(&cells, node, wanted, out);
        if let Some(skin) = &skin {
            blend_nodes(skin, &frame, node, wanted, SKIN_BAND * spacing, out);
        }
    });
    let mut net = nets::surface_net(&volume, &cells, |x| {
        let inner = field.at(&cells, x);
        let outer = skin.as_ref().map(|s| s.at(frame.to_scene(x)));
        newton(x, blended(outer, inner, voxel as f32))
    });
    drop(volume);
    let void = (VOID * settings.spacing / voxel).powi(3);
    clean::remove_specks(&mut net, settings.speck_area, SPECK_TRIANGLES, void);
    clean::collapse_short_edges(&mut net, SHORTEST);
    clean::taubin(&mut net, settings.smoothing);
    let normals = clean::normals(&net.vertices, &net.triangles);
    let positions = net.vertices.par_iter().map(|p| frame.to_scene(*p)).collect();
    Mesh { positions, normals, triangles: net.triangles, ..Mesh::default() }
}

/// The implicit surface of the skin, and how far from its samples it is believed \[scene units\].
struct Skin<'a> {
    imls: &'a Imls,
    reach: f32,
}

impl Skin<'_> {
    /// The field at a place with its share.
    fn at(&self, x: [f32; 3]) -> (FieldValue, f32) {
        let f = self.imls.evaluate(x);
        (f, self.share(&f))
    }

    /// Share β of the skin's field at a place; 0 where it is not defined. Sideways from the nearest sample counts: inside a skin that
    /// is less than half a bandwidth, beyond its border the field continues it as a plane, and the design's fade (over one voxel at a
    /// distance of 1.5h) lets such planes stick out. Bandwidths grow with the distance, so the distance itself is limited too:
    /// below an object whose underside nobody saw, everything would be inside.
    fn share(&self, f: &FieldValue) -> f32 {
        if !f.is_valid() || f.nearest >= 1.5 * f.bandwidth {
            return 0.0;
        }
        let sideways = (f.nearest * f.nearest - f.value * f.value).max(0.0).sqrt();
        let near = ((self.reach - f.nearest) / (0.3 * self.reach)).clamp(0.0, 1.0);
        near * ((1.2 - sideways / f.bandwidth) / 0.5).clamp(0.0, 1.0)
    }
}

/// Blends the skin's field into the values of a block, at the wanted nodes closer than `band` \[voxels\] to the zero set.
fn blend_nodes(skin: &Skin<'_>, frame: &Frame, node: [i32; 3], wanted: &[u8; 64], band: f32, out: &mut [[f32; 8]; 64]) {
    let mut places = Vec::new();
    let mut points = Vec::new();
    for row in 0..64 {
        for x in 0..8 {
            if wanted[row] >> x & 1 == 1 && out[row][x].abs() < band {
                places.push((row, x));
                points.push(frame.to_scene([node[0] + x as i32, node[1] + row as i32 % 8, node[2] + row as i32 / 8].map(|v| v as f32)));
            }
        }
    }
    let voxel = frame.voxel as f32;
    // Rows of nodes share what is gathered for the first of them.
    let margin = 4.0 * voxel;
    for ((row, x), f) in places.into_iter().zip(skin.imls.evaluate_near(&points, skin.reach, margin)) {
        let beta = skin.share(&f);
        let g = &mut out[row][x];
        *g += beta * (f.value / voxel - *g);
    }
}

/// Value and gradient of the blended field \[voxels\]; the slope of β itself is left out.
fn blended(outer: Option<(FieldValue, f32)>, inner: Option<(f32, [f32; 3])>, voxel: f32) -> Option<(f32, [f32; 3])> {
    match (outer, inner) {
        (Some((f, beta)), _) if beta >= 1.0 => Some((f.value / voxel, f.gradient)),
        (Some((f, beta)), Some((g, slope))) if beta > 0.0 => {
            Some((g + beta * (f.value / voxel - g), megas_math::vec3::lerp(slope, f.gradient, beta)))
        }
        _ => inner,
    }
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
