//! A figure of four variants at toy size: files, shared simulations, and the same command once more.

use std::sync::Mutex;

use megas_pipeline::{Event, FigureJob, LoadedScene, Options, Sink, figure};

/// Keeps the names of stages.
#[derive(Default)]
struct Stages(Mutex<Vec<String>>);

impl Sink for Stages {
    fn event(&self, event: Event<'_>) {
        if let Event::Stage { name, .. } = event {
            self.0.lock().unwrap().push(name.to_owned());
        }
    }
}

impl Stages {
    fn count(&self, name: &str) -> usize {
        self.0.lock().unwrap().iter().filter(|n| *n == name).count()
    }
}

const BLOCK: &str = "[[input.body]]\nname = \"block\"\nform = \"box\"\nsize_m = [0.05, 0.05, 0.05]\n[[object]]\nname = \"block\"\nparts = [\"block\"]\n\
                     [simulation]\ncells = 8\n[time]\nduration_s = 0.2\n[[camera]]\nframe = \"scene\"\n\
                     orbit = { target = [0.0, 0.0, 0.02], distance = 0.25, azimuth_deg = 20, elevation_deg = 25 }\n[output]\nwidth = 160\nheight = 120\n";

fn job(folder: &std::path::Path, sheet: &str) -> FigureJob {
    let (scene, figure) = (folder.join("block.toml"), folder.join("mine.toml"));
    std::fs::write(&scene, BLOCK).unwrap();
    std::fs::write(&figure, sheet).unwrap();
    FigureJob {
        figure: figure.display().to_string(),
        scene: LoadedScene::open(&scene).unwrap(),
        options: Options { out: folder.join("out"), force: false, threads: Some(1) },
    }
}

/// That a method finds no inside is a result too.
#[test]
fn a_variant_that_cannot_be_made_is_left_out_and_said_to_be() {
    let folder = tempfile::tempdir().unwrap();
    let text = "title = \"t\"\ntimes = [1.0]\n[[variant]]\nlabel = \"rays\"\n[[variant]]\nlabel = \"density\"\n\
                objects = { filling = \"density-field\" }\n";
    let job = job(folder.path(), text);
    let result = figure(&job, &Stages::default()).unwrap();
    assert!(result["variants"][0]["second_difference"].is_f64() && result["variants"][1]["failed"].is_string(), "{result}");
    let png = image::open(folder.path().join("out/figure.png")).unwrap();
    assert_eq!((png.width(), png.height()), (160, 120));
}

#[test]
fn variants_share_simulations_and_end_beside_each_other() {
    let folder = tempfile::tempdir().unwrap();
    let text = "title = \"t\"\ntimes = [0.0, 1.0]\n[[variant]]\nlabel = \"splats\"\n[[variant]]\nlabel = \"mesh\"\nset.skin = { draw = \"mesh\" }\n\
                [[variant]]\nlabel = \"particles\"\nset.skin = { draw = \"particle_mesh\" }\n[[variant]]\nlabel = \"butter\"\n\
                objects = { material = \"butter\" }\n";
    let job = job(folder.path(), text);
    let out = job.options.out.clone();
    let first = Stages::default();
    let result = figure(&job, &first).unwrap();
    assert_eq!((first.count("fill"), first.count("simulate"), first.count("render")), (2, 2, 4));
    let png = image::open(out.join("figure.png")).unwrap();
    assert_eq!((png.width(), png.height()), (4 * 160, 2 * 120));
    assert!(out.join("figure.mp4").exists() && out.join("figure.json").exists());
    let unrest: Vec<f64> = result["variants"].as_array().unwrap().iter().map(|v| v["second_difference"].as_f64().unwrap()).collect();
    assert!(unrest.iter().all(|u| (0.0..0.05).contains(u)), "{unrest:?}");
    // A mesh looks like the splats it comes from.
    let picture = |k: u32| image::open(out.join(format!("variant{k}/frames/rgb_00000.png"))).unwrap().to_rgb8();
    let (a, b) = (picture(1), picture(2));
    let difference = a.as_raw().iter().zip(b.as_raw()).map(|(x, y)| f64::from(x.abs_diff(*y))).sum::<f64>() / a.as_raw().len() as f64;
    assert!((0.05..12.0).contains(&difference), "{difference}");
    let again = Stages::default();
    assert_eq!(figure(&job, &again).unwrap()["variants"][1]["second_difference"], result["variants"][1]["second_difference"]);
    assert_eq!((again.count("simulate"), again.count("render")), (0, 0));
}
