//! The training loop (splatting.md §5): one view an iteration, forward, losses, backward, Adam, and at milestones the
//! refinements. Everything random follows from the seed and the iteration, so a resumed training goes on bit by bit as the
//! uninterrupted one, with any number of threads.

use fearless_simd::Level;
use megas_capture::{Photo, Seeds};
use megas_math::{rng::Rng, sh};
use megas_model::{Camera, Image, Projection, Splats, logit};
use megas_raster::{Channels, Cotangents, Frame, Gaussians, Gradients, Rasterizer, Settings, Statistics};
use rayon::prelude::*;
use serde::Serialize;

use crate::colours::{BATCH, Looks};
use crate::exposure::Exposures;
use crate::loss::{NormalConsistency, Photometric, PlaneGradient, PlaneImages, Target, alpha, edge_weights, regularise};
use crate::model::Model;
use crate::neighbour::{Neighbour, on_black};
use crate::options::{Background, GIANT, Options, seen_depth};
use crate::refine::{Refined, densify, relocate, reset_opacity, wander};

/// Largest share that one pruning may remove before its threshold is halved (splatting.md §5.6).
const MOST_PRUNED: f64 = 0.6;
/// Thresholds that are tried, largest first, and what their removal may cost \[dB\].
const AUTO_TAU: [f32; 5] = [0.2, 0.1, 0.05, 0.02, 0.01];
const AUTO_LOSS: f64 = 0.1;
/// Least share of the views that must see a Gaussian in front, least share of its weight there, and the pruning threshold
/// from which both are asked.
const FRONT_VIEWS: f64 = 0.08;
const FRONT_SHARE: f32 = 0.15;
const FRONT_TAU: f32 = 0.05;
/// Share of needles above which the controller raises the weight of the anisotropy loss, its factor and its cap (§5.2).
const NEEDLES: (f64, f32, f32) = (0.02, 1.5, 10.0);

/// What one iteration found.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct StepReport {
    /// Iteration, from 1.
    pub step: u32,
    /// Mean absolute difference of the colours.
    pub l1: f64,
    /// Mean structural similarity.
    pub ssim: f64,
    /// Total loss.
    pub loss: f64,
    /// PSNR of this iteration's view, over its background \[dB\].
    pub psnr: f64,
    /// Gaussians after the iteration.
    pub gaussians: usize,
    /// What refinement did, if there was one.
    pub refined: Option<Refined>,
    /// Gaussians removed because no pixel shows them, and the threshold that was used.
    pub internal: Option<(usize, f32)>,
}

/// A training in progress.
pub struct Trainer {
    pub(crate) options: Options,
    views: Vec<Photo>,
    pub(crate) model: Model,
    /// Maps of the views' colours; empty without exposure compensation.
    pub(crate) exposures: Exposures,
    pub(crate) step: u32,
    /// The controlled weight of the anisotropy loss.
    pub(crate) anisotropy: f32,
    pub(crate) was_reset: bool,
    order: (u32, Vec<usize>),
    work: Work,
}

/// Memory that lives across iterations.
struct Work {
    level: Level,
    rasterizer: Rasterizer,
    gaussians: Gaussians,
    frame: Frame,
    cotangents: Cotangents,
    gradients: Gradients,
    photometric: Photometric,
    normals: NormalConsistency,
    neighbour: Neighbour,
    target: Target,
    /// Edge weights per view, made when first needed.
    edges: Vec<Option<Vec<f32>>>,
    visible: Vec<u32>,
    mask: Vec<f32>,
}

/// Splats for the start of a training (splatting.md §2.5).
pub fn initial_splats(seeds: &Seeds) -> Splats {
    let mut splats = Splats::with_capacity(0, seeds.position.len());
    for ((x, c), s) in seeds.position.iter().zip(&seeds.colour).zip(&seeds.sigma) {
        splats.push(*x, [s.ln(); 3], [1.0, 0.0, 0.0, 0.0], logit(0.1), &c.map(sh::dc_from_rgb));
    }
    splats
}

