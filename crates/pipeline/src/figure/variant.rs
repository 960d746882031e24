//! Changes of a scene, and lists of them.

use std::path::Path;

use megas_scene::Scene;
use serde::Deserialize;
use toml::{Table, Value};

use super::{built_in, names};
use crate::{Failure, LoadedScene, folder_of};

/// A figure: variants, and the moments that the sheet of stills shows.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sheet {
    /// Title.
    #[serde(default)]
    pub title: String,
    /// Moments of the stills as shares of the film, 0–1.
    #[serde(default = "moments")]
    pub times: Vec<f64>,
    /// Show temperatures instead of colours.
    #[serde(default)]
    pub thermal: bool,
    /// The variants.
    #[serde(rename = "variant")]
    pub variants: Vec<Variant>,
}

fn moments() -> Vec<f64> {
    vec![0.0, 0.33, 0.66, 1.0]
}

/// One way to change a scene.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Variant {
    /// Caption.
    pub label: String,
    /// Keys of the scene file that take other values. Tables are merged; lists and plain values are replaced.
    #[serde(default)]
    pub set: Table,
    /// Keys that every object takes.
    #[serde(default)]
    pub objects: Table,
    /// Keys that the material of every object takes.
    #[serde(default)]
    pub materials: Table,
}

impl Sheet {
    /// A figure that comes with the program, or a file.
    pub fn open(name: &str) -> Result<Self, Failure> {
        let (text, folder) = match built_in(name) {
            Some(f) => (f.text.to_owned(), None),
            None => {
                let read = |e: std::io::Error| Failure::Input(format!("{name}: {e}; give a file, or the name of a figure: {}", names()));
                (std::fs::read_to_string(name).map_err(read)?, Some(folder_of(Path::new(name))))
            }
        };
        let sheet: Self = toml::from_str(&text).map_err(|e| Failure::Input(format!("{name}: {e}")))?;
        if sheet.variants.is_empty() || sheet.variants.len() > 12 {
            return Err(Failure::Input(format!("{name}: {} variants; a figure has 1 to 12 [[variant]]", sheet.variants.len())));
        }
        if let Some(t) = sheet.times.iter().find(|t| !(0.0..=1.0).contains(*t)) {
            return Err(Failure::Input(format!("{name}: times: {t} is no share of the film; expected 0 to 1")));
        }
        Ok(match folder {
            Some(folder) => sheet.with_paths_from(&folder),
            None => sheet,
        })
    }

    /// Splats that variants name lie beside the figure's file.
    fn with_paths_from(mut self, folder: &Path) -> Self {
        for v in &mut self.variants {
            if let Some(Value::String(splat)) = v.set.get_mut("input").and_then(Value::as_table_mut).and_then(|i| i.get_mut("splat"))
                && let Ok(full) = std::path::absolute(folder.join(&*splat))
            {
                *splat = full.display().to_string();
            }
        }
        self
    }
}

impl Variant {
    /// The scene with the changes, checked as if it had been written so.
    pub fn apply(&self, loaded: &LoadedScene) -> Result<LoadedScene, Failure> {
        let broken = |e: &dyn std::fmt::Display| Failure::Input(format!("variant '{}': {e}", self.label));
        let mut scene: Table = toml::from_str(&loaded.scene.to_toml()).map_err(|e| broken(&e))?;
        if let Some(clock) = self.set.get("time").and_then(Value::as_table)
            && ["melt_in_s", "acceleration"].iter().any(|k| clock.contains_key(*k))
            && let Some(time) = scene.get_mut("time").and_then(Value::as_table_mut)
        {
            // Two keys set the thermal clock; the variant's replaces the scene's.
            time.remove("melt_in_s");
            time.remove("acceleration");
        }
        merge(&mut scene, &self.set);
        if !(self.objects.is_empty() && self.materials.is_empty()) {
            self.change_objects(&mut scene).map_err(|e| broken(&e))?;
        }
        let text = toml::to_string(&scene).map_err(|e| broken(&e))?;
        let scene = Scene::parse(&text, &format!("variant '{}'", self.label)).map_err(|e| Failure::Input(e.to_string()))?;
        Ok(LoadedScene { scene, base_dir: loaded.base_dir.clone(), text })
    }

