//! A box of air: flow and temperature populations, advanced in place (simulation.md §4).

mod coarse;
mod rescale;

use fearless_simd::{Level, dispatch};
use rayon::prelude::*;

use crate::air::boundaries::{Exchange, Links, exchange, place};
use crate::air::d3q7::HeatRates;
use crate::air::d3q19::FlowRates;
use crate::air::population::{Format, Populations, Storage, with_populations};
use crate::air::settings::{Face, FlowFace, HeatFace, LatticeSettings};
use crate::air::storage::{CHUNK, Layout, planes, reach};
use crate::air::sweep::{Context, HOLES, Plane, SOLID, SPONGE, Seen, WRITE, sweep};
use crate::air::velocity_sets::{C, Q7, Q19, W7, W19};

/// How heat passes between a node with temperature populations and one without.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum HeatNode {
    /// The node has populations.
    #[default]
    Air,
    /// None, and no heat passes.
    Adiabatic,
    /// None; its face towards the air, half a node away, holds this temperature over the reference \[K\].
    Fixed(f32),
    /// None; the caller moves the heat. The number comes back in [`ExchangeLink::other`].
    Exchange(u32),
}

/// What fills a node besides air.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct NodeState {
    /// Filled fraction, 0–1.
    pub solid: f32,
    /// Velocity of what fills it, lattice units, |v| ≤ 0.1.
    pub velocity: [f32; 3],
    /// Its part in the heat.
    pub heat: HeatNode,
}

/// One link over which the caller moves heat between an air node and a node without populations.
#[derive(Clone, Copy, Debug)]
pub struct ExchangeLink {
    /// Temperature of the air node over the reference \[K\], at the start of the step.
    pub air: f32,
    /// The number of the other node in [`HeatNode::Exchange`].
    pub other: u32,
}

/// What the last step did besides moving air. Heats in \[K · nodes\], positive into the air.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StepReport {
    /// Extremes.
    pub seen: Seen,
    /// Through walls of fixed temperature or flux.
    pub wall: f64,
    /// Through open faces and sponges.
    pub open: f64,
    /// Over exchange links.
    pub exchanged: f64,
}

/// Node arrays of a lattice, padded like the populations.
#[derive(Clone, Debug, Default)]
struct Nodes {
    t: Vec<f32>,
    u: [Vec<f32>; 3],
    solid: Vec<f32>,
    solid_velocity: [Vec<f32>; 3],
    sponge: Vec<f32>,
    memory: Vec<f32>,
    capacity: Vec<f32>,
    conductivity: Vec<f32>,
    class: Vec<u8>,
    /// Resting temperature populations in half precision, which stay in single precision; empty otherwise.
    rest: Vec<f32>,
    /// Class without what [`Lattice::set_nodes`] brought.
    base: Vec<u8>,
}

/// The lattice. Same result for any number of threads.
#[derive(Clone, Debug)]
pub struct Lattice {
    settings: LatticeSettings,
    layout: Layout,
    populations: Populations,
    nodes: Nodes,
    flow_links: Links,
    heat_links: Links,
    exchange: Vec<Exchange>,
    fixed: Vec<(Exchange, f32)>,
    adiabatic: Vec<Exchange>,
    /// Nodes that [`Lattice::set_nodes`] filled last.
    filled: Vec<u32>,
    flux: Vec<f32>,
    odd: bool,
    /// Flow on cells of 2³ nodes, if it is not here.
    coarse: Option<Box<Lattice>>,
    /// The next step of the temperature starts with one of such a flow.
    flow_is_due: bool,
    /// This is such a flow: its temperature comes from the nodes of its cells.
    warmed: bool,
    write_all: bool,
    level: Level,
}

