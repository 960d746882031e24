//! The surface between oriented samples as the zero set of an implicit moving-least-squares field (splatting.md §7.4;
//! Kolluri 2008, and Öztireli et al. 2009 for the robust variant):
//!
//! ```text
//! f(x) = Σ φ_i s_i / Σ φ_i ,  s_i = n_i·(x−x_i) ,  φ_i = exp(−‖x−x_i‖²/h²)
//! ∇f   = [ Σ φ_i n_i + Σ ∇φ_i (s_i − f) ] / Σφ_i ,  ∇φ_i = −(2/h²) φ_i (x−x_i)
//! ```
//!
//! One [`Imls`] is one object: fields of touching objects must not see each other's samples. Two things differ from the
//! design's text, both for smoothness: all samples within 3h count instead of the 32 nearest of them (cutting at a count makes
//! f jump by percents of a weight, cutting at 3h by 1e-4), and they are found in sorted rows instead of a tree.

mod extend;
mod field;
#[cfg(test)]
mod reference;

use megas_math::{Vec3, vec3};
use rayon::prelude::*;

use crate::rows::Rows;
pub use extend::gap_samples;
use field::Scratch;

/// Oriented samples of one object's surface.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Samples {
    /// Positions \[scene units\].
    pub position: Vec<Vec3<f32>>,
    /// Outward unit normals. Samples whose normal is zero or not finite are ignored.
    pub normal: Vec<Vec3<f32>>,
    /// Weights in (0, 1]; empty: all 1.
    pub weight: Vec<f32>,
}

/// Constants of the field. Lengths are in units of the sample spacing d̄.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImlsSettings {
    /// Neighbour whose distance sets the bandwidth (12).
    pub neighbour: usize,
    /// Bandwidth per that distance (0.75).
    pub factor: f32,
    /// Smallest bandwidth (1.5 d̄).
    pub least: f32,
    /// Largest bandwidth (8 d̄).
    pub most: f32,
    /// Kolluri's weights: divides φ_i by the number of samples within h of x_i. For uneven sampling.
    pub even: bool,
    /// Robust refits: φ_i is multiplied by `exp(−‖n_i−∇f‖²/σ²)` with this σ (0.8 is usual), three times. Keeps edges sharp.
    pub robust: Option<f32>,
    /// Spacing d̄ \[scene units\]; measured where `None`. Give the smoothed value of earlier frames to keep films calm.
    pub spacing: Option<f32>,
}

impl Default for ImlsSettings {
    fn default() -> Self {
        Self { neighbour: 12, factor: 0.75, least: 1.5, most: 8.0, even: false, robust: None, spacing: None }
    }
}

/// The field at one place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FieldValue {
    /// f: signed distance to the surface near it, negative inside \[scene units\]; 0 where `weight` is 0.
    pub value: f32,
    /// ∇f, of length 1 up to the curvature times the distance.
    pub gradient: Vec3<f32>,
    /// Σφ.
    pub weight: f32,
    /// Bandwidth h that was used \[scene units\].
    pub bandwidth: f32,
    /// Distance to the nearest sample \[scene units\]; +∞ where none lies within three of the largest bandwidths.
    pub nearest: f32,
}

impl FieldValue {
    /// Whether the field means anything here: `Σφ ≥ 1e-8` and `‖∇f‖ ≥ 0.2`.
    pub fn is_valid(&self) -> bool {
        self.weight >= 1e-8 && vec3::norm(self.gradient) >= 0.2
    }

    /// `∇f/‖∇f‖`, zero where the field is undefined.
    pub fn normal(&self) -> Vec3<f32> {
        if self.is_valid() { vec3::normalize_or(self.gradient, [0.0; 3]) } else { [0.0; 3] }
    }
}

/// A point carried onto the surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Projection {
    /// The point of the surface \[scene units\].
    pub position: Vec3<f32>,
    /// Outward unit normal there.
    pub normal: Vec3<f32>,
    /// Bandwidth there \[scene units\].
    pub bandwidth: f32,
    /// Newton steps taken.
    pub steps: u32,
}

/// Most Newton steps of a projection.
const MOST_STEPS: u32 = 10;
/// Samples measured for the spacing.
const SPACING_SAMPLES: usize = 4096;
/// Points per parallel job.
const JOB: usize = 64;

/// The implicit surface of one object. Cheap to ask in parallel; answers do not depend on earlier questions or on threads.
#[derive(Clone, Debug)]
pub struct Imls {
    level: fearless_simd::Level,
    settings: ImlsSettings,
    spacing: f32,
    /// Samples in rows as wide as the nearest search, and four times as wide for what is far from all samples.
    rows: [Oriented; 2],
}

/// Samples in row order with their normals and weights.
#[derive(Clone, Debug, Default)]
struct Oriented {
    rows: Rows,
    n: [Vec<f32>; 3],
    weight: Vec<f32>,
}

impl Oriented {
    fn new(samples: &Samples, weight: &[f32], width: f32) -> Self {
        let rows = Rows::new(&samples.position, width);
        let axis = |a: usize| rows.item.iter().map(|&i| samples.normal[i as usize][a]).collect();
        let weight = rows.item.iter().map(|&i| weight[i as usize]).collect();
        Self { n: [axis(0), axis(1), axis(2)], weight, rows }
    }
}

