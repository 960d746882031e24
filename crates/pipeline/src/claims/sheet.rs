//! The contact sheet: the truth and every method beside each other, deformed.

use std::path::Path;

use megas_film::{Captions, side_by_side};
use megas_metrics::deform::Deformation;
use megas_model::Image;

use super::measure::tile;
use super::methods::Contender;
use crate::Failure;

/// Reads a picture of 8 bits per channel.
fn read(path: &Path) -> Option<Image> {
    let rgb = image::open(path).ok()?.to_rgb8();
    let data = rgb.as_raw().iter().map(|v| f32::from(*v) / 255.0).collect();
    Some(Image { width: rgb.width(), height: rgb.height(), channels: 3, data })
}

/// The picture with a caption in its corner.
pub fn captioned(image: &Image, text: &str) -> Result<Image, Failure> {
    let captions = Captions { left: text, right: "", time: None };
    side_by_side(image, &Image::new(0, image.height, 3), &captions).map_err(|e| Failure::Other(e.to_string()))
}

/// One row per deformation; the true pictures come first, then the tiles of every method's folder.
pub fn sheet(truth: &[(Deformation, Image)], methods: &[(Contender, &Path)]) -> Result<Option<Image>, Failure> {
    let Some(first) = truth.first() else { return Ok(None) };
    let (w, h) = (first.1.width, first.1.height);
    let mut sheet = Image::new(w * (methods.len() as u32 + 1), h * truth.len() as u32, 3);
    sheet.data.fill(1.0);
    for (row, (d, image)) in truth.iter().enumerate() {
        let mut put = |column: usize, image: &Image| {
            for y in 0..h.min(image.height) {
                for x in 0..w.min(image.width) {
                    sheet.pixel_mut(column as u32 * w + x, row as u32 * h + y).copy_from_slice(image.pixel(x, y));
                }
            }
        };
        put(0, &captioned(image, &format!("{} truth", d.id()))?);
        for (k, (m, folder)) in methods.iter().enumerate() {
            if let Some(image) = read(&tile(folder, *d)) {
                put(k + 1, &captioned(&image, &format!("{} {}", d.id(), m.id()))?);
            }
        }
    }
    Ok(Some(sheet))
}
