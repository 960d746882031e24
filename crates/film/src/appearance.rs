//! Appearance that the photographs cannot know: matter that glows, melts that are wet. Applied to posed Gaussians before they
//! are drawn; cold solids keep every bit of their colour.

use megas_math::{sh, vec3};
use megas_model::{Camera, Projection};
use megas_raster::Gaussians;
use rayon::prelude::*;

use crate::blackbody::glow;
use crate::wetness::{sheen, wet_albedo};

/// What to show, and how strongly.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Appearance {
    /// Brightness of glowing matter at `white`, relative to a white surface; 0 switches it off.
    pub glow: f32,
    /// Temperature \[K\] at which glowing matter is as bright as a white surface.
    pub white: f32,
    /// Exponent of the luminance: 1 is a camera with one exposure, which sees 1000 K as black where 1500 K is white; less
    /// compresses the range as the eye does (Stevens' power law: 0.33).
    pub compression: f32,
    /// How wet melts look, 0 (not at all) to 1.
    pub wet: f32,
}

impl Appearance {
    /// Nothing: the colours of the input.
    pub const OFF: Self = Self { glow: 0.0, white: 1500.0, compression: 0.33, wet: 0.0 };
}

/// Below this nothing glows \[K\]; from here to `VISIBLE` it fades in.
const DARK: f32 = 750.0;
const VISIBLE: f32 = 850.0;

fn linear(v: f32) -> f32 {
    if v <= 0.04045 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) }
}

fn encoded(v: f32) -> f32 {
    if v <= 0.003_130_8 { 12.92 * v } else { 1.055 * v.powf(1.0 / 2.4) - 0.055 }
}

