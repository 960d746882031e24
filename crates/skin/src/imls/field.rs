//! Value, gradient and projection of the field: samples around a place are gathered once, weighted sixteen at a time.

use fearless_simd::{Level, Simd, dispatch, f32x16, prelude::*};
use megas_math::simd::Lanes;
use megas_math::{Vec3, vec3};

use super::{FieldValue, Imls, MOST_STEPS, Projection};

/// Samples around a base point, as a structure of arrays whose length is padded to whole vectors with weight 0 far away.
#[derive(Debug, Default)]
pub(super) struct Scratch {
    /// Base − sample.
    d: [Vec<f32>; 3],
    n: [Vec<f32>; 3],
    weight: Vec<f32>,
    /// Squared distances from the place asked for.
    d2: Vec<f32>,
    /// Weights of the robust refits.
    trust: Vec<f32>,
    sorted: Vec<f32>,
    base: Vec3<f32>,
    /// Everything within this of the base is there.
    radius: f32,
    count: usize,
}

const FAR: f32 = 1e18;

impl Scratch {
    fn gather(&mut self, field: &Imls, level: usize, x: Vec3<f32>, radius: f32) {
        let Self { d, n, weight, .. } = self;
        for v in d.iter_mut().chain(n.iter_mut()) {
            v.clear();
        }
        weight.clear();
        let set = &field.rows[level];
        set.rows.within(x, radius, |s, offset, _| {
            for a in 0..3 {
                d[a].push(offset[a]);
                n[a].push(set.n[a][s]);
            }
            weight.push(set.weight[s]);
        });
        self.count = weight.len();
        let padded = self.count.next_multiple_of(16);
        for v in d.iter_mut() {
            v.resize(padded, FAR);
        }
        for v in n.iter_mut() {
            v.resize(padded, 0.0);
        }
        weight.resize(padded, 0.0);
        self.d2.resize(padded, 0.0);
        (self.base, self.radius) = (x, radius);
    }

    /// Squared distances from base + `shift`; returns the smallest and how many are at most `c2`.
    #[inline(always)]
    fn measure<S: Simd>(&mut self, s: S, shift: Vec3<f32>, c2: f32) -> (f32, usize) {
        let v = |x: f32| f32x16::splat(s, x);
        let mut least = v(FAR);
        let mut count = 0;
        for k in (0..self.d2.len()).step_by(16) {
            let at = |a: &[f32]| f32x16::from_slice(s, &a[k..k + 16]);
            let (x, y, z) = (at(&self.d[0]) + v(shift[0]), at(&self.d[1]) + v(shift[1]), at(&self.d[2]) + v(shift[2]));
            let d2 = x.mul_add(x, y.mul_add(y, z * z));
            least = least.min(d2);
            count += d2.simd_le(v(c2)).to_bitmask().count_ones() as usize;
            self.d2[k..k + 16].copy_from_slice(&d2.to_array());
        }
        (least.to_array().into_iter().fold(f32::INFINITY, f32::min), count)
    }

