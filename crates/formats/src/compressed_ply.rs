//! `.compressed.ply`: four 32-bit words per Gaussian, quantised in the ranges of its chunk of 256 (splatting.md §1.4).

use std::{
    f32::consts::SQRT_2,
    io::{self, BufRead, Write},
};

use megas_math::{quat, sh, vec3};
use megas_model::{Splats, logit};

use crate::{
    error::{FormatError, Place, Result, TRUNCATED},
    gather::{Gather, LOG_SCALE, degree_of_rest, row_count},
    ply::{Column, Element, Header, for_each_block, skip},
    source::Source,
    splat_file::{SplatFile, SplatFormat},
};

/// Gaussians per chunk.
const CHUNK: usize = 256;
const WORDS: [&str; 4] = ["packed_position", "packed_rotation", "packed_scale", "packed_color"];
/// Channels with a range per chunk; the last three are optional.
const RANGED: [&str; 9] = ["x", "y", "z", "scale_x", "scale_y", "scale_z", "r", "g", "b"];

/// Lower and upper ends of the nine channels of one chunk.
#[derive(Clone, Copy)]
struct Ranges([[f32; 2]; 9]);

/// True if a PLY with this header is one of these.
pub(crate) fn recognises(header: &Header) -> bool {
    header.element("chunk").is_some() && header.element("vertex").is_some_and(|v| v.column(WORDS[0]).is_some())
}

/// Reads the rows of a file whose header has been read.
pub(crate) fn read<R: BufRead>(source: &mut Source<'_, R>, header: &Header) -> Result<SplatFile> {
    const REMEDY: &str = "export the file again";
    let path = source.path;
    let mut chunks: Vec<Ranges> = Vec::new();
    let mut words: Vec<[u32; 4]> = Vec::new();
    let mut rest: Vec<u8> = Vec::new();
    let mut degree = 0;
    for element in &header.elements {
        let n = element.count;
        let fits = |source: &Source<'_, R>| element.check_fits(path, header.encoding, source.remaining(), 0);
        match element.name.as_str() {
            "chunk" => {
                let (low, high) = range_columns(path, element)?;
                fits(source)?;
                chunks.reserve_exact(n as usize);
                rows(source, header, element, |row| {
                    chunks.push(Ranges(std::array::from_fn(|k| match (low.get(k), high.get(k)) {
                        (Some(lo), Some(hi)) => [lo.f32(row), hi.f32(row)],
                        _ => [0.0, 1.0],
                    })));
                })?;
            }
            "vertex" => {
                let need = |k: usize| element.need(path, WORDS[k], REMEDY);
                let columns = [need(0)?, need(1)?, need(2)?, need(3)?];
                fits(source)?;
                words.reserve_exact(row_count(path, "vertex", n)?);
                rows(source, header, element, |row| words.push(columns.map(|c| c.u32(row))))?;
            }
            "sh" => {
                let count = element.properties.len();
                let Some(l) = degree_of_rest(count) else {
                    let place = Place::Element("sh".into());
                    let expected = "0, 9, 24 or 45 of them (spherical harmonics of degree 0 to 3)";
                    return Err(FormatError::defect(path, place, format!("{count} properties"), expected, REMEDY));
                };
                degree = l;
                // Reordered from channel-major to [coefficient][channel] on the way in.
                let columns: Vec<Column> = (0..count)
                    .map(|i| element.need(path, &format!("f_rest_{}", (i % 3) * (count / 3) + i / 3), REMEDY))
                    .collect::<Result<_>>()?;
                fits(source)?;
                rest.reserve_exact(n as usize * count);
                rows(source, header, element, |row| rest.extend(columns.iter().map(|c| c.u32(row) as u8)))?;
            }
            _ => skip(source, element, header.encoding)?,
        }
    }
    let stride = (sh::coefficients(degree) - 1) * 3;
    for (name, have, need) in [("chunk", chunks.len(), words.len().div_ceil(CHUNK)), ("sh", rest.len(), words.len() * stride)] {
        if have < need {
            let place = Place::Element(name.into());
            let found = format!("{have} values for {} Gaussians", words.len());
            return Err(FormatError::defect(path, place, found, format!("{need}"), TRUNCATED));
        }
    }
    let mut gather = Gather::new(degree, words.len());
    let mut coefficients = vec![0.0; 3 + stride];
    for (i, w) in words.iter().enumerate() {
        let (mean, log_scale, rotation, rgb, alpha) = decode(*w, &chunks[i / CHUNK]);
        coefficients[..3].copy_from_slice(&rgb.map(sh::dc_from_rgb));
        for (c, &u) in coefficients[3..].iter_mut().zip(&rest[i * stride..]) {
            *c = decode_coefficient(u);
        }
        gather.push(mean, log_scale, rotation, logit(alpha), &coefficients);
    }
    gather.finish(path, SplatFormat::CompressedPly, words.len() as u64)
}

