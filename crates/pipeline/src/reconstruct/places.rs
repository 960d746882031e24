//! Where the files of a training lie, and what may be in their way.

use std::path::{Path, PathBuf};

use crate::Failure;
use crate::disk::{check_writable, create_dir};
use crate::stage::{Found, StageDir};

/// Files of a training.
pub struct Places {
    /// The splats.
    pub output: PathBuf,
    /// The splats of an interrupted training.
    pub partial: PathBuf,
    /// The folder of the training.
    pub folder: PathBuf,
}

impl Places {
    /// Names them after the splat file; nothing is touched.
    pub fn new(output: &Path) -> Result<Self, Failure> {
        let bad = |why: &str| Failure::Input(format!("{}: {why}; give a file like scene.ply with -o", output.display()));
        let name = output.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
        let lower = name.to_ascii_lowercase();
        let extension = [".compressed.ply", ".ply", ".splat"].into_iter().find(|e| lower.ends_with(e) && lower.len() > e.len());
        let Some(extension) = extension else { return Err(bad("not a .ply, .compressed.ply or .splat file")) };
        if output.is_dir() {
            return Err(bad("this is a folder"));
        }
        let (stem, extension) = name.split_at(name.len() - extension.len());
        let beside = |name: String| output.with_file_name(name);
        let partial = beside(format!("{stem}.partial{extension}"));
        Ok(Self { output: output.to_path_buf(), partial, folder: beside(format!("{stem}.train")) })
    }

    /// Refuses to start where something would be lost in the end.
    pub fn check(&self, found: &Found, force: bool) -> Result<(), Failure> {
        let fresh = matches!(found, Found::Nothing);
        let in_the_way = [Some(&self.output), fresh.then_some(&self.partial)].into_iter().flatten().find(|p| p.exists());
        match in_the_way {
            Some(path) if !force => {
                Err(Failure::Input(format!("{} exists; use --force to replace it, or another file with -o", path.display())))
            }
            _ => Ok(()),
        }
    }

    /// Makes room for the training: its folder, marked as begun.
    pub fn begin(&self, stage: &StageDir) -> Result<(), Failure> {
        check_writable(&self.folder)?;
        if let Some(parent) = self.output.parent().filter(|p| !p.as_os_str().is_empty()) {
            create_dir(parent)?;
        }
        stage.begin()
    }

    /// Opens the training's folder for work named by `key`. A finished one gives its figures.
    pub fn open(&self, key: String, force: bool) -> Result<Opened, Failure> {
        let (stage, found) = match StageDir::open_at(self.folder.clone(), force, key)? {
            (_, Found::Done(figures)) if self.output.exists() => return Ok(Opened::Done(figures)),
            // Somebody took the result away: it is made again.
            (stage, Found::Done(_)) => (stage, Found::Nothing),
            other => other,
        };
        self.check(&found, force)?;
        Ok(Opened::Todo(stage, found))
    }
}

/// What there is of a training.
pub enum Opened {
    /// All of it: the figures.
    Done(serde_json::Value),
    /// Nothing or a part.
    Todo(StageDir, Found),
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_are_named_after_the_output_and_never_lost() {
        let dir = tempfile::tempdir().unwrap();
        let p = Places::new(&dir.path().join("a/b.compressed.ply")).unwrap();
        assert_eq!(p.partial, dir.path().join("a/b.partial.compressed.ply"));
        assert_eq!(p.folder, dir.path().join("a/b.train"));
        for bad in ["a.obj", ".ply", "ply", ""] {
            assert!(Places::new(&dir.path().join(bad)).is_err(), "{bad:?}");
        }
        std::fs::create_dir(dir.path().join("d.ply")).unwrap();
        assert!(Places::new(&dir.path().join("d.ply")).is_err());
        let p = Places::new(&dir.path().join("c.ply")).unwrap();
        assert!(matches!(p.open("k".into(), false), Ok(Opened::Todo(_, Found::Nothing))));
        std::fs::write(&p.output, "precious").unwrap();
        assert!(p.open("k".into(), false).is_err_and(|e| e.to_string().contains("--force")));
        assert!(p.open("k".into(), true).is_ok());
        let Ok(Opened::Todo(stage, _)) = p.open("k".into(), true) else { panic!("not begun") };
        p.begin(&stage).unwrap();
        stage.finish(&serde_json::json!({"psnr": 30})).unwrap();
        assert!(matches!(p.open("k".into(), false), Ok(Opened::Done(v)) if v["psnr"] == 30));
        assert!(p.open("other".into(), false).is_err());
        std::fs::remove_file(&p.output).unwrap();
        assert!(matches!(p.open("k".into(), false), Ok(Opened::Todo(_, Found::Nothing))));
    }
}
