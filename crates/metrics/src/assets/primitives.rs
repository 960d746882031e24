//! Signed distances of simple bodies and their smooth combinations (polynomial blends).

use megas_math::{Vec3, vec3};

/// Minimum with a fillet of size `k`.
#[inline(always)]
pub fn smin(a: f32, b: f32, k: f32) -> f32 {
    let h = (k - (a - b).abs()).max(0.0) / k;
    a.min(b) - h * h * k * 0.25
}

/// Maximum with a rounding of size `k`.
#[inline(always)]
pub fn smax(a: f32, b: f32, k: f32) -> f32 {
    -smin(-a, -b, k)
}

/// Round cone along a segment: radius `ra` at `a`, `rb` at `b` (linear between; exact for equal radii).
#[derive(Clone, Copy, Debug)]
pub struct RoundCone {
    a: Vec3<f32>,
    ba: Vec3<f32>,
    inv_len2: f32,
    ra: f32,
    rb: f32,
}

impl RoundCone {
    /// From the end points and their radii.
    pub fn new(a: Vec3<f32>, b: Vec3<f32>, ra: f32, rb: f32) -> Self {
        let ba = vec3::sub(b, a);
        Self { a, ba, inv_len2: 1.0 / vec3::dot(ba, ba).max(1e-12), ra, rb }
    }

    /// Signed distance.
    #[inline(always)]
    pub fn sdf(&self, x: Vec3<f32>) -> f32 {
        let pa = vec3::sub(x, self.a);
        let h = (vec3::dot(pa, self.ba) * self.inv_len2).clamp(0.0, 1.0);
        vec3::norm(vec3::add_scaled(pa, self.ba, -h)) - (self.ra + (self.rb - self.ra) * h)
    }
}

/// Upright cylinder of radius `r` between `z0` and `z1` with edges rounded by `round`, centred on the z axis.
#[inline(always)]
pub fn disc(x: Vec3<f32>, r: f32, z0: f32, z1: f32, round: f32) -> f32 {
    let q = (x[0] * x[0] + x[1] * x[1]).sqrt() - (r - round);
    let p = (x[2] - 0.5 * (z0 + z1)).abs() - (0.5 * (z1 - z0) - round);
    let outside = (q.max(0.0) * q.max(0.0) + p.max(0.0) * p.max(0.0)).sqrt();
    outside + q.max(p).min(0.0) - round
}

/// Ball.
#[inline(always)]
pub fn ball(x: Vec3<f32>, centre: Vec3<f32>, r: f32) -> f32 {
    vec3::norm(vec3::sub(x, centre)) - r
}
