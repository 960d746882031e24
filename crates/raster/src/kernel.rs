//! Compositing of one block of 16 × 16 pixels (splatting.md §3.3, §3.4).
//!
//! The block is sixteen bricks of 4 × 4 pixels, brick `b` at column `b % 4` and row `b / 4`, and so are its lanes. For each
//! entry one vector over the *bricks* finds those that the support touches (the exact minimum of the exponent over the
//! brick's pixel centres) and the exponent's linear terms at their corners; then one vector over the *pixels* of each
//! touched brick blends. State lives in planes of sixteen vectors.
//!
//! A pixel that has stopped carries its transmittance with the sign reversed: every later entry then fails the test for
//! stopping by itself, and no second mask is needed. Pixels outside the image start that way.

use fearless_simd::{Level, Simd, dispatch, f32x16, mask32x16, prelude::*, u32x16};

use megas_model::{Camera, Projection};

use crate::Settings;
use crate::bin::Lists;
use crate::project::{Extra, Record};

/// Edge of a block \[px\].
pub(crate) const BLOCK: usize = 16;

/// Records fetched at a time.
pub(crate) const STAGE: usize = 64;

/// One quantity of the 256 pixels of a block: `[brick][pixel]`.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub(crate) struct Plane(pub [[f32; 16]; 16]);

impl Default for Plane {
    fn default() -> Self {
        Self([[0.0; 16]; 16])
    }
}

/// A channel set at compile time: the number of planes and what lives in them. Plane 0 is the transmittance.
pub(crate) trait Set: Send + Sync {
    /// Planes of state.
    const PLANES: usize;
    /// First of three planes of colour.
    const RGB: Option<usize> = None;
    /// Temperature.
    const TEMPERATURE: Option<usize> = None;
    /// First of depth, normal (3), plane distance, median depth.
    const GEOMETRY: Option<usize> = None;
    /// Largest weight, then its entry as bits: the rank, or with statistics the position in the tile's list.
    const WINNER: Option<usize> = None;
    /// Per-Gaussian statistics.
    const STATISTICS: bool = false;
}

/// See [`crate::Channels::Rgba`].
pub(crate) struct Rgba;
impl Set for Rgba {
    const PLANES: usize = 4;
    const RGB: Option<usize> = Some(1);
}

/// See [`crate::Channels::RgbaTemperature`].
pub(crate) struct RgbaTemperature;
impl Set for RgbaTemperature {
    const PLANES: usize = 5;
    const RGB: Option<usize> = Some(1);
    const TEMPERATURE: Option<usize> = Some(4);
}

/// See [`crate::Channels::Geometry`].
pub(crate) struct Geometry;
impl Set for Geometry {
    const PLANES: usize = 13;
    const RGB: Option<usize> = Some(1);
    const TEMPERATURE: Option<usize> = Some(4);
    const GEOMETRY: Option<usize> = Some(5);
    const WINNER: Option<usize> = Some(11);
}

/// See [`crate::Channels::Weights`].
pub(crate) struct Weights;
impl Set for Weights {
    const PLANES: usize = 3;
    const WINNER: Option<usize> = Some(1);
    const STATISTICS: bool = true;
}

/// What one entry of a tile's list contributed to that tile.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Tally {
    pub w_max: f32,
    pub w_sum: f32,
    pub pixels: u32,
    pub argmax_pixels: u32,
    pub vote: [f32; 3],
    pub rank: u32,
}

/// What all blocks share.
pub(crate) struct Scene<'a> {
    pub level: Level,
    pub records: &'a [Record],
    pub extras: &'a [Extra],
    pub lists: &'a [Lists],
    /// Image size \[px\].
    pub size: [usize; 2],
    pub log_alpha_min: f32,
    pub alpha_max: f32,
    pub t_stop: f32,
}

