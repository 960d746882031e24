//! The touched nodes as a network of heat capacities joined by flux links (simulation.md §3.3, §3.5 without air).

use rayon::prelude::*;

use crate::material::{Material, Table};
use crate::thermal::contact::{self, Contact, Layers};
use crate::thermal::enthalpy::{EnthalpyCurve, MixtureCurve};
use crate::thermal::solids::Solids;
use crate::thermal::transfer::Lattice;
use crate::thermal::{Bath, Wall};

/// Marks a node of the grid that is not in the network.
const ABSENT: u32 = u32::MAX;

/// Nodes per parallel work item.
const CHUNK: usize = 1024;

/// Filled fraction from which a node conducts like a full one: a half-filled node lies on the surface, and all of the way to the
/// next one inside is material. A higher threshold insulates the surface by up to half a cell, depending on where it cuts the grid
/// (at 0.8 a slab of 16 cells under a film of Bi = 10 cools by 0.3 to 6 % too slowly; at 0.5 by 0.3 to 0.6 %).
const FULL: f64 = 0.5;

/// Filled fraction up to which a node lies outside. It only holds the rim of the points' kernels and hangs on the nodes inside; if it
/// conducted like them, it would carry heat along slanting surfaces past the nodes below (0.4 % of the cooling of the ball of V15).
const OUTSIDE: f64 = 0.4;

/// The same for the half cell between a node and a wall. Where a curved wall cuts the cells, nodes next to it are partly filled
/// because they lie nearer to it than half a cell or because a corner is missing; on average the ball of V15 is right with this.
const FULL_AT_WALL: f64 = 0.8;

/// Inverse distance of the rim of a body from the face of a wall, in node spacings.
const RIM: f64 = 8.0;

/// Conducting cross-section of a link whose emptier end is filled to `phi`.
#[inline(always)]
fn section(phi: f64) -> f64 {
    const RISE: f64 = (1.0 - OUTSIDE) / (FULL - OUTSIDE);
    if phi < OUTSIDE { phi } else { (OUTSIDE + (phi - OUTSIDE) * RISE).min(1.0) }
}

/// Conductivity of two halves in series.
#[inline(always)]
fn harmonic(a: f64, b: f64) -> f64 {
    2.0 * a * b / (a + b)
}

/// What the network needs to know of one material.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Medium {
    pub(crate) curve: EnthalpyCurve,
    pub(crate) density: f64,
    k_s: f64,
    k_l: f64,
    k_of_t: Table,
}

impl Medium {
    pub(crate) fn new(m: &Material, t_ref: f64) -> Self {
        Self {
            curve: EnthalpyCurve::new(m, t_ref),
            density: m.density,
            k_s: m.conductivity_solid,
            k_l: m.conductivity_liquid,
            k_of_t: m.tables.conductivity,
        }
    }

    /// Conductivity \[W/(m·K)\] at liquid fraction `f` and temperature `t` \[K\].
    #[inline(always)]
    pub(crate) fn conductivity(&self, f: f64, t: f64) -> f64 {
        match self.k_of_t.at(t) {
            Some(k) => k,
            None => self.k_s + f * (self.k_l - self.k_s),
        }
    }
}

/// What a node is made of: one material, or masses of several in [`Composition::mixed`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    One(u8),
    /// First of `used.len()` masses in `mixed`.
    Mixed(u32),
}

/// The materials present and the make-up of the mixed nodes.
#[derive(Clone, Debug, Default)]
pub(crate) struct Composition {
    /// Materials present, ascending.
    pub(crate) used: Vec<u8>,
    curves: Vec<EnthalpyCurve>,
    media: Vec<Medium>,
    mixture: MixtureCurve,
    /// Mass by used material for every mixed node.
    pub(crate) mixed: Vec<f64>,
}

impl Composition {
    /// Declares which materials are present (`present[m]`).
    pub(crate) fn reset(&mut self, media: &[Medium], present: &[bool; 256]) {
        self.mixed.clear();
        let same = self.used.len() == present.iter().filter(|p| **p).count() && self.used.iter().all(|m| present[*m as usize]);
        if same {
            return;
        }
        self.used = (0..=255u8).filter(|m| present[*m as usize]).collect();
        self.media = self.used.iter().map(|m| media[*m as usize]).collect();
        self.curves = self.media.iter().map(|m| m.curve).collect();
        self.mixture = MixtureCurve::new(&self.curves);
    }

