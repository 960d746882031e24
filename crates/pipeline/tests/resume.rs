//! The main job at a toy size: it runs, its books close, and an interruption changes no byte.

mod common;

use std::path::Path;

use megas_pipeline::{DEMO_SCENE, Failure, LoadedScene, Options, run};
use megas_scene::Scene;

use common::Impatient;

fn toy() -> LoadedScene {
    let mut scene = Scene::parse(DEMO_SCENE, "demo.toml").expect("the demo scene is valid");
    scene.simulation.cells = Some(10);
    scene.time.duration_s = 0.4;
    scene.time.melt_in_s = Some(0.2);
    scene.output.ply_every = 5;
    scene.output.mesh = vec![megas_scene::MeshKind::Ply, megas_scene::MeshKind::Glb];
    scene.output.mesh_every = 3;
    (scene.output.width, scene.output.height) = (Some(160), Some(120));
    LoadedScene { text: scene.to_toml(), scene, base_dir: Path::new(".").to_path_buf() }
}

fn options(out: &Path, threads: usize) -> Options {
    Options { out: out.to_path_buf(), force: false, threads: Some(threads) }
}

#[test]
fn a_run_closes_its_books_and_an_interruption_changes_no_byte() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let (whole, parts) = (dir.path().join("whole"), dir.path().join("parts"));
    let scene = toy();
    let result = run(&scene, &options(&whole, 2), &Impatient::after(u64::MAX)).expect("the run completes");
    assert_eq!(result["frames"], 10);
    assert_eq!(result["repairs"], 0);
    assert!(result["energy_residual"].as_f64().is_some_and(|r| r < 1e-10), "{result}");
    assert!(result["volume_change"].as_f64().is_some_and(|v| v < 0.02), "{result}");
    assert_eq!(result["films"].as_array().map(Vec::len), Some(3));
    assert_eq!(result["mesh"]["files"], 4);
    assert!(result["mesh"]["volume_last_ratio"].as_f64().is_some_and(|v| (v - 1.0).abs() < 0.1), "{result}");
    let mesh = megas_formats::load_mesh(whole.join("meshes/mesh_00009.ply")).expect("a mesh");
    assert!(megas_skin::mesh::Topology::of(&mesh).watertight());

    let stopped = run(&scene, &options(&parts, 1), &Impatient::after(6));
    assert!(matches!(stopped, Err(Failure::Interrupted(_))), "{stopped:?}");
    // As after a kill: the newest checkpoint is damaged and a half-written file lies about.
    let newest = parts.join("sim/checkpoint_b.bin");
    assert!(newest.exists() && parts.join("sim/checkpoint_a.bin").exists());
    std::fs::write(&newest, "cut off").expect("damage the checkpoint");
    std::fs::write(parts.join("sim/.megas-x.part"), "half").expect("leave a trace");
    run(&scene, &options(&parts, 1), &Impatient::after(u64::MAX)).expect("the run is resumed");
    for name in [
        "sim/frame_00009.bin",
        "frames/rgb_00009.png",
        "frames/thermal_00004.png",
        "film.mp4",
        "splats/frame_00005.ply",
        "meshes/mesh_00006.ply",
        "meshes/mesh_00009.glb",
        "meshes/measures.csv",
    ] {
        let read = |root: &Path| std::fs::read(root.join(name)).unwrap_or_else(|e| panic!("{name}: {e}"));
        assert!(read(&whole) == read(&parts), "{name} differs after the interruption");
    }
    assert!(!parts.join("sim/.megas-x.part").exists());

    // A second time everything is up to date; another scene in the same folder is refused.
    run(&scene, &options(&whole, 1), &Impatient::after(u64::MAX)).expect("nothing to do");
    let mut other = toy();
    other.scene.simulation.cells = Some(11);
    assert!(matches!(run(&other, &options(&whole, 1), &Impatient::after(u64::MAX)), Err(Failure::Input(_))));
}
