//! Terms on the shape and opacity of the Gaussians themselves (splatting.md §5.2, §5.8).
//!
//! Every function takes the stored values of all Gaussians, the strictly increasing indices of those that count ("visible":
//! blended somewhere in this iteration), and a gradient as long as the values, to which it adds `weight` times the
//! derivative. The value is returned without the weight. No index, no value, no gradient.

use megas_math::{Real, Vec3};

/// Indices per unit of parallel work.
const BLOCK: usize = 4096;

/// Sum of `f(index, gradient of that index)` over `indices`, in parallel, always added in the same order.
fn sum_over<T: Send>(indices: &[u32], gradient: &mut [T], f: &(impl Fn(usize, &mut T) -> f64 + Sync)) -> f64 {
    fn part<T: Send>(indices: &[u32], first: usize, gradient: &mut [T], f: &(impl Fn(usize, &mut T) -> f64 + Sync)) -> f64 {
        if indices.len() <= BLOCK {
            assert!(indices.is_sorted_by(|a, b| a < b), "indices must increase");
            return indices.iter().map(|&i| f(i as usize, &mut gradient[i as usize - first])).sum();
        }
        let (low, high) = indices.split_at((indices.len() / 2).next_multiple_of(BLOCK));
        let cut = high[0] as usize;
        let (gradient_low, gradient_high) = gradient.split_at_mut(cut - first);
        let (a, b) = rayon::join(|| part(low, first, gradient_low, f), || part(high, cut, gradient_high, f));
        a + b
    }
    part(indices, 0, gradient, f)
}

/// Positions of the largest, the middle and the smallest of three; of equals the first counts as larger.
#[inline(always)]
pub(crate) fn sorted<T: Real>(v: Vec3<T>) -> [usize; 3] {
    let mut order = [0, 1, 2];
    for (a, b) in [(0, 1), (1, 2), (0, 1)] {
        if v[order[a]] < v[order[b]] {
            order.swap(a, b);
        }
    }
    order
}

/// Flatness: mean of the shortest standard deviation over the scene extent, `S³/E`.
pub fn flatten<T: Real>(log_scale: &[[T; 3]], visible: &[u32], extent: f32, weight: f32, gradient: &mut [[T; 3]]) -> f64 {
    let scale = 1.0 / (f64::from(extent) * visible.len().max(1) as f64);
    let step = T::of(f64::from(weight) * scale);
    let sum = sum_over(visible, gradient, &|i, g| {
        let k = sorted(log_scale[i])[2];
        let s = log_scale[i][k].exp();
        g[k] += step * s;
        s.f64()
    });
    sum * scale
}

/// Needles: mean of `max(S¹/S² − a, 0)`, the ratio of the two largest standard deviations (discs are free).
pub fn anisotropy<T: Real>(log_scale: &[[T; 3]], visible: &[u32], a: f32, weight: f32, gradient: &mut [[T; 3]]) -> f64 {
    excess(log_scale, visible, a, weight, gradient, 1)
}

/// The regulariser of PhysGaussian (B1): mean of `max(S¹/S³, r) − r`, the ratio of the largest to the smallest.
pub fn roundness<T: Real>(log_scale: &[[T; 3]], visible: &[u32], r: f32, weight: f32, gradient: &mut [[T; 3]]) -> f64 {
    excess(log_scale, visible, r, weight, gradient, 2)
}

/// Mean of `max(ratio − limit, 0)`, the ratio of the largest axis to the `rank`-th after it.
fn excess<T: Real>(log_scale: &[[T; 3]], visible: &[u32], limit: f32, weight: f32, gradient: &mut [[T; 3]], rank: usize) -> f64 {
    let count = visible.len().max(1) as f64;
    let step = T::of(f64::from(weight) / count);
    // Most Gaussians are within the limit: decide in logarithms, exponentiate the others only.
    let (limit, log_limit) = (f64::from(limit), T::of(f64::from(limit).ln()));
    let sum = sum_over(visible, gradient, &|i, g| {
        let l = log_scale[i];
        let order = sorted(l);
        let (large, small) = (order[0], order[rank]);
        let log_ratio = l[large] - l[small];
        if log_ratio <= log_limit {
            return 0.0;
        }
        let ratio = log_ratio.exp();
        g[large] += step * ratio;
        g[small] -= step * ratio;
        ratio.f64() - limit
    });
    sum / count
}

