//! Flow on every second node (simulation.md §1.3 `flow_ratio`): an eighth of the nodes for the expensive half of the air, and every
//! other step. With one step for both, as the design has it, viscosities would be a quarter in its units, and most air too thin for it.
//!
//! Nodes of the flow lie in the middle of 2³ nodes of the temperature, not on one of them as the design has it: walls half a node
//! outside the last node of either lattice are then in the same place, and buoyancy is the plain mean of a cell. Velocities go back
//! by trilinear interpolation (¾ and ¼ per axis); beyond a face the flow continues as the face wants it.

use rayon::prelude::*;

use crate::air::lattice::{Lattice, NodeState};
use crate::air::settings::{Face, FlowFace};
use crate::air::sweep::Seen;

/// One axis of the interpolation: the cell of a node, the next one, their weights, and what a moving face adds.
#[derive(Clone, Copy)]
struct Blend {
    cells: [usize; 2],
    weights: [f32; 2],
    add: f32,
}

impl Blend {
    /// Node `i` of an axis with `cells` cells, for velocity component `component`.
    fn new(i: usize, cells: usize, axis: usize, faces: &[Face; 2], component: usize) -> Self {
        let here = i / 2;
        let up = i % 2 == 1;
        let other = if up { here + 1 } else { here.wrapping_sub(1) };
        if other < cells {
            return Self { cells: [here, other], weights: [0.75, 0.25], add: 0.0 };
        }
        let (sign, add) = match faces[usize::from(up)].flow {
            FlowFace::Periodic => return Self { cells: [here, if up { 0 } else { cells - 1 }], weights: [0.75, 0.25], add: 0.0 },
            FlowFace::NoSlip => (-1.0, 0.0),
            FlowFace::Moving(u) => (-1.0, 2.0 * u[component] as f32),
            FlowFace::FreeSlip => (if axis == component { -1.0 } else { 1.0 }, 0.0),
            FlowFace::Open => (1.0, 0.0),
        };
        Self { cells: [here; 2], weights: [0.75 + 0.25 * sign, 0.0], add: 0.25 * add }
    }
}

impl Lattice {
    /// Moves the flow to cells of 2³ nodes if the settings ask for it.
    pub(super) fn coarsen_flow(&mut self) {
        if self.settings.flow && !self.settings.flows_here() {
            let mut coarse = Self::new(self.settings.coarse());
            (coarse.warmed, coarse.write_all, self.write_all) = (true, true, true);
            self.coarse = Some(Box::new(coarse));
        }
    }

    /// The nodes of a cell.
    fn children(&self, cell: [usize; 3]) -> impl Iterator<Item = [usize; 3]> + use<> {
        let size = self.settings.nodes;
        let along = move |a: usize| 2 * cell[a]..(2 * cell[a] + 2).min(size[a]);
        along(0).flat_map(move |i| along(1).flat_map(move |j| along(2).map(move |k| [i, j, k])))
    }

    pub(super) fn fill_coarse(&mut self, state: &dyn Fn([usize; 3]) -> (f64, [f64; 3], f64)) {
        let Some(mut coarse) = self.coarse.take() else { return };
        coarse.fill(|cell| {
            let (mut sum, mut count) = ([0.0; 5], 0.0);
            for n in self.children(cell) {
                let (rho, u, t) = state(n);
                for (s, v) in sum.iter_mut().zip([rho - 1.0, u[0], u[1], u[2], t]) {
                    *s += v;
                }
                count += 1.0;
            }
            let [excess, ux, uy, uz, t] = sum.map(|s| s / count);
            (1.0 + excess, [ux, uy, uz], t)
        });
        self.coarse = Some(coarse);
    }

    /// Tells the flow what fills its cells: the mean of their nodes.
    pub(super) fn set_coarse_nodes(&mut self, states: &[([usize; 3], NodeState)]) {
        let Some(mut coarse) = self.coarse.take() else { return };
        let [_, ny, nz] = coarse.settings.nodes;
        let mut sums = vec![[0.0f32; 4]; coarse.settings.nodes.iter().product()];
        for (n, state) in states {
            let s = &mut sums[((n[0] / 2) * ny + n[1] / 2) * nz + n[2] / 2];
            s[3] += state.solid;
            for a in 0..3 {
                s[a] += state.solid * state.velocity[a];
            }
        }
        let filled = coarse.every().zip(&sums).filter(|(_, s)| s[3] > 0.0).map(|(cell, s)| {
            let solid = s[3] / self.children(cell).count() as f32;
            (cell, NodeState { solid, velocity: std::array::from_fn(|a| s[a] / s[3]), ..NodeState::default() })
        });
        let filled: Vec<_> = filled.collect();
        coarse.set_nodes(&filled);
        self.coarse = Some(coarse);
    }

