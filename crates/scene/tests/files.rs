//! Reading and writing whole scenes.

use std::path::Path;

use megas_scene::{
    Auto, Clock, Film, Frame, HeatKind, Method, Profile, Quality, Quantity, Region, Scene, SceneError, Severity, json_schema,
    material_presets,
};

const EVERYTHING: &str = r##"
title = "Everything at once"
quality = "preview"
seed = 7

[input]
splat = "table.ply"
up = "-y"

[[object]]
name = "cake"
size_m = 0.3
material = "cake"
initial_temperature_c = 5
initial_velocity_m_s = [0, 0, -1]
contact_resistance_m2k_w = 2e-4

[object.select]
box = { min = [-1, -1, -1], max = [1, 1, 1], rotation_deg = [0, 0, 30] }
min_opacity = 0.05
above_support_plane = true
largest_component = true
not = { any = [{ sphere = { center = [0, 0, 0], radius = 0.1 } }, { half_space = { point = [0, 0, 0], direction = [0, 1, 0] } }] }

[[object]]
name = "candle"
select.cylinder = { from = [2, 0, 0], to = [2, -1, 0], radius = 0.2 }
material = "paraffin-wax"

[materials.cake]
preset = "milk-chocolate"
sag_ratio = 0.01
melt_yield_stress_pa = 20

[[heat]]
name = "lamp"
kind = "flux"
flux_w_m2 = 3000
region = { capsule = { from = [0, 0, 1], to = [1, 0, 1], radius = 0.4 } }
schedule = { start_s = 0.5, end_s = 4, ramp_s = 0.5, period_s = 1, duty = 0.5 }
motion = [{ time_s = 0 }, { time_s = 2, offset = [1, 0, 0], rotation_deg = 90 }]

[[heat]]
kind = "temperature"
region = { object = "candle" }
frame = "scene"
schedule.keyframes = [[0, 20], [2, 90.5]]

[[heat]]
kind = "film"
temperature_c = 80
film_coefficient_w_m2k = "auto"
region = { surface = "all" }

[air]
mode = "none"

[support]
temperature_c = 120
raise = -0.1

[[collider]]
name = "knife"
shape = { capsule = { from = [0, 0, 0.5], to = [1, 0, 0.5], radius = 0.02 } }
mode = "slip"
temperature_c = 90

[[collider]]
shape = { box = { min = [0, 0, 0.5], max = [1, 1, 0.51] } }
thin = true

[time]
duration_s = 3
acceleration = 50

[simulation]
cells = 32
box_m = [1, 1, 0.5]
bounds = "delete"
phase_mode = "binary"

[fill]
directions = 14
tau_alpha = "auto"
open_bottom = "cap"
tracers = true

[skin]
push = "total"

[[camera]]
name = "side"
orbit = { azimuth_deg = 90, distance = 3 }

[[camera]]
name = "fly"
frame = "scene"
keyframes = [{ time_s = 0, eye = [0, 0, 5], target = [0, 0, 0] }, { time_s = 3, eye = [5, 0, 5], target = [0, 0, 0], fov_deg = 20 }]

[output]
width = 640
background = "#102030"
films = ["rgb", "side_by_side"]
thermal_range_c = [0, 100]
ply_every = 10
mesh = ["ply", "glb"]
mesh_every = 2
clip = { point = [0.5, 0.5, 0.5], normal = [0, -1, 0] }
appearance = { glow = 0.5, wet = 0 }
"##;

#[test]
fn photographs_and_fine_tuning_round_trip() {
    let text = r#"
[input]
capture = "photos"
[input.reconstruct]
method = "pgsr-prune"
profile = "real-hq"
iterations = 900
downscale = 4
background = "white"
object_box = { min = [0, 0, 0], max = [1, 2, 3], rotation_deg = [0, 0, 45] }
"#;
    let scene = Scene::parse(text, "s.toml").unwrap();
    let r = scene.input.reconstruct.as_ref().unwrap();
    assert_eq!((r.method, r.profile, r.downscale), (Method::PgsrPrune, Profile::RealHq, Some(4)));
    assert_eq!((r.eval_every, r.memory_gib), (8, 8.0));
    assert_eq!(Scene::parse(&scene.to_toml(), "again.toml").unwrap(), scene);
    let tuned = |text: &str| {
        let scene = Scene::parse(&format!("[input]\nsplat = \"a.ply\"\n{text}"), "s.toml").unwrap();
        assert_eq!(Scene::parse(&scene.to_toml(), "again.toml").unwrap(), scene);
        scene.input.finetuning().map(|f| (f.steps, f.size))
    };
    assert_eq!(tuned(""), None);
    assert_eq!(tuned("finetune = false"), None);
    assert_eq!(tuned("finetune = true"), Some((1_000, 640)));
    assert_eq!(tuned("[input.finetune]\nsteps = 300"), Some((300, 640)));
}

