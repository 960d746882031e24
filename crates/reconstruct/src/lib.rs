//! Views to splats that survive melting.