    fn masses(&self, first: u32) -> &[f64] {
        &self.mixed[first as usize..first as usize + self.used.len()]
    }

    /// Temperature of a node.
    #[inline]
    fn temperature(&self, media: &[Medium], kind: Kind, mass: f64, energy: f64) -> f64 {
        match kind {
            Kind::One(m) => media[m as usize].curve.temperature(energy / mass),
            Kind::Mixed(i) => self.mixture.temperature(&self.curves, self.masses(i), energy).0,
        }
    }

    /// Temperature of a node that shares its energy with air of heat capacity `air` \[J/K\].
    #[inline]
    fn temperature_with(&self, media: &[Medium], kind: Kind, mass: f64, air: f64, t_ref: f64, energy: f64) -> f64 {
        if air == 0.0 {
            return self.temperature(media, kind, mass, energy);
        }
        match kind {
            Kind::One(m) => media[m as usize].curve.temperature_with(mass, air, energy),
            Kind::Mixed(_) => {
                // Monotone: the air takes some of the energy, so the answer lies between the reference and the material alone.
                let (mut a, mut b) = (t_ref, self.temperature(media, kind, mass, energy));
                for _ in 0..100 {
                    let t = 0.5 * (a + b);
                    let alone = self.temperature(media, kind, mass, energy - air * (t - t_ref));
                    if (alone > t) == (b > a) { a = t } else { b = t }
                }
                0.5 * (a + b)
            }
        }
    }

    /// Energy of a node at temperature `t`.
    pub(crate) fn energy(&self, media: &[Medium], kind: Kind, mass: f64, t: f64) -> f64 {
        match kind {
            Kind::One(m) => mass * media[m as usize].curve.enthalpy(t),
            Kind::Mixed(i) => self.curves.iter().zip(self.masses(i)).map(|(c, m)| if *m > 0.0 { m * c.enthalpy(t) } else { 0.0 }).sum(),
        }
    }

    /// Temperature, heat capacity \[J/K\] and conductivity \[W/(m·K)\] of a node, and whether it is changing phase.
    fn state(&self, media: &[Medium], kind: Kind, mass: f64, energy: f64) -> (f64, f64, f64, bool) {
        match kind {
            Kind::One(m) => {
                let medium = &media[m as usize];
                let h = energy / mass;
                let f = medium.curve.liquid_fraction(h);
                let t = medium.curve.temperature(h);
                (t, mass * medium.curve.heat_capacity(h), medium.conductivity(f, t), f > 0.0 && f < 1.0)
            }
            Kind::Mixed(i) => {
                let (t, plateau) = self.mixture.temperature(&self.curves, self.masses(i), energy);
                let (mut capacity, mut k, mut volume) = (0.0, 0.0, 0.0);
                for (medium, m) in self.media.iter().zip(self.masses(i)) {
                    let f = MixtureCurve::fraction(&medium.curve, t, plateau);
                    let v = m / medium.density;
                    capacity += m * medium.curve.heat_capacity(medium.curve.enthalpy(t));
                    k += v * medium.conductivity(f, t);
                    volume += v;
                }
                (t, capacity, k / volume, false)
            }
        }
    }
}

/// A link to a wall that gives and takes heat.
#[derive(Clone, Copy, Debug)]
struct WallLink {
    slot: u32,
    conductance: f64,
    bath: Bath,
}

/// A node inside a wall that gives and takes heat, which holds the rim of a body touching the wall. The rim lies on average an
/// eighth of a cell from the face; setting it to the wall's temperature outright would heat it, and the points that make it
/// up, by as much per step whatever the step.
#[derive(Clone, Copy, Debug)]
struct Rim {
    slot: u32,
    conductance: f64,
    bath: Bath,
}

/// The simulated air between and around the material (simulation.md §3.3, §3.6).
#[derive(Clone, Copy, Debug)]
pub(crate) struct Around {
    /// Conductivity of the air \[W/(m·K)\].
    pub(crate) k: f64,
    /// Reference temperature \[K\].
    pub(crate) t_ref: f64,
    /// Least film coefficient towards the air \[W/(m²·K)\].
    pub(crate) film: f64,
}