    /// Before every other step of the temperature one of the flow on its cells.
    pub(super) fn step_coarse(&mut self) -> Seen {
        let Some(mut coarse) = self.coarse.take_if(|_| self.flow_is_due) else {
            self.flow_is_due = true;
            return Seen::NOTHING;
        };
        self.flow_is_due = false;
        self.give_temperatures(&mut coarse);
        let seen = coarse.step().seen;
        self.take_velocities(&coarse);
        self.coarse = Some(coarse);
        Seen { temperature: Seen::NOTHING.temperature, ..seen }
    }

    /// Mean temperature of the air in every cell; cells without air keep what they had.
    fn give_temperatures(&self, coarse: &mut Lattice) {
        let [_, ny, nz] = coarse.settings.nodes;
        let (layout, fine) = (coarse.layout, self.settings.nodes);
        let (t, memory) = (&self.nodes.t, &self.nodes.memory);
        coarse.nodes.t.par_chunks_exact_mut(layout.plane).enumerate().for_each(|(i, plane)| {
            let mut sums = vec![[0.0f32; 2]; nz];
            for j in 0..ny {
                sums.fill([0.0; 2]);
                for x in 2 * i..(2 * i + 2).min(fine[0]) {
                    for y in 2 * j..(2 * j + 2).min(fine[1]) {
                        let first = self.layout.node([x, y, 0]);
                        let row = t[first..][..fine[2]].chunks(2).zip(memory[first..][..fine[2]].chunks(2));
                        for (s, (t, m)) in sums.iter_mut().zip(row) {
                            for (t, m) in t.iter().zip(m) {
                                *s = [s[0] + m * t, s[1] + m];
                            }
                        }
                    }
                }
                for (t, s) in plane[layout.row(j as isize)..].iter_mut().zip(&sums) {
                    if s[1] > 0.0 {
                        *t = s[0] / s[1];
                    }
                }
            }
        });
    }

    /// Velocities of all nodes from those of the cells.
    fn take_velocities(&mut self, coarse: &Lattice) {
        let cells = coarse.settings.nodes;
        let [_, ny, nz] = self.settings.nodes;
        let (layout, faces) = (self.layout, &self.settings.faces);
        for a in 0..3 {
            let from = &coarse.nodes.u[a];
            let along = |axis: usize, i: usize| Blend::new(i, cells[axis], axis, &faces[axis], a);
            self.nodes.u[a].par_chunks_exact_mut(layout.plane).enumerate().for_each(|(i, plane)| {
                let mut row = vec![0.0f32; cells[2]];
                let x = along(0, i);
                for j in 0..ny {
                    let y = along(1, j);
                    let rows: [&[f32]; 4] =
                        std::array::from_fn(|q| &from[coarse.layout.node([x.cells[q / 2], y.cells[q % 2], 0])..][..cells[2]]);
                    let w: [f32; 4] = std::array::from_fn(|q| x.weights[q / 2] * y.weights[q % 2]);
                    let add = (y.weights[0] + y.weights[1]) * x.add + y.add;
                    for (k, r) in row.iter_mut().enumerate() {
                        *r = w[0] * rows[0][k] + w[1] * rows[1][k] + (w[2] * rows[2][k] + w[3] * rows[3][k]) + add;
                    }
                    let to = &mut plane[layout.row(j as isize)..][..nz];
                    let mut put = |k: usize| {
                        let z = along(2, k);
                        to[k] = z.weights[0] * row[z.cells[0]] + z.weights[1] * row[z.cells[1]] + z.add;
                    };
                    // The first and the last node look beyond the box; an odd count ends in the middle of its cell.
                    put(0);
                    put(nz - 1);
                    if nz > 2 {
                        for (pair, w) in to[1..nz - 1].chunks_mut(2).zip(row.windows(2)) {
                            pair[0] = 0.75 * w[0] + 0.25 * w[1];
                            if let Some(second) = pair.get_mut(1) {
                                *second = 0.25 * w[0] + 0.75 * w[1];
                            }
                        }
                    }
                }
            });
        }
    }

    /// Density and velocity of a node: of its cell, and as the last step saw it.
    pub(super) fn coarse_flow(&self, coarse: &Lattice, n: [usize; 3]) -> (f64, [f64; 3]) {
        let o = self.layout.node(n);
        (coarse.flow(n.map(|v| v / 2)).0, std::array::from_fn(|a| f64::from(self.nodes.u[a][o])))
    }

