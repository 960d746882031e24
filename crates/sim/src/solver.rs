//! The master loop: mechanics, phase, heat, checks, export (simulation.md §2.6, §9.3, §10.1).

mod export;
mod failure;
mod report;
mod walls;

use std::collections::BTreeMap;

use megas_math::mat3;
use megas_model::Points;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::collider::{Collider, Thermal};
use crate::grid::Grid;
use crate::material::Material;
use crate::mechanics::{Bounds, Mechanics, Report, Settings};
use crate::particles::{ParticleError, Particles};
use crate::phase::{PhaseOptions, PhaseRule, scale_deviator, swell};
use crate::source::{HeatSource, SourceKind};
use crate::thermal::solids::Solids;
use crate::thermal::{AirModel, Audit, ThermalError, ThermalOptions, ThermalPoints, ThermalSolver};

pub use export::Checkpoint;
use failure::{Caution, Health, MAX_FAILURES, Ring, TemperatureRange};
pub use failure::{CautiousHeat, Culprit};
pub use report::{FrameReport, Totals, repaired};
use walls::Walls;

/// Courant number of [`Mechanics::time_step`].
const DEFAULT_COURANT: f64 = 0.4;
/// Substeps per coupling step above which the run is refused (§2.5).
const MAX_SUBSTEPS: u64 = 2000;

/// Everything a simulation needs besides its points. SI units, +z up.
#[derive(Clone, Debug)]
pub struct SolverConfig {
    /// The grid of mechanics and heat.
    pub grid: Grid,
    /// Materials, thermally accelerated already where that is wanted.
    pub materials: Vec<Material>,
    /// Heat sources.
    pub sources: Vec<HeatSource>,
    /// Colliders, in the order in which they act.
    pub colliders: Vec<Collider>,
    /// Gravity \[m/s²\].
    pub gravity: [f64; 3],
    /// Temperature at which enthalpies are zero: the surroundings \[K\].
    pub ambient: f64,
    /// Heat transfer options.
    pub thermal: ThermalOptions,
    /// Phase options.
    pub phase: PhaseOptions,
    /// Simulated time between frames \[s\], > 0.
    pub frame_dt: f64,
    /// Longest coupling step \[s\], > 0.
    pub coupling_step: f64,
    /// Courant number C_e of the elastic wave, 0.05–0.7.
    pub courant: f64,
    /// False leaves pure conduction in bodies at rest.
    pub mechanics: bool,
    /// What happens to matter at the sides of the grid.
    pub bounds: Bounds,
    /// How mechanics and heat are joined.
    pub coupling: Coupling,
}

/// How the parts are joined; the defaults are the method, the rest is for comparison (simulation.md §0.4).
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Coupling {
    /// Points give their nodes their mean velocity without its gradient (PIC instead of APIC).
    pub plain_momentum: bool,
    /// Heat is exchanged after every substep instead of every coupling step.
    pub heat_every_substep: bool,
}

/// Why a simulation could not start or go on.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SimError {
    /// The points do not fit the scene.
    #[error(transparent)]
    Points(#[from] ParticleError),
    /// The thermal step failed.
    #[error(transparent)]
    Thermal(#[from] ThermalError),
    /// Nothing to simulate.
    #[error("there is nothing to simulate: {0}")]
    Empty(String),
    /// The material is too stiff for the grid.
    #[error(
        "the time step would be {dt:.1e} s: {needed} substeps per coupling step are needed and {MAX_SUBSTEPS} allowed; \
         '{material}' is too stiff or moves too fast for cells of {spacing:.2e} m: make it softer (sag_ratio, youngs_modulus_pa) \
         or use fewer cells"
    )]
    TooStiff {
        /// Stable step \[s\].
        dt: f64,
        /// Substeps needed.
        needed: u64,
        /// Stiffest material.
        material: String,
        /// Grid spacing \[m\].
        spacing: f64,
    },
    /// Repeated failure in spite of smaller steps.
    #[error("the simulation became unstable at t = {time:.4} s and going back to four times smaller time steps did not help: {culprit}")]
    Unstable {
        /// Simulated time \[s\].
        time: f64,
        /// Particle, object, material and violated limit.
        culprit: Box<Culprit>,
    },
    /// A checkpoint that does not belong to this simulation.
    #[error("the checkpoint does not fit: {0}")]
    Checkpoint(String),
}

