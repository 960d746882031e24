use megas_math::rng::Rng;

use super::super::reference;
use super::*;

fn random(rng: &mut Rng, pixels: usize) -> Vec<[f32; 3]> {
    (0..pixels).map(|_| [(); 3].map(|_| rng.unit() as f32)).collect()
}

/// A textured image and a render that resembles it, both with flat bright parts.
fn pair(width: usize, height: usize, seed: u64) -> (Vec<[f32; 3]>, Vec<[f32; 3]>) {
    let mut rng = Rng::new(seed);
    let mut y = random(&mut rng, width * height);
    let mut x = y.clone();
    for (i, (x, y)) in x.iter_mut().zip(&mut y).enumerate() {
        if i % width < width / 3 {
            *y = [1.0, 0.9, 1.0];
            *x = *y;
        }
        for c in 0..3 {
            x[c] = (x[c] + 0.1 * (rng.unit() as f32 - 0.5)).clamp(0.0, 1.0);
        }
    }
    (x, y)
}

fn wide(v: &[[f32; 3]]) -> Vec<f64> {
    v.as_flattened().iter().map(|&v| f64::from(v)).collect()
}

fn relative(got: &[[f32; 3]], exact: &[f64]) -> f64 {
    let (mut error, mut size) = (0.0, 0.0);
    for (&g, &e) in got.as_flattened().iter().zip(exact) {
        error += (f64::from(g) - e).powi(2);
        size += e * e;
    }
    (error / size).sqrt()
}

#[test]
fn value_and_gradient_follow_the_direct_sum_at_any_size() {
    // Narrower than a vector, than the window, a multiple of the vector width and not.
    for (k, (width, height)) in [(1, 1), (2, 9), (5, 4), (16, 12), (37, 29), (64, 33)].into_iter().enumerate() {
        let (x, y) = pair(width, height, k as u64);
        let mut rng = Rng::new(99);
        let mask: Vec<f32> = (0..width * height).map(|i| if i % 5 == 0 { 0.0 } else { rng.unit() as f32 + 0.1 }).collect();
        let mut photometric = Photometric::new();
        for masked in [false, true] {
            if masked && width * height == 1 {
                continue;
            }
            let mut target = Target::new(width, height, &y);
            target.set_mask(masked.then_some(&mask));
            let mut gradient = vec![[f32::NAN; 3]; x.len()];
            let got = photometric.evaluate(&x, &target, 0.2, &mut gradient);
            let weights: Vec<f64> = mask.iter().map(|&m| if masked { f64::from(m) } else { 1.0 }).collect();
            let (l1, ssim, exact) = reference::photometric(&wide(&x), &wide(&y), &weights, width, height, 0.2);
            assert!((got.l1 - l1).abs() < 1e-6 && (got.ssim - ssim).abs() < 2e-5, "{width}x{height}: {got:?}, {l1} {ssim}");
            assert!((got.total - (0.8 * l1 + 0.2 * (1.0 - ssim))).abs() < 1e-5);
            let error = relative(&gradient, &exact);
            assert!(error < 1e-4, "{width}x{height}, masked {masked}: gradient differs by {error:e}");
        }
    }
}

#[test]
fn every_instruction_set_gives_the_same() {
    let (width, height) = (37, 29);
    let (x, y) = pair(width, height, 2);
    let (_, _, exact) = reference::photometric(&wide(&x), &wide(&y), &vec![1.0; x.len()], width, height, 0.2);
    for level in levels() {
        let mut target = Target::new(width, height, &y);
        target.find_moments(level);
        let mut gradient = vec![[0.0; 3]; x.len()];
        Photometric { level, ..Photometric::new() }.evaluate(&x, &target, 0.2, &mut gradient);
        let error = relative(&gradient, &exact);
        assert!(error < 1e-4, "{level:?}: {error:e}");
    }
}

#[test]
fn the_reference_gradient_is_the_derivative() {
    let (width, height) = (9, 7);
    let (x, y) = pair(width, height, 5);
    let (mut x, y) = (wide(&x), wide(&y));
    let mask: Vec<f64> = (0..width * height).map(|i| (i % 4) as f64 * 0.4).collect();
    let lambda = 0.7;
    let total = |x: &[f64]| {
        let (l1, ssim, _) = reference::photometric(x, &y, &mask, width, height, lambda);
        (1.0 - lambda) * l1 + lambda * (1.0 - ssim)
    };
    let (_, _, gradient) = reference::photometric(&x, &y, &mask, width, height, lambda);
    let size = gradient.iter().fold(0.0f64, |m, g| m.max(g.abs()));
    for i in 0..x.len() {
        let (h, old) = (1e-6, x[i]);
        x[i] = old + h;
        let above = total(&x);
        x[i] = old - h;
        let slope = (above - total(&x)) / (2.0 * h);
        x[i] = old;
        assert!((slope - gradient[i]).abs() < 1e-7 * size.max(1.0), "{i}: {slope} {}", gradient[i]);
    }
}

