//! Analytic bodies for tests: the minimum set of splatting.md §9.1 without the meshes.

use std::f64::consts::PI;

use megas_math::{Vec3, mat3, quat, rng::Rng, sh, vec3};
use megas_model::{Splats, logit};

use super::{blue_noise::blue_noise, noise::noise_at, primitives::smin, solid::Solid};

/// A test body, lengths in scene units. All but the dome are centred at the origin; +z is up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Shape {
    /// Ball.
    Sphere {
        /// Radius.
        radius: f32,
    },
    /// Ring in the xy plane.
    Torus {
        /// Radius of the centre line.
        major: f32,
        /// Radius of the tube, below `major`.
        minor: f32,
    },
    /// Upright cylinder with a cylindrical cavity open at the top; wall and floor have the same thickness.
    Cup {
        /// Outer radius.
        radius: f32,
        /// Outer height.
        height: f32,
        /// Thickness of wall and floor.
        wall: f32,
    },
    /// Two balls side by side along x, blended.
    Blobs {
        /// Radius of either.
        radius: f32,
        /// Distance of their centres.
        distance: f32,
        /// Size of the fillet.
        blend: f32,
    },
    /// Upper half of a ball standing on z = 0. Its shell leaves the flat bottom open.
    Dome {
        /// Radius.
        radius: f32,
    },
    /// Box.
    Plate {
        /// Half side lengths.
        half: [f32; 3],
    },
}

/// How [`Shape::shell`] covers a surface with discs (the synthetic shells of splatting.md §6.5).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shell {
    /// Least distance r_min of two centres.
    pub spacing: f32,
    /// S¹ = S² in units of the spacing (1.1 gives a mean alpha of 0.96, §5.5).
    pub size: f32,
    /// Opacities are uniform between these.
    pub opacity: [f32; 2],
    /// Random seed.
    pub seed: u64,
}

impl Default for Shell {
    fn default() -> Self {
        Self { spacing: 0.03, size: 1.1, opacity: [0.5, 0.97], seed: 1 }
    }
}

impl Shape {
    /// Exact volume where a formula exists (not for blended blobs).
    pub fn exact_volume(&self) -> Option<f64> {
        let cylinder = |r: f64, h: f64| PI * r * r * h;
        Some(match *self {
            Self::Sphere { radius } => 4.0 / 3.0 * PI * f64::from(radius).powi(3),
            Self::Torus { major, minor } => 2.0 * PI * PI * f64::from(major) * f64::from(minor).powi(2),
            Self::Cup { radius, height, wall } => {
                let (r, h, w) = (f64::from(radius), f64::from(height), f64::from(wall));
                cylinder(r, h) - cylinder(r - w, h - w)
            }
            Self::Blobs { .. } => return None,
            Self::Dome { radius } => 2.0 / 3.0 * PI * f64::from(radius).powi(3),
            Self::Plate { half } => 8.0 * half.iter().map(|&h| f64::from(h)).product::<f64>(),
        })
    }

    /// A single layer of blue-noise discs with outward normals and the body's solid colour, object 1. The dome's bottom is left
    /// open.
    pub fn shell(&self, settings: &Shell) -> Splats {
        let points = blue_noise(self, settings.spacing, settings.seed);
        let mut rng = Rng::new(settings.seed ^ 0x5e11);
        let mut out = Splats::with_capacity(0, points.len());
        let s = (settings.size * settings.spacing).ln();
        let thin = (0.1 * settings.size * settings.spacing).ln();
        for p in points {
            let opacity = rng.range(f64::from(settings.opacity[0]), f64::from(settings.opacity[1])) as f32;
            if matches!(self, Self::Dome { .. }) && p.normal[2] < -0.9 {
                continue;
            }
            let rgb = self.albedo(p.position);
            out.push(p.position, [s, s, thin], disc_rotation(p.normal), logit(opacity), &rgb.map(sh::dc_from_rgb));
        }
        out.object_id.fill(1);
        out.normal_sign.fill(1);
        out
    }
}

/// Quaternion of a frame whose third axis is `n`.
pub(super) fn disc_rotation(n: Vec3<f32>) -> [f32; 4] {
    let (a, b) = vec3::frame_from_normal(n);
    quat::from_mat3(mat3::from_columns(a, b, n))
}

/// Distance of a box of the given half sizes around the origin.
fn cuboid(x: Vec3<f32>, half: Vec3<f32>) -> f32 {
    let q: Vec3<f32> = std::array::from_fn(|a| x[a].abs() - half[a]);
    vec3::norm(q.map(|v| v.max(0.0))) + q[0].max(q[1]).max(q[2]).min(0.0)
}

/// Exact distance in two dimensions of a rectangle `|u| ≤ a`, `|v| ≤ b`.
fn rectangle(u: f32, v: f32, a: f32, b: f32) -> f32 {
    cuboid([u, v, 0.0], [a, b, f32::INFINITY])
}

impl Solid for Shape {
    fn sdf(&self, x: Vec3<f32>) -> f32 {
        let rho = (x[0] * x[0] + x[1] * x[1]).sqrt();
        match *self {
            Self::Sphere { radius } => vec3::norm(x) - radius,
            Self::Torus { major, minor } => ((rho - major).powi(2) + x[2] * x[2]).sqrt() - minor,
            Self::Cup { radius, height, wall } => {
                let side = rectangle(rho - radius + 0.5 * wall, x[2], 0.5 * wall, 0.5 * height);
                let floor = rectangle(rho, x[2] + 0.5 * (height - wall), radius, 0.5 * wall);
                side.min(floor)
            }
            Self::Blobs { radius, distance, blend } => {
                let at = |s: f32| vec3::norm([x[0] - s * 0.5 * distance, x[1], x[2]]) - radius;
                smin(at(-1.0), at(1.0), blend)
            }
            Self::Dome { radius } => {
                if x[2] < 0.0 && rho > radius {
                    ((rho - radius).powi(2) + x[2] * x[2]).sqrt()
                } else {
                    (vec3::norm(x) - radius).max(-x[2])
                }
            }
            Self::Plate { half } => cuboid(x, half),
        }
    }

    fn bounds(&self) -> (Vec3<f32>, Vec3<f32>) {
        let hi = match *self {
            Self::Sphere { radius } | Self::Dome { radius } => [radius; 3],
            Self::Torus { major, minor } => [major + minor, major + minor, minor],
            Self::Cup { radius, height, .. } => [radius, radius, 0.5 * height],
            Self::Blobs { radius, distance, blend } => {
                [0.5 * distance + radius + 0.25 * blend, radius + 0.25 * blend, radius + 0.25 * blend]
            }
            Self::Plate { half } => half,
        };
        let mut lo = hi.map(|v| -v);
        if matches!(self, Self::Dome { .. }) {
            lo[2] = 0.0;
        }
        (lo, hi)
    }

    /// Smooth solid noise and stripes, the same for every body (splatting.md §9.1).
    fn albedo(&self, x: Vec3<f32>) -> [f32; 3] {
        let stripe = 0.5 + 0.5 * (18.0 * (x[0] + 0.4 * x[1] + 0.7 * x[2]) + 2.0 * noise_at(x, 3.0, 70.0)).sin();
        let tint = |seed: f32| 0.5 + 0.45 * noise_at(x, 2.5, seed);
        [0.15 + 0.7 * tint(71.0) + 0.1 * stripe, 0.1 + 0.45 * tint(72.0) + 0.35 * stripe, 0.2 + 0.6 * tint(73.0) - 0.1 * stripe]
            .map(|v| v.clamp(0.0, 1.0))
    }
}
