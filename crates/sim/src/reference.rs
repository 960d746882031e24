//! The slow, obvious MLS-MPM step (simulation.md §2, §5.2): one point, one node, one law at a time, in any precision.
//! The oracle of the fast kernels, and the double-precision instance of the physics suite.

mod laws;

use megas_math::{Mat3, Real, Vec3, bspline, mat3, vec3};

use crate::grid::Grid;
pub use laws::{Law, State, energy, return_map, return_map_with, stress, viscous_stress};

/// One material point.
#[derive(Clone, Copy, Debug)]
pub struct Point<T> {
    /// Position in node units.
    pub xi: Vec3<T>,
    /// Velocity \[m/s\].
    pub velocity: Vec3<T>,
    /// Affine velocity matrix \[1/s\].
    pub affine: Mat3<T>,
    /// Deformation gradient.
    pub elastic: Mat3<T>,
    /// Mass \[kg\].
    pub mass: T,
    /// Reference volume \[m³\].
    pub volume: T,
}

/// Masses and momenta (or velocities) of all nodes, indexed as [`Grid::index`].
#[derive(Clone, Debug)]
pub struct Nodes<T> {
    /// Mass \[kg\].
    pub mass: Vec<T>,
    /// Momentum \[kg·m/s\], or velocity \[m/s\] after the grid update.
    pub motion: Vec<Vec3<T>>,
}

/// Calls `f(node index, weight, distance from the point [m])` for the 27 nodes around a point.
pub fn stencil<T: Real>(grid: &Grid, xi: Vec3<T>, mut f: impl FnMut(usize, T, Vec3<T>)) {
    let parts = xi.map(bspline::base_and_fraction);
    let w = parts.map(|p| bspline::weights(p.1));
    let dx = T::of(grid.spacing);
    for i in 0..3 {
        for j in 0..3 {
            for k in 0..3 {
                let offset = [i, j, k];
                let node: [usize; 3] = std::array::from_fn(|a| parts[a].0 as usize + offset[a]);
                let d = std::array::from_fn(|a| (T::of(offset[a] as f64) - parts[a].1) * dx);
                f(grid.index(node[0], node[1], node[2]), w[0][i] * w[1][j] * w[2][k], d);
            }
        }
    }
}

/// P2G with the stress that `stress` gives each point.
pub fn p2g<T: Real>(grid: &Grid, points: &[Point<T>], dt: T, stress: impl Fn(usize) -> Mat3<T>) -> Nodes<T> {
    let [nodes] = p2g_parted(grid, points, dt, stress, |_, _| 0);
    nodes
}

/// P2G onto several sets of nodes (simulation.md §6.2): `set(p, node)` is the one in which point `p` finds a node.
pub fn p2g_parted<T: Real, const SETS: usize>(
    grid: &Grid,
    points: &[Point<T>],
    dt: T,
    stress: impl Fn(usize) -> Mat3<T>,
    set: impl Fn(usize, usize) -> usize,
) -> [Nodes<T>; SETS] {
    let empty = || Nodes { mass: vec![T::zero(); grid.len()], motion: vec![[T::zero(); 3]; grid.len()] };
    let mut sets: [Nodes<T>; SETS] = std::array::from_fn(|_| empty());
    let d = T::of(4.0 / (grid.spacing * grid.spacing));
    for (p, point) in points.iter().enumerate() {
        let a = mat3::add(mat3::scale(stress(p), -dt * point.volume * d), mat3::scale(point.affine, point.mass));
        let mv = vec3::scale(point.velocity, point.mass);
        stencil(grid, point.xi, |node, w, d| {
            let nodes = &mut sets[set(p, node)];
            nodes.mass[node] += w * point.mass;
            nodes.motion[node] = vec3::add_scaled(nodes.motion[node], vec3::add(mv, mat3::mul_vec(a, d)), w);
        });
    }
    sets
}

/// Momenta to velocities, plus `dt · gravity`.
pub fn update<T: Real>(nodes: &mut Nodes<T>, dt: T, gravity: Vec3<T>) {
    for (m, v) in nodes.mass.iter().zip(&mut nodes.motion) {
        if *m > T::zero() {
            *v = vec3::add_scaled(vec3::scale(*v, m.recip()), gravity, dt);
        }
    }
}

/// Velocity and affine matrix at a position.
pub fn g2p<T: Real>(grid: &Grid, nodes: &Nodes<T>, xi: Vec3<T>) -> (Vec3<T>, Mat3<T>) {
    g2p_parted(grid, std::slice::from_ref(nodes), xi, |_| 0)
}

/// G2P out of several sets of nodes: `set(node)` is the one in which the point finds a node.
pub fn g2p_parted<T: Real>(grid: &Grid, sets: &[Nodes<T>], xi: Vec3<T>, set: impl Fn(usize) -> usize) -> (Vec3<T>, Mat3<T>) {
    let mut v = [T::zero(); 3];
    let mut c = [[T::zero(); 3]; 3];
    let scale = T::of(4.0 / (grid.spacing * grid.spacing));
    stencil(grid, xi, |node, w, d| {
        let motion = sets[set(node)].motion[node];
        v = vec3::add_scaled(v, motion, w);
        c = mat3::add(c, mat3::scale(mat3::outer(motion, d), w * scale));
    });
    (v, c)
}
