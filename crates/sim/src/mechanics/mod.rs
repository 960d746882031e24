//! The MLS-MPM substep: P2G, grid, G2P, return map (simulation.md §2), over sparse blocks of nodes.
//!
//! Substeps run in batches ([`Mechanics::run`]). Inside a batch the G2P of one substep and the P2G of the next are one sweep
//! over the points, so stress is never stored: it follows from the return map that just happened, and at the start of a
//! batch from the stored F. Nothing but [`Particles`] carries over from one batch to the next, which is why a checkpoint
//! of them restarts bitwise.

mod laws;
mod nodes;
mod pass;
mod sheets;
mod time_step;
mod transfer;
mod view;

use std::ops::{Add, AddAssign};

use fearless_simd::{Level, dispatch};
use megas_math::{Mat3, mat3, vec3};
use megas_model::FLAG_ESCAPED;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::collider::{Collider, Placed, placed};
use crate::grid::Grid;
use crate::particles::Particles;
pub use laws::{material_point, material_point_with};
use nodes::{GridStep, Nodes, block_center};
use pass::{Outcome, Sweep, sweep};
use sheets::{put_back, take_sides};
pub use time_step::TimeStep;
use transfer::Tile;
use view::{View, views};

/// A face of the box.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Wall {
    /// Only the outward velocity vanishes.
    Slip,
    /// No motion.
    Sticky,
}

/// What happens to a point within two nodes of the box (simulation.md §9.3).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Bounds {
    /// It is held there, and the faces of the box are walls.
    #[default]
    Clamp,
    /// It loses its mass and is flagged as escaped; the faces are open.
    Delete,
}

/// Points that left the box for good.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Escaped {
    /// Points that carried mass.
    pub points: u64,
    /// Their mass \[kg\].
    pub mass: f64,
    /// Their heat `Σ m h` \[J\].
    pub heat: f64,
}

impl AddAssign for Escaped {
    fn add_assign(&mut self, o: Self) {
        *self = Self { points: self.points + o.points, mass: self.mass + o.mass, heat: self.heat + o.heat };
    }
}

/// Which shear modulus the backward Euler step of the flow uses (simulation.md §5.2).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum FlowStiffness {
    /// μ: exact for the Hencky law.
    Hencky,
    /// μ tr(b)/3 of Yue 2015, for comparison with other programs.
    Yue,
}

/// Constants of the mechanics.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Settings {
    /// Acceleration \[m/s²\].
    pub gravity: [f64; 3],
    /// Global drag c_d \[1/s\], ≥ 0.
    pub drag: f64,
    /// Affine damping ζ, 0–1 (1 keeps only rotation).
    pub affine_damping: f64,
    /// PIC in place of APIC: momentum goes to the nodes without its gradient, which damps (for comparison).
    pub plain_momentum: bool,
    /// Low and high face per axis.
    pub walls: [[Wall; 2]; 3],
    /// Rule at the faces.
    pub bounds: Bounds,
    /// Flow stiffness.
    pub flow: FlowStiffness,
    /// Integrate the total gradient Fᴿ and transport the normals with it.
    pub track_total: bool,
    /// Points in less than this share of a full neighbourhood fly freely (simulation.md §9.3); 0 turns it off.
    pub isolation: f64,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            gravity: [0.0, 0.0, -9.81],
            drag: 0.0,
            affine_damping: 0.0,
            plain_momentum: false,
            walls: [[Wall::Slip; 2]; 3],
            bounds: Bounds::Clamp,
            flow: FlowStiffness::Hencky,
            track_total: true,
            isolation: 0.05,
        }
    }
}

/// Number of automatic repairs (simulation.md §9.3); a clean run reports zeros.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Repairs {
    /// Degenerate or inverted gradients replaced by their rotation.
    pub degenerate: u64,
    /// Speeds cut to half a node spacing per substep.
    pub capped: u64,
    /// Points held at the margin of the box.
    pub out_of_box: u64,
    /// Points pushed out of an obstacle.
    pub projected: u64,
    /// Point-substeps in free flight. Not an error by itself.
    pub isolated: u64,
    /// Points whose velocity was not a number.
    pub non_finite: u64,
}

