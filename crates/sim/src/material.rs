//! What a material is: mechanical law of the solid, rheology of the melt, thermal properties (simulation.md §3.1, §5, §10.3).
//! Plain numbers in SI; presets, names and validation for people live in the scene crate.

use serde::{Deserialize, Serialize};

pub use crate::table::{Table, Tables};

/// Constitutive law (simulation.md §5.1, §5.2). Only [`Law::Hencky`] melts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Law {
    /// StVK with Hencky strain and Herschel–Bulkley flow: solid, mush and melt.
    Hencky,
    /// Fixed corotated elasticity; survives inversion.
    FixedCorotated,
    /// Compressible neo-Hookean elasticity, `τ = μ (b − I) + λ ln J I`.
    NeoHookean,
    /// Neo-Hookean elasticity split into shear and volume (Yue 2015), `τ = μ J^{−2/3} dev b + ½ K (J² − 1) I`.
    NeoHookeanSplit,
    /// Hencky elasticity with von Mises yield and linear hardening: metals, modelling clay.
    VonMises,
    /// Hencky elasticity with Drucker–Prager yield and volume correction: dry sand.
    DruckerPrager,
    /// Weakly compressible Newtonian fluid; keeps no shape at all.
    Fluid,
}

/// Rheometer constants of a melt in simple shear: `τ = τ_0 + κ γ̇ⁿ`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Rheology {
    /// Yield stress τ_0 \[Pa\], ≥ 0.
    pub yield_stress: f64,
    /// Consistency κ \[Pa·sⁿ\], > 0.
    pub consistency: f64,
    /// Flow index n, 0.2–2; 1 is Bingham or Newtonian.
    pub index: f64,
}

impl Rheology {
    /// The constants `(σ_Y, η, h)` of the return map (simulation.md §5.2): `σ_Y = √3 τ_0`, `h = n`, `η = κ 2^{(1+n)/2}`.
    pub fn return_map_constants(&self) -> (f64, f64, f64) {
        (3f64.sqrt() * self.yield_stress, self.consistency * 2f64.powf(0.5 * (1.0 + self.index)), self.index)
    }
}

/// How parameters follow the liquid fraction (simulation.md §5.5).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum PhaseMode {
    /// Parameters blend through the mushy zone (default).
    Mushy,
    /// Solid law below, liquid law above, with hysteresis.
    Binary,
    /// Always the liquid law (ablation).
    InitMelted,
}

/// A material in SI units.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Material {
    /// Name for messages.
    pub name: String,
    /// Elastic law.
    pub law: Law,
    /// Density ρ \[kg/m³\], > 0.
    pub density: f64,
    /// Shear modulus of the cold solid μ_s \[Pa\], > 0.
    pub shear_modulus: f64,
    /// Bulk modulus K \[Pa\], the same in both phases (simulation.md §5.3), > 0.
    pub bulk_modulus: f64,
    /// Uniaxial yield stress σ_Y of the solid \[Pa\]; infinite = purely elastic.
    pub solid_yield_stress: f64,
    /// Shear modulus of the melt μ_l \[Pa\], in (0, μ_s].
    pub melt_shear_modulus: f64,
    /// Flow of the melt.
    pub melt: Rheology,
    /// Arrhenius constant B of the melt's viscosity \[K\]; 0 = no dependence on temperature.
    pub arrhenius_k: f64,
    /// Loss of stiffness on the way to the solidus: E falls to `1 − softening` of its value; 0–0.9.
    pub softening: f64,
    /// Temperature at which the solid has its full stiffness \[K\] (start of the softening ramp).
    pub reference_temperature: f64,
    /// Specific heat of the solid c_s \[J/(kg·K)\], > 0.
    pub heat_capacity_solid: f64,
    /// Specific heat of the melt c_l \[J/(kg·K)\], > 0.
    pub heat_capacity_liquid: f64,
    /// Conductivity of the solid k_s \[W/(m·K)\], > 0.
    pub conductivity_solid: f64,
    /// Conductivity of the melt k_l \[W/(m·K)\], > 0.
    pub conductivity_liquid: f64,
    /// Latent heat L \[J/kg\], ≥ 0.
    pub latent_heat: f64,
    /// Solidus T_s \[K\]; infinite = never melts.
    pub solidus: f64,
    /// Liquidus T_l ≥ T_s \[K\].
    pub liquidus: f64,
    /// Phase rule.
    pub phase_mode: PhaseMode,
    /// Hardening modulus H of [`Law::VonMises`] \[Pa\], ≥ 0: the yield stress grows by H per unit of plastic strain.
    pub hardening: f64,
    /// Friction angle φ of [`Law::DruckerPrager`] \[rad\], 0–1.2.
    pub friction_angle: f64,
    /// Viscosity μ_v of [`Law::Fluid`] \[Pa·s\], ≥ 0.
    pub fluid_viscosity: f64,
    /// Density of the melt \[kg/m³\]; `None` = that of the solid, so that melting changes no volume (simulation.md §5.3).
    pub melt_density: Option<f64>,
    /// Volumetric thermal expansion β_V \[1/K\] from the reference temperature on; 0 = none.
    pub expansion: f64,
    /// Parameters that follow temperature.
    pub tables: Tables,
}

