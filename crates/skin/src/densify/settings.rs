//! Options of the crack-sealing densification (splatting.md §7, §11.1).

/// How an internal kernel's radius follows from its neighbours (§7.2).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Radius {
    /// κ times the mean distance to the three nearest of surface and inside.
    #[default]
    Mean3,
    /// κ times the distance to the nearest (the paper).
    Nearest,
}

/// Which internal particles come to light (§7.2).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Rule {
    /// Largest contribution in two pixels, or a blend weight of 0.05 in one.
    #[default]
    Weight,
    /// Largest contribution in a pixel (the paper).
    Argmax,
}

/// Shape of the kernels that seal cracks (§7.5).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Kernel {
    /// Flat along the surface normal and no thicker than the particle lies deep: crisp outlines.
    #[default]
    Disc,
    /// Isotropic (the paper).
    Ball,
}

/// Where the normals of surface Gaussians come from (§7.3).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Normals {
    /// The shortest axis of the deformed Gaussian (the paper).
    Axis,
    /// Transported by the simulator.
    Transport,
    /// Transported, and corrected where the surface around says otherwise.
    #[default]
    TransportPca,
}

/// Options of the densification.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DensifySettings {
    /// Virtual orthographic cameras (16–64).
    pub cameras: usize,
    /// Frames over which the cameras take turns; 1 asks all of them in every frame. The viewer's cameras are asked always.
    pub turns: usize,
    /// Least and greatest edge of a virtual image \[px\].
    pub resolution: [u32; 2],
    /// κ of the radii.
    pub kappa: f32,
    /// How radii are measured.
    pub radius: Radius,
    /// Which particles come to light.
    pub rule: Rule,
    /// Shape of their kernels.
    pub kernel: Kernel,
    /// How far kernels move onto the surface, 0–1; fades out between displacements of 0.5Δ and Δ.
    pub snap: f32,
    /// Extra samples in wide gaps (§7.4).
    pub extend: bool,
    /// σ of robust fits of the surface; `None`: plain.
    pub robust: Option<f32>,
    /// Normals of the surface samples.
    pub normals: Normals,
    /// Fades, delays and smoothing in time (§7.6); off shows and hides at once.
    pub hysteresis: bool,
    /// Molten surface Gaussians and kernels grow where the flow draws them apart, and are trimmed at rims.
    pub cover: bool,
    /// Molten surface Gaussians turn towards the surface (§7.5).
    pub realign: bool,
}

impl Default for DensifySettings {
    fn default() -> Self {
        Self {
            cameras: 32,
            turns: 4,
            resolution: [128, 384],
            kappa: 0.55,
            radius: Radius::Mean3,
            rule: Rule::Weight,
            kernel: Kernel::Disc,
            snap: 0.0,
            extend: true,
            robust: None,
            normals: Normals::TransportPca,
            hysteresis: true,
            cover: true,
            realign: true,
        }
    }
}

impl DensifySettings {
    /// What the paper says and nothing that it does not (§11.3).
    pub fn paper_literal() -> Self {
        Self {
            turns: 1,
            kappa: 0.5,
            radius: Radius::Nearest,
            rule: Rule::Argmax,
            kernel: Kernel::Ball,
            snap: 0.0,
            extend: false,
            robust: None,
            normals: Normals::Axis,
            hysteresis: false,
            cover: false,
            realign: false,
            ..Self::default()
        }
    }
}
