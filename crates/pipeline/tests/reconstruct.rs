//! Photographs to splats at a toy size: what comes out, what an interruption changes (nothing), what bad captures leave (nothing).

mod common;

use std::path::Path;

use common::{Impatient, capture, capture_around};
use megas_metrics::assets::{Shape, Sundae};
use megas_pipeline::{
    Backdrop, Failure, FinetuneJob, FinetuneSettings, LoadedScene, Method, Options, Profile, ReconstructJob, ReconstructSettings, StudyJob,
    finetune, plan_reconstruct, reconstruct, run, study,
};
use megas_scene::Scene;
use serde_json::Value;

fn job(folder: &Path, name: &str, iterations: u32) -> ReconstructJob {
    let settings = ReconstructSettings { profile: Profile::Tiny, iterations: Some(iterations), ..Default::default() };
    let output = folder.join("out").join(name);
    ReconstructJob { settings, preview_every: 100, threads: Some(2), ..ReconstructJob::new(folder.join("photos"), output) }
}

fn number(v: &Value, key: &str) -> f64 {
    v[key].as_f64().unwrap_or_else(|| panic!("{key} is missing in {v}"))
}

#[test]
fn the_embedded_scene_is_reconstructed_and_an_interruption_changes_no_byte() {
    reconstructed_and_interrupted(Some(Backdrop::White));
}

/// As above with the backdrop that is the default for photographs with alpha.
#[test]
fn with_a_random_backdrop_an_interruption_changes_no_byte() {
    reconstructed_and_interrupted(None);
}

fn reconstructed_and_interrupted(background: Option<Backdrop>) {
    let dir = tempfile::tempdir().unwrap();
    capture(&dir.path().join("photos"), &Sundae::new(), 20, 4, 64);
    let mut whole = job(dir.path(), "whole.ply", 200);
    whole.settings.background = background;
    let plan = plan_reconstruct(&whole).unwrap();
    assert_eq!((plan["views"].as_u64(), plan["test_views"].as_u64(), plan["iterations"].as_u64()), (Some(20), Some(4), Some(200)));
    assert!(!dir.path().join("out").exists(), "a dry run leaves nothing");

    let result = reconstruct(&whole, &Impatient::never()).unwrap();
    for key in ["psnr", "ssim", "flip", "gaussians", "iterations", "seconds", "needle_p99", "internal_fraction", "area_cv"] {
        assert!(number(&result, key).is_finite(), "{key}");
    }
    assert!(number(&result, "psnr") > 20.0 && number(&result, "ssim") > 0.6, "{result}");
    assert_eq!(result["output"], whole.output.display().to_string());
    let folder = dir.path().join("out/whole.train");
    for name in ["evaluation.json", "contact_sheet.png", "log.jsonl", "preview_000100.png", "preview_000200.png"] {
        assert!(folder.join(name).is_file(), "{name}");
    }
    assert!(!folder.join("checkpoint.bin").exists(), "only an unfinished training needs it");
    assert_eq!(std::fs::read_to_string(folder.join("log.jsonl")).unwrap().lines().count(), 2);

    // The same in two pieces, with other threads.
    let parts = ReconstructJob { threads: Some(1), output: dir.path().join("out/parts.ply"), ..whole.clone() };
    let stopped = reconstruct(&parts, &Impatient::after(90));
    assert!(matches!(&stopped, Err(Failure::Interrupted(m)) if m.contains("again to continue")), "{stopped:?}");
    let partial = dir.path().join("out/parts.partial.ply");
    assert!(partial.is_file() && dir.path().join("out/parts.train/checkpoint.bin").is_file() && !parts.output.exists());
    let other = reconstruct(
        &ReconstructJob { settings: ReconstructSettings { seed: 1, ..parts.settings.clone() }, ..parts.clone() },
        &Impatient::never(),
    );
    assert!(matches!(&other, Err(Failure::Input(m)) if m.contains("--force")), "{other:?}");
    reconstruct(&parts, &Impatient::never()).unwrap();
    assert!(!partial.exists());
    let read = |path: &Path| std::fs::read(path).unwrap();
    assert!(read(&whole.output) == read(&parts.output), "the interruption changed the splats");
    assert!(read(&folder.join("log.jsonl")) == read(&dir.path().join("out/parts.train/log.jsonl")), "the interruption changed the log");

    // A second time nothing happens; without its folder the file is in the way.
    assert_eq!(reconstruct(&whole, &Impatient::after(1)).unwrap(), result);
    std::fs::remove_dir_all(&folder).unwrap();
    assert!(matches!(reconstruct(&whole, &Impatient::never()), Err(Failure::Input(m)) if m.contains("exists")));
}

