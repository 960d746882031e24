//! Thin sheets (simulation.md §6.2): matter on one side of a sheet does not feel matter on the other.
//!
//! Nodes near a sheet know on which side they lie, and so do points. A node and a point on opposite sides are *parted*. In the place
//! of a node from which it is parted a point uses another node, which belongs to its own side alone: the nodes near a sheet exist
//! twice. The second one is held by the sheet like any node inside an obstacle, with the same rules of contact, so weight,
//! friction and sticking come out as on a thick obstacle, and neither mass nor momentum passes. (To leave such
//! pairs out and let the point feel its own velocity after contact in place of the node's, as CPIC does, carries weight by the pressure
//! that is left out, and no friction knows of it: in two dimensions a block on a slope of 30° with μ = 0.3 accelerates with 4.1 m/s² in
//! place of 2.36, and with μ = 0.7 it does not rest.)
//!
//! Points far from sheets never come here: blocks of points without a parted pair have no `Near`, and groups of points without one
//! take the ordinary transfers.

use megas_math::simd::transpose::Record;
use megas_math::vec3;
use rayon::prelude::*;

use super::nodes::{NodeBlock, SIDE, block_center, node_position};
use super::transfer::{CHUNK, Stencils, TILE, Tile, row, weights};
use crate::collider::{Contact, Placed};
use crate::grid::Grid;
use crate::particles::Particles;

/// Sides: bit k is set on the side that the normal of sheet k points to, bit 16 + k on the other side.
pub(crate) type Sides = u32;

/// Largest distance of a node from a point that uses it \[spacings\]: 1.5 √3.
const STENCIL: f64 = 2.6;
/// Points nearer than this take a side \[spacings\]: until the next sort they drift by one spacing, and a sheet by half of one.
const BAND: f64 = STENCIL + 1.6;
/// Points that got further through a sheet than this count as repairs when they are put back \[spacings\].
const THROUGH: f64 = 0.5;

/// Sheets that part a point from a node, bit by bit.
#[inline(always)]
pub(crate) fn parted(point: Sides, node: Sides) -> u16 {
    let x = point & node.rotate_left(16);
    (x | (x >> 16)) as u16
}

/// Sides with sheet `k` set to `side` (or to none).
fn with_side(sides: Sides, k: u8, side: Option<bool>) -> Sides {
    let cleared = sides & !(0x1_0001 << k);
    match side {
        None => cleared,
        Some(true) => cleared | 1 << k,
        Some(false) => cleared | 0x1_0000 << k,
    }
}

/// A node within reach of a sheet.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Tag {
    /// Node inside its block of 4³.
    node: u8,
    /// Number of the sheet.
    sheet: u8,
    /// Distance \[spacings\], ≥ 0 on the side of the normal.
    distance: f32,
    /// Contact level of the sheet \[spacings\].
    level: f64,
    /// What a node here feels that belongs to the positive side; turned round for the other.
    contact: Contact,
}

impl Tag {
    fn side(&self) -> Sides {
        with_side(0, self.sheet, Some(self.distance >= 0.0))
    }

    /// True if its sheet is one of `mask`.
    pub fn parts(&self, mask: u16) -> bool {
        mask >> self.sheet & 1 == 1
    }
}

/// The tags of a block of nodes, by node and sheet.
pub(crate) fn find_tags(grid: &Grid, coords: [u32; 3], sheets: &[&Placed]) -> Vec<Tag> {
    let mut found = Vec::new();
    let near: Vec<&&Placed> =
        sheets.iter().filter(|s| s.on_sheet(block_center(grid, coords), (STENCIL + 2.6) * grid.spacing).is_some()).collect();
    if near.is_empty() {
        return found;
    }
    for n in 0..SIDE * SIDE * SIDE {
        let x = node_position(grid, coords, n);
        for s in &near {
            let (Some(sheet), Some(at)) = (s.sheet, s.on_sheet(x, STENCIL * grid.spacing)) else { continue };
            if !at.rim {
                found.push(Tag {
                    node: n as u8,
                    sheet,
                    distance: (at.distance / grid.spacing) as f32,
                    level: s.collider.offset,
                    contact: s.contact_with(n as u8, at.normal, at.point),
                });
            }
        }
    }
    found
}