    /// Σφ, Σφs, Σφn, Σφd, Σφsd over the samples within 3h of base + `shift`, φ with the robust weights where asked.
    #[inline(always)]
    fn sums<S: Simd>(&self, s: S, shift: Vec3<f32>, h: f32, robust: bool) -> [f32; 11] {
        let v = |x: f32| f32x16::splat(s, x);
        let (ih2, cut) = (v(-1.0 / (h * h)), v(9.0 * h * h));
        let mut sum = [v(0.0); 11];
        for k in (0..self.d2.len()).step_by(16) {
            let at = |a: &[f32]| f32x16::from_slice(s, &a[k..k + 16]);
            let d2 = at(&self.d2);
            let near = d2.simd_le(cut);
            if !near.any_true() {
                continue;
            }
            let mut phi = near.select(exp16(s, d2 * ih2) * at(&self.weight), v(0.0));
            if robust {
                phi *= at(&self.trust);
            }
            let d = [at(&self.d[0]) + v(shift[0]), at(&self.d[1]) + v(shift[1]), at(&self.d[2]) + v(shift[2])];
            // The padding must not turn 0 · ∞ into NaN.
            let d = [near.select(d[0], v(0.0)), near.select(d[1], v(0.0)), near.select(d[2], v(0.0))];
            let n = [at(&self.n[0]), at(&self.n[1]), at(&self.n[2])];
            let side = n[0].mul_add(d[0], n[1].mul_add(d[1], n[2] * d[2]));
            let weighted = phi * side;
            sum[0] += phi;
            sum[1] += weighted;
            for a in 0..3 {
                sum[2 + a] = phi.mul_add(n[a], sum[2 + a]);
                sum[5 + a] = phi.mul_add(d[a], sum[5 + a]);
                sum[8 + a] = weighted.mul_add(d[a], sum[8 + a]);
            }
        }
        let mut out = [0.0; 11];
        for (o, s) in out.iter_mut().zip(sum) {
            // Pairs first: the order is fixed.
            let mut a = s.to_array();
            for half in [8, 4, 2, 1] {
                for k in 0..half {
                    a[k] += a[k + half];
                }
            }
            *o = a[0];
        }
        out
    }

    fn distrust(&mut self, gradient: Vec3<f32>, sigma: f32) {
        self.trust.clear();
        for k in 0..self.d2.len() {
            let e = vec3::sub([self.n[0][k], self.n[1][k], self.n[2][k]], gradient);
            self.trust.push((-vec3::dot(e, e) / (sigma * sigma)).exp());
        }
    }
}

/// `eˣ` of sixteen lanes by the accurate exponential of native width.
#[inline(always)]
fn exp16<S: Simd>(s: S, x: f32x16<S>) -> f32x16<S> {
    let x = x.to_array();
    let mut out = [0.0f32; 16];
    let width = Lanes::<S>::LEN;
    let mut k = 0;
    while k < 16 {
        let y = megas_math::simd::elementary::exp(s, Lanes::<S>::from_slice(s, &x[k..k + width]));
        out[k..k + width].copy_from_slice(y.as_slice());
        k += width;
    }
    f32x16::load_array(s, out)
}

impl Imls {
    /// Number of samples within h of `x`, at least 1.
    pub(super) fn crowd(&self, scratch: &mut Scratch, x: Vec3<f32>) -> f32 {
        let h = self.evaluate_with(scratch, x).bandwidth;
        let mut count = 0;
        self.rows[0].rows.within(x, h, |_, _, _| count += 1);
        count.max(1) as f32
    }

    pub(super) fn evaluate_with(&self, scratch: &mut Scratch, x: Vec3<f32>) -> FieldValue {
        scratch.radius = -1.0;
        self.at(scratch, x, 0.0, f32::INFINITY)
    }

    /// The field at `points` in their order, where the nearest sample is within `reach`; elsewhere undefined (`weight` 0). Much faster than
    /// one by one where neighbours in the list lie within `margin` of each other, as the nodes of a grid do: they share their
    /// samples. The list alone decides how sums are rounded.
    pub(crate) fn evaluate_near(&self, points: &[Vec3<f32>], reach: f32, margin: f32) -> Vec<FieldValue> {
        let mut scratch = Scratch { radius: -1.0, ..Scratch::default() };
        points.iter().map(|&x| self.at(&mut scratch, x, margin, reach)).collect()
    }

