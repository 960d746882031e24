//! The skin of a film, frame after frame: posed surface, sealed cracks, and its state on disk, so that a film that was stopped
//! goes on with the same bits.

use std::path::{Path, PathBuf};

use megas_model::{Camera, FLAG_ESCAPED, PointFrame};
use megas_raster::Gaussians;
use megas_scene::{CrackKernel, KernelRadius, Scene, SurfaceNormals, SurfaceRule};
use megas_skin::densify::{
    Anatomy, Deformed, Densifier, DensifyReport, DensifySettings, DensifyState, Fade, Kernel, Normals, Radius, Rule,
};
use megas_skin::{DEPTH_IN_PIXELS, InternalKernels, Push, Skin, SkinSettings, SkinState};
use serde_json::json;

use crate::Failure;
use crate::body::Bodies;
use crate::disk::frame_path;
use crate::table::Table;

/// Frames between two states on disk. The two newest are kept.
const KEEP_EVERY: u64 = 8;

/// Skin and densification of a scene.
pub(crate) struct Dresser {
    skin: Skin,
    densifier: Option<Densifier>,
    realign: bool,
    surface: usize,
    dt: f32,
    /// The next frame to take in.
    next: u64,
    /// Places of the internal particles in the last frame.
    inside: Vec<[f32; 3]>,
    gone: Vec<bool>,
    /// Gaussians that the needle clamp changed in the last frame.
    pub clamped: usize,
    /// Figures of the last frame.
    pub report: DensifyReport,
    /// Over the frames so far: most kernels, toggles, and the worst share of opposing normals.
    pub most_kernels: usize,
    pub toggles: f64,
    pub worst_normals: f32,
}

/// Settings of the densification that a scene asks for.
fn densify_settings(scene: &Scene) -> DensifySettings {
    let s = &scene.skin;
    let mut d = if scene.is_literal() { DensifySettings::paper_literal() } else { DensifySettings::default() };
    d.cameras = s.virtual_cameras as usize;
    if let Some(r) = s.kernel_radius {
        (d.radius, d.kappa) = match r {
            KernelRadius::Mean3 => (Radius::Mean3, 0.55),
            KernelRadius::Nearest => (Radius::Nearest, 0.5),
        };
    }
    if let Some(r) = s.surface_rule {
        d.rule = match r {
            SurfaceRule::Weight => Rule::Weight,
            SurfaceRule::Argmax => Rule::Argmax,
        };
    }
    if let Some(k) = s.kernel {
        d.kernel = match k {
            CrackKernel::Disc => Kernel::Disc,
            CrackKernel::Ball => Kernel::Ball,
        };
    }
    if let Some(n) = s.normals {
        d.normals = match n {
            SurfaceNormals::Axis => Normals::Axis,
            SurfaceNormals::Transport => Normals::Transport,
            SurfaceNormals::TransportPca => Normals::TransportPca,
        };
    }
    d.snap = s.snap as f32;
    d.extend = s.extend_gaps.unwrap_or(d.extend);
    d.hysteresis = s.fades.unwrap_or(d.hysteresis);
    d.cover = s.grow.unwrap_or(d.cover);
    d.realign = s.realign.unwrap_or(d.realign);
    d
}

impl Dresser {
    pub fn new(scene: &Scene, bodies: &Bodies) -> Self {
        let m = &bodies.meta;
        let unit = m.similarity.metres_per_unit;
        let size: [f64; 3] = std::array::from_fn(|a| m.box_max[a] - m.box_min[a]);
        let tau_scale = (0.01 * megas_math::vec3::norm(size)).min(0.5 * m.dx_m) / unit;
        let clamp = scene.skin.needle_clamp.unwrap_or(!scene.is_literal());
        let settings = SkinSettings {
            push: match scene.skin.push {
                megas_scene::Push::Elastic => Push::Elastic,
                megas_scene::Push::Total => Push::Total,
                megas_scene::Push::Rotation => Push::Rotation,
            },
            squeeze: scene.skin.squeeze.unwrap_or(!scene.is_literal()),
            depth: depth(scene, bodies),
            dull: scene.skin.dull.unwrap_or(!scene.is_literal()),
            needle_aspect: if clamp { scene.skin.max_stretch } else { f64::INFINITY },
            needle_size: if clamp { 2.0 * tau_scale } else { f64::INFINITY },
        };
        // Particles stand half a cell apart.
        let delta = 0.5 * m.dx_m / unit;
        let surface = bodies.surface.len();
        let densify = scene.skin.densify && !bodies.internal_rgb.is_empty();
        // Without the densification the whole inside is drawn: 0.55 of the particles' distance makes them nearly opaque together.
        let radius = if scene.skin.show_inside && !densify { (0.55 * delta) as f32 } else { 0.0 };
        let position = position_of(bodies, surface);
        let internal = InternalKernels { colour: bodies.internal_rgb.clone(), position, radius };
        let settings_of_cracks = densify_settings(scene);
        let at_rest: Vec<[f32; 3]> = position_of(bodies, surface);
        let densifier = densify.then(|| {
            let anatomy = Anatomy {
                surface_object: bodies.points.object[..surface].to_vec(),
                inside_object: bodies.points.object[surface..].to_vec(),
                inside_rgb: bodies.internal_rgb.clone(),
                spacing: delta as f32,
            };
            let mut d = Densifier::new(anatomy, settings_of_cracks);
            if !scene.is_literal() {
                let rest = Gaussians::from_splats(&bodies.surface);
                d.see_at_rest(&Deformed { surface: &rest, phase: &[], inside: &at_rest, temperature: &[], gone: &[] }, &[]);
            }
            d
        });
        Self {
            skin: Skin::new(bodies.surface.clone(), internal, m.similarity, settings),
            densifier,
            realign: settings_of_cracks.realign,
            surface,
            dt: (1.0 / scene.time.fps) as f32,
            next: 0,
            inside: Vec::new(),
            gone: Vec::new(),
            clamped: 0,
            report: DensifyReport::default(),
            most_kernels: 0,
            toggles: 0.0,
            worst_normals: 0.0,
        }
    }

