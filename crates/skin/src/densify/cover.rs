//! Thinned skin: where the flow has drawn the Gaussians of the surface apart, they grow until they meet again.
//!
//! Kernels from the inside (§7) seal what lies deeper than the skin, but a melt that spreads into a film has no inside: its surface
//! would become a net through which the ground shows. The deformation gradient cannot tell either, because its stretch is limited and
//! fades (§8.2). So the gaps are measured: in each sixth of the plane around a Gaussian the distance `D_k` to the next one of the
//! same skin, and with the directions `u_k` of the sectors
//!
//! ```text
//! C = κ²/3 · Σ_k D_k² u_k u_kᵀ ,   Σ ← Σ + [C − θ Σ_plane]₊
//! ```
//!
//! For an even spacing D the sum is (κD)² in the plane. Nothing shrinks, nothing grows out of the plane. θ > 1 waits until a gap can be
//! seen: what grows before loses detail for nothing.

use megas_math::{Vec3, vec3};
use megas_raster::{Gaussians, pack_covariance, unpack_covariance};
use rayon::prelude::*;

use super::rim;
use crate::rows::Rows;

/// How Gaussians grow.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Growth {
    /// κ: standard deviation per distance.
    pub kappa: f32,
    /// θ: growth begins where neighbours stand √θ/κ standard deviations apart.
    pub onset: f32,
    /// Sectors in which neighbours must be found.
    pub sectors: usize,
}

/// Gaussians of the surface: from 2.6 standard deviations on. Fresh models have neighbours two and less apart.
/// Fewer sectors than three belong to a drop or a thread.
pub(crate) const SURFACE: Growth = Growth { kappa: 0.45, onset: 1.4, sectors: 3 };
/// Kernels: behind them is nothing that could be spoiled. In a crack they have neighbours all around; those beside an outline would stick
/// out over it.
pub(crate) const KERNELS: Growth = Growth { kappa: 0.6, onset: 1.4, sectors: 5 };
/// Largest standard deviation that growth gives, in particle spacings Δ.
const MOST: f32 = 1.0;
/// Farthest neighbour, in largest standard deviations.
const REACH: f32 = 2.0;
/// Farthest neighbour that counts, in distances to the nearest: one seen along an edge is none to meet.
const WIDEST: f32 = 4.0;
/// Rise of a neighbour over the plane, per distance in it, up to which it is of the same sheet.
const SLOPE: f32 = 0.7;
/// Share of a neighbour's squared distance that must lie in the plane to count as being in a direction at all.
const STEEP: f32 = 0.05;
/// Share of the new value in the running mean, which gets one every second frame.
const NEW: f32 = 0.4;

/// Parts of the plane around a Gaussian.
pub(super) const SECTORS: usize = 6;

/// In-plane tensors `C` (world axes, packed like covariances) of the surface; zero: does not grow. And where its rims are ([`rim`]).
pub(crate) fn measure(
    surface: &Gaussians,
    normals: &[Vec3<f32>],
    object: &[u16],
    wanted: impl Fn(usize) -> bool + Sync,
    delta: f32,
    state: &mut Vec<[f32; 6]>,
    rim: &mut Vec<Vec3<f32>>,
    growth: Growth,
    smooth: bool,
) {
    let n = surface.len();
    state.resize(n, [0.0; 6]);
    rim.resize(n, [0.0; 3]);
    let present = |i: usize| surface.visible.get(i) != Some(&false);
    let asked: Vec<bool> = (0..n).map(|i| present(i) && wanted(i)).collect();
    if !asked.contains(&true) {
        return;
    }
    let reach = REACH * MOST * delta;
    let rows = Rows::new(&surface.mean, 0.5 * reach);
    state.par_iter_mut().zip(rim.par_iter_mut()).with_min_len(256).enumerate().filter(|(i, _)| asked[*i]).for_each(|(i, (kept, rim))| {
        let mine = |j: usize| present(j) && object[j] == object[i] && j != i;
        let (fresh, edge) = tensor(&rows, surface.mean[i], normals[i], reach, growth, mine, normals);
        let first = !smooth || kept[0] + kept[3] + kept[5] == 0.0;
        let share = if first { 1.0 } else { NEW };
        for (k, f) in kept.iter_mut().zip(fresh) {
            *k += share * (f - *k);
        }
        for (k, f) in rim.iter_mut().zip(edge) {
            *k += share * (f - *k);
        }
    });
}