/// Gives points that come near a sheet the side they are on, and takes it from those that left it or its rim. Sorted points.
pub(crate) fn take_sides(grid: &Grid, particles: &mut Particles, sheets: &[&Placed]) {
    let p = &*particles;
    let reach = BAND * grid.spacing;
    let changed: Vec<(usize, Vec<Sides>)> = p
        .blocks()
        .par_iter()
        .filter_map(|b| {
            let range = b.start as usize..b.end as usize;
            // Points lie up to half a cell outside the nodes of their block.
            let near: Vec<&&Placed> =
                sheets.iter().filter(|s| s.on_sheet(block_center(grid, b.coords), reach + 3.5 * grid.spacing).is_some()).collect();
            if near.is_empty() && p.sides[range.clone()].iter().all(|s| *s == 0) {
                return None;
            }
            let side = |i: usize| {
                let x = p.position(i);
                near.iter().fold(0, |sides, s| match (s.sheet, s.on_sheet(x, reach)) {
                    (Some(k), Some(at)) if !at.rim => {
                        // Who has a side keeps it, wherever the sheet has got to.
                        let kept = p.sides[i] & (0x1_0001 << k);
                        if kept == 0 { with_side(sides, k, Some(at.distance >= 0.0)) } else { sides | kept }
                    }
                    _ => sides,
                })
            };
            Some((range.start, range.map(side).collect()))
        })
        .collect();
    for (start, sides) in changed {
        particles.sides[start..start + sides.len()].copy_from_slice(&sides);
    }
}

/// Puts points that got through a sheet back on their side of it and removes the velocity that drove them; returns the number of those
/// that got far. (Nodes hold matter to a fraction of a spacing; the sheet is where it is.)
pub(crate) fn put_back(grid: &Grid, particles: &mut Particles, sheets: &[&Placed]) -> u64 {
    let mut count = 0;
    if sheets.is_empty() {
        return count;
    }
    for i in 0..particles.len() {
        let sides = particles.sides[i];
        if sides == 0 {
            continue;
        }
        for s in sheets {
            let Some(k) = s.sheet else { continue };
            let sign = match sides >> k & 0x1_0001 {
                0 => continue,
                1 => 1.0,
                _ => -1.0,
            };
            let x = particles.position(i);
            let Some(at) = s.on_sheet(x, BAND * grid.spacing).filter(|at| !at.rim && sign * at.distance < 0.0) else {
                continue;
            };
            let n = vec3::scale(at.normal, sign);
            particles.set_position(i, vec3::add_scaled(x, n, at.distance.abs()));
            let v: [f64; 3] = vec3::cast(particles.velocity(i));
            let inward = vec3::dot(vec3::sub(v, s.pose.velocity_at(at.point)), n).min(0.0);
            particles.set_velocity(i, vec3::cast(vec3::add_scaled(v, n, -inward)));
            count += u64::from(particles.mass[i] > 0.0 && at.distance.abs() > THROUGH * grid.spacing);
        }
    }
    count
}

/// What a block of points has besides its tile because sheets part some of its points from some of its nodes.
pub(crate) struct Near {
    /// Sides of the nodes of the tile.
    words: Box<[Sides; TILE * TILE * TILE]>,
    pub layers: Vec<Layer>,
}

/// Second nodes of those that the same sheets part from a point.
pub(crate) struct Layer {
    pub mask: u16,
    /// Places in the list of `Ghost`s of the blocks of nodes around, as `super::nodes::Nodes::around`.
    pub around: [u32; 27],
    /// Velocities.
    pub from: Tile,
    /// Momenta.
    pub to: Tile,
}

