//! Iso-lines of a scalar image by marching squares, as anti-aliased coverage.

use megas_model::Image;

use crate::colormap::unit;

/// Coverage in [0, 1], one per pixel, of a line of `width` pixels along `field = level`. Only where `weight` exceeds ½ at
/// all four corners of a cell; the field is smoothed a little first, weighted by `weight`.
pub(crate) fn isoline(field: &Image, weight: &Image, level: f32, width: f32) -> Vec<f32> {
    let (w, h) = (field.width as usize, field.height as usize);
    let smooth = smoothed(field, weight);
    let mut coverage = vec![0.0; w * h];
    for j in 0..h.saturating_sub(1) {
        for i in 0..w.saturating_sub(1) {
            let corner = [j * w + i, j * w + i + 1, (j + 1) * w + i + 1, (j + 1) * w + i];
            if !corner.iter().all(|&k| weight.data[k] > 0.5) {
                continue;
            }
            let v = corner.map(|k| smooth[k] - level);
            let above = v.map(|v| v > 0.0);
            if above == [above[0]; 4] {
                continue;
            }
            // Crossings in the order of the edges; of a saddle's four, the first two and the last two belong together
            // when the middle has the sign of corner 0's neighbours, the other pairing otherwise.
            let position = [(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)].map(|(x, y)| [x as f32, y as f32]);
            let mut crossing = [[0.0; 2]; 4];
            let mut n = 0;
            for e in 0..4 {
                let f = (e + 1) % 4;
                if above[e] != above[f] {
                    let t = v[e] / (v[e] - v[f]);
                    crossing[n] = std::array::from_fn(|c| position[e][c] + t * (position[f][c] - position[e][c]));
                    n += 1;
                }
            }
            let middle = v.iter().sum::<f32>() > 0.0;
            let pairs: &[[usize; 2]] = match n {
                2 => &[[0, 1]],
                _ if middle == above[0] => &[[0, 1], [2, 3]],
                _ => &[[3, 0], [1, 2]],
            };
            for p in pairs {
                stroke(&mut coverage, w, h, crossing[p[0]], crossing[p[1]], width);
            }
        }
    }
    coverage
}

/// Raises the coverage of the pixels near a segment between two pixel positions.
fn stroke(coverage: &mut [f32], w: usize, h: usize, a: [f32; 2], b: [f32; 2], width: f32) {
    let reach = 0.5 * width + 0.5;
    let range = |k: usize, n: usize| {
        let lo = (a[k].min(b[k]) - reach).ceil().max(0.0) as usize;
        lo..(((a[k].max(b[k]) + reach).floor() as usize) + 1).min(n)
    };
    let d = [b[0] - a[0], b[1] - a[1]];
    let len2 = (d[0] * d[0] + d[1] * d[1]).max(1e-12);
    for y in range(1, h) {
        for x in range(0, w) {
            let p = [x as f32 - a[0], y as f32 - a[1]];
            let t = ((p[0] * d[0] + p[1] * d[1]) / len2).clamp(0.0, 1.0);
            let distance = (p[0] - t * d[0]).hypot(p[1] - t * d[1]);
            let c = &mut coverage[y * w + x];
            *c = c.max((reach - distance).clamp(0.0, 1.0));
        }
    }
}

/// The field after a weighted 1-4-6-4-1 filter in both directions; splats make it ripple from pixel to pixel.
fn smoothed(field: &Image, weight: &Image) -> Vec<f32> {
    let (w, h) = (field.width as usize, field.height as usize);
    let a: Vec<f32> = weight.data.iter().map(|&a| unit(a)).collect();
    let sane = |v: f32| if v.is_finite() { v } else { 0.0 };
    let product: Vec<f32> = field.data.iter().zip(&a).map(|(&v, a)| sane(v) * a).collect();
    let (sum, total) = (filtered(product, w, h), filtered(a, w, h));
    let quotient = |((s, t), v): ((&f32, &f32), &f32)| if *t > 0.0 { s / t } else { sane(*v) };
    sum.iter().zip(&total).zip(&field.data).map(quotient).collect()
}

/// 1-4-6-4-1 along rows and along columns, the border repeated.
fn filtered(mut data: Vec<f32>, w: usize, h: usize) -> Vec<f32> {
    let mix = |a: f32, b: f32, c: f32, d: f32, e: f32| (a + e) + 4.0 * (b + d) + 6.0 * c;
    let mut padded = vec![0.0; w + 4];
    for row in data.chunks_exact_mut(w.max(1)) {
        padded[2..w + 2].copy_from_slice(row);
        padded[..2].fill(row[0]);
        padded[w + 2..].fill(row[w - 1]);
        for (o, p) in row.iter_mut().zip(padded.windows(5)) {
            *o = mix(p[0], p[1], p[2], p[3], p[4]);
        }
    }
    let mut out = vec![0.0; data.len()];
    for (j, o) in out.chunks_exact_mut(w.max(1)).enumerate() {
        let row = |k: usize| &data[(j + k).saturating_sub(2).min(h - 1) * w..][..w];
        let (a, b, c, d, e) = (row(0), row(1), row(2), row(3), row(4));
        for i in 0..w {
            o[i] = mix(a[i], b[i], c[i], d[i], e[i]);
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn radial(n: u32) -> (Image, Image) {
        let (mut f, mut a) = (Image::new(n, n, 1), Image::new(n, n, 1));
        let c = 0.5 * (n - 1) as f32;
        for j in 0..n {
            for i in 0..n {
                f.pixel_mut(i, j)[0] = (i as f32 - c).hypot(j as f32 - c);
                a.pixel_mut(i, j)[0] = if i < 50 { 1.0 } else { 0.0 };
            }
        }
        (f, a)
    }

    #[test]
    fn a_cone_gives_a_circle_where_there_is_something() {
        let (f, a) = radial(65);
        let line = isoline(&f, &a, 20.0, 1.5);
        let mut on = 0;
        for (k, &c) in line.iter().enumerate() {
            let r = f.data[k];
            let covered = k % 65 < 49;
            if covered && (r - 20.0).abs() < 0.4 {
                assert!(c > 0.6, "gap at {k}: {c}");
                on += 1;
            }
            // At the rim of what is covered the smoothing sees one side only.
            if (r - 20.0).abs() > if k % 65 < 46 { 1.6 } else { 2.2 } {
                assert_eq!(c, 0.0, "stray at {k}");
            }
            if k % 65 > 51 {
                assert_eq!(c, 0.0);
            }
        }
        assert!(on > 60);
    }

    #[test]
    fn saddles_and_broken_values_do_no_harm() {
        let mut f = Image::new(8, 8, 1);
        for (k, v) in f.data.iter_mut().enumerate() {
            *v = if (k % 8 + k / 8) % 2 == 0 { 1.0 } else { -1.0 };
        }
        f.data[20] = f32::NAN;
        let mut a = Image::new(8, 8, 1);
        a.data.fill(1.0);
        assert!(isoline(&f, &a, 0.0, 1.0).iter().all(|c| (0.0..=1.0).contains(c)));
    }
}
