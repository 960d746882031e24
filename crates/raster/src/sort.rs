//! Stable radix sort of depth keys (splatting.md §3.2).

use crate::project::Chunk;

const BITS: u32 = 11;
const BINS: usize = 1 << BITS;

/// Scratch of the sort; [`Sorter::order`] is the result.
#[derive(Debug, Default)]
pub(crate) struct Sorter {
    /// `(key, slot)`, ascending by key, ties in input order; `slot` is `(chunk, position)` as `chunk · CHUNK + position`.
    pub order: Vec<(u32, u32)>,
    other: Vec<(u32, u32)>,
}

impl Sorter {
    /// Sorts the visible Gaussians of all chunks.
    pub fn sort(&mut self, chunks: &[Chunk]) {
        self.order.clear();
        let (mut low, mut high) = (u32::MAX, 0);
        for (c, chunk) in chunks.iter().enumerate() {
            let base = (c * crate::project::CHUNK) as u32;
            for (k, &key) in chunk.keys.iter().enumerate() {
                self.order.push((key, base + k as u32));
                low = low.min(key);
                high = high.max(key);
            }
        }
        let n = self.order.len();
        if n < 2 {
            return;
        }
        self.other.resize(n, (0, 0));
        // Keys are positive floats, so their bits are ordered; what all share needs no pass.
        let passes = (32 - (high - low).leading_zeros()).div_ceil(BITS);
        for pass in 0..passes {
            let shift = pass * BITS;
            let digit = |key: u32| ((key - low) >> shift) as usize & (BINS - 1);
            let mut counts = [0u32; BINS];
            for &(key, _) in &self.order {
                counts[digit(key)] += 1;
            }
            let mut sum = 0;
            for c in &mut counts {
                sum += std::mem::replace(c, sum);
            }
            for &(key, slot) in &self.order {
                let at = &mut counts[digit(key)];
                self.other[*at as usize] = (key, slot);
                *at += 1;
            }
            std::mem::swap(&mut self.order, &mut self.other);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sorts_like_the_standard_stable_sort() {
        let mut rng = megas_math::rng::Rng::new(7);
        for n in [0, 1, 2, 1000] {
            for spread in [0.0, 1e-3, 1e6] {
                let chunk = Chunk {
                    keys: (0..n).map(|_| ((1.0 + spread * (rng.unit() * 20.0).floor()) as f32).to_bits()).collect(),
                    ..Chunk::default()
                };
                let mut expected: Vec<(u32, u32)> = chunk.keys.iter().copied().zip(0..).collect();
                expected.sort_by_key(|e| e.0);
                let mut s = Sorter::default();
                s.sort(std::slice::from_ref(&chunk));
                assert_eq!(s.order, expected);
            }
        }
    }
}
