//! One call from splats to a body: selection, baking, normals, filling, volumes, background, points.

use std::time::Instant;

use megas_math::{Vec3, mat3, vec3};
use megas_model::{FLAG_INTERNAL, FLAG_SPLAT, Points, Similarity, Splats};
use rayon::prelude::*;

use crate::background;
use crate::bake::{BakeReport, SplitReport, bake, split_needles};
use crate::fill::{FillMethod, FillReport, Filling, Shell, Skin, attach, fill};
use crate::neighbours::Neighbours;
use crate::orient::{OrientReport, orient_from, visibility, wall_normals};
use crate::select::{RobustBox, SelectReport, robust_bounds, select};
use crate::settings::{BodyError, BodySettings, Placement, check};
use crate::volumes::{VolumeReport, particles};

/// Gaussians that some pixel sees with this blend weight are skin to which the body must reach.
const SKIN_WEIGHT: f32 = 0.1;
/// How far below its skin the body may begin, in longest sides.
const DEEPEST_POCKET: f64 = 0.08;

/// The filled inside of a body.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Internal {
    /// Positions in scene coordinates.
    pub position: Vec<Vec3<f32>>,
    /// Base colours: inverse-distance mean over the 8 nearest surface Gaussians.
    pub rgb: Vec<[f32; 3]>,
    /// Volumes \[m³\].
    pub volume_m3: Vec<f32>,
}

/// What happened on the way.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct BodyReport {
    /// Selection counts and planes.
    pub selection: SelectReport,
    /// Baking counts.
    pub bake: BakeReport,
    /// Gaussians no view saw.
    pub unseen: usize,
    /// Splitting counts.
    pub split: SplitReport,
    /// Signs of the normals.
    pub orient: OrientReport,
    /// Interior test; lengths in scene units.
    pub fill: FillReport,
    /// Surface Gaussians that no volume carries, see [`Body::loose`].
    pub loose: usize,
    /// Volumes in cubic scene units.
    pub volumes: VolumeReport,
    /// Volume of the body \[m³\].
    pub volume_m3: f64,
    /// Diagonal L of the object's robust box in scene units.
    pub diagonal: f64,
    /// Simulator cell in scene units.
    pub dx_scene: f64,
    /// Simulator cell \[m\].
    pub dx_m: f64,
    /// Surface Gaussians, internal particles, background Gaussians without the patch, patch discs.
    pub counts: [usize; 4],
    /// What a person should look at, in words.
    pub warnings: Vec<String>,
    /// Seconds per stage.
    pub seconds: Vec<(&'static str, f64)>,
}

/// A body and what surrounds it.
#[derive(Clone, Debug)]
pub struct Body {
    /// Surface Gaussians of the object: baked, oriented, in scene coordinates.
    pub surface: Splats,
    /// The inside.
    pub internal: Internal,
    /// Static Gaussians, with the patch at the end (origin 2).
    pub background: Splats,
    /// Scene ↔ metres.
    pub similarity: Similarity,
    /// Material points in SI: surface first, then internal, identities ascending from `first_id`.
    pub points: Points,
    /// Surface Gaussians (indices, ascending) that lie more than a simulator cell away from all volume: specks in the air, hair,
    /// wires. They are tracers, and nothing in the simulator moves them.
    pub loose: Vec<u32>,
    /// The classified grid in the frame `R_a (X − O)`, scene units.
    pub filling: Filling,
    /// What happened.
    pub report: BodyReport,
}

