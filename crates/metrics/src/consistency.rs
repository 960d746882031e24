//! What must not change from view to view and from frame to frame, and what must not come to light (splatting.md §9.3 M9, M11–M13).

use megas_math::{mat3, vec3};
use megas_model::{Camera, Image};
use megas_raster::{Channels, Frame, Gaussians, Rasterizer, Settings};
use serde::{Deserialize, Serialize};

/// Angle between the two views of a pair, and between two that should look the same \[rad\].
pub const PAIR: f64 = 15.0 * std::f64::consts::PI / 180.0;
/// Angle over which nothing may pop \[rad\].
pub const POP: f64 = 0.1 * std::f64::consts::PI / 180.0;
/// Two views see the same point where their depths agree to this, in diagonals L.
const AGREE: f64 = 0.01;
/// Opacity from which temperatures are compared.
const OPAQUE: f32 = 0.9;

/// M9: how much of what is seen are Gaussians that were inside the object at rest, over all views: `Σ w [inside] / Σ A`.
pub fn exposure(model: &Gaussians, inside: &[bool], cameras: &[Camera], rasterizer: &mut Rasterizer) -> f64 {
    assert_eq!(inside.len(), model.len(), "one flag per Gaussian");
    let mut frame = Frame::default();
    let (mut hidden, mut all) = (0.0, 0.0);
    for camera in cameras {
        rasterizer.render(model, camera, &Settings::default(), Channels::Weights, &mut frame);
        all += frame.transmittance.iter().map(|t| f64::from(1.0 - t)).sum::<f64>();
        hidden += frame.statistics.w_sum.iter().zip(inside).filter(|p| *p.1).map(|p| f64::from(*p.0)).sum::<f64>();
    }
    if all > 0.0 { hidden / all } else { 0.0 }
}

/// M11: mean of `|I_{t+1} − 2 I_t + I_{t−1}|` over channels and the pixels of `mask`, over the frames of a film of a static camera.
/// `None` for fewer than three frames or an empty mask.
pub fn second_difference(frames: &[Image], mask: &[bool]) -> Option<f64> {
    let (mut sum, mut count) = (0.0, 0usize);
    for w in frames.windows(3) {
        let channels = w[1].channels as usize;
        assert!(w.iter().all(|i| i.data.len() == mask.len() * channels), "frames of one size, and a flag per pixel");
        for (i, _) in mask.iter().enumerate().filter(|m| *m.1) {
            for k in i * channels..(i + 1) * channels {
                sum += f64::from(w[2].data[k] - 2.0 * w[1].data[k] + w[0].data[k]).abs();
                count += 1;
            }
        }
    }
    (count > 0).then(|| sum / count as f64)
}

/// M12: how two views of the same thing differ after one is warped to the other.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ViewDifference {
    /// Mean absolute difference of the colours.
    pub colour: f64,
    /// Mean distance by which a point misses itself after going there and back \[px\].
    pub reprojection: f64,
    /// Mean absolute difference of the temperatures \[K\].
    pub kelvin: f64,
    /// Pixels that both views see, as a fraction of what the first sees.
    pub shared: f64,
}

/// Cameras 15° apart about `centre`, or as far as `angle` says: the second is the first turned about the scene's z.
pub fn turned(camera: &Camera, centre: [f32; 3], angle: f64) -> Camera {
    let (s, c) = angle.sin_cos();
    let turn = [[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]];
    let back = mat3::transpose(turn);
    let rotation = mat3::mul(mat3::cast::<f32, f64>(camera.rotation), back);
    // The camera stays where it is seen from the turned scene: W' x' + t' = W x + t for x' = R (x − c) + c.
    let c = vec3::cast::<f32, f64>(centre);
    let t = vec3::add(vec3::cast(camera.translation), mat3::mul_vec(mat3::cast(camera.rotation), vec3::sub(c, mat3::mul_vec(back, c))));
    Camera { rotation: mat3::cast(rotation), translation: vec3::cast(t), ..*camera }
}

