//! The distance field of the particles alone: how far the centre of mass of the particles around is away, minus a constant
//! (Zhu and Bridson 2005; splatting.md §7.7, step 2).
//!
//! `g(x) = ‖x − x̄‖ − 0.55Δ + 2Δ·max(0, 1 − W/0.7)²`, `x̄ = Σ w_k p_k / W`, `W = Σ w_k`, `w_k = max(0, 1 − ‖x−p_k‖²/(2Δ)²)³`.
//! The last term is ours: halfway between two sheets the centre of mass lies at x itself, and the plain form puts a false
//! sheet into every gap narrower than 4Δ. W is at least 0.74 at the surface of a single particle, so only such places change.
//!
//! For comparison, the density of the particles: `g(x) = 2Δ (½ − W/W₀)`, W₀ its mean in a lattice of spacing Δ. Where half of it is
//! left is what most tools take for the surface.

use fearless_simd::{Level, Simd, dispatch, f32x8, prelude::*};

use super::cells::Cells;

/// Weight below which a place counts as far from the particles.
const FAR: f32 = 0.7;
/// Height of the term that keeps gaps open, in units of Δ.
const GAP: f32 = 2.0;
/// W₀: the integral of the kernel over Δ³, `4π·8 ∫ (1−s²)³ s² ds = 4π·8·16/315`.
const FULL: f32 = 5.106_335;

/// What of the particles' kernel sums is the field.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ParticleField {
    /// Distance to the centre of mass around.
    #[default]
    AveragedCentre,
    /// Density: bumpier, the baseline of the comparisons.
    Density,
}

/// The field in voxel units.
#[derive(Clone, Copy, Debug)]
pub(crate) struct CentreDistance {
    level: Level,
    /// Spacing Δ \[voxels\].
    spacing: f32,
    /// Distance of the surface from the centres \[voxels\].
    offset: f32,
    kind: ParticleField,
}

/// Sums over the particles around every node of a block.
struct Sums {
    weight: [[f32; 8]; 64],
    offset: [[[f32; 8]; 64]; 3],
}

impl CentreDistance {
    pub fn new(spacing: f32, offset: f32, kind: ParticleField) -> Self {
        Self { level: Level::new(), spacing, offset: offset * spacing, kind }
    }

    /// Values at the 8³ nodes that start at `node`; rows whose bit mask in `wanted` is zero are left alone, nodes without
    /// particles get +1.
    pub fn at_nodes(&self, cells: &Cells, node: [i32; 3], wanted: &[u8; 64], out: &mut [[f32; 8]; 64]) {
        dispatch!(self.level, simd => self.at_nodes_simd(simd, cells, node, wanted, out));
    }

    #[inline(always)]
    fn at_nodes_simd<S: Simd>(&self, simd: S, cells: &Cells, node: [i32; 3], wanted: &[u8; 64], out: &mut [[f32; 8]; 64]) {
        let v = |x: f32| f32x8::splat(simd, x);
        let (zero, one) = (v(0.0), v(1.0));
        let radius = cells.edge;
        let inverse = 1.0 / (radius * radius);
        let origin = node.map(|n| n as f32);
        let lanes: [f32; 8] = std::array::from_fn(|k| origin[0] + k as f32);
        let xs = f32x8::load_array(simd, lanes);
        let mut sums = Sums { weight: [[0.0; 8]; 64], offset: [[[0.0; 8]; 64]; 3] };
        let low = cells.cell_of(origin.map(|o| o - radius));
        let high = cells.cell_of(origin.map(|o| o + 7.0 + radius));
        let [px, py, pz] = &cells.position;
        cells.for_ranges(low, high, |range| {
            for k in range {
                let p = [px[k], py[k] - origin[1], pz[k] - origin[2]];
                let first = |c: f32| (c - radius).ceil().max(0.0) as usize;
                let last = |c: f32| (c + radius).floor().min(7.0) as isize;
                let (y0, y1, z0, z1) = (first(p[1]), last(p[1]), first(p[2]), last(p[2]));
                let dx = xs - v(p[0]);
                let dx2 = dx * dx;
                let mut z = z0;
                while z as isize <= z1 {
                    let dz = z as f32 - p[2];
                    let mut y = y0;
                    while y as isize <= y1 {
                        let dy = y as f32 - p[1];
                        let row = z * 8 + y;
                        let rest = 1.0 - (dy * dy + dz * dz) * inverse;
                        if rest > 0.0 && wanted[row] != 0 {
                            let t = dx2.mul_add(v(-inverse), v(rest)).max(zero);
                            let w = t * t * t;
                            let add = |sum: &mut [f32; 8], value: f32x8<S>| *sum = (f32x8::load_array_ref(simd, sum) + value).to_array();
                            add(&mut sums.weight[row], w);
                            add(&mut sums.offset[0][row], w * dx);
                            add(&mut sums.offset[1][row], w * v(dy));
                            add(&mut sums.offset[2][row], w * v(dz));
                        }
                        y += 1;
                    }
                    z += 1;
                }
            }
        });
        let gap = v(GAP * self.spacing);
        let mut row = 0;
        while row < 64 {
            if wanted[row] != 0 {
                let w = f32x8::load_array_ref(simd, &sums.weight[row]);
                let [a, b, c] = megas_math::simd::each3(|k| f32x8::load_array_ref(simd, &sums.offset[k][row]));
                let least = v(1e-6);
                let length = a.mul_add(a, b.mul_add(b, c * c)).sqrt() / w.max(least);
                let thin = (one - w * v(1.0 / FAR)).max(zero);
                let g = match self.kind {
                    ParticleField::AveragedCentre => length - v(self.offset) + gap * thin * thin,
                    ParticleField::Density => v(2.0 * self.spacing) * (v(0.5) - w * v(1.0 / FULL)),
                };
                out[row] = w.simd_gt(least).select(g, one).to_array();
            }
            row += 1;
        }
    }

