//! Enthalpy, temperature and liquid fraction of one material, and of several materials in one node (simulation.md §3.1).

use crate::material::Material;

/// The piecewise linear relation between specific enthalpy \[J/kg\] and temperature \[K\] of one material. Enthalpy is zero
/// for the solid at the reference temperature (extrapolated where the solid does not exist there).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EnthalpyCurve {
    t_ref: f64,
    c_s: f64,
    c_l: f64,
    t_s: f64,
    t_l: f64,
    h_s: f64,
    h_l: f64,
}

impl EnthalpyCurve {
    /// The curve of `material` with zero enthalpy at `t_ref` \[K\]. `T_l = T_s`, `L = 0` and an infinite solidus are legal.
    pub fn new(material: &Material, t_ref: f64) -> Self {
        let (c_s, c_l) = (material.heat_capacity_solid, material.heat_capacity_liquid);
        let (t_s, t_l) = (material.solidus, material.liquidus);
        let h_s = c_s * (t_s - t_ref);
        let h_l = if t_s.is_finite() { h_s + material.latent_heat + 0.5 * (c_s + c_l) * (t_l - t_s) } else { f64::INFINITY };
        Self { t_ref, c_s, c_l, t_s, t_l, h_s, h_l }
    }

    /// Temperature \[K\] at specific enthalpy `h` \[J/kg\].
    #[inline]
    pub fn temperature(&self, h: f64) -> f64 {
        if h <= self.h_s {
            self.t_ref + h / self.c_s
        } else if h < self.h_l {
            self.t_s + (h - self.h_s) / (self.h_l - self.h_s) * (self.t_l - self.t_s)
        } else {
            self.t_l + (h - self.h_l) / self.c_l
        }
    }

    /// Specific enthalpy \[J/kg\] at temperature `t` \[K\]; on the isothermal plateau `T_s = T_l` the solid's end.
    #[inline]
    pub fn enthalpy(&self, t: f64) -> f64 {
        if t <= self.t_s {
            self.c_s * (t - self.t_ref)
        } else if t < self.t_l {
            self.h_s + (t - self.t_s) / (self.t_l - self.t_s) * (self.h_l - self.h_s)
        } else {
            self.h_l + self.c_l * (t - self.t_l)
        }
    }

    /// Temperature \[K\] of `mass` \[kg\] that shares `energy` \[J\] with something of heat capacity `air` \[J/K\] whose energy is
    /// zero at the reference temperature.
    #[inline]
    pub(crate) fn temperature_with(&self, mass: f64, air: f64, energy: f64) -> f64 {
        let start = mass * self.h_s + air * (self.t_s - self.t_ref);
        if energy <= start || start.is_nan() {
            return self.t_ref + energy / (mass * self.c_s + air);
        }
        let end = mass * self.h_l + air * (self.t_l - self.t_ref);
        if energy < end {
            self.t_s + (energy - start) / (end - start) * (self.t_l - self.t_s)
        } else {
            self.t_l + (energy - end) / (mass * self.c_l + air)
        }
    }

    /// Liquid mass fraction in `[0, 1]` at specific enthalpy `h` \[J/kg\].
    #[inline]
    pub fn liquid_fraction(&self, h: f64) -> f64 {
        if h <= self.h_s {
            0.0
        } else if h < self.h_l {
            (h - self.h_s) / (self.h_l - self.h_s)
        } else {
            1.0
        }
    }

    /// Specific heat \[J/(kg·K)\] that the transfers use at enthalpy `h`: solid, liquid, or their mean while melting (§3.3).
    #[inline]
    pub fn heat_capacity(&self, h: f64) -> f64 {
        if h <= self.h_s {
            self.c_s
        } else if h < self.h_l {
            0.5 * (self.c_s + self.c_l)
        } else {
            self.c_l
        }
    }

    /// Enthalpies at which melting starts and ends \[J/kg\]; infinite for a material that never melts.
    pub fn melting_interval(&self) -> (f64, f64) {
        (self.h_s, self.h_l)
    }

