//! Thermomechanical MLS-MPM: points and a scene in, points over time out
