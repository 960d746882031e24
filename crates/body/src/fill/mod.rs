//! Ray-traced internal filling (splatting.md §6.3–§6.6): which grid points lie inside the object.

mod attach;
pub mod bvh;
pub mod cleanup;
pub mod columns;
mod density;
mod grid;
mod shell;

use megas_math::{Real, Vec3};
use rayon::prelude::*;

pub use attach::{Skin, attach};
pub use cleanup::CleanupReport;
pub use density::{DensityField, density, density_filling};
pub use grid::Grid;
pub use shell::{ALPHA_MAX, ALPHA_MIN, Blend, Cap, Shell};

/// Fraction of interior points without a floor from which the automatic cap acts.
const OPEN_BOTTOM: f64 = 0.25;
/// The automatic cap reaches this many columns beyond those with interior points.
const CAP_REACH: usize = 4;

/// Opacity from which a ray counts as stopped by a wall (splatting.md §6.5).
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum TauAlpha {
    /// A fixed value in (0, 1); 0.5 by default.
    Fixed(f32),
    /// 0.6 × the 10 % quantile of A over the rays of the certain points, clamped to [0.4, 0.9].
    Auto,
}

/// The rays of a grid point.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Directions {
    /// The six axis directions; interior with four votes or more.
    Axes,
    /// The axes and the eight diagonals (much slower); interior with eight votes or more.
    AxesAndDiagonals,
}

/// How an unseen bottom is closed (splatting.md §6.6).
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum BottomCap {
    /// Not at all.
    Off,
    /// At the lowest surface, if more than a quarter of the interior points have nothing below them.
    Auto,
    /// At this height along the up axis, in units of the filling frame.
    At(f64),
}

/// How the inside is found.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum FillMethod {
    /// By rays that stop at walls whose normals point along them (§6.5).
    #[default]
    Rays,
    /// By the density of the Gaussians (§6.7); for comparison. Of the other options only the grid applies.
    DensityField(DensityField),
}

/// Options of the interior test.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FillSettings {
    /// Rays, or the baseline.
    pub method: FillMethod,
    /// Opacity threshold.
    pub tau_alpha: TauAlpha,
    /// `N·d / A` must exceed this; 0 by default.
    pub tau_n: f32,
    /// Ray directions.
    pub directions: Directions,
    /// Virtual cap under the object.
    pub cap: BottomCap,
    /// How often the spacing may be halved for thin objects, 0–3.
    pub max_refinements: u32,
}

impl Default for FillSettings {
    fn default() -> Self {
        Self {
            method: FillMethod::Rays,
            tau_alpha: TauAlpha::Fixed(0.5),
            tau_n: 0.0,
            directions: Directions::Axes,
            cap: BottomCap::Auto,
            max_refinements: 2,
        }
    }
}

/// What the filling found.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FillReport {
    /// Threshold in use.
    pub tau_alpha: f32,
    /// Interior points after the vote, before the clean-up.
    pub voted: usize,
    /// Of these, points that are inside only because no view reaches them.
    pub occluded: usize,
    /// Interior points after the clean-up.
    pub interior: usize,
    /// Points between a faint skin and the body below it, added by [`attach`].
    pub attached: usize,
    /// Points one vote short of the majority: a leaky shell has many of them.
    pub one_short: usize,
    /// What the clean-up changed.
    pub cleanup: CleanupReport,
    /// Fraction of the voted points with no wall below them, before any cap.
    pub open_bottom: f64,
    /// Height of the virtual cap in the filling frame, where one was used.
    pub cap_height: Option<f64>,
    /// How often the spacing was halved.
    pub refinements: u32,
    /// Median over the interior points of the shortest of the three axis runs through them.
    pub points_across: f64,
}

/// A classified grid.
#[derive(Clone, Debug)]
pub struct Filling {
    /// The grid; a cell is represented by its centre.
    pub grid: Grid,
    /// Interior flag of every cell.
    pub inside: Vec<bool>,
    /// Votes of every cell before the clean-up.
    pub votes: Vec<u8>,
    /// Cells of the grid per particle lattice cell along one axis: `2^refinements`.
    pub per_particle: usize,
    /// Counts.
    pub report: FillReport,
}

impl Filling {
    /// Classified volume in cubic units of the frame.
    pub fn volume(&self) -> f64 {
        self.report.interior as f64 * self.grid.cell_volume()
    }
}

