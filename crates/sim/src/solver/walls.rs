//! Which nodes lie inside obstacles, for the heat (simulation.md §6.3).

use megas_math::vec3;
use rayon::prelude::*;

use crate::collider::{Collider, Placed, Thermal, placed};
use crate::grid::Grid;
use crate::schedule::interpolate;
use crate::thermal::Wall;
use crate::thermal::solids::Cells;

/// Not inside any obstacle.
const FREE: u16 = u16::MAX;

/// The thermal condition of every node, kept up to date with obstacles that move, come, go, or change their temperature.
pub(super) struct Walls {
    /// First obstacle of the list that holds the node, of those that never change.
    fixed: Vec<u16>,
    /// The same for all obstacles, now.
    owner: Vec<u16>,
    /// Nodes whose owner may differ from `fixed`.
    changed: Vec<u32>,
    /// Condition that each obstacle imposes now.
    conditions: Vec<Wall>,
    nodes: Vec<Wall>,
    cells: Cells,
}

impl Walls {
    /// `None` without obstacles. `cells` are those of the conducting ones.
    pub(super) fn new(grid: &Grid, colliders: &[Collider], cells: Cells) -> Option<Self> {
        if colliders.is_empty() {
            return None;
        }
        let all = placed(colliders, 0.0);
        let fixed: Vec<&Placed> = all.iter().filter(|c| c.collider.is_static() && c.sheet.is_none()).collect();
        let owner = |n: usize| {
            let x = grid.position(grid.node(n));
            fixed.iter().find(|c| c.distance(x).0 < 0.0).map_or(FREE, |c| c.index)
        };
        let fixed: Vec<u16> = (0..grid.len()).into_par_iter().with_min_len(1024).map(owner).collect();
        Some(Self { owner: fixed.clone(), fixed, changed: Vec::new(), conditions: Vec::new(), nodes: vec![Wall::Open; grid.len()], cells })
    }

    /// The conditions at `time` \[s\].
    pub(super) fn at(&mut self, grid: &Grid, colliders: &[Collider], time: f64) -> &[Wall] {
        let conditions: Vec<Wall> = colliders.iter().map(|c| condition(&c.thermal, time)).collect();
        let refill = conditions != self.conditions;
        self.conditions = conditions;
        let mut stale = std::mem::take(&mut self.changed);
        for &n in &stale {
            self.owner[n as usize] = self.fixed[n as usize];
        }
        for c in placed(colliders, time).iter().filter(|c| !c.collider.is_static() && c.sheet.is_none()) {
            self.claim(grid, c);
        }
        if refill {
            let mut nodes = std::mem::take(&mut self.nodes);
            nodes.par_iter_mut().enumerate().with_min_len(4096).for_each(|(n, w)| *w = self.wall(n));
            self.nodes = nodes;
        } else {
            stale.extend_from_slice(&self.changed);
            for n in stale {
                self.nodes[n as usize] = self.wall(n as usize);
            }
        }
        &self.nodes
    }

    /// The condition of a node by its owner.
    fn wall(&self, node: usize) -> Wall {
        let owner = usize::from(self.owner[node]);
        match self.conditions.get(owner).copied() {
            None => Wall::Open,
            Some(Wall::Conducting(_)) => self.cells.get(owner, node).map_or(Wall::Adiabatic, Wall::Conducting),
            Some(condition) => condition,
        }
    }

    /// Gives the nodes inside a changeable obstacle to it, unless an earlier one of the list holds them.
    fn claim(&mut self, grid: &Grid, c: &Placed) {
        let mut range = grid.nodes.map(|n| [0, n]);
        if let Some((lo, hi)) = c.collider.shape.bounds() {
            let corner = |i: usize| c.pose.now(std::array::from_fn(|a| if i >> a & 1 == 1 { hi[a] } else { lo[a] }));
            let (mut low, mut high) = (corner(0), corner(0));
            for i in 1..8 {
                (low, high) = (vec3::min(low, corner(i)), vec3::max(high, corner(i)));
            }
            let (low, high) = (grid.coordinate(low), grid.coordinate(high));
            for a in 0..3 {
                let last = grid.nodes[a] as f64;
                range[a] = [low[a].floor().clamp(0.0, last) as usize, (high[a] + 1.0).ceil().clamp(0.0, last) as usize];
            }
        }
        let [x, y, z] = range;
        for i in x[0]..x[1] {
            for j in y[0]..y[1] {
                for k in z[0]..z[1] {
                    let n = grid.index(i, j, k);
                    if c.index < self.owner[n] && c.distance(grid.position([i, j, k])).0 < 0.0 {
                        self.owner[n] = c.index;
                        self.changed.push(n as u32);
                    }
                }
            }
        }
    }
}

fn condition(thermal: &Thermal, time: f64) -> Wall {
    match thermal {
        Thermal::Adiabatic => Wall::Adiabatic,
        Thermal::Fixed { kelvin, keyframes } => Wall::Fixed(interpolate(keyframes, time).unwrap_or(*kelvin) as f32),
        // Which cell depends on the node.
        Thermal::Conducting(_) => Wall::Conducting(0),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::collider::Shape;
    use crate::schedule::{Motion, PoseKey};

    #[test]
    fn nodes_follow_obstacles_that_move_come_go_and_warm_up() {
        let grid = Grid { origin: [0.0; 3], spacing: 1.0, nodes: [20, 12, 12] };
        let floor = Collider::new(Shape::HalfSpace { point: [0.0, 0.0, 2.5], normal: [0.0, 0.0, 1.0] });
        let key = |time, x: f64, q| PoseKey { time, translation: [x, 0.0, 0.0], rotation: q };
        let half = std::f64::consts::FRAC_1_SQRT_2;
        let poker = Collider {
            motion: Motion(vec![key(0.0, 0.0, [1.0, 0.0, 0.0, 0.0]), key(2.0, 8.0, [half, half, 0.0, 0.0])]),
            active: vec![[0.0, 3.0]],
            thermal: Thermal::Fixed { kelvin: 0.0, keyframes: vec![[0.0, 400.0], [1.0, 500.0]] },
            ..Collider::new(Shape::Capsule { a: [5.0, 6.0, 3.0], b: [5.0, 6.0, 8.0], radius: 1.6 })
        };
        let colliders = [floor, poker];
        let mut walls = Walls::new(&grid, &colliders, Cells::default()).unwrap();
        for time in [0.0, 0.7, 1.4, 2.5, 3.5, 0.7] {
            let got = walls.at(&grid, &colliders, time).to_vec();
            let mut counts = [0; 2];
            for (n, w) in got.iter().enumerate() {
                let x = grid.position(grid.node(n));
                let slow = placed(&colliders, time).iter().find(|c| c.distance(x).0 < 0.0).map(|c| c.index);
                let expected = match slow {
                    None => Wall::Open,
                    Some(0) => Wall::Adiabatic,
                    Some(_) => Wall::Fixed((400.0 + 100.0 * time.min(1.0)) as f32),
                };
                assert_eq!(*w, expected, "{time} {x:?}");
                counts[usize::from(*w != Wall::Adiabatic)] += usize::from(*w != Wall::Open);
            }
            assert!(counts[0] == 20 * 12 * 3 && (counts[1] > 30) == (time < 3.0), "{time} {counts:?}");
        }
    }
}