impl Near {
    /// `None` where no point of the block is parted from a node that it can reach before the next sort. `tags_at` gives the tags of the
    /// blocks of nodes around.
    pub fn new<'a>(sides: &[Sides], tags_at: impl Fn(usize) -> &'a [Tag]) -> Option<Box<Self>> {
        let mut points: Vec<Sides> = sides.iter().copied().filter(|s| *s != 0).collect();
        if points.is_empty() {
            return None;
        }
        points.sort_unstable();
        points.dedup();
        let mut words = Box::new([0; TILE * TILE * TILE]);
        for side in 0..27 {
            for t in tags_at(side) {
                let local = [t.node / 16, t.node / 4 % 4, t.node % 4].map(i64::from);
                let block = [side / 9, side / 3 % 3, side % 3].map(|s| 4 * (s as i64 - 1));
                let c: [i64; 3] = std::array::from_fn(|a| local[a] + block[a] + i64::from(super::transfer::TILE_ORIGIN));
                if c.iter().all(|v| (0..TILE as i64).contains(v)) {
                    words[((c[0] * TILE as i64 + c[1]) * TILE as i64 + c[2]) as usize] |= t.side();
                }
            }
        }
        let mut nodes: Vec<Sides> = words.iter().copied().filter(|w| *w != 0).collect();
        nodes.sort_unstable();
        nodes.dedup();
        let mut masks: Vec<u16> = points.iter().flat_map(|p| nodes.iter().map(|n| parted(*p, *n))).filter(|m| *m != 0).collect();
        masks.sort_unstable();
        masks.dedup();
        let layer = |mask| Layer { mask, around: [u32::MAX; 27], from: Tile::ZERO, to: Tile::ZERO };
        (!masks.is_empty()).then(|| Box::new(Self { words, layers: masks.into_iter().map(layer).collect() }))
    }

    /// Empties the momenta.
    pub fn clear(&mut self) {
        for l in &mut self.layers {
            l.to.0.fill(0.0);
        }
    }

    /// The sheets between a point and the node at `o` of its tile.
    #[inline(always)]
    fn between(&self, sides: Sides, o: usize) -> u16 {
        parted(sides, self.words[o / 4])
    }

    /// The layer in which a point finds the node at `o` of its tile; `None` for the tile itself.
    #[inline(always)]
    fn layer(&self, sides: Sides, o: usize) -> Option<usize> {
        let mask = self.between(sides, o);
        if mask == 0 { None } else { self.layers.iter().position(|l| l.mask == mask) }
    }

    /// True if some point of a group is parted from some node of its stencil.
    pub fn parts(&self, st: &Stencils, sides: &[Sides]) -> bool {
        sides.iter().enumerate().any(|(p, &s)| s != 0 && nodes_of(st.first[p]).any(|(_, o)| self.between(s, o) != 0))
    }

    /// Value of a node as a point with these sides finds it, `[x, y, z, mass]`.
    #[inline(always)]
    pub fn value<'a>(&'a self, tile: &'a Tile, sides: Sides, o: usize) -> &'a [f32] {
        let from = self.layer(sides, o).map_or(tile, |l| &self.layers[l].from);
        &from.0[o..o + 4]
    }

    /// G2P of a group of points, as `super::transfer::gather`.
    pub fn gather(&self, tile: &Tile, st: &Stencils, sides: &[Sides], out: &mut [Record; CHUNK]) {
        for (p, &s) in sides.iter().enumerate() {
            let w = Weights::new(st, p);
            let mut sums = [0.0f32; 16];
            for ([i, j, k], o) in nodes_of(st.first[p]) {
                let q = self.value(tile, s, o);
                for (m, f) in w.factors(i, j, k).into_iter().enumerate() {
                    for c in 0..4 {
                        sums[4 * m + c] = f.mul_add(q[c], sums[4 * m + c]);
                    }
                }
            }
            out[p] = Record(sums);
        }
    }

    /// P2G of a group of points, as `super::transfer::scatter`.
    pub fn scatter(&mut self, tile: &mut Tile, st: &Stencils, sides: &[Sides], records: &[Record; CHUNK]) -> u32 {
        let mut regions = 0;
        for (p, &s) in sides.iter().enumerate() {
            let w = Weights::new(st, p);
            let r = &records[p].0;
            regions |= super::transfer::touched(st.first[p]);
            for ([i, j, k], o) in nodes_of(st.first[p]) {
                let [plain, x, y, z] = w.factors(i, j, k);
                let add = std::array::from_fn(|c| plain.mul_add(r[c], x.mul_add(r[4 + c], y.mul_add(r[8 + c], z * r[12 + c]))));
                self.add(tile, s, o, add);
            }
        }
        regions
    }

    /// Adds to a node as a point with these sides finds it.
    #[inline(always)]
    pub fn add(&mut self, tile: &mut Tile, sides: Sides, o: usize, value: [f32; 4]) {
        let to = match self.layer(sides, o) {
            Some(l) => &mut self.layers[l].to,
            None => tile,
        };
        for (t, v) in to.0[o..o + 4].iter_mut().zip(value) {
            *t += v;
        }
    }
}

