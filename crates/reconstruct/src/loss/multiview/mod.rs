//! Agreement of two views of the same surface (splatting.md §5.2): the planes that a reference view renders must lie where
//! a neighbour renders them, and must look in the neighbour's photograph as in its own.
//!
//! *Geometry*: every pixel of the reference is lifted by its planar depth, projected into the neighbour, lifted again by
//! the depth found there, and projected back; it should return to where it started. The error `e` in pixels is weighted by
//! `exp(−e)`, held fixed, so that occluded pixels do not pull. *Appearance*: a patch around the pixel, carried over by the
//! homography of its plane, should correlate with the neighbour's photograph.
//!
//! The geometry term differentiates through both depth images and the place where the neighbour's is sampled, like PGSR;
//! whoever does not render the neighbour differentiably leaves its gradient out. The appearance term depends on the
//! reference's planes only.

mod neighbours;
mod patch;
mod round_trip;

pub use neighbours::neighbours;

use megas_math::{Mat3, Real, Vec3, mat3, vec3};
use megas_model::{Camera, Projection};
use rayon::prelude::*;

use super::plane::{Hit, PlaneGradient, PlaneImages, Rays};
use patch::{Match, Warp};
use round_trip::Trip;

/// Rows per unit of parallel work.
const BAND: usize = 8;

/// Weights and limits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MultiViewSettings {
    /// Weight of the geometry term.
    pub lambda_geo: f32,
    /// Weight of the appearance term; 0 leaves it out.
    pub lambda_ncc: f32,
    /// Pixels nearer to the neighbour than this do not count \[scene units\]; the design has 0.1 E.
    pub min_depth: f32,
    /// Pixels that return farther than this from where they started do not count \[px\].
    pub max_error: f32,
    /// Patches compared at most, spread evenly over the pixels that count.
    pub max_patches: usize,
    /// In [0, 1): where in its share of the pixels each patch lies. Draw a new one for every iteration.
    pub phase: f32,
}

impl Default for MultiViewSettings {
    fn default() -> Self {
        Self { lambda_geo: 0.03, lambda_ncc: 0.15, min_depth: 0.1, max_error: 1.0, max_patches: 102_400, phase: 0.5 }
    }
}

/// Values without their weights.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct MultiViewLoss {
    /// Mean of `exp(−e) e` over the pixels that count \[px\].
    pub geo: f64,
    /// Mean of `exp(−e) (1 − NCC²)` over the patches that count.
    pub ncc: f64,
    /// Pixels that counted.
    pub pixels: usize,
    /// Patches that counted.
    pub patches: usize,
}

/// One of the two views. Its images have the size of its camera, which must be a pinhole.
#[derive(Clone, Copy, Debug)]
pub struct MultiViewImage<'a, T = f32> {
    /// Pose and intrinsics.
    pub camera: &'a Camera,
    /// Rendered planes.
    pub planes: PlaneImages<'a, T>,
    /// Brightness of the photograph, see [`grey`]; may be empty where appearance is left out.
    pub grey: &'a [T],
}

/// Brightness of a photograph (the weights of ITU-R BT.601), one value per pixel.
pub fn grey(rgb: &[[f32; 3]]) -> Vec<f32> {
    rgb.iter().map(|c| 0.299 * c[0] + 0.587 * c[1] + 0.114 * c[2]).collect()
}

/// A pinhole camera in the scalar type of the computation.
#[derive(Clone, Copy, Debug)]
struct Pinhole<T> {
    axes: Mat3<T>,
    center: Vec3<T>,
    focal: [T; 2],
    principal: [T; 2],
    width: usize,
    height: usize,
}

impl<T: Real> Pinhole<T> {
    fn new(camera: &Camera) -> Self {
        let Projection::Pinhole { fx, fy } = camera.projection else { panic!("photographs are taken with pinhole cameras") };
        let of = |v: f32| T::of(f64::from(v));
        let axes: Mat3<T> = mat3::cast(camera.rotation);
        Self {
            axes,
            center: mat3::tmul_vec(axes, vec3::cast(camera.translation)).map(|v| -v),
            focal: [of(fx), of(fy)],
            principal: [of(camera.cx), of(camera.cy)],
            width: camera.width as usize,
            height: camera.height as usize,
        }
    }

    /// Continuous pixel position of a point in camera axes.
    #[inline(always)]
    fn project(&self, y: Vec3<T>) -> [T; 2] {
        [self.focal[0] * y[0] / y[2] + self.principal[0], self.focal[1] * y[1] / y[2] + self.principal[1]]
    }

