//! Gradients of a render with respect to every parameter of every splat (splatting.md §4).
//!
//! Tiles are replayed independently; each entry of a tile's list gets a record of sums, and the records of a Gaussian are
//! added up in the order of the tiles. No two threads ever add to the same number: gradients are bit-identical for any
//! number of threads.

mod chain;
mod kernel;
#[cfg(test)]
mod tests;

use megas_model::{Camera, Splats};
use rayon::prelude::*;

use self::chain::{ChainView, Parameters, Received, chain};
use self::kernel::{COLOUR_PLANES, GEOMETRY_PLANES, Partial};
use crate::kernel::{BLOCK, Place, Plane, Scene, pixel_of};
use crate::project::CHUNK;
use crate::rasterizer::{Rasterizer, list_starts};
use crate::{Channels, Frame, Settings};

/// Gradients of a loss with respect to the raw accumulated channels of a [`Frame`], one value per pixel. Empty arrays stand
/// for zero. Losses of derived channels (planar depth, normalised temperature …) are brought to this form first
/// (splatting.md §4.6).
#[derive(Clone, Debug, Default)]
pub struct Cotangents {
    /// `∂L/∂rgb` of the composited colour.
    pub rgb: Vec<[f32; 3]>,
    /// `∂L/∂A`, with `A = 1 − T` (apart from what colour owes to the background).
    pub alpha: Vec<f32>,
    /// `∂L/∂Σ w z`.
    pub depth: Vec<f32>,
    /// `∂L/∂Σ w n`, world axes.
    pub normal: Vec<[f32; 3]>,
    /// `∂L/∂Σ w n·(μ − c)`.
    pub plane: Vec<f32>,
    /// `∂L/∂Σ w T`.
    pub temperature: Vec<f32>,
}

/// Gradients with respect to the parameters of a set of splats; every array has one element per splat, zero where the splat
/// was not drawn.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Gradients {
    /// Centres.
    pub mean: Vec<[f32; 3]>,
    /// Log-scales.
    pub log_scale: Vec<[f32; 3]>,
    /// Quaternions as stored, not normalised.
    pub rotation: Vec<[f32; 4]>,
    /// Opacity logits.
    pub opacity_logit: Vec<f32>,
    /// Colour before the clamp at zero: `∂L/∂c_k = Y_k(direction) · colour`, see [`Gradients::sh`].
    pub colour: Vec<[f32; 3]>,
    /// Unit direction from the camera, along which the colour was evaluated.
    pub direction: Vec<[f32; 3]>,
    /// Temperatures.
    pub temperature: Vec<f32>,
    /// Lengths of the gradient of the projected mean and of the sum of its absolute values over the pixels, in normalised
    /// device coordinates (splatting.md §4.5).
    pub screen: Vec<[f32; 2]>,
    /// Three standard deviations of the image along its longer axis \[px\]; 0 where the splat was not drawn.
    pub radius: Vec<f32>,
}

impl Gradients {
    /// Number of splats.
    pub fn len(&self) -> usize {
        self.mean.len()
    }

    /// True without splats.
    pub fn is_empty(&self) -> bool {
        self.mean.is_empty()
    }

    /// True where splat `i` was drawn.
    #[inline(always)]
    pub fn visible(&self, i: usize) -> bool {
        self.radius[i] > 0.0
    }

    /// Gradient of the spherical-harmonic coefficients of splat `i`, `[coefficient][channel]`, for degree 3.
    #[inline(always)]
    pub fn sh(&self, i: usize) -> [[f32; 3]; 16] {
        let basis = megas_math::sh::basis(self.direction[i]);
        basis.map(|y| self.colour[i].map(|c| y * c))
    }

    fn resize(&mut self, n: usize) {
        self.mean.resize(n, [0.0; 3]);
        self.log_scale.resize(n, [0.0; 3]);
        self.rotation.resize(n, [0.0; 4]);
        self.opacity_logit.resize(n, 0.0);
        self.colour.resize(n, [0.0; 3]);
        self.direction.resize(n, [0.0; 3]);
        self.temperature.resize(n, 0.0);
        self.screen.resize(n, [0.0; 2]);
        self.radius.resize(n, 0.0);
    }
}

/// Memory of the backward pass.
#[derive(Debug, Default)]
pub(crate) struct Scratch {
    partials: Vec<Vec<Partial>>,
    starts: Vec<u32>,
    sums: Vec<Partial>,
    rank_of: Vec<u32>,
}

