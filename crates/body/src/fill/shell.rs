//! The object's Gaussians as rays meet them, in the filling frame (splatting.md §6.3).

use megas_math::{Mat3, Real, Vec3, mat3, vec3};
use megas_model::Splats;

/// Contributions below this opacity do not count.
pub const ALPHA_MIN: f64 = 1.0 / 255.0;
/// Opacity of a single contribution is limited to this.
pub const ALPHA_MAX: f64 = 0.99;

/// Oriented Gaussians, ready for rays. Generic so that the tests run in double precision.
#[derive(Clone, Debug, Default)]
pub struct Shell<T> {
    /// Centres.
    pub mean: Vec<Vec3<T>>,
    /// Covariances, symmetric.
    pub covariance: Vec<Mat3<T>>,
    /// Outward normals. Shorter ones than unit have less to say: zero for Gaussians that absorb rays but know no outside.
    pub normal: Vec<Vec3<T>>,
    /// Opacities in (1/255, 1].
    pub opacity: Vec<T>,
}

impl<T: Real> Shell<T> {
    /// The Gaussians of `splats` in the frame `y = rotation · (X − origin)`, with outward `normals` in scene axes (as long
    /// as the splats). Those that no ray can count (opacity below 1/255, not finite) are left out; the smallest scale is
    /// floored at 1e-3 of the largest.
    pub fn new(splats: &Splats, normals: &[Vec3<f32>], rotation: Mat3<f64>, origin: Vec3<f64>) -> Self {
        let mut shell = Self { mean: Vec::new(), covariance: Vec::new(), normal: Vec::new(), opacity: Vec::new() };
        for i in 0..splats.len() {
            let mean = mat3::mul_vec(rotation, vec3::sub(vec3::cast(splats.mean[i]), origin));
            let scale = splats.log_scale[i].map(|v| f64::from(v).exp());
            let largest = scale[0].max(scale[1]).max(scale[2]);
            let opacity = f64::from(splats.opacity(i));
            // `>` is false for NaN, which is what drops it.
            let usable = opacity > ALPHA_MIN && largest > 0.0 && largest.is_finite() && mean.iter().all(|v| v.is_finite());
            if !usable {
                continue;
            }
            let s = scale.map(|v| v.max(1e-3 * largest));
            let axes = mat3::mul(rotation, mat3::cast(splats.axes(i)));
            let cov = mat3::congruence(axes, mat3::diag(s.map(|v| v * v)));
            let normal = mat3::mul_vec(rotation, vec3::cast(normals[i]));
            shell.push(vec3::cast(mean), mat3::cast(cov), vec3::cast(normal), T::of(opacity));
        }
        shell
    }

    /// Appends one Gaussian.
    pub fn push(&mut self, mean: Vec3<T>, covariance: Mat3<T>, normal: Vec3<T>, opacity: T) {
        self.mean.push(mean);
        self.covariance.push(covariance);
        self.normal.push(normal);
        self.opacity.push(opacity);
    }

    /// Number of Gaussians.
    pub fn len(&self) -> usize {
        self.mean.len()
    }

    /// True without Gaussians.
    pub fn is_empty(&self) -> bool {
        self.mean.is_empty()
    }

    /// `2 ln(255 o)`: contributions with a squared canonical distance above it fall under 1/255.
    #[inline(always)]
    pub fn reach2(&self, i: usize) -> T {
        T::of(2.0) * (self.opacity[i] * T::of(255.0)).ln()
    }
}

/// A virtual cap (splatting.md §6.6): an opaque horizontal plane whose outside is below, over the marked columns of a grid.
#[derive(Clone, Debug, PartialEq)]
pub struct Cap {
    /// Height of the plane in the filling frame.
    pub height: f64,
    /// Lower corner of column (0, 0).
    pub origin: [f64; 2],
    /// Side of a column.
    pub spacing: f64,
    /// Columns along x and y.
    pub dims: [usize; 2],
    /// The columns it closes, x fastest.
    pub columns: Vec<bool>,
}

impl Cap {
    /// True where the vertical line through `(x, y)` crosses the cap.
    pub fn covers(&self, x: f64, y: f64) -> bool {
        let at = |v: f64, k: usize| {
            let i = ((v - self.origin[k]) / self.spacing).floor();
            (i >= 0.0 && i < self.dims[k] as f64).then_some(i as usize)
        };
        matches!((at(x, 0), at(y, 1)), (Some(i), Some(j)) if self.columns[j * self.dims[0] + i])
    }
}

/// What one ray accumulated: `A = Σ w`, `N = Σ w n`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Blend<T> {
    /// Accumulated alpha.
    pub alpha: T,
    /// Blended outward normal.
    pub normal: Vec3<T>,
}
