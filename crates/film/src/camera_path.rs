//! Cameras that move: orbits and keyframes.

use megas_math::{Vec3, vec3};
use megas_model::Camera;

use crate::error::{Result, mismatch};

/// How far an orbiting camera stands.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Distance {
    /// From the target \[scene units\].
    Fixed(f32),
    /// So that a sphere around the target just fits into the picture, whatever its shape.
    Fit {
        /// Radius of the object \[scene units\].
        radius: f32,
        /// Extra room, ≥ 1: things that melt spread. [`FIT_FACTOR`] suits most.
        factor: f32,
    },
}

/// Room for a puddle: about a third wider than the object was.
pub const FIT_FACTOR: f32 = 1.35;

/// A camera on a circle around a target.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Orbit {
    /// Point in the middle of the picture.
    pub target: Vec3<f32>,
    /// Distance from it.
    pub distance: Distance,
    /// Height above the horizon as seen from the target \[degrees\], clamped to ±89.
    pub elevation: f32,
    /// Direction at time 0 \[degrees\], counter-clockwise seen from above; 0 is the scene's +x (+y where x is up).
    pub azimuth: f32,
    /// Turning speed \[degrees per second\].
    pub speed: f32,
    /// Up direction of the scene, any length but 0.
    pub up: Vec3<f32>,
    /// Vertical field of view \[degrees\], 1–160.
    pub fov_y: f32,
}

impl Orbit {
    /// The camera at time `t` \[s\] for a picture of `width` × `height` pixels.
    pub fn camera_at(&self, t: f64, width: u32, height: u32) -> Camera {
        let up = vec3::normalize_or(self.up, [0.0, 0.0, 1.0]);
        let side = if up[0].abs() > 0.9 { [0.0, 1.0, 0.0] } else { [1.0, 0.0, 0.0] };
        let a = vec3::normalize_or(vec3::add_scaled(side, up, -vec3::dot(side, up)), side);
        let b = vec3::cross(up, a);
        let fov = self.fov_y.clamp(1.0, 160.0).to_radians();
        let distance = match self.distance {
            Distance::Fixed(d) => d,
            Distance::Fit { radius, factor } => {
                // The sphere touches the frustum's planes on the narrower side.
                let half = (0.5 * fov).tan() * (width as f32 / height as f32).min(1.0);
                radius * factor / half.atan().sin()
            }
        };
        // In double precision: after an hour of film the angle still moves evenly.
        let azimuth = (f64::from(self.azimuth) + f64::from(self.speed) * t).rem_euclid(360.0).to_radians();
        let (sa, ca) = azimuth.sin_cos();
        let (se, ce) = self.elevation.clamp(-89.0, 89.0).to_radians().sin_cos();
        let level = vec3::add(vec3::scale(a, ca as f32), vec3::scale(b, sa as f32));
        let direction = vec3::add(vec3::scale(level, ce), vec3::scale(up, se));
        Camera::look_at(vec3::add_scaled(self.target, direction, distance), self.target, up, fov, width, height)
    }
}

/// Where a camera is at one time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Keyframe {
    /// Time \[s\].
    pub time: f64,
    /// Position.
    pub eye: Vec3<f32>,
    /// Point in the middle of the picture.
    pub target: Vec3<f32>,
    /// Vertical field of view \[degrees\], 1–160.
    pub fov_y: f32,
}

/// A camera that passes through keyframes. It starts and ends at rest, passes every keyframe exactly, moves smoothly between
/// them, never overshoots, and stands still between equal ones (monotone cubic interpolation of each coordinate).
#[derive(Clone, Debug, PartialEq)]
pub struct KeyframePath {
    keys: Vec<Keyframe>,
    /// Rate of change of the seven coordinates at each keyframe.
    slopes: Vec<[f64; 7]>,
    up: Vec3<f32>,
}