impl Rasterizer {
    /// Gradients of the render that this rasterizer did last: `splats`, `camera`, `settings`, `channels` (either
    /// [`Channels::Rgba`] or [`Channels::Geometry`]) and `frame` must be those of that call, and its Gaussians must have been
    /// the splats at rest ([`crate::Gaussians::assign_splats`]).
    ///
    /// # Panics
    /// If the arrays do not fit together or the channel set has no gradients.
    pub fn backward(
        &mut self,
        splats: &Splats,
        camera: &Camera,
        settings: &Settings,
        channels: Channels,
        frame: &Frame,
        cotangents: &Cotangents,
        out: &mut Gradients,
    ) {
        assert_eq!((frame.width, frame.height), (camera.width, camera.height), "the frame is not of this camera");
        let mut scratch = std::mem::take(&mut self.backward);
        let geometry = match channels {
            Channels::Rgba => {
                self.replay::<COLOUR_PLANES>(camera, settings, frame, cotangents, &mut scratch);
                false
            }
            Channels::Geometry => {
                self.replay::<GEOMETRY_PLANES>(camera, settings, frame, cotangents, &mut scratch);
                true
            }
            _ => panic!("no gradients for this channel set"),
        };
        self.collect(camera, settings, geometry, &mut scratch);
        self.chain(splats, camera, settings, geometry, &mut scratch, out);
        self.backward = scratch;
    }

    /// Replays all tiles.
    fn replay<const N: usize>(&self, camera: &Camera, settings: &Settings, frame: &Frame, g: &Cotangents, scratch: &mut Scratch) {
        let scene = Scene::new(self.level, &self.records, &self.extras, &self.lists, camera, settings);
        let tile = settings.tile.pixels();
        let edge = tile.min(BLOCK);
        let [columns, rows] = [scene.size[0].div_ceil(tile), scene.size[1].div_ceil(tile)];
        scratch.partials.resize_with(columns * rows, Vec::new);
        scratch.partials.par_iter_mut().enumerate().for_each_init(
            || Box::new([Plane::default(); N]),
            |planes, (index, partials)| {
                let count: usize = scene.lists.iter().map(|l| l.of(index).len()).sum();
                partials.clear();
                partials.resize(count, Partial::default());
                let (x, y) = (index % columns * tile, index / columns * tile);
                let across = tile / edge;
                for b in 0..across * across {
                    let place = Place { x: x + b % across * edge, y: y + b / across * edge, edge, tile: index };
                    load_block(frame, g, &place, planes);
                    kernel::backward(&scene, place, planes, partials);
                }
            },
        );
    }

    /// Adds up the records of every Gaussian in the order of the tiles.
    fn collect(&self, camera: &Camera, settings: &Settings, geometry: bool, scratch: &mut Scratch) {
        let tile = settings.tile.pixels();
        let tiles = (camera.width as usize).div_ceil(tile) * (camera.height as usize).div_ceil(tile);
        let range = self.range();
        let lists = &self.lists;
        let Scratch { partials, starts, sums, .. } = scratch;
        list_starts(lists, tiles, starts);
        sums.clear();
        sums.resize(self.records.len(), Partial::default());
        let jobs = sums.par_chunks_mut(range).zip(starts.par_chunks(tiles)).enumerate();
        jobs.for_each(|(c, (sums, starts))| {
            for t in 0..tiles {
                let ranks = lists[c].of(t);
                let found = &partials[t][starts[t] as usize..][..ranks.len()];
                for (&rank, p) in ranks.iter().zip(found) {
                    sums[rank as usize - c * range].add(p, geometry);
                }
            }
        });
    }

    /// From sums over pixels to parameters, in the order of the splats.
    fn chain(&self, splats: &Splats, camera: &Camera, settings: &Settings, geometry: bool, scratch: &mut Scratch, out: &mut Gradients) {
        let n = splats.len();
        let Scratch { sums, rank_of, .. } = scratch;
        rank_of.clear();
        rank_of.resize(n, u32::MAX);
        for (rank, r) in self.records.iter().enumerate() {
            rank_of[r.index as usize] = rank as u32;
        }
        out.resize(n);
        let view = ChainView::<f32>::new(camera, settings, geometry);
        let (records, level) = (&self.records, self.level);
        let stride = splats.sh_stride();
        let Gradients { mean, log_scale, rotation, opacity_logit, colour, direction, temperature, screen, radius } = out;
        let arrays = (
            mean.par_chunks_mut(CHUNK),
            log_scale.par_chunks_mut(CHUNK),
            rotation.par_chunks_mut(CHUNK),
            opacity_logit.par_chunks_mut(CHUNK),
            colour.par_chunks_mut(CHUNK),
            direction.par_chunks_mut(CHUNK),
            temperature.par_chunks_mut(CHUNK),
            screen.par_chunks_mut(CHUNK),
            radius.par_chunks_mut(CHUNK),
        );
        let job = |c: usize, (mean, log_scale, rotation, opacity_logit, colour, direction, temperature, screen, radius): Slices| {
            for k in 0..mean.len() {
                let i = c * CHUNK + k;
                if rank_of[i] == u32::MAX {
                    (mean[k], log_scale[k], rotation[k], opacity_logit[k]) = ([0.0; 3], [0.0; 3], [0.0; 4], 0.0);
                    (colour[k], temperature[k], screen[k], radius[k]) = ([0.0; 3], 0.0, [0.0; 2], 0.0);
                    continue;
                }
                let r = &records[rank_of[i] as usize];
                let received = receive(r, &sums[rank_of[i] as usize]);
                let parameters = Parameters {
                    mean: splats.mean[i],
                    log_scale: splats.log_scale[i],
                    rotation: splats.rotation[i],
                    opacity_logit: splats.opacity_logit[i],
                    degree: splats.sh_degree,
                    sh: &splats.sh[i * stride..(i + 1) * stride],
                };
                let o = chain(&view, &parameters, &received, r.rgb.map(|v| v > 0.0));
                (mean[k], log_scale[k], rotation[k], opacity_logit[k]) = (o.mean, o.log_scale, o.rotation, o.opacity_logit);
                (colour[k], direction[k], temperature[k], screen[k], radius[k]) =
                    (o.colour, o.direction, o.temperature, o.screen, o.radius);
            }
        };
        arrays.into_par_iter().enumerate().for_each(|(c, slices)| {
            // Scalar code, but with the instruction set's registers and fused operations.
            fearless_simd::dispatch!(level, _simd => job(c, slices));
        });
    }
}

