//! The stages of a render in order, and the memory that they share.

use fearless_simd::Level;
use megas_model::Camera;
use rayon::prelude::*;

use crate::bin::Lists;
use crate::kernel::{self, BLOCK, Place, Plane, Scene, Set, Tally};
use crate::project::{self, Bounds, CHUNK, Extra, Record, View};
use crate::resolve::{Window, resolve_row};
use crate::sort::Sorter;
use crate::{Channels, Frame, Gaussians, Settings, Statistics};

/// Bytes of block state that are alive at a time; larger images are composited in strips.
const STRIP_BYTES: usize = 48 << 20;
/// Limits of how finely the depth order is cut for binning; no result depends on them.
const RANGE: usize = 4096;
const RANGES: usize = 32;

/// For channel sets without votes.
static NO_RAYS: [Plane; 3] = [Plane([[0.0; 16]; 16]); 3];

/// Renders Gaussians. Keeps its scratch memory, so repeated renders of similar size allocate nothing; results do not depend
/// on earlier calls, on the number of threads, or on the tile size.
#[derive(Debug)]
pub struct Rasterizer {
    pub(crate) level: Level,
    chunks: Vec<project::Chunk>,
    sorter: Sorter,
    pub(crate) records: Vec<Record>,
    pub(crate) extras: Vec<Extra>,
    bounds: Vec<Bounds>,
    pub(crate) lists: Vec<Lists>,
    planes: Vec<Plane>,
    tallies: Vec<Vec<Tally>>,
    starts: Vec<u32>,
    sums: Vec<Sum>,
    pub(crate) backward: crate::backward::Scratch,
}

impl Default for Rasterizer {
    fn default() -> Self {
        Self::new()
    }
}

impl Rasterizer {
    /// A rasterizer for this machine's best instruction set.
    pub fn new() -> Self {
        Self::with_level(Level::new())
    }

    /// A rasterizer that uses no more than the given instruction set. Images of different sets differ by rounding.
    pub fn with_level(level: Level) -> Self {
        Self {
            level,
            chunks: Vec::new(),
            sorter: Sorter::default(),
            records: Vec::new(),
            extras: Vec::new(),
            bounds: Vec::new(),
            lists: Vec::new(),
            planes: Vec::new(),
            tallies: Vec::new(),
            starts: Vec::new(),
            sums: Vec::new(),
            backward: Default::default(),
        }
    }

    /// Renders into `frame`, whose arrays are reused. Gaussians with values that are not finite are left out.
    ///
    /// # Panics
    /// If the arrays of `gaussians` do not fit together, or the image is larger than 65535 tiles on a side.
    pub fn render(&mut self, gaussians: &Gaussians, camera: &Camera, settings: &Settings, channels: Channels, frame: &mut Frame) {
        gaussians.assert_shape();
        frame.prepare(camera.width, camera.height, channels, gaussians.len());
        if frame.transmittance.is_empty() {
            return;
        }
        let view = View::new(camera, settings, channels);
        assert!(view.tiles.iter().all(|&n| n <= usize::from(u16::MAX)), "image too large");
        self.project(&view, gaussians);
        self.sorter.sort(&self.chunks);
        self.gather(channels == Channels::Geometry);
        self.bin(&view);
        match channels {
            Channels::Rgba => self.composite::<kernel::Rgba, 4>(&view, settings, frame),
            Channels::RgbaTemperature => self.composite::<kernel::RgbaTemperature, 5>(&view, settings, frame),
            Channels::Geometry => self.composite::<kernel::Geometry, 13>(&view, settings, frame),
            Channels::Weights => {
                self.composite::<kernel::Weights, 3>(&view, settings, frame);
                self.tally(&view, &mut frame.statistics);
            }
        }
    }

    /// As [`Rasterizer::render`], into a new frame.
    pub fn frame(&mut self, gaussians: &Gaussians, camera: &Camera, settings: &Settings, channels: Channels) -> Frame {
        let mut frame = Frame::default();
        self.render(gaussians, camera, settings, channels, &mut frame);
        frame
    }

