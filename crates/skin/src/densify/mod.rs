//! Adaptive surface-cracking densification (splatting.md §7): where the deformed skin opens, internal particles that can be seen
//! become kernels of the surface.
//!
//! A [`Densifier`] needs no simulator: it takes deformed surface Gaussians with normals and deformed internal particles, frame by
//! frame or once. All that one frame leaves to the next is in [`DensifyState`], so a film can be continued from any frame whose
//! state was kept, with the same bits.

mod cover;
mod detect;
mod fade;
mod kernels;
mod normals;
mod rim;
mod settings;

use megas_math::{Vec3, mat3, sh, vec3};
use megas_model::Camera;
use megas_raster::{Gaussians, unpack_covariance};
use rayon::prelude::*;

use crate::imls::{Imls, ImlsSettings, Samples, gap_samples};
use crate::rows::Rows;
use detect::{Detector, Rig, Seen, near_outside};
pub use fade::Fade;
use kernels::{Object, fresh};
pub(crate) use normals::is_axis_within;
pub use settings::{DensifySettings, Kernel, Normals, Radius, Rule};

/// Opacity of a kernel that is fully there.
const OPACITY: f32 = 0.99;
/// Radii \[Δ\].
const RADIUS: [f32; 2] = [0.25, 1.0];
/// Shares of the new value in the running means of radius, colour and normal (§7.6), which get one every second frame, and of spacing.
const NEW_RADIUS: f32 = 0.36;
const NEW_COLOUR: f32 = 0.19;
const NEW_NORMAL: f32 = 0.51;
const NEW_SPACING: f32 = 0.2;
/// Blend weight from which a surface Gaussian counts as visible.
const VISIBLE: f32 = 0.05;
/// A particle is drawn in detection no larger than its distance from the skin divided by this: behind a closed skin it must not
/// show over the outline.
const SKIN_IN_SIGMA: f32 = 2.0;
/// sin² of the angle (10°) between a Gaussian's axis and its normal up to which it lies in the surface.
const SIN2_LIES_WELL: f64 = 0.03;
/// Thickness of the layer that is looked at, in cells of 1.5 Δ.
const LAYER: usize = 2;

/// The bodies of one frame, scene units.
#[derive(Clone, Copy, Debug)]
pub struct Deformed<'a> {
    /// Deformed surface Gaussians with outward normals; hidden ones are ignored.
    pub surface: &'a Gaussians,
    /// Phases of the surface Gaussians (see `megas_model::Phase`); empty: all solid.
    pub phase: &'a [u8],
    /// Positions of the internal particles.
    pub inside: &'a [Vec3<f32>],
    /// Temperatures of the internal particles \[K\]; empty: ambient.
    pub temperature: &'a [f32],
    /// Internal particles that exist no more; empty: all exist.
    pub gone: &'a [bool],
}

/// What stays the same over a film.
#[derive(Clone, Debug, Default)]
pub struct Anatomy {
    /// Object of each surface Gaussian.
    pub surface_object: Vec<u16>,
    /// Object of each internal particle.
    pub inside_object: Vec<u16>,
    /// Colour of each internal particle, in [0, 1].
    pub inside_rgb: Vec<[f32; 3]>,
    /// Spacing Δ of the internal particles at rest \[scene units\].
    pub spacing: f32,
}

/// All that a frame leaves to the next one.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DensifyState {
    /// Frames seen so far.
    pub frames: u64,
    /// Centre and half size of the cameras' view.
    pub rig: [f32; 4],
    /// Spacing of the surface samples by object, in the order of the objects.
    pub sample_spacing: Vec<f32>,
    /// Radii of the particles.
    pub radius: Vec<f32>,
    /// Radii with which detection draws them.
    pub seen_radius: Vec<f32>,
    /// Scores by turn: surface Gaussians, then particles.
    pub scores: Vec<Vec<f32>>,
    /// Fades of the particles.
    pub fade: Vec<Fade>,
    /// Smoothed colours of the particles.
    pub colour: Vec<[f32; 3]>,
    /// Smoothed normals of the particles, zero before the first.
    pub normal: Vec<Vec3<f32>>,
    /// Way from the particles to the surface.
    pub up: Vec<Vec3<f32>>,
    /// What the Gaussians of the surface grow to (see [`Densifier::cover`]); empty before the first that melts.
    pub cover: Vec<[f32; 6]>,
    /// Where it ends: out over the edge, as long as that is certain.
    pub rim: Vec<[f32; 3]>,
    /// What the kernels of the particles grow to; zero where none is drawn.
    pub kernel_cover: Vec<[f32; 6]>,
    /// Their rims.
    pub kernel_rim: Vec<[f32; 3]>,
}

