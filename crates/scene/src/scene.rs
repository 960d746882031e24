//! The scene: everything a run needs to know.

use std::collections::BTreeMap;
use std::path::Path;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::camera::Camera;
use crate::check;
use crate::collider::{Collider, Support};
use crate::diagnostic::{Diagnostic, SceneError, Severity};
use crate::heat::Heat;
use crate::input::Input;
use crate::material::{MaterialContext, MaterialSpec};
use crate::material_checks::StepLimits;
use crate::object::Object;
use crate::output::{Appearance, Output};
use crate::settings::{Air, Fill, HeatTransfer, PhaseMode, Preset, Quality, Simulation, Time};
use crate::skin::Skin;
use crate::still::InputBody;
use crate::{CELSIUS_K, presets, semantic};

/// Real size of the objects when nobody says one \[m\].
const DEFAULT_SIZE_M: f64 = 0.2;

/// Longest scene file that is read \[bytes\].
const MAX_BYTES: u64 = 4 << 20;

/// A scene file. Only `input` is needed; everything else has a default.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Scene {
    /// Title, for people.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub title: String,
    /// "preview", "default" or "final": resolution, stiffness and picture size in one word.
    #[serde(default)]
    pub quality: Quality,
    /// "physical" or "paper" (the literal algorithm of the paper, for comparison).
    #[serde(default)]
    pub preset: Preset,
    /// Seed of everything random.
    #[serde(default)]
    #[schemars(range(min = 0, max = 9007199254740991i64))]
    pub seed: u64,
    /// Where the splats come from.
    pub input: Input,
    /// The things that are simulated; a single object of all splats (or the asset's own objects) if left out.
    #[serde(rename = "object", default, skip_serializing_if = "Vec::is_empty")]
    pub objects: Vec<Object>,
    /// Materials by name.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub materials: BTreeMap<String, MaterialSpec>,
    /// Heat sources; if left out, things melt from above. `heat = []` is none at all.
    #[serde(rename = "heat", default, skip_serializing_if = "Option::is_none")]
    pub heat: Option<Vec<Heat>>,
    /// The air.
    #[serde(default)]
    pub air: Air,
    /// The floor under the objects.
    #[serde(default)]
    pub support: Support,
    /// Other solid bodies.
    #[serde(rename = "collider", default, skip_serializing_if = "Vec::is_empty")]
    pub colliders: Vec<Collider>,
    /// How long, and how fast heat runs.
    #[serde(default)]
    pub time: Time,
    /// The simulation's grid and rules.
    #[serde(default)]
    pub simulation: Simulation,
    /// Filling the objects with material points.
    #[serde(default)]
    pub fill: Fill,
    /// How splats follow the points.
    #[serde(default)]
    pub skin: Skin,
    /// Cameras, each with its own films; one orbit if left out.
    #[serde(rename = "camera", default, skip_serializing_if = "Vec::is_empty")]
    pub cameras: Vec<Camera>,
    /// Pictures and files.
    #[serde(default)]
    pub output: Output,
}

/// How the thermal acceleration A_th is found (simulation.md §3.8).
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Clock {
    /// This factor.
    Factor(f64),
    /// Such that the objects melt in about this many seconds.
    MeltIn(f64),
}

impl Scene {
    /// Reads a scene from text; `file_name` is for messages. All problems found are reported together.
    pub fn parse(text: &str, file_name: &str) -> Result<Self, SceneError> {
        let source = check::Source::new(text, file_name)?;
        let problems = source.check_against(&crate::json_schema());
        if !problems.is_empty() {
            return Err(SceneError::Invalid(problems));
        }
        let scene: Self = toml::from_str(text).map_err(|e| SceneError::Invalid(vec![source.at_span(e.span(), "", e.message())]))?;
        let problems: Vec<Diagnostic> = semantic::problems(&scene).iter().map(|p| source.at_path(&p.path, &p.message)).collect();
        if problems.is_empty() { Ok(scene) } else { Err(SceneError::Invalid(check::in_file_order(problems))) }
    }

    /// Reads a scene file.
    pub fn load(path: &Path) -> Result<Self, SceneError> {
        let file = path.display().to_string();
        Self::parse(&Self::read(path)?, &file)
    }

    /// The text of a scene file, bounded in size.
    pub fn read(path: &Path) -> Result<String, SceneError> {
        let fail = |reason: String| SceneError::Read { file: path.display().to_string(), reason };
        let size = std::fs::metadata(path).map_err(|e| fail(format!("cannot read the scene file: {e}")))?;
        if size.is_dir() {
            return Err(fail("is a folder; a scene is a .toml file".into()));
        }
        if size.len() > MAX_BYTES {
            return Err(fail(format!(
                "{} bytes are too many for a scene file (at most {MAX_BYTES}); is this the splat itself?",
                size.len()
            )));
        }
        let bytes = std::fs::read(path).map_err(|e| fail(format!("cannot read the scene file: {e}")))?;
        String::from_utf8(bytes)
            .map_err(|_| fail("is not text (UTF-8); a scene is a .toml file. To look at a splat use `megas inspect`".into()))
    }

