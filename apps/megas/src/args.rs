//! The command line: what can be typed, and its help.

use std::path::{Path, PathBuf};

use clap::{Args, Parser, Subcommand};
use megas_scene::{Appearance, Clip, Frame, MeshKind, Scene};

use crate::claims_args::ClaimsArgs;
use crate::train_args::{FinetuneArgs, ReconstructArgs, StudyArgs};

/// Melt, freeze and heat real scenes: photographs or splats in, film out.
#[derive(Debug, Parser)]
#[command(name = "megas", version, max_term_width = 100, after_help = EXAMPLES, arg_required_else_help = true)]
pub struct Cli {
    /// What to do.
    #[command(subcommand)]
    pub command: Command,
    /// Everywhere options.
    #[command(flatten)]
    pub global: Global,
}

const EXAMPLES: &str = "\
Examples:
  megas demo                         melt the embedded ice cream; the films land in megas-out/demo
  megas reconstruct photos -o donut.ply   splats from posed photographs
  megas inspect donut.ply            what is in a splat file
  megas run donut.toml -o out        melt it: fill, simulate, render
  megas run donut.toml -o out --dry-run   only say what would be done
  megas render donut.toml -o out     new pictures of what was simulated before

A scene needs one line, the rest has defaults:
  [input]
  splat = \"donut.ply\"

Ctrl-C stops; the same command goes on where it stopped.
Exit codes: 0 done, 1 stopped or failed, 2 wrong input or usage.";

/// Options of every command.
#[derive(Args, Clone, Debug)]
pub struct Global {
    /// Print JSON lines only; the last is {"event":"result",…} or {"event":"error",…}.
    #[arg(long, global = true)]
    pub json: bool,
    /// No progress and no summary, only errors.
    #[arg(short, long, global = true, conflicts_with = "verbose")]
    pub quiet: bool,
    /// Also tell about notes and written files.
    #[arg(short, long, global = true)]
    pub verbose: bool,
    /// Worker threads [default: all cores]. The result does not depend on them.
    #[arg(long, global = true, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,
}

/// The commands.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Melt the embedded ice cream: no input needed.
    #[command(after_help = "Examples:\n  megas demo\n  megas demo -o /tmp/melt --quick")]
    Demo {
        /// Smaller and shorter: a minute instead of minutes.
        #[arg(long)]
        quick: bool,
        /// Where results go.
        #[command(flatten)]
        output: Output,
    },
    /// Say what is in a splat file: count, degree, bounding box, rows dropped.
    #[command(after_help = "Examples:\n  megas inspect donut.ply\n  megas inspect biker.compressed.ply --json")]
    Inspect {
        /// A .ply, .compressed.ply or .splat file.
        file: PathBuf,
    },
    /// Train splats on posed photographs (COLMAP or transforms.json).
    #[command(after_help = "Examples:\n  megas reconstruct photos/ -o thing.ply\n  megas reconstruct photos/ -o thing.ply --profile full \
                            --downscale 2\n  megas reconstruct photos/ -o thing.ply --dry-run\n\nBeside thing.ply, the folder \
                            thing.train holds the log, previews, the evaluation and a contact sheet.")]
    Reconstruct(Box<ReconstructArgs>),
    /// Make a splat from anywhere fit to melt, without photographs: no needles, nothing hidden inside, flat small kernels.
    #[command(after_help = "Examples:\n  megas finetune donut.ply -o tuned.ply\n  megas finetune donut.ply -o tuned.ply --preview\n  \
                            megas finetune room.ply -o vase.ply --above-support-plane --largest-component --up=-y")]
    Finetune(Box<FinetuneArgs>),
    /// Measure methods against each other.
    #[command(subcommand, arg_required_else_help = true)]
    Eval(Study),
    /// Run a scene from end to end: fill, simulate, render.
    #[command(after_help = "Examples:\n  megas run donut.toml -o out\n  megas run donut.toml -o out --dry-run")]
    Run(SceneArgs),
    /// First stage: select the objects and fill them with material points.
    #[command(after_help = "Example:\n  megas fill donut.toml -o out")]
    Fill(SceneArgs),
    /// Second stage: melt the points (runs `fill` first where needed).
    #[command(after_help = "Example:\n  megas simulate donut.toml -o out")]
    Simulate(SceneArgs),
    /// Third stage: pictures and films of the melt (runs the stages before where needed).
    #[command(after_help = "Examples:\n  megas render donut.toml -o out\n  megas render donut.toml -o out --mesh ply,glb --force\n  \
                            megas render donut.toml -o out --clip 0.5,0.5,0.5,0,-1,0 --force")]
    Render(RenderArgs),
    /// Print the JSON Schema of scene files, for editors with completion.
    #[command(after_help = "Example:\n  megas schema > scene.schema.json")]
    Schema,
    /// Compare the simulator with analytic solutions and published benchmarks.
    #[command(after_help = "Examples:\n  megas validate\n  megas validate --case V12 --case V34\n  megas validate --full -o suite\n\n\
                            DIR/validation.html shows every case with its figures, DIR/validation.json holds the same for machines.\n\
                            Exit code 1 if a number is outside its tolerance.")]
    Validate(ValidateArgs),
    /// List the material presets.
    #[command(after_help = "Examples:\n  megas materials\n  megas materials --json")]
    Materials,
}

