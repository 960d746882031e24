//! From temperature and liquid fraction to the law of a point, and what that does to its elastic strain
//! (simulation.md §5.4–5.6).

use megas_math::mat3::{self, Mat3};
use megas_math::{Real, svd};
use serde::{Deserialize, Serialize};

use crate::material::{Law, Material, PhaseMode, Tables};
use crate::particles::TAIT_EXPONENT;

/// Values of a point's phase byte. The byte is for output, for the skin and for sticking colliders; no law reads it except
/// the binary rule, whose hysteresis it is.
pub mod state {
    /// Never been liquid.
    pub const SOLID: u8 = 0;
    /// Liquid; stays so while cooling until it is solid again.
    pub const LIQUID: u8 = 1;
    /// Melting for the first time, not yet liquid.
    pub const MUSHY: u8 = 2;
    /// Solid again after having been liquid.
    pub const REFROZEN: u8 = 3;
}

/// Parameters of the return map of one point (simulation.md §5.2); the bulk modulus is the material's, in both phases.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct LawParameters {
    /// Shear modulus μ \[Pa\].
    pub mu: f32,
    /// Uniaxial yield stress σ_Y \[Pa\]; infinite = elastic.
    pub yield_stress: f32,
    /// Viscosity η of the return map \[Pa·sʰ\].
    pub viscosity: f32,
    /// Flow exponent h.
    pub exponent: f32,
}

/// Constants of the phase rule that no material carries.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PhaseOptions {
    /// Width of the switch in temperature where there is no latent heat \[K\], ≥ 0.
    pub delta_t: f64,
    /// Liquid fraction at which a point counts as liquid.
    pub f_up: f64,
    /// Liquid fraction at which a liquid point counts as solid again.
    pub f_dn: f64,
    /// Liquid fraction below which the solid skeleton carries everything.
    pub coherency: f64,
    /// Share χ of the deviatoric stress that survives binary freezing, 0–1.
    pub frozen_stress: f64,
}

impl Default for PhaseOptions {
    fn default() -> Self {
        Self { delta_t: 1.0, f_up: 0.9, f_dn: 0.1, coherency: 0.3, frozen_stress: 0.0 }
    }
}

/// Result of [`PhaseRule::update`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PhaseUpdate {
    /// The law until the next update.
    pub law: LawParameters,
    /// The new phase byte.
    pub phase: u8,
    /// Factor for the deviatoric Hencky strain; 1 = leave F alone, else apply [`scale_deviator`].
    pub strain_factor: f32,
    /// The point has just become solid: reset its accumulated plastic quantities.
    pub frozen: bool,
}

/// μ must rise by this fraction before F is touched; until then the old μ stays in force.
const RISE: f32 = 1e-3;

/// Finite stand-in for the yield stress of an elastic solid, as a fraction of Young's modulus (§5.5).
const SOLID_YIELD: f64 = 0.05;

/// Yield stresses are blended in logarithms down to this fraction of the solid's; a fully liquid point has its own value.
const YIELD_FLOOR: f64 = 1e-4;

/// Smallest stiffness left by softening, and the range of the melt's viscosity \[Pa·sʰ\] (§5.4).
const SOFTENING_FLOOR: f64 = 0.1;
const VISCOSITY_RANGE: [f64; 2] = [1e-4, 1e6];

/// The phase rule of one material, with everything that does not depend on the point worked out.
#[derive(Clone, Copy, Debug)]
pub struct PhaseRule {
    mode: PhaseMode,
    options: PhaseOptions,
    mu_s: f64,
    mu_l: f64,
    solid_yield: f64,
    /// Logarithms of the yield stresses at the ends of the blend.
    ln_yield: [f64; 2],
    melt_yield: f64,
    viscosity: f64,
    exponent: f64,
    arrhenius: f64,
    softening: f64,
    t_0: f64,
    t_s: f64,
    t_m: f64,
    /// Temperatures between which the fraction is taken from T instead of from the enthalpy, if L = 0 and the interval is
    /// too narrow.
    widened: Option<[f64; 2]>,
    never_melts: bool,
    no_latent_heat: bool,
    tables: Tables,
    /// Factor from the consistency κ to the viscosity η of the return map.
    eta_of_kappa: f64,
    /// A fluid is liquid from the start, whatever its temperature.
    fluid: bool,
}