    /// What [`Lattice::save`] adds for a flow on cells.
    pub(super) fn save_coarse(&self) -> Vec<f32> {
        let Some(coarse) = &self.coarse else { return Vec::new() };
        let mut out = coarse.save();
        out.push(f32::from(u8::from(self.flow_is_due)));
        for n in self.every() {
            out.extend(self.nodes.u.each_ref().map(|u| u[self.layout.node(n)]));
        }
        out
    }

    /// Continues from `Lattice::save_coarse`; false, and nothing changes, if it does not fit.
    pub(super) fn restore_coarse(&mut self, state: &[f32]) -> bool {
        let Some(coarse) = &mut self.coarse else { return state.is_empty() };
        let count: usize = self.settings.nodes.iter().product();
        let Some((flow, own)) = state.len().checked_sub(3 * count + 1).map(|l| state.split_at(l)) else { return false };
        if !coarse.restore(flow) {
            return false;
        }
        self.flow_is_due = own[0] > 0.0;
        for (n, u) in self.every().zip(own[1..].chunks_exact(3)) {
            let o = self.layout.node(n);
            for a in 0..3 {
                self.nodes.u[a][o] = u[a];
            }
        }
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::air::settings::LatticeSettings;

    fn lattice(nodes: [usize; 3], faces: [[Face; 2]; 3]) -> Lattice {
        Lattice::new(LatticeSettings { flow_ratio: 2, faces, ..LatticeSettings::new(nodes, 0.1, 0.1) })
    }

    /// A linear profile between walls, one of which moves, comes back exactly, up to the nodes next to the walls; a uniform wind
    /// through open faces too.
    #[test]
    fn velocities_come_back_from_the_cells() {
        let moving = Face { flow: FlowFace::Moving([0.08, 0.0, 0.0]), ..Face::WALL };
        for nodes in [[8, 6, 16], [8, 1, 16]] {
            let mut l = lattice(nodes, [[Face::OPEN; 2], [Face::PERIODIC; 2], [Face::WALL, moving]]);
            let u = |n: [usize; 3]| [0.08 * (n[2] as f64 + 0.5) / 16.0, 0.0, 0.0];
            l.fill(|n| (1.0, u(n), 0.0));
            let mut coarse = l.coarse.take().expect("a coarse flow");
            for c in coarse.every() {
                let o = coarse.layout.node(c);
                assert!((f64::from(coarse.nodes.u[0][o]) - 0.08 * (c[2] as f64 + 0.5) / 8.0).abs() < 1e-7);
            }
            l.take_velocities(&coarse);
            for n in l.every() {
                let got = f64::from(l.nodes.u[0][l.layout.node(n)]);
                assert!((got - u(n)[0]).abs() < 1e-7, "{n:?}: {got} {:?}", u(n));
            }
            // Odd counts leave half a cell over; buoyancy there is that of what is there.
            coarse.nodes.t.fill(9.0);
            l.nodes.t.fill(3.0);
            l.give_temperatures(&mut coarse);
            assert!(coarse.every().all(|c| coarse.nodes.t[coarse.layout.node(c)] == 3.0));
        }
        let l = lattice([7, 5, 9], [[Face::WALL; 2]; 3]);
        assert_eq!(l.coarse.as_ref().expect("a coarse flow").settings.nodes, [4, 3, 5]);
    }

    /// Decay of a shear wave: the flow on cells has the viscosity of the settings.
    #[test]
    fn the_flow_on_cells_is_as_viscous_as_asked() {
        let mut l = lattice([4, 4, 64], [[Face::PERIODIC; 2]; 3]);
        let k = std::f64::consts::TAU / 64.0;
        l.fill(|n| (1.0, [0.01 * (k * (n[2] as f64 + 0.5)).sin(), 0.0, 0.0], 0.0));
        let amplitude = |l: &Lattice| {
            let wave = |z: usize| (k * (z as f64 + 0.5)).sin();
            (0..64).map(|z| l.macroscopic([1, 1, z]).1[0] * wave(z)).sum::<f64>()
        };
        l.step();
        let start = amplitude(&l);
        for _ in 0..400 {
            l.step();
        }
        let rate = (start / amplitude(&l)).ln() / 400.0;
        assert!((rate / (0.1 * k * k) - 1.0).abs() < 0.01, "{rate} {}", 0.1 * k * k);
    }
}
