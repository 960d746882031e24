//! Points in rows: all points whose y and z fall into the same square, sorted by x. A ball query visits the few squares that
//! it overlaps, finds its start in each by bisection and then reads memory in order; nothing is ever further away than a cache
//! line. Built once a frame, faster than a tree, and answers in the same order for any number of threads.

use megas_math::{Vec3, vec3};

/// Most rows; wider ones are used for points that are spread out more than that.
const MOST_ROWS: usize = 1 << 21;

/// Points sorted into rows. Items are indices into the array that it was built from; points that are not finite are left out.
#[derive(Clone, Debug, Default)]
pub(crate) struct Rows {
    width: f32,
    origin: [f32; 2],
    size: [usize; 2],
    start: Vec<u32>,
    /// Positions in row order.
    pub x: Vec<f32>,
    pub y: Vec<f32>,
    pub z: Vec<f32>,
    /// Items in row order.
    pub item: Vec<u32>,
}

impl Rows {
    /// Sorts `points` into rows of `width` (> 0). `width` should be a third to the whole of the usual query radius.
    pub fn new(points: &[Vec3<f32>], width: f32) -> Self {
        let mut items: Vec<u32> = (0..points.len() as u32).filter(|&i| points[i as usize].iter().all(|v| v.is_finite())).collect();
        let (mut lo, mut hi) = ([f32::INFINITY; 2], [f32::NEG_INFINITY; 2]);
        for &i in &items {
            for a in 0..2 {
                lo[a] = lo[a].min(points[i as usize][a + 1]);
                hi[a] = hi[a].max(points[i as usize][a + 1]);
            }
        }
        if items.is_empty() {
            return Self::default();
        }
        let mut out = Self { width: width.max(f32::MIN_POSITIVE), origin: lo, ..Self::default() };
        loop {
            let n = [0, 1].map(|a| f64::from(hi[a] - lo[a]) / f64::from(out.width) + 1.0);
            if n[0] * n[1] <= MOST_ROWS as f64 {
                out.size = n.map(|v| v as usize);
                break;
            }
            out.width *= 2.0;
        }
        let row_of = |i: u32| {
            let p = points[i as usize];
            out.column(1, p[2]) * out.size[0] + out.column(0, p[1])
        };
        let rows = out.size[0] * out.size[1];
        let mut start = vec![0u32; rows + 1];
        let key: Vec<u32> = items.iter().map(|&i| row_of(i) as u32).collect();
        for &k in &key {
            start[k as usize + 1] += 1;
        }
        for k in 0..rows {
            start[k + 1] += start[k];
        }
        let mut next = start.clone();
        let mut sorted = vec![0u32; items.len()];
        for (&i, &k) in items.iter().zip(&key) {
            sorted[next[k as usize] as usize] = i;
            next[k as usize] += 1;
        }
        items.clear();
        for k in 0..rows {
            let row = &mut sorted[start[k] as usize..start[k + 1] as usize];
            row.sort_unstable_by(|&a, &b| points[a as usize][0].total_cmp(&points[b as usize][0]).then(a.cmp(&b)));
        }
        let axis = |a: usize| sorted.iter().map(|&i| points[i as usize][a]).collect::<Vec<f32>>();
        (out.x, out.y, out.z) = (axis(0), axis(1), axis(2));
        (out.item, out.start) = (sorted, start);
        out
    }

    /// Number of points.
    pub fn len(&self) -> usize {
        self.item.len()
    }

    #[inline(always)]
    fn column(&self, a: usize, v: f32) -> usize {
        // Saturates: left of the first column is the first, NaN too.
        (((v - self.origin[a]) / self.width) as usize).min(self.size[a].saturating_sub(1))
    }

    /// Calls `visit(slot, offset, squared distance)` for every point within `radius` of `x`, `offset = x − point`, slots in row
    /// order.
    #[inline(always)]
    pub fn within(&self, x: Vec3<f32>, radius: f32, mut visit: impl FnMut(usize, Vec3<f32>, f32)) {
        if self.item.is_empty() || !x.iter().all(|v| v.is_finite()) {
            return;
        }
        let r2 = radius * radius;
        let range = |a: usize| (self.column(a, x[a + 1] - radius), self.column(a, x[a + 1] + radius));
        let ((y0, y1), (z0, z1)) = (range(0), range(1));
        let apart = |a: usize, k: usize| {
            let lo = self.origin[a] + k as f32 * self.width;
            // The outermost columns of the directory are as wide as rounding makes them.
            let (lo, hi) = (lo - 1e-3 * self.width, lo + 1.001 * self.width);
            (lo - x[a + 1]).max(x[a + 1] - hi).max(0.0)
        };
        for kz in z0..=z1 {
            let dz = apart(1, kz);
            for ky in y0..=y1 {
                let dy = apart(0, ky);
                let left = r2 - dz * dz - dy * dy;
                if left < 0.0 {
                    continue;
                }
                let row = kz * self.size[0] + ky;
                let (begin, end) = (self.start[row] as usize, self.start[row + 1] as usize);
                if begin == end {
                    continue;
                }
                let reach = left.sqrt() * 1.0001;
                let xs = &self.x[begin..end];
                let from = if end - begin <= 8 { 0 } else { xs.partition_point(|&v| v < x[0] - reach) };
                let to = x[0] + reach;
                for s in begin + from..end {
                    if self.x[s] > to {
                        break;
                    }
                    let d = [x[0] - self.x[s], x[1] - self.y[s], x[2] - self.z[s]];
                    let d2 = vec3::dot(d, d);
                    if d2 <= r2 {
                        visit(s, d, d2);
                    }
                }
            }
        }
    }

