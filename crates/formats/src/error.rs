//! The one error of this crate: which file, where in it, what was found, what was expected and what to do about it.

use std::{
    fmt, io,
    path::{Path, PathBuf},
};

/// Result of everything in this crate.
pub type Result<T, E = FormatError> = std::result::Result<T, E>;

/// Why a file could not be read or written. Every message is one line.
#[derive(Debug, thiserror::Error)]
pub enum FormatError {
    /// The operating system refused.
    #[error("{}: cannot {action}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What was being done, as a verb phrase.
        action: &'static str,
        /// The system's answer.
        #[source]
        source: io::Error,
    },
    /// No space left for what was being written; the partial file is gone.
    #[error("{}: the disk is full; nothing was left behind, free some space or choose another folder", path.display())]
    DiskFull {
        /// The file that was to be written.
        path: PathBuf,
    },
    /// The target exists and overwriting was not allowed.
    #[error("{}: already exists; choose another name or allow overwriting", path.display())]
    Exists {
        /// The file that is in the way.
        path: PathBuf,
    },
    /// The content is not what it should be.
    #[error("{}: {defect}", path.display())]
    Malformed {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        defect: Box<Defect>,
    },
}

/// What is wrong with the content of a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Defect {
    /// Where.
    pub place: Place,
    /// What stands there.
    pub found: String,
    /// What should stand there.
    pub expected: String,
    /// What a person can do about it.
    pub remedy: &'static str,
}

/// A place in a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Place {
    /// The file as a whole, or its name.
    File,
    /// Line of a text part, from 1.
    Line(u64),
    /// Offset from the start of the file.
    Byte(u64),
    /// A PLY element as a whole.
    Element(String),
    /// A property of a PLY element.
    Property {
        /// Name of the element.
        element: String,
        /// Name of the property.
        property: String,
    },
    /// A row of a PLY element, from 0.
    Row {
        /// Name of the element.
        element: String,
        /// Index of the row.
        row: u64,
    },
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::File => f.write_str("the file"),
            Self::Line(n) => write!(f, "line {n}"),
            Self::Byte(n) => write!(f, "byte {n}"),
            Self::Element(e) => write!(f, "element '{e}'"),
            Self::Property { element, property } => write!(f, "property '{property}' of element '{element}'"),
            Self::Row { element, row } => write!(f, "row {row} of element '{element}'"),
        }
    }
}

impl fmt::Display for Defect {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: found {}, expected {}; {}", self.place, self.found, self.expected, self.remedy)
    }
}

/// What to say when a file ends too early or promises more than it holds.
pub(crate) const TRUNCATED: &str = "the file is truncated or damaged, copy or export it again";

impl FormatError {
    /// Wraps an answer of the operating system; a full disk gets its own message.
    pub fn io(path: &Path, action: &'static str, source: io::Error) -> Self {
        let path = path.to_path_buf();
        match source.kind() {
            io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => Self::DiskFull { path },
            _ => Self::Io { path, action, source },
        }
    }

    pub(crate) fn defect(path: &Path, place: Place, found: impl Into<String>, expected: impl Into<String>, remedy: &'static str) -> Self {
        Self::Malformed {
            path: path.to_path_buf(),
            defect: Box::new(Defect { place, found: found.into(), expected: expected.into(), remedy }),
        }
    }

    /// The file the error is about.
    pub fn path(&self) -> &Path {
        match self {
            Self::Io { path, .. } | Self::DiskFull { path } | Self::Exists { path } | Self::Malformed { path, .. } => path,
        }
    }
}

/// A piece of a hostile file, safe and short enough for a message.
pub(crate) fn quoted(text: &str) -> String {
    let mut s: String = text.chars().take(40).flat_map(char::escape_debug).collect();
    if text.chars().nth(40).is_some() {
        s.push('…');
    }
    format!("'{s}'")
}
