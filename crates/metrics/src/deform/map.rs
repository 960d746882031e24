//! The maps D1–D6.

use std::f64::consts::PI;

use megas_math::{Mat3, Vec3, mat3, vec3};
use serde::{Deserialize, Serialize};

/// Angle that the top turns by against the base \[rad\].
const TWIST: f64 = 1.5 * PI;
/// Vertical stretch.
const STRETCH: f64 = 2.0;
/// Vertical stretch of the slump at the base and at the top.
const SLUMP: [f64; 2] = [0.25, 0.9];
/// Isotropic factor.
const INFLATE: f64 = 1.5;
/// Largest stretch of the neck, and its half width in diagonals L.
const NECK: (f64, f64) = (6.0, 0.08);
/// Way of each half, in diagonals L.
const CUT: f64 = 0.08;
/// The slump goes on linearly beyond this fraction of the height above the top and below the base, where only floaters are.
const SLUMP_MARGIN: f64 = 0.1;

/// A prescribed deformation.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub enum Deformation {
    /// None: the object at rest.
    Rest,
    /// D1: turns about the vertical axis, by 1.5π over the height.
    Twist,
    /// D2: twice as high, thinner at constant volume.
    Stretch,
    /// D3: sinks together and spreads, most at the base, at constant volume.
    Slump,
    /// D4: grows 1.5-fold.
    Inflate,
    /// D5: a band of ± 0.08 L about the middle is stretched up to six-fold along x, at constant volume.
    Neck,
    /// D6: two halves part at the middle plane; the faces of the cut are new.
    Cut,
}

impl Deformation {
    /// D1 to D6.
    pub const ALL: [Self; 6] = [Self::Twist, Self::Stretch, Self::Slump, Self::Inflate, Self::Neck, Self::Cut];

    /// The name in the design: `D1`; `rest` for none.
    pub fn id(self) -> &'static str {
        match self {
            Self::Rest => "rest",
            Self::Twist => "D1",
            Self::Stretch => "D2",
            Self::Slump => "D3",
            Self::Inflate => "D4",
            Self::Neck => "D5",
            Self::Cut => "D6",
        }
    }

    /// What it does, in a word.
    pub fn name(self) -> &'static str {
        match self {
            Self::Rest => "rest",
            Self::Twist => "twist",
            Self::Stretch => "stretch",
            Self::Slump => "slump",
            Self::Inflate => "inflate",
            Self::Neck => "neck",
            Self::Cut => "cut",
        }
    }
}

/// Where an object stands: the frame and the sizes that the maps refer to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stage {
    /// Rows: the horizontal axes x and y and the vertical one, in the scene; a rotation.
    pub axes: Mat3<f64>,
    /// The point of the scene below the middle of the object at its base.
    pub origin: Vec3<f64>,
    /// Height H of the object \[scene units\].
    pub height: f64,
    /// Diagonal L of its box \[scene units\].
    pub diagonal: f64,
    /// Share of the way to the deformed place that points have gone; 1 but in films.
    pub amount: f64,
}

