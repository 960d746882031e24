//! State of a training as bytes. Resuming reproduces the uninterrupted training bit by bit (splatting.md §5.10).
//!
//! Layout: magic, length of a JSON header (u64), the header, then the arrays it implies as little-endian 32-bit values.

use std::io::{Read, Write};

use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::options::Options;
use crate::trainer::Trainer;

const MAGIC: &[u8; 8] = b"MGTRAIN1";
/// Longest header that is believed.
const MOST_HEADER: u64 = 1 << 20;

/// Why a checkpoint cannot be continued.
#[derive(Debug, Error)]
pub enum CheckpointError {
    /// It cannot be read.
    #[error("{0}")]
    Io(#[from] std::io::Error),
    /// It is not a checkpoint, or damaged.
    #[error("not a usable checkpoint: {0}")]
    Damaged(String),
    /// It belongs to a training with other options.
    #[error("the checkpoint belongs to a training with other options ({0}); start anew or use the same")]
    OtherOptions(String),
}

#[derive(Serialize, Deserialize)]
struct Header {
    options: Options,
    step: u32,
    anisotropy: f32,
    was_reset: bool,
    adam_steps: u64,
    splats: u64,
    sh_degree: u8,
    /// Views with an exposure of their own.
    #[serde(default)]
    exposures: u64,
}

/// Every array of the state in a fixed order, as 32-bit words.
fn arrays(t: &mut Trainer) -> Vec<&mut [u8]> {
    let m = &mut t.model;
    let stride = m.splats.sh_stride();
    let s = &mut m.splats;
    let mut out: Vec<&mut [u8]> = vec![
        bytemuck::cast_slice_mut(&mut s.mean),
        bytemuck::cast_slice_mut(&mut s.log_scale),
        bytemuck::cast_slice_mut(&mut s.rotation),
        bytemuck::cast_slice_mut(&mut s.opacity_logit),
        bytemuck::cast_slice_mut(&mut s.sh),
        bytemuck::cast_slice_mut(&mut m.activity.gradient),
        bytemuck::cast_slice_mut(&mut m.activity.views),
        bytemuck::cast_slice_mut(&mut m.activity.radius),
    ];
    for (_, moments, _) in m.adam.arrays(stride) {
        out.push(bytemuck::cast_slice_mut(&mut moments.first));
        out.push(bytemuck::cast_slice_mut(&mut moments.second));
    }
    for maps in [&mut t.exposures.map, &mut t.exposures.first, &mut t.exposures.second] {
        out.push(bytemuck::cast_slice_mut(maps));
    }
    out
}

impl Trainer {
    /// Writes the state.
    ///
    /// # Errors
    /// What the writer reports.
    pub fn save(&mut self, out: &mut impl Write) -> std::io::Result<()> {
        let header = Header {
            options: self.options.clone(),
            step: self.step,
            anisotropy: self.anisotropy,
            was_reset: self.was_reset,
            adam_steps: self.model.adam.steps,
            splats: self.model.splats.len() as u64,
            sh_degree: self.model.splats.sh_degree,
            exposures: self.exposures.map.len() as u64,
        };
        let header = serde_json::to_vec(&header)?;
        out.write_all(MAGIC)?;
        out.write_all(&(header.len() as u64).to_le_bytes())?;
        out.write_all(&header)?;
        for a in arrays(self) {
            out.write_all(a)?;
        }
        Ok(())
    }

    /// Continues from a state written by [`Trainer::save`] of a training with the same options; `length` is the number of
    /// bytes that `from` holds.
    ///
    /// # Errors
    /// If it cannot be read, is damaged or belongs to other options; the training is then as before.
    pub fn load(&mut self, from: &mut impl Read, length: u64) -> Result<(), CheckpointError> {
        let damaged = |what: String| Err(CheckpointError::Damaged(what));
        let mut start = [0u8; 16];
        from.read_exact(&mut start)?;
        if &start[..8] != MAGIC {
            return damaged("it does not begin with the mark of a training".into());
        }
        let size = u64::from_le_bytes(std::array::from_fn(|k| start[8 + k]));
        if size > MOST_HEADER || size + 16 > length {
            return damaged(format!("its header claims {size} bytes"));
        }
        let mut text = vec![0u8; size as usize];
        from.read_exact(&mut text)?;
        let header: Header = match serde_json::from_slice(&text) {
            Ok(h) => h,
            Err(e) => return damaged(format!("its header cannot be understood ({e})")),
        };
        if header.options != self.options {
            let value = |o: &Options| serde_json::to_value(o).unwrap_or_default();
            let (a, b) = (value(&header.options), value(&self.options));
            let names: Vec<String> =
                a.as_object().into_iter().flatten().filter(|(k, v)| b.get(k.as_str()) != Some(v)).map(|(k, _)| k.clone()).collect();
            return Err(CheckpointError::OtherOptions(names.join(", ")));
        }
        if header.sh_degree > 3 {
            return damaged(format!("degree {} of its spherical harmonics", header.sh_degree));
        }
        if header.exposures != self.exposures.map.len() as u64 {
            return damaged(format!("exposures of {} views, not of {}", header.exposures, self.exposures.map.len()));
        }
        let stride = 3 * (u64::from(header.sh_degree) + 1).pow(2);
        // Parameters, two moments each, activity.
        let words = 3 * (11 + stride) + 4;
        let fixed = 16 + size + 3 * 48 * header.exposures;
        let expected = header.splats.checked_mul(4 * words).and_then(|b| b.checked_add(fixed));
        if expected != Some(length) {
            return damaged(format!("{} splats do not fit its {length} bytes", header.splats));
        }
        let n = header.splats as usize;
        let mut splats = megas_model::Splats { sh_degree: header.sh_degree, ..Default::default() };
        splats.mean = vec![[0.0; 3]; n];
        splats.log_scale = vec![[0.0; 3]; n];
        splats.rotation = vec![[0.0; 4]; n];
        splats.opacity_logit = vec![0.0; n];
        splats.sh = vec![0.0; n * splats.sh_stride()];
        splats.fill_attributes();
        let before = (std::mem::replace(&mut self.model, crate::model::Model::new(splats)), self.exposures.clone());
        for a in arrays(self) {
            if let Err(e) = from.read_exact(a) {
                (self.model, self.exposures) = before;
                return Err(e.into());
            }
        }
        self.model.adam.steps = header.adam_steps;
        (self.step, self.anisotropy, self.was_reset) = (header.step, header.anisotropy, header.was_reset);
        Ok(())
    }
}
