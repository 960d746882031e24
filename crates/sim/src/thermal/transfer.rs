//! Points to nodes and back (simulation.md §3.3, §3.4): stencils, a scatter whose sums do not depend on the number of
//! threads, gathers.
//!
//! Scatter: points are binned by their base node's x into slabs of [`SLAB`] node planes. A slab writes at most two planes
//! into its right neighbour, so all even slabs may run at once, then all odd ones; inside a slab points go in their given
//! order. The sums therefore have one fixed order.

use megas_math::bspline;
use rayon::prelude::*;

use crate::grid::Grid;

/// Node planes per slab; at least the two planes of overlap.
const SLAB: usize = 4;

/// Points per work item of the gathers and of the fixed-shape sums.
pub(crate) const CHUNK: usize = 4096;

/// The 27 nodes and weights of one point.
pub(crate) struct Stencil {
    /// Memory index of the nine z rows' plane and row, x slowest.
    rows: [usize; 9],
    /// z index of the three nodes of a row.
    z: [usize; 3],
    /// Weights per axis.
    w: [[f64; 3]; 3],
    /// Node position minus point position per axis, in node spacings.
    d: [[f64; 3]; 3],
}

/// How an axis ends, and the stencils near its ends.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Lattice {
    pub(crate) nodes: [usize; 3],
    pub(crate) periodic: [bool; 3],
}

impl Lattice {
    pub(crate) fn new(grid: &Grid, periodic: [bool; 3]) -> Self {
        Self { nodes: grid.nodes, periodic }
    }

    /// First node of the stencil along `axis` and the point's fraction in `[½, 3/2]`. Points outside the grid act on its
    /// nearest nodes, so that no energy is ever lost.
    #[inline(always)]
    fn base(&self, axis: usize, xi: f64) -> (i64, f64) {
        // Truncation corrected for negative values: the library's floor is a call on the baseline instruction set.
        let t = (xi - 0.5) as i64;
        let base = t - i64::from(t as f64 > xi - 0.5);
        if self.periodic[axis] {
            return (base, xi - base as f64);
        }
        let inside = base.clamp(0, self.nodes[axis] as i64 - 3);
        (inside, (xi - inside as f64).clamp(0.5, 1.5))
    }

    #[inline(always)]
    fn wrap(&self, axis: usize, i: i64) -> usize {
        if self.periodic[axis] { i.rem_euclid(self.nodes[axis] as i64) as usize } else { i as usize }
    }

    #[inline(always)]
    pub(crate) fn stencil(&self, xi: [f64; 3]) -> Stencil {
        let mut ids = [[0usize; 3]; 3];
        let mut w = [[0.0; 3]; 3];
        let mut d = [[0.0; 3]; 3];
        for a in 0..3 {
            let (base, f) = self.base(a, xi[a]);
            w[a] = bspline::weights(f);
            for o in 0..3 {
                ids[a][o] = self.wrap(a, base + o as i64);
                d[a][o] = o as f64 - f;
            }
        }
        let rows = std::array::from_fn(|r| (ids[0][r / 3] * self.nodes[1] + ids[1][r % 3]) * self.nodes[2]);
        Stencil { rows, z: ids[2], w, d }
    }

    /// Memory index of the neighbour of `node` one step along `axis`, if there is one.
    #[inline(always)]
    pub(crate) fn neighbour(&self, node: [usize; 3], axis: usize, forward: bool) -> Option<[usize; 3]> {
        let (n, i) = (self.nodes[axis], node[axis]);
        let moved = match (forward, self.periodic[axis] && n > 1) {
            (true, _) if i + 1 < n => i + 1,
            (true, true) => 0,
            (false, _) if i > 0 => i - 1,
            (false, true) => n - 1,
            _ => return None,
        };
        let mut out = node;
        out[axis] = moved;
        Some(out)
    }

    fn plane(&self) -> usize {
        self.nodes[1] * self.nodes[2]
    }
}

impl Stencil {
    /// The same nodes in an array that holds `layers` values per node, of which `layer` is meant.
    #[inline(always)]
    pub(crate) fn in_layer(mut self, layers: usize, layer: usize) -> Self {
        if layers > 1 {
            self.rows = self.rows.map(|r| r * layers + layer);
            self.z = self.z.map(|z| z * layers);
        }
        self
    }

    /// Visits the 27 nodes: `(memory index relative to first, weight, offset in node spacings)`.
    #[inline(always)]
    pub(crate) fn visit(&self, first: usize, mut f: impl FnMut(usize, f64, [f64; 3])) {
        for r in 0..9 {
            let wxy = self.w[0][r / 3] * self.w[1][r % 3];
            let row = self.rows[r] - first;
            for c in 0..3 {
                f(row + self.z[c], wxy * self.w[2][c], [self.d[0][r / 3], self.d[1][r % 3], self.d[2][c]]);
            }
        }
    }
}

/// Weighted sums over a stencil.
pub(crate) struct Gathered {
    /// `Σ w a`, `Σ w b`.
    pub(crate) value: [f64; 2],
    /// `Σ w b d`, d in node spacings.
    pub(crate) moment: [f64; 3],
}

