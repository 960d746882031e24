//! Axis-parallel rays of a whole grid at once (splatting.md §6.4).
//!
//! Along a ray parallel to axis k the response of a Gaussian equals its two-dimensional marginal over the other axes, and
//! the place of the maximum is the conditional mean. All ±k rays of the points in one grid column therefore share one
//! list of hits: sort it once, then accumulate it once from each end.
//!
//! Nothing stops at low transmittance here: the recurrences `A_i = α_i + (1−α_i) A_{i+1}` give every gap of the column
//! exactly, at the cost of one step per hit.

use megas_math::Real;
use rayon::prelude::*;

use super::shell::{ALPHA_MAX, ALPHA_MIN};
use super::{Cap, Grid, Shell};

/// The two rays of one grid point along one axis.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Pair<T> {
    /// Accumulated alpha of the ray towards +k.
    pub alpha_up: T,
    /// `N·d` of the ray towards +k: positive where outward normals agree with the direction of travel.
    pub facing_up: T,
    /// Accumulated alpha of the ray towards −k.
    pub alpha_down: T,
    /// `N·d` of the ray towards −k.
    pub facing_down: T,
}

/// One Gaussian as the rays along one axis see it.
#[derive(Clone, Copy)]
struct Marginal<T> {
    mean: [T; 3],
    /// Inverse of the 2×2 marginal covariance: aa, ab, bb.
    inverse: [T; 3],
    /// `Σ_k⊥ (Σ_⊥⊥)⁻¹`.
    slope: [T; 2],
    reach2: T,
    opacity: T,
    normal: T,
    /// Rows `first..last` of the grid that it touches.
    rows: (u32, u32),
}

/// Axes `(k, a, b)`: rays run along k, a row of columns along a, rows are stacked along b.
const fn axes(k: usize) -> (usize, usize) {
    match k {
        0 => (1, 2),
        1 => (0, 2),
        _ => (0, 1),
    }
}

/// One Gaussian met by a column.
#[derive(Clone, Copy)]
struct Hit<T> {
    /// Coordinate along the column of the closest approach.
    t: T,
    /// Opacity there.
    alpha: T,
    /// Component of the outward normal along the column.
    normal: T,
}

/// Casts the rays of every grid point along ±`axis` (0–2) and returns `visit(point index, rays)` for each, in the order
/// of the grid. The cap takes part in the vertical rays.
pub fn cast_axis<T: Real, V: Copy + Default + Send + Sync>(
    shell: &Shell<T>,
    grid: &Grid,
    axis: usize,
    cap: Option<&Cap>,
    visit: impl Fn(usize, Pair<T>) -> V + Sync,
) -> Vec<V> {
    let (a, b) = axes(axis);
    let order = by_depth(shell, axis);
    let marginals: Vec<Marginal<T>> = order.par_iter().map(|&i| marginal(shell, i, grid, (axis, a, b))).collect();
    let (start, list) = rows_of(&marginals, grid.dims[b]);

    let [nx, ny, nz] = grid.dims;
    let slab = grid.dims[axis] * grid.dims[a];
    let mut out = vec![V::default(); grid.len()];
    // A slab holds one row of columns. For rays along x and y it is a z-layer of the grid; for rays along z it is a layer
    // of constant y, stored [z][x], and goes to its place afterwards.
    let (step_k, step_a) = if axis == 0 { (1, nx) } else { (nx, 1) };
    let point = |row: usize, i_k: usize, i_a: usize| {
        let mut c = [0; 3];
        (c[axis], c[a], c[b]) = (i_k, i_a, row);
        grid.index(c)
    };
    out.par_chunks_mut(slab).enumerate().for_each_init(RowScratch::default, |scratch, (row, values)| {
        scratch.collect(&marginals, &list[start[row]..start[row + 1]], grid, (axis, a, b), row, cap);
        for i_a in 0..grid.dims[a] {
            scratch.sort_column(i_a);
            scratch.accumulate();
            let (hits, up, down) = (&scratch.column, &scratch.up, &scratch.down);
            let mut gap = 0;
            for i_k in 0..grid.dims[axis] {
                let s = T::of(grid.coordinate(axis, i_k));
                while gap < hits.len() && hits[gap].t <= s {
                    gap += 1;
                }
                // A hit exactly at the point belongs to neither ray.
                let mut below = gap;
                while below > 0 && hits[below - 1].t >= s {
                    below -= 1;
                }
                let pair = Pair { alpha_up: up[gap][0], facing_up: up[gap][1], alpha_down: down[below][0], facing_down: -down[below][1] };
                values[i_k * step_k + i_a * step_a] = visit(point(row, i_k, i_a), pair);
            }
        }
    });
    if axis < 2 {
        return out;
    }
    let mut sorted = vec![V::default(); grid.len()];
    sorted.par_chunks_mut(nx * ny).enumerate().for_each(|(z, layer)| {
        for (y, line) in layer.chunks_exact_mut(nx).enumerate() {
            let from = (y * nz + z) * nx;
            line.copy_from_slice(&out[from..from + nx]);
        }
    });
    sorted
}

