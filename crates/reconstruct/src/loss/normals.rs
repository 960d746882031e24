//! Agreement of the blended normal with the normal of the planar depth around it (splatting.md §4.6, §5.2).
//!
//! `L_n = mean ω ‖A N_d − N‖₁`, where `N_d` is the direction of the cross product of the central differences of the
//! back-projected planar depth, facing the camera. A pixel takes part where its own planar depth and those of its four
//! neighbours are defined. Alpha is held fixed.

use megas_math::{Real, Vec3, vec3};
use megas_model::Camera;
use rayon::prelude::*;

use super::plane::{Hit, PlaneGradient, PlaneImages, Rays};

/// Rows per unit of parallel work.
const BAND: usize = 8;

/// The loss with its working memory; nothing is allocated after the first evaluation at a size.
#[derive(Clone, Debug, Default)]
pub struct NormalConsistency<T = f32> {
    hits: Vec<Option<Hit<T>>>,
    /// Derivatives by the two differences `U` (right − left) and `V` (below − above).
    differences: Vec<[Vec3<T>; 2]>,
    sums: Vec<f64>,
}

impl<T: Real> NormalConsistency<T> {
    /// Without any memory yet.
    pub fn new() -> Self {
        Self { hits: Vec::new(), differences: Vec::new(), sums: Vec::new() }
    }

    /// Value of the loss for a view through `camera` (which has the images' size) with the weights `omega` of
    /// [`super::edge_weights`]. Adds `weight` times the derivatives by the raw normal and plane to `gradient`.
    pub fn evaluate(&mut self, camera: &Camera, images: PlaneImages<T>, omega: &[T], weight: f32, gradient: PlaneGradient<T>) -> f64 {
        let (width, height) = (camera.width as usize, camera.height as usize);
        let pixels = width * height;
        images.check(pixels);
        assert!(omega.len() == pixels && gradient.normal.len() == pixels && gradient.plane.len() == pixels, "images of different sizes");
        if pixels == 0 {
            return 0.0;
        }
        self.hits.resize(pixels, None);
        self.differences.resize(pixels, [[T::zero(); 3]; 2]);
        self.sums.resize(height, 0.0);
        let rays = Rays::new(camera);
        let rows = self.hits.par_chunks_mut(width).enumerate().with_min_len(BAND);
        rows.for_each(|(y, row)| {
            for (x, hit) in row.iter_mut().enumerate() {
                let i = y * width + x;
                *hit = Hit::new(images.normal[i], images.plane[i], images.transmittance[i], rays.at(x, y));
            }
        });

        let field = Field { width, height, images, omega, hits: &self.hits };
        let step = T::of(f64::from(weight) / pixels as f64);
        let rows = self.differences.par_chunks_mut(width).zip(gradient.normal.par_chunks_mut(width)).zip(&mut self.sums);
        rows.enumerate().with_min_len(BAND).for_each(|(y, ((differences, normal), sum))| {
            *sum = field.compare(y, step, differences, normal);
        });

        let differences = &self.differences;
        let rows = gradient.normal.par_chunks_mut(width).zip(gradient.plane.par_chunks_mut(width));
        rows.enumerate().with_min_len(BAND).for_each(|(y, (normal, plane))| {
            for x in 0..width {
                let Some(hit) = self.hits[y * width + x] else { continue };
                let by_point = gather(differences, x, y, width, height);
                let (by_plane, by_normal) = hit.back(vec3::dot(by_point, rays.at(x, y).1));
                plane[x] += by_plane;
                normal[x] = vec3::add(normal[x], by_normal);
            }
        });
        self.sums.iter().sum::<f64>() / pixels as f64
    }
}

/// What every row reads.
struct Field<'a, T> {
    width: usize,
    height: usize,
    images: PlaneImages<'a, T>,
    omega: &'a [T],
    hits: &'a [Option<Hit<T>>],
}

