//! Arguments of the commands that train splats.

use std::path::{Path, PathBuf};

use clap::Args;
use clap::builder::{PossibleValuesParser, TypedValueParser};
use megas_pipeline::{Backdrop, Downscale, Method, Profile, ReconstructJob, ReconstructSettings};

/// A parser of exactly these names.
fn named<T: Copy + Send + Sync + 'static>(names: Vec<(&'static str, T)>) -> impl TypedValueParser<Value = T> {
    let parser = PossibleValuesParser::new(names.iter().map(|n| n.0).collect::<Vec<_>>());
    parser.try_map(move |text| names.iter().find(|n| n.0 == text).map(|n| n.1).ok_or("unknown name"))
}

fn methods() -> impl TypedValueParser<Value = Method> {
    named(Method::ALL.iter().map(|m| (m.name(), *m)).collect())
}

fn profiles() -> impl TypedValueParser<Value = Profile> {
    named([Profile::Tiny, Profile::Object, Profile::Full, Profile::RealHq].iter().map(|p| (p.name(), *p)).collect())
}

fn backdrops() -> impl TypedValueParser<Value = Backdrop> {
    named(vec![("black", Backdrop::Black), ("white", Backdrop::White), ("random", Backdrop::Random)])
}

fn downscale(text: &str) -> Result<Downscale, String> {
    match text {
        "auto" => Ok(Downscale::Auto),
        _ => text.parse().ok().filter(|f| (1..=64).contains(f)).map(Downscale::Factor).ok_or("expected auto or 1 to 64".into()),
    }
}

fn object_box(text: &str) -> Result<[f32; 6], String> {
    let numbers: Option<Vec<f32>> = text.split(',').map(|n| n.trim().parse().ok().filter(|v: &f32| v.is_finite())).collect();
    let six: Option<[f32; 6]> = numbers.and_then(|n| n.try_into().ok());
    six.filter(|b| b[3..].iter().all(|h| *h > 0.0)).ok_or("expected cx,cy,cz,hx,hy,hz: a centre and positive half extents".into())
}

fn gibibytes(text: &str) -> Result<f64, String> {
    text.parse().ok().filter(|v: &f64| *v > 0.0 && v.is_finite()).ok_or("expected a positive number of GiB".into())
}

/// Arguments of `reconstruct`.
#[derive(Args, Clone, Debug)]
pub struct ReconstructArgs {
    /// Folder with the photographs and their poses: COLMAP (sparse/0) or transforms.json.
    pub capture: PathBuf,
    /// Splat file to write [default: megas-out/NAME.ply].
    #[arg(short, long = "output", value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// How and how long.
    #[command(flatten)]
    pub training: TrainingArgs,
    /// Iterations between two previews (a held-out view beside its photograph); 0 for none.
    #[arg(long, value_name = "N", default_value_t = 500)]
    pub preview_every: u32,
    /// Replace an existing file, or an unfinished training with other settings.
    #[arg(long)]
    pub force: bool,
    /// Only say what would be done, how much memory and roughly how long it takes.
    #[arg(long)]
    pub dry_run: bool,
}

/// What determines a training.
#[derive(Args, Clone, Debug)]
pub struct TrainingArgs {
    /// Method; all but `ours` are for comparison.
    #[arg(long, value_parser = methods(), default_value = "ours")]
    pub method: Method,
    /// Length and size: 1500, 7000, 30 000 iterations; real-hq compares views with each other too.
    #[arg(long, value_parser = profiles(), default_value = "object")]
    pub profile: Profile,
    /// Iterations; all milestones follow [default: the profile's].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub iterations: Option<u32>,
    /// Reduce the photographs by this factor; auto reduces those wider than 1600 pixels.
    #[arg(long, value_name = "auto|N", value_parser = downscale, default_value = "auto")]
    pub downscale: Downscale,
    /// Hold out every so many views to judge the result; 0 for none.
    #[arg(long, value_name = "N", default_value_t = 8)]
    pub eval_every: u32,
    /// Seed of everything random.
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub seed: u64,
    /// Random points to begin with if the capture has none.
    #[arg(long, value_name = "N", default_value_t = 30_000, value_parser = count)]
    pub seeds_count: usize,
    /// Most Gaussians [default: the profile's].
    #[arg(long, value_name = "N", value_parser = count)]
    pub max_gaussians: Option<usize>,
    /// What is behind the object [default: random for photographs with alpha, else black].
    #[arg(long, value_parser = backdrops())]
    pub background: Option<Backdrop>,
    /// Where the object is, in the units of the poses [default: found from alpha, or scene.json beside the photographs].
    #[arg(long, value_name = "cx,cy,cz,hx,hy,hz", value_parser = object_box, allow_hyphen_values = true)]
    pub object_box: Option<[f32; 6]>,
    /// Simulator cells along the object's longest side: kernels stay below half a cell.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub cells: Option<u32>,
    /// Grow by sampling (Markov chain Monte Carlo) instead of by thresholds.
    #[arg(long)]
    pub mcmc: bool,
    /// Memory for the photographs in GiB.
    #[arg(long, value_name = "GIB", default_value = "8", value_parser = gibibytes)]
    pub memory_budget: f64,
}

fn count(text: &str) -> Result<usize, String> {
    text.parse().ok().filter(|n| (1..=100_000_000).contains(n)).ok_or("expected 1 to 100000000".into())
}

impl TrainingArgs {
    /// The settings.
    pub fn settings(&self) -> ReconstructSettings {
        ReconstructSettings {
            method: self.method,
            profile: self.profile,
            iterations: self.iterations,
            downscale: self.downscale,
            eval_every: self.eval_every,
            seed: self.seed,
            seeds_count: self.seeds_count,
            max_gaussians: self.max_gaussians,
            background: self.background,
            object_box: self.object_box,
            cells: self.cells,
            mcmc: self.mcmc,
        }
    }
}

impl ReconstructArgs {
    /// The job.
    pub fn job(&self, threads: Option<u16>) -> ReconstructJob {
        let name = self.capture.canonicalize().ok().and_then(|p| p.file_name().map(|n| n.to_string_lossy().into_owned()));
        let default = || Path::new("megas-out").join(format!("{}.ply", name.as_deref().unwrap_or("capture")));
        ReconstructJob {
            settings: self.training.settings(),
            preview_every: self.preview_every,
            memory_gib: self.training.memory_budget,
            force: self.force,
            threads: threads.map(usize::from),
            ..ReconstructJob::new(self.capture.clone(), self.out.clone().unwrap_or_else(default))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_read_or_refused() {
        assert_eq!(downscale("auto"), Ok(Downscale::Auto));
        assert_eq!(downscale("4"), Ok(Downscale::Factor(4)));
        assert!(downscale("0").is_err() && downscale("half").is_err());
        assert_eq!(object_box("-1, 2,3,0.5,1,1"), Ok([-1.0, 2.0, 3.0, 0.5, 1.0, 1.0]));
        assert!(object_box("1,2,3").is_err() && object_box("1,2,3,0,1,1").is_err() && object_box("a,2,3,1,1,1").is_err());
        assert!(gibibytes("0").is_err() && gibibytes("nan").is_err() && gibibytes("1.5") == Ok(1.5));
        assert!(count("0").is_err());
    }
}
