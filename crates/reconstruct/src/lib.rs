//! Views to splats that survive melting.

pub mod loss;