impl<'a> Scene<'a> {
    pub fn new(level: Level, records: &'a [Record], extras: &'a [Extra], lists: &'a [Lists], camera: &Camera, settings: &Settings) -> Self {
        Self {
            level,
            records,
            extras,
            lists,
            size: [camera.width as usize, camera.height as usize],
            log_alpha_min: settings.log_alpha_min(),
            alpha_max: settings.alpha_max,
            t_stop: settings.t_stop,
        }
    }
}

/// A block's place: its first pixel, the part of it that belongs to the tile, and the tile.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Place {
    pub x: usize,
    pub y: usize,
    /// Edge of the part that is composited: 8 or 16 pixels.
    pub edge: usize,
    pub tile: usize,
}

/// Composites the tile's list into `planes`. With statistics, `rays` holds the reversed unit viewing rays and `tallies`
/// has one element per entry of the list.
pub(crate) fn composite<C: Set, const N: usize>(
    scene: &Scene,
    place: Place,
    planes: &mut [Plane; N],
    rays: &[Plane; 3],
    tallies: &mut [Tally],
) {
    const { assert!(N == C::PLANES) };
    start::<C, N>(scene, place, planes);
    dispatch!(scene.level, simd => composite_simd::<_, C, N>(simd, scene, place, planes, rays, tallies));
}

/// Reversed unit viewing rays of a block, world axes.
pub(crate) fn rays(level: Level, camera: &Camera, place: Place) -> [Plane; 3] {
    dispatch!(level, _simd => rays_inline(camera, place))
}

#[inline(always)]
fn rays_inline(camera: &Camera, place: Place) -> [Plane; 3] {
    let mut rays = [Plane::default(); 3];
    let [ax, ay, az] = camera.rotation;
    for brick in 0..16 {
        let mut direction = [[0.0f32; 16]; 3];
        for lane in 0..16 {
            let [x, y] = pixel_of(brick, lane);
            let [u, v] = match camera.projection {
                Projection::Pinhole { fx, fy } => {
                    let (x, y) = ((place.x + x) as f32 + 0.5, (place.y + y) as f32 + 0.5);
                    [(x - camera.cx) / fx, (y - camera.cy) / fy]
                }
                Projection::Orthographic { .. } => [0.0; 2],
            };
            let scale = -(u * u + v * v + 1.0).sqrt().recip();
            for a in 0..3 {
                direction[a][lane] = (ax[a] * u + ay[a] * v + az[a]) * scale;
            }
        }
        for a in 0..3 {
            rays[a].0[brick] = direction[a];
        }
    }
    rays
}

/// Column and row of a pixel within its block.
#[inline(always)]
pub(crate) fn pixel_of(brick: usize, lane: usize) -> [usize; 2] {
    [brick % 4 * 4 + lane % 4, brick / 4 * 4 + lane / 4]
}

fn start<C: Set, const N: usize>(scene: &Scene, place: Place, planes: &mut [Plane; N]) {
    for brick in planes.iter_mut().flat_map(|p| &mut p.0) {
        *brick = [0.0; 16];
    }
    let (w, h) = (scene.size[0].saturating_sub(place.x).min(place.edge), scene.size[1].saturating_sub(place.y).min(place.edge));
    if w == BLOCK && h == BLOCK {
        for brick in &mut planes[0].0 {
            *brick = [1.0; 16];
        }
    } else {
        for brick in 0..16 {
            for lane in 0..16 {
                let [x, y] = pixel_of(brick, lane);
                planes[0].0[brick][lane] = if x < w && y < h { 1.0 } else { -1.0 };
            }
        }
    }
    if let Some(k) = C::WINNER {
        planes[k + 1] = Plane([[f32::from_bits(crate::NO_GAUSSIAN); 16]; 16]);
    }
}

