//! Faces of the box as links: what arrives from outside, written where the next step reads it (simulation.md §4.5).
//!
//! A link names the slot that wants a value and the slot the value comes from, for odd and even steps. Sources are never
//! wanted in the same step, so the order of the links does not matter.

use crate::air::population::Format;
use crate::air::settings::{Face, FlowFace, HeatFace};
use crate::air::storage::Layout;
use crate::air::velocity_sets::{C, Q7, Q19, W7, W19, direction, opposite};

/// `slot[to] = factor · slot[from] + add`, by parity of the next step (even, odd).
#[derive(Clone, Copy, Debug)]
pub(crate) struct Link {
    pub(crate) to: [u32; 2],
    pub(crate) from: [u32; 2],
    pub(crate) factor: f32,
    pub(crate) add: f32,
}

/// A link to the open air.
#[derive(Clone, Copy, Debug)]
pub(crate) struct OpenLink {
    pub(crate) to: [u32; 2],
    /// What departed from the node towards the opening.
    pub(crate) from: [u32; 2],
    /// What departed from the node the other way (temperature only).
    pub(crate) copy: [u32; 2],
    /// Index of the node in the node arrays.
    pub(crate) node: u32,
    /// Direction into the box.
    pub(crate) direction: u8,
}

/// All links of one set of populations.
#[derive(Clone, Debug, Default)]
pub(crate) struct Links {
    /// Plain copies: walls at rest, mirrors, periodic faces.
    pub(crate) copies: Vec<([u32; 2], [u32; 2])>,
    /// Moving walls, fixed temperatures and fluxes.
    pub(crate) affine: Vec<Link>,
    pub(crate) open: Vec<OpenLink>,
}

/// What one missing population is made of.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Arrival {
    /// A population that departed elsewhere, times a factor, plus a constant: (node, direction, factor, constant).
    From([isize; 3], usize, f64, f64),
    /// From the open air.
    Open,
}

fn slots(f: impl Fn(bool) -> usize) -> [u32; 2] {
    [f(false) as u32, f(true) as u32]
}

/// Axes along which `y` lies outside the box; periodic ones are wrapped in place.
fn outside(nodes: [usize; 3], faces: &[[Face; 2]; 3], y: &mut [isize; 3], periodic: impl Fn(&Face) -> bool) -> Vec<(usize, Face)> {
    let mut out = Vec::new();
    for a in 0..3 {
        let n = nodes[a] as isize;
        if (0..n).contains(&y[a]) {
            continue;
        }
        let face = faces[a][usize::from(y[a] >= n)];
        if periodic(&face) {
            y[a] = y[a].rem_euclid(n);
        } else {
            out.push((a, face));
        }
    }
    out
}

/// Where the flow population comes from that arrives at `x` along `k` from outside the box; `None` inside it.
pub(crate) fn flow_arrival(nodes: [usize; 3], faces: &[[Face; 2]; 3], x: [usize; 3], k: usize) -> Option<Arrival> {
    let here: [isize; 3] = x.map(|v| v as isize);
    let mut y: [isize; 3] = std::array::from_fn(|a| here[a] - C[k][a] as isize);
    let start = y;
    let out = outside(nodes, faces, &mut y, |f| f.flow == FlowFace::Periodic);
    if out.is_empty() {
        return (y != start).then_some(Arrival::From(y, k, 1.0, 0.0));
    }
    let is = |f: fn(&FlowFace) -> bool| out.iter().any(|(_, face)| f(&face.flow));
    if is(|f| *f == FlowFace::NoSlip) {
        return Some(Arrival::From(here, opposite(k), 1.0, 0.0));
    }
    if is(|f| matches!(f, FlowFace::Moving(_))) {
        let mut add = 0.0;
        for (_, face) in &out {
            if let FlowFace::Moving(u) = face.flow {
                add += 6.0 * W19[k] * (0..3).map(|a| f64::from(C[k][a]) * u[a]).sum::<f64>();
            }
        }
        return Some(Arrival::From(here, opposite(k), 1.0, add));
    }
    if is(|f| *f == FlowFace::Open) {
        return Some(Arrival::Open);
    }
    // Mirrors only: the normal parts turn around, the tangential ones go on.
    let mut c = C[k];
    for (a, _) in &out {
        c[*a] = -c[*a];
        y[*a] = here[*a];
    }
    Some(Arrival::From(y, direction(c).unwrap_or(opposite(k)), 1.0, 0.0))
}

/// Where the temperature population comes from that arrives at `x` along `k` from outside the box; `None` inside it.
pub(crate) fn heat_arrival(nodes: [usize; 3], faces: &[[Face; 2]; 3], x: [usize; 3], k: usize) -> Option<Arrival> {
    let here: [isize; 3] = x.map(|v| v as isize);
    let mut y: [isize; 3] = std::array::from_fn(|a| here[a] - C[k][a] as isize);
    let start = y;
    let out = outside(nodes, faces, &mut y, |f| f.heat == HeatFace::Periodic);
    let Some((_, face)) = out.first() else {
        return (y != start).then_some(Arrival::From(y, k, 1.0, 0.0));
    };
    Some(match face.heat {
        HeatFace::Fixed(t) => Arrival::From(here, opposite(k), -1.0, 2.0 * W7[k] * t),
        HeatFace::Flux(q) => Arrival::From(here, opposite(k), 1.0, q),
        HeatFace::Open => Arrival::Open,
        HeatFace::Adiabatic | HeatFace::Periodic => Arrival::From(here, opposite(k), 1.0, 0.0),
    })
}

