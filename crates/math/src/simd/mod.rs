//! Lanes: the mathematics of the hot loops, eight or sixteen values at a time, generic over the instruction set that
//! `fearless_simd` picks at run time.
//!
//! Every function takes the instruction-set token `s` first and works on [`Lanes`], the native width of `f32`. All are
//! `#[inline(always)]`: call them from inside `dispatch!` or `vectorize`. Lanes never influence each other, so a result
//! does not depend on how values are grouped.

pub mod elementary;
pub mod symmetric;
pub mod transpose;

use fearless_simd::Simd;

/// `f32` lanes of native width.
pub type Lanes<S> = <S as Simd>::f32s;
/// A symmetric 3×3 matrix per lane, `[xx, yy, zz, xy, xz, yz]`.
pub type Sym3<S> = [Lanes<S>; 6];
/// A 3×3 matrix per lane, `m[row][column]`.
pub type Mat3s<S> = [[Lanes<S>; 3]; 3];
