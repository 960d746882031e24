//! Materials as people write them, and their resolution to the numbers the simulator needs (simulation.md §2.5, §5, §10.3).

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::CELSIUS_K;
use crate::presets::{DEFAULT_MATERIAL, preset};
use crate::settings::PhaseMode;

/// Constitutive law of the elastic response.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Law {
    /// StVK with Hencky strain; the only law that melts.
    #[default]
    Hencky,
    /// Fixed corotated: soft elastic bodies, robust when crushed.
    FixedCorotated,
    /// Neo-Hookean: rubber.
    NeoHookean,
    /// Neo-Hookean with shear and volume kept apart.
    NeoHookeanSplit,
    /// Elastic until it yields, then it hardens: metals, modelling clay.
    VonMises,
    /// Dry sand: friction, no cohesion.
    DruckerPrager,
    /// A liquid without any yield stress.
    Fluid,
}

impl Law {
    /// Its name in scene files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Hencky => "hencky",
            Self::FixedCorotated => "fixed_corotated",
            Self::NeoHookean => "neo_hookean",
            Self::NeoHookeanSplit => "neo_hookean_split",
            Self::VonMises => "von_mises",
            Self::DruckerPrager => "drucker_prager",
            Self::Fluid => "fluid",
        }
    }
}

/// A material of a scene file: a preset with changes. Keys left out keep the preset's value.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct MaterialSpec {
    /// The preset to start from (see `megas materials`); "soft-wax" if left out.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub preset: Option<String>,
    /// Constitutive law: "hencky" melts; "fixed_corotated", "neo_hookean", "neo_hookean_split" (elastic), "von_mises" (metals, clay),
    /// "drucker_prager" (sand) and "fluid" never do.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub law: Option<Law>,
    /// Density in kg/m³.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 1.0, max = 30000.0))]
    pub density_kg_m3: Option<f64>,
    /// Stiffness by how much an object sags under its own weight, as a share of its height, instead of `youngs_modulus_pa`.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0.0005, max = 0.1))]
    pub sag_ratio: Option<f64>,
    /// Young's modulus in Pa. Cost grows with its square root; real values of stiff things are out of reach, see `sag_ratio`.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 10.0, max = 1e10))]
    pub youngs_modulus_pa: Option<f64>,
    /// Poisson's ratio, 0–0.45.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0.0, max = 0.45))]
    pub poisson_ratio: Option<f64>,
    /// Uniaxial yield stress of the solid in Pa; default 5 % of Young's modulus.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0.0, max = 1e12))]
    pub solid_yield_stress_pa: Option<f64>,
    /// Hardening of "von_mises" in Pa: the yield stress grows by this per unit of plastic strain.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0.0, max = 1e12))]
    pub hardening_pa: Option<f64>,
    /// Friction angle of "drucker_prager" in degrees: the steepest slope of a heap. Dry sand 30–35.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0.0, max = 60.0))]
    pub friction_angle_deg: Option<f64>,
    /// Viscosity of "fluid" in Pa·s. Water 0.001, oil 0.1; thick ones cost time steps.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0.0, max = 1e3))]
    pub viscosity_pa_s: Option<f64>,
    /// Stiffness of the solid over temperature, [[°C, share of its cold value], …], at most 8 entries; in place of `softening`.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(length(min = 1, max = 8))]
    pub stiffness_table_c: Option<Vec<[f64; 2]>>,
    /// Yield stress of the solid over temperature, [[°C, share of its plain value], …], at most 8 entries.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(length(min = 1, max = 8))]
    pub solid_yield_table_c: Option<Vec<[f64; 2]>>,
    /// Yield stress of the melt over temperature, [[°C, Pa], …], at most 8 entries, logarithms in between.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(length(min = 1, max = 8))]
    pub melt_yield_stress_table_c_pa: Option<Vec<[f64; 2]>>,
    /// Consistency of the melt over temperature, [[°C, Pa·sⁿ], …], at most 8 entries, logarithms in between; in place of
    /// `arrhenius_k`.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(length(min = 1, max = 8))]
    pub melt_consistency_table_c_pa_sn: Option<Vec<[f64; 2]>>,
    /// Conductivity of solid and melt over temperature, [[°C, W/(m·K)], …], at most 8 entries.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(length(min = 1, max = 8))]
    pub conductivity_table_c_w_m_k: Option<Vec<[f64; 2]>>,
    /// Density of the melt in kg/m³, if melting is to change the volume: water over ice 1000, molten paraffin 790.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 1.0, max = 30000.0))]
    pub melt_density_kg_m3: Option<f64>,
    /// Thermal expansion of the volume in 1/K, counted from the temperature at the start; 0 (default) is none. Wax 7e-4, steel 4e-5.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0.0, max = 0.01))]
    pub volume_expansion_1_k: Option<f64>,
    /// Share of its stiffness that the solid loses on the way to the solidus, 0–0.9; default 0.5.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0.0, max = 0.9))]
    pub softening: Option<f64>,
    /// Temperature in °C where softening begins; default: the temperature at the start.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = -273.15, max = 5000.0))]
    pub softening_start_c: Option<f64>,
    /// Shear modulus of the melt as a share of the bulk modulus, 0.01–1; default 0.3.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0.01, max = 1.0))]
    pub melt_stiffness_ratio: Option<f64>,
    /// Yield stress τ_0 of the melt in Pa: what it carries without flowing. Cream 30, ketchup 15, water 0.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0.0, max = 1e6))]
    pub melt_yield_stress_pa: Option<f64>,
    /// Consistency κ of the melt in Pa·sⁿ; its viscosity in Pa·s where n = 1. Honey 5, water 0.001.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 1e-4, max = 1e6))]
    pub melt_consistency_pa_sn: Option<f64>,
    /// Flow index n of the melt, 0.2–2; below 1 it thins when sheared.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0.2, max = 2.0))]
    pub melt_flow_index: Option<f64>,
    /// Arrhenius constant B of the melt's viscosity in K: 0 for none, wax 2000–8000, lava 25000.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0.0, max = 1e5))]
    pub arrhenius_k: Option<f64>,
    /// Specific heat of the solid in J/(kg·K).
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 1.0, max = 1e5))]
    pub heat_capacity_solid_j_kg_k: Option<f64>,
    /// Specific heat of the melt in J/(kg·K).
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 1.0, max = 1e5))]
    pub heat_capacity_liquid_j_kg_k: Option<f64>,
    /// Conductivity of the solid in W/(m·K).
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 1e-3, max = 1e4))]
    pub conductivity_solid_w_m_k: Option<f64>,
    /// Conductivity of the melt in W/(m·K).
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 1e-3, max = 1e4))]
    pub conductivity_liquid_w_m_k: Option<f64>,
    /// Latent heat of melting in J/kg.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0.0, max = 1e7))]
    pub latent_heat_j_kg: Option<f64>,
    /// Melting point in °C; short for equal `solidus_c` and `liquidus_c`.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = -273.15, max = 5000.0))]
    pub melt_temperature_c: Option<f64>,
    /// Melting begins here, in °C.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = -273.15, max = 5000.0))]
    pub solidus_c: Option<f64>,
    /// Melting ends here, in °C; at least `solidus_c`.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = -273.15, max = 5000.0))]
    pub liquidus_c: Option<f64>,
    /// false: never melts, whatever the preset says.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub melts: Option<bool>,
}

