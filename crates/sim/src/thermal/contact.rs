//! Resistance to heat between bodies that touch (simulation.md §6.3, end).
//!
//! A node near a contact holds matter of both bodies. With one temperature per node the bodies would exchange heat there through
//! their points as if nothing lay between them, so each body that has a resistance keeps a layer of nodes of its own: energy,
//! mass and temperature of its points alone. Within a layer heat is conducted as everywhere; between the layers of a node it
//! crosses the area of contact that lies there.
//!
//! Where a plane divides the bodies, every link along its normal is shared between them: a body's share falls from one to zero
//! over the reach of the points' kernel. What a node's links carry towards the other body less than away from it is the area of
//! contact at the node: the areas add up to that of the plane, what one body loses the other gains, and a temperature that is
//! linear on either side with a step `R q` between them is steady.

use crate::thermal::network::Network;
use crate::thermal::transfer::Lattice;

/// Layers of nodes: number zero is that of all bodies without a resistance, each of the others has its own.
#[derive(Clone, Debug, Default)]
pub(crate) struct Layers {
    /// Bodies with a resistance \[m²K/W\], ascending.
    bodies: Vec<(u16, f64)>,
}

impl Layers {
    /// Gives `body` the resistance \[m²K/W\] of its side of every contact.
    pub(crate) fn set(&mut self, body: u16, resistance: f64) {
        self.bodies.retain(|b| b.0 != body);
        if resistance > 0.0 {
            self.bodies.push((body, resistance));
            self.bodies.sort_unstable_by_key(|b| b.0);
        }
    }

    /// Number of layers, at least one.
    #[inline(always)]
    pub(crate) fn count(&self) -> usize {
        1 + self.bodies.len()
    }

    /// Layer of a body.
    #[inline(always)]
    pub(crate) fn of(&self, body: u16) -> usize {
        self.bodies.iter().position(|b| b.0 == body).map_or(0, |i| i + 1)
    }

    /// Resistance \[m²K/W\] of one side.
    fn side(&self, layer: usize) -> f64 {
        if layer == 0 { 0.0 } else { self.bodies[layer - 1].1 }
    }
}

/// Share of a link that is a body's, from the body's parts of the matter at both ends. Half at the face between the bodies, where a
/// flat one gives the fuller end 5/6 and the other 1/6; the place of such a face is met within 0.05 Δx wherever it lies. The last
/// bound keeps nodes that hold next to nothing from becoming stiff.
#[inline(always)]
pub(crate) fn share(a: f64, b: f64) -> f64 {
    let (own, others) = (a.min(b), 1.0 - a.max(b));
    (0.5 + (3.0 * own).min(0.5) - (3.0 * others).min(0.5)).min(6.0 * own)
}

/// Heat conductance \[W/K\] between two bodies at one node: slots of the network.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Contact {
    pub(crate) slots: [u32; 2],
    pub(crate) conductance: f64,
}

impl Contact {
    /// Heat \[J\] from the second to the first slot in `dt` seconds, as if both exchanged it alone: stable for any step.
    #[inline(always)]
    pub(crate) fn heat(&self, dt: f64, t: &[f64], capacity: &[f64]) -> f64 {
        let [a, b] = self.slots.map(|s| s as usize);
        let inverse = capacity[a].recip() + capacity[b].recip();
        -(-self.conductance * dt * inverse).exp_m1() / inverse * (t[b] - t[a])
    }
}

