//! The sparse grid: blocks of 4³ nodes where there is matter, and the update of their velocities (simulation.md §2.3, §9.2).
//!
//! Points scatter into one tile per block of points. A node block then adds up the tiles that reach it, always in the same
//! order: no two threads ever add to the same number, and the result does not depend on their count.

use std::collections::HashMap;

use fearless_simd::{Level, Simd, SimdBase, SimdFloat, dispatch, f32x4, f32x8, f32x16};
use rayon::prelude::*;

use super::sheets::{Ghost, Near, Tag, find_tags, with_sheets};
use super::transfer::{TILE, TILE_ORIGIN, Tile};
use super::{Bounds, Settings, Wall};
use crate::collider::{Contact, Placed, apply_contacts};
use crate::grid::{Grid, PADDING};
use crate::particles::Block;

/// No such block.
const NONE: u32 = u32::MAX;
/// Nodes per axis of a block.
pub(crate) const SIDE: usize = 4;

/// Values of the 4³ nodes of a block, `[x, y, z, mass]` per node, z fastest: after the grid update velocities, and for a
/// share pass the numerator in x.
#[derive(Clone)]
#[repr(C, align(64))]
pub(crate) struct NodeBlock(pub [f32; SIDE * SIDE * SIDE * 4]);

impl NodeBlock {
    pub const ZERO: Self = Self([0.0; SIDE * SIDE * SIDE * 4]);
}

/// What belongs to a node block besides its values.
#[derive(Clone)]
pub(crate) struct NodeInfo {
    pub coords: [u32; 3],
    /// Blocks of points around it, by `9 x + 3 y + z` with x, y, z in 0..3; [`NONE`] where there is none.
    tiles: [u32; 27],
    /// The block has nodes in the padding layers.
    walls: bool,
    /// Range of its contacts in [`Nodes::contacts`].
    contacts: (u32, u32),
    /// Liquid share of the mass of each node, where colliders ask for it.
    liquid: Option<Box<[f32; 64]>>,
}

/// All active node blocks.
#[derive(Default)]
pub(crate) struct Nodes {
    pub info: Vec<NodeInfo>,
    pub values: Vec<NodeBlock>,
    /// One tile per block of points, with the mask of the regions it touches.
    pub tiles: Vec<(Tile, u32)>,
    /// Node blocks around each block of points, by the same index as [`NodeInfo`].
    pub around: Vec<[u32; 27]>,
    contacts: Vec<Contact>,
    /// Contacts with obstacles that never move, of every block that was ever active, by block index.
    known: HashMap<u32, Vec<Contact>>,
    /// Where each block of points meets a sheet; `None` nearly everywhere, empty without sheets.
    pub near: Vec<Option<Box<Near>>>,
    /// The second nodes beside sheets.
    pub ghosts: Vec<Ghost>,
    /// Tags by sheets that never move, as `known`.
    tagged: HashMap<u32, Vec<Tag>>,
    table: Vec<u32>,
}

/// Offsets of the 27 neighbours in index order.
fn offsets() -> impl Iterator<Item = (usize, [i64; 3])> {
    (0..27).map(|k| (k, [(k / 9) as i64 - 1, (k / 3 % 3) as i64 - 1, (k % 3) as i64 - 1]))
}

/// Range along one axis that a neighbour at offset −1, 0, 1 (as 0, 1, 2) shares with a tile: first tile node, first block
/// node, count.
#[inline(always)]
fn overlap(side: usize) -> (usize, usize, usize) {
    [(0, 2, 2), (2, 0, 4), (6, 0, 2)][side]
}

/// Equation-of-motion constants of one substep.
pub(crate) struct GridStep<'a> {
    pub settings: &'a Settings,
    pub grid: &'a Grid,
    pub dt: f64,
    pub least_mass: f32,
}

