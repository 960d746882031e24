//! What is trained and how: methods, profiles and every constant behind them (splatting.md §5).

use megas_capture::Photo;
use megas_model::{Camera, Splats};
use serde::{Deserialize, Serialize};

use crate::exposure::ExposureRates;

/// The methods that are compared (splatting.md §5.8); each is a set of switches of one trainer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Method {
    /// Plain 3D Gaussian splatting (B0).
    Vanilla,
    /// B0 with PhysGaussian's bound of the ratio of the largest to the smallest axis (B1).
    Physgaussian,
    /// B0 with VR-DoH's bound of the ratio of volumes (B2).
    Vrdoh,
    /// The planar backbone: flattened Gaussians with consistent normals (B3).
    Pgsr,
    /// B3 with internal-free pruning (B4).
    PgsrPrune,
    /// B4 with the anisotropy loss and scale clamping: what survives melting (B5).
    Ours,
}

impl Method {
    /// All methods, in the order of the tables.
    pub const ALL: [Self; 6] = [Self::Vanilla, Self::Physgaussian, Self::Vrdoh, Self::Pgsr, Self::PgsrPrune, Self::Ours];

    /// The name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Vanilla => "vanilla",
            Self::Physgaussian => "physgaussian",
            Self::Vrdoh => "vrdoh",
            Self::Pgsr => "pgsr",
            Self::PgsrPrune => "pgsr-prune",
            Self::Ours => "ours",
        }
    }
}

/// How long and how large (splatting.md §5.7).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Profile {
    /// 1 500 iterations, at most 5 000 Gaussians: tests.
    Tiny,
    /// 7 000 iterations: objects on a CPU.
    Object,
    /// 30 000 iterations.
    Full,
    /// 30 000 iterations with the multi-view terms.
    RealHq,
}

impl Profile {
    /// Planned iterations.
    pub fn iterations(self) -> u32 {
        match self {
            Self::Tiny => 1_500,
            Self::Object => 7_000,
            Self::Full | Self::RealHq => 30_000,
        }
    }

    /// The name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Tiny => "tiny",
            Self::Object => "object",
            Self::Full => "full",
            Self::RealHq => "real-hq",
        }
    }
}

/// What renders and transparent targets are put on.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Background {
    /// One colour.
    Fixed([f32; 3]),
    /// Another colour in every iteration: nothing can hide behind half transparency.
    Random,
}

/// A box in which kernels are clamped and about whose size thresholds are expressed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Region {
    /// Centre, scene units.
    pub center: [f32; 3],
    /// Unit axes as rows.
    pub axes: [[f32; 3]; 3],
    /// Half extents along the axes.
    pub half: [f32; 3],
}

impl Region {
    /// The axis-aligned box between two corners.
    pub fn aligned(min: [f32; 3], max: [f32; 3]) -> Self {
        Self {
            center: std::array::from_fn(|a| 0.5 * (min[a] + max[a])),
            axes: megas_math::mat3::identity(),
            half: std::array::from_fn(|a| 0.5 * (max[a] - min[a])),
        }
    }

    /// The length of the diagonal, `L`.
    pub fn diagonal(&self) -> f32 {
        2.0 * megas_math::vec3::norm(self.half)
    }

    /// True inside the box grown by the factor `grow`.
    pub fn contains(&self, x: [f32; 3], grow: f32) -> bool {
        let d = megas_math::vec3::sub(x, self.center);
        (0..3).all(|a| megas_math::vec3::dot(self.axes[a], d).abs() <= self.half[a] * grow)
    }
}

/// When Gaussians are added and removed (splatting.md §5.4). Iterations count from 1.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Refinement {
    /// First iteration.
    pub start: u32,
    /// Iterations between refinements.
    pub every: u32,
    /// Last iteration.
    pub stop: u32,
    /// Mean gradient of the projected mean, normalised device coordinates, from which a Gaussian is cloned or split.
    pub gradient: f32,
    /// Mean of the summed absolute gradients from which a large one is split too.
    pub absolute_gradient: Option<f32>,
    /// Boundary between cloning and splitting, in units of the extent E.
    pub split_size: f32,
    /// The copy is placed at a random point of the Gaussian instead of on it.
    pub sample_clones: bool,
    /// Gaussians with less opacity are removed.
    pub opacity: f32,
    /// Iterations between opacity resets; 0 for none.
    pub reset_every: u32,
    /// Iterations between removals of what fewer than two views see in front; 0 for none.
    pub trim_every: u32,
    /// First iteration of those removals: random initial points hide each other, and removed too early nothing is left to
    /// grow from (19 instead of 26 dB on the fox).
    pub trim_start: u32,
    /// Most Gaussians.
    pub most: usize,
}