/// Places of the 27 nodes of a stencil in a tile.
#[inline(always)]
fn nodes_of(first: u32) -> impl Iterator<Item = ([usize; 3], usize)> {
    (0..27).map(move |n| {
        let [i, j, k] = [n / 9, n / 3 % 3, n % 3];
        ([i, j, k], row(first, i, j) + 4 * k)
    })
}

/// Weights of one point.
struct Weights {
    w: [[f32; 3]; 3],
    /// Weights times distance, per axis.
    d: [[f32; 3]; 3],
}

impl Weights {
    #[inline(always)]
    fn new(st: &Stencils, p: usize) -> Self {
        let g = st.gz[p];
        let z = weights(g);
        let of = |a: &[[f32; CHUNK]; 3]| [a[0][p], a[1][p], a[2][p]];
        Self { w: [of(&st.wx), of(&st.wy), z], d: [of(&st.dx), of(&st.dy), std::array::from_fn(|k| z[k] * (k as f32 - 1.0 - g))] }
    }

    /// Weight of a node, and weight times distance along x, y, z.
    #[inline(always)]
    fn factors(&self, i: usize, j: usize, k: usize) -> [f32; 4] {
        let ([wx, wy, wz], [dx, dy, dz]) = (self.w, self.d);
        let yz = wy[j] * wz[k];
        [wx[i] * yz, dx[i] * yz, wx[i] * dy[j] * wz[k], wx[i] * wy[j] * dz[k]]
    }
}

/// The second nodes of a block that a set of sheets parts from points.
pub(crate) struct Ghost {
    /// The block in the list of blocks of nodes.
    pub block: u32,
    /// Blocks of points around it that have such a layer, and which of their layers it is; by the index of
    /// `super::nodes::NodeInfo`.
    pub tiles: Vec<(u8, u32, u32)>,
    pub contacts: Vec<Contact>,
    /// Liquid share of the mass of each node.
    pub liquid: Option<Box<[f32; 64]>>,
    pub values: NodeBlock,
}

/// Adds to the contacts of a block of nodes those that sheets make, for the points that the sheets of `mask` part from them: none of
/// those of the nodes themselves.
pub(crate) fn with_sheets(mask: u16, mut contacts: Vec<Contact>, tags: &[Tag]) -> Vec<Contact> {
    for t in tags {
        let parted = t.parts(mask);
        // On which side of the sheet the node is felt, and how far over it.
        let positive = (t.distance >= 0.0) != parted;
        let height = if parted { -t.distance.abs() } else { t.distance.abs() };
        if f64::from(height) < t.level || (parted && t.level >= 0.0) {
            let normal = if positive { t.contact.normal } else { t.contact.normal.map(|v| -v) };
            contacts.push(Contact { normal, ..t.contact });
        }
    }
    contacts.sort_by_key(|c| (c.node, c.collider));
    contacts
}