fn smooth(x: f32, from: f32, to: f32) -> f32 {
    let t = ((x - from) / (to - from)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

impl Appearance {
    /// Light that matter of this temperature sends out, linear sRGB with 1 = a white surface; `None` if it does not glow.
    pub fn emission(&self, kelvin: f32) -> Option<[f32; 3]> {
        let fade = smooth(kelvin, DARK, VISIBLE);
        if self.glow <= 0.0 || fade <= 0.0 {
            return None;
        }
        let (l, colour) = glow(kelvin, self.white)?;
        // Overexposure is limited: two stops above white everything is white.
        let luminance = (self.compression * l).exp().min(4.0) * self.glow * fade;
        Some(colour.map(|c| c * luminance))
    }

    /// A display colour with glow added: summed as light, bright channels rolled off towards 1.
    pub fn shade(&self, rgb: [f32; 3], kelvin: f32, liquid: f32) -> [f32; 3] {
        let wet = self.wet * smooth(liquid, 0.3, 0.9);
        let emitted = self.emission(kelvin);
        if wet <= 0.0 && emitted.is_none() {
            return rgb;
        }
        let mut light = rgb.map(|v| linear(v.clamp(0.0, 1.0)));
        if wet > 0.0 {
            // Colour is lit albedo; 0.9 is the whitest thing that photographs show at full light.
            light = light.map(|v| v + wet * (wet_albedo(0.9 * v) / 0.9 - v));
        }
        if let Some(e) = emitted {
            light = [0, 1, 2].map(|k| light[k] + e[k]);
        }
        light.map(|v| encoded(if v > 0.8 { 0.8 + 0.2 * (1.0 - (-(v - 0.8) / 0.2).exp()) } else { v }))
    }

    /// Changes the colours of posed Gaussians for the frame: emission and darkening. `liquid` holds the melt fraction of the first
    /// Gaussians; later ones (the background) are dry.
    pub fn apply(&self, g: &mut Gaussians, liquid: &[f32]) {
        if self.glow <= 0.0 && self.wet <= 0.0 {
            return;
        }
        let stride = g.sh_stride();
        let temperature = &g.temperature;
        g.sh.par_chunks_mut(stride).with_min_len(1024).enumerate().for_each(|(i, c)| {
            let kelvin = temperature.get(i).copied().unwrap_or(megas_model::AMBIENT_K);
            let old = [0, 1, 2].map(|k| sh::rgb_from_dc(c[k]));
            let new = self.shade(old, kelvin, liquid.get(i).copied().unwrap_or(0.0));
            if new != old {
                // What depends on the view is reflected light: it changes as the reflected part does and drowns in the glow.
                let reflected = self.shade(old, 0.0, liquid.get(i).copied().unwrap_or(0.0));
                let keep = (0..3).map(|k| (reflected[k] / new[k].max(1e-3)).min(1.0)).fold(1.0, f32::min);
                c[3..].iter_mut().for_each(|v| *v *= keep);
                (0..3).for_each(|k| c[k] = sh::dc_from_rgb(new[k]));
            }
        });
    }

    /// Adds what melts mirror to a camera. `up` and `lamp` are unit directions in the scene's axes.
    pub fn add_sheen(&self, g: &mut Gaussians, liquid: &[f32], camera: &Camera, up: [f32; 3], lamp: [f32; 3]) {
        if self.wet <= 0.0 || g.normal.is_empty() {
            return;
        }
        let stride = g.sh_stride();
        let center = camera.center();
        let (mean, normal) = (&g.mean, &g.normal);
        g.sh.par_chunks_mut(stride).with_min_len(1024).zip(liquid).enumerate().for_each(|(i, (c, l))| {
            let wet = self.wet * smooth(*l, 0.3, 0.9);
            if wet <= 0.0 || vec3::dot(normal[i], normal[i]) < 0.25 {
                return;
            }
            let to_eye = match camera.projection {
                Projection::Pinhole { .. } => vec3::sub(center, mean[i]),
                Projection::Orthographic { .. } => vec3::scale(camera.rotation[2], -1.0),
            };
            let mirrored = wet * sheen(normal[i], vec3::normalize_or(to_eye, up), up, lamp);
            for v in &mut c[..3] {
                let light = linear(sh::rgb_from_dc(*v).clamp(0.0, 1.0)) + mirrored;
                *v = sh::dc_from_rgb(encoded(light.min(1.0)));
            }
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ON: Appearance = Appearance { glow: 1.0, wet: 0.6, ..Appearance::OFF };

    fn set(kelvin: &[f32]) -> Gaussians {
        let mut g = Gaussians::new(1);
        for t in kelvin {
            g.push([0.0; 3], [1.0; 6], [0.0, 0.0, 1.0], 0.9, &[0.3; 12], *t);
        }
        g
    }

    #[test]
    fn cold_solids_keep_every_bit() {
        let before = set(&[250.0, 293.15, 700.0]);
        let mut g = before.clone();
        let camera = Camera::look_at([0.0, 0.0, 5.0], [0.0; 3], [0.0, 1.0, 0.0], 0.5, 64, 64);
        ON.apply(&mut g, &[0.0, 0.1, 0.0]);
        ON.add_sheen(&mut g, &[0.0, 0.1, 0.0], &camera, [0.0, 0.0, 1.0], [0.0, 0.0, 1.0]);
        assert_eq!(g, before);
        Appearance::OFF.apply(&mut g, &[1.0; 3]);
        Appearance::OFF.add_sheen(&mut g, &[1.0; 3], &camera, [0.0, 0.0, 1.0], [0.0, 0.0, 1.0]);
        assert_eq!(g, before);
    }

    #[test]
    fn hot_matter_glows_red_then_yellow_and_never_jumps() {
        let rock = [0.2, 0.2, 0.2];
        let at = |t: f32| ON.shade(rock, t, 0.0);
        let (dull, bright) = (at(950.0), at(1450.0));
        assert!(dull[0] > 0.3 && dull[0] > 1.4 * dull[2] && dull[1] < dull[0], "{dull:?}");
        assert!(bright[0] > dull[0] && bright[1] > dull[1] + 0.2 && bright[0] < 1.001, "{bright:?}");
        let most = (0..200).map(|k| {
            let (a, b) = (at(700.0 + 5.0 * k as f32), at(705.0 + 5.0 * k as f32));
            (0..3).map(|c| (a[c] - b[c]).abs()).fold(0.0, f32::max)
        });
        let most = most.fold(0.0, f32::max);
        assert!(most < 0.04, "{most}");
    }

    #[test]
    fn melts_darken_and_shine() {
        let mut g = set(&[300.0, 300.0]);
        let dry = g.clone();
        ON.apply(&mut g, &[0.0, 1.0]);
        assert_eq!(g.sh[..12], dry.sh[..12]);
        assert!(g.sh[12] < dry.sh[12]);
        let darkened = g.sh[12];
        let camera = Camera::look_at([0.0, 0.0, 5.0], [0.0; 3], [0.0, 1.0, 0.0], 0.5, 64, 64);
        ON.add_sheen(&mut g, &[0.0, 1.0], &camera, [0.0, 0.0, 1.0], [0.0, 0.0, 1.0]);
        assert_eq!(g.sh[..12], dry.sh[..12]);
        assert!(g.sh[12] > darkened);
    }
}