fn rows<R: BufRead>(source: &mut Source<'_, R>, header: &Header, element: &Element, mut each: impl FnMut(&[u8])) -> Result<()> {
    if element.count == 0 {
        return Ok(());
    }
    let stride = element.stride().unwrap_or(1).max(1);
    for_each_block(source, element, header.encoding, |block| {
        block.chunks_exact(stride).for_each(&mut each);
        Ok(())
    })
}

/// Columns of the lower and the upper ends; six or nine of each.
fn range_columns(path: &std::path::Path, element: &Element) -> Result<(Vec<Column>, Vec<Column>)> {
    let channels = if element.column("min_r").is_some() { 9 } else { 6 };
    let side = |prefix: &str| -> Result<Vec<Column>> {
        RANGED[..channels].iter().map(|c| element.need(path, &format!("{prefix}_{c}"), "export the file again")).collect()
    };
    Ok((side("min")?, side("max")?))
}

/// `bits` wide field at `shift` as a fraction of its range.
fn fraction(word: u32, shift: u32, bits: u32) -> f32 {
    let max = (1u32 << bits) - 1;
    ((word >> shift) & max) as f32 / max as f32
}

fn quantise(t: f32, bits: u32) -> u32 {
    let max = ((1u32 << bits) - 1) as f32;
    (t * max).round().clamp(0.0, max) as u32
}

/// Three fractions as 11-10-11 bits.
fn unpack_11_10_11(w: u32) -> [f32; 3] {
    [fraction(w, 21, 11), fraction(w, 11, 10), fraction(w, 0, 11)]
}

fn pack_11_10_11(t: [f32; 3]) -> u32 {
    quantise(t[0], 11) << 21 | quantise(t[1], 10) << 11 | quantise(t[2], 11)
}

fn lerp([lo, hi]: [f32; 2], t: f32) -> f32 {
    // Exact at both ends, so that encoding what was decoded finds the same ranges.
    lo * (1.0 - t) + hi * t
}

fn unlerp([lo, hi]: [f32; 2], v: f32) -> f32 {
    if hi > lo { (v - lo) / (hi - lo) } else { 0.0 }
}

type Decoded = ([f32; 3], [f32; 3], [f32; 4], [f32; 3], f32);

fn decode(w: [u32; 4], ranges: &Ranges) -> Decoded {
    let r = &ranges.0;
    let (p, s) = (unpack_11_10_11(w[0]), unpack_11_10_11(w[2]));
    let largest = (w[1] >> 30) as usize;
    let others = [20, 10, 0].map(|shift| (fraction(w[1], shift, 10) - 0.5) * SQRT_2);
    let squares: f32 = others.iter().map(|v| v * v).sum();
    let mut q = [(1.0 - squares).max(0.0).sqrt(); 4];
    for (k, v) in (0..4).filter(|k| *k != largest).zip(others) {
        q[k] = v;
    }
    let rgb = std::array::from_fn(|k| lerp(r[6 + k], fraction(w[3], 24 - 8 * k as u32, 8)));
    (std::array::from_fn(|k| lerp(r[k], p[k])), std::array::from_fn(|k| lerp(r[3 + k], s[k])), q, rgb, fraction(w[3], 0, 8))
}

