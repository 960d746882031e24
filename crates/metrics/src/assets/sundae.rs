//! Three scoops of ice cream with chocolate sauce, a cherry and a wafer in a waffle bowl on a small round wooden table: the
//! geometry. One scene unit is 0.1 m; the object stands on the table top at z = 0 and is about 1.5 units tall.
//!
//! The object is one closed solid: the bowl is filled with ice cream, so the union has no hidden cavities, and [`Sundae::part`]
//! tells which material sits where. The bowl's wall is a good one and a half simulation cells at 24 cells per object.

use megas_math::{Vec3, rng::hash01, vec3};

use super::{
    light::{Light, Received},
    noise::{noise_at, smoothstep},
    primitives::{RoundCone, ball, disc, smax, smin},
    solid::{Hit, Solid, gradient},
    sundae_colour,
};

/// Real size of one scene unit of the sundae \[m\].
pub const METRES_PER_UNIT: f32 = 0.1;
/// Height of the table's top: the support plane under the object.
pub const TABLE_HEIGHT: f32 = 0.0;
/// Radius of the table top.
pub const TABLE_RADIUS: f32 = 1.34;

/// Thickness of the bowl's wall.
const WALL: f32 = 0.10;
/// Mean height of the bowl's rim.
const RIM: f32 = 0.53;
const SCOOP_RADIUS: f32 = 0.385;
const SCOOPS: [Vec3<f32>; 3] = [[-0.31, -0.17, 0.76], [0.32, -0.13, 0.74], [-0.01, 0.30, 0.86]];
const CHERRY: (Vec3<f32>, f32) = ([-0.03, 0.27, 1.335], 0.118);
const WAFER: (Vec3<f32>, Vec3<f32>, f32) = ([0.17, 0.16, 0.60], [0.50, 0.44, 1.50], 0.064);

/// The things of the scene; the number is the `object_id` of their splats, 0 being the static background.
#[repr(u8)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Part {
    /// The wooden table.
    Table = 0,
    /// The waffle bowl.
    Bowl = 1,
    /// The pink scoop.
    Strawberry = 2,
    /// The green scoop.
    Pistachio = 3,
    /// The cream-coloured scoop.
    Vanilla = 4,
    /// Chocolate sauce.
    Sauce = 5,
    /// The rolled wafer.
    Wafer = 6,
    /// The cherry.
    Cherry = 7,
}

impl Part {
    /// All parts by number.
    pub const ALL: [Self; 8] =
        [Self::Table, Self::Bowl, Self::Strawberry, Self::Pistachio, Self::Vanilla, Self::Sauce, Self::Wafer, Self::Cherry];

    /// Lower-case name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Table => "table",
            Self::Bowl => "bowl",
            Self::Strawberry => "strawberry",
            Self::Pistachio => "pistachio",
            Self::Vanilla => "vanilla",
            Self::Sauce => "sauce",
            Self::Wafer => "wafer",
            Self::Cherry => "cherry",
        }
    }

    /// True for the parts that are ice cream.
    pub fn is_ice_cream(self) -> bool {
        matches!(self, Self::Strawberry | Self::Pistachio | Self::Vanilla)
    }
}

/// The embedded scene. Building it computes the light volume (a fraction of a second); everything else is a pure function.
pub struct Sundae {
    sauce: [Vec<Tongue>; 3],
    wafer: RoundCone,
    light: Light,
}

impl Default for Sundae {
    fn default() -> Self {
        Self::new()
    }
}

impl Sundae {
    /// Builds the scene.
    pub fn new() -> Self {
        let sauce = std::array::from_fn(drips);
        let wafer = RoundCone::new(WAFER.0, WAFER.1, WAFER.2, WAFER.2);
        let mut s = Self { sauce, wafer, light: Light::empty() };
        s.light = Light::new(s.object_bounds(), |x| s.object_sdf(x), table, (TABLE_HEIGHT, TABLE_RADIUS));
        s
    }

    /// Box of the object without the table.
    pub fn object_bounds(&self) -> (Vec3<f32>, Vec3<f32>) {
        ([-0.86, -0.86, 0.0], [0.86, 0.86, 1.58])
    }

    /// Box of the table.
    pub fn table_bounds(&self) -> (Vec3<f32>, Vec3<f32>) {
        ([-TABLE_RADIUS, -TABLE_RADIUS, -0.56], [TABLE_RADIUS, TABLE_RADIUS, TABLE_HEIGHT])
    }

    /// Signed distance of the object alone (everything that stands on the table).
    pub fn object_sdf(&self, x: Vec3<f32>) -> f32 {
        let (bowl, fill) = bowl_and_fill(x);
        let mut d = bowl.min(fill).min(self.wafer_sdf(x)).min(ball(x, CHERRY.0, CHERRY.1));
        for k in 0..3 {
            d = d.min(self.sauce_sdf(x, k, d));
        }
        for k in 0..3 {
            d = d.min(scoop(x, k, d));
        }
        d
    }

