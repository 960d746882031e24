//! What a capture's list says about a camera, and what it means for an image of a known size (splatting.md §2.1, §2.3).

use crate::{error::Fault, lens::Lens};

/// Largest width or height that is believed \[px\].
pub(crate) const MAX_SIDE: u32 = 1 << 17;

/// Size of an image \[px\].
pub(crate) type Size = [u32; 2];

/// Intrinsics as written down; some flavours leave most of it out.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Optics {
    /// Focal lengths \[px\].
    pub focal: [Option<f64>; 2],
    /// Full fields of view \[rad\].
    pub angle: [Option<f64>; 2],
    /// Principal point \[px\].
    pub centre: [Option<f64>; 2],
    /// The size that all of this refers to \[px\]; without it the image's own.
    pub size: Option<[f64; 2]>,
    pub lens: Lens,
}

/// Checked intrinsics of an image of this size.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Intrinsics {
    pub focal: [f64; 2],
    pub centre: [f64; 2],
    pub size: Size,
    pub lens: Lens,
}

impl Optics {
    /// Whether the numbers stand in pixels of a size that is not written down.
    pub fn needs_original(&self) -> bool {
        self.size.is_none() && self.focal.iter().chain(&self.centre).any(Option::is_some)
    }

    /// Intrinsics at the size they are given for; `original` is the size of the photograph.
    pub fn resolve(&self, original: Size) -> Result<Intrinsics, Fault> {
        let size = match self.size {
            None => original,
            Some(stated) => {
                let good = |v: f64| v.fract() == 0.0 && v >= 1.0 && v <= f64::from(MAX_SIDE);
                if !stated.iter().all(|v| good(*v)) {
                    let found = format!("a size of {} × {} pixels", stated[0], stated[1]);
                    return Err(Fault::new(found, format!("whole numbers from 1 to {MAX_SIDE}"), "correct the camera's width and height"));
                }
                stated.map(|v| v as u32)
            }
        };
        let mut focal = self.focal;
        for a in 0..2 {
            if let (None, Some(angle)) = (focal[a], self.angle[a]) {
                if !(angle > 0.0 && angle < std::f64::consts::PI) {
                    let name = ["camera_angle_x", "camera_angle_y"][a];
                    return Err(Fault::new(format!("{name} = {angle}"), "an angle between 0 and π radians", "correct the field of view"));
                }
                focal[a] = Some(0.5 * f64::from(size[a]) / (0.5 * angle).tan());
            }
        }
        let Some(fx) = focal[0].or(focal[1]) else {
            let remedy = "add fl_x (pixels) or camera_angle_x (radians), or export the poses again with intrinsics";
            return Err(Fault::new("no focal length", "fl_x or camera_angle_x", remedy));
        };
        let focal = [fx, focal[1].unwrap_or(fx)];
        let centre = [0, 1].map(|a| self.centre[a].unwrap_or(0.5 * f64::from(size[a])));
        let intrinsics = Intrinsics { focal, centre, size, lens: self.lens };
        intrinsics.check()?;
        Ok(intrinsics)
    }
}

impl Intrinsics {
    fn check(&self) -> Result<(), Fault> {
        let longest = f64::from(self.size[0].max(self.size[1]));
        for a in 0..2 {
            let (f, c, side) = (self.focal[a], self.centre[a], f64::from(self.size[a]));
            // A hundredth of the image is a field of view of 178.9 degrees, a thousand times of it 0.06 degrees.
            if !(f > 0.01 * longest && f < 1000.0 * longest) {
                let expected = format!("a positive number of pixels that suits an image of {} × {}", self.size[0], self.size[1]);
                let remedy = "correct the intrinsics or run the camera calibration again";
                return Err(Fault::new(format!("focal length {} = {f}", ["fx", "fy"][a]), expected, remedy));
            }
            if !(c > -side && c < 2.0 * side) {
                let found = format!("principal point {} = {c}", ["cx", "cy"][a]);
                let remedy = "correct the intrinsics; they must belong to the full-size photograph";
                return Err(Fault::new(found, format!("near the image, 0 to {side} pixels"), remedy));
            }
        }
        if !self.lens.is_finite() {
            return Err(Fault::new(
                "a distortion coefficient that is no number",
                "finite coefficients",
                "run the camera calibration again",
            ));
        }
        Ok(())
    }

    /// The same camera for an image of another size; intrinsics follow the exact size ratio (§2.4).
    pub fn resized(&self, size: Size) -> Self {
        let ratio = [0, 1].map(|a| f64::from(size[a]) / f64::from(self.size[a]));
        Self { focal: [0, 1].map(|a| self.focal[a] * ratio[a]), centre: [0, 1].map(|a| self.centre[a] * ratio[a]), size, ..*self }
    }