    /// Enthalpy just before (`false`) or just after (`true`) anything that happens isothermally at `t`.
    fn side(&self, t: f64, after: bool) -> f64 {
        if after && t == self.t_l { self.h_l } else { self.enthalpy(t) }
    }

    /// Specific heat above `t`, not counting melting.
    fn slope_above(&self, t: f64) -> f64 {
        if t < self.t_l { self.c_s } else { self.c_l }
    }
}

/// Exact enthalpy curve of a mixture that shares one temperature: total enthalpy `Σ m_k h_k(T)` inverted piece by piece.
///
/// The design averages the constants of the materials in a node; the exact inversion costs the same in the few nodes where
/// it is needed and does not invent a melting point between those of the components.
#[derive(Clone, Debug, Default)]
pub(crate) struct MixtureCurve {
    /// Temperatures at which some component starts or ends melting, ascending.
    breaks: Vec<f64>,
}

impl MixtureCurve {
    /// Prepares the breakpoints of `curves`.
    pub(crate) fn new(curves: &[EnthalpyCurve]) -> Self {
        let mut breaks: Vec<f64> = curves.iter().flat_map(|c| [c.t_s, c.t_l]).filter(|t| t.is_finite()).collect();
        breaks.sort_by(f64::total_cmp);
        breaks.dedup();
        Self { breaks }
    }

    /// Temperature \[K\] of masses `mass[k]` \[kg\] of materials `curves[k]` holding `energy` \[J\] together, and the
    /// liquid fraction each component has on an isothermal plateau (elsewhere it follows from the temperature).
    pub(crate) fn temperature(&self, curves: &[EnthalpyCurve], mass: &[f64], energy: f64) -> (f64, f64) {
        let total =
            |t: f64, after: bool| curves.iter().zip(mass).map(|(c, m)| if *m > 0.0 { m * c.side(t, after) } else { 0.0 }).sum::<f64>();
        let mut below: Option<(f64, f64)> = None;
        for &t in &self.breaks {
            let lo = total(t, false);
            if energy <= lo {
                return match below {
                    Some((t0, e0)) => (t0 + (energy - e0) / (lo - e0) * (t - t0), 0.0),
                    None => (t + (energy - lo) / mass.iter().zip(curves).map(|(m, c)| m * c.c_s).sum::<f64>(), 0.0),
                };
            }
            let hi = total(t, true);
            if energy < hi {
                return (t, (energy - lo) / (hi - lo));
            }
            below = Some((t, hi));
        }
        match below {
            Some((t, e)) => (t + (energy - e) / mass.iter().zip(curves).map(|(m, c)| m * c.slope_above(t)).sum::<f64>(), 1.0),
            None => {
                let capacity = mass.iter().zip(curves).map(|(m, c)| m * c.c_s).sum::<f64>();
                let reference = mass.iter().zip(curves).map(|(m, c)| m * c.c_s * c.t_ref).sum::<f64>();
                ((energy + reference) / capacity, 0.0)
            }
        }
    }