/// Builds a body. Deterministic for a given input and seed, for any number of threads.
pub fn build_body(splats: &Splats, settings: &BodySettings) -> Result<Body, BodyError> {
    if splats.is_empty() {
        return Err(BodyError::Empty);
    }
    check(settings)?;
    let mut report = BodyReport::default();
    let mut clock = Clock(Instant::now());

    let (mask, selection) = select(splats, &settings.selection);
    report.selection = selection;
    if report.selection.selected == 0 {
        let tools = report.selection.tools.iter().map(|t| format!("{}: {}", t.tool, t.selected)).collect::<Vec<_>>().join(", ");
        return Err(BodyError::NothingSelected { total: splats.len(), tools });
    }
    let indices = |flag: bool| (0..splats.len()).filter(|&i| mask[i] == flag).collect::<Vec<_>>();
    let mut surface = splats.select(&indices(true));
    let mut background = splats.select(&indices(false));
    background.object_id.fill(0);
    surface.object_id.fill(settings.object);
    clock.lap("select", &mut report);

    let frame = frame(&surface, &settings.placement)?;
    let (similarity, l) = (frame.similarity, frame.bounds.diagonal());
    (report.diagonal, report.dx_scene, report.dx_m) = (l, frame.dx, frame.dx * similarity.metres_per_unit);
    report.bake = bake(&mut surface, l);
    let tau_scale = (0.01 * l).min(0.5 * frame.dx);
    let seen = see(&mut surface, settings, tau_scale, &mut report)?;
    clock.lap("bake and views", &mut report);
    report.orient = OrientReport { resolution: seen.1, ..orient_from(&mut surface, &seen.0, &settings.orient) };
    clock.lap("orient", &mut report);

    let normals = wall_normals(&surface, &seen.0, settings.orient.neighbours);
    let shell = Shell::<f32>::new(&surface, &normals, similarity.rotation, similarity.origin);
    let to_scene = |y: Vec3<f64>| vec3::add(mat3::tmul_vec(similarity.rotation, y), similarity.origin);
    let (min, max) = fill_box(&surface, &frame);
    let mut filling = fill(&shell, min, max, frame.dx, &settings.fill, |y| seen.0.hidden(vec3::cast(to_scene(y))));
    let hollow = BodyError::Hollow {
        spacing_m: filling.grid.spacing * similarity.metres_per_unit,
        one_short: filling.report.one_short,
        inconsistent: 100.0 * report.orient.inconsistent,
    };
    if filling.report.interior == 0 {
        return Err(hollow);
    }
    let local = |m: Vec3<f32>| mat3::mul_vec(similarity.rotation, vec3::sub(vec3::cast(m), similarity.origin));
    let centres: Vec<Vec3<f64>> = surface.mean.iter().map(|&m| local(m)).collect();
    let skin: Vec<Skin> = (0..surface.len())
        .filter(|&i| seen.0.w_max[i] >= SKIN_WEIGHT && normals[i] != [0.0; 3])
        .map(|i| {
            let mut scale = surface.scale(i);
            scale.sort_by(f32::total_cmp);
            let normal = mat3::mul_vec(similarity.rotation, vec3::cast(normals[i]));
            Skin { position: centres[i], normal, radius: f64::from(scale[1]) }
        })
        .collect();
    if settings.fill.method == FillMethod::Rays {
        attach(&mut filling, &skin, DEEPEST_POCKET * frame.bounds.longest());
    }
    report.fill = filling.report.clone();
    clock.lap("fill", &mut report);

    let placed = particles(&filling, &centres, &settings.volumes, settings.seed);
    if 2 * placed.loose.len() > surface.len() {
        return Err(hollow);
    }
    report.volumes = placed.report;
    report.loose = placed.loose.len();
    report.volume_m3 = placed.report.classified * similarity.metres_per_unit.powi(3);
    clock.lap("volumes", &mut report);

    if let Some(t) = settings.temperature_k {
        surface.temperature.fill(t);
    }
    let (internal, temperature) = inside(&surface, &placed, &similarity);
    let points = points(&surface, &centres, &placed, &temperature, &similarity, settings);
    clock.lap("points", &mut report);

    report.counts = [surface.len(), internal.position.len(), background.len(), 0];
    if settings.patch && !background.is_empty() {
        let up = mat3::tmul_vec(similarity.rotation, [0.0, 0.0, 1.0]);
        if let Some(mut patch) = background::patch(&surface, &background, up, tau_scale, settings.seed) {
            let next = splats.birth_id.iter().chain(&surface.birth_id).max().map_or(0, |m| m.wrapping_add(1));
            patch.splats.birth_id.iter_mut().enumerate().for_each(|(k, id)| *id = next.wrapping_add(k as u32));
            report.counts[3] = patch.splats.len();
            background.append(&patch.splats);
        }
        clock.lap("patch", &mut report);
    }
    report.warnings = warnings(&report);
    Ok(Body { surface, internal, background, similarity, points, loose: placed.loose, filling, report })
}

struct Clock(Instant);

