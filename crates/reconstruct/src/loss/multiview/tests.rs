use megas_math::rng::Rng;

use super::*;

const W: usize = 24;
const H: usize = 20;

/// Two views of the plane through the origin with normal `n()`, and its brightness as a function of the position.
fn cameras() -> [Camera; 2] {
    let mut a = Camera::look_at([0.4, -0.3, 3.0], [0.0; 3], [0.0, 1.0, 0.0], 0.5, W as u32, H as u32);
    let mut b = Camera::look_at([-0.6, 0.2, 2.7], [0.05, 0.0, 0.0], [0.1, 1.0, 0.0], 0.6, W as u32, H as u32);
    (a.cx, a.cy) = (11.3, 10.4);
    (b.cx, b.cy) = (12.5, 9.7);
    [a, b]
}

fn n() -> Vec3<f64> {
    vec3::normalize_or([0.2, -0.3, 1.0], [0.0, 0.0, 1.0])
}

fn brightness(x: Vec3<f64>) -> f64 {
    0.5 + 0.2 * (9.0 * x[0] + 2.0 * x[1]).sin() + 0.2 * (7.0 * x[1] - 3.0 * x[0]).cos()
}

#[derive(Clone)]
struct Scene {
    camera: Camera,
    normal: Vec<[f64; 3]>,
    plane: Vec<f64>,
    transmittance: Vec<f64>,
    grey: Vec<f64>,
}

impl Scene {
    fn new(camera: Camera, noise: f64, seed: u64) -> Self {
        let mut rng = Rng::new(seed);
        let pinhole = Pinhole::<f64>::new(&camera);
        let rays = Rays::<f64>::new(&camera);
        let mut s = Self { camera, normal: vec![], plane: vec![], transmittance: vec![], grey: vec![] };
        for i in 0..W * H {
            let a = rng.range(0.6, 1.0);
            let m = -vec3::dot(n(), pinhole.center);
            s.normal.push(n().map(|v| a * (v + noise * rng.normal())));
            s.plane.push(a * m * (1.0 + noise * rng.normal()));
            s.transmittance.push(1.0 - a);
            let along = rays.at(i % W, i / W).1;
            let x = vec3::add_scaled(pinhole.center, along, m / vec3::dot(n(), along));
            s.grey.push(brightness(x));
        }
        s
    }

    fn view(&self) -> MultiViewImage<'_, f64> {
        let planes = PlaneImages { normal: &self.normal, plane: &self.plane, transmittance: &self.transmittance };
        MultiViewImage { camera: &self.camera, planes, grey: &self.grey }
    }
}

struct Gradient {
    normal: Vec<[f64; 3]>,
    plane: Vec<f64>,
}

impl Gradient {
    fn new() -> Self {
        Self { normal: vec![[0.0; 3]; W * H], plane: vec![0.0; W * H] }
    }

    fn slices(&mut self) -> PlaneGradient<'_, f64> {
        PlaneGradient { normal: &mut self.normal, plane: &mut self.plane }
    }
}

fn run(scenes: &[Scene; 2], settings: &MultiViewSettings) -> (MultiViewLoss, MultiView<f64>, [Gradient; 2]) {
    let mut loss = MultiView::new();
    let mut g = [Gradient::new(), Gradient::new()];
    let [a, b] = &mut g;
    let value = loss.evaluate(scenes[0].view(), scenes[1].view(), settings, a.slices(), Some(b.slices()));
    (value, loss, g)
}

