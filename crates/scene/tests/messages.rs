//! What people read when a scene is wrong: place, key, value, what is allowed, the nearest name.

use megas_scene::{Diagnostic, Scene, SceneError};
use proptest::prelude::*;

fn problems(text: &str) -> Vec<Diagnostic> {
    match Scene::parse(text, "s.toml") {
        Err(SceneError::Invalid(problems)) => problems,
        Err(e) => panic!("{e}"),
        Ok(_) => panic!("this scene should be refused:\n{text}"),
    }
}

/// The scene has exactly one problem, with this message.
fn only(text: &str, expected: &str) {
    let text = format!("input.splat = \"a.ply\"\n{text}");
    let found: Vec<String> = problems(&text).iter().map(ToString::to_string).collect();
    assert_eq!(found, [expected]);
}

#[test]
fn unknown_keys_suggest_the_nearest() {
    only("titel = \"x\"", "s.toml:2:1: unknown key \"titel\"; did you mean \"title\"?");
    only("[[heat]]\nkind = \"power\"\npower_w = 1\npowr_w = 5", "s.toml:5:1: unknown key \"powr_w\" in heat; did you mean \"power_w\"?");
    only("[materials.choc]\ndensity = 5", "s.toml:3:1: unknown key \"density\" in materials.choc; did you mean \"density_kg_m3\"?");
    only(
        "[[object]]\nselect = { not = { sfere = 1 } }",
        "s.toml:3:20: unknown key \"sfere\" in object.select.not; did you mean \"sphere\"?",
    );
    only("[time]\nzzz = 1", "s.toml:3:1: unknown key \"zzz\" in time; allowed: acceleration, duration_s, fps, melt_in_s, time_lapse");
}

#[test]
fn wrong_types_and_ranges_say_what_is_allowed() {
    only("[time]\nfps = \"24\"", "s.toml:3:1: time.fps = \"24\": expected a number, 1 to 240");
    only("[materials.m]\ndensity_kg_m3 = -1300", "s.toml:3:1: materials.m.density_kg_m3 = -1300: out of range; allowed: 1 to 30000");
    only("[materials.m]\nmelt_flow_index = nan", "s.toml:3:1: materials.m.melt_flow_index = nan: expected a number, 0.2 to 2");
    only("[simulation]\ncells = 32.5", "s.toml:3:1: simulation.cells = 32.5: expected a whole number, 8 to 256");
    only("[output]\npng = 1", "s.toml:3:1: output.png = 1: expected true or false");
    only("seed = 'x'", "s.toml:2:1: seed = 'x': expected a whole number, 0 to 9.007199254740991e15");
    only("[fill]\ndirections = 8", "s.toml:3:1: fill.directions = 8: allowed: 6, 14");
    only("[[object]]\ncontact_resistance_m2k_w = 11", "s.toml:3:1: object.contact_resistance_m2k_w = 11: out of range; allowed: 0 to 10");
    only("[simulation]\nbounds = \"open\"", "s.toml:3:1: simulation.bounds = \"open\": allowed: \"clamp\", \"delete\"");
    only("[fill]\ntau_alpha = 1.5", "s.toml:3:1: fill.tau_alpha = 1.5: out of range; allowed: 0 to 1, or \"auto\"");
    only(
        "[air]\nfilm_coefficient_w_m2k = \"aut\"",
        "s.toml:3:1: air.film_coefficient_w_m2k = \"aut\": expected \"auto\" or a number; did you mean \"auto\"?",
    );
    only("output.background = \"red\"", "s.toml:2:8: output.background = \"red\": expected \"#rrggbb\" or 3 numbers");
    only(
        "quality = \"previw\"",
        "s.toml:2:1: quality = \"previw\": allowed: \"preview\", \"default\", \"final\"; did you mean \"preview\"?",
    );
    only(
        "[[camera]]\nkeyframes = [{ time_s = 0, eye = [0, 1], target = [0, 0, 0] }]",
        "s.toml:3:28: camera.keyframes.eye = [0, 1]: expected 3 values, found 2",
    );
    only("[[camera]]\nkeyframes = [{ time_s = 0, eye = [0, 0, 1] }]", "s.toml:3:14: camera.keyframes: \"target\" is missing");
}

#[test]
fn tables_that_repeat_and_regions_that_choose() {
    only("[heat]\nkind = \"power\"", "s.toml:2:2: write [[heat]] with two brackets instead of [heat]: there may be several");
    let both = "[[heat]]\nregion = { object = \"all\", surface = \"all\" }";
    let names = "sphere, box, cylinder, capsule, half_space, mesh, object, surface";
    only(both, &format!("s.toml:3:1: heat.region: write exactly one of: {names}"));
    only("[[heat]]\nregion = \"all\"", &format!("s.toml:3:1: heat.region = \"all\": expected a table with one of: {names}"));
}