impl Lattice {
    /// Air at rest at the reference temperature.
    pub fn new(settings: LatticeSettings) -> Self {
        let wraps = |f: &[Face; 2]| f.iter().all(|f| f.flow == FlowFace::Periodic && f.heat == HeatFace::Periodic);
        let layout = Layout::new(settings.nodes, settings.faces.each_ref().map(wraps));
        let n = layout.scalars();
        let zeros = || vec![0.0f32; n];
        let mut nodes = Nodes { memory: vec![1.0; n], t: zeros(), u: [zeros(), zeros(), zeros()], ..Nodes::default() };
        nodes.solid = zeros();
        if settings.heat && settings.storage == Storage::F16 {
            nodes.rest = vec![0.0; n];
        }
        nodes.solid_velocity = [zeros(), zeros(), zeros()];
        nodes.sponge = zeros();
        nodes.class = vec![0; settings.nodes[0] * settings.nodes[1] * layout.chunks()];
        let flow_links = if settings.flows_here() { Links::new(&layout, Q19, &settings.faces) } else { Links::default() };
        let heat_links = if settings.heat { Links::new(&layout, Q7, &settings.faces) } else { Links::default() };
        let mut lattice = Self {
            populations: Populations::new(
                settings.storage,
                if settings.flows_here() { layout.populations(Q19) } else { 0 },
                if settings.heat { layout.populations(Q7) } else { 0 },
            ),
            layout,
            nodes,
            flow_links,
            heat_links,
            exchange: Vec::new(),
            fixed: Vec::new(),
            adiabatic: Vec::new(),
            filled: Vec::new(),
            flux: Vec::new(),
            odd: false,
            coarse: None,
            flow_is_due: true,
            warmed: false,
            write_all: false,
            level: Level::new(),
            settings,
        };
        lattice.classify();
        lattice.coarsen_flow();
        lattice
    }

    /// Marks sponges and open faces.
    fn classify(&mut self) {
        let [nx, ny, nz] = self.settings.nodes;
        for i in 0..nx {
            for j in 0..ny {
                for k in 0..nz {
                    let s = self.settings.sponge([i, j, k]);
                    if s > 0.0 {
                        self.nodes.sponge[self.layout.node([i, j, k])] = s as f32;
                        self.mark([i, j, k], SPONGE);
                    }
                }
            }
        }
        let open: Vec<u32> = self.flow_links.open.iter().chain(&self.heat_links.open).map(|l| l.node).collect();
        for n in open {
            let c = self.chunk_of(n as usize);
            self.nodes.class[c] |= WRITE;
        }
        self.nodes.base = self.nodes.class.clone();
    }

    /// Chunk of an index into the node arrays.
    fn chunk_of(&self, n: usize) -> usize {
        let (i, o) = (n / self.layout.plane, n % self.layout.plane);
        let first = self.layout.row(0);
        let (j, k) = ((o - first) / self.layout.stride, (o - first) % self.layout.stride);
        (i * self.settings.nodes[1] + j) * self.layout.chunks() + k / CHUNK
    }

    fn mark(&mut self, n: [usize; 3], class: u8) {
        let c = (n[0] * self.settings.nodes[1] + n[1]) * self.layout.chunks() + n[2] / CHUNK;
        self.nodes.class[c] |= class;
    }

    /// The settings.
    pub fn settings(&self) -> &LatticeSettings {
        &self.settings
    }

    /// The instruction set in use.
    pub fn simd(&self) -> String {
        format!("{:?}", self.level).split('(').next().unwrap_or_default().to_lowercase()
    }

    /// Keep temperature and velocity of every node up to date in every step, not only where they are needed.
    pub fn keep_fields(&mut self, keep: bool) {
        self.write_all = keep || self.coarse.is_some();
    }

    /// Sets every node to the equilibrium of `state(node)` = (density, velocity, temperature over the reference).
    pub fn fill(&mut self, state: impl Fn([usize; 3]) -> (f64, [f64; 3], f64)) {
        self.odd = false;
        let [nx, ny, nz] = self.settings.nodes;
        for i in 0..nx {
            for j in 0..ny {
                for k in 0..nz {
                    let n = [i, j, k];
                    let (rho, u, t) = state(n);
                    self.set_equilibrium(n, rho, u, t);
                }
            }
        }
        self.fill_coarse(&state);
    }

