//! Collision of the flow: D3Q19, two relaxation times, Guo forcing, Smagorinsky, saturated nodes (simulation.md §4.2, §4.3,
//! §4.6). Populations are stored as `f_k − w_k`, so that sums keep their digits.

use fearless_simd::{Select, Simd, SimdBase, SimdFloat, SimdMask};
use megas_math::simd::Lanes;

use crate::air::settings::{LatticeSettings, SPEED_CAP};

/// Weights of the rest, the axes and the diagonals.
const W: [f32; 3] = [1.0 / 3.0, 1.0 / 18.0, 1.0 / 36.0];

/// Largest |ρ − 1| deep inside a solid.
pub(crate) const DEEP: f32 = 0.01;

#[inline(always)]
fn weight(q: usize) -> f32 {
    if q < 3 { W[1] } else { W[2] }
}

/// `c_q · v` of the nine pairs.
#[inline(always)]
pub(crate) fn along<S: Simd>(v: [Lanes<S>; 3]) -> [Lanes<S>; 9] {
    let [x, y, z] = v;
    [x, y, z, x + y, x - y, x + z, x - z, y + z, y - z]
}

/// Populations of one vector of nodes as sums and differences of the nine opposite pairs, and the rest.
#[derive(Clone, Copy)]
pub(crate) struct Pairs<S: Simd> {
    pub(crate) rest: Lanes<S>,
    pub(crate) sum: [Lanes<S>; 9],
    pub(crate) difference: [Lanes<S>; 9],
}

/// Density excess and momentum before forces.
#[inline(always)]
pub(crate) fn moments<S: Simd>(f: &Pairs<S>) -> (Lanes<S>, [Lanes<S>; 3]) {
    let s = &f.sum;
    let rho = f.rest + ((s[0] + s[1]) + (s[2] + s[3])) + ((s[4] + s[5]) + (s[6] + (s[7] + s[8])));
    let d = &f.difference;
    let x = (d[0] + (d[3] + d[4])) + (d[5] + d[6]);
    let y = (d[1] + (d[3] - d[4])) + (d[7] + d[8]);
    let z = (d[2] + (d[5] - d[6])) + (d[7] - d[8]);
    (rho, [x, y, z])
}

/// Constants of the collision.
#[derive(Clone, Copy)]
pub(crate) struct FlowRates {
    tau: f32,
    plus: f32,
    minus: f32,
    /// Λ_f, or 0 for a single relaxation time.
    lambda: f32,
    /// 18 √2 C_S²; 0 without the model.
    smagorinsky: f32,
}

impl FlowRates {
    pub(crate) fn new(settings: &LatticeSettings) -> Self {
        let tau = 3.0 * settings.viscosity + 0.5;
        let (plus, minus) = settings.flow_rates(tau);
        Self {
            tau: tau as f32,
            plus: plus as f32,
            minus: minus as f32,
            lambda: settings.lambda_flow.unwrap_or(0.0) as f32,
            smagorinsky: (18.0 * std::f64::consts::SQRT_2 * settings.smagorinsky * settings.smagorinsky) as f32,
        }
    }
}

impl FlowRates {
    /// True with the Smagorinsky model.
    #[inline(always)]
    pub(crate) fn has_eddies(&self) -> bool {
        self.smagorinsky > 0.0
    }
}

/// Velocity from momentum: divided by the density, capped for the equilibria. Returns u, ρ and |u|² before the cap.
#[inline(always)]
pub(crate) fn velocity<S: Simd>(s: S, rho: Lanes<S>, m: [Lanes<S>; 3]) -> ([Lanes<S>; 3], Lanes<S>, Lanes<S>) {
    let one = Lanes::<S>::splat(s, 1.0);
    let density = rho + one;
    let inverse = one / density;
    let mut u = [m[0] * inverse, m[1] * inverse, m[2] * inverse];
    let u2 = u[0].mul_add(u[0], u[1].mul_add(u[1], u[2] * u[2]));
    let cap = Lanes::<S>::splat(s, SPEED_CAP as f32);
    let fast = u2.simd_gt(cap * cap);
    if fast.any_true() {
        let scale = fast.select(cap / u2.sqrt(), one);
        u = [u[0] * scale, u[1] * scale, u[2] * scale];
    }
    (u, density, u2)
}

/// Collides with force density `force`; `u` is the force-corrected velocity. Returns the eddy viscosity, zero without model.
#[inline(always)]
pub(crate) fn collide<S: Simd>(
    s: S,
    f: &mut Pairs<S>,
    rates: &FlowRates,
    rho: Lanes<S>,
    density: Lanes<S>,
    u: [Lanes<S>; 3],
    force: [Lanes<S>; 3],
) -> Lanes<S> {
    let c = |v: f32| Lanes::<S>::splat(s, v);
    let m = [density * u[0], density * u[1], density * u[2]];
    let dot = |a: &[Lanes<S>; 3], b: &[Lanes<S>; 3]| a[0].mul_add(b[0], a[1].mul_add(b[1], a[2] * b[2]));
    let base = rho - dot(&m, &u) * 1.5;
    let cu = along::<S>(u);
    let (plus, minus, eddy) =
        if rates.has_eddies() { strained(s, f, rates, base, &cu, along::<S>(m)) } else { (c(rates.plus), c(rates.minus), c(0.0)) };
    let half_plus = plus * -0.5 + 1.0;
    let half_minus = minus * -0.5 + 1.0;
    // Even: w [A + (c·u)(c·G)]; odd: w c·H.
    let a = plus * base - half_plus * dot(&u, &force) * 3.0;
    let (p45, p9) = (plus * 4.5, half_plus * 9.0);
    let g = along::<S>([m[0].mul_add(p45, p9 * force[0]), m[1].mul_add(p45, p9 * force[1]), m[2].mul_add(p45, p9 * force[2])]);
    let (m3, h3) = (minus * 3.0, half_minus * 3.0);
    let h = along::<S>([m[0].mul_add(m3, h3 * force[0]), m[1].mul_add(m3, h3 * force[1]), m[2].mul_add(m3, h3 * force[2])]);
    // Half sums and half differences leave: f* = even ± odd.
    let (keep_even, keep_odd) = (plus * -0.5 + 0.5, minus * -0.5 + 0.5);
    f.rest = f.rest.mul_add(c(1.0) - plus, a * W[0]);
    for q in 0..9 {
        let w = weight(q);
        f.sum[q] = f.sum[q].mul_add(keep_even, cu[q].mul_add(g[q], a) * w);
        f.difference[q] = f.difference[q].mul_add(keep_odd, h[q] * w);
    }
    eddy
}

