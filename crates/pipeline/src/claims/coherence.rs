//! How calm films of a deformation are (splatting.md §9.3 M11): a few frames in the middle of a stretch and of a slump that take four
//! seconds, of splats and of meshes.
//!
//! The truth moves too. Beside the second difference in time, from which the design takes that of the truth, counted is that of what
//! differs from the truth: texture that moves as it should is no unrest then, and a picture that is calm because its texture is washed
//! out is not calm.

use megas_metrics::consistency::second_difference;
use megas_metrics::deform::{Carry, Deformation, Stage};
use megas_metrics::fidelity::{TrueView, draw};
use megas_metrics::mesh_quality::{MeshDifference, advected};
use megas_metrics::mesh_view::MeshGeometry;
use megas_metrics::surface::MeshDistance;
use megas_model::{Camera, Image, Mesh};
use megas_raster::{Frame, Gaussians, Rasterizer};
use megas_skin::imls::{Imls, ImlsSettings, Samples};
use megas_skin::mesh::attributes::{Carriers, colour};
use megas_skin::mesh::{MeshSettings, ParticleField, body_mesh};
use serde_json::{Map, Value, json};

use super::methods::Contender;
use super::model::{Filled, densifier, moved, posed_surface, with_inside};
use super::truth::{Truth, portrait};

/// The films.
pub const FILMS: [Deformation; 2] = [Deformation::Stretch, Deformation::Slump];
/// Frames of each, the share of the way where they begin, and the way from one to the next: the whole takes 96 frames.
const FRAMES: usize = 8;
const BEGIN: f64 = 0.45;
const STEP: f64 = 1.0 / 96.0;
/// Time between frames \[s\].
const DT: f32 = 1.0 / 24.0;
/// Key of the truth's own figures.
pub const TRUTH: &str = "truth";
/// Points at which meshes are compared.
const SAMPLES: usize = 20_000;

/// How the body is drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Look {
    /// Bare splats.
    Splats,
    /// Splats and kernels.
    Sealed,
    /// The mesh that films get: shaped by the splats, closed by the particles.
    SkinMesh,
    /// The mesh of the particles alone.
    ParticleMesh,
    /// The mesh of their density.
    DensityMesh,
}

impl Look {
    /// All of them, in the order of the tables.
    pub const ALL: [Self; 5] = [Self::Splats, Self::Sealed, Self::SkinMesh, Self::ParticleMesh, Self::DensityMesh];

    /// Key in the figures, and name in the tables.
    pub fn names(self) -> (&'static str, &'static str) {
        match self {
            Self::Splats => ("splats", "splats"),
            Self::Sealed => ("sealed", "splats and kernels"),
            Self::SkinMesh => ("skin_mesh", "mesh, shaped by the splats"),
            Self::ParticleMesh => ("particle_mesh", "mesh of the particles alone"),
            Self::DensityMesh => ("density_mesh", "mesh of their density"),
        }
    }
}

/// Figures of all films of a model. Null without particles.
pub fn coherence(model: &Filled, truth: &Truth) -> Value {
    if model.particles.is_empty() {
        return Value::Null;
    }
    let film = |d: Deformation| {
        let shots = Shots::new(truth, d);
        let poses: Vec<Pose> = shots.stages.iter().map(|s| Pose::new(model, s, d)).collect();
        let mut figures: Map<String, Value> =
            Look::ALL.map(|l| (l.names().0.to_owned(), shots.measure(model, &poses, l))).into_iter().collect();
        figures.insert(TRUTH.to_owned(), json!({ "second_difference": shots.plain(&shots.pictures) }));
        (d.id().to_owned(), Value::Object(figures))
    };
    Value::Object(FILMS.map(film).into_iter().collect())
}

/// A model in a frame.
struct Pose {
    /// Its splats, without and with what B6 does to them.
    plain: Gaussians,
    surface: Gaussians,
    /// Where its particles are.
    inside: Vec<[f32; 3]>,
}

impl Pose {
    fn new(model: &Filled, stage: &Stage, d: Deformation) -> Self {
        let posed = |method| posed_surface(method, model, stage, d, Carry::ElasticLike);
        Self { plain: posed(Contender::B5), surface: posed(Contender::B6), inside: moved(model, stage, d) }
    }
}

/// The truth of a film.
struct Shots {
    deformation: Deformation,
    camera: Camera,
    diagonal: f64,
    stages: Vec<Stage>,
    pictures: Vec<Image>,
    normals: Vec<Image>,
    /// Pixels where the object is in any frame.
    mask: Vec<bool>,
}