    /// Derivative by the point from that by its projection.
    #[inline(always)]
    fn project_back(&self, y: Vec3<T>, g: [T; 2]) -> Vec3<T> {
        let (a, b) = (g[0] * self.focal[0] / y[2], g[1] * self.focal[1] / y[2]);
        [a, b, -(a * y[0] + b * y[1]) / y[2]]
    }

    /// First of the four pixels between whose centres `v` lies, and the fractions; `None` outside the image.
    #[inline(always)]
    fn cell(&self, v: [T; 2]) -> Option<(usize, [T; 2])> {
        let half = T::of(0.5);
        let (x, y) = (v[0] - half, v[1] - half);
        let last = |n: usize| T::of(n as f64 - 1.0);
        // Written so that what is not a number is outside.
        (x >= T::zero() && y >= T::zero() && x < last(self.width) && y < last(self.height)).then(|| {
            let (i, j) = (x.f64() as u32, y.f64() as u32);
            (j as usize * self.width + i as usize, [x - T::of(f64::from(i)), y - T::of(f64::from(j))])
        })
    }
}

/// Weights of the four pixels of a cell: itself, right, below, both.
#[inline(always)]
fn bilinear<T: Real>([fx, fy]: [T; 2]) -> [T; 4] {
    let (gx, gy) = (T::one() - fx, T::one() - fy);
    [gx * gy, fx * gy, gx * fy, fx * fy]
}

/// Slope along x and y of the interpolation between the four values of a cell.
#[inline(always)]
fn bilinear_slope<T: Real>([fx, fy]: [T; 2], v: [T; 4]) -> [T; 2] {
    let (gx, gy) = (T::one() - fx, T::one() - fy);
    [gy * (v[1] - v[0]) + fy * (v[3] - v[2]), gx * (v[2] - v[0]) + fx * (v[3] - v[1])]
}

/// The loss with its working memory.
#[derive(Clone, Debug, Default)]
pub struct MultiView<T = f32> {
    hits: Vec<Option<Hit<T>>>,
    neighbour_hits: Vec<Option<Hit<T>>>,
    trips: Vec<Option<Trip<T>>>,
    /// Pixels whose patches are compared, ascending, and what came out.
    chosen: Vec<u32>,
    matches: Vec<Option<Match<T>>>,
    /// Derivative by the neighbour's depth.
    by_depth: Vec<T>,
}

impl<T: Real> MultiView<T> {
    /// Without any memory yet.
    pub fn new() -> Self {
        Self {
            hits: Vec::new(),
            neighbour_hits: Vec::new(),
            trips: Vec::new(),
            chosen: Vec::new(),
            matches: Vec::new(),
            by_depth: Vec::new(),
        }
    }

    /// Compares two views. Adds the weighted derivatives by the raw planes of the reference to `gradient` and, if wanted,
    /// those by the neighbour's to `neighbour_gradient`.
    pub fn evaluate(
        &mut self,
        reference: MultiViewImage<T>,
        neighbour: MultiViewImage<T>,
        settings: &MultiViewSettings,
        gradient: PlaneGradient<T>,
        neighbour_gradient: Option<PlaneGradient<T>>,
    ) -> MultiViewLoss {
        let (r, n) = (Pinhole::new(reference.camera), Pinhole::new(neighbour.camera));
        reference.planes.check(r.width * r.height);
        neighbour.planes.check(n.width * n.height);
        assert!(gradient.normal.len() == r.width * r.height && gradient.plane.len() == r.width * r.height, "images of different sizes");
        let rays = Rays::new(reference.camera);
        lift(&mut self.hits, &reference.planes, &rays, r.width);
        lift(&mut self.neighbour_hits, &neighbour.planes, &Rays::new(neighbour.camera), n.width);

        let depths = &self.neighbour_hits;
        let limits = [settings.min_depth, settings.max_error].map(|v| T::of(f64::from(v)));
        let trip = |i: usize, hit: &Option<Hit<T>>| Trip::new(&r, &n, [i % r.width, i / r.width], hit.as_ref()?, depths, limits);
        self.hits.par_iter().enumerate().with_min_len(BAND * r.width.max(1)).map(|(i, hit)| trip(i, hit)).collect_into_vec(&mut self.trips);

        let mut loss = MultiViewLoss::default();
        for trip in self.trips.iter().flatten() {
            loss.pixels += 1;
            loss.geo += (trip.weight * trip.error).f64();
        }
        if loss.pixels == 0 {
            return loss;
        }
        loss.geo /= loss.pixels as f64;
        let step = T::of(f64::from(settings.lambda_geo) / loss.pixels as f64);
        if let Some(gradient) = neighbour_gradient {
            self.spread(n.width, step, gradient);
        }
        let PlaneGradient { normal, plane } = gradient;
        let rows = normal.par_iter_mut().zip(plane.par_iter_mut()).zip(&self.trips).zip(&self.hits);
        rows.with_min_len(BAND * r.width).for_each(|(((normal, plane), trip), hit)| {
            if let (Some(trip), Some(hit)) = (trip, hit) {
                let (by_plane, by_normal) = hit.back(step * trip.by_depth);
                *plane += by_plane;
                *normal = vec3::add(*normal, by_normal);
            }
        });
        if settings.lambda_ncc > 0.0 {
            self.choose(settings, loss.pixels);
            let warp = Warp::new([&r, &n], [reference.grey, neighbour.grey]);
            let gradient = PlaneGradient { normal, plane };
            (loss.ncc, loss.patches) = self.correlate(&warp, &reference.planes, r.width, settings.lambda_ncc, gradient);
        }
        loss
    }