/// What can be measured.
#[derive(Debug, Subcommand)]
pub enum Study {
    /// Compare reconstruction methods on captures: M1 to M5 as a table. May take hours; the same command goes on.
    #[command(after_help = "Examples:\n  megas eval reconstruct ice/ cow/ --methods vanilla,ours --seeds 3 -o study\n  \
                            megas eval reconstruct ice/ --methods all --profile tiny --downscale 4 -o study")]
    Reconstruct(Box<StudyArgs>),
    /// Compare methods on one object when it deforms: cracks, fidelity, needles, filling. The same command goes on.
    #[command(after_help = "Examples:\n  megas eval claims ice/ --models study -o claims\n  \
                            megas eval claims ice/ --methods B0,B5,B6 --profile tiny --quick -o claims")]
    Claims(Box<ClaimsArgs>),
    /// Vary a scene and show the variants beside each other, as a film and as a sheet of stills.
    #[command(after_help = figures_help())]
    Figure(FigureArgs),
}

/// Arguments of `eval figure`.
#[derive(Args, Clone, Debug)]
pub struct FigureArgs {
    /// Name of a figure that comes with the program (below), or a file of variants.
    pub figure: String,
    /// The scene that is varied [default: the embedded ice cream].
    pub scene: Option<PathBuf>,
    /// Smaller and shorter pictures of the embedded ice cream.
    #[arg(long, conflicts_with = "scene")]
    pub quick: bool,
    /// Folder of the results [default: megas-out/figure-NAME]. What fits is continued.
    #[arg(short, long = "output", value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Replace results of other settings.
    #[arg(long)]
    pub force: bool,
}

fn figures_help() -> String {
    let names: String = megas_pipeline::FIGURES.iter().map(|f| format!("  {:<11} {}\n", f.name, f.about)).collect();
    format!(
        "Figures:\n{names}\nA file of one's own holds a title and variants, each a list of changes to the scene:\n  [[variant]]\n  \
         label = \"thick\"\n  set.skin = {{ densify = false }}           keys of the scene file\n  \
         objects = {{ material = \"butter\" }}         keys of every object\n  \
         materials = {{ melt_consistency_pa_sn = 5.0 }}   keys of the material of every object\n\n\
         Examples:\n  megas eval figure topology\n  megas eval figure heat donut.toml -o heat\n  megas eval figure mine.toml donut.toml\n\n\
         DIR/figure.mp4, DIR/figure.png, and DIR/figure.json with the temporal unrest of every variant (mean second difference)."
    )
}

/// Arguments of `validate`.
#[derive(Args, Clone, Debug)]
pub struct ValidateArgs {
    /// Only this case, for example V12 (repeatable).
    #[arg(long = "case", value_name = "ID")]
    pub cases: Vec<String>,
    /// Also the cases that take longer than a minute; some take many.
    #[arg(long)]
    pub full: bool,
    /// Folder for validation.html and validation.json.
    #[arg(short, long = "output", value_name = "DIR", default_value = "megas-out/validation")]
    pub out: PathBuf,
    /// Also write the tables as Markdown, for docs/validation.md.
    #[arg(long, value_name = "FILE")]
    pub markdown: Option<PathBuf>,
    /// Only list the cases.
    #[arg(long)]
    pub list: bool,
}

/// Arguments of the commands that work on a scene.
#[derive(Args, Clone, Debug)]
pub struct SceneArgs {
    /// The scene file (see `megas schema`, and the folder `examples`).
    pub scene: PathBuf,
    /// Where results go.
    #[command(flatten)]
    pub output: Output,
}

/// Arguments of `render`: a scene, and what to show of it instead of what the file says.
#[derive(Args, Clone, Debug)]
pub struct RenderArgs {
    /// The scene.
    #[command(flatten)]
    pub scene: SceneArgs,
    /// Write meshes of the objects: ply, obj, glb; the same as `mesh = ["ply"]` in `output`.
    #[arg(long, value_name = "FORMAT,…", value_delimiter = ',', value_parser = mesh_kind)]
    pub mesh: Vec<MeshKind>,
    /// Cut the pictures open at a plane: a point (0–1 along the objects' box, z up) and the direction that is cut away.
    #[arg(long, value_name = "X,Y,Z,NX,NY,NZ", value_parser = clip, allow_hyphen_values = true)]
    pub clip: Option<Clip>,
    /// No glow and no wetness: only the colours of the input.
    #[arg(long)]
    pub plain: bool,
}

