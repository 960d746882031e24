//! Which Gaussians belong to the object (splatting.md §5.11): expressions over the means, in scene coordinates.

mod bounds;
mod components;
mod plane;

use megas_math::{Vec3, quat, vec3};
use megas_model::Splats;

pub use bounds::{RobustBox, robust_bounds};
pub(crate) use plane::plane_below;
pub use plane::{Plane, support_plane};

/// A selection expression. All lengths are in scene units.
#[derive(Clone, Debug, PartialEq)]
pub enum Selection {
    /// Everything.
    All,
    /// What every part selects; everything if there are none.
    And(Vec<Self>),
    /// What any part selects; nothing if there are none.
    Or(Vec<Self>),
    /// What the part does not select.
    Not(Box<Self>),
    /// Inside an oriented box.
    Box {
        /// Centre.
        center: Vec3<f32>,
        /// Half of its sides, positive.
        half: Vec3<f32>,
        /// Quaternion `[w, x, y, z]` from the box's axes to the scene's.
        rotation: [f32; 4],
    },
    /// Inside a sphere.
    Sphere {
        /// Centre.
        center: Vec3<f32>,
        /// Radius, positive.
        radius: f32,
    },
    /// On the side of a plane that its normal points to.
    HalfSpace {
        /// A point of the plane.
        point: Vec3<f32>,
        /// Any vector along the normal.
        normal: Vec3<f32>,
    },
    /// Inside a cylinder between two discs.
    Cylinder {
        /// Centre of one disc.
        start: Vec3<f32>,
        /// Centre of the other disc.
        end: Vec3<f32>,
        /// Radius, positive.
        radius: f32,
    },
    /// Opacity above this value in [0, 1].
    OpacityAbove(f32),
    /// Largest standard deviation below this.
    ScaleBelow(f32),
    /// Base colour within a distance in the HSV cone, see [`hsv_distance`].
    Colour {
        /// Wanted colour, RGB in [0, 1].
        rgb: [f32; 3],
        /// Largest distance; 0.1–0.3 is useful.
        distance: f32,
    },
    /// Carries this object number already.
    Object(u16),
    /// One connected component of what the part selects: the one nearest to the seed, or the largest by Σ o·S¹S².
    Component {
        /// Candidates.
        of: Box<Self>,
        /// A point near the wanted component.
        seed: Option<Vec3<f32>>,
        /// Cell in which means count as connected (26-connectivity); by default 2.5 × the median distance to the nearest
        /// neighbour.
        cell: Option<f32>,
    },
    /// What the part selects above its support plane, cut 0.01 L above it; everything where no plane is found.
    AboveSupport {
        /// Candidates, the support included.
        of: Box<Self>,
        /// Scene-up.
        up: Vec3<f32>,
        /// Seed of the search.
        seed: u64,
    },
}

/// How many Gaussians one tool selected.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ToolCount {
    /// Name of the tool.
    pub tool: &'static str,
    /// Depth in the expression, 0 for the outermost.
    pub depth: usize,
    /// Number selected.
    pub selected: usize,
}

/// What a selection did.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SelectReport {
    /// Counts of every tool, parts before the expression that uses them.
    pub tools: Vec<ToolCount>,
    /// Support planes found, in order of evaluation.
    pub planes: Vec<Plane>,
    /// Number selected in the end.
    pub selected: usize,
}

/// Evaluates an expression: one flag per Gaussian and a report.
pub fn select(splats: &Splats, selection: &Selection) -> (Vec<bool>, SelectReport) {
    let mut report = SelectReport::default();
    let mask = evaluate(splats, selection, 0, &mut report);
    report.selected = count(&mask);
    (mask, report)
}

fn count(mask: &[bool]) -> usize {
    mask.iter().filter(|&&m| m).count()
}

