//! Sources turned into numbers per node for one coupling step (simulation.md §4.7).

use megas_math::vec3;
use rayon::prelude::*;

use crate::grid::Grid;
use crate::schedule::Pose;
use crate::source::surface::SurfaceMeasure;
use crate::source::{Film, HeatSource, Radiant, Region, SourceKind, SourceReport};
use crate::thermal::Wall;
use crate::thermal::network::Network;
use crate::thermal::transfer::Lattice;

/// What a list of [`Term`]s does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Action {
    /// `a` \[W\] into the node.
    Heat,
    /// Pulls the node by the share `a` towards the energy `b` \[J\].
    Hold,
    /// Conductance `a` \[W/K\] to surroundings at `b` \[K\].
    Exchange,
}

#[derive(Clone, Copy, Debug)]
pub(crate) struct Term {
    slot: u32,
    a: f64,
    b: f64,
}

/// All terms of a step, source after source.
#[derive(Clone, Debug, Default)]
pub(crate) struct Terms {
    terms: Vec<Term>,
    /// End of each source's terms and what they do.
    ranges: Vec<(usize, Action)>,
    /// One per source, then one for the film of the air model if there is one.
    pub(crate) reports: Vec<SourceReport>,
    weight: Vec<f64>,
    /// What sources that hold a temperature brought, for those of the temperature named first.
    pub(crate) held: Held,
}

/// Heat by which nodes were held at one temperature.
#[derive(Clone, Debug, Default)]
pub(crate) struct Held {
    /// The temperature \[K\].
    pub(crate) kelvin: f64,
    /// Heat per node \[J\]; empty without such a source.
    pub(crate) heat: Vec<f64>,
    /// Sources of this temperature, by their number.
    sources: Vec<usize>,
}

/// What the terms of a step need to know about the nodes.
pub(crate) struct Context<'a> {
    pub(crate) grid: &'a Grid,
    pub(crate) network: &'a Network,
    pub(crate) lattice: &'a Lattice,
    /// Dimensionless area per node; empty if no source asked for it.
    pub(crate) surface: &'a SurfaceMeasure,
    pub(crate) walls: Option<&'a [Wall]>,
    /// Mass share of object `id` in an active node.
    pub(crate) share: &'a (dyn Fn(u16, usize) -> f64 + Sync),
    /// Energy of a node at a temperature.
    pub(crate) energy_at: &'a (dyn Fn(usize, f64) -> f64 + Sync),
    pub(crate) time: f64,
}

impl HeatSource {
    /// True if the source needs the surface measure.
    pub(crate) fn needs_surface(&self) -> bool {
        self.per_area() || matches!(self.region, Region::Surface(_))
    }

    /// True if the source needs the direction of the surface.
    pub(crate) fn needs_facing(&self) -> bool {
        matches!(self.kind, SourceKind::Radiant(_))
    }

    /// True for kinds that act in proportion to the surface.
    fn per_area(&self) -> bool {
        matches!(self.kind, SourceKind::Flux { .. } | SourceKind::Film(_) | SourceKind::Radiant(_))
    }
}

impl Held {
    /// Notes that source `number` holds `kelvin`.
    fn add(&mut self, kelvin: f64, number: usize, nodes: usize) {
        if self.heat.is_empty() {
            self.kelvin = kelvin;
            self.heat.resize(nodes, 0.0);
        }
        if self.kelvin == kelvin {
            self.sources.push(number);
        }
    }
}

impl Terms {
    /// Forgets the last step.
    pub(crate) fn clear(&mut self) {
        self.terms.clear();
        self.ranges.clear();
        self.reports.clear();
        self.held.heat.clear();
        self.held.sources.clear();
    }

    /// Adds the terms of one source.
    pub(crate) fn add(&mut self, source: &HeatSource, cx: &Context) {
        let gain = source.schedule.gain(cx.time);
        let action = match source.kind {
            SourceKind::Temperature { .. } => Action::Hold,
            SourceKind::Film(_) => Action::Exchange,
            _ => Action::Heat,
        };
        if gain > 0.0 {
            self.weigh(source, cx);
            self.build(source, gain, cx);
        }
        self.finish(action, source.per_area(), cx);
    }

    /// Adds the film of the air model, on every surface.
    pub(crate) fn add_film(&mut self, film: Film, cx: &Context) {
        self.weight.clear();
        self.weight.resize(cx.network.len(), 1.0);
        self.exchange(film, 1.0, cx);
        self.finish(Action::Exchange, true, cx);
    }

    fn finish(&mut self, action: Action, surface: bool, cx: &Context) {
        let start = self.ranges.last().map_or(0, |r| r.0);
        let own = &self.terms[start..];
        let dx2 = cx.grid.spacing * cx.grid.spacing;
        let area =
            if surface { own.iter().map(|t| self.weight[t.slot as usize] * cx.surface.area[t.slot as usize] * dx2).sum() } else { 0.0 };
        self.reports.push(SourceReport { heat: 0.0, area, nodes: own.len() as u32 });
        self.ranges.push((self.terms.len(), action));
    }

    /// χ per active node.
    fn weigh(&mut self, source: &HeatSource, cx: &Context) {
        let region = &source.region;
        let pose = match source.kind {
            // The light moves, not what it falls on.
            SourceKind::Radiant(_) => Pose::REST,
            _ => source.motion.at(cx.time, region.pivot()),
        };
        let surface = matches!(region, Region::Surface(_));
        // On a surface region the layer itself decides, unless the kind already works per area.
        let layer = surface && !source.per_area();
        self.weight.clear();
        self.weight.resize(cx.network.len(), 0.0);
        self.weight.par_iter_mut().enumerate().for_each(|(slot, w)| {
            *w = match region.object() {
                Some(id) => (cx.share)(id, slot),
                None => region.weight(cx.grid.position(cx.network.node(slot)), cx.grid.spacing, &pose),
            };
            if layer {
                // Nodes of the rim with a whole open face count fully, those with an edge of one in part.
                *w *= (2.0 * cx.surface.area[slot]).min(1.0);
            }
        });
    }