/// What a material's numbers depend on besides the material itself.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MaterialContext {
    /// Height of the object H \[m\], > 0.
    pub object_height_m: f64,
    /// Gravity g \[m/s²\], ≥ 0; the visual stiffness uses 9.81 where it is zero.
    pub gravity_m_s2: f64,
    /// Sag ratio ε of the visual stiffness, 0.0005–0.1.
    pub sag_ratio: f64,
    /// Temperature of the surroundings T_∞ \[K\].
    pub ambient_k: f64,
    /// Temperature of the object at the start \[K\]; `None` = the default of [`ResolvedMaterial::initial_temperature_k`].
    pub initial_k: Option<f64>,
    /// The largest speed planned at load \[m/s\]: drop height, moving colliders; 0 for an object that only slumps.
    pub max_speed_m_s: f64,
    /// Phase rule.
    pub phase_mode: PhaseMode,
    /// Switching hysteresis δ \[K\].
    pub hysteresis_k: f64,
    /// False: melting takes no latent heat.
    pub latent_heat: bool,
    /// One specific heat for solids and melts of all materials \[J/(kg·K)\].
    pub uniform_heat_capacity: Option<f64>,
}

/// A contradiction in a material.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{key}: {message}")]
pub struct MaterialError {
    /// The key at fault.
    pub key: &'static str,
    /// What is wrong and what to do.
    pub message: String,
}

