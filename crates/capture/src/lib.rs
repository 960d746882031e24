//! A folder of posed photographs to views ready for training (splatting.md §2).
//!
//! [`load`] reads the poses of COLMAP models and of the `transforms.json` family, checks them against the photographs, takes
//! lens distortion out, reduces, masks and splits; [`seeds`] places the first Gaussians. Whatever comes from outside is compared
//! with the length of its file before anything is allocated for it; errors say in one line which file, where, what was found,
//! what was expected and what to do.

mod colmap;
mod develop;
mod error;
mod lens;
mod listing;
mod optics;
mod path;
mod picture;
mod plan;
mod resample;
mod seeds;
mod source;
mod transforms;
mod undistort;

use std::path::Path;

use megas_math::vec3;
use megas_model::{Camera, Image};

pub use error::{CaptureError, Defect, Result};
pub use seeds::{Seeds, seeds};

/// One photograph, decoded; 8 bits per channel to stay within memory.
#[derive(Clone, Debug, PartialEq)]
pub struct Photo {
    /// Identity: the relative path of the image as the poses list it.
    pub name: String,
    /// Pose and intrinsics of these pixels; always a pinhole.
    pub camera: Camera,
    /// 3 (RGB) or 4 (RGBA, straight alpha).
    pub channels: u32,
    /// `width · height · channels` values, row by row from the top left; display-referred sRGB.
    pub pixels: Vec<u8>,
    /// How much each pixel counts, 0 to 255: the user's mask times whether the lens showed the pixel at all. `None` if every
    /// pixel counts.
    pub mask: Option<Vec<u8>>,
}

impl Photo {
    /// The pixels as floats in [0, 1].
    pub fn to_image(&self) -> Image {
        let data = self.pixels.iter().map(|v| f32::from(*v) / 255.0).collect();
        Image { width: self.camera.width, height: self.camera.height, channels: self.channels, data }
    }
}

/// Coloured points.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Cloud {
    /// Positions in the frame of the poses, all finite.
    pub position: Vec<[f32; 3]>,
    /// sRGB, one per position.
    pub colour: Vec<[u8; 3]>,
}

/// A loaded capture.
#[derive(Clone, Debug, PartialEq)]
pub struct Capture {
    /// Views to train on, in the order of their names; never empty.
    pub train: Vec<Photo>,
    /// Views to test with, in the order of their names.
    pub test: Vec<Photo>,
    /// Points that came with the poses; never empty.
    pub points: Option<Cloud>,
    /// What was read: `colmap (binary)`, `colmap (text)`, `transforms.json` or `transforms_train.json`.
    pub kind: &'static str,
    /// What the user should know, one line each.
    pub notes: Vec<String>,
}

/// How much smaller than the files the views are made (§2.4).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Downscale {
    /// Images wider than 1600 pixels become 1600 wide.
    #[default]
    Auto,
    /// By this factor, at least 1; a folder `images_<factor>/` is taken instead if it is there.
    Factor(u32),
}

/// How to load.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Options {
    /// Reduction of the images.
    pub downscale: Downscale,
    /// Every how many views, in the order of their names, one becomes a test view, unless the capture says itself which ones
    /// are; 0 trains on all of them, whatever the capture says.
    pub eval_every: u32,
    /// Cut away what the lens did not show, instead of masking it.
    pub crop_undistorted: bool,
    /// Memory that the views and their decoding may take \[bytes\].
    pub memory_budget_bytes: u64,
}

impl Default for Options {
    fn default() -> Self {
        Self { downscale: Downscale::Auto, eval_every: 8, crop_undistorted: false, memory_budget_bytes: 8 << 30 }
    }
}

/// Loads the capture in `folder`: COLMAP (`sparse/0`, `sparse`, or the folder itself; binary before text), else
/// `transforms_train.json` and its siblings, else `transforms.json`.
///
/// # Errors
/// Every defect of the capture is an error, also a single missing or damaged photograph; things that merely may surprise go
/// into [`Capture::notes`].
pub fn load(folder: &Path, options: &Options) -> Result<Capture> {
    load_unless(folder, options, &|| false)
}

/// As [`load`], but gives up before the next photograph as soon as `stopped` says so.
///
/// # Errors
/// As [`load`], and [`CaptureError::Stopped`].
pub fn load_unless(folder: &Path, options: &Options, stopped: &(dyn Fn() -> bool + Sync)) -> Result<Capture> {
    if let Downscale::Factor(r) = options.downscale
        && r == 0
    {
        return Err(CaptureError::Option { option: "downscale", found: "0".into(), expected: "a whole number from 1" });
    }
    develop::develop(folder, read_listing(folder)?, options, stopped)
}

fn read_listing(folder: &Path) -> Result<listing::Listing> {
    let not = |why: String| CaptureError::NotACapture { folder: folder.to_path_buf(), why };
    if folder.is_file() {
        return Err(not("this is a file; give the folder that holds it and the photographs".into()));
    }
    if !folder.is_dir() {
        return Err(not("there is no such folder".into()));
    }
    let transforms = transforms::find(folder);
    if let Some((model, binary)) = colmap::find(folder) {
        let mut listing = colmap::read(folder, &model, binary)?;
        if transforms.is_some() {
            listing.notes.push(format!("the poses were taken from {}, not from transforms.json beside it", model.display()));
        }
        return Ok(listing);
    }
    match transforms {
        Some(found) => transforms::read(folder, &found),
        None => {
            let looked = "looked for cameras.bin and images.bin (or .txt) in sparse/0, sparse and the folder itself, for \
                          transforms_train.json and for transforms.json; compute camera poses first, for instance with COLMAP";
            Err(not(looked.into()))
        }
    }
}

/// The scene extent `E = 1.1 · max ‖c − mean(c)‖` over the cameras' positions (§2.6). One scene unit if they all stand at the
/// same place (or there are none), so that what is measured in `E` never vanishes.
pub fn extent<'a>(cameras: impl Iterator<Item = &'a Camera>) -> f32 {
    let centres: Vec<[f64; 3]> = cameras.map(|c| vec3::cast(c.center())).collect();
    let sum = centres.iter().fold([0.0; 3], |s, c| vec3::add(s, *c));
    let mean = vec3::scale(sum, 1.0 / centres.len().max(1) as f64);
    let far = centres.iter().map(|c| vec3::norm(vec3::sub(*c, mean))).fold(0.0, f64::max);
    let size = centres.iter().map(|c| vec3::norm(*c)).fold(0.0, f64::max);
    // Rounding of equal positions is not an extent.
    if far > 1e-6 * size { (1.1 * far) as f32 } else { 1.0 }
}
