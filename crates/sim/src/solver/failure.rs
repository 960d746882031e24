//! Going back after a failure, and telling what failed (simulation.md §9.3).

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::FrameReport;
use crate::material::Material;
use crate::mechanics::{Mechanics, Report};
use crate::particles::{FLUID, Particles};

/// Coupling steps after a failure during which the substep stays short.
const CAUTIOUS_STEPS: u32 = 20;
/// Failures in a row after which the run stops.
pub(super) const MAX_FAILURES: u32 = 4;
/// Smallest factor on the substep: a failure that this does not cure has another cause.
const SHORTEST: f64 = 1.0 / 16.0;
/// Density over its reference that is still a deformation and no accident.
pub(super) const DENSITY_RANGE: [f32; 2] = [0.5, 1.5];

/// How careful the mechanics is: coupling steps left with short substeps, and their factor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Caution {
    pub steps: u32,
    pub factor: f64,
}

impl Caution {
    pub const NONE: Self = Self { steps: 0, factor: 1.0 };

    /// Halves the substep for the next steps.
    pub fn raise(&mut self) {
        *self = Self { steps: CAUTIOUS_STEPS, factor: (0.5 * self.factor).max(SHORTEST) };
    }

    /// Keeps the substeps short for `steps` more steps, to get to where they were shortened.
    pub fn last(&mut self, steps: u64) {
        self.steps += steps as u32;
    }

    /// After a coupling step that went well.
    pub fn relax(&mut self) {
        self.steps = self.steps.saturating_sub(1);
        if self.steps == 0 {
            self.factor = 1.0;
        }
    }

    /// True when substeps cannot get shorter.
    pub fn exhausted(&self) -> bool {
        self.factor <= SHORTEST
    }
}

/// How careful the heat is: after temperatures had to be put right in three coupling steps in a row, the steps are halved.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct CautiousHeat {
    row: u32,
    steps: u32,
    /// Thermal steps per coupling step.
    pub(super) parts: u32,
}

impl Default for CautiousHeat {
    fn default() -> Self {
        Self { row: 0, steps: 0, parts: 1 }
    }
}

impl CautiousHeat {
    /// After a coupling step in which `clamped` temperatures were put right.
    pub(super) fn after(&mut self, clamped: u64) {
        self.row = if clamped > 0 { self.row + 1 } else { 0 };
        self.steps = self.steps.saturating_sub(1);
        if self.row >= 3 {
            *self = Self { row: 0, steps: CAUTIOUS_STEPS, parts: (2 * self.parts).min(16) };
        } else if self.steps == 0 {
            self.parts = 1;
        }
    }
}

struct Saved {
    particles: Particles,
    /// Temperatures of conducting obstacles \[K\].
    solids: Vec<f64>,
    report: FrameReport,
}

/// The state at the start of the frame and of the last two coupling steps, in buffers that are kept.
#[derive(Default)]
pub(super) struct Ring {
    saved: [Option<Saved>; 3],
}

impl Ring {
    /// Buffer of coupling step `c` of a frame: the first has its own, the others take turns.
    fn slot(step: u64) -> usize {
        if step == 0 { 0 } else { 1 + (step % 2) as usize }
    }

    /// Keeps the state at the start of coupling step `step` of the frame.
    pub fn save(&mut self, step: u64, particles: &Particles, solids: &[f64], report: &FrameReport) {
        match &mut self.saved[Self::slot(step)] {
            Some(s) => {
                s.particles.copy_from(particles);
                s.solids.clear();
                s.solids.extend_from_slice(solids);
                s.report = report.clone();
            }
            empty => *empty = Some(Saved { particles: particles.clone(), solids: solids.to_vec(), report: report.clone() }),
        }
    }

    /// Goes back to the start of coupling step `step`, one of the last two or the first, and gives the temperatures of the
    /// conducting obstacles then. What happened to be repaired since then did not happen; roll-backs did.
    pub fn restore(&self, step: u64, particles: &mut Particles, report: &mut FrameReport) -> &[f64] {
        let Some(s) = &self.saved[Self::slot(step)] else { return &[] };
        particles.copy_from(&s.particles);
        *report = FrameReport { rollbacks: report.rollbacks, ..s.report.clone() };
        &s.solids
    }
}

/// State of the points after a coupling step's mechanics.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Health {
    /// Points with a number that is none.
    pub broken: u64,
    /// Points denser or thinner than [`DENSITY_RANGE`].
    pub strayed: u64,
}

impl Health {
    /// One pass over the points.
    pub fn of(p: &Particles) -> Self {
        const CHUNK: usize = 4096;
        let parts: Vec<Self> = (0..p.len().div_ceil(CHUNK))
            .into_par_iter()
            .map(|k| {
                let mut found = Self::default();
                for i in k * CHUNK..((k + 1) * CHUNK).min(p.len()) {
                    found.broken += u64::from(!finite(p, i));
                    found.strayed += u64::from(strayed(p, i));
                }
                found
            })
            .collect();
        parts.into_iter().fold(Self::default(), |a, b| Self { broken: a.broken + b.broken, strayed: a.strayed + b.strayed })
    }
}