/// `2^e` with a relative error below 2e-7 for `|e| < 126`; anything outside.
#[inline(always)]
fn exp2<S: Simd>(simd: S, e: f32x16<S>) -> f32x16<S> {
    let v = |x: f32| f32x16::splat(simd, x);
    // Adding 1.5·2²³ leaves the nearest integer in the low bits of the sum.
    let magic = v(12_582_912.0);
    let shifted = e + magic;
    let r = e - (shifted - magic);
    // Minimax in relative error on [−½, ½].
    let p = r.mul_add(v(0.001_327_647_2), v(0.009_675_541_3));
    let p = p.mul_add(r, v(0.055_507_133));
    let p = p.mul_add(r, v(0.240_221_2));
    let p = p.mul_add(r, v(0.693_146_97));
    let p = p.mul_add(r, v(1.0));
    let bits: u32x16<S> = p.to_bits() + (shifted.to_bits() << 23);
    f32x16::from_bits(bits)
}

/// Bricks with a pixel that still takes light.
#[inline(always)]
pub(crate) fn alive<S: Simd>(simd: S, transmittance: &Plane) -> u32 {
    let zero = f32x16::splat(simd, 0.0);
    let mut bits = 0;
    for (b, t) in transmittance.0.iter().enumerate() {
        bits |= u32::from(f32x16::load_array_ref(simd, t).simd_gt(zero).any_true()) << b;
    }
    bits
}

#[inline(always)]
fn composite_simd<S: Simd, C: Set, const N: usize>(
    simd: S,
    scene: &Scene,
    place: Place,
    planes: &mut [Plane; N],
    rays: &[Plane; 3],
    tallies: &mut [Tally],
) {
    let v = |x: f32| f32x16::splat(simd, x);
    let load = |p: &Plane, b: usize| f32x16::load_array_ref(simd, &p.0[b]);
    let zero = v(0.0);
    let bricks = Bricks::new(simd, place);
    let (column, row) = (bricks.column, bricks.row);
    let limits = Limits::new(simd, scene);
    let half = v(0.5);

    let mut live = alive(simd, &planes[0]);
    let mut until_check = 16;
    let mut slot = 0usize;
    let mut staged = [Record::default(); STAGE];
    let mut ranks = [0u32; STAGE];
    let mut all = scene.lists.iter().flat_map(
        #[inline(always)]
        |l| l.of(place.tile),
    );
    loop {
        let count = stage(scene, &mut all, &mut staged, &mut ranks);
        if count == 0 {
            return;
        }
        for (r, &rank) in staged[..count].iter().zip(&ranks) {
            let (reached, x0, y0) = bricks.reached(simd, r);
            let mut touched = reached & live;
            if touched != 0 {
                let (l1, l2, l3) = (v(r.l[0]), v(r.l[1]), v(r.l[2]));
                let corner1 = x0.mul_add(l1, y0 * l2).to_array();
                let corner2 = (y0 * l3).to_array();
                let (inner1, inner2) = (column.mul_add(l1, row * l2), row * l3);
                let log_opacity = v(r.log_opacity);
                let mut tally = Accumulator::new(simd);
                while touched != 0 {
                    let b = touched.trailing_zeros() as usize & 15;
                    touched &= touched - 1;
                    let (s1, s2) = (inner1 + v(corner1[b]), inner2 + v(corner2[b]));
                    let Blend { before, w, .. } = limits.blend(simd, log_opacity, s1, s2, &mut planes[0].0[b]);
                    let mut add = |k: usize, value: f32| {
                        w.mul_add(v(value), load(&planes[k], b)).store_array(&mut planes[k].0[b]);
                    };
                    if let Some(k) = C::RGB {
                        add(k, r.rgb[0]);
                        add(k + 1, r.rgb[1]);
                        add(k + 2, r.rgb[2]);
                    }
                    if let Some(k) = C::TEMPERATURE {
                        add(k, r.temperature);
                    }
                    if let Some(k) = C::GEOMETRY {
                        let extra = &scene.extras[rank as usize];
                        add(k, extra.z);
                        add(k + 1, extra.normal[0]);
                        add(k + 2, extra.normal[1]);
                        add(k + 3, extra.normal[2]);
                        add(k + 4, extra.plane);
                        let front = w.simd_gt(zero) & before.simd_gt(half);
                        front.select(v(extra.z), load(&planes[k + 5], b)).store_array(&mut planes[k + 5].0[b]);
                    }
                    if let Some(k) = C::WINNER {
                        let best = load(&planes[k], b);
                        let better = w.simd_gt(best);
                        let id = if C::STATISTICS { slot as u32 } else { rank };
                        w.max(best).store_array(&mut planes[k].0[b]);
                        let id = v(f32::from_bits(id));
                        better.select(id, load(&planes[k + 1], b)).store_array(&mut planes[k + 1].0[b]);
                    }
                    if C::STATISTICS {
                        tally.w_max = tally.w_max.max(w);
                        tally.w_sum += w;
                        tally.pixels += w.simd_gt(zero).to_bitmask().count_ones();
                        let voting = before.simd_gt(half).select(w, zero);
                        for a in 0..3 {
                            tally.vote[a] = voting.mul_add(load(&rays[a], b), tally.vote[a]);
                        }
                    }
                }
                if C::STATISTICS {
                    let t = &mut tallies[slot];
                    t.w_max = t.w_max.max(tally.w_max.reduce_max());
                    t.w_sum += tally.w_sum.reduce_sum();
                    t.pixels += tally.pixels;
                    for a in 0..3 {
                        t.vote[a] += tally.vote[a].reduce_sum();
                    }
                }
                until_check -= 1;
                if until_check == 0 {
                    until_check = 16;
                    live = alive(simd, &planes[0]);
                    if live == 0 {
                        return;
                    }
                }
            }
            if C::STATISTICS {
                slot += 1;
            }
        }
    }
}

