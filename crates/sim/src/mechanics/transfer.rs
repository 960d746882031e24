//! P2G and G2P of one point at a time across the lanes of its nodes (simulation.md §2.1, §2.2, §2.4).
//!
//! Four nodes along z with four values each (velocity or momentum, and mass) are one 16-lane vector; a stencil is nine of
//! them, the fourth node with weight 0. Points of one cell follow each other, so the nine vectors stay in registers:
//! gathering loads them once per cell, scattering adds them to memory once per cell.

use fearless_simd::{Simd, SimdBase, SimdFloat, SimdSplit, f32x4, f32x16};
use megas_math::simd::each3;
use megas_math::simd::transpose::Record;
use megas_math::vec3;

/// Nodes per axis of a tile: a block, one node of stencil and one of drift on each side.
pub(crate) const TILE: usize = 8;
/// Values of a tile, with room for the unused fourth node of the last stencil row.
pub(crate) const TILE_LEN: usize = TILE * TILE * TILE * 4 + 16;
/// First node of a tile relative to the first node of its block.
pub(crate) const TILE_ORIGIN: u32 = 2;
/// Points handled together.
pub(crate) const CHUNK: usize = 16;

/// Node values of a block and its surroundings, `[x, y, z, mass]` per node, z fastest.
#[derive(Clone)]
#[repr(C, align(64))]
pub(crate) struct Tile(pub [f32; TILE_LEN]);

impl Tile {
    pub const ZERO: Self = Self([0.0; TILE_LEN]);
}

/// Stencils of a chunk of points: per axis the three weights `w`, the weights times distance `w (k − 1 − g)` in node spacings
/// (x and y), the offset along z, and the first node of the stencil in the tile.
#[repr(C, align(64))]
pub(crate) struct Stencils {
    pub wx: [[f32; CHUNK]; 3],
    pub dx: [[f32; CHUNK]; 3],
    pub wy: [[f32; CHUNK]; 3],
    pub dy: [[f32; CHUNK]; 3],
    pub gz: [f32; CHUNK],
    pub first: [u32; CHUNK],
}

impl Stencils {
    pub const ZERO: Self = Self {
        wx: [[0.0; CHUNK]; 3],
        dx: [[0.0; CHUNK]; 3],
        wy: [[0.0; CHUNK]; 3],
        dy: [[0.0; CHUNK]; 3],
        gz: [0.0; CHUNK],
        first: [0; CHUNK],
    };
}

/// Coefficients of the z weights per lane: `w = (c2 g + c1) g + c0`, and the node offset of the lane.
struct AxisZ<S: Simd> {
    c0: f32x16<S>,
    c1: f32x16<S>,
    c2: f32x16<S>,
    node: f32x16<S>,
}

impl<S: Simd> AxisZ<S> {
    #[inline(always)]
    fn new(s: S) -> Self {
        const fn lanes(v: [f32; 4]) -> [f32; 16] {
            let mut out = [0.0; 16];
            let mut i = 0;
            while i < 16 {
                out[i] = v[i / 4];
                i += 1;
            }
            out
        }
        const C0: [f32; 16] = lanes([0.125, 0.75, 0.125, 0.0]);
        const C1: [f32; 16] = lanes([-0.5, 0.0, 0.5, 0.0]);
        const C2: [f32; 16] = lanes([0.5, -1.0, 0.5, 0.0]);
        const NODE: [f32; 16] = lanes([-1.0, 0.0, 1.0, 2.0]);
        Self {
            c0: f32x16::from_slice(s, &C0),
            c1: f32x16::from_slice(s, &C1),
            c2: f32x16::from_slice(s, &C2),
            node: f32x16::from_slice(s, &NODE),
        }
    }

    /// Weight and distance of the four nodes.
    #[inline(always)]
    fn at(&self, g: f32x16<S>) -> (f32x16<S>, f32x16<S>) {
        (self.c2.mul_add(g, self.c1).mul_add(g, self.c0), self.node - g)
    }
}