#[test]
fn the_smallest_scene_melts() {
    let scene = Scene::parse("input.splat = \"donut.ply\"", "s.toml").unwrap();
    assert_eq!(scene.quality, Quality::Default);
    assert_eq!(scene.size_m(), (0.2, None));
    assert_eq!(scene.objects_or_default().len(), 1);
    assert!(scene.material(&scene.objects_or_default()[0].material).is_some());
    // It is heated, from above, and its clock runs such that it melts within the film.
    let heat = scene.heat_or_default();
    assert!(matches!(heat[0].region, Region::Box(b) if b.min[2] > 0.5));
    assert_eq!(heat[0].quantity(scene.ambient_k()), Quantity::Temperature(None));
    assert!(matches!(scene.clock(), Clock::MeltIn(t) if t < scene.time.duration_s));
    assert_eq!(scene.cameras_or_default().len(), 1);
    assert_eq!(scene.picture_size(), (1280, 720));
    // No heat at all is something else than no word about heat.
    assert!(Scene::parse("heat = []\ninput.splat = \"donut.ply\"", "s.toml").unwrap().heat_or_default().is_empty());
}

#[test]
fn every_key_is_read() {
    let scene = Scene::parse(EVERYTHING, "s.toml").unwrap();
    assert_eq!(scene.input.up.0, [0.0, -1.0, 0.0]);
    let select = scene.objects[0].select.as_ref().unwrap();
    assert_eq!(select.not.as_ref().unwrap().any.len(), 2);
    assert_eq!(scene.size_m(), (0.3, Some(0)));
    assert_eq!(scene.heat_or_default()[0].quantity(293.15), Quantity::Flux(3000.0));
    assert_eq!(scene.heat_or_default()[0].motion[1].axis, [0.0, 0.0, 1.0]);
    assert_eq!(scene.heat_or_default()[1].quantity(293.15), Quantity::Temperature(Some(293.15)));
    assert_eq!(scene.heat_or_default()[1].frame, Frame::Scene);
    assert_eq!(scene.heat_or_default()[2].quantity(293.15), Quantity::Film { coefficient: None, temperature_k: 353.15 });
    assert_eq!(scene.heat_or_default()[1].kind, HeatKind::Temperature);
    assert_eq!(scene.fill.tau_alpha, Auto::Auto);
    assert_eq!(scene.clock(), Clock::Factor(50.0));
    assert_eq!(scene.cells(), 32);
    assert_eq!(scene.picture_size(), (640, 360));
    assert_eq!(scene.output.background.0.map(|v| (v * 255.0).round() as u8), [0x10, 0x20, 0x30]);
    assert_eq!(scene.output.films, [Film::Rgb, Film::SideBySide]);
    let cake = scene.material("cake").unwrap().resolve("cake", &scene.material_context(&scene.objects[0], 0.3)).unwrap();
    assert_eq!((cake.density, cake.melt_yield_stress), (1300.0, 20.0));
    assert!((cake.youngs_modulus - 1300.0 * 9.81 * 0.3 / 0.01).abs() < 1e-6);
    assert!((cake.reference_temperature - 278.15).abs() < 1e-9);
}

#[test]
fn what_is_written_reads_back_the_same() {
    for text in
        [EVERYTHING, "input.asset = \"ice-cream\"", "input = { splat = \"a\", up = [0.6, 0, 0.8] }\noutput.background = [0.1, 0.2, 0.3]"]
    {
        let scene = Scene::parse(text, "s.toml").unwrap();
        let written = scene.to_toml();
        let again = Scene::parse(&written, "written.toml").unwrap_or_else(|e| panic!("{e}\n{written}"));
        assert_eq!(scene, again, "{written}");
    }
}