    fn build(&mut self, source: &HeatSource, gain: f64, cx: &Context) {
        let volume = cx.grid.spacing.powi(3);
        let dx2 = cx.grid.spacing.powi(2);
        let value = |constant| source.schedule.value(cx.time, constant);
        if let SourceKind::Temperature { kelvin } = &source.kind {
            self.held.add(value(*kelvin), self.ranges.len(), cx.network.len());
        }
        let Self { terms, weight, .. } = self;
        let each = || weight.iter().enumerate().filter(|(_, w)| **w > 0.0);
        let term = |slot: usize, a, b| Term { slot: slot as u32, a, b };
        match &source.kind {
            SourceKind::Temperature { kelvin } => {
                let t = value(*kelvin);
                terms.extend(each().map(|(s, w)| term(s, (gain * w).min(1.0), (cx.energy_at)(s, t))));
            }
            SourceKind::Power { watts } => {
                let filled: f64 = each().map(|(s, w)| w * cx.network.filled(s)).sum();
                if filled > 0.0 {
                    let scale = gain * value(*watts) / filled;
                    terms.extend(each().map(|(s, w)| term(s, scale * w * cx.network.filled(s), 0.0)));
                }
            }
            SourceKind::Volume { watts_per_m3 } => {
                let scale = gain * value(*watts_per_m3) * volume;
                terms.extend(each().map(|(s, w)| term(s, scale * w * cx.network.filled(s), 0.0)));
            }
            SourceKind::Flux { watts_per_m2 } => {
                let scale = gain * value(*watts_per_m2) * dx2;
                terms.extend(each().filter(|(s, _)| cx.surface.area[*s] > 0.0).map(|(s, w)| term(s, scale * w * cx.surface.area[s], 0.0)));
            }
            SourceKind::Radiant(radiant) => {
                let pose = source.motion.at(cx.time, radiant.light.pivot());
                self.shine(radiant, &pose, gain * value(radiant.strength), cx);
            }
            SourceKind::Film(film) => self.exchange(Film { ambient: value(film.ambient), ..*film }, gain, cx),
        }
    }

    /// Light that reaches the surface, and the share of it that stays.
    fn shine(&mut self, radiant: &Radiant, pose: &Pose, strength: f64, cx: &Context) {
        let Self { terms, weight, .. } = self;
        let light = radiant.light.placed(pose, strength);
        let (dx, dx2) = (cx.grid.spacing, cx.grid.spacing.powi(2));
        let lit = |slot: usize| {
            let facing = cx.surface.facing[slot];
            if weight[slot] <= 0.0 || facing == [0.0; 3] {
                return None;
            }
            let out = vec3::normalize_or(facing, [0.0; 3]);
            let x = cx.surface.place[slot];
            let arriving = light.at(std::array::from_fn(|a| cx.grid.origin[a] + dx * x[a]), dx)?;
            let across = vec3::dot(facing, arriving.toward);
            if across <= 0.0 {
                return None;
            }
            let seen = cx.surface.sees(cx.lattice, cx.walls, x, out, arriving.toward, arriving.distance / dx);
            let a = radiant.absorptivity * arriving.irradiance * across * dx2 * weight[slot];
            seen.then_some(Term { slot: slot as u32, a, b: 0.0 })
        };
        terms.par_extend((0..weight.len()).into_par_iter().with_min_len(256).filter_map(lit));
    }

    /// Film in series with the material above the node, so that inner nodes are not cooled directly.
    fn exchange(&mut self, film: Film, gain: f64, cx: &Context) {
        let dx = cx.grid.spacing;
        for (slot, (w, a)) in self.weight.iter().zip(&cx.surface.area).enumerate() {
            let h = film.total_coefficient(cx.network.t[slot]);
            if *w > 0.0 && *a > 0.0 && h > 0.0 {
                let depth = dx * cx.surface.depth[slot];
                let conductance = gain * w * a * dx * dx / (1.0 / h + depth / cx.network.k[slot]);
                self.terms.push(Term { slot: slot as u32, a: conductance, b: film.ambient });
            }
        }
    }

    /// Applies everything to the energies of the nodes for `dt` seconds.
    pub(crate) fn apply(&mut self, network: &mut Network, dt: f64) {
        let mut start = 0;
        for (number, (&(end, action), report)) in self.ranges.iter().zip(&mut self.reports).enumerate() {
            let held = self.held.sources.contains(&number);
            let mut heat = 0.0;
            for t in &self.terms[start..end] {
                let s = t.slot as usize;
                let q = match action {
                    Action::Heat => t.a * dt,
                    Action::Hold => t.a * (t.b - network.e[s]),
                    // Semi-implicit in the node's own temperature: stable for any conductance.
                    Action::Exchange => -t.a * dt * (network.t[s] - t.b) / (1.0 + t.a * dt / network.capacity[s]),
                };
                network.e[s] += q;
                heat += q;
                if held {
                    self.held.heat[s] += q;
                }
            }
            report.heat += heat;
            start = end;
        }
    }

    /// True if there is nothing to apply.
    pub(crate) fn is_empty(&self) -> bool {
        self.terms.is_empty()
    }

    /// Heat by kind of action: (powers and fluxes, holds, exchanges) \[J\].
    pub(crate) fn totals(&self) -> [f64; 3] {
        let mut q = [0.0; 3];
        for ((_, action), report) in self.ranges.iter().zip(&self.reports) {
            q[*action as usize] += report.heat;
        }
        q
    }
}
