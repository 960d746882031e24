//! Checks of a material at load: will it slump, what does it cost, is the melt stiff enough (simulation.md §5.7).

use crate::diagnostic::Severity;
use crate::material::{Law, ResolvedMaterial};

/// The grid and the clock that a material has to live with.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StepLimits {
    /// Height of the object H \[m\].
    pub object_height_m: f64,
    /// Gravity \[m/s²\].
    pub gravity_m_s2: f64,
    /// Grid spacing Δx \[m\].
    pub dx_m: f64,
    /// Share C_e of the stable step.
    pub courant: f64,
    /// Coupling step Δt_c \[s\].
    pub coupling_step_s: f64,
    /// Time between two frames \[s\].
    pub frame_dt_s: f64,
}

/// The largest number of substeps in one coupling step (simulation.md §2.5).
const MAX_SUBSTEPS: f64 = 2000.0;

/// Thickness over the object's height at which a melt still has to flow at its own speed.
const LAYER: f64 = 0.25;

/// What the checks found.
#[derive(Clone, Debug, PartialEq)]
pub struct MaterialReport {
    /// Yield number `Y = τ_0/(ρ g H)`; 0 without gravity.
    pub yield_number: f64,
    /// Elastic wave speed c \[m/s\].
    pub wave_speed_m_s: f64,
    /// Predicted substep Δt_m of a body at rest \[s\].
    pub substep_s: f64,
    /// Predicted substeps per frame.
    pub substeps_per_frame: u64,
    /// Warnings and errors, in words.
    pub messages: Vec<(Severity, String)>,
}

impl ResolvedMaterial {
    /// Runs the load-time checks.
    pub fn check(&self, limits: &StepLimits) -> MaterialReport {
        let mut messages = Vec::new();
        let name = &self.name;
        let mut positive = |what: &str, value: f64| {
            if !(value > 0.0 && value.is_finite()) {
                messages.push((Severity::Error, format!("{name}: {what} = {value} must be a positive number")));
            }
        };
        positive("density", self.density);
        if self.law != Law::Fluid {
            positive("shear modulus", self.shear_modulus);
        }
        positive("bulk modulus", self.bulk_modulus);
        positive("specific heat of the solid", self.heat_capacity_solid);
        positive("specific heat of the melt", self.heat_capacity_liquid);
        positive("conductivity of the solid", self.conductivity_solid);
        positive("conductivity of the melt", self.conductivity_liquid);
        positive("consistency of the melt", self.melt_consistency);
        if self.solidus > self.liquidus {
            messages.push((Severity::Error, format!("{name}: the solidus {} K lies above the liquidus {} K", self.solidus, self.liquidus)));
        }
        if self.melt_shear_modulus > self.shear_modulus {
            messages.push((Severity::Error, format!("{name}: the melt is stiffer in shear than the solid")));
        }

        let wave_speed = self.wave_speed();
        let weight = self.density * limits.gravity_m_s2 * limits.object_height_m;
        let yield_number = if weight > 0.0 { self.melt_yield_stress / weight } else { 0.0 };
        // Explicit viscosity has a limit of its own (simulation.md §2.5).
        let viscous =
            if self.fluid_viscosity > 0.0 { 0.1 * self.density * limits.dx_m.powi(2) / self.fluid_viscosity } else { f64::INFINITY };
        let substep = (limits.courant * limits.dx_m / wave_speed).min(viscous).min(limits.coupling_step_s);
        let per_coupling = (limits.coupling_step_s / substep).ceil();
        let couplings = (limits.frame_dt_s / limits.coupling_step_s).ceil().max(1.0);
        if per_coupling > MAX_SUBSTEPS {
            messages.push((
                Severity::Error,
                format!(
                    "{name}: too {}: {per_coupling} substeps per coupling step (at most {MAX_SUBSTEPS}); lower {}",
                    if viscous < limits.courant * limits.dx_m / wave_speed { "viscous" } else { "stiff" },
                    if viscous < limits.courant * limits.dx_m / wave_speed {
                        "viscosity_pa_s"
                    } else {
                        "youngs_modulus_pa or use sag_ratio"
                    },
                ),
            ));
        }
        if self.solidus.is_finite() && weight > 0.0 {
            self.check_melt(limits, yield_number, substep, &mut messages);
        }
        if weight > self.solid_yield_stress {
            let text = format!(
                "{name}: the solid yields under its own weight ({weight:.0} Pa at its foot, solid_yield_stress_pa {:.0}); \
                 raise solid_yield_stress_pa",
                self.solid_yield_stress
            );
            messages.push((Severity::Warning, text));
        }
        if let Some(melt) = self.melt_density.filter(|m| !(0.7..1.4).contains(&(m / self.density))) {
            let change = 100.0 * (self.density / melt - 1.0);
            messages.push((
                Severity::Warning,
                format!("{name}: melting would change the volume by {change:.0} %; is melt_density_kg_m3 = {melt} meant?"),
            ));
        }
        MaterialReport {
            yield_number,
            wave_speed_m_s: wave_speed,
            substep_s: substep,
            substeps_per_frame: (per_coupling * couplings) as u64,
            messages,
        }
    }