#[test]
fn the_same_plane_in_both_views_agrees() {
    let scenes = cameras().map(|c| Scene::new(c, 0.0, 1));
    let (loss, _, _) = run(&scenes, &MultiViewSettings::default());
    assert!(loss.pixels > W * H / 2 && loss.patches > 50, "{loss:?}");
    // Depth is not linear between pixels of a tilted plane, nor is brightness: small, but not nothing.
    assert!(loss.geo < 5e-3 && loss.ncc < 5e-3, "{loss:?}");
    // A homography with the wrong sign of the plane looks somewhere else.
    let mut wrong = scenes.clone();
    wrong[0].plane.iter_mut().for_each(|m| *m = -*m);
    let [r, n] = [0, 1].map(|k| Pinhole::<f64>::new(&scenes[k].camera));
    let warp = Warp::new([&r, &n], [&scenes[0].grey, &scenes[1].grey]);
    let patch = |scene: &Scene, i: usize| warp.compare([i % W, i / W], scene.normal[i], scene.plane[i]).map_or(1.0, |m| m.value);
    let centre = H / 2 * W + W / 2;
    assert!(
        patch(&scenes[0], centre) < 5e-3 && patch(&wrong[0], centre) > 0.05,
        "{} {}",
        patch(&scenes[0], centre),
        patch(&wrong[0], centre)
    );
    // A plane that is displaced by a twentieth of the distance is noticed by both terms.
    let mut off = scenes.clone();
    off[0].plane.iter_mut().for_each(|m| *m *= 1.02);
    let (worse, _, _) = run(&off, &MultiViewSettings::default());
    assert!(worse.geo > 10.0 * loss.geo && worse.ncc > 2.0 * loss.ncc, "{worse:?}");
}

/// Changes one raw value: the normal's components, then the plane.
fn entry(scene: &mut Scene, i: usize, k: usize, change: f64) {
    let slot = if k == 3 { &mut scene.plane[i] } else { &mut scene.normal[i][k] };
    *slot += change;
}

#[test]
fn gradients_are_the_derivatives_with_the_weights_held_fixed() {
    let [a, b] = cameras();
    let mut scenes = [Scene::new(a, 2e-3, 2), Scene::new(b, 2e-3, 3)];
    scenes[1].transmittance[8 * W + 11] = 0.8;
    for (geo, ncc) in [(0.7, 0.0), (0.0, 0.4), (0.7, 0.4)] {
        let settings = MultiViewSettings { lambda_geo: geo, lambda_ncc: ncc, ..MultiViewSettings::default() };
        let (value, base, g) = run(&scenes, &settings);
        assert!(value.pixels > 100 && value.geo > 1e-3);
        // What the gradient differentiates: the same pixels, the same weights.
        let objective = |scenes: &[Scene; 2]| {
            let (_, now, _) = run(scenes, &settings);
            let mut sum = 0.0;
            for (then, now) in base.trips.iter().zip(&now.trips) {
                if let Some(then) = then {
                    sum += f64::from(geo) * then.weight * now.as_ref().expect("still counts").error / value.pixels as f64;
                }
            }
            if ncc > 0.0 {
                for ((i, then), now) in base.chosen.iter().zip(&base.matches).zip(&now.matches) {
                    if then.is_some() {
                        let weight = base.trips[*i as usize].as_ref().unwrap().weight;
                        sum += f64::from(ncc) * weight * now.as_ref().expect("still counts").value / value.patches as f64;
                    }
                }
            }
            sum
        };
        let largest = g.iter().flat_map(|g| g.normal.iter().flatten().chain(&g.plane)).fold(0.0f64, |m, g| m.max(g.abs()));
        assert!(largest > 0.0);
        let mut nonzero = [0, 0];
        for view in 0..2 {
            for i in (0..W * H).step_by(7) {
                for k in 0..4 {
                    let analytic = if k == 3 { g[view].plane[i] } else { g[view].normal[i][k] };
                    let h = 1e-7;
                    entry(&mut scenes[view], i, k, h);
                    let above = objective(&scenes);
                    entry(&mut scenes[view], i, k, -2.0 * h);
                    let slope = (above - objective(&scenes)) / (2.0 * h);
                    entry(&mut scenes[view], i, k, h);
                    let bound = 1e-5 * (slope.abs() + analytic.abs() + 1e-3 * largest);
                    assert!((slope - analytic).abs() < bound, "view {view}, {i} {k}: {slope} {analytic}");
                    nonzero[view] += usize::from(analytic != 0.0);
                }
            }
        }
        assert!(nonzero[0] > 50 && (nonzero[1] > 50 || geo == 0.0), "{nonzero:?}");
    }
}