/// A running simulation. Deterministic: the state after any frame depends on configuration and points alone, not on the
/// number of threads nor on interruptions.
pub struct Solver {
    config: SolverConfig,
    particles: Particles,
    mechanics: Mechanics,
    thermal: ThermalSolver,
    rules: Vec<PhaseRule>,
    walls: Option<Walls>,
    totals: Totals,
    frame: u64,
    caution: Caution,
    cautious_heat: CautiousHeat,
    ring: Ring,
    temperatures: TemperatureRange,
    xi: Vec<[f64; 3]>,
    current_volume: Vec<f32>,
}

impl Solver {
    /// Prepares a simulation of `points`; their temperatures become enthalpies, their materials laws.
    pub fn new(config: SolverConfig, points: &Points) -> Result<Self, SimError> {
        if points.is_empty() {
            return Err(SimError::Empty("there are no points".into()));
        }
        let volume0: f64 = points.volume.iter().map(|&v| f64::from(v)).sum();
        if volume0 <= 0.0 || !volume0.is_finite() {
            return Err(SimError::Empty(format!("the points have a volume of {volume0} m³")));
        }
        let mut particles = Particles::new(points, &config.grid, &config.materials)?;
        let mut thermal = ThermalSolver::new(config.grid, &config.materials, config.ambient, config.thermal);
        let rules: Vec<PhaseRule> = config.materials.iter().map(|m| PhaseRule::new(m, &config.phase)).collect();
        for i in 0..particles.len() {
            let m = particles.material[i];
            let h = thermal.enthalpy(m, f64::from(points.temperature[i]));
            particles.enthalpy[i] = h;
            let (t, f) = (thermal.temperature(m, h), thermal.liquid_fraction(m, h));
            let rule = &rules[usize::from(m)];
            let law = rule.initial_law(t, f);
            particles.liquid[i] = rule.liquid(f) as f32;
            particles.phase[i] = rule.initial_phase(t, f);
            particles.shear[i] = law.mu;
            particles.yield_stress[i] = law.yield_stress;
            particles.viscosity[i] = law.viscosity;
            particles.exponent[i] = law.exponent;
            let material = &config.materials[usize::from(m)];
            if material.changes_volume() {
                // Volumes are those of the start, so masses follow from the density at its temperature and phase.
                particles.mass[i] = (f64::from(particles.volume[i]) / material.specific_volume(f, t)) as f32;
            }
        }
        particles.sort();
        let settings = Settings {
            gravity: config.gravity,
            plain_momentum: config.coupling.plain_momentum,
            bounds: config.bounds,
            ..Settings::default()
        };
        let mechanics = Mechanics::new(&config.grid, settings, config.colliders.clone());
        let (solids, cells) = Solids::new(&config.grid, &config.colliders);
        thermal.set_solids(solids);
        let walls = Walls::new(&config.grid, &config.colliders, cells);
        let temperatures = temperature_range(&config, points);
        Ok(Self {
            particles,
            mechanics,
            thermal,
            rules,
            walls,
            totals: Totals::default(),
            frame: 0,
            caution: Caution::NONE,
            cautious_heat: CautiousHeat::default(),
            ring: Ring::default(),
            temperatures,
            xi: Vec::new(),
            current_volume: Vec::new(),
            config,
        })
    }

