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
