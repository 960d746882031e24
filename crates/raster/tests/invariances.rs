//! What must not change the image, and what must change it in a known way (splatting.md §10.3, §10.4 G1).

mod common;

use common::{camera, orthographic, random_splats};
use megas_math::{mat3, quat, rng::Rng, sh, vec3};
use megas_model::{Camera, Projection, Splats};
use megas_raster::{
    Channels, ClipPlane, Frame, Gaussians, NO_GAUSSIAN, Rasterizer, Settings, TileSize, pack_covariance, unpack_covariance,
};

fn draw(g: &Gaussians, cam: &Camera, settings: &Settings, channels: Channels) -> Frame {
    Rasterizer::new().frame(g, cam, settings, channels)
}

fn geometry(g: &Gaussians, cam: &Camera) -> Frame {
    draw(g, cam, &Settings::default(), Channels::Geometry)
}

/// Largest difference of the colours.
fn distance(a: &Frame, b: &Frame) -> f32 {
    a.rgb.as_flattened().iter().zip(b.rgb.as_flattened()).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
}

/// Bit-for-bit equality of everything but the statistics (planar depth holds infinities, never NaN).
fn same_images(a: &Frame, b: &Frame) -> bool {
    let mut b = b.clone();
    b.statistics.clone_from(&a.statistics);
    *a == b
}

/// Differences larger than rounding only where a threshold was met exactly: fewer than one pixel in a thousand.
fn assert_close(a: &Frame, b: &Frame, tolerance: f32) {
    let off = a.rgb.iter().zip(&b.rgb).filter(|(a, b)| (0..3).any(|k| (a[k] - b[k]).abs() > tolerance)).count();
    assert!(off * 1000 <= a.rgb.len(), "{off} of {} pixels, largest {}", a.rgb.len(), distance(a, b));
    assert!(distance(a, b) < 1e-2);
}

#[test]
fn i1_moving_scene_and_camera_together() {
    let splats = random_splats(1, 300);
    let (q, shift) = (quat::normalize([0.3f64, -0.8, 0.4, 0.2]).unwrap(), [0.7f32, -2.0, 1.1]);
    let r = quat::to_mat3_unit(q);
    let r32: megas_math::Mat3<f32> = mat3::cast(r);
    let mut moved = splats.clone();
    let stride = moved.sh_stride();
    for i in 0..moved.len() {
        moved.mean[i] = vec3::add(mat3::mul_vec(r32, moved.mean[i]), shift);
        moved.rotation[i] = quat::mul(q, moved.rotation[i].map(f64::from)).map(|v| v as f32);
        sh::rotate(3, &mut moved.sh[i * stride..(i + 1) * stride], r);
    }
    let cam = camera(96, 64);
    let rotation = mat3::mul(cam.rotation, mat3::transpose(r32));
    let translation = vec3::sub(cam.translation, mat3::mul_vec(rotation, shift));
    let cam2 = Camera { rotation, translation, ..cam };
    assert_close(&geometry(&Gaussians::from_splats(&splats), &cam), &geometry(&Gaussians::from_splats(&moved), &cam2), 1e-5);
}

#[test]
fn i2_order_of_the_input() {
    let splats = random_splats(2, 3000);
    let mut order: Vec<usize> = (0..splats.len()).collect();
    let mut rng = Rng::new(3);
    for i in (1..order.len()).rev() {
        order.swap(i, rng.below(i + 1));
    }
    let (a, b) = (Gaussians::from_splats(&splats), Gaussians::from_splats(&splats.select(&order)));
    let (fa, mut fb) = (geometry(&a, &camera(96, 64)), geometry(&b, &camera(96, 64)));
    for id in &mut fb.argmax {
        *id = if *id == NO_GAUSSIAN { *id } else { order[*id as usize] as u32 };
    }
    assert!(same_images(&fa, &fb));
}

