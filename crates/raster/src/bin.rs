//! Depth-ordered tile lists (splatting.md §3.2), built in parallel without atomics.
//!
//! The depth order is cut into ranges; each range makes tile lists of its own, and the list of a tile is the concatenation
//! of its lists over the ranges. How the order is cut therefore changes nothing but the speed.

use fearless_simd::{Level, dispatch};

use crate::project::{Bounds, Record};

/// The tile lists of one range of the depth order.
#[derive(Debug, Default)]
pub(crate) struct Lists {
    /// `(tile, rank)` in depth order.
    pairs: Vec<(u32, u32)>,
    /// Start of each tile's list in `entries`; one more than there are tiles.
    offsets: Vec<u32>,
    entries: Vec<u32>,
}

impl Lists {
    /// The ranks whose support can touch `tile`, ascending.
    #[inline(always)]
    pub fn of(&self, tile: usize) -> &[u32] {
        &self.entries[self.offsets[tile] as usize..self.offsets[tile + 1] as usize]
    }

    /// Lists the Gaussians `first..first + records.len()` of the depth order.
    pub fn build(&mut self, level: Level, records: &[Record], bounds: &[Bounds], first: u32, tiles: [usize; 2], tile: f32) {
        // Scalar code, but with the instruction set's rounding and square roots.
        dispatch!(level, _simd => self.build_inline(records, bounds, first, tiles, tile));
    }

    #[inline(always)]
    fn build_inline(&mut self, records: &[Record], bounds: &[Bounds], first: u32, tiles: [usize; 2], tile: f32) {
        self.pairs.clear();
        let columns = tiles[0] as u32;
        for (k, (r, b)) in records.iter().zip(bounds).enumerate() {
            let rank = first + k as u32;
            let (x0, x1, y0, y1) = (u32::from(b.x[0]), u32::from(b.x[1]), u32::from(b.y[0]), u32::from(b.y[1]));
            if (x1 - x0) * (y1 - y0) <= 4 {
                // Few enough that the test of the bricks is cheaper than one of the rows.
                for y in y0..y1 {
                    for x in x0..x1 {
                        self.pairs.push((y * columns + x, rank));
                    }
                }
            } else {
                let spans = Spans::new(r);
                for y in y0..y1 {
                    let top = y as f32 * tile + 0.5;
                    if let Some([left, right]) = spans.over(top, top + tile - 1.0) {
                        let from = (((left - 0.5) / tile).floor().max(x0 as f32) as u32).min(x1);
                        let to = ((((right - 0.5) / tile).floor() + 1.0).max(0.0) as u32).min(x1);
                        for x in from..to {
                            self.pairs.push((y * columns + x, rank));
                        }
                    }
                }
            }
        }
        let count = tiles[0] * tiles[1];
        self.offsets.clear();
        self.offsets.resize(count + 1, 0);
        for &(t, _) in &self.pairs {
            self.offsets[t as usize] += 1;
        }
        let mut sum = 0;
        for o in &mut self.offsets {
            sum += *o;
            *o = sum;
        }
        // Filled from the back: afterwards every offset is the start of its list.
        self.entries.resize(self.pairs.len(), 0);
        for &(t, rank) in self.pairs.iter().rev() {
            let at = &mut self.offsets[t as usize];
            *at -= 1;
            self.entries[*at as usize] = rank;
        }
    }
}

/// Horizontal extent of a Gaussian's support over bands of rows.
struct Spans {
    mean: [f32; 2],
    l: [f32; 3],
    limit: f32,
    /// Largest |dy| of the support and the dy of its rightmost point.
    reach: f32,
    rightmost: f32,
}

impl Spans {
    #[inline(always)]
    fn new(r: &Record) -> Self {
        let [_, l2, l3] = r.l;
        let limit = r.limit * 1.0001;
        let reach = limit.sqrt() / l3;
        Self {
            mean: [r.base[0] + r.rest[0], r.base[1] + r.rest[1]],
            l: r.l,
            limit,
            reach,
            rightmost: -l2 * reach / (l2 * l2 + l3 * l3).sqrt(),
        }
    }

    /// Least and greatest x of the support over pixel centres with y in `top..=bottom`, a little too wide.
    #[inline(always)]
    fn over(&self, top: f32, bottom: f32) -> Option<[f32; 2]> {
        let margin = 0.01 + 2e-6 * self.reach;
        let lo = (top - self.mean[1] - margin).max(-self.reach);
        let hi = (bottom - self.mean[1] + margin).min(self.reach);
        if lo > hi {
            return None;
        }
        let edge = |dy: f32, side: f32| {
            let s2 = self.l[2] * dy;
            let s1 = (self.limit - s2 * s2).max(0.0).sqrt();
            (side * s1 - self.l[1] * dy) / self.l[0]
        };
        let right = edge(self.rightmost.max(lo).min(hi), 1.0);
        let left = edge((-self.rightmost).max(lo).min(hi), -1.0);
        let margin = 0.01 + 4e-6 * (right - left).abs();
        Some([self.mean[0] + left - margin, self.mean[0] + right + margin])
    }
}
