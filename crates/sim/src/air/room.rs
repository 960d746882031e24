//! The air around the material, in SI: roles of the nodes, exchange with the network of material nodes, audit
//! (simulation.md §3.5–§3.7, §4.8, §4.9).

use serde::{Deserialize, Serialize};

use crate::air::lattice::{HeatNode, Lattice, NodeState};
use crate::air::population::Storage;
use crate::air::settings::{Face, LAMBDA_STILL, LatticeSettings};
use crate::grid::Grid;
use crate::thermal::Wall;
use crate::thermal::network::Network;

/// Kinematic viscosity \[m²/s\], conductivity \[W/(m·K)\] and volumetric heat capacity \[J/(m³·K)\] of room air.
const VISCOSITY: f64 = 1.5e-5;
pub(crate) const CONDUCTIVITY: f64 = 0.026;
pub(crate) const HEAT_CAPACITY: f64 = 1.2e3;

/// Largest speed that the time step allows the air, in nodes per step (simulation.md §4.8).
const TARGET_SPEED: f64 = 0.08;
/// Steps become longer when the air would then still be slower than this part of [`TARGET_SPEED`].
const CALM: f64 = 0.7;
/// Largest lattice conductivity before the step is divided.
const LARGEST_CONDUCTIVITY: f64 = 0.5;
/// Smallest lattice viscosity; thinner air is thickened and says so.
const LEAST_VISCOSITY: f64 = 1.0 / 600.0;
/// Smallest lattice conductivity.
const LEAST_CONDUCTIVITY: f64 = 0.002;
/// Smagorinsky constant, and the relaxation time below which the model is on.
const SMAGORINSKY: f64 = 0.1;
const THIN: f64 = 0.53;
/// Layers of sponge inside open faces.
const SPONGE: usize = 6;
/// Largest speed of material on the lattice, in nodes per step; it is not faster than air could rise either.
const LARGEST_SOLID_SPEED: f32 = 0.1;
/// Density outside of which the air has failed.
const DENSITY: [f32; 2] = [0.5, 1.5];

/// Air that is simulated (simulation.md §3.6 `still`, `lbm`).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SimulatedAir {
    /// The air flows; otherwise it only conducts.
    pub convection: bool,
    /// Least film coefficient between material and air \[W/(m²·K)\], for boundary layers thinner than a cell; 0 leaves the
    /// lattice to itself.
    pub wall_film: f64,
    /// Emissivity of the surfaces towards surroundings at the ambient temperature, 0–1; 0 switches radiation off.
    pub emissivity: f64,
    /// Expected difference between the hottest or coldest thing and the air \[K\], > 0: sets the time step of the initial plume.
    pub temperature_difference: f64,
    /// Gravity \[m/s²\], along −z.
    pub gravity: f64,
    /// Lattice steps before time starts, with the material held, so that a plume has formed.
    pub plume_steps: u32,
    /// Closed box with walls at ambient temperature instead of an open one.
    pub closed: bool,
    /// Number format of the stored populations.
    pub storage: Storage,
    /// Spacing of the flow in nodes of the temperature, 1 or 2.
    pub flow_ratio: usize,
}

impl Default for SimulatedAir {
    fn default() -> Self {
        Self {
            convection: true,
            wall_film: 0.0,
            emissivity: 0.0,
            temperature_difference: 40.0,
            gravity: 9.81,
            plume_steps: 0,
            closed: false,
            storage: Storage::F32,
            flow_ratio: 1,
        }
    }
}

/// Chosen step and what it did to the air.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AirStep {
    /// Lattice steps per coupling step.
    pub steps: u32,
    /// Viscosity over that of real air, ≥ 1; conductivity of pure air grows alike, with a coarse flow half as much.
    pub thickened: f64,
}

impl SimulatedAir {
    /// Speed that rising air could reach in the box \[m/s\]; 0 without convection.
    fn rise(&self, grid: &Grid, ambient: f64) -> f64 {
        let height = grid.nodes[2] as f64 * grid.spacing;
        if self.convection { (self.gravity * self.temperature_difference / ambient * height).sqrt() } else { 0.0 }
    }