    /// Signed distance of the table alone.
    pub fn table_sdf(&self, x: Vec3<f32>) -> f32 {
        table(x)
    }

    /// Signed distance of one part. The scoops share the ice cream that fills the bowl below them.
    pub fn part_sdf(&self, x: Vec3<f32>, part: Part) -> f32 {
        match part {
            Part::Table => table(x),
            Part::Bowl => bowl_and_fill(x).0,
            Part::Strawberry => scoop(x, 0, f32::INFINITY),
            Part::Pistachio => scoop(x, 1, f32::INFINITY),
            Part::Vanilla => scoop(x, 2, f32::INFINITY),
            Part::Sauce => (0..3).fold(f32::INFINITY, |d, k| d.min(self.sauce_sdf(x, k, d))),
            Part::Wafer => self.wafer_sdf(x),
            Part::Cherry => ball(x, CHERRY.0, CHERRY.1),
        }
    }

    /// The part a point belongs to: inside, the material that fills it (cherry, wafer, bowl and sauce displace ice cream); at
    /// and beyond the surface, the nearest one.
    pub fn part(&self, x: Vec3<f32>) -> Part {
        // A point this far inside a part belongs to it whatever else claims it; nearer than that the surface decides.
        const INSIDE: f32 = -0.004;
        let mut nearest = (f32::INFINITY, Part::Table);
        for part in [Part::Cherry, Part::Wafer, Part::Bowl, Part::Sauce, Part::Table] {
            let d = self.part_sdf(x, part);
            if d < INSIDE {
                return part;
            }
            if d < nearest.0 {
                nearest = (d, part);
            }
        }
        let scoops = [Part::Strawberry, Part::Pistachio, Part::Vanilla].map(|p| (self.part_sdf(x, p), p));
        let best = scoops.iter().copied().fold((f32::INFINITY, Part::Vanilla), |a, b| if b.0 < a.0 { b } else { a });
        if best.0.min(bowl_and_fill(x).1) < nearest.0 { best.1 } else { nearest.1 }
    }

    /// Outward normal of the object alone.
    pub fn object_normal(&self, x: Vec3<f32>) -> Vec3<f32> {
        gradient(|p| self.object_sdf(p), x, 1e-3)
    }

    /// Colour for material that a cut or a melt exposes: the solid colour under the scene's average light, so that an opened
    /// interior looks like ice cream; display-referred sRGB.
    pub fn interior_colour(&self, x: Vec3<f32>) -> [f32; 3] {
        self.light.interior(sundae_colour::albedo(self, x, self.part(x)))
    }

    /// The light of the scene.
    pub(super) fn light(&self) -> &Light {
        &self.light
    }

    fn wafer_sdf(&self, x: Vec3<f32>) -> f32 {
        let d = self.wafer.sdf(x);
        // A flat cut at the upper end, with a shallow hole as of a rolled wafer.
        let axis = vec3::normalize_or(vec3::sub(WAFER.1, WAFER.0), [0.0, 0.0, 1.0]);
        let along = vec3::dot(vec3::sub(x, WAFER.1), axis);
        smax(d, along, 0.02)
    }

    /// Distance of the sauce on scoop `k`; anything not below `limit` may stand for a larger value.
    fn sauce_sdf(&self, x: Vec3<f32>, k: usize, limit: f32) -> f32 {
        let c = SCOOPS[k];
        let bound = ball(x, c, SCOOP_RADIUS + 0.08);
        if bound > 0.12 || bound > limit {
            return bound;
        }
        // A lens on top of the scoop, slightly lumpy, and the tongues that run down from it.
        let p = vec3::sub(x, c);
        let lens = vec3::norm([p[0] * 1.02, p[1] * 1.02, p[2] - 0.125]) - 0.292;
        let mut d = lens;
        for t in &self.sauce[k] {
            // The blend reaches as far as its fillet: beyond that a tongue changes nothing.
            if ball(x, t.centre, t.radius) < d + FILLET {
                for s in &t.parts {
                    d = smin(d, s.sdf(x), FILLET);
                }
            }
        }
        if d > limit + 0.01 || d.abs() > 0.06 {
            return d;
        }
        d + smoothstep(0.06, 0.03, d.abs()) * 0.006 * noise_at(x, 7.0, 3.0 + k as f32)
    }
}

/// One tongue of sauce: an arc over its scoop.
struct Tongue {
    parts: [RoundCone; 3],
    /// Ball around it.
    centre: Vec3<f32>,
    radius: f32,
}

/// Fillet between the tongues and the rest of the sauce.
const FILLET: f32 = 0.07;