impl Stage {
    /// The stage of an object whose surface has these points; `axes` are the rows of a rotation whose last points up.
    /// `None` without extent.
    pub fn new(points: &[[f32; 3]], axes: Mat3<f64>) -> Option<Self> {
        let (mut low, mut high) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
        for &p in points {
            let x = mat3::mul_vec(axes, vec3::cast(p));
            (low, high) = (vec3::min(low, x), vec3::max(high, x));
        }
        let size = vec3::sub(high, low);
        let base = [0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1]), low[2]];
        let ok = size.iter().all(|s| *s > 0.0 && s.is_finite());
        ok.then(|| Self { axes, origin: mat3::tmul_vec(axes, base), height: size[2], diagonal: vec3::norm(size), amount: 1.0 })
    }

    /// The same on the way: `X + amount (Φ(X) − X)`, for films of a deformation. `amount` in [0, 1]; turns ([`Deformation::Twist`])
    /// shrink on the way, the others stay invertible.
    pub fn partly(self, amount: f64) -> Self {
        Self { amount, ..self }
    }

    /// Φ(X): where a point of the scene goes.
    pub fn map(&self, d: Deformation, point: Vec3<f64>) -> Vec3<f64> {
        self.map_half(d, point, self.local(point)[0] < 0.0)
    }

    /// As [`Stage::map`], with the half that the point belongs to where the object is cut: `left` is x < 0.
    pub(super) fn map_half(&self, d: Deformation, point: Vec3<f64>, left: bool) -> Vec3<f64> {
        let x = self.local(point);
        self.scene(vec3::lerp(x, self.map_local(d, x, left), self.amount))
    }

    /// F = ∂Φ/∂X at a point of the scene.
    pub fn gradient(&self, d: Deformation, point: Vec3<f64>) -> Mat3<f64> {
        let whole = self.gradient_local(d, self.local(point));
        let f = mat3::add(mat3::scale(mat3::identity(), 1.0 - self.amount), mat3::scale(whole, self.amount));
        mat3::mul(mat3::transpose(self.axes), mat3::mul(f, self.axes))
    }

    /// Scene → stage.
    pub fn local(&self, point: Vec3<f64>) -> Vec3<f64> {
        mat3::mul_vec(self.axes, vec3::sub(point, self.origin))
    }

    /// Stage → scene.
    pub fn scene(&self, x: Vec3<f64>) -> Vec3<f64> {
        vec3::add(mat3::tmul_vec(self.axes, x), self.origin)
    }

    fn map_local(&self, d: Deformation, [x, y, z]: Vec3<f64>, left: bool) -> Vec3<f64> {
        match d {
            Deformation::Rest => [x, y, z],
            Deformation::Twist => {
                let (s, c) = (TWIST * z / self.height).sin_cos();
                [c * x - s * y, s * x + c * y, z]
            }
            Deformation::Stretch => {
                let w = STRETCH.sqrt().recip();
                [w * x, w * y, STRETCH * z]
            }
            Deformation::Slump => {
                let (zz, slope, _) = self.slump(z);
                let w = slope.sqrt().recip();
                [w * x, w * y, zz]
            }
            Deformation::Inflate => [INFLATE * x, INFLATE * y, INFLATE * z],
            Deformation::Neck => {
                let (xx, slope, _) = self.neck(x);
                let w = slope.sqrt().recip();
                [xx, w * y, w * z]
            }
            Deformation::Cut => [x + CUT * self.diagonal * if left { -1.0 } else { 1.0 }, y, z],
        }
    }

    fn gradient_local(&self, d: Deformation, [x, y, z]: Vec3<f64>) -> Mat3<f64> {
        match d {
            Deformation::Rest | Deformation::Cut => mat3::identity(),
            Deformation::Twist => {
                let rate = TWIST / self.height;
                let (s, c) = (rate * z).sin_cos();
                [[c, -s, -rate * (s * x + c * y)], [s, c, rate * (c * x - s * y)], [0.0, 0.0, 1.0]]
            }
            Deformation::Stretch => mat3::diag([STRETCH.sqrt().recip(), STRETCH.sqrt().recip(), STRETCH]),
            Deformation::Slump => {
                let (_, slope, curvature) = self.slump(z);
                let (w, k) = (slope.sqrt().recip(), -0.5 * curvature * slope.powf(-1.5));
                [[w, 0.0, k * x], [0.0, w, k * y], [0.0, 0.0, slope]]
            }
            Deformation::Inflate => mat3::diag([INFLATE; 3]),
            Deformation::Neck => {
                let (_, slope, curvature) = self.neck(x);
                let (w, k) = (slope.sqrt().recip(), -0.5 * curvature * slope.powf(-1.5));
                [[slope, 0.0, 0.0], [k * y, w, 0.0], [k * z, 0.0, w]]
            }
        }
    }

    /// Height of the slump with its first two derivatives.
    fn slump(&self, z: f64) -> (f64, f64, f64) {
        let [s0, s1] = SLUMP;
        let h = self.height;
        let t = (z / h).clamp(-SLUMP_MARGIN, 1.0 + SLUMP_MARGIN);
        let within = t == z / h;
        let slope = s0 + (s1 - s0) * t;
        let inside = h * (s0 * t + 0.5 * (s1 - s0) * t * t);
        let beyond = if within { 0.0 } else { z - t * h };
        (inside + slope * beyond, slope, if within { (s1 - s0) / h } else { 0.0 })
    }

    /// Place along the neck with its first two derivatives.
    fn neck(&self, x: f64) -> (f64, f64, f64) {
        let (k, b) = (NECK.0, NECK.1 * self.diagonal);
        let u = x / b;
        let bell = (k - 1.0) * (-u * u).exp();
        let place = x + (k - 1.0) * b * 0.5 * PI.sqrt() * erf(u);
        (place, 1.0 + bell, -2.0 * u / b * bell)
    }
}

/// The error function, by the series `2/√π e^{−x²} Σ 2ⁿ x^{2n+1} / (2n+1)!!` of positive terms (DLMF 7.6.2).
fn erf(x: f64) -> f64 {
    if x.abs() > 6.0 {
        return x.signum();
    }
    let (mut term, mut sum) = (x, x);
    let mut n = 0.0;
    while term.abs() > 1e-17 * sum.abs() {
        n += 1.0;
        term *= 2.0 * x * x / (2.0 * n + 1.0);
        sum += term;
    }
    2.0 / PI.sqrt() * (-x * x).exp() * sum
}

#[cfg(test)]
mod tests {
    use megas_math::{quat, rng::Rng};

    use super::*;

    fn stage() -> Stage {
        let axes = quat::to_mat3::<f64>([0.8, 0.3, -0.4, 0.2]);
        Stage { axes, origin: [0.3, -0.2, 0.5], height: 2.1, diagonal: 2.9, amount: 1.0 }
    }

