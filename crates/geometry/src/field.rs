//! A signed distance sampled on the nodes of a regular grid.

use megas_math::{Vec3, vec3};

/// Signed distances on a grid: node (i, j, k) sits at `origin + spacing · (i, j, k)`, z is fastest in memory; trilinear
/// between the nodes.
#[derive(Clone, Debug, PartialEq)]
pub struct Field {
    origin: Vec3<f64>,
    spacing: f64,
    nodes: [usize; 3],
    values: Vec<f32>,
}

impl Field {
    /// `None` unless there are two nodes per axis, one finite value per node, and a positive spacing.
    pub fn new(origin: Vec3<f64>, spacing: f64, nodes: [usize; 3], values: Vec<f32>) -> Option<Self> {
        let len = nodes.iter().try_fold(1usize, |n, &m| n.checked_mul(m));
        let good = nodes.iter().all(|&n| n >= 2)
            && len == Some(values.len())
            && spacing > 0.0
            && spacing.is_finite()
            && origin.iter().all(|v| v.is_finite())
            && values.iter().all(|v| v.is_finite());
        good.then_some(Self { origin, spacing, nodes, values })
    }

    /// Position of node (0, 0, 0).
    pub fn origin(&self) -> Vec3<f64> {
        self.origin
    }

    /// Distance between nodes.
    pub fn spacing(&self) -> f64 {
        self.spacing
    }

    /// Nodes per axis.
    pub fn nodes(&self) -> [usize; 3] {
        self.nodes
    }

    /// Signed distances, z fastest.
    pub fn values(&self) -> &[f32] {
        &self.values
    }

    /// Smallest and largest corner of the grid.
    pub fn bounds(&self) -> (Vec3<f64>, Vec3<f64>) {
        (self.origin, std::array::from_fn(|a| self.origin[a] + self.spacing * (self.nodes[a] - 1) as f64))
    }

    /// Volume of the inside; nodes near the surface count in part.
    pub(crate) fn volume(&self) -> f64 {
        let share = |d: &f32| (0.5 - f64::from(*d) / self.spacing).clamp(0.0, 1.0);
        self.values.iter().map(share).sum::<f64>() * self.spacing.powi(3)
    }

    pub(crate) fn center(&self) -> Vec3<f64> {
        let (lo, hi) = self.bounds();
        vec3::lerp(lo, hi, 0.5)
    }

    /// Trilinear value at `x`, which is moved into the grid first.
    fn value(&self, x: Vec3<f64>) -> f64 {
        let mut cell = [0; 3];
        let mut f = [0.0; 3];
        for a in 0..3 {
            let t = ((x[a] - self.origin[a]) / self.spacing).clamp(0.0, (self.nodes[a] - 1) as f64);
            cell[a] = (t as usize).min(self.nodes[a] - 2);
            f[a] = t - cell[a] as f64;
        }
        let row = |i: usize, j: usize| {
            let at = ((cell[0] + i) * self.nodes[1] + cell[1] + j) * self.nodes[2] + cell[2];
            let (a, b) = (f64::from(self.values[at]), f64::from(self.values[at + 1]));
            a + f[2] * (b - a)
        };
        let plane = |i: usize| {
            let (a, b) = (row(i, 0), row(i, 1));
            a + f[1] * (b - a)
        };
        let (a, b) = (plane(0), plane(1));
        a + f[0] * (b - a)
    }

    /// Distance and outward unit normal, by central differences over one spacing each way. Beyond the grid the surface is as
    /// near as the nearest node of the grid says; solids that reach its edge go on.
    pub(crate) fn distance(&self, x: Vec3<f64>) -> (f64, Vec3<f64>) {
        let (lo, hi) = self.bounds();
        let inside = vec3::max(lo, vec3::min(hi, x));
        let d = self.value(inside);
        let slope = |a: usize| {
            let (mut p, mut q) = (inside, inside);
            p[a] = (inside[a] - self.spacing).max(lo[a]);
            q[a] = (inside[a] + self.spacing).min(hi[a]);
            (self.value(q) - self.value(p)) / (q[a] - p[a])
        };
        let n = vec3::normalize_or([slope(0), slope(1), slope(2)], [0.0, 0.0, 1.0]);
        if d <= 0.0 || inside == x {
            return (d, n);
        }
        let from_surface = vec3::sub(x, vec3::add_scaled(inside, n, -d));
        (vec3::norm(from_surface), vec3::normalize_or(from_surface, n))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sampled_ball_is_a_ball_inside_and_beyond_the_grid() {
        let n = 21usize;
        let position = |i: usize| [i / (n * n), i / n % n, i % n].map(|c| 0.1 * c as f64 - 1.0);
        let values = (0..n * n * n).map(|i| (vec3::norm(position(i)) - 0.7) as f32).collect();
        let field = Field::new([-1.0; 3], 0.1, [n; 3], values).unwrap();
        assert!((field.volume() / (4.0 / 3.0 * std::f64::consts::PI * 0.343) - 1.0).abs() < 0.01);
        for x in [[0.55, 0.33, 0.2], [0.9, -0.3, 0.13], [2.0, 0.4, -0.3], [-1.0, 3.0, 5.0]] {
            let (d, normal) = field.distance(x);
            let r = vec3::norm(x);
            // Outside, the direction from the edge of the grid is good to a degree.
            assert!((d - (r - 0.7)).abs() < 5e-3 * (1.0 + 5.0 * d.max(0.0)), "{x:?} {d} {}", r - 0.7);
            assert!(vec3::dot(normal, x) / r > if d > 0.4 { 0.993 } else { 0.9995 }, "{x:?} {normal:?}");
        }
        assert!(Field::new([0.0; 3], 0.1, [2; 3], vec![f32::NAN; 8]).is_none());
        assert!(Field::new([0.0; 3], 0.1, [2, 2, 1], vec![0.0; 4]).is_none());
    }
}
