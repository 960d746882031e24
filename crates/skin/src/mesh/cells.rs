//! Particles in cells: a sparse grid of cells of one kernel radius, 8³ cells to a brick, bricks in a hash map. Says in
//! constant time which particles are near a place, and which places are certainly outside, certainly inside or neither.

use std::collections::HashMap;
use std::hash::{BuildHasherDefault, Hasher};

use rayon::prelude::*;

/// Cells along an axis of a brick.
const BRICK: i32 = 8;
/// Cells of a brick.
const CELLS: usize = 512;

/// What is known about the nodes in a cell without looking at distances.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Class {
    /// No particle in the cell and the 26 around it: farther than a kernel radius from all of them.
    Outside,
    /// The field has to be evaluated.
    Near,
    /// The cell is well filled, and none of the 26 around it is empty. Holes that are smaller than a cell are no holes of the
    /// body but of the sampling (splatting.md §7.7, step 2).
    Inside,
}

/// A hasher for keys that are numbers already: one multiplication. Its results are only looked up, never iterated.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Mix(u64);

impl Hasher for Mix {
    fn finish(&self) -> u64 {
        self.0
    }

    fn write(&mut self, bytes: &[u8]) {
        bytes.iter().for_each(|b| self.write_u64(u64::from(*b)));
    }

    fn write_u64(&mut self, v: u64) {
        let x = (self.0 ^ v).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        self.0 = x ^ (x >> 29);
    }
}

pub(crate) type Lookup = HashMap<u64, u32, BuildHasherDefault<Mix>>;

/// Three coordinates of up to ±2²⁰ in one number that sorts by z, then y, then x.
#[inline(always)]
pub(crate) fn pack(c: [i32; 3]) -> u64 {
    let u = |v: i32| u64::from((v + (1 << 20)) as u32 & 0x1f_ffff);
    u(c[2]) << 42 | u(c[1]) << 21 | u(c[0])
}

/// Inverse of [`pack`].
#[inline(always)]
pub(crate) fn unpack(key: u64) -> [i32; 3] {
    let v = |k: u64| (k & 0x1f_ffff) as i32 - (1 << 20);
    [v(key), v(key >> 21), v(key >> 42)]
}

/// Particles in a well filled cell: at rest there are 8, and a gap of one cell that lies astride leaves 4 in each.
const FILLED: u32 = 5;

/// The particles, sorted by cell, in voxel units.
pub(crate) struct Cells {
    /// Edge of a cell = kernel radius \[voxels\].
    pub edge: f32,
    /// Positions by axis, sorted by brick and cell, relative to the grid's origin; a few values more than particles, so
    /// that whole vectors can be read anywhere.
    pub position: [Vec<f32>; 3],
    /// Index of each sorted particle in the input.
    pub order: Vec<u32>,
    /// First particle of every cell of every brick with particles, and the end.
    starts: Vec<u32>,
    /// Bricks with particles.
    full: Lookup,
    /// Bricks with classes other than [`Class::Outside`].
    classes: Lookup,
    /// Classes of 512 cells each.
    class: Vec<[Class; CELLS]>,
    /// Brick coordinates of `class`, ascending.
    pub bricks: Vec<[i32; 3]>,
}

/// Readable values behind the last particle.
pub(crate) const PADDING: usize = 16;

#[inline(always)]
fn split(cell: [i32; 3]) -> ([i32; 3], usize) {
    let brick = cell.map(|c| c.div_euclid(BRICK));
    let l = cell.map(|c| c.rem_euclid(BRICK) as usize);
    (brick, (l[2] * 8 + l[1]) * 8 + l[0])
}