/// Compares two views of a model; `diagonal` is L.
pub fn view_difference(model: &Gaussians, a: &Camera, b: &Camera, diagonal: f64, rasterizer: &mut Rasterizer) -> ViewDifference {
    let [first, second] = [a, b].map(|c| rasterizer.frame(model, c, &Settings::default(), Channels::Geometry));
    let agree = (AGREE * diagonal) as f32;
    let (w, h) = (b.width as usize, b.height as usize);
    let mut out = ViewDifference::default();
    let (mut seen, mut shared) = (0usize, 0usize);
    for i in 0..first.planar_depth.len() {
        let depth = first.planar_depth[i];
        if !depth.is_finite() {
            continue;
        }
        seen += 1;
        let at = [(i % a.width as usize) as f32 + 0.5, (i / a.width as usize) as f32 + 0.5];
        let x = lifted(a, at, depth);
        let p = b.to_camera(x);
        let [u, v] = b.project(p);
        // The four pixels about the place; their centres are at halves.
        let (fu, fv) = (u - 0.5, v - 0.5);
        if !(fu >= 0.0 && fv >= 0.0 && fu < (w - 1) as f32 && fv < (h - 1) as f32) {
            continue;
        }
        let (x0, y0) = (fu as usize, fv as usize);
        let (wx, wy) = (fu - x0 as f32, fv - y0 as f32);
        let near = [y0 * w + x0, y0 * w + x0 + 1, (y0 + 1) * w + x0, (y0 + 1) * w + x0 + 1];
        let weight = [(1.0 - wx) * (1.0 - wy), wx * (1.0 - wy), (1.0 - wx) * wy, wx * wy];
        // Infinite depths fail too.
        if !near.iter().all(|&j| (second.planar_depth[j] - p[2]).abs() < agree) {
            continue;
        }
        shared += 1;
        let mix = |f: &dyn Fn(usize) -> f32| (0..4).map(|k| weight[k] * f(near[k])).sum::<f32>();
        let there = lifted(b, [u, v], mix(&|j| second.planar_depth[j]));
        let [u, v] = a.project(a.to_camera(there));
        out.reprojection += f64::from(u - at[0]).hypot(f64::from(v - at[1]));
        out.colour += (0..3).map(|c| f64::from(mix(&|j| second.rgb[j][c]) - first.rgb[i][c]).abs()).sum::<f64>() / 3.0;
        let kelvin = |f: &Frame, j: usize| f.kelvin(j).unwrap_or(0.0);
        out.kelvin += f64::from(mix(&|j| kelvin(&second, j)) - kelvin(&first, i)).abs();
    }
    let n = shared.max(1) as f64;
    ViewDifference {
        colour: out.colour / n,
        reprojection: out.reprojection / n,
        kelvin: out.kelvin / n,
        shared: shared as f64 / seen.max(1) as f64,
    }
}

/// The point at a depth along z behind a place in the image.
fn lifted(camera: &Camera, [u, v]: [f32; 2], depth: f32) -> [f32; 3] {
    let (o, d) = camera.ray(u, v);
    let (z, slope) = (camera.to_camera(o)[2], vec3::dot(camera.rotation[2], d));
    vec3::add_scaled(o, d, (depth - z) / slope)
}

/// M13: errors of the rendered temperature \[K\].
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TemperatureError {
    /// Mean.
    pub mean: f64,
    /// 95th percentile.
    pub p95: f64,
    /// Pixels compared.
    pub pixels: usize,
}

/// Compares the temperature of a render with the true one (`None` where there is no surface) where `A ≥ 0.9`.
pub fn temperature_error(frame: &Frame, truth: impl Fn(usize) -> Option<f32>) -> TemperatureError {
    let opaque = (0..frame.transmittance.len()).filter(|&i| frame.alpha(i) >= OPAQUE);
    let mut errors: Vec<f64> = opaque.filter_map(|i| Some(f64::from(frame.kelvin(i)? - truth(i)?).abs())).collect();
    errors.sort_unstable_by(f64::total_cmp);
    let n = errors.len();
    let p95 = errors.get((n * 95 / 100).min(n.saturating_sub(1))).copied().unwrap_or(0.0);
    TemperatureError { mean: errors.iter().sum::<f64>() / n.max(1) as f64, p95, pixels: n }
}

#[cfg(test)]
mod tests {
    use megas_math::{quat, sh};
    use megas_model::{Splats, fibonacci_directions};

    use super::*;

    /// An opaque ball of radius 1 whose temperature is 300 + 50 (1 + z) and whose colour follows the place, with one Gaussian in
    /// its middle.
    fn ball(count: usize, keep: impl Fn([f32; 3]) -> bool) -> Gaussians {
        let size = (4.0 * std::f32::consts::PI / count as f32).sqrt();
        let mut s = Splats::default();
        let l = (0.7 * size).ln();
        s.push([0.0; 3], [l + 2.0; 3], [1.0, 0.0, 0.0, 0.0], 5.0, &[3.0, -3.0, -3.0]);
        for d in fibonacci_directions(count).into_iter().filter(|d| keep(*d)) {
            s.push(d, [l, l, l - 3.0], quat::between([0.0, 0.0, 1.0], d), 5.0, &d.map(|v| sh::dc_from_rgb(0.5 + 0.3 * v)));
            let last = s.len() - 1;
            s.temperature[last] = 300.0 + 50.0 * (1.0 + d[2]);
        }
        Gaussians::from_splats(&s)
    }

