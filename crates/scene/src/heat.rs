//! Heat sources: region × kind × schedule × motion (simulation.md §4.7).

use megas_geometry::Shape;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::CELSIUS_K;
use crate::shape::{BoxShape, Frame, HalfSpace, MeshShape, Placement, Sphere, Tube};
use crate::value::Auto;

/// What a heat source does inside its region. Any of them cools when it is colder than the object.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum HeatKind {
    /// Holds everything in the region at `temperature_c` (default: 60 K above the highest melting point).
    #[default]
    Temperature,
    /// Puts `power_w` watts in all into the material of the region.
    Power,
    /// Puts `volume_w_m3` watts into every cubic metre of material in the region.
    Volume,
    /// Puts `flux_w_m2` watts through every square metre of surface in the region.
    Flux,
    /// Surface in the region exchanges heat with a fluid of `temperature_c` through `film_coefficient_w_m2k`: a hair dryer, a water bath.
    Film,
    /// Surface in the region exchanges radiation with surroundings of `temperature_c`, with `emissivity`: a grill, a fire.
    Radiation,
    /// Light that falls on surface in the region and casts shadows: the sun (`direction`, `intensity_w_m2`) or a torch (`position`,
    /// `power_w`).
    Radiant,
}

/// A heat source.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Heat {
    /// Name, for messages.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub name: String,
    /// What the source does; each kind has its own value key.
    pub kind: HeatKind,
    /// Where it acts: one shape, or a whole object, or an object's surface. Default: all objects.
    pub region: Region,
    /// What the coordinates of `region` and `motion` mean: "object" or "scene".
    pub frame: Frame,
    /// Temperature in °C, for the kinds temperature, film and radiation.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = -273.15, max = 10000.0))]
    pub temperature_c: Option<f64>,
    /// Total power in W, for the kind power (negative cools), or of the light of a torch of the kind radiant.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = -1e9, max = 1e9))]
    pub power_w: Option<f64>,
    /// Power density in W/m³, for the kind volume; negative cools.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = -1e12, max = 1e12))]
    pub volume_w_m3: Option<f64>,
    /// Heat flux in W/m², for the kind flux; negative cools. Sunlight: 1000.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = -1e9, max = 1e9))]
    pub flux_w_m2: Option<f64>,
    /// Film coefficient in W/(m²·K) for the kind film, or "auto" (natural convection around the object). Room air 5–12, hair
    /// dryer 50, water 500.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub film_coefficient_w_m2k: Option<Auto>,
    /// Emissivity for the kind radiation, 0–1; default 0.9.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0.0, max = 1.0))]
    pub emissivity: Option<f64>,
    /// Irradiance in W/m² across its direction, for the kind radiant without `position`. Sun: 1000.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0.0, max = 1e9))]
    pub intensity_w_m2: Option<f64>,
    /// Share of the light that the surface takes, for the kind radiant, 0–1; default 0.9.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0.0, max = 1.0))]
    pub absorptivity: Option<f64>,
    /// Way of the light, for the kind radiant; default straight down.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub direction: Option<[f64; 3]>,
    /// Where a torch of the kind radiant is.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub position: Option<[f64; 3]>,
    /// Half of the opening angle of a torch's cone in degrees; default 20. 180 shines everywhere.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 1.0, max = 180.0))]
    pub cone_deg: Option<f64>,
    /// When it is on.
    pub schedule: Schedule,
    /// How it moves: rigid motion of the region, linear between keyframes.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub motion: Vec<MotionKey>,
}

/// Where a source acts. Write exactly one, e.g. `region = { sphere = { center = [0.5, 0.5, 1], radius = 0.3 } }`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Region {
    /// A ball.
    Sphere(Sphere),
    /// A box.
    Box(BoxShape),
    /// A cylinder.
    Cylinder(Tube),
    /// A cylinder with round ends.
    Capsule(Tube),
    /// One side of a plane.
    HalfSpace(HalfSpace),
    /// The inside of a triangle mesh out of a file.
    Mesh(MeshShape),
    /// All of an object, by name; "all" for every object.
    Object(String),
    /// The surface of an object, by name; "all" for every object.
    Surface(String),
}

