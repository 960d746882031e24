//! Files appear whole or not at all: everything is written to a temporary file in the target's folder and renamed at the end.

use std::{
    io::{self, BufWriter, Seek, SeekFrom, Write},
    path::{Path, PathBuf},
};

use tempfile::NamedTempFile;

use crate::error::{FormatError, Result};

/// A file under construction. Dropping it without [`AtomicFile::commit`] removes every trace of it.
#[derive(Debug)]
pub struct AtomicFile {
    writer: BufWriter<NamedTempFile>,
    path: PathBuf,
    overwrite: bool,
}

impl AtomicFile {
    /// Starts the file that will become `path`. Fails at once if `path` exists and `overwrite` is false, or if its folder
    /// is missing or not writable.
    pub fn create(path: impl AsRef<Path>, overwrite: bool) -> Result<Self> {
        let path = path.as_ref();
        if !overwrite && path.symlink_metadata().is_ok() {
            return Err(FormatError::Exists { path: path.to_path_buf() });
        }
        if path.is_dir() {
            return Err(FormatError::io(path, "write", io::Error::new(io::ErrorKind::IsADirectory, "this is a folder")));
        }
        let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let mut builder = tempfile::Builder::new();
        builder.prefix(".megas-").suffix(".part");
        #[cfg(unix)]
        builder.permissions(<std::fs::Permissions as std::os::unix::fs::PermissionsExt>::from_mode(0o666));
        let file = builder.tempfile_in(folder).map_err(|e| FormatError::io(path, "create a file in this folder", bare(e)))?;
        Ok(Self { writer: BufWriter::with_capacity(1 << 18, file), path: path.to_path_buf(), overwrite })
    }

    /// Where the file will appear.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Makes the file appear under its name, with its content safely on the disk.
    pub fn commit(self) -> Result<()> {
        let Self { writer, path, overwrite } = self;
        let file = writer.into_inner().map_err(|e| FormatError::io(&path, "write", bare(e.into_error())))?;
        // Some file systems report a full disk only here.
        file.as_file().sync_data().map_err(|e| FormatError::io(&path, "write", e))?;
        let renamed = if overwrite { file.persist(&path) } else { file.persist_noclobber(&path) };
        match renamed {
            Ok(_) => Ok(()),
            Err(e) if e.error.kind() == io::ErrorKind::AlreadyExists => Err(FormatError::Exists { path }),
            Err(e) => Err(FormatError::io(&path, "rename the finished file to its name", bare(e.error))),
        }
    }
}

impl Write for AtomicFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.writer.write(bytes).map_err(bare)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.writer.flush().map_err(bare)
    }
}

impl Seek for AtomicFile {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.writer.seek(to).map_err(bare)
    }
}

/// Writes a whole file through `fill`, atomically: at no time can anybody see a part of it, and a failure (an error of
/// `fill`, a full disk) removes the temporary file. An existing file is replaced only if `overwrite` is true.
pub fn write_atomic(path: impl AsRef<Path>, overwrite: bool, fill: impl FnOnce(&mut AtomicFile) -> io::Result<()>) -> Result<()> {
    let mut file = AtomicFile::create(path, overwrite)?;
    fill(&mut file).map_err(|e| FormatError::io(&file.path, "write", bare(e)))?;
    file.commit()
}

/// An I/O error without the temporary file's name, which means nothing to the reader of the message.
fn bare(e: io::Error) -> io::Error {
    let text = e.to_string();
    match text.split_once(" at path ") {
        Some((system, _)) => io::Error::new(e.kind(), system.to_owned()),
        None => e,
    }
}
