//! Self fine-tuning of a pretrained splat without photographs (splatting.md §5.9).
//!
//! The imported splat is the teacher: it is photographed from all sides, and a student that starts from it, without its
//! needles, giants and hidden parts, learns those pictures under the losses that make it fit to melt.

use megas_capture::Photo;
use megas_math::{Vec3, mat3, vec3};
use megas_model::{Camera, Splats, fibonacci_directions, logit};
use megas_raster::{Channels, Gaussians, Rasterizer, Settings};
use serde::{Deserialize, Serialize};

use crate::loss::regularise::sorted;
use crate::options::{Background, GRADIENT, LearningRates, Method, Options, Profile, PruneEvent, Refinement, Region, SPLIT_LIMIT};
use crate::trainer::Trainer;

/// Vertical field of view of the virtual cameras.
const FOV: f32 = std::f32::consts::FRAC_PI_4;
/// Share of the image's height that the object fills.
const FILL: f32 = 0.8;
/// A half of a split Gaussian: displacement in standard deviations, and the share of the opacity.
const SPLIT: (f32, f32, f32) = (0.780_625, 1.6, 0.8);
/// τ_scale in diagonals of the object.
const SCALE_LIMIT: f32 = 0.006;
/// Splits of one Gaussian in a row.
const MOST_SPLITS: usize = 24;

/// How to fine-tune.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct FinetuneOptions {
    /// Steps.
    pub iterations: u32,
    /// Training views.
    pub views: u32,
    /// Held-out views.
    pub test_views: u32,
    /// Side of the views \[px\].
    pub size: u32,
    /// Seed.
    pub seed: u64,
    /// Side of the simulator's cells in scene units, if known: kernels are clamped to half of it.
    pub cell: Option<f32>,
    /// Most Gaussians.
    pub most: usize,
}

impl Default for FinetuneOptions {
    fn default() -> Self {
        Self { iterations: 1_000, views: 64, test_views: 16, size: 640, seed: 0, cell: None, most: 600_000 }
    }
}

/// The frozen original and what it is photographed with.
pub struct Teacher {
    /// Training views, RGBA.
    pub train: Vec<Photo>,
    /// Held-out views, RGBA.
    pub test: Vec<Photo>,
    /// Robust box of the means.
    pub region: Region,
    /// Distance of the cameras from the centre, E_v.
    pub distance: f32,
}

/// Box of the 0.5–99.5 % quantiles of the means, weighted by opacity.
fn robust_box(splats: &Splats) -> (Vec3<f32>, Vec3<f32>) {
    let quantiles = |axis: usize| {
        let mut v: Vec<(f32, f32)> = (0..splats.len()).map(|i| (splats.mean[i][axis], splats.opacity(i))).collect();
        v.sort_by(|a, b| a.0.total_cmp(&b.0));
        let total: f64 = v.iter().map(|x| f64::from(x.1)).sum();
        let find = |share: f64| {
            let mut sum = 0.0;
            v.iter().find(|x| {
                sum += f64::from(x.1);
                sum >= share * total
            })
        };
        let at = |share: f64| find(share).or(v.last()).map_or(0.0, |x| x.0);
        (at(0.005), at(0.995))
    };
    let [x, y, z] = [0, 1, 2].map(quantiles);
    ([x.0, y.0, z.0], [x.1, y.1, z.1])
}

impl Teacher {
    /// Photographs `splats` from all sides; `progress` is called after every view with the number done and of all.
    ///
    /// # Panics
    /// Without splats.
    pub fn new(splats: &Splats, options: &FinetuneOptions, mut progress: impl FnMut(usize, usize)) -> Self {
        assert!(!splats.is_empty(), "nothing to photograph");
        let (lo, hi) = robust_box(splats);
        let region = Region::aligned(lo, hi);
        let radius = (0.5 * region.diagonal()).max(1e-6);
        let distance = radius / (FILL * (0.5 * FOV).tan());
        let gaussians = Gaussians::from_splats(splats);
        let mut rasterizer = Rasterizer::new();
        let mut rng = megas_math::rng::Rng::new(options.seed ^ 0x7ea);
        let all = (options.views + options.test_views) as usize;
        let mut photograph = |name: &str, k: usize, direction: Vec3<f32>, jitter: bool, done: usize| {
            let r = distance * if jitter { rng.range(0.8, 1.3) as f32 } else { 1.0 };
            let eye = vec3::add_scaled(region.center, direction, r);
            let up = if direction[2].abs() > 0.95 { [0.0, 1.0, 0.0] } else { [0.0, 0.0, 1.0] };
            let camera = Camera::look_at(eye, region.center, up, FOV, options.size, options.size);
            let frame = rasterizer.frame(&gaussians, &camera, &Settings::default(), Channels::Rgba);
            progress(done + 1, all);
            Photo { name: format!("{name}_{k:03}"), camera, channels: 4, pixels: frame.rgba_image([0.0; 3]).to_u8(), mask: None }
        };
        let train: Vec<Photo> =
            fibonacci_directions(options.views as usize).into_iter().enumerate().map(|(k, d)| photograph("train", k, d, true, k)).collect();
        // Held-out directions on a spiral of their own, turned away from that of the training.
        let turn = mat3::transpose([[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]]);
        let test = fibonacci_directions(options.test_views as usize)
            .into_iter()
            .enumerate()
            .map(|(k, d)| photograph("test", k, mat3::mul_vec(turn, d), false, train.len() + k))
            .collect();
        Self { train, test, region, distance }
    }

