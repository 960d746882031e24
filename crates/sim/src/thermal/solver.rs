//! The coupling step of the heat: scatter, sources, conduction, gather, audit.

use rayon::prelude::*;

use crate::air::room::{AirBalance, CONDUCTIVITY, Room};
use crate::air::{AirStep, Lattice};
use crate::grid::Grid;
use crate::material::Material;
use crate::source::surface::SurfaceMeasure;
use crate::source::terms::{Context, Terms};
use crate::source::{Film, HeatSource, SourceReport};
use crate::thermal::contact::Layers;
use crate::thermal::network::{Around, Composition, Kind, Medium, Network};
use crate::thermal::solids::Solids;
use crate::thermal::transfer::{CHUNK, Lattice as Stencils, Slabs, fixed_sum};
use crate::thermal::{AirModel, Audit, ThermalError, ThermalOptions, ThermalPoints, Transfer, Wall};

/// Lanes of the node accumulator.
const ENERGY: usize = 0;
const MASS: usize = 1;
const VOLUME: usize = 2;
const RELAX: usize = 3;

/// Smallest share of a stencil's weight on material nodes from which a tracer takes its temperature (§3.3).
const TRACER_COVER: f64 = 0.25;

/// Dense node fields of a body at rest on the grid, for tests and for material that does not move.
#[derive(Debug)]
pub struct NodeFields<'a> {
    /// Mass per node \[kg\]; 0 = empty.
    pub mass: &'a [f64],
    /// Material volume per node \[m³\].
    pub volume: &'a [f64],
    /// Material per node.
    pub material: &'a [u8],
    /// Energy per node \[J\].
    pub energy: &'a mut [f64],
}

/// Heat conduction in the material points of one grid.
#[derive(Debug)]
pub struct ThermalSolver {
    grid: Grid,
    options: ThermalOptions,
    media: Vec<Medium>,
    lattice: Stencils,
    slabs: Slabs,
    network: Network,
    mix: Composition,
    surface: SurfaceMeasure,
    terms: Terms,
    solids: Solids,
    layers: Layers,
    /// Per node and layer: energy, mass, volume, relaxation.
    nodes: Vec<[f64; 4]>,
    /// The same, only where needed: mass by material used, then by body named in a source.
    channels: Vec<f64>,
    stride: usize,
    bodies: Vec<u16>,
    single_body: Option<u16>,
    /// The same: what the points gather, and the temperature.
    field: Vec<[f64; 2]>,
    /// Per point: sub-grid relaxation \[J/kg\].
    relax: Vec<f64>,
    partial: Vec<f64>,
    t_ref: f64,
    /// Simulated air, from the first step on.
    room: Option<Box<Room>>,
    /// Leave the air alone: trial steps.
    pub(crate) air_held: bool,
    /// Velocity of the points \[m/s\] for the air, and per node their momentum.
    point_velocity: Vec<[f32; 3]>,
    momentum: Vec<[f32; 3]>,
}

impl ThermalSolver {
    /// A solver for `materials` on `grid`. Enthalpy is zero for solids at `t_ref` \[K\], normally the ambient temperature.
    pub fn new(grid: Grid, materials: &[Material], t_ref: f64, options: ThermalOptions) -> Self {
        Self {
            grid,
            options,
            media: materials.iter().map(|m| Medium::new(m, t_ref)).collect(),
            lattice: Stencils::new(&grid, options.periodic),
            slabs: Slabs::default(),
            network: Network::default(),
            mix: Composition::default(),
            surface: SurfaceMeasure::default(),
            terms: Terms::default(),
            solids: Solids::default(),
            layers: Layers::default(),
            nodes: vec![[0.0; 4]; grid.len()],
            channels: Vec::new(),
            stride: 0,
            bodies: Vec::new(),
            single_body: None,
            field: vec![[0.0; 2]; grid.len()],
            relax: Vec::new(),
            partial: Vec::new(),
            t_ref,
            room: None,
            air_held: false,
            point_velocity: Vec::new(),
            momentum: Vec::new(),
        }
    }

    /// Obstacles that store and conduct heat; [`Wall::Conducting`] names their cells.
    pub fn set_solids(&mut self, solids: Solids) {
        self.solids = solids;
    }

    /// The conducting obstacles with their temperatures.
    pub fn solids(&self) -> &Solids {
        &self.solids
    }