/// Figures of one frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct DensifyReport {
    /// Kernels drawn, fading ones included.
    pub shown: usize,
    /// Σ|Δfade| over the particles: the toggles of the frame.
    pub toggles: f32,
    /// Surface Gaussians that can be seen.
    pub visible_surface: usize,
    /// Extra samples in wide gaps.
    pub gap_samples: usize,
    /// Share of neighbouring surface normals that oppose each other.
    pub opposing_normals: f32,
}

/// The densification of a film. See the module.
#[derive(Debug)]
pub struct Densifier {
    settings: DensifySettings,
    anatomy: Anatomy,
    objects: Vec<u16>,
    state: DensifyState,
    /// Scores of the particles at rest; empty: all 0.
    rest: Vec<f32>,
    detector: Detector,
    seen: Seen,
    /// Surface normals of this frame, and whether they were found before [`Densifier::advance`].
    normals: Vec<Vec3<f32>>,
    has_normals: bool,
    /// Kernels of this frame: particle, place, covariance.
    drawn: Vec<(u32, Vec3<f32>, [f32; 6])>,
    /// Fields of this frame, in the order of the objects.
    fields: Vec<Option<Object>>,
}

impl Densifier {
    /// # Panics
    /// If the arrays of `anatomy` do not fit together.
    pub fn new(anatomy: Anatomy, settings: DensifySettings) -> Self {
        assert_eq!(anatomy.inside_object.len(), anatomy.inside_rgb.len(), "particles");
        let mut objects: Vec<u16> = anatomy.surface_object.iter().chain(&anatomy.inside_object).copied().collect();
        objects.sort_unstable();
        objects.dedup();
        Self {
            settings,
            anatomy,
            objects,
            state: DensifyState::default(),
            rest: Vec::new(),
            detector: Detector::default(),
            seen: Seen::default(),
            normals: Vec::new(),
            has_normals: false,
            drawn: Vec::new(),
            fields: Vec::new(),
        }
    }

    /// Looks at the bodies as they were reconstructed. A skin that lets some light through looked right like that, so later only what
    /// shows more of a particle than then counts. Without this call all of it counts. Call it before the first frame; it is no part of
    /// the state, so call it again before [`Densifier::restore`].
    pub fn see_at_rest(&mut self, frame: &Deformed<'_>, viewers: &[Camera]) {
        let surfaces = self.anatomy.surface_object.len();
        let kept = std::mem::take(&mut self.state);
        self.rest.clear();
        let hysteresis = std::mem::replace(&mut self.settings.hysteresis, false);
        self.advance(frame, viewers, 0.0);
        self.settings.hysteresis = hysteresis;
        self.rest = (0..frame.inside.len()).map(|j| self.score(surfaces + j)).collect();
        self.state = kept;
        self.drawn.clear();
    }

    /// What the last frame left.
    pub fn state(&self) -> &DensifyState {
        &self.state
    }

    /// Continues after the frame that left `state`. `false` where it belongs to another body; nothing is changed then.
    pub fn restore(&mut self, state: DensifyState) -> bool {
        let (n, all) = (self.anatomy.inside_rgb.len(), self.anatomy.inside_rgb.len() + self.anatomy.surface_object.len());
        let fits = state.radius.len() == n
            && state.seen_radius.len() == n
            && state.up.len() == n
            && state.fade.len() == n
            && state.colour.len() == n
            && state.normal.len() == n
            && state.kernel_cover.len() == n
            && state.kernel_rim.len() == n
            && (state.cover.is_empty() || state.cover.len() == self.anatomy.surface_object.len())
            && state.rim.len() == state.cover.len()
            && state.scores.len() == self.settings.turns.max(1)
            && state.scores.iter().all(|s| s.len() == all)
            && state.sample_spacing.len() == self.objects.len();
        if fits {
            self.state = state;
        }
        fits
    }