    /// What the sources (and, last, the film of the air) would bring at the start, power \[W\] and area \[m²\], judged by one
    /// very short exchange. Times and keyframes of the sources count as given; nothing changes.
    pub fn probe_power(&mut self) -> Result<Vec<(f64, f64)>, SimError> {
        const SHORT: f64 = 1e-4;
        let backup = (self.particles.enthalpy.clone(), self.particles.temperature_gradient.clone());
        let solids = self.thermal.solids().clone();
        self.thermal.air_held = true;
        let done = self.heat(0.0, SHORT);
        self.thermal.air_held = false;
        self.thermal.set_solids(solids);
        done?;
        (self.particles.enthalpy, self.particles.temperature_gradient) = backup;
        Ok(self.thermal.reports().iter().map(|r| (r.heat / SHORT, r.area)).collect())
    }

    /// Gives all points of `object` a velocity \[m/s\]; meant for the start.
    pub fn set_object_velocity(&mut self, object: u16, velocity: [f32; 3]) {
        for i in 0..self.particles.len() {
            if self.particles.object[i] == object {
                self.particles.set_velocity(i, velocity);
            }
        }
    }

    /// Gives `object` a resistance to heat of its side of every contact with another object \[m²K/W\], ≥ 0; that of a contact is the
    /// sum of both sides (simulation.md §6.3). Meant for the start; checkpoints do not hold it.
    pub fn set_contact_resistance(&mut self, object: u16, resistance: f64) {
        self.thermal.set_contact_resistance(object, resistance);
    }

    /// Lets solids find their rest under gravity before time starts: mechanics alone, strongly damped, for `seconds`. Without it
    /// a film begins with the jolt of a body that feels its own weight at once. Time, heat and totals do not move. Returns the
    /// object whose centre sank the most and by how much \[m\]: what sinks by more than a cell or two has fallen, not settled.
    pub fn settle(&mut self, seconds: f64) -> Result<Option<(u16, f64)>, SimError> {
        /// Drag while settling \[1/s\]: near critical for bodies of some centimetres.
        const DRAG: f64 = 60.0;
        if !self.config.mechanics || seconds <= 0.0 {
            return Ok(None);
        }
        let before = self.heights();
        let steps = (seconds / self.config.coupling_step).ceil().max(1.0);
        self.mechanics.settings.drag = DRAG;
        // Nothing is lost before time starts.
        self.mechanics.settings.bounds = Bounds::Clamp;
        for _ in 0..steps as u64 {
            self.substeps(seconds / steps)?;
        }
        self.mechanics.settings.drag = 0.0;
        self.mechanics.settings.bounds = self.config.bounds;
        for i in 0..self.particles.len() {
            self.particles.set_velocity(i, [0.0; 3]);
            self.particles.set_affine(i, [[0.0; 3]; 3]);
        }
        self.particles.sort();
        let sunk = before.iter().zip(self.heights()).map(|((&o, b), (_, a))| (o, b - a));
        Ok(sunk.max_by(|a, b| a.1.total_cmp(&b.1)))
    }

    /// Mean height \[m\] of every object's points.
    fn heights(&self) -> BTreeMap<u16, f64> {
        let mut sums = BTreeMap::<u16, (f64, f64)>::new();
        for i in 0..self.particles.len() {
            let s = sums.entry(self.particles.object[i]).or_default();
            *s = (s.0 + self.particles.position(i)[2], s.1 + 1.0);
        }
        sums.into_iter().map(|(o, (z, n))| (o, z / n)).collect()
    }

    /// Frames done so far.
    pub fn frames_done(&self) -> u64 {
        self.frame
    }

    /// Simulated time \[s\].
    pub fn time(&self) -> f64 {
        self.frame as f64 * self.config.frame_dt
    }

    /// The points, in the solver's own order.
    pub fn particles(&self) -> &Particles {
        &self.particles
    }

    /// The simulated air, once a step has been made.
    pub fn air(&self) -> Option<&crate::air::Lattice> {
        self.thermal.air()
    }

    /// How the simulated air is stepped, once a step has been made.
    pub fn air_step(&self) -> Option<crate::air::AirStep> {
        self.thermal.air_step()
    }

    /// Sums over the whole run.
    pub fn totals(&self) -> &Totals {
        &self.totals
    }