/// The regulariser of VR-DoH (B2): `max(mean V of the largest / mean V of the smallest, r) − r`, each group the
/// `fraction` (0–1, at least one) of the visible Gaussians with the largest or smallest volume `V = s₁s₂s₃`.
pub fn volume_ratio<T: Real>(log_scale: &[[T; 3]], visible: &[u32], fraction: f32, r: f32, weight: f32, gradient: &mut [[T; 3]]) -> f64 {
    let n = visible.len();
    if n == 0 {
        return 0.0;
    }
    let size = ((f64::from(fraction) * n as f64).floor() as usize).clamp(1, n);
    let mut volumes: Vec<(f64, u32)> = visible
        .iter()
        .map(|&i| {
            let l = log_scale[i as usize];
            ((l[0] + l[1] + l[2]).f64().exp(), i)
        })
        .collect();
    // Equal volumes rank by index, which makes the groups, and with them the result, unique.
    let order = |a: &(f64, u32), b: &(f64, u32)| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1));
    volumes.select_nth_unstable_by(size - 1, order);
    let smallest = volumes[..size].to_vec();
    volumes.select_nth_unstable_by(n - size, order);
    let largest = &volumes[n - size..];
    let total = |group: &[(f64, u32)]| group.iter().map(|v| v.0).sum::<f64>();
    let (top, bottom) = (total(largest), total(&smallest));
    let (ratio, r) = (top / bottom, f64::from(r));
    if ratio <= r {
        return 0.0;
    }
    for (group, step) in [(largest, 1.0 / top), (&smallest, -1.0 / bottom)] {
        for &(volume, i) in group {
            let g = T::of(f64::from(weight) * ratio * step * volume);
            gradient[i as usize].iter_mut().for_each(|v| *v += g);
        }
    }
    ratio - r
}

/// Sparsity of the sampling strategy: mean opacity. Values and gradient are those of the stored logits.
pub fn opacity<T: Real>(logit: &[T], visible: &[u32], weight: f32, gradient: &mut [T]) -> f64 {
    let count = visible.len().max(1) as f64;
    let step = T::of(f64::from(weight) / count);
    let sum = sum_over(visible, gradient, &|i, g| {
        let o = T::one() / (T::one() + (-logit[i]).exp());
        *g += step * o * (T::one() - o);
        o.f64()
    });
    sum / count
}

/// Sparsity of the sampling strategy: mean standard deviation over Gaussians and axes \[scene units\].
pub fn scale<T: Real>(log_scale: &[[T; 3]], visible: &[u32], weight: f32, gradient: &mut [[T; 3]]) -> f64 {
    let count = 3.0 * visible.len().max(1) as f64;
    let step = T::of(f64::from(weight) / count);
    let sum = sum_over(visible, gradient, &|i, g| {
        let s = log_scale[i].map(T::exp);
        for k in 0..3 {
            g[k] += step * s[k];
        }
        (s[0] + s[1] + s[2]).f64()
    });
    sum / count
}

#[cfg(test)]
mod tests {
    use megas_math::rng::Rng;

    use super::*;

    fn shapes(n: usize) -> (Vec<[f64; 3]>, Vec<u32>) {
        let mut rng = Rng::new(11);
        let shapes = (0..n).map(|_| [(); 3].map(|_| rng.range(-5.0, -2.0))).collect();
        (shapes, (0..n as u32).filter(|i| i % 3 != 1).collect())
    }

    type Term = fn(&[[f64; 3]], &[u32], f32, &mut [[f64; 3]]) -> f64;

    const TERMS: [(&str, Term); 5] = [
        ("flatten", |l, v, w, g| flatten(l, v, 1.7, w, g)),
        ("anisotropy", |l, v, w, g| anisotropy(l, v, 2.0, w, g)),
        ("roundness", |l, v, w, g| roundness(l, v, 3.0, w, g)),
        ("volume ratio", |l, v, w, g| volume_ratio(l, v, 0.3, 5.0, w, g)),
        ("scale", |l, v, w, g| scale(l, v, w, g)),
    ];