    /// The same camera for the stored image: equal in size, or an exact reduction or enlargement of what the intrinsics say.
    pub fn fitted_to(&self, stored: Size) -> Result<Self, Fault> {
        if self.size == stored {
            return Ok(*self);
        }
        if whole_ratio(self.size, stored).is_some() || whole_ratio(stored, self.size).is_some() {
            return Ok(self.resized(stored));
        }
        let turned = self.size == [stored[1], stored[0]];
        let remedy = if turned {
            "the image lies on its side: save it the way the pose program saw it (without applying the EXIF orientation)"
        } else {
            "use the photographs the poses were computed from, or correct the camera's width and height"
        };
        let expected = format!("{} × {} or an exact fraction of it", self.size[0], self.size[1]);
        Err(Fault::new(format!("an image of {} × {} pixels", stored[0], stored[1]), expected, remedy))
    }
}

/// The whole number by which `large` was reduced to `small`, whichever way the division was rounded.
pub(crate) fn whole_ratio(large: Size, small: Size) -> Option<u32> {
    let guess = (f64::from(large[0]) / f64::from(small[0].max(1))).round() as u32;
    let fits = |r: u32| r >= 1 && [0, 1].into_iter().all(|a| small[a] == large[a] / r || small[a] == large[a].div_ceil(r));
    // Rounding of a small width can push the quotient over; the other axis decides.
    [guess, guess.saturating_sub(1), guess + 1].into_iter().find(|r| (1..=64).contains(r) && fits(*r))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn optics() -> Optics {
        Optics { focal: [None; 2], angle: [Some(0.7), None], centre: [None; 2], size: None, lens: Lens::Straight }
    }

    #[test]
    fn a_field_of_view_is_enough() {
        let i = optics().resolve([800, 600]).unwrap();
        let f = 400.0 / 0.35f64.tan();
        assert!((i.focal[0] - f).abs() < 1e-9 && i.focal[1] == i.focal[0] && i.centre == [400.0, 300.0]);
        let i = Optics { angle: [Some(0.7), Some(0.6)], ..optics() }.resolve([800, 600]).unwrap();
        assert!((i.focal[1] - 300.0 / 0.3f64.tan()).abs() < 1e-9);
    }

    #[test]
    fn wrong_intrinsics_are_refused() {
        for (o, what) in [
            (Optics { angle: [None; 2], ..optics() }, "no focal length"),
            (Optics { angle: [Some(4.0), None], ..optics() }, "camera_angle_x"),
            (Optics { angle: [Some(f64::NAN), None], ..optics() }, "camera_angle_x"),
            (Optics { focal: [Some(-5.0), None], ..optics() }, "fx = -5"),
            (Optics { focal: [Some(f64::NAN), None], ..optics() }, "fx = NaN"),
            (Optics { focal: [Some(500.0), Some(0.0)], ..optics() }, "fy = 0"),
            (Optics { centre: [Some(5000.0), None], ..optics() }, "cx = 5000"),
            (Optics { centre: [None, Some(f64::INFINITY)], ..optics() }, "cy = inf"),
            (Optics { size: Some([0.0, 5.0]), ..optics() }, "0 × 5"),
            (Optics { size: Some([1e12, 5.0]), ..optics() }, "1000000000000"),
            (Optics { size: Some([80.5, 5.0]), ..optics() }, "80.5"),
            (Optics { lens: Lens::Polynomial { k: [f64::NAN, 0.0, 0.0, 0.0], p: [0.0; 2] }, ..optics() }, "distortion"),
        ] {
            let fault = o.resolve([800, 600]).unwrap_err();
            assert!(fault.found.contains(what), "{what}: {fault:?}");
        }
    }

    #[test]
    fn sizes_must_match_up_to_an_exact_factor() {
        let i = Optics { focal: [Some(1000.0), None], size: Some([1999.0, 1501.0]), ..optics() }.resolve([1, 1]).unwrap();
        for (w, h, r) in [(1999, 1501, 1), (1000, 751, 2), (999, 750, 2), (1000, 750, 2), (499, 376, 4), (250, 187, 8)] {
            assert_eq!(whole_ratio([1999, 1501], [w, h]), Some(r));
            let s = i.fitted_to([w, h]).unwrap();
            assert!((s.focal[0] - 1000.0 * f64::from(w) / 1999.0).abs() < 1e-9);
            assert!((s.centre[1] - 0.5 * f64::from(h)).abs() < 1e-9);
        }
        assert!(i.fitted_to([3998, 3002]).is_ok());
        for bad in [[1000, 800], [1500, 1126], [1999, 1500], [20, 1501]] {
            assert!(i.fitted_to(bad).is_err(), "{bad:?}");
        }
        assert!(i.fitted_to([1501, 1999]).unwrap_err().remedy.contains("on its side"));
    }
}
