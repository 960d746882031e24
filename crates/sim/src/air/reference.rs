//! The oracle: the same lattice in double precision, two copies, pull, one node at a time (simulation.md §1.3, §4).

use crate::air::boundaries::{Arrival, flow_arrival, heat_arrival};
use crate::air::lattice::{HeatNode, NodeState};
use crate::air::settings::{LatticeSettings, SPEED_CAP, TURBULENT_PRANDTL};
use crate::air::velocity_sets::{C, Q7, Q19, W7, W19, opposite};

/// The slow lattice. Everything is public: it is a tool for tests and for cases that need double precision.
#[derive(Clone, Debug)]
pub struct Reference {
    /// Settings.
    pub settings: LatticeSettings,
    /// Arriving flow populations per node, z fastest.
    pub f: Vec<[f64; Q19]>,
    /// Arriving temperature populations per node.
    pub g: Vec<[f64; Q7]>,
    /// What fills the nodes.
    pub states: Vec<NodeState>,
    /// Capacity and conductivity per node; empty = air everywhere.
    pub media: Vec<(f64, f64)>,
    /// Velocity of the last collision.
    pub u: Vec<[f64; 3]>,
    /// Temperature of the last collision.
    pub t: Vec<f64>,
    /// Heat brought in by walls and by open faces or sponges in the last step \[K · nodes\].
    pub gained: [f64; 2],
}

impl Reference {
    /// Air at rest at the reference temperature.
    pub fn new(settings: LatticeSettings) -> Self {
        let n = settings.nodes.iter().product();
        let mut r = Self {
            f: vec![W19; n],
            g: vec![[0.0; Q7]; n],
            states: vec![NodeState::default(); n],
            media: Vec::new(),
            u: vec![[0.0; 3]; n],
            t: vec![0.0; n],
            gained: [0.0; 2],
            settings,
        };
        r.fill(|_| (1.0, [0.0; 3], 0.0));
        r
    }

    /// Index of a node.
    pub fn index(&self, n: [usize; 3]) -> usize {
        (n[0] * self.settings.nodes[1] + n[1]) * self.settings.nodes[2] + n[2]
    }

    fn node(&self, i: usize) -> [usize; 3] {
        let [_, ny, nz] = self.settings.nodes;
        [i / nz / ny, i / nz % ny, i % nz]
    }

    /// Sets every node to the equilibrium of `state(node)` = (density, velocity, temperature over the reference).
    pub fn fill(&mut self, state: impl Fn([usize; 3]) -> (f64, [f64; 3], f64)) {
        for i in 0..self.f.len() {
            let (rho, u, t) = state(self.node(i));
            let c = self.media.get(i).map_or(1.0, |m| m.0);
            self.f[i] = std::array::from_fn(|k| equilibrium(k, rho, u));
            self.g[i] = if self.states[i].heat == HeatNode::Air { heat_equilibrium(c * t, t, u.map(|v| c * v)) } else { [0.0; Q7] };
            self.u[i] = u;
            self.t[i] = t;
        }
    }

