//! Backward compositing of one block of 16 × 16 pixels (splatting.md §4.1).
//!
//! The entries of the tile are replayed front to back by the forward pass's own function, so the same pixels blend
//! the same entries with the same weights. What is behind an entry follows from what is still missing of the pixel's total,
//! without dividing by a small transmittance.
//!
//! Moments of the exponent's gradient are taken in the whitened coordinates `s = L(x − m)` of [`Record`]: with
//! `h = ô e^{−q} ∂L/∂α`, `∂L/∂m = 2 ln2 Lᵀ Σ h s` and `∂L/∂Σ' = 2 ln²2 Lᵀ (Σ h s sᵀ) L`, and no inverse is needed.

use fearless_simd::{Simd, dispatch, f32x16, prelude::*};

use crate::kernel::{Blend, Bricks, Limits, Place, Plane, STAGE, Scene, alive, stage};
use crate::project::Record;

/// Transmittance, what is missing of the total, then the cotangents: colour (3), alpha.
pub(crate) const COLOUR_PLANES: usize = 6;
/// As [`COLOUR_PLANES`], then depth, normal (3), plane distance, temperature.
pub(crate) const GEOMETRY_PLANES: usize = 12;

/// What one entry of a tile's list received from the pixels of that tile.
#[derive(Clone, Copy, Debug, Default)]
#[repr(C, align(16))]
pub(crate) struct Partial {
    /// `∂L/∂rgb`.
    pub rgb: [f32; 3],
    /// `Σ h`.
    pub h: f32,
    /// `Σ h s`.
    pub first: [f32; 2],
    /// `Σ |h l₁ s₁|`, `Σ |h (l₂ s₁ + l₃ s₂)|`.
    pub absolute: [f32; 2],
    /// `Σ h s₁²`, `Σ h s₁s₂`, `Σ h s₂²`.
    pub second: [f32; 3],
    /// Depth, normal, plane distance, temperature.
    pub geometry: [f32; 6],
}

const SUMS: usize = 11;

impl Partial {
    #[inline(always)]
    pub fn add(&mut self, o: &Self, geometry: bool) {
        for k in 0..3 {
            self.rgb[k] += o.rgb[k];
            self.second[k] += o.second[k];
        }
        for k in 0..2 {
            self.first[k] += o.first[k];
            self.absolute[k] += o.absolute[k];
        }
        self.h += o.h;
        if geometry {
            for k in 0..6 {
                self.geometry[k] += o.geometry[k];
            }
        }
    }
}

/// Adds the gradients of the tile's entries over one block to `partials`, which has one element per entry. Of `planes` the
/// cotangents, the totals and the starting transmittances are set.
pub(crate) fn backward<const N: usize>(scene: &Scene, place: Place, planes: &mut [Plane; N], partials: &mut [Partial]) {
    const { assert!(N == COLOUR_PLANES || N == GEOMETRY_PLANES) };
    dispatch!(scene.level, simd => backward_simd(simd, scene, place, planes, partials));
}

#[inline(always)]
fn backward_simd<S: Simd, const N: usize>(simd: S, scene: &Scene, place: Place, planes: &mut [Plane; N], partials: &mut [Partial]) {
    let geometry = N == GEOMETRY_PLANES;
    let v = |x: f32| f32x16::splat(simd, x);
    let zero = v(0.0);
    let one = v(1.0);
    let bricks = Bricks::new(simd, place);
    let (column, row) = (bricks.column, bricks.row);
    let limits = Limits::new(simd, scene);

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
                let mut sums = [zero; SUMS];
                let mut more = [zero; 6];
                let features = if geometry {
                    let e = &scene.extras[rank as usize];
                    [e.z, e.normal[0], e.normal[1], e.normal[2], e.plane, r.temperature]
                } else {
                    [0.0; 6]
                };
                while touched != 0 {
                    let b = touched.trailing_zeros() as usize & 15;
                    touched &= touched - 1;
                    let load = |p: &Plane| f32x16::load_array_ref(simd, &p.0[b]);
                    let (s1, s2) = (inner1 + v(corner1[b]), inner2 + v(corner2[b]));
                    let Blend { free, alpha, before, w, blended } = limits.blend(simd, log_opacity, s1, s2, &mut planes[0].0[b]);

                    let (gr, gg, gb) = (load(&planes[2]), load(&planes[3]), load(&planes[4]));
                    let mut c = gr.mul_add(v(r.rgb[0]), gg.mul_add(v(r.rgb[1]), gb.mul_add(v(r.rgb[2]), load(&planes[5]))));
                    sums[0] = w.mul_add(gr, sums[0]);
                    sums[1] = w.mul_add(gg, sums[1]);
                    sums[2] = w.mul_add(gb, sums[2]);
                    if geometry {
                        for k in 0..6 {
                            let g = load(&planes[COLOUR_PLANES + k]);
                            c = g.mul_add(v(features[k]), c);
                            more[k] = w.mul_add(g, more[k]);
                        }
                    }
                    let rest = load(&planes[1]) - w * c;
                    rest.store_array(&mut planes[1].0[b]);
                    // Where the largest alpha holds, the Gaussian's own parameters have no influence.
                    let free_alpha = free.simd_le(limits.alpha_max);
                    let slope = before * c - rest / (one - alpha);
                    let h = (blended & free_alpha).select(alpha * slope, zero);
                    let (h1, h2) = (h * s1, h * s2);
                    sums[3] += h;
                    sums[4] += h1;
                    sums[5] += h2;
                    sums[6] += (h1 * l1).abs();
                    sums[7] += h1.mul_add(l2, h2 * l3).abs();
                    sums[8] = h1.mul_add(s1, sums[8]);
                    sums[9] = h1.mul_add(s2, sums[9]);
                    sums[10] = h2.mul_add(s2, sums[10]);
                }
                let total = reduce(simd, |k| if k < SUMS { sums[k] } else { zero });
                let p = &mut partials[slot];
                let mut found = Partial {
                    rgb: [total[0], total[1], total[2]],
                    h: total[3],
                    first: [total[4], total[5]],
                    absolute: [total[6], total[7]],
                    second: [total[8], total[9], total[10]],
                    geometry: [0.0; 6],
                };
                if geometry {
                    found.geometry = std::array::from_fn(|k| more[k].reduce_sum());
                }
                p.add(&found, geometry);
                until_check -= 1;
                if until_check == 0 {
                    until_check = 16;
                    live = alive(simd, &planes[0]);
                    if live == 0 {
                        return;
                    }
                }
            }
            slot += 1;
        }
    }
}

/// Sums of the lanes of sixteen vectors, by a transposing tree.
#[inline(always)]
fn reduce<S: Simd>(simd: S, of: impl Fn(usize) -> f32x16<S>) -> [f32; 16] {
    // Each level halves the number of vectors: `join` interleaves two and adds their halves.
    let join = |a: f32x16<S>, b: f32x16<S>| a.zip_low(b) + a.zip_high(b);
    let quad = |i: usize| join(join(of(i), of(i + 8)), join(of(i + 4), of(i + 12)));
    let _ = simd;
    join(join(quad(0), quad(2)), join(quad(1), quad(3))).to_array()
}