/// Splats of every shape: needles of 1 : 10⁴, sheets, specks and giants.
fn extreme(seed: u64, n: usize) -> Gaussians {
    let mut s = random_splats(seed, n);
    let mut rng = Rng::new(seed);
    for l in &mut s.log_scale {
        *l = std::array::from_fn(|_| rng.range(1e-4f64.ln(), 2f64.ln()) as f32);
    }
    Gaussians::from_splats(&s)
}

#[test]
fn i3_threads_and_tiles_change_no_bit() {
    // More Gaussians than one range of the depth order and one projection chunk.
    for (g, cam) in [
        (extreme(4, 300), camera(150, 110)),
        (Gaussians::from_splats(&random_splats(5, 9500)), camera(70, 50)),
        (extreme(6, 300), orthographic(90)),
        (extreme(7, 300), Camera::look_at([0.3, 0.2, 0.1], [0.0; 3], [0.0, 0.0, 1.0], 1.3, 150, 110)),
    ] {
        for channels in [Channels::Rgba, Channels::RgbaTemperature, Channels::Geometry, Channels::Weights] {
            let base = draw(&g, &cam, &Settings::default(), channels);
            for tile in [TileSize::T8, TileSize::T16, TileSize::T32] {
                let mut per_tile: Option<Frame> = None;
                for threads in [1, 3] {
                    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
                    let f = pool.install(|| draw(&g, &cam, &Settings { tile, ..Settings::default() }, channels));
                    assert!(same_images(&base, &f), "{channels:?} {tile:?} {threads}");
                    assert_eq!(base.statistics.w_max, f.statistics.w_max);
                    assert_eq!(base.statistics.pixels, f.statistics.pixels);
                    if let Some(first) = &per_tile {
                        assert_eq!(first.statistics, f.statistics);
                    }
                    per_tile = Some(f);
                }
            }
        }
    }
}

#[test]
fn channel_sets_agree_and_frames_can_be_reused() {
    let g = Gaussians::from_splats(&random_splats(8, 500));
    let mut raster = Rasterizer::new();
    let mut frame = Frame::default();
    let all = geometry(&g, &camera(80, 60));
    for channels in [Channels::Weights, Channels::RgbaTemperature, Channels::Geometry, Channels::Rgba, Channels::Weights] {
        raster.render(&extreme(9, 700), &orthographic(33), &Settings::default(), channels, &mut frame);
        raster.render(&g, &camera(80, 60), &Settings::default(), channels, &mut frame);
        assert_eq!(frame.transmittance, all.transmittance);
        assert!(frame.rgb.is_empty() || frame.rgb == all.rgb);
        assert!(frame.temperature.is_empty() || frame.temperature == all.temperature);
        assert!(frame.argmax.is_empty() || frame.argmax == all.argmax);
        assert_eq!(frame, draw(&g, &camera(80, 60), &Settings::default(), channels));
    }
}

#[test]
fn i4_scaling_scene_and_camera_together() {
    let s = random_splats(10, 300);
    let mut t = s.clone();
    for i in 0..t.len() {
        t.mean[i] = vec3::scale(t.mean[i], 7.0);
        t.log_scale[i] = t.log_scale[i].map(|l| l + 7f32.ln());
    }
    let cam = camera(96, 64);
    let far = Camera { translation: vec3::scale(cam.translation, 7.0), ..cam };
    assert_close(&geometry(&Gaussians::from_splats(&s), &cam), &geometry(&Gaussians::from_splats(&t), &far), 1e-5);
}

#[test]
fn i5_other_names_for_the_same_gaussian() {
    let s = random_splats(11, 300);
    let mut t = s.clone();
    for i in 0..t.len() {
        // Negated quaternion of the axes in cyclic order: columns (x, y, z) become (y, z, x).
        let a = s.axes(i);
        let turned = mat3::from_columns(mat3::column(a, 1), mat3::column(a, 2), mat3::column(a, 0));
        t.rotation[i] = quat::from_mat3::<f64>(mat3::cast(turned)).map(|v| -v as f32);
        let l = s.log_scale[i];
        t.log_scale[i] = [l[1], l[2], l[0]];
    }
    assert_close(&geometry(&Gaussians::from_splats(&s), &camera(96, 64)), &geometry(&Gaussians::from_splats(&t), &camera(96, 64)), 1e-5);
}

