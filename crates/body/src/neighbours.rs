//! Nearest neighbours of points in space: one place that knows the k-d tree library.

use kiddo::{ImmutableKdTree, SquaredEuclidean};
use megas_math::Vec3;

/// A k-d tree over a fixed set of points; items are indices into that set.
pub struct Neighbours {
    tree: ImmutableKdTree<f32, 3>,
}

impl Neighbours {
    /// Builds the tree; `None` without points or where the library rejects them (coordinates that are not finite).
    pub fn new(points: &[Vec3<f32>]) -> Option<Self> {
        if points.is_empty() || points.iter().flatten().any(|v| !v.is_finite()) {
            return None;
        }
        ImmutableKdTree::new_from_slice(points).ok().map(|tree| Self { tree })
    }

    /// The `k` nearest items `(index, squared distance)`, nearest first, ties by index.
    pub fn nearest(&self, point: &Vec3<f32>, k: usize) -> Vec<(u32, f32)> {
        let Some(k) = std::num::NonZero::new(k) else { return Vec::new() };
        let found = self.tree.query(point).nearest_n::<SquaredEuclidean<f32>>(k).execute();
        let mut out: Vec<(u32, f32)> = found.iter().map(|r| (r.item, r.distance)).collect();
        out.sort_unstable_by(|a, b| a.1.total_cmp(&b.1).then(a.0.cmp(&b.0)));
        out
    }

    /// Squared distance to the nearest point.
    pub fn distance2(&self, point: &Vec3<f32>) -> f32 {
        self.tree.query(point).nearest_one::<SquaredEuclidean<f32>>().execute().distance
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use megas_math::{rng::Rng, vec3};

    #[test]
    fn agrees_with_a_linear_search_even_with_repeated_points() {
        let mut rng = Rng::new(11);
        let mut p: Vec<Vec3<f32>> = (0..500).map(|_| std::array::from_fn(|_| rng.unit() as f32)).collect();
        p.extend(std::iter::repeat_n([0.5, 0.5, 0.5], 200));
        let tree = Neighbours::new(&p).unwrap();
        for _ in 0..50 {
            let q: Vec3<f32> = std::array::from_fn(|_| rng.unit() as f32);
            let mut d: Vec<f32> = p.iter().map(|&x| vec3::dot(vec3::sub(x, q), vec3::sub(x, q))).collect();
            d.sort_by(f32::total_cmp);
            let got = tree.nearest(&q, 7);
            for k in 0..7 {
                assert!((got[k].1 - d[k]).abs() < 1e-6);
            }
            assert!((tree.distance2(&q) - d[0]).abs() < 1e-6);
        }
        assert!(Neighbours::new(&[]).is_none() && Neighbours::new(&[[f32::NAN, 0.0, 0.0]]).is_none());
    }
}
