//! The object as it truly is: its surface with colours taken from the photographs, deformed.

use std::collections::BTreeMap;
use std::path::Path;

use megas_body::neighbours::Neighbours;
use megas_capture::Photo;
use megas_formats::read_mesh_ply;
use megas_math::{mat3, vec3};
use megas_metrics::cracks::{CrackViews, box_sphere};
use megas_metrics::deform::{Deformation, Stage, deformed, finely_divided};
use megas_metrics::fidelity::{SIZE, TrueView, TrueViews};
use megas_metrics::image::psnr;
use megas_metrics::mesh_view::MeshGeometry;
use megas_metrics::surface::MeshDistance;
use megas_model::{Camera, Mesh, Projection};
use rayon::prelude::*;

use crate::Failure;
use crate::reconstruct::pictures::over;

/// Longest edge of the true surface, in diagonals L (the design asks for 0.005 at most).
const EDGE: f64 = 0.003;
/// A vertex is seen where the surface drawn from the camera is no farther before it than this, in L.
const HIDDEN: f64 = 0.004;
/// Least cosine between surface and view, and least opacity of a pixel, from which a colour is taken.
const FACING: f32 = 0.2;
const OPAQUE: u8 = 250;
/// The picture for people: side \[px\], direction and distance (in radii) of the camera, field of view \[rad\]. One face of a cut
/// is seen.
const PORTRAIT: u32 = 256;
const PORTRAIT_FROM: [f32; 3] = [0.74, -0.58, 0.34];
const PORTRAIT_DISTANCE: f32 = 3.1;
const PORTRAIT_FIELD: f32 = 0.62;
/// Neighbours that colour the faces of a cut.
const NEIGHBOURS: usize = 8;

/// The true object.
pub struct Truth {
    /// Frame and sizes of the deformations.
    pub stage: Stage,
    /// The surface as delivered, and prepared for distances.
    pub delivered: Mesh,
    pub surface: MeshDistance,
    /// Its volume.
    pub volume: f64,
    /// Which vertices of `mesh` a photograph shows; the others take the colour of the nearest that are shown.
    seen: Vec<bool>,
    /// Size of a pixel of the training photographs at the object, scene units.
    pub pixel: f64,
    /// PSNR of the coloured surface against held-out photographs \[dB\]: no model can be judged better than that.
    pub psnr: f64,
    mesh: Mesh,
    inside: Option<Neighbours>,
    views: usize,
    states: BTreeMap<Deformation, State>,
}

/// The true object after a deformation, in the views that methods are judged in.
pub struct State {
    /// Views for cracks.
    pub cracks: CrackViews,
    /// Views for fidelity.
    pub views: TrueViews,
    /// The picture for people.
    pub portrait: TrueView,
}

impl Truth {
    /// Reads `mesh/whole.ply` of a capture and colours it from the training photographs. `views` pictures are compared per
    /// deformation.
    pub fn new(capture: &Path, train: &[Photo], test: &[Photo], views: usize) -> Result<Self, Failure> {
        let path = capture.join("mesh").join("whole.ply");
        let rough = read_mesh_ply(&path).map_err(|e| Failure::Input(format!("{e}; claims need a capture with its true surface")))?;
        let bad = || Failure::Input(format!("{}: the mesh has no usable triangles", path.display()));
        let surface = MeshDistance::new(&rough).map_err(|e| Failure::Input(format!("{}: {e}", path.display())))?;
        let stage = Stage::new(&rough.positions, mat3::identity()).ok_or_else(bad)?;
        let mut mesh = finely_divided(&Mesh { colours: Vec::new(), ..rough.clone() }, EDGE * stage.diagonal);
        let seen = photographed(&mut mesh, train, (HIDDEN * stage.diagonal) as f32);
        let pixel = pixel(train, vec3::cast(stage.scene([0.0, 0.0, 0.5 * stage.height])));
        let inside = Neighbours::new(&mesh.positions);
        let compare = |p: &Photo| {
            let view = TrueView::new(&mesh, p.camera);
            psnr(&view.image, &over(p, [1.0; 3]), None)
        };
        let psnr = test.iter().map(compare).sum::<f64>() / test.len().max(1) as f64;
        Ok(Self {
            stage,
            surface,
            volume: volume(&rough),
            delivered: rough,
            seen,
            pixel,
            psnr,
            mesh,
            inside,
            views,
            states: BTreeMap::new(),
        })
    }

    /// Fraction of the vertices that a photograph shows.
    pub fn photographed(&self) -> f64 {
        self.seen.iter().filter(|s| **s).count() as f64 / self.seen.len().max(1) as f64
    }

    /// Whether a photograph shows the place of the true surface nearest to `x`.
    pub fn is_photographed(&self, x: [f64; 3]) -> bool {
        let near = self.inside.as_ref().and_then(|t| t.nearest(&vec3::cast(x), 1).first().map(|n| n.0));
        near.is_some_and(|i| self.seen[i as usize])
    }

    /// The object after a deformation; it is made when first asked for.
    pub fn state(&mut self, d: Deformation) -> &State {
        if !self.states.contains_key(&d) {
            let mesh = self.deformed(&self.stage, d);
            let state = State {
                cracks: CrackViews::new(&mesh, self.stage.diagonal),
                views: TrueViews::new(&mesh, self.views, SIZE),
                portrait: TrueView::new(&mesh, portrait(&mesh)),
            };
            self.states.insert(d, state);
        }
        &self.states[&d]
    }

