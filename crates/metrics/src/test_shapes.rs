//! Shapes that several tests look at.

use megas_model::Mesh;

/// A ball of radius 1 of `n` rings of `2n` quads, outward.
pub(crate) fn ball(n: usize) -> Mesh {
    let mut m = Mesh::default();
    for i in 0..=n {
        for k in 0..2 * n {
            let (z, r) = (std::f64::consts::PI * (i as f64 / n as f64 - 0.5)).sin_cos();
            let (s, c) = (std::f64::consts::PI * k as f64 / n as f64).sin_cos();
            m.positions.push([(r * c) as f32, (r * s) as f32, z as f32]);
        }
    }
    for i in 0..n {
        for k in 0..2 * n {
            let at = |i: usize, k: usize| (i * 2 * n + k % (2 * n)) as u32;
            m.triangles.push([at(i, k), at(i, k + 1), at(i + 1, k + 1)]);
            m.triangles.push([at(i, k), at(i + 1, k + 1), at(i + 1, k)]);
        }
    }
    m
}
