//! Forward models of lenses on the normalised image plane (splatting.md §2.2).

/// How a lens bends the ray of the normalised image point `(x, y) = (X/Z, Y/Z)`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Lens {
    /// An ideal pinhole.
    Straight,
    /// Radial polynomial `1 + k1 r² + k2 r⁴ + k3 r⁶ + k4 r⁸` with tangential terms (OPENCV, RADIAL, SIMPLE_RADIAL).
    Polynomial { k: [f64; 4], p: [f64; 2] },
    /// `θ_d = θ (1 + k1 θ² + k2 θ⁴ + k3 θ⁶ + k4 θ⁸)` along the direction of `(x, y)` (OPENCV_FISHEYE).
    Fisheye { k: [f64; 4] },
}

/// `1 + k1 s + k2 s² + k3 s³ + k4 s⁴`.
fn series(k: [f64; 4], s: f64) -> f64 {
    1.0 + s * (k[0] + s * (k[1] + s * (k[2] + s * k[3])))
}

/// Derivative of `r · series(k, r²)` with respect to `r`, as a function of `s = r²`.
fn slope(k: [f64; 4], s: f64) -> f64 {
    series([3.0 * k[0], 5.0 * k[1], 7.0 * k[2], 9.0 * k[3]], s)
}

impl Lens {
    /// A polynomial lens, or none if every coefficient is zero.
    pub fn polynomial(k: [f64; 4], p: [f64; 2]) -> Self {
        if k == [0.0; 4] && p == [0.0; 2] { Self::Straight } else { Self::Polynomial { k, p } }
    }

    pub fn is_straight(&self) -> bool {
        *self == Self::Straight
    }

    pub fn is_finite(&self) -> bool {
        match self {
            Self::Straight => true,
            Self::Polynomial { k, p } => k.iter().chain(p).all(|v| v.is_finite()),
            Self::Fisheye { k } => k.iter().all(|v| v.is_finite()),
        }
    }

    /// Where the lens puts the normalised point.
    #[inline(always)]
    pub fn distort(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        match *self {
            Self::Straight => [x, y],
            Self::Polynomial { k, p } => {
                let s = x * x + y * y;
                let radial = series(k, s);
                let dx = 2.0 * p[0] * x * y + p[1] * (s + 2.0 * x * x);
                let dy = p[0] * (s + 2.0 * y * y) + 2.0 * p[1] * x * y;
                [x * radial + dx, y * radial + dy]
            }
            Self::Fisheye { k } => {
                let r = (x * x + y * y).sqrt();
                if r < 1e-9 {
                    return [x, y];
                }
                let theta = r.atan();
                let scale = theta * series(k, theta * theta) / r;
                [x * scale, y * scale]
            }
        }
    }

    /// The radius on the normalised plane up to which the model is one-to-one: beyond the first maximum of its radial profile
    /// it folds the picture back, and what it says there is no longer the lens. `reach` bounds the search.
    pub fn fold_radius(&self, reach: f64) -> f64 {
        let first_fold = |k: [f64; 4], most: f64| {
            // Coefficients of real lenses leave room of several image sizes; 4096 steps find a fold well within a pixel's worth.
            let steps = 4096;
            (1..=steps).map(|i| most * f64::from(i) / f64::from(steps)).find(|r| slope(k, r * r) <= 0.0)
        };
        match *self {
            Self::Straight => f64::INFINITY,
            Self::Polynomial { k, .. } => first_fold(k, reach).unwrap_or(f64::INFINITY),
            Self::Fisheye { k } => first_fold(k, reach.atan()).map_or(f64::INFINITY, f64::tan),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn models_agree_with_their_formulas_at_a_point() {
        let (x, y) = (0.3, -0.2);
        let (k, p) = ([0.1, -0.05, 0.0, 0.0], [0.01, -0.02]);
        let r2 = x * x + y * y;
        let radial = 1.0 + 0.1 * r2 - 0.05 * r2 * r2;
        let [xd, yd] = Lens::polynomial(k, p).distort([x, y]);
        assert!((xd - (x * radial + 2.0 * 0.01 * x * y - 0.02 * (r2 + 2.0 * x * x))).abs() < 1e-15);
        assert!((yd - (y * radial + 0.01 * (r2 + 2.0 * y * y) + 2.0 * -0.02 * x * y)).abs() < 1e-15);
        let r = r2.sqrt();
        let theta = r.atan();
        let [xf, yf] = Lens::Fisheye { k: [0.02, 0.0, 0.0, 0.0] }.distort([x, y]);
        let td = theta * (1.0 + 0.02 * theta * theta);
        assert!((xf - x * td / r).abs() < 1e-15 && (yf - y * td / r).abs() < 1e-15);
        assert_eq!(Lens::Fisheye { k: [0.0; 4] }.distort([0.0, 0.0]), [0.0, 0.0]);
        assert!(Lens::polynomial([0.0; 4], [0.0; 2]).is_straight());
    }

    #[test]
    fn strong_barrels_fold() {
        // r − ½ r³ has its maximum at sqrt(2/3).
        let lens = Lens::polynomial([-0.5, 0.0, 0.0, 0.0], [0.0; 2]);
        assert!((lens.fold_radius(3.0) - (2.0f64 / 3.0).sqrt()).abs() < 1e-3);
        assert_eq!(lens.fold_radius(0.5), f64::INFINITY);
        assert_eq!(Lens::Fisheye { k: [0.0; 4] }.fold_radius(100.0), f64::INFINITY);
    }
}
