//! Frames for the outside, and checkpoints for ourselves (simulation.md §7.5, §9.3).

use megas_math::Mat3;
use megas_model::PointFrame;
use serde::{Deserialize, Serialize};

use super::failure::{Caution, CautiousHeat};
use super::{SimError, Solver, Totals};
use crate::particles::Particles;
use crate::stretch::limit_total;

/// What a checkpoint holds besides the arrays of the points.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Checkpoint {
    /// Number of points.
    pub points: u64,
    /// Frames done.
    pub frame: u64,
    /// Sums so far.
    pub totals: Totals,
    /// Coupling steps left with smaller substeps, and their factor.
    pub cautious: (u32, f64),
    /// Temperatures of the conducting colliders \[K\].
    #[serde(default)]
    pub solids: Vec<f64>,
    /// The same for the heat.
    #[serde(default)]
    pub cautious_heat: CautiousHeat,
}

impl Solver {
    /// The state of all points by ascending identity. Resets the rebase matrices and lets liquids forget old stretch: call
    /// it exactly once per frame.
    pub fn export(&mut self) -> PointFrame {
        let order = self.particles.by_id();
        let n = order.len();
        let frame_dt = self.config.frame_dt;
        let mut out = PointFrame { time: self.time(), ..PointFrame::default() };
        out.position.reserve_exact(n);
        for &i in &order {
            let i = i as usize;
            let p = &mut self.particles;
            let (m, h) = (p.material[i], p.enthalpy[i]);
            out.id.push(p.id[i]);
            out.position.push(p.position(i).map(|v| v as f32));
            out.elastic.push(flat(p.elastic(i)));
            let liquid = p.phase[i] == crate::phase::state::LIQUID;
            let (shown, kept) = limit_total(p.total(i), liquid, frame_dt);
            p.set_total(i, kept);
            out.total.push(flat(shown));
            out.rebase.push(std::mem::replace(&mut p.rebase[i], IDENTITY));
            out.normal.push(p.normal[i]);
            out.temperature.push(self.thermal.temperature(m, h) as f32);
            out.liquid.push(p.liquid[i]);
            out.phase.push(p.phase[i]);
            out.flags.push(p.flags[i]);
        }
        out
    }

    /// What to write besides [`Particles::arrays`] of [`Solver::particles`], right after [`Solver::export`].
    pub fn checkpoint(&self) -> Checkpoint {
        Checkpoint {
            points: self.particles.len() as u64,
            frame: self.frame,
            totals: self.totals.clone(),
            cautious: (self.caution.steps, self.caution.factor),
            cautious_heat: self.cautious_heat,
            solids: self.thermal.solids().temperatures().to_vec(),
        }
    }

    /// What to write after these arrays if it is not empty: the simulated air.
    pub fn air_state(&self) -> Vec<f32> {
        self.thermal.save_air()
    }

    /// Continues from a checkpoint: `arrays` are the bytes of [`Particles::arrays`] in the same order, and one more with
    /// [`Solver::air_state`] where the air is simulated. The run goes on
    /// bitwise as if it had never stopped.
    pub fn restore(&mut self, checkpoint: Checkpoint, arrays: &[Vec<u8>]) -> Result<(), SimError> {
        let n = self.particles.len();
        let misfit = |what: String| Err(SimError::Checkpoint(what));
        if checkpoint.points != n as u64 {
            return misfit(format!("it has {} points, the body {n}", checkpoint.points));
        }
        let mut particles = Particles::blank(self.particles.grid(), n);
        let targets = particles.arrays_mut();
        let expected = targets.len() + usize::from(self.thermal.simulates_air());
        if arrays.len() != expected {
            return misfit(format!("it has {} arrays, expected {expected}", arrays.len()));
        }
        let air: Vec<f32> = arrays
            .get(targets.len())
            .map_or_else(Vec::new, |bytes| bytes.chunks_exact(4).map(|b| f32::from_ne_bytes([b[0], b[1], b[2], b[3]])).collect());
        for ((name, target), source) in targets.into_iter().zip(arrays) {
            if target.len() != source.len() {
                return misfit(format!("array '{name}' has {} bytes, expected {}", source.len(), target.len()));
            }
            target.copy_from_slice(source);
        }
        if !self.thermal.solids_mut().restore(&checkpoint.solids) {
            let (has, needs) = (checkpoint.solids.len(), self.thermal.solids().len());
            return misfit(format!("it has temperatures of {has} cells of colliders, expected {needs}"));
        }
        if !self.thermal.restore_air(&air, self.config.frame_dt / self.coupling_steps() as f64) {
            return misfit("its air has another size".into());
        }
        particles.sort();
        self.particles = particles;
        self.frame = checkpoint.frame;
        self.totals = checkpoint.totals;
        self.caution = Caution { steps: checkpoint.cautious.0, factor: checkpoint.cautious.1 };
        self.cautious_heat = checkpoint.cautious_heat;
        Ok(())
    }
}

const IDENTITY: [f32; 9] = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];

fn flat(m: Mat3<f32>) -> [f32; 9] {
    std::array::from_fn(|k| m[k / 3][k % 3])
}
