//! The surface that a render sees in each pixel: a plane, blended from the planes of the Gaussians (splatting.md §3.3).

use megas_math::{Mat3, Real, Vec3, mat3, vec3};
use megas_model::{Camera, Projection};

/// The images of a render that describe its planes, one value per pixel.
#[derive(Clone, Copy, Debug)]
pub struct PlaneImages<'a, T = f32> {
    /// Raw blended normal `N = Σ w n`, world axes, every `n` turned to the camera.
    pub normal: &'a [[T; 3]],
    /// Raw blended plane `Σ w n·(μ − c)`, `c` the camera centre: minus the distance, hence negative on visible surfaces
    /// \[scene units\].
    pub plane: &'a [T],
    /// Transmittance `1 − A`.
    pub transmittance: &'a [T],
}

/// Derivatives by the two raw images of [`PlaneImages`]; alpha has none by definition of the losses.
#[derive(Debug)]
pub struct PlaneGradient<'a, T = f32> {
    /// By the raw normal.
    pub normal: &'a mut [[T; 3]],
    /// By the raw plane.
    pub plane: &'a mut [T],
}

impl<T> PlaneImages<'_, T> {
    /// Panics unless all images have `pixels` pixels.
    pub(super) fn check(&self, pixels: usize) {
        assert!(
            self.normal.len() == pixels && self.plane.len() == pixels && self.transmittance.len() == pixels,
            "images of different sizes"
        );
    }
}

/// The viewing rays of a camera: the point at depth `D` of a pixel is `start + D·along` from the camera centre, world axes.
#[derive(Clone, Copy, Debug)]
pub(super) struct Rays<T> {
    /// Rows are the camera's axes.
    pub axes: Mat3<T>,
    /// Reciprocals of the focal lengths, or scene units per pixel.
    inverse: [T; 2],
    center: [T; 2],
    parallel: bool,
}

impl<T: Real> Rays<T> {
    pub fn new(camera: &Camera) -> Self {
        let (focal, parallel) = match camera.projection {
            Projection::Pinhole { fx, fy } => ([fx, fy], false),
            Projection::Orthographic { scale } => ([scale; 2], true),
        };
        Self {
            axes: mat3::cast(camera.rotation),
            inverse: focal.map(|f| T::of(f64::from(f)).recip()),
            center: [T::of(f64::from(camera.cx)), T::of(f64::from(camera.cy))],
            parallel,
        }
    }

    /// `(start, along)` of the ray through the continuous pixel position `(u, v)`.
    #[inline(always)]
    pub fn through(&self, u: T, v: T) -> (Vec3<T>, Vec3<T>) {
        let (x, y) = ((u - self.center[0]) * self.inverse[0], (v - self.center[1]) * self.inverse[1]);
        let side = vec3::add_scaled(vec3::scale(self.axes[0], x), self.axes[1], y);
        if self.parallel { (side, self.axes[2]) } else { ([T::zero(); 3], vec3::add(side, self.axes[2])) }
    }

    /// The ray through the centre of a pixel.
    #[inline(always)]
    pub fn at(&self, x: usize, y: usize) -> (Vec3<T>, Vec3<T>) {
        let centre = |i: usize| T::of(i as f64 + 0.5);
        self.through(centre(x), centre(y))
    }
}

/// Where a viewing ray meets the blended plane of its pixel.
#[derive(Clone, Copy, Debug)]
pub(super) struct Hit<T> {
    /// Position relative to the camera centre, world axes.
    pub point: Vec3<T>,
    /// `1 / (N · along)`.
    pub inverse: T,
}

impl<T: Real> Hit<T> {
    /// `None` where the planar depth is not defined: `A < ½`, or the plane is seen edge-on or from behind.
    #[inline(always)]
    pub fn new(normal: Vec3<T>, plane: T, transmittance: T, (start, along): (Vec3<T>, Vec3<T>)) -> Option<Self> {
        let alpha = T::one() - transmittance;
        let slope = vec3::dot(normal, along);
        // Written so that what is not a number is not defined either.
        (alpha >= T::of(0.5) && slope <= T::of(-1e-3) * alpha).then(|| {
            let inverse = slope.recip();
            let depth = (plane - vec3::dot(normal, start)) * inverse;
            Self { point: vec3::add_scaled(start, along, depth), inverse }
        })
    }

    /// Derivatives by the raw plane and normal, from that by the depth: `∂D/∂plane = 1/(N·along)`,
    /// `∂D/∂N = −point/(N·along)`.
    #[inline(always)]
    pub fn back(&self, by_depth: T) -> (T, Vec3<T>) {
        let by_plane = by_depth * self.inverse;
        (by_plane, vec3::scale(self.point, -by_plane))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ray_meets_the_plane_it_was_made_for() {
        let pin = Camera::look_at([3.0, -2.0, 1.5], [0.1, 0.2, 0.3], [0.0, 0.0, 1.0], 0.8, 64, 48);
        let ortho = Camera::orthographic([0.1, 0.2, 0.3], [0.3, 0.5, -0.8], [0.0, 0.0, 1.0], 2.0, 5.0, 64, 48);
        for camera in [pin, ortho] {
            let rays = Rays::<f64>::new(&camera);
            let x: Vec3<f64> = [0.2, 0.1, -0.1];
            let c = vec3::cast::<f32, f64>(camera.center());
            let mut n = vec3::normalize_or([0.3, -0.2, 0.9], x);
            let pixel = camera.project(camera.to_camera(vec3::cast(x)));
            let ray = rays.through(f64::from(pixel[0]), f64::from(pixel[1]));
            if vec3::dot(n, ray.1) > 0.0 {
                n = n.map(|v| -v);
            }
            // Raw images: everything times alpha.
            let a = 0.7;
            let hit = Hit::new(vec3::scale(n, a), a * vec3::dot(n, vec3::sub(x, c)), 1.0 - a, ray).unwrap();
            assert!(vec3::norm(vec3::sub(hit.point, vec3::sub(x, c))) < 1e-5, "{hit:?}");
            assert!(Hit::new(vec3::scale(n, 0.49), -1.0, 0.51, ray).is_none(), "too transparent");
            assert!(Hit::new(n.map(|v| -v), -1.0, 0.0, ray).is_none(), "seen from behind");
        }
    }
}