    fn project(&mut self, view: &View, g: &Gaussians) {
        self.chunks.resize_with(g.len().div_ceil(CHUNK), Default::default);
        let level = self.level;
        self.chunks.par_iter_mut().enumerate().for_each(|(c, chunk)| {
            project::project(level, view, g, c * CHUNK, (c * CHUNK + CHUNK).min(g.len()), chunk);
        });
    }

    /// Brings the survivors into depth order.
    fn gather(&mut self, geometry: bool) {
        fn pick<T: Copy + Default + Send + Sync>(out: &mut Vec<T>, order: &[(u32, u32)], of: impl Fn(usize, usize) -> T + Sync) {
            out.resize(order.len(), T::default());
            out.par_chunks_mut(CHUNK).zip(order.par_chunks(CHUNK)).for_each(|(out, order)| {
                for (o, &(_, slot)) in out.iter_mut().zip(order) {
                    *o = of(slot as usize / CHUNK, slot as usize % CHUNK);
                }
            });
        }
        let (chunks, order) = (&self.chunks, &self.sorter.order[..]);
        pick(&mut self.records, order, |c, k| chunks[c].records[k]);
        pick(&mut self.bounds, order, |c, k| chunks[c].bounds[k]);
        if geometry {
            pick(&mut self.extras, order, |c, k| chunks[c].extras[k]);
        }
    }

    /// Length of the ranges that the depth order is cut into.
    pub(crate) fn range(&self) -> usize {
        self.records.len().div_ceil(RANGES).max(RANGE)
    }

    fn bin(&mut self, view: &View) {
        let (range, level) = (self.range(), self.level);
        self.lists.resize_with(self.records.len().div_ceil(range), Default::default);
        let ranges = self.records.par_chunks(range).zip(self.bounds.par_chunks(range));
        self.lists.par_iter_mut().zip(ranges).enumerate().for_each(|(c, (lists, (records, bounds)))| {
            lists.build(level, records, bounds, (c * range) as u32, view.tiles, view.tile());
        });
    }

    fn composite<C: Set, const N: usize>(&mut self, view: &View, settings: &Settings, frame: &mut Frame) {
        let camera = &view.camera;
        let size = [camera.width as usize, camera.height as usize];
        let scene = Scene::new(self.level, &self.records, &self.extras, &self.lists, camera, settings);
        let tile = settings.tile.pixels();
        let edge = tile.min(BLOCK);
        let across = tile / edge;
        let per_tile = across * across * N;
        let [columns, rows] = view.tiles;
        if C::STATISTICS {
            self.tallies.resize_with(columns * rows, Vec::new);
        }
        let strip = (STRIP_BYTES / (columns * per_tile * size_of::<Plane>())).clamp(1, rows);
        self.planes.resize(strip * columns * per_tile, Plane::default());
        for first in (0..rows).step_by(strip) {
            let last = (first + strip).min(rows);
            let planes = &mut self.planes[..(last - first) * columns * per_tile];
            let job = |index: usize, planes: &mut [Plane], tallies: &mut [Tally]| {
                let index = first * columns + index;
                let (x, y) = (index % columns * tile, index / columns * tile);
                for (b, block) in planes.as_chunks_mut::<N>().0.iter_mut().enumerate() {
                    let place = Place { x: x + b % across * edge, y: y + b / across * edge, edge, tile: index };
                    if C::STATISTICS {
                        kernel::composite::<C, N>(&scene, place, block, &kernel::rays(self.level, camera, place), tallies);
                        count_winners(block, C::WINNER, tallies);
                    } else {
                        kernel::composite::<C, N>(&scene, place, block, &NO_RAYS, tallies);
                    }
                }
            };
            if C::STATISTICS {
                let tallies = &mut self.tallies[first * columns..last * columns];
                planes.par_chunks_mut(per_tile).zip(tallies).enumerate().for_each(|(k, (planes, tallies))| {
                    list_tallies(&scene, first * columns + k, tallies);
                    job(k, planes, tallies);
                });
            } else {
                planes.par_chunks_mut(per_tile).enumerate().for_each(|(k, planes)| job(k, planes, &mut []));
            }
            let planes = &self.planes[..];
            let tallies = &self.tallies[..];
            let rows = first * tile..(last * tile).min(size[1]);
            let window = Window::new(frame, rows.start * size[0]..rows.end * size[0]);
            window.for_rows(rows.start, rows.len(), size[0], &|y, row| {
                let line = y / tile - first;
                let planes_of = |x: usize| {
                    let block = y % tile / edge * across + x % tile / edge;
                    let at = (line * columns + x / tile) * per_tile + block * N;
                    &planes[at..at + N]
                };
                let tallies_of = |x: usize| &tallies[y / tile * columns + x / tile][..];
                resolve_row::<C>(&scene, camera, settings.background, y, edge, row, planes_of, tallies_of);
            });
        }
    }

