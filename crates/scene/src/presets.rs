//! Material presets: typical literature values (simulation.md §10.3). Stiffness is not among them: it follows from the
//! object's size and the sag ratio (§2.5), because real moduli would cost millions of time steps and look the same.

use crate::material::Law;

/// The material of an object that names none.
pub const DEFAULT_MATERIAL: &str = "soft-wax";

/// The numbers of a material. Temperatures in °C, everything else in SI.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MaterialPreset {
    /// Name used in scene files.
    pub name: &'static str,
    /// One line for people.
    pub about: &'static str,
    /// Elastic law.
    pub law: Law,
    /// Density \[kg/m³\].
    pub density_kg_m3: f64,
    /// Poisson's ratio.
    pub poisson_ratio: f64,
    /// Specific heat of the solid \[J/(kg·K)\].
    pub heat_capacity_solid_j_kg_k: f64,
    /// Specific heat of the melt \[J/(kg·K)\].
    pub heat_capacity_liquid_j_kg_k: f64,
    /// Conductivity of the solid \[W/(m·K)\].
    pub conductivity_solid_w_m_k: f64,
    /// Conductivity of the melt \[W/(m·K)\].
    pub conductivity_liquid_w_m_k: f64,
    /// Latent heat \[J/kg\].
    pub latent_heat_j_kg: f64,
    /// Melting begins \[°C\]; infinite = never melts.
    pub solidus_c: f64,
    /// Melting ends \[°C\].
    pub liquidus_c: f64,
    /// Yield stress of the melt τ_0 \[Pa\].
    pub melt_yield_stress_pa: f64,
    /// Consistency of the melt κ \[Pa·sⁿ\].
    pub melt_consistency_pa_sn: f64,
    /// Flow index of the melt n.
    pub melt_flow_index: f64,
    /// Arrhenius constant of the melt's viscosity \[K\].
    pub arrhenius_k: f64,
    /// Sag ratio of its own; `None` = the scene's.
    pub sag_ratio: Option<f64>,
    /// Yield stress of the solid as a share of Young's modulus, where it yields at all.
    pub solid_yield_ratio: f64,
    /// Hardening modulus as a share of Young's modulus (von Mises).
    pub hardening_ratio: f64,
    /// Friction angle \[°\] (Drucker–Prager).
    pub friction_angle_deg: f64,
    /// Viscosity \[Pa·s\] (fluid).
    pub viscosity_pa_s: f64,
}

/// What most melting things share; the presets below change it.
const BASE: MaterialPreset = MaterialPreset {
    name: "",
    about: "",
    law: Law::Hencky,
    density_kg_m3: 1000.0,
    poisson_ratio: 0.3,
    heat_capacity_solid_j_kg_k: 2000.0,
    heat_capacity_liquid_j_kg_k: 2000.0,
    conductivity_solid_w_m_k: 0.25,
    conductivity_liquid_w_m_k: 0.25,
    latent_heat_j_kg: 0.0,
    solidus_c: 56.85,
    liquidus_c: 56.85,
    melt_yield_stress_pa: 20.0,
    melt_consistency_pa_sn: 5.0,
    melt_flow_index: 1.0,
    arrhenius_k: 0.0,
    sag_ratio: None,
    solid_yield_ratio: 0.05,
    hardening_ratio: 0.0,
    friction_angle_deg: 33.0,
    viscosity_pa_s: 0.001,
};

/// What things that never melt share.
const LASTING: MaterialPreset = MaterialPreset { solidus_c: f64::INFINITY, liquidus_c: f64::INFINITY, ..BASE };