impl Trainer {
    /// Starts a training of `splats` on `views`.
    ///
    /// # Panics
    /// Without views or splats: callers check both.
    pub fn new(views: Vec<Photo>, mut splats: Splats, options: Options) -> Self {
        assert!(!views.is_empty() && !splats.is_empty(), "nothing to train");
        options.clamp(&mut splats);
        // What another training knew: this one fits them to its own pixels.
        splats.trained_pixel.fill(0.0);
        let edges = vec![None; views.len()];
        let exposures = Exposures::new(if options.exposure.is_some() { views.len() } else { 0 });
        Self {
            anisotropy: options.weights.anisotropy,
            options,
            views,
            model: Model::new(splats),
            exposures,
            step: 0,
            was_reset: false,
            order: (u32::MAX, Vec::new()),
            work: Work {
                level: Level::new(),
                rasterizer: Rasterizer::new(),
                gaussians: Gaussians::default(),
                frame: Frame::default(),
                cotangents: Cotangents::default(),
                gradients: Gradients::default(),
                photometric: Photometric::new(),
                normals: NormalConsistency::new(),
                neighbour: Neighbour::default(),
                target: Target::default(),
                edges,
                visible: Vec::new(),
                mask: Vec::new(),
            },
        }
    }

    /// Iterations done.
    pub fn step_count(&self) -> u32 {
        self.step
    }

    /// True when all planned iterations are done.
    pub fn done(&self) -> bool {
        self.step >= self.options.iterations
    }

    /// Options.
    pub fn options(&self) -> &Options {
        &self.options
    }

    /// Training views.
    pub fn views(&self) -> &[Photo] {
        &self.views
    }

    /// Gives the training views back.
    pub(crate) fn into_views(self) -> Vec<Photo> {
        self.views
    }

    /// The splats as they are.
    pub fn splats(&self) -> &Splats {
        &self.model.splats
    }

    /// The splats with identities of their own and the sizes of the pixels that they were trained on, for a file.
    pub fn export(&self) -> Splats {
        let mut splats = self.model.splats.clone();
        splats.birth_id = (0..splats.len() as u32).collect();
        splats.trained_pixel = pixels(&splats.mean, self.views.iter().map(|v| &v.camera));
        splats
    }

    /// The current splats seen through `camera`.
    pub fn render(&mut self, camera: &Camera, background: [f32; 3]) -> Image {
        let w = &mut self.work;
        w.gaussians.assign_splats(&self.model.splats);
        let settings = Settings { background, ..Settings::default() };
        w.rasterizer.render(&w.gaussians, camera, &settings, Channels::Rgba, &mut w.frame);
        w.frame.rgb_image()
    }

    /// Index of the view of iteration `step`: epochs in an order of their own, without replacement.
    fn view_of(&mut self, step: u32) -> usize {
        let n = self.views.len() as u32;
        let (epoch, k) = ((step - 1) / n, (step - 1) % n);
        if self.order.0 != epoch {
            let mut rng = Rng::new(self.options.seed.wrapping_mul(0x9e37) ^ (u64::from(epoch) << 8) ^ 0x51);
            let mut order: Vec<usize> = (0..n as usize).collect();
            for i in (1..order.len()).rev() {
                order.swap(i, rng.below(i + 1));
            }
            self.order = (epoch, order);
        }
        self.order.1[k as usize]
    }

    /// One iteration.
    pub fn step(&mut self) -> StepReport {
        let step = self.step + 1;
        let view = self.view_of(step);
        self.model.raise_degree(self.options.degree_at(step));
        let mut report = self.descend(view, step);
        self.step = step;
        self.refine(step, &mut report);
        if let Some(lambda) = self.options.settle_colours.filter(|_| self.done()) {
            self.settle_colours(f64::from(lambda));
        }
        report.gaussians = self.model.splats.len();
        report
    }