    /// As [`ThermalSolver::solids`], to continue from kept temperatures.
    pub fn solids_mut(&mut self) -> &mut Solids {
        &mut self.solids
    }

    /// Gives body `object` a resistance to heat of its side of every contact with another \[m²K/W\], ≥ 0; that of a contact is the
    /// sum of both sides. Bodies without exchange heat as one.
    pub fn set_contact_resistance(&mut self, object: u16, resistance: f64) {
        self.forget();
        self.network.clear(self.grid.nodes, 1);
        self.layers.set(object, resistance);
        self.nodes.resize(self.grid.len() * self.layers.count(), [0.0; 4]);
        self.field.resize(self.grid.len() * self.layers.count(), [0.0; 2]);
        self.stride = 0;
    }

    /// Tells the simulated air how fast the points move \[m/s\], in their order, before a step.
    pub fn set_velocities(&mut self, velocity: impl Iterator<Item = [f32; 3]>) {
        self.point_velocity.clear();
        self.point_velocity.extend(velocity);
    }

    /// True if the air is simulated, not a film or nothing.
    pub fn simulates_air(&self) -> bool {
        matches!(self.options.air, AirModel::Simulated(_))
    }

    /// The simulated air after the first step.
    pub fn air(&self) -> Option<&Lattice> {
        self.room.as_ref().map(|r| &r.lattice)
    }

    /// How the air is stepped; `None` before the first step and without simulated air.
    pub fn air_step(&self) -> Option<AirStep> {
        self.room.as_ref().map(|r| r.step)
    }

    /// State of the simulated air for a checkpoint; empty without.
    pub(crate) fn save_air(&self) -> Vec<f32> {
        self.room.as_ref().map_or_else(Vec::new, |r| r.save())
    }

    /// Continues from `ThermalSolver::save_air`; false if it does not fit. Without a state the air starts with coupling steps of `dt`
    /// seconds.
    pub(crate) fn restore_air(&mut self, state: &[f32], dt: f64) -> bool {
        self.room = None;
        let AirModel::Simulated(settings) = self.options.air else { return state.is_empty() };
        if state.is_empty() {
            return true;
        }
        let mut room = Box::new(Room::new(settings, &self.grid, dt, self.t_ref));
        let fits = room.restore(state);
        self.room = fits.then_some(room);
        fits
    }

    /// A copy of the simulated air, to return to.
    pub(crate) fn keep_air(&self) -> Option<Box<Room>> {
        self.room.clone()
    }

    /// Returns to a copy of the air.
    pub(crate) fn return_air(&mut self, kept: Option<Box<Room>>) {
        self.room = kept;
    }

    /// Temperature \[K\] of `material` at specific enthalpy `h` \[J/kg\].
    #[inline]
    pub fn temperature(&self, material: u8, h: f64) -> f64 {
        self.media[material as usize].curve.temperature(h)
    }

    /// Specific enthalpy \[J/kg\] of `material` at temperature `t` \[K\].
    #[inline]
    pub fn enthalpy(&self, material: u8, t: f64) -> f64 {
        self.media[material as usize].curve.enthalpy(t)
    }

    /// Liquid fraction of `material` at specific enthalpy `h` \[J/kg\].
    #[inline]
    pub fn liquid_fraction(&self, material: u8, h: f64) -> f64 {
        self.media[material as usize].curve.liquid_fraction(h)
    }

    /// Temperature \[K\] of the node with memory index `node` after the last step; `None` where there was no material.
    pub fn node_temperature(&self, node: usize) -> Option<f64> {
        if self.network.len() == 0 {
            return None;
        }
        self.network.slot_of_index(node).map(|s| self.network.t[s])
    }

    /// Temperature \[K\] of the material at grid coordinate `xi` after the last step, from the nodes that hold material;
    /// `None` where these carry less than a quarter of the weight.
    pub fn sample(&self, xi: [f64; 3]) -> Option<f64> {
        self.ghost(xi, |n| self.network.slot_of_index(n), |slot| self.network.t[slot])
    }

    /// What each source of the last step did, in their order; one more for the film of the air model.
    pub fn reports(&self) -> &[SourceReport] {
        &self.terms.reports
    }