/// Filled fraction up to which a node counts as air: its material keeps its heat.
const THIN: f64 = 1e-4;

/// Compact arrays over the nodes that hold material, in memory order of the grid.
#[derive(Clone, Debug, Default)]
pub(crate) struct Network {
    /// Place (grid index times layers, plus layer) → slot, or [`ABSENT`].
    slot: Vec<u32>,
    nodes: [usize; 3],
    /// Layers of bodies between which heat meets a resistance; one without.
    layers: usize,
    /// Slot → place.
    places: Vec<u32>,
    /// Slot → grid index.
    pub(crate) dense: Vec<u32>,
    pub(crate) kind: Vec<Kind>,
    /// Mass \[kg\].
    pub(crate) mass: Vec<f64>,
    /// Filled fraction φ of the node (may exceed 1), and the slot's part of what fills it: one without layers.
    pub(crate) phi: Vec<f64>,
    pub(crate) part: Vec<f64>,
    /// Energy at the start of the step and now \[J\].
    pub(crate) e0: Vec<f64>,
    pub(crate) e: Vec<f64>,
    /// Temperature \[K\], heat capacity \[J/K\], conductivity \[W/(m·K)\].
    pub(crate) t: Vec<f64>,
    pub(crate) capacity: Vec<f64>,
    pub(crate) k: Vec<f64>,
    /// The node is changing phase.
    front: Vec<bool>,
    neighbours: Vec<[u32; 6]>,
    /// Conductance of each link \[W/K\].
    links: Vec<[f64; 6]>,
    walls: Vec<WallLink>,
    rims: Vec<Rim>,
    contacts: Vec<Contact>,
    /// With simulated air only: its constants; per node the heat capacity of its air \[J/K\] and its temperature over the
    /// reference at the start; conductance to a node of air \[W/K\]; conductivity of the material alone.
    pub(crate) around: Option<Around>,
    air: Vec<f64>,
    air_t: Vec<f64>,
    to_air: Vec<f64>,
    k_material: Vec<f64>,
}

impl Network {
    /// True for a node with so little material that it counts as air.
    #[inline(always)]
    pub(crate) fn is_thin(&self, slot: usize) -> bool {
        self.around.is_some() && self.phi[slot] <= THIN
    }

    /// Gives a node the air that its material leaves room for, at `t` over the reference; a full cell of air holds `cell`
    /// \[J/K\]. Returns the heat of that air.
    pub(crate) fn set_air(&mut self, slot: usize, cell: f64, t: f64) -> f64 {
        self.air.resize(self.len(), 0.0);
        self.air_t.resize(self.len(), 0.0);
        let air = if self.is_thin(slot) || !self.leads(slot) { 0.0 } else { cell * (1.0 - self.phi[slot]).max(0.0) };
        (self.air[slot], self.air_t[slot]) = (air, t);
        air * t
    }

    /// Energy of a node with its air at the start of the step \[J\].
    pub(crate) fn start_energy(&self, slot: usize) -> f64 {
        self.e0[slot] + self.air_capacity(slot) * self.air_t.get(slot).copied().unwrap_or(0.0)
    }

    /// Heat capacity of the air in a node \[J/K\].
    #[inline(always)]
    pub(crate) fn air_capacity(&self, slot: usize) -> f64 {
        self.air.get(slot).copied().unwrap_or(0.0)
    }

    /// Conductance between a node and a neighbour of air \[W/K\].
    #[inline(always)]
    pub(crate) fn to_air(&self, slot: usize) -> f64 {
        self.to_air[slot]
    }

    /// Energy of the material alone \[J\].
    #[inline(always)]
    pub(crate) fn material_energy(&self, slot: usize) -> f64 {
        match self.around {
            Some(around) => self.e[slot] - self.air_capacity(slot) * (self.t[slot] - around.t_ref),
            None => self.e[slot],
        }
    }

    /// Temperature \[K\] of the material alone at the start of the step.
    pub(crate) fn own_temperature(&self, media: &[Medium], mix: &Composition, slot: usize) -> f64 {
        match self.around {
            Some(_) => mix.temperature(media, self.kind[slot], self.mass[slot], self.e0[slot]),
            None => self.t[slot],
        }
    }

    pub(crate) fn len(&self) -> usize {
        self.dense.len()
    }

