//! Shape and colour of the kernels that seal a crack (splatting.md §7.5).

use megas_math::{Vec3, sh, vec3};
use megas_raster::Gaussians;

use super::settings::{DensifySettings, Kernel};
use crate::imls::Imls;
use crate::rows::Rows;

/// Surface neighbours that give the colour.
const COLOURS: usize = 12;
/// Share of them, by weight, that is left out at the bright and at the dark end: a highlight is no colour of the thing.
const OUTLIERS: f32 = 0.25;
/// Distances from the surface, in sample spacings, between which colour passes over to that of the inside.
const OWN_COLOUR: [f32; 2] = [6.0, 10.0];
/// Thickness of a disc in radii: most, and least.
const THICK: f32 = 0.3;
const THIN: f32 = 0.12;
/// Depth below the surface, in standard deviations, that a disc keeps.
const DEPTH_IN_SIGMA: f32 = 2.2;

/// What one object offers to kernels near its surface.
#[derive(Debug)]
pub(crate) struct Object {
    pub number: u16,
    pub field: Imls,
    /// Surface Gaussians that can be seen, and their base colours in row order.
    pub rows: Rows,
    pub rgb: Vec<[f32; 3]>,
    /// How much each covers: opacity times area.
    pub cover: Vec<f32>,
    pub spacing: f32,
}

/// A kernel before smoothing in time.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Fresh {
    /// Unit normal, zero where there is no surface near.
    pub normal: Vec3<f32>,
    /// Place of the surface minus the particle.
    pub up: Vec3<f32>,
    pub rgb: [f32; 3],
}

/// Normal and colour for the particle at `x` with its own colour `inside`; Δ is the particles' spacing.
pub(crate) fn fresh(object: Option<&Object>, x: Vec3<f32>, inside: [f32; 3], delta: f32, found: &mut Vec<(f32, u32)>) -> Fresh {
    let Some(o) = object else { return Fresh { normal: [0.0; 3], up: [0.0; 3], rgb: inside } };
    let projected = o.field.project(x, 2.0 * delta.max(o.spacing));
    let far = OWN_COLOUR[1] * o.spacing;
    o.rows.nearest(x, COLOURS, 2.0 * delta, far, found);
    let around = |d2: f32, s: u32| {
        // The design weighs by distance alone; but a sprinkle of fifty small Gaussians must not outvote the icing around it.
        (o.rgb[s as usize], o.cover[s as usize] / (d2 + 0.01 * delta * delta))
    };
    let mut colours = [([0.0f32; 3], 0.0f32); COLOURS];
    let used = found.len().min(COLOURS);
    colours.iter_mut().zip(found.iter()).for_each(|(c, &(d2, s))| *c = around(d2, s));
    let outside = middle(&mut colours[..used]);
    let rgb = match found.first() {
        Some(nearest) => {
            let d = nearest.0.sqrt() / o.spacing;
            let own = ((d - OWN_COLOUR[0]) / (OWN_COLOUR[1] - OWN_COLOUR[0])).clamp(0.0, 1.0);
            vec3::lerp(outside, inside, own)
        }
        None => inside,
    };
    match projected {
        Some(p) => Fresh { normal: p.normal, up: vec3::sub(p.position, x), rgb },
        None => Fresh { normal: [0.0; 3], up: [0.0; 3], rgb },
    }
}

/// Weighted mean of the colours without the brightest and the darkest: the photographed colours of a glossy thing contain what it
/// mirrored.
fn middle(colours: &mut [([f32; 3], f32)]) -> [f32; 3] {
    let light = |c: [f32; 3]| 0.2126 * c[0] + 0.7152 * c[1] + 0.0722 * c[2];
    colours.sort_by(|a, b| light(a.0).total_cmp(&light(b.0)));
    let total: f32 = colours.iter().map(|c| c.1).sum();
    let (from, to) = (OUTLIERS * total, (1.0 - OUTLIERS) * total);
    let (mut rgb, mut sum, mut at) = ([0.0f32; 3], 0.0f32, 0.0f32);
    for &(c, w) in colours.iter() {
        let share = ((at + w).min(to) - at.max(from)).max(0.0);
        rgb = vec3::add_scaled(rgb, c, share);
        sum += share;
        at += w;
    }
    vec3::scale(rgb, 1.0 / sum.max(1e-30))
}

/// Covariance of a kernel of radius `r` and normal `n` that lies `depth` below the surface.
pub(crate) fn covariance(s: &DensifySettings, r: f32, n: Vec3<f32>, depth: f32) -> [f32; 6] {
    let v = r * r;
    if s.kernel == Kernel::Ball || n == [0.0; 3] {
        return [v, 0.0, 0.0, v, 0.0, v];
    }
    let thickness = (depth.abs() / DEPTH_IN_SIGMA).clamp(THIN * r, THICK * r);
    // r² (I − n nᵀ) + t² n nᵀ
    let e = thickness * thickness - v;
    [v + e * n[0] * n[0], e * n[0] * n[1], e * n[0] * n[2], v + e * n[1] * n[1], e * n[1] * n[2], v + e * n[2] * n[2]]
}

/// Where the kernel stands: the particle's place, or part of the way to the surface.
pub(crate) fn place(s: &DensifySettings, x: Vec3<f32>, up: Vec3<f32>, delta: f32) -> Vec3<f32> {
    let far = vec3::norm(up) / delta;
    vec3::add_scaled(x, up, s.snap * (2.0 - 2.0 * far).clamp(0.0, 1.0))
}

/// Base colour of a Gaussian of a set.
pub(crate) fn base_rgb(g: &Gaussians, i: usize) -> [f32; 3] {
    let c = &g.sh[i * g.sh_stride()..];
    [sh::rgb_from_dc(c[0]), sh::rgb_from_dc(c[1]), sh::rgb_from_dc(c[2])].map(|v| v.clamp(0.0, 1.0))
}

/// Opacity times the area of a Gaussian's largest cross-section: the root of the sum of the principal minors of its covariance,
/// which for a disc is `S¹S²`.
pub(crate) fn cover(g: &Gaussians, i: usize) -> f32 {
    let [xx, xy, xz, yy, yz, zz] = g.covariance[i];
    let minors = (xx * yy - xy * xy) + (xx * zz - xz * xz) + (yy * zz - yz * yz);
    g.opacity[i] * minors.max(1e-30).sqrt()
}
