//! PLY rows of any encoding as little-endian bytes.

use std::io::BufRead;

use super::header::{Element, Encoding, Kind, Scalar};
use crate::{
    error::{FormatError, Place, Result, quoted},
    source::Source,
};

/// Bytes of rows handed out at once.
const BLOCK: usize = 1 << 20;
/// Bytes a text row may have.
const MAX_TEXT_ROW: usize = 1 << 20;

/// One row that may hold lists: little-endian values, and where each property's values lie.
#[derive(Default)]
pub(crate) struct Row {
    pub bytes: Vec<u8>,
    /// Byte range of each property in `bytes` (without a list's count).
    pub spans: Vec<std::ops::Range<usize>>,
    line: Vec<u8>,
}

impl Row {
    /// The values of property `k`, which has items of type `scalar`.
    pub fn values(&self, k: usize, scalar: Scalar) -> impl ExactSizeIterator<Item = f64> + '_ {
        self.bytes[self.spans[k].clone()].chunks_exact(scalar.size()).map(move |b| scalar.f64(b))
    }
}

/// Hands every row of a list-free element to `each`, as blocks of whole rows of `stride` bytes, in order.
pub(crate) fn for_each_block<R: BufRead>(
    source: &mut Source<'_, R>,
    element: &Element,
    encoding: Encoding,
    mut each: impl FnMut(&[u8]) -> Result<()>,
) -> Result<()> {
    let Some(stride) = element.stride().filter(|s| *s > 0) else {
        let place = Place::Element(element.name.clone());
        return Err(FormatError::defect(source.path, place, "no properties, or lists", "plain numbers", "export the file again"));
    };
    element.check_fits(source.path, encoding, source.remaining(), 0)?;
    let rows_per_block = (BLOCK / stride).max(1) as u64;
    let mut block = vec![0; rows_per_block.min(element.count) as usize * stride];
    let mut row = Row::default();
    let mut done = 0;
    while done < element.count {
        let rows = rows_per_block.min(element.count - done);
        let bytes = &mut block[..rows as usize * stride];
        if encoding == Encoding::Ascii {
            for (k, out) in bytes.chunks_exact_mut(stride).enumerate() {
                next_row(source, element, encoding, done + k as u64, &mut row)?;
                out.copy_from_slice(&row.bytes);
            }
        } else {
            source.take(bytes)?;
            if encoding == Encoding::Big {
                for r in bytes.chunks_exact_mut(stride) {
                    let mut at = 0;
                    for p in &element.properties {
                        let Kind::One(s) = p.kind else { continue };
                        r[at..at + s.size()].reverse();
                        at += s.size();
                    }
                }
            }
        }
        each(bytes)?;
        done += rows;
    }
    Ok(())
}

/// Passes over all rows of an element.
pub(crate) fn skip<R: BufRead>(source: &mut Source<'_, R>, element: &Element, encoding: Encoding) -> Result<()> {
    if element.properties.is_empty() {
        return Ok(());
    }
    element.check_fits(source.path, encoding, source.remaining(), 0)?;
    match element.stride() {
        Some(stride) if encoding != Encoding::Ascii => source.skip(stride as u64 * element.count),
        _ => {
            let mut row = Row::default();
            (0..element.count).try_for_each(|k| next_row(source, element, encoding, k, &mut row))
        }
    }
}

