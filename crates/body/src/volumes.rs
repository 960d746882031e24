//! Where the internal particles go, and how much volume every particle stands for (splatting.md §6.8, simulation.md §1.1).
//!
//! A word on light particles next to heavy ones: in MLS-MPM the force a particle exerts on a node is
//! `−V (4/Δx²) w σ (x_i − x_p)` and the mass it brings is `ρ V w`, with the same weight `w`. The acceleration of a node is
//! therefore a mean of per-particle accelerations weighted by mass, whatever the volumes are: tiny volumes cannot make it
//! large. What they can do is waste work and carry noisy deformation gradients, so cells are thinned out to 27 mass
//! points, which bounds a volume from below by 1/27 of the cell's share; what is left over becomes a tracer.

use megas_math::{Vec3, rng::hash01, vec3};
use rayon::prelude::*;

use crate::fill::Filling;
use crate::neighbours::Neighbours;

/// Whether surface Gaussians carry mass.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SplatMass {
    /// They do, unless they outnumber the internal particles by more than 4:1.
    Auto,
    /// They do.
    Always,
    /// They never do: all are tracers.
    Never,
}

/// Options of placement and volumes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VolumeSettings {
    /// Half width of the uniform jitter in particle spacings Δ, 0–0.5; 0.25 by default.
    pub jitter: f64,
    /// Internal particles nearer than this many Δ to a surface Gaussian with mass are left out; 0.5 by default.
    pub clearance: f64,
    /// Mass points per simulator cell above which surface Gaussians become tracers; 27 by default.
    pub max_per_cell: usize,
    /// Mass of surface Gaussians.
    pub splat_mass: SplatMass,
}

impl Default for VolumeSettings {
    fn default() -> Self {
        Self { jitter: 0.25, clearance: 0.5, max_per_cell: 27, splat_mass: SplatMass::Auto }
    }
}

/// The distribution of volumes, in cubic units of the filling frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct VolumeReport {
    /// Classified volume.
    pub classified: f64,
    /// Sum over the particles.
    pub assigned: f64,
    /// Smallest volume of a mass point.
    pub min: f64,
    /// Lower decile of the mass points.
    pub p10: f64,
    /// Median of the mass points.
    pub median: f64,
    /// Largest volume.
    pub max: f64,
    /// Points with mass.
    pub mass_points: usize,
    /// Surface Gaussians without mass.
    pub tracers: usize,
    /// Internal particles left out because a surface Gaussian is near.
    pub rejected: usize,
    /// Simulator cells with volume but without a particle, given to the nearest one.
    pub empty_cells: usize,
    /// Particles above the cap of 8 medians, cut to it.
    pub capped: usize,
    /// True where no surface Gaussian carries mass.
    pub tracer_mode: bool,
}

/// Internal particles and the volumes of all.
#[derive(Clone, Debug, Default)]
pub struct Particles {
    /// Internal positions in the filling frame.
    pub internal: Vec<Vec3<f64>>,
    /// Volumes of the surface Gaussians, then of the internal particles, in cubic units of the frame; 0 = tracer.
    pub volume: Vec<f64>,
    /// Surface Gaussians (indices) without any classified volume in the 27 simulator cells around them: the simulator's grid
    /// has no mass that could carry them.
    pub loose: Vec<u32>,
    /// Distribution.
    pub report: VolumeReport,
}

/// Places particles in the classified interior and shares its volume out. `surface` holds the centres of the surface
/// Gaussians in the filling frame; the seed fixes the jitter.
pub fn particles(filling: &Filling, surface: &[Vec3<f64>], settings: &VolumeSettings, seed: u64) -> Particles {
    let mut internal = candidates(filling, settings.jitter, seed);
    let tracer_mode = match settings.splat_mass {
        SplatMass::Always => false,
        SplatMass::Never => true,
        SplatMass::Auto => surface.len() > 4 * internal.len(),
    };
    let before = internal.len();
    let near: Vec<Vec3<f32>> = surface.iter().map(|&x| vec3::cast(x)).collect();
    if let (false, Some(tree)) = (tracer_mode, Neighbours::new(&near)) {
        let delta = filling.grid.spacing * filling.per_particle as f64;
        let least = (settings.clearance * delta).powi(2) as f32;
        let keep: Vec<bool> = internal.par_iter().map(|&x| tree.distance2(&vec3::cast(x)) >= least).collect();
        let mut flag = keep.iter();
        internal.retain(|_| *flag.next().unwrap_or(&true));
    }
    let mut out = share(filling, surface, internal, tracer_mode, settings, seed);
    out.report.rejected = before - out.internal.len();
    out
}