/// All Gaussians by the coordinate of their centres along `axis`.
fn by_depth<T: Real>(shell: &Shell<T>, axis: usize) -> Vec<u32> {
    let mut order: Vec<u32> = (0..shell.len() as u32).collect();
    order.sort_by(|&p, &q| {
        let (x, y) = (shell.mean[p as usize][axis], shell.mean[q as usize][axis]);
        x.partial_cmp(&y).unwrap_or(std::cmp::Ordering::Equal)
    });
    order
}

fn marginal<T: Real>(shell: &Shell<T>, item: u32, grid: &Grid, (k, a, b): (usize, usize, usize)) -> Marginal<T> {
    let i = item as usize;
    let (m, c) = (shell.mean[i], shell.covariance[i]);
    let det = c[a][a] * c[b][b] - c[a][b] * c[a][b];
    let inverse = [c[b][b] / det, -c[a][b] / det, c[a][a] / det];
    let slope = [c[k][a] * inverse[0] + c[k][b] * inverse[1], c[k][a] * inverse[1] + c[k][b] * inverse[2]];
    let reach2 = shell.reach2(i);
    let half = (reach2 * c[b][b]).sqrt().f64();
    let rows = if det > T::zero() && half.is_finite() { range(grid, b, m[b].f64(), half) } else { (0, 0) };
    Marginal { mean: [m[k], m[a], m[b]], inverse, slope, reach2, opacity: shell.opacity[i], normal: shell.normal[i][k], rows }
}

/// Cells `first..last` along `axis` whose centres lie within `half` of `mid`.
#[inline(always)]
fn range(grid: &Grid, axis: usize, mid: f64, half: f64) -> (u32, u32) {
    let at = |v: f64| (v - grid.origin[axis]) / grid.spacing - 0.5;
    let n = grid.dims[axis] as f64;
    let first = at(mid - half).ceil().clamp(0.0, n);
    let last = (at(mid + half).floor() + 1.0).clamp(0.0, n);
    (first as u32, last.max(first) as u32)
}

/// Which Gaussians touch which row: offsets and list, ascending within a row.
fn rows_of<T>(marginals: &[Marginal<T>], rows: usize) -> (Vec<usize>, Vec<u32>) {
    let mut start = vec![0usize; rows + 1];
    for m in marginals {
        for r in m.rows.0..m.rows.1 {
            start[r as usize + 1] += 1;
        }
    }
    for r in 0..rows {
        start[r + 1] += start[r];
    }
    let mut list = vec![0u32; start[rows]];
    let mut next = start.clone();
    for (i, m) in marginals.iter().enumerate() {
        for r in m.rows.0..m.rows.1 {
            list[next[r as usize]] = i as u32;
            next[r as usize] += 1;
        }
    }
    (start, list)
}

/// Working memory of one row of columns.
struct RowScratch<T> {
    found: Vec<Hit<T>>,
    found_column: Vec<u32>,
    start: Vec<u32>,
    sorted: Vec<Hit<T>>,
    column: Vec<Hit<T>>,
    up: Vec<[T; 2]>,
    down: Vec<[T; 2]>,
}

impl<T> Default for RowScratch<T> {
    fn default() -> Self {
        Self {
            found: Vec::new(),
            found_column: Vec::new(),
            start: Vec::new(),
            sorted: Vec::new(),
            column: Vec::new(),
            up: Vec::new(),
            down: Vec::new(),
        }
    }
}