/// Area of the surface of the body of `slot` towards all others at its node in squared node spacings, and how full it is behind
/// it, 0–1: less than one where the body's side ends.
fn face(network: &Network, lattice: &Lattice, slot: usize) -> [f64; 2] {
    let (node, layer, part) = (network.node(slot), network.layer(slot), network.part[slot]);
    let step = |axis: usize, forward: bool| {
        // Beyond the last matter the face goes on as it is here.
        let there = lattice.neighbour(node, axis, forward).and_then(|n| network.part_at(n, layer));
        share(part, there.unwrap_or(part))
    };
    let inward: [f64; 3] = std::array::from_fn(|a| step(a, true) - step(a, false));
    let largest = inward.iter().fold(0.0f64, |m, s| m.max(s.abs()));
    // Bodies at rest on each other leave a gap, which thins the node: two nodes further in there is none. In a corner not every way
    // leads inwards.
    let way = |axis: usize| std::iter::successors(Some(node), move |n| lattice.neighbour(*n, axis, inward[axis] > 0.0)).take(3);
    let ways = (0..3).filter(|a| inward[*a].abs() >= 0.5 * largest);
    let full = ways.flat_map(way).map(|n| network.phi_at(n)).fold(0.0, f64::max);
    [inward.iter().map(|s| s * s).sum::<f64>().sqrt(), full.min(1.0)]
}

/// Adds the contacts of all nodes that hold several bodies.
pub(crate) fn collect(network: &Network, lattice: &Lattice, layers: &Layers, spacing: f64, contacts: &mut Vec<Contact>) {
    let mut first = 0;
    while first < network.len() {
        // The slots of one node follow each other.
        let end = (first + 1..network.len()).find(|&s| network.dense[s] != network.dense[first]).unwrap_or(network.len());
        for a in first..end {
            for b in a + 1..end {
                let ([area_a, full_a], [area_b, full_b]) = (face(network, lattice, a), face(network, lattice, b));
                // What a body turns towards all others is divided among them by what they hold.
                let to_b = area_a * network.part[b] / (1.0 - network.part[a]);
                let to_a = area_b * network.part[a] / (1.0 - network.part[b]);
                let area = 0.5 * (to_a + to_b) * full_a.min(full_b) * spacing * spacing;
                let resistance = layers.side(network.layer(a)) + layers.side(network.layer(b));
                if area > 0.0 {
                    contacts.push(Contact { slots: [a as u32, b as u32], conductance: area / resistance });
                }
            }
        }
        first = end;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Part of the matter on the left of a flat face at `face` that the kernel gives to the node at 0.
    fn part(face: f64) -> f64 {
        // The quadratic B-spline, integrated.
        let tail = |z: f64| (1.5 - z.min(1.5)).powi(3) / 6.0;
        match face {
            z if z.abs() <= 0.5 => 0.5 + 0.75 * z - z.powi(3) / 3.0,
            z if z > 0.0 => 1.0 - tail(z),
            z => tail(-z),
        }
    }

    #[test]
    fn the_shares_of_links_say_where_a_flat_face_is() {
        for i in 0..20 {
            let face = 5.0 + f64::from(i) / 20.0;
            let nodes: Vec<f64> = (0..12).map(|n| part(face - f64::from(n))).collect();
            let left: Vec<f64> = nodes.windows(2).map(|w| share(w[0], w[1])).collect();
            let right: Vec<f64> = nodes.windows(2).map(|w| share(1.0 - w[0], 1.0 - w[1])).collect();
            // Links lie half way between the nodes; the sum of the shares is the length on the left.
            assert!((left.iter().sum::<f64>() - face).abs() < 0.051, "{face}: {left:?}");
            assert!(left.iter().zip(&right).all(|(l, r)| (l + r - 1.0).abs() < 1e-12), "{left:?} {right:?}");
            assert!(left.windows(2).all(|w| w[1] <= w[0]) && left[0] == 1.0 && left[10] == 0.0);
            // Not stiffer than full nodes by more than three.
            assert!(nodes.iter().zip(&left).all(|(n, s)| *s <= 3.0 * n + 1e-12));
        }
    }

    #[test]
    fn bodies_without_a_resistance_share_a_layer() {
        let mut layers = Layers::default();
        assert_eq!((layers.count(), layers.of(7)), (1, 0));
        layers.set(7, 1e-3);
        layers.set(3, 2e-3);
        assert_eq!((layers.count(), layers.of(3), layers.of(7), layers.of(1)), (3, 1, 2, 0));
        assert_eq!((layers.side(0), layers.side(1), layers.side(2)), (0.0, 2e-3, 1e-3));
        layers.set(3, 0.0);
        assert_eq!((layers.count(), layers.of(7)), (2, 1));
    }
}