/// `C` and rim around one place.
fn tensor(
    rows: &Rows,
    x: Vec3<f32>,
    normal: Vec3<f32>,
    reach: f32,
    growth: Growth,
    mine: impl Fn(usize) -> bool,
    normals: &[Vec3<f32>],
) -> ([f32; 6], [f32; 3]) {
    if vec3::dot(normal, normal) < 0.25 {
        return ([0.0; 6], [0.0; 3]);
    }
    let (t1, t2) = vec3::frame_from_normal(normal);
    let mut least = [f32::INFINITY; SECTORS];
    // Sectors with anything of the object that is not above or below.
    let mut any = [false; SECTORS];
    // Nearest first costs less than a wide search everywhere: most places are as dense as ever.
    let mut radius = 0.4 * reach;
    loop {
        rows.within(x, radius, |s, d, d2| {
            let j = rows.item[s] as usize;
            let h = vec3::dot(d, normal);
            let flat = d2 - h * h;
            if flat <= STEEP * d2 || !mine(j) {
                return;
            }
            // `d` points away from the neighbour, which makes no difference to u uᵀ but does to the sector.
            let k = sector(-vec3::dot(d, t1), -vec3::dot(d, t2));
            any[k] = true;
            if h * h > SLOPE * SLOPE * flat || vec3::dot(normal, normals[j]) <= 0.0 {
                return;
            }
            least[k] = least[k].min(flat);
        });
        if radius >= reach || least.iter().all(|v| v.is_finite()) {
            break;
        }
        radius = reach;
    }
    let found: Vec<f32> = least.iter().copied().filter(|v| v.is_finite()).collect();
    if found.len() < growth.sectors {
        return ([0.0; 6], [0.0; 3]);
    }
    // Beyond an edge there is nothing to meet: as far as on the other sides, no farther.
    let nearest = found.iter().copied().fold(f32::INFINITY, f32::min);
    let mut c = [0.0f32; 3];
    for (k, v) in least.iter().enumerate() {
        let d2 = if v.is_finite() { v.min(WIDEST * WIDEST * nearest) } else { nearest };
        let (s, o) = (std::f32::consts::TAU * (k as f32 + 0.5) / SECTORS as f32).sin_cos();
        c[0] += d2 * o * o;
        c[1] += d2 * o * s;
        c[2] += d2 * s * s;
    }
    let f = growth.kappa * growth.kappa * 2.0 / SECTORS as f32;
    let most = (reach / REACH) * (reach / REACH);
    let [a, b, d] = limit(c.map(|v| f * v), |v| v.clamp(0.0, most));
    let distance = (found.iter().sum::<f32>() / found.len() as f32).sqrt();
    (spread(t1, t2, a, b, d), rim::edge(any, distance, reach, t1, t2))
}

fn sector(a: f32, b: f32) -> usize {
    // Sixths of the circle without an arc tangent: the half plane, then the side of the lines at 60° and 120°.
    const TAN60: f32 = 1.732_050_8;
    let up = b >= 0.0;
    let (a, b) = if up { (a, b) } else { (-a, -b) };
    let k = if b < TAN60 * a {
        0
    } else if b < -TAN60 * a {
        2
    } else {
        1
    };
    if up { k } else { k + 3 }
}

/// `f` applied to the eigenvalues of `[[a, b], [b, d]]`.
fn limit([a, b, d]: [f32; 3], f: impl Fn(f32) -> f32) -> [f32; 3] {
    let (m, h) = (0.5 * (a + d), 0.5 * (a - d));
    let r = h.hypot(b);
    let (p, q) = (f(m + r), f(m - r));
    // Projector on the larger axis: ½(I + [h b; b −h]/r).
    let (mean, half) = (0.5 * (p + q), if r > 0.0 { 0.5 * (p - q) / r } else { 0.0 });
    [mean + half * h, half * b, mean - half * h]
}

/// `a t₁t₁ᵀ + b (t₁t₂ᵀ + t₂t₁ᵀ) + d t₂t₂ᵀ`.
fn spread(t1: Vec3<f32>, t2: Vec3<f32>, a: f32, b: f32, d: f32) -> [f32; 6] {
    let at = |r: usize, c: usize| a * t1[r] * t1[c] + b * (t1[r] * t2[c] + t2[r] * t1[c]) + d * t2[r] * t2[c];
    [at(0, 0), at(0, 1), at(0, 2), at(1, 1), at(1, 2), at(2, 2)]
}