    /// One coupling step of `dt` seconds that ends at `time` + `dt`: conduction, sources, exchange with walls.
    ///
    /// `walls` has one entry per grid node. Updates `h` and `grad_t` of the points; tracers (m = 0) receive the enthalpy of
    /// the material around them, or keep theirs where there is none. Nothing changes if an error is returned. The result is
    /// the same for any number of threads.
    pub fn step(
        &mut self,
        points: &mut ThermalPoints,
        dt: f64,
        time: f64,
        sources: &[HeatSource],
        walls: Option<&[Wall]>,
    ) -> Result<Audit, ThermalError> {
        let present = self.check(points, walls)?;
        self.mix.reset(&self.media, &present);
        self.forget();
        self.slabs.fill(&self.lattice, points.xi, points.mass);
        self.scatter(points);
        self.scatter_channels(points, sources);
        self.collect();
        let laps = self.place_air(points, dt, walls)?;
        self.network.prepare(&self.media, &self.mix, &self.lattice, self.grid.spacing, walls, &self.solids, &self.layers);
        if let (Some(room), Some(_)) = (&mut self.room, self.network.around) {
            room.start(&self.network);
        }

        let subcycles = self.subcycles(dt / f64::from(laps))?;
        if let Transfer::Increments { relaxation } = self.options.transfer {
            self.relax_points(points, relaxation, dt);
        }
        let before = self.point_energy(points);
        let stored = self.solids.energy();
        let wall = self.advance(dt, (laps, subcycles), time, sources, walls);
        self.gather(points);
        let after = self.point_energy(points);
        let mut air = AirBalance::default();
        if let (Some(room), Some(_)) = (&mut self.room, self.network.around) {
            air = room.finish(&self.network).ok_or(ThermalError::Air { time })?;
        }
        Ok(self.audit(before, after, wall, self.solids.energy() - stored - self.solids.power() * dt, subcycles, &air))
    }

    /// Conduction and sources for material at rest on the nodes, without points.
    pub fn step_nodes(
        &mut self,
        fields: &mut NodeFields,
        dt: f64,
        time: f64,
        sources: &[HeatSource],
        walls: Option<&[Wall]>,
    ) -> Result<Audit, ThermalError> {
        let n = self.grid.len();
        let lengths = [fields.mass.len(), fields.volume.len(), fields.material.len(), fields.energy.len()];
        if lengths.iter().any(|l| *l != n) || walls.is_some_and(|w| w.len() != n) {
            return Err(ThermalError::Input(format!("fields of {lengths:?} nodes on a grid of {n}")));
        }
        self.forget();
        self.network.around = None;
        self.network.clear(self.grid.nodes, 1);
        self.slabs.touched = self.grid.nodes.map(|n| [0, n]);
        let cell = self.grid.spacing.powi(3);
        for i in 0..n {
            if fields.mass[i] > 0.0 {
                self.network.push(i, Kind::One(fields.material[i]), fields.mass[i], fields.volume[i] / cell, fields.energy[i]);
            }
        }
        self.single_body = Some(0);
        self.network.prepare(&self.media, &self.mix, &self.lattice, self.grid.spacing, walls, &self.solids, &self.layers);
        let subcycles = self.subcycles(dt)?;
        let before = self.network.e.iter().sum();
        let stored = self.solids.energy();
        let wall = self.advance(dt, (1, subcycles), time, sources, walls);
        let after = self.network.e.iter().sum();
        for (i, e) in self.network.dense.iter().zip(&self.network.e) {
            fields.energy[*i as usize] = *e;
        }
        Ok(self.audit(before, after, wall, self.solids.energy() - stored - self.solids.power() * dt, subcycles, &AirBalance::default()))
    }

    fn check(&self, points: &ThermalPoints, walls: Option<&[Wall]>) -> Result<[bool; 256], ThermalError> {
        let n = points.xi.len();
        let lengths =
            [points.mass.len(), points.volume.len(), points.material.len(), points.object.len(), points.h.len(), points.grad_t.len()];
        if lengths.iter().any(|l| *l != n) {
            return Err(ThermalError::Input(format!("{n} positions but slices of {lengths:?}")));
        }
        if walls.is_some_and(|w| w.len() != self.grid.len()) {
            return Err(ThermalError::Input("one wall entry per grid node is needed".into()));
        }
        if (0..3).any(|a| self.grid.nodes[a] < 3) {
            return Err(ThermalError::Input("points need at least three nodes per axis".into()));
        }
        let mut present = [false; 256];
        for m in points.material {
            present[*m as usize] = true;
        }
        match (self.media.len()..256).find(|m| present[*m]) {
            Some(m) => Err(ThermalError::Input(format!("a point names material {m} of {}", self.media.len()))),
            None => Ok(present),
        }
    }

