//! 3D Gaussian splats as a structure of arrays (splatting.md §1.1).

use megas_math::{Mat3, Vec3, mat3, quat, sh};

use crate::AMBIENT_K;

/// Where a Gaussian came from; stored as `u8` in [`Splats::origin`].
#[repr(u8)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Origin {
    /// Reconstructed or imported surface.
    Surface = 0,
    /// Filled internal particle.
    Internal = 1,
    /// Background patch under the object.
    Patch = 2,
}

/// Phase of matter; stored as `u8` in [`Splats::phase`] and in the simulator's output.
#[repr(u8)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Phase {
    /// Never melted.
    Solid = 0,
    /// Liquid.
    Liquid = 1,
    /// Partly molten.
    Mushy = 2,
    /// Solid again after having been liquid.
    Resolidified = 3,
}

/// A set of 3D Gaussians. All arrays have the same length [`Splats::len`], `sh` has `len · (degree+1)² · 3` values in
/// `[Gaussian][coefficient][channel]` order. Positions are in scene units.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Splats {
    /// Spherical-harmonic degree, 0–3.
    pub sh_degree: u8,
    /// Centres.
    pub mean: Vec<[f32; 3]>,
    /// Natural logarithm of the standard deviations along the local axes.
    pub log_scale: Vec<[f32; 3]>,
    /// Rotation quaternions `[w, x, y, z]`, not necessarily normalised.
    pub rotation: Vec<[f32; 4]>,
    /// Logit of the opacity; ±∞ is legal.
    pub opacity_logit: Vec<f32>,
    /// Spherical-harmonic coefficients.
    pub sh: Vec<f32>,
    /// Temperature \[K\].
    pub temperature: Vec<f32>,
    /// 0 = static background, ≥ 1 = simulated object.
    pub object_id: Vec<u16>,
    /// See [`Phase`].
    pub phase: Vec<u8>,
    /// +1 or −1: makes the shortest axis point outward; 0 = not known.
    pub normal_sign: Vec<i8>,
    /// See [`Origin`].
    pub origin: Vec<u8>,
    /// Stable identity across frames.
    pub birth_id: Vec<u32>,
    /// Size, at the Gaussian, of a pixel of the photographs that it was trained on \[scene units\]; 0 = not known. What blurs a picture is
    /// that large in the model.
    pub trained_pixel: Vec<f32>,
}

impl Splats {
    /// An empty set with room for `capacity` Gaussians.
    pub fn with_capacity(sh_degree: u8, capacity: usize) -> Self {
        let mut s = Self { sh_degree, ..Self::default() };
        s.mean.reserve_exact(capacity);
        s.log_scale.reserve_exact(capacity);
        s.rotation.reserve_exact(capacity);
        s.opacity_logit.reserve_exact(capacity);
        s.sh.reserve_exact(capacity * s.sh_stride());
        s
    }

    /// Number of Gaussians.
    pub fn len(&self) -> usize {
        self.mean.len()
    }

    /// True if there are none.
    pub fn is_empty(&self) -> bool {
        self.mean.is_empty()
    }

    /// Values per Gaussian in [`Splats::sh`].
    pub fn sh_stride(&self) -> usize {
        sh::coefficients(self.sh_degree) * 3
    }

    /// The coefficients of Gaussian `i`.
    pub fn sh_of(&self, i: usize) -> &[f32] {
        let n = self.sh_stride();
        &self.sh[i * n..(i + 1) * n]
    }

    /// Appends one Gaussian with default attributes (ambient temperature, background, surface) and the next birth id.
    pub fn push(&mut self, mean: [f32; 3], log_scale: [f32; 3], rotation: [f32; 4], opacity_logit: f32, sh: &[f32]) {
        assert_eq!(sh.len(), self.sh_stride(), "coefficients do not match the degree of the set");
        self.mean.push(mean);
        self.log_scale.push(log_scale);
        self.rotation.push(rotation);
        self.opacity_logit.push(opacity_logit);
        self.sh.extend_from_slice(sh);
        self.fill_attributes();
    }

