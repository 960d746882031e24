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
    pub plane: &'a mut [f32],
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
            plane: cut(&mut frame.plane, range.clone()),
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
        let (plane, plane1) = cut(self.plane, at);
        let (temperature, temperature1) = cut(self.temperature, at);
        let (argmax, argmax1) = cut(self.argmax, at);
        let (argmax_weight, argmax_weight1) = cut(self.argmax_weight, at);
        (
            Self { rgb, transmittance, depth, planar_depth, median_depth, normal, plane, temperature, argmax, argmax_weight },
            Self {
                rgb: rgb1,
                transmittance: transmittance1,
                depth: depth1,
                planar_depth: planar_depth1,
                median_depth: median_depth1,
                normal: normal1,
                plane: plane1,
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

/// Writes row `y`. `planes_of(x)` are the planes of the block whose first column is `x`, `tallies_of(x)` those of its tile.
pub(crate) fn resolve_row<'p, C: Set>(
    scene: &Scene,
    camera: &Camera,
    background: [f32; 3],
    y: usize,
    edge: usize,
    mut row: Window,
    planes_of: impl Fn(usize) -> &'p [Plane],
    tallies_of: impl Fn(usize) -> &'p [Tally],
) {
    let width = scene.size[0];
    let lane = y % 4 * 4;
    for start in (0..width).step_by(edge) {
        let planes = planes_of(start);
        // Blocks start at multiples of their edge, bricks at multiples of four.
        for x in (start..(start + edge).min(width)).step_by(4) {
            let brick = y % edge / 4 * 4 + (x - start) / 4;
            let at = |k: usize| four(&planes[k].0[brick], lane);
            let n = (width - x).min(4);
            let mut t = at(0);
            for t in &mut t {
                *t = t.abs();
            }
            put(&mut row.transmittance[x..], &t);
            if let Some(k) = C::RGB {
                let mut rgb = [[0.0; 3]; 4];
                for c in 0..3 {
                    let plane = at(k + c);
                    for i in 0..4 {
                        rgb[i][c] = plane[i] + t[i] * background[c];
                    }
                }
                put(&mut row.rgb[x..], &rgb);
            }
            if let Some(k) = C::TEMPERATURE {
                put(&mut row.temperature[x..], &at(k));
            }
            if let Some(k) = C::GEOMETRY {
                geometry(camera, x, y, n, k, &t, at, &mut row);
            }
            if let Some(k) = C::WINNER {
                put(&mut row.argmax_weight[x..], &at(k));
                for (i, id) in at(k + 1).iter().enumerate().take(n) {
                    row.argmax[x + i] = match id.to_bits() {
                        crate::NO_GAUSSIAN => crate::NO_GAUSSIAN,
                        slot if C::STATISTICS => scene.records[tallies_of(start)[slot as usize].rank as usize].index,
                        rank => scene.records[rank as usize].index,
                    };
                }
            }
        }
    }
}

/// Four neighbours in a row of a brick.
#[inline(always)]
fn four(brick: &[f32; 16], lane: usize) -> [f32; 4] {
    let [a, b, c, d] = [lane & 12, (lane & 12) + 1, (lane & 12) + 2, (lane & 12) + 3];
    [brick[a], brick[b], brick[c], brick[d]]
}

/// Writes four neighbours, or what the row has room for.
#[inline(always)]
fn put<T: Copy>(out: &mut [T], v: &[T; 4]) {
    match out.first_chunk_mut::<4>() {
        Some(out) => *out = *v,
        None => out.copy_from_slice(&v[..out.len()]),
    }
}

/// Depths and normals of `n` pixels from column `x`; `at(k)` is the first of the planes, `t` the transmittance.
#[inline(always)]
fn geometry(camera: &Camera, x: usize, y: usize, n: usize, k: usize, t: &[f32; 4], at: impl Fn(usize) -> [f32; 4], row: &mut Window) {
    let (z, plane, median) = (at(k), at(k + 4), at(k + 5));
    let normal = [at(k + 1), at(k + 2), at(k + 3)];
    for i in 0..n {
        let alpha = 1.0 - t[i];
        let n = [normal[0][i], normal[1][i], normal[2][i]];
        row.depth[x + i] = z[i] / alpha.max(1e-6);
        row.normal[x + i] = n;
        row.plane[x + i] = plane[i];
        row.planar_depth[x + i] = planar_depth(camera, x + i, y, n, plane[i], alpha);
        row.median_depth[x + i] = median[i];
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
