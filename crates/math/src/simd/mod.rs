//! Lanes: the mathematics of the hot loops, eight or sixteen values at a time, generic over the instruction set that
//! `fearless_simd` picks at run time.
