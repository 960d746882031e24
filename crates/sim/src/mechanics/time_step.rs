//! The length of a substep (simulation.md §2.5).

use fearless_simd::{Simd, SimdBase, SimdFloat, dispatch};
use megas_math::simd::Lanes;
use megas_math::simd::symmetric::Traceless;
use rayon::prelude::*;

use super::Mechanics;
use super::laws::left_strain;
use crate::particles::{FLUID, Particles};

/// Elastic Courant number C_e.
const ELASTIC: f64 = 0.4;
/// Advective Courant number C_a.
const ADVECTIVE: f64 = 0.3;
/// Stability number of explicit viscosity, `Δt ≤ 0.1 ρ Δx²/μ_v`.
const VISCOUS: f64 = 0.1;
/// Largest stiffening factor χ.
const MAX_STIFFENING: f64 = 3.0;
/// Points per unit of parallel work.
const CHUNK: usize = 4096;

/// How a coupling step divides into substeps.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TimeStep {
    /// Substeps n_m, ≥ 1.
    pub steps: usize,
    /// Length of one \[s\].
    pub dt: f64,
    /// Fastest elastic wave c \[m/s\].
    pub wave_speed: f64,
    /// Largest speed of a point or of an obstacle \[m/s\].
    pub max_speed: f64,
    /// Stiffening χ = 1/σ_min of compressed points, 1–3.
    pub stiffening: f64,
    /// Index of the point with the fastest wave.
    pub stiffest: usize,
}

impl Mechanics {
    /// Substeps for an interval of `interval` seconds. The caller decides what number of them is too many.
    pub fn time_step(&self, p: &Particles, interval: f64) -> TimeStep {
        let n = p.len();
        let level = self.level;
        let parts: Vec<Scan> = (0..n.div_ceil(CHUNK))
            .into_par_iter()
            .map(|k| dispatch!(level, s => scan(s, p, k * CHUNK, ((k + 1) * CHUNK).min(n))))
            .collect();
        let Scan { wave2, stiffest, speed2, stretch2, viscosity } = parts.into_iter().fold(Scan::NONE, |a, b| {
            let (wave2, stiffest) = if b.wave2 > a.wave2 { (b.wave2, b.stiffest) } else { (a.wave2, a.stiffest) };
            Scan {
                wave2,
                stiffest,
                speed2: a.speed2.max(b.speed2),
                stretch2: a.stretch2.min(b.stretch2),
                viscosity: a.viscosity.max(b.viscosity),
            }
        });
        let wave_speed = f64::from(wave2).sqrt();
        let max_speed = f64::from(speed2).sqrt().max(self.obstacle_speed(self.time, interval));
        let stiffening = (1.0 / f64::from(stretch2).max(1e-6).sqrt()).clamp(1.0, MAX_STIFFENING);
        let dx = self.grid.spacing;
        let mut dt = interval;
        for (limit, speed) in [(ELASTIC, wave_speed * stiffening + max_speed), (ADVECTIVE, max_speed)] {
            if speed > 0.0 {
                dt = dt.min(limit * dx / speed);
            }
        }
        if viscosity > 0.0 {
            dt = dt.min(VISCOUS * dx * dx / f64::from(viscosity));
        }
        let steps = (interval / dt).ceil().max(1.0) as usize;
        TimeStep { steps, dt: interval / steps as f64, wave_speed, max_speed, stiffening, stiffest }
    }
}

/// What limits the step in a range of points.
struct Scan {
    /// Largest squared wave speed \[m²/s²\], and its point.
    wave2: f32,
    stiffest: usize,
    /// Largest squared speed \[m²/s²\].
    speed2: f32,
    /// Lower bound of the smallest squared stretch, or what stiffens a fluid as much.
    stretch2: f32,
    /// Largest kinematic viscosity of a fluid \[m²/s\].
    viscosity: f32,
}

impl Scan {
    const NONE: Self = Self { wave2: 0.0, stiffest: 0, speed2: 0.0, stretch2: 1.0, viscosity: 0.0 };
}

#[inline(always)]
fn scan<S: Simd>(s: S, p: &Particles, from: usize, to: usize) -> Scan {
    let mut found = Scan { stiffest: from, ..Scan::NONE };
    for i in from..to {
        if p.mass[i] > 0.0 {
            let c2 = (p.bulk[i] + p.shear[i] * (4.0 / 3.0)) * p.volume[i] / p.mass[i];
            if c2 > found.wave2 {
                (found.wave2, found.stiffest) = (c2, i);
            }
            if p.law[i] == FLUID {
                found.viscosity = found.viscosity.max(p.viscosity[i] * p.volume[i] / p.mass[i]);
                // Tait: c² grows like J^{1−γ}, so J^{γ−1} stands in for the squared stretch.
                let j = (p.elastic[0][i] + 1.0).clamp(0.1, 1.0);
                found.stretch2 = found.stretch2.min(j.powf((p.exponent[i] - 1.0).max(0.0)));
            }
        }
    }
    let n = Lanes::<S>::LEN;
    let mut speed2 = Lanes::<S>::splat(s, 0.0);
    let mut stretch2 = Lanes::<S>::splat(s, 1.0);
    for at in (from..to).step_by(n) {
        let lanes = |a: &Vec<f32>| Lanes::<S>::from_fn(s, |i| if at + i < to { a[at + i] } else { 0.0 });
        let v = [0, 1, 2].map(|k| lanes(&p.velocity[k]));
        speed2 = speed2.max(v[2].mul_add(v[2], v[1].mul_add(v[1], v[0] * v[0])));
        let fluid = Lanes::<S>::from_fn(s, |i| if at + i < to && p.law[at + i] == FLUID { 0.0 } else { 1.0 });
        let h = std::array::from_fn(|r| std::array::from_fn(|c| lanes(&p.elastic[3 * r + c]) * fluid));
        let mut x = left_strain::<S>(&h);
        let mean = (x[0] + x[1] + x[2]) * (1.0 / 3.0);
        for k in 0..3 {
            x[k] -= mean;
        }
        // No eigenvalue of a traceless matrix lies below −√(4p/3).
        let lowest = mean + 1.0 - (Traceless::<S>::new(x).p * (4.0 / 3.0)).sqrt();
        stretch2 = stretch2.min(lowest);
    }
    found.speed2 = speed2.reduce_max();
    found.stretch2 = found.stretch2.min(stretch2.reduce_min());
    found
}