    /// Clears the accumulators of the nodes that the last step touched.
    fn forget(&mut self) {
        for slot in 0..self.network.len() {
            let i = self.network.place(slot);
            self.nodes[i] = [0.0; 4];
            if self.stride > 0 {
                self.channels[i * self.stride..(i + 1) * self.stride].fill(0.0);
            }
        }
    }

    fn scatter(&mut self, points: &ThermalPoints) {
        let Self { nodes, slabs, lattice, layers, media, grid, options, .. } = self;
        let affine = options.transfer != Transfer::PicOverwrite;
        let count = layers.count();
        slabs.scatter(lattice, nodes, count, |part, first, p| {
            let m = f64::from(points.mass[p]);
            let v = f64::from(points.volume[p]);
            let h = points.h[p];
            // Energy per unit of weight, and its slope per node spacing.
            let slope = if affine { m * media[points.material[p] as usize].curve.heat_capacity(h) * grid.spacing } else { 0.0 };
            let e = m * h;
            let g = points.grad_t[p].map(|g| slope * f64::from(g));
            lattice.stencil(points.xi[p]).in_layer(count, layers.of(points.object[p])).visit(first * count, |n, w, d| {
                let mut add = [0.0; 4];
                add[ENERGY] = e + g[0] * d[0] + g[1] * d[1] + g[2] * d[2];
                add[MASS] = m;
                add[VOLUME] = v;
                // All four lanes at once: one vector addition.
                part[n] = std::array::from_fn(|l| part[n][l] + w * add[l]);
            });
        });
    }

    /// Masses by material and by body, only in scenes that need them.
    fn scatter_channels(&mut self, points: &ThermalPoints, sources: &[HeatSource]) {
        self.bodies.clear();
        self.single_body = points.object.first().copied().filter(|o| points.object.iter().all(|p| p == o));
        if self.single_body.is_none() {
            self.bodies.extend(sources.iter().filter_map(|s| s.region.object()));
            self.bodies.sort_unstable();
            self.bodies.dedup();
        }
        let materials = if self.mix.used.len() > 1 { self.mix.used.len() } else { 0 };
        let stride = materials + self.bodies.len();
        if stride != self.stride {
            self.channels.clear();
            self.channels.resize(stride * self.nodes.len(), 0.0);
            self.stride = stride;
        }
        if stride == 0 {
            return;
        }
        let Self { channels, slabs, lattice, layers, mix, bodies, .. } = self;
        let count = layers.count();
        slabs.scatter(lattice, channels, stride * count, |part, first, p| {
            let m = f64::from(points.mass[p]);
            let material = if materials > 0 { mix.used.binary_search(&points.material[p]).ok() } else { None };
            let body = bodies.binary_search(&points.object[p]).ok();
            lattice.stencil(points.xi[p]).in_layer(count, layers.of(points.object[p])).visit(first * count, |n, w, _| {
                for c in material.into_iter().chain(body.map(|b| materials + b)) {
                    part[n * stride + c] += w * m;
                }
            });
        });
    }

    /// Fills the network from the accumulators.
    fn collect(&mut self) {
        let Self { network, slabs, grid, nodes, layers, mix, channels, stride, .. } = self;
        let layers = layers.count();
        network.clear(grid.nodes, layers);
        let cell = grid.spacing.powi(3);
        let [x, y, z] = slabs.touched;
        let count = mix.used.len();
        for i in x[0]..x[1] {
            for j in y[0]..y[1] {
                let row = grid.index(i, j, 0);
                for n in (row + z[0]) * layers..(row + z[1]) * layers {
                    let a = nodes[n];
                    if a[MASS] > 0.0 {
                        let kind = if count == 1 {
                            Kind::One(mix.used[0])
                        } else {
                            let own = &channels[n * *stride..n * *stride + count];
                            match own.iter().position(|m| *m == a[MASS]) {
                                Some(k) => Kind::One(mix.used[k]),
                                None => {
                                    mix.mixed.extend_from_slice(own);
                                    Kind::Mixed((mix.mixed.len() - count) as u32)
                                }
                            }
                        };
                        network.push(n, kind, a[MASS], a[VOLUME] / cell, a[ENERGY]);
                    }
                }
            }
        }
        network.divide();
    }

