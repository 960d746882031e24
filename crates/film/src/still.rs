//! Single pictures as 8-bit PNG.

use std::{io, path::Path};

use megas_formats::write_atomic;
use megas_model::Image;

use crate::error::{Result, mismatch};

/// Writes an image with 1 (grey), 3 (RGB) or 4 (RGBA, straight alpha) channels of display-referred sRGB in [0, 1] as 8-bit
/// PNG, atomically. Values outside are clamped, not-a-number becomes black.
pub fn write_png(path: impl AsRef<Path>, image: &Image, overwrite: bool) -> Result<()> {
    let colour = match image.channels {
        1 => png::ColorType::Grayscale,
        3 => png::ColorType::Rgb,
        4 => png::ColorType::Rgba,
        n => return Err(mismatch(format!("an image with {n} channels"), "1, 3 or 4 channels")),
    };
    if image.width == 0 || image.height == 0 {
        return Err(mismatch(format!("an image of {}x{} pixels", image.width, image.height), "at least one pixel"));
    }
    write_atomic(path, overwrite, |w| {
        let mut encoder = png::Encoder::new(w, image.width, image.height);
        encoder.set_color(colour);
        encoder.set_depth(png::BitDepth::Eight);
        encoder.set_source_srgb(png::SrgbRenderingIntent::Perceptual);
        encoder.set_compression(png::Compression::Fast);
        let mut writer = encoder.write_header().map_err(plain)?;
        writer.write_image_data(&image.to_u8()).map_err(plain)?;
        writer.finish().map_err(plain)
    })?;
    Ok(())
}

/// The I/O error behind a failure to encode, so that a full disk is still recognised as one.
fn plain(e: png::EncodingError) -> io::Error {
    match e {
        png::EncodingError::IoError(e) => e,
        other => io::Error::other(other.to_string()),
    }
}
