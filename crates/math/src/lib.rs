//! Small dense mathematics shared by every stage: 3×3 linear algebra, quaternions, real spherical harmonics,
//! quadratic B-splines, random numbers, and (in [`simd`]) the same things eight or sixteen at a time.
//!
//! Plain arrays are the vocabulary: `[T; 3]` is a column vector, `[[T; 3]; 3]` a matrix stored row by row
//! (`m[row][column]`). Everything here is generic over `f32` and `f64` so that tests can run in double precision.

pub mod bspline;
pub mod half;
pub mod mat3;
pub mod quat;
pub mod rng;
pub mod sh;
pub mod simd;
pub mod svd;
pub mod vec3;

pub use mat3::Mat3;
pub use vec3::Vec3;

/// The scalar types the mathematics runs in: `f32` for production, `f64` for oracles.
pub trait Real: num_traits::Float + num_traits::NumAssign + std::fmt::Debug + Send + Sync + 'static {
    /// Converts a constant; exact for every value that the type can represent.
    fn of(value: f64) -> Self;
    /// Widens to double precision.
    fn f64(self) -> f64;
}

impl Real for f32 {
    fn of(value: f64) -> Self {
        value as f32
    }
    fn f64(self) -> f64 {
        f64::from(self)
    }
}

impl Real for f64 {
    fn of(value: f64) -> Self {
        value
    }
    fn f64(self) -> f64 {
        self
    }
}
