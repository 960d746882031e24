//! Stress and return map of every law in lanes (simulation.md §5.1, §5.2), one file per law.
//!
//! A group of lanes nearly always holds one material, because points are sorted by cell: each law is a branch that such a group
//! takes once. Where objects touch, a group evaluates every law it holds and keeps each lane's own.

mod drucker_prager;
mod fixed_corotated;
mod fluid;
mod hencky;
mod herschel_bulkley;
mod neo_hookean;
mod strain;
mod von_mises;

use fearless_simd::{Simd, SimdBase, SimdMask};
use megas_math::Mat3;
use megas_math::simd::{Lanes, Mat3s, Sym3};

use crate::particles::{DRUCKER_PRAGER, FIXED_COROTATED, FLUID, HENCKY, NEO_HOOKEAN, NEO_HOOKEAN_SPLIT, VON_MISES};
use crate::reference::{Law, State};
pub(crate) use fluid::advance as advance_fluid;
pub(crate) use strain::left_strain;
use strain::{Spectral, volume_change};

/// A mask over `f32` lanes.
pub(crate) type Mask<S> = <S as Simd>::mask32s;

/// Laws that work with Hencky strain.
const LOGARITHMIC: u32 = 1 << HENCKY | 1 << VON_MISES | 1 << DRUCKER_PRAGER;
/// Both forms of neo-Hookean elasticity.
const RUBBER: u32 = 1 << NEO_HOOKEAN | 1 << NEO_HOOKEAN_SPLIT;

/// Which laws a group of lanes follows.
#[derive(Clone, Copy)]
pub(crate) struct Laws<'a> {
    tags: &'a [u8],
    /// Bit per law that occurs.
    has: u32,
}

impl<'a> Laws<'a> {
    /// The laws of up to `LEN` lanes; lanes past the end follow the first one's.
    #[inline(always)]
    pub fn new(tags: &'a [u8]) -> Self {
        let first = tags[0];
        let has = if tags.iter().all(|&l| l == first) { 1 << first } else { tags.iter().fold(0, |m, &l| m | 1 << l) };
        Self { tags, has }
    }

    /// True where some lane follows this law.
    #[inline(always)]
    pub fn any(&self, law: u8) -> bool {
        self.any_of(1 << law)
    }

    /// True where some lane follows another law.
    #[inline(always)]
    pub fn any_but(&self, law: u8) -> bool {
        self.any_of(!(1 << law))
    }

    #[inline(always)]
    fn any_of(&self, set: u32) -> bool {
        self.has & set != 0
    }

    /// Lanes that follow `law`.
    #[inline(always)]
    pub fn lanes<S: Simd>(&self, s: S, law: u8) -> Mask<S> {
        self.lanes_of(s, 1 << law)
    }

    #[inline(always)]
    fn lanes_of<S: Simd>(&self, s: S, set: u32) -> Mask<S> {
        if !self.any_of(set) || !self.any_of(!set) {
            return Mask::<S>::splat(s, self.any_of(set));
        }
        let bits = self.tags.iter().enumerate().fold(0u64, |m, (i, &l)| m | (u64::from(set >> l & 1) << i));
        Mask::<S>::from_bitmask(s, bits)
    }
}

/// Parameters and history per lane; units as in [`crate::particles::Particles`].
pub(crate) struct Parameters<S: Simd> {
    pub shear: Lanes<S>,
    pub bulk: Lanes<S>,
    pub yield_stress: Lanes<S>,
    pub viscosity: Lanes<S>,
    pub exponent: Lanes<S>,
    /// The law's own constant.
    pub constant: Lanes<S>,
    /// Accumulated plastic strain before the step.
    pub plastic: Lanes<S>,
    /// Volume gain of sand before the step.
    pub gain: Lanes<S>,
}

/// What a deformation gradient answers.
pub(crate) struct Response<S: Simd> {
    /// Kirchhoff stress τ \[Pa\].
    pub stress: Sym3<S>,
    /// `F − I` after the return map.
    pub elastic: Mat3s<S>,
    /// Increment of plastic strain.
    pub plastic: Lanes<S>,
    /// Volume gain of sand after the step.
    pub gain: Lanes<S>,
    /// Volume ratio J.
    pub volume: Lanes<S>,
    /// Lanes whose gradient is degenerate and must be replaced; their stress is meaningless.
    pub degenerate: Mask<S>,
}

