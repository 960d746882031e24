//! scene.toml to a typed scene and back: presets, materials, validation, JSON Schema