/// Where one chunk's gradients go.
type Slices<'a> = (
    &'a mut [[f32; 3]],
    &'a mut [[f32; 3]],
    &'a mut [[f32; 4]],
    &'a mut [f32],
    &'a mut [[f32; 3]],
    &'a mut [[f32; 3]],
    &'a mut [f32],
    &'a mut [[f32; 2]],
    &'a mut [f32],
);

/// Sums over pixels as gradients in the image: undoes the whitening.
#[inline(always)]
fn receive(r: &crate::project::Record, p: &Partial) -> Received<f32> {
    const LN2: f32 = std::f32::consts::LN_2;
    let [l1, l2, l3] = r.l;
    let [b11, b12, b22] = p.second;
    // Lᵀ B L with L = [l₁ l₂; 0 l₃].
    let (u1, u2) = (l2 * b11 + l3 * b12, l2 * b12 + l3 * b22);
    let scale = 2.0 * LN2 * LN2;
    Received {
        rgb: p.rgb,
        opacity: p.h * (-r.log_opacity).exp2(),
        mean: [2.0 * LN2 * l1 * p.first[0], 2.0 * LN2 * (l2 * p.first[0] + l3 * p.first[1])],
        absolute: p.absolute.map(|v| 2.0 * LN2 * v),
        covariance: [scale * l1 * l1 * b11, scale * l1 * u1, scale * (l2 * u1 + l3 * u2)],
        depth: p.geometry[0],
        normal: [p.geometry[1], p.geometry[2], p.geometry[3]],
        plane: p.geometry[4],
        temperature: p.geometry[5],
    }
}

/// Brings the cotangents and the totals of one block into planes.
fn load_block<const N: usize>(frame: &Frame, g: &Cotangents, place: &Place, planes: &mut [Plane; N]) {
    let (width, height) = (frame.width as usize, frame.height as usize);
    let at = |a: &[f32], i: usize| a.get(i).copied().unwrap_or(0.0);
    let at3 = |a: &[[f32; 3]], i: usize| a.get(i).copied().unwrap_or([0.0; 3]);
    for brick in 0..16 {
        for lane in 0..16 {
            let [dx, dy] = pixel_of(brick, lane);
            let (x, y) = (place.x + dx, place.y + dy);
            let mut put = |k: usize, v: f32| planes[k].0[brick][lane] = v;
            if dx >= place.edge || dy >= place.edge || x >= width || y >= height {
                put(0, -1.0);
                (1..N).for_each(|k| put(k, 0.0));
                continue;
            }
            let i = y * width + x;
            let (rgb, a) = (frame.rgb[i], 1.0 - frame.transmittance[i]);
            let (gc, ga) = (at3(&g.rgb, i), at(&g.alpha, i));
            let mut total = gc[0] * rgb[0] + gc[1] * rgb[1] + gc[2] * rgb[2] + ga * a;
            put(0, 1.0);
            put(2, gc[0]);
            put(3, gc[1]);
            put(4, gc[2]);
            put(5, ga);
            if N == GEOMETRY_PLANES {
                let (gz, gn, gd, gt) = (at(&g.depth, i), at3(&g.normal, i), at(&g.plane, i), at(&g.temperature, i));
                let n = frame.normal[i];
                total += gz * frame.depth[i] * a.max(1e-6) + gn[0] * n[0] + gn[1] * n[1] + gn[2] * n[2];
                total += gd * frame.plane[i] + gt * frame.temperature[i];
                for (k, v) in [gz, gn[0], gn[1], gn[2], gd, gt].into_iter().enumerate() {
                    put(COLOUR_PLANES + k, v);
                }
            }
            put(1, total);
        }
    }
}