impl Nodes {
    /// Activates the nodes that the points of `blocks` can reach until the next sort, with their contacts to `colliders`. `sides` are
    /// those of all points.
    pub fn rebuild(&mut self, grid: &Grid, blocks: &[Block], colliders: &[Placed], sides: &[u32]) {
        let (sheets, colliders): (Vec<&Placed>, Vec<&Placed>) = colliders.iter().partition(|c| c.sheet.is_some());
        let (fixed, moving): (Vec<&Placed>, Vec<&Placed>) = colliders.iter().copied().partition(|c| c.collider.is_static());
        let dims = grid.blocks();
        self.table.clear();
        self.table.resize(dims.iter().product(), NONE);
        let neighbour = |c: [u32; 3], o: [i64; 3]| -> Option<[u32; 3]> {
            let n: [i64; 3] = std::array::from_fn(|a| i64::from(c[a]) + o[a]);
            (0..3).all(|a| n[a] >= 0 && n[a] < dims[a] as i64).then(|| n.map(|v| v as u32))
        };
        let mut points_at: HashMap<u32, u32> = HashMap::with_capacity(blocks.len());
        for (i, b) in blocks.iter().enumerate() {
            points_at.insert(grid.block_index(b.coords) as u32, i as u32);
            for (_, o) in offsets() {
                if let Some(n) = neighbour(b.coords, o) {
                    self.table[grid.block_index(n)] = 0;
                }
            }
        }
        self.info.clear();
        self.contacts.clear();
        for index in 0..self.table.len() {
            if self.table[index] == NONE {
                continue;
            }
            self.table[index] = self.info.len() as u32;
            let coords = [index / (dims[1] * dims[2]), index / dims[2] % dims[1], index % dims[2]].map(|v| v as u32);
            let mut tiles = [NONE; 27];
            for (k, o) in offsets() {
                if let Some(n) = neighbour(coords, o) {
                    tiles[k] = points_at.get(&(grid.block_index(n) as u32)).copied().unwrap_or(NONE);
                }
            }
            let walls = (0..3).any(|a| {
                let first = coords[a] as usize * SIDE;
                first < PADDING || first + SIDE > grid.nodes[a] - PADDING
            });
            let mut contacts = (0, 0);
            if !colliders.is_empty() {
                let first = self.contacts.len();
                if !fixed.is_empty() {
                    self.contacts.extend_from_slice(self.known.entry(index as u32).or_insert_with(|| find_contacts(grid, coords, &fixed)));
                }
                let center = block_center(grid, coords);
                // Half the diagonal of a block.
                let reach = 0.5 * (SIDE - 1) as f64 * 3f64.sqrt() * grid.spacing;
                let near: Vec<&Placed> = moving.iter().copied().filter(|c| c.distance(center).0 < reach).collect();
                if !near.is_empty() {
                    self.contacts.extend(find_contacts(grid, coords, &near));
                    self.contacts[first..].sort_by_key(|c| (c.node, c.collider));
                }
                contacts = (first as u32, self.contacts.len() as u32);
            }
            self.info.push(NodeInfo { coords, tiles, walls, contacts, liquid: None });
        }
        self.values.resize(self.info.len(), NodeBlock::ZERO);
        self.tiles.resize(blocks.len(), (Tile::ZERO, 0));
        self.around.clear();
        for b in blocks {
            let mut around = [NONE; 27];
            for (k, o) in offsets() {
                if let Some(n) = neighbour(b.coords, o) {
                    around[k] = self.table[grid.block_index(n)];
                }
            }
            self.around.push(around);
        }
        self.near.clear();
        self.ghosts.clear();
        if !sheets.is_empty() {
            self.part(grid, blocks, &sheets, sides);
        }
    }