    /// Lattice steps per coupling step of `dt` seconds for air of this speed \[m/s\] (simulation.md §4.8).
    fn steps(grid_spacing: f64, dt: f64, speed: f64) -> u32 {
        let alpha = CONDUCTIVITY / HEAT_CAPACITY;
        let conducting = alpha * dt / (LARGEST_CONDUCTIVITY * grid_spacing * grid_spacing);
        (speed * dt / (TARGET_SPEED * grid_spacing)).max(conducting).ceil().clamp(1.0, 1e6) as u32
    }

    /// Lattice settings for coupling steps of `dt` seconds, divided into `steps`.
    fn lattice(&self, nodes: [usize; 3], dx: f64, dt: f64, steps: u32, ambient: f64) -> (LatticeSettings, AirStep) {
        let alpha = CONDUCTIVITY / HEAT_CAPACITY;
        let step = dt / f64::from(steps);
        let unit = step / (dx * dx);
        let thickened = |least: f64| if self.convection { (least / (VISCOSITY * unit)).max(1.0) } else { 1.0 };
        // A coarse flow has fewer nodes per thickness of a boundary layer than its temperature, which need not follow it.
        let conducting = thickened(LEAST_VISCOSITY);
        let thickened = thickened(LEAST_VISCOSITY * self.flow_ratio as f64);
        let viscosity = VISCOSITY * unit * thickened;
        let mut s = LatticeSettings::new(nodes, viscosity, (alpha * unit * conducting).max(LEAST_CONDUCTIVITY));
        s.flow = self.convection;
        s.storage = self.storage;
        s.flow_ratio = self.flow_ratio;
        if !s.flow {
            s.lambda_heat = Some(LAMBDA_STILL);
        }
        s.smagorinsky = if 3.0 * viscosity / self.flow_ratio as f64 + 0.5 < THIN { SMAGORINSKY } else { 0.0 };
        let beta = 1.0 / ambient;
        s.buoyancy = [0.0, 0.0, self.gravity * beta * step * step / dx];
        s.buoyancy_limit = 0.5 / beta;
        let side = if self.closed { Face::fixed(0.0) } else { Face::OPEN };
        s.faces = [[side; 2], [side; 2], [Face::WALL, side]];
        s.sponge_layers = if self.closed { 0 } else { SPONGE };
        (s, AirStep { steps, thickened })
    }
}

/// Energy balance of the air over one coupling step \[J\], positive into the air.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct AirBalance {
    pub(crate) before: f64,
    pub(crate) after: f64,
    pub(crate) wall: f64,
    pub(crate) open: f64,
    pub(crate) displaced: f64,
    pub(crate) capped: u32,
}

/// The lattice and its place among the material.
#[derive(Clone, Debug)]
pub(crate) struct Room {
    settings: SimulatedAir,
    pub(crate) lattice: Lattice,
    pub(crate) step: AirStep,
    /// Coupling step that the lattice is made for \[s\].
    dt: f64,
    ambient: f64,
    spacing: f64,
    /// Heat capacity of a node of air \[J/K\].
    cell: f64,
    /// Heat of the air in partly filled nodes \[J\], and of all air, at the end of the last step.
    share: f64,
    started: bool,
    states: Vec<([usize; 3], NodeState)>,
    balance: AirBalance,
    /// Speed that rising air could reach \[m/s\], and the largest of the last coupling step.
    rise: f64,
    speed: f64,
}

impl Room {
    /// Air at rest at the ambient temperature, for coupling steps of `dt` seconds.
    pub(crate) fn new(settings: SimulatedAir, grid: &Grid, dt: f64, ambient: f64) -> Self {
        let rise = settings.rise(grid, ambient);
        // An initial plume is there before its speed is known.
        let steps = SimulatedAir::steps(grid.spacing, dt, if settings.plume_steps > 0 { rise } else { 0.0 });
        let (lattice, step) = settings.lattice(grid.nodes, grid.spacing, dt, steps, ambient);
        Self {
            settings,
            lattice: Lattice::new(lattice),
            step,
            dt,
            ambient,
            spacing: grid.spacing,
            cell: HEAT_CAPACITY * grid.spacing.powi(3),
            share: 0.0,
            started: false,
            states: Vec::new(),
            balance: AirBalance::default(),
            rise,
            speed: 0.0,
        }
    }