/// Classifies the grid points around the shell (`min`, `max`: the box of its means that matter). `dx` is the cell of the
/// simulator: the particle lattice has half of it, and cells align with multiples of `dx` through the frame's origin.
///
/// `hidden` says of a point whether no view from outside reaches it; such points are inside whatever the normals say. (The
/// paper's test relies on normals alone, and leaves holes between the layers under the skin of imported splats.)
pub fn fill<T: Real>(
    shell: &Shell<T>,
    min: Vec3<f64>,
    max: Vec3<f64>,
    dx: f64,
    settings: &FillSettings,
    hidden: impl Fn(Vec3<f64>) -> bool + Sync,
) -> Filling {
    let spacing = typical_spacing(shell);
    if let FillMethod::DensityField(field) = &settings.method {
        let grid = Grid::covering(min, max, dx + 0.5 * spacing, 0.5 * dx, 2);
        let side = (0..3).map(|k| max[k] - min[k]).fold(0.0, f64::max);
        return density_filling(shell, grid, side, field);
    }
    let mut refinements = 0;
    loop {
        let per_particle = 1usize << refinements;
        let delta = 0.5 * dx / per_particle as f64;
        // Two cells of air on each side let the clean-up walk around the object.
        let grid = Grid::covering(min, max, 2.0 * delta + 0.5 * spacing, delta, 2 * per_particle);
        let mut filling = classify(shell, grid, settings, &hidden);
        filling.per_particle = per_particle;
        filling.report.refinements = refinements;
        let done = filling.report.points_across >= 3.0 || refinements >= settings.max_refinements;
        if done || delta < 0.25 * spacing || grid.len() > 40_000_000 {
            return filling;
        }
        refinements += 1;
    }
}

/// Classifies the points of a given grid, see [`fill`].
pub fn classify<T: Real>(shell: &Shell<T>, grid: Grid, settings: &FillSettings, hidden: impl Fn(Vec3<f64>) -> bool + Sync) -> Filling {
    let mut tau = match settings.tau_alpha {
        TauAlpha::Fixed(v) => v,
        TauAlpha::Auto => 0.5,
    };
    let mut cap = match settings.cap {
        BottomCap::At(height) => cap_at(shell, &grid, height, None),
        BottomCap::Off | BottomCap::Auto => None,
    };
    let mut rays = cast_axes(shell, &grid, cap.as_ref(), tau, settings.tau_n);
    if settings.tau_alpha == TauAlpha::Auto {
        tau = auto_tau(shell, &grid, cap.as_ref(), &rays);
        rays = cast_axes(shell, &grid, cap.as_ref(), tau, settings.tau_n);
    }
    let open_bottom = open_fraction(&rays);
    if settings.cap == BottomCap::Auto && open_bottom > OPEN_BOTTOM {
        cap = lowest(shell).and_then(|height| cap_at(shell, &grid, height, Some(&rays)));
        if cap.is_some() {
            let vertical = cast_one(shell, &grid, 2, cap.as_ref(), tau, settings.tau_n);
            let keep = |old: u8, new: u8| old & 0b1111 | new;
            rays.par_iter_mut().zip(vertical).for_each(|(r, v)| *r = Rays { votes: keep(r.votes, v.votes), walls: keep(r.walls, v.walls) });
        }
    }
    let (mut votes, threshold) = match settings.directions {
        Directions::Axes => (rays.par_iter().map(|r| r.votes.count_ones() as u8).collect::<Vec<u8>>(), 4),
        Directions::AxesAndDiagonals => (with_diagonals(shell, &grid, cap.as_ref(), tau, settings.tau_n, &rays), 8),
    };
    // Above the threshold: the majority filter is for votes that were close.
    let occluded: usize = votes
        .par_iter_mut()
        .enumerate()
        .map(|(i, v)| {
            let raise = *v < threshold && hidden(grid.center(grid.cell(i)));
            if raise {
                *v = threshold + 1;
            }
            usize::from(raise)
        })
        .sum();
    let one_short = votes.iter().filter(|&&v| v + 1 == threshold).count();
    let mut inside: Vec<bool> = votes.iter().map(|&v| v >= threshold).collect();
    let voted = inside.iter().filter(|&&v| v).count();
    let cleanup = cleanup::clean(&grid, &mut inside, &votes, threshold);
    let report = FillReport {
        tau_alpha: tau,
        voted,
        occluded,
        attached: 0,
        interior: inside.iter().filter(|&&v| v).count(),
        one_short,
        cleanup,
        open_bottom,
        cap_height: cap.map(|c| c.height),
        refinements: 0,
        points_across: points_across(&grid, &inside),
    };
    Filling { grid, inside, votes, per_particle: 1, report }
}