    /// Advances to the next frame. `stop` is asked between coupling steps; if it answers true the state returns to the last
    /// complete frame and `None` comes back.
    pub fn advance_frame(&mut self, stop: &dyn Fn() -> bool) -> Result<Option<FrameReport>, SimError> {
        let steps = self.coupling_steps();
        let dt = self.config.frame_dt / steps as f64;
        let start = self.time();
        let mut air = self.thermal.keep_air();
        let before = (self.caution, self.cautious_heat);
        let mut report = FrameReport { strayed: Health::of(&self.particles).strayed, ..FrameReport::default() };
        // The step that failed last, and how often in a row.
        let (mut step, mut failed, mut failures) = (0, 0, 0);
        while step < steps {
            if stop() {
                self.go_back(0, &mut report);
                (self.caution, self.cautious_heat) = before;
                self.thermal.return_air(air.take());
                return Ok(None);
            }
            self.ring.save(step, &self.particles, self.thermal.solids().temperatures(), &report);
            let time = start + step as f64 * dt;
            match self.coupling_step(time, dt, &mut report)? {
                Ok(()) => {
                    if step >= failed {
                        failures = 0;
                    }
                    step += 1;
                }
                Err(attempt) => {
                    failures += 1;
                    self.go_back(step, &mut report);
                    if failures > MAX_FAILURES {
                        let materials = &self.config.materials;
                        self.mechanics.time = time;
                        let culprit = failure::culprit(&mut self.particles, &mut self.mechanics, materials, attempt.0, attempt.1);
                        return Err(SimError::Unstable { time, culprit: Box::new(culprit) });
                    }
                    failed = step.max(failed);
                    self.caution.raise();
                    report.rollbacks += 1;
                    // Shorter substeps did not help: the harm may have been done in the step before. Of simulated air only the start of
                    // the frame is kept: a copy of it in every step would cost time and memory that hardly any run needs.
                    let before_last = failures == 2 && step > 0;
                    if self.thermal.simulates_air() && (before_last || self.config.coupling.heat_every_substep) {
                        self.caution.last(step);
                        step = 0;
                        self.thermal.return_air(air.clone());
                        self.cautious_heat = before.1;
                        self.go_back(step, &mut report);
                    } else if before_last {
                        step -= 1;
                        self.go_back(step, &mut report);
                    }
                }
            }
        }
        self.frame += 1;
        report.finish(self.frame, self.time(), &self.particles, &self.config.materials);
        self.totals.append(&report);
        Ok(Some(report))
    }

    /// Restores the start of a coupling step of this frame, one of the last two or the first.
    fn go_back(&mut self, step: u64, report: &mut FrameReport) {
        let solids = self.ring.restore(step, &mut self.particles, report);
        self.thermal.solids_mut().restore(solids);
    }

    /// The exchanges of one coupling step: one, or one for each substep where that is asked for. If the mechanics fails (§9.3),
    /// number and length of the substeps come back and the state is lost.
    fn coupling_step(&mut self, time: f64, dt: f64, report: &mut FrameReport) -> Result<Result<(), (u64, f64)>, SimError> {
        if !(self.config.coupling.heat_every_substep && self.config.mechanics) {
            return self.exchange(time, dt, report);
        }
        let substeps = self.mechanics.time_step(&self.particles, dt).steps as f64 * DEFAULT_COURANT / self.config.courant;
        let count = substeps.ceil().clamp(1.0, MAX_SUBSTEPS as f64);
        for k in 0..count as u64 {
            if let Err(attempt) = self.exchange(time + k as f64 * dt / count, dt / count, report)? {
                return Ok(Err(attempt));
            }
        }
        Ok(Ok(()))
    }

    /// Coupling steps per frame.
    fn coupling_steps(&self) -> u64 {
        (self.config.frame_dt / self.config.coupling_step - 1e-9).ceil().max(1.0) as u64
    }