impl Default for Region {
    fn default() -> Self {
        Self::Object("all".into())
    }
}

impl Region {
    /// The shape in metres; `None` for [`Region::Mesh`], which has to be read, and for [`Region::Object`] and [`Region::Surface`],
    /// which are sets of points.
    pub fn to_si(&self, frame: Frame, placement: &Placement) -> Option<Shape> {
        match self {
            Self::Sphere(s) => Some(placement.sphere(frame, s)),
            Self::Box(b) => Some(placement.boxed(frame, b)),
            Self::Cylinder(t) => Some(placement.cylinder(frame, t)),
            Self::Capsule(t) => Some(placement.capsule(frame, t)),
            Self::HalfSpace(h) => Some(placement.half_space(frame, h)),
            Self::Mesh(_) | Self::Object(_) | Self::Surface(_) => None,
        }
    }
}

/// When a source is on, and how strong. All times in seconds of the film.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Schedule {
    /// On from here.
    #[schemars(range(min = 0.0, max = 1e6))]
    pub start_s: f64,
    /// Off from here; never if left out.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0.0, max = 1e6))]
    pub end_s: Option<f64>,
    /// The strength grows linearly over this time after `start_s` (temperatures from the air's).
    #[schemars(range(min = 0.0, max = 1e6))]
    pub ramp_s: f64,
    /// With a period the source blinks: on for the share `duty` of each period.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 1e-3, max = 1e6))]
    pub period_s: Option<f64>,
    /// Share of a period that the source is on, 0–1.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0.0, max = 1.0))]
    pub duty: Option<f64>,
    /// Instead of one value: [[time_s, value], …], linear in between, in the unit of the kind's value key (°C for temperatures).
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub keyframes: Vec<[f64; 2]>,
}

impl Schedule {
    /// True if the source is on at time `t` \[s\].
    pub fn active(&self, t: f64) -> bool {
        if t < self.start_s || self.end_s.is_some_and(|end| t >= end) {
            return false;
        }
        match self.period_s {
            Some(period) => ((t - self.start_s) / period).fract() < self.duty.unwrap_or(0.5),
            None => true,
        }
    }

    /// Share of the full strength at time `t` \[s\]: 0 while off, growing through the ramp, 1 after it.
    pub fn strength(&self, t: f64) -> f64 {
        match self.active(t) {
            false => 0.0,
            true if self.ramp_s > 0.0 => ((t - self.start_s) / self.ramp_s).clamp(0.0, 1.0),
            true => 1.0,
        }
    }

    /// The keyframed value at time `t` \[s\]; `None` without keyframes.
    pub fn keyframed(&self, t: f64) -> Option<f64> {
        let first = self.keyframes.first()?;
        let last = self.keyframes.last()?;
        if t <= first[0] {
            return Some(first[1]);
        }
        let pair = self.keyframes.windows(2).find(|w| t < w[1][0]);
        Some(pair.map_or(last[1], |w| w[0][1] + (w[1][1] - w[0][1]) * (t - w[0][0]) / (w[1][0] - w[0][0])))
    }
}

/// One keyframe of a rigid motion.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct MotionKey {
    /// Time in seconds.
    #[schemars(range(min = 0.0, max = 1e6))]
    pub time_s: f64,
    /// Displacement from the place given in the shape, in lengths of its frame (in the object frame: fractions of the longest side).
    #[serde(default)]
    pub offset: [f64; 3],
    /// Rotation about the shape's centre in degrees around `axis`.
    #[serde(default)]
    #[schemars(range(min = -1e5, max = 1e5))]
    pub rotation_deg: f64,
    /// Axis of the rotation; default +z.
    #[serde(default = "plus_z")]
    pub axis: [f64; 3],
}

fn plus_z() -> [f64; 3] {
    [0.0, 0.0, 1.0]
}

