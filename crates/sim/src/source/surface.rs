//! Surface area without a surface mesh: `a = |∇φ| Δx` per node, `Σ a Δx² = area` (simulation.md §4.7).

use rayon::prelude::*;

use crate::source::radiant::STRIDE;
use crate::thermal::Wall;
use crate::thermal::network::Network;
use crate::thermal::transfer::Lattice;

/// Layers around the touched nodes in which the smoothed gradient can be non-zero.
const MARGIN: usize = 2;

/// How far an area that lies over (nearly) empty nodes climbs towards material.
const CLIMB: usize = 3;

/// Filled fraction that counts as the inside. Points are never spread evenly, and without the cut every fluctuation of φ
/// inside a body would count as surface (2 % of the area of a ball of 16 cells, growing with its size).
const FULL: f64 = 0.9;

/// Scratch of the area measure.
#[derive(Clone, Debug, Default)]
pub(crate) struct SurfaceMeasure {
    phi: Vec<f32>,
    smooth: Vec<f32>,
    other: Vec<f32>,
    gradient: Vec<f32>,
    /// Dimensionless area per active node, in the network's order.
    pub(crate) area: Vec<f64>,
    /// The same with its outward direction, where some source asks for it.
    pub(crate) facing: Vec<[f64; 3]>,
    window: Window,
}

/// A box of nodes around the touched ones; `shape` nodes from `lo`. Axes that wrap are taken whole.
#[derive(Clone, Copy, Debug, Default)]
struct Window {
    lo: [i64; 3],
    shape: [usize; 3],
}

impl Window {
    fn new(lattice: &Lattice, touched: &[[usize; 2]; 3]) -> Self {
        let mut w = Self { lo: [0; 3], shape: [0; 3] };
        for a in 0..3 {
            // Where the axis does not wrap the window may stick out of the grid: there is no material out there.
            let margin = if lattice.periodic[a] { 0 } else { MARGIN + 1 };
            w.lo[a] = touched[a][0] as i64 - margin as i64;
            w.shape[a] = touched[a][1] - touched[a][0] + 2 * margin;
        }
        w
    }

    /// Window index of window coordinates, wrapping on periodic axes; `None` outside.
    #[inline(always)]
    fn at(&self, lattice: &Lattice, c: [i64; 3]) -> Option<usize> {
        let mut out = 0;
        for a in 0..3 {
            let n = self.shape[a] as i64;
            let i = if lattice.periodic[a] { c[a].rem_euclid(n) } else { c[a] };
            if i < 0 || i >= n {
                return None;
            }
            out = out * self.shape[a] + i as usize;
        }
        Some(out)
    }

    /// Visits the nodes of the 3³ block around window node `at` with coordinates `c`, in memory order.
    #[inline(always)]
    fn around(&self, lattice: &Lattice, c: [i64; 3], at: usize, mut visit: impl FnMut(usize)) {
        if (0..3).all(|a| c[a] > 0 && c[a] + 1 < self.shape[a] as i64) {
            let (row, plane) = (self.shape[2], self.shape[1] * self.shape[2]);
            for x in [at - plane, at, at + plane] {
                for y in [x - row, x, x + row] {
                    for z in [y - 1, y, y + 1] {
                        visit(z);
                    }
                }
            }
            return;
        }
        for n in 0..27i64 {
            if let Some(j) = self.at(lattice, [c[0] + n / 9 - 1, c[1] + n / 3 % 3 - 1, c[2] + n % 3 - 1]) {
                visit(j);
            }
        }
    }

    fn coordinates(&self, index: usize) -> [i64; 3] {
        let k = index % self.shape[2];
        let ij = index / self.shape[2];
        [(ij / self.shape[1]) as i64, (ij % self.shape[1]) as i64, k as i64]
    }
}