/// True where a ray ends on a wall whose outside it would leave by.
#[inline(always)]
fn interior_ray<T: Real>(alpha: T, facing: T, tau_alpha: T, tau_n: T) -> bool {
    alpha >= tau_alpha && facing > tau_n * alpha
}

/// What the six axis rays of a point found.
#[derive(Clone, Copy, Debug, Default)]
struct Rays {
    /// Interior votes: bit `2·axis` towards +, bit `2·axis + 1` towards −.
    votes: u8,
    /// Rays that met a wall, whatever its normal; same bits.
    walls: u8,
}

/// Casts both directions along one axis.
fn cast_one<T: Real>(shell: &Shell<T>, grid: &Grid, axis: usize, cap: Option<&Cap>, tau: f32, tau_n: f32) -> Vec<Rays> {
    let (tau, tau_n) = (T::of(f64::from(tau)), T::of(f64::from(tau_n)));
    columns::cast_axis(shell, grid, axis, cap, |_, p| {
        let up = interior_ray(p.alpha_up, p.facing_up, tau, tau_n);
        let down = interior_ray(p.alpha_down, p.facing_down, tau, tau_n);
        let walls = u8::from(p.alpha_up >= tau) | u8::from(p.alpha_down >= tau) << 1;
        Rays { votes: (u8::from(up) | u8::from(down) << 1) << (2 * axis), walls: walls << (2 * axis) }
    })
}

fn cast_axes<T: Real>(shell: &Shell<T>, grid: &Grid, cap: Option<&Cap>, tau: f32, tau_n: f32) -> Vec<Rays> {
    let mut rays = cast_one(shell, grid, 0, cap, tau, tau_n);
    for axis in 1..3 {
        let more = cast_one(shell, grid, axis, cap, tau, tau_n);
        rays.par_iter_mut().zip(more).for_each(|(r, m)| *r = Rays { votes: r.votes | m.votes, walls: r.walls | m.walls });
    }
    rays
}

/// `0.6 ×` the 10 % quantile of A over the rays of the points with all six votes.
fn auto_tau<T: Real>(shell: &Shell<T>, grid: &Grid, cap: Option<&Cap>, rays: &[Rays]) -> f32 {
    let mut histogram = [0usize; 256];
    for axis in 0..3 {
        let levels = columns::cast_axis(shell, grid, axis, cap, |i, p| {
            let level = |a: T| (a.f64() * 255.0) as u8;
            if rays[i].votes == 0b11_1111 { [level(p.alpha_up), level(p.alpha_down)] } else { [0; 2] }
        });
        for (i, l) in levels.iter().enumerate() {
            if rays[i].votes == 0b11_1111 {
                histogram[usize::from(l[0])] += 1;
                histogram[usize::from(l[1])] += 1;
            }
        }
    }
    let total: usize = histogram.iter().sum();
    if total == 0 {
        return 0.5;
    }
    let mut below = 0;
    let level = (0..256).find(|&l| {
        below += histogram[l];
        below * 10 >= total
    });
    (0.6 * level.unwrap_or(255) as f32 / 255.0).clamp(0.4, 0.9)
}

/// Fraction of the points with a majority whose downward ray meets no wall at all.
fn open_fraction(rays: &[Rays]) -> f64 {
    let (mut all, mut open) = (0usize, 0usize);
    for r in rays {
        if r.votes.count_ones() >= 4 {
            all += 1;
            open += usize::from(r.walls & 0b10_0000 == 0);
        }
    }
    if all == 0 { 0.0 } else { open as f64 / all as f64 }
}

/// Height of the lowest half per cent of the centres.
fn lowest<T: Real>(shell: &Shell<T>) -> Option<f64> {
    let mut z: Vec<f64> = shell.mean.iter().map(|m| m[2].f64()).collect();
    z.sort_by(f64::total_cmp);
    z.get(z.len() / 200).copied()
}