    /// Equilibrium of one node. Only valid where the neighbours' departing populations do not matter: everywhere.
    fn set_equilibrium(&mut self, n: [usize; 3], rho: f64, u: [f64; 3], t: f64) {
        let here = n.map(|v| v as isize);
        if self.settings.flows_here() {
            let u2: f64 = u.iter().map(|v| v * v).sum();
            for k in 0..Q19 {
                let cu: f64 = (0..3).map(|a| f64::from(C[k][a]) * u[a]).sum();
                let f = W19[k] * (rho - 1.0 + rho * (3.0 * cu + 4.5 * cu * cu - 1.5 * u2));
                let slot = self.layout.arriving(Q19, self.odd, k, here);
                self.populations.set_flow(slot, f as f32);
            }
        }
        let i = self.layout.node(n);
        if self.settings.heat && self.nodes.memory[i] > 0.0 {
            self.set_heat(n, t, u);
        }
        self.nodes.t[i] = t as f32;
        for a in 0..3 {
            self.nodes.u[a][i] = u[a] as f32;
        }
    }

    fn set_heat(&mut self, n: [usize; 3], t: f64, u: [f64; 3]) {
        let c = self.nodes.capacity.get(self.layout.node(n)).map_or(1.0, |c| f64::from(*c));
        for k in 0..Q7 {
            let cu: f64 = (0..3).map(|a| f64::from(C[k][a]) * u[a]).sum();
            let g = if k == 0 { c * t - (1.0 - W7[0]) * t } else { W7[k] * t * (1.0 + 4.0 * c * cu) };
            self.put_heat(n, k, g as f32);
        }
        // What rounding took from the moving ones stays at rest.
        let short = c * t - self.enthalpy(n);
        if let Some(rest) = self.nodes.rest.get_mut(self.layout.node(n)) {
            *rest += short as f32;
        }
    }

    /// Capacity C̃ and conductivity K̃ per node, for lattices on which material is at rest.
    pub fn set_media(&mut self, media: impl Fn([usize; 3]) -> (f32, f32)) {
        let n = self.layout.scalars();
        self.nodes.capacity = vec![1.0; n];
        self.nodes.conductivity = vec![self.settings.diffusivity as f32; n];
        let [nx, ny, nz] = self.settings.nodes;
        for i in 0..nx {
            for j in 0..ny {
                for k in 0..nz {
                    let o = self.layout.node([i, j, k]);
                    (self.nodes.capacity[o], self.nodes.conductivity[o]) = media([i, j, k]);
                }
            }
        }
    }

    /// Replaces everything that is not plain air. `states` lists nodes in ascending order of (x, y, z). Returns the heat that
    /// the air lost to nodes that were filled, and the heat of nodes that were set free at temperature
    /// [`Lattice::temperature`] \[K · nodes\], both positive.
    pub fn set_nodes(&mut self, states: &[([usize; 3], NodeState)]) -> (f64, f64) {
        let (mut displaced, mut released) = (0.0, 0.0);
        self.nodes.class.copy_from_slice(&self.nodes.base);
        let old = std::mem::take(&mut self.filled);
        let mut was_hole = Vec::new();
        for &o in &old {
            let o = o as usize;
            self.nodes.solid[o] = 0.0;
            if self.nodes.memory[o] == 0.0 {
                self.nodes.memory[o] = 1.0;
                was_hole.push(o as u32);
            }
        }
        let lost = |o: usize| was_hole.binary_search(&(o as u32)).is_err();
        let mut filled = Vec::with_capacity(states.len());
        let mut fresh = Vec::new();
        for (n, state) in states {
            let o = self.layout.node(*n);
            filled.push(o as u32);
            self.nodes.solid[o] = state.solid.clamp(0.0, 1.0);
            for a in 0..3 {
                self.nodes.solid_velocity[a][o] = state.velocity[a];
            }
            if state.heat != HeatNode::Air {
                self.nodes.memory[o] = 0.0;
                if self.settings.heat && lost(o) {
                    fresh.push(*n);
                }
            }
            if let HeatNode::Fixed(t) = state.heat {
                self.nodes.t[o] = t;
            }
        }
        for n in fresh {
            displaced += self.enthalpy(n);
        }
        self.filled = filled;
        for (n, state) in states {
            let class = if state.solid > 0.0 { SOLID } else { 0 } | if state.heat != HeatNode::Air { HOLES } else { 0 };
            self.mark(*n, class);
        }
        // Nodes that became air start at the last temperature and velocity of what was there.
        for o in was_hole {
            let o = o as usize;
            if self.nodes.memory[o] > 0.0 {
                let n = self.coordinates(o);
                let u = std::array::from_fn(|a| f64::from(self.nodes.solid_velocity[a][o]));
                self.set_heat(n, f64::from(self.nodes.t[o]), u);
                released += f64::from(self.nodes.t[o]);
            }
        }
        self.mark_deep();
        if self.settings.heat {
            self.connect(states);
        }
        self.set_coarse_nodes(states);
        (displaced, released)
    }

