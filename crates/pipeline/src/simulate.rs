//! Stage two: the simulation, frame by frame, with checkpoints.

use std::path::Path;
use std::time::Instant;

use megas_model::{FLAG_SPLAT, PointFrame};
use megas_scene::{Bounds, Severity};
use megas_sim::solver::{Checkpoint, FrameReport, SimError, Solver, Totals, repaired};
use serde_json::{Value, json};

use crate::body::Bodies;
use crate::convert::{Prepared, prepare};
use crate::disk::frame_path;
use crate::room::confined;
use crate::stage::{Found, StageDir};
use crate::table::Table;
use crate::{Event, Failure, LoadedScene, Sink};

/// Frames between two checkpoints.
const CHECKPOINT_EVERY: u64 = 4;

/// Largest relative error of the energy audit that passes without a warning (simulation.md §3.7).
const AUDIT_LIMIT: f64 = 1e-5;

/// What sinks by more cells than this while the bodies settle has fallen or flowed, and the film should show it.
const FALL_CELLS: f64 = 1.5;

/// Number of simulated frames of a scene; frame 0 is the state at rest.
pub fn frames(loaded: &LoadedScene) -> u64 {
    loaded.scene.time.frames()
}

/// Runs or continues the simulation and returns its figures.
pub fn simulate(loaded: &LoadedScene, bodies: &Bodies, stage: &StageDir, found: Found, sink: &dyn Sink) -> Result<Value, Failure> {
    let Prepared { config, acceleration, melt_time, remarks } = prepare(loaded, bodies)?;
    for (severity, text) in &remarks {
        sink.event(if *severity == Severity::Note { Event::Note(text) } else { Event::Warning(text) });
    }
    if melt_time.is_finite() {
        sink.event(Event::Note(&format!(
            "in nature this would melt in about {}; heat runs {acceleration:.0} times faster",
            span(melt_time)
        )));
    }
    let total = frames(loaded);
    let fail = |e: SimError| failure(e, bodies);
    let (grid, cell) = (config.grid, config.grid.spacing);
    let mut solver = Solver::new(config.clone(), &bodies.points).map_err(fail)?;
    stage.begin()?;
    let resumed = if matches!(found, Found::Partial) { resume(&mut solver, &stage.path) } else { None };
    // The slot of the ring to write next: never the one that holds the newest checkpoint.
    let mut slot = resumed.map_or(0, |used| 1 - used);
    sink.event(Event::Stage { name: "simulate", steps: total - 1 });
    let objects = crate::body::scene_objects(&loaded.scene);
    if resumed.is_some() {
        sink.event(Event::Note(&format!("continuing at frame {} of {total}", solver.frames_done())));
    } else {
        let velocity = |o: &megas_scene::Object| o.initial_velocity_m_s;
        if objects.iter().all(|o| velocity(o).is_none())
            && let Some((object, sunk)) = solver.settle(loaded.scene.simulation.settle_s).map_err(fail)?
            && sunk > FALL_CELLS * cell
        {
            // Who drops a thing wants to see it fall: the film starts with the bodies where the scene puts them.
            solver = Solver::new(config, &bodies.points).map_err(fail)?;
            let name = bodies.meta.objects.iter().find(|o| o.number == object).map_or("an object", |o| &o.name);
            sink.event(Event::Note(&format!(
                "'{name}' would sink {:.0} mm before the film while the bodies settle, so they start unsettled (simulation.settle_s)",
                sunk * 1e3
            )));
        }
        for (k, o) in objects.iter().enumerate() {
            if let Some(v) = velocity(o) {
                solver.set_object_velocity(k as u16 + 1, v.map(|c| c as f32));
            }
        }
        write_frame(&stage.path, 0, &solver.export(), None)?;
    }
    for (k, o) in objects.iter().enumerate() {
        if let Some(resistance) = o.contact_resistance_m2k_w {
            solver.set_contact_resistance(k as u16 + 1, resistance);
        }
    }
    sink.event(Event::Step { done: solver.frames_done() });
    let start = Instant::now();
    let mut told = false;
    while solver.frames_done() + 1 < total {
        let Some(report) = solver.advance_frame(&|| sink.cancelled()).map_err(fail)? else {
            save_checkpoint(&solver, &stage.path, &mut slot)?;
            return Err(Failure::Interrupted(format!(
                "stopped at frame {} of {total}; run the same command again to continue",
                solver.frames_done()
            )));
        };
        warn_about(&report, bodies.points.len(), sink);
        let frame = solver.export();
        if !told
            && loaded.scene.simulation.bounds == Bounds::Clamp
            && let Some(text) = confined(&frame, &grid)
        {
            told = true;
            sink.event(Event::Warning(&text));
        }
        write_frame(&stage.path, report.frame, &frame, Some(&report))?;
        if report.frame % CHECKPOINT_EVERY == 0 || report.frame + 1 == total {
            save_checkpoint(&solver, &stage.path, &mut slot)?;
        }
        sink.event(Event::Step { done: solver.frames_done() });
    }
    let seconds = start.elapsed().as_secs_f64();
    let totals = solver.totals().clone();
    if totals.energy_residual() > AUDIT_LIMIT {
        sink.event(Event::Warning(&format!("the energy audit does not close: relative residual {:.1e}", totals.energy_residual())));
    }
    let lost = totals.escaped;
    if lost.points > 0 {
        sink.event(Event::Note(&format!(
            "{} of {} points left the simulated space, with {:.3e} kg and {:.3e} J",
            lost.points,
            bodies.points.len(),
            lost.mass,
            lost.heat
        )));
    }
    let figures = figures(&totals, total, bodies, acceleration);
    stage.finish(&figures)?;
    for name in CHECKPOINTS {
        let _ = std::fs::remove_file(stage.path.join(name));
    }
    sink.event(Event::StageDone { name: "simulate", seconds });
    Ok(figures)
}

