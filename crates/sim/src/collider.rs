//! Solid obstacles as conditions on nodes (simulation.md §6.1, §6.3): motion, contact modes, friction, what they do to heat.

use megas_geometry::OnSheet;
pub use megas_geometry::{Shape, Sheet};
use megas_math::{Vec3, vec3};
use serde::{Deserialize, Serialize};

use crate::schedule::{Motion, Pose, active};

/// What happens to velocity at a node inside the obstacle.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Mode {
    /// Takes the obstacle's velocity.
    Sticky,
    /// Keeps the tangential part.
    Slip,
    /// Slides with Coulomb friction and may leave (default of scenes).
    Separate,
}

/// What an obstacle does to the heat of the material that touches it (simulation.md §6.3).
#[derive(Clone, Debug, Default, PartialEq)]
pub enum Thermal {
    /// Nothing.
    #[default]
    Adiabatic,
    /// Its surface has a given temperature, whatever it takes: a hot plate.
    Fixed {
        /// Temperature \[K\].
        kelvin: f64,
        /// Temperatures over time `[t, K]` with increasing t, linear between, constant outside; they replace `kelvin`.
        keyframes: Vec<[f64; 2]>,
    },
    /// It stores and conducts heat itself: a stove slab, a pan, a poker.
    Conducting(Conductor),
}

/// The inside of an obstacle that takes part in the heat. One at rest has a temperature in every node; one that moves has a
/// single temperature, as if it conducted perfectly.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Conductor {
    /// Temperature at the start \[K\].
    pub kelvin: f64,
    /// Heat capacity per volume ρc \[J/(m³·K)\], > 0.
    pub volumetric_capacity: f64,
    /// Conductivity \[W/(m·K)\], > 0.
    pub conductivity: f64,
    /// Heating spread over its inside \[W\].
    pub watts: f64,
}

/// An obstacle, perhaps a moving one.
#[derive(Clone, Debug, PartialEq)]
pub struct Collider {
    /// Name for messages.
    pub name: String,
    /// Geometry. A [`Shape::Sheet`] holds matter on both of its sides apart; there may be [`MAX_SHEETS`] of them, the others are not
    /// there. It does nothing to heat.
    pub shape: Shape,
    /// Contact rule.
    pub mode: Mode,
    /// Coulomb friction of [`Mode::Separate`], ≥ 0.
    pub friction: f64,
    /// Nodes with a distance below this are in contact \[node spacings\]; −0.5 for visual contact, 0 for analytic tests, 0.5 for sheets.
    pub offset: f64,
    /// [`Mode::Separate`] turns sticky where more than half of the node's mass is liquid.
    pub melt_sticks: bool,
    /// Rigid motion about [`Shape::pivot`].
    pub motion: Motion,
    /// Times `[start, end)` \[s\] at which it exists; always if empty.
    pub active: Vec<[f64; 2]>,
    /// What it does to heat.
    pub thermal: Thermal,
}

/// Contact level of scene colliders \[node spacings\]: the kernel sees a wall half a node early.
pub const SCENE_CONTACT_OFFSET: f64 = -0.5;

/// Contact level of sheets \[node spacings\]: nodes up to half a spacing before them are held, and all that are felt through them; so a
/// sheet is where it is, on the average over its places between nodes.
pub const SHEET_CONTACT_OFFSET: f64 = 0.5;

impl Collider {
    /// A scene collider: at rest, separate, friction 0.4, half a spacing of overlap (a sheet is felt half a spacing early), melts stick,
    /// adiabatic.
    pub fn new(shape: Shape) -> Self {
        let offset = if matches!(shape, Shape::Sheet(_)) { SHEET_CONTACT_OFFSET } else { SCENE_CONTACT_OFFSET };
        Self {
            name: String::new(),
            shape,
            mode: Mode::Separate,
            friction: 0.4,
            offset,
            melt_sticks: true,
            motion: Motion::default(),
            active: Vec::new(),
            thermal: Thermal::Adiabatic,
        }
    }

    /// True for a thin sheet.
    pub fn is_sheet(&self) -> bool {
        matches!(self.shape, Shape::Sheet(_))
    }

    /// True if it is always there and never moves.
    pub fn is_static(&self) -> bool {
        self.motion.is_still() && self.active.is_empty()
    }

    /// Its place at `time` \[s\]; `None` while it does not exist.
    pub fn at(&self, time: f64) -> Option<Pose> {
        active(&self.active, time).then(|| self.motion.at(time, self.shape.pivot()))
    }