/// The cap at a height: footprint = convex hull of the Gaussians within 3Δ of it, or of all where those span no area;
/// with a first vote at hand only near columns in which it found something inside, so that the cap does not close the
/// hole of a ring.
fn cap_at<T: Real>(shell: &Shell<T>, grid: &Grid, height: f64, rays: Option<&[Rays]>) -> Option<Cap> {
    let flat = |within: f64| -> Vec<[f64; 2]> {
        let near = shell.mean.iter().filter(|m| (m[2].f64() - height).abs() <= within);
        crate::polygon::convex_hull(&near.map(|m| [m[0].f64(), m[1].f64()]).collect::<Vec<_>>())
    };
    let mut footprint = flat(3.0 * grid.spacing);
    if footprint.len() < 3 {
        footprint = flat(f64::INFINITY);
    }
    if footprint.len() < 3 {
        return None;
    }
    let [nx, ny, _] = grid.dims;
    let mut columns = vec![rays.is_none(); nx * ny];
    for (i, _) in rays.unwrap_or_default().iter().enumerate().filter(|(_, r)| r.votes.count_ones() >= 4) {
        let [x, y, _] = grid.cell(i);
        for v in y.saturating_sub(CAP_REACH)..(y + CAP_REACH + 1).min(ny) {
            columns[v * nx..][x.saturating_sub(CAP_REACH)..(x + CAP_REACH + 1).min(nx)].fill(true);
        }
    }
    let place = |axis: usize, i: usize| grid.coordinate(axis, i);
    for y in 0..ny {
        for x in 0..nx {
            columns[y * nx + x] &= crate::polygon::contains(&footprint, [place(0, x), place(1, y)]);
        }
    }
    Some(Cap { height, origin: [grid.origin[0], grid.origin[1]], spacing: grid.spacing, dims: [nx, ny], columns })
}

/// Adds the votes of the eight diagonals. A point stops as soon as its fate is certain, so that votes below the
/// threshold of eight are lower bounds.
fn with_diagonals<T: Real>(shell: &Shell<T>, grid: &Grid, cap: Option<&Cap>, tau: f32, tau_n: f32, rays: &[Rays]) -> Vec<u8> {
    let tree = bvh::Bvh::new(shell);
    let (tau, tau_n) = (T::of(f64::from(tau)), T::of(f64::from(tau_n)));
    let diagonal = T::of(3.0).sqrt().recip();
    rays.par_iter()
        .enumerate()
        .with_min_len(256)
        .map_init(Vec::new, |hits, (i, r)| {
            let mut votes = r.votes.count_ones() as u8;
            let x = grid.center(grid.cell(i)).map(T::of);
            for k in 0..8u8 {
                if votes + (8 - k) < 8 {
                    break;
                }
                let d: Vec3<T> = std::array::from_fn(|b| if k >> b & 1 == 0 { diagonal } else { -diagonal });
                let hit = tree.trace(x, d, cap, hits);
                votes += u8::from(interior_ray(hit.alpha, megas_math::vec3::dot(hit.normal, d), tau, tau_n));
            }
            votes
        })
        .collect()
}

/// Median distance between neighbouring Gaussians.
fn typical_spacing<T: Real>(shell: &Shell<T>) -> f64 {
    let points: Vec<Vec3<f32>> = shell.mean.iter().map(|&m| megas_math::vec3::cast(m)).collect();
    let Some(tree) = crate::neighbours::Neighbours::new(&points) else { return 0.0 };
    let stride = (points.len() / 2000).max(1);
    let mut d: Vec<f32> = points.iter().step_by(stride).filter_map(|p| tree.nearest(p, 2).last().map(|n| n.1.sqrt())).collect();
    d.sort_by(f32::total_cmp);
    d.get(d.len() / 2).copied().map_or(0.0, f64::from)
}

/// Median over the interior of the shortest axis run through a point.
fn points_across(grid: &Grid, inside: &[bool]) -> f64 {
    let mut shortest = vec![u16::MAX; grid.len()];
    let step = [1, grid.dims[0], grid.dims[0] * grid.dims[1]];
    for axis in 0..3 {
        let n = grid.dims[axis];
        for i in 0..grid.len() {
            // Each run is walked once, from its first point.
            if !inside[i] || (grid.cell(i)[axis] > 0 && inside[i - step[axis]]) {
                continue;
            }
            let room = n - grid.cell(i)[axis];
            let run = (0..room).take_while(|&k| inside[i + k * step[axis]]).count();
            for k in 0..run {
                let s = &mut shortest[i + k * step[axis]];
                *s = (*s).min(run as u16);
            }
        }
    }
    let mut runs: Vec<u16> = shortest.into_iter().filter(|&r| r < u16::MAX).collect();
    if runs.is_empty() {
        return 0.0;
    }
    let mid = runs.len() / 2;
    f64::from(*runs.select_nth_unstable(mid).1)
}