impl Solid for Sundae {
    fn sdf(&self, x: Vec3<f32>) -> f32 {
        self.object_sdf(x).min(table(x))
    }

    fn bounds(&self) -> (Vec3<f32>, Vec3<f32>) {
        let (o, t) = (self.object_bounds(), self.table_bounds());
        (vec3::min(o.0, t.0), vec3::max(o.1, t.1))
    }

    fn albedo(&self, x: Vec3<f32>) -> [f32; 3] {
        sundae_colour::albedo(self, x, self.part(x))
    }

    fn shade(&self, hits: &[Hit]) -> [f32; 3] {
        let mut sum = [0.0; 3];
        let mut last: Option<(Part, Hit, Received)> = None;
        for h in hits {
            let part = self.part(h.position);
            // Arriving light varies slowly: neighbouring rays that meet the same part nearby share it.
            let same = last.as_ref().is_some_and(|(p, at, _)| {
                *p == part && vec3::norm(vec3::sub(at.position, h.position)) < 0.02 && vec3::dot(at.normal, h.normal) > 0.8
            });
            if !same {
                last = Some((part, *h, self.light.receive(h.position, h.normal)));
            }
            if let Some((_, _, lit)) = &last {
                let albedo = sundae_colour::albedo(self, h.position, part);
                sum = vec3::add(sum, self.light.shade(lit, h.normal, h.direction, albedo, sundae_colour::finish(part)));
            }
        }
        vec3::scale(sum, 1.0 / hits.len().max(1) as f32)
    }
}

/// The tongues of sauce on scoop `k`: arcs over the scoop that start in the lens and end in a drop.
fn drips(k: usize) -> Vec<Tongue> {
    const COUNT: u64 = 8;
    let mut out = Vec::new();
    for i in 0..COUNT {
        let h = |purpose: u64| hash01(7 + k as u64, i, purpose) as f32;
        let azimuth = std::f32::consts::TAU * (i as f32 + 0.55 * h(1)) / COUNT as f32;
        let end = 0.80 + 0.75 * h(2) * h(2) + 0.25 * h(5);
        let lean = 0.25 * (h(3) - 0.5);
        let width = 0.036 + 0.014 * h(4);
        let at = |t: f32| {
            let theta = 0.45 + (end - 0.45) * t;
            let phi = azimuth + lean * t * t;
            let r = SCOOP_RADIUS + 0.004;
            let d = [theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos()];
            vec3::add_scaled(SCOOPS[k], d, r)
        };
        let radius = |t: f32| width * (1.25 - 0.55 * t + 0.45 * t * t * t);
        let parts = std::array::from_fn(|s| {
            let (a, b) = (s as f32 / 3.0, (s + 1) as f32 / 3.0);
            RoundCone::new(at(a), at(b), radius(a), radius(b))
        });
        let centre = vec3::lerp(at(0.0), at(1.0), 0.5);
        let reach = (0..=3).map(|s| vec3::norm(vec3::sub(at(s as f32 / 3.0), centre)) + radius(s as f32 / 3.0)).fold(0.0, f32::max);
        out.push(Tongue { parts, centre, radius: reach });
    }
    out
}

/// One scoop: a ball with the ragged skirt a scoop leaves around its foot, and an icy, dragged surface.
///
/// Anything not below `limit` may stand for a larger value.
fn scoop(x: Vec3<f32>, k: usize, limit: f32) -> f32 {
    /// No relief is higher.
    const RELIEF: f32 = 0.05;
    let p = vec3::sub(x, SCOOPS[k]);
    let seed = k as f32;
    let r = vec3::norm(p);
    // The skirt reaches farthest.
    let far = r - (SCOOP_RADIUS + 0.15);
    if far > 0.2 || far > limit {
        return far;
    }
    let rho = (p[0] * p[0] + p[1] * p[1]).sqrt();
    let wave = noise_at(p, 3.1, 1.0 + seed);
    let q = [rho - 0.355 - 0.025 * wave, p[2] + 0.19 + 0.06 * noise_at(p, 2.3, 2.0 + seed)];
    let skirt = (q[0] * q[0] + 1.6 * q[1] * q[1]).sqrt() - 0.075 - 0.02 * wave;
    let base = smin(r - SCOOP_RADIUS, skirt, 0.045);
    let near = smoothstep(0.13, 0.04, base.abs());
    if near <= 0.0 || base - RELIEF > limit {
        return base;
    }
    // The scoop is dragged through the tub along one direction: fine furrows across it, deeper towards the foot.
    let tilt = 0.5 * seed - 0.4;
    let drag = [p[0] * tilt.cos() + p[2] * tilt.sin(), p[1], p[2] * tilt.cos() - p[0] * tilt.sin()];
    let warp = 0.35 * noise_at(p, 4.0, 5.0 + seed);
    let foot = smoothstep(0.05, -0.22, p[2]);
    let furrow = noise_at([drag[0] * 0.22, drag[1] * 0.22, drag[2] + 0.1 * warp], 21.0, 6.0 + seed);
    let lumps = noise_at(p, 5.5, 7.0 + seed);
    let grain = noise_at(p, 26.0, 8.0 + seed);
    let pits = smoothstep(0.22, 0.55, noise_at(p, 13.0, 10.0 + seed));
    let amount = 0.012 * lumps + (0.008 + 0.012 * foot) * furrow + (0.004 + 0.010 * foot) * grain - 0.012 * pits;
    base - near * amount
}