    fn coordinates(&self, o: usize) -> [usize; 3] {
        let (i, r) = (o / self.layout.plane, o % self.layout.plane - self.layout.row(0));
        [i, r / self.layout.stride, r % self.layout.stride]
    }

    /// Marks nodes that are solid together with their 18 neighbours; the box walls count as solid.
    fn mark_deep(&mut self) {
        let [nx, ny, nz] = self.settings.nodes.map(|n| n as isize);
        let solid = &self.nodes.solid;
        let layout = &self.layout;
        let full = |n: [isize; 3]| {
            if n[0] < 0 || n[1] < 0 || n[2] < 0 || n[0] >= nx || n[1] >= ny || n[2] >= nz {
                return true;
            }
            solid[layout.node(n.map(|v| v as usize))] > 0.999
        };
        let deep: Vec<u32> = self
            .filled
            .par_iter()
            .copied()
            .with_min_len(1024)
            .filter(|&o| {
                solid[o as usize] > 0.999 && {
                    let n = self.coordinates(o as usize).map(|v| v as isize);
                    (1..Q19).all(|k| full(std::array::from_fn(|a| n[a] + C[k][a] as isize)))
                }
            })
            .collect();
        for o in deep {
            self.nodes.solid[o as usize] = 2.0;
        }
    }

    /// Rebuilds the links between nodes with and without temperature populations.
    fn connect(&mut self, states: &[([usize; 3], NodeState)]) {
        self.exchange.clear();
        self.fixed.clear();
        self.adiabatic.clear();
        let size = self.settings.nodes;
        for (n, state) in states {
            if state.heat == HeatNode::Air {
                continue;
            }
            for k in 1..Q7 {
                // The neighbour into which populations along k would come from here.
                let x: [isize; 3] = std::array::from_fn(|a| n[a] as isize + C[k][a] as isize);
                if (0..3).any(|a| x[a] < 0 || x[a] >= size[a] as isize) {
                    continue;
                }
                let x = x.map(|v| v as usize);
                if self.nodes.memory[self.layout.node(x)] == 0.0 {
                    continue;
                }
                match state.heat {
                    HeatNode::Exchange(id) => {
                        self.exchange.push(exchange(&self.layout, x, k, id));
                        self.mark(x, WRITE);
                    }
                    HeatNode::Fixed(t) => self.fixed.push((exchange(&self.layout, x, k, 0), t)),
                    _ => self.adiabatic.push(exchange(&self.layout, x, k, 0)),
                }
            }
        }
    }

    /// One step without exchange links.
    pub fn step(&mut self) -> StepReport {
        self.step_with(|_, flux| flux.fill(0.0))
    }

