//! Small anti-aliased text on images.

use megas_model::Image;
use noto_sans_mono_bitmap::{FontWeight, RasterHeight, get_raster, get_raster_width};

/// A size of the font.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Font(RasterHeight);

impl Font {
    /// The size that reads well on an image of this height.
    pub fn for_height(height: u32) -> Self {
        Self(match height {
            0..400 => RasterHeight::Size16,
            400..700 => RasterHeight::Size20,
            700..1000 => RasterHeight::Size24,
            _ => RasterHeight::Size32,
        })
    }

    /// Distance of lines \[px\].
    pub fn line(self) -> i32 {
        self.0.val() as i32
    }

    /// Width of a text \[px\].
    pub fn width(self, text: &str) -> i32 {
        (text.chars().count() * get_raster_width(FontWeight::Regular, self.0)) as i32
    }

    /// Draws `text` with its upper left corner at `(x, y)`; what lies outside the image is left out.
    pub fn draw(self, image: &mut Image, x: i32, y: i32, text: &str, colour: [f32; 3]) {
        let advance = self.width(" ");
        for (k, character) in text.chars().enumerate() {
            let glyph = get_raster(character, FontWeight::Regular, self.0).or_else(|| get_raster('?', FontWeight::Regular, self.0));
            let Some(glyph) = glyph else { continue };
            for (j, row) in glyph.rows().enumerate() {
                for (i, &coverage) in row.iter().enumerate() {
                    blend(image, x + k as i32 * advance + i as i32, y + j as i32, colour, f32::from(coverage) / 255.0);
                }
            }
        }
    }

    /// Draws `text` on a translucent plate; `(x, y)` is the plate's upper left corner.
    pub fn draw_on_plate(self, image: &mut Image, x: i32, y: i32, text: &str, ink: Ink) {
        let pad = self.line() / 4;
        fill(image, [x, y, x + self.width(text) + 2 * pad, y + self.line() + pad], ink.plate, PLATE);
        self.draw(image, x + pad, y + pad / 2, text, ink.text);
    }
}

/// Opacity of plates behind text.
pub(crate) const PLATE: f32 = 0.6;

/// Colours of text and of the plate behind it.
#[derive(Clone, Copy)]
pub(crate) struct Ink {
    pub text: [f32; 3],
    pub plate: [f32; 3],
}

impl Ink {
    /// Light on dark.
    pub const LIGHT: Self = Self { text: [0.95; 3], plate: [0.0; 3] };
    /// Dark on light.
    pub const DARK: Self = Self { text: [0.08; 3], plate: [1.0; 3] };

    /// What reads well on a background of this colour.
    pub fn on(background: [f32; 3]) -> Self {
        if background.iter().sum::<f32>() > 1.5 { Self::DARK } else { Self::LIGHT }
    }
}

/// Mixes `colour` into a pixel of the first three channels; nothing happens outside the image.
pub(crate) fn blend(image: &mut Image, x: i32, y: i32, colour: [f32; 3], alpha: f32) {
    if x < 0 || y < 0 || x >= image.width as i32 || y >= image.height as i32 {
        return;
    }
    for (p, c) in image.pixel_mut(x as u32, y as u32).iter_mut().zip(colour) {
        *p += alpha * (c - *p);
    }
}

/// Mixes `colour` into the pixels of the box `[x0, y0, x1, y1)`.
pub(crate) fn fill(image: &mut Image, [x0, y0, x1, y1]: [i32; 4], colour: [f32; 3], alpha: f32) {
    for y in y0.max(0)..y1.min(image.height as i32) {
        for x in x0.max(0)..x1.min(image.width as i32) {
            blend(image, x, y, colour, alpha);
        }
    }
}