/// Weights of the three nodes along an axis around a point at offset `g` from the middle one, in the
/// form whose rounding the lanes share.
#[inline(always)]
pub(crate) fn weights(g: f32) -> [f32; 3] {
    [0.5 * (0.5 - g) * (0.5 - g), 0.75 - g * g, 0.5 * (0.5 + g) * (0.5 + g)]
}

#[inline(always)]
pub(crate) fn row(first: u32, i: usize, j: usize) -> usize {
    (first as usize + (i * TILE + j) * TILE) * 4
}

/// Sum of the four nodes of a row vector.
#[inline(always)]
fn sum_nodes<S: Simd>(v: f32x16<S>) -> f32x4<S> {
    let (lo, hi) = v.split();
    let (a, b) = (lo + hi).split();
    a + b
}

/// G2P of the first `count` points: record `[v, Σ w m, Σ w d_x v, ·, Σ w d_y v, ·, Σ w d_z v, ·]` with distances in node
/// spacings.
#[inline(always)]
pub(crate) fn gather<S: Simd>(s: S, tile: &Tile, st: &Stencils, count: usize, out: &mut [Record; CHUNK]) {
    let z = AxisZ::new(s);
    let splat = |v: f32| f32x16::splat(s, v);
    let zero = splat(0.0);
    let mut rows = [[zero; 3]; 3];
    let mut last = u32::MAX;
    for p in 0..count.min(CHUNK) {
        let first = st.first[p];
        if first != last {
            last = first;
            for i in 0..3 {
                for j in 0..3 {
                    let o = row(first, i, j);
                    rows[i][j] = f32x16::from_slice(s, &tile.0[o..o + 16]);
                }
            }
        }
        let (wz, dz) = z.at(splat(st.gz[p]));
        let wy = each3(|j| splat(st.wy[j][p]));
        let dy = each3(|j| splat(st.dy[j][p]));
        let (mut v, mut vx, mut vy) = (zero, zero, zero);
        for i in 0..3 {
            let plain = rows[i][2].mul_add(wy[2], rows[i][1].mul_add(wy[1], rows[i][0] * wy[0]));
            let lever = rows[i][2].mul_add(dy[2], rows[i][1].mul_add(dy[1], rows[i][0] * dy[0]));
            let wx = splat(st.wx[i][p]);
            v = plain.mul_add(wx, v);
            vx = plain.mul_add(splat(st.dx[i][p]), vx);
            vy = lever.mul_add(wx, vy);
        }
        let v = v * wz;
        let record = &mut out[p].0;
        sum_nodes(v).store_slice(&mut record[0..4]);
        sum_nodes(vx * wz).store_slice(&mut record[4..8]);
        sum_nodes(vy * wz).store_slice(&mut record[8..12]);
        sum_nodes(v * dz).store_slice(&mut record[12..16]);
    }
}

/// Share of a tracer's stencil without matter beyond which nothing carries it any more.
const LOST: f32 = 0.98;
/// Mass at a tracer, in that of the heaviest node of its stencil, from which on it follows the nodes by their weights, and up to which
/// it follows them by their mass. At a flat surface it is a half.
const NEAR: f32 = 0.35;
const FAR: f32 = 0.2;