    /// One step. `exchange` receives all exchange links, in a fixed order, and returns the heat that each brings into the
    /// air \[K\].
    pub fn step_with(&mut self, exchange: impl FnOnce(&mut dyn Iterator<Item = ExchangeLink>, &mut [f32])) -> StepReport {
        let flow = self.step_coarse();
        let seen = self.collide_and_stream().merge(flow);
        let odd = !self.odd;
        let mut report = StepReport { seen, wall: 0.0, open: seen.sponge, exchanged: 0.0 };
        if !self.exchange.is_empty() {
            self.flux.resize(self.exchange.len(), 0.0);
            let mut links = self.exchange.iter().map(|l| ExchangeLink { air: self.nodes.t[l.air as usize], other: l.other });
            exchange(&mut links, &mut self.flux);
        }
        let p = usize::from(odd);
        with_populations!(&mut self.populations, |f, g| {
            let (flow_links, heat_links, u) = (&self.flow_links, &self.heat_links, &self.nodes.u);
            let ((), (wall, open)) = rayon::join(
                || {
                    flow_links.close(odd, f);
                    flow_links.open_flow(odd, f, u);
                },
                || (heat_links.close(odd, g), heat_links.open_heat(odd, g, u)),
            );
            report.wall = wall;
            report.open += open;
            for l in &self.adiabatic {
                g[l.to[p] as usize] = g[l.from[p] as usize];
            }
            for (l, t) in &self.fixed {
                let old = g[l.from[p] as usize].get();
                report.wall += place(g, l.to[p], -old + 2.0 * W7[1] as f32 * t, old);
            }
            for (l, q) in self.exchange.iter().zip(&self.flux) {
                let old = g[l.from[p] as usize].get();
                let placed = place(g, l.to[p], old + q, old);
                if let Some(rest) = self.nodes.rest.get_mut(l.air as usize) {
                    *rest += (f64::from(*q) - placed) as f32;
                }
                report.exchanged += f64::from(*q);
            }
        });
        self.odd = odd;
        report
    }

    fn collide_and_stream(&mut self) -> Seen {
        let s = &self.settings;
        let lattice = |v: [f64; 3]| v.map(|x| x as f32);
        let cx = Context {
            layout: &self.layout,
            flow: FlowRates::new(s),
            heat: HeatRates::new(s),
            force: lattice(s.force),
            buoyancy: lattice(s.buoyancy),
            limit: s.buoyancy_limit as f32,
            wind: lattice(s.wind),
            carried: self.coarse.is_some(),
            warmed: self.warmed,
            sign: if self.odd { -1.0 } else { 1.0 },
            reach: std::array::from_fn(|q| reach(&self.layout, self.odd, q)),
            write_all: self.write_all,
        };
        let (nodes, layout, odd, level) = (&mut self.nodes, &self.layout, self.odd, self.level);
        with_populations!(&mut self.populations, |f, g| sweep_planes(s, layout, odd, level, &cx, nodes, f, g))
    }

    /// The population that arrives at a node along `k` in the next step, flow.
    fn flow_population(&self, n: [usize; 3], k: usize) -> f64 {
        f64::from(self.populations.flow(self.layout.arriving(Q19, self.odd, k, n.map(|v| v as isize))))
    }

    /// The population that arrives at a node along `k` in the next step, temperature.
    fn heat_population(&self, n: [usize; 3], k: usize) -> f64 {
        f64::from(self.stored_heat(n, k))
    }

    fn stored_heat(&self, n: [usize; 3], k: usize) -> f32 {
        match self.nodes.rest.get(self.layout.node(n)) {
            Some(rest) if k == 0 => *rest,
            _ => self.populations.heat(self.layout.arriving(Q7, self.odd, k, n.map(|v| v as isize))),
        }
    }

    fn put_heat(&mut self, n: [usize; 3], k: usize, value: f32) {
        match self.nodes.rest.get_mut(self.layout.node(n)) {
            Some(rest) if k == 0 => *rest = value,
            _ => self.populations.set_heat(self.layout.arriving(Q7, self.odd, k, n.map(|v| v as isize)), value),
        }
    }

    /// Density and velocity of a node, without the correction for half of the next force.
    pub fn flow(&self, n: [usize; 3]) -> (f64, [f64; 3]) {
        if !self.settings.flow {
            return (1.0, self.settings.wind);
        }
        if let Some(coarse) = &self.coarse {
            return self.coarse_flow(coarse, n);
        }
        let (mut rho, mut m) = (1.0, [0.0; 3]);
        for k in 0..Q19 {
            let f = self.flow_population(n, k);
            rho += f;
            for a in 0..3 {
                m[a] += f64::from(C[k][a]) * f;
            }
        }
        (rho, m.map(|v| v / rho))
    }

    /// Density and force-corrected velocity of a node of plain air (simulation.md §4.2).
    pub fn macroscopic(&self, n: [usize; 3]) -> (f64, [f64; 3]) {
        let (rho, u) = self.flow(n);
        if self.coarse.is_some() {
            return (rho, u);
        }
        let t = if self.settings.heat || self.warmed { self.temperature(n) } else { 0.0 };
        let t = t.clamp(-self.settings.buoyancy_limit, self.settings.buoyancy_limit);
        (rho, std::array::from_fn(|a| u[a] + 0.5 * (self.settings.force[a] + self.settings.buoyancy[a] * t) / rho))
    }