/// Relaxation rates with the eddy viscosity of Smagorinsky: (ω⁺, ω⁻, ν_t).
#[inline(always)]
fn strained<S: Simd>(
    s: S,
    f: &Pairs<S>,
    rates: &FlowRates,
    base: Lanes<S>,
    cu: &[Lanes<S>; 9],
    cm: [Lanes<S>; 9],
) -> (Lanes<S>, Lanes<S>, Lanes<S>) {
    let c = |v: f32| Lanes::<S>::splat(s, v);
    // Twice the even non-equilibrium of each pair.
    let n = |q: usize| f.sum[q] - cu[q].mul_add(cm[q] * 4.5, base) * (2.0 * weight(q));
    let n: [Lanes<S>; 9] = [n(0), n(1), n(2), n(3), n(4), n(5), n(6), n(7), n(8)];
    let xx = n[0] + ((n[3] + n[4]) + (n[5] + n[6]));
    let yy = n[1] + ((n[3] + n[4]) + (n[7] + n[8]));
    let zz = n[2] + ((n[5] + n[6]) + (n[7] + n[8]));
    let (xy, xz, yz) = (n[3] - n[4], n[5] - n[6], n[7] - n[8]);
    let off = xy.mul_add(xy, xz.mul_add(xz, yz * yz));
    let norm2 = xx.mul_add(xx, yy.mul_add(yy, zz.mul_add(zz, off * 2.0)));
    let t = rates.tau;
    let tau = ((norm2.sqrt() * rates.smagorinsky + t * t).sqrt() + t) * 0.5;
    let plus = c(1.0) / tau;
    let minus = if rates.lambda > 0.0 { c(1.0) / (c(rates.lambda) / (tau - 0.5) + 0.5) } else { plus };
    (plus, minus, (tau - t) * (1.0 / 3.0))
}

/// Mixes in the reflection about a solid that fills part of the node (simulation.md §4.6). `before` is the state before the
/// collision and `f` after it; `solid` the filled fraction; beyond 1.5 the node is deep inside and starts anew. It keeps its
/// density within one percent of 1: the design sets it to 1, which loses 5e-4 of the air when a block crosses a closed box.
#[inline(always)]
pub(crate) fn saturate<S: Simd>(
    s: S,
    before: &Pairs<S>,
    f: &mut Pairs<S>,
    solid: Lanes<S>,
    share: Lanes<S>,
    rho: Lanes<S>,
    density: Lanes<S>,
    u: [Lanes<S>; 3],
    v: [Lanes<S>; 3],
) {
    let c = |v: f32| Lanes::<S>::splat(s, v);
    let dot = |a: &[Lanes<S>; 3]| a[0].mul_add(a[0], a[1].mul_add(a[1], a[2] * a[2]));
    let (u2, v2) = (dot(&u) * 1.5, dot(&v) * 1.5);
    let keep = c(1.0) - share;
    let deep = solid.simd_gt(c(1.5));
    let held = rho.max(c(-DEEP)).min(c(DEEP));
    let held_density = held + 1.0;
    let rest = before.rest.mul_add(share, f.rest * keep) + share * density * (u2 - v2) * W[0];
    f.rest = deep.select((held - held_density * v2) * W[0], rest);
    let (cu, cv) = (along::<S>(u), along::<S>(v));
    for q in 0..9 {
        let w = weight(q);
        let even = density * (cv[q] * cv[q] * 4.5 - v2 - cu[q] * cu[q] * 4.5 + u2) * w;
        let odd = density * (cv[q] + cu[q]) * (3.0 * w) - before.difference[q];
        f.sum[q] = (before.sum[q] * 0.5 + even).mul_add(share, f.sum[q] * keep);
        f.difference[q] = (before.difference[q] * 0.5 + odd).mul_add(share, f.difference[q] * keep);
        f.sum[q] = deep.select((held + held_density * (cv[q] * cv[q] * 4.5 - v2)) * w, f.sum[q]);
        f.difference[q] = deep.select(held_density * cv[q] * (3.0 * w), f.difference[q]);
    }
}

/// B of simulation.md §4.6.
#[inline(always)]
pub(crate) fn solid_share<S: Simd>(s: S, rates: &FlowRates, solid: Lanes<S>) -> Lanes<S> {
    let c = |v: f32| Lanes::<S>::splat(s, v);
    let excess = c(rates.tau - 0.5);
    let filled = solid.min(c(1.0));
    filled * excess / (c(1.0) - filled + excess)
}
