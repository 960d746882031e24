//! What shapes a body, and why there may be none.

use megas_math::{Vec3, vec3};
use megas_model::Similarity;

use crate::fill::FillSettings;
use crate::orient::OrientSettings;
use crate::select::Selection;
use crate::volumes::VolumeSettings;

/// Where the metres come from.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Placement {
    /// From the size of this object (simulation.md §0.1).
    Size {
        /// Scene-up, any length but zero.
        up: Vec3<f64>,
        /// Real length of the longest side of the object's robust box \[m\], positive.
        size_m: f64,
        /// Simulator cells over that side, 8–512; 48 by default.
        cells: u32,
    },
    /// Given, for the further objects of a scene.
    Given {
        /// The scene's similarity.
        similarity: Similarity,
        /// The simulator's cell \[m\], positive.
        dx_m: f64,
    },
}

/// Splitting of needles and giants before the rest, see [`crate::bake::split_needles`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SplitSettings {
    /// Largest S¹/S², above 1; 2.0 by default.
    pub a: f32,
    /// Largest S¹ in scene units; `min(0.01 L, dx/2)` by default.
    pub tau_scale: Option<f32>,
    /// Budget of Gaussians.
    pub max_count: usize,
}

impl Default for SplitSettings {
    fn default() -> Self {
        Self { a: 2.0, tau_scale: None, max_count: 400_000 }
    }
}

/// Everything that shapes a body.
#[derive(Clone, Debug, PartialEq)]
pub struct BodySettings {
    /// Which Gaussians belong to the object; the rest is background.
    pub selection: Selection,
    /// Size and orientation.
    pub placement: Placement,
    /// Object number to give, from 1.
    pub object: u16,
    /// Index into the scene's material list.
    pub material: u8,
    /// Initial temperature \[K\]; the splats' own where absent.
    pub temperature_k: Option<f32>,
    /// First point identity.
    pub first_id: u32,
    /// Removes Gaussians that no virtual view sees with at least this blend weight (§5.6); 0.02 by default.
    pub prune_below: Option<f32>,
    /// Splits needles and giants; off by default.
    pub split: Option<SplitSettings>,
    /// Outward normals.
    pub orient: OrientSettings,
    /// Interior test.
    pub fill: FillSettings,
    /// Particles.
    pub volumes: VolumeSettings,
    /// Whether the background gets a patch under the object.
    pub patch: bool,
    /// Seed of everything random.
    pub seed: u64,
}

impl Default for BodySettings {
    fn default() -> Self {
        Self {
            selection: Selection::All,
            placement: Placement::Size { up: [0.0, 0.0, 1.0], size_m: 0.2, cells: 48 },
            object: 1,
            material: 0,
            temperature_k: None,
            first_id: 0,
            prune_below: Some(0.02),
            split: None,
            orient: OrientSettings::default(),
            fill: FillSettings::default(),
            volumes: VolumeSettings::default(),
            patch: true,
            seed: 0,
        }
    }
}

/// Why no body came out.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum BodyError {
    /// The input has no Gaussians.
    #[error("the splat file holds no Gaussians; check that it was read from the right path")]
    Empty,
    /// A setting is out of range.
    #[error("{name} = {value}, but it must be {expected}")]
    Setting {
        /// Name of the setting.
        name: &'static str,
        /// What it was.
        value: String,
        /// What it may be.
        expected: &'static str,
    },
    /// The selection is empty.
    #[error("the selection picked none of {total} Gaussians ({tools}); widen the box or sphere, or lower the opacity threshold")]
    NothingSelected {
        /// Gaussians in the input.
        total: usize,
        /// Counts of the tools.
        tools: String,
    },
    /// Baking and pruning left nothing.
    #[error(
        "all {selected} selected Gaussians were dropped ({transparent} almost transparent, {invalid} not finite, \
         {unseen} seen by no view); \
         lower prune_below or select a more opaque part"
    )]
    NothingVisible {
        /// Gaussians selected.
        selected: usize,
        /// Of these, opacity below 1/255.
        transparent: usize,
        /// Of these, not finite.
        invalid: usize,
        /// Of these, never seen.
        unseen: usize,
    },
    /// The object has no extent.
    #[error("the selected object has no size: its {count} Gaussians share one position; select more of it")]
    NoExtent {
        /// Gaussians of the object.
        count: usize,
    },
    /// Nothing was found inside, or only under less than half of the surface.
    #[error(
        "no interior was found under most of the surface at a grid spacing of {spacing_m:.2e} m ({one_short} points were one vote short, \
         {inconsistent:.1} % of \
         neighbouring normals disagree): the object is a thin shell, translucent, or open on several sides; raise the number of \
         cells, lower tau_alpha towards 0.4, use 14 directions, or select the whole object"
    )]
    Hollow {
        /// Finest grid spacing tried \[m\].
        spacing_m: f64,
        /// Grid points one vote short of the majority.
        one_short: usize,
        /// Inconsistent neighbour pairs in per cent.
        inconsistent: f64,
    },
}

/// Refuses settings that cannot work.
pub(crate) fn check(settings: &BodySettings) -> Result<(), BodyError> {
    let fail = |name, value: String, expected| Err(BodyError::Setting { name, value, expected });
    match settings.placement {
        Placement::Size { up, size_m, cells } => {
            if !(size_m > 0.0 && size_m.is_finite()) {
                return fail("size_m", size_m.to_string(), "a positive length in metres, such as 0.2");
            }
            if !(8..=512).contains(&cells) {
                return fail("cells", cells.to_string(), "between 8 and 512 over the longest side");
            }
            if !(vec3::norm(up) > 0.0 && vec3::norm(up).is_finite()) {
                return fail("up", format!("{up:?}"), "a direction that is not zero, such as [0, 0, 1]");
            }
        }
        Placement::Given { similarity, dx_m } => {
            if !(dx_m > 0.0 && dx_m.is_finite()) {
                return fail("dx_m", dx_m.to_string(), "a positive length in metres");
            }
            if !(similarity.metres_per_unit > 0.0 && similarity.metres_per_unit.is_finite()) {
                return fail("metres_per_unit", similarity.metres_per_unit.to_string(), "positive");
            }
        }
    }
    if settings.object == 0 {
        return fail("object", "0".into(), "1 or more (0 is the background)");
    }
    if !(0.0..=0.5).contains(&settings.volumes.jitter) {
        return fail("jitter", settings.volumes.jitter.to_string(), "between 0 and 0.5");
    }
    if let Some(s) = settings.split
        && !(s.a > 1.0 && s.tau_scale.is_none_or(|t| t > 0.0))
    {
        return fail("split", format!("{s:?}"), "a > 1 and tau_scale > 0");
    }
    if let Some(t) = settings.temperature_k
        && !(t > 0.0 && t.is_finite())
    {
        return fail("temperature_k", t.to_string(), "a positive temperature in kelvin");
    }
    Ok(())
}