    fn check_melt(&self, limits: &StepLimits, yield_number: f64, substep: f64, messages: &mut Vec<(Severity, String)>) {
        let name = &self.name;
        if yield_number > 0.5 {
            let text = format!(
                "{name}: the melt will not slump: its yield stress {} Pa carries the weight of {:.3} m of it \
                 (yield number {yield_number:.2} > 0.5); lower melt_yield_stress_pa or make the object larger",
                self.melt_yield_stress, limits.object_height_m
            );
            messages.push((Severity::Warning, text));
        } else if yield_number < 0.005 {
            let text = format!(
                "{name}: the melt spreads like water (yield number {yield_number:.4} < 0.005); \
                 raise melt_yield_stress_pa to keep some shape"
            );
            messages.push((Severity::Note, text));
        }
        // Elastic strain of the flowing melt stays small only if μ_l ≥ 10 s_max (simulation.md §5.2). The planned shear rate is that of a
        // collapse under gravity over the object's height.
        let rate = (2.0 * limits.gravity_m_s2 / limits.object_height_m).sqrt();
        let stress = std::f64::consts::SQRT_2 * (self.melt_yield_stress + self.melt_consistency * rate.powf(self.melt_flow_index));
        if self.melt_shear_modulus < 10.0 * stress {
            let text = format!(
                "{name}: the melt's shear modulus {:.3e} Pa is below 10 × its flow stress {stress:.3e} Pa: it will look rubbery and \
                 flow too easily; stiffen it (smaller sag_ratio) or thin the melt (melt_consistency_pa_sn)",
                self.melt_shear_modulus
            );
            messages.push((Severity::Warning, text));
        }
        // Every substep smooths velocities: a layer of N cells on a sticky floor keeps 90 % of its speed from a viscosity of
        // 0.2 ρ Δx²/(N Δt_m) on, which is 0.5 ρ c Δx/N at the usual Courant number (docs/validation.md, slow melts).
        let viscosity = stress / (std::f64::consts::SQRT_2 * rate);
        let cells = 0.2 * self.density * limits.dx_m.powi(2) / (substep * viscosity);
        let layer = LAYER * limits.object_height_m / limits.dx_m;
        if cells > layer {
            let text = format!(
                "{name}: the melt is too thin for the grid: at {viscosity:.2} Pa·s it flows at less than 90 % of its speed where it lies \
                 thinner than {:.1} mm ({cells:.0} cells), and a layer of {layer:.0} cells would need {:.1} Pa·s; use more cells, \
                 softer solids (larger sag_ratio) or a thicker melt (melt_consistency_pa_sn)",
                1e3 * cells * limits.dx_m,
                viscosity * cells / layer,
            );
            // True of most previews; who measures wants to know.
            messages.push((Severity::Note, text));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::material::{MaterialContext, MaterialSpec};
    use crate::settings::PhaseMode;

    fn report(spec: MaterialSpec, height: f64) -> MaterialReport {
        let context = MaterialContext {
            object_height_m: height,
            gravity_m_s2: 9.81,
            sag_ratio: 0.005,
            ambient_k: 293.15,
            initial_k: None,
            max_speed_m_s: 0.0,
            phase_mode: PhaseMode::Mushy,
            hysteresis_k: 1.0,
            latent_heat: true,
            uniform_heat_capacity: None,
        };
        let limits = StepLimits {
            object_height_m: height,
            gravity_m_s2: 9.81,
            dx_m: height / 48.0,
            courant: 0.4,
            coupling_step_s: 0.002,
            frame_dt_s: 1.0 / 24.0,
        };
        spec.resolve("m", &context).unwrap().check(&limits)
    }

    #[test]
    fn the_example_of_the_design() {
        let r = report(MaterialSpec::default(), 0.2);
        assert!((r.substep_s - 7.2e-5).abs() < 4e-6, "{}", r.substep_s);
        assert!((r.yield_number - 20.0 / (1000.0 * 9.81 * 0.2)).abs() < 1e-12);
        assert_eq!(r.messages, []);
        assert_eq!(r.substeps_per_frame, 21 * 28);
    }

    #[test]
    fn slump_and_stiffness_are_judged() {
        let stiff = report(MaterialSpec { melt_yield_stress_pa: Some(2000.0), ..Default::default() }, 0.2);
        assert!(stiff.messages.iter().any(|(s, m)| *s == Severity::Warning && m.contains("will not slump")));
        let thick = report(MaterialSpec { melt_consistency_pa_sn: Some(1e5), ..Default::default() }, 0.2);
        assert!(thick.messages.iter().any(|(_, m)| m.contains("rubbery")));
        // At a rate of 9.9/s: 20/9.9 + 0.5 Pa·s, where a quarter of the height would need 4.
        let thin = report(MaterialSpec { melt_consistency_pa_sn: Some(0.5), ..Default::default() }, 0.2);
        assert!(thin.messages.iter().any(|(s, m)| *s == Severity::Note && m.contains("too thin for the grid: at 2.52 Pa·s")), "{thin:?}");
        let water = report(MaterialSpec::from_preset("water-ice"), 0.2);
        assert!(water.messages.iter().any(|(s, m)| *s == Severity::Note && m.contains("like water")));
        let steel = report(MaterialSpec { youngs_modulus_pa: Some(1e10), ..Default::default() }, 0.02);
        assert!(steel.messages.iter().any(|(s, m)| *s == Severity::Error && m.contains("too stiff")), "{:?}", steel);
    }
}
