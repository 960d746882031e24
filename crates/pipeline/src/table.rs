//! The file format of intermediate stages: named binary columns behind a JSON header, with a checksum.
//!
//! Layout (little-endian): 8 magic bytes, u64 length of the header, the header as JSON
//! `{"meta": …, "columns": [{"name", "bytes"}, …]}`, the columns one after another, and an FNV-1a checksum (u64) of
//! everything before it. A file that was cut off or altered is refused.

use std::io::Write;
use std::path::Path;

use bytemuck::{Pod, cast_slice};
use serde::{Deserialize, Serialize};

use crate::Failure;
use crate::disk::write_atomic;

const MAGIC: &[u8; 8] = b"MEGASTB1";
const MAX_HEADER: u64 = 1 << 20;

/// Columns being collected for writing, or read from a file.
#[derive(Default)]
pub struct Table {
    /// Free-form description of the contents.
    pub meta: serde_json::Value,
    columns: Vec<(String, Vec<u8>)>,
}

#[derive(Serialize, Deserialize)]
struct Header {
    meta: serde_json::Value,
    columns: Vec<ColumnHeader>,
}

#[derive(Serialize, Deserialize)]
struct ColumnHeader {
    name: String,
    bytes: u64,
}

impl Table {
    /// An empty table with a description.
    pub fn new(meta: serde_json::Value) -> Self {
        Self { meta, columns: Vec::new() }
    }

    /// Adds a column.
    pub fn push<T: Pod>(&mut self, name: &str, values: &[T]) {
        self.columns.push((name.to_owned(), cast_slice(values).to_vec()));
    }

    /// Takes a column out; every value as `T`.
    pub fn take<T: Pod>(&mut self, name: &str) -> Result<Vec<T>, String> {
        let i = self.columns.iter().position(|(n, _)| n == name).ok_or_else(|| format!("column '{name}' is missing"))?;
        let (_, bytes) = self.columns.swap_remove(i);
        let size = size_of::<T>();
        if bytes.len() % size != 0 {
            return Err(format!("column '{name}' has {} bytes, not a multiple of {size}", bytes.len()));
        }
        Ok(bytemuck::pod_collect_to_vec(&bytes))
    }

    /// Takes a column that must have `rows` values.
    pub fn take_rows<T: Pod>(&mut self, name: &str, rows: usize) -> Result<Vec<T>, String> {
        let v = self.take(name)?;
        if v.len() == rows { Ok(v) } else { Err(format!("column '{name}' has {} rows, expected {rows}", v.len())) }
    }

    /// Writes the table; an existing file is replaced in one step.
    pub fn write(&self, path: &Path) -> Result<(), Failure> {
        let columns = self.columns.iter().map(|(name, b)| ColumnHeader { name: name.clone(), bytes: b.len() as u64 }).collect();
        let header = serde_json::to_vec(&Header { meta: self.meta.clone(), columns }).map_err(|e| Failure::Other(e.to_string()))?;
        let mut sum = Fnv::default();
        write_atomic(path, |w| {
            let length = (header.len() as u64).to_le_bytes();
            let parts = [MAGIC.as_slice(), &length, &header].into_iter().chain(self.columns.iter().map(|(_, b)| b.as_slice()));
            for part in parts {
                sum.update(part);
                w.write_all(part)?;
            }
            w.write_all(&sum.value().to_le_bytes())
        })
    }

    /// Reads a table and verifies its checksum; the error says what is wrong with which file.
    pub fn read(path: &Path) -> Result<Self, Failure> {
        let fail = |what: String| Failure::Input(format!("{}: {what}; delete it (or use --force) to compute it again", path.display()));
        let bytes = std::fs::read(path).map_err(|e| fail(format!("cannot be read ({e})")))?;
        Self::parse(&bytes).map_err(fail)
    }