/// Lets the Gaussians grow to their tensors. Returns how many did.
pub(crate) fn grow(surface: &mut Gaussians, normals: &[Vec3<f32>], state: &[[f32; 6]], onset: f32) -> usize {
    let grown: Vec<usize> = surface
        .covariance
        .par_iter_mut()
        .with_min_len(1024)
        .enumerate()
        .filter(|(i, _)| state.get(*i).is_some_and(|c| c[0] + c[3] + c[5] > 0.0))
        .filter_map(|(i, covariance)| {
            let (t1, t2) = vec3::frame_from_normal(normals[i]);
            let (s, c) = (unpack_covariance(*covariance), unpack_covariance(state[i]));
            let gap = |u: Vec3<f32>, v: Vec3<f32>| {
                (0..3).map(|r| (0..3).map(|k| u[r] * (c[r][k] - onset * s[r][k]) * v[k]).sum::<f32>()).sum::<f32>()
            };
            let [a, b, d] = limit([gap(t1, t1), gap(t1, t2), gap(t2, t2)], |v| v.max(0.0));
            if a + d <= 0.0 {
                return None;
            }
            let more = unpack_covariance(spread(t1, t2, a, b, d));
            *covariance = pack_covariance(std::array::from_fn(|r| std::array::from_fn(|k| s[r][k] + more[r][k])));
            Some(i)
        })
        .collect();
    grown.len()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A sheet of discs with standard deviation 0.06 at the spacings `dx` and `dy`, tilted.
    fn sheet(dx: f32, dy: f32) -> (Gaussians, Vec<Vec3<f32>>) {
        let n = vec3::normalize_or([0.3f32, -0.2, 0.9], [0.0; 3]);
        let (t1, t2) = vec3::frame_from_normal(n);
        let mut g = Gaussians::new(0);
        for i in 0..400 {
            let (u, v) = ((i % 20) as f32 * dx, (i / 20) as f32 * dy);
            let x = [0, 1, 2].map(|k| u * t1[k] + v * t2[k]);
            g.push(x, spread(t1, t2, 0.0036, 0.0, 0.0036), n, 0.97, &[0.0; 3], 300.0);
        }
        let normals = g.normal.clone();
        (g, normals)
    }

    fn grown(dx: f32, dy: f32, object: &[u16]) -> (Gaussians, Gaussians) {
        let (before, normals) = sheet(dx, dy);
        let (mut g, mut state, mut rim) = (before.clone(), Vec::new(), Vec::new());
        measure(&g, &normals, object, |_| true, 0.3, &mut state, &mut rim, SURFACE, true);
        grow(&mut g, &normals, &state, SURFACE.onset);
        (before, g)
    }

    #[test]
    fn drawn_apart_they_meet_again_and_close_ones_stay() {
        let one = vec![1; 400];
        let (before, after) = grown(0.1, 0.1, &one);
        let middle = |i: &usize| (2..18).contains(&(i % 20)) && (2..18).contains(&(i / 20));
        assert!((0..400).filter(middle).all(|i| before.covariance[i] == after.covariance[i]));
        let area = |g: &Gaussians, i: usize| super::super::kernels::cover(g, i) / g.opacity[i];
        // The middle of the sheet: threefold spacing in one direction, in both.
        let (_, long) = grown(0.3, 0.1, &one);
        let (_, wide) = grown(0.3, 0.3, &one);
        let (a, b) = (area(&long, 210).sqrt(), area(&wide, 210).sqrt());
        assert!(a > 0.08 && a < 0.13, "{a}");
        assert!(b > 0.14 && b < 0.2, "{b}");
        // Only in the plane.
        let n = wide.normal[210];
        let s = unpack_covariance(wide.covariance[210]);
        let out: f32 = (0..3).map(|r| (0..3).map(|k| n[r] * s[r][k] * n[k]).sum::<f32>()).sum();
        assert!(out.abs() < 1e-6, "{out}");
        // What lies wider apart than the largest size allows is no skin any more, and another object is no neighbour.
        let (before, after) = grown(0.9, 0.9, &one);
        assert!(before == after);
        let stripes: Vec<u16> = (0..400).map(|i| i as u16).collect();
        let (before, after) = grown(0.3, 0.3, &stripes);
        assert!(before == after);
    }

    #[test]
    fn sectors_are_sixths() {
        for k in 0..360 {
            let (s, c) = (k as f32 + 0.5).to_radians().sin_cos();
            assert_eq!(sector(c, s), k / 60, "{k}");
        }
    }
}