/// The step of time of a return map.
#[derive(Clone, Copy)]
pub(crate) struct Flow {
    /// Its length \[s\].
    pub dt: f32,
    /// Yue's μ̂ = μ tr(b)/3 in place of μ.
    pub yue: bool,
}

/// Stress of `F = I + H` (of J alone for a fluid), after the plastic flow of one step where that is given. `rate` is the velocity
/// gradient \[1/s\], which only fluids ask for.
#[inline(always)]
pub(crate) fn respond<S: Simd>(s: S, h: Mat3s<S>, rate: &Mat3s<S>, law: &Parameters<S>, laws: &Laws, flow: Option<Flow>) -> Response<S> {
    let zero = Lanes::<S>::splat(s, 0.0);
    let mut out = Response {
        stress: [zero; 6],
        elastic: h,
        plastic: zero,
        gain: law.gain,
        volume: h[0][0] + 1.0,
        degenerate: Mask::<S>::splat(s, false),
    };
    if laws.any_but(FLUID) {
        let strain = left_strain::<S>(&h);
        let change = volume_change::<S>(&h);
        out.volume = change + 1.0;
        if laws.any_of(LOGARITHMIC | 1 << FIXED_COROTATED) {
            let corotated = laws.lanes(s, FIXED_COROTATED);
            let wanted = laws.lanes_of(s, LOGARITHMIC | 1 << FIXED_COROTATED);
            let spectral = Spectral::new(s, &strain, out.volume, wanted, corotated);
            out.degenerate = spectral.degenerate;
            if laws.any_of(LOGARITHMIC) {
                hencky::respond(s, &h, &spectral, change, law, laws, flow, &mut out);
            }
            if laws.any(FIXED_COROTATED) {
                fixed_corotated::respond(s, &spectral, change, law, corotated, &mut out);
            }
        }
        if laws.any_of(RUBBER) {
            neo_hookean::respond(s, &strain, change, law, laws, &mut out);
        }
    }
    if laws.any(FLUID) {
        fluid::respond(s, &h, rate, law, laws.lanes(s, FLUID), &mut out);
    }
    out
}

/// The production law at one point, for tests and diagnostics: `F − I` after the return map of a step of `dt` seconds, and the
/// Kirchhoff stress \[Pa\]. The gradient must not be degenerate.
pub fn material_point(law: &Law<f32>, h: Mat3<f32>, dt: f32) -> (Mat3<f32>, Mat3<f32>) {
    material_point_with(law, h, [[0.0; 3]; 3], dt, &mut State::default())
}

/// [`material_point`] with a velocity gradient `rate` \[1/s\] and a history, which is updated.
pub fn material_point_with(law: &Law<f32>, h: Mat3<f32>, rate: Mat3<f32>, dt: f32, state: &mut State<f32>) -> (Mat3<f32>, Mat3<f32>) {
    fearless_simd::dispatch!(fearless_simd::Level::new(), s => one(s, law, h, rate, dt, state))
}

#[inline(always)]
fn one<S: Simd>(s: S, law: &Law<f32>, h: Mat3<f32>, rate: Mat3<f32>, dt: f32, state: &mut State<f32>) -> (Mat3<f32>, Mat3<f32>) {
    let c = |v| Lanes::<S>::splat(s, v);
    let parameters = Parameters {
        shear: c(law.shear),
        bulk: c(law.bulk),
        yield_stress: c(law.yield_stress),
        viscosity: c(law.viscosity),
        exponent: c(law.exponent),
        constant: c(law.constant),
        plastic: c(state.plastic),
        gain: c(state.gain),
    };
    let laws = Laws::new(std::slice::from_ref(&law.law));
    let flow = Flow { dt, yue: false };
    let r = respond(s, h.map(|row| row.map(c)), &rate.map(|row| row.map(c)), &parameters, &laws, Some(flow));
    state.plastic += r.plastic[0];
    state.gain = r.gain[0];
    let t = r.stress.map(|v| v[0]);
    (r.elastic.map(|row| row.map(|v| v[0])), [[t[0], t[3], t[4]], [t[3], t[1], t[5]], [t[4], t[5], t[2]]])
}

#[cfg(test)]
mod tests;