    /// One step. `flux(air node, other)` is the heat that an exchange link brings into the air.
    pub fn step(&mut self, flux: impl Fn(usize, u32) -> f64) {
        let s = self.settings.clone();
        let n = self.f.len();
        let (mut f, mut g) = (self.f.clone(), self.g.clone());
        self.gained = [0.0; 2];
        for i in 0..n {
            let sponge = s.sponge(self.node(i));
            let has_heat = s.heat && self.states[i].heat == HeatNode::Air;
            let (c, k) = self.media.get(i).copied().unwrap_or((1.0, s.diffusivity));
            if has_heat {
                let h = g[i].iter().sum::<f64>() + 0.5 * s.source;
                let change = -sponge * h / c;
                for q in 0..Q7 {
                    g[i][q] += W7[q] * change;
                }
                self.gained[1] += change;
                self.t[i] = (h + change) / c;
            } else if let HeatNode::Fixed(t) = self.states[i].heat {
                self.t[i] = f64::from(t);
            }
            let (mut eddy, mut rho) = (0.0, 1.0);
            if s.flow {
                rho = f[i].iter().sum();
                let warm = if s.heat { self.t[i].clamp(-s.buoyancy_limit, s.buoyancy_limit) } else { 0.0 };
                let force = std::array::from_fn(|a| s.force[a] + s.buoyancy[a] * warm);
                eddy = self.collide_flow(i, &mut f[i], force, sponge);
            }
            if has_heat {
                // The flow of mass: u itself has sources, as air is compressed a little.
                let u = if s.flow { self.u[i].map(|v| v * rho) } else { s.wind };
                let t = self.t[i];
                let h = g[i].iter().sum::<f64>() + 0.5 * s.source;
                let (plus, minus) = s.heat_rates(if self.media.is_empty() { k + eddy / TURBULENT_PRANDTL } else { k });
                let eq = heat_equilibrium(h, t, u.map(|v| c * v));
                let old = g[i];
                for q in 0..Q7 {
                    let (even, odd) = halves(&old, &eq, q);
                    g[i][q] = old[q] - plus * even - minus * odd + (1.0 - 0.5 * plus) * s.source * W7[q];
                }
            }
        }
        for i in 0..n {
            let x = self.node(i);
            for k in 1..Q19 {
                if s.flow {
                    self.f[i][k] = self.arriving_flow(&f, x, i, k);
                }
                if s.heat && k < Q7 && self.states[i].heat == HeatNode::Air {
                    self.g[i][k] = self.arriving_heat(&g, x, i, k, &flux);
                }
            }
            self.f[i][0] = f[i][0];
            self.g[i][0] = g[i][0];
        }
    }

    /// Collides node `i`; returns the eddy viscosity.
    fn collide_flow(&mut self, i: usize, f: &mut [f64; Q19], force: [f64; 3], sponge: f64) -> f64 {
        let s = &self.settings;
        let tau = 3.0 * s.viscosity + 0.5;
        let state = self.states[i];
        let solid = f64::from(state.solid.clamp(0.0, 1.0));
        let share = solid * (tau - 0.5) / (1.0 - solid + tau - 0.5);
        let v = state.velocity.map(f64::from);
        let force = force.map(|x| x * (1.0 - share));
        let rho: f64 = f.iter().sum();
        let mut u: [f64; 3] = std::array::from_fn(|a| ((0..Q19).map(|k| f64::from(C[k][a]) * f[k]).sum::<f64>() + 0.5 * force[a]) / rho);
        let speed = u.iter().map(|x| x * x).sum::<f64>().sqrt();
        if speed > SPEED_CAP {
            u = u.map(|x| x * SPEED_CAP / speed);
        }
        let damped = u.map(|x| -sponge * x);
        for k in 0..Q19 {
            f[k] += 3.0 * W19[k] * rho * dot(C[k].map(f64::from), damped);
        }
        u = std::array::from_fn(|a| u[a] + damped[a]);
        self.u[i] = u;
        let eq: [f64; Q19] = std::array::from_fn(|k| equilibrium(k, rho, u));
        let mut tau_now = tau;
        if s.smagorinsky > 0.0 {
            let mut norm2 = 0.0;
            for a in 0..3 {
                for b in 0..3 {
                    let pi: f64 = (0..Q19).map(|k| f64::from(C[k][a] * C[k][b]) * (f[k] - eq[k])).sum();
                    norm2 += pi * pi;
                }
            }
            let q = 18.0 * std::f64::consts::SQRT_2 * s.smagorinsky.powi(2) * norm2.sqrt();
            tau_now = 0.5 * (tau + (tau * tau + q).sqrt());
        }
        let (plus, minus) = s.flow_rates(tau_now);
        let old = *f;
        let deep = self.is_deep(i);
        for k in 0..Q19 {
            let c = C[k].map(f64::from);
            let (cu, cf, uf) = (dot(c, u), dot(c, force), dot(u, force));
            let (even, odd) = halves(&old, &eq, k);
            let pushed = (1.0 - 0.5 * plus) * W19[k] * (9.0 * cu * cf - 3.0 * uf) + (1.0 - 0.5 * minus) * 3.0 * W19[k] * cf;
            let trt = -plus * even - minus * odd + pushed;
            let kk = opposite(k);
            let reflected = old[kk] - old[k] + equilibrium(k, rho, v) - eq[kk];
            f[k] = if deep { equilibrium(k, rho.clamp(0.99, 1.01), v) } else { old[k] + (1.0 - share) * trt + share * reflected };
        }
        (tau_now - tau) / 3.0
    }

