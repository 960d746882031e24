//! Adding and removing Gaussians while training (splatting.md §5.4, §5.8).

use megas_math::{mat3, quat, rng::Rng, vec3};
use megas_model::{Splats, logit};
use serde::Serialize;

use crate::model::Model;
use crate::options::{GIANT, Mcmc, Options, Refinement};

/// Splits by the absolute gradient in one refinement.
const MOST_ABSOLUTE: usize = 50_000;
/// Radius on the screen from which the absolute gradient splits \[px\].
const LARGE_RADIUS: f32 = 20.0;
/// Scales of the halves of a split Gaussian.
const SHRINK: f32 = 1.6;

/// What a refinement did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Refined {
    /// Gaussians copied.
    pub cloned: usize,
    /// Gaussians replaced by two.
    pub split: usize,
    /// Gaussians removed for their opacity or size.
    pub pruned: usize,
}

/// A random point of Gaussian `i`.
fn sample(splats: &Splats, i: usize, rng: &mut Rng) -> [f32; 3] {
    let s = splats.scale(i);
    let z: [f32; 3] = std::array::from_fn(|a| rng.normal() as f32 * s[a]);
    vec3::add(splats.mean[i], mat3::mul_vec(quat::to_mat3(splats.rotation[i]), z))
}

/// Clones, splits and prunes; `after_reset` says that opacities have been reset before.
pub(crate) fn densify(model: &mut Model, options: &Options, refinement: &Refinement, step: u32, after_reset: bool) -> Refined {
    let n = model.splats.len();
    let mut rng = Rng::new(options.seed ^ (u64::from(step) << 20));
    let boundary = refinement.split_size * options.extent;
    let largest = |i: usize| model.splats.scale(i).into_iter().fold(0.0f32, f32::max);
    let (mut clones, mut splits) = (Vec::new(), Vec::new());
    let mut absolute = 0;
    for i in 0..n {
        let [gradient, absolute_gradient] = model.activity.mean(i);
        let large = largest(i) > boundary;
        if gradient >= options.gradient_at(refinement, model.splats.mean[i]) {
            if large { splits.push(i) } else { clones.push(i) }
        } else if large
            && refinement.absolute_gradient.is_some_and(|limit| absolute_gradient >= limit)
            && model.activity.radius[i] > LARGE_RADIUS
            && absolute < MOST_ABSOLUTE
        {
            absolute += 1;
            splits.push(i);
        }
    }
    // Within the budget: those that need it most.
    let room = refinement.most.saturating_sub(n);
    if clones.len() + splits.len() > room {
        let mut all: Vec<(f32, usize)> = clones.iter().chain(&splits).map(|&i| (model.activity.mean(i)[0], i)).collect();
        all.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        all.truncate(room);
        let mut chosen = vec![false; n];
        all.iter().for_each(|&(_, i)| chosen[i] = true);
        clones.retain(|&i| chosen[i]);
        splits.retain(|&i| chosen[i]);
    }
    let mut new = model.splats.select(&clones);
    if refinement.sample_clones {
        for (k, &i) in clones.iter().enumerate() {
            new.mean[k] = sample(&model.splats, i, &mut rng);
        }
    }
    let twice: Vec<usize> = splits.iter().flat_map(|&i| [i, i]).collect();
    let mut halves = model.splats.select(&twice);
    for (k, &i) in twice.iter().enumerate() {
        halves.mean[k] = sample(&model.splats, i, &mut rng);
        halves.log_scale[k] = halves.log_scale[k].map(|l| l - SHRINK.ln());
    }
    new.append(&halves);
    model.append(&new);
    let mut gone = vec![false; model.splats.len()];
    splits.iter().for_each(|&i| gone[i] = true);
    model.retain(|i| !gone[i]);
    let (floor, giant) = (logit(refinement.opacity), (GIANT * options.extent).ln());
    let doomed: Vec<bool> = (0..model.splats.len())
        .map(|i| model.splats.opacity_logit[i] < floor || (after_reset && model.splats.log_scale[i].iter().any(|&l| l > giant)))
        .collect();
    let pruned = model.retain(|i| !doomed[i]);
    model.activity.reset(model.splats.len());
    Refined { cloned: clones.len(), split: splits.len(), pruned }
}

