//! Several pictures in one: RGB beside thermal, captions, time stamps.

use megas_model::Image;

use crate::{
    error::{Result, mismatch},
    text::{Font, Ink},
};

/// What is written on a composed picture; everything is optional.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Captions<'a> {
    /// Upper left corner of the left picture.
    pub left: &'a str,
    /// Upper left corner of the right picture.
    pub right: &'a str,
    /// Simulated time, lower left corner \[s\].
    pub time: Option<f64>,
}

/// Two RGB (or RGBA, put on black) images of the same height beside each other.
pub fn side_by_side(left: &Image, right: &Image, captions: &Captions<'_>) -> Result<Image> {
    if left.height != right.height || left.channels < 3 || right.channels < 3 {
        let size = |i: &Image| format!("{}x{} with {} channels", i.width, i.height, i.channels);
        return Err(mismatch(format!("{} beside {}", size(left), size(right)), "the same height and 3 or 4 channels"));
    }
    let mut image = Image::new(left.width + right.width, left.height, 3);
    for y in 0..left.height {
        for (source, offset) in [(left, 0), (right, left.width)] {
            for x in 0..source.width {
                let p = source.pixel(x, y);
                let a = if p.len() == 4 { p[3] } else { 1.0 };
                let out = image.pixel_mut(offset + x, y);
                (0..3).for_each(|c| out[c] = a * p[c]);
            }
        }
    }
    let font = Font::for_height(image.height);
    let margin = font.line() / 2;
    for (text, x) in [(captions.left, 0), (captions.right, left.width as i32)] {
        if !text.is_empty() {
            font.draw_on_plate(&mut image, x + margin, margin, text, Ink::LIGHT);
        }
    }
    if let Some(t) = captions.time {
        stamp_time(&mut image, t);
    }
    Ok(image)
}

/// Writes the simulated time \[s\] into the lower left corner of an image with 3 or 4 channels.
pub fn stamp_time(image: &mut Image, seconds: f64) {
    let font = Font::for_height(image.height);
    let margin = font.line() / 2;
    let text = if seconds < 600.0 {
        format!("{seconds:6.2} s")
    } else {
        format!("{:4} min {:02} s", (seconds / 60.0) as u64, (seconds % 60.0) as u64)
    };
    let y = image.height as i32 - margin - font.line() - font.line() / 4;
    font.draw_on_plate(image, margin, y, &text, Ink::LIGHT);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_pictures_keep_their_pixels() {
        let (mut a, mut b) = (Image::new(100, 90, 4), Image::new(60, 90, 3));
        a.data.chunks_exact_mut(4).for_each(|p| p.copy_from_slice(&[1.0, 0.5, 0.0, 0.5]));
        b.data.fill(0.25);
        let c = side_by_side(&a, &b, &Captions::default()).unwrap();
        assert_eq!((c.width, c.height, c.channels), (160, 90, 3));
        assert_eq!((c.pixel(99, 45), c.pixel(100, 45)), (&[0.5, 0.25, 0.0][..], &[0.25; 3][..]));
        let d = side_by_side(&a, &b, &Captions { left: "RGB", right: "°C", time: Some(1.5) }).unwrap();
        let changed = |x0: u32, x1: u32, y0: u32, y1: u32| (y0..y1).any(|y| (x0..x1).any(|x| c.pixel(x, y) != d.pixel(x, y)));
        assert!(changed(0, 50, 0, 40) && changed(100, 150, 0, 40) && changed(0, 90, 50, 90) && !changed(110, 160, 50, 90));
        assert!(side_by_side(&a, &Image::new(60, 91, 3), &Captions::default()).is_err());
    }
}