    fn change_objects(&self, scene: &mut Table) -> Result<(), String> {
        let mut materials = match scene.remove("materials") {
            Some(Value::Table(t)) => t,
            _ => Table::new(),
        };
        let objects = scene.get_mut("object").and_then(Value::as_array_mut).filter(|o| !o.is_empty());
        let objects = objects.ok_or("it changes objects; the scene must list them as [[object]]")?;
        for object in objects.iter_mut().filter_map(Value::as_table_mut) {
            merge(object, &self.objects);
            if self.materials.is_empty() {
                continue;
            }
            let name = object.get("material").and_then(Value::as_str).unwrap_or("soft-wax").to_owned();
            let mut material = materials
                .get(&name)
                .and_then(Value::as_table)
                .cloned()
                .unwrap_or_else(|| Table::from_iter([("preset".to_owned(), Value::String(name.clone()))]));
            merge(&mut material, &self.materials);
            let varied = format!("{name}-varied");
            object.insert("material".into(), Value::String(varied.clone()));
            materials.insert(varied, Value::Table(material));
        }
        scene.insert("materials".into(), Value::Table(materials));
        Ok(())
    }
}

/// Puts `change` into `table`.
fn merge(table: &mut Table, change: &Table) {
    for (key, new) in change {
        match (table.get_mut(key), new) {
            (Some(Value::Table(old)), Value::Table(new)) => merge(old, new),
            _ => {
                table.insert(key.clone(), new.clone());
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::demo_scene;
    use crate::figure::FIGURES;

    fn variant(text: &str) -> Variant {
        toml::from_str(text).unwrap()
    }

    #[test]
    fn every_built_in_figure_applies_to_the_demo() {
        let demo = demo_scene(true).unwrap();
        for f in FIGURES {
            let sheet = Sheet::open(f.name).unwrap();
            assert!(sheet.variants.len() >= 2, "{}", f.name);
            let scenes: Vec<Scene> =
                sheet.variants.iter().map(|v| v.apply(&demo).unwrap_or_else(|e| panic!("{}: {e}", f.name)).scene).collect();
            for (i, a) in scenes.iter().enumerate() {
                assert!(scenes[..i].iter().all(|b| a != b), "{}: two variants are the same", f.name);
            }
        }
    }

    #[test]
    fn changes_reach_tables_objects_and_materials() {
        let demo = demo_scene(true).unwrap();
        let v = variant(
            "label = \"x\"\nset = { skin = { densify = false }, time = { acceleration = 7.0 } }\nobjects = { initial_temperature_c = -5.0 }\n\
             materials = { melt_yield_stress_pa = 3.0 }",
        );
        let scene = v.apply(&demo).unwrap().scene;
        assert!(!scene.skin.densify && scene.skin.push == demo.scene.skin.push);
        assert_eq!((scene.time.acceleration, scene.time.melt_in_s), (Some(7.0), None));
        assert!(scene.objects.iter().all(|o| o.initial_temperature_c == Some(-5.0)));
        assert_eq!(scene.objects.len(), demo.scene.objects.len());
        let scoop = &scene.materials[&scene.objects[0].material];
        assert_eq!((scoop.melt_yield_stress_pa, scoop.melt_consistency_pa_sn), (Some(3.0), Some(5.0)));
        assert_eq!(scene.heat, demo.scene.heat);
    }

    #[test]
    fn mistakes_are_told_with_the_variant() {
        let demo = demo_scene(true).unwrap();
        let e = variant("label = \"typo\"\nset = { skin = { densefy = false } }").apply(&demo).unwrap_err().to_string();
        assert!(e.contains("typo") && e.contains("densify"), "{e}");
        assert!(Sheet::open("no-such-figure").unwrap_err().to_string().contains("topology"));
    }
}