/// A material in SI units, number for number what the simulator takes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ResolvedMaterial {
    /// Name for messages.
    pub name: String,
    /// Elastic law.
    pub law: Law,
    /// Density ρ \[kg/m³\].
    pub density: f64,
    /// Young's modulus of the cold solid E* \[Pa\]; `shear_modulus` follows from it.
    pub youngs_modulus: f64,
    /// Shear modulus of the cold solid μ_s \[Pa\].
    pub shear_modulus: f64,
    /// Bulk modulus K \[Pa\], the same in both phases; at least what weak compressibility needs (simulation.md §5.3).
    pub bulk_modulus: f64,
    /// Uniaxial yield stress of the solid \[Pa\]; infinite = purely elastic.
    pub solid_yield_stress: f64,
    /// Shear modulus of the melt μ_l \[Pa\], ≤ μ_s.
    pub melt_shear_modulus: f64,
    /// Yield stress of the melt τ_0 \[Pa\].
    pub melt_yield_stress: f64,
    /// Consistency of the melt κ \[Pa·sⁿ\].
    pub melt_consistency: f64,
    /// Flow index of the melt n.
    pub melt_flow_index: f64,
    /// Arrhenius constant B \[K\].
    pub arrhenius_k: f64,
    /// Loss of stiffness on the way to the solidus.
    pub softening: f64,
    /// Temperature at which the solid has its full stiffness \[K\].
    pub reference_temperature: f64,
    /// Specific heat of the solid \[J/(kg·K)\].
    pub heat_capacity_solid: f64,
    /// Specific heat of the melt \[J/(kg·K)\].
    pub heat_capacity_liquid: f64,
    /// Conductivity of the solid \[W/(m·K)\].
    pub conductivity_solid: f64,
    /// Conductivity of the melt \[W/(m·K)\].
    pub conductivity_liquid: f64,
    /// Latent heat \[J/kg\].
    pub latent_heat: f64,
    /// Solidus \[K\]; infinite = never melts.
    pub solidus: f64,
    /// Liquidus \[K\], ≥ solidus.
    pub liquidus: f64,
    /// Phase rule.
    pub phase_mode: PhaseMode,
    /// Hardening modulus H \[Pa\].
    pub hardening: f64,
    /// Friction angle φ \[rad\].
    pub friction_angle: f64,
    /// Viscosity of a fluid \[Pa·s\].
    pub fluid_viscosity: f64,
    /// Density of the melt \[kg/m³\] if it differs.
    pub melt_density: Option<f64>,
    /// Volumetric thermal expansion \[1/K\].
    pub expansion: f64,
    /// Parameters over temperature.
    pub tables: ResolvedTables,
}

