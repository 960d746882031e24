//! All measures of a set of Gaussians in one place.

use megas_model::Splats;
use serde::{Deserialize, Serialize};

use super::{Consistency, Needles, Uniformity};
use crate::surface::{Floaters, MeshDistance};

/// What is wrong with a model before it is deformed (splatting.md §9.3 M2–M5).
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SplatReport {
    /// Number of Gaussians.
    pub count: usize,
    /// Needles.
    pub needles: Needles,
    /// Equality of sizes.
    pub consistency: Consistency,
    /// Evenness of the means; absent for fewer than two.
    pub uniformity: Option<Uniformity>,
    /// Gaussians inside the object; needs the true surface.
    pub floaters: Option<Floaters>,
}

impl SplatReport {
    /// Measures the Gaussians of an object: `a` is the largest permitted ratio of the two longest axes; with a surface the
    /// lengths of the object are taken from it.
    pub fn new(splats: &Splats, a: f64, surface: Option<&MeshDistance>) -> Self {
        Self {
            count: splats.len(),
            needles: Needles::new(splats, a),
            consistency: Consistency::new(splats),
            uniformity: Uniformity::new(splats, surface, 0),
            floaters: surface.map(|s| Floaters::new(splats, &s.signed_all(&splats.mean), s.diagonal())),
        }
    }
}