/// `out[i] = f(in[i−1], in[i], in[i+1])` along one axis; zero beyond the window, wrapping on periodic axes.
fn along(window: &Window, periodic: [bool; 3], axis: usize, input: &[f32], out: &mut [f32], f: impl Fn(f32, f32, f32) -> f32 + Sync) {
    let [nx, ny, nz] = window.shape;
    let n = window.shape[axis];
    let stride = [ny * nz, nz, 1][axis];
    let before = |i: usize, at: usize| match (i > 0, periodic[axis]) {
        (true, _) => input[at - stride],
        (false, true) => input[at + (n - 1) * stride],
        (false, false) => 0.0,
    };
    let after = |i: usize, at: usize| match (i + 1 < n, periodic[axis]) {
        (true, _) => input[at + stride],
        (false, true) => input[at - (n - 1) * stride],
        (false, false) => 0.0,
    };
    debug_assert_eq!(input.len(), nx * ny * nz);
    out.par_chunks_mut(nz).enumerate().for_each(|(row, line)| {
        let first = row * nz;
        if axis == 2 {
            for (k, v) in line.iter_mut().enumerate() {
                *v = f(before(k, first + k), input[first + k], after(k, first + k));
            }
        } else {
            let i = if axis == 0 { row / ny } else { row % ny };
            for (k, v) in line.iter_mut().enumerate() {
                *v = f(before(i, first + k), input[first + k], after(i, first + k));
            }
        }
    });
}

/// Difference of `field` across two spacings at window node `c`, per axis.
fn slope(field: &[f32], window: &Window, lattice: &Lattice, c: [i64; 3]) -> [f32; 3] {
    let value = |d: [i64; 3]| window.at(lattice, std::array::from_fn(|a| c[a] + d[a])).map_or(0.0, |i| field[i]);
    [value([1, 0, 0]) - value([-1, 0, 0]), value([0, 1, 0]) - value([0, -1, 0]), value([0, 0, 1]) - value([0, 0, -1])]
}

impl SurfaceMeasure {
    /// Computes [`SurfaceMeasure::area`] for the nodes of `network`. Surface that faces a wall is not exposed and counts
    /// as zero. With `facing` the directions are kept as well.
    pub(crate) fn compute(
        &mut self,
        lattice: &Lattice,
        network: &Network,
        touched: &[[usize; 2]; 3],
        walls: Option<&[Wall]>,
        facing: bool,
    ) {
        self.area.clear();
        self.area.resize(network.len(), 0.0);
        self.facing.clear();
        self.facing.resize(if facing { network.len() } else { 0 }, [0.0; 3]);
        if network.len() == 0 {
            return;
        }
        let window = Window::new(lattice, touched);
        self.window = window;
        let cells = window.shape[0] * window.shape[1] * window.shape[2];
        for buffer in [&mut self.phi, &mut self.smooth, &mut self.other, &mut self.gradient] {
            buffer.clear();
            buffer.resize(cells, 0.0);
        }
        for slot in 0..network.len() {
            let node = network.node(slot);
            let c = std::array::from_fn(|a| node[a] as i64 - window.lo[a]);
            if let Some(i) = window.at(lattice, c) {
                self.phi[i] = (network.phi[slot] / FULL).min(1.0) as f32;
            }
        }
        let p = lattice.periodic;
        let blur = |a: f32, b: f32, c: f32| 0.25 * (a + c) + 0.5 * b;
        along(&window, p, 0, &self.phi, &mut self.other, blur);
        along(&window, p, 1, &self.other, &mut self.smooth, blur);
        along(&window, p, 2, &self.smooth, &mut self.other, blur);
        // `gradient` collects the squared length; the direction is needed only where walls may hide the surface.
        for axis in 0..3 {
            along(&window, p, axis, &self.other, &mut self.smooth, |a, _, c| 0.5 * (c - a));
            self.gradient.par_iter_mut().zip(&self.smooth).for_each(|(g, d)| *g += d * d);
        }
        for i in 0..cells {
            if self.gradient[i] > 0.0 {
                self.give(lattice, network, &window, walls, i);
            }
        }
    }

