//! Records of sixteen floats ↔ lanes: the change between "one point after the other" and "one quantity of many points".

use fearless_simd::{Simd, SimdBase};

use super::Lanes;

/// Values per record.
pub const RECORD: usize = 16;

/// One record, aligned so that it never straddles a cache line.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub struct Record(pub [f32; RECORD]);

impl Record {
    /// All zero.
    pub const ZERO: Self = Self([0.0; RECORD]);
}

/// Transposes the leading `LEN × LEN` square in place by perfect shuffles.
#[inline(always)]
fn square<S: Simd>(m: &mut [Lanes<S>; RECORD]) {
    let n = Lanes::<S>::LEN;
    let half = n / 2;
    let mut round = 1;
    while round < n {
        let old = *m;
        for i in 0..half {
            (m[2 * i], m[2 * i + 1]) = old[i].interleave(old[i + half]);
        }
        round *= 2;
    }
}

/// Reads `LEN` records and returns quantity `q` of all of them in lane vector `q`.
#[inline(always)]
pub fn load_records<S: Simd>(s: S, records: &[Record]) -> [Lanes<S>; RECORD] {
    let n = Lanes::<S>::LEN;
    let records = &records[..n];
    let zero = Lanes::<S>::splat(s, 0.0);
    let mut out = [zero; RECORD];
    for b in 0..RECORD / n {
        let mut m = [zero; RECORD];
        for i in 0..n {
            m[i] = Lanes::<S>::from_slice(s, &records[i].0[b * n..(b + 1) * n]);
        }
        square::<S>(&mut m);
        for i in 0..n {
            out[b * n + i] = m[i];
        }
    }
    out
}

/// Writes lane vector `q` as quantity `q` of `LEN` records.
#[inline(always)]
pub fn store_records<S: Simd>(s: S, values: &[Lanes<S>; RECORD], records: &mut [Record]) {
    let n = Lanes::<S>::LEN;
    let records = &mut records[..n];
    let zero = Lanes::<S>::splat(s, 0.0);
    for b in 0..RECORD / n {
        let mut m = [zero; RECORD];
        for i in 0..n {
            m[i] = values[b * n + i];
        }
        square::<S>(&mut m);
        for i in 0..n {
            m[i].store_slice(&mut records[i].0[b * n..(b + 1) * n]);
        }
    }
}

#[cfg(test)]
mod tests {
    use fearless_simd::{Level, dispatch};

    use super::*;

    #[inline(always)]
    fn round_trip<S: Simd>(s: S) {
        let n = Lanes::<S>::LEN;
        let mut records = [Record::ZERO; RECORD];
        for (r, rec) in records.iter_mut().enumerate() {
            rec.0 = std::array::from_fn(|q| (100 * r + q) as f32);
        }
        let lanes = load_records(s, &records);
        for (q, v) in lanes.iter().enumerate() {
            for r in 0..n {
                assert_eq!(v[r], (100 * r + q) as f32);
            }
        }
        let mut back = [Record::ZERO; RECORD];
        store_records(s, &lanes, &mut back);
        for r in 0..n {
            assert_eq!(back[r].0, records[r].0);
        }
    }

    #[test]
    fn records_become_lanes_and_back() {
        let level = Level::new();
        dispatch!(level, s => round_trip(s));
    }
}