    /// The scene as a file with every default written out; [`Scene::parse`] reads the same scene back.
    pub fn to_toml(&self) -> String {
        // Every type of a scene maps to TOML; a round-trip test covers them all.
        toml::to_string(self).unwrap_or_default()
    }

    /// The objects, or the one object of everything. For an asset the asset's own objects go before this default.
    pub fn objects_or_default(&self) -> Vec<Object> {
        if !self.objects.is_empty() {
            return self.objects.clone();
        }
        let of_body = |b: &InputBody| Object { name: b.name.clone(), parts: vec![b.name.clone()], ..Object::default() };
        let own: Vec<Object> = self.input.bodies.iter().map(of_body).collect();
        if own.is_empty() { vec![Object::default()] } else { own }
    }

    /// The heat sources in use: melting from above if the scene does not mention heat.
    pub fn heat_or_default(&self) -> Vec<Heat> {
        self.heat.clone().unwrap_or_else(|| vec![Heat::from_above()])
    }

    /// The cameras in use.
    pub fn cameras_or_default(&self) -> Vec<Camera> {
        if self.cameras.is_empty() { vec![Camera::default()] } else { self.cameras.clone() }
    }

    /// True if a procedural body is part of an object; the others are scenery.
    pub fn simulates(&self, body: &InputBody) -> bool {
        self.objects.is_empty() || self.objects.iter().any(|o| o.parts.contains(&body.name))
    }

    /// Real size \[m\] and which object (index into `objects`) has it; `None` = all objects together.
    pub fn size_m(&self) -> (f64, Option<usize>) {
        if let Some((lo, hi)) = self.input.bodies_box(|b| self.simulates(b)) {
            return ((0..3).map(|a| hi[a] - lo[a]).fold(0.0, f64::max), None);
        }
        let given = self.objects.iter().enumerate().find_map(|(i, o)| o.size_m.map(|s| (s, Some(i))));
        given.unwrap_or((DEFAULT_SIZE_M, None))
    }

    /// Grid cells along the longest side.
    pub fn cells(&self) -> u32 {
        self.simulation.cells.unwrap_or(self.quality.cells())
    }

    /// Sag ratio of solids without a stiffness of their own.
    pub fn sag_ratio(&self) -> f64 {
        self.simulation.sag_ratio.unwrap_or(self.quality.sag_ratio())
    }

    /// Width and height of pictures \[px\]. One given alone keeps the shape of the quality's picture.
    pub fn picture_size(&self) -> (u32, u32) {
        let (w, h) = self.quality.size();
        let even = |v: f64| ((v / 2.0).round() as u32 * 2).max(16);
        match (self.output.width, self.output.height) {
            (Some(width), Some(height)) => (width, height),
            (Some(width), None) => (width, even(f64::from(width) * f64::from(h) / f64::from(w))),
            (None, Some(height)) => (even(f64::from(height) * f64::from(w) / f64::from(h)), height),
            (None, None) => (w, h),
        }
    }

    /// Temperature of the surroundings \[K\].
    pub fn ambient_k(&self) -> f64 {
        self.air.temperature_c + CELSIUS_K
    }

    /// How the thermal acceleration is found.
    pub fn clock(&self) -> Clock {
        match (self.time.acceleration, self.time.melt_in_s) {
            (Some(factor), _) => Clock::Factor(factor),
            (None, Some(seconds)) => Clock::MeltIn(seconds),
            (None, None) => Clock::MeltIn(0.75 * self.time.duration_s * self.time.time_lapse),
        }
    }

    /// The material of that name: the scene's own, or a preset.
    pub fn material(&self, name: &str) -> Option<MaterialSpec> {
        self.materials.get(name).cloned().or_else(|| presets::preset(name).map(|p| MaterialSpec::from_preset(p.name)))
    }

    /// Whether everything is to be as the paper writes it.
    pub fn is_literal(&self) -> bool {
        self.preset == Preset::Paper
    }

    /// Glow and wetness in use: the paper's pictures have neither.
    pub fn appearance(&self) -> Appearance {
        let plain = Appearance { glow: 0.0, wet: 0.0, ..Appearance::default() };
        self.output.appearance.unwrap_or(if self.is_literal() { plain } else { Appearance::default() })
    }

    /// The phase rule in use.
    pub fn phase_mode(&self) -> PhaseMode {
        self.simulation.phase_mode.unwrap_or(if self.is_literal() { PhaseMode::Binary } else { PhaseMode::Mushy })
    }

