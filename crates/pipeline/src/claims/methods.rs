//! The methods that the paper compares (splatting.md §5.8).

use megas_metrics::deform::Deformation;
use megas_reconstruct::Method;
use serde::Serialize;

/// A method: a training, a filling, and what is drawn when the object deforms.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
pub enum Contender {
    /// Plain splatting.
    B0,
    /// PhysGaussian.
    B1,
    /// VR-DoH.
    B2,
    /// The planar backbone.
    B3,
    /// B3 with internal-free pruning.
    B4,
    /// Ours without anything drawn inside.
    B5,
    /// Ours.
    B6,
    /// Ours filled by the density field.
    A1,
}

impl Contender {
    /// All of them, in the order of the tables.
    pub const ALL: [Self; 8] = [Self::B0, Self::B1, Self::B2, Self::B3, Self::B4, Self::B5, Self::B6, Self::A1];

    /// The name in the design.
    pub fn id(self) -> &'static str {
        match self {
            Self::B0 => "B0",
            Self::B1 => "B1",
            Self::B2 => "B2",
            Self::B3 => "B3",
            Self::B4 => "B4",
            Self::B5 => "B5",
            Self::B6 => "B6",
            Self::A1 => "A1",
        }
    }

    /// The name for people.
    pub fn name(self) -> &'static str {
        match self {
            Self::B5 => "ours, static",
            Self::B6 => "ours",
            Self::A1 => "ours, density field",
            _ => self.training().name(),
        }
    }

    /// The training its splats come from.
    pub fn training(self) -> Method {
        match self {
            Self::B0 => Method::Vanilla,
            Self::B1 => Method::Physgaussian,
            Self::B2 => Method::Vrdoh,
            Self::B3 => Method::Pgsr,
            Self::B4 => Method::PgsrPrune,
            Self::B5 | Self::B6 | Self::A1 => Method::Ours,
        }
    }

    /// Fills by the density of the splats instead of by rays. (B0 has no filling of its own: it gets the one of the methods
    /// that build on it.)
    pub fn fills_by_density(self) -> bool {
        matches!(self, Self::B0 | Self::B1 | Self::B2 | Self::A1)
    }

    /// Bounds the shape of deformed splats (§8.4).
    pub fn clamps_needles(self) -> bool {
        !matches!(self, Self::B0 | Self::B1 | Self::B2)
    }

    /// Shows the inside where the surface opens.
    pub fn shows_inside(self) -> bool {
        matches!(self, Self::B6 | Self::A1)
    }

    /// Draws splats with the blur of the pixels that they were trained on, whatever those of the picture are.
    pub fn knows_pixels(self) -> bool {
        self.training() == Method::Ours
    }

    /// Opacity below which splats are dropped before anything moves.
    pub fn least_opacity(self) -> f32 {
        if self == Self::B1 { 0.02 } else { 0.0 }
    }
}

/// Deformations that the crack claim is about.
pub const EXTREME: [Deformation; 3] = [Deformation::Slump, Deformation::Neck, Deformation::Cut];

/// Deformations that the fidelity claim is about.
pub const SHAPED: [Deformation; 3] = [Deformation::Twist, Deformation::Stretch, Deformation::Slump];