impl<T: Real> RowScratch<T> {
    /// Gathers the hits of all columns of a row and groups them by column.
    fn collect(
        &mut self,
        marginals: &[Marginal<T>],
        list: &[u32],
        grid: &Grid,
        (k, a, b): (usize, usize, usize),
        row: usize,
        cap: Option<&Cap>,
    ) {
        self.found.clear();
        self.found_column.clear();
        let (half, alpha_min, alpha_max) = (T::of(-0.5), T::of(ALPHA_MIN), T::of(ALPHA_MAX));
        let (first_a, spacing) = (T::of(grid.coordinate(a, 0)), T::of(grid.spacing));
        let y_b = T::of(grid.coordinate(b, row));
        for &i in list {
            let m = &marginals[i as usize];
            let dy = y_b - m.mean[2];
            // Along the row the ellipse D² ≤ reach² is an interval around the conditional mean.
            let mid = -m.inverse[1] / m.inverse[0] * dy;
            let rest = m.reach2 - dy * dy * (m.inverse[2] - m.inverse[1] * m.inverse[1] / m.inverse[0]);
            if rest < T::zero() || rest.is_nan() {
                continue;
            }
            let (lo, hi) = range(grid, a, (m.mean[1] + mid).f64(), (rest / m.inverse[0]).sqrt().f64());
            for column in lo..hi {
                let dx = first_a + T::of(f64::from(column)) * spacing - m.mean[1];
                let d2 = dx * (m.inverse[0] * dx + m.inverse[1] * (dy + dy)) + m.inverse[2] * dy * dy;
                let alpha = (m.opacity * (half * d2).exp()).min(alpha_max);
                if alpha >= alpha_min {
                    let t = m.mean[0] + m.slope[0] * dx + m.slope[1] * dy;
                    self.found.push(Hit { t, alpha, normal: m.normal });
                    self.found_column.push(column);
                }
            }
        }
        if let (2, Some(cap)) = (k, cap) {
            for column in 0..grid.dims[a] {
                if cap.covers(grid.coordinate(a, column), grid.coordinate(b, row)) {
                    self.found.push(Hit { t: T::of(cap.height), alpha: T::one(), normal: -T::one() });
                    self.found_column.push(column as u32);
                }
            }
        }
        self.group(grid.dims[a]);
    }

    fn group(&mut self, columns: usize) {
        self.start.clear();
        self.start.resize(columns + 1, 0);
        for &c in &self.found_column {
            self.start[c as usize + 1] += 1;
        }
        for c in 0..columns {
            self.start[c + 1] += self.start[c];
        }
        self.sorted.clear();
        self.sorted.resize(self.found.len(), Hit { t: T::zero(), alpha: T::zero(), normal: T::zero() });
        for (h, &c) in self.found.iter().zip(&self.found_column) {
            // `start[c]` runs ahead while filling and ends where column c + 1 begins.
            self.sorted[self.start[c as usize] as usize] = *h;
            self.start[c as usize] += 1;
        }
    }

    /// Brings the hits of one column into order.
    fn sort_column(&mut self, column: usize) {
        let first = if column == 0 { 0 } else { self.start[column - 1] as usize };
        let hits = &self.sorted[first..self.start[column] as usize];
        self.column.clear();
        self.column.extend_from_slice(hits);
        // Gaussians arrive by the depth of their centres, so that their hits are nearly sorted: insertion wins.
        for i in 1..self.column.len() {
            let h = self.column[i];
            let mut j = i;
            while j > 0 && self.column[j - 1].t > h.t {
                self.column[j] = self.column[j - 1];
                j -= 1;
            }
            self.column[j] = h;
        }
    }

    /// Accumulates the sorted column from both ends: `up[g]` blends the hits `g..`, `down[g]` the hits `..g` from the
    /// nearest to the farthest.
    fn accumulate(&mut self) {
        let n = self.column.len();
        let zero = [T::zero(); 2];
        self.up.clear();
        self.up.resize(n + 1, zero);
        self.down.clear();
        self.down.resize(n + 1, zero);
        for i in 0..n {
            self.down[i + 1] = over(&self.column[i], self.down[i]);
            let j = n - 1 - i;
            self.up[j] = over(&self.column[j], self.up[j + 1]);
        }
    }
}

/// One hit in front of what lies behind it.
#[inline(always)]
fn over<T: Real>(hit: &Hit<T>, behind: [T; 2]) -> [T; 2] {
    let t = T::one() - hit.alpha;
    [hit.alpha + t * behind[0], hit.alpha * hit.normal + t * behind[1]]
}