    /// Merges the tiles' tallies in the order of tiles, in double precision.
    fn tally(&mut self, view: &View, statistics: &mut Statistics) {
        let tiles = view.tiles[0] * view.tiles[1];
        let range = self.range();
        let (lists, tallies) = (&self.lists, &self.tallies);
        list_starts(lists, tiles, &mut self.starts);
        self.sums.clear();
        self.sums.resize(self.records.len(), Sum::default());
        let jobs = self.sums.par_chunks_mut(range).zip(self.starts.par_chunks(tiles)).enumerate();
        jobs.for_each(|(c, (sums, starts))| {
            for tile in 0..tiles {
                let (start, count) = (starts[tile] as usize, lists[c].of(tile).len());
                for t in &tallies[tile][start..start + count] {
                    sums[t.rank as usize - c * range].add(t);
                }
            }
        });
        for (r, s) in self.records.iter().zip(&self.sums) {
            let i = r.index as usize;
            statistics.w_max[i] = s.w_max;
            statistics.pixels[i] = s.pixels;
            statistics.argmax_pixels[i] = s.argmax_pixels;
            statistics.w_sum[i] = s.w_sum as f32;
            statistics.votes[i] = [s.vote[0] as f32, s.vote[1] as f32, s.vote[2] as f32];
        }
    }
}

/// Where the part of each range of the depth order starts in the list of each of `tiles` tiles: `starts[range · tiles + tile]`.
pub(crate) fn list_starts(lists: &[Lists], tiles: usize, starts: &mut Vec<u32>) {
    starts.clear();
    starts.resize(lists.len() * tiles, 0);
    for c in 1..lists.len() {
        let (before, here) = starts[(c - 1) * tiles..(c + 1) * tiles].split_at_mut(tiles);
        for tile in 0..tiles {
            here[tile] = before[tile] + lists[c - 1].of(tile).len() as u32;
        }
    }
}

/// The tallies of one Gaussian over all tiles.
#[derive(Clone, Copy, Debug, Default)]
struct Sum {
    w_sum: f64,
    vote: [f64; 3],
    w_max: f32,
    pixels: u32,
    argmax_pixels: u32,
}

impl Sum {
    #[inline(always)]
    fn add(&mut self, t: &Tally) {
        self.w_max = self.w_max.max(t.w_max);
        self.pixels += t.pixels;
        self.argmax_pixels += t.argmax_pixels;
        self.w_sum += f64::from(t.w_sum);
        for a in 0..3 {
            self.vote[a] += f64::from(t.vote[a]);
        }
    }
}

/// One empty tally per entry of the tile's list.
fn list_tallies(scene: &Scene, tile: usize, tallies: &mut Vec<Tally>) {
    tallies.clear();
    for lists in scene.lists {
        tallies.extend(lists.of(tile).iter().map(|&rank| Tally { rank, ..Tally::default() }));
    }
}

fn count_winners<const N: usize>(block: &[Plane; N], winner: Option<usize>, tallies: &mut [Tally]) {
    let Some(k) = winner else { return };
    for id in block[k + 1].0.as_flattened() {
        if let Some(t) = tallies.get_mut(id.to_bits() as usize) {
            t.argmax_pixels += 1;
        }
    }
}
