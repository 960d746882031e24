//! Another time step for air that already flows: what a step means changes; velocity \[m/s\], pressure, stress, temperature and
//! heat flux do not (simulation.md §4.8).
//!
//! With r = Δt'/Δt, velocities in nodes per step grow by r, the excess of density (pressure over c_s²) by r², the even
//! non-equilibrium of the flow (ρ c_s² τ S Δt) by r τ'/τ, and the odd one of the temperature (a difference of temperatures over one
//! node times the relaxation time) by τ_g'/τ_g. An eddy viscosity is taken for a small part of τ.

use crate::air::boundaries::Links;
use crate::air::lattice::Lattice;
use crate::air::settings::LatticeSettings;
use crate::air::velocity_sets::{C, Q7, Q19, W7, W19, opposite};

impl Lattice {
    /// Goes on with `settings`, whose steps are `ratio` times as long; nodes, kinds of faces and storage must be the same. Every
    /// node keeps its heat.
    pub(crate) fn change_step(&mut self, settings: LatticeSettings, ratio: f64) {
        let old = &self.settings;
        let stress = ratio * (3.0 * settings.viscosity + 0.5) / (3.0 * old.viscosity + 0.5);
        let flux = old.heat_rates(old.diffusivity).1 / settings.heat_rates(settings.diffusivity).1;
        for n in self.every() {
            let (rho, u) = self.flow(n);
            // Half of the force of a step is still to come; in solids it is not worth the distinction.
            let full = if self.nodes.solid[self.layout.node(n)] > 0.0 { u } else { self.macroscopic(n).1 };
            if settings.heat {
                self.rescale_heat(n, full, ratio, flux);
            }
            if settings.flows_here() {
                let excess = rho - 1.0;
                let (scaled, to) = (excess * ratio * ratio, std::array::from_fn(|a| ratio * (full[a] + ratio * (u[a] - full[a]))));
                for k in 0..Q19 {
                    let beyond = self.flow_population(n, k) - equilibrium(k, excess, u);
                    let slot = self.layout.arriving(Q19, self.odd, k, n.map(|v| v as isize));
                    self.populations.set_flow(slot, (equilibrium(k, scaled, to) + stress * beyond) as f32);
                }
            }
        }
        for v in self.nodes.u.iter_mut().chain(&mut self.nodes.solid_velocity) {
            v.iter_mut().for_each(|v| *v *= ratio as f32);
        }
        if settings.flows_here() {
            self.flow_links = Links::new(&self.layout, Q19, &settings.faces);
        }
        if settings.heat {
            self.heat_links = Links::new(&self.layout, Q7, &settings.faces);
        }
        if let Some(coarse) = &mut self.coarse {
            coarse.change_step(settings.coarse(), ratio);
        }
        self.settings = settings;
    }

    /// The part that is carried grows with the velocity, the part that is conducted with the relaxation time.
    fn rescale_heat(&mut self, n: [usize; 3], u: [f64; 3], ratio: f64, flux: f64) {
        let heat = self.enthalpy(n);
        for k in (1..Q7).step_by(2) {
            let (a, b) = (self.heat_population(n, k), self.heat_population(n, opposite(k)));
            let carried = 8.0 * W7[k] * heat * (0..3).map(|i| f64::from(C[k][i]) * u[i]).sum::<f64>();
            let difference = carried * ratio + (a - b - carried) * flux;
            self.put_heat(n, k, (0.5 * (a + b + difference)) as f32);
            self.put_heat(n, opposite(k), (0.5 * (a + b - difference)) as f32);
        }
        // What rounding took from those that move stays at rest.
        let rest = self.heat_population(n, 0) + (heat - self.enthalpy(n));
        self.put_heat(n, 0, rest as f32);
    }
}

/// Equilibrium of population `k` less its weight, for a density of 1 + `excess`.
fn equilibrium(k: usize, excess: f64, u: [f64; 3]) -> f64 {
    let cu: f64 = (0..3).map(|a| f64::from(C[k][a]) * u[a]).sum();
    let u2: f64 = u.iter().map(|v| v * v).sum();
    W19[k] * (excess + (1.0 + excess) * (3.0 * cu + 4.5 * cu * cu - 1.5 * u2))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    /// Sheared air carries and conducts a wave of temperature (no sound, whose speed depends on the step). Steps become twice or
    /// half as long; against a run with those steps from the start.
    #[test]
    fn a_change_of_step_changes_neither_the_flow_nor_the_heat() {
        let made = |r: f64| LatticeSettings { viscosity: 0.1 * r, diffusivity: 0.07 * r, ..LatticeSettings::new([16, 4, 16], 0.1, 0.07) };
        let wave = |r: f64| {
            move |n: [usize; 3]| {
                let [x, z] = [n[0], n[2]].map(|i| (TAU * i as f64 / 16.0).sin());
                (1.0, [0.01 * r * z, 0.0, 0.0], 20.0 + 10.0 * x)
            }
        };
        for (r, before) in [(2.0, 40), (0.5, 40)] {
            let (mut changed, mut whole) = (Lattice::new(made(1.0)), Lattice::new(made(r)));
            changed.fill(wave(1.0));
            whole.fill(wave(r));
            (0..before).for_each(|_| _ = changed.step());
            (0..(f64::from(before) / r) as u32).for_each(|_| _ = whole.step());
            let heat = changed.total_enthalpy();
            changed.change_step(made(r), r);
            assert!((changed.total_enthalpy() / heat - 1.0).abs() < 1e-7);
            let errors = [0, 1].map(|more| {
                for _ in 0..more {
                    changed.step();
                    whole.step();
                }
                let (mut du, mut u2, mut dt, mut t2) = (0.0, 0.0, 0.0, 0.0);
                for n in whole.every() {
                    let (a, b) = (changed.macroscopic(n).1, whole.macroscopic(n).1);
                    du += (0..3).map(|i| (a[i] - b[i]).powi(2)).sum::<f64>();
                    u2 += b.iter().map(|v| v * v).sum::<f64>();
                    dt += (changed.temperature(n) - whole.temperature(n)).powi(2);
                    t2 += (whole.temperature(n) - 20.0).powi(2);
                }
                [(du / u2).sqrt(), (dt / t2).sqrt()]
            });
            // The two runs differ by the error of their steps; the change adds nothing. A stress or a flux that is not scaled
            // adds 3e-3 to 3e-2 and 7e-4 to 3e-3 in the first step.
            for (then, now) in errors[0].into_iter().zip(errors[1]) {
                assert!(now < 0.01 && (now - then).abs() < 3e-4, "{r}: {errors:?}");
            }
        }
    }
}
