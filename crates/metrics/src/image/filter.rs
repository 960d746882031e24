//! Separable filters on one plane of an image.

use rayon::prelude::*;

/// What lies beyond the border of an image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Border {
    /// Zeros.
    Zero,
    /// The nearest pixel.
    Replicate,
}

/// Correlates the rows of `plane` with `across`, then the columns with `down`; both have an odd number of taps.
pub(super) fn separable(plane: &[f64], width: usize, across: &[f64], down: &[f64], border: Border) -> Vec<f64> {
    if plane.is_empty() {
        return Vec::new();
    }
    let height = plane.len() / width;
    let radius = across.len() / 2;
    let mut rows = vec![0.0; plane.len()];
    rows.par_chunks_mut(width).zip(plane.par_chunks(width)).for_each(|(out, row)| {
        let (first, last) = match border {
            Border::Zero => (0.0, 0.0),
            Border::Replicate => (row[0], row[width - 1]),
        };
        let mut padded = vec![first; radius];
        padded.extend_from_slice(row);
        padded.resize(width + 2 * radius, last);
        for (k, tap) in across.iter().enumerate() {
            out.iter_mut().zip(&padded[k..]).for_each(|(o, v)| *o += tap * v);
        }
    });
    let radius = down.len() / 2;
    let mut result = vec![0.0; plane.len()];
    result.par_chunks_mut(width).enumerate().for_each(|(y, out)| {
        for (k, tap) in down.iter().enumerate() {
            let row = y as isize + k as isize - radius as isize;
            let inside = row.clamp(0, height as isize - 1);
            if row == inside || border == Border::Replicate {
                out.iter_mut().zip(&rows[inside as usize * width..]).for_each(|(o, v)| *o += tap * v);
            }
        }
    });
    result
}

/// `2 radius + 1` values of `exp(−x²/(2σ²))`, scaled to sum to one.
pub(super) fn gaussian(sigma: f64, radius: usize) -> Vec<f64> {
    let values: Vec<f64> = offsets(radius).map(|x| (-0.5 * (x / sigma).powi(2)).exp()).collect();
    let sum: f64 = values.iter().sum();
    values.iter().map(|v| v / sum).collect()
}

/// `−radius … radius`.
pub(super) fn offsets(radius: usize) -> impl Iterator<Item = f64> {
    let r = radius as isize;
    (-r..=r).map(|x| x as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn borders_and_directions() {
        // A step along x, one along y; asymmetric taps, so that a flip would show.
        let plane = [1.0, 2.0, 4.0, 8.0, 16.0, 32.0];
        let across = [1.0, 0.0, 10.0];
        let one = [0.0, 1.0, 0.0];
        assert_eq!(separable(&plane, 3, &across, &one, Border::Zero), [20.0, 41.0, 2.0, 160.0, 328.0, 16.0]);
        assert_eq!(separable(&plane, 3, &across, &one, Border::Replicate), [21.0, 41.0, 42.0, 168.0, 328.0, 336.0]);
        assert_eq!(separable(&plane, 3, &one, &across, Border::Zero), [80.0, 160.0, 320.0, 1.0, 2.0, 4.0]);
        assert_eq!(separable(&plane, 3, &one, &across, Border::Replicate), [81.0, 162.0, 324.0, 81.0, 162.0, 324.0]);
        let g = gaussian(1.5, 5);
        assert!((g.iter().sum::<f64>() - 1.0).abs() < 1e-15 && (g[5] / g[8] - 2f64.exp()).abs() < 1e-12);
    }
}
