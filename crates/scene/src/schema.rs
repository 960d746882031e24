//! The JSON Schema of scene files. It is also what [`crate::check`] validates against, so the two cannot disagree.

use serde_json::{Map, Value};

use crate::scene::Scene;

/// The JSON Schema (draft 2020-12) of `scene.toml`: keys, descriptions with units, ranges, defaults.
pub fn json_schema() -> Value {
    let mut schema = schemars::schema_for!(Scene).to_value();
    drop_null(&mut schema);
    if let Value::Object(map) = &mut schema {
        map.insert("title".into(), "megas scene".into());
    }
    schema
}

/// TOML has no null: an optional key is simply absent. Removes the null alternatives and defaults that the derive adds for `Option`.
fn drop_null(value: &mut Value) {
    match value {
        Value::Object(map) => {
            if let Some(Value::Array(types)) = map.get_mut("type") {
                types.retain(|t| t != "null");
                if types.len() == 1 {
                    let only = types.remove(0);
                    map.insert("type".into(), only);
                }
            }
            if map.get("default").is_some_and(Value::is_null) {
                map.remove("default");
            }
            if let Some(Value::Array(alternatives)) = map.get_mut("anyOf") {
                alternatives.retain(|a| a.get("type").is_none_or(|t| t != "null"));
                if alternatives.len() == 1 {
                    let only = alternatives.remove(0);
                    map.remove("anyOf");
                    merge(map, only);
                }
            }
            map.values_mut().for_each(drop_null);
        }
        Value::Array(items) => items.iter_mut().for_each(drop_null),
        _ => {}
    }
}

fn merge(map: &mut Map<String, Value>, other: Value) {
    if let Value::Object(other) = other {
        for (key, value) in other {
            map.entry(key).or_insert(value);
        }
    }
}
