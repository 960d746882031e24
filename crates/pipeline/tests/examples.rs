//! The example scenes that need no file, at toy size: they parse, run, their audits close, and nothing had to be repaired.

use std::path::{Path, PathBuf};

use megas_pipeline::{Event, LoadedScene, Options, Sink};

/// Says nothing.
struct Quiet;

impl Sink for Quiet {
    fn event(&self, _: Event<'_>) {}
}

/// Example scenes without a splat or photographs.
fn scenes() -> Vec<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples");
    let mut found: Vec<PathBuf> = std::fs::read_dir(folder)
        .unwrap()
        .map(|f| f.unwrap().path())
        .filter(|p| p.extension().is_some_and(|e| e == "toml"))
        .filter(|p| !LoadedScene::open(p).unwrap().scene.input.bodies.is_empty())
        .collect();
    found.sort();
    found
}

#[test]
fn every_example_runs_at_toy_size() {
    let scenes = scenes();
    assert!(scenes.len() >= 8, "{scenes:?}");
    for path in scenes {
        let mut loaded = LoadedScene::open(&path).unwrap();
        loaded.scene.simulation.cells = Some(12);
        loaded.scene.time.duration_s = 0.1;
        let out = tempfile::tempdir().unwrap();
        let options = Options { out: out.path().join("out"), force: false, threads: None };
        let figures = megas_pipeline::simulate(&loaded, &options, &Quiet).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
        assert_eq!(figures["repairs"], 0, "{}: {figures}", path.display());
        assert!(figures["energy_residual"].as_f64().unwrap() < 1e-5, "{}: {figures}", path.display());
    }
}

/// Keeps the notes.
#[derive(Default)]
struct Notes(std::sync::Mutex<Vec<String>>);

impl Sink for Notes {
    fn event(&self, event: Event<'_>) {
        if let Event::Note(text) = event {
            self.0.lock().unwrap().push(text.to_owned());
        }
    }
}

#[test]
fn what_is_dropped_falls_in_the_film_and_not_before_it() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples/dropped.toml");
    let mut loaded = LoadedScene::open(&path).unwrap();
    loaded.scene.simulation.cells = Some(12);
    loaded.scene.time.duration_s = 0.1;
    let notes = |loaded: &LoadedScene| {
        let out = tempfile::tempdir().unwrap();
        let options = Options { out: out.path().join("out"), force: false, threads: None };
        let sink = Notes::default();
        let figures = megas_pipeline::simulate(loaded, &options, &sink).unwrap();
        (sink.0.into_inner().unwrap().join("\n"), figures["max_speed_m_s"].as_f64().unwrap())
    };
    let (told, speed) = notes(&loaded);
    assert!(told.contains("'ball' would sink"), "{told}");
    assert!(speed > 0.3, "free fall for one frame gives 0.4 m/s, this gives {speed}");
    loaded.scene.simulation.settle_s = 0.0;
    assert!(!notes(&loaded).0.contains("would sink"));
}

#[test]
fn a_mesh_can_be_a_thin_collider_unless_it_is_closed() {
    let dir = tempfile::tempdir().unwrap();
    let scene = dir.path().join("scene.toml");
    let run = |obj: &str| {
        std::fs::write(dir.path().join("leaf.obj"), obj).unwrap();
        let text = "[[input.body]]\nname = \"ball\"\nform = \"ball\"\nsize_m = [0.05, 0.05, 0.05]\ncenter_m = [0.0, 0.0, 0.06]\n\
                    [[object]]\nname = \"wax\"\nparts = [\"ball\"]\n\
                    [[collider]]\nframe = \"scene\"\nshape = { mesh = { file = \"leaf.obj\" } }\nthin = true\n";
        std::fs::write(&scene, text).unwrap();
        let mut loaded = LoadedScene::open(&scene).unwrap();
        loaded.scene.simulation.cells = Some(12);
        loaded.scene.time.duration_s = 0.1;
        let options = Options { out: dir.path().join("out"), force: true, threads: None };
        megas_pipeline::simulate(&loaded, &options, &Quiet)
    };
    let corners = "v -0.05 -0.05 0.03\nv 0.05 -0.05 0.03\nv 0.05 0.05 0.03\nv -0.05 0.05 0.03\nv 0 0 0.02\n";
    let leaf = format!("{corners}f 1 2 5\nf 2 3 5\nf 3 4 5\nf 4 1 5\n");
    assert_eq!(run(&leaf).unwrap()["repairs"], 0);
    let error = run(&format!("{leaf}f 1 3 2\nf 1 4 3\n")).unwrap_err().to_string();
    assert!(error.contains("leaf.obj: the mesh is closed") && error.contains("single layer of triangles, or leave out thin"), "{error}");
}