    /// Roles of the nodes of the simulated air and its share of the material's nodes; returns the lattice steps to come.
    fn place_air(&mut self, points: &ThermalPoints, dt: f64, walls: Option<&[Wall]>) -> Result<u32, ThermalError> {
        self.network.around = None;
        let AirModel::Simulated(settings) = self.options.air else { return Ok(1) };
        if self.air_held {
            return Ok(1);
        }
        self.network.around = Some(Around { k: CONDUCTIVITY, t_ref: self.t_ref, film: settings.wall_film });
        let moving = settings.convection && self.point_velocity.len() == points.xi.len();
        self.momentum.clear();
        if moving {
            self.momentum.resize(self.grid.len(), [0.0; 3]);
            let velocity = &self.point_velocity;
            let lattice = &self.lattice;
            self.slabs.scatter(lattice, &mut self.momentum, 1, |part, first, p| {
                lattice.stencil(points.xi[p]).visit(first, |n, w, _| {
                    let m = (w * f64::from(points.mass[p])) as f32;
                    part[n] = std::array::from_fn(|a| part[n][a] + m * velocity[p][a]);
                });
            });
        }
        let room = self.room.get_or_insert_with(|| Box::new(Room::new(settings, &self.grid, dt, self.t_ref)));
        room.set_interval(dt);
        let mass: Vec<f64> = (0..self.network.len()).map(|s| self.network.node_mass(s)).collect();
        let (momentum, dense) = (&self.momentum, self.network.dense.clone());
        room.take_places(&mut self.network, walls, |s| match momentum.get(dense[s] as usize) {
            Some(m) => m.map(|v| v / mass[s] as f32),
            None => [0.0; 3],
        });
        Ok(room.step.steps)
    }

    fn subcycles(&self, dt: f64) -> Result<u32, ThermalError> {
        let (needed, allowed) = (self.network.subcycles(dt, &self.solids), self.options.max_subcycles);
        if needed > allowed { Err(ThermalError::TooFast { dt, needed, allowed }) } else { Ok(needed) }
    }

    /// Sub-grid relaxation: how far each point moves towards the temperature of its nodes, and the sums of that per node.
    fn relax_points(&mut self, points: &ThermalPoints, relaxation: f64, dt: f64) {
        let Self { relax, field, network, lattice, layers, media, mix, nodes, slabs, grid, .. } = self;
        relax.clear();
        relax.resize(points.xi.len(), 0.0);
        if relaxation <= 0.0 {
            return;
        }
        for s in 0..network.len() {
            field[network.place(s)] = [0.0, network.own_temperature(media, mix, s)];
        }
        let count = layers.count();
        let rate = relaxation * dt / (grid.spacing * grid.spacing);
        relax.par_chunks_mut(CHUNK).enumerate().for_each(|(c, chunk)| {
            for (o, delta) in chunk.iter_mut().enumerate() {
                let p = c * CHUNK + o;
                if points.mass[p] > 0.0 && finite(points.xi[p]) {
                    let medium = &media[points.material[p] as usize];
                    let h = points.h[p];
                    let capacity = medium.curve.heat_capacity(h);
                    let k = medium.conductivity(medium.curve.liquid_fraction(h), medium.curve.temperature(h));
                    let zeta = -(-rate * k / (medium.density * capacity)).exp_m1();
                    let stencil = lattice.stencil(points.xi[p]).in_layer(count, layers.of(points.object[p]));
                    let around = stencil.gather(field).value[1];
                    *delta = -zeta * capacity * (medium.curve.temperature(h) - around);
                }
            }
        });
        slabs.scatter(lattice, nodes, count, |part, first, p| {
            let q = f64::from(points.mass[p]) * relax[p];
            lattice
                .stencil(points.xi[p])
                .in_layer(count, layers.of(points.object[p]))
                .visit(first * count, |n, w, _| part[n][RELAX] += w * q);
        });
    }