#[test]
fn i6_invisible_and_broken_gaussians_change_nothing() {
    let s = random_splats(12, 200);
    let (g, cam) = (Gaussians::from_splats(&s), camera(64, 64));
    let (base, n) = (geometry(&g, &cam), g.len());
    let mut h = g.clone();
    let c = [0.01, 0.0, 0.0, 0.01, 0.0, 0.01];
    let normal = [0.0, 0.0, 1.0];
    let rgb = [0.5f32; 48];
    let behind = vec3::add_scaled(cam.center(), cam.rotation[2], -1.0);
    h.push([0.0; 3], c, normal, 0.0039, &rgb, 300.0);
    h.push(behind, c, normal, 1.0, &rgb, 300.0);
    // At the camera, beside the image, hidden.
    h.push(cam.center(), c, normal, 1.0, &rgb, 300.0);
    h.push(vec3::add_scaled([0.0; 3], cam.rotation[0], 50.0), c, normal, 1.0, &rgb, 300.0);
    h.push([0.0; 3], c, normal, 1.0, &rgb, 300.0);
    h.set_visible(h.len() - 1, false);
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        for k in 0..3 {
            let mut m = [0.0; 3];
            m[k] = bad;
            h.push(m, c, normal, 1.0, &rgb, 300.0);
            h.push([0.0; 3], c, m, 1.0, &rgb, 300.0);
        }
        for k in 0..6 {
            let mut c = c;
            c[k] = bad;
            h.push([0.0; 3], c, normal, 1.0, &rgb, 300.0);
        }
        h.push([0.0; 3], c, normal, bad, &rgb, 300.0);
        h.push([0.0; 3], c, normal, 1.0, &rgb, bad);
        for k in [0, 4, 47] {
            let mut rgb = rgb;
            rgb[k] = bad;
            h.push([0.0; 3], c, normal, 1.0, &rgb, 300.0);
        }
        h.push([0.0; 3], c, normal, 1.0, &rgb, 300.0);
        h.set_view_rotation(h.len() - 1, [[bad; 3]; 3]);
    }
    // A covariance that is not positive.
    h.push([0.0; 3], [-1.0, 0.0, 0.0, -1.0, 0.0, -1.0], normal, 1.0, &rgb, 300.0);
    assert!(same_images(&base, &geometry(&h, &cam)));
    let ortho = orthographic(40);
    assert!(geometry(&h, &ortho).rgb.as_flattened().iter().all(|v| v.is_finite()));
    let w = draw(&h, &cam, &Settings::default(), Channels::Weights).statistics;
    assert!(w.w_max[n..n + 5].iter().all(|&w| w == 0.0) && w.w_max[..n].iter().any(|&w| w > 0.5));
}

#[test]
fn i7_to_i9_background_weights_and_temperature() {
    let mut s = random_splats(13, 300);
    s.temperature.fill(321.0);
    let (g, cam) = (Gaussians::from_splats(&s), camera(96, 64));
    let white = draw(&g, &cam, &Settings { background: [1.0; 3], ..Settings::default() }, Channels::RgbaTemperature);
    let black = draw(&g, &cam, &Settings::default(), Channels::RgbaTemperature);
    let mut hot = 0;
    for i in 0..white.rgb.len() {
        for k in 0..3 {
            assert!((white.rgb[i][k] - black.rgb[i][k] - black.transmittance[i]).abs() < 1e-6);
        }
        if let Some(t) = black.kelvin(i) {
            hot += 1;
            assert!((t - 321.0).abs() < 1e-3, "{t}");
        }
    }
    assert!(hot > 1000);
    // Every Gaussian white: the colour is Σw.
    s.set_degree(0);
    s.sh.fill(sh::dc_from_rgb(1.0));
    let f = draw(&Gaussians::from_splats(&s), &cam, &Settings::default(), Channels::Rgba);
    for i in 0..f.rgb.len() {
        assert!((f.rgb[i][0] + f.transmittance[i] - 1.0).abs() < 2e-6);
    }
    let w = draw(&g, &cam, &Settings::default(), Channels::Weights);
    let sum: f64 = w.statistics.w_sum.iter().chain(&w.transmittance).map(|&v| f64::from(v)).sum();
    assert!((sum / w.transmittance.len() as f64 - 1.0).abs() < 1e-6);
}