#[test]
fn equal_images_are_perfectly_similar_and_at_rest() {
    let (_, y) = pair(50, 40, 3);
    let target = Target::new(50, 40, &y);
    let mut gradient = vec![[1.0; 3]; y.len()];
    let loss = Photometric::new().evaluate(&y, &target, 1.0, &mut gradient);
    assert!(loss.l1 == 0.0 && (loss.ssim - 1.0).abs() < 1e-6, "{loss:?}");
    let largest = gradient.as_flattened().iter().fold(0.0f32, |m, g| m.max(g.abs()));
    // A real difference of 0.1 in one pixel has a gradient of order 1/samples.
    assert!(largest * 3.0 * y.len() as f32 <= 1e-2, "{largest}");
}

#[test]
fn what_the_mask_hides_does_not_count() {
    let (x, y) = pair(40, 30, 8);
    let mut target = Target::new(40, 30, &y);
    let mask: Vec<f32> = (0..1200).map(|i| if i % 40 < 20 { 1.0 } else { 0.0 }).collect();
    target.set_mask(Some(&mask));
    let mut changed = x.clone();
    for (i, px) in changed.iter_mut().enumerate() {
        if i % 40 >= 25 {
            *px = [0.0; 3];
        }
    }
    let (mut g0, mut g1) = (vec![[0.0; 3]; 1200], vec![[0.0; 3]; 1200]);
    let mut photometric = Photometric::new();
    // The windows of the last unmasked column end at column 24.
    assert_eq!(photometric.evaluate(&x, &target, 0.2, &mut g0), photometric.evaluate(&changed, &target, 0.2, &mut g1));
    assert_eq!(g0, g1);
    assert!((0..1200).all(|i| i % 40 < 25 || g0[i] == [0.0; 3]));
    assert!((0..1200).any(|i| i % 40 > 20 && g0[i] != [0.0; 3]), "windows reach beyond the mask");
    target.set_mask(Some(&vec![0.0; 1200]));
    let loss = photometric.evaluate(&x, &target, 0.2, &mut g0);
    assert!(loss.total == 0.0 && g0.iter().all(|g| *g == [0.0; 3]));
}

#[test]
fn threads_do_not_change_a_bit() {
    let (x, y) = pair(83, 61, 4);
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let target = Target::new(83, 61, &y);
            let mut gradient = vec![[0.0; 3]; x.len()];
            (Photometric::new().evaluate(&x, &target, 0.2, &mut gradient), gradient)
        })
    };
    assert_eq!(run(1), run(5));
}

/// Every level that the machine has, the best last.
fn levels() -> Vec<Level> {
    let best = Level::new();
    let mut levels = vec![Level::baseline()];
    #[cfg(any(target_arch = "x86", target_arch = "x86_64"))]
    levels.extend(best.as_sse4_2().map(Level::Sse4_2).into_iter().chain(best.as_avx2().map(Level::Avx2)));
    levels.push(best);
    levels
}

/// Run with `--ignored --nocapture` on an optimised build to see the cost of one iteration at 400².
#[test]
#[ignore = "a measurement"]
fn cost_at_400() {
    let (x, y) = pair(400, 400, 1);
    let rgba: Vec<u8> = y.iter().flat_map(|p| [(p[0] * 255.0) as u8, (p[1] * 255.0) as u8, (p[2] * 255.0) as u8, 200]).collect();
    let mut target = Target::new(400, 400, &y);
    let mut gradient = vec![[0.0; 3]; x.len()];
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    for level in levels() {
        let mut photometric = Photometric { level, ..Photometric::new() };
        let mut best = [f64::MAX; 2];
        pool.install(|| {
            for i in 0..40 {
                let start = std::time::Instant::now();
                target.composite_u8(400, 400, &rgba, [i as f32 / 60.0; 3]);
                best[0] = best[0].min(start.elapsed().as_secs_f64());
                let start = std::time::Instant::now();
                photometric.evaluate(&x, &target, 0.2, &mut gradient);
                best[1] = best[1].min(start.elapsed().as_secs_f64());
            }
        });
        println!("composite {:.2} ms (best level), evaluate {:.2} ms ({level:?})", best[0] * 1e3, best[1] * 1e3);
        assert!(best[1] < 0.1);
    }
}