    /// Lets molten Gaussians of the surface grow where the flow has drawn them apart, and trims them where it has torn or cut it. Call it
    /// before [`Densifier::advance`] of the same frame. Returns how many have grown.
    pub fn cover(&mut self, surface: &mut Gaussians, phase: &[u8]) -> usize {
        if !self.settings.cover {
            return 0;
        }
        self.find_normals(surface, phase);
        self.has_normals = true;
        let (state, rim) = (&mut self.state.cover, &mut self.state.rim);
        // What has grown once goes on after it has frozen.
        let grown = |i: usize| state.get(i).is_some_and(|c| c[0] + c[3] + c[5] > 0.0);
        // Neighbours take turns, except where nothing is known yet.
        let turn = self.state.frames as usize;
        let wanted = |i: usize| if grown(i) { (i + turn).is_multiple_of(2) } else { phase.get(i).is_some_and(|p| *p != 0) };
        let wanted: Vec<bool> = (0..surface.len()).map(wanted).collect();
        let (object, delta) = (&self.anatomy.surface_object, self.anatomy.spacing);
        cover::measure(surface, &self.normals, object, |i| wanted[i], delta, state, rim, cover::SURFACE, self.settings.hysteresis);
        let grown = cover::grow(surface, &self.normals, state, cover::SURFACE.onset);
        rim::trim(surface, rim);
        grown
    }

    fn find_normals(&mut self, surface: &Gaussians, phase: &[u8]) {
        let typical = self.state.sample_spacing.iter().copied().filter(|s| *s > 0.0).fold(f32::INFINITY, f32::min);
        let spacing = if typical.is_finite() { typical } else { Rows::spacing(&surface.mean, 2048) };
        // What nobody saw in the last frames is no sample of the surface; its transported normal will do.
        let asked = |i: usize| self.state.frames == 0 || self.is_visible(i);
        self.normals = normals::normals(surface, phase, asked, spacing, self.settings.normals);
    }

    /// Takes in one frame, `dt` seconds of film after the last. `viewers` are the cameras that will look at it, if known. The first
    /// frame (and any single one) shows at once what it selects.
    ///
    /// # Panics
    /// If the frame has other numbers of Gaussians or particles than the anatomy.
    pub fn advance(&mut self, frame: &Deformed<'_>, viewers: &[Camera], dt: f32) -> DensifyReport {
        let (n, surfaces) = (self.anatomy.inside_rgb.len(), self.anatomy.surface_object.len());
        assert_eq!(frame.inside.len(), n, "particles");
        assert_eq!(frame.surface.len(), surfaces, "surface Gaussians");
        let first = self.state.frames == 0;
        if first {
            self.state.radius = vec![0.0; n];
            self.state.seen_radius = vec![0.0; n];
            self.state.fade = vec![Fade::hidden(); n];
            self.state.colour = self.anatomy.inside_rgb.clone();
            self.state.normal = vec![[0.0; 3]; n];
            self.state.up = vec![[0.0; 3]; n];
            self.state.kernel_cover = vec![[0.0; 6]; n];
            self.state.kernel_rim = vec![[0.0; 3]; n];
            self.state.scores = vec![vec![0.0; n + surfaces]; self.settings.turns.max(1)];
            self.state.sample_spacing = vec![0.0; self.objects.len()];
        }
        let delta = self.anatomy.spacing;
        let present = |i: usize| frame.surface.visible.get(i) != Some(&false);
        let skin: Vec<Vec3<f32>> = (0..surfaces).filter(|&i| present(i)).map(|i| frame.surface.mean[i]).collect();
        let inside: Vec<u32> = (0..n as u32).filter(|&j| frame.gone.get(j as usize) != Some(&true)).collect();
        let places: Vec<Vec3<f32>> = inside.iter().map(|&j| frame.inside[j as usize]).collect();
        let outer = near_outside(&[&skin, &places], &places, 1.5 * delta, LAYER);
        let layer: Vec<u32> = inside.iter().zip(&outer).filter(|(_, o)| **o).map(|(j, _)| *j).collect();

        let detection = self.radii(frame, &skin, &places, &layer, first);
        self.look(frame, &layer, &detection, viewers, first);
        let mut report = DensifyReport { visible_surface: self.visible(surfaces), ..DensifyReport::default() };
        report.toggles = self.fades(dt, first);
        self.fields(frame, &mut report);
        self.kernels(frame, first);
        report.shown = self.drawn.len();
        self.state.frames += 1;
        report
    }

