//! Loading and saving splats whatever their format.

use std::{fmt, io::Write, path::Path};

use megas_model::Splats;

use crate::{
    atomic::write_atomic,
    compressed_ply,
    error::{FormatError, Place, Result, quoted},
    ply::Header,
    source, splat_bin, splat_ply,
};

/// File formats of splats.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SplatFormat {
    /// The ecosystem's PLY (splatting.md §1.3).
    Ply,
    /// Quantised PLY in chunks of 256 (splatting.md §1.4).
    CompressedPly,
    /// 32-byte records without view-dependent colour (splatting.md §1.4).
    Splat,
}

impl fmt::Display for SplatFormat {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Ply => "ply",
            Self::CompressedPly => "compressed.ply",
            Self::Splat => "splat",
        })
    }
}

/// How a set of splats was trained to be rendered (header comment `SplatRenderMode`).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum RenderMode {
    /// Plain 3D Gaussians.
    #[default]
    Default,
    /// Mip-Splatting: opacity is compensated for the screen-space low-pass.
    Mip,
    /// Flat 2D Gaussians (surfels).
    Flat,
}

impl RenderMode {
    pub(crate) fn keyword(self) -> &'static str {
        match self {
            Self::Default => "default",
            Self::Mip => "mip",
            Self::Flat => "2dgs",
        }
    }
}

/// What happened while loading.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LoadReport {
    /// Format of the file.
    pub format: SplatFormat,
    /// Rows in the file.
    pub rows: u64,
    /// Gaussians kept, the length of the set.
    pub count: usize,
    /// Rows left out: a position, scale (except −∞), rotation, opacity or colour that is not finite, or a zero rotation.
    pub dropped_non_finite: u64,
    /// Values of optional attributes outside their range, replaced by the default.
    pub replaced_attributes: u64,
    /// Degree of the spherical harmonics, 0–3.
    pub sh_degree: u8,
    /// From the header comment, or `Flat` where `scale_2` is missing.
    pub render_mode: RenderMode,
    /// From the header comment `antialiased`; true for [`RenderMode::Mip`].
    pub antialiased: bool,
    /// True if the file itself carries temperatures.
    pub has_temperature: bool,
}

/// A loaded file.
#[derive(Clone, Debug, PartialEq)]
pub struct SplatFile {
    /// The Gaussians.
    pub splats: Splats,
    /// What happened while loading.
    pub report: LoadReport,
}

/// How to save.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct WriteOptions {
    /// Replace an existing file.
    pub overwrite: bool,
    /// PLY only: nothing but the classic properties (no temperature, object id, …) and no comments, for viewers that assume a
    /// fixed row.
    pub strict: bool,
    /// PLY only: announced in the header.
    pub render_mode: RenderMode,
}

/// Loads splats from `path`; the content decides between the two PLY formats, the extension `.splat` names the third.
///
/// Positions are taken as they are, in scene units. Log-scales are clamped to ±20 (splatting.md §1.1). Broken rows are
/// dropped and counted; a file without one usable row is an error.
pub fn load_splats(path: impl AsRef<Path>) -> Result<SplatFile> {
    let path = path.as_ref();
    let mut source = source::open(path)?;
    let magic = source.peek(4)?.to_vec();
    let extension = extension(path);
    if magic.starts_with(b"ply") {
        let header = Header::read(&mut source)?;
        return if compressed_ply::recognises(&header) {
            compressed_ply::read(&mut source, &header)
        } else {
            splat_ply::read(&mut source, &header)
        };
    }
    if extension == "splat" {
        return splat_bin::read(&mut source);
    }
    let found = match (magic.as_slice(), extension.as_str()) {
        ([], _) => "an empty file".into(),
        ([0x1f, 0x8b, ..] | b"NGSP", _) | (_, "spz") => "an SPZ file".into(),
        (b"PK\x03\x04", _) | (_, "sog") => "a SOG or ZIP file".into(),
        (_, "ksplat") => "a KSPLAT file".into(),
        (_, "ply") => format!("a .ply file that starts with {}", quoted(&String::from_utf8_lossy(&magic))),
        (m, e) => format!("extension {} and content that starts with {}", quoted(e), quoted(&String::from_utf8_lossy(m))),
    };
    let expected = "a splat in .ply, .compressed.ply or .splat format";
    Err(FormatError::defect(path, Place::File, found, expected, "convert it to .ply first, for example with SuperSplat"))
}

/// Saves splats to `path`, atomically; the extension (`.ply`, `.compressed.ply`, `.splat`) decides the format.
pub fn save_splats(path: impl AsRef<Path>, splats: &Splats, options: &WriteOptions) -> Result<()> {
    let path = path.as_ref();
    let write: fn(&Splats, &WriteOptions, &mut dyn Write) -> std::io::Result<()> = match extension(path).as_str() {
        "compressed.ply" => |s, _, w| compressed_ply::write(s, w),
        "ply" => |s, o, w| splat_ply::write(s, o, w),
        "splat" => |s, _, w| splat_bin::write(s, w),
        other => {
            let expected = ".ply, .compressed.ply or .splat";
            return Err(FormatError::defect(path, Place::File, format!("extension {}", quoted(other)), expected, "choose one of these"));
        }
    };
    write_atomic(path, options.overwrite, |w| write(splats, options, w))
}

fn extension(path: &Path) -> String {
    let name = path.file_name().map(|n| n.to_string_lossy().to_ascii_lowercase()).unwrap_or_default();
    if name.ends_with(".compressed.ply") {
        return "compressed.ply".into();
    }
    Path::new(&name).extension().map(|e| e.to_string_lossy().into_owned()).unwrap_or_default()
}
