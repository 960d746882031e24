//! Surface splats placed directly on the ground truth, as a perfect reconstruction would give them.

use megas_math::{Vec3, mat3, sh, vec3};
use megas_model::{Splats, fibonacci_directions, logit};
use rayon::prelude::*;

use super::{
    blue_noise::{SurfacePoint, blue_noise, neighbours},
    light::{Finish, Light},
    shapes::disc_rotation,
    solid::{Solid, gradient},
    sundae::{Part, Sundae},
    sundae_colour,
};

/// How [`Sundae::sprinkle`] covers the scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sprinkle {
    /// Least distance of two splats on the object, scene units; the count grows with its inverse square (0.0105: about 60 000).
    pub spacing: f32,
    /// The same on the table.
    pub table_spacing: f32,
    /// S¹ = S² in units of the spacing (splatting.md §5.5).
    pub size: f32,
    /// Opacity of every splat, below 1.
    pub opacity: f32,
    /// Degree of the spherical harmonics, 0–3; gloss needs at least 2.
    pub sh_degree: u8,
    /// Random seed.
    pub seed: u64,
}

impl Default for Sprinkle {
    fn default() -> Self {
        Self { spacing: 0.0105, table_spacing: 0.0165, size: 0.7, opacity: 0.97, sh_degree: 2, seed: 1 }
    }
}

/// One of the two bodies of the scene.
struct Body<'a> {
    scene: &'a Sundae,
    table: bool,
}

impl Solid for Body<'_> {
    fn sdf(&self, x: Vec3<f32>) -> f32 {
        if self.table { self.scene.table_sdf(x) } else { self.scene.object_sdf(x) }
    }
    fn bounds(&self) -> (Vec3<f32>, Vec3<f32>) {
        if self.table { self.scene.table_bounds() } else { self.scene.object_bounds() }
    }
    fn albedo(&self, x: Vec3<f32>) -> [f32; 3] {
        self.scene.albedo(x)
    }
}

/// A body under light.
pub(super) trait Lit: Solid {
    /// The light.
    fn light(&self) -> &Light;
    /// Number and finish of the part at a point of the surface.
    fn look(&self, x: Vec3<f32>) -> (u16, Finish);
    /// Unlit colour of a part at a point.
    fn colour(&self, x: Vec3<f32>, part: u16) -> [f32; 3];
}

impl Lit for Body<'_> {
    fn light(&self) -> &Light {
        self.scene.light()
    }

    fn look(&self, x: Vec3<f32>) -> (u16, Finish) {
        let part = match self.scene.part(x) {
            _ if self.table => Part::Table,
            // The bowl's underside touches the table top.
            Part::Table => Part::Bowl,
            other => other,
        };
        (part as u16, sundae_colour::finish(part))
    }

    fn colour(&self, x: Vec3<f32>, part: u16) -> [f32; 3] {
        sundae_colour::albedo(self.scene, x, Part::ALL[usize::from(part)])
    }
}

impl Sundae {
    /// Covers object (closed, bottom included) and table with one layer of discs: oriented to the outside, coloured as
    /// photographs show them, `object_id` = [`Part`]. The object comes first, then the table.
    pub fn sprinkle(&self, settings: &Sprinkle) -> Splats {
        let fit = Fit::new(settings.sh_degree);
        let mut out = Splats { sh_degree: settings.sh_degree, ..Splats::default() };
        for table in [false, true] {
            let body = Body { scene: self, table };
            let spacing = if table { settings.table_spacing } else { settings.spacing };
            cover(&body, spacing, settings.seed + u64::from(table), settings, &fit, &mut out);
        }
        out
    }
}

/// Adds one layer of discs on a body, their numbers in `object_id`.
pub(super) fn cover(body: &impl Lit, spacing: f32, seed: u64, settings: &Sprinkle, fit: &Fit, out: &mut Splats) {
    let points = blue_noise(body, spacing, seed);
    let size = spacing * settings.size;
    let dots: Vec<Dot> = points.par_iter().map(|p| dot(body, p, size, fit)).collect();
    let logit = logit(settings.opacity);
    let s = size.ln();
    let first = out.len();
    for (p, dot) in points.iter().zip(&dots) {
        out.push(p.position, [s, s, s - 5f32.ln()], disc_rotation(p.normal), logit, &dot.sh);
        let last = out.len() - 1;
        out.object_id[last] = dot.part;
        out.normal_sign[last] = 1;
    }
    sharpen(out, first, &points, spacing, size);
}

/// Part and colour of a disc of standard deviation `s`: albedo and relief averaged over the disc, light taken at its centre.
fn dot(body: &impl Lit, p: &SurfacePoint, s: f32, fit: &Fit) -> Dot {
    let (part, finish) = body.look(p.position);
    let lit = body.light().receive(p.position, p.normal);
    let (a, b) = vec3::frame_from_normal(p.normal);
    let taps: [(Vec3<f32>, [f32; 3]); 4] = std::array::from_fn(|k| {
        let (u, v) = [(0.6, 0.25), (-0.25, 0.6), (-0.6, -0.25), (0.25, -0.6)][k];
        let x = vec3::add_scaled(vec3::add_scaled(p.position, a, u * s), b, v * s);
        let n = gradient(|x| body.sdf(x), x, 1e-3);
        (n, body.colour(x, part))
    });
    let colour = |d: Vec3<f32>| {
        let sum = taps.iter().fold([0.0; 3], |sum, &(n, c)| vec3::add(sum, body.light().shade(&lit, n, d, c, finish)));
        vec3::scale(sum, 0.25)
    };
    let view_dependent = finish.gloss > 0.2 && fit.degree > 0;
    let coefficients = if view_dependent {
        fit.apply(p.normal, colour)
    } else {
        let mut sh = vec![0.0; sh::coefficients(fit.degree) * 3];
        let rgb = colour(vec3::scale(p.normal, -1.0));
        sh[..3].copy_from_slice(&rgb.map(sh::dc_from_rgb));
        sh
    };
    Dot { part, sh: coefficients }
}