impl<T: Real> Field<'_, T> {
    /// Sum of the loss over row `y`. Writes its derivatives by the differences and adds those by the blended normal.
    fn compare(&self, y: usize, step: T, differences: &mut [[Vec3<T>; 2]], normal: &mut [Vec3<T>]) -> f64 {
        differences.fill([[T::zero(); 3]; 2]);
        if y == 0 || y + 1 >= self.height {
            return 0.0;
        }
        let mut sum = T::zero();
        for x in 1..self.width.max(1) - 1 {
            let i = y * self.width + x;
            let omega = self.omega[i];
            let Some([u, v]) = self.spans(i).filter(|_| omega > T::zero()) else { continue };
            let cross = vec3::cross(v, u);
            let size = vec3::norm(cross);
            if size <= T::zero() {
                continue;
            }
            let facing = vec3::scale(cross, size.recip());
            let alpha = T::one() - self.images.transmittance[i];
            let off = vec3::sub(vec3::scale(facing, alpha), self.images.normal[i]);
            sum += omega * (off[0].abs() + off[1].abs() + off[2].abs());
            let sign = off.map(|d| sign(d) * step * omega);
            normal[x] = vec3::sub(normal[x], sign);
            let g = vec3::scale(sign, alpha);
            let g = vec3::scale(vec3::add_scaled(g, facing, -vec3::dot(facing, g)), size.recip());
            differences[x] = [vec3::cross(g, v), vec3::cross(u, g)];
        }
        sum.f64()
    }

    /// The differences `U`, `V` at pixel `i`, if all five depths are defined.
    #[inline(always)]
    fn spans(&self, i: usize) -> Option<[Vec3<T>; 2]> {
        self.hits[i]?;
        let [left, right] = [self.hits[i - 1]?.point, self.hits[i + 1]?.point];
        let [above, below] = [self.hits[i - self.width]?.point, self.hits[i + self.width]?.point];
        Some([vec3::sub(right, left), vec3::sub(below, above)])
    }
}

/// −1, 0 or 1, without a branch that noise would send either way.
#[inline(always)]
fn sign<T: Real>(v: T) -> T {
    let one_if = |condition: bool| if condition { T::one() } else { T::zero() };
    one_if(v > T::zero()) - one_if(v < T::zero())
}

/// Derivative by the point of pixel `(x, y)`, which is a neighbour in four differences.
#[inline(always)]
fn gather<T: Real>(differences: &[[Vec3<T>; 2]], x: usize, y: usize, width: usize, height: usize) -> Vec3<T> {
    let i = y * width + x;
    let mut g = [T::zero(); 3];
    if x > 0 {
        g = vec3::add(g, differences[i - 1][0]);
    }
    if x + 1 < width {
        g = vec3::sub(g, differences[i + 1][0]);
    }
    if y > 0 {
        g = vec3::add(g, differences[i - width][1]);
    }
    if y + 1 < height {
        g = vec3::sub(g, differences[i + width][1]);
    }
    g
}

#[cfg(test)]
mod tests {
    use megas_math::rng::Rng;

    use super::*;

    const W: usize = 11;
    const H: usize = 9;

    fn cameras() -> [Camera; 2] {
        let mut pin = Camera::look_at([2.0, -3.0, 1.5], [0.1, 0.2, 0.3], [0.0, 0.0, 1.0], 0.8, W as u32, H as u32);
        (pin.cx, pin.cy) = (4.7, 5.1);
        [pin, Camera::orthographic([0.1, 0.2, 0.3], [0.3, 0.5, -0.8], [0.0, 0.0, 1.0], 0.8, 5.0, W as u32, H as u32)]
    }

    struct Scene {
        normal: Vec<[f64; 3]>,
        plane: Vec<f64>,
        transmittance: Vec<f64>,
    }

    impl Scene {
        /// The plane through the origin with normal `n`, seen with an alpha that varies, `noise` on everything.
        fn plane(camera: &Camera, n: Vec3<f64>, noise: f64) -> Self {
            let mut rng = Rng::new(7);
            let c = vec3::cast::<f32, f64>(camera.center());
            let mut scene = Self { normal: vec![], plane: vec![], transmittance: vec![] };
            for _ in 0..W * H {
                let a = rng.range(0.6, 0.95);
                scene.normal.push(n.map(|v| a * (v + noise * rng.normal())));
                scene.plane.push(-a * vec3::dot(n, c) * (1.0 + 0.1 * noise * rng.normal()));
                scene.transmittance.push(1.0 - a);
            }
            scene
        }