#[test]
fn i10_pushing_forward_by_identity_and_by_a_rigid_motion() {
    let s = random_splats(14, 300);
    let rest = Gaussians::from_splats(&s);
    let cam = camera(96, 64);
    let push = |f: megas_math::Mat3<f32>, shift: [f32; 3]| {
        let mut g = rest.clone();
        for i in 0..g.len() {
            g.covariance[i] = pack_covariance(mat3::symmetrize(mat3::congruence(f, unpack_covariance(g.covariance[i]))));
            g.mean[i] = vec3::add(mat3::mul_vec(f, g.mean[i]), shift);
            g.normal[i] = mat3::mul_vec(f, g.normal[i]);
            g.set_view_rotation(i, f);
        }
        g
    };
    let still = geometry(&rest, &cam);
    assert!(distance(&still, &geometry(&push(mat3::identity(), [0.0; 3]), &cam)) <= 1e-6);
    let (r, shift) = (quat::to_mat3([0.4f32, 0.1, -0.9, 0.3]), [0.3, 0.6, -0.2]);
    let rotation = mat3::mul(cam.rotation, mat3::transpose(r));
    let moved = Camera { rotation, translation: vec3::sub(cam.translation, mat3::mul_vec(rotation, shift)), ..cam };
    assert_close(&still, &geometry(&push(r, shift), &moved), 2e-5);
}

/// A jittered sheet of opaque discs through the origin with the given unit normal.
fn sheet(normal: [f32; 3]) -> Splats {
    let mut rng = Rng::new(15);
    let mut s = Splats::default();
    let (a, b) = vec3::frame_from_normal(normal);
    let r = quat::from_mat3(mat3::from_columns(a, b, normal));
    for i in -40..40 {
        for j in -40..40 {
            let (u, v) = (0.05 * (i as f64 + rng.range(-0.3, 0.3)), 0.05 * (j as f64 + rng.range(-0.3, 0.3)));
            let mean = vec3::add(vec3::scale(a, u as f32), vec3::scale(b, v as f32));
            s.push(mean, [0.04f32.ln(), 0.04f32.ln(), 1e-4f32.ln()], r, 3.0, &[0.5; 3]);
        }
    }
    s
}

#[test]
fn g1_planar_depth_of_a_tilted_plane() {
    let normal = [0.5, 0.0, 0.75f32.sqrt()];
    let g = Gaussians::from_splats(&sheet(normal));
    for cam in [
        Camera::look_at([0.0, 0.0, 3.0], [0.0; 3], [0.0, 1.0, 0.0], 0.6, 64, 64),
        Camera::orthographic([0.0; 3], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0], 0.9, 3.0, 64, 64),
    ] {
        let f = geometry(&g, &cam);
        for y in 4..60 {
            for x in 4..60 {
                let i = f.index(x, y);
                let (o, d) = cam.ray(x as f32 + 0.5, y as f32 + 0.5);
                let t = -vec3::dot(o, normal) / vec3::dot(d, normal);
                let z = t * vec3::dot(d, cam.rotation[2]);
                assert!((f.planar_depth[i] / z - 1.0).abs() < 1e-3, "{} instead of {z}", f.planar_depth[i]);
                let n = vec3::normalize_or(f.normal[i], [0.0; 3]);
                assert!(vec3::dot(n, normal) > 0.1f32.to_radians().cos());
                assert!((f.median_depth[i] / z - 1.0).abs() < 0.05 && (f.depth[i] / z - 1.0).abs() < 0.02);
            }
        }
        // Front-layer votes point to the camera.
        let v = draw(&g, &cam, &Settings::default(), Channels::Weights).statistics.votes;
        assert!(v.iter().filter(|v| vec3::norm(**v) > 0.0).all(|&v| vec3::dot(v, normal) > 0.0));
    }
}

