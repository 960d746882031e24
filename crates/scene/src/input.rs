//! What goes in: a splat file, photographs, or an embedded asset.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::shape::BoxShape;
use crate::still::{InputBody, Table};
use crate::value::Up;

/// Where the splats come from: a file, photographs, or an embedded asset.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Input {
    /// Path of a splat file (.ply, .compressed.ply, .splat), relative to the scene file.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub splat: Option<String>,
    /// Path of a folder of posed photographs (COLMAP or transforms.json), relative to the scene file; splats are trained on them first.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub capture: Option<String>,
    /// Name of an embedded asset, e.g. "ice-cream".
    #[serde(skip_serializing_if = "Option::is_none")]
    pub asset: Option<String>,
    /// Procedural bodies, for scenes without a capture, in metres; +z is up and z = 0 is the top of the table they stand on.
    #[serde(rename = "body", skip_serializing_if = "Vec::is_empty")]
    pub bodies: Vec<InputBody>,
    /// The table under procedural bodies.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub table: Option<Table>,
    /// The direction that points up in the file: "+x", "-x", "+y", "-y", "+z", "-z", or three numbers. Many captured splats are "-y".
    pub up: Up,
    /// How to train splats on the photographs of `capture`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reconstruct: Option<Reconstruct>,
    /// Make the objects of a splat file fit to melt before anything else: true, or a table of settings.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub finetune: Option<Finetune>,
}

impl Input {
    /// Corners of the box around the procedural bodies for which `chosen` holds \[m\]; `None` without any.
    pub fn bodies_box(&self, chosen: impl Fn(&InputBody) -> bool) -> Option<([f64; 3], [f64; 3])> {
        let boxes = self.bodies.iter().filter(|b| chosen(b)).map(InputBody::bounds);
        boxes.reduce(|a, b| (megas_math::vec3::min(a.0, b.0), megas_math::vec3::max(a.1, b.1)))
    }

    /// The fine-tuning that is asked for, if any.
    pub fn finetuning(&self) -> Option<FinetuneSettings> {
        match &self.finetune {
            None | Some(Finetune::Switch(false)) => None,
            Some(Finetune::Switch(true)) => Some(FinetuneSettings::default()),
            Some(Finetune::Settings(s)) => Some(s.clone()),
        }
    }
}

/// Ways to train; all but "ours" are for comparison.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Method {
    /// Plain 3D Gaussian splatting.
    Vanilla,
    /// With a bound of the ratio of the largest to the smallest axis.
    Physgaussian,
    /// With a bound of the ratio of volumes.
    Vrdoh,
    /// Flattened Gaussians with consistent normals.
    Pgsr,
    /// The same without what no view shows.
    PgsrPrune,
    /// The same without needles and giants: what survives melting.
    #[default]
    Ours,
}

/// Length and size of a training.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Profile {
    /// 1500 iterations and few Gaussians, for tests.
    Tiny,
    /// 7000 iterations: objects on a CPU.
    #[default]
    Object,
    /// 30 000 iterations.
    Full,
    /// 30 000 iterations that compare views with each other too.
    RealHq,
}

/// What is behind the object while training.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Backdrop {
    /// Black.
    Black,
    /// White.
    White,
    /// Another colour in every iteration.
    Random,
}

/// How to train splats on photographs. `simulation.cells`, if the scene gives it, keeps kernels below half a cell.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Reconstruct {
    /// Method.
    pub method: Method,
    /// Length and size.
    pub profile: Profile,
    /// Iterations; all milestones follow. The profile's own if left out.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 1, max = 1_000_000))]
    pub iterations: Option<u32>,
    /// Reduce the photographs by this factor; if left out, those wider than 1600 pixels are reduced to that.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 1, max = 64))]
    pub downscale: Option<u32>,
    /// Every how many photographs one is held out to judge the result; 0 for none.
    #[schemars(range(min = 0, max = 1_000_000))]
    pub eval_every: u32,
    /// Random points to begin with if the capture has none.
    #[schemars(range(min = 1, max = 100_000_000))]
    pub seeds_count: u32,
    /// Most Gaussians; the profile's own if left out.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 1, max = 100_000_000))]
    pub max_gaussians: Option<u32>,
    /// What is behind the object; if left out, random for photographs with alpha and black for others.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub background: Option<Backdrop>,
    /// Grow by sampling (Markov chain Monte Carlo) instead of by thresholds.
    pub mcmc: bool,
    /// Learn an exposure for every photograph: for photographs that were not taken with fixed exposure and white balance.
    pub exposure: bool,
    /// Where the object is, in the coordinates of the poses; if left out, found from alpha or from a `scene.json` beside the photographs.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub object_box: Option<BoxShape>,
    /// Memory for the photographs in GiB.
    #[schemars(range(min = 0.01, max = 65_536.0))]
    pub memory_gib: f64,
}

impl Default for Reconstruct {
    fn default() -> Self {
        Self {
            method: Method::default(),
            profile: Profile::default(),
            iterations: None,
            downscale: None,
            eval_every: 8,
            seeds_count: 30_000,
            max_gaussians: None,
            background: None,
            mcmc: false,
            exposure: false,
            object_box: None,
            memory_gib: 8.0,
        }
    }
}

/// Fine-tuning: on, off, or on with settings.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum Finetune {
    /// On or off.
    Switch(bool),
    /// On.
    Settings(FinetuneSettings),
}

/// How to fine-tune a splat without photographs. `simulation.cells`, if the scene gives it, keeps kernels below half a cell.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct FinetuneSettings {
    /// Steps.
    #[schemars(range(min = 1, max = 1_000_000))]
    pub steps: u32,
    /// Side of the virtual views in pixels.
    #[schemars(range(min = 32, max = 4096))]
    pub size: u32,
    /// Virtual views to train on.
    #[schemars(range(min = 2, max = 4096))]
    pub views: u32,
    /// Most Gaussians.
    #[schemars(range(min = 1, max = 100_000_000))]
    pub max_gaussians: u32,
}

impl Default for FinetuneSettings {
    fn default() -> Self {
        Self { steps: 1_000, size: 640, views: 64, max_gaussians: 600_000 }
    }
}