    /// Whether particle `j`, about which something is known, is asked again in this frame: neighbours take turns.
    fn is_turn_of(&self, j: usize) -> bool {
        !self.settings.hysteresis || (j as u64 + self.state.frames).is_multiple_of(2)
    }

    /// Radii (§7.2) of the particles in `layer`, smoothed in time, and the smaller ones that detection draws.
    fn radii(&mut self, frame: &Deformed<'_>, skin: &[Vec3<f32>], places: &[Vec3<f32>], layer: &[u32], first: bool) -> Vec<f32> {
        let asked: Vec<u32> =
            layer.iter().copied().filter(|&j| self.state.radius[j as usize] == 0.0 || self.is_turn_of(j as usize)).collect();
        let (s, delta) = (self.settings, self.anatomy.spacing);
        let near_skin = Rows::new(skin, 0.5 * delta);
        let near_inside = Rows::new(places, 0.8 * delta);
        let literal = s.radius == Radius::Nearest;
        let fresh: Vec<[f32; 2]> = asked
            .par_iter()
            .with_min_len(64)
            .map_init(
                || (Vec::new(), Vec::new()),
                |(a, b), &j| {
                    let x = frame.inside[j as usize];
                    near_skin.nearest(x, 3, 0.7 * delta, 2.0 * delta, a);
                    near_inside.nearest(x, 4, 1.1 * delta, 2.0 * delta, b);
                    let skin = a.first().map_or(f32::INFINITY, |f| f.0.sqrt());
                    let mut d: [f32; 3] = [2.0 * delta; 3];
                    let mut all = a.iter().chain(b.iter().skip(1)).map(|f| f.0.sqrt()).collect::<Vec<f32>>();
                    all.sort_unstable_by(f32::total_cmp);
                    d.iter_mut().zip(&all).for_each(|(d, v)| *d = *v);
                    let base = if literal { d[0] } else { (d[0] + d[1] + d[2]) / 3.0 };
                    let r = (s.kappa * base).clamp(RADIUS[0] * delta, RADIUS[1] * delta);
                    let seen = if literal { r } else { r.min((skin / SKIN_IN_SIGMA).max(RADIUS[0] * delta)) };
                    [r, seen]
                },
            )
            .collect();
        for (&j, f) in asked.iter().zip(&fresh) {
            let r = &mut self.state.radius[j as usize];
            let share = if first || *r == 0.0 || !s.hysteresis { 1.0 } else { NEW_RADIUS };
            *r += share * (f[0] - *r);
            self.state.seen_radius[j as usize] = f[1];
        }
        layer.iter().map(|&j| self.state.seen_radius[j as usize]).collect()
    }

