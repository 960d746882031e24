//! `eval figure`: variants of one scene beside each other, as a film, a sheet of stills and a table. The figures of the paper
//! (ablations of topology, push-forward, phase switch, sources, parameters; cross-sections) are such lists of changes.

mod compose;
mod variant;

use std::path::PathBuf;
use std::time::Instant;

use megas_scene::{Film, Scene};
use serde_json::{Value, json};

use crate::disk::{create_dir, write_json};
use crate::run::{in_pool, render_from};
use crate::{Event, Failure, LoadedScene, Options, Sink};
use variant::{Sheet, Variant};

/// Pixels that a film of several variants may be wide.
const FILM_WIDTH: u32 = 1920;

/// A figure that comes with the program.
pub struct BuiltIn {
    /// Its name.
    pub name: &'static str,
    /// What it shows.
    pub about: &'static str,
    text: &'static str,
}

/// The figures that come with the program.
pub const FIGURES: &[BuiltIn] = &[
    BuiltIn {
        name: "sections",
        about: "cut open: the inside as it melts, and its temperature is that of the thermal film",
        text: include_str!("figure/sections.toml"),
    },
    BuiltIn {
        name: "topology",
        about: "what closes cracks: bare splats, kernels, growing splats, meshes",
        text: include_str!("figure/topology.toml"),
    },
    BuiltIn { name: "push", about: "what deforms the splats: elastic, total, rotation", text: include_str!("figure/push.toml") },
    BuiltIn {
        name: "phase",
        about: "the phase switch: mushy, without latent heat, binary, molten from the start",
        text: include_str!("figure/phase.toml"),
    },
    BuiltIn { name: "preset", about: "the paper's algorithm to the letter against ours", text: include_str!("figure/preset.toml") },
    BuiltIn { name: "heat", about: "kinds of heat: lamp, torch, hot air, hot table", text: include_str!("figure/heat.toml") },
    BuiltIn { name: "parameters", about: "thin, thick and stiff melts", text: include_str!("figure/parameters.toml") },
];

/// A figure to be made.
#[derive(Clone, Debug)]
pub struct FigureJob {
    /// Name of a figure that comes with the program, or a file of one's own.
    pub figure: String,
    /// The scene that is varied.
    pub scene: LoadedScene,
    /// Where results go.
    pub options: Options,
}

/// Runs all variants and writes `figure.mp4`, `figure.png` and `figure.json`; returns the table.
pub fn figure(job: &FigureJob, sink: &dyn Sink) -> Result<Value, Failure> {
    in_pool(job.options.threads, || Work::new(job)?.run(sink))
}

struct Work<'a> {
    job: &'a FigureJob,
    sheet: Sheet,
    scenes: Vec<LoadedScene>,
    columns: usize,
}

/// What is known of a variant that has been drawn.
struct Drawn {
    label: String,
    frames: PathBuf,
    seconds: f64,
    figures: Value,
}

impl<'a> Work<'a> {
    fn new(job: &'a FigureJob) -> Result<Self, Failure> {
        let sheet = Sheet::open(&job.figure)?;
        let columns = if sheet.variants.len() <= 4 { sheet.variants.len() } else { sheet.variants.len().div_ceil(2) };
        let varied = |v: &Variant| -> Result<LoadedScene, Failure> {
            let mut loaded = v.apply(&job.scene)?;
            let (w, h) = loaded.scene.picture_size();
            let width = w.min(FILM_WIDTH / columns as u32) & !1;
            let o = &mut loaded.scene.output;
            (o.width, o.height) = (Some(width), Some((h * width / w) & !1));
            o.png = true;
            o.films = vec![if sheet.thermal { Film::Thermal } else { Film::Rgb }];
            loaded.text = loaded.scene.to_toml();
            Ok(loaded)
        };
        let scenes = sheet.variants.iter().map(varied).collect::<Result<_, _>>()?;
        Ok(Self { job, sheet, scenes, columns })
    }

    fn run(&self, sink: &dyn Sink) -> Result<Value, Failure> {
        let out = &self.job.options.out;
        let mut simulated: Vec<Scene> = Vec::new();
        let (mut drawn, mut failed) = (Vec::new(), Vec::new());
        for (k, (v, loaded)) in self.sheet.variants.iter().zip(&self.scenes).enumerate() {
            sink.event(Event::Note(&format!("variant {} of {}: {}", k + 1, self.scenes.len(), v.label)));
            // Variants that differ in their pictures alone share one simulation.
            let without = without_pictures(&loaded.scene);
            let base = simulated.iter().position(|s| *s == without).unwrap_or_else(|| {
                simulated.push(without);
                simulated.len() - 1
            });
            let at = |folder: PathBuf| Options { out: folder, ..self.job.options.clone() };
            let folder = out.join(format!("variant{}", k + 1));
            let start = Instant::now();
            let figures = match render_from(loaded, &at(out.join(format!("simulation{}", base + 1))), &at(folder.clone()), sink) {
                Ok(figures) => figures,
                // That a method finds no inside, say, is a result; the others are worth seeing all the same.
                Err(Failure::Input(why)) if self.scenes.len() - failed.len() > 1 => {
                    sink.event(Event::Warning(&format!("\"{}\" is left out: {why}", v.label)));
                    failed.push(json!({ "label": v.label, "failed": why }));
                    continue;
                }
                Err(e) => return Err(e),
            };
            drawn.push(Drawn { label: v.label.clone(), frames: folder.join("frames"), seconds: start.elapsed().as_secs_f64(), figures });
        }
        create_dir(out)?;
        let scene = &self.scenes[0].scene;
        let film = compose::Film {
            labels: drawn.iter().map(|d| d.label.as_str()).collect(),
            folders: drawn.iter().map(|d| d.frames.as_path()).collect(),
            kind: if self.sheet.thermal { "thermal" } else { "rgb" },
            columns: self.columns.min(drawn.len()),
            frames: scene.time.frames(),
            fps: scene.time.fps,
        };
        let (mp4, png) = (out.join("figure.mp4"), out.join("figure.png"));
        let unrest = film.write(&mp4, sink)?;
        film.stills(&self.sheet.times, &png)?;
        for file in [&mp4, &png] {
            sink.event(Event::File(file));
        }
        let rows: Vec<Value> = drawn
            .iter()
            .zip(unrest)
            .map(|(d, m11)| json!({"label": d.label, "second_difference": m11, "seconds": d.seconds, "skin": d.figures["skin"]}))
            .chain(failed)
            .collect();
        let result = json!({
            "figure": self.job.figure,
            "title": self.sheet.title,
            "film": mp4.display().to_string(),
            "sheet": png.display().to_string(),
            "frames": scene.time.frames(),
            "variants": rows,
        });
        write_json(&out.join("figure.json"), &result)?;
        Ok(result)
    }
}

/// What a simulation depends on.
fn without_pictures(scene: &Scene) -> Scene {
    let default = Scene::default();
    let skin = megas_scene::Skin { patch_background: scene.skin.patch_background, ..default.skin };
    Scene { skin, output: default.output, cameras: default.cameras, ..scene.clone() }
}

/// Names and meanings of the figures, for help and errors.
fn names() -> String {
    FIGURES.iter().map(|f| format!("{} ({})", f.name, f.about)).collect::<Vec<_>>().join("; ")
}

fn built_in(name: &str) -> Option<&'static BuiltIn> {
    FIGURES.iter().find(|f| f.name == name)
}