    /// Sources and conduction; returns the heat from walls of fixed temperature and from conducting obstacles.
    fn advance(&mut self, dt: f64, (laps, subcycles): (u32, u32), time: f64, sources: &[HeatSource], walls: Option<&[Wall]>) -> [f64; 2] {
        let film = match self.options.air {
            AirModel::Film(film) => Some(film),
            AirModel::Simulated(air) if air.emissivity > 0.0 => {
                Some(Film { ambient: self.t_ref, coefficient: 0.0, emissivity: air.emissivity })
            }
            AirModel::Simulated(_) | AirModel::None => None,
        };
        self.surface.area.clear();
        if film.is_some() || sources.iter().any(|s| s.needs_surface()) {
            let facing = sources.iter().any(|s| s.needs_facing());
            self.surface.compute(&self.lattice, &self.network, &self.slabs.touched, walls, facing);
        }
        let Self { network, media, mix, terms, surface, grid, nodes, channels, stride, bodies, single_body, solids, lattice, room, .. } =
            self;
        terms.clear();
        {
            let share = |id: u16, slot: usize| match (*single_body, bodies.binary_search(&id)) {
                (Some(only), _) => f64::from(u8::from(only == id)),
                (None, Ok(b)) => {
                    let n = network.place(slot);
                    channels[(n + 1) * *stride - bodies.len() + b] / nodes[n][MASS]
                }
                (None, Err(_)) => 0.0,
            };
            let energy_at = |slot: usize, t: f64| network.energy_at(media, mix, slot, t);
            let cx = Context { grid, network, lattice, surface, walls, share: &share, energy_at: &energy_at, time };
            for source in sources {
                terms.add(source, &cx);
            }
            if let Some(film) = film {
                terms.add_film(film, &cx);
            }
        }
        let part = dt / f64::from(laps * subcycles);
        let mut from_walls = [0.0; 2];
        for lap in 0..laps * subcycles {
            if let (Some(room), Some(_), 0) = (room.as_mut(), network.around, lap % subcycles) {
                let mut e = std::mem::take(&mut network.e);
                room.advance(network, Some(&mut e));
                network.e = e;
                network.update_temperatures(media, mix);
            }
            if !terms.is_empty() {
                terms.apply(network, part);
                network.update_temperatures(media, mix);
            }
            let [fixed, conducting] = network.conduct(part, solids);
            from_walls = [from_walls[0] + fixed, from_walls[1] + conducting];
            solids.advance(part);
            network.update_temperatures(media, mix);
        }
        from_walls
    }

    /// What a source that holds a temperature brought goes to the points in proportion to what they lack of it. In equal parts, as
    /// the other heat, points that are held already would get as much as those next to them that are not and keep the node cold,
    /// step after step, and end far hotter than the source (in examples/dropped.toml at 12 cells by more than 4 K).
    fn hold_points(&mut self, points: &ThermalPoints) {
        let Self { network, field, media, mix, terms, relax, lattice, layers, grid, .. } = self;
        let kelvin = terms.held.kelvin;
        for (s, heat) in terms.held.heat.iter_mut().enumerate() {
            let missing = network.energy_at(media, mix, s, kelvin) - network.start_energy(s);
            let share = if *heat * missing > 0.0 { (*heat / missing).min(1.0) } else { 0.0 };
            field[network.place(s)] = [0.0, share];
            *heat = share * (mix.energy(media, network.kind[s], network.mass[s], kelvin) - network.e0[s]);
        }
        relax.par_chunks_mut(CHUNK).enumerate().for_each(|(c, chunk)| {
            for (o, delta) in chunk.iter_mut().enumerate() {
                let p = c * CHUNK + o;
                if points.mass[p] > 0.0 && finite(points.xi[p]) {
                    let got = lattice.stencil(points.xi[p]).in_layer(layers.count(), layers.of(points.object[p])).gather(field);
                    let curve = &media[points.material[p] as usize].curve;
                    let h = points.h[p];
                    // The point as the nodes saw it, with its gradient.
                    let slope = curve.heat_capacity(h) * grid.spacing;
                    let aside: f64 = (0..3).map(|a| f64::from(points.grad_t[p][a]) * got.moment[a]).sum();
                    *delta += got.value[1] * (curve.enthalpy(kelvin) - h) - slope * aside;
                }
            }
        });
    }