/// Radius of the bowl's outside at height `z` and azimuth `phi`, and its slope dR/dz.
fn bowl_radius(z: f32, phi: f32) -> (f32, f32) {
    let t = (z / RIM).clamp(0.0, 1.25);
    let u = (1.0 - t).max(0.0);
    let bend = u.powf(0.3);
    let flute = 0.022 * t * t * (6.0 * phi + 0.4).cos();
    (0.37 + 0.36 * (1.0 - u * bend) + 0.10 * (t - 1.0).max(0.0) + flute, 0.36 * 1.3 / RIM * bend)
}

/// Relief of the waffle at height `z` and azimuth `phi`: 1 on the ridges, 0 in the dimples (diamonds).
pub(super) fn waffle(z: f32, phi: f32) -> f32 {
    let around = phi * (20.0 / std::f32::consts::TAU);
    let up = (z + 0.25 * z * z) * 5.4;
    let line = |v: f32| 2.0 * (v - v.floor() - 0.5).abs();
    let ridge = line(around + up).max(line(around - up));
    smoothstep(0.66, 0.86, ridge)
}

/// Distance of the bowl's outer side, positive outside; its relief included near the surface.
fn bowl_side(x: Vec3<f32>, phi: f32) -> f32 {
    let r = (x[0] * x[0] + x[1] * x[1]).sqrt();
    let (radius, slope) = bowl_radius(x[2], phi);
    let side = (r - radius) / (1.0 + slope * slope).sqrt();
    if side.abs() > 0.05 {
        return side;
    }
    let fade = smoothstep(0.05, 0.02, side.abs()) * smoothstep(0.0, 0.06, x[2]) * smoothstep(RIM + 0.02, RIM - 0.06, x[2]);
    side + fade * (0.016 * (1.0 - waffle(x[2], phi)) + 0.004 * noise_at(x, 14.0, 21.0))
}

/// Height of the wavy rim.
fn rim(phi: f32) -> f32 {
    RIM + 0.022 * (6.0 * phi + 0.4).cos() + 0.012 * (2.0 * phi + 1.0).sin()
}

/// Distances of the waffle bowl (a wall of constant thickness with a fluted, rounded rim and a solid floor) and of the ice cream
/// that fills it under and between the scoops.
fn bowl_and_fill(x: Vec3<f32>) -> (f32, f32) {
    let far = disc(x, 0.80, 0.0, RIM + 0.08, 0.02);
    if far > 0.15 {
        return (far, far);
    }
    let phi = x[1].atan2(x[0]);
    let side = bowl_side(x, phi);
    let wall = (side + 0.5 * WALL).abs() - 0.5 * WALL;
    let wall = smax(wall, x[2] - rim(phi), 0.07);
    let floor = side.max(x[2] - 0.12);
    let bowl = smax(smin(wall, floor, 0.04), -x[2], 0.03);
    let inside = (side + 0.8 * WALL).max(0.06 - x[2]);
    let mut top = x[2] - 0.41;
    if top.abs() < 0.1 && inside < 0.05 {
        top -= smoothstep(0.1, 0.05, top.abs())
            * (0.03 * noise_at(x, 5.0, 13.0) + 0.010 * noise_at(x, 15.0, 14.0) + 0.006 * noise_at(x, 34.0, 15.0));
    }
    (bowl, inside.max(top))
}

/// The table: a round top on a turned foot.
pub(super) fn table(x: Vec3<f32>) -> f32 {
    let top = disc(x, TABLE_RADIUS, -0.13, TABLE_HEIGHT, 0.045);
    let r = (x[0] * x[0] + x[1] * x[1]).sqrt();
    let z = x[2];
    if z > 0.0 {
        return top;
    }
    // Stem: narrow waist between a flared neck and a flared foot.
    let t = ((z + 0.13) / -0.37).clamp(0.0, 1.0);
    let waist = 0.17 + 0.30 * (2.0 * t - 1.0).abs().powi(3);
    let stem = ((r - waist) * 0.6).max(-0.50 - z).max(z + 0.10);
    let foot = disc(x, 0.66, -0.56, -0.47, 0.035);
    smin(smin(top, stem, 0.06), foot, 0.06)
}