impl Repairs {
    /// None.
    pub const NONE: Self = Self { degenerate: 0, capped: 0, out_of_box: 0, projected: 0, isolated: 0, non_finite: 0 };
}

impl Add for Repairs {
    type Output = Self;
    fn add(self, o: Self) -> Self {
        Self {
            degenerate: self.degenerate + o.degenerate,
            capped: self.capped + o.capped,
            out_of_box: self.out_of_box + o.out_of_box,
            projected: self.projected + o.projected,
            isolated: self.isolated + o.isolated,
            non_finite: self.non_finite + o.non_finite,
        }
    }
}

impl AddAssign for Repairs {
    fn add_assign(&mut self, o: Self) {
        *self = *self + o;
    }
}

/// What a batch of substeps found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Report {
    /// Repairs.
    pub repairs: Repairs,
    /// Largest speed of a point in any substep \[m/s\].
    pub max_speed: f64,
    /// Smallest and largest volume ratio J in any substep.
    pub volume_ratio: (f64, f64),
    /// Kinetic energy taken by the speed cap \[J\].
    pub energy_removed: f64,
    /// Points lost at the faces of the box.
    pub escaped: Escaped,
}

/// The solver: settings, obstacles and the sparse grid.
pub struct Mechanics {
    grid: Grid,
    /// Constants; may be changed between batches.
    pub settings: Settings,
    /// Time at which the next batch starts \[s\]: where the obstacles are. Every batch moves it on.
    pub time: f64,
    colliders: Vec<Collider>,
    nodes: Nodes,
    level: Level,
    least_mass: f32,
}

impl Mechanics {
    /// A solver on `grid`, which must be the grid of the particles.
    pub fn new(grid: &Grid, settings: Settings, colliders: Vec<Collider>) -> Self {
        Self { grid: *grid, settings, time: 0.0, colliders, nodes: Nodes::default(), level: Level::new(), least_mass: 0.0 }
    }

    /// The obstacles, in order of precedence.
    pub fn colliders(&self) -> &[Collider] {
        &self.colliders
    }

    /// The instruction set in use.
    pub fn simd(&self) -> String {
        format!("{:?}", self.level).split('(').next().unwrap_or_default().to_lowercase()
    }

    /// Runs `steps` substeps of `dt` seconds and sorts the particles before and, where they drift, in between.
    pub fn run(&mut self, particles: &mut Particles, steps: usize, dt: f64) -> Report {
        let mut outcome = Outcome::NEUTRAL;
        if steps > 0 && !particles.is_empty() {
            self.least_mass = least_mass(particles);
            if self.settings.track_total {
                pull_normals_back(particles);
            }
            let mut left = steps;
            while left > 0 {
                particles.sort();
                let now = self.time + (steps - left) as f64 * dt;
                let placed = placed(&self.colliders, now);
                if self.has_sheets() {
                    take_sides(&self.grid, particles, &sheets_of(&placed));
                }
                self.nodes.rebuild(&self.grid, particles.blocks(), &placed, &particles.sides);
                let mut blocks = views(particles);
                if self.nodes.wants_liquid() {
                    self.find_liquid(&mut blocks);
                }
                let limit = left.min(self.steps_until_obstacles_moved(now, left, dt));
                let (done, found) = self.run_sorted(&mut blocks, limit, dt);
                drop(blocks);
                particles.mark_moved();
                outcome = outcome.merge(found);
                left -= done;
            }
            if self.settings.track_total {
                push_normals_forward(particles);
            }
            self.time += steps as f64 * dt;
            outcome.repairs.projected += self.project_out(particles);
        }
        let mut escaped = Escaped::default();
        if self.settings.bounds == Bounds::Delete {
            for i in 0..particles.len() {
                if particles.flags[i] & FLAG_ESCAPED != 0 {
                    escaped += remove(particles, i);
                }
            }
        }
        Report {
            repairs: outcome.repairs,
            max_speed: f64::from(outcome.speed2).sqrt(),
            volume_ratio: (f64::from(outcome.volume.0), f64::from(outcome.volume.1)),
            energy_removed: outcome.removed,
            escaped,
        }
    }