    /// Renders this turn's cameras and the viewers', and keeps the scores.
    fn look(&mut self, frame: &Deformed<'_>, layer: &[u32], radii: &[f32], viewers: &[Camera], first: bool) {
        let s = self.settings;
        let mut rig = Rig { center: [self.state.rig[0], self.state.rig[1], self.state.rig[2]], half: self.state.rig[3] };
        let particles = layer.iter().zip(radii).map(|(&j, &r)| (j, frame.inside[j as usize], r));
        self.detector.fill(frame.surface, particles);
        rig.follow(&self.detector.set.mean);
        self.state.rig = [rig.center[0], rig.center[1], rig.center[2], rig.half];
        let mut typical: Vec<f32> = radii.to_vec();
        let mid = typical.len() / 2;
        let pixel = if typical.is_empty() { self.anatomy.spacing } else { *typical.select_nth_unstable_by(mid, f32::total_cmp).1 };
        let edge = ((2.0 * rig.half / pixel.max(1e-9)).ceil().min(1e6) as u32).clamp(s.resolution[0], s.resolution[1].max(s.resolution[0]));
        let (turns, total) = (s.turns.max(1), self.anatomy.surface_object.len() + self.anatomy.inside_rgb.len());
        let now = (self.state.frames % turns as u64) as usize;
        for turn in 0..turns {
            if turn != now && !first {
                continue;
            }
            self.seen.reset(total);
            for k in (turn..s.cameras).step_by(turns) {
                self.detector.look(&rig.camera(k, s.cameras, edge), 0.0, &mut self.seen);
            }
            for v in viewers {
                self.detector.look(&v.resized((v.width / 2).max(1), (v.height / 2).max(1)), 0.01, &mut self.seen);
            }
            let least = if s.rule == Rule::Argmax { 1 } else { 2 };
            let surfaces = self.anatomy.surface_object.len();
            let score = |i: usize| {
                let won = u32::from(self.seen.won[i]) >= if i < surfaces { 1 } else { least };
                let w = if s.rule == Rule::Argmax { 0.0 } else { self.seen.w_max[i] };
                if won { w.max(if i < surfaces { 1.0 } else { VISIBLE }) } else { w }
            };
            for (i, q) in self.state.scores[turn].iter_mut().enumerate() {
                *q = score(i);
            }
        }
    }

    /// Best score over the turns.
    fn score(&self, i: usize) -> f32 {
        self.state.scores.iter().map(|s| s[i]).fold(0.0, f32::max)
    }

    fn visible(&self, surfaces: usize) -> usize {
        (0..surfaces).filter(|&i| self.score(i) >= VISIBLE).count()
    }

    fn fades(&mut self, dt: f32, first: bool) -> f32 {
        let surfaces = self.anatomy.surface_object.len();
        let mut toggles = 0.0;
        for j in 0..self.state.fade.len() {
            // A particle that is fully in the open counts, however it was at rest.
            let q = self.score(surfaces + j);
            let q = self.rest.get(j).map_or(q, |r| if q > 0.6 { q } else { q - 1.2 * r });
            let f = &mut self.state.fade[j];
            let before = f.amount;
            f.advance(q, dt, first, self.settings.hysteresis);
            toggles += (f.amount - before).abs();
        }
        if first { 0.0 } else { toggles }
    }

    /// One implicit surface per object from the Gaussians that can be seen (§7.4).
    fn fields(&mut self, frame: &Deformed<'_>, report: &mut DensifyReport) {
        let surfaces = self.anatomy.surface_object.len();
        if !std::mem::take(&mut self.has_normals) {
            self.find_normals(frame.surface, frame.phase);
        }
        let drawn: Vec<u32> = (0..self.state.fade.len() as u32).filter(|&j| self.state.fade[j as usize].is_drawn()).collect();
        let mut fields = Vec::new();
        let (mut opposing, mut samples) = (0.0, 0);
        for (k, &number) in self.objects.iter().enumerate() {
            let mine: Vec<u32> = (0..surfaces as u32)
                .filter(|&i| {
                    let i = i as usize;
                    self.anatomy.surface_object[i] == number && self.score(i) >= VISIBLE && frame.surface.visible.get(i) != Some(&false)
                })
                .collect();
            let mut set = Samples {
                position: mine.iter().map(|&i| frame.surface.mean[i as usize]).collect(),
                normal: mine.iter().map(|&i| self.normals[i as usize]).collect(),
                weight: Vec::new(),
            };
            let now = Rows::spacing(&set.position, 2048);
            let kept = &mut self.state.sample_spacing[k];
            *kept = if *kept > 0.0 && now > 0.0 && self.settings.hysteresis { *kept + NEW_SPACING * (now - *kept) } else { now };
            let spacing = *kept;
            opposing += normals::opposing(&set.position, &set.normal, spacing) * mine.len() as f32;
            samples += mine.len();
            let options = ImlsSettings { spacing: Some(spacing), robust: self.settings.robust, ..ImlsSettings::default() };
            let rows = Rows::new(&set.position, 1.5 * spacing.max(1e-9));
            let rgb = rows.item.iter().map(|&i| kernels::base_rgb(frame.surface, mine[i as usize] as usize)).collect();
            let cover = rows.item.iter().map(|&i| kernels::cover(frame.surface, mine[i as usize] as usize)).collect();
            let mut field = Imls::new(&set, &options);
            if let Some(skin) = field.as_ref().filter(|_| self.settings.extend) {
                let of_mine: Vec<u32> = drawn.iter().copied().filter(|&j| self.anatomy.inside_object[j as usize] == number).collect();
                let extra = gap_samples(skin, frame.inside, &of_mine, self.anatomy.spacing);
                if !extra.position.is_empty() {
                    report.gap_samples += extra.position.len();
                    set.extend(&extra);
                    field = Imls::new(&set, &options);
                }
            }
            fields.push(field.map(|field| Object { number, field, rows, rgb, cover, spacing }));
        }
        report.opposing_normals = opposing / samples.max(1) as f32;
        self.fields = fields;
    }