    /// The `k` nearest points `(squared distance, slot)`, nearest first, ties by item; fewer if none is closer than `reach`.
    /// `guess` is where the search begins and only changes the speed.
    pub fn nearest(&self, x: Vec3<f32>, k: usize, guess: f32, reach: f32, out: &mut Vec<(f32, u32)>) {
        let mut radius = guess.min(reach);
        loop {
            out.clear();
            self.within(x, radius, |s, _, d2| out.push((d2, s as u32)));
            if out.len() >= k || radius >= reach || out.len() == self.len() {
                break;
            }
            radius = (1.7 * radius).min(reach);
        }
        let by = |a: &(f32, u32), b: &(f32, u32)| a.0.total_cmp(&b.0).then(self.item[a.1 as usize].cmp(&self.item[b.1 as usize]));
        if out.len() > k {
            out.select_nth_unstable_by(k, by);
            out.truncate(k);
        }
        out.sort_unstable_by(by);
    }

    /// Typical distance between neighbours: the median, over at most `samples` points evenly spread over the array, of the mean
    /// distance to the six nearest others. 0 for fewer than two points or where all coincide.
    pub fn spacing(points: &[Vec3<f32>], samples: usize) -> f32 {
        let finite = points.iter().filter(|p| p.iter().all(|v| v.is_finite()));
        let (mut lo, mut hi, mut n) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3], 0usize);
        for p in finite {
            (lo, hi, n) = (vec3::min(lo, *p), vec3::max(hi, *p), n + 1);
        }
        if n < 2 {
            return 0.0;
        }
        let e = vec3::sub(hi, lo);
        let longest = e[0].max(e[1]).max(e[2]);
        // As if they lay on the surface of their box.
        let guess = (2.0 * (e[0] * e[1] + e[1] * e[2] + e[2] * e[0]) / n as f32).sqrt().max(longest / n as f32);
        if guess.is_nan() || guess <= 0.0 {
            return 0.0;
        }
        let rows = Self::new(points, 2.0 * guess);
        let stride = rows.len().div_ceil(samples.max(1));
        let mut found = Vec::new();
        let mut means: Vec<f32> = (0..rows.len())
            .step_by(stride)
            .map(|s| {
                rows.nearest([rows.x[s], rows.y[s], rows.z[s]], 7, 2.0 * guess, 4.0 * longest, &mut found);
                // The first is the point itself.
                found[1..].iter().map(|f| f.0.sqrt()).sum::<f32>() / (found.len() - 1).max(1) as f32
            })
            .collect();
        let mid = means.len() / 2;
        *means.select_nth_unstable_by(mid, f32::total_cmp).1
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use megas_math::rng::Rng;

    #[test]
    fn balls_and_neighbours_agree_with_a_linear_search() {
        let mut rng = Rng::new(5);
        let mut p: Vec<Vec3<f32>> = (0..3000).map(|_| std::array::from_fn(|a| (rng.unit() * [3.0, 1.0, 0.4][a]) as f32)).collect();
        p[17][1] = f32::NAN;
        p.push([9.0, -8.0, 7.0]);
        for width in [0.02, 0.3, 5.0] {
            let rows = Rows::new(&p, width);
            assert_eq!(rows.len(), 3000);
            let mut found = Vec::new();
            for _ in 0..60 {
                let x: Vec3<f32> = std::array::from_fn(|a| (rng.range(-0.2, 1.2) * [3.0, 1.0, 0.4][a]) as f32);
                let radius = rng.range(0.0, 0.5) as f32;
                let mut direct: Vec<(f32, u32)> = Vec::new();
                for (i, q) in p.iter().enumerate() {
                    let d = vec3::sub(x, *q);
                    direct.push((vec3::dot(d, d), i as u32));
                }
                direct.retain(|d| d.0.is_finite());
                direct.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
                let mut ball = Vec::new();
                rows.within(x, radius, |s, _, d2| ball.push((d2, rows.item[s])));
                ball.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
                let inside: Vec<_> = direct.iter().filter(|d| d.0 <= radius * radius).copied().collect();
                assert_eq!(ball, inside);
                rows.nearest(x, 12, 0.05, 100.0, &mut found);
                let items: Vec<_> = found.iter().map(|f| (f.0, rows.item[f.1 as usize])).collect();
                assert_eq!(items, direct[..12]);
            }
        }
    }

    #[test]
    fn the_spacing_of_a_square_lattice_is_known_and_degenerate_sets_have_none() {
        // Four neighbours at 1 and two of the four at √2.
        let p: Vec<Vec3<f32>> = (0..2500).map(|i| [(i % 50) as f32, (i / 50) as f32, 0.0]).collect();
        assert!((Rows::spacing(&p, 4096) - (4.0 + 2.0 * 2f32.sqrt()) / 6.0).abs() < 1e-5);
        assert_eq!(Rows::spacing(&[[1.0; 3]; 9], 100), 0.0);
        assert_eq!(Rows::spacing(&[[1.0; 3]], 100), 0.0);
        assert_eq!(Rows::spacing(&[], 100), 0.0);
        assert!(Rows::new(&[], 1.0).len() == 0);
    }
}
