//! `megas materials`: the presets as a table.

use std::fmt::Write;

use megas_scene::{DEFAULT_MATERIAL, MaterialPreset, material_presets};
use serde_json::{Value, json};

/// The presets for people.
pub fn table() -> String {
    let mut text = format!(
        "{:<16} {:>8} {:>16} {:>12} {:>13}   about\n{:<16} {:>8} {:>16} {:>12} {:>13}\n",
        "name", "density", "melts at", "latent heat", "conductivity", "", "kg/m³", "°C", "kJ/kg", "W/(m·K)"
    );
    for p in material_presets() {
        let _ = writeln!(
            text,
            "{:<16} {:>8} {:>16} {:>12} {:>13}   {}",
            p.name,
            p.density_kg_m3,
            range(p),
            p.latent_heat_j_kg / 1000.0,
            p.conductivity_solid_w_m_k,
            p.about
        );
    }
    text.push_str("\nIn a scene file:  [[object]] material = \"butter\"   or, to change some numbers:\n");
    text.push_str("  [materials.my-butter]\n  preset = \"butter\"\n  melt_yield_stress_pa = 50\n");
    text
}

fn range(p: &MaterialPreset) -> String {
    let whole = |c: f64| format!("{}", (c * 10.0).round() / 10.0 + 0.0);
    match (p.solidus_c, p.liquidus_c) {
        (s, _) if !s.is_finite() => "never".into(),
        (s, l) if s == l => whole(s),
        (s, l) => format!("{} to {}", whole(s), whole(l)),
    }
}

/// The presets for machines, with the keys of scene files. Temperatures of materials that never melt are null.
pub fn list() -> Vec<Value> {
    let one = |p: &MaterialPreset| {
        json!({
            "name": p.name,
            "about": p.about,
            "default": p.name == DEFAULT_MATERIAL,
            "density_kg_m3": p.density_kg_m3,
            "poisson_ratio": p.poisson_ratio,
            "heat_capacity_solid_j_kg_k": p.heat_capacity_solid_j_kg_k,
            "heat_capacity_liquid_j_kg_k": p.heat_capacity_liquid_j_kg_k,
            "conductivity_solid_w_m_k": p.conductivity_solid_w_m_k,
            "conductivity_liquid_w_m_k": p.conductivity_liquid_w_m_k,
            "latent_heat_j_kg": p.latent_heat_j_kg,
            "solidus_c": p.solidus_c,
            "liquidus_c": p.liquidus_c,
            "melt_yield_stress_pa": p.melt_yield_stress_pa,
            "melt_consistency_pa_sn": p.melt_consistency_pa_sn,
            "melt_flow_index": p.melt_flow_index,
            "arrhenius_k": p.arrhenius_k,
            "law": p.law.name(),
            "sag_ratio": p.sag_ratio,
        })
    };
    material_presets().iter().map(one).collect()
}
