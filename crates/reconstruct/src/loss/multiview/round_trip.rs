//! From a pixel of the reference to the neighbour's surface and back.

use megas_math::{Real, mat3, vec3};

use super::{Hit, Pinhole, bilinear, bilinear_slope};

/// A pixel that returned close to where it started.
#[derive(Clone, Copy, Debug)]
pub(super) struct Trip<T> {
    /// Distance from the start \[px\].
    pub error: T,
    /// `exp(−error)`.
    pub weight: T,
    /// Derivative of `weight · error`, the weight held fixed, by the reference's depth.
    pub by_depth: T,
    /// The same by the depth sampled in the neighbour.
    pub by_neighbour: T,
    /// Where that was: the first of four pixels, and the fractions between them.
    pub cell: u32,
    pub fraction: [T; 2],
}

impl<T: Real> Trip<T> {
    /// The trip of pixel `[x, y]`, whose surface is `hit`. `None` where it leaves the neighbour's image, meets no surface
    /// there, comes nearer than `min_depth` to the neighbour or returns more than `max_error` pixels away.
    pub fn new(
        r: &Pinhole<T>,
        n: &Pinhole<T>,
        [x, y]: [usize; 2],
        hit: &Hit<T>,
        neighbour: &[Option<Hit<T>>],
        [min_depth, max_error]: [T; 2],
    ) -> Option<Self> {
        let shift = vec3::sub(r.center, n.center);
        // There: the point in the neighbour's axes.
        let there = mat3::mul_vec(n.axes, vec3::add(hit.point, shift));
        if there[2] <= min_depth {
            return None;
        }
        let (cell, fraction) = n.cell(n.project(there))?;
        let mut depths = [T::zero(); 4];
        for (depth, offset) in depths.iter_mut().zip([0, 1, n.width, n.width + 1]) {
            // Third axis of the neighbour: depth along z.
            *depth = vec3::dot(n.axes[2], neighbour[cell + offset]?.point);
        }
        let weights = bilinear(fraction);
        let depth = depths.iter().zip(weights).fold(T::zero(), |sum, (d, w)| sum + *d * w);
        let (a, b) = (there[0] / there[2], there[1] / there[2]);
        let surface = vec3::scale([a, b, T::one()], depth);
        // Back again.
        let back = mat3::mul_vec(r.axes, vec3::sub(mat3::tmul_vec(n.axes, surface), shift));
        if back[2] <= T::zero() {
            return None;
        }
        let end = r.project(back);
        let start = [x, y].map(|i| T::of(i as f64 + 0.5));
        let off = [end[0] - start[0], end[1] - start[1]];
        let error = off[0].hypot(off[1]);
        // Written so that what is not a number does not count.
        (error < max_error).then(|| {
            let weight = (-error).exp();
            let scale = if error > T::zero() { weight / error } else { T::zero() };
            let g = r.project_back(back, [off[0] * scale, off[1] * scale]);
            let g = mat3::mul_vec(n.axes, mat3::tmul_vec(r.axes, g));
            let by_neighbour = a * g[0] + b * g[1] + g[2];
            // The direction matters twice: for the point, and for where the depth was sampled.
            let slope = bilinear_slope(fraction, depths);
            let by_a = depth * g[0] + by_neighbour * slope[0] * n.focal[0];
            let by_b = depth * g[1] + by_neighbour * slope[1] * n.focal[1];
            let g = [by_a / there[2], by_b / there[2], -(by_a * a + by_b * b) / there[2]];
            // The point moves along the viewing ray, whose depth component is one.
            let along = vec3::scale(hit.point, vec3::dot(r.axes[2], hit.point).recip());
            let by_depth = vec3::dot(mat3::tmul_vec(n.axes, g), along);
            Self { error, weight, by_depth, by_neighbour, cell: cell as u32, fraction }
        })
    }
}
