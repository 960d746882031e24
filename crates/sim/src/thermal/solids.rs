//! Obstacles that store and conduct heat (simulation.md §6.3): a temperature per node of those at rest, one for all of those
//! that move.

use rayon::prelude::*;

use crate::collider::{Collider, Conductor, Thermal};
use crate::grid::Grid;

/// Not part of a conducting obstacle.
const NONE: u32 = u32::MAX;

/// The cells of all conducting obstacles. Cells are nodes of the grid, or whole moving obstacles.
#[derive(Clone, Debug, Default)]
pub struct Solids {
    /// Temperature of each cell \[K\].
    pub(crate) t: Vec<f64>,
    /// Heat capacity \[J/K\].
    pub(crate) capacity: Vec<f64>,
    /// Conductivity \[W/(m·K)\].
    pub(crate) k: Vec<f64>,
    /// Heating \[W\].
    watts: Vec<f64>,
    /// Neighbours of a cell; itself where there is none.
    neighbours: Vec<[u32; 6]>,
    /// Conductance to any of them \[W/K\].
    link: Vec<f64>,
    /// Heat that came in during the step \[J\].
    gained: Vec<f64>,
}

/// Where the cells are.
#[derive(Clone, Debug, Default)]
pub(crate) struct Cells {
    /// Cell of each grid node; empty without obstacles at rest that conduct.
    at_node: Vec<u32>,
    /// Cell of each obstacle that has only one.
    of_obstacle: Vec<u32>,
}

impl Cells {
    /// The cell of obstacle `collider` at grid node `node`.
    #[inline]
    pub(crate) fn get(&self, collider: usize, node: usize) -> Option<u32> {
        let one = self.of_obstacle.get(collider).copied().filter(|&c| c != NONE);
        one.or_else(|| self.at_node.get(node).copied().filter(|&c| c != NONE))
    }
}

impl Solids {
    /// The conducting ones among `colliders`.
    pub(crate) fn new(grid: &Grid, colliders: &[Collider]) -> (Self, Cells) {
        let mut solids = Self::default();
        let mut cells = Cells { at_node: Vec::new(), of_obstacle: vec![NONE; colliders.len()] };
        for (index, c) in colliders.iter().enumerate() {
            let Thermal::Conducting(conductor) = c.thermal else { continue };
            match c.shape.volume().filter(|_| !c.motion.is_still()) {
                Some(volume) => {
                    cells.of_obstacle[index] = solids.t.len() as u32;
                    solids.push(&conductor, volume, conductor.watts, 0.0);
                }
                None => solids.fill(grid, c, &conductor, &mut cells.at_node),
            }
        }
        (solids, cells)
    }

    fn push(&mut self, c: &Conductor, volume: f64, watts: f64, link: f64) {
        self.neighbours.push([self.t.len() as u32; 6]);
        self.t.push(c.kelvin);
        self.capacity.push(c.volumetric_capacity * volume);
        self.k.push(c.conductivity);
        self.watts.push(watts);
        self.link.push(link);
        self.gained.push(0.0);
    }

    /// A cell for every node inside an obstacle at rest that no earlier one has taken.
    fn fill(&mut self, grid: &Grid, c: &Collider, conductor: &Conductor, at_node: &mut Vec<u32>) {
        at_node.resize(grid.len(), NONE);
        let pose = c.motion.at(0.0, c.shape.pivot());
        let inside: Vec<bool> = (0..grid.len())
            .into_par_iter()
            .with_min_len(1024)
            .map(|n| at_node[n] == NONE && pose.distance(&c.shape, grid.position(grid.node(n))).0 < 0.0)
            .collect();
        let count = inside.iter().filter(|i| **i).count();
        let first = self.t.len();
        for n in (0..inside.len()).filter(|&n| inside[n]) {
            at_node[n] = self.t.len() as u32;
            self.push(conductor, grid.spacing.powi(3), conductor.watts / count as f64, conductor.conductivity * grid.spacing);
        }
        let strides = [grid.nodes[1] * grid.nodes[2], grid.nodes[2], 1];
        for n in (0..inside.len()).filter(|&n| inside[n]) {
            let node = grid.node(n);
            let cell = at_node[n] as usize;
            for l in 0..6 {
                let a = l / 2;
                let other = match l % 2 {
                    0 if node[a] > 0 => at_node[n - strides[a]],
                    1 if node[a] + 1 < grid.nodes[a] => at_node[n + strides[a]],
                    _ => NONE,
                };
                // Only within the same obstacle: two that touch do not exchange heat.
                if other != NONE && other as usize >= first {
                    self.neighbours[cell][l] = other;
                }
            }
        }
    }

    /// Number of cells.
    pub fn len(&self) -> usize {
        self.t.len()
    }

    /// True if nothing conducts.
    pub fn is_empty(&self) -> bool {
        self.t.is_empty()
    }

    /// Temperatures of all cells \[K\]: what a checkpoint keeps.
    pub fn temperatures(&self) -> &[f64] {
        &self.t
    }

