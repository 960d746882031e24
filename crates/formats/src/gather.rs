//! Where decoded rows of every splat format go: checks them, clamps them, drops the unusable ones and counts.

use std::path::Path;

use megas_math::sh;
use megas_model::Splats;

use crate::{
    error::{FormatError, Place, Result},
    splat_file::{LoadReport, RenderMode, SplatFile, SplatFormat},
};

/// Bounds of log-scales (splatting.md §1.1).
pub(crate) const LOG_SCALE: f32 = 20.0;

/// A growing set of checked Gaussians.
pub(crate) struct Gather {
    pub splats: Splats,
    dropped: u64,
}

impl Gather {
    /// Room for `rows` Gaussians; the caller has checked that the file can hold that many.
    pub fn new(sh_degree: u8, rows: usize) -> Self {
        Self { splats: Splats::with_capacity(sh_degree, rows), dropped: 0 }
    }

    /// Takes one row, or drops it if a value is unusable; says which.
    #[inline(always)]
    pub fn push(&mut self, mean: [f32; 3], log_scale: [f32; 3], rotation: [f32; 4], opacity_logit: f32, sh: &[f32]) -> bool {
        // Without early exit: the usual row is good, and this way it is checked many values at a time.
        let finite = |values: &[f32]| values.iter().fold(true, |all, v| all & v.is_finite());
        let scales = log_scale.iter().all(|&s| s.is_finite() || s == f32::NEG_INFINITY);
        let norm2: f64 = rotation.iter().map(|&c| f64::from(c) * f64::from(c)).sum();
        if !(finite(&mean) & finite(&rotation) & finite(sh) & scales) || opacity_logit.is_nan() || norm2 == 0.0 {
            self.dropped += 1;
            return false;
        }
        // Lengths whose square is out of reach of single precision are normalised here, everything else at use.
        let rotation = if (1e-30..1e30).contains(&norm2) {
            rotation
        } else {
            let n = norm2.sqrt();
            rotation.map(|c| (f64::from(c) / n) as f32)
        };
        let s = &mut self.splats;
        s.mean.push(mean);
        s.log_scale.push(log_scale.map(|v| v.clamp(-LOG_SCALE, LOG_SCALE)));
        s.rotation.push(rotation);
        s.opacity_logit.push(opacity_logit);
        s.sh.extend_from_slice(sh);
        true
    }

    /// Completes the set.
    pub fn finish(mut self, path: &Path, format: SplatFormat, rows: u64) -> Result<SplatFile> {
        if self.splats.is_empty() {
            let found = if rows == 0 { "no Gaussians".into() } else { format!("{rows} rows, none of them usable") };
            let expected = "at least one row with finite position, scale, rotation and colour";
            return Err(FormatError::defect(
                path,
                Place::File,
                found,
                expected,
                "the training that made this file has diverged, or it is empty",
            ));
        }
        self.splats.fill_attributes();
        let report = LoadReport {
            format,
            rows,
            count: self.splats.len(),
            dropped_non_finite: self.dropped,
            replaced_attributes: 0,
            sh_degree: self.splats.sh_degree,
            render_mode: RenderMode::Default,
            antialiased: false,
            has_temperature: false,
        };
        Ok(SplatFile { splats: self.splats, report })
    }
}

/// The degree whose channel-major `f_rest_*` list has `rest` entries.
pub(crate) fn degree_of_rest(rest: usize) -> Option<u8> {
    (0..=3).find(|&l| (sh::coefficients(l) - 1) * 3 == rest)
}

/// Number of splats as an index, refused beyond what a birth id can name.
pub(crate) fn row_count(path: &Path, element: &str, count: u64) -> Result<usize> {
    match u32::try_from(count) {
        Ok(n) => Ok(n as usize),
        Err(_) => {
            let place = Place::Element(element.into());
            let remedy = "thin the splat out or split the file";
            Err(FormatError::defect(path, place, format!("{count} rows"), "fewer than 2^32 rows", remedy))
        }
    }
}