    /// The coloured surface after a deformation on `stage`, which may be on its way.
    pub fn deformed(&self, stage: &Stage, d: Deformation) -> Mesh {
        let colour = |x: [f64; 3]| {
            let near = self.inside.as_ref().map(|t| t.nearest(&vec3::cast(x), NEIGHBOURS)).unwrap_or_default();
            let (mut sum, mut weight) = ([0.0; 3], 0.0);
            for (i, d2) in near {
                let w = 1.0 / (d2 + 1e-9);
                sum = vec3::add_scaled(sum, self.mesh.colours[i as usize], w);
                weight += w;
            }
            sum.map(|c| if weight > 0.0 { c / weight } else { 0.5 })
        };
        deformed(&self.mesh, stage, d, colour)
    }
}

/// The camera of pictures for people.
pub fn portrait(mesh: &Mesh) -> Camera {
    let (centre, radius) = box_sphere(mesh);
    let eye = vec3::add_scaled(centre, PORTRAIT_FROM, PORTRAIT_DISTANCE * radius);
    Camera::look_at(eye, centre, [0.0, 0.0, 1.0], PORTRAIT_FIELD, PORTRAIT, PORTRAIT)
}

/// Median size of a pixel at a place.
fn pixel(photos: &[Photo], middle: [f32; 3]) -> f64 {
    let size = |p: &Photo| match p.camera.projection {
        Projection::Pinhole { fx, .. } => f64::from(vec3::norm(vec3::sub(p.camera.center(), middle)) / fx),
        Projection::Orthographic { scale } => f64::from(scale).recip(),
    };
    let mut sizes: Vec<f64> = photos.iter().map(size).collect();
    sizes.sort_unstable_by(f64::total_cmp);
    sizes.get(sizes.len() / 2).copied().unwrap_or(0.0)
}

/// Volume of a closed mesh, whichever way round it is.
fn volume(m: &Mesh) -> f64 {
    let v = |i: u32| vec3::cast::<f32, f64>(m.positions[i as usize]);
    m.triangles.iter().map(|&[a, b, c]| vec3::dot(v(a), vec3::cross(v(b), v(c))) / 6.0).sum::<f64>().abs()
}

/// Gives every vertex the mean of the photographed colours over the views that show it, weighted by the squared cosine. The
/// light is the photographs': it moves with the surface, as it does with splats. Returns which vertices are shown.
fn photographed(mesh: &mut Mesh, photos: &[Photo], hidden: f32) -> Vec<bool> {
    let normals = vertex_normals(mesh);
    let mut sum = vec![[0.0f32; 4]; mesh.positions.len()];
    for photo in photos {
        let camera = &photo.camera;
        let geometry = MeshGeometry::new(mesh, camera);
        let (w, h) = (camera.width as usize, camera.height as usize);
        let channels = photo.channels as usize;
        let eye = camera.center();
        sum.par_iter_mut().enumerate().with_min_len(256).for_each(|(i, sum)| {
            let x = mesh.positions[i];
            let p = camera.to_camera(x);
            let [u, v] = camera.project(p);
            let (u, v) = (u - 0.5, v - 0.5);
            let inside = p[2] > 0.0 && u >= 0.0 && v >= 0.0 && u < (w - 1) as f32 && v < (h - 1) as f32;
            let toward = vec3::normalize_or(vec3::sub(eye, x), [0.0, 0.0, 1.0]);
            let cos = vec3::dot(normals[i], toward);
            if !inside || cos < FACING {
                return;
            }
            let (x0, y0) = (u as usize, v as usize);
            let (fx, fy) = (u - x0 as f32, v - y0 as f32);
            let mut colour = [0.0f32; 3];
            for (k, weight) in [(1.0 - fx) * (1.0 - fy), fx * (1.0 - fy), (1.0 - fx) * fy, fx * fy].into_iter().enumerate() {
                let at = (y0 + k / 2) * w + x0 + k % 2;
                let pixel = &photo.pixels[at * channels..(at + 1) * channels];
                // A pixel beside an edge of the surface shows something else.
                if geometry.depth[at] < p[2] - hidden / cos || !geometry.depth[at].is_finite() || (channels == 4 && pixel[3] < OPAQUE) {
                    return;
                }
                (0..3).for_each(|c| colour[c] += weight * f32::from(pixel[c]) / 255.0);
            }
            let weight = cos * cos;
            (0..3).for_each(|c| sum[c] += weight * colour[c]);
            sum[3] += weight;
        });
    }
    let seen: Vec<u32> = (0..sum.len() as u32).filter(|&i| sum[i as usize][3] > 0.0).collect();
    let places: Vec<[f32; 3]> = seen.iter().map(|&i| mesh.positions[i as usize]).collect();
    let tree = Neighbours::new(&places);
    let colour = |i: usize| {
        let own = Some(i).filter(|&i| sum[i][3] > 0.0);
        let near = || tree.as_ref()?.nearest(&mesh.positions[i], 1).first().map(|n| seen[n.0 as usize] as usize);
        own.or_else(near).map_or([0.5; 3], |i| [0, 1, 2].map(|c| sum[i][c] / sum[i][3]))
    };
    mesh.colours = (0..sum.len()).into_par_iter().with_min_len(256).map(colour).collect();
    sum.iter().map(|s| s[3] > 0.0).collect()
}

fn vertex_normals(mesh: &Mesh) -> Vec<[f32; 3]> {
    let mut normals = vec![[0.0f32; 3]; mesh.positions.len()];
    for t in &mesh.triangles {
        let [a, b, c] = t.map(|v| mesh.positions[v as usize]);
        let n = vec3::cross(vec3::sub(b, a), vec3::sub(c, a));
        t.iter().for_each(|&v| normals[v as usize] = vec3::add(normals[v as usize], n));
    }
    normals.into_iter().map(|n| vec3::normalize_or(n, [0.0, 0.0, 1.0])).collect()
}