    /// Grid node of a slot.
    #[inline(always)]
    pub(crate) fn node(&self, slot: usize) -> [usize; 3] {
        let i = self.dense[slot] as usize;
        let ij = i / self.nodes[2];
        [ij / self.nodes[1], ij % self.nodes[1], i % self.nodes[2]]
    }

    #[inline(always)]
    fn index(&self, n: [usize; 3]) -> usize {
        (n[0] * self.nodes[1] + n[1]) * self.nodes[2] + n[2]
    }

    /// Place of a slot: index into arrays with a value per node and layer.
    #[inline(always)]
    pub(crate) fn place(&self, slot: usize) -> usize {
        self.places[slot] as usize
    }

    /// Layer of a slot.
    #[inline(always)]
    pub(crate) fn layer(&self, slot: usize) -> usize {
        if self.layers == 1 { 0 } else { self.places[slot] as usize % self.layers }
    }

    /// Slot of a memory index in `layer`, if that holds material there.
    #[inline(always)]
    pub(crate) fn slot_in(&self, index: usize, layer: usize) -> Option<usize> {
        match self.slot[index * self.layers + layer] {
            ABSENT => None,
            s => Some(s as usize),
        }
    }

    /// Slots of a memory index, by layer.
    #[inline(always)]
    fn slots_of(&self, index: usize) -> impl Iterator<Item = usize> {
        (0..self.layers).filter_map(move |layer| self.slot_in(index, layer))
    }

    /// Slot of a memory index that holds material: of several layers the one with the most.
    #[inline(always)]
    pub(crate) fn slot_of_index(&self, index: usize) -> Option<usize> {
        if self.layers == 1 {
            return self.slot_in(index, 0);
        }
        self.slots_of(index).reduce(|a, b| if self.part[b] > self.part[a] { b } else { a })
    }

    /// True for the slot that stands for its node where the node has to have one temperature.
    #[inline(always)]
    pub(crate) fn leads(&self, slot: usize) -> bool {
        self.layers == 1 || self.slot_of_index(self.dense[slot] as usize) == Some(slot)
    }

    /// Slots of a grid node and their parts of what fills it.
    pub(crate) fn parts(&self, node: [usize; 3]) -> impl Iterator<Item = (usize, f64)> {
        self.slots_of(self.index(node)).map(|s| (s, self.part[s]))
    }

    /// Filled fraction of a grid node.
    pub(crate) fn phi_at(&self, node: [usize; 3]) -> f64 {
        self.slots_of(self.index(node)).next().map_or(0.0, |s| self.phi[s])
    }

    /// Part of `layer` in a grid node; `None` for a node without material.
    pub(crate) fn part_at(&self, node: [usize; 3], layer: usize) -> Option<f64> {
        let index = self.index(node);
        self.slots_of(index).next()?;
        Some(self.slot_in(index, layer).map_or(0.0, |s| self.part[s]))
    }

    /// Mass of all layers in the node of a slot \[kg\].
    pub(crate) fn node_mass(&self, slot: usize) -> f64 {
        if self.layers == 1 {
            return self.mass[slot];
        }
        self.slots_of(self.dense[slot] as usize).map(|s| self.mass[s]).sum()
    }

    /// Filled fraction of a node that is the slot's own.
    #[inline(always)]
    pub(crate) fn filled(&self, slot: usize) -> f64 {
        self.phi[slot] * self.part[slot]
    }

    /// Empties the network; the grid has `nodes` nodes, each with `layers` layers.
    pub(crate) fn clear(&mut self, nodes: [usize; 3], layers: usize) {
        for &i in &self.places {
            self.slot[i as usize] = ABSENT;
        }
        self.nodes = nodes;
        self.layers = layers;
        self.slot.resize(nodes.iter().product::<usize>() * layers, ABSENT);
        self.places.clear();
        self.dense.clear();
        self.kind.clear();
        self.mass.clear();
        self.phi.clear();
        self.part.clear();
        self.e0.clear();
        self.walls.clear();
        self.rims.clear();
        self.contacts.clear();
        self.air.clear();
        self.air_t.clear();
    }