/// An error of the solver; what became unstable is told with the name of its object, which the solver does not know.
fn failure(e: SimError, bodies: &Bodies) -> Failure {
    if let SimError::Unstable { culprit, .. } = &e
        && let Some(object) = bodies.meta.objects.iter().find(|o| o.number == culprit.object)
    {
        return Failure::Input(format!("{e} (object {} is '{}')", culprit.object, object.name));
    }
    Failure::Input(e.to_string())
}

fn figures(totals: &Totals, frames: u64, bodies: &Bodies, acceleration: f64) -> Value {
    json!({
        "frames": frames,
        "particles": bodies.points.len(),
        "substeps": totals.substeps,
        "energy_residual": totals.energy_residual(),
        "energy_audit": totals.audit,
        "volume_change": totals.volume_change,
        "repairs": repaired(&totals.repairs),
        "repairs_by_kind": totals.repairs,
        "rollbacks": totals.rollbacks,
        "temperatures_put_right": totals.temperatures,
        "points_out_of_density_range": totals.strayed,
        "escaped": totals.escaped,
        "energy_removed_j": totals.capped_energy,
        "max_speed_m_s": totals.max_speed,
        "thermal_acceleration": acceleration,
    })
}

fn warn_about(report: &FrameReport, points: usize, sink: &dyn Sink) {
    if report.rollbacks > 0 {
        sink.event(Event::Warning(&format!(
            "frame {}: {} coupling steps were repeated with smaller time steps",
            report.frame, report.rollbacks
        )));
    }
    let repairs = repaired(&report.repairs);
    if repairs > 0 {
        let r = &report.repairs;
        let kinds = [
            (r.projected, "pushed out of obstacles"),
            (r.degenerate, "freed of an impossible shape"),
            (r.capped, "slowed to half a cell per step"),
            (r.out_of_box, "held at the edge of the box"),
            (r.non_finite, "freed of a velocity that was no number"),
        ];
        let told: Vec<String> = kinds.iter().filter(|(n, _)| *n > 0).map(|(n, what)| format!("{n} {what}")).collect();
        sink.event(Event::Warning(&format!("frame {}: points repaired: {}", report.frame, told.join(", "))));
    }
    if report.repairs.degenerate * 1000 > points as u64 {
        sink.event(Event::Warning(&format!(
            "frame {}: {} deformation gradients were repaired, more than 0.1 % of the points: a material is too soft or the time step \
             too long (sag_ratio, courant)",
            report.frame, report.repairs.degenerate
        )));
    }
    if report.temperatures > 0 {
        sink.event(Event::Warning(&format!(
            "frame {}: {} temperatures were beyond everything that touches the bodies and were put right ({:.1e} J)",
            report.frame, report.temperatures, report.temperature_heat
        )));
    }
    if report.volume_change.abs() > 0.03 {
        sink.event(Event::Warning(&format!(
            "frame {}: the volume changed by {:.1} %: the material is too soft for its weight or the cells are too coarse",
            report.frame,
            100.0 * report.volume_change
        )));
    }
}

/// "3 h 20 min", "45 s".
fn span(seconds: f64) -> String {
    match seconds {
        s if s < 120.0 => format!("{s:.0} s"),
        s if s < 7200.0 => format!("{:.0} min", s / 60.0),
        s if s < 172_800.0 => format!("{:.1} h", s / 3600.0),
        s => format!("{:.1} days", s / 86_400.0),
    }
}