    /// One exchange between mechanics and heat.
    fn exchange(&mut self, time: f64, dt: f64, report: &mut FrameReport) -> Result<Result<(), (u64, f64)>, SimError> {
        let mut lost = 0.0;
        if self.config.mechanics {
            self.mechanics.time = time;
            let (found, attempt) = self.substeps(dt)?;
            let health = Health::of(&self.particles);
            let broken = found.repairs.non_finite + health.broken > 0;
            // Speeds beyond half a cell per substep are a symptom of a step that is too long, and so may be points that leave
            // the density range. Shorter steps get a chance; what they do not cure is real and stays, counted.
            let hasty = found.repairs.capped > 0 && !self.caution.exhausted();
            let strayed = health.strayed > report.strayed && self.caution.factor == 1.0;
            if broken || hasty || strayed {
                return Ok(Err(attempt));
            }
            report.repairs += found.repairs;
            report.capped_energy += found.energy_removed;
            report.max_speed = report.max_speed.max(found.max_speed);
            report.substeps += attempt.0;
            report.substep_min = report.substep_min.min(attempt.1);
            report.strayed = health.strayed;
            report.escaped += found.escaped;
            lost = found.escaped.heat;
            self.caution.relax();
        }
        self.particles.sort();
        let parts = self.cautious_heat.parts;
        let part = dt / f64::from(parts);
        for k in 0..parts {
            let audit = self.heat(time + f64::from(k) * part, part)?;
            report.audit(&audit.after_loss(std::mem::take(&mut lost)));
        }
        let clamped = self.keep_temperatures(report);
        self.cautious_heat.after(clamped);
        self.update_phases();
        report.coupling_steps += 1;
        Ok(Ok(()))
    }

    /// Puts temperatures outside their range back to its ends and books the heat (§9.3); returns their number.
    fn keep_temperatures(&mut self, report: &mut FrameReport) -> u64 {
        let (p, thermal, range) = (&mut self.particles, &self.thermal, self.temperatures);
        let mut count = 0;
        for i in 0..p.len() {
            let t = thermal.temperature(p.material[i], p.enthalpy[i]);
            if !(range.lowest..=range.highest).contains(&t) {
                let h = thermal.enthalpy(p.material[i], t.clamp(range.lowest, range.highest));
                // Tracers follow their neighbours and hold no heat.
                count += u64::from(p.mass[i] > 0.0);
                report.temperature_heat += f64::from(p.mass[i]) * (h - p.enthalpy[i]);
                p.enthalpy[i] = h;
            }
        }
        report.temperatures += count;
        count
    }

    /// The mechanical substeps of one coupling step: what they found, their number and length.
    fn substeps(&mut self, dt: f64) -> Result<(Report, (u64, f64)), SimError> {
        let limit = self.mechanics.time_step(&self.particles, dt);
        // `time_step` uses the default Courant number.
        let factor = DEFAULT_COURANT / (self.config.courant * self.caution.factor);
        let needed = limit.steps as f64 * factor;
        if !needed.is_finite() || needed > MAX_SUBSTEPS as f64 {
            let material = self.particles.material.get(limit.stiffest).map(|&m| self.config.materials[usize::from(m)].name.clone());
            return Err(SimError::TooStiff {
                dt: dt / needed,
                needed: needed.ceil().min(1e18) as u64,
                material: material.unwrap_or_default(),
                spacing: self.config.grid.spacing,
            });
        }
        let count = needed.ceil().max(1.0) as u64;
        let substep = dt / count as f64;
        Ok((self.mechanics.run(&mut self.particles, count as usize, substep), (count, substep)))
    }

