//! Numbered files, one per frame.

use std::{
    fs,
    path::{Path, PathBuf},
};

use megas_formats::{FormatError, MeshFormat, WriteOptions, save_mesh, save_splats};
use megas_model::{Mesh, Splats};

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

/// A folder of meshes, `mesh_00000.ply`, `mesh_00001.ply`, …, in one or several formats.
#[derive(Clone, Debug)]
pub struct MeshSequence {
    folder: PathBuf,
    formats: Vec<MeshFormat>,
    up: [f32; 3],
}

impl MeshSequence {
    /// Uses (and creates if necessary) `folder`. `up` is the direction in the meshes' axes that points upward.
    pub fn create(folder: impl AsRef<Path>, formats: &[MeshFormat], up: [f32; 3]) -> Result<Self> {
        let folder = folder.as_ref().to_path_buf();
        fs::create_dir_all(&folder).map_err(|e| FormatError::io(&folder, "create the folder", e))?;
        Ok(Self { folder, formats: formats.to_vec(), up })
    }

    /// File of frame `index` in one of the formats.
    pub fn path(&self, index: u32, format: MeshFormat) -> PathBuf {
        self.folder.join(format!("mesh_{index:05}.{}", format.extension()))
    }

    /// True if all files of frame `index` are there.
    pub fn has(&self, index: u32) -> bool {
        self.formats.iter().all(|f| self.path(index, *f).exists())
    }

    /// Writes frame `index` in every format; frames may come in any order and again.
    pub fn write(&self, index: u32, mesh: &Mesh) -> Result<()> {
        self.formats.iter().try_for_each(|f| Ok(save_mesh(self.path(index, *f), mesh, self.up, true)?))
    }
}

/// `frame_00012.EXTENSION`: sorts by time in every file manager.
pub fn frame_name(index: u32, extension: &str) -> String {
    format!("frame_{index:05}.{extension}")
}
