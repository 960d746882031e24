//! One plane of one step: populations in, collision, populations out (simulation.md §4.3, §4.4, §4.6).
//!
//! A sum of a pair is even and a difference odd under exchange of the two directions, so odd and even steps of the AA pattern
//! differ in one exact factor of ±1.

use fearless_simd::{Select, Simd, SimdBase, SimdFloat, SimdMask};
use megas_math::simd::{Lanes, each3};

use crate::air::d3q7::{self, HeatPairs, HeatRates};
use crate::air::d3q19::{self, FlowRates, Pairs};
use crate::air::population::Format;
use crate::air::settings::SPEED_CAP;
use crate::air::storage::{CHUNK, Layout};

/// Some node of the chunk holds a solid.
pub(crate) const SOLID: u8 = 1;
/// Some node of the chunk has no temperature populations.
pub(crate) const HOLES: u8 = 2;
/// Some node of the chunk lies in a sponge.
pub(crate) const SPONGE: u8 = 4;
/// Somebody needs the temperature and the velocity of the chunk.
pub(crate) const WRITE: u8 = 8;

/// What all planes share.
pub(crate) struct Context<'a> {
    pub(crate) layout: &'a Layout,
    pub(crate) flow: FlowRates,
    pub(crate) heat: HeatRates,
    pub(crate) force: [f32; 3],
    pub(crate) buoyancy: [f32; 3],
    pub(crate) limit: f32,
    pub(crate) wind: [f32; 3],
    /// Without flow: take the velocity from the node arrays instead of `wind`.
    pub(crate) carried: bool,
    /// Without temperature: buoyancy by the temperatures in the node arrays.
    pub(crate) warmed: bool,
    /// +1 in even steps, −1 in odd ones.
    pub(crate) sign: f32,
    pub(crate) reach: [isize; 19],
    /// Write temperature and velocity of every node.
    pub(crate) write_all: bool,
}

