//! The velocity sets D3Q19 and D3Q7 (simulation.md §4.1).
//!
//! Direction 0 is rest; 2q + 1 and 2q + 2 are opposite and form pair q. The first three pairs are the axes in both sets.

/// Directions of the flow.
pub(crate) const Q19: usize = 19;
/// Directions of the temperature.
pub(crate) const Q7: usize = 7;

/// First direction of each pair of D3Q19.
pub(crate) const PAIRS: [[i32; 3]; 9] =
    [[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 0], [1, -1, 0], [1, 0, 1], [1, 0, -1], [0, 1, 1], [0, 1, -1]];

/// Velocities of D3Q19; the first seven are those of D3Q7.
pub(crate) const C: [[i32; 3]; Q19] = {
    let mut c = [[0; 3]; Q19];
    let mut q = 0;
    while q < 9 {
        let p = PAIRS[q];
        c[2 * q + 1] = p;
        c[2 * q + 2] = [-p[0], -p[1], -p[2]];
        q += 1;
    }
    c
};

/// Weights of D3Q19, cs² = 1/3.
pub(crate) const W19: [f64; Q19] = {
    let mut w = [1.0 / 36.0; Q19];
    w[0] = 1.0 / 3.0;
    let mut k = 1;
    while k < 7 {
        w[k] = 1.0 / 18.0;
        k += 1;
    }
    w
};

/// Weights of D3Q7, cs² = 1/4.
pub(crate) const W7: [f64; Q7] = [0.25, 0.125, 0.125, 0.125, 0.125, 0.125, 0.125];

/// The opposite direction.
#[inline(always)]
pub(crate) const fn opposite(k: usize) -> usize {
    if k == 0 { 0 } else { ((k - 1) ^ 1) + 1 }
}

/// The direction with velocity `c`, if the set has it.
pub(crate) fn direction(c: [i32; 3]) -> Option<usize> {
    C.iter().position(|v| *v == c)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn moments_of_the_weights_are_isotropic() {
        for (w, q, cs2) in [(&W19[..], Q19, 1.0 / 3.0), (&W7[..], Q7, 0.25)] {
            assert!((w.iter().sum::<f64>() - 1.0).abs() < 1e-15);
            for a in 0..3 {
                for b in 0..3 {
                    let m: f64 = (0..q).map(|k| w[k] * f64::from(C[k][a] * C[k][b])).sum();
                    let expected = if a == b { cs2 } else { 0.0 };
                    assert!((m - expected).abs() < 1e-15, "{q} {a} {b}");
                }
            }
        }
        // Fourth order, which the stress of the flow needs.
        for (a, b) in [(0, 1), (0, 2), (1, 2)] {
            let m: f64 = (0..Q19).map(|k| W19[k] * f64::from(C[k][a] * C[k][a] * C[k][b] * C[k][b])).sum();
            assert!((m - 1.0 / 9.0).abs() < 1e-15);
        }
        for k in 0..Q19 {
            assert_eq!(C[opposite(k)], C[k].map(|v| -v));
            assert_eq!(direction(C[k]), Some(k));
        }
    }
}
