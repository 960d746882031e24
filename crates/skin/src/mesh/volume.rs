//! Field values at the nodes around the surface: blocks of 8³ nodes in a hash map; everything else is known to be outside or
//! inside (splatting.md §7.7, steps 1 and 2).

use rayon::prelude::*;

use super::cells::{Cells, Class, Lookup, pack, unpack};

/// Nodes along an axis of a block.
pub(crate) const EDGE: i32 = 8;
/// Value of nodes that were not evaluated, voxels.
const UNIFORM: f32 = 1.0;

/// The nodes of one block, rows along x; row `8z + y`.
pub(crate) struct Block {
    /// The first node is 8 times these.
    pub coords: [i32; 3],
    /// Values of the field in voxel units, negative inside.
    pub value: [[f32; 8]; 64],
    /// Bits of the nodes that are inside.
    pub inside: [u8; 64],
}

/// All blocks that the surface may pass through.
pub(crate) struct Volume {
    /// Ascending by z, y, x.
    pub blocks: Vec<Block>,
    lookup: Lookup,
}

/// Blocks with a node that has to be evaluated, or whose upper neighbour has one.
fn active(cells: &Cells) -> Vec<u64> {
    let edge = f64::from(cells.edge);
    let mut keys: Vec<u64> = (0..cells.bricks.len())
        .into_par_iter()
        .flat_map_iter(|b| {
            let mut list = Vec::new();
            for cell in cells.near_cells(b) {
                let low = cell.map(|c| (((f64::from(c) * edge - 1e-3).ceil() as i32) - 1).div_euclid(EDGE));
                let high = cell.map(|c| (((f64::from(c) + 1.0) * edge + 1e-3).floor() as i32).div_euclid(EDGE));
                for z in low[2]..=high[2] {
                    for y in low[1]..=high[1] {
                        for x in low[0]..=high[0] {
                            let key = pack([x, y, z]);
                            if list.last() != Some(&key) {
                                list.push(key);
                            }
                        }
                    }
                }
            }
            list.sort_unstable();
            list.dedup();
            list
        })
        .collect();
    keys.par_sort_unstable();
    keys.dedup();
    keys
}

/// Classes of the nodes of a block: bit masks of those to evaluate and of those inside.
fn masks(cells: &Cells, node: [i32; 3]) -> ([u8; 64], [u8; 64]) {
    let mut place = [[0usize; 8]; 3];
    let base = node.map(|n| cells.cell_of_node(n));
    let mut count = [0; 3];
    for a in 0..3 {
        for k in 0..8 {
            place[a][k] = (cells.cell_of_node(node[a] + k as i32) - base[a]) as usize;
        }
        count[a] = place[a][7] + 1;
    }
    let mut class = [Class::Outside; 512];
    for z in 0..count[2] {
        for y in 0..count[1] {
            for x in 0..count[0] {
                class[(z * 8 + y) * 8 + x] = cells.class([base[0] + x as i32, base[1] + y as i32, base[2] + z as i32]);
            }
        }
    }
    let (mut near, mut inside) = ([0u8; 64], [0u8; 64]);
    for row in 0..64 {
        let from = (place[2][row / 8] * 8 + place[1][row % 8]) * 8;
        for x in 0..8 {
            match class[from + place[0][x]] {
                Class::Near => near[row] |= 1 << x,
                Class::Inside => inside[row] |= 1 << x,
                Class::Outside => {}
            }
        }
    }
    (near, inside)
}

impl Volume {
    /// Evaluates `field(first node, rows wanted, values)` in every active block.
    pub fn new(cells: &Cells, field: impl Fn([i32; 3], &[u8; 64], &mut [[f32; 8]; 64]) + Sync) -> Self {
        let keys = active(cells);
        let blocks: Vec<Block> = keys
            .par_iter()
            .map(|k| {
                let coords = unpack(*k);
                let node = coords.map(|c| c * EDGE);
                let (near, full) = masks(cells, node);
                let mut b = Block { coords, value: [[UNIFORM; 8]; 64], inside: [0; 64] };
                if near.iter().any(|r| *r != 0) {
                    field(node, &near, &mut b.value);
                }
                for row in 0..64 {
                    for x in 0..8 {
                        let v = &mut b.value[row][x];
                        if near[row] >> x & 1 == 0 {
                            *v = if full[row] >> x & 1 == 1 { -UNIFORM } else { UNIFORM };
                        }
                        b.inside[row] |= u8::from(*v < 0.0) << x;
                    }
                }
                b
            })
            .collect();
        let lookup = keys.iter().enumerate().map(|(i, k)| (*k, i as u32)).collect();
        Self { blocks, lookup }
    }

    /// Number of the block with these coordinates.
    #[inline(always)]
    pub fn find(&self, coords: [i32; 3]) -> Option<usize> {
        self.lookup.get(&pack(coords)).map(|i| *i as usize)
    }

    /// Value at any node.
    pub fn value(&self, cells: &Cells, node: [i32; 3]) -> f32 {
        match self.find(node.map(|n| n.div_euclid(EDGE))) {
            Some(b) => {
                let l = node.map(|n| n.rem_euclid(EDGE) as usize);
                self.blocks[b].value[l[2] * 8 + l[1]][l[0]]
            }
            None => match cells.class(node.map(|n| cells.cell_of_node(n))) {
                Class::Inside => -UNIFORM,
                _ => UNIFORM,
            },
        }
    }
}
