//! The error of this crate.

use std::path::PathBuf;

use megas_formats::FormatError;

/// Result of everything in this crate.
pub type Result<T, E = FilmError> = std::result::Result<T, E>;

/// Why pictures could not be made. Every message is one line.
#[derive(Debug, thiserror::Error)]
pub enum FilmError {
    /// The file could not be written.
    #[error(transparent)]
    File(#[from] FormatError),
    /// Images, sizes or ranges that do not fit together.
    #[error("found {found}, expected {expected}")]
    Mismatch {
        /// What was given.
        found: String,
        /// What would have been right.
        expected: String,
    },
    /// The video encoder or the container refused.
    #[error("{}: the video could not be encoded: {reason}", path.display())]
    Video {
        /// The film.
        path: PathBuf,
        /// What the encoder said.
        reason: String,
    },
}

pub(crate) fn mismatch(found: impl Into<String>, expected: impl Into<String>) -> FilmError {
    FilmError::Mismatch { found: found.into(), expected: expected.into() }
}