#[test]
fn orthographic_is_the_limit_of_far_perspective() {
    let mut s = random_splats(16, 300);
    s.set_degree(1);
    let g = Gaussians::from_splats(&s);
    let ortho = orthographic(64);
    let Projection::Orthographic { scale } = ortho.projection else { unreachable!() };
    let distance_away = 4000.0;
    let far = Camera {
        translation: vec3::add(ortho.translation, [0.0, 0.0, distance_away - 5.0]),
        projection: Projection::Pinhole { fx: scale * distance_away, fy: scale * distance_away },
        ..ortho
    };
    let (a, b) = (geometry(&g, &ortho), geometry(&g, &far));
    let mean: f32 = a.rgb.as_flattened().iter().zip(b.rgb.as_flattened()).map(|(a, b)| (a - b).abs()).sum::<f32>() / (3.0 * 64.0 * 64.0);
    assert!(mean < 1e-3, "{mean}");
    assert!(mean > 0.0);
}

#[test]
fn nothing_to_draw_and_nowhere_to_draw_it() {
    let settings = Settings { background: [0.1, 0.2, 0.3], ..Settings::default() };
    for g in [Gaussians::new(0), Gaussians::new(3)] {
        let f = draw(&g, &camera(20, 10), &settings, Channels::Geometry);
        assert!(f.rgb.iter().all(|&c| c == settings.background) && f.transmittance.iter().all(|&t| t == 1.0));
        assert!(f.planar_depth.iter().all(|d| *d == f32::INFINITY) && f.argmax.iter().all(|&a| a == NO_GAUSSIAN));
        assert!(draw(&g, &camera(20, 10), &settings, Channels::Weights).statistics.w_max.is_empty());
    }
    let g = Gaussians::from_splats(&random_splats(17, 50));
    for (w, h) in [(0, 10), (10, 0), (0, 0)] {
        assert!(draw(&g, &camera(w, h), &settings, Channels::Geometry).rgb.is_empty());
    }
    let one = Camera::look_at([3.0, 0.0, 0.0], [0.0; 3], [0.0, 0.0, 1.0], 0.8, 1, 1);
    assert!(draw(&g, &one, &settings, Channels::Rgba).transmittance[0] < 1.0);
}

#[test]
fn giants_and_specks() {
    let cam = camera(64, 64);
    let mut g = Gaussians::new(0);
    let white = [sh::dc_from_rgb(1.0); 3];
    for size in [1e9f32, 1e4] {
        g.clear();
        g.push([0.0; 3], [size * size, 0.0, 0.0, size * size, 0.0, size * size], [0.0, 0.0, 1.0], 0.5, &white, 300.0);
        let f = draw(&g, &cam, &Settings::default(), Channels::Rgba);
        assert!(f.transmittance.iter().all(|t| (t - 0.5).abs() < 1e-4), "{size}");
    }
    // A point: only the low-pass is left, and its integral is that of the low-pass.
    g.clear();
    g.push([0.0; 3], [0.0; 6], [0.0, 0.0, 1.0], 1.0, &white, 300.0);
    let f = draw(&g, &cam, &Settings { alpha_max: 1.0, alpha_min: 1e-9, ..Settings::default() }, Channels::Rgba);
    let sum: f32 = f.rgb.iter().map(|c| c[0]).sum();
    assert!((sum / (0.3 * std::f32::consts::TAU) - 1.0).abs() < 0.06, "{sum}");
    let f = draw(&g, &cam, &Settings { anti_aliased: true, ..Settings::default() }, Channels::Rgba);
    assert!(f.rgb.iter().map(|c| c[0]).sum::<f32>() < 0.05);
}

