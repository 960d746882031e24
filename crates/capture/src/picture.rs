//! Image files: what their headers claim, and their pixels in 8 bits.

use std::{
    fs::File,
    io::{BufReader, Cursor},
    path::Path,
};

use image::{ImageDecoder, ImageFormat, ImageReader, Limits};

use crate::{
    error::{CaptureError, Fault, Result, TRUNCATED},
    optics::{MAX_SIDE, Size},
    source::read_whole,
};

/// Largest image file that is opened \[bytes\].
const MAX_FILE: u64 = 4 << 30;
/// No encoder of PNG or JPEG gets more pixels than this into one byte: deflate reaches 1032 (8 times that for 1-bit images
/// that are widened), a JPEG of one bit per block some 1400.
const MOST_BYTES_PER_BYTE: u64 = 10_000;

/// What the first bytes of a file claim.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Header {
    pub size: Size,
    /// 3, or 4 with an alpha channel.
    pub channels: usize,
    /// Memory while decoding: file, decoded samples and their 8-bit copy.
    pub peak_bytes: u64,
}

impl Header {
    pub fn pixels(&self) -> u64 {
        u64::from(self.size[0]) * u64::from(self.size[1])
    }
}

/// An image with 8 bits per channel.
pub(crate) struct Picture {
    pub size: Size,
    pub channels: usize,
    pub pixels: Vec<u8>,
}

fn unreadable(path: &Path, error: &image::ImageError) -> CaptureError {
    let remedy = match error {
        image::ImageError::Unsupported(_) => "convert the image to PNG or JPEG",
        _ => TRUNCATED,
    };
    // The library's message names what it choked on; one line of it is enough.
    let text = error.to_string();
    let found = format!("an image that cannot be decoded ({})", text.lines().next().unwrap_or_default());
    Fault::new(found, "a PNG or JPEG photograph", remedy).at(path, "the image")
}

/// Reads the header. Sizes that the file cannot possibly hold are refused.
pub(crate) fn probe(path: &Path) -> Result<Header> {
    let file = File::open(path).map_err(|e| CaptureError::io(path, "open for reading", e))?;
    let meta = file.metadata().map_err(|e| CaptureError::io(path, "open for reading", e))?;
    let file_bytes = meta.len();
    if !meta.is_file() || file_bytes == 0 {
        let found = if meta.is_file() { "an empty file" } else { "a folder or a device" };
        return Err(Fault::new(found, "a PNG or JPEG photograph", "copy the photograph again").at(path, "the image"));
    }
    let reader = ImageReader::new(BufReader::new(file)).with_guessed_format().map_err(|e| CaptureError::io(path, "read", e))?;
    let decoder = reader.into_decoder().map_err(|e| unreadable(path, &e))?;
    let ((w, h), colour) = (decoder.dimensions(), decoder.color_type());
    let decoded = u64::from(w) * u64::from(h) * u64::from(colour.bytes_per_pixel());
    if w == 0 || h == 0 || w > MAX_SIDE || h > MAX_SIDE {
        let expected = format!("sides from 1 to {MAX_SIDE} pixels");
        return Err(Fault::new(format!("an image of {w} × {h} pixels"), expected, "remove the image or replace it").at(path, "the image"));
    }
    if decoded / MOST_BYTES_PER_BYTE > file_bytes + 1024 {
        let found = format!("{w} × {h} pixels claimed by a file of {file_bytes} bytes");
        return Err(Fault::new(found, "a file that can hold its pixels", TRUNCATED).at(path, "the image"));
    }
    let channels = if colour.has_alpha() { 4 } else { 3 };
    let copy = u64::from(w) * u64::from(h) * channels as u64;
    Ok(Header { size: [w, h], channels, peak_bytes: file_bytes + decoded + copy })
}

/// Decodes what [`probe`] looked at. 16-bit samples are rounded to 8, grey becomes RGB, alpha stays straight; the EXIF
/// orientation is not applied, because the programs that compute poses ignore it too (splatting.md §2.4).
pub(crate) fn decode(path: &Path, header: &Header) -> Result<Picture> {
    let image = dynamic(path, header)?;
    let pixels = if header.channels == 4 { image.into_rgba8().into_raw() } else { image.into_rgb8().into_raw() };
    Ok(Picture { size: header.size, channels: header.channels, pixels })
}

/// Decodes a mask: its brightness, 255 where pixels count. Masks of zeros and ones are taken as black and white.
pub(crate) fn decode_mask(path: &Path, header: &Header) -> Result<Vec<u8>> {
    let mut mask = dynamic(path, header)?.into_luma8().into_raw();
    if mask.iter().all(|v| *v <= 1) {
        mask.iter_mut().for_each(|v| *v *= 255);
    }
    Ok(mask)
}