const PRESETS: [MaterialPreset; 15] = [
    MaterialPreset { name: "soft-wax", about: "the default: melts at 57 °C at once, without latent heat, into a thick melt", ..BASE },
    MaterialPreset {
        name: "ice-cream",
        about: "half air; softens from -18 °C, runs at -1 °C, keeps some shape",
        density_kg_m3: 550.0, // 100 % overrun: half of its volume is air
        heat_capacity_solid_j_kg_k: 1900.0,
        heat_capacity_liquid_j_kg_k: 3000.0,
        conductivity_solid_w_m_k: 0.3,
        conductivity_liquid_w_m_k: 0.4,
        latent_heat_j_kg: 180e3,
        solidus_c: -18.15,
        liquidus_c: -1.15,
        melt_yield_stress_pa: 30.0,
        melt_consistency_pa_sn: 10.0,
        melt_flow_index: 0.5, // strongly shear-thinning
        ..BASE
    },
    MaterialPreset {
        name: "milk-chocolate",
        about: "27-34 °C, a smooth melt with a yield stress (the Casson melt fitted as Bingham)",
        density_kg_m3: 1300.0,
        heat_capacity_solid_j_kg_k: 1600.0,
        heat_capacity_liquid_j_kg_k: 1700.0,
        conductivity_solid_w_m_k: 0.26,
        conductivity_liquid_w_m_k: 0.26,
        latent_heat_j_kg: 45e3,
        solidus_c: 26.85,
        liquidus_c: 33.85,
        melt_yield_stress_pa: 12.0,
        melt_consistency_pa_sn: 3.0,
        ..BASE
    },
    MaterialPreset {
        name: "butter",
        about: "17-35 °C, slides and spreads",
        density_kg_m3: 911.0,
        heat_capacity_solid_j_kg_k: 2200.0,
        heat_capacity_liquid_j_kg_k: 2400.0,
        conductivity_solid_w_m_k: 0.2,
        conductivity_liquid_w_m_k: 0.2,
        latent_heat_j_kg: 70e3,
        solidus_c: 16.85,
        liquidus_c: 34.85,
        melt_yield_stress_pa: 20.0,
        melt_consistency_pa_sn: 2.0,
        melt_flow_index: 0.7,
        ..BASE
    },
    MaterialPreset {
        name: "paraffin-wax",
        about: "candle wax: 52-57 °C, a thin melt",
        density_kg_m3: 900.0,
        heat_capacity_solid_j_kg_k: 2100.0,
        heat_capacity_liquid_j_kg_k: 2200.0,
        conductivity_solid_w_m_k: 0.24,
        conductivity_liquid_w_m_k: 0.15,
        latent_heat_j_kg: 200e3,
        solidus_c: 51.85,
        liquidus_c: 56.85,
        melt_yield_stress_pa: 1.0,
        melt_consistency_pa_sn: 0.03,
        ..BASE
    },
    MaterialPreset {
        name: "water-ice",
        about: "0 °C sharp, much latent heat; the melt is thicker than water so that coarse grids resolve it",
        density_kg_m3: 917.0,
        heat_capacity_solid_j_kg_k: 2100.0,
        heat_capacity_liquid_j_kg_k: 4186.0,
        conductivity_solid_w_m_k: 2.2,
        conductivity_liquid_w_m_k: 0.58,
        latent_heat_j_kg: 334e3,
        solidus_c: 0.0,
        liquidus_c: 0.0,
        melt_yield_stress_pa: 0.0,
        melt_consistency_pa_sn: 0.5, // water: 0.0018
        ..BASE
    },
    MaterialPreset {
        name: "basaltic-lava",
        about: "1000-1177 °C, stiffens quickly when it cools",
        density_kg_m3: 2600.0,
        heat_capacity_solid_j_kg_k: 1200.0,
        heat_capacity_liquid_j_kg_k: 1200.0,
        conductivity_solid_w_m_k: 1.5,
        conductivity_liquid_w_m_k: 1.5,
        latent_heat_j_kg: 400e3,
        solidus_c: 999.85,
        liquidus_c: 1176.85,
        melt_yield_stress_pa: 300.0,
        melt_consistency_pa_sn: 300.0,
        arrhenius_k: 2.5e4,
        ..BASE
    },
    MaterialPreset {
        name: "gallium",
        about: "a metal that melts in the hand, 29.8 °C; the classic of melting validation",
        density_kg_m3: 6093.0,
        heat_capacity_solid_j_kg_k: 381.0,
        heat_capacity_liquid_j_kg_k: 381.0,
        conductivity_solid_w_m_k: 32.0,
        conductivity_liquid_w_m_k: 32.0,
        latent_heat_j_kg: 80.2e3,
        solidus_c: 29.78,
        liquidus_c: 29.78,
        melt_yield_stress_pa: 0.0,
        melt_consistency_pa_sn: 0.0019,
        ..BASE
    },
    MaterialPreset {
        name: "elastic",
        about: "rubber-like, never melts",
        law: Law::FixedCorotated,
        heat_capacity_solid_j_kg_k: 1500.0,
        heat_capacity_liquid_j_kg_k: 1500.0,
        conductivity_solid_w_m_k: 0.2,
        conductivity_liquid_w_m_k: 0.2,
        ..LASTING
    },
    MaterialPreset {
        name: "rubber",
        about: "nearly incompressible, springs back from large stretch, never melts",
        law: Law::NeoHookean,
        density_kg_m3: 1100.0,
        poisson_ratio: 0.45,
        heat_capacity_solid_j_kg_k: 1900.0,
        heat_capacity_liquid_j_kg_k: 1900.0,
        conductivity_solid_w_m_k: 0.16,
        conductivity_liquid_w_m_k: 0.16,
        ..LASTING
    },
    MaterialPreset {
        name: "jelly",
        about: "wobbles under its own weight, never melts",
        law: Law::FixedCorotated,
        density_kg_m3: 1050.0,
        poisson_ratio: 0.4,
        heat_capacity_solid_j_kg_k: 3900.0,
        heat_capacity_liquid_j_kg_k: 3900.0,
        conductivity_solid_w_m_k: 0.55,
        conductivity_liquid_w_m_k: 0.55,
        sag_ratio: Some(0.05),
        ..LASTING
    },
    MaterialPreset {
        name: "steel",
        about: "dents and stays dented (von Mises with hardening); stiffness and yield stress are visual, heat is real",
        law: Law::VonMises,
        density_kg_m3: 7850.0,
        heat_capacity_solid_j_kg_k: 490.0,
        heat_capacity_liquid_j_kg_k: 490.0,
        conductivity_solid_w_m_k: 50.0,
        conductivity_liquid_w_m_k: 50.0,
        solid_yield_ratio: 0.03,
        hardening_ratio: 0.1,
        ..LASTING
    },
    MaterialPreset {
        name: "modelling-clay",
        about: "keeps every dent (von Mises without hardening)",
        law: Law::VonMises,
        density_kg_m3: 1700.0,
        heat_capacity_solid_j_kg_k: 1200.0,
        heat_capacity_liquid_j_kg_k: 1200.0,
        conductivity_solid_w_m_k: 0.6,
        conductivity_liquid_w_m_k: 0.6,
        solid_yield_ratio: 0.015,
        ..LASTING
    },
    MaterialPreset {
        name: "sand",
        about: "dry, runs until its slope is 33 degrees (Drucker-Prager)",
        law: Law::DruckerPrager,
        density_kg_m3: 1600.0,
        heat_capacity_solid_j_kg_k: 830.0,
        heat_capacity_liquid_j_kg_k: 830.0,
        conductivity_solid_w_m_k: 0.3,
        conductivity_liquid_w_m_k: 0.3,
        ..LASTING
    },
    MaterialPreset {
        name: "water",
        about: "liquid from the start, whatever its temperature (for ice that melts see water-ice)",
        law: Law::Fluid,
        heat_capacity_solid_j_kg_k: 4186.0,
        heat_capacity_liquid_j_kg_k: 4186.0,
        conductivity_solid_w_m_k: 0.6,
        conductivity_liquid_w_m_k: 0.6,
        ..LASTING
    },
];

/// All presets, the default first.
pub fn material_presets() -> &'static [MaterialPreset] {
    &PRESETS
}

/// The preset of that name.
pub(crate) fn preset(name: &str) -> Option<&'static MaterialPreset> {
    PRESETS.iter().find(|p| p.name == name)
}
