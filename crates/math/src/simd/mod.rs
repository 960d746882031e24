//! Lanes: the mathematics of the hot loops, eight or sixteen values at a time, generic over the instruction set that
//! `fearless_simd` picks at run time.
//!
//! Every function takes the instruction-set token `s` first and works on [`Lanes`], the native width of `f32`. All are
//! `#[inline(always)]`: call them from inside `dispatch!` or `vectorize`. Lanes never influence each other, so a result
//! does not depend on how values are grouped.

pub mod elementary;
pub mod half;
pub mod symmetric;
pub mod transpose;

use fearless_simd::Simd;

/// `f32` lanes of native width.
pub type Lanes<S> = <S as Simd>::f32s;
/// A symmetric 3×3 matrix per lane, `[xx, yy, zz, xy, xz, yz]`.
pub type Sym3<S> = [Lanes<S>; 6];
/// A 3×3 matrix per lane, `m[row][column]`.
pub type Mat3s<S> = [[Lanes<S>; 3]; 3];

/// `[f(0), f(1), f(2)]`. The array functions of the standard library are not always inlined, and vector code that is not
/// inlined loses its instruction set; this and the two below always are.
#[inline(always)]
pub fn each3<T>(f: impl Fn(usize) -> T) -> [T; 3] {
    [f(0), f(1), f(2)]
}

/// `[f(0), …, f(5)]`.
#[inline(always)]
pub fn each6<T>(f: impl Fn(usize) -> T) -> [T; 6] {
    [f(0), f(1), f(2), f(3), f(4), f(5)]
}

/// The matrix of `f(row, column)`.
#[inline(always)]
pub fn each9<T>(f: impl Fn(usize, usize) -> T) -> [[T; 3]; 3] {
    [[f(0, 0), f(0, 1), f(0, 2)], [f(1, 0), f(1, 1), f(1, 2)], [f(2, 0), f(2, 1), f(2, 2)]]
}