    /// Lengthens or shortens the lattice step to what the air's speed asks for: the rise of air in the whole box is an upper bound
    /// that real plumes stay far below (a melting torus of 0.2 m, 60 K warmer than its air: a quarter of it). `material` is the
    /// speed \[m/s\] of what moves in the air; what is faster than air could rise is slowed down for the lattice instead.
    fn adapt(&mut self, material: f64) {
        if !self.settings.convection || !self.started && self.settings.plume_steps > 0 {
            return;
        }
        let speed = self.speed.max(material.min(self.rise));
        let [least, calm] = [1.0, CALM].map(|part| SimulatedAir::steps(self.spacing, self.dt, speed / part));
        let steps = self.step.steps.clamp(least, calm);
        if steps != self.step.steps {
            self.change_steps(self.dt, steps);
        }
    }

    /// Divides coupling steps of `dt` seconds into `steps` from now on.
    fn change_steps(&mut self, dt: f64, steps: u32) {
        let (lattice, step) = self.settings.lattice(self.lattice.settings().nodes, self.spacing, dt, steps, self.ambient);
        self.lattice.change_step(lattice, dt / self.dt * f64::from(self.step.steps) / f64::from(steps));
        (self.dt, self.step) = (dt, step);
    }

    /// Makes the lattice fit coupling steps of `dt` seconds.
    pub(crate) fn set_interval(&mut self, dt: f64) {
        if (dt / self.dt - 1.0).abs() >= 1e-9 {
            self.change_steps(dt, SimulatedAir::steps(self.spacing, dt, self.speed));
        }
    }

    /// Gives every node its role for this coupling step and the network its share of the air. `velocity(slot)` in m/s.
    pub(crate) fn take_places(&mut self, network: &mut Network, walls: Option<&[Wall]>, velocity: impl Fn(usize) -> [f32; 3]) {
        let fastest =
            (0..network.len()).filter(|s| !network.is_thin(*s)).map(|s| velocity(s).iter().map(|v| v * v).sum::<f32>()).fold(0.0, f32::max);
        self.adapt(f64::from(fastest.sqrt()));
        self.speed = 0.0;
        let per_step = (self.dt / f64::from(self.step.steps) / self.spacing) as f32;
        let limit = LARGEST_SOLID_SPEED.min(self.rise as f32 * per_step);
        let mut states = std::mem::take(&mut self.states);
        states.clear();
        let solid_wall = |i: usize| walls.map_or(Wall::Open, |w| w[i]);
        let total: usize = self.lattice.settings().nodes.iter().product();
        let [_, ny, nz] = self.lattice.settings().nodes;
        for i in 0..total {
            let mine = network.slot_of_index(i);
            let wall = solid_wall(i);
            let node = [i / nz / ny, i / nz % ny, i % nz];
            let state = match (wall, mine) {
                (Wall::Open, Some(s)) if !network.is_thin(s) => {
                    let v = velocity(s).map(|v| v * per_step);
                    let size = v.iter().map(|x| x * x).sum::<f32>().sqrt();
                    let keep = if size > limit { limit / size } else { 1.0 };
                    NodeState { solid: network.phi[s].min(1.0) as f32, velocity: v.map(|x| x * keep), heat: HeatNode::Exchange(s as u32) }
                }
                (Wall::Open, _) => continue,
                _ => NodeState {
                    solid: 1.0,
                    velocity: [0.0; 3],
                    // Conducting obstacles exchange heat with material only; towards the air they are insulated.
                    heat: match wall {
                        Wall::Fixed(t) => HeatNode::Fixed((f64::from(t) - self.ambient) as f32),
                        _ => HeatNode::Adiabatic,
                    },
                },
            };
            states.push((node, state));
        }
        // The air in partly filled nodes keeps the temperature that the node had.
        let mut share = 0.0;
        for s in 0..network.len() {
            let here = self.lattice.temperature(network.node(s));
            share += network.set_air(s, self.cell, here);
        }
        let (lost, released) = self.lattice.set_nodes(&states);
        let displaced = share - self.share + self.cell * (released - lost);
        self.share = share;
        self.balance = AirBalance { before: self.energy() + share - displaced, displaced, ..AirBalance::default() };
        self.states = states;
    }