    /// Σ g of a node \[K\]: its heat.
    pub fn enthalpy(&self, n: [usize; 3]) -> f64 {
        (0..Q7).map(|k| self.heat_population(n, k)).sum()
    }

    /// Temperature of a node over the reference \[K\]; of nodes without populations what they were given last.
    pub fn temperature(&self, n: [usize; 3]) -> f64 {
        let o = self.layout.node(n);
        if !self.settings.heat || self.nodes.memory[o] == 0.0 {
            return f64::from(self.nodes.t[o]);
        }
        let c = self.nodes.capacity.get(o).map_or(1.0, |c| f64::from(*c));
        (self.enthalpy(n) + 0.5 * self.settings.source) / c
    }

    /// Tells the temperature over the reference \[K\] of a node without populations; it becomes that of the air left behind.
    pub fn set_temperature(&mut self, n: [usize; 3], t: f32) {
        let o = self.layout.node(n);
        self.nodes.t[o] = t;
    }

    /// Adds `change` \[K\] to the temperature of an air node (simulation.md §3.5), keeping its flux.
    pub fn warm(&mut self, n: [usize; 3], change: f32) {
        for k in 0..Q7 {
            let old = self.stored_heat(n, k);
            self.put_heat(n, k, old + W7[k] as f32 * change);
        }
    }

    /// Σ g over all nodes with populations \[K · nodes\].
    pub fn total_enthalpy(&self) -> f64 {
        let [nx, ny, nz] = self.settings.nodes;
        let rows: Vec<f64> = (0..nx)
            .into_par_iter()
            .map(|i| {
                let mut sum = 0.0;
                for j in 0..ny {
                    let memory = &self.nodes.memory[self.layout.node([i, j, 0])..][..nz];
                    let resting = self.nodes.rest.get(self.layout.node([i, j, 0])..).map_or(&[][..], |r| &r[..nz.min(r.len())]);
                    sum += resting.iter().zip(memory).map(|(g, m)| f64::from(g * m)).sum::<f64>();
                    for k in usize::from(!resting.is_empty())..Q7 {
                        let first = self.layout.arriving(Q7, self.odd, k, [i as isize, j as isize, 0]);
                        sum += with_populations!(&self.populations, |_f, g| {
                            g[first..][..nz].iter().zip(memory).map(|(g, m)| f64::from(g.get() * m)).sum::<f64>()
                        });
                    }
                }
                sum
            })
            .collect();
        rows.iter().sum()
    }

    /// Everything that the next step depends on, besides settings and media: per node the arriving populations, temperature,
    /// role and velocity of what fills it. The same whether the next step is an odd or an even one.
    pub fn save(&self) -> Vec<f32> {
        let [nx, ny, nz] = self.settings.nodes;
        let mut out = Vec::with_capacity(nx * ny * nz * (Q19 + Q7 + 6));
        for n in self.every() {
            let here = n.map(|v| v as isize);
            if self.settings.flows_here() {
                out.extend((0..Q19).map(|k| self.populations.flow(self.layout.arriving(Q19, self.odd, k, here))));
            }
            if self.settings.heat {
                out.extend((0..Q7).map(|k| self.stored_heat(n, k)));
            }
            let o = self.layout.node(n);
            let v = &self.nodes.solid_velocity;
            out.extend([self.nodes.t[o], self.nodes.memory[o], v[0][o], v[1][o], v[2][o], self.nodes.solid[o]]);
        }
        out.extend(self.save_coarse());
        out
    }