    fn object(&self, number: u16) -> Option<&Object> {
        self.fields.iter().flatten().find(|o| o.number == number)
    }

    /// Attributes of the kernels that are drawn (§7.5, §7.6).
    fn kernels(&mut self, frame: &Deformed<'_>, first: bool) {
        let (s, delta) = (self.settings, self.anatomy.spacing);
        let drawn: Vec<u32> = (0..self.state.fade.len() as u32)
            .filter(|&j| self.state.fade[j as usize].is_drawn() && frame.gone.get(j as usize) != Some(&true))
            .collect();
        // The first appearance takes what it finds; later frames move towards it.
        let new = |d: &Self, k: usize| first || d.state.normal[k] == [0.0; 3] || !s.hysteresis || !d.state.fade[k].remembers();
        let asked: Vec<usize> = drawn.iter().map(|&j| j as usize).filter(|&k| new(self, k) || self.is_turn_of(k)).collect();
        let made: Vec<kernels::Fresh> = asked
            .par_iter()
            .with_min_len(64)
            .map_init(Vec::new, |found, &j| {
                fresh(self.object(self.anatomy.inside_object[j]), frame.inside[j], self.anatomy.inside_rgb[j], delta, found)
            })
            .collect();
        for (&k, f) in asked.iter().zip(&made) {
            let new = new(self, k);
            let colour = &mut self.state.colour[k];
            *colour = if new { f.rgb } else { vec3::lerp(*colour, f.rgb, NEW_COLOUR) };
            if f.normal != [0.0; 3] {
                let n = &mut self.state.normal[k];
                *n = if new || vec3::dot(*n, f.normal) < -0.9 {
                    f.normal
                } else {
                    vec3::normalize_or(vec3::lerp(*n, f.normal, NEW_NORMAL), f.normal)
                };
            }
            self.state.up[k] = f.up;
        }
        self.drawn.clear();
        for &j in &drawn {
            let k = j as usize;
            let up = self.state.up[k];
            let covariance = kernels::covariance(&s, self.state.radius[k], self.state.normal[k], vec3::norm(up));
            self.drawn.push((j, kernels::place(&s, frame.inside[k], up, delta), covariance));
        }
        if s.cover && s.kernel == Kernel::Disc {
            self.close(frame);
        }
        // A particle that is not drawn starts afresh once it has been forgotten.
        for k in 0..self.state.fade.len() {
            let f = self.state.fade[k];
            if !f.is_drawn() && !f.remembers() {
                self.state.normal[k] = [0.0; 3];
                self.state.kernel_cover[k] = [0.0; 6];
                self.state.kernel_rim[k] = [0.0; 3];
            }
        }
    }