fn finite(p: &Particles, i: usize) -> bool {
    // A sum is finite only if its terms are, unless they are too large to mean anything.
    let v: f32 = p.velocity(i).iter().map(|v| v.abs()).sum();
    let f: f32 = p.displacement_gradient(i).iter().flatten().map(|v| v.abs()).sum();
    (v + f).is_finite() && p.enthalpy[i].is_finite()
}

fn strayed(p: &Particles, i: usize) -> bool {
    let j = megas_math::mat3::det(p.elastic(i));
    // ρ/ρ⁰ = 1/J. Tracers have no density.
    p.mass[i] > 0.0 && p.law[i] != FLUID && !(1.0 / DENSITY_RANGE[1]..=1.0 / DENSITY_RANGE[0]).contains(&j)
}

/// The point that failed first.
#[derive(Clone, Debug, PartialEq)]
pub struct Culprit {
    /// Identity of the point.
    pub point: u32,
    /// Number of its object, from 1.
    pub object: u16,
    /// Its material.
    pub material: String,
    /// Where it was \[m\].
    pub position: [f64; 3],
    /// What it violated, in words, with the limit.
    pub violated: String,
}

impl std::fmt::Display for Culprit {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let [x, y, z] = self.position;
        write!(
            f,
            "point {} of object {}, material '{}', at [{x:.4}, {y:.4}, {z:.4}] m: {}",
            self.point, self.object, self.material, self.violated
        )
    }
}

/// Looks for the point at which a failure starts: repeats the failed substeps one by one on `p`, which is lost by that.
pub(super) fn culprit(p: &mut Particles, mechanics: &mut Mechanics, materials: &[Material], steps: u64, dt: f64) -> Culprit {
    let cap = 0.5 * p.grid().spacing / dt;
    let name = |p: &Particles, i: usize, violated: String| Culprit {
        point: p.id[i],
        object: p.object[i],
        material: materials.get(usize::from(p.material[i])).map(|m| m.name.clone()).unwrap_or_default(),
        position: p.position(i),
        violated,
    };
    let lowest = |p: &Particles, bad: &dyn Fn(usize) -> bool| (0..p.len()).filter(|&i| bad(i)).min_by_key(|&i| p.id[i]);
    if let Some(i) = lowest(p, &|i| !finite(p, i)) {
        return name(p, i, "its velocity, deformation or enthalpy is not a number".into());
    }
    // The most suspicious point so far; the one before the first number that is none is the best guess.
    let mut suspect = worst(p, cap);
    for _ in 0..steps {
        let Report { repairs, .. } = mechanics.run(p, 1, dt);
        if let Some(i) = lowest(p, &|i| !finite(p, i)) {
            return name(p, i, "its velocity, deformation or enthalpy became infinite or not a number".into());
        }
        if repairs.non_finite > 0 {
            break;
        }
        suspect = worst(p, cap);
    }
    let i = lowest(p, &|i| p.id[i] == suspect.0).unwrap_or(0);
    name(p, i, suspect.1)
}

/// Identity of the point furthest beyond a limit, and which limit.
fn worst(p: &Particles, cap: f64) -> (u32, String) {
    let mut found = (0, 0.0, String::new());
    for i in 0..p.len() {
        let speed = p.velocity(i).iter().map(|v| f64::from(*v).powi(2)).sum::<f64>().sqrt();
        let density = 1.0 / f64::from(megas_math::mat3::det(p.elastic(i)));
        let excess = (speed / cap).max(density.max(1.0 / density) / f64::from(DENSITY_RANGE[1]));
        if excess > found.1 || (excess == found.1 && p.id[i] < found.0) {
            let text = if speed / cap >= excess {
                format!("speed {speed:.3} m/s, limit {cap:.3} m/s (half a cell per substep)")
            } else {
                format!("density {density:.3} of its reference, limits {} and {}", DENSITY_RANGE[0], DENSITY_RANGE[1])
            };
            found = (p.id[i], excess, text);
        }
    }
    (found.0, found.2)
}

/// Temperatures that a body can have: between the coldest and the hottest thing that touches it, 1 % more on both sides.
/// A source of power has no temperature; it lifts the limit on its side.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct TemperatureRange {
    pub lowest: f64,
    pub highest: f64,
}

impl TemperatureRange {
    /// Nothing seen yet.
    pub const EMPTY: Self = Self { lowest: f64::INFINITY, highest: f64::NEG_INFINITY };

    /// Makes room for a temperature \[K\].
    pub fn include(&mut self, kelvin: f64) {
        self.lowest = self.lowest.min(kelvin);
        self.highest = self.highest.max(kelvin);
    }

    /// With the margin; absolute zero is the end.
    pub fn widened(self) -> Self {
        Self { lowest: (0.99 * self.lowest).max(0.0), highest: 1.01 * self.highest }
    }
}
