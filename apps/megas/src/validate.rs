//! `megas validate`: the physics suite as a table while it runs, as JSON lines, and as a page.

use std::fmt::Write;
use std::path::Path;
use std::time::Instant;

use megas_pipeline::{Event, Failure, Sink};
use megas_validation::{Case, Finished, Results, Row, Tier, cases, page, run as suite};
use serde_json::{Value, json};

use crate::args::{Global, ValidateArgs};
use crate::console::{Console, print_json, stop_on_ctrl_c};
use crate::summary::duration;

/// Runs the cases that are wanted, writes the page, and gives the figures and whether all of them passed.
pub fn run(a: &ValidateArgs, global: &Global) -> Result<(Value, bool), Failure> {
    let wanted = select(&a.cases, a.full)?;
    let stem = |name: &str| a.out.join(name);
    // Before hours of work, not after them.
    std::fs::create_dir_all(&a.out).map_err(|e| cannot_write(&a.out, &e.to_string()))?;
    stop_on_ctrl_c();
    let console = Console::new(global);
    let start = Instant::now();
    console.event(Event::Stage { name: "validate", steps: wanted.len() as u64 });
    console.answer(&header());
    let mut done = Vec::new();
    for case in &wanted {
        if console.cancelled() {
            write(&stem("validation.html"), &page::page(&Results::new(done.clone())), &console)?;
            return Err(Failure::Interrupted(format!("stopped after {} of {} cases", done.len(), wanted.len())));
        }
        console.doing(&format!("{} {}", case.id, case.name));
        let finished = suite::in_pool(global.threads.map(usize::from), || suite::run(case));
        if global.json {
            let mut line = finished.brief();
            line["event"] = "case".into();
            print_json(&line);
        }
        console.answer(&table(&finished));
        done.push(finished);
        console.event(Event::Step { done: done.len() as u64 });
    }
    let results = Results::new(done);
    console.event(Event::StageDone { name: "validate", seconds: start.elapsed().as_secs_f64() });
    write(&stem("validation.json"), &format!("{:#}\n", results.to_json()), &console)?;
    write(&stem("validation.html"), &page::page(&results), &console)?;
    if let Some(file) = &a.markdown {
        write(file, &page::markdown(&results), &console)?;
    }
    let mut figures = results.summary();
    figures["page"] = stem("validation.html").display().to_string().into();
    Ok((figures, results.failed().is_empty()))
}

/// The cases asked for, or those of a minute and less.
fn select(ids: &[String], full: bool) -> Result<Vec<Case>, Failure> {
    let all = cases();
    for id in ids {
        if !all.iter().any(|c| c.id.eq_ignore_ascii_case(id)) {
            let mut known: Vec<&str> = all.iter().map(|c| c.id).collect();
            known.dedup();
            return Err(Failure::Input(format!("there is no case {id:?}; there are {}", known.join(", "))));
        }
    }
    let wanted = |c: &Case| if ids.is_empty() { full || c.tier < Tier::C } else { ids.iter().any(|id| c.id.eq_ignore_ascii_case(id)) };
    Ok(all.into_iter().filter(wanted).collect())
}

/// Every case for people.
pub fn list() -> String {
    let mut text = String::new();
    for c in cases() {
        let time = match c.tier {
            Tier::A => "seconds",
            Tier::B => "a minute",
            Tier::C => "longer",
        };
        let _ = writeln!(text, "{:<10} {:<9} {}", c.id, time, c.name);
    }
    text.push_str("\nThose that take longer run with --full or when named by --case.\n");
    text
}

/// Every case for machines.
pub fn list_json() -> Value {
    let one =
        |c: &Case| json!({ "case": c.id, "name": c.name, "tier": c.tier, "proves": c.proves, "setup": c.setup, "reference": c.formula });
    json!({ "cases": cases().iter().map(one).collect::<Vec<_>>() })
}

/// Letters for the name of a quantity.
const WIDTH: usize = 62;

fn header() -> String {
    format!("{:<WIDTH$} {:>12} {:>12} {:>10} {:>10}\n", "case / quantity", "reference", "ours", "error", "tolerance")
}

/// The rows of a case for people.
fn table(case: &Finished) -> String {
    let cpu = case.core_seconds.map_or(String::new(), |s| format!(", {} of processor time", duration(s)));
    let mut text = format!("{} {}  ({}{cpu})\n", case.id, case.name, duration(case.seconds));
    let number = |v: f64| {
        if v == 0.0 {
            "0".into()
        } else if (1e-3..1e5).contains(&v.abs()) {
            format!("{v:.5}")
        } else {
            format!("{v:.4e}")
        }
    };
    for row in &case.outcome.rows {
        let Row { quantity, reference, ours, tolerance, .. } = row;
        let _ = writeln!(
            text,
            "{:<WIDTH$} {:>12} {:>12} {:>10.1e} {:>10.1e}{}",
            format!("  {quantity}"),
            number(*reference),
            number(*ours),
            row.error(),
            tolerance,
            if row.passed() { "" } else { "  FAILED" }
        );
    }
    for note in &case.outcome.notes {
        let _ = writeln!(text, "  note: {note}");
    }
    if let Some(panic) = &case.panic {
        let _ = writeln!(text, "  FAILED: {panic}");
    } else if case.outcome.rows.is_empty() {
        text.push_str("  FAILED: the case compares nothing\n");
    }
    text
}

fn write(path: &Path, text: &str, console: &Console) -> Result<(), Failure> {
    std::fs::write(path, text).map_err(|e| cannot_write(path, &e.to_string()))?;
    console.event(Event::File(path));
    Ok(())
}

fn cannot_write(path: &Path, why: &str) -> Failure {
    Failure::Other(format!("{}: cannot be written: {why}; choose another place with -o", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unknown_cases_are_named_and_known_ones_found_in_any_case() {
        let ids = |list: &[&str]| select(&list.iter().map(|s| (*s).to_string()).collect::<Vec<_>>(), false);
        assert!(ids(&["V99"]).err().unwrap().to_string().contains("V99"));
        assert!(ids(&["v12"]).unwrap().iter().all(|c| c.id == "V12"));
        assert!(ids(&[]).unwrap().iter().all(|c| c.tier < Tier::C));
    }
}
