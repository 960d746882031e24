//! The contact sheet: the truth and every method beside each other, deformed.

use std::path::Path;

use megas_film::{Captions, side_by_side};
use megas_metrics::deform::Deformation;
use megas_model::Image;

use super::measure::tile;
use super::methods::Contender;
use crate::Failure;
use crate::render::read_png;

/// The picture with a caption in its corner.
pub fn captioned(image: &Image, text: &str) -> Result<Image, Failure> {
    let captions = Captions { left: text, right: "", time: None };
    side_by_side(image, &Image::new(0, image.height, 3), &captions).map_err(|e| Failure::Other(e.to_string()))
}

/// Copies what fits of `tile` into `out`, its corner at `left`, `top`.
pub fn place(out: &mut Image, tile: &Image, left: u32, top: u32) {
    for y in 0..tile.height.min(out.height - top) {
        for x in 0..tile.width.min(out.width - left) {
            out.pixel_mut(left + x, top + y).copy_from_slice(tile.pixel(x, y));
        }
    }
}

/// One row per deformation; the true pictures come first, then the tiles of every method's folder.
pub fn sheet(truth: &[(Deformation, Image)], methods: &[(Contender, &Path)]) -> Result<Option<Image>, Failure> {
    let Some(first) = truth.first() else { return Ok(None) };
    let (w, h) = (first.1.width, first.1.height);
    let mut sheet = Image::new(w * (methods.len() as u32 + 1), h * truth.len() as u32, 3);
    sheet.data.fill(1.0);
    for (row, (d, image)) in truth.iter().enumerate() {
        let mut put = |column: usize, image: &Image| {
            place(&mut sheet, image, column as u32 * w, row as u32 * h);
        };
        put(0, &captioned(image, &format!("{} truth", d.id()))?);
        for (k, (m, folder)) in methods.iter().enumerate() {
            if let Ok(image) = read_png(&tile(folder, *d)) {
                put(k + 1, &captioned(&image, &format!("{} {}", d.id(), m.id()))?);
            }
        }
    }
    Ok(Some(sheet))
}