fn dynamic(path: &Path, header: &Header) -> Result<image::DynamicImage> {
    let bytes = read_whole(path, MAX_FILE)?;
    let format = image::guess_format(&bytes).map_err(|e| unreadable(path, &e))?;
    if format == ImageFormat::Jpeg && !jpeg_is_whole(&bytes) {
        return Err(Fault::new("a JPEG without its end", "the end-of-image marker", TRUNCATED).at(path, "the image"));
    }
    let mut reader = ImageReader::with_format(Cursor::new(&bytes), format);
    let mut limits = Limits::default();
    limits.max_image_width = Some(header.size[0]);
    limits.max_image_height = Some(header.size[1]);
    // The budget was compared with the header's size already.
    limits.max_alloc = Some(8 * header.peak_bytes + (64 << 20));
    reader.limits(limits);
    let image = reader.decode().map_err(|e| unreadable(path, &e))?;
    if [image.width(), image.height()] != header.size {
        return Err(
            Fault::new("another size than a moment ago", "a file at rest", "try again when nobody writes to it").at(path, "the image")
        );
    }
    Ok(image)
}

/// Whether the scan data of a JPEG is followed by the end-of-image marker. Decoders paint what is missing grey without a word,
/// and a grey half of a photograph is worse than none.
fn jpeg_is_whole(bytes: &[u8]) -> bool {
    let mut at = 2;
    // Segments before the first scan may hold a thumbnail with an end marker of its own: step over them.
    while let Some([0xff, marker]) = bytes.get(at..at + 2) {
        match marker {
            0xff => at += 1,
            0xda => return bytes[at..].windows(2).rev().any(|w| w == [0xff, 0xd9]),
            0x01 | 0xd0..=0xd8 => at += 2,
            _ => match bytes.get(at + 2..at + 4) {
                Some(length) => at += 2 + usize::from(u16::from_be_bytes([length[0], length[1]])),
                None => return false,
            },
        }
    }
    // Not laid out as expected: the decoder will say why.
    true
}

#[cfg(test)]
mod tests {
    use image::{DynamicImage, ImageBuffer, Luma, LumaA, Rgb};

    use super::*;

    fn stored(image: impl Into<DynamicImage>, name: &str) -> Result<Picture> {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join(name);
        image.into().save(&path).unwrap();
        decode(&path, &probe(&path)?)
    }

    #[test]
    fn deep_grey_and_transparent_images_become_8_bit_colour() {
        let deep = stored(ImageBuffer::from_pixel(3, 2, Rgb([65535u16, 32768, 0])), "a.png").unwrap();
        assert_eq!((deep.size, deep.channels, &deep.pixels[..3]), ([3, 2], 3, &[255, 128, 0][..]));
        let grey = stored(ImageBuffer::from_pixel(3, 2, Luma([77u8])), "a.png").unwrap();
        assert_eq!((grey.channels, &grey.pixels[..3]), (3, &[77, 77, 77][..]));
        let grey = stored(ImageBuffer::from_pixel(3, 2, Luma([257u16 * 5])), "a.png").unwrap();
        assert_eq!(grey.pixels[..3], [5, 5, 5]);
        let glass = stored(ImageBuffer::from_pixel(3, 2, LumaA([9u8, 128])), "a.png").unwrap();
        assert_eq!((glass.channels, &glass.pixels[..4]), (4, &[9, 9, 9, 128][..]));
    }

    #[test]
    fn damaged_images_are_refused() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.jpg");
        let noisy = ImageBuffer::from_fn(64, 64, |x, y| Rgb([(x * y % 251) as u8, (x * 7) as u8, (y * 5) as u8]));
        DynamicImage::from(noisy).save(&path).unwrap();
        let whole = std::fs::read(&path).unwrap();
        let header = probe(&path).unwrap();
        decode(&path, &header).unwrap();
        for keep in [whole.len() / 2, whole.len() - 2] {
            std::fs::write(&path, &whole[..keep]).unwrap();
            let message = decode(&path, &header).err().unwrap().to_string();
            assert!(message.contains("truncated"), "{message}");
        }
        std::fs::write(&path, b"").unwrap();
        assert!(probe(&path).unwrap_err().to_string().contains("empty file"));
        std::fs::write(&path, b"GIF89a,,,,,,,,,,,").unwrap();
        assert!(probe(&path).unwrap_err().to_string().contains("PNG or JPEG"));
        // A PNG header that claims more than it can hold.
        let png = dir.path().join("b.png");
        DynamicImage::from(ImageBuffer::from_pixel(4, 4, Luma([1u8]))).save(&png).unwrap();
        let mut bytes = std::fs::read(&png).unwrap();
        bytes[16..24].copy_from_slice(&[0, 1, 0, 0, 0, 1, 0, 0]);
        std::fs::write(&png, &bytes).unwrap();
        assert!(probe(&png).is_err());
    }

    #[test]
    fn masks_of_ones_are_white() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("m.png");
        DynamicImage::from(ImageBuffer::from_fn(2, 1, |x, _| Luma([x as u8]))).save(&path).unwrap();
        assert_eq!(decode_mask(&path, &probe(&path).unwrap()).unwrap(), [0, 255]);
    }
}
