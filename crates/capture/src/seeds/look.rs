//! One view as the seeding asks it: which pixel shows a point, and what is there.

use megas_math::Vec3;
use megas_model::Camera;

use crate::Photo;

/// A view with quick access to its pixels.
pub(super) struct Look<'p> {
    pub photo: &'p Photo,
    pub camera: &'p Camera,
}

impl<'p> Look<'p> {
    pub fn new(photo: &'p Photo) -> Self {
        Self { photo, camera: &photo.camera }
    }

    /// Index of the pixel that shows `x`; `None` behind the camera, outside the image and where the mask says that the pixel
    /// tells nothing.
    #[inline(always)]
    pub fn pixel(&self, x: Vec3<f32>) -> Option<usize> {
        let p = self.camera.to_camera(x);
        if p[2].is_nan() || p[2] <= 0.0 {
            return None;
        }
        let [u, v] = self.camera.project(p);
        if !(u >= 0.0 && v >= 0.0 && u < self.camera.width as f32 && v < self.camera.height as f32) {
            return None;
        }
        let i = v as usize * self.camera.width as usize + u as usize;
        self.photo.mask.as_ref().is_none_or(|m| m[i] > 0).then_some(i)
    }

    /// Whether the pixel may show the object: not wholly transparent.
    #[inline(always)]
    pub fn opaque(&self, pixel: usize) -> bool {
        self.photo.channels < 4 || self.photo.pixels[4 * pixel + 3] > 0
    }

    /// Colour in [0, 1] and its weight, the alpha.
    #[inline(always)]
    pub fn colour(&self, pixel: usize) -> ([f32; 3], f32) {
        let c = self.photo.channels as usize;
        let px = &self.photo.pixels[pixel * c..][..c];
        let weight = if c == 4 { f32::from(px[3]) / 255.0 } else { 1.0 };
        ([0, 1, 2].map(|k| f32::from(px[k]) / 255.0), weight)
    }
}