    /// True for a solid node whose 18 neighbours are solid too.
    fn is_deep(&self, i: usize) -> bool {
        let n = self.settings.nodes;
        let x = self.node(i);
        (0..Q19).all(|k| {
            let y: [isize; 3] = std::array::from_fn(|a| x[a] as isize + C[k][a] as isize);
            (0..3).any(|a| y[a] < 0 || y[a] >= n[a] as isize) || self.states[self.index(y.map(|v| v as usize))].solid > 0.999
        })
    }

    fn arriving_flow(&self, f: &[[f64; Q19]], x: [usize; 3], i: usize, k: usize) -> f64 {
        match flow_arrival(self.settings.nodes, &self.settings.faces, x, k) {
            None => f[self.index(std::array::from_fn(|a| (x[a] as isize - C[k][a] as isize) as usize))][k],
            Some(Arrival::From(y, d, factor, add)) => factor * f[self.index(y.map(|v| v as usize))][d] + add,
            Some(Arrival::Open) => {
                let (cu, u2) = (dot(C[k].map(f64::from), self.u[i]), dot(self.u[i], self.u[i]));
                -f[i][opposite(k)] + 2.0 * W19[k] * (1.0 + 4.5 * cu * cu - 1.5 * u2)
            }
        }
    }

    fn arriving_heat(&mut self, g: &[[f64; Q7]], x: [usize; 3], i: usize, k: usize, flux: &impl Fn(usize, u32) -> f64) -> f64 {
        let back = g[i][opposite(k)];
        match heat_arrival(self.settings.nodes, &self.settings.faces, x, k) {
            None => {
                let y = self.index(std::array::from_fn(|a| (x[a] as isize - C[k][a] as isize) as usize));
                match self.states[y].heat {
                    HeatNode::Air => g[y][k],
                    HeatNode::Adiabatic => back,
                    HeatNode::Fixed(t) => {
                        self.gained[0] += 2.0 * (W7[k] * f64::from(t) - back);
                        -back + 2.0 * W7[k] * f64::from(t)
                    }
                    HeatNode::Exchange(id) => back + flux(i, id),
                }
            }
            Some(Arrival::From(y, d, factor, add)) => {
                let from = g[self.index(y.map(|v| v as usize))][d];
                if factor != 1.0 || add != 0.0 {
                    self.gained[0] += factor * from + add - back;
                }
                factor * from + add
            }
            Some(Arrival::Open) => {
                let inward = dot(C[k].map(f64::from), self.u[i]) > 0.0;
                let arriving = if inward { -back } else { g[i][k] };
                self.gained[1] += arriving - back;
                arriving
            }
        }
    }

    /// Density and velocity of a node, without the correction for half of the next force.
    pub fn flow(&self, n: [usize; 3]) -> (f64, [f64; 3]) {
        let f = &self.f[self.index(n)];
        let rho: f64 = f.iter().sum();
        (rho, std::array::from_fn(|a| (0..Q19).map(|k| f64::from(C[k][a]) * f[k]).sum::<f64>() / rho))
    }

    /// Temperature of a node over the reference.
    pub fn temperature(&self, n: [usize; 3]) -> f64 {
        let i = self.index(n);
        if self.states[i].heat != HeatNode::Air {
            return self.t[i];
        }
        (self.g[i].iter().sum::<f64>() + 0.5 * self.settings.source) / self.media.get(i).map_or(1.0, |m| m.0)
    }
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn equilibrium(k: usize, rho: f64, u: [f64; 3]) -> f64 {
    let cu = dot(C[k].map(f64::from), u);
    W19[k] * rho * (1.0 + 3.0 * cu + 4.5 * cu * cu - 1.5 * dot(u, u))
}

fn heat_equilibrium(h: f64, t: f64, cu: [f64; 3]) -> [f64; Q7] {
    std::array::from_fn(|k| if k == 0 { h - (1.0 - W7[0]) * t } else { W7[k] * (t + 4.0 * t * dot(C[k].map(f64::from), cu)) })
}

/// Even and odd half of the departure from equilibrium along `k`.
fn halves<const Q: usize>(f: &[f64; Q], eq: &[f64; Q], k: usize) -> (f64, f64) {
    let (a, b) = (f[k] - eq[k], f[opposite(k)] - eq[opposite(k)]);
    (0.5 * (a + b), 0.5 * (a - b))
}