/// Arrays of one plane; empty where a lattice does without.
pub(crate) struct Plane<'a, F, G> {
    pub(crate) f: [&'a mut [F]; 19],
    pub(crate) g: [&'a mut [G]; 7],
    /// Resting temperature populations where the format of the others is too coarse for them; empty otherwise.
    pub(crate) rest: &'a mut [f32],
    pub(crate) t: &'a mut [f32],
    pub(crate) u: [&'a mut [f32]; 3],
    pub(crate) solid: &'a [f32],
    pub(crate) solid_velocity: [&'a [f32]; 3],
    pub(crate) sponge: &'a [f32],
    /// 1 where temperature populations live, 0 elsewhere.
    pub(crate) memory: &'a [f32],
    /// Capacity and conductivity per node; empty where all is air.
    pub(crate) capacity: &'a [f32],
    pub(crate) conductivity: &'a [f32],
    pub(crate) class: &'a [u8],
}

/// What a step saw (simulation.md §4.8).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Seen {
    /// Largest |u|² of any node before the cap.
    pub speed2: f32,
    /// Density, smallest and largest.
    pub density: [f32; 2],
    /// Temperature over the reference, smallest and largest.
    pub temperature: [f32; 2],
    /// Nodes whose speed was capped.
    pub capped: u32,
    /// Heat the sponges brought in \[K · nodes\].
    pub sponge: f64,
}

impl Seen {
    /// Nothing seen.
    pub const NOTHING: Self = Self {
        speed2: 0.0,
        density: [f32::INFINITY, f32::NEG_INFINITY],
        temperature: [f32::INFINITY, f32::NEG_INFINITY],
        capped: 0,
        sponge: 0.0,
    };

    /// Both together.
    pub fn merge(self, o: Self) -> Self {
        Self {
            speed2: self.speed2.max(o.speed2),
            density: [self.density[0].min(o.density[0]), self.density[1].max(o.density[1])],
            temperature: [self.temperature[0].min(o.temperature[0]), self.temperature[1].max(o.temperature[1])],
            capped: self.capped + o.capped,
            sponge: self.sponge + o.sponge,
        }
    }
}

/// [`Seen`] per lane.
struct Watch<S: Simd> {
    speed2: Lanes<S>,
    density: [Lanes<S>; 2],
    temperature: [Lanes<S>; 2],
    capped: Lanes<S>,
    sponge: Lanes<S>,
}

impl<S: Simd> Watch<S> {
    #[inline(always)]
    fn new(s: S) -> Self {
        let c = |v: f32| Lanes::<S>::splat(s, v);
        Self {
            speed2: c(0.0),
            density: [c(f32::INFINITY), c(f32::NEG_INFINITY)],
            temperature: [c(f32::INFINITY), c(f32::NEG_INFINITY)],
            capped: c(0.0),
            sponge: c(0.0),
        }
    }

    #[inline(always)]
    fn finish(self) -> Seen {
        let all = |v: &Lanes<S>, f: fn(f32, f32) -> f32, start: f32| v.as_slice().iter().fold(start, |a, b| f(a, *b));
        Seen {
            speed2: all(&self.speed2, f32::max, 0.0),
            density: [1.0 + all(&self.density[0], f32::min, f32::INFINITY), 1.0 + all(&self.density[1], f32::max, f32::NEG_INFINITY)],
            temperature: [all(&self.temperature[0], f32::min, f32::INFINITY), all(&self.temperature[1], f32::max, f32::NEG_INFINITY)],
            capped: all(&self.capped, |a, b| a + b, 0.0) as u32,
            sponge: self.sponge.as_slice().iter().map(|v| f64::from(*v)).sum(),
        }
    }
}

/// Advances every node of a plane.
#[inline(always)]
pub(crate) fn sweep<S: Simd, F: Format, G: Format, const FLOW: bool, const HEAT: bool>(s: S, cx: &Context, p: &mut Plane<F, G>) -> Seen {
    let lanes = Lanes::<S>::LEN;
    let [_, ny, nz] = cx.layout.nodes;
    let chunks = cx.layout.chunks();
    let mut watch = Watch::new(s);
    for j in 0..ny {
        let row = cx.layout.row(j as isize);
        for (chunk, &class) in p.class[j * chunks..(j + 1) * chunks].iter().enumerate() {
            let mut k = chunk * CHUNK;
            let end = (k + CHUNK).min(nz);
            let plain = class == 0 && !cx.write_all && p.capacity.is_empty();
            while k < end {
                let valid = (nz - k).min(lanes);
                if plain && valid == lanes {
                    vector::<S, F, G, FLOW, HEAT, false>(s, cx, p, row + k, valid, class, &mut watch);
                } else {
                    vector::<S, F, G, FLOW, HEAT, true>(s, cx, p, row + k, valid, class, &mut watch);
                }
                k += lanes;
            }
        }
    }
    watch.finish()
}

#[inline(always)]
fn load<S: Simd>(s: S, a: &[f32], n: usize) -> Lanes<S> {
    Lanes::<S>::from_slice(s, &a[n..n + Lanes::<S>::LEN])
}

#[inline(always)]
fn store<S: Simd>(v: Lanes<S>, a: &mut [f32], n: usize) {
    v.store_slice(&mut a[n..n + Lanes::<S>::LEN]);
}

/// Advances one vector of nodes. Without `GENERAL` it is pure air away from everything.
#[inline(always)]
fn vector<S: Simd, F: Format, G: Format, const FLOW: bool, const HEAT: bool, const GENERAL: bool>(
    s: S,
    cx: &Context,
    p: &mut Plane<F, G>,
    n: usize,
    valid: usize,
    class: u8,
    watch: &mut Watch<S>,
) {
    let c = |v: f32| Lanes::<S>::splat(s, v);
    let (zero, one) = (c(0.0), c(1.0));
    let at = |q: usize| (n as isize + cx.reach[q]) as usize;
    // What the watch counts: nodes of the box that are air.
    let mut counts = one;
    if GENERAL && valid < Lanes::<S>::LEN {
        counts = Lanes::<S>::from_fn(s, |i| if i < valid { 1.0 } else { 0.0 });
    }
    let sponge = if GENERAL && class & SPONGE != 0 { load(s, p.sponge, n) } else { zero };
    let memory = if GENERAL && HEAT && class & HOLES != 0 { load(s, p.memory, n) } else { one };

    let mut g = HeatPairs { rest: zero, sum: [zero; 3], difference: [zero; 3] };
    let (mut h, mut t, mut capacity) = (zero, zero, one);
    if HEAT {
        g.rest = if G::EXACT { G::load(s, p.g[0], n) } else { load(s, p.rest, n) };
        for q in 0..3 {
            let (a, b) = (G::load(s, p.g[2 * q + 1], at(2 * q + 1)), G::load(s, p.g[2 * q + 2], at(2 * q + 2)));
            g.sum[q] = (a + b) * (1.0 / G::SCALE);
            g.difference[q] = (a - b) * (cx.sign * (1.0 / G::SCALE));
        }
        h = d3q7::enthalpy(&g) + 0.5 * cx.heat.source;
        t = h;
        if GENERAL && !p.capacity.is_empty() {
            capacity = load(s, p.capacity, n);
            t = h / capacity;
        }
        if GENERAL && class & SPONGE != 0 {
            let change = sponge * t * -1.0 * memory;
            g.rest = change.mul_add(c(0.25), g.rest);
            for q in 0..3 {
                g.sum[q] = change.mul_add(c(0.25), g.sum[q]);
            }
            (h, t) = (h + change, t + change);
            watch.sponge = change.mul_add(counts, watch.sponge);
        }
        if GENERAL && class & HOLES != 0 {
            t = memory.simd_gt(zero).select(t, load(s, p.t, n));
        }
    } else if cx.warmed {
        t = load(s, p.t, n);
    }

    let mut u = each3(|a| c(cx.wind[a]));
    let (mut eddy, mut mass) = (zero, one);
    if FLOW {
        let mut f = Pairs { rest: F::load(s, p.f[0], n) * (1.0 / F::SCALE), sum: [zero; 9], difference: [zero; 9] };
        for q in 0..9 {
            let (a, b) = (F::load(s, p.f[2 * q + 1], at(2 * q + 1)), F::load(s, p.f[2 * q + 2], at(2 * q + 2)));
            f.sum[q] = (a + b) * (1.0 / F::SCALE);
            f.difference[q] = (a - b) * (cx.sign * (1.0 / F::SCALE));
        }
        let (rho, m) = d3q19::moments(&f);
        let mut force = each3(|a| c(cx.force[a]));
        if HEAT || cx.warmed {
            let warm = t.max(c(-cx.limit)).min(c(cx.limit));
            force = each3(|a| warm.mul_add(c(cx.buoyancy[a]), force[a]));
        }
        let solid = if GENERAL && class & SOLID != 0 { load(s, p.solid, n) } else { zero };
        let share = d3q19::solid_share(s, &cx.flow, solid);
        if GENERAL && class & SOLID != 0 {
            force = each3(|a| force[a] * (one - share));
        }
        let m = each3(|a| force[a].mul_add(c(0.5), m[a]));
        let (velocity, density, speed2) = d3q19::velocity(s, rho, m);
        (u, mass) = (velocity, density);
        if GENERAL && class & SPONGE != 0 {
            let change = each3(|a| sponge * u[a] * -1.0);
            let step = d3q19::along::<S>(each3(|a| change[a] * density));
            for q in 0..9 {
                let w = if q < 3 { 1.0 / 3.0 } else { 1.0 / 6.0 };
                f.difference[q] = step[q].mul_add(c(w), f.difference[q]);
            }
            u = each3(|a| u[a] + change[a]);
        }
        let before = f;
        eddy = d3q19::collide(s, &mut f, &cx.flow, rho, density, u, force);
        if GENERAL && class & SOLID != 0 {
            let v = each3(|a| load(s, p.solid_velocity[a], n));
            d3q19::saturate(s, &before, &mut f, solid, share, rho, density, u, v);
            counts = solid.simd_gt(c(0.5)).select(zero, counts);
        }
        F::store(s, f.rest * F::SCALE, p.f[0], n);
        for q in 0..9 {
            let (even, turned) = (f.sum[q] * F::SCALE, f.difference[q] * (cx.sign * F::SCALE));
            F::store(s, even - turned, p.f[2 * q + 1], at(2 * q + 1));
            F::store(s, even + turned, p.f[2 * q + 2], at(2 * q + 2));
        }
        let (mut speed2, mut low, mut high) = (speed2, rho, rho);
        if GENERAL {
            let open = counts.simd_gt(zero);
            (speed2, low, high) = (open.select(speed2, zero), open.select(rho, zero), open.select(rho, zero));
        }
        let fast = speed2.simd_gt(c(SPEED_CAP as f32 * SPEED_CAP as f32));
        if fast.any_true() {
            watch.capped += fast.select(one, zero);
        }
        watch.speed2 = watch.speed2.max(speed2);
        watch.density = [watch.density[0].min(low), watch.density[1].max(high)];
    } else if cx.carried {
        u = each3(|a| load(s, p.u[a], n));
    }

    if HEAT {
        // The flow of mass: u itself has sources, air is compressed by 3U², and would heat up where it is pressed together.
        let mass = mass * capacity * memory;
        let carried = each3(|a| u[a] * mass);
        let rates = if GENERAL && !p.conductivity.is_empty() {
            cx.heat.of(s, load(s, p.conductivity, n))
        } else if cx.flow.has_eddies() {
            cx.heat.of(s, cx.heat.turbulent::<S>(eddy))
        } else {
            cx.heat.plain(s)
        };
        d3q7::collide(s, &mut g, rates, cx.heat.source, h, t, carried);
        if GENERAL && class & HOLES != 0 {
            g.rest *= memory;
            g.sum = each3(|q| g.sum[q] * memory);
            g.difference = each3(|q| g.difference[q] * memory);
            counts *= memory;
        }
        let mut lost = zero;
        for q in 0..3 {
            let (even, turned) = (g.sum[q] * G::SCALE, g.difference[q] * (cx.sign * G::SCALE));
            let a = G::store(s, even - turned, p.g[2 * q + 1], at(2 * q + 1));
            let b = G::store(s, even + turned, p.g[2 * q + 2], at(2 * q + 2));
            if !G::EXACT {
                // Twice the sum of the pair, less what is stored of it.
                lost += even * 2.0 - (a + b);
            }
        }
        if G::EXACT {
            G::store(s, g.rest, p.g[0], n);
        } else {
            // What rounding takes from those that move stays at rest: no heat is lost, however little arrives per step.
            store::<S>(lost.mul_add(c(1.0 / G::SCALE), g.rest), p.rest, n);
        }
        let (mut low, mut high) = (t, t);
        if GENERAL {
            let open = counts.simd_gt(zero);
            (low, high) = (open.select(t, c(f32::INFINITY)), open.select(t, c(f32::NEG_INFINITY)));
        }
        watch.temperature = [watch.temperature[0].min(low), watch.temperature[1].max(high)];
    }
    if GENERAL && (class & WRITE != 0 || cx.write_all) {
        if HEAT {
            store::<S>(t, p.t, n);
        }
        if FLOW {
            for a in 0..3 {
                store::<S>(u[a], p.u[a], n);
            }
        }
    }
}
