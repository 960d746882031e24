//! Pictures of several variants beside each other.

use std::path::Path;

use megas_film::{Mp4Writer, write_png};
use megas_metrics::consistency::second_difference;
use megas_model::Image;

use crate::claims::{captioned, place};
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
        // The last three pictures of every variant.
        let mut recent: Vec<Vec<Image>> = vec![Vec::new(); self.folders.len()];
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
            for ((recent, picture), sum) in recent.iter_mut().zip(now).zip(&mut sums) {
                if recent.len() == 3 {
                    recent.remove(0);
                }
                recent.push(picture);
                *sum += unrest(recent);
            }
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

/// M11 of a few pictures in a row, over the whole picture.
fn unrest(frames: &[Image]) -> f64 {
    let everywhere = frames.first().map_or(0, |f| f.data.len() / f.channels as usize);
    second_difference(frames, &vec![true; everywhere]).unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steady_change_is_calm_and_flicker_is_not() {
        let grey = |v: f32| Image { width: 2, height: 1, channels: 3, data: vec![v; 6] };
        assert!(unrest(&[grey(0.1), grey(0.2), grey(0.3)]) < 1e-6);
        assert!((unrest(&[grey(0.1), grey(0.3), grey(0.1)]) - 0.4).abs() < 1e-6);
    }
}
