//! Where populations live: padded planes, and the AA pattern that streams in place (simulation.md §1.3).
//!
//! Every population has one slot per node. Even steps read `f_k` from slot `(k, x)` and leave `f_k*` in slot `(k̄, x)`; odd
//! steps find `f_k` in slot `(k̄, x − c_k)` and leave `f_k*` in slot `(k, x + c_k)`. Either way slot `(q, a)` is touched by one
//! node only, in even steps by `a`, in odd steps by `a − c_q`: half the memory and traffic of two copies, and plane of slots
//! `(q, x + c_q)` may be handed to plane x alone, so threads need no locks and the code no `unsafe`.
//!
//! The box has a rim of ghost nodes. After each step the boundary conditions write what should arrive from the ghosts into
//! the slots from which the next step reads; what the kernel computes in the rim or in the padding of a row is overwritten.

use crate::air::velocity_sets::{C, Q19, opposite};

/// Rows are padded to whole vectors of this many nodes, on every instruction set.
pub(crate) const CHUNK: usize = 16;
/// Room before and after the rows of a plane.
const APRON: usize = 16;

/// Shape of the padded box.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Layout {
    pub(crate) nodes: [usize; 3],
    /// Nodes from one row to the next; the ghost below a row is the last of the row before.
    pub(crate) stride: usize,
    /// Length of a plane.
    pub(crate) plane: usize,
    /// Where populations go: the velocities, less their part along periodic axes of one node, on which every node is its
    /// own neighbour.
    pub(crate) moves: [[isize; 3]; Q19],
}

impl Layout {
    /// `wraps` tells which axes are periodic.
    pub(crate) fn new(nodes: [usize; 3], wraps: [bool; 3]) -> Self {
        let stride = (nodes[2] + 2).next_multiple_of(CHUNK);
        let moves = C.map(|c| std::array::from_fn(|a| if wraps[a] && nodes[a] == 1 { 0 } else { c[a] as isize }));
        Self { nodes, stride, plane: 2 * APRON + (nodes[1] + 2) * stride, moves }
    }

    /// Offset in its plane of the first node of row `j`, −1 ≤ j ≤ ny.
    #[inline(always)]
    pub(crate) fn row(&self, j: isize) -> usize {
        APRON + (j + 1) as usize * self.stride
    }

    /// Offset in its plane of node (·, j, k), ghosts included.
    #[inline(always)]
    pub(crate) fn offset(&self, j: isize, k: isize) -> usize {
        (self.row(j) as isize + k) as usize
    }

    /// Index of an interior node in arrays with one value per node.
    #[inline(always)]
    pub(crate) fn node(&self, n: [usize; 3]) -> usize {
        n[0] * self.plane + self.offset(n[1] as isize, n[2] as isize)
    }

    /// Length of arrays with one value per node.
    pub(crate) fn scalars(&self) -> usize {
        self.nodes[0] * self.plane
    }

    /// Length of the storage of `q` populations.
    pub(crate) fn populations(&self, q: usize) -> usize {
        (self.nodes[0] + 2) * q * self.plane
    }

    /// Index of slot `k` of node `n`, ghosts included, in a storage of `q` populations.
    #[inline(always)]
    pub(crate) fn slot(&self, q: usize, k: usize, n: [isize; 3]) -> usize {
        ((n[0] + 1) as usize * q + k) * self.plane + self.offset(n[1], n[2])
    }

    /// Slot from which the next step (odd or even) takes the population that arrives at `n` along `k`.
    #[inline(always)]
    pub(crate) fn arriving(&self, q: usize, odd: bool, k: usize, n: [isize; 3]) -> usize {
        if odd { self.slot(q, opposite(k), std::array::from_fn(|a| n[a] - self.moves[k][a])) } else { self.slot(q, k, n) }
    }

    /// Slot in which the step before (with the next one odd or even) left what departs from `n` along `k`.
    #[inline(always)]
    pub(crate) fn departed(&self, q: usize, odd: bool, k: usize, n: [isize; 3]) -> usize {
        if odd { self.slot(q, opposite(k), n) } else { self.slot(q, k, std::array::from_fn(|a| n[a] + self.moves[k][a])) }
    }

    /// Chunks of vectors per row.
    pub(crate) fn chunks(&self) -> usize {
        self.nodes[2].div_ceil(CHUNK)
    }
}

/// Cuts the storage of `Q` populations into what each plane of nodes touches in an odd or even step.
pub(crate) fn planes<'a, T, const Q: usize>(layout: &Layout, odd: bool, storage: &'a mut [T]) -> Vec<[&'a mut [T]; Q]> {
    let mut parts: Vec<&mut [T]> = storage.chunks_exact_mut(layout.plane).collect();
    let mut out = Vec::with_capacity(layout.nodes[0]);
    for i in 0..layout.nodes[0] {
        out.push(std::array::from_fn(|q| {
            let shift = if odd { layout.moves[q][0] } else { 0 };
            let plane = (i as isize + 1 + shift) as usize;
            std::mem::take(&mut parts[plane * Q + q])
        }));
    }
    out
}

/// Offset, relative to the node, of the slots `q` that it touches inside their plane.
#[inline(always)]
pub(crate) fn reach(layout: &Layout, odd: bool, q: usize) -> isize {
    if odd { layout.moves[q][1] * layout.stride as isize + layout.moves[q][2] } else { 0 }
}
