//! From the state of blocks to the rows of a frame.

use std::ops::Range;

use megas_math::{Vec3, mat3};
use megas_model::{Camera, Projection};

use crate::Frame;
use crate::kernel::{Plane, Scene, Set, Tally};

/// A range of pixels of every channel; what a channel set lacks is empty.
pub(crate) struct Window<'a> {
    pub rgb: &'a mut [[f32; 3]],
    pub transmittance: &'a mut [f32],
    pub depth: &'a mut [f32],
    pub planar_depth: &'a mut [f32],
    pub median_depth: &'a mut [f32],
    pub normal: &'a mut [[f32; 3]],
    pub temperature: &'a mut [f32],
    pub argmax: &'a mut [u32],
    pub argmax_weight: &'a mut [f32],
}

impl<'a> Window<'a> {
    /// The pixels `range` of a frame.
    pub fn new(frame: &'a mut Frame, range: Range<usize>) -> Self {
        fn cut<T>(v: &mut [T], range: Range<usize>) -> &mut [T] {
            if v.is_empty() { v } else { &mut v[range] }
        }
        Self {
            rgb: cut(&mut frame.rgb, range.clone()),
            transmittance: cut(&mut frame.transmittance, range.clone()),
            depth: cut(&mut frame.depth, range.clone()),
            planar_depth: cut(&mut frame.planar_depth, range.clone()),
            median_depth: cut(&mut frame.median_depth, range.clone()),
            normal: cut(&mut frame.normal, range.clone()),
            temperature: cut(&mut frame.temperature, range.clone()),
            argmax: cut(&mut frame.argmax, range.clone()),
            argmax_weight: cut(&mut frame.argmax_weight, range),
        }
    }

    fn split_at(self, at: usize) -> (Self, Self) {
        fn cut<T>(v: &mut [T], at: usize) -> (&mut [T], &mut [T]) {
            v.split_at_mut(at.min(v.len()))
        }
        let (rgb, rgb1) = cut(self.rgb, at);
        let (transmittance, transmittance1) = cut(self.transmittance, at);
        let (depth, depth1) = cut(self.depth, at);
        let (planar_depth, planar_depth1) = cut(self.planar_depth, at);
        let (median_depth, median_depth1) = cut(self.median_depth, at);
        let (normal, normal1) = cut(self.normal, at);
        let (temperature, temperature1) = cut(self.temperature, at);
        let (argmax, argmax1) = cut(self.argmax, at);
        let (argmax_weight, argmax_weight1) = cut(self.argmax_weight, at);
        (
            Self { rgb, transmittance, depth, planar_depth, median_depth, normal, temperature, argmax, argmax_weight },
            Self {
                rgb: rgb1,
                transmittance: transmittance1,
                depth: depth1,
                planar_depth: planar_depth1,
                median_depth: median_depth1,
                normal: normal1,
                temperature: temperature1,
                argmax: argmax1,
                argmax_weight: argmax_weight1,
            },
        )
    }

    /// Calls `f` with the index and the pixels of each of `count` rows, the first of which is row `first`.
    pub fn for_rows(self, first: usize, count: usize, width: usize, f: &(impl Fn(usize, Window) + Sync)) {
        if count > 8 {
            let half = count / 2;
            let (a, b) = self.split_at(half * width);
            rayon::join(|| a.for_rows(first, half, width, f), || b.for_rows(first + half, count - half, width, f));
            return;
        }
        let mut rest = self;
        for y in first..first + count {
            let (row, tail) = rest.split_at(width);
            f(y, row);
            rest = tail;
        }
    }
}

/// Where the pixel in column `x` and row `y` of the image lies within its block: `(brick, lane)`.
#[inline(always)]
fn within(x: usize, y: usize) -> (usize, usize) {
    (y / 4 % 4 * 4 + x / 4 % 4, y % 4 * 4 + x % 4)
}

/// Writes row `y`. `planes_of(x)` are the planes of the block that holds column `x` of that row, `tallies_of(x)` those of
/// its tile.
pub(crate) fn resolve_row<'p, C: Set>(
    scene: &Scene,
    camera: &Camera,
    background: [f32; 3],
    y: usize,
    edge: usize,
    row: Window,
    planes_of: impl Fn(usize) -> &'p [Plane],
    tallies_of: impl Fn(usize) -> &'p [Tally],
) {
    let width = scene.size[0];
    for start in (0..width).step_by(edge) {
        let planes = planes_of(start);
        let end = (start + edge).min(width);
        for x in start..end {
            // Blocks start at multiples of their edge, bricks at multiples of four.
            let (brick, lane) = within(x % edge, y % edge);
            let at = |k: usize| planes[k].0[brick][lane];
            let t = at(0).abs();
            row.transmittance[x] = t;
            if let Some(k) = C::RGB {
                row.rgb[x] = [at(k) + t * background[0], at(k + 1) + t * background[1], at(k + 2) + t * background[2]];
            }
            if let Some(k) = C::TEMPERATURE {
                row.temperature[x] = at(k);
            }
            if let Some(k) = C::GEOMETRY {
                let alpha = 1.0 - t;
                row.depth[x] = at(k) / alpha.max(1e-6);
                let n = [at(k + 1), at(k + 2), at(k + 3)];
                row.normal[x] = n;
                row.planar_depth[x] = planar_depth(camera, x, y, n, at(k + 4), alpha);
                row.median_depth[x] = at(k + 5);
            }
            if let Some(k) = C::WINNER {
                let id = at(k + 1).to_bits();
                row.argmax_weight[x] = at(k);
                row.argmax[x] = match id {
                    crate::NO_GAUSSIAN => id,
                    slot if C::STATISTICS => scene.records[tallies_of(start)[slot as usize].rank as usize].index,
                    rank => scene.records[rank as usize].index,
                };
            }
        }
    }
}

/// Depth along z of the blended plane `n·x = d` seen through a pixel (splatting.md §3.3); +∞ where it is not defined.
fn planar_depth(camera: &Camera, x: usize, y: usize, n: Vec3<f32>, d: f32, alpha: f32) -> f32 {
    let n = mat3::mul_vec(camera.rotation, n);
    let (u, v) = (x as f32 + 0.5 - camera.cx, y as f32 + 0.5 - camera.cy);
    let (numerator, denominator) = match camera.projection {
        Projection::Pinhole { fx, fy } => (d, n[0] * u / fx + n[1] * v / fy + n[2]),
        Projection::Orthographic { scale } => (d - (n[0] * u + n[1] * v) / scale, n[2]),
    };
    if alpha < 0.5 || denominator > -1e-3 * alpha { f32::INFINITY } else { numerator / denominator }
}
