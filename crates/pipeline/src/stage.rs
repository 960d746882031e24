//! A stage's folder: what it was made from, whether it is complete, and what may be reused.

use std::path::{Path, PathBuf};

use serde_json::{Value, json};

use crate::disk::{create_dir, read_json, write_json};
use crate::table::Fnv;
use crate::{Failure, Options};

/// Bumped whenever a stage's files or their meaning change, so that older folders are recomputed and never misread.
const FORMAT: u32 = 1;

/// What [`StageDir::open`] found.
pub enum Found {
    /// Nothing: the stage starts from the beginning.
    Nothing,
    /// An interrupted run of the same work: continue it.
    Partial,
    /// The finished result of the same work, with its figures.
    Done(Value),
}

/// The folder of one stage.
pub struct StageDir {
    /// The folder.
    pub path: PathBuf,
    key: String,
}

impl StageDir {
    /// Looks at `out/name` and decides what can be reused for work with this key. Nothing is created yet.
    pub fn open(options: &Options, name: &str, key: String) -> Result<(Self, Found), Failure> {
        let opened = Self::open_at(options.out.join(name), options.force, key)?;
        if matches!(opened.1, Found::Partial) {
            sweep(&options.out);
        }
        Ok(opened)
    }

    /// As [`StageDir::open`] for a folder of any name in a folder that may belong to somebody else.
    pub fn open_at(path: PathBuf, force: bool, key: String) -> Result<(Self, Found), Failure> {
        let stage = Self { path, key };
        let marker = stage.marker();
        let Some(found) = read_json(&marker) else {
            if stage.path.exists() && std::fs::read_dir(&stage.path).is_ok_and(|mut d| d.next().is_some()) {
                return Err(Failure::Input(format!(
                    "{} exists but was not made by this program; choose another output folder with -o",
                    stage.path.display()
                )));
            }
            return Ok((stage, Found::Nothing));
        };
        if found["key"] == json!(stage.key) {
            if found["done"] == json!(true) {
                return Ok((stage, Found::Done(found["figures"].clone())));
            }
            sweep(&stage.path);
            return Ok((stage, Found::Partial));
        }
        if !force {
            return Err(Failure::Input(format!(
                "{} holds the result of another scene or of other settings; use --force to replace it, or another folder with -o",
                stage.path.display()
            )));
        }
        std::fs::remove_dir_all(&stage.path).map_err(|e| crate::disk::explain("remove", &stage.path, &e))?;
        Ok((stage, Found::Nothing))
    }

    /// Creates the folder and marks the work as begun.
    pub fn begin(&self) -> Result<(), Failure> {
        create_dir(&self.path)?;
        write_json(&self.marker(), &json!({"key": self.key, "done": false}))
    }

    /// Marks the work as complete.
    pub fn finish(&self, figures: &Value) -> Result<(), Failure> {
        write_json(&self.marker(), &json!({"key": self.key, "done": true, "figures": figures}))
    }

    fn marker(&self) -> PathBuf {
        self.path.join("stage.json")
    }
}

/// Removes files that a killed run left half-written (see `megas_formats::AtomicFile`).
fn sweep(folder: &Path) {
    for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
        let name = entry.file_name();
        let name = name.to_string_lossy();
        if name.starts_with(".megas-") && name.ends_with(".part") {
            let _ = std::fs::remove_file(entry.path());
        }
    }
}

/// Names the inputs of a stage: settings as JSON, the key of the stage before it, and the contents of files.
pub struct KeyBuilder(Fnv);

impl KeyBuilder {
    /// Starts a key for the stage `name`.
    pub fn new(name: &str) -> Self {
        let mut fnv = Fnv::default();
        fnv.update(name.as_bytes());
        fnv.update(&FORMAT.to_le_bytes());
        fnv.update(env!("CARGO_PKG_VERSION").as_bytes());
        Self(fnv)
    }

    /// Adds text.
    pub fn text(self, text: &str) -> Self {
        self.bytes(text.as_bytes())
    }

    /// Adds bytes.
    pub fn bytes(mut self, bytes: &[u8]) -> Self {
        self.0.update(&(bytes.len() as u64).to_le_bytes());
        self.0.update(bytes);
        self
    }

    /// Adds settings.
    pub fn settings(self, value: &impl serde::Serialize) -> Result<Self, Failure> {
        let text = serde_json::to_string(value).map_err(|e| Failure::Other(format!("settings cannot be hashed: {e}")))?;
        Ok(self.text(&text))
    }

    /// Adds the contents of a file.
    pub fn file(self, path: &Path) -> Result<Self, Failure> {
        let bytes = std::fs::read(path).map_err(|e| crate::disk::explain("read", path, &e))?;
        Ok(self.bytes(&bytes))
    }

    /// The key.
    pub fn finish(self) -> String {
        format!("{:016x}", self.0.value())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn options(dir: &Path, force: bool) -> Options {
        Options { out: dir.to_path_buf(), force, threads: None }
    }

    #[test]
    fn results_are_reused_continued_refused_or_replaced() -> Result<(), Box<dyn std::error::Error>> {
        let dir = tempfile::tempdir()?;
        let (stage, found) = StageDir::open(&options(dir.path(), false), "sim", "a".into())?;
        assert!(matches!(found, Found::Nothing) && !stage.path.exists());
        stage.begin()?;
        std::fs::write(stage.path.join(".megas-x.part"), "half a frame")?;
        assert!(matches!(StageDir::open(&options(dir.path(), false), "sim", "a".into())?.1, Found::Partial));
        assert!(!stage.path.join(".megas-x.part").exists());
        stage.finish(&json!({"frames": 7}))?;
        let (_, found) = StageDir::open(&options(dir.path(), false), "sim", "a".into())?;
        assert!(matches!(found, Found::Done(v) if v["frames"] == 7));
        assert!(StageDir::open(&options(dir.path(), false), "sim", "b".into()).is_err());
        assert!(matches!(StageDir::open(&options(dir.path(), true), "sim", "b".into())?.1, Found::Nothing));
        Ok(())
    }

    #[test]
    fn a_folder_of_somebody_else_is_never_touched() -> Result<(), Box<dyn std::error::Error>> {
        let dir = tempfile::tempdir()?;
        std::fs::create_dir(dir.path().join("sim"))?;
        std::fs::write(dir.path().join("sim/precious.txt"), "x")?;
        assert!(StageDir::open(&options(dir.path(), true), "sim", "a".into()).is_err());
        assert!(dir.path().join("sim/precious.txt").exists());
        Ok(())
    }

    #[test]
    fn keys_tell_inputs_apart() {
        let a = KeyBuilder::new("s").text("ab").text("c").finish();
        let b = KeyBuilder::new("s").text("a").text("bc").finish();
        assert_ne!(a, b);
    }
}