/// Copies the next records of a tile's list and their ranks; returns how many. Records lie in depth order, so a tile's are
/// scattered over memory: fetched one by one between the branches of the compositing, the wait for each would cost as much as
/// all the arithmetic. Copied in batches the misses overlap.
#[inline(always)]
pub(crate) fn stage<'a>(
    scene: &Scene,
    list: &mut impl Iterator<Item = &'a u32>,
    records: &mut [Record; STAGE],
    ranks: &mut [u32; STAGE],
) -> usize {
    let mut count = 0;
    for ((s, r), &rank) in records.iter_mut().zip(ranks).zip(list) {
        (*s, *r) = (scene.records[rank as usize], rank);
        count += 1;
    }
    count
}

/// The constants of the image formation in every lane.
pub(crate) struct Limits<S: Simd> {
    log_alpha_min: f32x16<S>,
    pub alpha_max: f32x16<S>,
    t_stop: f32x16<S>,
}

/// One Gaussian on sixteen pixels.
pub(crate) struct Blend<S: Simd> {
    /// `ô e^{−q}` before the cut-offs.
    pub free: f32x16<S>,
    /// Zero outside the support.
    pub alpha: f32x16<S>,
    /// Transmittance before it; negative where the pixel has stopped.
    pub before: f32x16<S>,
    /// Weight `αT`, zero where the pixel has stopped.
    pub w: f32x16<S>,
    /// Pixels in which it is blended.
    pub blended: mask32x16<S>,
}

impl<S: Simd> Limits<S> {
    #[inline(always)]
    pub fn new(simd: S, scene: &Scene) -> Self {
        let v = |x: f32| f32x16::splat(simd, x);
        Self { log_alpha_min: v(scene.log_alpha_min), alpha_max: v(scene.alpha_max), t_stop: v(scene.t_stop) }
    }

    /// Blends a Gaussian at the whitened offsets `s1`, `s2` over pixels and advances their transmittance. The forward and the
    /// backward pass share it, so both blend the same entries with the same weights.
    #[inline(always)]
    pub fn blend(&self, simd: S, log_opacity: f32x16<S>, s1: f32x16<S>, s2: f32x16<S>, transmittance: &mut [f32; 16]) -> Blend<S> {
        let zero = f32x16::splat(simd, 0.0);
        let e = log_opacity - s1.mul_add(s1, s2 * s2);
        let hit = e.simd_ge(self.log_alpha_min);
        let free = exp2(simd, e);
        let alpha = hit.select(free.min(self.alpha_max), zero);
        let before = f32x16::load_array_ref(simd, transmittance);
        let weight = alpha * before;
        let after = before - weight;
        let open: mask32x16<S> = after.simd_ge(self.t_stop);
        let stopped = before.min(-before);
        open.select(after, stopped).store_array(transmittance);
        Blend { free, alpha, before, w: open.select(weight, zero), blended: open & hit }
    }
}