/// The value of a source in SI units, by kind.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Quantity {
    /// Dirichlet temperature \[K\]; `None` = 60 K above the highest melting point of the scene.
    Temperature(Option<f64>),
    /// Total power \[W\].
    Power(f64),
    /// Power density \[W/m³\].
    Volume(f64),
    /// Surface flux \[W/m²\].
    Flux(f64),
    /// Convective film.
    Film {
        /// Film coefficient \[W/(m²·K)\]; `None` = from the natural-convection correlation.
        coefficient: Option<f64>,
        /// Temperature of the fluid \[K\].
        temperature_k: f64,
    },
    /// Radiation to surroundings.
    Radiation {
        /// Emissivity, 0–1.
        emissivity: f64,
        /// Temperature of the surroundings \[K\].
        temperature_k: f64,
    },
    /// Light with shadows; place and direction are in the [`Heat`].
    Radiant {
        /// Irradiance \[W/m²\] without a position, radiated power \[W\] with one.
        strength: f64,
        /// Share that the surface takes, 0–1.
        absorptivity: f64,
    },
}

impl Heat {
    /// The source that melts things from above, used when a scene has no `heat` at all: the upper part of the object's box held 60 K above
    /// the highest melting point.
    pub fn from_above() -> Self {
        Self {
            name: "from above".into(),
            kind: HeatKind::Temperature,
            region: Region::Box(BoxShape { min: [-0.2, -0.2, 0.75], max: [1.2, 1.2, 1.5], rotation_deg: None }),
            ..Self::default()
        }
    }

    /// The first value of the source in SI. `ambient_k` stands in for a missing temperature of `film` and `radiation`.
    pub fn quantity(&self, ambient_k: f64) -> Quantity {
        let first = self.schedule.keyframes.first().map(|k| k[1]);
        let kelvin = first.or(self.temperature_c).map(|c| c + CELSIUS_K);
        let value = |v: Option<f64>| first.or(v).unwrap_or(0.0);
        match self.kind {
            HeatKind::Temperature => Quantity::Temperature(kelvin),
            HeatKind::Power => Quantity::Power(value(self.power_w)),
            HeatKind::Volume => Quantity::Volume(value(self.volume_w_m3)),
            HeatKind::Flux => Quantity::Flux(value(self.flux_w_m2)),
            HeatKind::Film => Quantity::Film {
                coefficient: self.film_coefficient_w_m2k.unwrap_or(Auto::Auto).value(),
                temperature_k: kelvin.unwrap_or(ambient_k),
            },
            HeatKind::Radiant => Quantity::Radiant {
                strength: value(if self.position.is_some() { self.power_w } else { self.intensity_w_m2 }),
                absorptivity: self.absorptivity.unwrap_or(0.9),
            },
            HeatKind::Radiation => {
                Quantity::Radiation { emissivity: self.emissivity.unwrap_or(0.9), temperature_k: kelvin.unwrap_or(ambient_k) }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn schedules_ramp_blink_and_end() {
        let s = Schedule { start_s: 1.0, end_s: Some(5.0), ramp_s: 2.0, ..Schedule::default() };
        assert_eq!([0.5, 1.0, 2.0, 3.5, 5.0].map(|t| s.strength(t)), [0.0, 0.0, 0.5, 1.0, 0.0]);
        let blink = Schedule { period_s: Some(2.0), duty: Some(0.25), ..Schedule::default() };
        assert_eq!([0.0, 0.4, 0.6, 2.1].map(|t| blink.active(t)), [true, true, false, true]);
        let keyed = Schedule { keyframes: vec![[1.0, 10.0], [3.0, 30.0]], ..Schedule::default() };
        assert_eq!([0.0, 2.0, 9.0].map(|t| keyed.keyframed(t)), [Some(10.0), Some(20.0), Some(30.0)]);
    }

    #[test]
    fn quantities_are_in_si() {
        let h = Heat { kind: HeatKind::Film, temperature_c: Some(100.0), ..Heat::default() };
        assert_eq!(h.quantity(293.15), Quantity::Film { coefficient: None, temperature_k: 373.15 });
        assert_eq!(Heat::from_above().quantity(293.15), Quantity::Temperature(None));
    }
}