/// Parameters over temperature in kelvin; empty = not given.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ResolvedTables {
    /// Share of the solid's stiffness.
    pub stiffness: Vec<[f64; 2]>,
    /// Share of the solid's yield stress.
    pub solid_yield: Vec<[f64; 2]>,
    /// Yield stress of the melt \[Pa\].
    pub melt_yield: Vec<[f64; 2]>,
    /// Consistency of the melt \[Pa·sⁿ\].
    pub melt_consistency: Vec<[f64; 2]>,
    /// Conductivity \[W/(m·K)\].
    pub conductivity: Vec<[f64; 2]>,
}

/// A table of a scene in kelvin: ascending temperatures, positive values (zero too where no logarithm is taken).
fn table(key: &'static str, entries: Option<&[[f64; 2]]>, zero: bool) -> Result<Vec<[f64; 2]>, MaterialError> {
    let entries = entries.unwrap_or_default();
    if let Some(w) = entries.windows(2).find(|w| w[1][0] <= w[0][0]) {
        let message = format!("{} °C comes after {} °C; temperatures must ascend", w[1][0], w[0][0]);
        return Err(MaterialError { key, message });
    }
    if let Some(e) = entries.iter().find(|e| e[1] < 0.0 || !zero && e[1] == 0.0) {
        return Err(MaterialError { key, message: format!("the value {} at {} °C must be positive", e[1], e[0]) });
    }
    Ok(entries.iter().map(|e| [e[0] + CELSIUS_K, e[1]]).collect())
}

impl MaterialSpec {
    /// The preset of that name without changes.
    pub fn from_preset(name: &str) -> Self {
        Self { preset: Some(name.into()), ..Self::default() }
    }

    /// Solidus and liquidus in °C; infinite if the material never melts.
    fn melting_range_c(&self, base: (f64, f64)) -> Result<(f64, f64), MaterialError> {
        let fail = |key, message: &str| Err(MaterialError { key, message: message.into() });
        let given = self.melt_temperature_c.is_some() || self.solidus_c.is_some() || self.liquidus_c.is_some();
        if self.melts == Some(false) {
            return if given {
                fail("melts", "is false, but a melting temperature is given; remove one")
            } else {
                Ok((f64::INFINITY, f64::INFINITY))
            };
        }
        if let Some(t) = self.melt_temperature_c {
            if self.solidus_c.is_some() || self.liquidus_c.is_some() {
                return fail("melt_temperature_c", "stands for solidus_c and liquidus_c at once; give either it or those two");
            }
            return Ok((t, t));
        }
        let (solidus, liquidus) = match (self.solidus_c, self.liquidus_c) {
            // One end alone over a preset that never melts, or beyond the preset's other end, is a sharp melting point.
            (Some(s), None) => (s, if base.1.is_finite() { base.1.max(s) } else { s }),
            (None, Some(l)) => (base.0.min(l), l),
            (Some(s), Some(l)) => (s, l),
            (None, None) => base,
        };
        if solidus > liquidus {
            return Err(MaterialError {
                key: "solidus_c",
                message: format!("is {solidus} °C, above liquidus_c = {liquidus} °C; melting begins at the solidus"),
            });
        }
        if self.melts == Some(true) && !liquidus.is_finite() {
            return fail("melts", "is true, but the preset has no melting temperature; give melt_temperature_c");
        }
        Ok((solidus, liquidus))
    }

    /// Refuses keys that another law would use.
    fn check_law_keys(&self, law: Law) -> Result<(), MaterialError> {
        let yields = matches!(law, Law::Hencky | Law::VonMises);
        let keys = [
            ("solid_yield_stress_pa", self.solid_yield_stress_pa.is_some(), yields, "\"hencky\" or \"von_mises\""),
            ("hardening_pa", self.hardening_pa.is_some(), law == Law::VonMises, "\"von_mises\""),
            ("friction_angle_deg", self.friction_angle_deg.is_some(), law == Law::DruckerPrager, "\"drucker_prager\""),
            ("viscosity_pa_s", self.viscosity_pa_s.is_some(), law == Law::Fluid, "\"fluid\""),
        ];
        match keys.iter().find(|k| k.1 && !k.2) {
            Some((key, _, _, laws)) => {
                Err(MaterialError { key, message: format!("has no effect with law = \"{}\"; it belongs to {laws}", law.name()) })
            }
            None => Ok(()),
        }
    }