impl Stencil {
    /// Gathers a pair of values per node.
    #[inline(always)]
    pub(crate) fn gather(&self, field: &[[f64; 2]]) -> Gathered {
        let mut out = Gathered { value: [0.0; 2], moment: [0.0; 3] };
        let wz = self.w[2];
        let wd = [wz[0] * self.d[2][0], wz[1] * self.d[2][1], wz[2] * self.d[2][2]];
        for r in 0..9 {
            let wxy = self.w[0][r / 3] * self.w[1][r % 3];
            let v: [[f64; 2]; 3] = std::array::from_fn(|c| field[self.rows[r] + self.z[c]]);
            let a = wz[0] * v[0][0] + wz[1] * v[1][0] + wz[2] * v[2][0];
            let b = wz[0] * v[0][1] + wz[1] * v[1][1] + wz[2] * v[2][1];
            out.value[0] += wxy * a;
            out.value[1] += wxy * b;
            out.moment[0] += wxy * self.d[0][r / 3] * b;
            out.moment[1] += wxy * self.d[1][r % 3] * b;
            out.moment[2] += wxy * (wd[0] * v[0][1] + wd[1] * v[1][1] + wd[2] * v[2][1]);
        }
        out
    }
}

/// The points that take part in the scatter, sorted into slabs.
#[derive(Clone, Debug, Default)]
pub(crate) struct Slabs {
    order: Vec<u32>,
    starts: Vec<u32>,
    width: usize,
    /// Points that carry mass but have no finite position; they are left alone.
    pub(crate) skipped: usize,
    /// First and one-past-last node touched, per axis.
    pub(crate) touched: [[usize; 2]; 3],
}

impl Slabs {
    /// Counting sort of the mass points by slab; stable.
    pub(crate) fn fill(&mut self, lattice: &Lattice, xi: &[[f64; 3]], mass: &[f32]) {
        let nx = lattice.nodes[0];
        self.width = if lattice.periodic[0] { nx } else { SLAB };
        let count = nx.div_ceil(self.width);
        self.starts.clear();
        self.starts.resize(count + 2, 0);
        self.skipped = 0;
        let (mut lo, mut hi) = ([i64::MAX; 3], [i64::MIN; 3]);
        let usable = |p: usize| mass[p] > 0.0 && xi[p].iter().all(|v| v.is_finite());
        let slab_of = |p: usize| if lattice.periodic[0] { 0 } else { lattice.base(0, xi[p][0]).0 as usize / SLAB };
        for p in 0..xi.len() {
            if usable(p) {
                self.starts[slab_of(p) + 2] += 1;
                for a in 0..3 {
                    let b = lattice.base(a, xi[p][a]).0;
                    lo[a] = lo[a].min(b);
                    hi[a] = hi[a].max(b + 3);
                }
            } else {
                self.skipped += usize::from(mass[p] > 0.0);
            }
        }
        for s in 2..self.starts.len() {
            self.starts[s] += self.starts[s - 1];
        }
        self.order.clear();
        self.order.resize(*self.starts.last().unwrap_or(&0) as usize, 0);
        for p in 0..xi.len() {
            if usable(p) {
                let slot = &mut self.starts[slab_of(p) + 1];
                self.order[*slot as usize] = p as u32;
                *slot += 1;
            }
        }
        self.touched = std::array::from_fn(|a| match (self.order.is_empty(), lattice.periodic[a]) {
            (true, _) => [0, 0],
            (false, true) => [0, lattice.nodes[a]],
            (false, false) => [lo[a] as usize, hi[a] as usize],
        });
    }

    /// Runs `kernel(nodes, first, point)` for every mass point, where `nodes` is the part of the array that starts at node
    /// `first` (with `stride` values per node). The order of the additions into a node is fixed.
    pub(crate) fn scatter<T: Send>(
        &self,
        lattice: &Lattice,
        nodes: &mut [T],
        stride: usize,
        kernel: impl Fn(&mut [T], usize, usize) + Sync,
    ) {
        let slab = self.width * lattice.plane();
        for parity in 0..2 {
            let skip = (parity * slab * stride).min(nodes.len());
            nodes[skip..].par_chunks_mut(2 * slab * stride).enumerate().for_each(|(c, part)| {
                let s = 2 * c + parity;
                if s + 1 < self.starts.len() {
                    for &p in &self.order[self.starts[s] as usize..self.starts[s + 1] as usize] {
                        kernel(part, s * slab, p as usize);
                    }
                }
            });
        }
    }
}

/// Sum over points of `term(p)` in a fixed order; `partial` is scratch.
pub(crate) fn fixed_sum(count: usize, partial: &mut Vec<f64>, term: impl Fn(usize) -> f64 + Sync) -> f64 {
    partial.clear();
    partial.resize(count.div_ceil(CHUNK), 0.0);
    partial.par_iter_mut().enumerate().for_each(|(c, sum)| {
        *sum = (c * CHUNK..((c + 1) * CHUNK).min(count)).map(&term).sum();
    });
    partial.iter().sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use megas_math::rng::Rng;

    #[test]
    fn scatter_conserves_and_does_not_depend_on_threads() {
        let lattice = Lattice { nodes: [23, 9, 11], periodic: [false; 3] };
        let mut rng = Rng::new(3);
        let xi: Vec<[f64; 3]> = (0..2000).map(|_| [rng.range(-1.0, 24.0), rng.range(1.0, 7.0), rng.range(1.0, 9.0)]).collect();
        let mass: Vec<f32> = (0..2000).map(|i| if i % 7 == 0 { 0.0 } else { 1.0 + (i % 5) as f32 }).collect();
        let run = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a thread pool");
            pool.install(|| {
                let mut slabs = Slabs::default();
                slabs.fill(&lattice, &xi, &mass);
                let mut nodes = vec![0.0f64; 23 * 9 * 11];
                slabs.scatter(&lattice, &mut nodes, 1, |part, first, p| {
                    lattice.stencil(xi[p]).visit(first, |n, w, _| part[n] += w * f64::from(mass[p]));
                });
                nodes
            })
        };
        let one = run(1);
        let total: f64 = mass.iter().map(|m| f64::from(*m)).sum();
        assert!((one.iter().sum::<f64>() - total).abs() < 1e-9 * total);
        assert_eq!(one, run(2));
        assert_eq!(one, run(3));
    }
}