    /// Finds the blocks of points that sheets run through, and makes the second nodes there.
    fn part(&mut self, grid: &Grid, blocks: &[Block], sheets: &[&Placed], sides: &[u32]) {
        let (fixed, moving): (Vec<&Placed>, Vec<&Placed>) = sheets.iter().copied().partition(|c| c.collider.is_static());
        let (known, info, around) = (&self.tagged, &self.info, &self.around);
        let index = |coords| grid.block_index(coords) as u32;
        // Tags by sheets at rest where they are not known yet, and by the others.
        let found: Vec<(Option<Vec<Tag>>, Vec<Tag>)> = info
            .par_iter()
            .map(|n| {
                let new = (!fixed.is_empty() && !known.contains_key(&index(n.coords))).then(|| find_tags(grid, n.coords, &fixed));
                (new, find_tags(grid, n.coords, &moving))
            })
            .collect();
        let mut tags: Vec<Vec<Tag>> = Vec::with_capacity(found.len());
        for (n, (new, moving)) in info.iter().zip(found) {
            if let Some(new) = new {
                self.tagged.insert(index(n.coords), new);
            }
            let mut all = self.tagged.get(&index(n.coords)).cloned().unwrap_or_default();
            all.extend(moving);
            tags.push(all);
        }
        let tags_at = |n: u32| tags.get(n as usize).map_or(&[] as &[Tag], Vec::as_slice);
        self.near = blocks
            .par_iter()
            .zip(around)
            .map(|(b, around)| Near::new(&sides[b.start as usize..b.end as usize], |side| tags_at(around[side])))
            .collect();
        for n in (0..self.info.len()).filter(|n| !tags[*n].is_empty()) {
            let info = &self.info[n];
            let plain = self.contacts_of(info).to_vec();
            let mut tiles: Vec<(u16, (u8, u32, u32))> = Vec::new();
            for (k, &t) in info.tiles.iter().enumerate() {
                let Some(Some(near)) = self.near.get(t as usize) else { continue };
                tiles.extend(near.layers.iter().enumerate().map(|(l, layer)| (layer.mask, (k as u8, t, l as u32))));
            }
            // By layer, and as before within one.
            tiles.sort_by_key(|t| t.0);
            for of_layer in tiles.chunk_by(|a, b| a.0 == b.0) {
                let mask = of_layer[0].0;
                if !tags[n].iter().any(|t| t.parts(mask)) {
                    continue;
                }
                let contacts = with_sheets(mask, plain.clone(), &tags[n]);
                for &(_, (k, t, l)) in of_layer {
                    if let Some(Some(near)) = self.near.get_mut(t as usize) {
                        near.layers[l as usize].around[26 - k as usize] = self.ghosts.len() as u32;
                    }
                }
                let tiles = of_layer.iter().map(|t| t.1).collect();
                self.ghosts.push(Ghost { block: n as u32, tiles, contacts, liquid: None, values: NodeBlock::ZERO });
            }
            // Sheets that are felt before they are reached hold the nodes on their own side too.
            let contacts = with_sheets(0, plain, &tags[n]);
            if contacts.len() > self.contacts_of(info).len() {
                let first = self.contacts.len() as u32;
                self.contacts.extend(contacts);
                self.info[n].contacts = (first, self.contacts.len() as u32);
            }
        }
    }

    /// True where some active node is held by an obstacle that melts stick to.
    pub fn wants_liquid(&self) -> bool {
        self.contacts.iter().chain(self.ghosts.iter().flat_map(|g| &g.contacts)).any(|c| c.melt_sticks)
    }

    /// Contacts of a node block.
    fn contacts_of(&self, info: &NodeInfo) -> &[Contact] {
        &self.contacts[info.contacts.0 as usize..info.contacts.1 as usize]
    }

    /// Sums the tiles into `out` for one block; returns false where nothing touches it.
    #[inline(always)]
    fn sum_tiles<S: Simd>(&self, s: S, info: &NodeInfo, out: &mut NodeBlock) -> bool {
        out.0.fill(0.0);
        let mut any = false;
        for (k, &t) in info.tiles.iter().enumerate() {
            if t == NONE {
                continue;
            }
            let (tile, regions) = &self.tiles[t as usize];
            // Seen from those points, this block lies at the opposite offset.
            let side = 26 - k;
            if regions >> side & 1 == 0 {
                continue;
            }
            any = true;
            add_tile(s, side, tile, out);
        }
        any
    }

    /// The same for second nodes.
    #[inline(always)]
    fn sum_layers<S: Simd>(&self, s: S, ghost: &mut Ghost) {
        ghost.values.0.fill(0.0);
        for &(k, t, l) in &ghost.tiles {
            if let Some(Some(near)) = self.near.get(t as usize) {
                add_tile(s, 26 - k as usize, &near.layers[l as usize].to, &mut ghost.values);
            }
        }
    }

    /// New velocities of one block from momenta in the tiles; returns the largest speed squared.
    #[inline(always)]
    pub fn advance<S: Simd>(&self, s: S, index: usize, out: &mut NodeBlock, step: &GridStep) -> f32 {
        let info = &self.info[index];
        if !self.sum_tiles(s, info, out) {
            return 0.0;
        }
        finish(s, info, self.contacts_of(info), info.liquid.as_deref(), out, step)
    }

    /// The same for second nodes.
    #[inline(always)]
    pub fn advance_ghost<S: Simd>(&self, s: S, ghost: &mut Ghost, step: &GridStep) -> f32 {
        self.sum_layers(s, ghost);
        let Ghost { block, contacts, liquid, values, .. } = ghost;
        finish(s, &self.info[*block as usize], contacts, liquid.as_deref(), values, step)
    }

