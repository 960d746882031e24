//! What the rasterizer draws: Gaussians given by their covariance, which is what deformation leaves behind.

use megas_math::{Mat3, Vec3, sh};
use megas_model::{AMBIENT_K, Splats};
use rayon::prelude::*;

/// Gaussians ready to draw, as a structure of arrays. `mean`, `covariance`, `opacity` have one value per Gaussian and `sh`
/// has `len · (degree+1)² · 3` in `[Gaussian][coefficient][channel]` order. The other arrays are either empty, which means
/// the default that each names, or as long. A value that is not finite makes the rasterizer skip that Gaussian.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Gaussians {
    /// Centres, world axes.
    pub mean: Vec<[f32; 3]>,
    /// Covariances `[xx, xy, xz, yy, yz, zz]`, world axes.
    pub covariance: Vec<[f32; 6]>,
    /// Opacities in [0, 1].
    pub opacity: Vec<f32>,
    /// Spherical-harmonic degree, 0–3.
    pub sh_degree: u8,
    /// Spherical-harmonic coefficients.
    pub sh: Vec<f32>,
    /// Unit normals of any sign, world axes; empty: zero.
    pub normal: Vec<[f32; 3]>,
    /// Rotation ΔR (row by row) of the appearance: colour is evaluated along `ΔRᵀ d` (splatting.md §8.3); empty: identity.
    pub view_rotation: Vec<[f32; 9]>,
    /// Temperatures \[K\]; empty: ambient.
    pub temperature: Vec<f32>,
    /// False hides a Gaussian; empty: all are drawn.
    pub visible: Vec<bool>,
    /// Sizes of a pixel of the photographs that each was trained on, at its place \[scene units\]; 0: not known; empty: 0. The low-pass
    /// is that of those pixels then, whatever the picture's own are (see [`crate::Settings::low_pass`]).
    pub trained_pixel: Vec<f32>,
}

/// The six values of a symmetric matrix in the order of [`Gaussians::covariance`].
#[inline(always)]
pub fn pack_covariance(c: Mat3<f32>) -> [f32; 6] {
    [c[0][0], c[0][1], c[0][2], c[1][1], c[1][2], c[2][2]]
}

/// The matrix of six packed values.
#[inline(always)]
pub fn unpack_covariance(c: [f32; 6]) -> Mat3<f32> {
    [[c[0], c[1], c[2]], [c[1], c[3], c[4]], [c[2], c[4], c[5]]]
}

impl Gaussians {
    /// An empty set of the given degree (0–3).
    pub fn new(sh_degree: u8) -> Self {
        Self { sh_degree: sh_degree.min(3), ..Self::default() }
    }

    /// All splats at rest, with normals and temperatures.
    pub fn from_splats(splats: &Splats) -> Self {
        let mut g = Self::default();
        g.assign_splats(splats);
        g
    }

    /// Replaces the contents by `splats` at rest without giving memory back.
    pub fn assign_splats(&mut self, splats: &Splats) {
        self.assign_shapes(splats);
        self.sh_degree = splats.sh_degree;
        self.sh.clear();
        self.sh.extend_from_slice(&splats.sh);
    }

    /// As [`Gaussians::assign_splats`] without the spherical harmonics, which are two thirds of the bytes: a trainer lends
    /// its own by swapping [`Gaussians::sh`].
    pub fn assign_shapes(&mut self, splats: &Splats) {
        const CHUNK: usize = 1024;
        let n = splats.len();
        self.view_rotation.clear();
        self.visible.clear();
        self.mean.resize(n, [0.0; 3]);
        self.covariance.resize(n, [0.0; 6]);
        self.opacity.resize(n, 0.0);
        self.normal.resize(n, [0.0; 3]);
        self.temperature.clear();
        self.temperature.extend_from_slice(&splats.temperature);
        self.trained_pixel.clear();
        self.trained_pixel.extend_from_slice(splats.known_pixels());
        let arrays = (
            self.mean.par_chunks_mut(CHUNK),
            self.covariance.par_chunks_mut(CHUNK),
            self.opacity.par_chunks_mut(CHUNK),
            self.normal.par_chunks_mut(CHUNK),
        );
        arrays.into_par_iter().enumerate().for_each(|(c, (mean, covariance, opacity, normal))| {
            for k in 0..mean.len() {
                let i = c * CHUNK + k;
                let (r, s) = (splats.axes(i), splats.scale(i));
                let m = r.map(|row| [row[0] * s[0], row[1] * s[1], row[2] * s[2]]);
                let dot = |a: usize, b: usize| m[a][0] * m[b][0] + m[a][1] * m[b][1] + m[a][2] * m[b][2];
                mean[k] = splats.mean[i];
                covariance[k] = [dot(0, 0), dot(0, 1), dot(0, 2), dot(1, 1), dot(1, 2), dot(2, 2)];
                opacity[k] = splats.opacity(i);
                normal[k] = splats.normal(i);
            }
        });
    }

    /// Number of Gaussians.
    pub fn len(&self) -> usize {
        self.mean.len()
    }

    /// True if there are none.
    pub fn is_empty(&self) -> bool {
        self.mean.is_empty()
    }

    /// Values per Gaussian in [`Gaussians::sh`].
    pub fn sh_stride(&self) -> usize {
        sh::coefficients(self.sh_degree) * 3
    }

    /// Removes everything, keeps the memory and the degree.
    pub fn clear(&mut self) {
        self.truncate(0);
    }

    /// Keeps the first `n`.
    pub fn truncate(&mut self, n: usize) {
        let stride = self.sh_stride();
        self.mean.truncate(n);
        self.covariance.truncate(n);
        self.opacity.truncate(n);
        self.sh.truncate(n * stride);
        self.normal.truncate(n);
        self.view_rotation.truncate(n);
        self.temperature.truncate(n);
        self.visible.truncate(n);
        self.trained_pixel.truncate(n);
    }

