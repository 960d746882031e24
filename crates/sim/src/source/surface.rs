//! Surface area without a surface mesh: `a = |∇φ| Δx` per node, `Σ a Δx² = area` (simulation.md §4.7).
//!
//! The measure itself is spread over five layers of nodes. It is given to the rim, the nodes that reach half filled and have a face
//! towards one that does not: a film that acts on a node below others takes their heat past them, and the design's rule (the
//! fullest neighbour) moves area sideways, towards the tops of curved bodies. On the rim, in proportion to the open faces seen
//! along the normal, a linear temperature in a plane at any angle is exact: what a node loses is what its missing links would carry.
//! A node of the rim shares its area, by mass, with the nodes outside that hold the last of the matter: these would otherwise learn only by
//! conduction what the surface loses, and be warmer than all below.

use rayon::prelude::*;

use crate::source::radiant::{CLEAR, CLEARANCE, STRIDE};
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

/// The filled fraction as the measure sees it: one from [`FULL`] on, and bent below. Straight up to the cut, the cut pushes the surface
/// outwards by 0.07 Δx (balls of 8 and 16 cells had 1 % too much area); bent so far that it does not push at all, curved surfaces
/// lose what the kernel takes off them (a ball of 6 cells 3 %). Half of it is within 0.5 % from 8 cells on.
#[inline(always)]
fn bent(phi: f64) -> f32 {
    const B: f64 = 0.26;
    const A: f64 = (1.0 - B * FULL * FULL) / FULL;
    if phi < FULL { (phi * (A + B * phi)) as f32 } else { 1.0 }
}

/// [`bent`] of a half-filled node, which lies on the surface.
const INSIDE: f32 = 0.5035;

/// Smoothed [`bent`] φ of a half space at depths from `DEPTHS_FROM` on in steps of a quarter \[node spacings\]: the kernel of the points,
/// the cut and the smoothing together. Means over planes along (100), (110), (111) and (210), which differ by up to 0.015.
const DEPTHS: [f32; 17] =
    [0.007, 0.018, 0.0393, 0.0754, 0.13, 0.2041, 0.2961, 0.4024, 0.5153, 0.6293, 0.7404, 0.8272, 0.8891, 0.9422, 0.974, 0.9909, 0.9976];
const DEPTHS_FROM: f32 = -2.0;

/// Depth under the surface \[node spacings\] at a value of the smoothed φ; negative outside.
fn depth(smooth: f32) -> f32 {
    let i = DEPTHS.partition_point(|v| *v <= smooth).clamp(1, DEPTHS.len() - 1);
    let (a, b) = (DEPTHS[i - 1], DEPTHS[i]);
    DEPTHS_FROM + 0.25 * ((i - 1) as f32 + ((smooth - a) / (b - a)).clamp(0.0, 1.0))
}

/// Scratch of the area measure.
#[derive(Clone, Debug, Default)]
pub(crate) struct SurfaceMeasure {
    phi: Vec<f32>,
    /// The filled fraction as it is.
    fill: Vec<f32>,
    smooth: Vec<f32>,
    other: Vec<f32>,
    gradient: Vec<f32>,
    /// Bits of the directions (−x, +x, −y, …) in which a node inside has a neighbour outside.
    rim: Vec<u8>,
    /// Dimensionless area per active node, in the network's order.
    pub(crate) area: Vec<f64>,
    /// The same with its outward direction, where some source asks for it.
    pub(crate) facing: Vec<[f64; 3]>,
    /// Depth of the nodes that have area under the surface \[node spacings\].
    pub(crate) depth: Vec<f64>,
    /// With `facing`: where on the surface that area lies, in grid coordinates.
    pub(crate) place: Vec<[f64; 3]>,
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