/// Lowers every opacity to at most 0.01 and forgets the moments.
pub(crate) fn reset_opacity(model: &mut Model) {
    let ceiling = logit(0.01);
    model.splats.opacity_logit.iter_mut().for_each(|l| *l = l.min(ceiling));
    model.adam.forget_opacity();
}

/// Opacity and shrinkage of the scales of `count` Gaussians that together look like one of opacity `o` (splatting.md §5.8).
fn share(o: f64, count: usize) -> (f64, f64) {
    let new = 1.0 - (1.0 - o).powf(1.0 / count as f64);
    let mut sum = 0.0;
    for i in 1..=count {
        let mut binomial = 1.0;
        for k in 0..i {
            sum += binomial * if k % 2 == 0 { 1.0 } else { -1.0 } * new.powi(k as i32 + 1) / (k as f64 + 1.0).sqrt();
            binomial *= (i - 1 - k) as f64 / (k + 1) as f64;
        }
    }
    (new, o / sum)
}

/// Moves dead Gaussians onto live ones and grows the set: the sampling strategy's refinement.
pub(crate) fn relocate(model: &mut Model, options: &Options, mcmc: &Mcmc, most: usize, step: u32) -> Refined {
    let mut rng = Rng::new(options.seed ^ (u64::from(step) << 20) ^ 0xabcd);
    let floor = logit(mcmc.dead_opacity);
    let n = model.splats.len();
    let dead: Vec<usize> = (0..n).filter(|&i| model.splats.opacity_logit[i] <= floor).collect();
    let mut cumulative = Vec::with_capacity(n);
    let mut sum = 0.0;
    for i in 0..n {
        if model.splats.opacity_logit[i] > floor {
            sum += f64::from(model.splats.opacity(i));
        }
        cumulative.push(sum);
    }
    if sum <= 0.0 {
        return Refined::default();
    }
    let grow = ((n as f64 * f64::from(mcmc.growth)) as usize).min(most.saturating_sub(n));
    let mut draw = || {
        let u = rng.unit() * sum;
        cumulative.partition_point(|&c| c <= u).min(n - 1)
    };
    let sources: Vec<usize> = (0..dead.len() + grow).map(|_| draw()).collect();
    let mut times = vec![1usize; n];
    sources.iter().for_each(|&i| times[i] += 1);
    for i in 0..n {
        if times[i] > 1 {
            let (o, shrink) = share(f64::from(model.splats.opacity(i)).min(0.999_999), times[i].min(51));
            model.splats.opacity_logit[i] = logit(o.max(f64::from(mcmc.dead_opacity)) as f32);
            model.splats.log_scale[i] = model.splats.log_scale[i].map(|l| l + shrink.ln() as f32);
        }
    }
    let copies = model.splats.select(&sources);
    let mut gone = vec![false; n];
    dead.iter().for_each(|&i| gone[i] = true);
    model.retain(|i| !gone[i]);
    model.append(&copies);
    // Those that were divided start anew.
    let n = model.splats.len();
    model.activity.reset(n);
    Refined { cloned: grow, split: 0, pruned: dead.len() }
}