impl Keyframe {
    fn coordinates(&self) -> [f64; 7] {
        let (e, t) = (self.eye, self.target);
        [e[0], e[1], e[2], t[0], t[1], t[2], self.fov_y].map(f64::from)
    }
}

impl KeyframePath {
    /// A path through `keys`, whose times must increase; `up` is the scene's up direction.
    pub fn new(keys: Vec<Keyframe>, up: Vec3<f32>) -> Result<Self> {
        if keys.is_empty() {
            return Err(mismatch("a camera path without keyframes", "at least one"));
        }
        for (k, key) in keys.iter().enumerate() {
            if !key.time.is_finite() || !key.coordinates().iter().all(|v| v.is_finite()) {
                return Err(mismatch(format!("a value in camera keyframe {k} that is not finite"), "finite numbers"));
            }
            if !(1.0..=160.0).contains(&key.fov_y) {
                return Err(mismatch(format!("a field of view of {}° in camera keyframe {k}", key.fov_y), "1° to 160°"));
            }
            if key.eye == key.target {
                return Err(mismatch(format!("camera keyframe {k} at its own target"), "different points"));
            }
        }
        if let Some(w) = keys.windows(2).find(|w| w[1].time <= w[0].time) {
            return Err(mismatch(format!("camera keyframes at {} s and then {} s", w[0].time, w[1].time), "increasing times"));
        }
        let mut slopes = vec![[0.0; 7]; keys.len()];
        for (w, slope) in keys.windows(3).zip(&mut slopes[1..]) {
            let (h0, h1) = (w[1].time - w[0].time, w[2].time - w[1].time);
            let [a, b, c] = [w[0], w[1], w[2]].map(|k| k.coordinates());
            for k in 0..7 {
                let (d0, d1) = ((b[k] - a[k]) / h0, (c[k] - b[k]) / h1);
                // Fritsch–Butland: the weighted harmonic mean, zero at turning points.
                if d0 * d1 > 0.0 {
                    let (w0, w1) = (2.0 * h1 + h0, h1 + 2.0 * h0);
                    slope[k] = (w0 + w1) / (w0 / d0 + w1 / d1);
                }
            }
        }
        Ok(Self { keys, slopes, up })
    }

    /// The camera at time `t` \[s\] for a picture of `width` × `height` pixels; before the first and after the last keyframe
    /// it stays there.
    pub fn camera_at(&self, t: f64, width: u32, height: u32) -> Camera {
        let next = self.keys.partition_point(|k| k.time <= t);
        let c = if next == 0 {
            self.keys[0].coordinates()
        } else if next == self.keys.len() {
            self.keys[next - 1].coordinates()
        } else {
            let i = next - 1;
            let h = self.keys[next].time - self.keys[i].time;
            let s = (t - self.keys[i].time) / h;
            let (a, b) = (self.keys[i].coordinates(), self.keys[next].coordinates());
            std::array::from_fn(|k| {
                let (ma, mb, d) = (h * self.slopes[i][k], h * self.slopes[next][k], b[k] - a[k]);
                a[k] + s * (ma + s * ((3.0 * d - 2.0 * ma - mb) + s * (ma + mb - 2.0 * d)))
            })
        };
        let v = c.map(|v| v as f32);
        Camera::look_at([v[0], v[1], v[2]], [v[3], v[4], v[5]], self.up, v[6].to_radians(), width, height)
    }
}

/// A moving camera.
#[derive(Clone, Debug, PartialEq)]
pub enum CameraPath {
    /// Around a target.
    Orbit(Orbit),
    /// Through keyframes.
    Keyframes(KeyframePath),
}

impl CameraPath {
    /// The camera at time `t` \[s\] for a picture of `width` × `height` pixels.
    pub fn camera_at(&self, t: f64, width: u32, height: u32) -> Camera {
        match self {
            Self::Orbit(o) => o.camera_at(t, width, height),
            Self::Keyframes(k) => k.camera_at(t, width, height),
        }
    }
}
