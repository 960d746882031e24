//! What a reconstruction can be told, and the trainer's options that follow from it.

use std::path::PathBuf;

use megas_capture::Downscale;
use megas_reconstruct::{Background, ExposureRates, Mcmc, Method, Options, Profile, Region};

use crate::Failure;

/// Random points that a capture without points begins with.
const SEEDS: usize = 30_000;

/// Views and decoding must fit into this unless somebody says otherwise \[GiB\].
const MEMORY_GIB: f64 = 8.0;

/// What is behind transparent pixels and open views.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Backdrop {
    /// Black.
    Black,
    /// White.
    White,
    /// Another colour in every iteration.
    Random,
}

/// How to reconstruct. The defaults suit an object on a CPU.
#[derive(Clone, Debug, PartialEq)]
pub struct ReconstructSettings {
    /// Method.
    pub method: Method,
    /// Length and size of the training.
    pub profile: Profile,
    /// Iterations; all milestones follow. The profile's own if absent.
    pub iterations: Option<u32>,
    /// Reduction of the photographs.
    pub downscale: Downscale,
    /// Every how many views one is held out; 0 for none.
    pub eval_every: u32,
    /// Seed of everything random.
    pub seed: u64,
    /// Random points to begin with where the capture has none.
    pub seeds_count: usize,
    /// Most Gaussians; the profile's own if absent.
    pub max_gaussians: Option<usize>,
    /// Backdrop; random for transparent photographs and black for others if absent.
    pub background: Option<Backdrop>,
    /// Where the object is; found where possible if absent.
    pub object_box: Option<Region>,
    /// Simulator cells along the object's longest side: kernels are clamped to half a cell.
    pub cells: Option<u32>,
    /// Sampling strategy instead of thresholds.
    pub mcmc: bool,
    /// An exposure for every photograph.
    pub exposure: bool,
    /// Threshold of internal-free pruning; the design's own if absent.
    pub tau_prune: Option<TauPrune>,
}

/// Largest blend weight below which a Gaussian is removed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum TauPrune {
    /// As much as costs at most 0.1 dB.
    Auto,
    /// Of the last stages; the first stages use a fifth and a half of it.
    Last(f32),
}

impl Default for ReconstructSettings {
    fn default() -> Self {
        Self {
            method: Method::Ours,
            profile: Profile::Object,
            iterations: None,
            downscale: Downscale::Auto,
            eval_every: 8,
            seed: 0,
            seeds_count: SEEDS,
            max_gaussians: None,
            background: None,
            object_box: None,
            cells: None,
            mcmc: false,
            exposure: false,
            tau_prune: None,
        }
    }
}

/// A reconstruction from a capture to a file.
#[derive(Clone, Debug, PartialEq)]
pub struct ReconstructJob {
    /// Folder of posed photographs.
    pub capture: PathBuf,
    /// Splat file to write.
    pub output: PathBuf,
    /// How.
    pub settings: ReconstructSettings,
    /// Iterations between two previews; 0 for none.
    pub preview_every: u32,
    /// Memory that the views and their decoding may take \[GiB\].
    pub memory_gib: f64,
    /// Replace an existing file, or a training with other settings.
    pub force: bool,
    /// Worker threads; all cores when absent.
    pub threads: Option<usize>,
}

impl ReconstructJob {
    /// A job with default settings.
    pub fn new(capture: PathBuf, output: PathBuf) -> Self {
        let settings = ReconstructSettings::default();
        Self { capture, output, settings, preview_every: 500, memory_gib: MEMORY_GIB, force: false, threads: None }
    }
}

/// What the settings mean for views of extent `extent` with an object in `region`.
pub fn trainer_options(s: &ReconstructSettings, extent: f32, region: Option<Region>, transparent: bool) -> Result<Options, Failure> {
    let iterations = s.iterations.unwrap_or(s.profile.iterations());
    if iterations == 0 {
        return Err(Failure::Input("iterations: found 0, expected at least 1".into()));
    }
    let cell = match (s.cells, region) {
        (Some(0), _) => return Err(Failure::Input("cells: found 0, expected at least 1".into())),
        (Some(n), Some(r)) => Some(2.0 * r.half.into_iter().fold(0.0, f32::max) / n as f32),
        _ => None,
    };
    let mut o = Options::with_iterations(s.method, s.profile, iterations, extent, region, transparent, cell);
    o.seed = s.seed;
    if let Some(r) = &mut o.refinement {
        r.most = s.max_gaussians.unwrap_or(r.most);
    }
    o.mcmc = s.mcmc.then(Mcmc::default);
    o.exposure = s.exposure.then(ExposureRates::default);
    match s.tau_prune {
        Some(TauPrune::Auto) => o.prune_auto = true,
        Some(TauPrune::Last(tau)) if !(tau > 0.0 && tau < 1.0) => {
            return Err(Failure::Input(format!("tau-prune: found {tau}, expected a number between 0 and 1, or auto")));
        }
        Some(TauPrune::Last(tau)) => {
            let last = o.prune.last().map_or(tau, |e| e.tau);
            o.prune.iter_mut().for_each(|e| e.tau *= tau / last);
        }
        None => {}
    }
    match s.background {
        Some(Backdrop::Black) => o.background = Background::Fixed([0.0; 3]),
        Some(Backdrop::White) => o.background = Background::Fixed([1.0; 3]),
        Some(Backdrop::Random) => o.background = Background::Random,
        None => {}
    }
    Ok(o)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_reach_the_trainer() {
        let region = Some(Region::aligned([-1.0, -0.5, -0.25], [1.0, 0.5, 0.25]));
        let s = ReconstructSettings { cells: Some(200), max_gaussians: Some(77), mcmc: true, seed: 5, ..Default::default() };
        let o = trainer_options(&s, 3.0, region, true).unwrap();
        assert_eq!((o.seed, o.refinement.unwrap().most, o.iterations), (5, 77, 7_000));
        assert!((o.scale_limit.unwrap() - 0.5 * 2.0 / 200.0).abs() < 1e-7 && o.mcmc.is_some());
        assert_eq!(o.background, Background::Random);
        let s = ReconstructSettings { iterations: Some(300), background: Some(Backdrop::White), ..Default::default() };
        let o = trainer_options(&s, 3.0, None, false).unwrap();
        assert_eq!((o.iterations, o.refinement.unwrap().start, o.background), (300, 5, Background::Fixed([1.0; 3])));
        assert!(trainer_options(&ReconstructSettings { iterations: Some(0), ..s }, 3.0, None, false).is_err());
    }

    #[test]
    fn every_method_has_options_that_json_can_hold() {
        for method in Method::ALL {
            let s = ReconstructSettings { method, ..Default::default() };
            let o = trainer_options(&s, 3.0, None, true).unwrap();
            let text = serde_json::to_string(&o).unwrap();
            assert_eq!(serde_json::from_str::<Options>(&text).unwrap(), o, "{method:?}");
        }
    }
}
