//! Arguments of the commands that train splats.

use std::path::{Path, PathBuf};

use clap::Args;
use clap::builder::{PossibleValuesParser, TypedValueParser};
use megas_pipeline::{
    Backdrop, Downscale, FinetuneJob, FinetuneSettings, Method, Profile, ReconstructJob, ReconstructSettings, Region, StudyJob, TauPrune,
};
use megas_scene::Select;

/// A parser of exactly these names.
fn named<T: Copy + Send + Sync + 'static>(names: Vec<(&'static str, T)>) -> impl TypedValueParser<Value = T> {
    let parser = PossibleValuesParser::new(names.iter().map(|n| n.0).collect::<Vec<_>>());
    parser.try_map(move |text| names.iter().find(|n| n.0 == text).map(|n| n.1).ok_or("unknown name"))
}

fn methods() -> impl TypedValueParser<Value = Method> {
    named(Method::ALL.iter().map(|m| (m.name(), *m)).collect())
}

pub(crate) fn profiles() -> impl TypedValueParser<Value = Profile> {
    named([Profile::Tiny, Profile::Object, Profile::Full, Profile::RealHq].iter().map(|p| (p.name(), *p)).collect())
}

fn backdrops() -> impl TypedValueParser<Value = Backdrop> {
    named(vec![("black", Backdrop::Black), ("white", Backdrop::White), ("random", Backdrop::Random)])
}

pub(crate) fn downscale(text: &str) -> Result<Downscale, String> {
    match text {
        "auto" => Ok(Downscale::Auto),
        _ => text.parse().ok().filter(|f| (1..=64).contains(f)).map(Downscale::Factor).ok_or("expected auto or 1 to 64".into()),
    }
}

fn tau_prune(text: &str) -> Result<TauPrune, String> {
    match text {
        "auto" => Ok(TauPrune::Auto),
        _ => text
            .parse()
            .ok()
            .filter(|t: &f32| *t > 0.0 && *t < 1.0)
            .map(TauPrune::Last)
            .ok_or("expected auto or a number between 0 and 1".into()),
    }
}

fn object_box(text: &str) -> Result<Region, String> {
    let six: Option<[f32; 6]> = numbers::<6>(text).map(|n| n.map(|v| v as f32));
    let region = |[x, y, z, a, b, c]: [f32; 6]| Region { half: [a, b, c], ..Region::aligned([x, y, z], [x, y, z]) };
    six.filter(|b| b[3..].iter().all(|h| *h > 0.0))
        .map(region)
        .ok_or("expected cx,cy,cz,hx,hy,hz: a centre and positive half extents".into())
}

