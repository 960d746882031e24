//! Band-limited solid noise.

use megas_math::Vec3;

#[inline(always)]
fn hash(x: i32, y: i32, z: i32) -> u32 {
    let h = (x as u32).wrapping_mul(0x9e37_79b1) ^ (y as u32).wrapping_mul(0x85eb_ca77) ^ (z as u32).wrapping_mul(0xc2b2_ae3d);
    let h = (h ^ (h >> 15)).wrapping_mul(0x2c1b_3c6d);
    let h = (h ^ (h >> 12)).wrapping_mul(0x297a_2d39);
    h ^ (h >> 15)
}

/// Uniform in [0, 1) for a lattice cell.
#[inline(always)]
pub fn cell(x: i32, y: i32, z: i32) -> f32 {
    (hash(x, y, z) >> 8) as f32 * (1.0 / 16_777_216.0)
}

/// Gradient at a lattice point (one of the twelve cube edges) times the offset from it.
#[inline(always)]
fn corner(h: u32, x: f32, y: f32, z: f32) -> f32 {
    let (a, b) = match h % 3 {
        0 => (x, y),
        1 => (y, z),
        _ => (z, x),
    };
    let a = if h & 256 == 0 { a } else { -a };
    let b = if h & 512 == 0 { b } else { -b };
    a + b
}

/// Largest integer not above `v`, without the library call that `f32::floor` is on the oldest instruction sets.
#[inline(always)]
fn floor(v: f32) -> i32 {
    let i = v as i32;
    i - i32::from((i as f32) > v)
}

/// Gradient noise with zero mean, amplitude about ±0.8 and features of size ≈ 1; twice continuously differentiable.
pub fn noise(p: Vec3<f32>) -> f32 {
    let [i, j, k] = p.map(floor);
    let f = [i as f32, j as f32, k as f32];
    let [x, y, z] = [p[0] - f[0], p[1] - f[1], p[2] - f[2]];
    let [u, v, w] = [x, y, z].map(|t| t * t * t * (t * (t * 6.0 - 15.0) + 10.0));
    let c = |a: i32, b: i32, c: i32| corner(hash(i + a, j + b, k + c), x - a as f32, y - b as f32, z - c as f32);
    let mix = |a: f32, b: f32, t: f32| a + (b - a) * t;
    let low = mix(mix(c(0, 0, 0), c(1, 0, 0), u), mix(c(0, 1, 0), c(1, 1, 0), u), v);
    let high = mix(mix(c(0, 0, 1), c(1, 0, 1), u), mix(c(0, 1, 1), c(1, 1, 1), u), v);
    mix(low, high, w)
}

/// `noise` of `p` scaled by `frequency` and shifted to an unrelated place by `seed`.
#[inline(always)]
pub fn noise_at(p: Vec3<f32>, frequency: f32, seed: f32) -> f32 {
    noise([p[0] * frequency + 17.3 * seed, p[1] * frequency - 9.1 * seed, p[2] * frequency + 31.7 * seed])
}

/// Scattered blobs: in about `share` of the cells of size 1 there is a ball of the given radius (≤ 0.3, fits its cell).
/// Returns the depth inside the nearest one in [0, 1] and its own random number.
pub fn specks(p: Vec3<f32>, share: f32, radius: f32) -> (f32, f32) {
    let f = p.map(f32::floor);
    let [i, j, k] = f.map(|v| v as i32);
    let present = cell(i, j, k);
    if present > share {
        return (0.0, 0.0);
    }
    let margin = radius;
    let centre = |salt: i32| margin + (1.0 - 2.0 * margin) * cell(i + 911 * salt, j + 577 * salt, k - 313 * salt);
    let d = [p[0] - f[0] - centre(1), p[1] - f[1] - centre(2), p[2] - f[2] - centre(3)];
    let r = (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).sqrt();
    ((1.0 - r / radius).max(0.0), present / share)
}

/// Smooth step from 0 at `a` to 1 at `b` (`a > b` runs downward).
#[inline(always)]
pub fn smoothstep(a: f32, b: f32, x: f32) -> f32 {
    let t = ((x - a) / (b - a)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}