    #[test]
    fn erf_has_its_known_values() {
        // Abramowitz & Stegun, table 7.1.
        for (x, e) in [(0.5, 0.520_499_877_8), (1.0, 0.842_700_792_9), (2.0, 0.995_322_265_0), (-1.0, -0.842_700_792_9)] {
            assert!((erf(x) - e).abs() < 1e-10, "{x}");
        }
        assert!((erf(3.5) - 0.999_999_256_901_6).abs() < 1e-12 && erf(7.0) == 1.0 && erf(0.0) == 0.0);
    }

    #[test]
    fn gradients_are_the_derivatives_of_the_maps() {
        let mut rng = Rng::new(3);
        let h = 1e-5;
        for (d, amount) in Deformation::ALL.into_iter().flat_map(|d| [(d, 1.0), (d, 0.4)]) {
            let s = stage().partly(amount);
            for _ in 0..200 {
                let local = [rng.range(-1.0, 1.0), rng.range(-1.0, 1.0), rng.range(0.0, s.height)];
                if d == Deformation::Cut && local[0].abs() < 1e-3 {
                    continue;
                }
                let x = s.scene(local);
                let f = s.gradient(d, x);
                for k in 0..3 {
                    let (mut up, mut down) = (x, x);
                    up[k] += h;
                    down[k] -= h;
                    let (a, b) = (s.map(d, up), s.map(d, down));
                    for r in 0..3 {
                        let difference = (a[r] - b[r]) / (2.0 * h);
                        assert!(
                            (difference - f[r][k]).abs() < 1e-8 * (1.0 + f[r][k].abs()) * 10.0,
                            "{d:?} {r} {k}: {difference} {}",
                            f[r][k]
                        );
                    }
                }
            }
        }
    }

    #[test]
    fn volumes_are_those_of_the_design() {
        let s = stage();
        let mut rng = Rng::new(4);
        for d in Deformation::ALL {
            let expected = if d == Deformation::Inflate { 3.375 } else { 1.0 };
            for _ in 0..200 {
                let x = s.scene([rng.range(-1.5, 1.5), rng.range(-1.5, 1.5), rng.range(-0.5, s.height + 0.5)]);
                assert!((mat3::det(s.gradient(d, x)) - expected).abs() < 1e-12, "{d:?}");
            }
        }
    }

    #[test]
    fn maps_do_what_their_names_say() {
        let s = Stage { axes: mat3::identity(), origin: [0.0; 3], height: 2.0, diagonal: 3.0, amount: 1.0 };
        let close = |a: Vec3<f64>, b: Vec3<f64>| assert!(vec3::norm(vec3::sub(a, b)) < 1e-12, "{a:?} {b:?}");
        close(s.map(Deformation::Twist, [1.0, 0.0, 2.0]), [0.0, -1.0, 2.0]);
        close(s.map(Deformation::Twist, [1.0, 0.5, 0.0]), [1.0, 0.5, 0.0]);
        close(s.map(Deformation::Stretch, [0.0, 0.0, 1.0]), [0.0, 0.0, 2.0]);
        // ∫ (0.25 + 0.65 t) over the height.
        close(s.map(Deformation::Slump, [0.0, 0.0, 2.0]), [0.0, 0.0, 2.0 * 0.575]);
        close(s.map(Deformation::Slump, [0.5, 0.0, 0.0]), [1.0, 0.0, 0.0]);
        close(s.map(Deformation::Cut, [0.1, 0.2, 0.3]), [0.34, 0.2, 0.3]);
        close(s.map(Deformation::Cut, [-0.1, 0.2, 0.3]), [-0.34, 0.2, 0.3]);
        close(s.partly(0.5).map(Deformation::Cut, [-0.1, 0.2, 0.3]), [-0.22, 0.2, 0.3]);
        assert!((s.gradient(Deformation::Neck, [0.0, 0.3, 0.3])[0][0] - 6.0).abs() < 1e-12);
        let far = s.map(Deformation::Neck, [1.5, 0.2, 0.1]);
        close(far, [1.5 + 5.0 * 0.24 * 0.5 * PI.sqrt(), 0.2, 0.1]);
        // Floaters far outside do not fold over.
        assert!(s.map(Deformation::Slump, [0.0, 0.0, -9.0])[2] < -1.0);
        let built = Stage::new(&[[-1.0, 0.0, 1.0], [3.0, 2.0, 2.0], [0.0, 1.0, 1.5]], mat3::identity()).unwrap();
        close(built.origin, [1.0, 1.0, 1.0]);
        assert!((built.height - 1.0).abs() < 1e-12 && (built.diagonal - 21f64.sqrt()).abs() < 1e-12);
        assert!(Stage::new(&[[0.0; 3]], mat3::identity()).is_none());
    }
}