/// The bricks of a block, one to a lane, and the pixels of a brick, one to a lane.
pub(crate) struct Bricks<S: Simd> {
    /// Offset of each pixel within a brick; also the index of each brick within the block.
    pub column: f32x16<S>,
    /// As `column`, downwards.
    pub row: f32x16<S>,
    /// Centres of the bricks' first pixels.
    x: f32x16<S>,
    y: f32x16<S>,
}

impl<S: Simd> Bricks<S> {
    #[inline(always)]
    pub fn new(simd: S, place: Place) -> Self {
        let v = |x: f32| f32x16::splat(simd, x);
        let lane = f32x16::load_array(simd, std::array::from_fn(|i| i as f32));
        let row = (lane * v(0.25)).floor();
        let column = lane - row * v(4.0);
        let (x, y) = (column.mul_add(v(4.0), v(place.x as f32 + 0.5)), row.mul_add(v(4.0), v(place.y as f32 + 0.5)));
        Self { column, row, x, y }
    }

    /// Bit mask of the bricks that the support can touch, and the offsets of their first pixels from the mean.
    #[inline(always)]
    pub fn reached(&self, simd: S, r: &Record) -> (u32, f32x16<S>, f32x16<S>) {
        let v = |x: f32| f32x16::splat(simd, x);
        let (zero, three) = (v(0.0), v(3.0));
        let (l1, l2, l3) = (v(r.l[0]), v(r.l[1]), v(r.l[2]));
        let x0 = self.x - v(r.base[0]) - v(r.rest[0]);
        let y0 = self.y - v(r.base[1]) - v(r.rest[1]);
        let (x1, y1) = (x0 + three, y0 + three);
        // The minimum over a brick lies on one of the two edges that face the mean, or is the mean itself.
        let xn = x0.max(x1.min(zero));
        let yn = y0.max(y1.min(zero));
        let ya = (xn * v(r.slope[1])).min(y1).max(y0);
        let xb = (yn * v(r.slope[0])).min(x1).max(x0);
        let exponent = |x: f32x16<S>, y: f32x16<S>| {
            let s1 = x.mul_add(l1, y * l2);
            let s2 = y * l3;
            s1.mul_add(s1, s2 * s2)
        };
        let nearest = exponent(xn, ya).min(exponent(xb, yn));
        (nearest.simd_le(v(r.limit)).to_bitmask() as u32, x0, y0)
    }
}

/// Statistics of one entry, lane by lane.
struct Accumulator<S: Simd> {
    w_max: f32x16<S>,
    w_sum: f32x16<S>,
    vote: [f32x16<S>; 3],
    pixels: u32,
}

impl<S: Simd> Accumulator<S> {
    #[inline(always)]
    fn new(simd: S) -> Self {
        let zero = f32x16::splat(simd, 0.0);
        Self { w_max: zero, w_sum: zero, vote: [zero; 3], pixels: 0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_exponential_is_accurate_over_its_range() {
        #[inline(always)]
        fn run<S: Simd>(simd: S, e: [f32; 16]) -> [f32; 16] {
            exp2(simd, f32x16::load_array(simd, e)).to_array()
        }
        let mut worst = 0.0f64;
        for i in 0..100_000 {
            let e: [f32; 16] = std::array::from_fn(|k| -(i as f32 * 16.0 + k as f32) * (100.0 / 1.6e6));
            let got = dispatch!(Level::new(), simd => run(simd, e));
            for k in 0..16 {
                let exact = f64::from(e[k]).exp2();
                worst = worst.max((f64::from(got[k]) / exact - 1.0).abs());
            }
        }
        assert!(worst < 3e-7, "{worst}");
    }
}