/// Coefficients −4…4 in 256 steps; the two outermost bytes mean the ends themselves.
fn decode_coefficient(u: u8) -> f32 {
    let n = match u {
        0 => 0.0,
        255 => 1.0,
        _ => (f32::from(u) + 0.5) / 256.0,
    };
    8.0 * (n - 0.5)
}

fn encode_coefficient(v: f32) -> u8 {
    (256.0 * (v / 8.0 + 0.5)).floor().clamp(0.0, 255.0) as u8
}

/// The nine channels of one Gaussian that chunks have ranges for.
fn channels(s: &Splats, i: usize) -> [f32; 9] {
    let l = s.log_scale[i].map(|v| v.clamp(-LOG_SCALE, LOG_SCALE));
    let (m, c) = (s.mean[i], s.base_rgb(i));
    [m[0], m[1], m[2], l[0], l[1], l[2], c[0], c[1], c[2]]
}

fn encode(s: &Splats, i: usize, ranges: &Ranges) -> [u32; 4] {
    let c = channels(s, i);
    let t: [f32; 9] = std::array::from_fn(|k| unlerp(ranges.0[k], c[k]));
    let q = quat::normalize(s.rotation[i]).unwrap_or([1.0, 0.0, 0.0, 0.0]);
    let largest = (1..4).fold(0, |best, k| if q[k].abs() > q[best].abs() { k } else { best });
    // q and −q are the same rotation: the largest component is made positive and left out.
    let sign = if q[largest] < 0.0 { -1.0 } else { 1.0 };
    let rotation = (0..4).filter(|k| *k != largest).fold(largest as u32, |word, k| word << 10 | quantise(sign * q[k] / SQRT_2 + 0.5, 10));
    let colour = t[6..].iter().fold(0, |word, &v| word << 8 | quantise(v, 8)) << 8 | quantise(s.opacity(i), 8);
    [pack_11_10_11([t[0], t[1], t[2]]), rotation, pack_11_10_11([t[3], t[4], t[5]]), colour]
}

/// Writes the file; rows are put in Morton order first, because a chunk is the more accurate the smaller it is.
pub(crate) fn write(splats: &Splats, w: &mut dyn Write) -> io::Result<()> {
    write_ordered(splats, &morton_order(splats), w)
}

fn write_ordered(splats: &Splats, order: &[usize], w: &mut dyn Write) -> io::Result<()> {
    let rest = (sh::coefficients(splats.sh_degree) - 1) * 3;
    let mut header = format!("ply\nformat binary_little_endian 1.0\nelement chunk {}\n", order.len().div_ceil(CHUNK));
    for group in [0..3, 3..6, 6..9] {
        for side in ["min", "max"] {
            RANGED[group.clone()].iter().for_each(|c| header.push_str(&format!("property float {side}_{c}\n")));
        }
    }
    header.push_str(&format!("element vertex {}\n", order.len()));
    WORDS.iter().for_each(|p| header.push_str(&format!("property uint {p}\n")));
    if rest > 0 {
        header.push_str(&format!("element sh {}\n", order.len()));
        (0..rest).for_each(|k| header.push_str(&format!("property uchar f_rest_{k}\n")));
    }
    header.push_str("end_header\n");
    w.write_all(header.as_bytes())?;

    let ranges: Vec<Ranges> = order
        .chunks(CHUNK)
        .map(|chunk| {
            let start = [[f32::INFINITY, f32::NEG_INFINITY]; 9];
            Ranges(chunk.iter().fold(start, |acc, &i| {
                let c = channels(splats, i);
                std::array::from_fn(|k| [acc[k][0].min(c[k]), acc[k][1].max(c[k])])
            }))
        })
        .collect();
    for r in &ranges {
        for group in [0..3, 3..6, 6..9] {
            for side in 0..2 {
                r.0[group.clone()].iter().try_for_each(|pair| w.write_all(&pair[side].to_le_bytes()))?;
            }
        }
    }
    for (n, &i) in order.iter().enumerate() {
        encode(splats, i, &ranges[n / CHUNK]).iter().try_for_each(|word| w.write_all(&word.to_le_bytes()))?;
    }
    if rest > 0 {
        let mut row = vec![0; rest];
        for &i in order {
            for (k, &c) in splats.sh_of(i)[3..].iter().enumerate() {
                row[(k % 3) * (rest / 3) + k / 3] = encode_coefficient(c);
            }
            w.write_all(&row)?;
        }
    }
    Ok(())
}