    fn gather(&mut self, points: &mut ThermalPoints) {
        let overwrite = !matches!(self.options.transfer, Transfer::Increments { .. });
        if overwrite {
            self.terms.held.heat.clear();
        } else if !self.terms.held.heat.is_empty() {
            self.hold_points(points);
        }
        let Self { network, nodes, field, terms, .. } = self;
        for s in 0..network.len() {
            let n = network.place(s);
            let e = network.material_energy(s);
            let held = terms.held.heat.get(s).copied().unwrap_or(0.0);
            let gain = if overwrite { e } else { e - network.e0[s] - nodes[n][RELAX] - held };
            field[n] = [gain / network.mass[s], network.t[s]];
        }
        let this = &*self;
        let slope = if options_gradient(this.options.transfer) { 4.0 / this.grid.spacing } else { 0.0 };
        let (xi, mass, material) = (points.xi, points.mass, points.material);
        let layer = |p: usize| this.layers.of(points.object[p]);
        points.h.par_chunks_mut(CHUNK).zip(points.grad_t.par_chunks_mut(CHUNK)).enumerate().for_each(|(c, (h, grad))| {
            for (o, (h, grad)) in h.iter_mut().zip(grad.iter_mut()).enumerate() {
                let p = c * CHUNK + o;
                if !finite(xi[p]) {
                    continue;
                }
                if mass[p] > 0.0 {
                    let got = this.lattice.stencil(xi[p]).in_layer(this.layers.count(), layer(p)).gather(&this.field);
                    *h = if overwrite { got.value[0] } else { *h + this.relax[p] + got.value[0] };
                    *grad = got.moment.map(|m| (slope * m) as f32);
                } else {
                    this.listen(xi[p], material[p], layer(p), h);
                }
            }
        });
    }

    /// Gives a tracer the state of the material of its layer around it.
    fn listen(&self, xi: [f64; 3], material: u8, layer: usize, h: &mut f64) {
        let network = &self.network;
        // With one material the enthalpy itself is interpolated, so that tracers know how far melting has come.
        let one = self.mix.used.as_slice() == [material];
        let value = if one {
            self.ghost(xi, |n| network.slot_in(n, layer), |s| network.material_energy(s) / network.mass[s])
        } else {
            self.ghost(xi, |n| network.slot_in(n, layer), |s| network.t[s]).map(|t| self.enthalpy(material, t))
        };
        if let Some(value) = value {
            *h = value;
        }
    }

    /// Weighted mean over the material nodes of a stencil; `slot_of(node)` is what holds material.
    fn ghost(&self, xi: [f64; 3], slot_of: impl Fn(usize) -> Option<usize>, value: impl Fn(usize) -> f64) -> Option<f64> {
        if self.network.len() == 0 || !finite(xi) {
            return None;
        }
        let (mut sum, mut weight) = (0.0, 0.0);
        self.lattice.stencil(xi).visit(0, |n, w, _| {
            if let Some(s) = slot_of(n) {
                sum += w * value(s);
                weight += w;
            }
        });
        (weight >= TRACER_COVER).then(|| sum / weight)
    }

    fn point_energy(&mut self, points: &ThermalPoints) -> f64 {
        fixed_sum(points.h.len(), &mut self.partial, |p| if points.mass[p] > 0.0 { f64::from(points.mass[p]) * points.h[p] } else { 0.0 })
    }

    fn audit(&self, before: f64, after: f64, [wall, solid]: [f64; 2], stored: f64, subcycles: u32, air: &AirBalance) -> Audit {
        let [source, dirichlet, film] = self.terms.totals();
        let (before, after, wall) = (before + air.before, after + air.after, wall + air.wall);
        Audit {
            before,
            after,
            source,
            dirichlet,
            film,
            wall,
            solid,
            open: air.open,
            displaced: air.displaced,
            escaped: 0.0,
            air: air.after,
            capped: air.capped,
            residual: after - before - (source + dirichlet + film + wall + solid + air.open + air.displaced) + stored + solid,
            surface: self.surface.area.iter().sum::<f64>() * self.grid.spacing.powi(2),
            subcycles,
            skipped: self.slabs.skipped as u32,
        }
    }
}

#[inline(always)]
fn finite(x: [f64; 3]) -> bool {
    x.iter().all(|v| v.is_finite())
}

/// True for the schemes whose points carry a temperature gradient.
fn options_gradient(transfer: Transfer) -> bool {
    transfer != Transfer::PicOverwrite
}
