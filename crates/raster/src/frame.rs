//! What a render gives back. All images are row by row from the top left; a frame can be reused for any size and channel set.

use megas_model::Image;

use crate::Channels;

/// [`Frame::argmax`] where nothing was blended.
pub const NO_GAUSSIAN: u32 = u32::MAX;

/// The images of one render. A channel that was not asked for is empty (splatting.md §3.3).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Frame {
    /// Width \[px\].
    pub width: u32,
    /// Height \[px\].
    pub height: u32,
    /// Composited colour `Σ w c + T·background`, not clamped above.
    pub rgb: Vec<[f32; 3]>,
    /// Transmittance `T` that is left, in (0, 1].
    pub transmittance: Vec<f32>,
    /// Expected depth `Σ w z / max(A, 1e-6)` along the camera's z \[scene units\]; 0 where nothing was blended.
    pub depth: Vec<f32>,
    /// Depth along z of the blended plane; +∞ where it is not defined (`A < 0.5` or seen edge-on).
    pub planar_depth: Vec<f32>,
    /// Depth along z of the last blended Gaussian before half of the light was gone; 0 where nothing was blended.
    pub median_depth: Vec<f32>,
    /// Raw blended normal `Σ w n`, world axes, every `n` turned to the camera.
    pub normal: Vec<[f32; 3]>,
    /// Raw blended signed distance of the camera from the Gaussians' planes, `Σ w n·(μ − c)` \[scene units\].
    pub plane: Vec<f32>,
    /// Raw blended temperature `Σ w T` \[K\]; see [`Frame::kelvin`].
    pub temperature: Vec<f32>,
    /// Index of the Gaussian with the largest weight (the nearest of equals), [`NO_GAUSSIAN`] without any.
    pub argmax: Vec<u32>,
    /// That weight.
    pub argmax_weight: Vec<f32>,
    /// Per-Gaussian statistics; empty unless asked for.
    pub statistics: Statistics,
}

/// What each Gaussian contributed to one or several images; every array is as long as the set, or empty.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Statistics {
    /// Largest blend weight in any pixel.
    pub w_max: Vec<f32>,
    /// Sum of blend weights over all pixels.
    pub w_sum: Vec<f32>,
    /// Number of pixels in which the Gaussian was blended.
    pub pixels: Vec<u32>,
    /// Number of pixels in which the Gaussian had the largest weight.
    pub argmax_pixels: Vec<u32>,
    /// Orientation votes `Σ w·[T > 0.5]·(−d)`, `d` the unit viewing ray, world axes (splatting.md §6.2).
    pub votes: Vec<[f32; 3]>,
}

impl Statistics {
    /// Adds the statistics of another view of the same Gaussians; an empty one takes its size from `other`.
    pub fn merge(&mut self, other: &Self) {
        if self.w_max.is_empty() {
            self.resize(other.w_max.len());
        }
        assert_eq!(self.w_max.len(), other.w_max.len(), "statistics of different sets");
        for i in 0..self.w_max.len() {
            self.w_max[i] = self.w_max[i].max(other.w_max[i]);
            self.w_sum[i] += other.w_sum[i];
            self.pixels[i] += other.pixels[i];
            self.argmax_pixels[i] += other.argmax_pixels[i];
            for k in 0..3 {
                self.votes[i][k] += other.votes[i][k];
            }
        }
    }

    /// Makes room for `n` Gaussians, all zero.
    pub(crate) fn resize(&mut self, n: usize) {
        zeroed(&mut self.w_max, n, 0.0);
        zeroed(&mut self.w_sum, n, 0.0);
        zeroed(&mut self.pixels, n, 0);
        zeroed(&mut self.argmax_pixels, n, 0);
        zeroed(&mut self.votes, n, [0.0; 3]);
    }
}

fn zeroed<T: Copy>(v: &mut Vec<T>, n: usize, zero: T) {
    v.clear();
    v.resize(n, zero);
}

impl Frame {
    /// Index of the pixel in column `x` and row `y`.
    #[inline(always)]
    pub fn index(&self, x: u32, y: u32) -> usize {
        y as usize * self.width as usize + x as usize
    }

    /// Accumulated alpha `A = 1 − T` of pixel `i`.
    #[inline(always)]
    pub fn alpha(&self, i: usize) -> f32 {
        1.0 - self.transmittance[i]
    }

    /// Temperature of pixel `i`, normalised by alpha; `None` where `A < 0.5` or without that channel.
    #[inline(always)]
    pub fn kelvin(&self, i: usize) -> Option<f32> {
        let (a, t) = (self.alpha(i), *self.temperature.get(i)?);
        (a >= 0.5).then(|| t / a)
    }

    /// The composited colour as an image of three channels.
    pub fn rgb_image(&self) -> Image {
        Image { width: self.width, height: self.height, channels: 3, data: self.rgb.as_flattened().to_vec() }
    }

    /// Colour with straight alpha; what a render over a black background holds, made independent of it.
    pub fn rgba_image(&self, background: [f32; 3]) -> Image {
        let mut image = Image::new(self.width, self.height, 4);
        for (i, out) in image.data.chunks_exact_mut(4).enumerate() {
            let (t, a) = (self.transmittance[i], self.alpha(i));
            for k in 0..3 {
                out[k] = (self.rgb[i][k] - t * background[k]) / a.max(1e-6);
            }
            out[3] = a;
        }
        image
    }

    /// Sizes every array for `channels`; contents are unspecified where the render writes them anyway.
    pub(crate) fn prepare(&mut self, width: u32, height: u32, channels: Channels, gaussians: usize) {
        (self.width, self.height) = (width, height);
        let n = width as usize * height as usize;
        let colour = channels != Channels::Weights;
        let geometry = channels == Channels::Geometry;
        let winner = geometry || channels == Channels::Weights;
        let thermal = geometry || channels == Channels::RgbaTemperature;
        let size = |wanted: bool| if wanted { n } else { 0 };
        self.rgb.resize(size(colour), [0.0; 3]);
        self.transmittance.resize(n, 1.0);
        for plane in [&mut self.depth, &mut self.planar_depth, &mut self.median_depth, &mut self.plane] {
            plane.resize(size(geometry), 0.0);
        }
        self.normal.resize(size(geometry), [0.0; 3]);
        self.temperature.resize(size(thermal), 0.0);
        self.argmax.resize(size(winner), NO_GAUSSIAN);
        self.argmax_weight.resize(size(winner), 0.0);
        self.statistics.resize(if channels == Channels::Weights { gaussians } else { 0 });
    }
}