/// One particle per lattice cell of the interior: at the centre of the cell or, on a refined grid, at the interior point
/// of the cell nearest to the middle of its interior points; jittered.
fn candidates(filling: &Filling, jitter: f64, seed: u64) -> Vec<Vec3<f64>> {
    let (grid, pp) = (&filling.grid, filling.per_particle);
    let dims = grid.dims.map(|n| n / pp);
    let mut out = Vec::new();
    for z in 0..dims[2] {
        for y in 0..dims[1] {
            for x in 0..dims[0] {
                let Some(cell) = representative(filling, [x, y, z]) else { continue };
                // The identity of a lattice cell does not depend on how far the grid reaches.
                let id = (0..3).fold(0u64, |id, k| {
                    let global = (grid.origin[k] / (grid.spacing * pp as f64)).round() as i64 + [x, y, z][k] as i64;
                    id << 21 | (global & 0x1f_ffff) as u64
                });
                let c = grid.center(cell);
                out.push(std::array::from_fn(|k| c[k] + (2.0 * hash01(seed, id, 17 + k as u64) - 1.0) * jitter * grid.spacing));
            }
        }
    }
    out
}

fn representative(filling: &Filling, lattice: [usize; 3]) -> Option<[usize; 3]> {
    let (grid, pp) = (&filling.grid, filling.per_particle);
    let first = lattice.map(|v| v * pp);
    if pp == 1 {
        return filling.inside[grid.index(first)].then_some(first);
    }
    let inside: Vec<[usize; 3]> = (0..pp * pp * pp)
        .map(|i| [first[0] + i % pp, first[1] + i / pp % pp, first[2] + i / (pp * pp)])
        .filter(|&c| filling.inside[grid.index(c)])
        .collect();
    let n = inside.len() as f64;
    let mid: Vec3<f64> = std::array::from_fn(|k| inside.iter().map(|c| c[k] as f64).sum::<f64>() / n);
    let away = |c: &[usize; 3]| (0..3).map(|k| (c[k] as f64 - mid[k]).powi(2)).sum::<f64>();
    inside.into_iter().min_by(|a, b| away(a).total_cmp(&away(b)))
}

/// `V_p = volume of the interior in the simulator's cell / mass points in it`.
fn share(
    filling: &Filling,
    surface: &[Vec3<f64>],
    internal: Vec<Vec3<f64>>,
    tracer_mode: bool,
    settings: &VolumeSettings,
    seed: u64,
) -> Particles {
    let grid = &filling.grid;
    let block = 2 * filling.per_particle;
    let cells = crate::fill::Grid { spacing: grid.spacing * block as f64, dims: grid.dims.map(|n| n / block), ..*grid };
    let mut filled = vec![0u32; cells.len()];
    for (i, _) in filling.inside.iter().enumerate().filter(|(_, v)| **v) {
        filled[cells.index(grid.cell(i).map(|c| c / block))] += 1;
    }

    let loose = loose(&cells, &filled, surface);

    // Members of every cell with volume, ascending: surface first, internal after.
    let count = surface.len() + internal.len();
    let position = |p: usize| if p < surface.len() { surface[p] } else { internal[p - surface.len()] };
    let mut home: Vec<Option<usize>> = (0..count)
        .map(|p| {
            let allowed = !(tracer_mode && p < surface.len());
            cells.locate(position(p)).map(|c| cells.index(c)).filter(|&c| allowed && filled[c] > 0)
        })
        .collect();
    thin_out(&mut home, surface.len(), cells.len(), settings.max_per_cell, seed);

    let mut members = vec![0u32; cells.len()];
    for c in home.iter().flatten() {
        members[*c] += 1;
    }
    let unit = grid.cell_volume();
    let mut volume: Vec<f64> = home.iter().map(|h| h.map_or(0.0, |c| f64::from(filled[c]) * unit / f64::from(members[c]))).collect();
    let massive: Vec<usize> = (0..count).filter(|&p| home[p].is_some()).collect();
    let points: Vec<Vec3<f32>> = massive.iter().map(|&p| vec3::cast(position(p))).collect();
    let mut report = VolumeReport { classified: filling.volume(), tracer_mode, ..VolumeReport::default() };
    if let Some(tree) = Neighbours::new(&points) {
        for c in (0..cells.len()).filter(|&c| filled[c] > 0 && members[c] == 0) {
            report.empty_cells += 1;
            if let Some(n) = tree.nearest(&vec3::cast(cells.center(cells.cell(c))), 1).first() {
                volume[massive[n.0 as usize]] += f64::from(filled[c]) * unit;
            }
        }
        report.capped = cap(&mut volume, &massive, &points, &tree, surface.len());
    }
    let mut sorted: Vec<f64> = massive.iter().map(|&p| volume[p]).collect();
    sorted.sort_by(f64::total_cmp);
    if let (Some(&min), Some(&max)) = (sorted.first(), sorted.last()) {
        (report.min, report.max) = (min, max);
        (report.p10, report.median) = (sorted[sorted.len() / 10], sorted[sorted.len() / 2]);
    }
    report.assigned = volume.iter().sum();
    report.mass_points = massive.len();
    report.tracers = home[..surface.len()].iter().filter(|h| h.is_none()).count();
    Particles { internal, volume, loose, report }
}

