//! Arguments of `eval claims`.

use std::path::{Path, PathBuf};

use clap::Args;
use megas_pipeline::{Carry, ClaimsJob, Contender, Downscale, Profile, ReconstructSettings, Scope};

use crate::train_args::{downscale, gibibytes, named_list, profiles};

/// Pictures per deformation, and with `--quick`.
const VIEWS: usize = 24;
const QUICK_VIEWS: usize = 8;

/// What is compared, and how.
#[derive(Args, Clone, Debug)]
pub struct ClaimsArgs {
    /// Folder of a capture with its true surface in mesh/whole.ply.
    pub capture: PathBuf,
    /// Folder that `eval reconstruct -o` wrote: its models are used, missing ones are left out. Without it models are trained.
    #[arg(long, value_name = "DIR")]
    pub models: Option<PathBuf>,
    /// Methods B0 to B6 and A1, separated by commas, or all.
    #[arg(long, value_name = "LIST", value_parser = contenders, default_value = "all")]
    pub methods: Contenders,
    /// Trainings with different seeds.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=100))]
    pub seeds: u32,
    /// The first seed.
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub seed: u64,
    /// Shapes that follow the whole gradient and its rotation too, not only the elastic-like part.
    #[arg(long)]
    pub all_modes: bool,
    /// 8 pictures per deformation instead of 24, and of them PSNR alone.
    #[arg(long)]
    pub quick: bool,
    /// Length and size of the trainings.
    #[arg(long, value_parser = profiles(), default_value = "object")]
    pub profile: Profile,
    /// Iterations; all milestones follow [default: the profile's].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub iterations: Option<u32>,
    /// Reduce the photographs by this factor; auto reduces those wider than 1600 pixels.
    #[arg(long, value_name = "auto|N", value_parser = downscale, default_value = "auto")]
    pub downscale: Downscale,
    /// Memory for the photographs in GiB.
    #[arg(long, value_name = "GIB", default_value = "8", value_parser = gibibytes)]
    pub memory_budget: f64,
    /// Folder of the results [default: megas-out/claims].
    #[arg(short, long = "output", value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Replace results of other settings.
    #[arg(long)]
    pub force: bool,
}

/// Several methods.
#[derive(Clone, Debug, PartialEq)]
pub struct Contenders(Vec<Contender>);

fn contenders(text: &str) -> Result<Contenders, String> {
    let show = |m: Contender| format!("{} ({})", m.id(), m.name());
    named_list(text, &Contender::ALL, |m, name| m.id().eq_ignore_ascii_case(name), show).map(Contenders)
}

impl ClaimsArgs {
    /// The job.
    pub fn job(&self, threads: Option<u16>) -> ClaimsJob {
        ClaimsJob {
            capture: self.capture.clone(),
            models: self.models.clone(),
            methods: self.methods.0.clone(),
            seeds: self.seeds,
            settings: ReconstructSettings {
                profile: self.profile,
                iterations: self.iterations,
                downscale: self.downscale,
                seed: self.seed,
                ..ReconstructSettings::default()
            },
            scope: Scope {
                modes: if self.all_modes { Carry::ALL.to_vec() } else { vec![Carry::ElasticLike] },
                views: if self.quick { QUICK_VIEWS } else { VIEWS },
                perceptual: !self.quick,
            },
            memory_gib: self.memory_budget,
            out: self.out.clone().unwrap_or_else(|| Path::new("megas-out").join("claims")),
            force: self.force,
            threads: threads.map(usize::from),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn methods_are_named_as_in_the_tables() {
        assert_eq!(contenders("b0, B6,B0"), Ok(Contenders(vec![Contender::B0, Contender::B6])));
        assert_eq!(contenders("all").map(|c| c.0.len()), Ok(8));
        assert!(contenders("B7").is_err_and(|e| e.contains("A1 (ours, density field)")));
    }
}