    fn has_sheets(&self) -> bool {
        self.colliders.iter().any(Collider::is_sheet)
    }

    /// Substeps after which an obstacle may have moved by half a node spacing, so that its contacts are out of date.
    fn steps_until_obstacles_moved(&self, time: f64, left: usize, dt: f64) -> usize {
        let speed = self.obstacle_speed(time, left as f64 * dt);
        let steps = if speed > 0.0 { 0.5 * self.grid.spacing / (speed * dt) } else { f64::INFINITY };
        if steps >= left as f64 { left } else { (steps as usize).max(1) }
    }

    /// Largest speed of an obstacle's surface inside the grid in the `interval` after `time` \[m/s\].
    fn obstacle_speed(&self, time: f64, interval: f64) -> f64 {
        let (lo, hi) = (self.grid.origin, self.grid.position(self.grid.nodes.map(|n| n - 1)));
        let at = |s: f64| self.colliders.iter().map(|c| c.speed(time + s * interval, lo, hi)).fold(0.0, f64::max);
        [0.0, 0.5, 1.0].map(at).into_iter().fold(0.0, f64::max)
    }

    /// Substeps until `limit` or until points may leave the reach of their tile; at least one.
    fn run_sorted(&mut self, blocks: &mut [View], limit: usize, dt: f64) -> (usize, Outcome) {
        let mut outcome = Outcome::NEUTRAL;
        self.sweep::<false, true>(blocks, dt);
        let mut drift = 0.0;
        for step in 1..=limit {
            drift += f64::from(self.advance_grid(dt)).sqrt().min(self.speed_cap(dt)) * dt / self.grid.spacing;
            // The apron of a tile is one cell: after the next move, P2G must still find every point inside.
            if step == limit || drift > 0.99 {
                return (step, outcome.merge(self.sweep::<true, false>(blocks, dt)));
            }
            outcome = outcome.merge(self.sweep::<true, true>(blocks, dt));
        }
        (limit, outcome)
    }

    fn speed_cap(&self, dt: f64) -> f64 {
        0.5 * self.grid.spacing / dt
    }

    fn constants(&self, dt: f64) -> Sweep {
        Sweep {
            dt: dt as f32,
            dx: self.grid.spacing as f32,
            inv_dx: (1.0 / self.grid.spacing) as f32,
            speed_cap: self.speed_cap(dt) as f32,
            nodes: self.grid.nodes,
            affine_damping: self.settings.affine_damping as f32,
            lever: if self.settings.plain_momentum { 0.0 } else { self.grid.spacing as f32 },
            track_total: self.settings.track_total,
            yue: self.settings.flow == FlowStiffness::Yue,
            bounds: self.settings.bounds,
            isolation: self.settings.isolation as f32,
        }
    }

