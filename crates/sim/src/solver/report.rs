//! What a frame, and a whole run, did (simulation.md §3.7, §9.3).

use serde::{Deserialize, Serialize};

use crate::material::Material;
use crate::mechanics::{Escaped, Repairs};
use crate::particles::Particles;
use crate::thermal::Audit;

/// Figures of one frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FrameReport {
    /// Number of the frame, from 1 (frame 0 is the start).
    pub frame: u64,
    /// Simulated time at its end \[s\].
    pub time: f64,
    /// Exchanges between mechanics and heat.
    pub coupling_steps: u64,
    /// Mechanical substeps.
    pub substeps: u64,
    /// Shortest substep \[s\].
    pub substep_min: f64,
    /// Largest speed of a point \[m/s\].
    pub max_speed: f64,
    /// Energy balance of the frame; `None` before the first exchange.
    pub audit: Option<Audit>,
    /// Repairs of points.
    pub repairs: Repairs,
    /// Coupling steps that were repeated with smaller substeps.
    pub rollbacks: u64,
    /// Kinetic energy taken by the speed cap \[J\].
    #[serde(default)]
    pub capped_energy: f64,
    /// Temperatures put back into the range of everything that touches the bodies.
    #[serde(default)]
    pub temperatures: u64,
    /// Heat that this added \[J\].
    #[serde(default)]
    pub temperature_heat: f64,
    /// What left the box.
    #[serde(default)]
    pub escaped: Escaped,
    /// Points denser than 1.5 or thinner than 0.5 of their reference at the end. Fragments of a melt may be.
    #[serde(default)]
    pub strayed: u64,
    /// `Σ V⁰ det F / Σ V⁰ − 1`, with the reference volumes V⁰ that phase and temperature ask for.
    pub volume_change: f64,
    /// Molten share of the mass that can melt.
    pub liquid_fraction: f64,
}

impl Default for FrameReport {
    fn default() -> Self {
        Self {
            frame: 0,
            time: 0.0,
            coupling_steps: 0,
            substeps: 0,
            substep_min: f64::INFINITY,
            max_speed: 0.0,
            audit: None,
            repairs: Repairs::default(),
            rollbacks: 0,
            capped_energy: 0.0,
            temperatures: 0,
            temperature_heat: 0.0,
            escaped: Escaped::default(),
            strayed: 0,
            volume_change: 0.0,
            liquid_fraction: 0.0,
        }
    }
}

impl FrameReport {
    pub(super) fn audit(&mut self, step: &Audit) {
        match &mut self.audit {
            Some(a) => a.append(step),
            None => self.audit = Some(*step),
        }
    }

    pub(super) fn finish(&mut self, frame: u64, time: f64, p: &Particles, materials: &[Material]) {
        self.frame = frame;
        self.time = time;
        if !self.substep_min.is_finite() {
            self.substep_min = 0.0;
        }
        let (mut volume, mut reference, mut liquid, mut mass) = (0.0, 0.0, 0.0, 0.0);
        for i in 0..p.len() {
            reference += f64::from(p.volume[i]);
            volume += f64::from(p.volume[i]) * f64::from(p.volume_ratio(i));
            if materials[usize::from(p.material[i])].solidus.is_finite() {
                liquid += f64::from(p.mass[i]) * f64::from(p.liquid[i]);
                mass += f64::from(p.mass[i]);
            }
        }
        self.volume_change = volume / reference - 1.0;
        self.liquid_fraction = if mass > 0.0 { liquid / mass } else { 0.0 };
    }
}

/// Repairs that changed a point: everything but free flight, which is physics.
pub fn repaired(r: &Repairs) -> u64 {
    r.degenerate + r.capped + r.out_of_box + r.projected + r.non_finite
}

/// Sums over a run.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Totals {
    /// Mechanical substeps.
    pub substeps: u64,
    /// Energy balance from the first frame to the last.
    pub audit: Option<Audit>,
    /// Repairs of points.
    pub repairs: Repairs,
    /// Repeated coupling steps.
    pub rollbacks: u64,
    /// Kinetic energy taken by the speed cap \[J\].
    #[serde(default)]
    pub capped_energy: f64,
    /// Temperatures put back into their range.
    #[serde(default)]
    pub temperatures: u64,
    /// Heat that this added \[J\].
    #[serde(default)]
    pub temperature_heat: f64,
    /// What left the box.
    #[serde(default)]
    pub escaped: Escaped,
    /// Most points outside the density range in any frame.
    #[serde(default)]
    pub strayed: u64,
    /// Largest |volume change| of any frame.
    pub volume_change: f64,
    /// Largest speed \[m/s\].
    pub max_speed: f64,
}

impl Totals {
    pub(super) fn append(&mut self, frame: &FrameReport) {
        self.substeps += frame.substeps;
        self.repairs += frame.repairs;
        self.rollbacks += frame.rollbacks;
        self.capped_energy += frame.capped_energy;
        self.temperatures += frame.temperatures;
        self.temperature_heat += frame.temperature_heat;
        self.escaped += frame.escaped;
        self.strayed = self.strayed.max(frame.strayed);
        self.volume_change = self.volume_change.max(frame.volume_change.abs());
        self.max_speed = self.max_speed.max(frame.max_speed);
        match (&mut self.audit, &frame.audit) {
            (Some(a), Some(b)) => a.append(b),
            (None, b) => self.audit = *b,
            (Some(_), None) => {}
        }
    }

    /// `|R| / max(|E|, Σ|Q|)` of the energy audit (simulation.md §3.7).
    pub fn energy_residual(&self) -> f64 {
        self.audit.map_or(0.0, |a| {
            let scale = a.scale();
            if scale > 0.0 { a.residual.abs() / scale } else { 0.0 }
        })
    }
}
