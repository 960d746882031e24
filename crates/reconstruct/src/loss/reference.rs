//! The photometric loss the slow way: double precision, a two-dimensional window, one pixel after the other.

/// `(L1, mean SSIM, gradient of (1−λ)L1 + λ(1−SSIM) by x)` of interleaved images; `mask` has one weight per pixel.
pub fn photometric(x: &[f64], y: &[f64], mask: &[f64], width: usize, height: usize, lambda: f64) -> (f64, f64, Vec<f64>) {
    let samples = 3.0 * mask.iter().sum::<f64>();
    let at = |px: usize, py: usize, c: usize| 3 * (py * width + px) + c;
    // Calls `f(neighbour, weight)` for every pixel under the window.
    let window = |px: usize, py: usize, f: &mut dyn FnMut(usize, usize, f64)| {
        let weight = |d: isize| (-0.5 * (d as f64 / 1.5).powi(2)).exp();
        let total: f64 = (-5..=5).map(weight).sum();
        for dy in -5isize..=5 {
            for dx in -5isize..=5 {
                let (qx, qy) = (px as isize + dx, py as isize + dy);
                if qx >= 0 && qy >= 0 && (qx as usize) < width && (qy as usize) < height {
                    f(qx as usize, qy as usize, weight(dx) * weight(dy) / (total * total));
                }
            }
        }
    };
    let (mut l1, mut ssim, mut gradient) = (0.0, 0.0, vec![0.0; x.len()]);
    for py in 0..height {
        for px in 0..width {
            let m = mask[py * width + px] / samples;
            for c in 0..3 {
                let i = at(px, py, c);
                l1 += m * (x[i] - y[i]).abs();
                if x[i] != y[i] {
                    gradient[i] += (1.0 - lambda) * m * (x[i] - y[i]).signum();
                }
                let (mut mx, mut my, mut xx, mut yy, mut xy) = (0.0, 0.0, 0.0, 0.0, 0.0);
                window(px, py, &mut |qx, qy, w| {
                    let (a, b) = (x[at(qx, qy, c)], y[at(qx, qy, c)]);
                    mx += w * a;
                    my += w * b;
                    xx += w * a * a;
                    yy += w * b * b;
                    xy += w * a * b;
                });
                let (a1, a2) = (2.0 * mx * my + 1e-4, 2.0 * (xy - mx * my) + 9e-4);
                let (b1, b2) = (mx * mx + my * my + 1e-4, xx - mx * mx + yy - my * my + 9e-4);
                let s = a1 * a2 / (b1 * b2);
                ssim += m * s;
                // Quotient rule on S itself, without the shared terms that the production code collects.
                window(px, py, &mut |qx, qy, w| {
                    let (a, b) = (x[at(qx, qy, c)], y[at(qx, qy, c)]);
                    let (d_mx, d_xx, d_xy) = (w, 2.0 * w * a, w * b);
                    let (d_a1, d_a2) = (2.0 * my * d_mx, 2.0 * (d_xy - my * d_mx));
                    let (d_b1, d_b2) = (2.0 * mx * d_mx, d_xx - 2.0 * mx * d_mx);
                    let d = (d_a1 * a2 + a1 * d_a2) / (b1 * b2) - s * (d_b1 / b1 + d_b2 / b2);
                    gradient[at(qx, qy, c)] -= lambda * m * d;
                });
            }
        }
    }
    (l1, ssim, gradient)
}
