//! Photographs taken through a lens, resampled to an ideal pinhole (splatting.md §2.2).

use crate::{
    optics::{Intrinsics, Size},
    resample::round,
};

/// Where the pixels of the straightened image come from. The new camera has the focal lengths, the principal point and the
/// size of the old one.
pub(crate) struct Straightener {
    camera: Intrinsics,
    fold_squared: f64,
}

impl Straightener {
    pub fn new(camera: &Intrinsics) -> Self {
        let far = [0, 1].map(|a| {
            let (c, side) = (camera.centre[a], f64::from(camera.size[a]));
            c.abs().max((side - c).abs()) / camera.focal[a]
        });
        let reach = far[0].hypot(far[1]);
        Self { camera: *camera, fold_squared: camera.lens.fold_radius(reach).powi(2) }
    }

    /// Continuous position in the photograph of the straightened image's position; `None` outside the photograph or where
    /// the lens model has no meaning.
    #[inline(always)]
    pub fn source(&self, position: [f64; 2]) -> Option<[f64; 2]> {
        let c = &self.camera;
        let n = [(position[0] - c.centre[0]) / c.focal[0], (position[1] - c.centre[1]) / c.focal[1]];
        if n[0] * n[0] + n[1] * n[1] >= self.fold_squared {
            return None;
        }
        let d = c.lens.distort(n);
        let p = [d[0] * c.focal[0] + c.centre[0], d[1] * c.focal[1] + c.centre[1]];
        let inside = |a: usize| p[a] >= 0.0 && p[a] <= f64::from(c.size[a]);
        (inside(0) && inside(1)).then_some(p)
    }

    /// The straightened pixels of the rectangle and 0 or 255 for each of them: whether the photograph shows it.
    pub fn straighten(&self, pixels: &[u8], channels: usize, area: Rect) -> (Vec<u8>, Vec<u8>) {
        match channels {
            1 => self.straighten_channels::<1>(pixels, area),
            3 => self.straighten_channels::<3>(pixels, area),
            _ => self.straighten_channels::<4>(pixels, area),
        }
    }

    fn straighten_channels<const C: usize>(&self, pixels: &[u8], area: Rect) -> (Vec<u8>, Vec<u8>) {
        let count = area.size[0] as usize * area.size[1] as usize;
        let (pixels, _) = pixels.as_chunks::<C>();
        let mut out = vec![0; count * C];
        let mut valid = vec![0; count];
        for ((px, seen), at) in out.as_chunks_mut::<C>().0.iter_mut().zip(&mut valid).zip(area.centres()) {
            if let Some(p) = self.source(at) {
                *px = bilinear(pixels, self.camera.size, p);
                *seen = 255;
            }
        }
        (out, valid)
    }

    /// The largest rectangle that a greedy shrinking finds in which every pixel is valid: as long as a side holds invalid
    /// pixels, the side with the largest share of them moves inward. `None` if nothing is left.
    pub fn full_area(&self) -> Option<Rect> {
        let [w, h] = self.camera.size;
        let whole = Rect { first: [0, 0], size: [w, h] };
        let valid: Vec<bool> = whole.centres().map(|at| self.source(at).is_some()).collect();
        let holes = |x0: u32, y0: u32, nx: u32, ny: u32| {
            let rows = (y0..y0 + ny).map(|y| &valid[y as usize * w as usize + x0 as usize..][..nx as usize]);
            rows.flatten().filter(|v| !**v).count()
        };
        let ([mut x, mut y], [mut nx, mut ny]) = (whole.first, whole.size);
        while nx > 0 && ny > 0 {
            // Left, right, top, bottom.
            let sides = [holes(x, y, 1, ny), holes(x + nx - 1, y, 1, ny), holes(x, y, nx, 1), holes(x, y + ny - 1, nx, 1)];
            let share = |k: usize| sides[k] as f64 / f64::from(if k < 2 { ny } else { nx });
            let worst = (1..4).fold(0, |best, k| if share(k) > share(best) { k } else { best });
            match (sides[worst], worst) {
                (0, _) => return Some(Rect { first: [x, y], size: [nx, ny] }),
                (_, 0) => (x, nx) = (x + 1, nx - 1),
                (_, 1) => nx -= 1,
                (_, 2) => (y, ny) = (y + 1, ny - 1),
                _ => ny -= 1,
            }
        }
        None
    }
}

