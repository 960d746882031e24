//! The conduct of the command line: exit codes, help, JSON contract, errors that leave nothing behind.

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Command, Output, Stdio};

use serde_json::Value;

fn megas(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_megas")).args(arguments).stdin(Stdio::null()).output().unwrap()
}

fn stdout(output: &Output) -> String {
    String::from_utf8(output.stdout.clone()).unwrap()
}

fn stderr(output: &Output) -> String {
    String::from_utf8(output.stderr.clone()).unwrap()
}

/// Every line of standard output as JSON.
fn json_lines(output: &Output) -> Vec<Value> {
    stdout(output).lines().map(|l| serde_json::from_str(l).unwrap_or_else(|e| panic!("{e}: {l}"))).collect()
}

fn write(folder: &Path, name: &str, text: &str) -> String {
    let path = folder.join(name);
    std::fs::write(&path, text).unwrap();
    path.display().to_string()
}

#[test]
fn help_answers_with_examples() {
    for arguments in [
        &["--help"][..],
        &["help", "run"],
        &["run", "--help"],
        &["demo", "--help"],
        &["inspect", "--help"],
        &["render", "--help"],
        &["reconstruct", "--help"],
        &["finetune", "--help"],
        &["eval", "reconstruct", "--help"],
        &["validate", "--help"],
    ] {
        let output = megas(arguments);
        assert_eq!(output.status.code(), Some(0), "{arguments:?}");
        assert!(stdout(&output).contains("Example"), "{arguments:?}");
    }
    assert!(stdout(&megas(&["--version"])).starts_with("megas "));
}

#[test]
fn wrong_usage_is_2_and_says_so_on_standard_error() {
    for arguments in [&[][..], &["melt"], &["run"], &["run", "a.toml", "b.toml"], &["demo", "--threads", "none"], &["demo", "-q", "-v"]] {
        let output = megas(arguments);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}");
        assert!(stdout(&output).is_empty() && !stderr(&output).is_empty(), "{arguments:?}");
    }
    assert!(stderr(&megas(&["simulte", "a.toml"])).contains("'simulate'"), "a typing error gets a suggestion");
}

#[test]
fn wrong_usage_with_json_is_one_error_line() {
    let output = megas(&["run", "--json"]);
    assert_eq!(output.status.code(), Some(2));
    let lines = json_lines(&output);
    assert_eq!((lines.len(), lines[0]["event"].as_str()), (1, Some("error")));
    assert!(lines[0]["message"].as_str().unwrap().contains("<SCENE>"), "{lines:?}");
    assert!(stderr(&output).is_empty());
}

#[test]
fn the_schema_is_json_in_both_forms() {
    let plain: Value = serde_json::from_str(&stdout(&megas(&["schema"]))).unwrap();
    assert!(plain["properties"]["input"].is_object());
    let lines = json_lines(&megas(&["schema", "--json"]));
    assert_eq!(lines.len(), 1);
    assert_eq!((lines[0]["event"].as_str(), &lines[0]["schema"]), (Some("result"), &plain));
}

#[test]
fn materials_are_listed_in_both_forms() {
    let text = stdout(&megas(&["materials"]));
    for name in ["ice-cream", "water-ice", "paraffin-wax", "milk-chocolate", "butter", "basaltic-lava", "gallium", "soft-wax", "elastic"] {
        assert!(text.lines().any(|l| l.starts_with(name)), "{name} is missing");
    }
    let lines = json_lines(&megas(&["--json", "materials"]));
    let list = lines[0]["materials"].as_array().unwrap();
    assert_eq!(list.iter().filter(|m| m["default"] == true).count(), 1);
    let ice = list.iter().find(|m| m["name"] == "water-ice").unwrap();
    assert_eq!(ice["latent_heat_j_kg"], 334e3);
    assert!(list.iter().find(|m| m["name"] == "elastic").unwrap()["solidus_c"].is_null());
}

#[test]
fn validation_writes_a_page_and_ends_with_its_figures() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("suite");
    let output = megas(&["validate", "--case", "v02", "--json", "-o", out.to_str().unwrap()]);
    assert_eq!(output.status.code(), Some(0), "{}", stdout(&output));
    let lines = json_lines(&output);
    assert!(lines.iter().any(|l| l["event"] == "case" && l["case"] == "V02" && l["rows"][0]["passed"] == true));
    let last = lines.last().unwrap();
    assert_eq!((&last["event"], &last["total"], &last["passed"]), (&"result".into(), &1.into(), &1.into()));
    assert!(last["failed"].as_array().unwrap().is_empty());
    assert!(std::fs::read_to_string(out.join("validation.html")).unwrap().ends_with("</html>\n"));
    let kept: Value = serde_json::from_str(&std::fs::read_to_string(out.join("validation.json")).unwrap()).unwrap();
    assert_eq!(kept["cases"][0]["id"], "V02");
    let unknown = megas(&["validate", "--case", "V99", "-o", out.to_str().unwrap()]);
    assert_eq!(unknown.status.code(), Some(2));
    assert!(stderr(&unknown).contains("V99") && stderr(&unknown).contains("V02"));
}