    /// Adds a layer of a node; call in ascending order of `place`. `phi` is filled by the layer alone until
    /// `Network::divide`.
    #[inline(always)]
    pub(crate) fn push(&mut self, place: usize, kind: Kind, mass: f64, phi: f64, energy: f64) {
        self.slot[place] = self.dense.len() as u32;
        self.places.push(place as u32);
        self.dense.push((place / self.layers) as u32);
        self.kind.push(kind);
        self.mass.push(mass);
        self.phi.push(phi);
        self.part.push(1.0);
        self.e0.push(energy);
    }

    /// After the last node: gives the layers of a node its filled fraction, and their parts of it.
    pub(crate) fn divide(&mut self) {
        if self.layers == 1 {
            return;
        }
        for node in self.dense.chunk_by(|a, b| a == b).scan(0, |end, node| {
            *end += node.len();
            Some(*end - node.len()..*end)
        }) {
            let total: f64 = self.phi[node.clone()].iter().sum();
            for s in node {
                (self.part[s], self.phi[s]) = (self.phi[s] / total, total);
            }
        }
    }

    /// Temperatures, capacities and conductivities from the energies, then the links.
    pub(crate) fn prepare(
        &mut self,
        media: &[Medium],
        mix: &Composition,
        lattice: &Lattice,
        spacing: f64,
        walls: Option<&[Wall]>,
        solids: &Solids,
        layers: &Layers,
    ) {
        let n = self.len();
        self.e.clear();
        self.e.extend_from_slice(&self.e0);
        if self.around.is_some() {
            self.air.resize(n, 0.0);
            self.air_t.resize(n, 0.0);
            for s in 0..n {
                self.e[s] += self.air[s] * self.air_t[s];
            }
        }
        for v in [&mut self.t, &mut self.capacity, &mut self.k] {
            v.resize(n, 0.0);
        }
        self.front.resize(n, false);
        self.neighbours.resize(n, [0; 6]);
        self.links.resize(n, [0.0; 6]);
        let Self { t, capacity, k, front, kind, mass, e0, .. } = self;
        (
            t.par_iter_mut(),
            capacity.par_iter_mut(),
            k.par_iter_mut(),
            front.par_iter_mut(),
            kind.par_iter(),
            mass.par_iter(),
            e0.par_iter(),
        )
            .into_par_iter()
            .with_min_len(CHUNK)
            .for_each(|(t, c, k, front, kind, m, e)| (*t, *c, *k, *front) = mix.state(media, *kind, *m, *e));
        self.mix_in_air(media, mix, spacing);
        let mut links = std::mem::take(&mut self.links);
        let mut neighbours = std::mem::take(&mut self.neighbours);
        links.par_iter_mut().zip(neighbours.par_iter_mut()).with_min_len(CHUNK).enumerate().for_each(|(s, (g, nb))| {
            for l in 0..6 {
                (nb[l], g[l]) = self.link(lattice, spacing, walls, s, l).unwrap_or((s as u32, 0.0));
            }
        });
        (self.links, self.neighbours) = (links, neighbours);
        if self.layers > 1 {
            let mut contacts = std::mem::take(&mut self.contacts);
            contact::collect(self, lattice, layers, spacing, &mut contacts);
            self.contacts = contacts;
        }
        if let Some(walls) = walls {
            self.join_walls(lattice, spacing, walls, solids);
        }
    }

    /// Temperature, capacity and conductivity of nodes that are shared with air (simulation.md §3.3), and their conductance to
    /// nodes of air.
    fn mix_in_air(&mut self, media: &[Medium], mix: &Composition, spacing: f64) {
        let Some(around) = self.around else { return };
        self.k_material.clear();
        self.to_air.clear();
        for s in 0..self.len() {
            let (kind, mass, air) = (self.kind[s], self.mass[s], self.air[s]);
            let t = mix.temperature_with(media, kind, mass, air, around.t_ref, self.e[s]);
            let (_, capacity, k, front) = mix.state(media, kind, mass, self.e[s] - air * (t - around.t_ref));
            let filled = self.phi[s].min(1.0);
            (self.t[s], self.front[s]) = (t, front);
            self.capacity[s] = capacity + air;
            self.k_material.push(k);
            self.k[s] = 1.0 / (filled / k + (1.0 - filled) / around.k);
            self.to_air.push((spacing * harmonic(self.k[s], around.k)).max(around.film * spacing * spacing));
        }
    }

