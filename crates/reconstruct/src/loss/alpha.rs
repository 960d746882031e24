//! Agreement of the accumulated alpha with the alpha of the photograph (splatting.md §5.2, RGBA inputs only).

use rayon::prelude::*;

/// Pixels per unit of parallel work.
const BLOCK: usize = 8192;

/// Mean of `|A − α|` over pixels, `A = 1 − transmittance`, `α = target(pixel)` in [0, 1]. Adds `weight` times its derivative
/// by `A` to `gradient`.
pub fn alpha(transmittance: &[f32], target: impl Fn(usize) -> f32 + Sync, weight: f32, gradient: &mut [f32]) -> f64 {
    assert_eq!(transmittance.len(), gradient.len(), "one alpha per pixel");
    let n = transmittance.len().max(1) as f64;
    let step = (f64::from(weight) / n) as f32;
    let blocks = transmittance.par_chunks(BLOCK).zip(gradient.par_chunks_mut(BLOCK)).enumerate();
    let sums: Vec<f64> = blocks
        .map(|(block, (transmittance, gradient))| {
            let mut sum = 0.0;
            for (i, (t, g)) in transmittance.iter().zip(gradient).enumerate() {
                let difference = (1.0 - t) - target(block * BLOCK + i);
                sum += f64::from(difference.abs());
                if difference != 0.0 {
                    *g += step.copysign(difference);
                }
            }
            sum
        })
        .collect();
    sums.iter().sum::<f64>() / n
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_gradient_is_the_derivative_and_is_added() {
        let n = 20_000;
        let wanted = |i: usize| (i % 7) as f32 / 6.0;
        let mut t: Vec<f32> = (0..n).map(|i| (i % 11) as f32 / 10.0 + 0.004).collect();
        t[3] = 1.0 - wanted(3);
        let mut g = vec![1.0; n];
        let value = alpha(&t, wanted, 0.5, &mut g);
        let direct: f64 = (0..n).map(|i| f64::from((1.0 - t[i] - wanted(i)).abs())).sum::<f64>() / n as f64;
        assert!((value - direct).abs() < 1e-9);
        assert_eq!(g[3], 1.0);
        for i in [0, 9000, n - 1] {
            // Large enough for single precision, smaller than the distance to the kink.
            let (h, old) = (2e-3f32, t[i]);
            let mut scratch = vec![0.0; n];
            t[i] = old - h;
            let above = alpha(&t, wanted, 0.5, &mut scratch);
            t[i] = old + h;
            let slope = 0.5 * (above - alpha(&t, wanted, 0.5, &mut scratch)) / (2.0 * f64::from(h));
            t[i] = old;
            assert!((slope - f64::from(g[i] - 1.0)).abs() < 2e-7, "{i}: {slope} {}", g[i] - 1.0);
            assert!(slope.abs() > 2e-5);
        }
    }
}