#[test]
fn a_bad_capture_leaves_nothing() {
    let dir = tempfile::tempdir().unwrap();
    let photos = dir.path().join("photos");
    capture(&photos, &Shape::Sphere { radius: 0.5 }, 4, 1, 16);
    let truncated = std::fs::read(photos.join("images/train_02.png")).unwrap()[..60].to_vec();
    let cases: [(&str, Option<&[u8]>); 3] =
        [("images/train_02.png", Some(&truncated)), ("images/train_02.png", None), ("transforms_train.json", Some(b"{\"frames\": [{}"))];
    for (name, content) in cases {
        let path = photos.join(name);
        let before = std::fs::read(&path).unwrap();
        match content {
            Some(bytes) => std::fs::write(&path, bytes).unwrap(),
            None => std::fs::remove_file(&path).unwrap(),
        }
        let failed = reconstruct(&job(dir.path(), "a.ply", 10), &Impatient::never());
        assert!(matches!(&failed, Err(Failure::Input(m)) if m.lines().count() == 1 && m.contains("train")), "{failed:?}");
        assert!(!dir.path().join("out").exists(), "{name} left something");
        std::fs::write(&path, before).unwrap();
    }
    let nowhere = ReconstructJob { capture: dir.path().join("nowhere"), ..job(dir.path(), "a.ply", 10) };
    assert!(matches!(reconstruct(&nowhere, &Impatient::never()), Err(Failure::Input(_))));
    let wrong_name = ReconstructJob { output: dir.path().join("out/a.obj"), ..job(dir.path(), "a.ply", 10) };
    assert!(matches!(reconstruct(&wrong_name, &Impatient::never()), Err(Failure::Input(_))));
    assert!(!dir.path().join("out").exists());
}

#[test]
fn methods_are_compared_and_the_comparison_goes_on() {
    let dir = tempfile::tempdir().unwrap();
    capture(&dir.path().join("photos"), &Shape::Torus { major: 0.5, minor: 0.2 }, 8, 2, 32);
    let study_job = StudyJob {
        captures: vec![dir.path().join("photos")],
        methods: vec![Method::Vanilla, Method::Pgsr, Method::Ours],
        seeds: 2,
        seeds_all: false,
        settings: ReconstructSettings { profile: Profile::Tiny, iterations: Some(40), ..Default::default() },
        memory_gib: 1.0,
        out: dir.path().join("study"),
        force: false,
        threads: Some(2),
    };
    let stopped = study(&study_job, &Impatient::after(30));
    assert!(matches!(stopped, Err(Failure::Interrupted(_))), "{stopped:?}");
    let result = study(&study_job, &Impatient::never()).unwrap();
    assert_eq!((result["trainings"].as_u64(), result["captures"][0].as_str()), (Some(5), Some("photos")));
    let text = std::fs::read_to_string(dir.path().join("study/table.md")).unwrap();
    assert!(text.contains("| vanilla | 2 |") && text.contains("| pgsr | 1 |") && text.contains("5 of 5 trainings done"), "{text}");
    let table: Value = serde_json::from_slice(&std::fs::read(dir.path().join("study/table.json")).unwrap()).unwrap();
    assert!(table["assets"][0]["orderings"].as_array().is_some_and(|o| !o.is_empty()));
    // Everything is there: one that would stop at the first iteration gets the result.
    assert_eq!(study(&study_job, &Impatient::after(1)).unwrap(), result);
}

#[test]
fn photographs_melt_and_splats_are_tuned_before_they_do() {
    let dir = tempfile::tempdir().unwrap();
    capture_around(&dir.path().join("photos"), &Shape::Torus { major: 0.5, minor: 0.25 }, 24, 2, 64);
    let toy =
        "\n[simulation]\ncells = 8\n[time]\nduration_s = 0.2\nmelt_in_s = 0.1\n[output]\nwidth = 96\nheight = 64\nfilms = [\"rgb\"]\n";
    let load = |input: &str| {
        let text = format!("{input}{toy}");
        LoadedScene { scene: Scene::parse(&text, "s.toml").unwrap(), base_dir: dir.path().to_path_buf(), text }
    };
    let options = |name: &str| Options { out: dir.path().join(name), force: false, threads: Some(2) };
    let scene = load("[input]\ncapture = \"photos\"\n[input.reconstruct]\nprofile = \"tiny\"\niterations = 300\n");
    let stopped = run(&scene, &options("melt"), &Impatient::after(50));
    assert!(matches!(stopped, Err(Failure::Interrupted(_))), "{stopped:?}");
    let result = run(&scene, &options("melt"), &Impatient::never()).unwrap();
    assert!(number(&result["training"], "psnr") > 20.0, "{result}");
    assert_eq!(result["films"].as_array().map(Vec::len), Some(1));
    let splats = dir.path().join("melt/reconstruct/splats.ply");
    assert!(splats.is_file() && dir.path().join("melt/body/stage.json").is_file());

    let job = FinetuneJob {
        settings: FinetuneSettings { steps: 20, size: 48, views: 8, test_views: 2, ..Default::default() },
        threads: Some(2),
        ..FinetuneJob::new(splats.clone(), dir.path().join("tuned.ply"))
    };
    let tuned = finetune(&job, &Impatient::never()).unwrap();
    for key in ["psnr", "gaussians_before", "gaussians", "needle_fraction", "needle_p99", "hidden_fraction", "hidden_fraction_before"] {
        assert!(number(&tuned, key).is_finite(), "{key}");
    }
    assert!(number(&tuned, "psnr") > 25.0, "{tuned}");
    let itself = FinetuneJob { output: splats.clone(), force: true, ..job };
    assert!(matches!(finetune(&itself, &Impatient::never()), Err(Failure::Input(_))));

    let scene = load("[input]\nsplat = \"melt/reconstruct/splats.ply\"\nfinetune = { steps = 20, size = 128, views = 32 }\n");
    let result = run(&scene, &options("tuned"), &Impatient::never()).unwrap();
    assert!(number(&result["training"], "needle_fraction") <= 0.01, "{result}");
    assert!(dir.path().join("tuned/finetune/splats.ply").is_file());
}