    /// Conductivities of both halves of the way between two nodes. Between a node that changes phase and a neighbour of the same
    /// material that does not, all of the way lies in the neighbour's phase: while the front crosses the node, its distance from
    /// the neighbour grows from half a cell to one and a half. The node's own mixture would make water behind melting ice conduct
    /// like ice over a quarter of a cell.
    #[inline(always)]
    fn conductivities(&self, k: &[f64], s: usize, o: usize) -> (f64, f64) {
        match (self.front[s], self.front[o]) {
            (true, false) if self.kind[s] == self.kind[o] => (k[o], k[o]),
            (false, true) if self.kind[s] == self.kind[o] => (k[s], k[s]),
            _ => (k[s], k[o]),
        }
    }

    /// The flux link of slot `s` in direction `l` (−x, +x, −y, …): slot at the other end and conductance \[W/K\].
    #[inline(always)]
    fn link(&self, lattice: &Lattice, spacing: f64, walls: Option<&[Wall]>, s: usize, l: usize) -> Option<(u32, f64)> {
        let other = self.index(lattice.neighbour(self.node(s), l / 2, l % 2 == 1)?);
        let o = self.slot_in(other, self.layer(s))?;
        if let Some(walls) = walls
            && (walls[other].bath().is_some() || walls[self.dense[s] as usize].bath().is_some())
        {
            return None;
        }
        if self.around.is_some() {
            if self.is_thin(s) || self.is_thin(o) {
                return None;
            }
            // One temperature per node, material and air in series; but the rim of a body touches it, so it conducts at least
            // what the filled cross-section does.
            let (a, b) = self.conductivities(&self.k_material, s, o);
            let touching = section(self.phi[s].min(self.phi[o])) * harmonic(a, b);
            return Some((o as u32, spacing * self.own(s, o) * harmonic(self.k[s], self.k[o]).max(touching)));
        }
        // Harmonic mean over the filled cross-section: nodes at the rim neither insulate nor become stiff.
        let (a, b) = self.conductivities(&self.k, s, o);
        let filled = section(self.phi[s].min(self.phi[o]));
        Some((o as u32, spacing * self.own(s, o) * filled * harmonic(a, b)))
    }

    /// Share of the link between two slots of a layer that is this layer's.
    #[inline(always)]
    fn own(&self, s: usize, o: usize) -> f64 {
        if self.layers == 1 { 1.0 } else { contact::share(self.part[s], self.part[o]) }
    }

    /// Collects the nodes inside walls that give and take heat, and the links to such walls, half a cell away.
    fn join_walls(&mut self, lattice: &Lattice, spacing: f64, walls: &[Wall], solids: &Solids) {
        for s in 0..self.len() {
            if let Some(bath) = walls[self.dense[s] as usize].bath() {
                let conductance = RIM * self.k[s] * spacing * self.phi[s].min(1.0) * self.part[s];
                self.rims.push(Rim { slot: s as u32, conductance, bath });
                continue;
            }
            let node = self.node(s);
            for l in 0..6 {
                let Some(n) = lattice.neighbour(node, l / 2, l % 2 == 1) else { continue };
                if let Some(bath) = walls[self.index(n)].bath() {
                    let filled = (self.phi[s] / FULL_AT_WALL).min(1.0) * self.part[s];
                    let near = 2.0 * self.k[s] * spacing * filled;
                    let conductance = match bath {
                        Bath::Fixed(_) => near,
                        // In series with half a cell of the solid.
                        Bath::Cell(c) => {
                            let far = 2.0 * solids.k[c as usize] * spacing * filled;
                            near * far / (near + far)
                        }
                    };
                    self.walls.push(WallLink { slot: s as u32, conductance, bath });
                }
            }
        }
    }