impl Cells {
    /// Sorts `points` (voxel units) into cells of `edge` voxels. Points that are not finite or farther than a million cells
    /// from the origin must have been left out.
    pub fn new(points: &[[f32; 3]], edge: f32) -> Self {
        let mut cells = Self {
            edge,
            position: Default::default(),
            order: Vec::new(),
            starts: Vec::new(),
            full: Lookup::default(),
            classes: Lookup::default(),
            class: Vec::new(),
            bricks: Vec::new(),
        };
        let at: Vec<(u64, u16)> = points
            .par_iter()
            .with_min_len(4096)
            .map(|p| {
                let (brick, local) = split(cells.cell_of(*p));
                (pack(brick), local as u16)
            })
            .collect();
        let mut keys: Vec<u64> = Vec::new();
        for (k, _) in &at {
            if keys.last() != Some(k) {
                keys.push(*k);
            }
        }
        keys.sort_unstable();
        keys.dedup();
        cells.full = keys.iter().enumerate().map(|(i, k)| (*k, i as u32)).collect();
        let mut last = (u64::MAX, 0);
        let slots: Vec<u32> = at
            .iter()
            .map(|(key, local)| {
                if last.0 != *key {
                    last = (*key, cells.full[key]);
                }
                last.1 * CELLS as u32 + u32::from(*local)
            })
            .collect();
        cells.starts = vec![0; keys.len() * CELLS + 1];
        slots.iter().for_each(|s| cells.starts[*s as usize + 1] += 1);
        for k in 1..cells.starts.len() {
            cells.starts[k] += cells.starts[k - 1];
        }
        let mut next = cells.starts.clone();
        cells.order = vec![0; points.len()];
        for (i, s) in slots.iter().enumerate() {
            let to = &mut next[*s as usize];
            cells.order[*to as usize] = i as u32;
            *to += 1;
        }
        for a in 0..3 {
            cells.position[a] = cells.order.iter().map(|i| points[*i as usize][a]).collect();
            cells.position[a].resize(points.len() + PADDING, 0.0);
        }
        cells.classify(&keys);
        cells
    }

    /// Cell that contains a position.
    #[inline(always)]
    pub fn cell_of(&self, p: [f32; 3]) -> [i32; 3] {
        p.map(|v| (v / self.edge).floor() as i32)
    }

    /// Cell that contains node `i` of an axis.
    #[inline(always)]
    pub fn cell_of_node(&self, i: i32) -> i32 {
        (i as f32 / self.edge).floor() as i32
    }

    fn classify(&mut self, keys: &[u64]) {
        let mut wanted: Vec<u64> = keys
            .iter()
            .flat_map(|k| {
                let b = unpack(*k);
                (0..27).map(move |n| pack([b[0] + n % 3 - 1, b[1] + n / 3 % 3 - 1, b[2] + n / 9 - 1]))
            })
            .collect();
        wanted.sort_unstable();
        wanted.dedup();
        let made: Vec<(u64, [Class; CELLS])> = wanted
            .par_iter()
            .filter_map(|k| {
                let class = self.classes_of(unpack(*k));
                class.iter().any(|c| *c != Class::Outside).then_some((*k, class))
            })
            .collect();
        self.classes = made.iter().enumerate().map(|(i, (k, _))| (*k, i as u32)).collect();
        self.bricks = made.iter().map(|(k, _)| unpack(*k)).collect();
        self.class = made.into_iter().map(|(_, c)| c).collect();
    }

    /// Occupancy of a brick and one cell around it, then minimum and maximum over 3³ cells; rows of cells are bits.
    fn classes_of(&self, brick: [i32; 3]) -> [Class; CELLS] {
        let mut rows = [0u16; 100];
        for n in 0..27 {
            let d = [n % 3 - 1, n / 3 % 3 - 1, n / 9 - 1];
            let Some(&slot) = self.full.get(&pack([brick[0] + d[0], brick[1] + d[1], brick[2] + d[2]])) else { continue };
            let starts = &self.starts[slot as usize * CELLS..(slot as usize + 1) * CELLS + 1];
            // Cells of the neighbour that lie inside the frame of 10³, and where they go.
            let range = |d: i32| if d < 0 { 7..8 } else { 0..if d > 0 { 1 } else { 8 } };
            let to = |d: i32, l: usize| if d < 0 { 0 } else { l + if d > 0 { 9 } else { 1 } };
            for z in range(d[2]) {
                for y in range(d[1]) {
                    let from = (z * 8 + y) * 8;
                    let bits = range(d[0]).fold(0u16, |b, x| b | u16::from(starts[from + x + 1] > starts[from + x]) << to(d[0], x));
                    rows[to(d[2], z) * 10 + to(d[1], y)] |= bits;
                }
            }
        }
        let any = rows.map(|r| r | r >> 1 | r >> 2);
        let all = rows.map(|r| r & r >> 1 & r >> 2);
        let own = self.full.get(&pack(brick)).map(|slot| *slot as usize * CELLS);
        let filled = |cell: usize| own.is_some_and(|from| self.starts[from + cell + 1] - self.starts[from + cell] >= FILLED);
        let mut class = [Class::Outside; CELLS];
        for z in 0..8 {
            for y in 0..8 {
                let (mut one, mut every) = (0u16, !0u16);
                for k in 0..9 {
                    let row = (z + k / 3) * 10 + y + k % 3;
                    one |= any[row];
                    every &= all[row];
                }
                for x in 0..8 {
                    let cell = (z * 8 + y) * 8 + x;
                    class[cell] = match (one >> x & 1, every >> x & 1) {
                        (0, _) => Class::Outside,
                        (_, 1) if filled(cell) => Class::Inside,
                        _ => Class::Near,
                    };
                }
            }
        }
        class
    }