#[test]
fn what_is_trained_on_fine_pixels_stays_as_large_from_far_away() {
    // A wall of small discs, seen at the pixels of its training and four times coarser: each coarse pixel is to be the mean of 4 × 4.
    let mut s = Splats::default();
    let mut rng = Rng::new(31);
    for i in 0..32 * 32 {
        let at = |k: i32| (k as f32 + 0.5) / 32.0 - 0.5;
        let colour = [0, 1, 2].map(|_| sh::dc_from_rgb(rng.unit() as f32));
        s.push([at(i % 32), at(i / 32), 0.0], [-4.2, -4.2, -7.0], [1.0, 0.0, 0.0, 0.0], 4.0, &colour);
    }
    let look = |size: u32| Camera::orthographic([0.0; 3], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0], 1.0, 5.0, size, size);
    // At the training's own resolution it changes nothing.
    let plain = Gaussians::from_splats(&Splats { trained_pixel: vec![0.0; s.len()], ..s.clone() });
    let same = Gaussians::from_splats(&Splats { trained_pixel: vec![2.0 / 256.0; s.len()], ..s.clone() });
    assert!(distance(&geometry(&plain, &look(256)), &geometry(&same, &look(256))) < 1e-4);
    let mut error = |pixel: f32| {
        s.trained_pixel.fill(pixel);
        let g = Gaussians::from_splats(&s);
        let fine = draw(&g, &look(256), &Settings::default(), Channels::Rgba);
        let coarse = draw(&g, &look(64), &Settings::default(), Channels::Rgba);
        let mean = |x: usize, y: usize| -> [f32; 3] {
            let at = |k: usize| fine.rgb[(4 * y + k / 4) * 256 + 4 * x + k % 4];
            (0..16).map(at).fold([0.0; 3], |s, c| vec3::add_scaled(s, c, 1.0 / 16.0))
        };
        let differs = |i: usize| vec3::norm(vec3::sub(coarse.rgb[i], mean(i % 64, i / 64)));
        (0..64 * 64).map(differs).sum::<f32>() / (64.0 * 64.0)
    };
    let (unknown, known) = (error(0.0), error(2.0 / 256.0));
    assert!(known < 0.25 * unknown && known < 0.02, "{unknown} {known}");
}

#[test]
fn the_clip_plane_leaves_out_one_side() {
    let g = Gaussians::from_splats(&random_splats(18, 300));
    let cut = ClipPlane { normal: [0.0, 0.0, 1.0], offset: 0.1 };
    let mut kept = g.clone();
    for i in 0..g.len() {
        kept.set_visible(i, g.mean[i][2] <= 0.1);
    }
    let a = draw(&g, &camera(64, 64), &Settings { clip: Some(cut), ..Settings::default() }, Channels::Geometry);
    assert!(same_images(&a, &geometry(&kept, &camera(64, 64))));
    assert!(!same_images(&a, &geometry(&g, &camera(64, 64))));
}

#[test]
fn statistics_of_views_add_up() {
    let g = Gaussians::from_splats(&random_splats(19, 200));
    let a = draw(&g, &camera(64, 64), &Settings::default(), Channels::Weights).statistics;
    let b = draw(&g, &orthographic(64), &Settings::default(), Channels::Weights).statistics;
    let mut sum = megas_raster::Statistics::default();
    sum.merge(&a);
    sum.merge(&b);
    for i in 0..g.len() {
        assert_eq!(sum.w_max[i], a.w_max[i].max(b.w_max[i]));
        assert_eq!(sum.pixels[i], a.pixels[i] + b.pixels[i]);
        assert_eq!(sum.votes[i][1], a.votes[i][1] + b.votes[i][1]);
    }
}