impl Links {
    /// The links of the faces for the flow (`q` = 19) or the temperature (`q` = 7).
    pub(crate) fn new(layout: &Layout, q: usize, faces: &[[Face; 2]; 3]) -> Self {
        let mut links = Self::default();
        let n = layout.nodes;
        for i in 0..n[0] {
            for j in 0..n[1] {
                let rim = i == 0 || j == 0 || i + 1 == n[0] || j + 1 == n[1];
                let step = if rim || n[2] < 2 { 1 } else { n[2] - 1 };
                for k in (0..n[2]).step_by(step) {
                    for d in 1..q {
                        links.push(layout, q, faces, [i, j, k], d);
                    }
                }
            }
        }
        links
    }

    fn push(&mut self, layout: &Layout, q: usize, faces: &[[Face; 2]; 3], x: [usize; 3], k: usize) {
        let arrival = if q == Q19 { flow_arrival(layout.nodes, faces, x, k) } else { heat_arrival(layout.nodes, faces, x, k) };
        let here = x.map(|v| v as isize);
        let to = slots(|odd| layout.arriving(q, odd, k, here));
        match arrival {
            None => {}
            Some(Arrival::From(y, d, factor, add)) => {
                let from = slots(|odd| layout.departed(q, odd, d, y));
                if factor == 1.0 && add == 0.0 {
                    if to != from {
                        self.copies.push((to, from));
                    }
                } else {
                    self.affine.push(Link { to, from, factor: factor as f32, add: add as f32 });
                }
            }
            Some(Arrival::Open) => self.open.push(OpenLink {
                to,
                from: slots(|odd| layout.departed(q, odd, opposite(k), here)),
                copy: slots(|odd| layout.departed(q, odd, k, here)),
                node: layout.node(x) as u32,
                direction: k as u8,
            }),
        }
    }

    /// Copies and affine links; returns the sum of what the affine ones added.
    pub(crate) fn close<T: Format>(&self, odd: bool, slots: &mut [T]) -> f64 {
        let p = usize::from(odd);
        for (to, from) in &self.copies {
            slots[to[p] as usize] = slots[from[p] as usize];
        }
        let mut gained = 0.0;
        for l in &self.affine {
            let old = slots[l.from[p] as usize].get();
            gained += place(slots, l.to[p], l.factor * old + l.add, old);
        }
        gained
    }

    /// Open faces of the flow: density 1 outside, velocity of the boundary node in the step before.
    pub(crate) fn open_flow<T: Format>(&self, odd: bool, slots: &mut [T], u: &[Vec<f32>; 3]) {
        let p = usize::from(odd);
        for l in &self.open {
            let k = l.direction as usize;
            let v: [f32; 3] = std::array::from_fn(|a| u[a][l.node as usize]);
            slots[l.to[p] as usize] = T::put(open_flow(k, slots[l.from[p] as usize].get(), v));
        }
    }

    /// Open faces of the temperature; returns the heat that came in.
    pub(crate) fn open_heat<T: Format>(&self, odd: bool, slots: &mut [T], u: &[Vec<f32>; 3]) -> f64 {
        let p = usize::from(odd);
        let mut gained = 0.0;
        for l in &self.open {
            let k = l.direction as usize;
            let inward: f32 = (0..3).map(|a| u[a][l.node as usize] * C[k][a] as f32).sum();
            let old = slots[l.from[p] as usize].get();
            let new = if inward > 0.0 { -old } else { slots[l.copy[p] as usize].get() };
            gained += place(slots, l.to[p], new, old);
        }
        gained
    }
}

/// Stores a population; returns what the stored one exceeds `old` by.
#[inline(always)]
pub(crate) fn place<T: Format>(slots: &mut [T], to: u32, value: f32, old: f32) -> f64 {
    let stored = T::put(value);
    slots[to as usize] = stored;
    f64::from(stored.get() - old)
}

/// Anti-bounce-back for a density of 1, with stored populations `f − w`.
#[inline(always)]
fn open_flow(k: usize, departed: f32, v: [f32; 3]) -> f32 {
    let cv: f32 = (0..3).map(|a| v[a] * C[k][a] as f32).sum();
    let v2: f32 = v.iter().map(|x| x * x).sum();
    -departed + 2.0 * W19[k] as f32 * (4.5 * cv * cv - 1.5 * v2)
}

/// A node with populations next to one without: heat crosses as a flux (simulation.md §3.5).
#[derive(Clone, Copy, Debug)]
pub(crate) struct Exchange {
    pub(crate) to: [u32; 2],
    pub(crate) from: [u32; 2],
    /// Index of the air node in the node arrays.
    pub(crate) air: u32,
    /// What lies on the other side, as the owner of the lattice counts it.
    pub(crate) other: u32,
}

/// The exchange link of air node `x` whose populations along `k` come from a node without.
pub(crate) fn exchange(layout: &Layout, x: [usize; 3], k: usize, other: u32) -> Exchange {
    let here = x.map(|v| v as isize);
    Exchange {
        to: slots(|odd| layout.arriving(Q7, odd, k, here)),
        from: slots(|odd| layout.departed(Q7, odd, opposite(k), here)),
        air: layout.node(x) as u32,
        other,
    }
}