impl PhaseRule {
    /// The rule of `material`.
    pub fn new(material: &Material, options: &PhaseOptions) -> Self {
        let (mu_s, k) = (material.shear_modulus, material.bulk_modulus);
        let young = 9.0 * k * mu_s / (3.0 * k + mu_s);
        let (melt_yield, viscosity, exponent) = material.melt.return_map_constants();
        let start = if material.solid_yield_stress.is_finite() { material.solid_yield_stress } else { SOLID_YIELD * young };
        let t_m = material.melting_point();
        let fluid = material.law == Law::Fluid;
        let (viscosity, exponent) = match material.law {
            Law::Hencky => (viscosity, exponent),
            Law::Fluid => (material.fluid_viscosity, TAIT_EXPONENT),
            _ => (0.0, 1.0),
        };
        // Only the Hencky law has a melt.
        let never_melts = material.law != Law::Hencky || !material.solidus.is_finite() && material.phase_mode != PhaseMode::InitMelted;
        let narrow = material.latent_heat == 0.0 && material.liquidus - material.solidus < options.delta_t;
        Self {
            mode: material.phase_mode,
            options: *options,
            mu_s: if fluid { 0.0 } else { mu_s },
            mu_l: if never_melts { 0.0 } else { material.melt_shear_modulus },
            solid_yield: material.solid_yield_stress,
            ln_yield: [start.ln(), melt_yield.max(YIELD_FLOOR * start).ln()],
            melt_yield,
            viscosity,
            exponent,
            arrhenius: material.arrhenius_k,
            softening: material.softening,
            t_0: material.reference_temperature,
            t_s: material.solidus,
            t_m,
            widened: narrow.then_some([t_m - 0.5 * options.delta_t, t_m + 0.5 * options.delta_t]),
            never_melts,
            no_latent_heat: material.latent_heat == 0.0,
            tables: material.tables,
            eta_of_kappa: 2f64.powf(0.5 * (1.0 + exponent)),
            fluid,
        }
    }

    /// Phase byte of a new point at liquid fraction `f_l`.
    pub fn initial_phase(&self, t: f64, f_l: f64) -> u8 {
        match self.mode {
            _ if self.fluid => state::LIQUID,
            _ if self.never_melts => state::SOLID,
            PhaseMode::InitMelted => state::LIQUID,
            _ => self.next_phase(t, self.fraction(t, f_l), state::SOLID),
        }
    }

    /// Law of a new point: [`PhaseRule::update`] without a past.
    pub fn initial_law(&self, t: f64, f_l: f64) -> LawParameters {
        self.law(t, self.fraction(t, f_l), self.initial_phase(t, f_l))
    }

    /// The law at temperature `t` \[K\] and liquid fraction `f_l` for a point that had phase byte `phase` and shear modulus
    /// `mu_old` \[Pa\]. Call once per coupling step.
    #[inline]
    pub fn update(&self, t: f64, f_l: f64, phase: u8, mu_old: f32) -> PhaseUpdate {
        let f = self.fraction(t, f_l);
        let next = match self.mode {
            _ if self.fluid => state::LIQUID,
            _ if self.never_melts => state::SOLID,
            PhaseMode::InitMelted => state::LIQUID,
            _ => self.next_phase(t, f, phase),
        };
        let mut law = self.law(t, f, next);
        let frozen = next == state::REFROZEN && phase != state::REFROZEN;
        let mut strain_factor = 1.0;
        if law.mu > mu_old * (1.0 + RISE) {
            strain_factor = mu_old / law.mu;
            if self.mode == PhaseMode::Binary && frozen {
                strain_factor *= self.options.frozen_stress as f32;
            }
        } else if law.mu > mu_old {
            law.mu = mu_old;
        }
        PhaseUpdate { law, phase: next, strain_factor, frozen }
    }

