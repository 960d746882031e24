//! RGB → Y'CbCr 4:2:0 for video, BT.709 matrix, limited range (Y' 16–235, chroma 16–240).

use megas_model::Image;
use openh264::formats::YUVSource;

use crate::colormap::unit;

/// Luma weights of BT.709.
const KR: f32 = 0.2126;
const KB: f32 = 0.0722;
const KG: f32 = 1.0 - KR - KB;

/// One frame as three planes; sizes are even.
pub(crate) struct Planes {
    width: usize,
    height: usize,
    y: Vec<u8>,
    u: Vec<u8>,
    v: Vec<u8>,
    /// Colour differences of two rows at full resolution: `B' − Y'` and `R' − Y'`.
    rows: [[Vec<f32>; 2]; 2],
}

impl Planes {
    /// Planes that hold an image of `width` × `height`; an odd last column or row is repeated.
    pub fn new(width: u32, height: u32) -> Self {
        let (w, h) = (width.next_multiple_of(2) as usize, height.next_multiple_of(2) as usize);
        let chroma = vec![128; w / 2 * (h / 2)];
        let row = || [vec![0.0; w], vec![0.0; w]];
        Self { width: w, height: h, y: vec![16; w * h], u: chroma.clone(), v: chroma, rows: [row(), row()] }
    }

    /// Converts an image of the announced size; RGBA is put on black, grey becomes RGB.
    pub fn fill(&mut self, image: &Image) {
        let w = self.width;
        for j in (0..self.height).step_by(2) {
            for k in 0..2 {
                let source = (j + k).min(image.height as usize - 1);
                let y = &mut self.y[(j + k) * w..(j + k + 1) * w];
                let [db, dr] = &mut self.rows[k];
                for i in 0..image.width as usize {
                    let [r, g, b] = rgb(image.pixel(i as u32, source as u32));
                    let luma = KR * r + KG * g + KB * b;
                    y[i] = (16.5 + 219.0 * luma) as u8;
                    (db[i], dr[i]) = (b - luma, r - luma);
                }
                if w > image.width as usize {
                    (y[w - 1], db[w - 1], dr[w - 1]) = (y[w - 2], db[w - 2], dr[w - 2]);
                }
            }
            // Players take chroma samples to lie on the even luma columns, halfway between two rows: a 1-2-1 filter along
            // the row keeps edges where they are, a plain average of 2×2 would shift colour by a quarter pixel.
            let at = j / 2 * (w / 2);
            let planes = [(&mut self.u, 0, 2.0 * (1.0 - KB)), (&mut self.v, 1, 2.0 * (1.0 - KR))];
            for (plane, which, norm) in planes {
                let (above, below) = (&self.rows[0][which], &self.rows[1][which]);
                for (k, out) in plane[at..at + w / 2].iter_mut().enumerate() {
                    let (l, m, r) = ((2 * k).saturating_sub(1), 2 * k, 2 * k + 1);
                    let mean = 0.125 * (above[l] + below[l] + 2.0 * (above[m] + below[m]) + above[r] + below[r]);
                    *out = (128.5 + 224.0 / norm * mean) as u8;
                }
            }
        }
    }
}

/// The colour of a pixel in [0, 1]; not-a-number becomes 0.
#[inline(always)]
fn rgb(pixel: &[f32]) -> [f32; 3] {
    match *pixel {
        [r, g, b, a] => [unit(r) * unit(a), unit(g) * unit(a), unit(b) * unit(a)],
        [r, g, b] => [unit(r), unit(g), unit(b)],
        _ => [unit(pixel[0]); 3],
    }
}

impl YUVSource for Planes {
    fn dimensions(&self) -> (usize, usize) {
        (self.width, self.height)
    }

    fn strides(&self) -> (usize, usize, usize) {
        (self.width, self.width / 2, self.width / 2)
    }

    fn y(&self) -> &[u8] {
        &self.y
    }

    fn u(&self) -> &[u8] {
        &self.u
    }

    fn v(&self) -> &[u8] {
        &self.v
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn primaries_have_the_values_of_the_standard() {
        // BT.709, 8 bit: 75 % bars are tabulated everywhere; these are the 100 % ones.
        let cases = [
            ([0.0, 0.0, 0.0], [16, 128, 128]),
            ([1.0, 1.0, 1.0], [235, 128, 128]),
            ([1.0, 0.0, 0.0], [63, 102, 240]),
            ([0.0, 1.0, 0.0], [173, 42, 26]),
            ([0.0, 0.0, 1.0], [32, 240, 118]),
        ];
        for (colour, expected) in cases {
            let mut image = Image::new(3, 5, 3);
            image.data.chunks_exact_mut(3).for_each(|p| p.copy_from_slice(&colour));
            let mut planes = Planes::new(3, 5);
            planes.fill(&image);
            assert_eq!(planes.dimensions(), (4, 6));
            let all = |p: &[u8], v: u8| p.iter().all(|x| *x == v);
            assert!(all(&planes.y, expected[0]) && all(&planes.u, expected[1]) && all(&planes.v, expected[2]), "{colour:?}");
        }
    }

    #[test]
    fn what_is_not_a_number_is_black() {
        let mut image = Image::new(2, 2, 3);
        image.data.fill(f32::NAN);
        let mut planes = Planes::new(2, 2);
        planes.fill(&image);
        assert_eq!((planes.y[0], planes.u[0], planes.v[0]), (16, 128, 128));
    }
}