/// One removal of Gaussians that no pixel shows with a weight above `tau` (splatting.md §5.6).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PruneEvent {
    /// Iteration.
    pub step: u32,
    /// Least largest weight.
    pub tau: f32,
}

/// Weights of the loss terms (splatting.md §5.2, §5.8); 0 switches a term off.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Weights {
    /// D-SSIM against L1.
    pub ssim: f32,
    /// Alpha of transparent targets.
    pub alpha: f32,
    /// Flatness, on S³/E.
    pub flat: f32,
    /// Needles, on S¹/S² above [`Weights::anisotropy_limit`].
    pub anisotropy: f32,
    /// The paper's `a`.
    pub anisotropy_limit: f32,
    /// Consistency of normals with depth.
    pub normal: f32,
    /// First iteration of the normal and the multi-view terms.
    pub normal_start: u32,
    /// Multi-view reprojection.
    pub geometric: f32,
    /// Multi-view patches.
    pub ncc: f32,
    /// PhysGaussian's roundness and its bound r.
    pub roundness: [f32; 2],
    /// VR-DoH's volume ratio: weight, fraction, bound.
    pub volume_ratio: [f32; 3],
}

/// Learning rates (splatting.md §5.3).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct LearningRates {
    /// Centres at the first and the last iteration, in units of the extent E.
    pub mean: [f32; 2],
    /// Log-scales.
    pub log_scale: f32,
    /// Quaternions.
    pub rotation: f32,
    /// Opacity logits.
    pub opacity: f32,
    /// Constant colour.
    pub dc: f32,
    /// Directional colour.
    pub rest: f32,
}

impl Default for LearningRates {
    fn default() -> Self {
        Self { mean: [1.6e-4, 1.6e-6], log_scale: 5e-3, rotation: 1e-3, opacity: 5e-2, dc: 2.5e-3, rest: 1.25e-4 }
    }
}

/// The strategy of sampling instead of thresholds (splatting.md §5.8), for a fixed budget.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Mcmc {
    /// Gaussians with less opacity are moved to a live one.
    pub dead_opacity: f32,
    /// Growth per refinement.
    pub growth: f32,
    /// Scale of the noise on the centres.
    pub noise: f32,
    /// Weight of the mean opacity.
    pub opacity_weight: f32,
    /// Weight of the mean scale.
    pub scale_weight: f32,
}

impl Default for Mcmc {
    fn default() -> Self {
        Self { dead_opacity: 0.005, growth: 0.05, noise: 5e5, opacity_weight: 0.01, scale_weight: 0.01 }
    }
}

/// Everything that determines a training besides the views and the initial splats.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Options {
    /// Method.
    pub method: Method,
    /// Planned iterations.
    pub iterations: u32,
    /// Seed of everything random.
    pub seed: u64,
    /// Loss.
    pub weights: Weights,
    /// Learning rates.
    pub rates: LearningRates,
    /// Adding and removing; `None` trains a fixed set.
    pub refinement: Option<Refinement>,
    /// Sampling strategy in place of thresholds.
    pub mcmc: Option<Mcmc>,
    /// Internal-free pruning.
    pub prune: Vec<PruneEvent>,
    /// Upper clamp of the standard deviations inside the object's region \[scene units\].
    pub scale_limit: Option<f32>,
    /// Where the object is.
    pub region: Option<Region>,
    /// Scene extent E \[scene units\].
    pub extent: f32,
    /// Highest degree of the spherical harmonics, 0–3.
    pub sh_degree: u8,
    /// Iterations between two degrees.
    pub sh_every: u32,
    /// Background.
    pub background: Background,
    /// Exposure compensation of opaque views; `None` takes all photographs as equally exposed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub exposure: Option<ExposureRates>,
    /// The thresholds of [`Options::prune`] are chosen by what a removal costs: the largest of 0.2, 0.1, 0.05, 0.02 and 0.01
    /// that lowers the mean PSNR of the training views by at most 0.1 dB (splatting.md §5.6).
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub prune_auto: bool,
    /// For every training view the depth before which there is nothing \[scene units\]; empty if that is not known.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub clearance: Vec<f32>,
    /// Strength with which directional colours are calmed at the end where no view looked; `None` leaves them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub settle_colours: Option<f32>,
}

