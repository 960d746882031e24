//! When something happens and how strongly: intervals, ramps, keyframes, duty cycles (simulation.md §4.7).

use megas_geometry::Shape;
use megas_math::quat::{self, Quat};
use megas_math::{Mat3, Vec3, mat3, vec3};
use serde::{Deserialize, Serialize};

/// A strength over time. The default is "always on at full strength".
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Schedule {
    /// On intervals `[start, end]` \[s\]; empty means always on. An end may be infinite (any value larger than the run).
    pub intervals: Vec<[f64; 2]>,
    /// Seconds to rise linearly from zero at the start of an interval and to fall to zero before its end; 0 switches.
    pub ramp: f64,
    /// Values over time `[t, value]` with increasing t, linear between, constant outside; they replace the source's number.
    pub keyframes: Vec<[f64; 2]>,
    /// Periodic duty inside the intervals.
    pub duty: Option<Duty>,
}

/// A periodic on/off pattern that starts "on" at t = 0.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Duty {
    /// Length of one cycle \[s\], > 0.
    pub period: f64,
    /// Share of the cycle that is on, 0–1.
    pub on: f64,
}

impl Schedule {
    /// Strength in `[0, 1]` at `time` \[s\].
    pub fn gain(&self, time: f64) -> f64 {
        let mut gain = if self.intervals.is_empty() { 1.0 } else { 0.0 };
        for &[start, end] in &self.intervals {
            if time >= start && time < end {
                let edge = (time - start).min(end - time);
                gain = f64::max(gain, if self.ramp > 0.0 { (edge / self.ramp).min(1.0) } else { 1.0 });
            }
        }
        match self.duty {
            Some(d) if d.period > 0.0 && (time / d.period).rem_euclid(1.0) >= d.on => 0.0,
            _ => gain,
        }
    }

    /// The value at `time`: from the keyframes where there are any, else `constant`.
    pub fn value(&self, time: f64, constant: f64) -> f64 {
        interpolate(&self.keyframes, time).unwrap_or(constant)
    }
}

/// Values over time `[t, value]` with increasing t at `time`: linear between, constant outside; `None` without any.
pub fn interpolate(keyframes: &[[f64; 2]], time: f64) -> Option<f64> {
    let (first, last) = (keyframes.first()?, keyframes.last()?);
    if time <= first[0] {
        return Some(first[1]);
    }
    let after = keyframes.partition_point(|k| k[0] <= time);
    if after == keyframes.len() {
        return Some(last[1]);
    }
    let (a, b) = (keyframes[after - 1], keyframes[after]);
    Some(a[1] + (b[1] - a[1]) * (time - a[0]) / (b[0] - a[0]))
}

/// One key of a rigid motion.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PoseKey {
    /// Time \[s\].
    pub time: f64,
    /// Displacement from the place where the region was defined \[m\].
    #[serde(default)]
    pub translation: Vec3<f64>,
    /// Rotation about the region's own centre, quaternion `[w, x, y, z]`.
    #[serde(default = "no_rotation")]
    pub rotation: Quat<f64>,
}

fn no_rotation() -> Quat<f64> {
    [1.0, 0.0, 0.0, 0.0]
}

/// A rigid motion by keyframes with increasing time: linear translation, spherical interpolation of the rotation, constant
/// outside. Without keys it stands still.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Motion(pub Vec<PoseKey>);

impl Motion {
    /// True without keyframes.
    pub fn is_still(&self) -> bool {
        self.0.is_empty()
    }

