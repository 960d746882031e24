//! Making imported or trained Gaussians fit to be deformed (splatting.md §5.5, §5.9 step 4).

use megas_math::{Vec3, mat3, vec3};
use megas_model::{Splats, logit};

/// Opacity below which no ray can count a Gaussian.
const LEAST_OPACITY: f32 = 1.0 / 255.0;

/// What [`bake`] did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct BakeReport {
    /// Dropped: mean, scale or rotation not finite.
    pub invalid: usize,
    /// Dropped: opacity below 1/255.
    pub transparent: usize,
    /// Kept with a raised smallest scale.
    pub thickened: usize,
}

/// Drops Gaussians that cannot be seen or are not finite, and raises the smallest scale to `max(1e-4 L, 0.02 S²)` so that
/// inverses stay bounded. `l` is the diagonal of the object's robust box in scene units.
pub fn bake(splats: &mut Splats, l: f64) -> BakeReport {
    let mut report = BakeReport::default();
    let mut keep = Vec::with_capacity(splats.len());
    for i in 0..splats.len() {
        let q = splats.rotation[i];
        let rows = splats.mean[i].iter().chain(&splats.log_scale[i]).chain(&q);
        let finite = rows.clone().all(|v| v.is_finite()) && q.iter().any(|v| *v != 0.0) && !splats.opacity_logit[i].is_nan();
        if !finite {
            report.invalid += 1;
        } else if splats.opacity(i) < LEAST_OPACITY {
            report.transparent += 1;
        } else {
            keep.push(i);
        }
    }
    if keep.len() < splats.len() {
        *splats = splats.select(&keep);
    }
    for s in &mut splats.log_scale {
        let mut sorted = s.map(|v| v.clamp(-20.0, 20.0));
        *s = sorted;
        sorted.sort_by(f32::total_cmp);
        let floor = ((1e-4 * l) as f32).max(0.02 * sorted[1].exp()).ln();
        if sorted[0] < floor {
            report.thickened += 1;
            *s = s.map(|v| v.max(floor));
        }
    }
    report
}

/// What [`split_needles`] did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SplitReport {
    /// Splits made; each adds one Gaussian.
    pub splits: usize,
    /// Gaussians that still break a limit because the budget ran out.
    pub left_over: usize,
}

/// Splits Gaussians with `S¹ > a·S²` or `S¹ > tau_scale` into two children along their longest axis until none is left or
/// `max_count` is reached, the worst first. Children keep the variance along the axis (`S¹/1.6`, centres at ±0.781 S¹)
/// and 0.8 of the opacity. `a` > 1; lengths in scene units. Children follow their siblings in the arrays and get new
/// birth ids.
pub fn split_needles(splats: &mut Splats, a: f32, tau_scale: f32, max_count: usize) -> SplitReport {
    const SHRINK: f32 = 1.6;
    let delta = (1.0 - 1.0 / (SHRINK * SHRINK)).sqrt();
    let mut report = SplitReport::default();
    let mut next_id = splats.birth_id.iter().copied().max().map_or(0, |m| m.wrapping_add(1));
    loop {
        let mut worst: Vec<(f32, usize)> =
            (0..splats.len()).map(|i| (excess(splats.log_scale[i], a, tau_scale), i)).filter(|(e, _)| *e > 1.0).collect();
        let room = max_count.saturating_sub(splats.len());
        if worst.is_empty() || room == 0 {
            report.left_over = worst.len();
            return report;
        }
        if worst.len() > room {
            worst.sort_by(|x, y| y.0.total_cmp(&x.0).then(x.1.cmp(&y.1)));
            worst.truncate(room);
        }
        let mut split = vec![false; splats.len()];
        worst.iter().for_each(|&(_, i)| split[i] = true);
        let order: Vec<usize> = (0..splats.len()).flat_map(|i| std::iter::repeat_n(i, 1 + usize::from(split[i]))).collect();
        *splats = splats.select(&order);
        report.splits += worst.len();
        let mut j = 0;
        for divided in split {
            if !divided {
                j += 1;
                continue;
            }
            let axis = longest(splats.log_scale[j]);
            let step = vec3::scale(mat3::column(splats.axes(j), axis), delta * splats.scale(j)[axis]);
            let opacity = logit(0.8 * splats.opacity(j));
            for (k, sign) in [(j, 1.0), (j + 1, -1.0)] {
                splats.mean[k] = vec3::add_scaled(splats.mean[k], step, sign);
                splats.log_scale[k][axis] -= SHRINK.ln();
                splats.opacity_logit[k] = opacity;
            }
            splats.birth_id[j + 1] = next_id;
            next_id = next_id.wrapping_add(1);
            j += 2;
        }
    }
}