pub(crate) fn gibibytes(text: &str) -> Result<f64, String> {
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
    pub object_box: Option<Region>,
    /// Simulator cells along the object's longest side: kernels stay below half a cell.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub cells: Option<u32>,
    /// Grow by sampling (Markov chain Monte Carlo) instead of by thresholds.
    #[arg(long)]
    pub mcmc: bool,
    /// Learn an exposure for every photograph: for photographs that were not taken with fixed exposure and white balance.
    #[arg(long)]
    pub exposure: bool,
    /// Blend weight up to which a Gaussian counts as hidden and is removed; auto removes what costs at most 0.1 dB [default: 0.1].
    #[arg(long, value_name = "auto|TAU", value_parser = tau_prune)]
    pub tau_prune: Option<TauPrune>,
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
            exposure: self.exposure,
            tau_prune: self.tau_prune,
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

/// A direction: `+z`, `-y`, …, or three numbers.
fn direction(text: &str) -> Result<[f64; 3], String> {
    let error = || "expected +x, -x, +y, -y, +z, -z or three numbers like 0,-1,0".to_owned();
    if let [sign @ (b'+' | b'-'), axis @ b'x'..=b'z'] = text.as_bytes() {
        let mut v = [0.0; 3];
        v[usize::from(axis - b'x')] = if *sign == b'+' { 1.0 } else { -1.0 };
        return Ok(v);
    }
    let v = numbers::<3>(text).ok_or_else(error)?;
    if v.iter().any(|c| *c != 0.0) { Ok(v) } else { Err(error()) }
}

fn numbers<const N: usize>(text: &str) -> Option<[f64; N]> {
    let all: Option<Vec<f64>> = text.split(',').map(|n| n.trim().parse().ok().filter(|v: &f64| v.is_finite())).collect();
    all?.try_into().ok()
}

fn point(text: &str) -> Result<[f64; 3], String> {
    numbers(text).ok_or("expected three numbers: x,y,z".into())
}

fn share(text: &str) -> Result<f64, String> {
    text.parse().ok().filter(|v| (0.0..=1.0).contains(v)).ok_or("expected a number from 0 to 1".into())
}

fn length(text: &str) -> Result<f64, String> {
    text.parse().ok().filter(|v: &f64| *v > 0.0 && v.is_finite()).ok_or("expected a positive number".into())
}

/// Arguments of `finetune`.
#[derive(Args, Clone, Debug)]
pub struct FinetuneArgs {
    /// A .ply, .compressed.ply or .splat file.
    pub splat: PathBuf,
    /// Splat file to write [default: megas-out/NAME.tuned.ply].
    #[arg(short, long = "output", value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Views of 320 pixels and 400 steps instead of 640 and 1000: minutes on two cores.
    #[arg(long)]
    pub preview: bool,
    /// Steps [default: 1000].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub steps: Option<u32>,
    /// Side of the virtual views in pixels [default: 640].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(32..=4096))]
    pub size: Option<u32>,
    /// Virtual views to train on.
    #[arg(long, value_name = "N", default_value_t = 64, value_parser = clap::value_parser!(u32).range(2..=4096))]
    pub views: u32,
    /// Simulator cells along the object's longest side: kernels stay below half a cell.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub cells: Option<u32>,
    /// Most Gaussians.
    #[arg(long, value_name = "N", default_value_t = 600_000, value_parser = count)]
    pub max_gaussians: usize,
    /// Seed of everything random.
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub seed: u64,
    /// What of the file is the object.
    #[command(flatten)]
    pub select: SelectArgs,
    /// Also write what is not selected, as it was.
    #[arg(long)]
    pub keep_rest: bool,
    /// Replace an existing file, or an unfinished training with other settings.
    #[arg(long)]
    pub force: bool,
    /// Only say what would be done, how much memory and roughly how long it takes.
    #[arg(long)]
    pub dry_run: bool,
}

/// The simple tools of a scene's `select`; the whole file without any.
#[derive(Args, Clone, Debug)]
#[command(next_help_heading = "Selecting the object")]
pub struct SelectArgs {
    /// Keep only the largest connected component.
    #[arg(long)]
    pub largest_component: bool,
    /// Keep only the connected component nearest to this point.
    #[arg(long, value_name = "x,y,z", value_parser = point, allow_hyphen_values = true)]
    pub seed_point: Option<[f64; 3]>,
    /// Fit the plane that the thing stands on and keep what is above it.
    #[arg(long)]
    pub above_support_plane: bool,
    /// The direction that points up in the file.
    #[arg(long, value_name = "DIRECTION", value_parser = direction, default_value = "+z", allow_hyphen_values = true)]
    pub up: [f64; 3],
    /// Least opacity, 0 to 1.
    #[arg(long, value_name = "O", value_parser = share)]
    pub min_opacity: Option<f64>,
    /// Longest standard deviation, in the file's units.
    #[arg(long, value_name = "S", value_parser = length)]
    pub max_scale: Option<f64>,
}

impl SelectArgs {
    fn select(&self) -> Vec<Select> {
        let select = Select {
            largest_component: self.largest_component,
            seed: self.seed_point,
            above_support_plane: self.above_support_plane,
            min_opacity: self.min_opacity,
            max_scale: self.max_scale,
            ..Select::default()
        };
        if select == Select::default() { Vec::new() } else { vec![select] }
    }
}

impl FinetuneArgs {
    /// The job.
    pub fn job(&self, threads: Option<u16>) -> FinetuneJob {
        let name = self.splat.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
        let stem = name.split('.').next().filter(|s| !s.is_empty()).unwrap_or("splat");
        let default = || Path::new("megas-out").join(format!("{stem}.tuned.ply"));
        let base = if self.preview { FinetuneSettings::preview() } else { FinetuneSettings::default() };
        FinetuneJob {
            select: self.select.select(),
            up: self.select.up,
            keep_rest: self.keep_rest,
            settings: FinetuneSettings {
                steps: self.steps.unwrap_or(base.steps),
                size: self.size.unwrap_or(base.size),
                views: self.views,
                seed: self.seed,
                cells: self.cells,
                max_gaussians: self.max_gaussians,
                ..base
            },
            force: self.force,
            threads: threads.map(usize::from),
            ..FinetuneJob::new(self.splat.clone(), self.out.clone().unwrap_or_else(default))
        }
    }
}

/// Arguments of `eval reconstruct`. Method and seed are those of [`TrainingArgs`] where one is enough.
#[derive(Args, Clone, Debug)]
pub struct StudyArgs {
    /// Folders of captures; those with a true surface in mesh/whole.ply say the most.
    #[arg(required = true)]
    pub captures: Vec<PathBuf>,
    /// Methods, separated by commas, or all.
    #[arg(long, value_name = "LIST", value_parser = method_list, default_value = "vanilla,ours")]
    pub methods: MethodList,
    /// Trainings of vanilla and ours with different seeds; the others get one.
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=100))]
    pub seeds: u32,
    /// The other methods get all seeds too.
    #[arg(long)]
    pub seeds_all: bool,
    /// Length and size of the trainings.
    #[arg(long, value_parser = profiles(), default_value = "object")]
    pub profile: Profile,
    /// Iterations; all milestones follow [default: the profile's].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub iterations: Option<u32>,
    /// Reduce the photographs by this factor; auto reduces those wider than 1600 pixels.
    #[arg(long, value_name = "auto|N", value_parser = downscale, default_value = "auto")]
    pub downscale: Downscale,
    /// Hold out every so many views, unless the capture says itself which.
    #[arg(long, value_name = "N", default_value_t = 8, value_parser = clap::value_parser!(u32).range(1..))]
    pub eval_every: u32,
    /// The first seed.
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub seed: u64,
    /// Memory for the photographs in GiB.
    #[arg(long, value_name = "GIB", default_value = "8", value_parser = gibibytes)]
    pub memory_budget: f64,
    /// Folder of the results [default: megas-out/eval].
    #[arg(short, long = "output", value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Replace results of other settings.
    #[arg(long)]
    pub force: bool,
}