    /// Appends one Gaussian. `coefficients` must have [`Gaussians::sh_stride`] values.
    pub fn push(&mut self, mean: Vec3<f32>, covariance: [f32; 6], normal: Vec3<f32>, opacity: f32, coefficients: &[f32], temperature: f32) {
        assert_eq!(coefficients.len(), self.sh_stride(), "coefficients do not match the degree of the set");
        let n = self.len();
        fill(&mut self.normal, n, [0.0; 3]);
        fill(&mut self.temperature, n, AMBIENT_K);
        self.mean.push(mean);
        self.covariance.push(covariance);
        self.normal.push(normal);
        self.opacity.push(opacity);
        self.sh.extend_from_slice(coefficients);
        self.temperature.push(temperature);
        self.fill_optional();
    }

    /// Appends `other`; the degree of `self` stays: higher bands of `other` are dropped, missing ones are zero.
    pub fn extend_from(&mut self, other: &Self) {
        let (n, m) = (self.len(), other.len());
        fn join<T: Copy>(a: &mut Vec<T>, b: &[T], n: usize, m: usize, default: T) {
            if a.is_empty() && b.is_empty() {
                return;
            }
            a.resize(n, default);
            a.extend_from_slice(b);
            a.resize(n + m, default);
        }
        join(&mut self.normal, &other.normal, n, m, [0.0; 3]);
        join(&mut self.view_rotation, &other.view_rotation, n, m, IDENTITY);
        join(&mut self.temperature, &other.temperature, n, m, AMBIENT_K);
        join(&mut self.visible, &other.visible, n, m, true);
        join(&mut self.trained_pixel, &other.trained_pixel, n, m, 0.0);
        self.mean.extend_from_slice(&other.mean);
        self.covariance.extend_from_slice(&other.covariance);
        self.opacity.extend_from_slice(&other.opacity);
        let (mine, theirs) = (self.sh_stride(), other.sh_stride());
        if mine == theirs {
            self.sh.extend_from_slice(&other.sh);
        } else {
            for c in other.sh.chunks_exact(theirs) {
                self.sh.extend_from_slice(&c[..mine.min(theirs)]);
                self.sh.extend(std::iter::repeat_n(0.0, mine.saturating_sub(theirs)));
            }
        }
    }

    /// Sets `ΔR` of Gaussian `i`; the others keep theirs or the identity.
    pub fn set_view_rotation(&mut self, i: usize, rotation: Mat3<f32>) {
        let n = self.len();
        fill(&mut self.view_rotation, n, IDENTITY);
        let [a, b, c] = rotation;
        self.view_rotation[i] = [a[0], a[1], a[2], b[0], b[1], b[2], c[0], c[1], c[2]];
    }

    /// Hides or shows Gaussian `i`; the others keep their state or are shown.
    pub fn set_visible(&mut self, i: usize, visible: bool) {
        let n = self.len();
        fill(&mut self.visible, n, true);
        self.visible[i] = visible;
    }

    fn fill_optional(&mut self) {
        let n = self.len();
        if !self.view_rotation.is_empty() {
            fill(&mut self.view_rotation, n, IDENTITY);
        }
        if !self.visible.is_empty() {
            fill(&mut self.visible, n, true);
        }
        if !self.trained_pixel.is_empty() {
            fill(&mut self.trained_pixel, n, 0.0);
        }
    }

    /// Panics where the arrays do not fit together: a mistake of the program, never of the data.
    pub(crate) fn assert_shape(&self) {
        let n = self.len();
        assert!(self.sh_degree <= 3, "degree above 3");
        assert_eq!(self.covariance.len(), n, "covariances");
        assert_eq!(self.opacity.len(), n, "opacities");
        assert_eq!(self.sh.len(), n * self.sh_stride(), "spherical harmonics");
        assert!(self.normal.is_empty() || self.normal.len() == n, "normals");
        assert!(self.view_rotation.is_empty() || self.view_rotation.len() == n, "view rotations");
        assert!(self.temperature.is_empty() || self.temperature.len() == n, "temperatures");
        assert!(self.visible.is_empty() || self.visible.len() == n, "visibility");
        assert!(self.trained_pixel.is_empty() || self.trained_pixel.len() == n, "pixels of the training");
    }
}

const IDENTITY: [f32; 9] = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];

fn fill<T: Copy>(v: &mut Vec<T>, n: usize, default: T) {
    if v.len() < n {
        v.resize(n, default);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn joining_fills_defaults_and_degrees() {
        let mut a = Gaussians::new(0);
        a.push([0.0; 3], [1.0; 6], [0.0, 0.0, 1.0], 0.5, &[1.0, 2.0, 3.0], 300.0);
        let mut b = Gaussians::new(1);
        b.mean.push([1.0; 3]);
        b.covariance.push([2.0; 6]);
        b.opacity.push(0.25);
        b.sh.extend((0..12).map(|k| k as f32));
        b.set_visible(0, false);
        a.extend_from(&b);
        a.assert_shape();
        assert_eq!(a.sh, [1.0, 2.0, 3.0, 0.0, 1.0, 2.0]);
        assert_eq!(a.visible, [true, false]);
        assert_eq!(a.temperature, [300.0, AMBIENT_K]);
        b.extend_from(&a);
        b.assert_shape();
        assert_eq!(b.sh[12..16], [1.0, 2.0, 3.0, 0.0]);
        a.truncate(1);
        a.push([0.0; 3], [1.0; 6], [0.0, 0.0, 1.0], 0.5, &[1.0, 2.0, 3.0], 300.0);
        a.assert_shape();
    }
}