/// Noise on the centres that lets almost transparent Gaussians wander (splatting.md §5.8).
pub(crate) fn wander(splats: &mut Splats, mcmc: &Mcmc, rate: f32, seed: u64, step: u32) {
    use rayon::prelude::*;
    let Splats { mean, log_scale, rotation, opacity_logit, .. } = splats;
    let jobs = mean.par_iter_mut().zip(log_scale.par_iter()).zip(rotation.par_iter().zip(opacity_logit.par_iter()));
    jobs.enumerate().with_min_len(1024).for_each(|(i, ((x, l), (q, o)))| {
        let opacity = 1.0 / (1.0 + (-o).exp());
        let strength = mcmc.noise * rate / (1.0 + (100.0 * (opacity - mcmc.dead_opacity)).exp());
        if strength > 1e-8 {
            let mut rng = Rng::new(seed ^ (u64::from(step) << 32) ^ i as u64);
            let r = quat::to_mat3(*q);
            let z: [f32; 3] = std::array::from_fn(|_| rng.normal() as f32);
            let local = mat3::tmul_vec(r, z);
            let local = std::array::from_fn(|a| local[a] * (2.0 * l[a]).exp() * strength);
            *x = vec3::add(*x, mat3::mul_vec(r, local));
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::options::{Method, Profile, Region};

    fn model(n: usize) -> (Model, Options) {
        let mut s = Splats::default();
        for i in 0..n {
            let size = if i % 2 == 0 { 0.001f32 } else { 0.2 };
            s.push([i as f32, 0.0, 0.0], [size.ln(); 3], [1.0, 0.0, 0.0, 0.0], 1.0, &[0.1, 0.2, 0.3]);
        }
        let options = Options::new(Method::Vanilla, Profile::Object, 1.0, Some(Region::aligned([-1.0; 3], [1.0; 3])), false, None);
        (Model::new(s), options)
    }

    #[test]
    fn small_ones_are_cloned_large_ones_split_and_moments_follow() {
        let (mut m, o) = model(8);
        m.adam.opacity.first = (0..8).map(|i| i as f32).collect();
        for i in [2, 3] {
            m.activity.gradient[i] = [1e-3, 0.0];
            m.activity.views[i] = 1;
        }
        m.splats.opacity_logit[6] = -9.0;
        let r = densify(&mut m, &o, &o.refinement.unwrap(), 100, false);
        assert_eq!(r, Refined { cloned: 1, split: 1, pruned: 1 });
        assert_eq!(m.splats.len(), 8 + 1 + 2 - 1 - 1);
        assert_eq!(m.adam.opacity.first, [0.0, 1.0, 2.0, 4.0, 5.0, 7.0, 0.0, 0.0, 0.0]);
        assert_eq!(m.splats.mean[6], [2.0, 0.0, 0.0], "vanilla clones in place");
        assert!((m.splats.scale(7)[0] - 0.2 / 1.6).abs() < 1e-6);
    }

    #[test]
    fn the_budget_keeps_the_neediest() {
        let (mut m, o) = model(6);
        for i in 0..6 {
            m.activity.gradient[i] = [1e-3 * (i + 1) as f32, 0.0];
            m.activity.views[i] = 1;
        }
        let refinement = Refinement { most: 8, ..o.refinement.unwrap() };
        let r = densify(&mut m, &o, &refinement, 100, false);
        assert_eq!((r.cloned, r.split, m.splats.len()), (1, 1, 8));
    }

    #[test]
    fn shares_of_a_gaussian_compose_to_it() {
        for o in [0.1, 0.5, 0.9] {
            let (one, shrink) = share(o, 1);
            assert!((one - o).abs() < 1e-12 && (shrink - 1.0).abs() < 1e-12);
            let (each, shrink) = share(o, 3);
            assert!((1.0 - (1.0 - each).powi(3) - o).abs() < 1e-12);
            assert!(shrink > 0.5 && shrink < 1.0, "{shrink}");
        }
    }

    #[test]
    fn dead_ones_move_to_live_ones() {
        let (mut m, o) = model(40);
        for i in 0..10 {
            m.splats.opacity_logit[i] = -8.0;
        }
        let r = relocate(&mut m, &o, &Mcmc::default(), 41, 100);
        assert_eq!((r.pruned, r.cloned, m.splats.len()), (10, 1, 41));
        assert!(m.splats.opacity_logit.iter().all(|&l| l > -6.0) && m.splats.mean.iter().all(|x| x[0] >= 10.0));
    }
}
