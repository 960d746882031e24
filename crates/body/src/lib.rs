//! Splats to a body that can be simulated: selection, outward normals, ray-traced filling, volumes
