//! Where a photograph is smooth, so that its surface may be assumed smooth as well (splatting.md §5.2).

/// Weights `ω = (1 − |∇I|)²` in [0, 1] of the normal consistency, one per pixel: `|∇I|` is the larger of the two central
/// differences of the mean over channels, stretched to [0, 1] over the image; the outermost pixels have weight 0. A
/// constant image has weight 1 inside.
pub fn edge_weights(width: usize, height: usize, rgb: &[[f32; 3]]) -> Vec<f32> {
    assert_eq!(rgb.len(), width * height, "one colour per pixel");
    let grey: Vec<f32> = rgb.iter().map(|c| (c[0] + c[1] + c[2]) / 3.0).collect();
    let mut weights = vec![0.0f32; rgb.len()];
    if width < 3 || height < 3 {
        return weights;
    }
    let (mut low, mut high) = (f32::MAX, 0.0f32);
    for y in 1..height - 1 {
        for i in y * width + 1..(y + 1) * width - 1 {
            let slope = (grey[i + 1] - grey[i - 1]).abs().max((grey[i + width] - grey[i - width]).abs());
            weights[i] = slope;
            (low, high) = (low.min(slope), high.max(slope));
        }
    }
    let stretch = if high > low { (high - low).recip() } else { 0.0 };
    for y in 1..height - 1 {
        for w in &mut weights[y * width + 1..(y + 1) * width - 1] {
            let flat = 1.0 - (*w - low) * stretch;
            *w = flat * flat;
        }
    }
    weights
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_step_has_no_weight_and_flat_parts_have_all() {
        let (width, height) = (10, 6);
        let rgb: Vec<[f32; 3]> = (0..60).map(|i| if i % width < 5 { [0.2, 0.2, 0.2] } else { [0.9, 0.5, 0.1] }).collect();
        let w = edge_weights(width, height, &rgb);
        for y in 0..height {
            for x in 0..width {
                let border = x == 0 || y == 0 || x == width - 1 || y == height - 1;
                let edge = x == 4 || x == 5;
                assert_eq!(w[y * width + x], if border || edge { 0.0 } else { 1.0 }, "{x} {y}");
            }
        }
        // A vertical step half as high as the horizontal one: (1 − ½)².
        let mut rgb = vec![[0.0f32; 3]; 100];
        for y in 0..10 {
            for x in 0..10 {
                rgb[y * 10 + x] = [if y < 5 { 0.0 } else { 0.25 } + if x < 5 { 0.0 } else { 0.5 }; 3];
            }
        }
        let w = edge_weights(10, 10, &rgb);
        assert_eq!((w[5 * 10 + 2], w[2 * 10 + 5], w[2 * 10 + 2]), (0.25, 0.0, 1.0));
        assert!(edge_weights(5, 5, &[[0.3; 3]; 25])[12] == 1.0 && edge_weights(2, 9, &[[0.3; 3]; 18]).iter().all(|&w| w == 0.0));
    }
}