    fn camera() -> Camera {
        Camera::look_at([2.5, 2.0, 1.0], [0.0; 3], [0.0, 0.0, 1.0], 0.7, 96, 96)
    }

    #[test]
    fn what_is_inside_comes_to_light_through_a_hole() {
        let mut r = Rasterizer::new();
        let inside = |g: &Gaussians| (0..g.len()).map(|i| i == 0).collect::<Vec<_>>();
        let (whole, holed) = (ball(8000, |_| true), ball(8000, |d| vec3::dot(d, [0.74, 0.59, 0.3]) < 0.8));
        let dark = exposure(&whole, &inside(&whole), &[camera()], &mut r);
        let light = exposure(&holed, &inside(&holed), &[camera()], &mut r);
        assert!(dark < 0.01 && light > 0.02, "{dark} {light}");
        assert!((exposure(&whole, &vec![true; whole.len()], &[camera()], &mut r) - 1.0).abs() < 1e-3);
    }

    #[test]
    fn second_differences_forgive_steady_change_and_count_flicker() {
        let frame = |v: f32| Image { width: 2, height: 1, channels: 3, data: vec![v, v, v, 9.0 * v, 0.0, 0.0] };
        let steady: Vec<Image> = [0.0, 0.1, 0.2, 0.3].map(frame).into();
        let mask = [true, false];
        assert!(second_difference(&steady, &mask).unwrap() < 1e-6);
        let flicker: Vec<Image> = [0.0, 0.1, 0.0, 0.1].map(frame).into();
        assert!((second_difference(&flicker, &mask).unwrap() - 0.2).abs() < 1e-6);
        assert!(second_difference(&steady[..2], &mask).is_none() && second_difference(&steady, &[false; 2]).is_none());
    }

    #[test]
    fn two_views_of_a_coloured_ball_agree() {
        let g = ball(20_000, |_| true);
        let a = camera();
        let b = turned(&a, [0.0; 3], PAIR);
        assert!((vec3::norm(b.center()) - vec3::norm(a.center())).abs() < 1e-5);
        let cos = vec3::dot(a.center(), b.center()) / vec3::dot(a.center(), a.center());
        // The cameras go round the vertical axis.
        let [x, y, _] = a.center();
        let expected = 1.0 - (1.0 - (PAIR as f32).cos()) * (x * x + y * y) / vec3::dot(a.center(), a.center());
        assert!((cos - expected).abs() < 1e-5);
        let mut r = Rasterizer::new();
        let d = view_difference(&g, &a, &b, 3.46, &mut r);
        assert!(d.shared > 0.5 && d.colour < 0.01 && d.reprojection < 0.3 && d.kelvin < 1.0, "{d:?}");
        // Colours that depend on the view differ.
        let mut shiny = g.clone();
        shiny.sh_degree = 1;
        shiny.sh = g.sh.chunks_exact(3).flat_map(|c| [c, &[0.8; 9]].concat()).collect();
        assert!(view_difference(&shiny, &a, &b, 3.46, &mut r).colour > 3.0 * d.colour);
        let still = view_difference(&g, &a, &turned(&a, [0.0; 3], POP), 3.46, &mut r);
        assert!(still.colour < 0.1 * d.colour && still.reprojection < 0.01, "{still:?} {d:?}");
    }

    #[test]
    fn temperatures_of_a_field_are_rendered_to_a_kelvin() {
        // Of overlapping discs the nearest wins, and it lies about a standard deviation (blurred by half a pixel: 0.01) towards the
        // camera of the true place: half a kelvin here.
        let g = ball(80_000, |_| true);
        let camera = camera().resized(288, 288);
        let frame = Rasterizer::new().frame(&g, &camera, &Settings::default(), Channels::RgbaTemperature);
        let truth = |i: usize| {
            let (o, d) = camera.ray((i % 288) as f32 + 0.5, (i / 288) as f32 + 0.5);
            let b = vec3::dot(o, d);
            let disc = b * b - vec3::dot(o, o) + 1.0;
            (disc > 0.0).then(|| 350.0 + 50.0 * vec3::add_scaled(o, d, -b - disc.sqrt())[2])
        };
        let e = temperature_error(&frame, truth);
        assert!(e.pixels > 40_000 && e.mean < 0.6 && e.p95 < 1.5, "{e:?}");
        let off = temperature_error(&frame, |i| truth(i).map(|t| t + 7.0));
        assert!((off.mean - 7.0).abs() < 0.6, "{off:?}");
    }
}