/// Completes the G2P record of a tracer whose stencil reaches beyond the matter: empty nodes take the mean velocity of the
/// others, as if the weights were renormalised. (Mass points never meet empty nodes.) Without this the skin lags behind the
/// body it lies on. Farther out the nodes have hardly any mass, and what forces make of their velocities is noise that no point
/// with mass feels: there the velocities give way to their mean by mass, or the skin would climb off the body in strands.
///
/// Returns true where there is no matter to follow. `node` gives `[v, m]` of a node by its place in the tile.
pub(crate) fn complete_tracer<'a>(node: impl Fn(usize) -> &'a [f32], st: &Stencils, p: usize, record: &mut Record) -> bool {
    let g = st.gz[p];
    let wz = weights(g);
    // Σ w, Σ w d_x, Σ w d_y, Σ w d_z over the empty nodes.
    let mut empty = [0.0f32; 4];
    let mut heaviest = 0.0f32;
    let mut momentum = [0.0f32; 3];
    for i in 0..3 {
        for j in 0..3 {
            let o = row(st.first[p], i, j);
            for k in 0..3 {
                let node = node(o + 4 * k);
                let mass = node[3];
                let (wx, wy) = (st.wx[i][p], st.wy[j][p]);
                let w = wx * wy * wz[k];
                if mass <= 0.0 {
                    empty[0] += w;
                    empty[1] += st.dx[i][p] * wy * wz[k];
                    empty[2] += wx * st.dy[j][p] * wz[k];
                    empty[3] += w * (k as f32 - 1.0 - g);
                } else {
                    heaviest = heaviest.max(mass);
                    momentum = vec3::add_scaled(momentum, [node[0], node[1], node[2]], w * mass);
                }
            }
        }
    }
    if empty[0] > LOST {
        return true;
    }
    if empty[0] > 0.0 {
        for a in 0..3 {
            let mean = record.0[a] / (1.0 - empty[0]);
            record.0[a] = mean;
            for axis in 1..4 {
                record.0[4 * axis + a] += mean * empty[axis];
            }
        }
    }
    let mass = record.0[3];
    if mass < NEAR * heaviest {
        let trust = ((mass / heaviest - FAR) / (NEAR - FAR)).max(0.0);
        for a in 0..3 {
            // Distances to all nodes sum up to nothing, so a velocity that they share has no gradient.
            record.0[a] = trust * record.0[a] + (1.0 - trust) * momentum[a] / mass;
            for axis in 1..4 {
                record.0[4 * axis + a] *= trust;
            }
        }
    }
    false
}

/// P2G of the first `count` points: record `[m v, m, A_x, 0, A_y, 0, A_z, 0]` with the columns of `A` per node spacing. Returns
/// the regions of the tile that were touched (see [`touched`]).
#[inline(always)]
pub(crate) fn scatter<S: Simd>(s: S, tile: &mut Tile, st: &Stencils, count: usize, records: &[Record; CHUNK]) -> u32 {
    let z = AxisZ::new(s);
    let splat = |v: f32| f32x16::splat(s, v);
    let zero = splat(0.0);
    let mut sums = [[zero; 3]; 3];
    let count = count.min(CHUNK);
    let mut regions = 0;
    for p in 0..count {
        let first = st.first[p];
        let record = &records[p].0;
        let quad = |k: usize| f32x16::block_splat(f32x4::from_slice(s, &record[4 * k..4 * k + 4]));
        let (wz, dz) = z.at(splat(st.gz[p]));
        let plain = quad(3).mul_add(dz, quad(0)) * wz;
        let ax = quad(1) * wz;
        let ay = quad(2) * wz;
        let wy = each3(|j| splat(st.wy[j][p]));
        let dy = each3(|j| splat(st.dy[j][p]));
        for i in 0..3 {
            let wx = splat(st.wx[i][p]);
            let t = ax.mul_add(splat(st.dx[i][p]), plain * wx);
            let u = ay * wx;
            for j in 0..3 {
                sums[i][j] = u.mul_add(dy[j], t.mul_add(wy[j], sums[i][j]));
            }
        }
        if p + 1 == count || st.first[p + 1] != first {
            regions |= touched(first);
            for i in 0..3 {
                for j in 0..3 {
                    let o = row(first, i, j);
                    let memory = &mut tile.0[o..o + 16];
                    (f32x16::from_slice(s, memory) + sums[i][j]).store_slice(memory);
                    sums[i][j] = zero;
                }
            }
        }
    }
    regions
}