    /// The frame that must come next.
    pub fn next(&self) -> u64 {
        self.next
    }

    /// Whether a frame leaves something to the next that only drawing it finds out.
    pub fn remembers(&self) -> bool {
        self.densifier.is_some()
    }

    /// Takes in the next frame. `out` receives what is drawn of the bodies if `wanted` or if later frames need it.
    pub fn frame(&mut self, points: &PointFrame, viewers: &[Camera], wanted: bool, out: &mut Gaussians) {
        self.skin.advance(points, self.dt);
        self.next += 1;
        if !(wanted || self.remembers()) {
            return;
        }
        self.clamped = self.skin.pose(points, out);
        let Some(densifier) = &mut self.densifier else { return };
        let n = self.surface;
        self.inside.clear();
        self.inside.extend(points.position[n..].iter().map(|x| self.skin.place(*x)));
        self.gone.clear();
        self.gone.extend(points.flags[n..].iter().map(|f| f & FLAG_ESCAPED != 0));
        densifier.cover(out, &points.phase[..n]);
        let deformed = Deformed {
            surface: out,
            phase: &points.phase[..n],
            inside: &self.inside,
            temperature: &points.temperature[n..],
            gone: &self.gone,
        };
        self.report = densifier.advance(&deformed, viewers, self.dt);
        self.most_kernels = self.most_kernels.max(self.report.shown);
        self.toggles += f64::from(self.report.toggles);
        self.worst_normals = self.worst_normals.max(self.report.opposing_normals);
        let mut own = Gaussians::new(out.sh_degree);
        densifier.append(&deformed, &mut own);
        if self.realign {
            let densifier = &*densifier;
            // Neighbours take turns: half the work, and nobody sees it.
            let turn = self.next as usize;
            let normal_at = |i: usize| {
                if (i + turn).is_multiple_of(2) { densifier.surface_normal_of_field(i, out) } else { [0.0; 3] }
            };
            self.skin.realign(points, out, 2.0 * self.dt, &normal_at);
        }
        out.extend_from(&own);
    }

    /// Melt fractions of the Gaussians that [`Dresser::frame`] wrote last, in their order.
    pub fn liquid(&self, points: &PointFrame, gaussians: usize) -> Vec<f32> {
        match &self.densifier {
            // Kernels stand in the order in which they are drawn, which is not that of the points.
            Some(d) => {
                let kernels = d.drawn().map(|j| points.liquid[self.surface + j as usize]);
                points.liquid[..self.surface].iter().copied().chain(kernels).collect()
            }
            None => points.liquid[..gaussians.min(points.liquid.len())].to_vec(),
        }
    }