/// Several methods.
#[derive(Clone, Debug, PartialEq)]
pub struct MethodList(Vec<Method>);

fn method_list(text: &str) -> Result<MethodList, String> {
    named_list(text, &Method::ALL, |m, name| m.name() == name, |m| m.name().to_owned()).map(MethodList)
}

/// Methods separated by commas, each once, or `all` of them. `is` tells which a name means, `show` names one in a message.
pub(crate) fn named_list<T: Copy + PartialEq>(
    text: &str,
    all: &[T],
    is: impl Fn(T, &str) -> bool,
    show: impl Fn(T) -> String,
) -> Result<Vec<T>, String> {
    if text == "all" {
        return Ok(all.to_vec());
    }
    let names = || all.iter().map(|&m| show(m)).collect::<Vec<_>>().join(", ");
    let mut list = Vec::new();
    for name in text.split(',').map(str::trim) {
        let found = all.iter().copied().find(|&m| is(m, name));
        let method = found.ok_or_else(|| format!("no method '{name}'; there are {} and all", names()))?;
        if !list.contains(&method) {
            list.push(method);
        }
    }
    Ok(list)
}

impl StudyArgs {
    /// The job.
    pub fn job(&self, threads: Option<u16>) -> StudyJob {
        StudyJob {
            captures: self.captures.clone(),
            methods: self.methods.0.clone(),
            seeds: self.seeds,
            seeds_all: self.seeds_all,
            settings: ReconstructSettings {
                profile: self.profile,
                iterations: self.iterations,
                downscale: self.downscale,
                eval_every: self.eval_every,
                seed: self.seed,
                ..ReconstructSettings::default()
            },
            memory_gib: self.memory_budget,
            out: self.out.clone().unwrap_or_else(|| Path::new("megas-out").join("eval")),
            force: self.force,
            threads: threads.map(usize::from),
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
        assert!(object_box("-1, 2,3,0.5,1,1").is_ok_and(|r| r.center == [-1.0, 2.0, 3.0] && r.half == [0.5, 1.0, 1.0]));
        assert!(object_box("1,2,3").is_err() && object_box("1,2,3,0,1,1").is_err() && object_box("a,2,3,1,1,1").is_err());
        assert!(gibibytes("0").is_err() && gibibytes("nan").is_err() && gibibytes("1.5") == Ok(1.5));
        assert!(count("0").is_err());
        assert_eq!(method_list("ours, vanilla,ours"), Ok(MethodList(vec![Method::Ours, Method::Vanilla])));
        assert_eq!(method_list("all").map(|l| l.0.len()), Ok(6));
        assert!(method_list("best").is_err_and(|e| e.contains("pgsr-prune")));
        assert_eq!(direction("-y"), Ok([0.0, -1.0, 0.0]));
        assert_eq!(direction("0.5,0,1"), Ok([0.5, 0.0, 1.0]));
        assert!(direction("y").is_err() && direction("0,0,0").is_err() && direction("+w").is_err());
        assert!(share("1.1").is_err() && length("-1").is_err() && point("1,2").is_err());
    }
}
