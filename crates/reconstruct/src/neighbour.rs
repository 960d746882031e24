//! The second view of an iteration, for the losses between two views (splatting.md §5.2).

use megas_capture::Photo;
use megas_math::rng::Rng;
use megas_model::{Camera, Splats};
use megas_raster::{Channels, Cotangents, Frame, Gaussians, Gradients, Rasterizer, Settings};

use crate::loss::multiview::{MultiView, MultiViewImage, MultiViewSettings, grey, neighbours};
use crate::loss::{PlaneGradient, PlaneImages};
use crate::options::Options;

/// Nearest distance from the neighbour's camera, in units of the extent.
const MIN_DEPTH: f32 = 0.1;

/// Renders a neighbour of the iteration's view and compares the two.
#[derive(Default)]
pub(crate) struct Neighbour {
    rasterizer: Rasterizer,
    frame: Frame,
    cotangents: Cotangents,
    gradients: Gradients,
    loss: MultiView,
    /// Neighbours of every view, made when first needed.
    near: Option<Vec<Vec<u32>>>,
    /// Brightness of the photographs, made when first needed.
    grey: Vec<Option<Vec<f32>>>,
}

fn planes(frame: &Frame) -> PlaneImages<'_> {
    PlaneImages { normal: &frame.normal, plane: &frame.plane, transmittance: &frame.transmittance }
}

/// Colours of a photograph; transparent parts are black.
pub(crate) fn on_black(photo: &Photo) -> Vec<[f32; 3]> {
    let colour = |p: &[u8]| {
        let a = p.get(3).map_or(1.0, |&a| f32::from(a) / 255.0);
        [0, 1, 2].map(|k| f32::from(p[k]) / 255.0 * a)
    };
    photo.pixels.chunks_exact(photo.channels as usize).map(colour).collect()
}

impl Neighbour {
    /// Compares view `view`, rendered as `frame`, with one of its neighbours, drawn anew in every iteration. `gaussians` are
    /// the splats at rest with their colours. Adds the weighted derivatives to the normals and planes of `cotangents`, and
    /// keeps those of the neighbour for [`Neighbour::add_to`]. Returns the weighted loss; `None` without a neighbour.
    pub fn compare(
        &mut self,
        views: &[Photo],
        view: usize,
        gaussians: &Gaussians,
        frame: &Frame,
        options: &Options,
        step: u32,
        cotangents: &mut Cotangents,
    ) -> Option<(usize, f64)> {
        let extent = options.extent;
        let near = self.near.get_or_insert_with(|| {
            let cameras: Vec<Camera> = views.iter().map(|p| p.camera).collect();
            neighbours(&cameras, extent)
        });
        let mut rng = Rng::new(options.seed ^ (u64::from(step) << 24) ^ 0x9b);
        let list = &near[view];
        if list.is_empty() {
            return None;
        }
        let other = list[rng.below(list.len())] as usize;
        let camera = &views[other].camera;
        self.rasterizer.render(gaussians, camera, &Settings::default(), Channels::Geometry, &mut self.frame);
        self.grey.resize(views.len(), None);
        for k in [view, other] {
            self.grey[k].get_or_insert_with(|| grey(&on_black(&views[k])));
        }
        let pixels = self.frame.transmittance.len();
        let c = &mut self.cotangents;
        c.normal.clear();
        c.normal.resize(pixels, [0.0; 3]);
        c.plane.clear();
        c.plane.resize(pixels, 0.0);
        let settings = MultiViewSettings {
            lambda_geo: options.weights.geometric,
            lambda_ncc: options.weights.ncc,
            min_depth: MIN_DEPTH * extent,
            phase: rng.unit() as f32,
            ..MultiViewSettings::default()
        };
        let image = |k: usize, frame| MultiViewImage {
            camera: &views[k].camera,
            planes: planes(frame),
            grey: self.grey[k].as_deref().unwrap_or_default(),
        };
        let loss = self.loss.evaluate(
            image(view, frame),
            image(other, &self.frame),
            &settings,
            PlaneGradient { normal: &mut cotangents.normal, plane: &mut cotangents.plane },
            Some(PlaneGradient { normal: &mut c.normal, plane: &mut c.plane }),
        );
        Some((other, f64::from(settings.lambda_geo) * loss.geo + f64::from(settings.lambda_ncc) * loss.ncc))
    }

    /// Adds what the neighbour `camera` says to the gradients of the geometry. It has no part in the statistics of the
    /// refinement, which belong to the iteration's own view.
    pub fn add_to(&mut self, splats: &Splats, camera: &Camera, out: &mut Gradients) {
        let (settings, channels) = (Settings::default(), Channels::Geometry);
        self.rasterizer.backward(splats, camera, &settings, channels, &self.frame, &self.cotangents, &mut self.gradients);
        let g = &self.gradients;
        let add = |a: &mut [f32], b: &[f32]| a.iter_mut().zip(b).for_each(|(a, b)| *a += b);
        add(out.mean.as_flattened_mut(), g.mean.as_flattened());
        add(out.log_scale.as_flattened_mut(), g.log_scale.as_flattened());
        add(out.rotation.as_flattened_mut(), g.rotation.as_flattened());
        add(&mut out.opacity_logit, &g.opacity_logit);
    }
}