    /// Forward, losses, backward and the optimiser's step.
    fn descend(&mut self, view: usize, step: u32) -> StepReport {
        let Self { options, views, model, exposures, work, .. } = self;
        let photo = &views[view];
        let camera = &photo.camera;
        let (width, height) = (camera.width as usize, camera.height as usize);
        let pixels = width * height;
        let weights = &options.weights;
        let background = match options.background {
            Background::Fixed(c) => c,
            Background::Random => {
                let mut rng = Rng::new(options.seed ^ (u64::from(step) << 16) ^ 0xb6);
                std::array::from_fn(|_| rng.unit() as f32)
            }
        };
        let transparent = photo.channels == 4;
        if transparent {
            work.target.composite_u8(width, height, &photo.pixels, background);
        } else {
            work.target.set_u8(width, height, &photo.pixels);
        }
        match &photo.mask {
            Some(mask) => {
                work.mask.clear();
                work.mask.extend(mask.iter().map(|&v| f32::from(v) / 255.0));
                work.target.set_mask(Some(&work.mask));
            }
            None => work.target.set_mask(None),
        }

        let paired = weights.geometric > 0.0 || weights.ncc > 0.0;
        let planar = (weights.normal > 0.0 || paired) && step >= weights.normal_start;
        let channels = if planar { Channels::Geometry } else { Channels::Rgba };
        let settings = Settings { background, ..Settings::default() };
        work.gaussians.assign_shapes(&model.splats);
        lend(&mut model.splats, &mut work.gaussians, |g| work.rasterizer.render(g, camera, &settings, channels, &mut work.frame));

        let c = &mut work.cotangents;
        c.rgb.resize(pixels, [0.0; 3]);
        // The colours behind a matte belong to no photograph.
        let exposure = options.exposure.filter(|_| !transparent);
        let seen = if exposure.is_some() { exposures.expose(view, &work.frame.rgb) } else { &work.frame.rgb };
        let photometric = work.photometric.evaluate(seen, &work.target, weights.ssim, &mut c.rgb);
        let psnr = psnr(seen, work.target.rgb(), photo.mask.as_deref());
        if let Some(rates) = exposure {
            let by_map = exposures.pull_back(view, &work.frame.rgb, &mut c.rgb);
            let t = f64::from(step) / f64::from(options.iterations.max(1));
            // Every view has its turn once per epoch.
            exposures.step(view, &by_map, rates, (step - 1) / views.len() as u32 + 1, t);
        }
        let mut loss = photometric.total;
        c.alpha.clear();
        if transparent && weights.alpha > 0.0 {
            c.alpha.resize(pixels, 0.0);
            let truth = |i: usize| f32::from(photo.pixels[4 * i + 3]) / 255.0;
            loss += f64::from(weights.alpha) * alpha(&work.frame.transmittance, truth, weights.alpha, &mut c.alpha);
        }
        c.normal.clear();
        c.plane.clear();
        if planar {
            // Not from the target, whose background may be another one in every iteration.
            let edges = work.edges[view].get_or_insert_with(|| edge_weights(width, height, &on_black(photo)));
            c.normal.resize(pixels, [0.0; 3]);
            c.plane.resize(pixels, 0.0);
            let images = PlaneImages { normal: &work.frame.normal, plane: &work.frame.plane, transmittance: &work.frame.transmittance };
            let gradient = PlaneGradient { normal: &mut c.normal, plane: &mut c.plane };
            loss += f64::from(weights.normal) * work.normals.evaluate(camera, images, edges, weights.normal, gradient);
        }
        let mut other = None;
        if planar && paired {
            other = lend(&mut model.splats, &mut work.gaussians, |g| work.neighbour.compare(views, view, g, &work.frame, options, step, c));
        }
        work.rasterizer.backward(&model.splats, camera, &settings, channels, &work.frame, c, &mut work.gradients);

        if let Some((other, value)) = other {
            loss += value;
            work.neighbour.add_to(&model.splats, &views[other].camera, &mut work.gradients);
        }
        let g = &mut work.gradients;
        work.visible.clear();
        work.visible.extend((0..model.splats.len() as u32).filter(|&i| g.radius[i as usize] > 0.0));
        let (scales, visible) = (&model.splats.log_scale, &work.visible[..]);
        if weights.flat > 0.0 {
            loss += f64::from(weights.flat) * regularise::flatten(scales, visible, options.extent, weights.flat, &mut g.log_scale);
        }
        if self.anisotropy > 0.0 {
            let value = regularise::anisotropy(scales, visible, weights.anisotropy_limit, self.anisotropy, &mut g.log_scale);
            loss += f64::from(self.anisotropy) * value;
        }
        let [weight, bound] = weights.roundness;
        if weight > 0.0 {
            loss += f64::from(weight) * regularise::roundness(scales, visible, bound, weight, &mut g.log_scale);
        }
        let [weight, fraction, bound] = weights.volume_ratio;
        if weight > 0.0 {
            loss += f64::from(weight) * regularise::volume_ratio(scales, visible, fraction, bound, weight, &mut g.log_scale);
        }
        if let Some(mcmc) = &options.mcmc {
            loss += f64::from(mcmc.opacity_weight)
                * regularise::opacity(&model.splats.opacity_logit, visible, mcmc.opacity_weight, &mut g.opacity_logit);
            loss += f64::from(mcmc.scale_weight) * regularise::scale(scales, visible, mcmc.scale_weight, &mut g.log_scale);
        }

        if options.refinement.is_some_and(|r| step <= r.stop) {
            model.activity.add(&work.gradients);
        }
        let rates = options.rates_at(step);
        model.adam.step(work.level, &mut model.splats, &work.gradients, &rates);
        if let Some(mcmc) = &options.mcmc {
            wander(&mut model.splats, mcmc, rates.mean, options.seed, step);
        }
        options.clamp(&mut model.splats);
        StepReport { step, l1: photometric.l1, ssim: photometric.ssim, loss, psnr, ..StepReport::default() }
    }

