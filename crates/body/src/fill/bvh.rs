//! Rays in any direction: a bounding-volume hierarchy over the Gaussians, and the search through all of them that it is
//! tested against (splatting.md §6.3, §6.4).

use megas_math::{Real, Vec3, mat3, vec3};

use super::shell::{ALPHA_MAX, ALPHA_MIN};
use super::{Blend, Cap, Shell};

const LEAF: usize = 8;
const BINS: usize = 16;
/// Below this transmittance nothing that follows can change a result by more than the tests allow.
const T_STOP: f64 = 1e-9;

#[derive(Clone, Copy, Debug)]
struct Node<T> {
    min: Vec3<T>,
    max: Vec3<T>,
    /// Leaf: first item. Inner: index of the left child; the right one follows it.
    first: u32,
    /// Number of items of a leaf, 0 for inner nodes.
    count: u32,
}

/// A hierarchy over a [`Shell`].
#[derive(Debug)]
pub struct Bvh<'a, T> {
    shell: &'a Shell<T>,
    precision: Vec<[[T; 3]; 3]>,
    nodes: Vec<Node<T>>,
    items: Vec<u32>,
}

/// A Gaussian met by a ray.
#[derive(Clone, Copy, Debug)]
pub struct RayHit<T> {
    t: T,
    alpha: T,
    item: u32,
}

impl<'a, T: Real> Bvh<'a, T> {
    /// Builds the hierarchy by binned surface-area splits.
    pub fn new(shell: &'a Shell<T>) -> Self {
        let bounds: Vec<(Vec3<T>, Vec3<T>)> = (0..shell.len())
            .map(|i| {
                let h: Vec3<T> = std::array::from_fn(|k| (shell.reach2(i) * shell.covariance[i][k][k]).sqrt());
                (vec3::sub(shell.mean[i], h), vec3::add(shell.mean[i], h))
            })
            .collect();
        let precision = precisions(shell);
        let mut bvh = Self { shell, precision, nodes: Vec::new(), items: (0..shell.len() as u32).collect() };
        if !shell.is_empty() {
            bvh.nodes.push(Node { min: [T::zero(); 3], max: [T::zero(); 3], first: 0, count: 0 });
            let mut todo = vec![(0usize, 0usize, shell.len())];
            while let Some((node, lo, hi)) = todo.pop() {
                let (min, max) = enclose(&bounds, &bvh.items[lo..hi]);
                let cut = if hi - lo > LEAF { split(shell, &bounds, &mut bvh.items[lo..hi]) } else { None };
                let child = bvh.nodes.len();
                bvh.nodes[node] = match cut {
                    None => Node { min, max, first: lo as u32, count: (hi - lo) as u32 },
                    Some(_) => Node { min, max, first: child as u32, count: 0 },
                };
                if let Some(k) = cut {
                    bvh.nodes.extend([bvh.nodes[node]; 2]);
                    todo.push((child, lo, lo + k));
                    todo.push((child + 1, lo + k, hi));
                }
            }
        }
        bvh
    }

    /// Blends the ray from `origin` along the unit vector `direction` front to back. `hits` is working memory.
    pub fn trace(&self, origin: Vec3<T>, direction: Vec3<T>, cap: Option<&Cap>, hits: &mut Vec<RayHit<T>>) -> Blend<T> {
        hits.clear();
        let inverse = direction.map(|d| T::one() / d);
        // A split leaves at least a sixteenth of the items on either side, so that the depth stays below 250 for any set
        // that fits into memory.
        let mut stack = [0u32; 256];
        let mut top = usize::from(!self.nodes.is_empty());
        while top > 0 {
            top -= 1;
            let node = &self.nodes[stack[top] as usize];
            if !meets(node, origin, inverse) {
                continue;
            }
            if node.count == 0 {
                stack[top] = node.first;
                stack[top + 1] = node.first + 1;
                top += 2;
            } else {
                for &i in &self.items[node.first as usize..(node.first + node.count) as usize] {
                    hits.extend(respond(self.shell, &self.precision[i as usize], i, origin, direction));
                }
            }
        }
        blend(self.shell, origin, direction, cap, hits)
    }
}

/// The same as [`Bvh::trace`] by testing every Gaussian.
pub fn trace_all<T: Real>(shell: &Shell<T>, origin: Vec3<T>, direction: Vec3<T>, cap: Option<&Cap>) -> Blend<T> {
    let precision = precisions(shell);
    let mut hits: Vec<RayHit<T>> = (0..shell.len()).filter_map(|i| respond(shell, &precision[i], i as u32, origin, direction)).collect();
    blend(shell, origin, direction, cap, &mut hits)
}

fn precisions<T: Real>(shell: &Shell<T>) -> Vec<[[T; 3]; 3]> {
    shell.covariance.iter().map(|&c| mat3::inverse(c).unwrap_or([[T::infinity(); 3]; 3])).collect()
}

/// Maximum of the Gaussian along the ray, written with the precision matrix P: `t* = −d·P(x−μ) / d·Pd`, and D² there.
fn respond<T: Real>(shell: &Shell<T>, p: &[[T; 3]; 3], i: u32, origin: Vec3<T>, d: Vec3<T>) -> Option<RayHit<T>> {
    let item = i as usize;
    let x = vec3::sub(origin, shell.mean[item]);
    let pd = mat3::mul_vec(*p, d);
    let t = -vec3::dot(x, pd) / vec3::dot(d, pd);
    let y = vec3::add_scaled(x, d, t);
    let d2 = vec3::dot(y, mat3::mul_vec(*p, y));
    let alpha = (shell.opacity[item] * (d2 * T::of(-0.5)).exp()).min(T::of(ALPHA_MAX));
    (t > T::zero() && alpha >= T::of(ALPHA_MIN)).then_some(RayHit { t, alpha, item: i })
}

