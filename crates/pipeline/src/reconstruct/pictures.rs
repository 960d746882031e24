//! Renders beside photographs: previews and contact sheets.

use megas_capture::Photo;
use megas_film::{Captions, side_by_side};
use megas_model::Image;

use crate::Failure;

/// Largest side of one picture of a contact sheet \[px\].
const TILE: u32 = 320;
/// Most pairs on a contact sheet.
const MOST_PAIRS: usize = 40;
/// Pairs beside each other.
const COLUMNS: usize = 3;

/// The photograph over a colour, three channels.
pub fn over(photo: &Photo, background: [f32; 3]) -> Image {
    let image = photo.to_image();
    if image.channels == 3 {
        return image;
    }
    let blend = |p: &[f32]| [0, 1, 2].map(|k| p[k] * p[3] + background[k] * (1.0 - p[3]));
    let data = image.data.chunks_exact(4).flat_map(blend).collect();
    Image { channels: 3, data, ..image }
}

/// A render beside its photograph; `captions` are those of the two.
pub fn pair(render: &Image, photograph: &Image, captions: [&str; 2]) -> Result<Image, Failure> {
    let captions = Captions { left: captions[0], right: captions[1], time: None };
    side_by_side(render, photograph, &captions).map_err(|e| Failure::Other(e.to_string()))
}

/// Reduced by the smallest whole factor that brings both sides to at most `side`, by averaging.
fn reduced(image: &Image, side: u32) -> Image {
    let f = image.width.max(image.height).div_ceil(side).max(1);
    if f == 1 {
        return image.clone();
    }
    let channels = image.channels as usize;
    let mut out = Image::new((image.width / f).max(1), (image.height / f).max(1), image.channels);
    for y in 0..out.height {
        for x in 0..out.width {
            let mut sum = [0.0f32; 4];
            let (columns, rows) = (f.min(image.width - x * f), f.min(image.height - y * f));
            for j in 0..rows {
                for i in 0..columns {
                    let p = image.pixel(x * f + i, y * f + j);
                    (0..channels).for_each(|k| sum[k] += p[k]);
                }
            }
            let n = (columns * rows) as f32;
            let pixel = out.pixel_mut(x, y);
            (0..channels).for_each(|k| pixel[k] = sum[k] / n);
        }
    }
    out
}

/// Pairs collected for one picture.
#[derive(Default)]
pub struct ContactSheet {
    tiles: Vec<Image>,
}

impl ContactSheet {
    /// Which of `count` views go on the sheet: all of them, or as many as fit, evenly spread.
    pub fn chosen(count: usize) -> Vec<usize> {
        let n = count.min(MOST_PAIRS);
        (0..n).map(|k| k * count / n.max(1)).collect()
    }

    /// Adds a render beside its photograph.
    pub fn add(&mut self, render: &Image, photograph: &Image, captions: [&str; 2]) -> Result<(), Failure> {
        self.tiles.push(pair(&reduced(render, TILE), &reduced(photograph, TILE), captions)?);
        Ok(())
    }

    /// The sheet; `None` without pairs.
    pub fn image(&self) -> Option<Image> {
        let columns = self.tiles.len().min(COLUMNS);
        let width = self.tiles.iter().map(|t| t.width).max()?;
        let height = self.tiles.iter().map(|t| t.height).max()?;
        let gap = 4;
        let rows = self.tiles.len().div_ceil(columns);
        let mut sheet = Image::new(columns as u32 * (width + gap) - gap, rows as u32 * (height + gap) - gap, 3);
        sheet.data.fill(0.5);
        for (k, tile) in self.tiles.iter().enumerate() {
            let (x0, y0) = ((k % columns) as u32 * (width + gap), (k / columns) as u32 * (height + gap));
            for y in 0..tile.height {
                for x in 0..tile.width {
                    sheet.pixel_mut(x0 + x, y0 + y).copy_from_slice(tile.pixel(x, y));
                }
            }
        }
        Some(sheet)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sheet_holds_pairs_of_any_size() {
        let mut sheet = ContactSheet::default();
        assert!(sheet.image().is_none());
        for (w, h) in [(700, 300), (100, 90), (1, 1), (320, 320), (50, 60)] {
            let mut image = Image::new(w, h, 3);
            image.data.fill(0.25);
            sheet.add(&image, &image, ["", ""]).unwrap();
        }
        let image = sheet.image().unwrap();
        assert_eq!((image.width, image.height), (3 * 640 + 8, 2 * 320 + 4));
        assert_eq!((image.pixel(300, 98)[0], image.pixel(0, 110)[0]), (0.25, 0.5));
        assert_eq!(ContactSheet::chosen(3), [0, 1, 2]);
        assert_eq!(ContactSheet::chosen(80).len(), MOST_PAIRS);
    }
}
