//! CPU rasterizer for 3D Gaussians: splats and a camera in, channels out