    /// What happens at milestones, after the optimiser's step.
    fn refine(&mut self, step: u32, report: &mut StepReport) {
        if let Some(r) = self.options.refinement {
            let at_interval = step.is_multiple_of(r.every);
            if at_interval && step >= r.start && step <= r.stop {
                report.refined = Some(match self.options.mcmc {
                    Some(mcmc) => relocate(&mut self.model, &self.options, &mcmc, r.most, step),
                    None => densify(&mut self.model, &self.options, &r, step, self.was_reset),
                });
            }
            if r.trim_every > 0 && step >= r.trim_start && step <= r.stop && step.is_multiple_of(r.trim_every) {
                self.trim();
            }
            if self.options.mcmc.is_none() && r.reset_every > 0 && step < r.stop && step.is_multiple_of(r.reset_every) {
                reset_opacity(&mut self.model);
                self.was_reset = true;
            }
            if at_interval {
                self.control_needles();
                self.clear_cameras();
            }
        }
        let due: Vec<f32> = self.options.prune.iter().filter(|e| e.step == step).map(|e| e.tau).collect();
        for tau in due {
            let (mut gone, tau) = if self.options.prune_auto { self.prune_cheaply() } else { self.prune_internal(tau) };
            if tau >= FRONT_TAU {
                gone += self.prune_hidden();
            }
            report.internal = Some((gone, tau));
        }
    }

    /// Raises the weight of the anisotropy loss while too many needles are left (splatting.md §5.2).
    fn control_needles(&mut self) {
        if self.anisotropy <= 0.0 {
            return;
        }
        let limit = (1.1 * self.options.weights.anisotropy_limit).ln();
        let needles = self.model.splats.log_scale.iter().filter(|l| {
            let [first, second, _] = regularise::sorted(**l);
            l[first] - l[second] > limit
        });
        if needles.count() as f64 > NEEDLES.0 * self.model.splats.len() as f64 {
            self.anisotropy = (self.anisotropy * NEEDLES.1).min(NEEDLES.2.max(self.options.weights.anisotropy));
        }
    }

    /// Calms directional colours where no training view looked, with strength `lambda` (see `colours`); at the end of a training.
    pub fn settle_colours(&mut self, lambda: f64) {
        for first in (0..self.model.splats.len()).step_by(BATCH) {
            let mut looks = Looks::new(&self.model.splats, first);
            self.statistics(|camera, splats, s| looks.add(camera, splats, &s.w_sum));
            looks.settle(&mut self.model.splats, lambda);
        }
    }

    /// Statistics of all Gaussians over the training views; calls `each` after every view.
    fn statistics(&mut self, mut each: impl FnMut(&Camera, &Splats, &Statistics)) {
        let Self { views, work, model, .. } = self;
        work.gaussians.assign_splats(&model.splats);
        for photo in views.iter() {
            work.rasterizer.render(&work.gaussians, &photo.camera, &Settings::default(), Channels::Weights, &mut work.frame);
            each(&photo.camera, &model.splats, &work.frame.statistics);
        }
    }