    /// Continues from kept temperatures; false if there are not as many as cells.
    pub fn restore(&mut self, temperatures: &[f64]) -> bool {
        let fits = temperatures.len() == self.t.len();
        if fits {
            self.t.copy_from_slice(temperatures);
        }
        fits
    }

    /// Heat content above 0 K \[J\].
    pub fn energy(&self) -> f64 {
        self.t.iter().zip(&self.capacity).map(|(t, c)| t * c).sum()
    }

    /// Heating of all \[W\].
    pub(crate) fn power(&self) -> f64 {
        self.watts.iter().sum()
    }

    /// Largest `Σ G / C` of a cell with `outside` \[W/K\] of links per cell to the material.
    pub(crate) fn rate(&self, outside: &[f64]) -> f64 {
        let own = |c: usize| self.link[c] * self.neighbours[c].iter().filter(|n| **n as usize != c).count() as f64;
        (0..self.len()).map(|c| (own(c) + outside[c]) / self.capacity[c]).fold(0.0, f64::max)
    }

    /// Books heat that comes into a cell from the material; it counts after [`Solids::advance`].
    #[inline]
    pub(crate) fn gain(&mut self, cell: u32, heat: f64) {
        self.gained[cell as usize] += heat;
    }

    /// Conduction inside, heating, and what was gained, over `dt` seconds.
    pub(crate) fn advance(&mut self, dt: f64) {
        let Self { t, capacity, watts, neighbours, link, gained, .. } = self;
        let before = &*t;
        gained.par_iter_mut().enumerate().with_min_len(1024).for_each(|(c, g)| {
            let q: f64 = neighbours[c].iter().map(|&n| link[c] * (before[n as usize] - before[c])).sum();
            *g += dt * (q + watts[c]);
        });
        for ((t, g), c) in t.iter_mut().zip(gained).zip(&*capacity) {
            *t += *g / c;
            *g = 0.0;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::collider::Shape;

    #[test]
    fn a_slab_conducts_like_the_cosine_it_is_and_keeps_its_heat() {
        let grid = Grid { origin: [0.0; 3], spacing: 0.01, nodes: [40, 3, 3] };
        let conductor = Conductor { kelvin: 300.0, volumetric_capacity: 2e6, conductivity: 20.0, watts: 0.0 };
        let slab = Collider {
            thermal: Thermal::Conducting(conductor),
            ..Collider::new(Shape::aligned_box([0.045, -1.0, -1.0], [0.365, 1.0, 1.0]))
        };
        let (mut solids, cells) = Solids::new(&grid, &[slab]);
        assert_eq!(solids.len(), 32 * 9);
        assert!(cells.get(0, grid.index(4, 1, 1)).is_none() && cells.get(0, grid.index(36, 1, 1)).is_some());
        // The slowest mode of an insulated bar of 0.32 m.
        let mode = |i: usize| (std::f64::consts::PI * (i as f64 - 4.5) / 32.0).cos();
        for i in 5..37 {
            for j in 0..9 {
                let c = cells.get(0, grid.index(i, j / 3, j % 3)).unwrap();
                solids.t[c as usize] += 10.0 * mode(i);
            }
        }
        let start = solids.energy();
        for _ in 0..500 {
            solids.advance(1.0);
        }
        let decay = (-(std::f64::consts::PI / 0.32).powi(2) * 1e-5 * 500.0).exp();
        let c = cells.get(0, grid.index(6, 1, 1)).unwrap() as usize;
        assert!(((solids.t[c] - 300.0) / (10.0 * mode(6)) - decay).abs() < 2e-3 * decay);
        assert!((solids.energy() / start - 1.0).abs() < 1e-12);
    }

    #[test]
    fn a_moving_one_is_a_single_cell() {
        use crate::schedule::{Motion, PoseKey};
        let grid = Grid { origin: [0.0; 3], spacing: 0.01, nodes: [20; 3] };
        let conductor = Conductor { kelvin: 600.0, volumetric_capacity: 4e6, conductivity: 50.0, watts: 8.0 };
        let key = PoseKey { time: 0.0, translation: [0.0; 3], rotation: [1.0, 0.0, 0.0, 0.0] };
        let poker = Collider {
            thermal: Thermal::Conducting(conductor),
            motion: Motion(vec![key]),
            ..Collider::new(Shape::aligned_box([0.0; 3], [0.1, 0.01, 0.02]))
        };
        let (mut solids, cells) = Solids::new(&grid, &[Collider::new(Shape::Sphere { center: [0.0; 3], radius: 1.0 }), poker]);
        assert_eq!((solids.len(), cells.get(1, 5), cells.get(0, 5)), (1, Some(0), None));
        // 80 J/K and 8 W: a kelvin in ten seconds.
        solids.gain(0, -80.0);
        solids.advance(10.0);
        assert!((solids.t[0] - 600.0).abs() < 1e-9);
    }
}