/// Size in units of the extent E beyond which a Gaussian is no part of any surface.
pub(crate) const GIANT: f32 = 0.1;
/// The paper's τ_prune in its three stages.
const TAU: [f32; 5] = [0.02, 0.02, 0.05, 0.1, 0.1];
/// τ_scale in diagonals of the object, the lower end of the design's range. Its 0.01 leaves the areas of the kernels too
/// uneven: on the synthetic ice cream (2 500 iterations) their coefficient of variation is 1.05, and 0.65 with 0.006 at the
/// same PSNR. Smaller kernels also leave less room behind the surface ([`GRADIENT_CLAMPED`]).
const SCALE_LIMIT: f32 = 0.005;
/// Gradient from which Gaussians are cloned or split, and from which those that the clamp keeps small are: each covers less
/// of the picture, so its share of the same error is smaller. On the synthetic cow (2 500 iterations) 0.6 % of the opacity
/// is deeper than 0.02 L with 0.006 and 2e-4, and 0.1 % with this and 0.005.
pub(crate) const GRADIENT: f32 = 2e-4;
const GRADIENT_CLAMPED: f32 = 1.2e-4;
/// Learning rate of the directional colours of `ours` for 30 000 iterations, and the highest for shorter trainings. Other methods
/// show a highlight by Gaussians behind the surface; where these are removed, the directional colours alone have to, and where
/// a short training ends before they are learnt, the surface is dented below the highlight instead. On the synthetic cow:
/// 34.3 dB with 1.25e-4 and 35.7 dB with 5e-4 after 2 500 iterations; 36.71 dB and 0.55 % of the opacity deeper than 0.02 L with
/// 5.4e-4, and 36.92 dB and 0.48 % with 1e-3, after 7 000. The other methods keep the usual rate, although vanilla gains by a
/// faster one too (docs/results.md).
const REST: [f32; 2] = [2.4e-4, 1e-3];
/// The region in which kernels are clamped is this much larger than the object's box.
const INFLATED: f32 = 1.1;
/// Boundary between cloning and splitting in units of τ_scale. With the planar backbone's own boundary (0.001 E, several
/// times smaller) kernels keep being halved far below the clamp, and areas vary by 0.65 instead of 0.54.
pub(crate) const SPLIT_LIMIT: f32 = 0.7;
/// Iterations of the pruning events out of 30 000.
const PRUNE_AT: [u32; 5] = [8_000, 11_000, 14_000, 16_500, 20_000];
/// `ours` prunes once more near the end, as fine-tuning does: what has lost its weight to the surface since the paper's last
/// event is behind it by then. On the synthetic cow 0.6 % of the Gaussians are hidden instead of 2.0 %, for 0.03 dB.
const LAST_PRUNE: PruneEvent = PruneEvent { step: 27_000, tau: 0.1 };

/// Strength of [`Options::settle_colours`]. Held-out photographs against deformed objects seen from all sides (ice cream, cow; twist): 0 has
/// 42.32, 36.92 and 38.31, 29.46 dB, 0.02 has 42.22, 36.81 and 38.75, 29.78 dB, this 41.98, 36.54 and 39.17, 30.25 dB.
const SETTLE: f32 = 0.08;

/// Fewest pixels of all opaque training views together for every Gaussian.
const PIXELS_PER_GAUSSIAN: usize = 24;
/// Share of the points in a view that are taken for outliers when they are nearest, and which part of the distance to the
/// next is free for certain.
const CLEARANCE: (f64, f32) = (0.02, 0.5);

/// Depth before which `camera` has nothing, 0 if it sees no point.
fn clearance(camera: &Camera, points: &[[f32; 3]]) -> f32 {
    let mut depths: Vec<f32> = points.iter().filter_map(|x| seen_depth(camera, *x)).collect();
    let at = (depths.len() as f64 * CLEARANCE.0) as usize;
    if depths.is_empty() {
        return 0.0;
    }
    CLEARANCE.1 * *depths.select_nth_unstable_by(at, f32::total_cmp).1
}

/// Depth of a point inside the image of `camera`.
pub(crate) fn seen_depth(camera: &Camera, x: [f32; 3]) -> Option<f32> {
    let p = camera.to_camera(x);
    if p[2].is_nan() || p[2] <= 0.0 {
        return None;
    }
    let [u, v] = camera.project(p);
    (u >= 0.0 && v >= 0.0 && u < camera.width as f32 && v < camera.height as f32).then_some(p[2])
}