    /// Largest blend weight of every Gaussian over the training views (splatting.md §5.6).
    pub fn largest_weights(&mut self) -> Vec<f32> {
        let mut w_max = vec![0.0f32; self.model.splats.len()];
        self.statistics(|_, _, s| w_max.iter_mut().zip(&s.w_max).for_each(|(a, b)| *a = a.max(*b)));
        w_max
    }

    /// Removes what no pixel shows with a weight above `tau`; returns how many and the threshold that was used.
    pub(crate) fn prune_internal(&mut self, mut tau: f32) -> (usize, f32) {
        let w_max = self.largest_weights();
        let share = |tau: f32| w_max.iter().filter(|&&w| w <= tau).count() as f64 / w_max.len().max(1) as f64;
        if share(tau) > MOST_PRUNED {
            tau *= 0.5;
        }
        // A training whose weights are all small (nothing fits yet) must not lose everything.
        if share(tau) >= 1.0 {
            return (0, tau);
        }
        (self.model.retain(|i| w_max[i] > tau), tau)
    }

    /// Removes as much of what no pixel shows as costs little (see [`Options::prune_auto`]).
    fn prune_cheaply(&mut self) -> (usize, f32) {
        let w_max = self.largest_weights();
        let before = self.mean_psnr(None);
        let affordable = |t: &mut Self, tau: f32| {
            let keep: Vec<usize> = (0..w_max.len()).filter(|&i| w_max[i] > tau).collect();
            !keep.is_empty() && t.mean_psnr(Some(&keep)) >= before - AUTO_LOSS
        };
        match AUTO_TAU.into_iter().find(|tau| affordable(self, *tau)) {
            Some(tau) => (self.model.retain(|i| w_max[i] > tau), tau),
            None => (0, 0.0),
        }
    }

    /// Mean PSNR of the training views, drawn with the Gaussians `keep` only, over black \[dB\].
    fn mean_psnr(&mut self, keep: Option<&[usize]>) -> f64 {
        let Self { views, work, model, exposures, options, .. } = self;
        match keep {
            Some(keep) => work.gaussians.assign_splats(&model.splats.select(keep)),
            None => work.gaussians.assign_splats(&model.splats),
        }
        let mut sum = 0.0;
        for (k, photo) in views.iter().enumerate() {
            let (width, height) = (photo.camera.width as usize, photo.camera.height as usize);
            work.rasterizer.render(&work.gaussians, &photo.camera, &Settings::default(), Channels::Rgba, &mut work.frame);
            if photo.channels == 4 {
                work.target.composite_u8(width, height, &photo.pixels, [0.0; 3]);
            } else {
                work.target.set_u8(width, height, &photo.pixels);
            }
            let seen =
                if photo.channels != 4 && options.exposure.is_some() { exposures.expose(k, &work.frame.rgb) } else { &work.frame.rgb };
            sum += psnr(seen, work.target.rgb(), photo.mask.as_deref());
        }
        sum / views.len() as f64
    }

    /// Removes what stands where the training views see through (see [`Options::clearance`]).
    fn clear_cameras(&mut self) {
        let near: Vec<_> = self.views.iter().map(|v| v.camera).zip(self.options.clearance.iter().copied()).collect();
        if near.is_empty() {
            return;
        }
        let free = |x: &[f32; 3]| near.iter().any(|(camera, clear)| seen_depth(camera, *x).is_some_and(|z| z < *clear));
        let gone: Vec<bool> = self.model.splats.mean.par_iter().map(free).collect();
        if gone.contains(&false) {
            self.model.retain(|i| !gone[i]);
        }
    }

