//! Runs a scene end to end: stages with their files, cache, checkpoints, resume, and events for progress.
//!
//! Every stage leaves its result on disk (`DIR/reconstruct` or `DIR/finetune` where something is trained, `DIR/body`, `DIR/sim`, `DIR/frames`) together with a key of what it was made from;
//! the next stage, or a later run, starts from there.

mod background;
mod body;
mod cameras;
mod claims;
mod colliders;
mod convert;
mod demo;
mod disk;
mod figure;
mod gaps;
mod inspect;
mod mesh_splats;
mod meshes;
mod plan;
mod reconstruct;
mod render;
mod room;
mod run;
mod scenery;
mod seeds;
mod simulate;
mod skin;
mod source;
mod stage;
mod study;
mod surface_meshes;
mod table;

use std::fmt;
use std::path::{Path, PathBuf};

use megas_scene::Scene;

pub use claims::{ClaimsJob, Contender, Scope, claims};
pub use demo::{DEMO_SCENE, demo, demo_scene};
pub use figure::{FIGURES, FigureJob, figure};
pub use inspect::inspect;
pub use megas_capture::Downscale;
pub use megas_metrics::deform::Carry;
pub use megas_reconstruct::{Method, Profile};
pub use plan::plan;
pub use reconstruct::{
    Backdrop, FinetuneJob, FinetuneSettings, ReconstructJob, ReconstructSettings, Region, TauPrune, finetune, plan_finetune,
    plan_reconstruct, reconstruct,
};
pub use run::{fill, render, run, simulate};
pub use study::{StudyJob, study};

/// What a run tells the program around it.
#[derive(Clone, Copy, Debug)]
pub enum Event<'a> {
    /// A stage begins; it will report `steps` steps in all (0 = not known).
    Stage {
        /// Name for people.
        name: &'a str,
        /// Steps to come.
        steps: u64,
    },
    /// The current stage has finished `done` of its steps.
    Step {
        /// Steps finished so far.
        done: u64,
    },
    /// How the current stage is doing: names and values.
    Live(&'a [(&'static str, f64)]),
    /// A stage has ended.
    StageDone {
        /// Name for people.
        name: &'a str,
        /// Wall time \[s\].
        seconds: f64,
    },
    /// Something worth knowing.
    Note(&'a str),
    /// Something worth worrying about.
    Warning(&'a str),
    /// A result was written.
    File(&'a Path),
}

/// Receives events and may ask for a stop.
pub trait Sink: Sync {
    /// Called from the thread that runs the pipeline.
    fn event(&self, event: Event<'_>);

    /// True when the user wants to stop; the pipeline then leaves a resumable state behind.
    fn cancelled(&self) -> bool {
        false
    }
}

/// Why a command did not do what it was asked.
#[derive(Debug)]
pub enum Failure {
    /// The input or the way it was used is wrong (exit code 2).
    Input(String),
    /// The user stopped the run; it can be resumed (exit code 1).
    Interrupted(String),
    /// Anything else (exit code 1).
    Other(String),
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Input(m) | Self::Interrupted(m) | Self::Other(m) => f.write_str(m),
        }
    }
}

impl std::error::Error for Failure {}

/// Where and how to run.
#[derive(Clone, Debug)]
pub struct Options {
    /// Output folder.
    pub out: PathBuf,
    /// Replace results of another scene that are in the way.
    pub force: bool,
    /// Worker threads; all cores when absent.
    pub threads: Option<usize>,
}

/// A scene with the folder that its relative paths start from.
#[derive(Clone, Debug)]
pub struct LoadedScene {
    /// The scene.
    pub scene: Scene,
    /// Folder of the scene file.
    pub base_dir: PathBuf,
    /// Text of the scene file, copied into the output folder.
    pub text: String,
}

impl LoadedScene {
    /// Reads and validates a scene file.
    pub fn open(path: &Path) -> Result<Self, Failure> {
        let text = Scene::read(path).map_err(|e| Failure::Input(e.to_string()))?;
        let name = path.display().to_string();
        let scene = Scene::parse(&text, &name).map_err(|e| Failure::Input(e.to_string()))?;
        Ok(Self { scene, base_dir: folder_of(path), text })
    }
}

/// The folder that relative paths in a file start from.
pub(crate) fn folder_of(file: &Path) -> PathBuf {
    file.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new(".")).to_path_buf()
}