fn evaluate(splats: &Splats, selection: &Selection, depth: usize, report: &mut SelectReport) -> Vec<bool> {
    let n = splats.len();
    let means = |f: &dyn Fn(Vec3<f32>) -> bool| splats.mean.iter().map(|&m| f(m)).collect::<Vec<bool>>();
    let mut part = |s: &Selection| evaluate(splats, s, depth + 1, report);
    let (tool, mask) = match selection {
        Selection::All => ("all", vec![true; n]),
        Selection::And(parts) => {
            let mut mask = vec![true; n];
            for p in parts {
                mask.iter_mut().zip(part(p)).for_each(|(m, v)| *m &= v);
            }
            ("and", mask)
        }
        Selection::Or(parts) => {
            let mut mask = vec![false; n];
            for p in parts {
                mask.iter_mut().zip(part(p)).for_each(|(m, v)| *m |= v);
            }
            ("or", mask)
        }
        Selection::Not(p) => ("not", part(p).into_iter().map(|v| !v).collect()),
        Selection::Box { center, half, rotation } => {
            let axes = quat::to_mat3(*rotation);
            let inside = |m: Vec3<f32>| {
                let local = megas_math::mat3::tmul_vec(axes, vec3::sub(m, *center));
                (0..3).all(|k| local[k].abs() <= half[k])
            };
            ("box", means(&inside))
        }
        Selection::Sphere { center, radius } => ("sphere", means(&|m| vec3::norm(vec3::sub(m, *center)) <= *radius)),
        Selection::HalfSpace { point, normal } => ("half-space", means(&|m| vec3::dot(vec3::sub(m, *point), *normal) >= 0.0)),
        Selection::Cylinder { start, end, radius } => {
            let axis = vec3::sub(*end, *start);
            let length2 = vec3::dot(axis, axis);
            let inside = |m: Vec3<f32>| {
                let t = vec3::dot(vec3::sub(m, *start), axis) / length2;
                let foot = vec3::add_scaled(*start, axis, t);
                (0.0..=1.0).contains(&t) && vec3::norm(vec3::sub(m, foot)) <= *radius
            };
            ("cylinder", means(&inside))
        }
        Selection::OpacityAbove(least) => ("opacity", (0..n).map(|i| splats.opacity(i) > *least).collect()),
        Selection::ScaleBelow(limit) => {
            ("scale", splats.log_scale.iter().map(|s| s.iter().fold(f32::MIN, |a, &b| a.max(b)).exp() < *limit).collect())
        }
        Selection::Colour { rgb, distance } => ("colour", (0..n).map(|i| hsv_distance(splats.base_rgb(i), *rgb) <= *distance).collect()),
        Selection::Object(id) => ("object", splats.object_id.iter().map(|o| o == id).collect()),
        Selection::Component { of, seed, cell } => {
            let of = part(of);
            ("component", components::component(splats, &of, *seed, *cell))
        }
        Selection::AboveSupport { of, up, seed } => {
            let mut mask = part(of);
            if let Some(plane) = support_plane(splats, &mask, *up, *seed) {
                mask.iter_mut().zip(&splats.mean).for_each(|(v, &m)| *v &= plane.height(m) > plane.cut);
                report.planes.push(plane);
            }
            ("above support", mask)
        }
    };
    report.tools.push(ToolCount { tool, depth, selected: count(&mask) });
    mask
}

/// Distance of two colours in the HSV cone: hue is the angle, saturation × value the radius, value the height. Black is a
/// point, so that the meaningless hue of dark and grey colours does not count.
pub fn hsv_distance(a: [f32; 3], b: [f32; 3]) -> f32 {
    let cone = |c: [f32; 3]| {
        let [r, g, b] = c.map(|v| v.clamp(0.0, 1.0));
        let value = r.max(g).max(b);
        let chroma = value - r.min(g).min(b);
        let sixth = if chroma == 0.0 {
            0.0
        } else if value == r {
            (g - b) / chroma
        } else if value == g {
            (b - r) / chroma + 2.0
        } else {
            (r - g) / chroma + 4.0
        };
        let (s, c) = (sixth * std::f32::consts::FRAC_PI_3).sin_cos();
        [chroma * c, chroma * s, value]
    };
    vec3::norm(vec3::sub(cone(a), cone(b)))
}
