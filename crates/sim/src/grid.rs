//! The one regular grid of mechanics and heat (simulation.md §0.1, §1.2).

use serde::{Deserialize, Serialize};

/// A dense node grid: node (i, j, k) sits at `origin + spacing · (i, j, k)`; z is fastest in memory.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Grid {
    /// Position of node (0, 0, 0) \[m\].
    pub origin: [f64; 3],
    /// Node spacing Δx \[m\].
    pub spacing: f64,
    /// Nodes per axis.
    pub nodes: [usize; 3],
}

/// Node layers at each face of the box that act as walls for the mechanics (simulation.md §0.1).
pub const PADDING: usize = 3;

impl Grid {
    /// Number of nodes.
    pub fn len(&self) -> usize {
        self.nodes[0] * self.nodes[1] * self.nodes[2]
    }

    /// True for a grid without nodes.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Memory index of a node.
    #[inline(always)]
    pub fn index(&self, i: usize, j: usize, k: usize) -> usize {
        (i * self.nodes[1] + j) * self.nodes[2] + k
    }

    /// Node of a memory index.
    #[inline(always)]
    pub fn node(&self, index: usize) -> [usize; 3] {
        let k = index % self.nodes[2];
        let ij = index / self.nodes[2];
        [ij / self.nodes[1], ij % self.nodes[1], k]
    }

    /// Position of a node \[m\].
    #[inline(always)]
    pub fn position(&self, node: [usize; 3]) -> [f64; 3] {
        std::array::from_fn(|a| self.origin[a] + self.spacing * node[a] as f64)
    }

    /// Grid coordinate ξ of a position: node units from node (0, 0, 0).
    #[inline(always)]
    pub fn coordinate(&self, x: [f64; 3]) -> [f64; 3] {
        std::array::from_fn(|a| (x[a] - self.origin[a]) / self.spacing)
    }
}