    /// The thermal exchange of one coupling step.
    fn heat(&mut self, time: f64, dt: f64) -> Result<Audit, SimError> {
        let p = &mut self.particles;
        p.grid_coordinates(&mut self.xi);
        self.current_volume.resize(p.len(), 0.0);
        self.current_volume.par_iter_mut().with_min_len(4096).enumerate().for_each(|(i, v)| {
            let j = p.volume_ratio(i).clamp(0.6, 1.4);
            *v = p.volume[i] * j;
        });
        if self.thermal.simulates_air() {
            self.thermal.set_velocities((0..p.len()).map(|i| p.velocity(i)));
        }
        let mut points = ThermalPoints {
            xi: &self.xi,
            mass: &p.mass,
            volume: &self.current_volume,
            material: &p.material,
            object: &p.object,
            h: &mut p.enthalpy,
            grad_t: &mut p.temperature_gradient,
        };
        // Obstacles are where the points are: at the end of the step.
        let walls = self.walls.as_mut().map(|w| w.at(&self.config.grid, &self.config.colliders, time + dt));
        Ok(self.thermal.step(&mut points, dt, time, &self.config.sources, walls)?)
    }

    /// Laws from temperatures (§5.4–5.6).
    fn update_phases(&mut self) {
        let p = &mut self.particles;
        let (thermal, rules) = (&self.thermal, &self.rules);
        let mut rescaled: Vec<(usize, f32)> = Vec::new();
        let materials = &self.config.materials;
        let swells: Vec<bool> = materials.iter().map(Material::changes_volume).collect();
        for i in 0..p.len() {
            let m = p.material[i];
            let h = p.enthalpy[i];
            let (t, f) = (thermal.temperature(m, h), thermal.liquid_fraction(m, h));
            let rule = &rules[usize::from(m)];
            let update = rule.update(t, f, p.phase[i], p.shear[i]);
            p.liquid[i] = rule.liquid(f) as f32;
            p.phase[i] = update.phase;
            p.shear[i] = update.law.mu;
            p.yield_stress[i] = update.law.yield_stress;
            p.viscosity[i] = update.law.viscosity;
            p.exponent[i] = update.law.exponent;
            if update.strain_factor != 1.0 {
                rescaled.push((i, update.strain_factor));
            }
            if swells[usize::from(m)]
                && let Some((volume, factor)) = swell(&materials[usize::from(m)], p.mass[i], p.volume[i], f, t)
            {
                let before = p.elastic(i);
                let after = mat3::scale(before, factor);
                p.volume[i] = volume;
                p.record_rebase(i, before, after);
                p.set_elastic(i, after);
            }
            if update.frozen {
                (p.plastic_strain[i], p.volume_gain[i]) = (0.0, 0.0);
            }
        }
        let particles = &*p;
        let changed: Vec<_> = rescaled.par_iter().map(|&(i, factor)| (i, scale_deviator(particles.elastic(i), factor).0)).collect();
        for (i, after) in changed {
            let before = p.elastic(i);
            p.record_rebase(i, before, after);
            p.set_elastic(i, after);
        }
    }
}

/// Everything that touches the bodies: their own start, the surroundings, sources and obstacles.
fn temperature_range(config: &SolverConfig, points: &Points) -> TemperatureRange {
    let mut range = TemperatureRange::EMPTY;
    range.include(config.ambient);
    points.temperature.iter().for_each(|t| range.include(f64::from(*t)));
    if let AirModel::Film(film) = config.thermal.air {
        range.include(film.ambient);
    }
    for source in &config.sources {
        let mut values = source.schedule.keyframes.iter().map(|k| k[1]).collect::<Vec<_>>();
        match &source.kind {
            SourceKind::Temperature { kelvin } => values.push(*kelvin),
            SourceKind::Film(film) => values.push(film.ambient),
            // Power heats or cools without an end.
            _ => values = vec![0.0, f64::INFINITY],
        }
        values.into_iter().for_each(|t| range.include(t));
    }
    for collider in &config.colliders {
        match &collider.thermal {
            Thermal::Adiabatic => {}
            Thermal::Fixed { kelvin, keyframes } => {
                range.include(*kelvin);
                keyframes.iter().for_each(|k| range.include(k[1]));
            }
            Thermal::Conducting(conductor) => {
                range.include(conductor.kelvin);
                if conductor.watts != 0.0 {
                    range.include(0.0);
                    range.include(f64::INFINITY);
                }
            }
        }
    }
    range.widened()
}
