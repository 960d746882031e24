//! When something happens and how strongly: intervals, ramps, keyframes, duty cycles (simulation.md §4.7).

use megas_math::quat::{self, Quat};
use megas_math::{Vec3, vec3};
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
        let (Some(first), Some(last)) = (self.keyframes.first(), self.keyframes.last()) else {
            return constant;
        };
        if time <= first[0] {
            return first[1];
        }
        let after = self.keyframes.partition_point(|k| k[0] <= time);
        if after == self.keyframes.len() {
            return last[1];
        }
        let (a, b) = (self.keyframes[after - 1], self.keyframes[after]);
        a[1] + (b[1] - a[1]) * (time - a[0]) / (b[0] - a[0])
    }
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
    /// Translation \[m\] and unit rotation at `time`.
    pub fn pose(&self, time: f64) -> (Vec3<f64>, Quat<f64>) {
        let unit = |q| quat::normalize(q).unwrap_or(no_rotation());
        let keys = &self.0;
        let after = keys.partition_point(|k| k.time <= time);
        match (after.checked_sub(1).map(|i| &keys[i]), keys.get(after)) {
            (None, None) => ([0.0; 3], no_rotation()),
            (Some(k), None) | (None, Some(k)) => (k.translation, unit(k.rotation)),
            (Some(a), Some(b)) => {
                let s = (time - a.time) / (b.time - a.time);
                (vec3::lerp(a.translation, b.translation, s), quat::slerp(unit(a.rotation), unit(b.rotation), s))
            }
        }
    }
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
        let (t, q) = m.pose(1.0);
        assert_eq!(t, [1.0, 0.0, 0.0]);
        assert!((q[0] - (std::f64::consts::FRAC_PI_8).cos()).abs() < 1e-12);
        assert_eq!(m.pose(9.0).0, [2.0, 0.0, 0.0]);
        assert_eq!(Motion::default().pose(1.0).0, [0.0; 3]);
    }
}
