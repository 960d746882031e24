//! `.splat`: 32-byte records without a header (splatting.md §1.4).

use std::io::{self, BufRead, Write};

use megas_math::{quat, sh};
use megas_model::{Splats, logit};

use crate::{
    error::{FormatError, Place, Result, TRUNCATED},
    gather::{Gather, row_count},
    source::Source,
    splat_file::{SplatFile, SplatFormat},
};

const RECORD: usize = 32;

/// Reads all records.
pub(crate) fn read<R: BufRead>(source: &mut Source<'_, R>) -> Result<SplatFile> {
    let length = source.remaining();
    if !length.is_multiple_of(RECORD as u64) {
        let place = Place::Byte(length / RECORD as u64 * RECORD as u64);
        let found = format!("{} bytes after the last whole record", length % RECORD as u64);
        return Err(FormatError::defect(source.path, place, found, "a whole number of 32-byte records", TRUNCATED));
    }
    let rows = length / RECORD as u64;
    let mut gather = Gather::new(0, row_count(source.path, "record", rows)?);
    let mut block = vec![0; RECORD * rows.min(1 << 15) as usize];
    let mut left = rows;
    while left > 0 {
        let n = left.min(1 << 15);
        let bytes = &mut block[..n as usize * RECORD];
        source.take(bytes)?;
        for r in bytes.chunks_exact(RECORD) {
            let float = |k: usize| f32::from_le_bytes([r[4 * k], r[4 * k + 1], r[4 * k + 2], r[4 * k + 3]]);
            let unit = |k: usize| f32::from(r[k]) / 255.0;
            let rotation: [f32; 4] = std::array::from_fn(|k| f32::from(r[28 + k]) / 127.5 - 1.0);
            gather.push(
                [float(0), float(1), float(2)],
                // The logarithm of a negative scale is not a number: the row is dropped.
                [float(3).ln(), float(4).ln(), float(5).ln()],
                quat::normalize(rotation).unwrap_or(rotation),
                logit(unit(27)),
                &[24, 25, 26].map(|k| sh::dc_from_rgb(unit(k))),
            );
        }
        left -= n;
    }
    gather.finish(source.path, SplatFormat::Splat, rows)
}

/// Writes all Gaussians; view-dependent colour is lost.
pub(crate) fn write(splats: &Splats, w: &mut dyn Write) -> io::Result<()> {
    for i in 0..splats.len() {
        let mut record = [0; RECORD];
        for (k, v) in splats.mean[i].into_iter().chain(splats.scale(i)).enumerate() {
            record[4 * k..4 * k + 4].copy_from_slice(&v.to_le_bytes());
        }
        let byte = |v: f32| (v * 255.0).round().clamp(0.0, 255.0) as u8;
        for (k, v) in splats.base_rgb(i).into_iter().chain([splats.opacity(i)]).enumerate() {
            record[24 + k] = byte(v);
        }
        let q = quat::normalize(splats.rotation[i]).unwrap_or([1.0, 0.0, 0.0, 0.0]);
        for (k, c) in q.into_iter().enumerate() {
            record[28 + k] = byte(0.5 + 0.5 * c);
        }
        w.write_all(&record)?;
    }
    Ok(())
}