    /// Visits the nodes of the 3³ block around window coordinates `c`, in memory order.
    #[inline(always)]
    fn around(&self, lattice: &Lattice, c: [i64; 3], mut visit: impl FnMut(usize)) {
        if (0..3).all(|a| c[a] > 0 && c[a] + 1 < self.shape[a] as i64) {
            let at = (c[0] as usize * self.shape[1] + c[1] as usize) * self.shape[2] + c[2] as usize;
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
        self.place.clear();
        self.place.resize(self.facing.len(), [0.0; 3]);
        self.depth.clear();
        self.depth.resize(network.len(), 0.0);
        if network.len() == 0 {
            return;
        }
        let window = Window::new(lattice, touched);
        self.window = window;
        let cells = window.shape[0] * window.shape[1] * window.shape[2];
        for buffer in [&mut self.phi, &mut self.fill, &mut self.smooth, &mut self.other, &mut self.gradient] {
            buffer.clear();
            buffer.resize(cells, 0.0);
        }
        for slot in 0..network.len() {
            let node = network.node(slot);
            let c = std::array::from_fn(|a| node[a] as i64 - window.lo[a]);
            if let Some(i) = window.at(lattice, c) {
                self.phi[i] = bent(network.phi[slot]);
                self.fill[i] = network.phi[slot] as f32;
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
        self.find_rim(lattice, &window);
        for i in 0..cells {
            if self.gradient[i] > 0.0 {
                self.give(lattice, network, &window, walls, i);
            }
        }
        for (place, area) in self.place.iter_mut().zip(&self.area) {
            if *area > 0.0 {
                *place = place.map(|v| v / area);
            }
        }
    }

    fn find_rim(&mut self, lattice: &Lattice, window: &Window) {
        let Self { rim, phi, .. } = self;
        rim.clear();
        rim.resize(phi.len(), 0);
        rim.par_iter_mut().enumerate().with_min_len(4096).for_each(|(i, rim)| {
            if phi[i] < INSIDE {
                return;
            }
            let c = window.coordinates(i);
            for l in 0..6 {
                let mut n = c;
                n[l / 2] += if l % 2 == 1 { 1 } else { -1 };
                if window.at(lattice, n).is_none_or(|j| phi[j] < INSIDE) {
                    *rim |= 1 << l;
                }
            }
        });
    }

    /// Gives the area over window node `i` to the rim of the body next to it.
    fn give(&mut self, lattice: &Lattice, network: &Network, window: &Window, walls: Option<&[Wall]>, i: usize) {
        let here = window.coordinates(i);
        if let Some(walls) = walls
            && self.faces_wall(lattice, window, walls, here)
        {
            return;
        }
        let area = f64::from(self.gradient[i].sqrt());
        // Central differences over two spacings; outwards is downhill.
        let out = slope(&self.other, window, lattice, here).map(|g| -0.5 * g);
        let normal = out.map(|g| g / self.gradient[i].sqrt());
        // Straight to the surface, so that nothing moves sideways.
        let way = normal.map(|n| n * depth(self.other[i]));
        let foot = std::array::from_fn(|a| here[a] + way[a].round() as i64);
        let place = std::array::from_fn(|a| (here[a] + window.lo[a]) as f64 + f64::from(way[a]));
        let mut seen = [(0, 0.0f32); 27];
        let mut count = 0;
        let mut total = 0.0;
        window.around(lattice, foot, |j| {
            if self.rim[j] != 0 {
                let open = |l: usize| if self.rim[j] & 1 << l != 0 { if l % 2 == 1 { normal[l / 2] } else { -normal[l / 2] } } else { 0.0 };
                let weight = (0..6).map(|l| open(l).max(0.0)).sum::<f32>();
                if weight > 0.0 {
                    (seen[count], count) = ((j, weight), count + 1);
                    total += weight;
                }
            }
        });
        if count == 0 {
            let at = self.climb(lattice, window, i);
            self.add(network, at, area, out, place);
        }
        for &(j, weight) in &seen[..count] {
            // The node and those outside it; one that lies outside several of the rim is divided by the squares of the normal.
            let c = window.coordinates(j);
            let mut column = [(j, self.fill[j]); 7];
            let mut members = 1;
            for l in (0..6).filter(|l| self.rim[j] & 1 << l != 0) {
                let sign = if l % 2 == 1 { 1 } else { -1 };
                let open = normal[l / 2] * sign as f32;
                let mut n = c;
                n[l / 2] += sign;
                if open > 0.0
                    && let Some(o) = window.at(lattice, n)
                    && self.fill[o] > 0.0
                {
                    (column[members], members) = ((o, self.fill[o] * open * open), members + 1);
                }
            }
            let mass: f32 = column[..members].iter().map(|m| m.1).sum();
            for &(k, m) in &column[..members] {
                let share = weight / total * m / mass;
                self.add(network, k, area * f64::from(share), out.map(|v| v * share), place);
            }
        }
    }

    /// The fullest node uphill from window node `i`: threads and drops have no rim.
    fn climb(&self, lattice: &Lattice, window: &Window, i: usize) -> usize {
        let mut at = i;
        for _ in 0..CLIMB {
            if self.phi[at] >= INSIDE {
                break;
            }
            let c = window.coordinates(at);
            // Uphill in φ; beyond the last material the smoothed φ still shows the way.
            let climb = |field: &[f32]| {
                let mut best = at;
                window.around(lattice, c, |j| {
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
        at
    }

    /// Adds area, its direction and its place to the node at window node `at`, if it holds material.
    fn add(&mut self, network: &Network, at: usize, area: f64, out: [f32; 3], place: [f64; 3]) {
        let c = self.window.coordinates(at);
        let node = std::array::from_fn(|a| (c[a] + self.window.lo[a]) as usize);
        if self.phi[at] > 0.0 {
            for (slot, part) in network.parts(node) {
                self.area[slot] += area * part;
                self.depth[slot] = f64::from(depth(self.other[at]).max(0.0));
                if let Some(facing) = self.facing.get_mut(slot) {
                    *facing = std::array::from_fn(|a| facing[a] + f64::from(out[a]) * part);
                    self.place[slot] = std::array::from_fn(|a| self.place[slot][a] + area * part * place[a]);
                }
            }
        }
    }

    /// True if nothing stands between the place on a surface at grid coordinate `x` with the outward normal `out` and a light in
    /// the unit direction `toward`, `distance` node spacings away: neither material nor an obstacle.
    pub(crate) fn sees(
        &self,
        lattice: &Lattice,
        walls: Option<&[Wall]>,
        x: [f64; 3],
        out: [f64; 3],
        toward: [f64; 3],
        distance: f64,
    ) -> bool {
        let mut s = 0.0;
        while s < distance {
            let lift = CLEARANCE * (1.0 - s / CLEAR).max(0.0);
            let p: [f64; 3] = std::array::from_fn(|a| x[a] + s * toward[a] + lift * out[a]);
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
            if self.filled(lattice, p) > INSIDE {
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
