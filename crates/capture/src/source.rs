//! A file being read: knows how much of it is left, so that no claim in it is believed before it was compared with that.

use std::{
    fs::File,
    io::{BufRead, BufReader, Read},
    path::{Path, PathBuf},
};

use crate::error::{CaptureError, Fault, Result, TRUNCATED};

/// Longest line of a text file \[bytes\]: the 2-D points of one image stand on a single one.
const MAX_LINE: u64 = 64 << 20;

/// A buffered reader with a known length and a path for messages; little endian.
pub(crate) struct Source<R = BufReader<File>> {
    path: PathBuf,
    reader: R,
    position: u64,
    length: u64,
    line: u64,
}

/// Opens a regular file.
pub(crate) fn open(path: &Path) -> Result<Source> {
    let file = File::open(path).map_err(|e| CaptureError::io(path, "open for reading", e))?;
    let length = regular(path, &file)?;
    Ok(Source::new(path, BufReader::with_capacity(1 << 16, file), length))
}

/// Reads a whole file of at most `limit` bytes.
pub(crate) fn read_whole(path: &Path, limit: u64) -> Result<Vec<u8>> {
    let file = File::open(path).map_err(|e| CaptureError::io(path, "open for reading", e))?;
    let length = regular(path, &file)?;
    if length > limit {
        let fault = Fault::new(format!("{length} bytes"), format!("at most {limit}"), "this is not a file of the expected kind");
        return Err(fault.at(path, "the file"));
    }
    let mut bytes = Vec::with_capacity(length as usize);
    // A file that grows while it is read is cut at the limit.
    file.take(limit).read_to_end(&mut bytes).map_err(|e| CaptureError::io(path, "read", e))?;
    Ok(bytes)
}

fn regular(path: &Path, file: &File) -> Result<u64> {
    let meta = file.metadata().map_err(|e| CaptureError::io(path, "open for reading", e))?;
    if !meta.is_file() {
        let found = if meta.is_dir() { "a folder" } else { "a device or a pipe" };
        return Err(Fault::new(found, "a regular file", "put the file itself there").at(path, "the file"));
    }
    Ok(meta.len())
}

impl<R: BufRead> Source<R> {
    pub fn new(path: &Path, reader: R, length: u64) -> Self {
        Self { path: path.to_path_buf(), reader, position: 0, length, line: 0 }
    }

    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Bytes from here to the end.
    pub fn remaining(&self) -> u64 {
        self.length - self.position
    }

    /// Where the next value stands, for messages.
    pub fn place(&self) -> String {
        if self.line > 0 { format!("line {}", self.line) } else { format!("byte {}", self.position) }
    }

    pub fn array<const N: usize>(&mut self) -> Result<[u8; N]> {
        let mut bytes = [0; N];
        if N as u64 > self.remaining() {
            return Err(self.truncated(format!("{} of {N} bytes", self.remaining())));
        }
        self.reader.read_exact(&mut bytes).map_err(|e| CaptureError::io(&self.path, "read", e))?;
        self.position += N as u64;
        Ok(bytes)
    }

    pub fn i32(&mut self) -> Result<i32> {
        self.array().map(i32::from_le_bytes)
    }

    pub fn u64(&mut self) -> Result<u64> {
        self.array().map(u64::from_le_bytes)
    }

    pub fn f64(&mut self) -> Result<f64> {
        self.array().map(f64::from_le_bytes)
    }

    pub fn f64s<const N: usize>(&mut self) -> Result<[f64; N]> {
        let mut values = [0.0; N];
        for v in &mut values {
            *v = self.f64()?;
        }
        Ok(values)
    }

    /// A count of things of at least `least` bytes each; refused if the rest of the file cannot hold them.
    pub fn count(&mut self, least: u64, what: &str) -> Result<u64> {
        let place = self.place();
        let n = self.u64()?;
        if n.checked_mul(least).is_none_or(|bytes| bytes > self.remaining()) {
            let found = format!("{n} {what} of at least {least} bytes claimed and {} bytes left", self.remaining());
            return Err(Fault::new(found, format!("at most {} {what}", self.remaining() / least), TRUNCATED).at(&self.path, place));
        }
        Ok(n)
    }

    /// Passes over `n` items of `size` bytes.
    pub fn skip(&mut self, n: u64, size: u64) -> Result<()> {
        let Some(bytes) = n.checked_mul(size).filter(|b| *b <= self.remaining()) else {
            return Err(self.truncated(format!("{n} items of {size} bytes claimed and {} bytes left", self.remaining())));
        };
        let copied = std::io::copy(&mut (&mut self.reader).take(bytes), &mut std::io::sink());
        let copied = copied.map_err(|e| CaptureError::io(&self.path, "read", e))?;
        self.position += copied;
        if copied < bytes { Err(self.truncated("the end of the file".into())) } else { Ok(()) }
    }

    /// The bytes before the next NUL, which is passed over; at most `limit` of them.
    pub fn nul_terminated(&mut self, limit: usize) -> Result<Vec<u8>> {
        let mut bytes = Vec::new();
        let n = (&mut self.reader).take(limit as u64 + 1).read_until(0, &mut bytes);
        let n = n.map_err(|e| CaptureError::io(&self.path, "read", e))?;
        if bytes.pop() != Some(0) {
            return Err(self.truncated(format!("a name of {n} bytes without its end")));
        }
        self.position = (self.position + n as u64).min(self.length);
        Ok(bytes)
    }

    /// Replaces `line` by the next line without its end; false at the end of the file.
    pub fn line_into(&mut self, line: &mut String) -> Result<bool> {
        let mut bytes = std::mem::take(line).into_bytes();
        bytes.clear();
        let n = (&mut self.reader).take(MAX_LINE).read_until(b'\n', &mut bytes);
        let n = n.map_err(|e| CaptureError::io(&self.path, "read", e))? as u64;
        self.line += 1;
        self.position = (self.position + n).min(self.length);
        let not_text = |found: &str| Fault::new(found, "a line of text", "this is not a text file of the expected kind");
        if n == MAX_LINE {
            return Err(not_text("64 MiB without a line end").at(&self.path, self.place()));
        }
        *line = String::from_utf8(bytes).map_err(|_| not_text("bytes that are not UTF-8").at(&self.path, self.place()))?;
        line.truncate(line.trim_end_matches(['\n', '\r']).len());
        Ok(n > 0)
    }

    fn truncated(&self, found: String) -> CaptureError {
        Fault::new(found, "more data", TRUNCATED).at(&self.path, self.place())
    }
}
