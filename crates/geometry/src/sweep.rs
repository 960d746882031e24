//! Distances away from where they are known: |∇d| = 1 by fast sweeping (Zhao 2005).

/// Fills `distance` (unsigned, z fastest) outward from the nodes whose value is finite. Those marked in `fixed` keep theirs.
pub(crate) fn sweep(distance: &mut [f32], fixed: &[bool], nodes: [usize; 3], spacing: f64) {
    let h = spacing as f32;
    let [nx, ny, nz] = nodes;
    let strides = [ny * nz, nz, 1];
    // Two rounds of all eight directions: characteristics turn at most a few times around a body.
    for pass in 0..16 {
        let up = [pass & 1 == 0, pass & 2 == 0, pass & 4 == 0];
        let at = |a: usize, n: usize, step: usize| if up[a] { step } else { n - 1 - step };
        for i in (0..nx).map(|s| at(0, nx, s)) {
            for j in (0..ny).map(|s| at(1, ny, s)) {
                for k in (0..nz).map(|s| at(2, nz, s)) {
                    let n = (i * ny + j) * nz + k;
                    if fixed[n] {
                        continue;
                    }
                    let mut near = [f32::INFINITY; 3];
                    for (a, c) in [i, j, k].into_iter().enumerate() {
                        if c > 0 {
                            near[a] = distance[n - strides[a]];
                        }
                        if c + 1 < nodes[a] {
                            near[a] = near[a].min(distance[n + strides[a]]);
                        }
                    }
                    let d = eikonal(near, h);
                    if d < distance[n] {
                        distance[n] = d;
                    }
                }
            }
        }
    }
}

/// The value that makes the upwind gradient one, from the smaller neighbour per axis.
fn eikonal(mut near: [f32; 3], h: f32) -> f32 {
    near.sort_unstable_by(f32::total_cmp);
    let [a, b, c] = near;
    if !a.is_finite() {
        return f32::INFINITY;
    }
    let one = a + h;
    if one <= b {
        return one;
    }
    let two = 0.5 * (a + b + (2.0 * h * h - (a - b) * (a - b)).max(0.0).sqrt());
    if two <= c {
        return two;
    }
    let (sum, squares) = (a + b + c, a * a + b * b + c * c);
    (sum + (sum * sum - 3.0 * (squares - h * h)).max(0.0).sqrt()) / 3.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distances_spread_from_a_plane_and_from_a_ball() {
        let n = 24usize;
        let ball = |i: usize| {
            let x = [i / (n * n), i / n % n, i % n].map(|c| c as f32 - 11.5);
            (x[0] * x[0] + x[1] * x[1] + x[2] * x[2]).sqrt() - 4.0
        };
        let plane = |i: usize| (i % n) as f32 - 5.3;
        // First order: the middle of a small ball and the far corners are off by some per cent.
        for (exact, tolerance) in [(&ball as &dyn Fn(usize) -> f32, 0.1), (&plane, 1e-5)] {
            let known = |i: usize| exact(i).abs() < 2.0;
            let mut d: Vec<f32> = (0..n * n * n).map(|i| if known(i) { exact(i).abs() } else { f32::INFINITY }).collect();
            let fixed: Vec<bool> = (0..d.len()).map(known).collect();
            sweep(&mut d, &fixed, [n; 3], 1.0);
            for i in 0..d.len() {
                assert!((d[i] - exact(i).abs()).abs() < tolerance * (1.0 + d[i]), "{i}: {} {}", d[i], exact(i));
            }
        }
    }
}