#[test]
fn a_broken_scene_is_2_with_place_and_leaves_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let cases = [
        ("[input]\nsplat = \"a.ply\"\n[heat]\n", ":3:2: write [[heat]]"),
        ("[input]\nsplat = \"a.ply\"\nupp = \"+z\"\n", ":3:1: unknown key \"upp\" in input; did you mean \"up\"?"),
        ("[input]\nsplat = \"a.ply\"\n[materials.m]\ndensity_kg_m3 = -1\n", ":4:1: materials.m.density_kg_m3 = -1: out of range"),
        ("[input\n", ":1:"),
    ];
    for (text, expected) in cases {
        let scene = write(folder.path(), "scene.toml", text);
        for command in ["run", "fill", "simulate", "render"] {
            let output = megas(&[command, &scene, "-o", out.to_str().unwrap()]);
            assert_eq!(output.status.code(), Some(2), "{text}");
            let message = stderr(&output);
            assert!(message.starts_with("error: ") && message.contains("scene.toml") && message.contains(expected), "{message}");
            assert_eq!(message.lines().count(), 1, "{message}");
            assert!(stdout(&output).is_empty() && !out.exists());
        }
    }
}

#[test]
fn failures_with_json_end_with_an_error_event() {
    let folder = tempfile::tempdir().unwrap();
    let missing = folder.path().join("missing.toml");
    let scene = write(folder.path(), "scene.toml", "[input]\nsplat = \"missing.ply\"\n");
    let ply = write(folder.path(), "broken.ply", "ply\nformat binary_little_endian 1.0\nelement vertex 5\n");
    let out = folder.path().join("out");
    let out = out.to_str().unwrap();
    for arguments in [
        &["run", missing.to_str().unwrap(), "-o", out, "--json"][..],
        &["run", &scene, "-o", out, "--json"],
        &["fill", &scene, "-o", out, "--json"],
        &["inspect", &ply, "--json"],
        &["inspect", folder.path().to_str().unwrap(), "--json"],
    ] {
        let output = megas(arguments);
        assert_eq!(output.status.code(), Some(2), "{arguments:?} {}", stdout(&output));
        let lines = json_lines(&output);
        let last = lines.last().unwrap();
        assert_eq!(last["event"], "error", "{arguments:?}");
        assert!(last["message"].as_str().is_some_and(|m| m.len() > 10), "{last}");
        assert!(lines.iter().all(|l| l["event"] != "result"));
        assert!(!Path::new(out).exists(), "{arguments:?} left {out} behind");
    }
}

#[test]
fn training_commands_refuse_what_they_cannot_use_and_leave_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let output = |name: &str| out.join(name).display().to_string();
    let here = folder.path().to_str().unwrap();
    let broken = write(folder.path(), "broken.ply", "ply\nformat binary_little_endian 1.0\nelement vertex 5\n");
    let scene = write(folder.path(), "scene.toml", "[input]\ncapture = \"nowhere\"\n");
    let (ply, table) = (output("a.ply"), output("study"));
    let cases: [(&[&str], &str); 9] = [
        (&["reconstruct", here, "-o", &ply], "not a capture"),
        (&["reconstruct", here, "-o", &ply, "--dry-run"], "not a capture"),
        (&["reconstruct", here, "-o", &output("a.obj")], "a.obj"),
        (&["reconstruct", here, "-o", &ply, "--method", "our"], "vanilla"),
        (&["reconstruct", here, "-o", &ply, "--object-box", "1,2,3"], "cx,cy,cz,hx,hy,hz"),
        (&["finetune", &broken, "-o", &ply], "broken.ply"),
        (&["eval", "reconstruct", here, "-o", &table], "not a capture"),
        (&["eval", "reconstruct", here, "-o", &table, "--methods", "best"], "pgsr-prune"),
        (&["run", &scene, "-o", &table], "not a capture"),
    ];
    for (arguments, expected) in cases {
        let json: Vec<&str> = arguments.iter().copied().chain(["--json"]).collect();
        let answer = megas(&json);
        assert_eq!(answer.status.code(), Some(2), "{arguments:?} {}", stdout(&answer));
        let lines = json_lines(&answer);
        let last = lines.last().unwrap();
        assert_eq!(last["event"], "error", "{arguments:?}");
        assert!(last["message"].as_str().unwrap().contains(expected), "{arguments:?} {last}");
        assert!(!out.exists(), "{arguments:?} left {} behind", out.display());
    }
}

#[test]
fn a_dry_run_tells_and_does_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let output = megas(&["demo", "--dry-run", "--json", "-o", out.to_str().unwrap()]);
    assert_eq!(output.status.code(), Some(0), "{}", stdout(&output));
    let lines = json_lines(&output);
    assert_eq!((lines.len(), lines[0]["event"].as_str(), lines[0]["dry_run"].as_bool()), (1, Some("result"), Some(true)));
    assert!(!out.exists());
}

#[test]
fn a_reader_that_goes_away_is_no_error() {
    let mut child = Command::new(env!("CARGO_BIN_EXE_megas")).arg("schema").stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    drop(child.stdout.take());
    let output = child.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(0));
    assert!(stderr(&output).is_empty(), "{}", stderr(&output));
}

/// Ctrl-C in the middle of a run: exit code 1, an error event that says how to go on, and a folder to go on from.
#[cfg(unix)]
#[test]
fn ctrl_c_leaves_something_to_continue() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let mut child = Command::new(env!("CARGO_BIN_EXE_megas"))
        .args(["demo", "--quick", "--json", "--output"])
        .arg(&out)
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let mut last = Value::Null;
    let mut interrupted = false;
    for line in BufReader::new(child.stdout.take().unwrap()).lines() {
        last = serde_json::from_str(&line.unwrap()).unwrap();
        if !interrupted && last["event"] == "step" {
            interrupted = Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success();
        }
    }
    assert!(interrupted, "the run never reported a step");
    assert_eq!(child.wait().unwrap().code(), Some(1));
    assert_eq!(last["event"], "error");
    assert!(last["message"].as_str().unwrap().contains("again to continue"), "{last}");
    assert!(out.is_dir());
}
