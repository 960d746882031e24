//! Small values with more than one spelling: a number or "auto", a direction or "+z", a colour.

use std::borrow::Cow;

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Deserializer, Serialize, Serializer, de::Error};

/// A number, or `"auto"`: the program chooses.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Auto {
    /// The program chooses.
    Auto,
    /// The user's value.
    Value(f64),
}

impl Auto {
    /// The user's value, if there is one.
    pub fn value(self) -> Option<f64> {
        match self {
            Self::Auto => None,
            Self::Value(v) => Some(v),
        }
    }
}

#[derive(Serialize, Deserialize)]
#[serde(untagged)]
enum TextOr<T> {
    Text(String),
    Other(T),
}

impl Serialize for Auto {
    fn serialize<S: Serializer>(&self, s: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Auto => s.serialize_str("auto"),
            Self::Value(v) => s.serialize_f64(*v),
        }
    }
}

impl<'de> Deserialize<'de> for Auto {
    fn deserialize<D: Deserializer<'de>>(d: D) -> Result<Self, D::Error> {
        match TextOr::<f64>::deserialize(d)? {
            TextOr::Text(t) if t == "auto" => Ok(Self::Auto),
            TextOr::Text(t) => Err(D::Error::custom(format!("\"{t}\" is neither a number nor \"auto\""))),
            TextOr::Other(v) => Ok(Self::Value(v)),
        }
    }
}

impl JsonSchema for Auto {
    fn schema_name() -> Cow<'static, str> {
        "NumberOrAuto".into()
    }

    fn inline_schema() -> bool {
        true
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({ "anyOf": [{ "enum": ["auto"] }, { "type": "number", "minimum": 0 }] })
    }
}

const AXES: [(&str, [f64; 3]); 6] = [
    ("+x", [1.0, 0.0, 0.0]),
    ("-x", [-1.0, 0.0, 0.0]),
    ("+y", [0.0, 1.0, 0.0]),
    ("-y", [0.0, -1.0, 0.0]),
    ("+z", [0.0, 0.0, 1.0]),
    ("-z", [0.0, 0.0, -1.0]),
];

/// The direction of "up" in a file: `"+z"`, `"-y"`, … or three numbers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Up(pub [f64; 3]);

impl Default for Up {
    fn default() -> Self {
        Self([0.0, 0.0, 1.0])
    }
}

impl Serialize for Up {
    fn serialize<S: Serializer>(&self, s: S) -> Result<S::Ok, S::Error> {
        match AXES.iter().find(|(_, v)| *v == self.0) {
            Some((name, _)) => s.serialize_str(name),
            None => self.0.serialize(s),
        }
    }
}

impl<'de> Deserialize<'de> for Up {
    fn deserialize<D: Deserializer<'de>>(d: D) -> Result<Self, D::Error> {
        match TextOr::<[f64; 3]>::deserialize(d)? {
            TextOr::Text(t) => match AXES.iter().find(|(name, _)| *name == t) {
                Some((_, v)) => Ok(Self(*v)),
                None => Err(D::Error::custom(format!("\"{t}\" is not a direction; write \"+z\", \"-y\", … or three numbers"))),
            },
            TextOr::Other(v) => Ok(Self(v)),
        }
    }
}

impl JsonSchema for Up {
    fn schema_name() -> Cow<'static, str> {
        "Up".into()
    }

    fn inline_schema() -> bool {
        true
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        let names: Vec<&str> = AXES.iter().map(|a| a.0).collect();
        json_schema!({ "anyOf": [
            { "enum": names },
            { "type": "array", "items": { "type": "number" }, "minItems": 3, "maxItems": 3 }
        ] })
    }
}

/// The pattern of a colour in the schema, and what [`is_colour`] checks.
pub(crate) const COLOUR_PATTERN: &str = "^#[0-9a-fA-F]{6}$";

/// True for `#rrggbb`.
pub(crate) fn is_colour(text: &str) -> bool {
    text.strip_prefix('#').is_some_and(|h| h.len() == 6 && h.bytes().all(|b| b.is_ascii_hexdigit()))
}

/// A display colour: `"#rrggbb"` or three numbers in [0, 1] (sRGB).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Colour(pub [f32; 3]);

impl Serialize for Colour {
    fn serialize<S: Serializer>(&self, s: S) -> Result<S::Ok, S::Error> {
        let bytes = self.0.map(|v| (v * 255.0).round());
        // Colours that came as #rrggbb leave as #rrggbb; anything finer keeps its numbers.
        if (0..3).all(|i| (bytes[i] / 255.0 - self.0[i]).abs() < 1e-6) {
            s.serialize_str(&format!("#{:02x}{:02x}{:02x}", bytes[0] as u8, bytes[1] as u8, bytes[2] as u8))
        } else {
            self.0.map(f64::from).serialize(s)
        }
    }
}

impl<'de> Deserialize<'de> for Colour {
    fn deserialize<D: Deserializer<'de>>(d: D) -> Result<Self, D::Error> {
        match TextOr::<[f64; 3]>::deserialize(d)? {
            TextOr::Text(t) => {
                let hex = is_colour(&t).then(|| &t[1..]);
                let value = hex.and_then(|h| u32::from_str_radix(h, 16).ok());
                let value =
                    value.ok_or_else(|| D::Error::custom(format!("\"{t}\" is not a colour; write \"#rrggbb\" or three numbers 0–1")))?;
                Ok(Self([16, 8, 0].map(|shift| ((value >> shift) & 255) as f32 / 255.0)))
            }
            TextOr::Other(v) => Ok(Self(v.map(|v| v as f32))),
        }
    }
}

impl JsonSchema for Colour {
    fn schema_name() -> Cow<'static, str> {
        "Colour".into()
    }

    fn inline_schema() -> bool {
        true
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({ "anyOf": [
            { "type": "string", "pattern": COLOUR_PATTERN },
            { "type": "array", "items": { "type": "number", "minimum": 0, "maximum": 1 }, "minItems": 3, "maxItems": 3 }
        ] })
    }
}