    /// Upper bound of the speed \[m/s\] of its surface within the box from `lo` to `hi`, at `time`.
    pub(crate) fn speed(&self, time: f64, lo: Vec3<f64>, hi: Vec3<f64>) -> f64 {
        let Some(pose) = self.at(time).filter(|_| !self.motion.is_still()) else { return 0.0 };
        let corner = |lo: Vec3<f64>, hi: Vec3<f64>, i: usize| std::array::from_fn(|a| if i >> a & 1 == 1 { hi[a] } else { lo[a] });
        let speed = |x| vec3::norm(pose.velocity_at(x));
        let most = |f: &dyn Fn(usize) -> f64| (0..8).map(f).fold(0.0, f64::max);
        let anywhere = most(&|i| speed(corner(lo, hi, i)));
        match self.shape.bounds() {
            // Rates are affine in space: largest in a corner.
            Some((a, b)) => most(&|i| speed(pose.now(corner(a, b, i)))).min(anywhere),
            None => anywhere,
        }
    }
}

/// Most sheets in a list of colliders: points remember a side of each.
pub const MAX_SHEETS: usize = 16;

/// An obstacle where it is now.
pub(crate) struct Placed<'a> {
    /// Its place in the list.
    pub index: u16,
    /// Its number among the sheets of the list, whether they are there or not; `None` for one with an inside.
    pub sheet: Option<u8>,
    pub collider: &'a Collider,
    pub pose: Pose,
}

/// The obstacles that exist at `time`.
pub(crate) fn placed(colliders: &[Collider], time: f64) -> Vec<Placed<'_>> {
    let mut numbers = 0..MAX_SHEETS as u8;
    let mut out = Vec::with_capacity(colliders.len());
    for (k, collider) in colliders.iter().enumerate() {
        let sheet = if collider.is_sheet() { numbers.next() } else { None };
        // A sheet without a number is one too many.
        if collider.is_sheet() == sheet.is_some()
            && let Some(pose) = collider.at(time)
        {
            out.push(Placed { index: k as u16, sheet, collider, pose });
        }
    }
    out
}

impl Placed<'_> {
    /// Signed distance \[m\] and outward normal.
    #[inline]
    pub fn distance(&self, x: Vec3<f64>) -> (f64, Vec3<f64>) {
        self.pose.distance(&self.collider.shape, x)
    }

    /// The contact of a node at `x`, if it is held.
    pub fn contact(&self, node: u8, x: Vec3<f64>, spacing: f64) -> Option<Contact> {
        let (d, normal) = self.distance(x);
        (self.sheet.is_none() && d < self.collider.offset * spacing).then(|| self.contact_with(node, normal, x))
    }

    /// What a node feels that is held where the obstacle is at `x` and faces `normal`.
    pub fn contact_with(&self, node: u8, normal: Vec3<f64>, x: Vec3<f64>) -> Contact {
        let c = self.collider;
        Contact {
            node,
            collider: self.index,
            mode: c.mode,
            melt_sticks: c.melt_sticks,
            friction: c.friction as f32,
            normal: vec3::cast(normal),
            velocity: vec3::cast(self.pose.velocity_at(x)),
        }
    }

    /// Where `x` is against this sheet, if that is nearer than `reach` \[m\].
    pub fn on_sheet(&self, x: Vec3<f64>, reach: f64) -> Option<OnSheet> {
        let Shape::Sheet(sheet) = &self.collider.shape else { return None };
        let at = sheet.near(self.pose.home(x), reach)?;
        Some(OnSheet { normal: self.pose.turned(at.normal), point: self.pose.now(at.point), ..at })
    }
}

/// One node held by one obstacle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Contact {
    /// Node inside its block of 4³.
    pub node: u8,
    /// Place of the obstacle in the list.
    pub collider: u16,
    pub mode: Mode,
    pub melt_sticks: bool,
    pub friction: f32,
    pub normal: [f32; 3],
    /// Velocity of the obstacle here \[m/s\].
    pub velocity: [f32; 3],
}

impl Contact {
    /// The velocity after this contact; `liquid` is the liquid share of the node's mass.
    #[inline]
    fn apply(&self, v: [f32; 3], liquid: f32) -> [f32; 3] {
        let relative = vec3::sub(v, self.velocity);
        let vn = vec3::dot(relative, self.normal);
        let tangential = vec3::add_scaled(relative, self.normal, -vn);
        let kept = match self.mode {
            Mode::Sticky => [0.0; 3],
            Mode::Slip => tangential,
            Mode::Separate if vn >= 0.0 => return v,
            Mode::Separate if self.melt_sticks && liquid > 0.5 => [0.0; 3],
            Mode::Separate => {
                let vt = vec3::norm(tangential);
                let keep = if vt > 0.0 { (1.0 + self.friction * vn / vt).max(0.0) } else { 0.0 };
                vec3::scale(tangential, keep)
            }
        };
        vec3::add(self.velocity, kept)
    }

    /// True if `v` enters the obstacle by more than rounding.
    #[inline]
    fn entered(&self, v: [f32; 3], size: f32) -> bool {
        vec3::dot(vec3::sub(v, self.velocity), self.normal) < -1e-6 * size
    }
}