    /// Class of the nodes in a cell.
    pub fn class(&self, cell: [i32; 3]) -> Class {
        let (brick, local) = split(cell);
        self.classes.get(&pack(brick)).map_or(Class::Outside, |b| self.class[*b as usize][local])
    }

    /// Cells of class [`Class::Near`] of brick number `b`.
    pub fn near_cells(&self, b: usize) -> impl Iterator<Item = [i32; 3]> + '_ {
        let origin = self.bricks[b].map(|c| c * BRICK);
        self.class[b].iter().enumerate().filter(|(_, c)| **c == Class::Near).map(move |(l, _)| {
            let l = l as i32;
            [origin[0] + l % 8, origin[1] + l / 8 % 8, origin[2] + l / 64]
        })
    }

    /// Hands out the ranges of sorted particles in the cells `low..=high`, in a fixed order.
    #[inline(always)]
    pub fn for_ranges(&self, low: [i32; 3], high: [i32; 3], mut each: impl FnMut(std::ops::Range<usize>)) {
        let (bl, bh) = (low.map(|c| c.div_euclid(BRICK)), high.map(|c| c.div_euclid(BRICK)));
        for bz in bl[2]..=bh[2] {
            for by in bl[1]..=bh[1] {
                for bx in bl[0]..=bh[0] {
                    let Some(&slot) = self.full.get(&pack([bx, by, bz])) else { continue };
                    let starts = &self.starts[slot as usize * CELLS..(slot as usize + 1) * CELLS + 1];
                    let b = [bx, by, bz].map(|v| v * BRICK);
                    let from: [i32; 3] = std::array::from_fn(|a| (low[a] - b[a]).max(0));
                    let to: [i32; 3] = std::array::from_fn(|a| (high[a] - b[a]).min(BRICK - 1));
                    for z in from[2]..=to[2] {
                        for y in from[1]..=to[1] {
                            let row = ((z * 8 + y) * 8) as usize;
                            let range = starts[row + from[0] as usize] as usize..starts[row + to[0] as usize + 1] as usize;
                            if !range.is_empty() {
                                each(range);
                            }
                        }
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use megas_math::rng::Rng;

    #[test]
    fn ranges_and_classes_agree_with_a_linear_search() {
        let mut rng = Rng::new(5);
        let points: Vec<[f32; 3]> = (0..9000).map(|_| std::array::from_fn(|a| rng.range(-40.0, [-10.0, -15.0, -20.0][a]) as f32)).collect();
        let cells = Cells::new(&points, 3.0);
        let cell: Vec<[i32; 3]> = points.iter().map(|p| cells.cell_of(*p)).collect();
        let mut seen = [0; 3];
        for _ in 0..400 {
            let c: [i32; 3] = std::array::from_fn(|_| rng.range(-16.0, -1.0) as i32);
            let inside = |q: &[i32; 3], r: i32| (0..3).all(|a| (q[a] - c[a]).abs() <= r);
            let mut got = Vec::new();
            cells.for_ranges(c.map(|v| v - 1), c.map(|v| v + 1), |r| got.extend(r.map(|k| cells.order[k])));
            got.sort_unstable();
            let expected: Vec<u32> = (0..points.len() as u32).filter(|i| inside(&cell[*i as usize], 1)).collect();
            assert_eq!(got, expected);
            let full = (0..27).filter(|n| {
                let q = [c[0] + n % 3 - 1, c[1] + n / 3 % 3 - 1, c[2] + n / 9 - 1];
                cell.contains(&q)
            });
            let class = match full.count() {
                0 => Class::Outside,
                27 if cell.iter().filter(|q| **q == c).count() >= 5 => Class::Inside,
                _ => Class::Near,
            };
            assert_eq!(cells.class(c), class);
            seen[class as usize] += 1;
        }
        assert!(seen.iter().all(|n| *n > 5), "{seen:?}");
        for v in [[0, 0, 0], [-5, 7, 1 << 19], [1 << 19, -(1 << 19), -1]] {
            assert_eq!(unpack(pack(v)), v);
        }
    }
}