    /// One sweep over all blocks of points (see [`pass::sweep`]).
    fn sweep<const GATHER: bool, const SCATTER: bool>(&mut self, blocks: &mut [View], dt: f64) -> Outcome {
        let constants = self.constants(dt);
        let level = self.level;
        let mut tiles = std::mem::take(&mut self.nodes.tiles);
        let mut near = std::mem::take(&mut self.nodes.near);
        near.resize_with(blocks.len(), || None);
        let nodes = &self.nodes;
        let found: Vec<Outcome> = blocks
            .par_iter_mut()
            .zip(tiles.par_iter_mut())
            .zip(near.par_iter_mut())
            .enumerate()
            .map_init(
                || Box::new(Tile::ZERO),
                |from, (index, ((view, (to, regions)), near))| {
                    if SCATTER {
                        to.0.fill(0.0);
                    }
                    let mut near = near.as_deref_mut();
                    let (outcome, touched) = dispatch!(level, s => {
                        if GATHER {
                            nodes.load_tile(s, index, from);
                        }
                        if let Some(near) = near.as_deref_mut() {
                            if GATHER {
                                nodes.load_layers(s, near);
                            }
                            if SCATTER {
                                near.clear();
                            }
                        }
                        sweep::<_, GATHER, SCATTER>(s, view, from, to, near, &constants)
                    });
                    *regions = touched;
                    outcome
                },
            )
            .collect();
        self.nodes.tiles = tiles;
        self.nodes.near = near;
        found.into_iter().fold(Outcome::NEUTRAL, Outcome::merge)
    }

    /// Velocities of all node blocks from the tiles; returns the largest speed squared.
    fn advance_grid(&mut self, dt: f64) -> f32 {
        let mut values = std::mem::take(&mut self.nodes.values);
        let nodes = &self.nodes;
        let level = self.level;
        let step = GridStep { settings: &self.settings, grid: &self.grid, dt, least_mass: self.least_mass };
        let fastest: Vec<f32> =
            values.par_iter_mut().enumerate().map(|(i, out)| dispatch!(level, s => nodes.advance(s, i, out, &step))).collect();
        self.nodes.values = values;
        let mut ghosts = std::mem::take(&mut self.nodes.ghosts);
        let nodes = &self.nodes;
        let beside: Vec<f32> = ghosts.par_iter_mut().map(|g| dispatch!(level, s => nodes.advance_ghost(s, g, &step))).collect();
        self.nodes.ghosts = ghosts;
        fastest.into_iter().chain(beside).fold(0.0, f32::max)
    }

    /// Liquid share of the node masses near obstacles, once per sort: P2G of `m f_l` in place of momentum.
    fn find_liquid(&mut self, blocks: &mut [View]) {
        let level = self.level;
        let mut tiles = std::mem::take(&mut self.nodes.tiles);
        let mut near = std::mem::take(&mut self.nodes.near);
        near.resize_with(blocks.len(), || None);
        blocks.par_iter().zip(tiles.par_iter_mut()).zip(near.par_iter_mut()).for_each(|((view, (to, regions)), near)| {
            to.0.fill(0.0);
            let mut near = near.as_deref_mut();
            if let Some(near) = near.as_deref_mut() {
                near.clear();
            }
            *regions = pass::scatter_liquid(view, to, near);
        });
        self.nodes.tiles = tiles;
        self.nodes.near = near;
        let nodes = &self.nodes;
        let shares: Vec<_> = (0..nodes.info.len()).into_par_iter().map(|i| nodes.liquid_share(level, i)).collect();
        self.nodes.set_liquid(shares);
        let mut ghosts = std::mem::take(&mut self.nodes.ghosts);
        let nodes = &self.nodes;
        ghosts.par_iter_mut().for_each(|g| nodes.find_ghost_liquid(level, g));
        self.nodes.ghosts = ghosts;
    }

