//! What every ground-truth body can answer.

use megas_math::{Vec3, vec3};
use rayon::prelude::*;

/// A body given by its signed distance and a colour for every point of space. Lengths are scene units, +z is up.
pub trait Solid: Sync {
    /// Signed distance to the surface, negative inside; close to exact near the surface, never much too large elsewhere.
    fn sdf(&self, x: Vec3<f32>) -> f32;

    /// A box `(min, max)` that contains the whole body.
    fn bounds(&self) -> (Vec3<f32>, Vec3<f32>);

    /// The unlit solid colour c(X), display-referred sRGB in [0, 1] (splatting.md §9.1).
    fn albedo(&self, x: Vec3<f32>) -> [f32; 3];

    /// Outward unit normal: the direction of steepest ascent of the distance, by differences over a tetrahedron.
    fn normal(&self, x: Vec3<f32>) -> Vec3<f32> {
        gradient(|p| self.sdf(p), x, 1e-3)
    }

    /// Mean colour, display-referred, of the points that the rays of one pixel meet; black without any.
    fn shade(&self, hits: &[Hit]) -> [f32; 3] {
        let sum = hits.iter().fold([0.0; 3], |sum, h| vec3::add(sum, self.albedo(h.position)));
        vec3::scale(sum, 1.0 / hits.len().max(1) as f32)
    }
}

/// Where a viewing ray meets a surface.
#[derive(Clone, Copy, Debug)]
pub struct Hit {
    /// The point.
    pub position: Vec3<f32>,
    /// Outward unit normal.
    pub normal: Vec3<f32>,
    /// Unit direction of the ray, from the camera.
    pub direction: Vec3<f32>,
}

/// Direction of the gradient of `f` at `x` from the corners of a tetrahedron of half-edge `h`; +z where the gradient vanishes.
pub(super) fn gradient(f: impl Fn(Vec3<f32>) -> f32, x: Vec3<f32>, h: f32) -> Vec3<f32> {
    const CORNERS: [Vec3<f32>; 4] = [[1.0, -1.0, -1.0], [-1.0, -1.0, 1.0], [-1.0, 1.0, -1.0], [1.0, 1.0, 1.0]];
    let g = CORNERS.iter().fold([0.0; 3], |g, &c| vec3::add_scaled(g, c, f(vec3::add_scaled(x, c, h))));
    vec3::normalize_or(g, [0.0, 0.0, 1.0])
}

/// Volume by counting on a grid of `n` cells along the longest side of the bounds; cells that the surface crosses count in
/// proportion to their distance, so the error falls like the square of the cell.
pub fn volume(solid: &impl Solid, n: usize) -> f64 {
    let (lo, hi) = solid.bounds();
    let size = vec3::sub(hi, lo);
    let h = size[0].max(size[1]).max(size[2]) / n as f32;
    let count = size.map(|s| (s / h).ceil() as usize);
    let slices: Vec<f64> = (0..count[2])
        .into_par_iter()
        .map(|k| {
            let mut sum = 0.0;
            for j in 0..count[1] {
                for i in 0..count[0] {
                    let x = [i, j, k].map(|c| c as f32 + 0.5);
                    let d = solid.sdf([lo[0] + x[0] * h, lo[1] + x[1] * h, lo[2] + x[2] * h]);
                    sum += f64::from((0.5 - d / h).clamp(0.0, 1.0));
                }
            }
            sum
        })
        .collect();
    slices.iter().sum::<f64>() * f64::from(h).powi(3)
}
