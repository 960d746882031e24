//! The canonical order of points: by 4³ block, then cell, then identity (simulation.md §9.2). It depends on the state
//! alone, so a restart or another number of threads continues with the same order.

use rayon::prelude::*;

use super::{Particles, each_array, unpack};
use crate::grid::Grid;

/// Nodes per axis of a block.
pub const BLOCK: usize = 4;

/// The points of one block of 4³ cells.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Block {
    /// Block coordinates: its first node is 4 times these.
    pub coords: [u32; 3],
    /// First point.
    pub start: u32,
    /// One past the last point.
    pub end: u32,
}

impl Grid {
    /// Blocks per axis.
    pub(crate) fn blocks(&self) -> [usize; 3] {
        self.nodes.map(|n| n.div_ceil(BLOCK))
    }

    /// Index of a block in the dense block table.
    #[inline(always)]
    pub(crate) fn block_index(&self, c: [u32; 3]) -> usize {
        let b = self.blocks();
        (c[0] as usize * b[1] + c[1] as usize) * b[2] + c[2] as usize
    }
}

/// Order of the cells inside a block: z slowest. Neighbouring points then touch the same rows of nodes (rows run along z),
/// which a processor can forward from its store buffer; shifted rows it cannot.
#[inline(always)]
fn cell_rank(c: [u32; 3]) -> u32 {
    ((c[2] & 3) << 4) | ((c[0] & 3) << 2) | (c[1] & 3)
}

impl Particles {
    /// Puts the points into canonical order and finds the blocks. Does nothing if no point moved since the last sort.
    pub fn sort(&mut self) {
        if self.sorted {
            return;
        }
        self.sorted = true;
        self.blocks.clear();
        let n = self.len();
        if n == 0 {
            return;
        }
        let table = self.grid.blocks().iter().product();
        let mut count = vec![0u32; table];
        let keys: Vec<u32> =
            self.cell.par_iter().with_min_len(4096).map(|&c| self.grid.block_index(unpack(c).map(|v| v / BLOCK as u32)) as u32).collect();
        for &k in &keys {
            count[k as usize] += 1;
        }
        let dims = self.grid.blocks();
        let mut next = 0;
        for (index, c) in count.iter_mut().enumerate() {
            if *c > 0 {
                let coords = [index / (dims[1] * dims[2]), index / dims[2] % dims[1], index % dims[2]].map(|v| v as u32);
                self.blocks.push(Block { coords, start: next, end: next + *c });
                let len = *c;
                *c = next;
                next += len;
            }
        }
        // (cell, id) in the high bits orders the points of a block; the low half carries the index along.
        let mut order = vec![(0u64, 0u32); n];
        for (i, &k) in keys.iter().enumerate() {
            let slot = &mut count[k as usize];
            order[*slot as usize] = ((u64::from(cell_rank(unpack(self.cell[i]))) << 32) | u64::from(self.id[i]), i as u32);
            *slot += 1;
        }
        let mut rest = order.as_mut_slice();
        let mut parts = Vec::with_capacity(self.blocks.len());
        for b in &self.blocks {
            let (head, tail) = rest.split_at_mut((b.end - b.start) as usize);
            parts.push(head);
            rest = tail;
        }
        parts.into_par_iter().with_min_len(8).for_each(<[(u64, u32)]>::sort_unstable);
        let from: Vec<u32> = order.into_iter().map(|o| o.1).collect();
        if from.iter().enumerate().all(|(i, &f)| i == f as usize) {
            return;
        }
        let from = &from;
        rayon::scope(|scope| {
            each_array!(self, unique, _name, a => scope.spawn(move |_| permute(a, from)));
        });
    }

    /// The blocks that hold points, in order; valid after [`Particles::sort`] until a point moves.
    pub fn blocks(&self) -> &[Block] {
        &self.blocks
    }
}

fn permute<T: Copy + Send + Sync>(a: &mut Vec<T>, from: &[u32]) {
    *a = from.iter().map(|&i| a[i as usize]).collect();
}

#[cfg(test)]
mod tests {
    use megas_math::rng::Rng;

    use super::*;

    fn cloud(count: usize, seed: u64) -> Particles {
        let grid = Grid { origin: [0.0; 3], spacing: 0.1, nodes: [21, 17, 30] };
        let mut rng = Rng::new(seed);
        let mut p = Particles::blank(&grid, count);
        for i in 0..count {
            p.id[i] = i as u32;
            let x = std::array::from_fn(|a| rng.range(0.2, (grid.nodes[a] - 3) as f64 * 0.1));
            p.set_position(i, x);
            p.mass[i] = i as f32;
            p.enthalpy[i] = i as f64;
            p.set_velocity(i, [i as f32, 0.0, 1.0]);
        }
        p
    }

    #[test]
    fn order_is_by_block_cell_and_identity_and_carries_every_array() {
        let mut p = cloud(5000, 1);
        let places: Vec<_> = (0..p.len()).map(|i| p.position(i)).collect();
        p.sort();
        let mut seen = 0;
        for b in p.blocks().to_vec() {
            assert_eq!(b.start as usize, seen);
            seen = b.end as usize;
            let mut last = (0, 0);
            for i in b.start as usize..b.end as usize {
                let c = unpack(p.cell[i]);
                assert_eq!(c.map(|v| v / 4), b.coords);
                let key = (cell_rank(c), p.id[i]);
                assert!(i == b.start as usize || key > last);
                last = key;
                let id = p.id[i] as usize;
                assert_eq!(p.mass[i], id as f32);
                assert_eq!(p.enthalpy[i], id as f64);
                assert_eq!(p.velocity(i)[0], id as f32);
                assert_eq!(p.position(i), places[id]);
            }
        }
        assert_eq!(seen, p.len());
    }

    #[test]
    fn order_does_not_depend_on_the_order_before() {
        let mut a = cloud(2000, 5);
        let mut b = a.clone();
        let reversed: Vec<u32> = (0..b.len() as u32).rev().collect();
        let from = &reversed;
        each_array!(&mut b, unique, _name, v => permute(v, from));
        assert_ne!(a.state_hash(), b.state_hash());
        a.sort();
        b.sort();
        assert_eq!(a.state_hash(), b.state_hash());
        assert_eq!(a, b);
    }
}