    /// Liquid share of the node masses from tiles that hold `[m f_l, ·, ·, m]`.
    pub fn liquid_share(&self, level: Level, index: usize) -> Option<Box<[f32; 64]>> {
        let info = &self.info[index];
        if !self.contacts_of(info).iter().any(|c| c.melt_sticks) {
            return None;
        }
        let mut sum = NodeBlock::ZERO;
        dispatch!(level, s => self.sum_tiles(s, info, &mut sum));
        Some(share(&sum))
    }

    /// The same for second nodes.
    pub fn find_ghost_liquid(&self, level: Level, ghost: &mut Ghost) {
        ghost.liquid = None;
        if ghost.contacts.iter().any(|c| c.melt_sticks) {
            dispatch!(level, s => self.sum_layers(s, ghost));
            ghost.liquid = Some(share(&ghost.values));
        }
    }

    /// Stores the result of [`Nodes::liquid_share`].
    pub fn set_liquid(&mut self, shares: Vec<Option<Box<[f32; 64]>>>) {
        for (info, share) in self.info.iter_mut().zip(shares) {
            info.liquid = share;
        }
    }

    /// Copies the velocities around a block of points into a tile.
    #[inline(always)]
    pub fn load_tile<S: Simd>(&self, s: S, block: usize, out: &mut Tile) {
        load(s, &self.around[block], |n| Some(&self.values.get(n as usize)?.0), out);
    }

    /// The same for the second nodes of a block of points.
    #[inline(always)]
    pub fn load_layers<S: Simd>(&self, s: S, near: &mut Near) {
        for layer in &mut near.layers {
            load(s, &layer.around, |n| Some(&self.ghosts.get(n as usize)?.values.0), &mut layer.from);
        }
    }

    /// Calls `f(node, mass, velocity)` for every active node inside the grid that has mass.
    pub fn for_each(&self, grid: &Grid, mut f: impl FnMut([usize; 3], f32, [f32; 3])) {
        for (info, values) in self.info.iter().zip(&self.values) {
            for (n, q) in values.0.as_chunks::<4>().0.iter().enumerate() {
                let local = [n / 16, n / 4 % 4, n % 4];
                let node: [usize; 3] = std::array::from_fn(|a| info.coords[a] as usize * SIDE + local[a]);
                if q[3] > 0.0 && (0..3).all(|a| node[a] < grid.nodes[a]) {
                    f(node, q[3], [q[0], q[1], q[2]]);
                }
            }
        }
    }
}

/// New velocities of one block of nodes from their momenta; returns the largest speed squared.
#[inline(always)]
fn finish<S: Simd>(
    s: S,
    info: &NodeInfo,
    mut contacts: &[Contact],
    liquid: Option<&[f32; 64]>,
    out: &mut NodeBlock,
    step: &GridStep,
) -> f32 {
    let keep = (1.0 - step.settings.drag * step.dt).max(0.0) as f32;
    let push = step.settings.gravity.map(|g| (g * step.dt) as f32);
    let push = f32x4::from_slice(s, &[push[0], push[1], push[2], 0.0]);
    for q in out.0.as_chunks_mut::<4>().0 {
        let mass = q[3];
        if mass > step.least_mass {
            let v = f32x4::from_slice(s, q).mul_add(f32x4::splat(s, keep / mass), push);
            v.store_slice(q);
            q[3] = mass;
        } else {
            q[..3].fill(0.0);
        }
    }
    while let Some(first) = contacts.first() {
        let count = contacts.iter().take_while(|c| c.node == first.node).count();
        let q = &mut out.0[usize::from(first.node) * 4..][..4];
        let liquid = liquid.map_or(0.0, |l| l[usize::from(first.node)]);
        let v = apply_contacts(&contacts[..count], [q[0], q[1], q[2]], liquid);
        q[..3].copy_from_slice(&v);
        contacts = &contacts[count..];
    }
    if info.walls && step.settings.bounds == Bounds::Clamp {
        walls(info.coords, out, step);
    }
    out.0.as_chunks::<4>().0.iter().fold(0.0f32, |m, q| m.max(q[0] * q[0] + q[1] * q[1] + q[2] * q[2]))
}