    /// The numbers in SI. `name` is for messages; `context` gives size, gravity and temperatures.
    pub fn resolve(&self, name: &str, context: &MaterialContext) -> Result<ResolvedMaterial, MaterialError> {
        let base_name = self.preset.as_deref().unwrap_or(DEFAULT_MATERIAL);
        let base = preset(base_name)
            .ok_or_else(|| MaterialError { key: "preset", message: format!("\"{base_name}\" is not a material preset") })?;

        let (solidus_c, liquidus_c) = self.melting_range_c((base.solidus_c, base.liquidus_c))?;
        let never_melts = !solidus_c.is_finite();
        let law = self.law.unwrap_or(if never_melts { base.law } else { Law::Hencky });
        if law != Law::Hencky && !never_melts {
            let message = format!("\"{}\" cannot melt; use \"hencky\", or melts = false", law.name());
            return Err(MaterialError { key: "law", message });
        }
        self.check_law_keys(law)?;

        let density = self.density_kg_m3.unwrap_or(base.density_kg_m3);
        if self.sag_ratio.is_some() && self.youngs_modulus_pa.is_some() {
            let message = "and youngs_modulus_pa both give the stiffness; remove one".into();
            return Err(MaterialError { key: "sag_ratio", message });
        }
        let visual_gravity = if context.gravity_m_s2 > 0.0 { context.gravity_m_s2 } else { 9.81 };
        let weight = density * visual_gravity * context.object_height_m;
        let sag = self.sag_ratio.or(base.sag_ratio).unwrap_or(context.sag_ratio);
        let youngs_modulus = self.youngs_modulus_pa.unwrap_or(weight / sag);
        let nu = self.poisson_ratio.unwrap_or(base.poisson_ratio);
        let shear_modulus = if law == Law::Fluid { 0.0 } else { youngs_modulus / (2.0 * (1.0 + nu)) };
        // A melt is nearly incompressible only if K stands well above its pressures (simulation.md §5.3). Elastic bodies keep their own.
        let stiff_enough =
            (100.0 * density * context.max_speed_m_s.powi(2)).max(density * context.gravity_m_s2 * context.object_height_m / 0.01);
        let elastic_bulk = youngs_modulus / (3.0 * (1.0 - 2.0 * nu));
        let bulk_modulus = if never_melts && law != Law::Fluid { elastic_bulk } else { elastic_bulk.max(stiff_enough) };

        let (mut solidus, mut liquidus) = (solidus_c + CELSIUS_K, liquidus_c + CELSIUS_K);
        let latent_heat = if context.latent_heat { self.latent_heat_j_kg.unwrap_or(base.latent_heat_j_kg) } else { 0.0 };
        // Without latent heat a sharp melting point has no enthalpy interval to blend over (simulation.md §5.5).
        let width = context.hysteresis_k.max(0.1);
        if latent_heat == 0.0 && liquidus - solidus < width && !never_melts && context.phase_mode == PhaseMode::Mushy {
            let middle = 0.5 * (solidus + liquidus);
            (solidus, liquidus) = (middle - 0.5 * width, middle + 0.5 * width);
        }

        let elastic = never_melts && self.solid_yield_stress_pa.is_none() && law != Law::VonMises;
        // A yield stress that a preset gives scales with the visual stiffness, as a share of it.
        let own_yield = base.solid_yield_ratio * youngs_modulus;
        let tables = ResolvedTables {
            stiffness: table("stiffness_table_c", self.stiffness_table_c.as_deref(), false)?,
            solid_yield: table("solid_yield_table_c", self.solid_yield_table_c.as_deref(), false)?,
            melt_yield: table("melt_yield_stress_table_c_pa", self.melt_yield_stress_table_c_pa.as_deref(), false)?,
            melt_consistency: table("melt_consistency_table_c_pa_sn", self.melt_consistency_table_c_pa_sn.as_deref(), false)?,
            conductivity: table("conductivity_table_c_w_m_k", self.conductivity_table_c_w_m_k.as_deref(), false)?,
        };
        let mut material = ResolvedMaterial {
            name: name.into(),
            law,
            density,
            youngs_modulus,
            shear_modulus,
            bulk_modulus,
            solid_yield_stress: if elastic { f64::INFINITY } else { self.solid_yield_stress_pa.unwrap_or(own_yield) },
            melt_shear_modulus: (self.melt_stiffness_ratio.unwrap_or(0.3) * bulk_modulus).min(shear_modulus),
            melt_yield_stress: self.melt_yield_stress_pa.unwrap_or(base.melt_yield_stress_pa),
            melt_consistency: self.melt_consistency_pa_sn.unwrap_or(base.melt_consistency_pa_sn),
            melt_flow_index: self.melt_flow_index.unwrap_or(base.melt_flow_index),
            arrhenius_k: self.arrhenius_k.unwrap_or(base.arrhenius_k),
            softening: if never_melts { 0.0 } else { self.softening.unwrap_or(0.5) },
            reference_temperature: context.ambient_k,
            heat_capacity_solid: context
                .uniform_heat_capacity
                .or(self.heat_capacity_solid_j_kg_k)
                .unwrap_or(base.heat_capacity_solid_j_kg_k),
            heat_capacity_liquid: context
                .uniform_heat_capacity
                .or(self.heat_capacity_liquid_j_kg_k)
                .unwrap_or(base.heat_capacity_liquid_j_kg_k),
            conductivity_solid: self.conductivity_solid_w_m_k.unwrap_or(base.conductivity_solid_w_m_k),
            conductivity_liquid: self.conductivity_liquid_w_m_k.unwrap_or(base.conductivity_liquid_w_m_k),
            latent_heat,
            solidus,
            liquidus,
            phase_mode: context.phase_mode,
            hardening: if law == Law::VonMises { self.hardening_pa.unwrap_or(base.hardening_ratio * youngs_modulus) } else { 0.0 },
            friction_angle: if law == Law::DruckerPrager {
                self.friction_angle_deg.unwrap_or(base.friction_angle_deg).to_radians()
            } else {
                0.0
            },
            fluid_viscosity: if law == Law::Fluid { self.viscosity_pa_s.unwrap_or(base.viscosity_pa_s) } else { 0.0 },
            melt_density: self.melt_density_kg_m3.filter(|_| !never_melts),
            expansion: self.volume_expansion_1_k.unwrap_or(0.0),
            tables,
        };
        let start = self.softening_start_c.map(|c| c + CELSIUS_K).or(context.initial_k);
        let start = start.unwrap_or_else(|| material.initial_temperature_k(context.ambient_k));
        // The ramp needs some length: an object that starts near its solidus softens over the last 10 K below it.
        material.reference_temperature = start.min(material.solidus - 10.0);
        Ok(material)
    }
}

