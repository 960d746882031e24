//! Files and folders with errors a person can act on.

use std::io::{self, Write};
use std::path::{Path, PathBuf};

use megas_formats::AtomicFile;

use crate::Failure;

/// Explains an I/O error: what was being done, to which path, and what helps.
pub fn explain(doing: &str, path: &Path, e: &io::Error) -> Failure {
    let help = match e.kind() {
        io::ErrorKind::PermissionDenied | io::ErrorKind::ReadOnlyFilesystem => "; choose a folder you may write to with -o",
        io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => {
            "; free some space or choose another folder with -o, then run the same command to go on"
        }
        io::ErrorKind::NotFound => "; check the path",
        _ => "",
    };
    Failure::Input(format!("cannot {doing} {}: {e}{help}", path.display()))
}

/// Writes a file that appears whole or not at all; an existing one is replaced (stage folders belong to the program).
pub fn write_atomic(path: &Path, fill: impl FnOnce(&mut AtomicFile) -> io::Result<()>) -> Result<(), Failure> {
    megas_formats::write_atomic(path, true, fill).map_err(|e| Failure::Input(e.to_string()))
}

/// Makes sure, before long work, that `folder` can be written or created; leaves nothing behind.
pub fn check_writable(folder: &Path) -> Result<(), Failure> {
    let existing = folder.ancestors().find(|p| p.exists()).unwrap_or(Path::new("."));
    let probe = existing.join(format!(".megas-{}.tmp", std::process::id()));
    let outcome = std::fs::File::create(&probe).map_err(|e| explain("write into", existing, &e));
    let _ = std::fs::remove_file(&probe);
    outcome.map(|_| ())
}

/// Creates a folder with its parents.
pub fn create_dir(path: &Path) -> Result<(), Failure> {
    std::fs::create_dir_all(path).map_err(|e| explain("create folder", path, &e))
}

/// Writes text.
pub fn write_text(path: &Path, text: &str) -> Result<(), Failure> {
    write_atomic(path, |w| w.write_all(text.as_bytes()))
}

/// Writes pretty JSON.
pub fn write_json(path: &Path, value: &serde_json::Value) -> Result<(), Failure> {
    let text = serde_json::to_vec_pretty(value).map_err(|e| Failure::Other(e.to_string()))?;
    write_atomic(path, |w| w.write_all(&text))
}

/// Reads JSON; `None` where the file does not exist or is not JSON (then it is as good as absent).
pub fn read_json(path: &Path) -> Option<serde_json::Value> {
    serde_json::from_slice(&std::fs::read(path).ok()?).ok()
}

/// `folder/stem_00042.extension`.
pub fn frame_path(folder: &Path, stem: &str, index: usize, extension: &str) -> PathBuf {
    folder.join(format!("{stem}_{index:05}.{extension}"))
}
