//! A file being read: knows how much of it is left, so that no claim in it is believed before it was compared with that.

use std::{
    fs::File,
    io::{BufRead, BufReader, Read},
    path::Path,
};

use crate::error::{FormatError, Place, Result, TRUNCATED};

/// A reader with a known length and a path for messages.
pub(crate) struct Source<'p, R> {
    pub path: &'p Path,
    reader: R,
    position: u64,
    length: u64,
    line: u64,
}

/// Opens a regular file.
pub(crate) fn open(path: &Path) -> Result<Source<'_, BufReader<File>>> {
    let fail = |e| FormatError::io(path, "open for reading", e);
    let file = File::open(path).map_err(fail)?;
    let meta = file.metadata().map_err(fail)?;
    if !meta.is_file() {
        let found = if meta.is_dir() { "a folder" } else { "a device or a pipe" };
        return Err(FormatError::defect(path, Place::File, found, "a regular file", "give the path of a file on a disk"));
    }
    Ok(Source::new(path, BufReader::with_capacity(1 << 16, file), meta.len()))
}

impl<'p, R: BufRead> Source<'p, R> {
    pub fn new(path: &'p Path, reader: R, length: u64) -> Self {
        Self { path, reader, position: 0, length, line: 0 }
    }

    /// Bytes from here to the end.
    pub fn remaining(&self) -> u64 {
        self.length - self.position
    }

    /// Number of the line read last, from 1.
    pub fn line(&self) -> u64 {
        self.line
    }

    /// The first bytes without taking them; fewer than `n` only if the file is shorter (or `n` exceeds the buffer).
    pub fn peek(&mut self, n: usize) -> Result<&[u8]> {
        let buffer = self.reader.fill_buf().map_err(|e| FormatError::io(self.path, "read", e))?;
        Ok(&buffer[..buffer.len().min(n)])
    }

    /// Fills `buffer`, which the caller has checked to be no longer than [`Source::remaining`].
    pub fn take(&mut self, buffer: &mut [u8]) -> Result<()> {
        let n = buffer.len() as u64;
        if n > self.remaining() {
            return Err(self.truncated(format!("{} of {n} bytes", self.remaining())));
        }
        self.reader.read_exact(buffer).map_err(|e| FormatError::io(self.path, "read", e))?;
        self.position += n;
        Ok(())
    }

    /// Passes over `n` bytes.
    pub fn skip(&mut self, n: u64) -> Result<()> {
        if n > self.remaining() {
            return Err(self.truncated(format!("{} of {n} bytes", self.remaining())));
        }
        let copied = std::io::copy(&mut (&mut self.reader).take(n), &mut std::io::sink());
        let copied = copied.map_err(|e| FormatError::io(self.path, "read", e))?;
        self.position += copied;
        if copied < n { Err(self.truncated("the end of the file".into())) } else { Ok(()) }
    }

    /// Replaces `line` by the next line without its end; false at the end of the file. Lines of more than `limit` bytes
    /// are an error.
    pub fn line_into(&mut self, line: &mut Vec<u8>, limit: usize) -> Result<bool> {
        line.clear();
        let n = (&mut self.reader).take(limit as u64 + 1).read_until(b'\n', line);
        let n = n.map_err(|e| FormatError::io(self.path, "read", e))? as u64;
        self.line += 1;
        self.position = (self.position + n).min(self.length);
        if n > limit as u64 {
            let remedy = "this is not a text file of the expected kind";
            return Err(FormatError::defect(
                self.path,
                Place::Line(self.line),
                format!("more than {limit} bytes"),
                "the end of the line",
                remedy,
            ));
        }
        while matches!(line.last(), Some(b'\n' | b'\r')) {
            line.pop();
        }
        Ok(n > 0)
    }

    pub fn truncated(&self, found: String) -> FormatError {
        FormatError::defect(self.path, Place::Byte(self.position), found, "more data", TRUNCATED)
    }
}