impl Options {
    /// The defaults of a method and a profile for a scene of extent `extent`, with an object in `region` if there is one.
    /// `transparent` says that the views have alpha. `cell` is the side of the simulator's cells in scene units, if known.
    pub fn new(method: Method, profile: Profile, extent: f32, region: Option<Region>, transparent: bool, cell: Option<f32>) -> Self {
        Self::with_iterations(method, profile, profile.iterations(), extent, region, transparent, cell)
    }

    /// As [`Options::new`] with another number of iterations: all milestones follow.
    pub fn with_iterations(
        method: Method,
        profile: Profile,
        iterations: u32,
        extent: f32,
        region: Option<Region>,
        transparent: bool,
        cell: Option<f32>,
    ) -> Self {
        let f = f64::from(iterations) / 30_000.0;
        let at = |step: u32| ((f64::from(step) * f).round() as u32).max(1);
        let tiny = profile == Profile::Tiny;
        let planar = matches!(method, Method::Pgsr | Method::PgsrPrune | Method::Ours);
        let pruned = matches!(method, Method::PgsrPrune | Method::Ours);
        let ours = method == Method::Ours;
        let on = |yes: bool, v: f32| if yes { v } else { 0.0 };
        let scale_limit = region.filter(|_| ours).map(|r| {
            let share = if tiny { 0.02 } else { SCALE_LIMIT } * r.diagonal();
            cell.filter(|_| !tiny).map_or(share, |c| share.min(0.5 * c))
        });
        let split = if planar { 0.001 } else { 0.01 };
        Self {
            method,
            iterations,
            seed: 0,
            weights: Weights {
                ssim: 0.2,
                alpha: on(transparent, 0.1),
                flat: on(planar, 100.0),
                anisotropy: on(ours, 1.0),
                anisotropy_limit: 2.0,
                normal: on(planar, 0.015),
                normal_start: at(7_000),
                geometric: on(planar && profile == Profile::RealHq, 0.03),
                ncc: on(planar && profile == Profile::RealHq, 0.15),
                roundness: [on(method == Method::Physgaussian, 1.0), 3.0],
                volume_ratio: [on(method == Method::Vrdoh, 0.01), 0.3, 5.0],
            },
            rates: LearningRates {
                rest: if ours { (REST[0] / f as f32).clamp(REST[0], REST[1]) } else { LearningRates::default().rest },
                ..LearningRates::default()
            },
            refinement: Some(Refinement {
                start: at(500),
                every: at(100).max(50),
                stop: at(15_000),
                gradient: if scale_limit.is_some() && !tiny { GRADIENT_CLAMPED } else { GRADIENT },
                absolute_gradient: planar.then_some(8e-4),
                split_size: scale_limit.map_or(split, |s| SPLIT_LIMIT * s / extent),
                sample_clones: planar,
                opacity: 0.005,
                reset_every: if tiny { 0 } else { at(3_000).max(600) },
                trim_every: if planar { at(1_000).max(100) } else { 0 },
                trim_start: at(6_000),
                most: match profile {
                    Profile::Tiny => 5_000,
                    Profile::Object => 300_000,
                    Profile::Full | Profile::RealHq => 6_000_000,
                },
            }),
            mcmc: None,
            prune: PRUNE_AT
                .iter()
                .zip(TAU)
                .map(|(&step, tau)| PruneEvent { step, tau })
                .filter(|_| pruned)
                .chain(ours.then_some(LAST_PRUNE))
                .map(|event| PruneEvent { step: at(event.step), ..event })
                .collect(),
            scale_limit,
            region,
            extent,
            sh_degree: 3,
            sh_every: at(1_000).max(250),
            background: if transparent { Background::Random } else { Background::Fixed([0.0; 3]) },
            exposure: None,
            prune_auto: false,
            clearance: Vec::new(),
            settle_colours: ours.then_some(SETTLE),
        }
    }