impl Clock {
    fn lap(&mut self, stage: &'static str, report: &mut BodyReport) {
        let now = Instant::now();
        report.seconds.push((stage, (now - self.0).as_secs_f64()));
        self.0 = now;
    }
}

/// The filling frame: scene units, simulator axes, origin O.
struct Frame {
    similarity: Similarity,
    /// Robust box along the rotated axes, before O is subtracted.
    bounds: RobustBox,
    /// Simulator cell in scene units.
    dx: f64,
}

fn frame(surface: &Splats, placement: &Placement) -> Result<Frame, BodyError> {
    let rotation = match placement {
        Placement::Size { up, .. } => Similarity::rotation_from_up(*up),
        Placement::Given { similarity, .. } => similarity.rotation,
    };
    let no_extent = BodyError::NoExtent { count: surface.len() };
    let bounds = robust_bounds(surface, &vec![true; surface.len()], rotation).ok_or(no_extent.clone())?;
    if !(bounds.longest() > 0.0 && bounds.longest().is_finite()) {
        return Err(no_extent);
    }
    Ok(match *placement {
        Placement::Size { size_m, cells, .. } => {
            let similarity =
                Similarity { metres_per_unit: size_m / bounds.longest(), rotation, origin: mat3::tmul_vec(rotation, bounds.center()) };
            Frame { similarity, bounds, dx: bounds.longest() / f64::from(cells) }
        }
        Placement::Given { similarity, dx_m } => Frame { similarity, bounds, dx: dx_m / similarity.metres_per_unit },
    })
}

/// Splits, looks from all sides and prunes what nobody saw.
fn see(
    surface: &mut Splats,
    settings: &BodySettings,
    tau_scale: f64,
    report: &mut BodyReport,
) -> Result<(crate::orient::Visibility, usize), BodyError> {
    let selected = report.selection.selected;
    let nothing =
        |bake: BakeReport, unseen| BodyError::NothingVisible { selected, transparent: bake.transparent, invalid: bake.invalid, unseen };
    if surface.is_empty() {
        return Err(nothing(report.bake, 0));
    }
    if let Some(s) = settings.split {
        report.split = split_needles(surface, s.a, s.tau_scale.unwrap_or(tau_scale as f32), s.max_count);
    }
    let (mut seen, resolution) = visibility(surface, &settings.orient);
    if let Some(least) = settings.prune_below {
        let keep: Vec<usize> = (0..surface.len()).filter(|&i| seen.w_max[i] >= least).collect();
        report.unseen = surface.len() - keep.len();
        if keep.is_empty() {
            return Err(nothing(report.bake, report.unseen));
        }
        if report.unseen > 0 {
            *surface = surface.select(&keep);
            seen.retain(&keep);
        }
    }
    Ok((seen, resolution))
}

/// The box to classify, in the filling frame: all means, but not farther out than a quarter of the robust box.
fn fill_box(surface: &Splats, frame: &Frame) -> (Vec3<f64>, Vec3<f64>) {
    let s = &frame.similarity;
    let shift = mat3::mul_vec(s.rotation, s.origin);
    let (mut lo, mut hi) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
    for &m in &surface.mean {
        let x = vec3::sub(mat3::mul_vec(s.rotation, vec3::cast(m)), shift);
        (lo, hi) = (vec3::min(lo, x), vec3::max(hi, x));
    }
    let room = 0.25 * frame.bounds.longest();
    let (min, max) = (vec3::sub(frame.bounds.min, shift), vec3::sub(frame.bounds.max, shift));
    (std::array::from_fn(|k| lo[k].max(min[k] - room)), std::array::from_fn(|k| hi[k].min(max[k] + room)))
}