    /// The options of the student's training.
    pub fn options(&self, finetune: &FinetuneOptions) -> Options {
        let mut o = Options::new(Method::Ours, Profile::Object, self.distance, Some(self.region), true, finetune.cell);
        // Milestones of the 1000 steps of the paper, in proportion.
        let at = |step: u32| (u64::from(step) * u64::from(finetune.iterations)).div_ceil(1_000) as u32;
        o.iterations = finetune.iterations;
        o.seed = finetune.seed;
        o.weights.alpha = 0.5;
        o.weights.normal_start = at(300);
        // The kernels of the original are given: a finer clamp would only split them into more than its views can tell apart.
        let share = SCALE_LIMIT * self.region.diagonal();
        o.scale_limit = Some(finetune.cell.map_or(share, |c| share.min(0.5 * c)));
        o.rates = LearningRates { mean: [1.6e-5, 1.6e-6], opacity: 0.02, ..LearningRates::default() };
        o.refinement = o.refinement.map(|r| Refinement {
            start: at(100),
            every: at(100),
            stop: at(600),
            reset_every: 0,
            trim_every: 0,
            gradient: GRADIENT,
            split_size: SPLIT_LIMIT * o.scale_limit.unwrap_or(share) / self.distance,
            most: finetune.most,
            ..r
        });
        // The last one is ours: what has lost its weight since the second would be left hidden in the body.
        o.prune = [(500, 0.05), (800, 0.1), (950, 0.1)].map(|(step, tau)| PruneEvent { step: at(step), tau }).to_vec();
        o.sh_every = 0;
        o.background = Background::Random;
        // The original's colours are known all around.
        o.settle_colours = None;
        o
    }

    /// The student before its first step: what no view shows is gone, needles and giants are split, everything is flat.
    pub fn student(self, splats: &Splats, options: Options) -> (Trainer, Vec<Photo>) {
        let mut trainer = Trainer::new(self.train, splats.clone(), Options { scale_limit: None, ..options.clone() });
        trainer.prune_internal(0.02);
        let most = options.refinement.map_or(usize::MAX, |r| r.most);
        let limit = options.scale_limit.unwrap_or(f32::INFINITY);
        let mut student = split_needles(trainer.splats(), options.weights.anisotropy_limit, limit, most);
        for l in &mut student.log_scale {
            let [_, middle, least] = sorted(*l);
            l[least] = l[least].min(l[middle] - std::f32::consts::LN_2);
        }
        (Trainer::new(trainer.into_views(), student, options), self.test)
    }
}

/// Replaces every Gaussian with `S¹ > aspect · S²` or `S¹ > size` by two along its longest axis, again and again, which keeps
/// the variance along that axis (splatting.md §5.9). Stops where `most` would be exceeded.
pub fn split_needles(splats: &Splats, aspect: f32, size: f32, most: usize) -> Splats {
    let mut done = Splats { sh_degree: splats.sh_degree, ..Splats::default() };
    let mut todo = splats.clone();
    for _ in 0..MOST_SPLITS {
        let long = |l: &[f32; 3]| {
            let [first, second, _] = sorted(*l);
            l[first] - l[second] > aspect.ln() || l[first] > size.ln()
        };
        let (mut split, mut keep) = (Vec::new(), Vec::new());
        (0..todo.len()).for_each(|i| if long(&todo.log_scale[i]) { split.push(i) } else { keep.push(i) });
        done.append(&todo.select(&keep));
        if split.is_empty() || done.len() + 2 * split.len() > most {
            done.append(&todo.select(&split));
            return done;
        }
        let (offset, shrink, opacity) = SPLIT;
        let twice: Vec<usize> = split.iter().flat_map(|&i| [i, i]).collect();
        let mut next = todo.select(&twice);
        for k in 0..next.len() {
            let l = next.log_scale[k];
            let axis = sorted(l)[0];
            let along = mat3::column(next.axes(k), axis);
            let side = if k % 2 == 0 { 1.0 } else { -1.0 };
            next.mean[k] = vec3::add_scaled(next.mean[k], along, side * offset * l[axis].exp());
            next.log_scale[k][axis] -= shrink.ln();
            next.opacity_logit[k] = logit(opacity * next.opacity(k));
        }
        todo = next;
    }
    done.append(&todo);
    done
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn needles_become_chains_with_the_same_spread() {
        let mut s = Splats::default();
        s.push([1.0, 2.0, 3.0], [0.0, -3.0, -4.0], [0.8, 0.0, 0.6, 0.0], logit(0.5), &[0.1, 0.2, 0.3]);
        s.push([0.0; 3], [-3.0, -3.2, -4.0], [1.0, 0.0, 0.0, 0.0], 0.0, &[0.1, 0.2, 0.3]);
        let out = split_needles(&s, 2.0, 10.0, 1000);
        assert!(out.len() > 8, "{}", out.len());
        for l in &out.log_scale {
            let mut l = *l;
            l.sort_by(f32::total_cmp);
            assert!(l[2] - l[1] <= 2f32.ln() + 1e-6);
        }
        // Variance along the needle: spread of the centres plus that of each.
        let axis = mat3::column(s.axes(0), 0);
        let parts: Vec<usize> = (0..out.len()).filter(|&i| vec3::norm(out.mean[i]) > 1.0).collect();
        let n = parts.len() as f32;
        let x = |i: usize| vec3::dot(vec3::sub(out.mean[i], s.mean[0]), axis);
        let spread: f32 = parts.iter().map(|&i| x(i) * x(i) + (2.0 * out.log_scale[i][0]).exp()).sum::<f32>() / n;
        assert!((spread - 1.0).abs() < 1e-4, "{spread}");
        assert!(split_needles(&s, 2.0, 10.0, 3).len() <= 4);
    }
}