    /// Continues from [`Lattice::save`]; call [`Lattice::set_nodes`] before the next step. False, and nothing changes, if the
    /// state belongs to another lattice.
    pub fn restore(&mut self, state: &[f32]) -> bool {
        let (flow, heat) = (if self.settings.flows_here() { Q19 } else { 0 }, if self.settings.heat { Q7 } else { 0 });
        let record = flow + heat + 6;
        let nodes: Vec<[usize; 3]> = self.every().collect();
        let Some((state, coarse)) = state.split_at_checked(nodes.len() * record) else { return false };
        if !self.restore_coarse(coarse) {
            return false;
        }
        self.odd = false;
        self.filled.clear();
        for (n, r) in nodes.into_iter().zip(state.chunks_exact(record)) {
            let here = n.map(|v| v as isize);
            for k in 0..flow {
                let slot = self.layout.arriving(Q19, false, k, here);
                self.populations.set_flow(slot, r[k]);
            }
            for k in 0..heat {
                self.put_heat(n, k, r[flow + k]);
            }
            let o = self.layout.node(n);
            let r = &r[flow + heat..];
            (self.nodes.t[o], self.nodes.memory[o], self.nodes.solid[o]) = (r[0], r[1], r[5]);
            for a in 0..3 {
                self.nodes.solid_velocity[a][o] = r[2 + a];
            }
            if r[5] > 0.0 || r[1] == 0.0 {
                self.filled.push(o as u32);
            }
        }
        true
    }

    pub(crate) fn every(&self) -> impl Iterator<Item = [usize; 3]> + use<> {
        let [nx, ny, nz] = self.settings.nodes;
        (0..nx).flat_map(move |i| (0..ny).flat_map(move |j| (0..nz).map(move |k| [i, j, k])))
    }
}

/// One step of all planes.
fn sweep_planes<F: Format, G: Format>(
    s: &LatticeSettings,
    layout: &Layout,
    odd: bool,
    level: Level,
    cx: &Context,
    nodes: &mut Nodes,
    f: &mut [F],
    g: &mut [G],
) -> Seen {
    let nx = s.nodes[0];
    let plane = layout.plane;
    let class = s.nodes[1] * layout.chunks();
    let f = if s.flows_here() {
        planes::<F, Q19>(layout, odd, f)
    } else {
        (0..nx).map(|_| std::array::from_fn(|_| Default::default())).collect()
    };
    let g = if s.heat { planes::<G, Q7>(layout, odd, g) } else { (0..nx).map(|_| std::array::from_fn(|_| Default::default())).collect() };
    let [ux, uy, uz] = &mut nodes.u;
    let velocity = ux.chunks_exact_mut(plane).zip(uy.chunks_exact_mut(plane)).zip(uz.chunks_exact_mut(plane));
    let part = |v: &[f32], i: usize| -> std::ops::Range<usize> { if v.is_empty() { 0..0 } else { i * plane..(i + 1) * plane } };
    let mut rest = nodes.rest.chunks_exact_mut(plane);
    let mut tasks: Vec<Plane<F, G>> = Vec::with_capacity(nx);
    for (i, (((f, g), t), ((ux, uy), uz))) in f.into_iter().zip(g).zip(nodes.t.chunks_exact_mut(plane)).zip(velocity).enumerate() {
        tasks.push(Plane {
            f,
            g,
            t,
            u: [ux, uy, uz],
            solid: &nodes.solid[part(&nodes.solid, i)],
            solid_velocity: nodes.solid_velocity.each_ref().map(|v| &v[part(v, i)]),
            sponge: &nodes.sponge[part(&nodes.sponge, i)],
            memory: &nodes.memory[part(&nodes.memory, i)],
            capacity: &nodes.capacity[part(&nodes.capacity, i)],
            conductivity: &nodes.conductivity[part(&nodes.conductivity, i)],
            rest: rest.next().unwrap_or_default(),
            class: &nodes.class[i * class..(i + 1) * class],
        });
    }
    let seen: Vec<Seen> = tasks
        .par_iter_mut()
        .map(|p| match (s.flows_here(), s.heat) {
            (true, true) => dispatch!(level, v => sweep::<_, F, G, true, true>(v, cx, p)),
            (true, false) => dispatch!(level, v => sweep::<_, F, G, true, false>(v, cx, p)),
            (false, _) => dispatch!(level, v => sweep::<_, F, G, false, true>(v, cx, p)),
        })
        .collect();
    seen.into_iter().fold(Seen::NOTHING, Seen::merge)
}