        fn images(&self) -> PlaneImages<'_, f64> {
            PlaneImages { normal: &self.normal, plane: &self.plane, transmittance: &self.transmittance }
        }

        fn value(&self, camera: &Camera, omega: &[f64]) -> f64 {
            self.evaluate(camera, omega, 1.0).0
        }

        fn evaluate(&self, camera: &Camera, omega: &[f64], weight: f32) -> (f64, Vec<[f64; 3]>, Vec<f64>) {
            let (mut normal, mut plane) = (vec![[0.0; 3]; W * H], vec![0.0; W * H]);
            let gradient = PlaneGradient { normal: &mut normal, plane: &mut plane };
            let value = NormalConsistency::new().evaluate(camera, self.images(), omega, weight, gradient);
            (value, normal, plane)
        }
    }

    fn facing(camera: &Camera) -> Vec3<f64> {
        let f = vec3::cast::<f32, f64>(camera.rotation[2]);
        vec3::normalize_or(vec3::sub([0.2, 0.15, -0.1], f), f)
    }

    #[test]
    fn a_plane_agrees_with_its_own_normal_and_with_no_other() {
        for camera in cameras() {
            let n = facing(&camera);
            let omega = vec![1.0; W * H];
            let scene = Scene::plane(&camera, n, 0.0);
            let (value, normal, plane) = scene.evaluate(&camera, &omega, 1.0);
            assert!(value < 1e-6, "{value}");
            // The subgradient of the exact minimum is of rounding noise only in value, not in size; it is bounded.
            assert!(normal.iter().flatten().chain(&plane).all(|g| g.is_finite()));
            // Blended normals that lie by 0.1 in x: 0.1 A per inner pixel.
            let mut tilted = Scene::plane(&camera, n, 0.0);
            let c = vec3::cast::<f32, f64>(camera.center());
            let rays = Rays::new(&camera);
            let mut expected = 0.0;
            for y in 0..H {
                for x in 0..W {
                    let i = y * W + x;
                    let a = 1.0 - tilted.transmittance[i];
                    let hit = Hit::new(tilted.normal[i], tilted.plane[i], 1.0 - a, rays.at(x, y)).unwrap();
                    assert!(vec3::dot(n, vec3::add(hit.point, c)).abs() < 1e-6);
                    tilted.normal[i][0] += 0.1 * a;
                    // The plane through the same point of the surface, so that the depth stays.
                    tilted.plane[i] = vec3::dot(tilted.normal[i], hit.point);
                    if x > 0 && y > 0 && x + 1 < W && y + 1 < H {
                        expected += 0.1 * a / (W * H) as f64;
                    }
                }
            }
            let value = tilted.value(&camera, &omega);
            assert!((value - expected).abs() < 1e-6, "{value} {expected}");
        }
    }

    #[test]
    fn gradients_are_the_derivatives() {
        for camera in cameras() {
            let mut scene = Scene::plane(&camera, facing(&camera), 0.05);
            let mut rng = Rng::new(3);
            let omega: Vec<f64> = (0..W * H).map(|_| rng.unit()).collect();
            // A hole and its surroundings.
            scene.transmittance[3 * W + 6] = 0.7;
            scene.normal[6 * W + 3] = scene.normal[6 * W + 3].map(|v| -v);
            let (value, normal, plane) = scene.evaluate(&camera, &omega, 2.0);
            assert!(value > 1e-3);
            let largest = normal.iter().flatten().chain(&plane).fold(0.0f64, |m, g| m.max(g.abs()));
            let mut check = |i: usize, k: usize, analytic: f64| {
                let entry = |scene: &mut Scene, change: f64| {
                    let slot = if k == 3 { &mut scene.plane[i] } else { &mut scene.normal[i][k] };
                    *slot += change;
                };
                let h = 1e-6;
                entry(&mut scene, h);
                let above = scene.value(&camera, &omega);
                entry(&mut scene, -2.0 * h);
                let slope = 2.0 * (above - scene.value(&camera, &omega)) / (2.0 * h);
                entry(&mut scene, h);
                assert!((slope - analytic).abs() < 1e-5 * (slope.abs() + analytic.abs() + 1e-3 * largest), "{i} {k}: {slope} {analytic}");
            };
            for i in 0..W * H {
                for k in 0..3 {
                    check(i, k, normal[i][k]);
                }
                check(i, 3, plane[i]);
            }
            assert_eq!(plane[3 * W + 6], 0.0);
        }
    }

    /// A noisy plane at 400² in single precision.
    fn large() -> (Camera, Vec<[f32; 3]>, Vec<f32>, Vec<f32>, Vec<f32>) {
        let camera = Camera::look_at([2.0, -3.0, 1.5], [0.1, 0.2, 0.3], [0.0, 0.0, 1.0], 0.8, 400, 400);
        let n = vec3::cast::<f64, f32>(facing(&camera));
        let mut rng = Rng::new(1);
        let c = camera.center();
        let normal = (0..160_000).map(|_| n.map(|v| v + 0.05 * rng.normal() as f32)).collect();
        let plane = (0..160_000).map(|_| -vec3::dot(n, c) * (1.0 + 1e-3 * rng.normal() as f32)).collect();
        (camera, normal, plane, vec![0.0; 160_000], vec![1.0; 160_000])
    }

    #[test]
    fn single_precision_follows_double_and_threads_change_nothing() {
        let (camera, normal, plane, transmittance, omega) = large();
        let images = PlaneImages { normal: &normal, plane: &plane, transmittance: &transmittance };
        let run = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| {
                let (mut gn, mut gp) = (vec![[0.0; 3]; 160_000], vec![0.0; 160_000]);
                let gradient = PlaneGradient { normal: &mut gn, plane: &mut gp };
                let value = NormalConsistency::<f32>::new().evaluate(&camera, images, &omega, 1.0, gradient);
                (value, gn, gp)
            })
        };
        let one = run(1);
        assert!(one == run(3));
        let wide = |v: &[f32]| v.iter().map(|&v| f64::from(v)).collect::<Vec<f64>>();
        let (normal, plane) = (normal.iter().map(|&n| vec3::cast(n)).collect::<Vec<_>>(), wide(&plane));
        let images = PlaneImages { normal: &normal, plane: &plane, transmittance: &wide(&transmittance) };
        let (mut gn, mut gp) = (vec![[0.0; 3]; 160_000], vec![0.0; 160_000]);
        let gradient = PlaneGradient { normal: &mut gn, plane: &mut gp };
        let exact = NormalConsistency::new().evaluate(&camera, images, &wide(&omega), 1.0, gradient);
        assert!(exact > 0.01 && (exact - one.0).abs() < 1e-4 * exact);
        let difference: f64 = gp.iter().zip(&one.2).map(|(a, &b)| (a - f64::from(b)).powi(2)).sum();
        let size: f64 = gp.iter().map(|a| a * a).sum();
        // A component near the kink may take the other sign in single precision.
        assert!((difference / size).sqrt() < 1e-2, "{}", (difference / size).sqrt());
    }

    /// Run with `--ignored --nocapture` on an optimised build to see the cost of one iteration at 400².
    #[test]
    #[ignore = "a measurement"]
    fn cost_at_400() {
        let (camera, normal, plane, transmittance, omega) = large();
        let images = PlaneImages { normal: &normal, plane: &plane, transmittance: &transmittance };
        let (mut gn, mut gp) = (vec![[0.0; 3]; 160_000], vec![0.0; 160_000]);
        let mut loss = NormalConsistency::<f32>::new();
        let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
        let best = (0..40).map(|_| {
            let start = std::time::Instant::now();
            pool.install(|| loss.evaluate(&camera, images, &omega, 1.0, PlaneGradient { normal: &mut gn, plane: &mut gp }));
            start.elapsed().as_secs_f64()
        });
        let best = best.fold(f64::MAX, f64::min);
        println!("normal consistency {:.2} ms", best * 1e3);
        assert!(best < 0.1);
    }
}
