//! The rasterizer against the brute-force reference (splatting.md §10.2).

mod common;

use fearless_simd::{Level, Simd};

use common::{camera, orthographic, random_splats, render};
use megas_model::Camera;
use megas_raster::{Channels, Gaussians, NO_GAUSSIAN, Rasterizer, Settings};

/// Compares every channel and statistic; returns the largest error of a colour.
fn compare(g: &Gaussians, cam: &Camera, settings: &Settings) -> f64 {
    compare_at(Level::new(), g, cam, settings)
}

fn compare_at(level: Level, g: &Gaussians, cam: &Camera, settings: &Settings) -> f64 {
    let reference = render(g, cam, settings);
    // The documents ask for 2e-5; what is asserted here is the accuracy that was reached, with room for other processors.
    let mut raster = Rasterizer::with_level(level);
    let f = raster.frame(g, cam, settings, Channels::Geometry);
    let weights = raster.frame(g, cam, settings, Channels::Weights);
    let (mut worst, mut tied) = (0.0f64, 0);
    let mut ambiguous = vec![false; g.len()];
    for (i, r) in reference.pixels.iter().enumerate() {
        // A decision within rounding of a tie may go either way; such pixels are counted, not compared.
        if r.margin < 1e-5 {
            tied += 1;
            ambiguous.fill(true);
            continue;
        }
        let close = |what: &str, got: f32, want: f64, tolerance: f64| {
            assert!((f64::from(got) - want).abs() <= tolerance, "pixel {i}: {what} {got} instead of {want}");
        };
        for k in 0..3 {
            worst = worst.max((f64::from(f.rgb[i][k]) - r.rgb[k]).abs());
            close("colour", f.rgb[i][k], r.rgb[k], 3e-6);
            close("normal", f.normal[i][k], r.normal[k], 3e-6);
        }
        close("transmittance", f.transmittance[i], r.t, 3e-6);
        close("temperature", f.temperature[i], r.temperature, 400.0 * 3e-6);
        close("best weight", f.argmax_weight[i], r.best, 1e-5);
        if 1.0 - r.t > 0.01 {
            close("depth", f.depth[i], r.depth, 6.0 * 3e-6 / (1.0 - r.t));
        }
        if r.best - r.second > 1e-4 {
            assert_eq!(f.argmax[i], r.argmax, "pixel {i}");
            assert_eq!(weights.argmax[i], r.argmax, "pixel {i}");
        }
        if r.gate > 1e-5 {
            close("median depth", f.median_depth[i], r.median, 1e-5 * r.median);
        }
        if r.planar_margin > 1e-2 {
            assert_eq!(f.planar_depth[i].is_finite(), r.planar.is_finite(), "pixel {i}");
            if r.planar.is_finite() {
                close("planar depth", f.planar_depth[i], r.planar, 2e-4 * r.planar.abs());
            }
        }
        assert_eq!(weights.transmittance[i], f.transmittance[i]);
    }
    assert!(tied * 1000 < reference.pixels.len(), "{tied} pixels near a tie");
    let s = &weights.statistics;
    let mut winners = vec![0u32; g.len()];
    for &id in &weights.argmax {
        if id != NO_GAUSSIAN {
            winners[id as usize] += 1;
        }
    }
    assert_eq!(winners, s.argmax_pixels);
    for i in 0..g.len() {
        let tie = tied as f64;
        let (w_max, w_sum) = (f64::from(s.w_max[i]), f64::from(s.w_sum[i]));
        assert!((w_max - reference.w_max[i]).abs() < 1e-5 || ambiguous[i] && (w_max - reference.w_max[i]).abs() < 5e-3, "w_max of {i}");
        let slack = 1e-5 * (1.0 + reference.w_sum[i]) + 5e-3 * tie;
        assert!((w_sum - reference.w_sum[i]).abs() < slack, "w_sum of {i}: {w_sum} instead of {}", reference.w_sum[i]);
        assert!(s.pixels[i].abs_diff(reference.blended[i]) as usize <= tied, "pixels of {i}");
        for a in 0..3 {
            let slack = slack + reference.vote_slack[i];
            assert!((f64::from(s.votes[i][a]) - reference.votes[i][a]).abs() < slack, "vote of {i}");
        }
    }
    worst
}

#[test]
fn twenty_random_scenes_match_the_reference() {
    let mut worst = 0.0f64;
    for seed in 0..20 {
        let g = Gaussians::from_splats(&random_splats(seed, 200));
        let settings = Settings { background: [0.2, 0.5, 0.8], ..Settings::default() };
        worst = worst.max(compare(&g, &camera(64, 64), &settings));
    }
    println!("largest error of a colour: {worst:.2e}");
}

#[test]
fn other_cameras_and_settings_match_the_reference() {
    for seed in 20..24 {
        let mut g = Gaussians::from_splats(&random_splats(seed, 200));
        compare(&g, &orthographic(64), &Settings::default());
        // Sizes that fill neither tiles nor bricks.
        compare(&g, &camera(61, 35), &Settings::default());
        compare(&g, &camera(64, 48), &Settings { anti_aliased: true, ..Settings::default() });
        // Trained on pixels that are unknown, smaller and larger than those of the picture.
        g.trained_pixel = (0..g.len()).map(|i| [0.0, 0.01, 0.1][i % 3]).collect();
        compare(&g, &camera(64, 48), &Settings::default());
        compare(&g, &orthographic(64), &Settings::default());
        g.trained_pixel.clear();
        let turn = megas_math::quat::to_mat3([0.8f32, 0.3, -0.2, 0.5]);
        for i in (0..g.len()).step_by(2) {
            g.set_view_rotation(i, turn);
        }
        compare(&g, &camera(64, 48), &Settings { alpha_min: 0.02, alpha_max: 0.8, t_stop: 0.01, low_pass: 0.1, ..Settings::default() });
        // Close up: many means outside the frustum, clamped tangents, splats larger than the image.
        let near = Camera::look_at([0.6, -0.5, 0.4], [0.0; 3], [0.0, 0.0, 1.0], 1.2, 48, 48);
        compare(&g, &near, &Settings::default());
    }
}

/// What a machine without this one's newest instructions computes.
#[test]
fn every_instruction_set_matches_the_reference() {
    let best = Level::new();
    let mut levels = vec![best];
    #[cfg(target_arch = "x86_64")]
    levels.extend(
        [best.as_avx2().map(|t| t.level()), best.as_sse4_2().map(|t| t.level()), best.as_sse2().map(|t| t.level())].iter().flatten(),
    );
    for level in levels {
        for seed in 30..33 {
            let g = Gaussians::from_splats(&random_splats(seed, 200));
            compare_at(level, &g, &camera(64, 64), &Settings::default());
        }
    }
}