    /// Limits what is trained to what opaque `views` can determine. A capture of a dozen photographs has room for hundreds of
    /// thousands of Gaussians that each explain a few pixels of one view, and for colours that are another one from every
    /// direction: the training views are met to the grain, and all others badly. Mattes leave little room for this, so
    /// transparent views are no reason for limits.
    ///
    /// `points` are points on the surfaces, such as structure from motion finds; nothing stands much nearer to a camera than
    /// the nearest of those that it sees.
    pub fn suit(&mut self, views: &[Photo], points: Option<&[[f32; 3]]>) {
        if views.iter().all(|v| v.channels == 4) {
            return;
        }
        let pixels: usize = views
            .iter()
            .map(|v| v.mask.as_ref().map_or(v.pixels.len() / v.channels as usize, |m| m.iter().filter(|m| **m >= 128).count()))
            .sum();
        if let Some(r) = &mut self.refinement {
            r.most = r.most.min((pixels / PIXELS_PER_GAUSSIAN).max(1));
        }
        // (d + 1)² coefficients of every colour, from the half of the views that sees a place.
        let degrees = (0..=self.sh_degree).rev().find(|d| 2 * (usize::from(*d) + 1).pow(2) <= views.len());
        self.sh_degree = degrees.unwrap_or(0);
        self.clearance = points.map_or_else(Vec::new, |p| views.iter().map(|v| clearance(&v.camera, p)).collect());
    }

    /// Degree of the spherical harmonics in iteration `step`.
    pub fn degree_at(&self, step: u32) -> u8 {
        (step / self.sh_every.max(1)).min(u32::from(self.sh_degree)) as u8
    }

    /// Learning rates of iteration `step`; that of the centres falls geometrically.
    pub fn rates_at(&self, step: u32) -> crate::adam::Rates {
        let t = f64::from(step) / f64::from(self.iterations.max(1));
        let [first, last] = self.rates.mean.map(|v| f64::from(v).ln());
        crate::adam::Rates {
            mean: self.extent * (first * (1.0 - t) + last * t).exp() as f32,
            log_scale: self.rates.log_scale,
            rotation: self.rates.rotation,
            opacity: self.rates.opacity,
            dc: self.rates.dc,
            rest: self.rates.rest,
        }
    }

    /// Gradient from which a Gaussian at `x` is cloned or split: outside the region, where nothing is clamped, the usual one.
    pub(crate) fn gradient_at(&self, refinement: &Refinement, x: [f32; 3]) -> f32 {
        match self.region.filter(|_| self.scale_limit.is_some()) {
            Some(region) if !region.contains(x, INFLATED) => refinement.gradient.max(GRADIENT),
            _ => refinement.gradient,
        }
    }

    /// Fewest Gaussians that can cover a sphere with the region's diagonal in kernels of the clamp's size (splatting.md
    /// §5.5); `None` without a clamp.
    pub fn least_cover(&self) -> Option<usize> {
        let (limit, region) = (self.scale_limit?, self.region?);
        let [a, b, c] = region.half.map(|h| 2.0 * h);
        let area = std::f32::consts::FRAC_PI_2 * (a * b + b * c + c * a) * (2.0 / 3.0);
        Some((0.5 * area / (limit * limit)) as usize)
    }

