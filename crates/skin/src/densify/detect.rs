//! Who can be seen: weights-only renders by virtual cameras around the body (splatting.md §7.1, §7.2).

use megas_math::{Vec3, vec3};
use megas_model::{Camera, fibonacci_directions};
use megas_raster::{Channels, Frame, Gaussians, Rasterizer, Settings};

/// Opacity of a particle in detection: opaque after the rasterizer's clamp.
const OPAQUE: f32 = 1.0;
/// Move or growth of the body, in its half size, that makes the cameras follow.
const FOLLOW: f32 = 0.1;

/// The ball that the cameras look at.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Rig {
    pub center: Vec3<f32>,
    /// Half size of the images; 0 before the first frame.
    pub half: f32,
}

impl Rig {
    /// Fixed in the world unless the box of the points has moved or changed by more than a tenth. A few stray points do not count.
    pub fn follow(&mut self, points: &[Vec3<f32>]) {
        if points.is_empty() {
            return;
        }
        let stride = points.len().div_ceil(20_000);
        let (mut lo, mut hi) = ([0.0; 3], [0.0; 3]);
        for a in 0..3 {
            let mut v: Vec<f32> = points.iter().step_by(stride).map(|p| p[a]).collect();
            let (from, to) = (v.len() / 500, v.len() - 1 - v.len() / 500);
            lo[a] = *v.select_nth_unstable_by(from, f32::total_cmp).1;
            hi[a] = *v.select_nth_unstable_by(to, f32::total_cmp).1;
        }
        let center = vec3::scale(vec3::add(lo, hi), 0.5);
        let half = (0.5 * 1.05 * vec3::norm(vec3::sub(hi, lo))).max(1e-6);
        let moved = vec3::norm(vec3::sub(center, self.center)) > FOLLOW * self.half;
        if self.half == 0.0 || moved || (half / self.half - 1.0).abs() > FOLLOW {
            *self = Self { center, half };
        }
    }

    /// Camera `k` of `count`.
    pub fn camera(&self, k: usize, count: usize, edge: u32) -> Camera {
        let d = fibonacci_directions(count)[k];
        let up = vec3::frame_from_normal(d).1;
        Camera::orthographic(self.center, d.map(|v| -v), up, self.half, 4.0 * self.half, edge, edge)
    }
}

/// Best score of each Gaussian over a few views.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Seen {
    /// Largest blend weight.
    pub w_max: Vec<f32>,
    /// Most pixels won, over all views together.
    pub won: Vec<u16>,
}

impl Seen {
    pub fn reset(&mut self, n: usize) {
        self.w_max.clear();
        self.w_max.resize(n, 0.0);
        self.won.clear();
        self.won.resize(n, 0);
    }
}

/// Renders that ask who is seen. Keeps scratch memory only.
#[derive(Debug)]
pub(crate) struct Detector {
    rasterizer: Rasterizer,
    frame: Frame,
    /// Surface Gaussians first, then the particles of `who`.
    pub set: Gaussians,
    /// Index of each Gaussian of the set: surface index, or surface count + particle index.
    pub who: Vec<u32>,
}

impl Default for Detector {
    fn default() -> Self {
        Self { rasterizer: Rasterizer::new(), frame: Frame::default(), set: Gaussians::new(0), who: Vec::new() }
    }
}

impl Detector {
    /// Fills the set with visible surface Gaussians and opaque balls at `particles` (index, place, radius).
    pub fn fill(&mut self, surface: &Gaussians, particles: impl Iterator<Item = (u32, Vec3<f32>, f32)>) {
        let s = &mut self.set;
        s.clear();
        self.who.clear();
        for i in 0..surface.len() {
            if surface.visible.get(i) != Some(&false) {
                s.mean.push(surface.mean[i]);
                s.covariance.push(surface.covariance[i]);
                s.opacity.push(surface.opacity[i]);
                self.who.push(i as u32);
            }
        }
        for (j, x, r) in particles {
            let v = r * r;
            s.mean.push(x);
            s.covariance.push([v, 0.0, 0.0, v, 0.0, v]);
            s.opacity.push(OPAQUE);
            self.who.push((surface.len() + j as usize) as u32);
        }
        s.sh.resize(3 * s.mean.len(), 0.0);
    }

    /// Asks one camera and takes the better of its answer and `seen`.
    pub fn look(&mut self, camera: &Camera, z_near: f32, seen: &mut Seen) {
        let settings = Settings { z_near, ..Settings::default() };
        self.rasterizer.render(&self.set, camera, &settings, Channels::Weights, &mut self.frame);
        let s = &self.frame.statistics;
        for (k, &i) in self.who.iter().enumerate() {
            let (w, won) = (&mut seen.w_max[i as usize], &mut seen.won[i as usize]);
            *w = w.max(s.w_max[k]);
            *won = won.saturating_add(s.argmax_pixels[k].min(u32::from(u16::MAX)) as u16);
        }
    }
}

/// Marks what lies within about `depth` cells of the outside of the points, cells of size `cell`: all that can be seen even
/// through a torn skin. Everything where the box has too many cells for a map.
pub(crate) fn near_outside(all: &[&[Vec3<f32>]], ask: &[Vec3<f32>], cell: f32, depth: usize) -> Vec<bool> {
    let (mut lo, mut hi) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    for p in all.iter().flat_map(|v| v.iter()).filter(|p| p.iter().all(|v| v.is_finite())) {
        (lo, hi) = (vec3::min(lo, *p), vec3::max(hi, *p));
    }
    let pad = depth as f32 + 1.0;
    let size = [0, 1, 2].map(|a| ((hi[a] - lo[a]) / cell + 2.0 * pad + 1.0) as f64);
    // Without points, all of which may have left, the box is less than nothing.
    if !(size[0] * size[1] * size[2] < 3e7 && size[0] > 0.0 && cell > 0.0) {
        return vec![true; ask.len()];
    }
    let size = size.map(|v| v as usize);
    let index = |p: &Vec3<f32>| -> usize {
        let c = [0, 1, 2].map(|a| (((p[a] - lo[a]) / cell + pad) as usize).min(size[a] - 1));
        (c[2] * size[1] + c[1]) * size[0] + c[0]
    };
    let mut open = vec![true; size[0] * size[1] * size[2]];
    for p in all.iter().flat_map(|v| v.iter()) {
        open[index(p)] = false;
    }
    // Grow the open cells, one axis after the other; borders are open already.
    for stride in [1, size[0], size[0] * size[1]] {
        for _ in 0..depth {
            let before = open.clone();
            for k in stride..open.len() - stride {
                // Rows that wrap around meet the open border, which marks too much, never too little.
                open[k] = before[k] | before[k - stride] | before[k + stride];
            }
        }
    }
    ask.iter().map(|p| open[index(p)]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_has_no_outside() {
        assert_eq!(near_outside(&[&[], &[]], &[], 0.1, 2), Vec::<bool>::new());
        assert_eq!(near_outside(&[&[[0.0; 3]]], &[[0.0; 3]], 0.1, 2), [true]);
    }
}
