//! `--dry-run`: what would be done, in what memory, in about what time.

use megas_scene::Severity;
use serde_json::{Value, json};

use crate::body::scene_objects;
use crate::convert::resolve_material;
use crate::reconstruct::{plan_finetune, plan_reconstruct};
use crate::source::{Training, training};
use crate::{Failure, LoadedScene, Options};

/// Point updates per second and core on a desktop processor, for the estimate of time.
const UPDATES_PER_CORE_S: f64 = 7.0e6;
/// Bytes per point: state, its backup, sorting, a frame being written.
const BYTES_PER_POINT: f64 = 1200.0;
/// Share of its bounding cube that an object fills, for the estimate of points (a ball has 0.52, a torus 0.2).
const FILLED: f64 = 0.25;
/// Core-seconds per picture and megapixel, both films.
const CORE_S_PER_MEGAPIXEL: f64 = 0.6;

/// Refuses materials that cannot work; returns substeps per frame and what is worth knowing.
pub fn check_materials(loaded: &LoadedScene) -> Result<(u64, Vec<String>), Failure> {
    let scene = &loaded.scene;
    let (size, _) = scene.size_m();
    let limits = scene.step_limits(size, size / f64::from(scene.cells()));
    let mut substeps: u64 = 1;
    let mut remarks = Vec::new();
    for o in &scene_objects(scene) {
        let report = resolve_material(scene, o, size)?.check(&limits);
        substeps = substeps.max(report.substeps_per_frame);
        for (severity, text) in report.messages {
            if severity == Severity::Error {
                return Err(Failure::Input(text));
            }
            if !remarks.contains(&text) {
                remarks.push(text);
            }
        }
    }
    Ok((substeps, remarks))
}

/// Describes a run without doing it. Checks everything that can be checked from the scene and its input file.
pub fn plan(loaded: &LoadedScene, options: &Options) -> Result<Value, Failure> {
    let scene = &loaded.scene;
    let objects = scene_objects(scene);
    let (size, _) = scene.size_m();
    let dx = size / f64::from(scene.cells());
    let mut splats = None;
    if let Some(file) = &scene.input.splat {
        let path = loaded.base_dir.join(file);
        splats = Some(megas_formats::load_splats(&path).map_err(|e| Failure::Input(e.to_string()))?.report.count);
    }
    let (substeps, remarks) = check_materials(loaded)?;
    let mut stages = vec!["fill", "simulate", "render"];
    let mut trained = None;
    match training(loaded, options) {
        Some(Training::Reconstruct(job)) => {
            let plan = plan_reconstruct(&job)?;
            splats = plan["gaussians_estimate"].as_f64().map(|n| n as usize);
            trained = Some(plan);
            stages.insert(0, "reconstruct");
        }
        Some(Training::Finetune(job)) => {
            trained = Some(plan_finetune(&job)?);
            stages.insert(0, "finetune");
        }
        None => {}
    }
    let cells = f64::from(scene.cells()).powi(3) * FILLED;
    let points = cells * 8.0 + splats.unwrap_or(40_000) as f64;
    let frames = scene.time.frames();
    let threads = options.threads.unwrap_or_else(rayon::current_num_threads) as f64;
    let (w, h) = scene.picture_size();
    let megapixels = f64::from(w) * f64::from(h) * 1e-6 * scene.cameras_or_default().len() as f64;
    let simulate = points * substeps as f64 * (frames - 1) as f64 / UPDATES_PER_CORE_S / threads;
    let render = frames as f64 * megapixels * CORE_S_PER_MEGAPIXEL / threads;
    Ok(json!({
        "stages": stages,
        "training": trained,
        "out": options.out.display().to_string(),
        "input_splats": splats,
        "objects": objects.iter().map(|o| json!({"name": o.name, "material": o.material})).collect::<Vec<_>>(),
        "cells": scene.cells(),
        "cell_m": dx,
        "points_estimate": points.round(),
        "frames": frames,
        "substeps_per_frame": substeps,
        "picture": [w, h],
        "threads": threads,
        "memory_mib_estimate": (points * BYTES_PER_POINT / f64::from(1 << 20) + 64.0).round(),
        "disk_mib_estimate": (points * 90.0 * frames as f64 / f64::from(1 << 20)).round(),
        "simulate_s_estimate": simulate.round(),
        "render_s_estimate": render.round(),
        "remarks": remarks,
    }))
}