/// Discs blend with their neighbours, which blurs what they show. Van Cittert's iteration on the base colours undoes that as
/// far as the spacing allows: what the blend lacks is added to the disc in the middle.
fn sharpen(splats: &mut Splats, first: usize, points: &[SurfacePoint], spacing: f32, sigma: f32) {
    const ITERATIONS: usize = 3;
    let reach = (2.4 * sigma).min(2.0 * spacing);
    let near = neighbours(points, reach);
    let stride = splats.sh_stride();
    let target: Vec<[f32; 3]> = (0..points.len()).map(|i| splats.base_rgb(first + i)).collect();
    let weights: Vec<Vec<(u32, f32)>> = near
        .par_iter()
        .enumerate()
        .map(|(i, list)| {
            let p = &points[i];
            let blend = |&j: &u32| {
                let q = &points[j as usize];
                let e = vec3::sub(q.position, p.position);
                (vec3::dot(p.normal, q.normal) > 0.3).then(|| (j, (-0.5 * vec3::dot(e, e) / (sigma * sigma)).exp()))
            };
            list.iter().filter_map(blend).collect()
        })
        .collect();
    let mut colour = target.clone();
    for _ in 0..ITERATIONS {
        let next: Vec<[f32; 3]> = weights
            .par_iter()
            .enumerate()
            .map(|(i, list)| {
                let (mut sum, mut total) = (colour[i], 1.0);
                for &(j, w) in list {
                    sum = vec3::add_scaled(sum, colour[j as usize], w);
                    total += w;
                }
                // Overshoot beyond what can be shown would come back as specks when the thing deforms.
                std::array::from_fn(|c| (colour[i][c] + 0.8 * (target[i][c] - sum[c] / total)).clamp(0.0, 1.0))
            })
            .collect();
        colour = next;
    }
    for (i, (now, was)) in colour.iter().zip(&target).enumerate() {
        for c in 0..3 {
            splats.sh[(first + i) * stride + c] += sh::dc_from_rgb(now[c]) - sh::dc_from_rgb(was[c]);
        }
    }
}

struct Dot {
    part: u16,
    sh: Vec<f32>,
}

/// Least-squares fit of spherical harmonics to a colour known on the front side of a disc, in the frame of its normal.
pub(super) struct Fit {
    degree: u8,
    directions: Vec<Vec3<f32>>,
    /// Coefficients = `inverse` (n × directions) · values.
    inverse: Vec<f64>,
}

impl Fit {
    /// Directions are those from the camera; the back is asked, weakly, for the mean of the front.
    pub fn new(degree: u8) -> Self {
        let directions = fibonacci_directions(64);
        let n = sh::coefficients(degree);
        let basis: Vec<[f64; 16]> = directions.iter().map(|d| sh::basis(d.map(f64::from))).collect();
        let weight = |d: &Vec3<f32>| if d[2] < -0.1 { 1.0 } else { 0.08 };
        let width = n + directions.len();
        let mut m = vec![0.0; n * width];
        for r in 0..n {
            for c in 0..n {
                m[r * width + c] = basis.iter().zip(&directions).map(|(y, d)| weight(d) * y[r] * y[c]).sum();
            }
            for (k, d) in directions.iter().enumerate() {
                m[r * width + n + k] = weight(d) * basis[k][r];
            }
        }
        // Gauss–Jordan on a small positive-definite matrix needs no pivoting.
        for i in 0..n {
            let p = m[i * width + i];
            m[i * width..(i + 1) * width].iter_mut().for_each(|v| *v /= p);
            for r in (0..n).filter(|&r| r != i) {
                let f = m[r * width + i];
                for c in 0..width {
                    m[r * width + c] -= f * m[i * width + c];
                }
            }
        }
        let inverse = (0..n).flat_map(|i| m[i * width + n..(i + 1) * width].to_vec()).collect();
        Self { degree, directions, inverse }
    }

    fn apply(&self, normal: Vec3<f32>, colour: impl Fn(Vec3<f32>) -> [f32; 3]) -> Vec<f32> {
        let (a, b) = vec3::frame_from_normal(normal);
        let frame = mat3::from_columns(a, b, normal);
        let mut values: Vec<[f32; 3]> = vec![[0.0; 3]; self.directions.len()];
        let (mut mean, mut front) = ([0.0; 3], 0.0);
        for (v, d) in values.iter_mut().zip(&self.directions).filter(|(_, d)| d[2] < -0.1) {
            *v = colour(mat3::mul_vec(frame, *d));
            mean = vec3::add(mean, *v);
            front += 1.0;
        }
        for (v, _) in values.iter_mut().zip(&self.directions).filter(|(_, d)| d[2] >= -0.1) {
            *v = vec3::scale(mean, 1.0 / front);
        }
        let n = sh::coefficients(self.degree);
        let mut out = vec![0.0f32; n * 3];
        for i in 0..n {
            let row = &self.inverse[i * self.directions.len()..(i + 1) * self.directions.len()];
            for c in 0..3 {
                out[i * 3 + c] = row.iter().zip(&values).map(|(w, v)| w * f64::from(v[c] - 0.5)).sum::<f64>() as f32;
            }
        }
        sh::rotate(self.degree, &mut out, mat3::cast(frame));
        out
    }
}