impl RenderArgs {
    /// Puts what was typed into the scene.
    pub fn apply(&self, scene: &mut Scene) {
        let o = &mut scene.output;
        if !self.mesh.is_empty() {
            o.mesh = self.mesh.clone();
        }
        if self.clip.is_some() {
            o.clip = self.clip;
        }
        if self.plain {
            o.appearance = Some(Appearance { glow: 0.0, wet: 0.0, ..Appearance::default() });
        }
    }
}

fn mesh_kind(text: &str) -> Result<MeshKind, String> {
    match text {
        "ply" => Ok(MeshKind::Ply),
        "obj" => Ok(MeshKind::Obj),
        "glb" => Ok(MeshKind::Glb),
        _ => Err("write ply, obj or glb".into()),
    }
}

fn clip(text: &str) -> Result<Clip, String> {
    let numbers: Option<Vec<f64>> = text.split(',').map(|w| w.trim().parse().ok().filter(|v: &f64| v.is_finite())).collect();
    match numbers.as_deref() {
        Some(&[x, y, z, nx, ny, nz]) if [nx, ny, nz] != [0.0; 3] => {
            Ok(Clip { point: [x, y, z], normal: [nx, ny, nz], frame: Frame::Object })
        }
        _ => Err("write six numbers X,Y,Z,NX,NY,NZ, the last three not all zero".into()),
    }
}

/// Where results go, or whether they go anywhere.
#[derive(Args, Clone, Debug)]
pub struct Output {
    /// Output folder [default: megas-out/NAME]. What fits is continued; anything else in it is an error unless --force.
    #[arg(short, long = "output", value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Replace results of another scene that are in the way.
    #[arg(long)]
    pub force: bool,
    /// Only say what would be done, how much memory and roughly how long it takes.
    #[arg(long)]
    pub dry_run: bool,
}

impl Output {
    /// The folder to use for something called `name`.
    pub fn folder(&self, name: &str) -> PathBuf {
        self.out.clone().unwrap_or_else(|| Path::new("megas-out").join(name))
    }
}

impl Command {
    /// Name in messages.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Demo { .. } => "demo",
            Self::Inspect { .. } => "inspect",
            Self::Reconstruct(_) => "reconstruct",
            Self::Finetune(_) => "finetune",
            Self::Eval(Study::Reconstruct(_)) => "eval reconstruct",
            Self::Eval(Study::Claims(_)) => "eval claims",
            Self::Eval(Study::Figure(_)) => "eval figure",
            Self::Run(_) => "run",
            Self::Fill(_) => "fill",
            Self::Simulate(_) => "simulate",
            Self::Render(_) => "render",
            Self::Schema => "schema",
            Self::Validate(_) => "validate",
            Self::Materials => "materials",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    #[test]
    fn the_command_line_is_consistent() {
        Cli::command().debug_assert();
    }

    #[test]
    fn options_may_stand_anywhere() {
        let cli = Cli::try_parse_from(["megas", "--json", "run", "s.toml", "-o", "d", "--threads", "2"]).unwrap();
        assert!(cli.global.json && cli.global.threads == Some(2));
        assert!(matches!(cli.command, Command::Run(a) if a.output.folder("x") == Path::new("d") && !a.output.dry_run));
        let cli = Cli::try_parse_from(["megas", "demo", "-q"]).unwrap();
        assert!(matches!(cli.command, Command::Demo { output, .. } if output.folder("demo") == Path::new("megas-out/demo")));
        let cli =
            Cli::try_parse_from(["megas", "render", "s.toml", "--mesh", "ply,glb", "--clip", "0.5,0.5,0.5,0,-1,0", "--plain"]).unwrap();
        let Command::Render(a) = cli.command else { panic!("render") };
        let mut scene = Scene::default();
        a.apply(&mut scene);
        assert_eq!((&scene.output.mesh[..], scene.appearance().wet), (&[MeshKind::Ply, MeshKind::Glb][..], 0.0));
        assert!(scene.output.clip.is_some_and(|c| c.normal == [0.0, -1.0, 0.0] && c.frame == Frame::Object));
        assert!(Cli::try_parse_from(["megas", "render", "s.toml", "--clip", "0,0,0,0,0,0"]).is_err());
        assert!(Cli::try_parse_from(["megas", "render", "s.toml", "--mesh", "stl"]).is_err());
        assert!(Cli::try_parse_from(["megas", "demo", "--threads", "0"]).is_err());
        assert!(Cli::try_parse_from(["megas", "demo", "-q", "-v"]).is_err());
    }
}