    /// Heat in the populations \[J\].
    fn energy(&self) -> f64 {
        self.cell * self.lattice.total_enthalpy()
    }

    /// Lets a plume form before the first step, with the material held at its temperature.
    pub(crate) fn start(&mut self, network: &Network) {
        if std::mem::replace(&mut self.started, true) {
            return;
        }
        for _ in 0..self.settings.plume_steps {
            self.advance(network, None);
        }
        self.balance = AirBalance { before: self.energy() + self.share, ..AirBalance::default() };
    }

    /// One lattice step; moves heat between `energy` (per slot, if given) and the air.
    pub(crate) fn advance(&mut self, network: &Network, mut energy: Option<&mut [f64]>) {
        let dt = self.dt / f64::from(self.step.steps);
        let (cell, ambient) = (self.cell, self.ambient);
        let report = self.lattice.step_with(|links, flux| {
            for (q, link) in flux.iter_mut().zip(links) {
                let s = link.other as usize;
                let g = network.to_air(s) * dt;
                // Semi-implicit in the node: stable however little material it holds.
                let kelvin = g * (network.t[s] - ambient - f64::from(link.air)) / (1.0 + g / network.capacity[s]) / cell;
                *q = kelvin as f32;
                if let Some(energy) = energy.as_deref_mut() {
                    energy[s] -= f64::from(*q) * cell;
                }
            }
        });
        self.balance.wall += cell * report.wall;
        self.balance.open += cell * report.open;
        self.balance.capped += report.seen.capped;
        self.speed = self.speed.max(f64::from(report.seen.speed2.sqrt()) * self.spacing / dt);
        let [low, high] = report.seen.density;
        if self.settings.convection && !(low > DENSITY[0] && high < DENSITY[1]) {
            self.balance.capped = u32::MAX;
        }
    }

    /// Closes the step: the nodes' temperatures become those of the air in them. `None` if the air has failed.
    pub(crate) fn finish(&mut self, network: &Network) -> Option<AirBalance> {
        let mut share = 0.0;
        for s in 0..network.len() {
            let t = (network.t[s] - self.ambient) as f32;
            if !network.is_thin(s) && network.leads(s) {
                self.lattice.set_temperature(network.node(s), t);
                share += network.air_capacity(s) * f64::from(t);
            }
        }
        self.share = share;
        self.balance.after = self.energy() + share;
        (self.balance.capped != u32::MAX && self.balance.after.is_finite()).then_some(self.balance)
    }

    /// Everything that the next step depends on.
    pub(crate) fn save(&self) -> Vec<f32> {
        let mut out = self.lattice.save();
        // An f64 as two f32 that add up to it would lose bits; keep the bits themselves.
        let bits = self.share.to_bits();
        let (speed, dt, steps) = (self.speed.to_bits(), self.dt.to_bits(), self.step.steps);
        let tail = [bits >> 32, bits, speed >> 32, speed, dt >> 32, dt, u64::from(steps), u64::from(self.started)];
        out.extend(tail.map(|b| f32::from_bits(b as u32)));
        out
    }

    /// Continues from [`Room::save`]; false if it does not fit.
    pub(crate) fn restore(&mut self, state: &[f32]) -> bool {
        let Some((lattice, tail)) = state.split_last_chunk::<8>() else { return false };
        let [share, share_low, speed, speed_low, dt, dt_low, steps, started] = tail.map(f32::to_bits);
        let whole = |high: u32, low: u32| f64::from_bits(u64::from(high) << 32 | u64::from(low));
        let dt = whole(dt, dt_low);
        if steps == 0 || !(dt > 0.0 && dt.is_finite()) {
            return false;
        }
        if steps != self.step.steps || dt != self.dt {
            self.change_steps(dt, steps);
        }
        if !self.lattice.restore(lattice) {
            return false;
        }
        (self.share, self.speed, self.started) = (whole(share, share_low), whole(speed, speed_low), started != 0);
        true
    }
}