/// A rectangle of pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Rect {
    pub first: [u32; 2],
    pub size: Size,
}

impl Rect {
    /// Centres of its pixels, row by row.
    fn centres(self) -> impl Iterator<Item = [f64; 2]> {
        let [x0, y0] = self.first.map(f64::from);
        (0..self.size[1]).flat_map(move |j| (0..self.size[0]).map(move |i| [x0 + f64::from(i) + 0.5, y0 + f64::from(j) + 0.5]))
    }
}

/// Bilinear sample at a continuous position (pixel centres at ½); the outermost half pixel repeats the edge. Colours are
/// weighted by alpha.
#[inline(always)]
fn bilinear<const C: usize>(pixels: &[[u8; C]], size: Size, position: [f64; 2]) -> [u8; C] {
    let axis = |a: usize| {
        let last = size[a] as usize - 1;
        let t = (position[a] - 0.5).clamp(0.0, last as f64);
        let i = (t as usize).min(last);
        (i, (i + 1).min(last), (t - i as f64) as f32)
    };
    let ((x0, x1, fx), (y0, y1, fy)) = (axis(0), axis(1));
    let w = size[0] as usize;
    let corners = [(x0, y0, (1.0 - fx) * (1.0 - fy)), (x1, y0, fx * (1.0 - fy)), (x0, y1, (1.0 - fx) * fy), (x1, y1, fx * fy)];
    let mut sum = [0f32; C];
    for (x, y, weight) in corners {
        let px = pixels[y * w + x];
        if C == 4 {
            let wa = weight * f32::from(px[3]);
            (0..3).for_each(|k| sum[k] += wa * f32::from(px[k]));
            sum[3] += wa;
        } else {
            (0..C).for_each(|k| sum[k] += weight * f32::from(px[k]));
        }
    }
    if C == 4 {
        let inverse = if sum[3] > 1e-3 { 1.0 / sum[3] } else { 0.0 };
        (0..3).for_each(|k| sum[k] *= inverse);
    }
    sum.map(round)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lens::Lens;

    fn camera(lens: Lens) -> Intrinsics {
        Intrinsics { focal: [300.0, 310.0], centre: [205.0, 148.0], size: [400, 300], lens }
    }

    const LENSES: [Lens; 3] = [
        Lens::Polynomial { k: [-0.12, 0.03, 0.0, 0.0], p: [0.002, -0.003] },
        Lens::Polynomial { k: [0.08, 0.01, 0.0, 0.0], p: [-0.001, 0.001] },
        Lens::Fisheye { k: [0.02, -0.01, 0.003, -0.001] },
    ];

    /// Photographs dots through the lens and looks where they are after straightening: within a tenth of a pixel of the
    /// pinhole projection.
    #[test]
    fn dots_come_back_to_where_a_pinhole_puts_them() {
        for lens in LENSES {
            let c = camera(lens);
            let targets: Vec<[f64; 2]> =
                (0..7).flat_map(|i| (0..5).map(move |j| [50.3 + 50.1 * f64::from(i), 40.7 + 54.3 * f64::from(j)])).collect();
            let seen: Vec<[f64; 2]> = targets
                .iter()
                .map(|t| {
                    let d = lens.distort([0, 1].map(|a| (t[a] - c.centre[a]) / c.focal[a]));
                    [0, 1].map(|a| d[a] * c.focal[a] + c.centre[a])
                })
                .collect();
            // Wide Gaussian dots, far enough apart not to touch.
            let mut photo = vec![0u8; 400 * 300];
            for (k, v) in photo.iter_mut().enumerate() {
                let p = [(k % 400) as f64 + 0.5, (k / 400) as f64 + 0.5];
                let light: f64 = seen.iter().map(|s| (-((p[0] - s[0]).powi(2) + (p[1] - s[1]).powi(2)) / 18.0).exp()).sum();
                *v = (light * 250.0).min(255.0) as u8;
            }
            let (straight, valid) = Straightener::new(&c).straighten(&photo, 1, Rect { first: [0, 0], size: c.size });
            for (t, s) in targets.iter().zip(&seen) {
                if (0..2).any(|a| s[a] < 15.0 || s[a] > f64::from(c.size[a]) - 15.0) {
                    continue;
                }
                let (mut sum, mut moment) = (0.0, [0.0; 2]);
                for y in (t[1] as usize).saturating_sub(14)..(t[1] as usize + 15).min(300) {
                    for x in (t[0] as usize).saturating_sub(14)..(t[0] as usize + 15).min(400) {
                        let v = f64::from(straight[y * 400 + x]);
                        sum += v;
                        moment[0] += v * (x as f64 + 0.5);
                        moment[1] += v * (y as f64 + 0.5);
                    }
                }
                let error = (moment[0] / sum - t[0]).hypot(moment[1] / sum - t[1]);
                assert!(error < 0.1, "{lens:?} at {t:?}: {error}");
            }
            assert!(valid[150 * 400 + 200] == 255);
        }
    }

    /// A ramp has no texture to blur: the value tells the source position directly.
    #[test]
    fn a_ramp_shows_the_forward_model() {
        for lens in LENSES {
            let c = camera(lens);
            let photo: Vec<u8> = (0..400 * 300).map(|k| ((k % 400) / 2 + (k / 400) / 6) as u8).collect();
            let (straight, valid) = Straightener::new(&c).straighten(&photo, 1, Rect { first: [0, 0], size: c.size });
            for (k, v) in straight.iter().enumerate().filter(|(k, _)| valid[*k] == 255) {
                let at = [(k % 400) as f64 + 0.5, (k / 400) as f64 + 0.5];
                let d = lens.distort([0, 1].map(|a| (at[a] - c.centre[a]) / c.focal[a]));
                let p = [0, 1].map(|a| d[a] * c.focal[a] + c.centre[a]);
                let expected = p[0] / 2.0 + p[1] / 6.0;
                assert!((f64::from(*v) - expected).abs() < 2.0, "{k}: {v} {expected}");
            }
        }
    }

    #[test]
    fn outside_is_invalid_and_cropping_removes_it() {
        // A pincushion asks for light from beyond the frame; a fisheye shows more than a pinhole of the same focal length.
        let pincushion = Straightener::new(&camera(LENSES[1]));
        let photo = vec![200u8; 400 * 300 * 3];
        let (pixels, valid) = pincushion.straighten(&photo, 3, Rect { first: [0, 0], size: [400, 300] });
        let holes = valid.iter().filter(|v| **v == 0).count();
        assert!(holes > 500 && holes < 30_000, "{holes}");
        assert!(pixels.chunks(3).zip(&valid).all(|(p, v)| p[0] == if *v == 255 { 200 } else { 0 }));
        let area = pincushion.full_area().unwrap();
        assert!(area.size[0] > 340 && area.size[1] > 250 && area.first[0] > 0, "{area:?}");
        assert!(pincushion.straighten(&photo, 3, area).1.iter().all(|v| *v == 255));

        let fisheye = Straightener::new(&camera(Lens::Fisheye { k: [0.0; 4] }));
        assert_eq!(fisheye.full_area().unwrap().size, [400, 300]);
    }

    #[test]
    fn folded_light_is_not_believed() {
        let c = Intrinsics { focal: [150.0, 150.0], ..camera(Lens::Polynomial { k: [-0.5, 0.0, 0.0, 0.0], p: [0.0; 2] }) };
        let s = Straightener::new(&c);
        assert!(s.source([205.0 + 120.0, 148.0]).is_some());
        assert!(s.source([205.0 + 125.0, 148.0]).is_none());
        assert!(s.full_area().is_some_and(|r| r.size[0] < 200));
    }

    #[test]
    fn hidden_colours_do_not_bleed() {
        assert_eq!(bilinear(&[[200, 0, 0, 255], [0, 255, 0, 0]], [2, 1], [1.0, 0.5]), [200, 0, 0, 128]);
    }
}