fn loose(cells: &crate::fill::Grid, filled: &[u32], surface: &[Vec3<f64>]) -> Vec<u32> {
    let held = |x: Vec3<f64>| {
        (0..27).any(|o| {
            let shift = [o % 3 - 1, o / 3 % 3 - 1, o / 9 - 1];
            let near = std::array::from_fn(|k| x[k] + f64::from(shift[k]) * cells.spacing);
            cells.locate(near).is_some_and(|c| filled[cells.index(c)] > 0)
        })
    };
    (0..surface.len() as u32).filter(|&i| !held(surface[i as usize])).collect()
}

/// Takes the mass of surface Gaussians in crowded cells, chosen by a hash, until at most `most` mass points remain.
fn thin_out(home: &mut [Option<usize>], surface: usize, cells: usize, most: usize, seed: u64) {
    let mut members = vec![0u32; cells];
    for c in home.iter().flatten() {
        members[*c] += 1;
    }
    let mut crowd: Vec<(usize, u64, usize)> = (0..surface)
        .filter_map(|p| home[p].filter(|&c| members[c] as usize > most).map(|c| (c, hash01(seed, p as u64, 23).to_bits(), p)))
        .collect();
    crowd.sort_unstable();
    for (c, _, p) in crowd {
        if members[c] as usize > most {
            members[c] -= 1;
            home[p] = None;
        }
    }
}

/// Cuts volumes above 8 medians and gives the rest to the nearest points that have room. The median is that of all mass
/// points or of the internal ones, whichever is larger: a crowd of light surface Gaussians must not cut the interior.
fn cap(volume: &mut [f64], massive: &[usize], points: &[Vec3<f32>], tree: &Neighbours, surface: usize) -> usize {
    let median = |least: usize| {
        let mut v: Vec<f64> = massive.iter().filter(|&&p| p >= least).map(|&p| volume[p]).collect();
        let mid = v.len() / 2;
        if v.is_empty() { 0.0 } else { *v.select_nth_unstable_by(mid, f64::total_cmp).1 }
    };
    let limit = 8.0 * median(0).max(median(surface));
    let mut capped = 0;
    for (k, &p) in massive.iter().enumerate() {
        let mut rest = volume[p] - limit;
        if rest <= 0.0 {
            continue;
        }
        capped += 1;
        volume[p] = limit;
        for (j, _) in tree.nearest(&points[k], 64) {
            let q = massive[j as usize];
            let take = rest.min((limit - volume[q]).max(0.0));
            volume[q] += take;
            rest -= take;
        }
        // Nobody near has room: conservation matters more than the cap.
        volume[p] += rest;
    }
    capped
}