    /// Place and speed at `time` of a thing that turns about `pivot` \[m\].
    pub fn at(&self, time: f64, pivot: Vec3<f64>) -> Pose {
        let unit = |q| quat::normalize(q).unwrap_or(no_rotation());
        let keys = &self.0;
        let after = keys.partition_point(|k| k.time <= time);
        match (after.checked_sub(1).map(|i| &keys[i]), keys.get(after)) {
            (None, None) => Pose::REST,
            (Some(k), None) | (None, Some(k)) => Pose::new(pivot, k.translation, unit(k.rotation)),
            (Some(a), Some(b)) => {
                let length = b.time - a.time;
                let (s, from, to) = ((time - a.time) / length, unit(a.rotation), unit(b.rotation));
                let pose = Pose::new(pivot, vec3::lerp(a.translation, b.translation, s), quat::slerp(from, to, s));
                Pose {
                    velocity: vec3::scale(vec3::sub(b.translation, a.translation), length.recip()),
                    spin: vec3::scale(turn(from, to), length.recip()),
                    ..pose
                }
            }
        }
    }
}

/// The rotation vector that leads from `a` to `b` by the shorter way: axis times angle.
fn turn(a: Quat<f64>, b: Quat<f64>) -> Vec3<f64> {
    let q = quat::mul(b, [a[0], -a[1], -a[2], -a[3]]);
    let q = if q[0] < 0.0 { q.map(|c| -c) } else { q };
    let axis = [q[1], q[2], q[3]];
    let sine = vec3::norm(axis);
    vec3::scale(vec3::normalize_or(axis, [0.0; 3]), 2.0 * sine.atan2(q[0]))
}

/// A rigid displacement and its rate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    rotation: Mat3<f64>,
    pivot: Vec3<f64>,
    /// Where the pivot is now \[m\].
    place: Vec3<f64>,
    /// Velocity of the pivot \[m/s\].
    velocity: Vec3<f64>,
    /// Angular velocity \[rad/s\].
    spin: Vec3<f64>,
    still: bool,
}

impl Pose {
    /// No displacement.
    pub const REST: Self = Self {
        rotation: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        pivot: [0.0; 3],
        place: [0.0; 3],
        velocity: [0.0; 3],
        spin: [0.0; 3],
        still: true,
    };

    fn new(pivot: Vec3<f64>, translation: Vec3<f64>, rotation: Quat<f64>) -> Self {
        let place = vec3::add(pivot, translation);
        Self { rotation: quat::to_mat3_unit(rotation), pivot, place, still: false, ..Self::REST }
    }

    /// Where the material point that is now at `x` was before it was displaced.
    #[inline]
    pub fn home(&self, x: Vec3<f64>) -> Vec3<f64> {
        if self.still { x } else { vec3::add(self.pivot, mat3::tmul_vec(self.rotation, vec3::sub(x, self.place))) }
    }

    /// Where a point of the undisplaced thing is now.
    pub fn now(&self, x: Vec3<f64>) -> Vec3<f64> {
        if self.still { x } else { vec3::add(self.place, mat3::mul_vec(self.rotation, vec3::sub(x, self.pivot))) }
    }

    /// A direction of the undisplaced thing as it is now.
    pub fn turned(&self, n: Vec3<f64>) -> Vec3<f64> {
        if self.still { n } else { mat3::mul_vec(self.rotation, n) }
    }

    /// The rotation.
    pub fn rotation(&self) -> Mat3<f64> {
        self.rotation
    }

    /// Velocity of the thing at `x` \[m/s\].
    pub fn velocity_at(&self, x: Vec3<f64>) -> Vec3<f64> {
        vec3::add(self.velocity, vec3::cross(self.spin, vec3::sub(x, self.place)))
    }

    /// Signed distance of `x` from the displaced `shape` \[m\] and its outward normal.
    #[inline]
    pub fn distance(&self, shape: &Shape, x: Vec3<f64>) -> (f64, Vec3<f64>) {
        if self.still {
            return shape.distance(x);
        }
        let (d, n) = shape.distance(self.home(x));
        (d, self.turned(n))
    }
}