/// Bit `9 x + 3 y + z` (each 0, 1, 2: the neighbour block below, the block itself, the one above) is set where a stencil whose
/// first node is `first` reaches that part of the tile.
#[inline(always)]
pub(crate) fn touched(first: u32) -> u32 {
    let axis = |base: u32| 0b010 | u32::from(base < 2) | (u32::from(base >= 4) << 2);
    let z = axis(first & 7);
    let y = axis((first >> 3) & 7);
    let x = axis(first >> 6);
    let spread =
        |bits: u32, by: u32, stride: u32| (0..3).fold(0, |acc, k| if bits >> k & 1 == 1 { acc | (by << (k * stride)) } else { acc });
    spread(x, spread(y, z, 3), 9)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Record of a point at offset `gx` from the middle node of its stencil, whose columns of nodes have these masses and velocities
    /// along x.
    fn followed(gx: f32, mass: [f32; 3], velocity: [f32; 3]) -> Option<Record> {
        let mut st = Stencils::ZERO;
        let (wx, wy) = (weights(gx), weights(0.0));
        for k in 0..3 {
            let node = k as f32 - 1.0;
            (st.wx[k][0], st.dx[k][0]) = (wx[k], wx[k] * (node - gx));
            (st.wy[k][0], st.dy[k][0]) = (wy[k], wy[k] * node);
        }
        let mut tile = Tile::ZERO;
        for i in 0..3 {
            for (j, k) in (0..9).map(|n| (n / 3, n % 3)) {
                let o = row(0, i, j) + 4 * k;
                tile.0[o] = if mass[i] > 0.0 { velocity[i] } else { 0.0 };
                tile.0[o + 3] = mass[i];
            }
        }
        let mut records = [Record::ZERO; CHUNK];
        fearless_simd::dispatch!(fearless_simd::Level::new(), s => gather(s, &tile, &st, 1, &mut records));
        let lost = complete_tracer(|o| &tile.0[o..o + 4], &st, 0, &mut records[0]);
        (!lost).then_some(records[0])
    }

    #[test]
    fn tracers_follow_the_matter_and_not_its_fringe() {
        // Within the matter a fast node counts by its weight; empty nodes take the mean of the others.
        let inside = followed(0.2, [1.0, 1.0, 0.5], [0.0, 0.0, 10.0]).unwrap();
        assert!((inside.0[0] - 10.0 * weights(0.2)[2]).abs() < 1e-5);
        let beside = followed(0.2, [1.0, 1.0, 0.0], [3.0, 3.0, 0.0]).unwrap();
        assert!((beside.0[0] - 3.0).abs() < 1e-5 && beside.0[4].abs() < 1e-5, "{:?}", beside.0);
        // Outside of it the fringe, which weighs nothing, has little to say.
        let out = followed(0.4, [1.0, 1e-4, 1e-4], [1.0, 10.0, 10.0]).unwrap();
        assert!((out.0[0] - 1.0).abs() < 0.2 && out.0[4] == 0.0, "{:?}", out.0);
        // Between the two it passes over without a step.
        let at = |m: f32| followed(0.0, [1.0, m, 0.0], [0.0, 10.0, 0.0]).unwrap().0[0];
        for k in 0..100 {
            let m = 0.003 * k as f32 + 1e-4;
            assert!((at(m + 0.003) - at(m)).abs() < 0.5, "{m}: {} {}", at(m), at(m + 0.003));
        }
        assert!(followed(0.0, [0.0; 3], [0.0; 3]).is_none());
    }

    #[test]
    fn touched_regions_follow_the_stencil() {
        let bit = |x: u32, y: u32, z: u32| 1 << (9 * x + 3 * y + z);
        let first = |x: u32, y: u32, z: u32| (x * 8 + y) * 8 + z;
        assert_eq!(touched(first(2, 3, 2)), bit(1, 1, 1));
        assert_eq!(touched(first(1, 2, 4)), bit(1, 1, 1) | bit(0, 1, 1) | bit(1, 1, 2) | bit(0, 1, 2));
        assert_eq!(touched(first(5, 5, 5)).count_ones(), 8);
    }
}