    /// For each Gaussian the number of training views in which it is blended while more than half of the light is left (at
    /// most 255), and the share of its blend weights that it deposits so.
    pub fn front(&mut self) -> Vec<(u8, f32)> {
        let mut sums = vec![(0u8, [0.0f32; 2]); self.model.splats.len()];
        self.statistics(|_, _, s| {
            for (((views, sum), v), w) in sums.iter_mut().zip(&s.votes).zip(&s.w_sum) {
                *views = views.saturating_add(u8::from(*v != [0.0; 3]));
                // The rays of one view to one Gaussian are nearly parallel: the length of the vote is the sum of its weights.
                sum[0] += megas_math::vec3::norm(*v);
                sum[1] += w;
            }
        });
        sums.into_iter().map(|(views, [front, all])| (views, if all > 0.0 { front / all } else { 0.0 })).collect()
    }

    /// Removes what fewer than two views see in front (splatting.md §5.4).
    fn trim(&mut self) {
        self.retain_in_front(2, 0.0, f32::INFINITY);
    }

    /// Removes giants and what is in front in hardly any view or with hardly any of its weight. A glossy surface leaves floaters that
    /// show its highlights through thin places: they have large weights in a few pixels, but from nearly everywhere they are
    /// behind it.
    fn prune_hidden(&mut self) -> usize {
        let least = ((FRONT_VIEWS * self.views.len() as f64).ceil() as u8).max(2);
        self.retain_in_front(least, FRONT_SHARE, (0.99 * GIANT * self.options.extent).ln())
    }

    /// Keeps what at least `least` views see in front, with at least `share` of its weight, and what is smaller than the
    /// log-scale `giant`; everything where nothing would be left. Returns how many went.
    fn retain_in_front(&mut self, least: u8, share: f32, giant: f32) -> usize {
        let keep: Vec<bool> = self
            .front()
            .iter()
            .zip(&self.model.splats.log_scale)
            .map(|(&(views, front), l)| views >= least && front >= share && l.iter().all(|&l| l < giant))
            .collect();
        if self.views.len() < 2 || !keep.contains(&true) {
            return 0;
        }
        self.model.retain(|i| keep[i])
    }
}

/// Lends the colours of `splats`, most of their bytes, to `gaussians` while `f` draws them.
fn lend<R>(splats: &mut Splats, gaussians: &mut Gaussians, f: impl FnOnce(&Gaussians) -> R) -> R {
    gaussians.sh_degree = splats.sh_degree;
    std::mem::swap(&mut gaussians.sh, &mut splats.sh);
    let result = f(gaussians);
    std::mem::swap(&mut gaussians.sh, &mut splats.sh);
    result
}

/// Median size of a pixel at each place over the cameras that have it in their picture; 0 where none has.
fn pixels<'a>(places: &[[f32; 3]], cameras: impl Iterator<Item = &'a Camera>) -> Vec<f32> {
    let cameras: Vec<&Camera> = cameras.collect();
    let size = |x: &[f32; 3], camera: &Camera| {
        let p = camera.to_camera(*x);
        let [u, v] = camera.project(p);
        let inside = p[2] > 0.0 && u >= 0.0 && v >= 0.0 && u < camera.width as f32 && v < camera.height as f32;
        inside.then_some(match camera.projection {
            Projection::Pinhole { fx, .. } => p[2] / fx,
            Projection::Orthographic { scale } => scale.recip(),
        })
    };
    let median = |sizes: &mut Vec<f32>, x: &[f32; 3]| {
        sizes.clear();
        sizes.extend(cameras.iter().filter_map(|c| size(x, c)));
        let middle = sizes.len() / 2;
        if sizes.is_empty() { 0.0 } else { *sizes.select_nth_unstable_by(middle, f32::total_cmp).1 }
    };
    places.par_iter().with_min_len(256).map_init(Vec::new, median).collect()
}

/// PSNR of colours clamped to [0, 1], over the pixels that count.
fn psnr(rendered: &[[f32; 3]], truth: &[[f32; 3]], mask: Option<&[u8]>) -> f64 {
    let (mut sum, mut count) = (0.0, 0u32);
    for (i, (a, b)) in rendered.iter().zip(truth).enumerate() {
        if mask.is_none_or(|m| m[i] >= 128) {
            sum += f64::from((0..3).map(|k| (a[k].clamp(0.0, 1.0) - b[k]).powi(2)).sum::<f32>());
            count += 1;
        }
    }
    -10.0 * (sum / (3.0 * f64::from(count.max(1)))).max(1e-12).log10()
}