    /// Number of equal parts of `dt` for which every node keeps `Σ G Δt ≤ C`.
    pub(crate) fn subcycles(&self, dt: f64, solids: &Solids) -> u32 {
        // Wall links of one node follow each other.
        let mut wall = 0.0f64;
        let mut total = (u32::MAX, 0.0);
        for w in &self.walls {
            let s = w.slot as usize;
            if total.0 != w.slot {
                total = (w.slot, self.links[s].iter().sum::<f64>());
            }
            total.1 += w.conductance;
            wall = wall.max(total.1 / self.capacity[s]);
        }
        if !solids.is_empty() {
            let mut outside = vec![0.0; solids.len()];
            let links = self.walls.iter().map(|w| (w.bath, w.conductance));
            for (bath, conductance) in links.chain(self.rims.iter().map(|r| (r.bath, r.conductance))) {
                if let Bath::Cell(c) = bath {
                    outside[c as usize] += conductance;
                }
            }
            wall = wall.max(solids.rate(&outside));
        }
        let rate = self
            .links
            .par_iter()
            .zip(&self.capacity)
            .with_min_len(CHUNK)
            .map(|(g, c)| g.iter().sum::<f64>() / c)
            .reduce(|| 0.0, f64::max)
            .max(wall);
        // The bound is exact; a whisker of slack keeps a ratio of one from rounding up to two.
        (rate * dt * (1.0 - 1e-9)).ceil().clamp(1.0, f64::from(u32::MAX)) as u32
    }

    /// Moves heat along all links for `dt` seconds; returns the heat \[J\] that came in from walls of fixed temperature and
    /// from conducting obstacles.
    pub(crate) fn conduct(&mut self, dt: f64, solids: &mut Solids) -> [f64; 2] {
        let Self { e, t, links, neighbours, walls, rims, contacts, capacity, .. } = self;
        let mut heat = [0.0; 2];
        let mut book = |bath: Bath, q: f64, solids: &mut Solids| match bath {
            Bath::Fixed(_) => heat[0] += q,
            Bath::Cell(c) => {
                heat[1] += q;
                solids.gain(c, -q);
            }
        };
        for w in walls.iter() {
            let behind = match w.bath {
                Bath::Fixed(t) => t,
                Bath::Cell(c) => solids.t[c as usize],
            };
            let q = w.conductance * dt * (behind - t[w.slot as usize]);
            e[w.slot as usize] += q;
            book(w.bath, q, solids);
        }
        let t = &*t;
        e.par_iter_mut().zip(links.par_iter()).zip(neighbours.par_iter()).with_min_len(CHUNK).enumerate().for_each(|(s, ((e, g), nb))| {
            let mut q = 0.0;
            for l in 0..6 {
                q += g[l] * (t[nb[l] as usize] - t[s]);
            }
            *e += dt * q;
        });
        for c in contacts.iter() {
            let q = c.heat(dt, t, capacity);
            e[c.slots[0] as usize] += q;
            e[c.slots[1] as usize] -= q;
        }
        for r in rims.iter() {
            let s = r.slot as usize;
            // Semi-implicit: stable for any step.
            let (behind, inverse) = match r.bath {
                Bath::Fixed(t) => (t, 0.0),
                Bath::Cell(c) => (solids.t[c as usize], solids.capacity[c as usize].recip()),
            };
            let g = r.conductance * dt;
            let q = g * (behind - t[s]) / (1.0 + g * (capacity[s].recip() + inverse));
            e[s] += q;
            book(r.bath, q, solids);
        }
        heat
    }

    /// Temperatures from the energies.
    pub(crate) fn update_temperatures(&mut self, media: &[Medium], mix: &Composition) {
        if let Some(around) = self.around {
            let Self { t, e, kind, mass, air, .. } = self;
            (t.par_iter_mut(), e.par_iter(), kind.par_iter(), mass.par_iter(), air.par_iter())
                .into_par_iter()
                .with_min_len(CHUNK)
                .for_each(|(t, e, kind, m, a)| *t = mix.temperature_with(media, *kind, *m, *a, around.t_ref, *e));
            return;
        }
        let Self { t, e, kind, mass, .. } = self;
        (t.par_iter_mut(), e.par_iter(), kind.par_iter(), mass.par_iter())
            .into_par_iter()
            .with_min_len(CHUNK)
            .for_each(|(t, e, kind, m)| *t = mix.temperature(media, *kind, *m, *e));
    }

    /// Energy \[J\] of a node at temperature `t`.
    pub(crate) fn energy_at(&self, media: &[Medium], mix: &Composition, slot: usize, t: f64) -> f64 {
        let air = self.around.map_or(0.0, |a| self.air_capacity(slot) * (t - a.t_ref));
        mix.energy(media, self.kind[slot], self.mass[slot], t) + air
    }
}
