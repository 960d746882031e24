//! Deformed points to a renderable surface: push-forward, rebase, needle clamp