#[test]
fn references_are_followed() {
    only(
        "[[object]]\nmaterial = \"chocolate\"\n[materials.chocolat]\npreset = \"butter\"",
        "s.toml:3:1: object.material = \"chocolate\" is no preset and no [materials] table; did you mean \"chocolat\"?",
    );
    only(
        "[materials.m]\npreset = \"icecream\"",
        "s.toml:3:1: materials.m.preset: \"icecream\" is not a material preset; did you mean \"ice-cream\"?",
    );
    only(
        "[[object]]\nname = \"cake\"\n[[heat]]\nregion.object = \"cak\"",
        "s.toml:5:1: heat.region: there is no object \"cak\"; did you mean \"cake\"?",
    );
    only("[[object]]\n[[object]]", "s.toml:3:1: object.name = \"object\" is taken by an earlier object; names must differ");
    let sizes = "[[object]]\nsize_m = 1\n[[object]]\nname = \"b\"\nsize_m = 2";
    only(sizes, "s.toml:6:1: object.size_m: \"object\" already gives the real size; one is enough, all are scaled by it");
}

#[test]
fn contradictions_are_found() {
    only("[[heat]]\nkind = \"power\"", "s.toml:3:1: heat: kind = \"power\" needs power_w (or schedule.keyframes)");
    only(
        "[[heat]]\nkind = \"power\"\npower_w = 5\nflux_w_m2 = 1",
        "s.toml:5:1: heat.flux_w_m2 means nothing for kind = \"power\"; remove it or change the kind",
    );
    only("[time]\nmelt_in_s = 3\nacceleration = 2", "s.toml:3:1: time: melt_in_s and acceleration both set the thermal clock; give one");
    only(
        "[materials.m]\nsolidus_c = 50\nliquidus_c = 40",
        "s.toml:3:1: materials.m.solidus_c: is 50 °C, above liquidus_c = 40 °C; melting begins at the solidus",
    );
    only("[output]\nwidth = 641", "s.toml:3:1: output.width = 641: films need an even number of pixels; use 640 or 642");
    only(
        "simulation.box_m = [0.1, 0.1, 0.1]",
        "s.toml:2:12: simulation.box_m = [0.1, 0.1, 0.1]: the object's longest side of 0.2 m does not fit; \
         leave box_m out or make it larger",
    );
    only("[[camera]]\nname = \"a/b\"", "s.toml:3:1: camera.name = \"a/b\" becomes part of file names; use letters, digits, - and _");
    only("[[collider]]\nshape.box = { min = [0, 0, 0], max = [1, 0, 1] }", "s.toml:3:15: box: min 0 is not below max 0 along y");
    only(
        "[[collider]]\nthin = true\nshape.sphere = { center = [0, 0, 0], radius = 1 }",
        "s.toml:3:1: collider.thin: only a mesh (one open layer of triangles) or a box can be thin; leave out thin or use one of them",
    );
    only(
        "[[collider]]\nthin = true\ntemperature_c = 90\nshape.mesh = { file = \"leaf.obj\" }",
        "s.toml:4:1: collider.temperature_c: heat passes a thin collider as if it were not there; leave out temperature_c or thin",
    );
    let leaves = "[[collider]]\nthin = true\nshape.mesh = { file = \"leaf.obj\" }\n".repeat(17);
    only(&leaves, "s.toml:51:1: collider.thin: at most 16 colliders can be thin; join meshes");
    only("[[heat]]\nschedule = { start_s = 2, end_s = 1 }", "s.toml:3:27: heat.schedule.end_s = 1 must be after start_s = 2");
}

#[test]
fn photographs_and_fine_tuning_say_what_they_need() {
    let one = |text: &str| {
        let found: Vec<String> = problems(text).iter().map(ToString::to_string).collect();
        assert_eq!(found.len(), 1, "{found:?}");
        found[0].clone()
    };
    let two = one("[input]\ncapture = \"photos\"\nsplat = \"a.ply\"");
    assert_eq!(two, "s.toml:2:1: input: give one of splat (a file), capture (photographs) and asset (embedded)");
    assert_eq!(one("[input]\ncapture = \"\""), "s.toml:2:1: input.capture is empty");
    let alone = one("[input]\nsplat = \"a.ply\"\nreconstruct = { profile = \"full\" }");
    assert_eq!(alone, "s.toml:3:1: input.reconstruct says how to train on photographs; it needs capture = \"folder\"");
    let tuned = one("[input]\ncapture = \"photos\"\nfinetune = true");
    assert_eq!(tuned, "s.toml:3:1: input.finetune is for a splat file (splat = \"file.ply\"); other inputs need none");
    only("[input.finetune]\nstep = 5", "s.toml:3:1: unknown key \"step\" in input.finetune; did you mean \"steps\"?");
    only("[input.finetune]\nsize = 8", "s.toml:3:1: input.finetune.size = 8: out of range; allowed: 32 to 4096");
    only("input.finetune = \"yes\"", "s.toml:2:7: input.finetune = \"yes\": expected true or false or a table");
    let profile = one("[input]\ncapture = \"p\"\n[input.reconstruct]\nprofile = \"objekt\"");
    assert!(profile.starts_with("s.toml:4:1: input.reconstruct.profile = \"objekt\": allowed: "), "{profile}");
    assert!(profile.ends_with("did you mean \"object\"?"), "{profile}");
    let boxed = one("[input]\ncapture = \"p\"\n[input.reconstruct]\nobject_box = { min = [0, 0, 0], max = [1, 0, 1] }");
    assert_eq!(boxed, "s.toml:4:16: box: min 0 is not below max 0 along y");
}