    /// The kernels grow until they meet what is drawn beside them, and are trimmed where the body ends. Radii follow the spacing of all
    /// particles, and of those only the few that can be seen are drawn.
    fn close(&mut self, frame: &Deformed<'_>) {
        let (mut set, mut object) = (Gaussians::new(0), Vec::new());
        let mut push = |mean, covariance, normal, o| {
            set.push(mean, covariance, normal, 1.0, &[0.0; 3], 0.0);
            object.push(o);
        };
        for (j, mean, covariance) in &self.drawn {
            push(*mean, *covariance, self.state.normal[*j as usize], self.anatomy.inside_object[*j as usize]);
        }
        for i in 0..frame.surface.len() {
            if frame.surface.visible.get(i) != Some(&false) && self.is_visible(i) {
                push(frame.surface.mean[i], frame.surface.covariance[i], self.normals[i], self.anatomy.surface_object[i]);
            }
        }
        let who = || self.drawn.iter().map(|d| d.0 as usize);
        let mut cover: Vec<[f32; 6]> = who().map(|k| self.state.kernel_cover[k]).collect();
        let mut rim: Vec<[f32; 3]> = who().map(|k| self.state.kernel_rim[k]).collect();
        let (kernels, normals) = (self.drawn.len(), set.normal.clone());
        let (growth, smooth) = (cover::KERNELS, self.settings.hysteresis);
        cover::measure(&set, &normals, &object, |k| k < kernels, self.anatomy.spacing, &mut cover, &mut rim, growth, smooth);
        for (n, k) in who().enumerate() {
            (self.state.kernel_cover[k], self.state.kernel_rim[k]) = (cover[n], rim[n]);
        }
        cover::grow(&mut set, &normals, &cover, growth.onset);
        rim::trim(&mut set, &rim);
        for (n, (_, mean, covariance)) in self.drawn.iter_mut().enumerate() {
            (*mean, *covariance) = (set.mean[n], set.covariance[n]);
        }
    }

    /// Appends the kernels of the last frame to `out`, whose degree stays.
    pub fn append(&self, frame: &Deformed<'_>, out: &mut Gaussians) {
        let mut own = Gaussians::new(0);
        for (j, mean, covariance) in &self.drawn {
            let k = *j as usize;
            let kelvin = frame.temperature.get(k).copied().unwrap_or(megas_model::AMBIENT_K);
            let colour = self.state.colour[k].map(sh::dc_from_rgb);
            own.push(*mean, *covariance, self.state.normal[k], OPACITY * self.state.fade[k].amount, &colour, kelvin);
        }
        // They lie below a surface that is drawn with the blur of its training, and should not stick out by more.
        let known = frame.surface.trained_pixel.iter().copied().filter(|p| *p > 0.0);
        if let Some(pixel) = known.reduce(f32::min) {
            own.trained_pixel = vec![pixel; own.len()];
        }
        out.extend_from(&own);
    }

    /// Particles of the kernels that [`Densifier::append`] appends, in its order.
    pub fn drawn(&self) -> impl Iterator<Item = u32> + '_ {
        self.drawn.iter().map(|d| d.0)
    }

    /// Surface normals of the last frame, corrected.
    pub fn surface_normals(&self) -> &[Vec3<f32>] {
        &self.normals
    }

    /// Whether surface Gaussian `i` could be seen in the last frame.
    pub fn is_visible(&self, i: usize) -> bool {
        self.score(i) >= VISIBLE
    }

    /// Normal of the implicit surface at Gaussian `i` of the `surface` that the last frame had. Zero where it is not part of that surface
    /// (buried, or more than a spacing away from it), and where the Gaussian lies in it well enough by its own normal, which costs little
    /// to see.
    pub fn surface_normal_of_field(&self, i: usize, surface: &Gaussians) -> Vec3<f32> {
        let Some(f) = self.field(self.anatomy.surface_object[i]).filter(|_| self.is_visible(i)) else { return [0.0; 3] };
        if is_axis_within(mat3::cast(unpack_covariance(surface.covariance[i])), self.normals[i], SIN2_LIES_WELL) {
            return [0.0; 3];
        }
        let v = f.evaluate(surface.mean[i]);
        if v.value.abs() < f.spacing() { v.normal() } else { [0.0; 3] }
    }

    /// The implicit surface of an object in the last frame.
    pub fn field(&self, object: u16) -> Option<&Imls> {
        self.object(object).map(|o| &o.field)
    }
}

#[cfg(test)]
mod tests;