    /// Writes the state after the last frame every eighth frame and forgets older ones.
    pub fn keep(&self, folder: &Path) -> Result<(), Failure> {
        let Some(d) = self.densifier.as_ref().filter(|_| self.next.is_multiple_of(KEEP_EVERY)) else { return Ok(()) };
        let (s, skin) = (d.state(), self.skin.state());
        let fades: Vec<[f32; 2]> = s.fade.iter().map(|f| [f.amount, f.unseen_s]).collect();
        let counts: Vec<[u16; 2]> = s.fade.iter().map(|f| [f.seen, f.wanted]).collect();
        let mut t = Table::new(
            json!({"frames": s.frames, "turns": s.scores.len(), "totals": [self.most_kernels as f64, self.toggles, f64::from(self.worst_normals)]}),
        );
        t.push("rig", &s.rig);
        t.push("spacing", &s.sample_spacing);
        t.push("radius", &s.radius);
        t.push("seen_radius", &s.seen_radius);
        for (k, scores) in s.scores.iter().enumerate() {
            t.push(&format!("scores{k}"), scores);
        }
        t.push("fade", &fades);
        t.push("count", &counts);
        t.push("colour", &s.colour);
        t.push("normal", &s.normal);
        t.push("up", &s.up);
        t.push("cover", &s.cover);
        t.push("rim", &s.rim);
        t.push("kernel_cover", &s.kernel_cover);
        t.push("kernel_rim", &s.kernel_rim);
        t.push("sigma0", &skin.sigma0);
        t.push("turned", &skin.turned);
        t.push("gloss", &skin.gloss);
        t.write(&state_path(folder, self.next))?;
        if let Some(old) = self.next.checked_sub(2 * KEEP_EVERY) {
            let _ = std::fs::remove_file(state_path(folder, old));
        }
        Ok(())
    }

    /// Goes on from the newest state on disk that lies before frame `first`, or from the beginning.
    pub fn resume(&mut self, folder: &Path, first: u64) {
        let newest = first / KEEP_EVERY * KEEP_EVERY;
        for frames in [Some(newest), newest.checked_sub(KEEP_EVERY)].into_iter().flatten().filter(|f| *f > 0) {
            if self.load(&state_path(folder, frames), frames).is_some() {
                return;
            }
        }
    }

    fn load(&mut self, path: &Path, frames: u64) -> Option<()> {
        let densifier = self.densifier.as_mut()?;
        let mut t = Table::read(path).ok()?;
        let turns = t.meta["turns"].as_u64()?;
        let totals: Vec<f64> = t.meta["totals"].as_array()?.iter().filter_map(serde_json::Value::as_f64).collect();
        let fades: Vec<[f32; 2]> = t.take("fade").ok()?;
        let counts: Vec<[u16; 2]> = t.take("count").ok()?;
        let fade = |(f, c): (&[f32; 2], &[u16; 2])| Fade { amount: f[0], unseen_s: f[1], seen: c[0], wanted: c[1] };
        let state = DensifyState {
            frames: t.meta["frames"].as_u64().filter(|f| *f == frames)?,
            rig: t.take("rig").ok()?.try_into().ok()?,
            sample_spacing: t.take("spacing").ok()?,
            radius: t.take("radius").ok()?,
            seen_radius: t.take("seen_radius").ok()?,
            scores: (0..turns).map(|k| t.take(&format!("scores{k}")).ok()).collect::<Option<_>>()?,
            fade: fades.iter().zip(&counts).map(fade).collect(),
            colour: t.take("colour").ok()?,
            normal: t.take("normal").ok()?,
            up: t.take("up").ok()?,
            cover: t.take("cover").ok()?,
            rim: t.take("rim").ok()?,
            kernel_cover: t.take("kernel_cover").ok()?,
            kernel_rim: t.take("kernel_rim").ok()?,
        };
        let skin = SkinState { sigma0: t.take("sigma0").ok()?, turned: t.take("turned").ok()?, gloss: t.take("gloss").ok()? };
        let [most, toggles, worst] = totals[..] else { return None };
        if !self.skin.restore(&skin) || !densifier.restore(state) {
            return None;
        }
        (self.most_kernels, self.toggles, self.worst_normals) = (most as usize, toggles, worst as f32);
        self.next = frames;
        Some(())
    }
}

/// Depth of the splats below the surface that they draw, scene units.
pub(crate) fn depth(scene: &Scene, bodies: &Bodies) -> f64 {
    if let Some(metres) = scene.skin.depth_m {
        return metres / bodies.meta.similarity.metres_per_unit;
    }
    let mut pixels = bodies.surface.trained_pixel.clone();
    pixels.sort_unstable_by(f32::total_cmp);
    // Zero where most of them do not know.
    let median = pixels.get(pixels.len() / 2).map_or(0.0, |p| f64::from(*p));
    if scene.is_literal() { 0.0 } else { DEPTH_IN_PIXELS * median }
}

/// Places of the internal particles at rest \[scene units\].
fn position_of(bodies: &Bodies, surface: usize) -> Vec<[f32; 3]> {
    bodies.points.position[surface..].iter().map(|x| bodies.meta.similarity.to_scene(*x).map(|v| v as f32)).collect()
}

fn state_path(folder: &Path, frames: u64) -> PathBuf {
    frame_path(folder, "skin", frames as usize, "bin")
}

/// Removes the states of a film that is done.
pub(crate) fn forget(folder: &Path, total: u64) {
    for frames in (0..=total).step_by(KEEP_EVERY as usize) {
        let _ = std::fs::remove_file(state_path(folder, frames));
    }
}