    fn parse(bytes: &[u8]) -> Result<Self, String> {
        let damaged = || "is cut off or damaged".to_owned();
        if bytes.len() < 24 || &bytes[..8] != MAGIC {
            return Err("is not a stage file of this version".to_owned());
        }
        let (body, sum) = bytes.split_at(bytes.len() - 8);
        let mut fnv = Fnv::default();
        fnv.update(body);
        if fnv.value().to_le_bytes() != sum {
            return Err(damaged());
        }
        let length = u64::from_le_bytes(body[8..16].try_into().map_err(|_| damaged())?);
        if length > MAX_HEADER || length as usize > body.len() - 16 {
            return Err(damaged());
        }
        let (header, mut rest) = body[16..].split_at(length as usize);
        let header: Header = serde_json::from_slice(header).map_err(|_| damaged())?;
        let mut columns = Vec::new();
        for c in header.columns {
            if c.bytes > rest.len() as u64 {
                return Err(damaged());
            }
            let (data, next) = rest.split_at(c.bytes as usize);
            columns.push((c.name, data.to_vec()));
            rest = next;
        }
        Ok(Self { meta: header.meta, columns })
    }
}

/// FNV-1a over 8-byte words (a checksum against accidents, not against attackers), also used to name what a stage was made of.
pub struct Fnv {
    state: u64,
    tail: [u8; 8],
    filled: usize,
}

impl Default for Fnv {
    fn default() -> Self {
        Self { state: 0xcbf2_9ce4_8422_2325, tail: [0; 8], filled: 0 }
    }
}

impl Fnv {
    fn word(&mut self, w: u64) {
        self.state = (self.state ^ w).wrapping_mul(0x0000_0100_0000_01b3).rotate_left(29);
    }

    /// Adds bytes; how they are split over calls makes no difference.
    pub fn update(&mut self, mut bytes: &[u8]) {
        while self.filled != 0 && !bytes.is_empty() {
            self.tail[self.filled] = bytes[0];
            bytes = &bytes[1..];
            self.filled = (self.filled + 1) % 8;
            if self.filled == 0 {
                self.word(u64::from_le_bytes(self.tail));
            }
        }
        let (words, rest) = bytes.as_chunks::<8>();
        for w in words {
            self.word(u64::from_le_bytes(*w));
        }
        for &b in rest {
            self.tail[self.filled] = b;
            self.filled += 1;
        }
    }

    /// The checksum so far.
    pub fn value(&self) -> u64 {
        let mut copy = Self { state: self.state, tail: self.tail, filled: 0 };
        let mut last = [0; 8];
        last[..self.filled].copy_from_slice(&self.tail[..self.filled]);
        copy.word(u64::from_le_bytes(last));
        copy.word(self.filled as u64);
        copy.state
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn round_trip_and_every_truncation_or_flip_is_noticed() -> Result<(), Box<dyn std::error::Error>> {
        let dir = tempfile::tempdir()?;
        let path = dir.path().join("a.bin");
        let mut t = Table::new(serde_json::json!({"frame": 3}));
        t.push("x", &[[1.0f64, 2.0, 3.0], [4.0, 5.0, 6.0]]);
        t.push("id", &[7u32, 8]);
        t.push("phase", &[1u8, 2, 3]);
        t.write(&path)?;
        let mut back = Table::read(&path)?;
        assert_eq!(back.meta["frame"], 3);
        assert_eq!(back.take_rows::<[f64; 3]>("x", 2)?, [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]);
        assert!(back.take_rows::<u32>("id", 3).is_err() && back.take::<u8>("nothing").is_err());
        assert_eq!(back.take::<u8>("phase")?, [1, 2, 3]);
        let bytes = std::fs::read(&path)?;
        for n in 0..bytes.len() {
            assert!(Table::parse(&bytes[..n]).is_err(), "cut at {n}");
            let mut b = bytes.clone();
            b[n] ^= 4;
            assert!(Table::parse(&b).is_err(), "flip at {n}");
        }
        Ok(())
    }

    #[test]
    fn the_checksum_does_not_depend_on_how_bytes_arrive() {
        let data: Vec<u8> = (0..100).collect();
        let mut whole = Fnv::default();
        whole.update(&data);
        for step in [1, 3, 7, 8, 13] {
            let mut parts = Fnv::default();
            data.chunks(step).for_each(|c| parts.update(c));
            assert_eq!(parts.value(), whole.value());
        }
    }
}
