//! Number formats of stored populations: `f32`, or half precision with a scale.
//!
//! The collision is always done in `f32`. A half holds 11 significant bits between 2⁻¹⁴ and 2¹⁶, so what is stored is the
//! deviation from rest times a power of two, which costs nothing and loses nothing: rounding errors then stay relative to the
//! deviation down to the scale of interest (Lehmann et al. 2022, Phys. Rev. E 106, 015308).
//!
//! Temperature populations that rest are kept in `f32` all the same, and take up what rounding takes from the six that move. So heat
//! is conserved as in single precision, and a heat that is smaller per step than the last digit of what it is added to arrives.

use bytemuck::TransparentWrapper;
use fearless_simd::{Simd, SimdBase};
use megas_math::simd::{self, Lanes};
use serde::{Deserialize, Serialize};

/// How populations are stored.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Storage {
    /// Single precision.
    #[default]
    F32,
    /// Half precision: half the memory, errors of up to 2⁻¹¹ of the deviation from rest per step. Heat through faces with a
    /// [`crate::air::HeatFace::Flux`] is lost where it is smaller than that.
    F16,
}

/// Power of two that scales flow populations: deviations below 2 in magnitude fit, and those above 2⁻²⁹ keep all digits.
pub(crate) const FLOW_EXPONENT: i32 = 15;
/// The same for the temperature \[K\]: heat up to 16 376 K per node fits, and what is above 2⁻¹⁶ K keeps all digits.
pub(crate) const HEAT_EXPONENT: i32 = 2;

/// A format. `VALUE · SCALE` is stored; the caller of [`Format::load`] and [`Format::store`] scales.
pub(crate) trait Format: Copy + Default + Send + Sync {
    const SCALE: f32;
    /// The format holds every `f32`.
    const EXACT: bool;

    /// The `LEN` stored numbers from `a[n]` on, times [`Format::SCALE`].
    fn load<S: Simd>(s: S, a: &[Self], n: usize) -> Lanes<S>;
    /// Stores lanes that are scaled already; returns what is stored.
    fn store<S: Simd>(s: S, v: Lanes<S>, a: &mut [Self], n: usize) -> Lanes<S>;
    /// The population.
    fn get(self) -> f32;
    /// The nearest number of the format.
    fn put(value: f32) -> Self;
}

impl Format for f32 {
    const SCALE: f32 = 1.0;
    const EXACT: bool = true;

    #[inline(always)]
    fn load<S: Simd>(s: S, a: &[Self], n: usize) -> Lanes<S> {
        Lanes::<S>::from_slice(s, &a[n..n + Lanes::<S>::LEN])
    }

    #[inline(always)]
    fn store<S: Simd>(_: S, v: Lanes<S>, a: &mut [Self], n: usize) -> Lanes<S> {
        v.store_slice(&mut a[n..n + Lanes::<S>::LEN]);
        v
    }

    #[inline(always)]
    fn get(self) -> f32 {
        self
    }

    #[inline(always)]
    fn put(value: f32) -> Self {
        value
    }
}

/// A population times 2^`EXPONENT` in half precision.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, TransparentWrapper)]
#[repr(transparent)]
pub(crate) struct Half<const EXPONENT: i32>(u16);

const fn power(exponent: i32) -> f32 {
    f32::from_bits(((127 + exponent) as u32) << 23)
}

impl<const EXPONENT: i32> Format for Half<EXPONENT> {
    const SCALE: f32 = power(EXPONENT);
    const EXACT: bool = false;

    #[inline(always)]
    fn load<S: Simd>(s: S, a: &[Self], n: usize) -> Lanes<S> {
        simd::half::load(s, Self::peel_slice(&a[n..n + Lanes::<S>::LEN]))
    }

    #[inline(always)]
    fn store<S: Simd>(s: S, v: Lanes<S>, a: &mut [Self], n: usize) -> Lanes<S> {
        simd::half::store(v, s, Self::peel_slice_mut(&mut a[n..n + Lanes::<S>::LEN]))
    }

    #[inline(always)]
    fn get(self) -> f32 {
        megas_math::half::to_f32(self.0) * power(-EXPONENT)
    }

    #[inline(always)]
    fn put(value: f32) -> Self {
        Self(megas_math::half::from_f32(value * Self::SCALE))
    }
}

/// All populations of a lattice; empty where it does without flow or temperature.
#[derive(Clone, Debug)]
pub(crate) enum Populations {
    Single { f: Vec<f32>, g: Vec<f32> },
    Half { f: Vec<Half<FLOW_EXPONENT>>, g: Vec<Half<HEAT_EXPONENT>> },
}

/// Runs the same code on the two arrays of [`Populations`], whatever their format.
macro_rules! with_populations {
    ($populations:expr, |$f:ident, $g:ident| $body:expr) => {
        match $populations {
            crate::air::population::Populations::Single { f: $f, g: $g } => $body,
            crate::air::population::Populations::Half { f: $f, g: $g } => $body,
        }
    };
}
pub(crate) use with_populations;

impl Populations {
    /// All at rest at the reference temperature.
    pub(crate) fn new(storage: Storage, flow: usize, heat: usize) -> Self {
        match storage {
            Storage::F32 => Self::Single { f: vec![0.0; flow], g: vec![0.0; heat] },
            Storage::F16 => Self::Half { f: vec![Half::default(); flow], g: vec![Half::default(); heat] },
        }
    }

    /// Flow population in a slot.
    pub(crate) fn flow(&self, slot: usize) -> f32 {
        with_populations!(self, |f, _g| f[slot].get())
    }

    /// Temperature population in a slot.
    pub(crate) fn heat(&self, slot: usize) -> f32 {
        with_populations!(self, |_f, g| g[slot].get())
    }

    /// Stores a flow population.
    pub(crate) fn set_flow(&mut self, slot: usize, value: f32) {
        with_populations!(self, |f, _g| f[slot] = Format::put(value));
    }

    /// Stores a temperature population.
    pub(crate) fn set_heat(&mut self, slot: usize, value: f32) {
        with_populations!(self, |_f, g| g[slot] = Format::put(value));
    }
}
