//! Where something happens: a shape, a whole body, a surface (simulation.md §4.7).

pub use megas_geometry::Shape;
use megas_math::Vec3;

use crate::schedule::Pose;

/// A region of space or of the scene. Lengths in metres, simulator axes (+z up).
#[derive(Clone, Debug, PartialEq)]
pub enum Region {
    /// Everywhere.
    All,
    /// Inside a shape.
    Shape(Shape),
    /// A whole body, wherever it moves.
    Object(u16),
    /// The surface layer of one body, or of all.
    Surface(Option<u16>),
}

impl From<Shape> for Region {
    fn from(shape: Shape) -> Self {
        Self::Shape(shape)
    }
}

impl Region {
    /// The body this region follows, if it names one.
    pub fn object(&self) -> Option<u16> {
        match self {
            Region::Object(id) | Region::Surface(Some(id)) => Some(*id),
            _ => None,
        }
    }

    /// Point about which a motion turns the region \[m\].
    pub fn pivot(&self) -> Vec3<f64> {
        match self {
            Region::Shape(s) => s.pivot(),
            Region::All | Region::Object(_) | Region::Surface(_) => [0.0; 3],
        }
    }

    /// Weight χ ∈ `[0, 1]` of a node at `x` when the region is displaced by `pose`: 1 inside, 0 outside, smooth over one
    /// `spacing` across the boundary; 1 for the regions that are not shapes.
    pub fn weight(&self, x: Vec3<f64>, spacing: f64, pose: &Pose) -> f64 {
        match self {
            Region::Shape(s) => smooth(s.distance(pose.home(x)).0 / spacing),
            Region::All | Region::Object(_) | Region::Surface(_) => 1.0,
        }
    }
}

/// From 1 at half a spacing inside to 0 at half a spacing outside.
fn smooth(d: f64) -> f64 {
    let t = (0.5 - d).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::schedule::{Motion, PoseKey};

    #[test]
    fn weights_are_smooth_and_move() {
        let ball = Region::from(Shape::Sphere { center: [0.0; 3], radius: 1.0 });
        assert_eq!(Region::All.weight([9.0; 3], 0.1, &Pose::REST), 1.0);
        assert_eq!(ball.weight([1.0, 0.0, 0.0], 0.1, &Pose::REST), 0.5);
        assert_eq!(ball.weight([1.051, 0.0, 0.0], 0.1, &Pose::REST), 0.0);
        let away = Motion(vec![PoseKey { time: 0.0, translation: [2.0, 0.0, 0.0], rotation: [1.0, 0.0, 0.0, 0.0] }]);
        assert_eq!(ball.weight([2.5, 0.0, 0.0], 0.1, &away.at(0.0, ball.pivot())), 1.0);
    }
}
