//! The one error of this crate: which file, where in it, what was found, what was expected and what to do about it.

use std::{
    fmt, io,
    path::{Path, PathBuf},
};

/// Result of everything in this crate.
pub type Result<T, E = CaptureError> = std::result::Result<T, E>;

/// Why a capture could not be loaded. Every message is one line.
#[derive(Debug, thiserror::Error)]
pub enum CaptureError {
    /// The operating system refused.
    #[error("{}: cannot {action}: {source}", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// What was being done, as a verb phrase.
        action: &'static str,
        /// The system's answer.
        #[source]
        source: io::Error,
    },
    /// The folder holds no capture.
    #[error("{}: not a capture: {why}", folder.display())]
    NotACapture {
        /// The folder that was given.
        folder: PathBuf,
        /// What was looked for and what to do.
        why: String,
    },
    /// The content of a file is not what it should be.
    #[error("{}: {defect}", path.display())]
    Malformed {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        defect: Box<Defect>,
    },
    /// Listed photographs are not on the disk.
    #[error("{}: {missing} of {listed} listed images are missing: {}{}; {remedy}", folder.display(), first.join(", "), if *missing > first.len() { ", …" } else { "" })]
    MissingImages {
        /// The folder they were looked for in.
        folder: PathBuf,
        /// How many are missing.
        missing: usize,
        /// How many are listed.
        listed: usize,
        /// The first three of them, as looked for.
        first: Vec<String>,
        /// What to do.
        remedy: String,
    },
    /// The photographs do not fit the memory budget.
    #[error("{}: the photographs need {} and the memory budget is {}; {remedy}", folder.display(), gib(*need_bytes), gib(*budget_bytes))]
    OverBudget {
        /// The folder.
        folder: PathBuf,
        /// What loading needs \[bytes\].
        need_bytes: u64,
        /// What the options allow \[bytes\].
        budget_bytes: u64,
        /// Which downscale would fit.
        remedy: String,
    },
    /// An option has no meaning.
    #[error("{option}: found {found}, expected {expected}")]
    Option {
        /// Name of the option.
        option: &'static str,
        /// Its value.
        found: String,
        /// What is allowed.
        expected: &'static str,
    },
    /// The user stopped the loading; nothing was written.
    #[error("stopped while the photographs were loaded; nothing was written")]
    Stopped,
    /// The point cloud beside the poses could not be read.
    #[error(transparent)]
    Cloud(#[from] megas_formats::FormatError),
}

/// What is wrong with the content of a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Defect {
    /// Where: a byte, a line, a frame, a camera.
    pub place: String,
    /// What stands there.
    pub found: String,
    /// What should stand there.
    pub expected: String,
    /// What a person can do about it.
    pub remedy: String,
}

impl fmt::Display for Defect {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: found {}, expected {}; {}", self.place, self.found, self.expected, self.remedy)
    }
}

/// A defect whose file and place only the caller knows.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Fault {
    pub found: String,
    pub expected: String,
    pub remedy: String,
}

impl Fault {
    pub fn new(found: impl Into<String>, expected: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self { found: found.into(), expected: expected.into(), remedy: remedy.into() }
    }

    pub fn at(self, path: &Path, place: impl Into<String>) -> CaptureError {
        let Self { found, expected, remedy } = self;
        CaptureError::Malformed { path: path.to_path_buf(), defect: Box::new(Defect { place: place.into(), found, expected, remedy }) }
    }
}

impl CaptureError {
    pub(crate) fn io(path: &Path, action: &'static str, source: io::Error) -> Self {
        Self::Io { path: path.to_path_buf(), action, source }
    }
}

/// What to say when a file ends too early or promises more than it holds.
pub(crate) const TRUNCATED: &str = "the file is truncated or damaged, copy or export it again";

/// A piece of a hostile file, safe and short enough for a message.
pub(crate) fn quoted(text: &str) -> String {
    let mut s: String = text.chars().take(60).flat_map(char::escape_debug).collect();
    if text.chars().nth(60).is_some() {
        s.push('…');
    }
    format!("'{s}'")
}

/// A number of bytes for a message.
fn gib(bytes: u64) -> String {
    match bytes {
        0..0x10_0000 => format!("{bytes} bytes"),
        0x10_0000..0x4000_0000 => format!("{:.1} MiB", bytes as f64 / f64::from(1 << 20)),
        _ => format!("{:.2} GiB", bytes as f64 / f64::from(1 << 30)),
    }
}