impl Shots {
    fn new(truth: &Truth, deformation: Deformation) -> Self {
        let stages: Vec<Stage> = (0..FRAMES).map(|k| truth.stage.partly(BEGIN + STEP * k as f64)).collect();
        let camera = portrait(&truth.deformed(&stages[FRAMES / 2], deformation));
        let mut out = Self {
            deformation,
            camera,
            diagonal: truth.stage.diagonal,
            stages,
            pictures: Vec::new(),
            normals: Vec::new(),
            mask: vec![false; camera.width as usize * camera.height as usize],
        };
        for stage in &out.stages {
            let mesh = truth.deformed(stage, deformation);
            out.pictures.push(TrueView::new(&mesh, camera).image);
            let geometry = MeshGeometry::new(&mesh, &camera);
            out.mask.iter_mut().zip(geometry.silhouette()).for_each(|(m, s)| *m |= s);
            out.normals.push(normals(&mesh, &geometry));
        }
        out
    }

    fn measure(&self, model: &Filled, poses: &[Pose], look: Look) -> Value {
        match look {
            Look::Splats | Look::Sealed => {
                let (mut sealing, mut rasterizer, mut frame) = (densifier(model), Rasterizer::new(), Frame::default());
                let picture = |p: &Pose| match look {
                    Look::Sealed => {
                        let all = with_inside(self.deformation, p.surface.clone(), &p.inside, &mut sealing, DT);
                        draw(&all, &self.camera, &mut rasterizer, &mut frame)
                    }
                    _ => draw(&p.plain, &self.camera, &mut rasterizer, &mut frame),
                };
                let pictures: Vec<Image> = poses.iter().map(picture).collect();
                json!({ "second_difference": self.plain(&pictures), "beyond_truth": self.beyond(&pictures, &self.pictures) })
            }
            Look::SkinMesh | Look::ParticleMesh | Look::DensityMesh => {
                let meshes: Vec<Mesh> = poses.iter().map(|p| self.mesh(model, p, look)).collect();
                let pictures: Vec<Image> = meshes.iter().map(|m| TrueView::new(m, self.camera).image).collect();
                let shapes: Vec<Image> = meshes.iter().map(|m| normals(m, &MeshGeometry::new(m, &self.camera))).collect();
                let steps = self.steps(poses, &meshes);
                let mean = |f: fn(&MeshDifference) -> f64| steps.iter().map(f).sum::<f64>() / steps.len().max(1) as f64;
                json!({
                    "second_difference": self.plain(&pictures),
                    "beyond_truth": self.beyond(&pictures, &self.pictures),
                    "normals_beyond_truth": self.beyond(&shapes, &self.normals),
                    "chamfer": mean(|d| d.chamfer),
                    "p95": mean(|d| d.p95),
                    "normal_deg": mean(|d| d.normal_mean).to_degrees(),
                })
            }
        }
    }

    fn plain(&self, pictures: &[Image]) -> Option<f64> {
        second_difference(pictures, &self.mask)
    }

    fn beyond(&self, pictures: &[Image], truth: &[Image]) -> Option<f64> {
        let less = |(a, b): (&Image, &Image)| Image { data: a.data.iter().zip(&b.data).map(|(a, b)| a - b).collect(), ..a.clone() };
        second_difference(&pictures.iter().zip(truth).map(less).collect::<Vec<_>>(), &self.mask)
    }

    fn mesh(&self, model: &Filled, pose: &Pose, look: Look) -> Mesh {
        let Pose { surface, inside, .. } = pose;
        let samples = Samples { position: surface.mean.clone(), normal: surface.normal.clone(), weight: Vec::new() };
        let skin = (look == Look::SkinMesh).then(|| Imls::new(&samples.raised(model.depth as f32), &ImlsSettings::default())).flatten();
        let field = if look == Look::DensityMesh { ParticleField::Density } else { ParticleField::AveragedCentre };
        let settings = MeshSettings { field, ..MeshSettings::new(model.spacing, self.diagonal) };
        let mut mesh = body_mesh(inside, skin.as_ref(), &settings);
        let own: Vec<[f32; 3]> = (0..model.surface.len()).map(|i| model.surface.seen_rgb(i).map(|v| v.clamp(0.0, 1.0))).collect();
        let outer = Carriers { position: &surface.mean, value: &own };
        colour(&mut mesh, outer, Carriers { position: inside, value: &model.colour }, model.spacing as f32);
        mesh
    }

    /// Every mesh, carried to the next frame by the particles, against the mesh of that frame.
    fn steps(&self, poses: &[Pose], meshes: &[Mesh]) -> Vec<MeshDifference> {
        let step = |k: usize| {
            let carried = advected(&meshes[k], &poses[k].inside, &poses[k + 1].inside)?;
            let (a, b) = (MeshDistance::new(&carried).ok()?, MeshDistance::new(&meshes[k + 1]).ok()?);
            Some(MeshDifference::new((&carried, &a), (&meshes[k + 1], &b), self.diagonal, SAMPLES))
        };
        (0..meshes.len() - 1).filter_map(step).collect()
    }
}

/// Normals as a picture; zero where nothing is.
fn normals(mesh: &Mesh, geometry: &MeshGeometry) -> Image {
    let data = (0..geometry.triangle.len()).flat_map(|i| geometry.normal(mesh, i).unwrap_or_default()).collect();
    Image { width: geometry.width, height: geometry.height, channels: 3, data }
}