fn morton_order(splats: &Splats) -> Vec<usize> {
    let Some((lo, hi)) = splats.bounds() else { return Vec::new() };
    let size = vec3::sub(hi, lo).map(|v| v.max(f32::MIN_POSITIVE));
    let spread = |v: u64| (0..21).fold(0, |m, b| m | (v >> b & 1) << (3 * b));
    let code =
        |m: [f32; 3]| -> u64 { (0..3).map(|k| spread((((m[k] - lo[k]) / size[k]) * 2_097_151.0) as u64) << k).fold(0, |a, b| a | b) };
    let mut keyed: Vec<(u64, usize)> = splats.mean.iter().enumerate().map(|(i, m)| (code(*m), i)).collect();
    keyed.sort_unstable();
    keyed.into_iter().map(|(_, i)| i).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn encoding_what_was_decoded_changes_nothing() {
        let mut s = Splats { sh_degree: 2, ..Splats::default() };
        let mut x = 1u32;
        let mut next = || {
            x = x.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (x >> 8) as f32 / (1 << 24) as f32 - 0.5
        };
        for _ in 0..700 {
            let c: Vec<f32> = (0..27).map(|_| 6.0 * next()).collect();
            s.push([next(), 5.0 * next(), next()], [next(), next() - 6.0, next()], [next(), next(), next(), next()], 8.0 * next(), &c);
        }
        let order: Vec<usize> = (0..s.len()).collect();
        let encoded = |s: &Splats| {
            let mut bytes = Vec::new();
            write_ordered(s, &order, &mut bytes).unwrap();
            bytes
        };
        let decoded = |bytes: &[u8]| {
            let mut source = Source::new(std::path::Path::new("test"), bytes, bytes.len() as u64);
            let header = Header::read(&mut source).unwrap();
            assert!(recognises(&header));
            read(&mut source, &header).unwrap().splats
        };
        let first = encoded(&s);
        let t = decoded(&first);
        let second = encoded(&t);
        // The colour ranges pass through a multiplication and back and may move by one unit in the last place.
        let words = 700 * (16 + 24);
        let (head, tail) = (first.len() - words, second.len() - words);
        let (vertices, colours) = (head..head + 700 * 16, head + 700 * 16..first.len());
        assert!(head == tail && first[colours.clone()] == second[colours]);
        let mut turned = 0;
        for (a, b) in first[vertices.clone()].chunks_exact(16).zip(second[vertices].chunks_exact(16)) {
            assert!(a[..4] == b[..4] && a[8..] == b[8..]);
            // Where two components are equally large, rounding may have made the other one the largest.
            turned += usize::from(a[4..8] != b[4..8]);
        }
        assert!(turned <= 3, "{turned} rotations changed");
        let ranges = |bytes: &[u8]| -> Vec<f32> {
            bytes[..head].rchunks_exact(4).take(3 * 18).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect()
        };
        assert!(ranges(&first).iter().zip(ranges(&second)).all(|(a, b)| (a - b).abs() <= 1e-6 * a.abs().max(1.0)));
        assert_eq!(decoded(&second).mean, t.mean);
    }
}