    /// The fraction that the rule works with.
    #[inline(always)]
    fn fraction(&self, t: f64, f_l: f64) -> f64 {
        match self.widened {
            Some([lo, hi]) if hi > lo => ((t - lo) / (hi - lo)).clamp(0.0, 1.0),
            Some([lo, _]) => f64::from(u8::from(t >= lo)),
            None => f_l,
        }
    }

    fn next_phase(&self, t: f64, f: f64, phase: u8) -> u8 {
        let PhaseOptions { delta_t, f_up, f_dn, .. } = self.options;
        let switch_by_t = self.mode == PhaseMode::Binary && self.no_latent_heat;
        let melted = if switch_by_t { t >= self.t_m + 0.5 * delta_t } else { f >= f_up };
        // Strictly below for a switch without width, so that melting wins at T_m itself.
        let solid = if switch_by_t { t <= self.t_m - 0.5 * delta_t && !melted } else { f <= f_dn };
        match phase {
            state::LIQUID if solid => state::REFROZEN,
            state::LIQUID => state::LIQUID,
            _ if melted => state::LIQUID,
            state::REFROZEN => state::REFROZEN,
            _ if self.mode == PhaseMode::Mushy && f > 0.0 => state::MUSHY,
            _ => state::SOLID,
        }
    }

    #[inline]
    fn law(&self, t: f64, f: f64, phase: u8) -> LawParameters {
        // Share of the way from solid to liquid.
        let s = match self.mode {
            _ if self.never_melts => 0.0,
            PhaseMode::InitMelted => 1.0,
            PhaseMode::Binary => f64::from(u8::from(phase == state::LIQUID)),
            PhaseMode::Mushy => ((f - self.options.coherency) / (1.0 - self.options.coherency)).clamp(0.0, 1.0),
        };
        let solid_yield = || self.solid_yield * self.tables.solid_yield.at(t).unwrap_or(1.0);
        let melt_yield = || self.tables.melt_yield.at(t).map_or(self.melt_yield, |tau| 3f64.sqrt() * tau);
        let (mu, yield_stress) = if s <= 0.0 {
            (self.softened(t), solid_yield())
        } else if s >= 1.0 {
            (self.mu_l, melt_yield())
        } else {
            let solid = self.softened(t);
            let mu = solid * (self.mu_l.min(solid) / solid).powf(s);
            let mut ends = self.ln_yield;
            if !self.tables.solid_yield.is_empty() || !self.tables.melt_yield.is_empty() {
                let start = if self.solid_yield.is_finite() { solid_yield() } else { self.ln_yield[0].exp() };
                ends = [start.ln(), melt_yield().max(YIELD_FLOOR * start).ln()];
            }
            (mu, (ends[0] + s * (ends[1] - ends[0])).exp())
        };
        LawParameters {
            mu: mu as f32,
            yield_stress: yield_stress as f32,
            viscosity: self.viscosity(t, s) as f32,
            exponent: self.exponent as f32,
        }
    }

    /// Viscosity of the return map at `t`, or of a fluid.
    #[inline(always)]
    fn viscosity(&self, t: f64, s: f64) -> f64 {
        if self.fluid || self.viscosity == 0.0 {
            return self.viscosity;
        }
        let eta = match self.tables.melt_consistency.at(t) {
            Some(kappa) => kappa * self.eta_of_kappa,
            None if self.arrhenius == 0.0 || s == 0.0 && self.solid_yield.is_infinite() => self.viscosity,
            None => self.viscosity * (self.arrhenius * (1.0 / t - 1.0 / self.t_m)).exp(),
        };
        eta.clamp(VISCOSITY_RANGE[0], VISCOSITY_RANGE[1])
    }

    /// Liquid fraction for the mechanics (sticking, output): that of the heat, and one for a fluid.
    #[inline(always)]
    pub fn liquid(&self, f_l: f64) -> f64 {
        if self.fluid { 1.0 } else { f_l }
    }