/// True at the times of the intervals `[start, end)`, and always if there are none.
pub fn active(intervals: &[[f64; 2]], time: f64) -> bool {
    intervals.is_empty() || intervals.iter().any(|&[start, end]| time >= start && time < end)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gain_follows_intervals_ramp_and_duty() {
        let s = Schedule { intervals: vec![[1.0, 5.0]], ramp: 1.0, ..Schedule::default() };
        for (t, g) in [(0.5, 0.0), (1.25, 0.25), (3.0, 1.0), (4.75, 0.25), (5.0, 0.0)] {
            assert!((s.gain(t) - g).abs() < 1e-12, "t = {t}");
        }
        let d = Schedule { duty: Some(Duty { period: 2.0, on: 0.25 }), ..Schedule::default() };
        assert_eq!([0.1, 0.6, 2.4, 3.9].map(|t| d.gain(t)), [1.0, 0.0, 1.0, 0.0]);
        assert_eq!(Schedule::default().gain(1e9), 1.0);
    }

    #[test]
    fn keyframes_replace_the_constant() {
        let s = Schedule { keyframes: vec![[0.0, 300.0], [2.0, 400.0], [2.0, 350.0], [4.0, 350.0]], ..Schedule::default() };
        assert_eq!([-1.0, 1.0, 2.0, 9.0].map(|t| s.value(t, 0.0)), [300.0, 350.0, 350.0, 350.0]);
        assert_eq!(Schedule::default().value(3.0, 7.0), 7.0);
    }

    #[test]
    fn motion_interpolates_and_holds() {
        let half = std::f64::consts::FRAC_1_SQRT_2;
        let m = Motion(vec![
            PoseKey { time: 0.0, translation: [0.0; 3], rotation: no_rotation() },
            PoseKey { time: 2.0, translation: [2.0, 0.0, 0.0], rotation: [half, 0.0, 0.0, half] },
        ]);
        // The pivot moves at 1 m/s while the thing turns by a quarter in two seconds.
        let pose = m.at(1.0, [0.0, 5.0, 0.0]);
        assert_eq!(pose.now([0.0, 5.0, 0.0]), [1.0, 5.0, 0.0]);
        let tip = pose.now([1.0, 5.0, 0.0]);
        assert!(vec3::norm(vec3::sub(tip, [1.0 + half, 5.0 + half, 0.0])) < 1e-12);
        assert!(vec3::norm(vec3::sub(pose.home(tip), [1.0, 5.0, 0.0])) < 1e-12);
        let h = 1e-6;
        let moved = vec3::scale(vec3::sub(m.at(1.0 + h, [0.0, 5.0, 0.0]).now([1.0, 5.0, 0.0]), tip), 1.0 / h);
        assert!(vec3::norm(vec3::sub(moved, pose.velocity_at(tip))) < 1e-5);
        let late = m.at(9.0, [0.0; 3]);
        assert_eq!((late.now([0.0; 3]), late.velocity_at([1.0; 3])), ([2.0, 0.0, 0.0], [0.0; 3]));
        assert_eq!(Motion::default().at(1.0, [3.0; 3]), Pose::REST);
    }

    #[test]
    fn distances_move_with_the_thing() {
        let shape = Shape::Capsule { a: [1.0, 0.0, 0.0], b: [2.0, 1.0, 0.0], radius: 0.3 };
        let q = quat::from_axis_angle(vec3::normalize_or([1.0, 2.0, 3.0], [1.0, 0.0, 0.0]), 0.7);
        let pose = Motion(vec![PoseKey { time: 0.0, translation: [0.1, -0.2, 0.3], rotation: q }]).at(0.0, shape.pivot());
        let x = [0.4, 0.9, -0.6];
        let (d, n) = pose.distance(&shape, pose.now(x));
        assert!((shape.distance(x).0 - d).abs() < 1e-12);
        assert!(pose.distance(&shape, vec3::add_scaled(pose.now(x), n, -d)).0.abs() < 1e-12);
        assert!(active(&[], 3.0) && active(&[[1.0, 2.0], [3.0, 4.0]], 3.5) && !active(&[[1.0, 2.0]], 2.0));
    }
}