#[test]
fn examples_of_the_repository_are_valid() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples");
    let mut seen = 0;
    for entry in std::fs::read_dir(&folder).into_iter().flatten() {
        let path = entry.unwrap().path();
        if path.extension().is_some_and(|e| e == "toml") {
            Scene::load(&path).unwrap_or_else(|e| panic!("{e}"));
            seen += 1;
        }
    }
    if seen == 0 {
        eprintln!("skipped: no example scenes in {}", folder.display());
    }
}

#[test]
fn unreadable_files_say_why() {
    let folder = tempfile::tempdir().unwrap();
    let missing = folder.path().join("no.toml");
    assert!(matches!(Scene::load(&missing), Err(SceneError::Read { reason, .. }) if reason.contains("cannot read")));
    assert!(matches!(Scene::load(folder.path()), Err(SceneError::Read { reason, .. }) if reason.contains("folder")));
    let binary = folder.path().join("splat.ply");
    std::fs::write(&binary, [0xff, 0xfe, 0x00]).unwrap();
    assert!(matches!(Scene::load(&binary), Err(SceneError::Read { reason, .. }) if reason.contains("megas inspect")));
    let large = folder.path().join("large.toml");
    std::fs::File::create(&large).unwrap().set_len(1 << 40).unwrap();
    assert!(matches!(Scene::load(&large), Err(SceneError::Read { reason, .. }) if reason.contains("too many")));
}

#[test]
fn remarks_judge_the_melt() {
    let stiff = "input.splat = \"a.ply\"\nobject = [{ material = \"m\", size_m = 0.01 }]\nmaterials.m.melt_yield_stress_pa = 500";
    let remarks = Scene::parse(stiff, "s.toml").unwrap().remarks();
    assert!(remarks.iter().any(|(s, m)| *s == Severity::Warning && m.contains("will not slump")), "{remarks:?}");
}

#[test]
fn presets_resolve_and_pass_their_checks() {
    let scene = Scene::parse("input.asset = \"ice-cream\"", "s.toml").unwrap();
    for preset in material_presets() {
        let spec = scene.material(preset.name).unwrap();
        let m = spec.resolve(preset.name, &scene.material_context(&Default::default(), 0.2)).unwrap();
        let report = m.check(&scene.step_limits(0.2, 0.2 / 48.0));
        assert!(report.messages.iter().all(|(s, _)| *s < Severity::Warning), "{:?}", report.messages);
        assert!(m.melt_shear_modulus <= m.shear_modulus && m.solidus <= m.liquidus && m.reference_temperature < m.solidus);
    }
}

/// Every object of the schema is closed, every key is described, every number has a range or is a coordinate.
#[test]
fn the_schema_documents_every_key() {
    let schema = json_schema();
    assert_eq!(schema["required"], serde_json::json!(["input"]));
    assert!(schema["properties"]["simulation"].is_object() && schema["$schema"].as_str().unwrap().contains("2020-12"));
    let definitions = schema["$defs"].as_object().unwrap();
    let mut keys = 0;
    for (name, definition) in definitions.iter().map(|(n, d)| (n.as_str(), d)).chain([("Scene", &schema)]) {
        let Some(properties) = definition["properties"].as_object() else { continue };
        assert_eq!(definition["additionalProperties"], false, "{name} accepts unknown keys");
        for (key, property) in properties {
            keys += 1;
            let text = property["description"].as_str().unwrap_or("");
            assert!(text.len() > 5, "{name}.{key} has no description");
            if matches!(property["type"].as_str(), Some("number" | "integer")) && property.get("enum").is_none() {
                assert!(property["minimum"].is_number() && property["maximum"].is_number(), "{name}.{key} has no range");
            }
        }
    }
    assert!(keys > 100, "{keys}");
    assert!(!schema.to_string().contains("null"), "TOML has no null");
    let unit = &definitions["MaterialSpec"]["properties"]["density_kg_m3"];
    assert_eq!((unit["minimum"].as_f64(), unit["type"].as_str()), (Some(1.0), Some("number")));
}