    /// Shear modulus of the solid at `t`; never below the melt's.
    #[inline(always)]
    fn softened(&self, t: f64) -> f64 {
        if let Some(share) = self.tables.stiffness.at(t) {
            return (self.mu_s * share).max(self.mu_l);
        }
        if self.softening == 0.0 || t <= self.t_0 || self.t_s <= self.t_0 || !self.t_s.is_finite() {
            return self.mu_s;
        }
        let way = ((t - self.t_0) / (self.t_s - self.t_0)).min(1.0);
        (self.mu_s * (1.0 - self.softening * way).max(SOFTENING_FLOOR)).max(self.mu_l)
    }
}

/// Largest relative change of a reference volume in one coupling step; what phase and heat ask for beyond it waits for the next.
const SWELL: f64 = 5e-3;

/// The reference volume \[m³\] of a point of `mass` \[kg\] that had `volume`, at liquid fraction `f_l` and temperature `t` \[K\], and
/// the factor for its gradient: `V⁰ ← m/ρ(f_l, T)`, `F ← (V⁰_old/V⁰_new)^{1/3} F` (simulation.md §5.3). The space it takes does not
/// change at once; the pressure that arises makes it swell or shrink. `None` if there is nothing to do.
///
/// Density change at melting and thermal expansion are one rule: both change the stress-free volume. The design divides F by
/// `(1 + β_V ΔT)^{1/3}` when stress is evaluated; with V⁰ carrying the factor instead, nothing has to be done per substep.
pub fn swell(material: &Material, mass: f32, volume: f32, f_l: f64, t: f64) -> Option<(f32, f32)> {
    if mass <= 0.0 {
        return None;
    }
    let (mass, old) = (f64::from(mass), f64::from(volume));
    let ratio = (mass * material.specific_volume(f_l, t) / old).clamp(1.0 - SWELL, 1.0 + SWELL);
    // Far below what anybody could see, far above rounding.
    if (ratio - 1.0).abs() < 1e-6 { None } else { Some(((old * ratio) as f32, (1.0 / ratio).cbrt() as f32)) }
}

