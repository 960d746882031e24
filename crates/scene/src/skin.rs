//! How splats follow the points, and how the skin stays closed (splatting.md §7, §8, §11.1).

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// What deforms the splats (splatting.md §8.2).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Push {
    /// The elastic deformation: melt keeps round splats.
    #[default]
    Elastic,
    /// The total deformation, limited: splats stretch with the flow.
    Total,
    /// Rotation only.
    Rotation,
}

/// Shape of the kernels that seal cracks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum CrackKernel {
    /// Flat along the surface: crisp outlines.
    Disc,
    /// Round (the paper).
    Ball,
}

/// Which points of the inside become kernels.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum SurfaceRule {
    /// Those that some view sees well enough: no translucent seams.
    Weight,
    /// Those that contribute most to some pixel (the paper).
    Argmax,
}

/// How large the kernels of cracks are.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum KernelRadius {
    /// 0.55 of the mean distance to the three nearest.
    Mean3,
    /// Half the distance to the nearest (the paper).
    Nearest,
}

/// Where normals of the deformed surface come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum SurfaceNormals {
    /// The shortest axis of each splat (the paper).
    Axis,
    /// Carried along by the material.
    Transport,
    /// Carried along, and corrected where melt has flowed.
    TransportPca,
}

/// What the pictures show of the objects.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Draw {
    /// The splats and the kernels that seal them.
    #[default]
    Splats,
    /// The closed mesh of every frame, shaped by the oriented skin.
    Mesh,
    /// The mesh around the particles alone, as density-based methods make it, for comparison.
    ParticleMesh,
}

/// How splats follow the points. Keys that are left out follow `preset`: with "paper" everything is as the paper writes it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Skin {
    /// What the pictures show of the objects: "splats", or the surface made anew in every frame as "mesh" or "particle_mesh".
    pub draw: Draw,
    /// What deforms the splats: "elastic", "total" or "rotation".
    pub push: Push,
    /// Seal cracks: points of the inside that come to light become part of the surface.
    pub densify: bool,
    /// Keep splats from turning into needles (default: yes; no with preset "paper").
    #[serde(skip_serializing_if = "Option::is_none")]
    pub needle_clamp: Option<bool>,
    /// Longest over middle axis of a splat is kept below this, 1–100.
    #[schemars(range(min = 1.0, max = 100.0))]
    pub max_stretch: f64,
    /// Turn molten splats towards the surface that they lie in (default: yes; no with preset "paper").
    #[serde(skip_serializing_if = "Option::is_none")]
    pub realign: Option<bool>,
    /// Let molten splats and the kernels in cracks grow where the flow draws them apart, so that a thin film stays closed, and trim them
    /// where it has torn, so that they do not stick out (default: yes; no with preset "paper"). Needs `densify`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub grow: Option<bool>,
    /// Let splats get narrower where the flow presses the surface together, down to half (default: yes; no with preset "paper"). Matters
    /// for push "elastic".
    #[serde(skip_serializing_if = "Option::is_none")]
    pub squeeze: Option<bool>,
    /// Let what melts lose the highlights that were photographed on it, and keep the colour that they average to (default: yes; no with
    /// preset "paper"). Its own sheen is a matter of `wetness`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub dull: Option<bool>,
    /// Depth of the splats below the surface that they draw \[m\], 0–0.01, kept while the flow presses the surface together or apart; 0:
    /// they go where the material goes (default: 1.35 pixels of the photographs, as deep as trainings put them, where the splats
    /// remember those, else 0; 0 with preset "paper").
    #[schemars(range(min = 0.0, max = 0.01))]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub depth_m: Option<f64>,
    /// Which points become kernels: "weight" or "argmax" (the paper).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub surface_rule: Option<SurfaceRule>,
    /// Shape of the kernels: "disc" or "ball" (the paper).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub kernel: Option<CrackKernel>,
    /// Size of the kernels: "mean3" or "nearest" (the paper).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub kernel_radius: Option<KernelRadius>,
    /// Normals of the surface: "transport_pca", "transport" or "axis" (the paper).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub normals: Option<SurfaceNormals>,
    /// How far kernels move from their points onto the surface, 0–1.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub snap: f64,
    /// Extend the surface over gaps wider than ten splats (default: yes; no with preset "paper").
    #[serde(skip_serializing_if = "Option::is_none")]
    pub extend_gaps: Option<bool>,
    /// Kernels come and go gently (default: yes; no with preset "paper").
    #[serde(skip_serializing_if = "Option::is_none")]
    pub fades: Option<bool>,
    /// Virtual cameras that look for cracks.
    #[schemars(range(min = 8, max = 128))]
    pub virtual_cameras: u32,
    /// Without `densify`: draw the whole inside below the skin, so that cracks show something.
    pub show_inside: bool,
    /// Patch the background under the object where nobody ever saw it.
    pub patch_background: bool,
}

impl Default for Skin {
    fn default() -> Self {
        Self {
            draw: Draw::Splats,
            push: Push::Elastic,
            densify: true,
            needle_clamp: None,
            max_stretch: 4.0,
            realign: None,
            grow: None,
            squeeze: None,
            dull: None,
            depth_m: None,
            surface_rule: None,
            kernel: None,
            kernel_radius: None,
            normals: None,
            snap: 0.0,
            extend_gaps: None,
            fades: None,
            virtual_cameras: 32,
            show_inside: true,
            patch_background: true,
        }
    }
}