/// Writes a frame. Tensors are kept for the points that carry splats only (they come first), and rebase matrices only where
/// one is not the identity: together half of the bytes.
fn write_frame(folder: &Path, index: u64, f: &PointFrame, report: Option<&FrameReport>) -> Result<(), Failure> {
    const IDENTITY: [f32; 9] = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
    let splats = f.flags.iter().take_while(|&&g| g & FLAG_SPLAT != 0).count();
    let rebased = f.rebase[..splats].iter().any(|b| *b != IDENTITY);
    let mut t = Table::new(json!({"frame": index, "time": f.time, "points": f.id.len(), "splats": splats, "report": report}));
    t.push("id", &f.id);
    t.push("position", &f.position);
    t.push("elastic", &f.elastic[..splats]);
    t.push("total", &f.total[..splats]);
    t.push("rebase", if rebased { &f.rebase[..splats] } else { &[] });
    t.push("normal", &f.normal[..splats]);
    t.push("temperature", &f.temperature);
    t.push("liquid", &f.liquid);
    t.push("phase", &f.phase);
    t.push("flags", &f.flags);
    t.write(&frame_path(folder, "frame", index as usize, "bin"))
}

/// Reads one frame of the simulation; tensors and normals of the points with splats only, rebase matrices empty if nothing
/// was rebased.
pub fn read_frame(folder: &Path, index: u64) -> Result<PointFrame, Failure> {
    let path = frame_path(folder, "frame", index as usize, "bin");
    let mut t = Table::read(&path)?;
    let bad = |e: String| Failure::Input(format!("{}: {e}; use --force to compute it again", path.display()));
    let n = t.meta["points"].as_u64().unwrap_or(0) as usize;
    let splats = t.meta["splats"].as_u64().unwrap_or(0) as usize;
    Ok(PointFrame {
        time: t.meta["time"].as_f64().unwrap_or(0.0),
        id: t.take_rows("id", n).map_err(bad)?,
        position: t.take_rows("position", n).map_err(bad)?,
        elastic: t.take_rows("elastic", splats).map_err(bad)?,
        total: t.take_rows("total", splats).map_err(bad)?,
        rebase: t.take("rebase").map_err(bad)?,
        normal: t.take_rows("normal", splats).map_err(bad)?,
        temperature: t.take_rows("temperature", n).map_err(bad)?,
        liquid: t.take_rows("liquid", n).map_err(bad)?,
        phase: t.take_rows("phase", n).map_err(bad)?,
        flags: t.take_rows("flags", n).map_err(bad)?,
    })
}

/// The ring: the older of the two is overwritten, so one is always whole.
const CHECKPOINTS: [&str; 2] = ["checkpoint_a.bin", "checkpoint_b.bin"];

fn save_checkpoint(solver: &Solver, folder: &Path, slot: &mut usize) -> Result<(), Failure> {
    let checkpoint = solver.checkpoint();
    let meta = serde_json::to_value(&checkpoint).map_err(|e| Failure::Other(e.to_string()))?;
    let mut t = Table::new(meta);
    for (k, (_, bytes)) in solver.particles().arrays().into_iter().enumerate() {
        t.push(&k.to_string(), bytes);
    }
    let air = solver.air_state();
    if !air.is_empty() {
        t.push(&solver.particles().arrays().len().to_string(), &air);
    }
    t.write(&folder.join(CHECKPOINTS[*slot]))?;
    *slot = 1 - *slot;
    Ok(())
}

/// Continues from the newest checkpoint that is whole and fits and tells its slot; `None` starts over.
fn resume(solver: &mut Solver, folder: &Path) -> Option<usize> {
    let mut candidates: Vec<(Checkpoint, Table, usize)> = CHECKPOINTS
        .iter()
        .enumerate()
        .filter_map(|(slot, name)| {
            let mut t = Table::read(&folder.join(name)).ok()?;
            let meta = serde_json::from_value(t.meta.take()).ok()?;
            Some((meta, t, slot))
        })
        .collect();
    candidates.sort_by_key(|c| std::cmp::Reverse(c.0.frame));
    for (checkpoint, mut table, slot) in candidates {
        let arrays: Vec<Vec<u8>> = (0..).map_while(|k: usize| table.take(&k.to_string()).ok()).collect();
        let whole = (0..=checkpoint.frame).all(|k| frame_path(folder, "frame", k as usize, "bin").exists());
        if whole && solver.restore(checkpoint, &arrays).is_ok() {
            return Some(slot);
        }
    }
    None
}
