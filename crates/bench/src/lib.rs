//! Benchmark scenes, one JSON line each
