//! Ground whose height varies over a rectangle.

use megas_math::{Vec3, vec3};

/// Heights on a regular grid over a rectangle, bilinear between them and constant beyond its edges; solid below.
#[derive(Clone, Debug, PartialEq)]
pub struct Heightfield {
    corner: [f64; 2],
    spacing: [f64; 2],
    count: [usize; 2],
    heights: Vec<f64>,
}

impl Heightfield {
    /// Heights `z` over the rectangle with its smallest corner at `corner` and sides `size`, `count` per axis, y fastest.
    /// `None` unless there are at least two per axis, as many as announced, all finite, and the sides are positive.
    pub fn new(corner: [f64; 2], size: [f64; 2], count: [usize; 2], heights: Vec<f64>) -> Option<Self> {
        let good = count.iter().all(|&n| n >= 2)
            && count[0].checked_mul(count[1]) == Some(heights.len())
            && heights.iter().chain(&corner).all(|v| v.is_finite())
            && size.iter().all(|&s| s > 0.0 && s.is_finite());
        let spacing = std::array::from_fn(|a| size[a] / (count[a].max(2) - 1) as f64);
        good.then_some(Self { corner, spacing, count, heights })
    }

    /// Height and its slopes.
    pub fn height(&self, x: f64, y: f64) -> (f64, [f64; 2]) {
        let mut cell = [0; 2];
        let mut f = [0.0; 2];
        let mut inside = [true; 2];
        for (a, v) in [x, y].into_iter().enumerate() {
            let t = (v - self.corner[a]) / self.spacing[a];
            let last = (self.count[a] - 1) as f64;
            inside[a] = t >= 0.0 && t <= last;
            let t = t.clamp(0.0, last);
            cell[a] = (t as usize).min(self.count[a] - 2);
            f[a] = t - cell[a] as f64;
        }
        let at = |i: usize, j: usize| self.heights[(cell[0] + i) * self.count[1] + cell[1] + j];
        let (h00, h01, h10, h11) = (at(0, 0), at(0, 1), at(1, 0), at(1, 1));
        let [u, v] = f;
        let height = (1.0 - u) * ((1.0 - v) * h00 + v * h01) + u * ((1.0 - v) * h10 + v * h11);
        let slope = |inside: bool, d: f64, spacing: f64| if inside { d / spacing } else { 0.0 };
        let dx = (1.0 - v) * (h10 - h00) + v * (h11 - h01);
        let dy = (1.0 - u) * (h01 - h00) + u * (h11 - h10);
        (height, [slope(inside[0], dx, self.spacing[0]), slope(inside[1], dy, self.spacing[1])])
    }

    /// Distance to first order: the height above ground, shortened by the slope. Exact on planes, and on the surface.
    pub(crate) fn distance(&self, x: Vec3<f64>) -> (f64, Vec3<f64>) {
        let (h, [sx, sy]) = self.height(x[0], x[1]);
        let length = (1.0 + sx * sx + sy * sy).sqrt();
        ((x[2] - h) / length, vec3::scale([-sx, -sy, 1.0], 1.0 / length))
    }

    pub(crate) fn center(&self) -> Vec3<f64> {
        let mid = |a: usize| self.corner[a] + 0.5 * self.spacing[a] * (self.count[a] - 1) as f64;
        let [x, y] = [mid(0), mid(1)];
        [x, y, self.height(x, y).0]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn heights_are_bilinear_and_an_inclined_plane_is_exact() {
        let plane: Vec<f64> = (0..12).map(|i| 0.5 * f64::from(i / 4) + 0.25 * f64::from(i % 4)).collect();
        let h = Heightfield::new([1.0, 2.0], [2.0, 3.0], [3, 4], plane).unwrap();
        assert_eq!(h.height(1.5, 3.5), (0.25 + 0.375, [0.5, 0.25]));
        assert_eq!(h.height(-9.0, 3.0).0, 0.25);
        let n = vec3::normalize_or([-0.5, -0.25, 1.0], [0.0; 3]);
        let (d, got) = h.distance(vec3::add_scaled([2.0, 3.0, 0.75], n, 0.3));
        assert!((d - 0.3).abs() < 1e-12 && vec3::norm(vec3::sub(got, n)) < 1e-12);
        assert!(Heightfield::new([0.0; 2], [1.0; 2], [1, 2], vec![0.0; 2]).is_none());
        assert!(Heightfield::new([0.0; 2], [1.0; 2], [2, 2], vec![0.0, 1.0, f64::NAN, 0.0]).is_none());
    }
}
