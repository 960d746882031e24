//! Pictures of several variants beside each other.

use std::path::Path;

use megas_film::{Mp4Writer, write_png};
use megas_model::Image;

use crate::claims::captioned;
use crate::render::{picture_path, read_png};
use crate::{Event, Failure, Sink};

/// Variants with frames of the same size and number.
pub struct Film<'a> {
    pub labels: Vec<&'a str>,
    /// Folders of their pictures.
    pub folders: Vec<&'a Path>,
    /// "rgb" or "thermal".
    pub kind: &'static str,
    pub columns: usize,
    pub frames: u64,
    pub fps: f64,
}

impl Film<'_> {
    /// Picture `k` of every variant.
    fn pictures(&self, k: u64) -> Result<Vec<Image>, Failure> {
        self.folders.iter().map(|f| read_png(&picture_path(f, "main", self.kind, k))).collect()
    }

    /// Tiles in rows of `columns`, with captions.
    fn tiles(&self, pictures: &[Image]) -> Result<Image, Failure> {
        let (w, h) = (pictures[0].width, pictures[0].height);
        let mut out = Image::new(w * self.columns as u32, h * pictures.len().div_ceil(self.columns) as u32, 3);
        for (i, (picture, label)) in pictures.iter().zip(&self.labels).enumerate() {
            place(&mut out, &captioned(picture, label)?, (i % self.columns) as u32 * w, (i / self.columns) as u32 * h);
        }
        Ok(out)
    }

    /// Writes the film. Returns the mean second difference in time of each variant's pictures in [0, 1], which for a camera at
    /// rest is the temporal unrest M11 (splatting.md §9.3), here over the whole picture.
    pub fn write(&self, path: &Path, sink: &dyn Sink) -> Result<Vec<f64>, Failure> {
        let fail = |e: megas_film::FilmError| Failure::Input(e.to_string());
        sink.event(Event::Stage { name: "encode", steps: self.frames });
        let mut writer = None;
        let mut past: [Option<Vec<Image>>; 2] = [None, None];
        let mut sums = vec![0.0; self.folders.len()];
        for k in 0..self.frames {
            let now = self.pictures(k)?;
            let image = self.tiles(&now)?;
            if writer.is_none() {
                writer = Some(Mp4Writer::create(path, image.width, image.height, self.fps, true).map_err(fail)?);
            }
            if let Some(w) = &mut writer {
                w.push(&image).map_err(fail)?;
            }
            if let [Some(a), Some(b)] = &past {
                for (i, sum) in sums.iter_mut().enumerate() {
                    *sum += second_difference(&a[i], &b[i], &now[i]);
                }
            }
            past = [past[1].take(), Some(now)];
            sink.event(Event::Step { done: k + 1 });
        }
        if let Some(w) = writer {
            w.finish().map_err(fail)?;
        }
        let triples = self.frames.saturating_sub(2).max(1) as f64;
        Ok(sums.iter().map(|s| s / triples).collect())
    }

    /// Writes the sheet of stills: a row per moment, a column per variant.
    pub fn stills(&self, times: &[f64], path: &Path) -> Result<(), Failure> {
        let mut sheet: Option<Image> = None;
        for (row, t) in times.iter().enumerate() {
            let pictures = self.pictures((t * (self.frames - 1) as f64).round() as u64)?;
            let (w, h) = (pictures[0].width, pictures[0].height);
            let out = sheet.get_or_insert_with(|| Image::new(w * pictures.len() as u32, h * times.len() as u32, 3));
            for (i, (picture, label)) in pictures.iter().zip(&self.labels).enumerate() {
                place(out, &captioned(picture, label)?, i as u32 * w, row as u32 * h);
            }
        }
        sheet.map_or(Ok(()), |s| write_png(path, &s, true).map_err(|e| Failure::Input(e.to_string())))
    }
}

fn place(out: &mut Image, tile: &Image, left: u32, top: u32) {
    for y in 0..tile.height.min(out.height - top) {
        for x in 0..tile.width.min(out.width - left) {
            out.pixel_mut(left + x, top + y).copy_from_slice(tile.pixel(x, y));
        }
    }
}

fn second_difference(a: &Image, b: &Image, c: &Image) -> f64 {
    let sum: f64 = a.data.iter().zip(&b.data).zip(&c.data).map(|((a, b), c)| f64::from((a - 2.0 * b + c).abs())).sum();
    sum / a.data.len().max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steady_change_is_calm_and_flicker_is_not() {
        let grey = |v: f32| Image { width: 2, height: 1, channels: 3, data: vec![v; 6] };
        assert!(second_difference(&grey(0.1), &grey(0.2), &grey(0.3)) < 1e-6);
        assert!((second_difference(&grey(0.1), &grey(0.3), &grey(0.1)) - 0.4).abs() < 1e-6);
    }
}