fn blend<T: Real>(shell: &Shell<T>, origin: Vec3<T>, d: Vec3<T>, cap: Option<&Cap>, hits: &mut [RayHit<T>]) -> Blend<T> {
    hits.sort_unstable_by(|a, b| a.t.partial_cmp(&b.t).unwrap_or(std::cmp::Ordering::Equal).then(a.item.cmp(&b.item)));
    let wall = cap.and_then(|c| cap_distance(c, origin, d)).unwrap_or(T::infinity());
    let mut out = Blend { alpha: T::zero(), normal: [T::zero(); 3] };
    let mut through = T::one();
    for h in hits.iter() {
        if h.t > wall {
            break;
        }
        let w = h.alpha * through;
        out.alpha += w;
        out.normal = vec3::add_scaled(out.normal, shell.normal[h.item as usize], w);
        through *= T::one() - h.alpha;
        if through < T::of(T_STOP) {
            return out;
        }
    }
    if wall.is_finite() {
        out.alpha += through;
        out.normal[2] -= through;
    }
    out
}

/// Where the ray meets the cap, if it does.
fn cap_distance<T: Real>(cap: &Cap, origin: Vec3<T>, d: Vec3<T>) -> Option<T> {
    let t = (T::of(cap.height) - origin[2]) / d[2];
    let at = vec3::add_scaled(origin, d, t);
    (t > T::zero() && t.is_finite() && cap.covers(at[0].f64(), at[1].f64())).then_some(t)
}

#[inline(always)]
fn meets<T: Real>(n: &Node<T>, origin: Vec3<T>, inverse: Vec3<T>) -> bool {
    let (mut near, mut far) = (T::neg_infinity(), T::infinity());
    for k in 0..3 {
        let (a, b) = ((n.min[k] - origin[k]) * inverse[k], (n.max[k] - origin[k]) * inverse[k]);
        // min/max ignore NaN (0·∞): a ray inside a slab parallel to it is not cut by that slab.
        near = near.max(a.min(b));
        far = far.min(a.max(b));
    }
    // The hit is the closest approach, which for an off-centre ray lies inside the box too.
    far >= near && far >= T::zero()
}

fn enclose<T: Real>(bounds: &[(Vec3<T>, Vec3<T>)], items: &[u32]) -> (Vec3<T>, Vec3<T>) {
    items.iter().fold(([T::infinity(); 3], [T::neg_infinity(); 3]), |(lo, hi), &i| {
        let b = &bounds[i as usize];
        (vec3::min(lo, b.0), vec3::max(hi, b.1))
    })
}

/// Reorders `items` at the cheapest of 16 bins per axis and returns the size of the left part.
fn split<T: Real>(shell: &Shell<T>, bounds: &[(Vec3<T>, Vec3<T>)], items: &mut [u32]) -> Option<usize> {
    let n = items.len();
    let (mut lo, mut hi) = ([T::infinity(); 3], [T::neg_infinity(); 3]);
    for &i in items.iter() {
        lo = vec3::min(lo, shell.mean[i as usize]);
        hi = vec3::max(hi, shell.mean[i as usize]);
    }
    let bin = |i: u32, k: usize| {
        let f = (shell.mean[i as usize][k] - lo[k]) / (hi[k] - lo[k]);
        ((f.f64() * BINS as f64) as usize).min(BINS - 1)
    };
    let area = |b: &(Vec3<T>, Vec3<T>)| {
        let e = vec3::sub(b.1, b.0);
        e[0] * e[1] + e[1] * e[2] + e[2] * e[0]
    };
    let mut best: Option<(T, usize, usize)> = None;
    for k in 0..3 {
        if hi[k] <= lo[k] {
            continue;
        }
        let mut boxes = [([T::infinity(); 3], [T::neg_infinity(); 3]); BINS];
        let mut counts = [0usize; BINS];
        for &i in items.iter() {
            let c = bin(i, k);
            boxes[c] = (vec3::min(boxes[c].0, bounds[i as usize].0), vec3::max(boxes[c].1, bounds[i as usize].1));
            counts[c] += 1;
        }
        for cut in 1..BINS {
            let side = |range: std::ops::Range<usize>| {
                range.filter(|&c| counts[c] > 0).fold((0, ([T::infinity(); 3], [T::neg_infinity(); 3])), |(m, b), c| {
                    (m + counts[c], (vec3::min(b.0, boxes[c].0), vec3::max(b.1, boxes[c].1)))
                })
            };
            let ((left, lb), (right, rb)) = (side(0..cut), side(cut..BINS));
            if left * 16 < n || right * 16 < n {
                continue;
            }
            let cost = area(&lb) * T::of(left as f64) + area(&rb) * T::of(right as f64);
            if best.is_none_or(|(c, _, _)| cost < c) {
                best = Some((cost, k, cut));
            }
        }
    }
    if let Some((_, k, cut)) = best {
        // A stable partition keeps the result independent of library internals.
        let (left, right): (Vec<u32>, Vec<u32>) = items.iter().partition(|&&i| bin(i, k) < cut);
        items[..left.len()].copy_from_slice(&left);
        items[left.len()..].copy_from_slice(&right);
        return Some(left.len());
    }
    let k = (0..3).fold(0, |m, k| if hi[k] - lo[k] > hi[m] - lo[m] { k } else { m });
    items.sort_unstable_by(|&p, &q| {
        let (x, y) = (shell.mean[p as usize][k], shell.mean[q as usize][k]);
        x.partial_cmp(&y).unwrap_or(std::cmp::Ordering::Equal).then(p.cmp(&q))
    });
    Some(n / 2)
}