impl Imls {
    /// The field of `samples`; `None` where no two usable samples lie apart (then there is no surface).
    ///
    /// # Panics
    /// If the arrays of `samples` have different lengths.
    pub fn new(samples: &Samples, settings: &ImlsSettings) -> Option<Self> {
        let n = samples.position.len();
        assert_eq!(samples.normal.len(), n, "normals");
        assert!(samples.weight.is_empty() || samples.weight.len() == n, "weights");
        let usable = |i: &usize| {
            let l = vec3::norm(samples.normal[*i]);
            samples.position[*i].iter().all(|v| v.is_finite()) && l > 0.5 && l < 2.0 && samples.weight.get(*i).is_none_or(|w| *w > 0.0)
        };
        let keep: Vec<usize> = (0..n).filter(usable).collect();
        let kept;
        let samples = if keep.len() == n {
            samples
        } else {
            kept = samples.select(&keep);
            &kept
        };
        let spacing = settings.spacing.unwrap_or_else(|| Rows::spacing(&samples.position, SPACING_SAMPLES));
        if samples.position.is_empty() || spacing.is_nan() || spacing <= 0.0 {
            return None;
        }
        let mut weight = if samples.weight.is_empty() { vec![1.0; keep.len()] } else { samples.weight.clone() };
        let width = settings.least * spacing;
        let build = |weight: &[f32]| [1.0, 4.0].map(|f| Oriented::new(samples, weight, f * width));
        let mut out = Self { level: fearless_simd::Level::new(), settings: *settings, spacing, rows: build(&weight) };
        if settings.even {
            let crowd: Vec<f32> =
                samples.position.par_iter().with_min_len(JOB).map_init(Scratch::default, |s, &x| out.crowd(s, x)).collect();
            weight.iter_mut().zip(&crowd).for_each(|(w, c)| *w /= c);
            out.rows = build(&weight);
        }
        Some(out)
    }

    /// Typical distance d̄ between neighbouring samples \[scene units\].
    pub fn spacing(&self) -> f32 {
        self.spacing
    }

    /// Number of samples that the field is made of.
    pub fn len(&self) -> usize {
        self.rows[0].rows.len()
    }

    /// Never: a field has samples.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// f and ∇f at `x`.
    pub fn evaluate(&self, x: Vec3<f32>) -> FieldValue {
        self.evaluate_with(&mut Scratch::default(), x)
    }

    /// Newton's method onto the zero set, `x ← x − f∇f/‖∇f‖²` with steps no longer than h, until a step is below 1e-3 d̄. `None`
    /// where the field is undefined on the way, where ten steps do not suffice, or where the surface is farther from `x` than
    /// `reach` \[scene units\].
    pub fn project(&self, x: Vec3<f32>, reach: f32) -> Option<Projection> {
        self.project_with(&mut Scratch::default(), x, reach)
    }

    /// [`Imls::evaluate`] of many points, in parallel, in their order.
    pub fn evaluate_all(&self, points: &[Vec3<f32>]) -> Vec<FieldValue> {
        points.par_iter().with_min_len(JOB).map_init(Scratch::default, |s, &x| self.evaluate_with(s, x)).collect()
    }

    /// [`Imls::project`] of many points, in parallel, in their order.
    pub fn project_all(&self, points: &[Vec3<f32>], reach: f32) -> Vec<Option<Projection>> {
        points.par_iter().with_min_len(JOB).map_init(Scratch::default, |s, &x| self.project_with(s, x, reach)).collect()
    }

    /// Distance to the nearest sample if it is below `reach`, in parallel.
    pub fn distance_all(&self, points: &[Vec3<f32>], reach: f32) -> Vec<Option<f32>> {
        let distance = |found: &mut Vec<(f32, u32)>, x: &Vec3<f32>| {
            self.rows[0].rows.nearest(*x, 1, self.spacing, reach, found);
            found.first().map(|f| f.0.sqrt())
        };
        points.par_iter().with_min_len(JOB).map_init(Vec::new, distance).collect()
    }
}

impl Samples {
    /// The samples moved out along their normals: means of splats lie below the surface that they draw (see [`crate::lost_depth`]).
    pub fn raised(mut self, by: f32) -> Self {
        for (x, n) in self.position.iter_mut().zip(&self.normal) {
            *x = vec3::add_scaled(*x, *n, by);
        }
        self
    }

    /// The samples at `indices`.
    pub fn select(&self, indices: &[usize]) -> Self {
        let pick = |v: &[Vec3<f32>]| indices.iter().map(|&i| v[i]).collect();
        let weight = if self.weight.is_empty() { Vec::new() } else { indices.iter().map(|&i| self.weight[i]).collect() };
        Self { position: pick(&self.position), normal: pick(&self.normal), weight }
    }

    /// Appends `other`.
    pub fn extend(&mut self, other: &Self) {
        if !(self.weight.is_empty() && other.weight.is_empty()) {
            self.weight.resize(self.position.len(), 1.0);
            self.weight.extend_from_slice(&other.weight);
        }
        self.position.extend_from_slice(&other.position);
        self.normal.extend_from_slice(&other.normal);
        if !self.weight.is_empty() {
            self.weight.resize(self.position.len(), 1.0);
        }
    }
}

#[cfg(test)]
mod tests;