    /// Gives the area over window node `i` to a node that holds enough material.
    fn give(&mut self, lattice: &Lattice, network: &Network, window: &Window, walls: Option<&[Wall]>, i: usize) {
        let here = window.coordinates(i);
        if let Some(walls) = walls
            && self.faces_wall(lattice, window, walls, here)
        {
            return;
        }
        let mut at = i;
        for _ in 0..CLIMB {
            if self.phi[at] >= 0.5 {
                break;
            }
            let c = window.coordinates(at);
            // Uphill in φ; beyond the last material the smoothed φ still shows the way.
            let climb = |field: &[f32]| {
                let mut best = at;
                window.around(lattice, c, at, |j| {
                    if field[j] > field[best] {
                        best = j;
                    }
                });
                best
            };
            let mut best = climb(&self.phi);
            if best == at && self.phi[at] == 0.0 {
                best = climb(&self.other);
            }
            if best == at {
                break;
            }
            at = best;
        }
        let c = window.coordinates(at);
        let node = std::array::from_fn(|a| (c[a] + window.lo[a]) as usize);
        if self.phi[at] > 0.0
            && let Some(slot) = network.slot_of(node)
        {
            self.area[slot] += f64::from(self.gradient[i].sqrt());
            if let Some(facing) = self.facing.get_mut(slot) {
                let g = slope(&self.other, window, lattice, here);
                // Central differences over two spacings; outwards is downhill.
                *facing = std::array::from_fn(|a| facing[a] - 0.5 * f64::from(g[a]));
            }
        }
    }

    /// True if nothing stands between a place above a surface at grid coordinate `x` and a light in the unit direction `toward`,
    /// `distance` node spacings away: neither material nor an obstacle.
    pub(crate) fn sees(&self, lattice: &Lattice, walls: Option<&[Wall]>, x: [f64; 3], toward: [f64; 3], distance: f64) -> bool {
        let mut s = 0.0;
        while s < distance {
            let p: [f64; 3] = std::array::from_fn(|a| x[a] + s * toward[a]);
            let outside = |a: usize| !lattice.periodic[a] && (p[a] < 0.0 || p[a] > (lattice.nodes[a] - 1) as f64);
            if (0..3).any(outside) || s > 4.0 * lattice.nodes.iter().sum::<usize>() as f64 {
                return true;
            }
            if let Some(walls) = walls {
                let index = (0..3).fold(0, |index, a| {
                    let i = (p[a].round() as i64).rem_euclid(lattice.nodes[a] as i64);
                    index * lattice.nodes[a] + i as usize
                });
                if walls[index] != Wall::Open {
                    return false;
                }
            }
            if self.filled(lattice, p) > 0.5 {
                return false;
            }
            s += STRIDE;
        }
        true
    }

    /// Filled fraction between the nodes.
    fn filled(&self, lattice: &Lattice, p: [f64; 3]) -> f32 {
        let cell = p.map(|v| v.floor());
        let f: [f32; 3] = std::array::from_fn(|a| (p[a] - cell[a]) as f32);
        let base: [i64; 3] = std::array::from_fn(|a| cell[a] as i64 - self.window.lo[a]);
        let mut sum = 0.0;
        for n in 0..8i64 {
            let o = [n / 4, n / 2 % 2, n % 2];
            if let Some(i) = self.window.at(lattice, std::array::from_fn(|a| base[a] + o[a])) {
                let w = |a: usize| if o[a] == 1 { f[a] } else { 1.0 - f[a] };
                sum += w(0) * w(1) * w(2) * self.phi[i];
            }
        }
        sum
    }

    /// True where the outward side of the surface near window node `c` is a wall node.
    fn faces_wall(&self, lattice: &Lattice, window: &Window, walls: &[Wall], c: [i64; 3]) -> bool {
        let g = slope(&self.other, window, lattice, c);
        let norm = g.iter().map(|v| v * v).sum::<f32>().sqrt();
        if norm <= 0.0 {
            return false;
        }
        let mut index = 0;
        for a in 0..3 {
            let n = lattice.nodes[a] as i64;
            let i = c[a] + window.lo[a] - (1.5 * g[a] / norm).round() as i64;
            let i = if lattice.periodic[a] { i.rem_euclid(n) } else { i.clamp(0, n - 1) };
            index = index * lattice.nodes[a] + i as usize;
        }
        walls[index] != Wall::Open
    }
}