    /// The field at `x`; what `scratch` holds is used again where it covers the ball. `margin` is gathered on top for the steps
    /// that follow. Undefined where the nearest sample is farther than `reach`.
    fn at(&self, scratch: &mut Scratch, x: Vec3<f32>, margin: f32, reach: f32) -> FieldValue {
        let s = &self.settings;
        // Bandwidth h_k of stage k is certain where the twelfth neighbour is within h_k/factor.
        let mut h = s.least * self.spacing;
        let most = (s.most * self.spacing).max(h);
        // What decides about the reach must be gathered.
        let decisive = if reach.is_finite() { reach } else { 0.0 };
        loop {
            let c = h / s.factor;
            let need = (3.0 * h).max(c).max(decisive);
            let moved = vec3::norm(vec3::sub(x, scratch.base));
            if !(scratch.radius >= 0.0 && moved + need <= scratch.radius) {
                let wide = need > 3.01 * 4.0 * s.least * self.spacing;
                scratch.gather(self, usize::from(wide), x, need + margin);
            }
            let shift = vec3::sub(x, scratch.base);
            let (least, count) = dispatch!(self.level, simd => scratch.measure(simd, shift, c * c));
            let nearest = if least < 0.5 * FAR { least.sqrt() } else { f32::INFINITY };
            if nearest > reach {
                return FieldValue { value: 0.0, gradient: [0.0; 3], weight: 0.0, bandwidth: h, nearest };
            }
            if count < s.neighbour && h < most {
                h = (2.0 * h).min(most);
                continue;
            }
            if count >= s.neighbour && h > s.least * self.spacing {
                scratch.sorted.clear();
                scratch.sorted.extend_from_slice(&scratch.d2[..scratch.count]);
                let d2 = *scratch.sorted.select_nth_unstable_by(s.neighbour - 1, f32::total_cmp).1;
                h = (s.factor * d2.sqrt()).clamp(s.least * self.spacing, most);
            }
            return self.fit(scratch, shift, h, nearest);
        }
    }

    fn fit(&self, scratch: &mut Scratch, shift: Vec3<f32>, h: f32, nearest: f32) -> FieldValue {
        let mut out = value(self.level, scratch, shift, h, nearest, false);
        if let Some(sigma) = self.settings.robust {
            for _ in 0..3 {
                if !out.is_valid() {
                    break;
                }
                scratch.distrust(out.gradient, sigma);
                let next = value(self.level, scratch, shift, h, nearest, true);
                if !next.is_valid() {
                    break;
                }
                out = next;
            }
        }
        out
    }

    pub(super) fn project_with(&self, scratch: &mut Scratch, start: Vec3<f32>, reach: f32) -> Option<Projection> {
        scratch.radius = -1.0;
        let mut x = start;
        for steps in 0..=MOST_STEPS {
            let v = self.at(scratch, x, self.spacing, f32::INFINITY);
            if !v.is_valid() {
                return None;
            }
            let g2 = vec3::dot(v.gradient, v.gradient);
            let mut step = vec3::scale(v.gradient, -v.value / g2);
            let length = v.value.abs() / g2.sqrt();
            if length < 1e-3 * self.spacing {
                let x = vec3::add(x, step);
                let close = vec3::norm(vec3::sub(x, start)) <= reach;
                return close.then(|| Projection { position: x, normal: v.normal(), bandwidth: v.bandwidth, steps });
            }
            if length > v.bandwidth {
                step = vec3::scale(step, v.bandwidth / length);
            }
            x = vec3::add(x, step);
            if vec3::norm(vec3::sub(x, start)) > 2.0 * reach {
                return None;
            }
        }
        None
    }
}

fn value(level: Level, scratch: &Scratch, shift: Vec3<f32>, h: f32, nearest: f32, robust: bool) -> FieldValue {
    let s = dispatch!(level, simd => scratch.sums(simd, shift, h, robust));
    let weight = s[0];
    if weight <= 0.0 {
        return FieldValue { value: 0.0, gradient: [0.0; 3], weight: 0.0, bandwidth: h, nearest };
    }
    let f = s[1] / weight;
    let gradient = [0, 1, 2].map(|a| (s[2 + a] - 2.0 / (h * h) * (s[8 + a] - f * s[5 + a])) / weight);
    FieldValue { value: f, gradient, weight, bandwidth: h, nearest }
}