    /// Liquid fraction of component `curve` at the mixture's temperature `t` and plateau fraction.
    pub(crate) fn fraction(curve: &EnthalpyCurve, t: f64, plateau: f64) -> f64 {
        if t == curve.t_s && t == curve.t_l { plateau } else { curve.liquid_fraction(curve.enthalpy(t)) }
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::material::{Law, PhaseMode, Rheology};

    /// A wax-like material for tests.
    pub(crate) fn wax() -> Material {
        Material {
            name: "wax".into(),
            law: Law::Hencky,
            density: 900.0,
            shear_modulus: 4e4,
            bulk_modulus: 8e4,
            solid_yield_stress: f64::INFINITY,
            melt_shear_modulus: 1e4,
            melt: Rheology { yield_stress: 10.0, consistency: 1.0, index: 0.8 },
            arrhenius_k: 0.0,
            softening: 0.0,
            reference_temperature: 293.15,
            heat_capacity_solid: 2100.0,
            heat_capacity_liquid: 2300.0,
            conductivity_solid: 0.24,
            conductivity_liquid: 0.15,
            latent_heat: 2e5,
            solidus: 325.0,
            liquidus: 330.0,
            phase_mode: PhaseMode::Mushy,
            ..Material::default()
        }
    }

    fn variants() -> Vec<Material> {
        vec![
            wax(),
            Material { liquidus: 325.0, ..wax() },
            Material { latent_heat: 0.0, ..wax() },
            Material { latent_heat: 0.0, liquidus: 325.0, heat_capacity_liquid: 2100.0, ..wax() },
            Material { solidus: f64::INFINITY, liquidus: f64::INFINITY, ..wax() },
        ]
    }

    #[test]
    fn temperature_and_enthalpy_are_inverses_everywhere() {
        for m in variants() {
            for t_ref in [250.0, 293.15, 327.0, 400.0] {
                let c = EnthalpyCurve::new(&m, t_ref);
                for i in 0..400 {
                    let t = 200.0 + 0.5 * f64::from(i) + 0.123;
                    assert!((c.temperature(c.enthalpy(t)) - t).abs() < 1e-10, "{m:?} {t}");
                    // The other way round only off the plateau, where temperature alone does not tell the enthalpy.
                    let h = -3e5 + 2.5e3 * f64::from(i);
                    let flat = m.solidus == m.liquidus && c.temperature(h) == m.solidus;
                    if !flat {
                        assert!((c.enthalpy(c.temperature(h)) - h).abs() < 1e-6 * h.abs().max(1.0), "{m:?} {h}");
                    }
                }
                assert_eq!(c.enthalpy(t_ref.min(m.solidus)), c.c_s * (t_ref.min(m.solidus) - t_ref));
            }
        }
    }

    #[test]
    fn liquid_fraction_takes_the_latent_heat_on_the_plateau() {
        let c = EnthalpyCurve::new(&Material { liquidus: 325.0, ..wax() }, 300.0);
        let start = 2100.0 * 25.0;
        assert_eq!((c.liquid_fraction(start), c.temperature(start)), (0.0, 325.0));
        assert!((c.liquid_fraction(start + 5e4) - 0.25).abs() < 1e-12);
        assert_eq!(c.temperature(start + 1.9e5), 325.0);
        assert!((c.temperature(start + 2e5 + 2300.0) - 326.0).abs() < 1e-9);
    }

    #[test]
    fn mixture_inverts_the_sum_of_its_components() {
        let metal = Material { solidus: f64::INFINITY, liquidus: f64::INFINITY, heat_capacity_solid: 500.0, ..wax() };
        let ice = Material { solidus: 310.0, liquidus: 310.0, ..wax() };
        let curves: Vec<EnthalpyCurve> = [wax(), metal, ice].iter().map(|m| EnthalpyCurve::new(m, 293.15)).collect();
        let mix = MixtureCurve::new(&curves);
        let mass = [0.3, 0.5, 0.2];
        for i in 0..200 {
            let t = 280.0 + 0.4 * f64::from(i) + 0.05;
            let e: f64 = curves.iter().zip(mass).map(|(c, m)| m * c.enthalpy(t)).sum();
            assert!((mix.temperature(&curves, &mass, e).0 - t).abs() < 1e-9, "{t}");
        }
        let e: f64 = curves.iter().zip(mass).map(|(c, m)| m * c.enthalpy(310.0)).sum();
        let (t, f) = mix.temperature(&curves, &mass, e + 0.2 * 2e5 * 0.75);
        assert!(t == 310.0 && (f - 0.75).abs() < 1e-12);
        // One component alone is that component.
        let e = 1.7 * curves[0].enthalpy(327.0);
        assert!((mix.temperature(&curves, &[1.7, 0.0, 0.0], e).0 - 327.0).abs() < 1e-9);
    }
}
