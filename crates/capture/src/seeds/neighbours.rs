//! Mean squared distance to the three nearest points, by a k-d tree that stands points on top of each other.

use rayon::prelude::*;

/// Points in a leaf of the tree.
const LEAF: usize = 8;

/// A balanced tree in place: the median of every range stands in its middle.
struct Tree {
    points: Vec<[f32; 3]>,
    /// Number of the point in the order of the caller.
    order: Vec<u32>,
    /// Axis along which the range with this middle is split.
    axes: Vec<u8>,
}

/// For every point the mean of the squared distances to its three nearest others; 0 where there are no others.
pub(super) fn mean_square_to_nearest(points: &[[f32; 3]]) -> Vec<f32> {
    let n = points.len();
    let mut order: Vec<u32> = (0..n as u32).collect();
    let mut axes = vec![0; n];
    split(points, &mut order, &mut axes);
    let tree = Tree { points: order.iter().map(|i| points[*i as usize]).collect(), order, axes };
    let found: Vec<f32> = (0..n).into_par_iter().map(|at| tree.mean_of_three(at)).collect();
    let mut result = vec![0.0; n];
    tree.order.iter().zip(found).for_each(|(i, d2)| result[*i as usize] = d2);
    result
}

fn split(points: &[[f32; 3]], order: &mut [u32], axes: &mut [u8]) {
    if order.len() <= LEAF {
        return;
    }
    let (mut lo, mut hi) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    for i in order.iter() {
        let p = points[*i as usize];
        (0..3).for_each(|k| (lo[k], hi[k]) = (lo[k].min(p[k]), hi[k].max(p[k])));
    }
    let axis = (1..3).fold(0, |a, k| if hi[k] - lo[k] > hi[a] - lo[a] { k } else { a });
    let middle = order.len() / 2;
    // Ties by number: the tree is the same whatever order they come in.
    order.select_nth_unstable_by(middle, |a, b| points[*a as usize][axis].total_cmp(&points[*b as usize][axis]).then(a.cmp(b)));
    axes[middle] = axis as u8;
    let ((left, right), (axes_left, axes_right)) = (order.split_at_mut(middle), axes.split_at_mut(middle));
    rayon::join(|| split(points, left, axes_left), || split(points, &mut right[1..], &mut axes_right[1..]));
}

impl Tree {
    fn mean_of_three(&self, at: usize) -> f32 {
        let mut best = [f32::INFINITY; 3];
        self.search(0, self.points.len(), at, &mut best);
        let found = best.iter().filter(|d| d.is_finite()).count();
        if found == 0 { 0.0 } else { best.iter().filter(|d| d.is_finite()).sum::<f32>() / found as f32 }
    }

    fn search(&self, from: usize, to: usize, at: usize, best: &mut [f32; 3]) {
        if to - from <= LEAF {
            (from..to).for_each(|i| self.consider(i, at, best));
            return;
        }
        let middle = from + (to - from) / 2;
        let axis = self.axes[middle] as usize;
        self.consider(middle, at, best);
        let offset = self.points[at][axis] - self.points[middle][axis];
        let (near, far) = if offset < 0.0 { ((from, middle), (middle + 1, to)) } else { ((middle + 1, to), (from, middle)) };
        self.search(near.0, near.1, at, best);
        // Not searched on equality: that keeps heaps of equal points cheap.
        if offset * offset < best[2] {
            self.search(far.0, far.1, at, best);
        }
    }

    #[inline(always)]
    fn consider(&self, i: usize, at: usize, best: &mut [f32; 3]) {
        if i == at {
            return;
        }
        let (a, b) = (self.points[i], self.points[at]);
        let d2 = (a[0] - b[0]).powi(2) + (a[1] - b[1]).powi(2) + (a[2] - b[2]).powi(2);
        if d2 < best[2] {
            *best = if d2 < best[0] {
                [d2, best[0], best[1]]
            } else if d2 < best[1] {
                [best[0], d2, best[1]]
            } else {
                [best[0], best[1], d2]
            };
        }
    }
}

#[cfg(test)]
mod tests {
    use megas_math::rng::Rng;

    use super::*;

    #[test]
    fn the_tree_finds_what_a_full_search_finds() {
        let mut rng = Rng::new(3);
        // Clumps, a plane, and copies.
        let mut points: Vec<[f32; 3]> = (0..900).map(|_| [0, 1, 2].map(|_| rng.unit() as f32)).collect();
        points.extend((0..300).map(|i| [(i % 20) as f32 * 0.05, (i / 20) as f32 * 0.05, 0.5]));
        points.extend_from_within(0..150);
        let fast = mean_square_to_nearest(&points);
        for (i, p) in points.iter().enumerate() {
            let d2 = |q: &[f32; 3]| (q[0] - p[0]).powi(2) + (q[1] - p[1]).powi(2) + (q[2] - p[2]).powi(2);
            let mut all: Vec<f32> = points.iter().enumerate().filter(|(j, _)| *j != i).map(|(_, q)| d2(q)).collect();
            all.sort_by(f32::total_cmp);
            assert!((fast[i] - (all[0] + all[1] + all[2]) / 3.0).abs() <= 1e-7, "{i}");
        }
    }

    #[test]
    fn few_and_equal_points() {
        assert!(mean_square_to_nearest(&[]).is_empty());
        assert_eq!(mean_square_to_nearest(&[[1.0; 3]]), [0.0]);
        assert_eq!(mean_square_to_nearest(&[[0.0; 3], [2.0, 0.0, 0.0]]), [4.0, 4.0]);
        let heap = mean_square_to_nearest(&vec![[1.0, 2.0, 3.0]; 200_000]);
        assert!(heap.iter().all(|d| *d == 0.0));
    }
}