    /// Width of the switching hysteresis δ \[K\].
    pub fn hysteresis_k(&self) -> f64 {
        self.simulation.hysteresis_k.unwrap_or(if self.is_literal() { 0.0 } else { 1.0 })
    }

    /// How temperature travels.
    pub fn heat_transfer(&self) -> HeatTransfer {
        self.simulation.heat_transfer.unwrap_or(if self.is_literal() { HeatTransfer::Affine } else { HeatTransfer::Increments })
    }

    /// The specific heat that all materials share \[J/(kg·K)\], if they do: that of the first object's solid.
    fn uniform_heat_capacity(&self) -> Option<f64> {
        if !self.simulation.uniform_heat_capacity.unwrap_or(self.is_literal()) {
            return None;
        }
        let spec = self.material(&self.objects_or_default().first()?.material)?;
        spec.heat_capacity_solid_j_kg_k
            .or_else(|| presets::preset(spec.preset.as_deref().unwrap_or(presets::DEFAULT_MATERIAL)).map(|p| p.heat_capacity_solid_j_kg_k))
    }

    /// What [`MaterialSpec::resolve`] needs, for an object of that height \[m\].
    pub fn material_context(&self, object: &Object, height_m: f64) -> MaterialContext {
        let speed = object.initial_velocity_m_s.map_or(0.0, |v| v.iter().map(|c| c * c).sum::<f64>().sqrt());
        MaterialContext {
            object_height_m: height_m,
            gravity_m_s2: self.simulation.gravity_m_s2,
            sag_ratio: self.sag_ratio(),
            ambient_k: self.ambient_k(),
            initial_k: object.initial_temperature_c.map(|c| c + CELSIUS_K),
            max_speed_m_s: speed,
            phase_mode: self.phase_mode(),
            hysteresis_k: self.hysteresis_k(),
            latent_heat: self.simulation.latent_heat.unwrap_or(!self.is_literal()),
            uniform_heat_capacity: self.uniform_heat_capacity(),
        }
    }

    /// What a material has to live with, for an object of that height and a grid of that spacing \[m\].
    pub fn step_limits(&self, height_m: f64, dx_m: f64) -> StepLimits {
        StepLimits {
            object_height_m: height_m,
            gravity_m_s2: self.simulation.gravity_m_s2,
            dx_m,
            courant: self.simulation.courant,
            coupling_step_s: self.simulation.coupling_step_s,
            frame_dt_s: self.time.frame_dt_s(),
        }
    }

    /// Things worth knowing before the run, judged with the object's height still unknown (its longest side stands in).
    pub fn remarks(&self) -> Vec<(Severity, String)> {
        let (size, _) = self.size_m();
        let limits = self.step_limits(size, size / f64::from(self.cells()));
        let mut remarks = Vec::new();
        for object in self.objects_or_default() {
            let context = self.material_context(&object, size);
            let material = self.material(&object.material).map(|m| m.resolve(&object.material, &context));
            if let Some(Ok(material)) = material {
                for message in material.check(&limits).messages {
                    if !remarks.contains(&message) {
                        remarks.push(message);
                    }
                }
            }
        }
        remarks
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_paper_preset_is_literal_and_single_keys_overrule_it() {
        let scene = |text: &str| Scene::parse(&format!("{text}\n[input]\nasset = \"ice-cream\"\n"), "s.toml").unwrap();
        let physical = scene("");
        assert_eq!((physical.phase_mode(), physical.hysteresis_k()), (PhaseMode::Mushy, 1.0));
        assert_eq!(physical.heat_transfer(), HeatTransfer::Increments);
        let paper = scene("preset = \"paper\"");
        assert_eq!((paper.phase_mode(), paper.hysteresis_k(), paper.heat_transfer()), (PhaseMode::Binary, 0.0, HeatTransfer::Affine));
        let object = Object { material: "water-ice".into(), ..Object::default() };
        let resolve = |s: &Scene| s.material("water-ice").unwrap().resolve("ice", &s.material_context(&object, 0.1)).unwrap();
        // The first object is soft wax with 2000 J/(kg·K).
        let m = resolve(&paper);
        assert_eq!((m.latent_heat, m.heat_capacity_solid, m.heat_capacity_liquid), (0.0, 2000.0, 2000.0));
        assert_eq!(resolve(&physical).latent_heat, 334e3);
        let mixed = Scene::parse(
            "preset = \"paper\"\n[input]\nasset = \"ice-cream\"\n[simulation]\nlatent_heat = true\nheat_transfer = \"pic\"\n",
            "s.toml",
        )
        .unwrap();
        assert_eq!((resolve(&mixed).latent_heat, mixed.heat_transfer()), (334e3, HeatTransfer::Pic));
    }
}
