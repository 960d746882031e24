//! Held-out views: how well they are met, as numbers and as a contact sheet (splatting.md §9.3 M1).

use std::path::{Path, PathBuf};

use megas_capture::Photo;
use megas_film::write_png;
use megas_metrics::image::Quality;
use megas_model::{Camera, Image};
use serde_json::{Value, json};

use super::pictures::{ContactSheet, over};
use crate::disk::write_json;
use crate::{Event, Failure, Sink};

/// Colour behind transparent photographs when they are compared.
pub const WHITE: [f32; 3] = [1.0; 3];

/// The comparison of all held-out views.
pub struct Evaluation {
    /// Means over the views; `None` without held-out views.
    pub mean: Option<Quality>,
    /// Every view with its identity.
    pub views: Vec<(String, Quality)>,
    /// Renders beside photographs; `None` without held-out views.
    pub sheet: Option<Image>,
}

impl Evaluation {
    /// Compares what `render` makes of every photograph's camera with the photograph. Transparent photographs and their
    /// renders are both put on white, opaque ones are rendered over `background`; masked pixels do not count.
    /// `called` is what the contact sheet calls the photographs.
    pub fn new(
        photos: &[Photo],
        called: &str,
        background: [f32; 3],
        mut render: impl FnMut(&Camera, [f32; 3]) -> Image,
    ) -> Result<Self, Failure> {
        let shown = ContactSheet::chosen(photos.len());
        let mut sheet = ContactSheet::default();
        let mut views = Vec::with_capacity(photos.len());
        for (k, photo) in photos.iter().enumerate() {
            let (image, truth) = compared(photo, background, &mut render);
            let mask: Option<Vec<bool>> = photo.mask.as_ref().map(|m| m.iter().map(|&v| v >= 128).collect());
            // Nothing can be said of a view that counts nowhere.
            if mask.as_ref().is_some_and(|m| !m.contains(&true)) {
                continue;
            }
            let quality = Quality::of(&image, &truth, mask.as_deref());
            if shown.contains(&k) {
                sheet.add(&image, &truth, [&format!("{:.2} dB", quality.psnr), called])?;
            }
            views.push((photo.name.clone(), quality));
        }
        let qualities: Vec<Quality> = views.iter().map(|v| v.1).collect();
        Ok(Self { mean: Quality::mean(&qualities), views, sheet: sheet.image() })
    }

    /// Writes the figures and, if there are views, the contact sheet, whose path is returned.
    pub fn write(&self, folder: &Path, sink: &dyn Sink) -> Result<Option<PathBuf>, Failure> {
        write_json(&folder.join("evaluation.json"), &self.to_json())?;
        let Some(image) = &self.sheet else { return Ok(None) };
        let path = folder.join("contact_sheet.png");
        write_png(&path, image, true).map_err(|e| Failure::Input(e.to_string()))?;
        sink.event(Event::File(&path));
        Ok(Some(path))
    }

    /// Means and every view.
    pub fn to_json(&self) -> Value {
        let one = |(name, q): &(String, Quality)| json!({ "name": name, "psnr": q.psnr, "ssim": q.ssim, "flip": q.flip });
        json!({ "mean": self.mean, "views": self.views.iter().map(one).collect::<Vec<_>>() })
    }
}

/// Render and photograph, both with three channels over the same colour.
pub fn compared(photo: &Photo, background: [f32; 3], render: &mut impl FnMut(&Camera, [f32; 3]) -> Image) -> (Image, Image) {
    let behind = if photo.channels == 4 { WHITE } else { background };
    (render(&photo.camera, behind), over(photo, behind))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn transparent_views_are_compared_over_white() {
        let camera = Camera::look_at([0.0, -3.0, 0.0], [0.0; 3], [0.0, 0.0, 1.0], 0.7, 32, 24);
        let photo = |channels: u32, mask| Photo {
            name: format!("{channels}"),
            camera,
            channels,
            pixels: [255, 0, 0, 51][..channels as usize].repeat(32 * 24),
            mask,
        };
        let behind = |c: &Camera, b: [f32; 3]| {
            let truth = if b == WHITE { [1.0, 0.8, 0.8] } else { [1.0, 0.0, 0.0] };
            Image { width: c.width, height: c.height, channels: 3, data: truth.repeat(32 * 24) }
        };
        let nothing = Some(vec![0u8; 32 * 24]);
        let e = Evaluation::new(&[photo(4, None), photo(3, None), photo(3, nothing)], "photograph", [0.0; 3], behind).unwrap();
        assert_eq!(e.views.len(), 2);
        assert!(e.views.iter().all(|v| v.1.psnr > 100.0), "{:?}", e.views);
        assert!(e.sheet.is_some() && e.to_json()["views"][1]["name"] == "3");
    }
}