    /// Moves points that are deeper than one node spacing inside an obstacle to its surface and removes their inward velocity; the same
    /// for points that got through a sheet.
    fn project_out(&self, particles: &mut Particles) -> u64 {
        let mut colliders = placed(&self.colliders, self.time);
        let mut count = put_back(&self.grid, particles, &sheets_of(&colliders));
        colliders.retain(|c| c.sheet.is_none());
        if colliders.is_empty() {
            return count;
        }
        let dx = self.grid.spacing;
        // Only blocks that reach deep enough; points have drifted by at most a cell since the sort.
        let reach = 3.0 * 3f64.sqrt() * dx;
        for b in particles.blocks().to_vec() {
            let center = block_center(&self.grid, b.coords);
            let near: Vec<&Placed> = colliders.iter().filter(|c| c.distance(center).0 < reach - dx).collect();
            if near.is_empty() {
                continue;
            }
            for i in b.start as usize..b.end as usize {
                for c in &near {
                    let x = particles.position(i);
                    let (d, n) = c.distance(x);
                    if d < -dx {
                        particles.set_position(i, vec3::add_scaled(x, n, -d));
                        let v: [f64; 3] = vec3::cast(particles.velocity(i));
                        let inward = vec3::dot(vec3::sub(v, c.pose.velocity_at(x)), n).min(0.0);
                        particles.set_velocity(i, vec3::cast(vec3::add_scaled(v, n, -inward)));
                        // Tracers lie outside the mass that the contact holds; putting them back is not a repair.
                        count += u64::from(particles.mass[i] > 0.0);
                    }
                }
            }
        }
        count
    }

    /// Calls `f(node, mass [kg], velocity [m/s])` for every node with mass, as the last grid update left them.
    pub fn for_each_node(&self, f: impl FnMut([usize; 3], f32, [f32; 3])) {
        self.nodes.for_each(&self.grid, f);
    }
}

/// The sheets among obstacles.
fn sheets_of<'a, 'b>(placed: &'a [Placed<'b>]) -> Vec<&'a Placed<'b>> {
    placed.iter().filter(|c| c.sheet.is_some()).collect()
}

/// Takes a point out of the simulation: it has neither mass nor motion from now on.
fn remove(p: &mut Particles, i: usize) -> Escaped {
    let mass = f64::from(std::mem::take(&mut p.mass[i]));
    p.volume[i] = 0.0;
    p.set_velocity(i, [0.0; 3]);
    p.set_affine(i, [[0.0; 3]; 3]);
    p.set_elastic(i, mat3::identity());
    Escaped { points: u64::from(mass > 0.0), mass, heat: mass * p.enthalpy[i] }
}

/// Nodes below this mass are empty (simulation.md §2.3): 1e-12 of the median.
fn least_mass(p: &Particles) -> f32 {
    let mut m: Vec<f32> = p.mass.iter().copied().filter(|&m| m > 0.0).collect();
    if m.is_empty() {
        return 0.0;
    }
    let middle = m.len() / 2;
    *m.select_nth_unstable_by(middle, f32::total_cmp).1 * 1e-12
}

/// `n ← Fᴿᵀ n`: with [`push_normals_forward`] at the end of a batch, normals follow `(ΔFᴿ)^{-T}` without any work per substep
/// (simulation.md §2.4).
fn pull_normals_back(p: &mut Particles) {
    let Particles { normal, total, .. } = p;
    normal.par_iter_mut().enumerate().with_min_len(4096).filter(|(_, n)| **n != [0.0; 3]).for_each(|(i, n)| {
        let f: Mat3<f32> = std::array::from_fn(|r| std::array::from_fn(|c| total[3 * r + c][i]));
        *n = mat3::tmul_vec(f, *n);
    });
}

/// `n ← normalize(Fᴿ^{-T} n)`.
fn push_normals_forward(p: &mut Particles) {
    let Particles { normal, total, .. } = p;
    normal.par_iter_mut().enumerate().with_min_len(4096).filter(|(_, n)| **n != [0.0; 3]).for_each(|(i, n)| {
        let f: Mat3<f32> = std::array::from_fn(|r| std::array::from_fn(|c| total[3 * r + c][i]));
        // The cofactor matrix is det F · F^{-T}.
        let cofactor = [vec3::cross(f[1], f[2]), vec3::cross(f[2], f[0]), vec3::cross(f[0], f[1])];
        let v = vec3::scale(mat3::mul_vec(cofactor, *n), mat3::det(f).signum());
        *n = vec3::normalize_or(v, vec3::normalize_or(*n, [0.0; 3]));
    });
}

#[cfg(test)]
mod tests;
