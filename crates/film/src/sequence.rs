//! Numbered files, one per frame.

use std::{
    fs,
    path::{Path, PathBuf},
};

use megas_formats::{FormatError, WriteOptions, save_splats};
use megas_model::Splats;

use crate::error::Result;

/// A folder of splats, `frame_00000.ply`, `frame_00001.ply`, …, as viewers with a time line expect them.
#[derive(Clone, Debug)]
pub struct PlySequence {
    folder: PathBuf,
    options: WriteOptions,
}

impl PlySequence {
    /// Uses (and creates if necessary) `folder`.
    pub fn create(folder: impl AsRef<Path>, options: WriteOptions) -> Result<Self> {
        let folder = folder.as_ref().to_path_buf();
        fs::create_dir_all(&folder).map_err(|e| FormatError::io(&folder, "create the folder", e))?;
        Ok(Self { folder, options })
    }

    /// File of frame `index`.
    pub fn path(&self, index: u32) -> PathBuf {
        self.folder.join(frame_name(index, "ply"))
    }

    /// Writes frame `index`; frames may come in any order, also again after an interruption if overwriting is allowed.
    pub fn write(&self, index: u32, splats: &Splats) -> Result<PathBuf> {
        let path = self.path(index);
        save_splats(&path, splats, &self.options)?;
        Ok(path)
    }
}

/// `frame_00012.EXTENSION`: sorts by time in every file manager.
pub fn frame_name(index: u32, extension: &str) -> String {
    format!("frame_{index:05}.{extension}")
}