/// Velocity of a node after all obstacles that hold it: each in list order, then the first again, and at rest with the first
/// where they still contradict each other (the corner rule of simulation.md §6.1).
#[inline]
pub(crate) fn apply_contacts(contacts: &[Contact], mut v: [f32; 3], liquid: f32) -> [f32; 3] {
    for c in contacts {
        v = c.apply(v, liquid);
    }
    if let [first, _, ..] = contacts {
        v = first.apply(v, liquid);
        let size = vec3::norm(v).max(vec3::norm(first.velocity));
        if contacts.iter().any(|c| c.entered(v, size)) {
            return first.velocity;
        }
    }
    v
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn contact_modes_follow_coulomb_and_corners_come_to_rest() {
        let up = Contact {
            node: 0,
            collider: 0,
            mode: Mode::Separate,
            melt_sticks: true,
            friction: 0.5,
            normal: [0.0, 0.0, 1.0],
            velocity: [0.0; 3],
        };
        assert_eq!(up.apply([1.0, 0.0, 2.0], 0.0), [1.0, 0.0, 2.0]);
        assert_eq!(up.apply([1.0, 0.0, -1.0], 0.0), [0.5, 0.0, 0.0]);
        assert_eq!(up.apply([1.0, 0.0, -3.0], 0.0), [0.0; 3]);
        assert_eq!(up.apply([1.0, 0.0, -1.0], 0.9), [0.0; 3]);
        let slip = Contact { mode: Mode::Slip, ..up };
        assert_eq!(slip.apply([1.0, 2.0, -3.0], 0.0), [1.0, 2.0, 0.0]);
        assert_eq!(Contact { mode: Mode::Sticky, ..up }.apply([1.0, 2.0, 3.0], 0.0), [0.0; 3]);
        // Two opposed oblique planes: no velocity satisfies both except the common tangent.
        let s = 0.5f32.sqrt();
        let a = Contact { friction: 0.0, normal: [s, 0.0, s], ..up };
        let b = Contact { friction: 0.0, normal: [-s, 0.0, s], ..up };
        let v = apply_contacts(&[a, b], [0.0, 1.0, -1.0], 0.0);
        for c in [a, b] {
            assert!(vec3::dot(v, c.normal) >= -1e-6);
        }
        // An acute wedge: each projection pushes into the other wall.
        let c = Contact { friction: 0.0, normal: [0.98, 0.0, 0.199], ..up };
        let d = Contact { friction: 0.0, normal: [-0.98, 0.0, 0.199], ..up };
        assert_eq!(apply_contacts(&[c, d], [0.0, 0.0, -1.0], 0.0), [0.0; 3]);
    }

    #[test]
    fn moving_obstacles_are_obstacles_at_rest_seen_from_them() {
        let normal = [0.6, 0.0, 0.8];
        let still = Contact { node: 0, collider: 0, mode: Mode::Separate, melt_sticks: true, friction: 0.3, normal, velocity: [0.0; 3] };
        let u = [0.5, -0.25, 2.0];
        for mode in [Mode::Separate, Mode::Slip, Mode::Sticky] {
            for (v, liquid) in [([1.0, 2.0, -3.0], 0.0), ([1.0, 2.0, 3.0], 0.0), ([1.0, 2.0, -3.0], 0.9)] {
                let still = Contact { mode, ..still };
                let moving = Contact { velocity: u, ..still };
                let (a, b) = (still.apply(v, liquid), moving.apply(vec3::add(v, u), liquid));
                assert!(vec3::norm(vec3::sub(vec3::add(a, u), b)) < 1e-6, "{mode:?}");
            }
        }
        // A piston pushes material along the floor that holds it as well.
        let floor = Contact { normal: [0.0, 0.0, 1.0], friction: 0.0, ..still };
        let piston = Contact { normal: [1.0, 0.0, 0.0], friction: 0.0, velocity: [0.2, 0.0, 0.0], ..still };
        assert_eq!(apply_contacts(&[floor, piston], [0.0, 0.1, -1.0], 0.0), [0.2, 0.1, 0.0]);
    }

    #[test]
    fn speeds_bound_the_surface() {
        use crate::schedule::PoseKey;
        let half = std::f64::consts::FRAC_1_SQRT_2;
        let keys = vec![
            PoseKey { time: 0.0, translation: [0.0; 3], rotation: [1.0, 0.0, 0.0, 0.0] },
            PoseKey { time: 1.0, translation: [0.5, 0.0, 0.0], rotation: [half, 0.0, 0.0, half] },
        ];
        let bar = Collider { motion: Motion(keys), ..Collider::new(Shape::aligned_box([-1.0, -0.1, -0.1], [1.0, 0.1, 0.1])) };
        // The tip moves with the pivot and a quarter turn per second at a lever of one metre.
        let most = bar.speed(0.5, [-9.0; 3], [9.0; 3]);
        let tip = 0.5 + std::f64::consts::FRAC_PI_2 * 1.01f64.sqrt();
        assert!(most <= tip + 1e-9 && most > 0.8 * tip, "{most} {tip}");
        assert_eq!(bar.speed(1.5, [-9.0; 3], [9.0; 3]), 0.0);
        assert!(Collider { active: vec![[2.0, 3.0]], ..bar }.at(1.0).is_none());
    }
}
