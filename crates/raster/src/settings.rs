//! Options of a render and the channel sets.

use megas_math::Vec3;

/// What a render produces; each set is a kernel of its own, compiled without the others' work (splatting.md §3.4).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Channels {
    /// Colour and alpha.
    Rgba,
    /// Colour, alpha and temperature: what a film needs in one pass.
    RgbaTemperature,
    /// Everything that exists per pixel.
    Geometry,
    /// Nothing per pixel but alpha and the winner; the per-Gaussian statistics.
    Weights,
}

/// Leaves out every Gaussian whose mean `x` has `normal · x > offset` (splatting.md §8.5).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClipPlane {
    /// Direction of the side that is cut away, world axes, not necessarily unit.
    pub normal: Vec3<f32>,
    /// Position along `normal`.
    pub offset: f32,
}

/// Constants of the image formation. The defaults are the ecosystem's (splatting.md §3.1, §3.3).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Smallest alpha that is blended; below 1e-30 counts as 1e-30.
    pub alpha_min: f32,
    /// Largest alpha of one Gaussian, below 1.
    pub alpha_max: f32,
    /// A pixel stops before the entry that would bring its transmittance below this.
    pub t_stop: f32,
    /// Low-pass ε added to the image covariance \[px²\]. Trainings fit Gaussians with it, so it is part of the model: where the size of
    /// a training's pixel is known ([`crate::Gaussians::trained_pixel`]), q pixels of the picture, ε q² is added instead, and for
    /// q < 1 what a larger pixel averages more than the training's, (1 − q²)/12, which conserves the integral. Otherwise a model
    /// grows fat when it is seen from farther away than its photographs, and thin from nearer.
    pub low_pass: f32,
    /// Gaussians nearer than this along the camera's z are left out \[scene units\].
    pub z_near: f32,
    /// Scales opacity so that the low-pass conserves the integral (splatting.md §3.1 step 4).
    pub anti_aliased: bool,
    /// Background colour, display-referred sRGB.
    pub background: [f32; 3],
    /// Cut through the scene.
    pub clip: Option<ClipPlane>,
    /// Edge of the tiles that Gaussians are sorted into: 8, 16 or 32 pixels. Changes the speed, not one bit of the image.
    pub tile: TileSize,
}

/// Variance of an average over a pixel \[px²\].
pub(crate) const BOX: f64 = 1.0 / 12.0;

/// Edge of a tile in pixels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum TileSize {
    /// 8 × 8 pixels.
    T8,
    /// 16 × 16 pixels.
    #[default]
    T16,
    /// 32 × 32 pixels.
    T32,
}

impl TileSize {
    /// The edge in pixels.
    pub const fn pixels(self) -> usize {
        match self {
            Self::T8 => 8,
            Self::T16 => 16,
            Self::T32 => 32,
        }
    }
}

impl Settings {
    /// Variances that are added to the image covariance of a Gaussian whose training's pixels are q pixels of the picture (1: not known):
    /// the model's own, and that of the wider average, for which its opacity pays (see [`Settings::low_pass`]) \[px²\].
    pub fn blur(&self, q2: f64) -> [f64; 2] {
        [f64::from(self.low_pass) * q2, BOX * (1.0 - q2).max(0.0)]
    }

    /// The smallest alpha that counts, with its lower bound.
    pub(crate) fn least_alpha(&self) -> f32 {
        self.alpha_min.max(1e-30)
    }

    /// log₂ of the smallest alpha that counts.
    pub(crate) fn log_alpha_min(&self) -> f32 {
        self.least_alpha().log2()
    }
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            alpha_min: 1.0 / 255.0,
            alpha_max: 0.99,
            t_stop: 1e-4,
            low_pass: 0.3,
            z_near: 0.01,
            anti_aliased: false,
            background: [0.0; 3],
            clip: None,
            tile: TileSize::T16,
        }
    }
}
