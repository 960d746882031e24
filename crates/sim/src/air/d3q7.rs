//! Collision of the temperature: D3Q7, two relaxation times, total enthalpy (simulation.md §4.4). Temperatures are over the
//! reference.

use fearless_simd::{Simd, SimdBase, SimdFloat};
use megas_math::simd::Lanes;

use crate::air::settings::{LatticeSettings, TURBULENT_PRANDTL};

/// Populations of one vector of nodes as sums and differences of the three pairs, and the rest.
#[derive(Clone, Copy)]
pub(crate) struct HeatPairs<S: Simd> {
    pub(crate) rest: Lanes<S>,
    pub(crate) sum: [Lanes<S>; 3],
    pub(crate) difference: [Lanes<S>; 3],
}

/// Constants of the collision.
#[derive(Clone, Copy)]
pub(crate) struct HeatRates {
    pub(crate) k: f32,
    plus: f32,
    minus: f32,
    /// Λ_g, or 0 for a single relaxation time.
    lambda: f32,
    pub(crate) source: f32,
}

impl HeatRates {
    pub(crate) fn new(settings: &LatticeSettings) -> Self {
        let (plus, minus) = settings.heat_rates(settings.diffusivity);
        Self {
            k: settings.diffusivity as f32,
            plus: plus as f32,
            minus: minus as f32,
            lambda: settings.lambda_heat.unwrap_or(0.0) as f32,
            source: settings.source as f32,
        }
    }

    /// (ω⁺, ω⁻) of air.
    #[inline(always)]
    pub(crate) fn plain<S: Simd>(&self, s: S) -> (Lanes<S>, Lanes<S>) {
        (Lanes::<S>::splat(s, self.plus), Lanes::<S>::splat(s, self.minus))
    }

    /// (ω⁺, ω⁻) at conductivity `k`.
    #[inline(always)]
    pub(crate) fn of<S: Simd>(&self, s: S, k: Lanes<S>) -> (Lanes<S>, Lanes<S>) {
        let c = |v: f32| Lanes::<S>::splat(s, v);
        let k4 = k * 4.0;
        let minus = c(1.0) / (k4 + 0.5);
        let plus = if self.lambda > 0.0 { c(1.0) / (c(self.lambda) / k4 + 0.5) } else { minus };
        (plus, minus)
    }

    /// Conductivity of air with the eddies of viscosity `eddy`.
    #[inline(always)]
    pub(crate) fn turbulent<S: Simd>(&self, eddy: Lanes<S>) -> Lanes<S> {
        eddy * (1.0 / TURBULENT_PRANDTL) as f32 + self.k
    }
}

/// Enthalpy H of the nodes.
#[inline(always)]
pub(crate) fn enthalpy<S: Simd>(g: &HeatPairs<S>) -> Lanes<S> {
    g.rest + (g.sum[0] + (g.sum[1] + g.sum[2]))
}

/// Collides; `h` includes half the source, `t` is the temperature and `cu` capacity times velocity.
#[inline(always)]
pub(crate) fn collide<S: Simd>(
    s: S,
    g: &mut HeatPairs<S>,
    rates: (Lanes<S>, Lanes<S>),
    source: f32,
    h: Lanes<S>,
    t: Lanes<S>,
    cu: [Lanes<S>; 3],
) {
    let c = |v: f32| Lanes::<S>::splat(s, v);
    let (plus, minus) = rates;
    let added = (plus * -0.5 + 1.0) * source;
    g.rest = g.rest.mul_add(c(1.0) - plus, plus.mul_add(h - t * 0.75, added * 0.25));
    let even = plus.mul_add(t, added) * 0.125;
    let odd = minus * t * 0.5;
    let (keep_even, keep_odd) = (plus * -0.5 + 0.5, minus * -0.5 + 0.5);
    for q in 0..3 {
        g.sum[q] = g.sum[q].mul_add(keep_even, even);
        g.difference[q] = g.difference[q].mul_add(keep_odd, odd * cu[q]);
    }
}