    /// Brings the optional attributes (temperature … trained pixel) to the length of [`Splats::mean`] with their defaults.
    pub fn fill_attributes(&mut self) {
        let n = self.mean.len();
        self.temperature.resize(n, AMBIENT_K);
        self.object_id.resize(n, 0);
        self.phase.resize(n, Phase::Solid as u8);
        self.normal_sign.resize(n, 0);
        self.origin.resize(n, Origin::Surface as u8);
        self.trained_pixel.resize(n, 0.0);
        for i in self.birth_id.len()..n {
            self.birth_id.push(i as u32);
        }
    }

    /// The Gaussians at `indices`, in that order.
    pub fn select(&self, indices: &[usize]) -> Self {
        fn pick<T: Copy>(v: &[T], indices: &[usize]) -> Vec<T> {
            indices.iter().map(|&i| v[i]).collect()
        }
        Self {
            sh_degree: self.sh_degree,
            mean: pick(&self.mean, indices),
            log_scale: pick(&self.log_scale, indices),
            rotation: pick(&self.rotation, indices),
            opacity_logit: pick(&self.opacity_logit, indices),
            sh: indices.iter().flat_map(|&i| self.sh_of(i).iter().copied()).collect(),
            temperature: pick(&self.temperature, indices),
            object_id: pick(&self.object_id, indices),
            phase: pick(&self.phase, indices),
            normal_sign: pick(&self.normal_sign, indices),
            origin: pick(&self.origin, indices),
            birth_id: pick(&self.birth_id, indices),
            trained_pixel: pick(&self.trained_pixel, indices),
        }
    }

    /// Appends `other`; the lower degree is padded with zero coefficients.
    pub fn append(&mut self, other: &Self) {
        if other.sh_degree > self.sh_degree {
            self.set_degree(other.sh_degree);
        }
        let (n, m) = (self.sh_stride(), other.sh_stride());
        for i in 0..other.len() {
            self.sh.extend_from_slice(other.sh_of(i));
            self.sh.extend(std::iter::repeat_n(0.0, n - m));
        }
        self.mean.extend_from_slice(&other.mean);
        self.log_scale.extend_from_slice(&other.log_scale);
        self.rotation.extend_from_slice(&other.rotation);
        self.opacity_logit.extend_from_slice(&other.opacity_logit);
        self.temperature.extend_from_slice(&other.temperature);
        self.object_id.extend_from_slice(&other.object_id);
        self.phase.extend_from_slice(&other.phase);
        self.normal_sign.extend_from_slice(&other.normal_sign);
        self.origin.extend_from_slice(&other.origin);
        self.birth_id.extend_from_slice(&other.birth_id);
        self.trained_pixel.extend_from_slice(&other.trained_pixel);
    }

    /// Changes the degree: drops higher bands or pads them with zeros.
    pub fn set_degree(&mut self, degree: u8) {
        let (old, new) = (self.sh_stride(), sh::coefficients(degree) * 3);
        if old == new {
            return;
        }
        let keep = old.min(new);
        let mut out = Vec::with_capacity(self.len() * new);
        for c in self.sh.chunks_exact(old) {
            out.extend_from_slice(&c[..keep]);
            out.extend(std::iter::repeat_n(0.0, new - keep));
        }
        self.sh = out;
        self.sh_degree = degree;
    }

    /// Opacity in [0, 1].
    #[inline(always)]
    pub fn opacity(&self, i: usize) -> f32 {
        1.0 / (1.0 + (-self.opacity_logit[i]).exp())
    }

    /// Standard deviations along the local axes.
    #[inline(always)]
    pub fn scale(&self, i: usize) -> Vec3<f32> {
        self.log_scale[i].map(f32::exp)
    }

    /// Rotation matrix; its columns are the local axes.
    #[inline(always)]
    pub fn axes(&self, i: usize) -> Mat3<f32> {
        quat::to_mat3(self.rotation[i])
    }