#[test]
fn a_scene_needs_one_input() {
    assert_eq!(problems("title = 'x'")[0].to_string(), "s.toml:1:1: the scene: \"input\" is missing");
    let neither = &problems("[input]\nup = '+y'")[0];
    let expected = "s.toml:1:2: input: give splat = \"file.ply\", capture = \"photographs\", asset = \"ice-cream\" or [[input.body]]";
    assert_eq!(neither.to_string(), expected);
    let both = &problems("[input]\nsplat = 'a'\nasset = 'b'")[0];
    assert_eq!((both.line, both.key.as_str()), (3, "input.asset"));
}

#[test]
fn procedural_bodies_are_checked() {
    let one = |text: &str| problems(text)[0].to_string();
    assert!(one("[input]\nsplat = 'a'\n[[input.body]]\n").contains("either splat or [[input.body]]"));
    assert!(one("[[input.body]]\nform = 'mesh'").contains("needs mesh"));
    assert!(one("[[input.body]]\nmotion = [{ time_s = 1 }]").contains("is for scenery"));
    assert!(one("[[input.body]]\ntemperature_c = 20").contains("object.initial_temperature_c"));
    assert!(one("[[input.body]]\nsize_m = [0.1, 0.1, 0]").contains("every side"));
    assert!(one("[[input.body]]\nform = 'torus'\nsize_m = [0.1, 0.1, 0.06]").contains("thinner than"));
    let parts = "[[input.body]]\nname = 'cake'\n[[object]]\nname = 'o'\nparts = ['cak']";
    assert!(one(parts).contains("no input body \"cak\"; did you mean \"cake\"?"), "{}", one(parts));
}

#[test]
fn syntax_errors_have_a_place() {
    let p = &problems("input.splat = \"a\"\n[time\nfps = 3")[0];
    assert_eq!(p.line, 2, "{p}");
    assert!(p.message.starts_with("not valid TOML") && !p.message.contains('\n'), "{p}");
    let twice = &problems("seed = 1\nseed = 2")[0];
    assert_eq!(twice.line, 2, "{twice}");
}

#[test]
fn all_problems_come_at_once_in_order() {
    let text = "titel = 1\n[input]\nsplat = \"a\"\nup = \"z\"\n[time]\nfps = 0\n[[heat]]\nkind = \"hot\"";
    let lines: Vec<usize> = problems(text).iter().map(|p| p.line).collect();
    assert_eq!(lines, [1, 4, 6, 8]);
    let meaning =
        "input.splat = \"a\"\nobject = [{ material = \"x\" }]\n[time]\nmelt_in_s = 1\nacceleration = 2\n[[heat]]\nkind = \"flux\"";
    let lines: Vec<usize> = problems(meaning).iter().map(|p| p.line).collect();
    assert_eq!(lines, [2, 4, 7]);
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, ..ProptestConfig::default() })]

    /// No text makes the reader panic, and every refusal has a message on one line.
    #[test]
    fn any_text_is_answered(lines in prop::collection::vec(prop::sample::select(vec![
        "[input]", "splat = \"a\"", "[[object]]", "[object]", "select = { box = 3 }", "select = []", "[[heat]]", "region = { sphere = {} }",
        "schedule.keyframes = [[1]]",
        "[materials.a]", "[materials]", "preset = 1", "a = { preset = \"x\" }", "[time]", "fps = inf",
        "fps = 1979-05-27",
        "up = [0,0,0]", "[[camera]]", "keyframes = [1, {}]",
        "orbit = {}", "é = \"ü\"", "\"", "[fill]", "tau_alpha = -1", "[heat.region]", "= 3",
    ]), 0..12)) {
        let text = lines.join("\n");
        if let Err(SceneError::Invalid(problems)) = Scene::parse(&text, "s.toml") {
            prop_assert!(!problems.is_empty());
            for p in problems {
                prop_assert!(!p.message.contains('\n') && p.line >= 1 && p.line <= lines.len().max(1) + 1, "{}", p);
            }
        }
    }
}