/// Scales the deviatoric Hencky strain of `f` by `factor`, keeping its volume ratio and both rotations of its SVD.
///
/// Returns the new F and `B = F_after⁻¹ F_before`, by which the rebase matrix of the point is to be multiplied from the left
/// so that the shape seen by the splats does not jump: `F_after · B = F_before` (§5.6, §7.5).
pub fn scale_deviator<T: Real>(f: Mat3<T>, factor: T) -> (Mat3<T>, Mat3<T>) {
    let d = svd::svd(mat3::cast::<T, f64>(f));
    let strain = d.s.map(|s| s.max(0.05).ln());
    let mean = (strain[0] + strain[1] + strain[2]) / 3.0;
    let removed = strain.map(|e| (e - mean) * (1.0 - factor.f64()));
    let after: [f64; 3] = std::array::from_fn(|a| (strain[a] - removed[a]).exp());
    let b = mat3::mul(mat3::mul(d.v, mat3::diag(removed.map(f64::exp))), mat3::transpose(d.v));
    (mat3::cast(d.with_values(after)), mat3::cast(b))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::thermal::enthalpy::tests::wax;

    fn rule(mode: PhaseMode, change: impl Fn(&mut Material)) -> PhaseRule {
        let mut m = Material { phase_mode: mode, ..wax() };
        change(&mut m);
        PhaseRule::new(&m, &PhaseOptions::default())
    }

    #[test]
    fn mushy_blend_is_continuous_monotone_and_ends_at_the_laws() {
        let r = rule(PhaseMode::Mushy, |_| {});
        let m = wax();
        let at = |f: f64| r.law(325.0 + 5.0 * f, f, state::SOLID);
        assert_eq!(at(0.2).mu, m.shear_modulus as f32);
        assert_eq!(at(0.2).yield_stress, f32::INFINITY);
        assert_eq!(at(1.0).mu, m.melt_shear_modulus as f32);
        assert!((f64::from(at(1.0).yield_stress) - 3f64.sqrt() * 10.0).abs() < 1e-5);
        assert!((f64::from(at(0.65).mu) - (4e4f64 * 1e4).sqrt()).abs() < 1.0, "half way is the geometric mean");
        let mut last = at(0.3001);
        for i in 1..1000 {
            let now = at(0.3001 + 0.6998 * f64::from(i) / 999.0);
            assert!(now.mu <= last.mu && now.mu > 0.99 * last.mu);
            assert!(now.yield_stress <= last.yield_stress && now.yield_stress > 0.98 * last.yield_stress);
            last = now;
        }
    }

    #[test]
    fn binary_rule_has_hysteresis_and_toggles_once_per_pass() {
        for latent in [2e5, 0.0] {
            let r = rule(PhaseMode::Binary, |m| m.latent_heat = latent);
            let (mut phase, mut mu, mut toggles) = (state::SOLID, 4e4f32, 0);
            let mut seen = Vec::new();
            for i in 0..400 {
                // Up and down once, with a wobble that would make a plain threshold chatter.
                let way = 1.0 - (f64::from(i) / 200.0 - 1.0).abs();
                let f = (1.4 * way - 0.2 + 0.04 * f64::from(i % 3)).clamp(0.0, 1.0);
                let u = r.update(325.0 + 5.0 * f, f, phase, mu);
                toggles += usize::from((u.phase == state::LIQUID) != (phase == state::LIQUID));
                if u.phase != phase {
                    seen.push(u.phase);
                }
                (phase, mu) = (u.phase, u.law.mu);
            }
            assert_eq!((toggles, seen), (2, vec![state::LIQUID, state::REFROZEN]), "L = {latent}");
        }
    }

    #[test]
    fn phase_byte_tells_the_history() {
        let r = rule(PhaseMode::Mushy, |_| {});
        let mut phase = state::SOLID;
        let seen: Vec<u8> = [0.0, 0.5, 0.0, 0.5, 0.95, 0.5, 0.05, 0.5, 0.95]
            .iter()
            .map(|f| {
                phase = r.update(327.0, *f, phase, 1e4).phase;
                phase
            })
            .collect();
        assert_eq!(seen, [0, 2, 0, 2, 1, 1, 3, 3, 1]);
        assert_eq!(rule(PhaseMode::InitMelted, |_| {}).initial_phase(100.0, 0.0), state::LIQUID);
        let solid = rule(PhaseMode::Mushy, |m| (m.solidus, m.liquidus) = (f64::INFINITY, f64::INFINITY));
        let u = solid.update(5000.0, 0.0, state::SOLID, 4e4);
        assert_eq!((u.phase, u.law.mu, u.strain_factor), (state::SOLID, 4e4, 1.0));
    }

    #[test]
    fn softening_and_arrhenius() {
        let r = rule(PhaseMode::Mushy, |m| (m.softening, m.arrhenius_k) = (0.5, 5000.0));
        assert_eq!(r.law(293.15, 0.0, 0).mu, 4e4);
        assert!((r.law(325.0, 0.0, 0).mu - 2e4).abs() < 1.0);
        let eta = |t: f64| f64::from(r.law(t, 1.0, 1).viscosity);
        assert!((eta(340.0) / eta(360.0) - (5000.0 * (1.0 / 340.0 - 1.0 / 360.0_f64)).exp()).abs() < 1e-5);
        // Without latent heat and without an interval the switch still has a width.
        let sharp = rule(PhaseMode::Mushy, |m| (m.latent_heat, m.liquidus) = (0.0, 325.0));
        assert!(sharp.law(325.2, sharp.fraction(325.2, 1.0), 0).mu < 4e4);
        assert!(sharp.law(325.2, sharp.fraction(325.2, 1.0), 0).mu > 1e4);
    }

    #[test]
    fn tables_take_the_place_of_softening_and_arrhenius() {
        let linear = |e: &[[f64; 2]]| crate::table::Table::linear(e).unwrap();
        let log = |e: &[[f64; 2]]| crate::table::Table::log_linear(e).unwrap();
        let r = rule(PhaseMode::Mushy, |m| {
            m.softening = 0.5;
            m.solid_yield_stress = 2e3;
            m.tables.stiffness = linear(&[[300.0, 1.0], [320.0, 0.5]]);
            m.tables.solid_yield = linear(&[[300.0, 1.0], [320.0, 0.2]]);
            m.tables.melt_yield = log(&[[330.0, 10.0], [350.0, 0.1]]);
            m.tables.melt_consistency = log(&[[330.0, 4.0], [350.0, 1.0]]);
        });
        assert!((r.law(310.0, 0.0, 0).mu - 3e4).abs() < 1.0 && (r.law(310.0, 0.0, 0).yield_stress - 1.2e3).abs() < 0.1);
        let melt = r.law(340.0, 1.0, 1);
        assert!((f64::from(melt.yield_stress) - 3f64.sqrt()).abs() < 1e-4);
        assert!((f64::from(melt.viscosity) - 2.0 * 2f64.powf(0.9)).abs() < 1e-4);
        // Through the mush the yield stress stays continuous.
        assert!((r.law(330.0, 0.9999, 1).yield_stress / r.law(330.0, 1.0, 1).yield_stress - 1.0).abs() < 1e-2);
    }

    #[test]
    fn laws_without_a_melt_keep_their_parameters_at_any_temperature() {
        let law = |law: Law| rule(PhaseMode::Mushy, |m| (m.law, m.fluid_viscosity, m.softening) = (law, 0.7, 0.5));
        let metal = law(Law::VonMises).update(5000.0, 1.0, state::SOLID, 4e4);
        assert_eq!((metal.phase, metal.law.viscosity, metal.law.exponent, metal.strain_factor), (state::SOLID, 0.0, 1.0, 1.0));
        let water = law(Law::Fluid);
        assert_eq!((water.initial_phase(10.0, 0.0), water.liquid(0.0)), (state::LIQUID, 1.0));
        let w = water.update(10.0, 0.0, state::LIQUID, 0.0).law;
        assert_eq!((w.mu, w.viscosity, w.exponent), (0.0, 0.7, 7.0));
    }

    #[test]
    fn reference_volumes_follow_phase_and_heat_in_small_steps() {
        let m = Material { melt_density: Some(1000.0), expansion: 1e-3, ..wax() };
        let (mass, mut volume) = (0.9f32, 1e-3f32);
        assert_eq!(swell(&m, mass, volume, 0.0, 293.15), None);
        let mut f = 1.0f64;
        let mut steps = 0;
        while let Some((v, factor)) = swell(&m, mass, volume, 1.0, 343.15) {
            assert!((f64::from(v / volume) - 1.0).abs() <= 5.001e-3);
            (volume, f, steps) = (v, f * f64::from(factor), steps + 1);
        }
        // 10 % smaller by melting, 5 % larger by heat.
        assert!((f64::from(volume) / (0.9e-3 * 1.05) - 1.0).abs() < 2e-6, "{volume}");
        assert!((f.powi(3) * f64::from(volume) / 1e-3 - 1.0).abs() < 1e-5, "the space taken stays: V⁰ det F");
        assert!(steps > 5);
        assert_eq!(swell(&m, 0.0, volume, 0.0, 293.15), None, "tracers have no volume");
    }

    #[test]
    fn rising_stiffness_rescales_the_strain_and_tiny_rises_wait() {
        let r = rule(PhaseMode::Mushy, |_| {});
        let up = r.update(326.0, 0.35, state::LIQUID, 1e4);
        assert!(up.law.mu > 1e4 && (up.strain_factor * up.law.mu - 1e4).abs() < 1.0);
        let wait = r.update(326.0, 0.0, state::SOLID, 4e4 * 0.9995);
        assert_eq!((wait.strain_factor, wait.law.mu), (1.0, 4e4 * 0.9995));
        let b = rule(PhaseMode::Binary, |_| {}).update(300.0, 0.0, state::LIQUID, 1e4);
        assert_eq!((b.strain_factor, b.frozen, b.law.mu), (0.0, true, 4e4));
    }
}