    #[test]
    fn gradients_are_the_derivatives_and_only_of_the_visible() {
        let (mut l, visible) = shapes(40);
        for (name, term) in TERMS {
            let mut g = vec![[0.5; 3]; l.len()];
            assert!(term(&l, &visible, 0.8, &mut g) > 0.0, "{name} is active");
            let largest = g.iter().flatten().fold(0.0f64, |m, g| m.max((g - 0.5).abs()));
            for i in 0..l.len() {
                for k in 0..3 {
                    let (h, old) = (1e-5, l[i][k]);
                    let mut scratch = vec![[0.0; 3]; l.len()];
                    l[i][k] = old + h;
                    let above = term(&l, &visible, 0.8, &mut scratch);
                    l[i][k] = old - h;
                    let slope = 0.8 * (above - term(&l, &visible, 0.8, &mut scratch)) / (2.0 * h);
                    l[i][k] = old;
                    let analytic = g[i][k] - 0.5;
                    let bound = 1e-6 * (slope.abs() + analytic.abs() + 1e-3 * largest);
                    assert!((slope - analytic).abs() <= bound, "{name} {i} {k}: {slope} {analytic}");
                    assert!(i % 3 != 1 || analytic == 0.0);
                }
            }
        }
    }

    #[test]
    fn opacity_gradient_is_the_derivative() {
        let mut logit = vec![-3.0f64, 0.2, 1.5, 4.0];
        let visible = [0, 2, 3];
        let mut g = vec![0.0; 4];
        let value = opacity(&logit, &visible, 1.0, &mut g);
        assert!((value - [-3.0f64, 1.5, 4.0].map(|l| 1.0 / (1.0 + (-l).exp())).iter().sum::<f64>() / 3.0).abs() < 1e-12);
        for i in 0..4 {
            let mut scratch = vec![0.0; 4];
            logit[i] += 1e-5;
            let above = opacity(&logit, &visible, 1.0, &mut scratch);
            logit[i] -= 2e-5;
            let slope = (above - opacity(&logit, &visible, 1.0, &mut scratch)) / 2e-5;
            logit[i] += 1e-5;
            assert!((slope - g[i]).abs() < 1e-9);
        }
    }

    #[test]
    fn values_of_known_shapes() {
        let l = [[6.0f64, 2.0, 1.0], [1.0, 4.0, 4.0]].map(|s| s.map(f64::ln));
        let all = [0, 1];
        let mut g = vec![[0.0; 3]; 2];
        let close = |value: f64, expected: f64| assert!((value - expected).abs() < 1e-12, "{value} {expected}");
        close(flatten(&l, &all, 2.0, 1.0, &mut g), 0.5);
        close(anisotropy(&l, &all, 2.0, 1.0, &mut g), 0.5);
        close(roundness(&l, &all, 3.0, 1.0, &mut g), 0.5 * (3.0 + 1.0));
        close(scale(&l, &all, 1.0, &mut g), 3.0);
        // Volumes 12 and 16, one in each group.
        close(volume_ratio(&l, &all, 0.5, 1.2, 1.0, &mut g), 16.0 / 12.0 - f64::from(1.2f32));
        assert_eq!(volume_ratio(&l, &all, 0.5, 2.0, 1.0, &mut g), 0.0);
        // A disc is no needle.
        assert_eq!(anisotropy(&l, &[1], 1.1, 1.0, &mut g), 0.0);
        let mut none = vec![[0.0; 3]; 2];
        for (_, term) in TERMS {
            assert_eq!(term(&l, &[], 1.0, &mut none), 0.0);
        }
        assert_eq!(none, [[0.0; 3]; 2]);
    }

    #[test]
    fn many_blocks_give_the_same_bits_on_any_number_of_threads() {
        let (l, visible) = shapes(100_000);
        let run = |threads: usize, term: Term| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| {
                let mut g = vec![[0.0; 3]; l.len()];
                (term(&l, &visible, 1.0, &mut g), g)
            })
        };
        for (name, term) in TERMS {
            let (value, g) = run(1, term);
            assert!(run(5, term) == (value, g.clone()), "{name}");
            // Blocks cover everything once: of `scale` every derivative is the value itself.
            if name == "scale" {
                let sum: f64 = g.iter().flatten().sum();
                assert!((sum - value).abs() < 1e-9 * value);
            }
        }
    }
}
