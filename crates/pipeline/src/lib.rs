//! Runs a scene end to end: stages, cache, checkpoints, resume, progress events