impl Default for Material {
    /// A plain wax without latent heat, for tests and as a base for literals.
    fn default() -> Self {
        let (shear_modulus, bulk_modulus) = Self::moduli(4e4, 0.3);
        Self {
            name: "wax".into(),
            law: Law::Hencky,
            density: 1000.0,
            shear_modulus,
            bulk_modulus,
            solid_yield_stress: f64::INFINITY,
            melt_shear_modulus: shear_modulus,
            melt: Rheology { yield_stress: 20.0, consistency: 5.0, index: 1.0 },
            arrhenius_k: 0.0,
            softening: 0.0,
            reference_temperature: 293.15,
            heat_capacity_solid: 2000.0,
            heat_capacity_liquid: 2000.0,
            conductivity_solid: 0.25,
            conductivity_liquid: 0.25,
            latent_heat: 0.0,
            solidus: f64::INFINITY,
            liquidus: f64::INFINITY,
            phase_mode: PhaseMode::Mushy,
            hardening: 0.0,
            friction_angle: 0.0,
            fluid_viscosity: 0.0,
            melt_density: None,
            expansion: 0.0,
            tables: Tables::default(),
        }
    }
}

impl Material {
    /// Melting point: the middle of the mushy interval \[K\].
    pub fn melting_point(&self) -> f64 {
        0.5 * (self.solidus + self.liquidus)
    }

    /// Elastic wave speed of the cold solid, `√((K + 4μ/3)/ρ)` \[m/s\].
    pub fn wave_speed(&self) -> f64 {
        ((self.bulk_modulus + 4.0 / 3.0 * self.shear_modulus) / self.density).sqrt()
    }

    /// Specific volume \[m³/kg\] at liquid fraction `f_l` and temperature `t` \[K\]: what phase and heat alone make of the volume,
    /// without pressure (simulation.md §5.3).
    pub fn specific_volume(&self, f_l: f64, t: f64) -> f64 {
        let solid = 1.0 / self.density;
        let melt = self.melt_density.map_or(solid, |d| 1.0 / d);
        let growth = if self.expansion == 0.0 { 1.0 } else { (1.0 + self.expansion * (t - self.reference_temperature)).clamp(0.5, 2.0) };
        (solid + f_l * (melt - solid)) * growth
    }

    /// True where [`Material::specific_volume`] is not constant.
    pub fn changes_volume(&self) -> bool {
        self.expansion != 0.0 || self.melt_density.is_some_and(|d| d != self.density)
    }

    /// Slope α_f of the Drucker–Prager cone, `√2 tan φ/3`: in simple shear the material slides at τ = p tan φ, so that a heap stands at φ.
    /// The design's cone, `√(2/3) · 2 sin φ/(3 − sin φ)`, meets Mohr–Coulomb in triaxial compression instead and is a fifth stronger in
    /// shear: sand of 31° would rest at 36°.
    pub fn friction_slope(&self) -> f64 {
        2f64.sqrt() * self.friction_angle.tan() / 3.0
    }

    /// The same material with its thermal clock running `factor` times faster (A_th, simulation.md §3.8).
    pub fn accelerated(&self, factor: f64) -> Self {
        Self {
            heat_capacity_solid: self.heat_capacity_solid / factor,
            heat_capacity_liquid: self.heat_capacity_liquid / factor,
            latent_heat: self.latent_heat / factor,
            ..self.clone()
        }
    }

    /// Shear and bulk modulus of Young's modulus `e` and Poisson's ratio `nu`.
    pub fn moduli(e: f64, nu: f64) -> (f64, f64) {
        (e / (2.0 * (1.0 + nu)), e / (3.0 * (1.0 - 2.0 * nu)))
    }
}
