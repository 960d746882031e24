//! The robust box of a set of Gaussians (splatting.md §5.9 step 1).

use megas_math::{Mat3, Vec3, mat3, vec3};
use megas_model::Splats;

/// Box between the 0.5 % and 99.5 % quantiles of the means, weighted by opacity, along the axes of a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RobustBox {
    /// Lower corner in the frame.
    pub min: Vec3<f64>,
    /// Upper corner in the frame.
    pub max: Vec3<f64>,
}

impl RobustBox {
    /// Length of the diagonal, `L` of the design.
    pub fn diagonal(&self) -> f64 {
        vec3::norm(vec3::sub(self.max, self.min))
    }

    /// Longest side.
    pub fn longest(&self) -> f64 {
        (0..3).map(|k| self.max[k] - self.min[k]).fold(0.0, f64::max)
    }

    /// Centre.
    pub fn center(&self) -> Vec3<f64> {
        vec3::lerp(self.min, self.max, 0.5)
    }
}

/// The robust box of the Gaussians whose flag is set, in the frame `rotation · X`; `None` where nothing has weight.
pub fn robust_bounds(splats: &Splats, mask: &[bool], rotation: Mat3<f64>) -> Option<RobustBox> {
    let mut rows: Vec<(Vec3<f64>, f64)> = (0..splats.len())
        .filter(|&i| mask[i])
        .map(|i| (mat3::mul_vec(rotation, vec3::cast(splats.mean[i])), f64::from(splats.opacity(i))))
        .filter(|(x, w)| x.iter().all(|v| v.is_finite()) && *w > 0.0)
        .collect();
    let total: f64 = rows.iter().map(|r| r.1).sum();
    if rows.is_empty() {
        return None;
    }
    let mut out = RobustBox { min: [0.0; 3], max: [0.0; 3] };
    for k in 0..3 {
        rows.sort_by(|a, b| a.0[k].total_cmp(&b.0[k]));
        let quantile = |q: f64| {
            let mut sum = 0.0;
            rows.iter().find(|r| {
                sum += r.1;
                sum >= q * total
            })
        };
        let last = rows[rows.len() - 1];
        out.min[k] = quantile(0.005).unwrap_or(&last).0[k];
        out.max[k] = quantile(0.995).unwrap_or(&last).0[k];
    }
    Some(out)
}