    /// Adds the derivatives by the neighbour's planes. Several pixels share a depth, so the sums are formed by one thread.
    fn spread(&mut self, width: usize, step: T, gradient: PlaneGradient<T>) {
        let pixels = self.neighbour_hits.len();
        assert!(gradient.normal.len() == pixels && gradient.plane.len() == pixels, "images of different sizes");
        self.by_depth.clear();
        self.by_depth.resize(pixels, T::zero());
        for trip in self.trips.iter().flatten() {
            for (i, w) in [0, 1, width, width + 1].into_iter().zip(bilinear(trip.fraction)) {
                self.by_depth[trip.cell as usize + i] += step * w * trip.by_neighbour;
            }
        }
        let rows = gradient.normal.par_iter_mut().zip(gradient.plane).zip(&self.by_depth).zip(&self.neighbour_hits);
        rows.with_min_len(BAND * width).for_each(|(((normal, plane), &by_depth), hit)| {
            if let Some(hit) = hit.filter(|_| by_depth != T::zero()) {
                let (by_plane, by_normal) = hit.back(by_depth);
                *plane += by_plane;
                *normal = vec3::add(*normal, by_normal);
            }
        });
    }

    /// Every pixel that counts, or as many of them as permitted, one in each equal share.
    fn choose(&mut self, settings: &MultiViewSettings, pixels: usize) {
        let counted = (0..self.trips.len()).filter(|&i| self.trips[i].is_some()).map(|i| i as u32);
        self.chosen.clear();
        if pixels <= settings.max_patches {
            self.chosen.extend(counted);
            return;
        }
        let share = |k: usize| (k as f64 + f64::from(settings.phase)) * settings.max_patches as f64 / pixels as f64;
        self.chosen.extend(counted.enumerate().filter(|(k, _)| share(*k).floor() != share(k + 1).floor()).map(|(_, i)| i));
    }

    /// Mean and number of the patches that count; adds their derivatives.
    fn correlate(
        &mut self,
        warp: &Warp<T>,
        planes: &PlaneImages<T>,
        width: usize,
        lambda: f32,
        gradient: PlaneGradient<T>,
    ) -> (f64, usize) {
        let one = |&i: &u32| {
            let i = i as usize;
            warp.compare([i % width, i / width], planes.normal[i], planes.plane[i])
        };
        self.chosen.par_iter().with_min_len(256).map(one).collect_into_vec(&mut self.matches);
        let weight = |i: u32| self.trips[i as usize].as_ref().map_or(T::zero(), |t| t.weight);
        let count = self.matches.iter().flatten().count();
        let step = T::of(f64::from(lambda) / count.max(1) as f64);
        let mut sum = 0.0;
        for (&i, found) in self.chosen.iter().zip(&self.matches) {
            let Some(found) = found else { continue };
            let w = weight(i);
            sum += (w * found.value).f64();
            let i = i as usize;
            gradient.normal[i] = vec3::add_scaled(gradient.normal[i], found.by_normal, step * w);
            gradient.plane[i] += step * w * found.by_plane;
        }
        (sum / count.max(1) as f64, count)
    }
}

/// The surface in every pixel.
fn lift<T: Real>(hits: &mut Vec<Option<Hit<T>>>, planes: &PlaneImages<T>, rays: &Rays<T>, width: usize) {
    let hit = |i: usize| Hit::new(planes.normal[i], planes.plane[i], planes.transmittance[i], rays.at(i % width, i / width));
    (0..planes.plane.len()).into_par_iter().with_min_len(BAND * width.max(1)).map(hit).collect_into_vec(hits);
}

#[cfg(test)]
mod tests;
