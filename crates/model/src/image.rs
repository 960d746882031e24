//! Images and posed views.

use crate::Camera;

/// A floating-point image, row by row from the top left, channels interleaved.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Image {
    /// Width \[px\].
    pub width: u32,
    /// Height \[px\].
    pub height: u32,
    /// Values per pixel (1 = grey, 3 = RGB, 4 = RGBA with straight alpha).
    pub channels: u32,
    /// `width · height · channels` values; colours are display-referred sRGB in [0, 1].
    pub data: Vec<f32>,
}

impl Image {
    /// An image of zeros.
    pub fn new(width: u32, height: u32, channels: u32) -> Self {
        Self { width, height, channels, data: vec![0.0; width as usize * height as usize * channels as usize] }
    }

    /// The values of one pixel.
    #[inline(always)]
    pub fn pixel(&self, x: u32, y: u32) -> &[f32] {
        let c = self.channels as usize;
        let i = (y as usize * self.width as usize + x as usize) * c;
        &self.data[i..i + c]
    }

    /// The values of one pixel, for writing.
    #[inline(always)]
    pub fn pixel_mut(&mut self, x: u32, y: u32) -> &mut [f32] {
        let c = self.channels as usize;
        let i = (y as usize * self.width as usize + x as usize) * c;
        &mut self.data[i..i + c]
    }

    /// 8-bit values with rounding; out-of-range is clamped.
    pub fn to_u8(&self) -> Vec<u8> {
        self.data.iter().map(|v| (v.clamp(0.0, 1.0) * 255.0 + 0.5) as u8).collect()
    }
}

/// A photograph with its camera and, for synthetic views, its ground truth.
#[derive(Clone, Debug)]
pub struct View {
    /// Identity, the relative path of the image.
    pub name: String,
    /// Pose and intrinsics.
    pub camera: Camera,
    /// RGB or RGBA (straight alpha).
    pub image: Image,
    /// Depth along the camera's z axis in scene units, +∞ where nothing was hit; one channel.
    pub depth: Option<Image>,
    /// Unit surface normal in world axes, zero where nothing was hit; three channels.
    pub normal: Option<Image>,
}