/// Scene positions, colours and volumes of the internal particles, and their temperatures.
fn inside(surface: &Splats, placed: &crate::volumes::Particles, similarity: &Similarity) -> (Internal, Vec<f32>) {
    let s3 = similarity.metres_per_unit.powi(3);
    let position: Vec<Vec3<f32>> =
        placed.internal.iter().map(|&x| vec3::cast(vec3::add(mat3::tmul_vec(similarity.rotation, x), similarity.origin))).collect();
    let tree = Neighbours::new(&surface.mean);
    let near: Vec<([f32; 3], f32)> = position
        .par_iter()
        .map(|x| {
            let found = tree.as_ref().map(|t| t.nearest(x, 8)).unwrap_or_default();
            let floor = found.first().map_or(1.0, |n| 1e-6 * n.1.max(1e-20));
            let (mut rgb, mut kelvin, mut weight) = ([0.0; 3], 0.0, 0.0);
            for &(i, d2) in &found {
                let w = surface.opacity(i as usize) / (d2 + floor);
                rgb = vec3::add_scaled(rgb, surface.seen_rgb(i as usize), w);
                kelvin += surface.temperature[i as usize];
                weight += w;
            }
            (rgb.map(|c| c / weight), kelvin / found.len().max(1) as f32)
        })
        .collect();
    let volume_m3 = placed.volume[surface.len()..].iter().map(|v| (v * s3) as f32).collect();
    let rgb = near.iter().map(|n| n.0).collect();
    (Internal { position, rgb, volume_m3 }, near.into_iter().map(|n| n.1).collect())
}

/// Material points in SI.
fn points(
    surface: &Splats,
    centres: &[Vec3<f64>],
    placed: &crate::volumes::Particles,
    temperature: &[f32],
    similarity: &Similarity,
    settings: &BodySettings,
) -> Points {
    let (n, m) = (surface.len(), placed.internal.len());
    let s = similarity.metres_per_unit;
    let normal = |i: usize| vec3::cast(similarity.direction_to_si(vec3::cast(surface.normal(i))));
    Points {
        position: centres.iter().chain(&placed.internal).map(|&x| vec3::scale(x, s)).collect(),
        volume: placed.volume.iter().map(|v| (v * s.powi(3)) as f32).collect(),
        temperature: surface.temperature.iter().chain(temperature).copied().collect(),
        normal: (0..n).map(normal).chain(std::iter::repeat_n([0.0; 3], m)).collect(),
        material: vec![settings.material; n + m],
        object: vec![settings.object; n + m],
        flags: std::iter::repeat_n(FLAG_SPLAT, n).chain(std::iter::repeat_n(FLAG_INTERNAL, m)).collect(),
        id: (0..(n + m) as u32).map(|k| settings.first_id.wrapping_add(k)).collect(),
    }
}

fn warnings(r: &BodyReport) -> Vec<String> {
    let mut out = Vec::new();
    let percent = |a: usize, b: usize| 100.0 * a as f64 / b.max(1) as f64;
    if r.orient.inconsistent_flat > 0.05 {
        out.push(format!(
            "{:.1} % of flat neighbouring Gaussians have opposing normals (5 % is normal): the surface may be double or noisy",
            100.0 * r.orient.inconsistent_flat
        ));
    }
    if r.fill.one_short * 4 > r.fill.interior {
        out.push(format!(
            "{} grid points are one vote short of being inside ({:.0} % of the interior): the shell leaks; \
             try 14 directions or a lower tau_alpha",
            r.fill.one_short,
            percent(r.fill.one_short, r.fill.interior)
        ));
    }
    if r.fill.cleanup.enclosed * 10 > r.fill.interior {
        out.push(format!(
            "{:.0} % of the interior was filled only because it is enclosed: the object may be hollow in truth, or its walls translucent",
            percent(r.fill.cleanup.enclosed, r.fill.interior)
        ));
    }
    if r.fill.points_across < 3.0 {
        out.push(format!("the object is only {} grid points thick: raise the number of cells", r.fill.points_across));
    }
    if r.fill.cap_height.is_some() {
        out.push(format!("{:.0} % of the interior saw no bottom: a virtual cap closes it", 100.0 * r.fill.open_bottom));
    }
    if r.fill.cleanup.points_dropped * 20 > r.fill.interior {
        out.push(format!(
            "{} grid points in {} loose parts were dropped",
            r.fill.cleanup.points_dropped, r.fill.cleanup.components_dropped
        ));
    }
    if r.loose * 100 > r.counts[0] {
        out.push(format!(
            "{} of {} surface Gaussians lie apart from the body and will not move with it: deselect them, or leave them to the background",
            r.loose, r.counts[0]
        ));
    }
    if r.volumes.tracer_mode {
        out.push("surface Gaussians outnumber the inside by more than 4:1 and carry no mass".into());
    }
    if r.split.left_over > 0 {
        out.push(format!("{} Gaussians are still too long or too large: raise the budget of the split", r.split.left_over));
    }
    out
}