/// Adds the part of a tile that a block of nodes shares with it; the block lies at offset `side` from that of the points.
#[inline(always)]
fn add_tile<S: Simd>(s: S, side: usize, tile: &Tile, out: &mut NodeBlock) {
    let [(tx, bx, nx), (ty, by, ny), (tz, bz, nz)] = [overlap(side / 9), overlap(side / 3 % 3), overlap(side % 3)];
    for x in 0..nx {
        for y in 0..ny {
            let from = (((tx + x) * TILE + ty + y) * TILE + tz) * 4;
            let to = (((bx + x) * SIDE + by + y) * SIDE + bz) * 4;
            // Four nodes of a row, or two.
            if nz == SIDE {
                let (a, b) = (&mut out.0[to..to + 16], &tile.0[from..from + 16]);
                (f32x16::from_slice(s, a) + f32x16::from_slice(s, b)).store_slice(a);
            } else {
                let (a, b) = (&mut out.0[to..to + 8], &tile.0[from..from + 8]);
                (f32x8::from_slice(s, a) + f32x8::from_slice(s, b)).store_slice(a);
            }
        }
    }
}

/// Copies the values of the blocks of nodes `around` a block of points into a tile; zero where there is none.
#[inline(always)]
fn load<'a, S: Simd>(s: S, around: &[u32; 27], values_of: impl Fn(u32) -> Option<&'a [f32; 256]>, out: &mut Tile) {
    for (side, &n) in around.iter().enumerate() {
        let [(tx, bx, nx), (ty, by, ny), (tz, bz, nz)] = [overlap(side / 9), overlap(side / 3 % 3), overlap(side % 3)];
        let values = values_of(n);
        for x in 0..nx {
            for y in 0..ny {
                let to = (((tx + x) * TILE + ty + y) * TILE + tz) * 4;
                let Some(values) = values else {
                    out.0[to..to + 4 * nz].fill(0.0);
                    continue;
                };
                let from = (((bx + x) * SIDE + by + y) * SIDE + bz) * 4;
                if nz == SIDE {
                    f32x16::from_slice(s, &values[from..from + 16]).store_slice(&mut out.0[to..to + 16]);
                } else {
                    f32x8::from_slice(s, &values[from..from + 8]).store_slice(&mut out.0[to..to + 8]);
                }
            }
        }
    }
}

/// First value over mass of every node.
fn share(sum: &NodeBlock) -> Box<[f32; 64]> {
    Box::new(std::array::from_fn(|n| if sum.0[4 * n + 3] > 0.0 { sum.0[4 * n] / sum.0[4 * n + 3] } else { 0.0 }))
}

/// Box walls: in the padding layers nothing moves outwards (slip) or at all (sticky).
fn walls(coords: [u32; 3], out: &mut NodeBlock, step: &GridStep) {
    for (n, q) in out.0.as_chunks_mut::<4>().0.iter_mut().enumerate() {
        let local = [n / 16, n / 4 % 4, n % 4];
        for a in 0..3 {
            let node = coords[a] as usize * SIDE + local[a];
            let (low, high) = (node < PADDING, node + PADDING >= step.grid.nodes[a]);
            for (active, wall, outward) in [(low, step.settings.walls[a][0], -1.0), (high, step.settings.walls[a][1], 1.0)] {
                if active {
                    match wall {
                        Wall::Slip if q[a] * outward > 0.0 => q[a] = 0.0,
                        Wall::Slip => {}
                        Wall::Sticky => q[..3].fill(0.0),
                    }
                }
            }
        }
    }
}

/// Middle of the nodes of a block.
pub(crate) fn block_center(grid: &Grid, coords: [u32; 3]) -> [f64; 3] {
    grid.position(coords.map(|c| c as usize * SIDE)).map(|x| x + 0.5 * (SIDE - 1) as f64 * grid.spacing)
}

/// Place of node `n` of a block.
pub(crate) fn node_position(grid: &Grid, coords: [u32; 3], n: usize) -> [f64; 3] {
    let local = [n / 16, n / 4 % 4, n % 4];
    grid.position(std::array::from_fn(|a| coords[a] as usize * SIDE + local[a]))
}

/// The nodes of a block that obstacles hold, ordered by node and then obstacle.
fn find_contacts(grid: &Grid, coords: [u32; 3], colliders: &[&Placed]) -> Vec<Contact> {
    let mut found = Vec::new();
    for n in 0..SIDE * SIDE * SIDE {
        let x = node_position(grid, coords, n);
        found.extend(colliders.iter().filter_map(|c| c.contact(n as u8, x, grid.spacing)));
    }
    found
}

const _: () = assert!(TILE == SIDE + 2 * TILE_ORIGIN as usize);