#[test]
fn patches_are_limited_spread_and_threads_change_nothing() {
    let scenes = [Scene::new(cameras()[0], 1e-3, 2), Scene::new(cameras()[1], 1e-3, 3)];
    let settings = MultiViewSettings { max_patches: 40, ..MultiViewSettings::default() };
    let (value, loss, _) = run(&scenes, &settings);
    assert!(loss.chosen.len() == 40 && value.patches <= 40 && value.pixels > 100);
    let counted: Vec<u32> = (0..W * H).filter(|&i| loss.trips[i].is_some()).map(|i| i as u32).collect();
    let rank = |i: u32| counted.iter().position(|&c| c == i).unwrap();
    let steps: Vec<usize> = loss.chosen.windows(2).map(|p| rank(p[1]) - rank(p[0])).collect();
    let (least, most) = (counted.len() / 40, counted.len().div_ceil(40));
    assert!(steps.iter().all(|s| (least..=most).contains(s)), "{steps:?}");
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let (value, _, [a, b]) = run(&scenes, &settings);
            (value, a.normal, a.plane, b.normal, b.plane)
        })
    };
    assert!(with(1) == with(4));
}

#[test]
fn views_that_see_nothing_in_common_cost_nothing() {
    let [a, mut b] = cameras();
    b = Camera::look_at([0.0, 0.0, 3.0], [0.0, 0.0, 9.0], [0.0, 1.0, 0.0], 0.5, b.width, b.height);
    let scenes = [Scene::new(a, 0.0, 1), Scene::new(b, 0.0, 1)];
    let (value, _, g) = run(&scenes, &MultiViewSettings::default());
    assert_eq!(value, MultiViewLoss::default());
    assert!(g.iter().all(|g| g.plane.iter().all(|v| *v == 0.0)));
    assert_eq!(grey(&[[1.0, 0.0, 0.0], [1.0, 1.0, 1.0]]), [0.299, 1.0]);
}

/// Run with `--ignored --nocapture` on an optimised build to see the cost of one iteration at 400².
#[test]
#[ignore = "a measurement"]
fn cost_at_400() {
    let views = cameras().map(|mut c| {
        c = c.resized(400, 400);
        let pinhole = Pinhole::<f64>::new(&c);
        let rays = Rays::<f64>::new(&c);
        let m = -vec3::dot(n(), pinhole.center);
        let along = (0..160_000).map(|i| rays.at(i % 400, i / 400).1);
        let place = along.map(|along| vec3::add_scaled(pinhole.center, along, m / vec3::dot(n(), along)));
        (c, vec![vec3::cast::<f64, f32>(n()); 160_000], vec![m as f32; 160_000], place.map(|x| brightness(x) as f32).collect::<Vec<f32>>())
    });
    let opaque = vec![0.0f32; 160_000];
    let [a, b] = &views;
    let [a, b] = [a, b].map(|(camera, normal, plane, grey)| MultiViewImage {
        camera,
        planes: PlaneImages { normal, plane, transmittance: &opaque },
        grey,
    });
    let mut loss = MultiView::<f32>::new();
    let (mut gn, mut gp) = ([vec![[0.0; 3]; 160_000], vec![[0.0; 3]; 160_000]], [vec![0.0; 160_000], vec![0.0; 160_000]]);
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    for lambda_ncc in [0.0, 0.15] {
        let settings = MultiViewSettings { lambda_ncc, ..MultiViewSettings::default() };
        let mut best = f64::MAX;
        let mut value = MultiViewLoss::default();
        for _ in 0..10 {
            let ([na, nb], [pa, pb]) = (&mut gn, &mut gp);
            let (first, second) = (PlaneGradient { normal: na, plane: pa }, PlaneGradient { normal: nb, plane: pb });
            let start = std::time::Instant::now();
            value = pool.install(|| loss.evaluate(a, b, &settings, first, Some(second)));
            best = best.min(start.elapsed().as_secs_f64());
        }
        println!("multi-view with λ_ncc = {lambda_ncc}: {:.2} ms, {value:?}", best * 1e3);
        assert!(value.pixels > 10_000 && best < 2.0);
    }
}