/// Reads the next row, number `index` of its element.
pub(crate) fn next_row<R: BufRead>(
    source: &mut Source<'_, R>,
    element: &Element,
    encoding: Encoding,
    index: u64,
    row: &mut Row,
) -> Result<()> {
    row.bytes.clear();
    row.spans.clear();
    if encoding == Encoding::Ascii {
        return text_row(source, element, row);
    }
    let mut take = |row: &mut Row, scalar: Scalar, n: u64| {
        let from = row.bytes.len();
        let size = scalar.size();
        let bytes = n.checked_mul(size as u64).filter(|b| *b <= source.remaining()).ok_or_else(|| {
            let place = Place::Row { element: element.name.clone(), row: index };
            let found = format!("{n} values claimed and {} bytes left", source.remaining());
            FormatError::defect(source.path, place, found, "no more than the file holds", crate::error::TRUNCATED)
        })?;
        row.bytes.resize(from + bytes as usize, 0);
        source.take(&mut row.bytes[from..])?;
        if encoding == Encoding::Big {
            row.bytes[from..].chunks_exact_mut(size).for_each(<[u8]>::reverse);
        }
        Ok(from)
    };
    for p in &element.properties {
        let (scalar, n) = match p.kind {
            Kind::One(s) => (s, 1),
            Kind::List { count, item } => {
                let at = take(row, count, 1)?;
                let n = count.f64(&row.bytes[at..]);
                row.bytes.truncate(at);
                // A negative count is refused by what it claims: it becomes larger than any file.
                (item, if n < 0.0 { u64::MAX } else { n as u64 })
            }
        };
        let from = take(row, scalar, n)?;
        row.spans.push(from..row.bytes.len());
    }
    Ok(())
}

fn text_row<R: BufRead>(source: &mut Source<'_, R>, element: &Element, row: &mut Row) -> Result<()> {
    let mut line = std::mem::take(&mut row.line);
    loop {
        if !source.line_into(&mut line, MAX_TEXT_ROW)? {
            return Err(source.truncated("the end of the file".into()));
        }
        if line.iter().any(|b| !b.is_ascii_whitespace()) {
            break;
        }
    }
    let text = String::from_utf8_lossy(&line);
    let mut words = text.split_ascii_whitespace();
    let number = source.line();
    let mut next = |bytes: &mut Vec<u8>, scalar: Scalar, property: &str| -> Result<()> {
        let word = words.next();
        if word.is_some_and(|w| push_number(bytes, scalar, w).is_some()) {
            return Ok(());
        }
        let found = word.map_or_else(|| "the end of the line".into(), quoted);
        let expected = format!("a {scalar:?} value of property {}", quoted(property));
        Err(FormatError::defect(source.path, Place::Line(number), found, expected, "correct the line or export the file again"))
    };
    for p in &element.properties {
        let from = row.bytes.len();
        match p.kind {
            Kind::One(s) => next(&mut row.bytes, s, &p.name)?,
            Kind::List { count, item } => {
                next(&mut row.bytes, count, &p.name)?;
                let n = count.f64(&row.bytes[from..]);
                row.bytes.truncate(from);
                // Bounded by the words of the line: the first missing one ends this.
                for _ in 0..n as u64 {
                    next(&mut row.bytes, item, &p.name)?;
                }
            }
        }
        row.spans.push(from..row.bytes.len());
    }
    row.line = line;
    Ok(())
}

/// Appends the little-endian bytes of the number `word`; `None` if it is not one of this type.
fn push_number(bytes: &mut Vec<u8>, scalar: Scalar, word: &str) -> Option<()> {
    // C libraries print "-nan", "nan(ind)" and the like.
    let is_nan = || word.trim_start_matches(['-', '+']).get(..3).is_some_and(|w| w.eq_ignore_ascii_case("nan"));
    match scalar {
        Scalar::F32 => bytes.extend(word.parse::<f32>().ok().or_else(|| is_nan().then_some(f32::NAN))?.to_le_bytes()),
        Scalar::F64 => bytes.extend(word.parse::<f64>().ok().or_else(|| is_nan().then_some(f64::NAN))?.to_le_bytes()),
        Scalar::I8 => bytes.extend(word.parse::<i8>().ok()?.to_le_bytes()),
        Scalar::U8 => bytes.extend(word.parse::<u8>().ok()?.to_le_bytes()),
        Scalar::I16 => bytes.extend(word.parse::<i16>().ok()?.to_le_bytes()),
        Scalar::U16 => bytes.extend(word.parse::<u16>().ok()?.to_le_bytes()),
        Scalar::I32 => bytes.extend(word.parse::<i32>().ok()?.to_le_bytes()),
        Scalar::U32 => bytes.extend(word.parse::<u32>().ok()?.to_le_bytes()),
    }
    Some(())
}