    /// Clamps the scales of splats inside the region, and everywhere what has grown beyond the size from which refinement
    /// would have removed it: after its end such a giant before a few cameras hides the scene from all others.
    pub(crate) fn clamp(&self, splats: &mut Splats) {
        let (Some(limit), Some(region)) = (self.scale_limit, self.region) else { return };
        let (limit, giant) = (limit.ln(), (GIANT * self.extent).ln());
        for (l, &x) in splats.log_scale.iter_mut().zip(&splats.mean) {
            if l.iter().any(|&v| v > limit) {
                let limit = if region.contains(x, INFLATED) { limit } else { giant };
                *l = l.map(|v| v.min(limit));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn milestones_follow_the_number_of_iterations() {
        let region = Some(Region::aligned([-1.0; 3], [1.0; 3]));
        let full = Options::new(Method::Ours, Profile::Full, 4.0, region, true, None);
        let r = full.refinement.unwrap();
        assert_eq!((r.start, r.every, r.stop, r.reset_every, full.sh_every), (500, 100, 15_000, 3_000, 1_000));
        assert_eq!(full.prune.iter().map(|e| e.step).collect::<Vec<_>>(), [&PRUNE_AT[..], &[LAST_PRUNE.step]].concat());
        let object = Options::new(Method::Ours, Profile::Object, 4.0, region, true, None);
        let r = object.refinement.unwrap();
        assert_eq!((r.start, r.every, r.stop, r.reset_every), (117, 50, 3_500, 700));
        // No pruning while weights are still low from a reset.
        for e in &object.prune {
            assert!(e.step > r.stop || e.step % r.reset_every >= 350, "{e:?}");
        }
        assert_eq!((object.degree_at(0), object.degree_at(260), object.degree_at(7_000)), (0, 1, 3));
        assert!((object.rates_at(7_000).mean - 4.0 * 1.6e-6).abs() < 1e-9);
        assert!((object.scale_limit.unwrap() - SCALE_LIMIT * 12f32.sqrt()).abs() < 1e-6);
    }

    #[test]
    fn short_trainings_of_surfaces_learn_directional_colours_faster() {
        let rest = |m, n| Options::with_iterations(m, Profile::Object, n, 4.0, None, true, None).rates.rest;
        assert!((rest(Method::Ours, 15_000) / (2.0 * REST[0]) - 1.0).abs() < 1e-5);
        assert_eq!((rest(Method::Ours, 60_000), rest(Method::Ours, 100)), (REST[0], REST[1]));
        assert_eq!(rest(Method::Vanilla, 7_000), LearningRates::default().rest);
    }

    #[test]
    fn finer_thresholds_hold_where_kernels_are_clamped() {
        let o = Options::new(Method::Ours, Profile::Object, 4.0, Some(Region::aligned([-1.0; 3], [1.0; 3])), false, None);
        let r = o.refinement.unwrap();
        assert_eq!((o.gradient_at(&r, [0.5; 3]), o.gradient_at(&r, [1.5, 0.0, 0.0])), (GRADIENT_CLAMPED, GRADIENT));
        let scene = Options::new(Method::Ours, Profile::Object, 4.0, None, false, None);
        assert_eq!(scene.gradient_at(&scene.refinement.unwrap(), [0.5; 3]), GRADIENT);
    }

    #[test]
    fn a_few_opaque_views_bound_what_is_trained() {
        let view = |channels: u32| {
            let camera = Camera::look_at([0.0, -4.0, 0.0], [0.0; 3], [0.0, 0.0, 1.0], 0.7, 40, 30);
            Photo { name: String::new(), camera, channels, pixels: vec![9; 1200 * channels as usize], mask: None }
        };
        // One point in a hundred is a stray one before the camera; one is behind it.
        let mut points: Vec<[f32; 3]> = (0..99).map(|i| [0.0, i as f32 * 0.01, 0.0]).collect();
        points.extend([[0.0, -3.9, 0.0], [0.0, -5.0, 0.0]]);
        let fresh = || Options::new(Method::Ours, Profile::Object, 4.0, None, false, None);
        let mut o = fresh();
        o.suit(&vec![view(3); 12], Some(&points));
        assert_eq!((o.refinement.unwrap().most, o.sh_degree), (12 * 1200 / PIXELS_PER_GAUSSIAN, 1));
        assert!(o.clearance.len() == 12 && o.clearance.iter().all(|c| (c - 0.5 * 4.01).abs() < 0.01), "{:?}", o.clearance);
        let degree = |n: usize| {
            let mut o = fresh();
            o.suit(&vec![view(3); n], None);
            (o.sh_degree, o.clearance.len())
        };
        assert_eq!([1, 8, 18, 32, 100].map(degree), [(0, 0), (1, 0), (2, 0), (3, 0), (3, 0)]);
        // Half of the pixels count.
        let mut o = fresh();
        o.suit(&[Photo { mask: Some([0, 255].repeat(600)), ..view(3) }], None);
        assert_eq!(o.refinement.unwrap().most, 600 / PIXELS_PER_GAUSSIAN);
        let (mut o, before) = (fresh(), fresh());
        o.suit(&vec![view(4); 12], Some(&points));
        assert_eq!(o, before);
    }

    #[test]
    fn methods_switch_what_they_are_named_for() {
        let make = |m| Options::new(m, Profile::Object, 4.0, Some(Region::aligned([-1.0; 3], [1.0; 3])), true, None);
        let vanilla = make(Method::Vanilla);
        assert!(vanilla.weights.flat == 0.0 && vanilla.prune.is_empty() && vanilla.scale_limit.is_none());
        assert_eq!(make(Method::PgsrPrune).prune.len(), 5);
        assert!(make(Method::Pgsr).weights.anisotropy == 0.0 && make(Method::Ours).weights.anisotropy == 1.0);
        assert!(make(Method::Physgaussian).weights.roundness[0] > 0.0 && make(Method::Vrdoh).weights.volume_ratio[0] > 0.0);
    }
}