fn longest(s: Vec3<f32>) -> usize {
    (0..3).fold(0, |m, k| if s[k] > s[m] { k } else { m })
}

/// By which factor a Gaussian breaks the stricter of the two limits.
fn excess(log_scale: Vec3<f32>, a: f32, tau_scale: f32) -> f32 {
    let mut s = log_scale;
    s.sort_by(f32::total_cmp);
    ((s[2] - s[1]).exp() / a).max(s[2].exp() / tau_scale)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn one(scale: Vec3<f32>, opacity: f32) -> Splats {
        let mut s = Splats::default();
        s.push([1.0, 2.0, 3.0], scale.map(f32::ln), [0.9, 0.1, -0.3, 0.2], logit(opacity), &[0.1, 0.2, 0.3]);
        s
    }

    #[test]
    fn baking_drops_the_hopeless_and_thickens_the_thin() {
        let mut s = one([0.1, 0.2, 1e-6], 0.5);
        s.append(&one([0.1, 0.2, 0.05], 0.5));
        s.append(&one([0.1, 0.2, 0.05], 0.003));
        s.append(&one([0.1, f32::NAN, 0.05], 0.5));
        let r = bake(&mut s, 5.0);
        assert_eq!(r, BakeReport { invalid: 1, transparent: 1, thickened: 1 });
        assert_eq!(s.len(), 2);
        assert!((s.scale(0)[2] - 0.002).abs() < 1e-6, "{:?}", s.scale(0));
        let mut s = one([0.1, 0.2, 1e-6], 0.5);
        bake(&mut s, 100.0);
        assert!((s.scale(0)[2] - 0.01).abs() < 1e-6);
    }

    #[test]
    fn splitting_keeps_centre_and_covariance_of_the_mixture() {
        let parent = one([0.5, 0.12, 0.02], 0.6);
        let mut s = parent.clone();
        let r = split_needles(&mut s, 4.0, 10.0, 2);
        assert_eq!((r.splits, s.len()), (1, 2));
        let mean = vec3::scale(vec3::add(s.mean[0], s.mean[1]), 0.5);
        assert!(vec3::norm(vec3::sub(mean, parent.mean[0])) < 1e-6);
        let d = vec3::scale(vec3::sub(s.mean[0], s.mean[1]), 0.5);
        let mixture = mat3::add(s.covariance(0), mat3::outer(d, d));
        assert!(mat3::norm(mat3::sub(mixture, parent.covariance(0))) < 1e-5 * mat3::norm(mixture));
        assert!((s.opacity(0) - 0.48).abs() < 1e-6);
        assert_ne!(s.birth_id[0], s.birth_id[1]);
    }

    #[test]
    fn splitting_ends_within_the_limits_or_at_the_budget() {
        let mut s = one([3.0, 0.12, 0.02], 0.6);
        s.append(&one([0.1, 0.1, 0.02], 0.6));
        let r = split_needles(&mut s, 2.0, 0.2, 100_000);
        assert_eq!((r.left_over, s.len()), (0, 2 + r.splits));
        for i in 0..s.len() {
            assert!(excess(s.log_scale[i], 2.0, 0.2) <= 1.0);
        }
        let mut s = one([3.0, 0.12, 0.02], 0.6);
        let r = split_needles(&mut s, 2.0, 0.2, 5);
        assert!(r.left_over > 0 && s.len() == 5);
    }
}