    /// Covariance `R diag(S²) Rᵀ`.
    pub fn covariance(&self, i: usize) -> Mat3<f32> {
        let (r, s) = (self.axes(i), self.scale(i));
        mat3::mul(mat3::mul(r, mat3::diag([s[0] * s[0], s[1] * s[1], s[2] * s[2]])), mat3::transpose(r))
    }

    /// Index (0–2) of the shortest local axis; the first of equals.
    #[inline(always)]
    pub fn shortest_axis(&self, i: usize) -> usize {
        let s = self.log_scale[i];
        let k = usize::from(s[1] < s[0]);
        if s[2] < s[k] { 2 } else { k }
    }

    /// Unit normal: the shortest axis, turned by [`Splats::normal_sign`] where that is known.
    pub fn normal(&self, i: usize) -> Vec3<f32> {
        let n = mat3::column(self.axes(i), self.shortest_axis(i));
        if self.normal_sign[i] < 0 { n.map(|v| -v) } else { n }
    }

    /// View-independent colour (the DC term) in [0, 1] where the file kept to that.
    pub fn base_rgb(&self, i: usize) -> [f32; 3] {
        let c = self.sh_of(i);
        std::array::from_fn(|ch| sh::rgb_from_dc(c[ch]))
    }

    /// Mean colour as seen from outside, in [0, 1] where the file kept to that (see [`sh::seen_dc`]); needs outward normals.
    pub fn seen_rgb(&self, i: usize) -> [f32; 3] {
        sh::seen_dc(self.sh_of(i), self.normal(i)).map(sh::rgb_from_dc)
    }

    /// [`Splats::trained_pixel`] where any is known, else nothing.
    pub fn known_pixels(&self) -> &[f32] {
        if self.trained_pixel.iter().any(|p| *p > 0.0) { &self.trained_pixel } else { &[] }
    }

    /// Axis-aligned box of the means `(min, max)`; `None` without Gaussians.
    pub fn bounds(&self) -> Option<(Vec3<f32>, Vec3<f32>)> {
        let first = *self.mean.first()?;
        Some(self.mean.iter().fold((first, first), |(lo, hi), &m| (megas_math::vec3::min(lo, m), megas_math::vec3::max(hi, m))))
    }
}

/// Logit of an opacity; ±∞ at 1 and 0.
pub fn logit(opacity: f32) -> f32 {
    (opacity / (1.0 - opacity)).ln()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample() -> Splats {
        let mut s = Splats { sh_degree: 1, ..Splats::default() };
        for i in 0..3 {
            let c: Vec<f32> = (0..12).map(|k| (i * 12 + k) as f32).collect();
            s.push([i as f32; 3], [0.0, -1.0, -2.0 + i as f32], [1.0, 0.0, 0.0, 0.0], 0.0, &c);
        }
        s
    }

    #[test]
    fn selection_append_and_degree_keep_rows_together() {
        let s = sample();
        let mut t = s.select(&[2, 0]);
        assert_eq!(t.sh_of(0), s.sh_of(2));
        assert_eq!(t.birth_id, [2, 0]);
        let mut low = Splats { sh_degree: 0, ..Splats::default() };
        low.push([9.0; 3], [0.0; 3], [1.0, 0.0, 0.0, 0.0], 0.0, &[1.0, 2.0, 3.0]);
        t.append(&low);
        assert_eq!(t.sh_of(2)[..4], [1.0, 2.0, 3.0, 0.0]);
        t.set_degree(0);
        assert_eq!(t.sh_of(0), &s.sh_of(2)[..3]);
    }

    #[test]
    fn the_normal_is_the_shortest_axis_with_its_sign() {
        let mut s = sample();
        assert_eq!(s.normal(0), [0.0, 0.0, 1.0]);
        s.normal_sign[0] = -1;
        assert_eq!(s.normal(0), [-0.0, -0.0, -1.0]);
        assert_eq!(s.shortest_axis(2), 1);
    }
}
