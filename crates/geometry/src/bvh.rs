//! A tree of boxes over triangles.

use megas_math::{Vec3, vec3};

/// Triangles in a leaf at most.
const LEAF: usize = 4;

/// Deepest tree that the traversals have room for; a median split reaches half of it with four billion triangles.
pub(crate) const DEPTH: usize = 64;

/// A triangle by its corners.
pub(crate) type Triangle = [Vec3<f64>; 3];

/// A box and what is in it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Node {
    pub low: Vec3<f64>,
    pub high: Vec3<f64>,
    /// Range of [`Bvh::triangles`] below this node.
    pub first: u32,
    pub count: u32,
    /// The second child; the first follows its parent. Zero for leaves.
    pub second: u32,
}

impl Node {
    /// Squared distance from `x` to the box, 0 inside.
    #[inline(always)]
    pub fn distance2(&self, x: Vec3<f64>) -> f64 {
        let mut d2 = 0.0;
        for k in 0..3 {
            let d = (self.low[k] - x[k]).max(x[k] - self.high[k]).max(0.0);
            d2 += d * d;
        }
        d2
    }
}

/// The tree. Its layout depends on the triangles alone.
#[derive(Clone, Debug, Default)]
pub(crate) struct Bvh {
    /// Parents before their children; the root is first.
    pub nodes: Vec<Node>,
    /// Triangles in the order of the leaves.
    pub triangles: Vec<Triangle>,
    /// Their indices in the caller's order.
    pub index: Vec<u32>,
}

impl Bvh {
    /// Splits at the median along the longest side of the box of centroids.
    pub fn new(triangles: &[Triangle]) -> Self {
        let centroids: Vec<Vec3<f64>> = triangles.iter().map(|t| vec3::scale(vec3::add(vec3::add(t[0], t[1]), t[2]), 1.0 / 3.0)).collect();
        let mut tree = Self { nodes: Vec::new(), triangles: Vec::new(), index: (0..triangles.len() as u32).collect() };
        if !triangles.is_empty() {
            let mut index = std::mem::take(&mut tree.index);
            tree.split(triangles, &centroids, &mut index, 0);
            tree.triangles = index.iter().map(|&i| triangles[i as usize]).collect();
            tree.index = index;
        }
        tree
    }

    fn split(&mut self, triangles: &[Triangle], centroids: &[Vec3<f64>], index: &mut [u32], first: usize) {
        let (low, high) = bounds(index.iter().flat_map(|&i| triangles[i as usize]));
        let node = self.nodes.len();
        self.nodes.push(Node { low, high, first: first as u32, count: index.len() as u32, second: 0 });
        if index.len() <= LEAF {
            return;
        }
        let (low, high) = bounds(index.iter().map(|&i| centroids[i as usize]));
        let size = vec3::sub(high, low);
        let axis = (0..3).max_by(|&a, &b| size[a].total_cmp(&size[b])).unwrap_or(0);
        let middle = index.len() / 2;
        // Equal centroids rank by index: the order, and so the tree, is unique.
        index.select_nth_unstable_by(middle, |&a, &b| centroids[a as usize][axis].total_cmp(&centroids[b as usize][axis]).then(a.cmp(&b)));
        let (a, b) = index.split_at_mut(middle);
        self.split(triangles, centroids, a, first);
        self.nodes[node].second = self.nodes.len() as u32;
        self.split(triangles, centroids, b, first + middle);
    }
}

/// Smallest box of points.
pub(crate) fn bounds(points: impl Iterator<Item = Vec3<f64>>) -> (Vec3<f64>, Vec3<f64>) {
    points.fold(([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]), |(low, high), x| (vec3::min(low, x), vec3::max(high, x)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use megas_math::rng::Rng;

    #[test]
    fn every_triangle_is_in_one_leaf_and_in_all_boxes_above() {
        let mut rng = Rng::new(2);
        let mut triangles: Vec<Triangle> = (0..333).map(|_| [(); 3].map(|_| [(); 3].map(|_| rng.unit()))).collect();
        triangles.extend(std::iter::repeat_n([[0.5; 3]; 3], 50));
        let tree = Bvh::new(&triangles);
        let mut seen = vec![0; triangles.len()];
        for (n, node) in tree.nodes.iter().enumerate() {
            let range = node.first as usize..(node.first + node.count) as usize;
            for &x in tree.triangles[range.clone()].iter().flatten() {
                assert_eq!(node.distance2(x), 0.0);
            }
            if node.second == 0 {
                assert!(node.count as usize <= LEAF);
                tree.index[range].iter().for_each(|&i| seen[i as usize] += 1);
            } else {
                let [a, b] = [n + 1, node.second as usize].map(|c| tree.nodes[c]);
                assert_eq!((a.first, b.first, a.count + b.count), (node.first, node.first + a.count, node.count));
            }
        }
        assert!(seen.iter().all(|&s| s == 1));
        assert!(tree.index.iter().zip(&tree.triangles).all(|(&i, t)| triangles[i as usize] == *t));
    }
}