    /// Value and gradient at a place \[voxels\]; `None` where no particle is within the kernel radius.
    pub fn at(&self, cells: &Cells, x: [f32; 3]) -> Option<(f32, [f32; 3])> {
        dispatch!(self.level, simd => self.at_simd(simd, cells, x))
    }

    #[inline(always)]
    fn at_simd<S: Simd>(&self, simd: S, cells: &Cells, x: [f32; 3]) -> Option<(f32, [f32; 3])> {
        let v = |x: f32| f32x8::splat(simd, x);
        let zero = v(0.0);
        let inverse = 1.0 / (cells.edge * cells.edge);
        let cell = cells.cell_of(x);
        let lane = f32x8::load_array(simd, [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]);
        // W, Σ w d, Σ t² d, Σ t² d dᵀ.
        let mut sum = [zero; 13];
        cells.for_ranges(cell.map(|c| c - 1), cell.map(|c| c + 1), |range| {
            let mut k = range.start;
            while k < range.end {
                let load = |a: usize| {
                    let chunk: [f32; 8] = cells.position[a][k..k + 8].try_into().unwrap_or_default();
                    v(x[a]) - f32x8::load_array(simd, chunk)
                };
                let d = megas_math::simd::each3(load);
                let r2 = d[0].mul_add(d[0], d[1].mul_add(d[1], d[2] * d[2]));
                let t = r2.mul_add(v(-inverse), v(1.0)).max(zero);
                let t = lane.simd_lt(v((range.end - k) as f32)).select(t, zero);
                let t2 = t * t;
                let w = t2 * t;
                sum[0] += w;
                let m = megas_math::simd::each3(|a| t2 * d[a]);
                for a in 0..3 {
                    sum[1 + a] = w.mul_add(d[a], sum[1 + a]);
                    sum[4 + a] += m[a];
                }
                sum[7] = m[0].mul_add(d[0], sum[7]);
                sum[8] = m[0].mul_add(d[1], sum[8]);
                sum[9] = m[0].mul_add(d[2], sum[9]);
                sum[10] = m[1].mul_add(d[1], sum[10]);
                sum[11] = m[1].mul_add(d[2], sum[11]);
                sum[12] = m[2].mul_add(d[2], sum[12]);
                k += 8;
            }
        });
        let mut s = [0.0f32; 13];
        for (out, lanes) in s.iter_mut().zip(sum) {
            let l = lanes.to_array();
            *out = ((l[0] + l[4]) + (l[2] + l[6])) + ((l[1] + l[5]) + (l[3] + l[7]));
        }
        if s[0] <= 1e-6 {
            return None;
        }
        let w = s[0];
        if self.kind == ParticleField::Density {
            let scale = 2.0 * self.spacing / FULL;
            return Some((self.spacing - scale * w, [s[4], s[5], s[6]].map(|m| scale * 6.0 * inverse * m)));
        }
        let offset = [s[1] / w, s[2] / w, s[3] / w];
        let length = (offset[0] * offset[0] + offset[1] * offset[1] + offset[2] * offset[2]).sqrt();
        let thin = (1.0 - w / FAR).max(0.0);
        let value = length - self.offset + GAP * self.spacing * thin * thin;
        // ∂w/∂x = −6 t² d / R²; u = (x − x̄)/‖x − x̄‖; ∇‖x − x̄‖ = u − K (M u)/W + K (u·s) m/W.
        let k = 6.0 * inverse / w;
        let u = offset.map(|o| o / length.max(1e-12));
        let m = [s[4], s[5], s[6]];
        let mu =
            [s[7] * u[0] + s[8] * u[1] + s[9] * u[2], s[8] * u[0] + s[10] * u[1] + s[11] * u[2], s[9] * u[0] + s[11] * u[1] + s[12] * u[2]];
        let slope = 2.0 * GAP * self.spacing * thin / FAR * 6.0 * inverse;
        let gradient = std::array::from_fn(|a| u[a] - k * mu[a] + k * length * m[a] + slope * m[a]);
        Some((value, gradient))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use megas_math::{rng::Rng, vec3};

    /// The definition, in double precision.
    fn reference(points: &[[f32; 3]], x: [f64; 3], spacing: f64, offset: f64, kind: ParticleField) -> f64 {
        let (mut w, mut s) = (0.0, [0.0; 3]);
        for p in points {
            let d = vec3::sub(x, p.map(f64::from));
            let t = (1.0 - vec3::dot(d, d) / (2.0 * spacing).powi(2)).max(0.0).powi(3);
            w += t;
            s = vec3::add_scaled(s, d, t);
        }
        let thin = (1.0 - w / f64::from(FAR)).max(0.0);
        if kind == ParticleField::Density && w > 1e-6 {
            return 2.0 * spacing * (0.5 - w / (32.0 * std::f64::consts::PI * 16.0 / 315.0));
        }
        if w <= 1e-6 { 1.0 } else { vec3::norm(s) / w - offset * spacing + f64::from(GAP) * spacing * thin * thin }
    }

    #[test]
    fn values_and_gradients_follow_the_definition() {
        let mut rng = Rng::new(8);
        let spacing = 1.7;
        let points: Vec<[f32; 3]> = (0..900).map(|_| std::array::from_fn(|_| rng.range(-9.0, 6.0) as f32)).collect();
        let cells = Cells::new(&points, 2.0 * spacing as f32);
        for kind in [ParticleField::AveragedCentre, ParticleField::Density] {
            let field = CentreDistance::new(spacing as f32, 0.62, kind);
            let mut out = [[0.0; 8]; 64];
            let node = [-8, 0, -8];
            field.at_nodes(&cells, node, &[0xff; 64], &mut out);
            let (mut largest, mut slopes) = (0.0f64, 0);
            for (row, values) in out.iter().enumerate() {
                for (k, got) in values.iter().enumerate() {
                    let x = [node[0] + k as i32, node[1] + row as i32 % 8, node[2] + row as i32 / 8].map(f64::from);
                    let value = |x| reference(&points, x, spacing, 0.62, kind);
                    largest = largest.max((f64::from(*got) - value(x)).abs());
                    let Some((g, gradient)) = field.at(&cells, x.map(|v| v as f32)) else { continue };
                    largest = largest.max((f64::from(g) - value(x)).abs());
                    // Where x is the centre of mass itself the distance has a kink.
                    if kind == ParticleField::AveragedCentre && g <= -0.55 * spacing as f32 {
                        continue;
                    }
                    let h = 1e-5;
                    for a in 0..3 {
                        let step = |s: f64| value(std::array::from_fn(|b| x[b] + if a == b { s } else { 0.0 }));
                        let slope = (step(h) - step(-h)) / (2.0 * h);
                        assert!((f64::from(gradient[a]) - slope).abs() < 2e-3 * (1.0 + slope.abs()), "{x:?} {a}: {} {slope}", gradient[a]);
                        slopes += 1;
                    }
                }
            }
            assert!(largest < 2e-5 && slopes > 1000, "{largest} {slopes}");
        }
    }
}