impl ResolvedMaterial {
    /// Default temperature at the start, `min(T_∞, T_s − 10 K)` (simulation.md §1.1).
    pub fn initial_temperature_k(&self, ambient_k: f64) -> f64 {
        ambient_k.min(self.solidus - 10.0)
    }

    /// Melting point, the middle of the mushy interval \[K\]; infinite if it never melts.
    pub fn melting_point(&self) -> f64 {
        0.5 * (self.solidus + self.liquidus)
    }

    /// Elastic wave speed of the cold solid \[m/s\].
    pub fn wave_speed(&self) -> f64 {
        ((self.bulk_modulus + 4.0 / 3.0 * self.shear_modulus) / self.density).sqrt()
    }

    /// Rough time to melt at nature's pace \[s\] (simulation.md §10.3): the slower of what the surface flux `flux_w_m2` brings and of what
    /// conduction through the melt lets pass from a surface at `surface_k`. `depth_m` is volume over heated area V/A, `start_k` the
    /// temperature before. Infinite if nothing drives it or it never melts.
    pub fn melt_time_s(&self, depth_m: f64, start_k: f64, flux_w_m2: Option<f64>, surface_k: Option<f64>) -> f64 {
        let melting_point = self.melting_point();
        if !melting_point.is_finite() {
            return f64::INFINITY;
        }
        let need = self.density * (self.latent_heat + self.heat_capacity_solid * (melting_point - start_k).max(0.0));
        let by_flux = flux_w_m2.map(|q| if q > 0.0 { need * depth_m / q } else { f64::INFINITY });
        // The design's estimate counts the latent heat alone; with the sensible heat it also holds for materials that have none.
        let by_conduction = surface_k.map(|t| match t - melting_point {
            d if d > 0.0 => need * depth_m * depth_m / (2.0 * self.conductivity_liquid * d),
            _ => f64::INFINITY,
        });
        match (by_flux, by_conduction) {
            (Some(a), Some(b)) => a.max(b),
            (Some(t), None) | (None, Some(t)) => t,
            (None, None) => f64::INFINITY,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn context() -> MaterialContext {
        MaterialContext {
            object_height_m: 0.2,
            gravity_m_s2: 9.81,
            sag_ratio: 0.005,
            ambient_k: 293.15,
            initial_k: None,
            max_speed_m_s: 0.0,
            phase_mode: PhaseMode::Mushy,
            hysteresis_k: 1.0,
            latent_heat: true,
            uniform_heat_capacity: None,
        }
    }

    #[test]
    fn visual_stiffness_follows_size_and_sag() {
        // The example of simulation.md §2.5: ρ = 1000, H = 0.2 m, 0.5 %: E* ≈ 4e5 Pa and c ≈ 23 m/s.
        let m = MaterialSpec::default().resolve("m", &context()).unwrap();
        assert!((m.youngs_modulus - 392_400.0).abs() < 1.0, "{}", m.youngs_modulus);
        assert!((m.wave_speed() - 23.0).abs() < 0.5, "{}", m.wave_speed());
        assert!((m.bulk_modulus / m.youngs_modulus - 0.8333).abs() < 1e-3);
        // A softer solid keeps the bulk modulus of a weakly compressible melt.
        let soft = MaterialSpec { sag_ratio: Some(0.05), ..MaterialSpec::default() }.resolve("m", &context()).unwrap();
        assert!((soft.bulk_modulus - 1000.0 * 9.81 * 0.2 / 0.01).abs() < 1e-6);
        assert!(soft.melt_shear_modulus <= soft.shear_modulus);
    }

    #[test]
    fn melting_without_latent_heat_gets_an_interval() {
        let m = MaterialSpec::default().resolve("m", &context()).unwrap();
        assert!((m.solidus - 329.5).abs() < 1e-9 && (m.liquidus - 330.5).abs() < 1e-9);
        let ice = MaterialSpec::from_preset("water-ice").resolve("ice", &context()).unwrap();
        assert_eq!((ice.solidus, ice.liquidus), (273.15, 273.15));
        assert_eq!(ice.initial_temperature_k(293.15), 263.15);
    }

    #[test]
    fn contradictions_name_their_key() {
        let key = |s: MaterialSpec| s.resolve("m", &context()).unwrap_err().key;
        assert_eq!(key(MaterialSpec { sag_ratio: Some(0.01), youngs_modulus_pa: Some(1e5), ..Default::default() }), "sag_ratio");
        assert_eq!(key(MaterialSpec { solidus_c: Some(50.0), liquidus_c: Some(40.0), ..Default::default() }), "solidus_c");
        assert_eq!(key(MaterialSpec { melts: Some(false), solidus_c: Some(50.0), ..Default::default() }), "melts");
        assert_eq!(key(MaterialSpec { law: Some(Law::FixedCorotated), ..Default::default() }), "law");
        assert_eq!(key(MaterialSpec::from_preset("adamantium")), "preset");
    }

    #[test]
    fn every_law_has_its_own_keys() {
        let of = |law: Law| MaterialSpec { law: Some(law), melts: Some(false), ..Default::default() };
        let sand = MaterialSpec { friction_angle_deg: Some(30.0), ..of(Law::DruckerPrager) }.resolve("m", &context()).unwrap();
        assert!((sand.friction_angle - 30f64.to_radians()).abs() < 1e-12 && sand.solid_yield_stress.is_infinite());
        let metal = MaterialSpec { hardening_pa: Some(1e5), ..of(Law::VonMises) }.resolve("m", &context()).unwrap();
        assert!(metal.hardening == 1e5 && metal.solid_yield_stress.is_finite());
        let water = MaterialSpec::from_preset("water").resolve("m", &context()).unwrap();
        assert!(water.shear_modulus == 0.0 && water.fluid_viscosity > 0.0 && water.bulk_modulus >= 1000.0 * 9.81 * 0.2 / 0.01);
        let key = |s: MaterialSpec| s.resolve("m", &context()).unwrap_err().key;
        assert_eq!(key(MaterialSpec { friction_angle_deg: Some(30.0), ..Default::default() }), "friction_angle_deg");
        assert_eq!(key(MaterialSpec { viscosity_pa_s: Some(1.0), ..of(Law::NeoHookean) }), "viscosity_pa_s");
        assert_eq!(key(MaterialSpec { solid_yield_stress_pa: Some(1.0), ..of(Law::DruckerPrager) }), "solid_yield_stress_pa");
        assert_eq!(key(MaterialSpec { law: Some(Law::Fluid), ..Default::default() }), "law");
    }

    #[test]
    fn tables_come_in_kelvin_and_in_order() {
        let spec = |t: Vec<[f64; 2]>| MaterialSpec { stiffness_table_c: Some(t), ..Default::default() };
        let m = spec(vec![[20.0, 1.0], [50.0, 0.4]]).resolve("m", &context()).unwrap();
        assert_eq!(m.tables.stiffness, [[293.15, 1.0], [323.15, 0.4]]);
        assert_eq!(spec(vec![[20.0, 1.0], [20.0, 0.4]]).resolve("m", &context()).unwrap_err().key, "stiffness_table_c");
        assert_eq!(spec(vec![[20.0, 0.0]]).resolve("m", &context()).unwrap_err().key, "stiffness_table_c");
    }

    #[test]
    fn an_elastic_preset_can_be_made_to_melt_and_back() {
        let e = MaterialSpec::from_preset("elastic").resolve("e", &context()).unwrap();
        assert!(e.solidus.is_infinite() && e.solid_yield_stress.is_infinite() && e.law == Law::FixedCorotated);
        assert_eq!(e.reference_temperature, 293.15);
        let molten =
            MaterialSpec { melt_temperature_c: Some(80.0), ..MaterialSpec::from_preset("elastic") }.resolve("e", &context()).unwrap();
        assert!(molten.law == Law::Hencky && (molten.melting_point() - 353.15).abs() < 1e-9);
    }

    #[test]
    fn melt_times_have_the_right_size() {
        let ice = MaterialSpec::from_preset("water-ice").resolve("ice", &context()).unwrap();
        // 917 · (334e3 + 2100 · 10) J/m³ over 1 cm at 300 W/m²: three hours.
        let t = ice.melt_time_s(0.01, 263.15, Some(300.0), None);
        assert!((t - 917.0 * 355e3 * 0.01 / 300.0).abs() < 1e-6 * t);
        assert!(ice.melt_time_s(0.01, 263.15, None, Some(270.0)).is_infinite());
        assert!(ice.melt_time_s(0.01, 263.15, Some(1e9), Some(333.15)) > 100.0);
    }
}
