//! V01, V02: transfers between points and nodes (simulation.md §8.1), through the production sweep in `f32` and through the
//! oracle in `f64`.

use megas_math::rng::Rng;
use megas_math::{Mat3, mat3, vec3};
use megas_sim::grid::Grid;
use megas_sim::mechanics::{Mechanics, Settings};
use megas_sim::particles::Particles;
use megas_sim::reference::{self, Point};

use crate::{Case, Outcome, Row, Tier};

/// Cases of this file.
pub const CASES: &[Case] = &[
    Case::new("V01", "conservation of mass, momentum and angular momentum", Tier::A, conservation)
        .proves("weights, scattering to the nodes and gathering from them")
        .setup(
            "10⁴ points at random places in 20³ cells, random masses, velocities and affine matrices; one step there and back, \
                through the production sweep (f32) and through the oracle (f64)",
        )
        .formula("Σm, Σmv and Σ x × mv + Σ m (Δx²/4) ε : C^{T} are the same before, on the nodes and after"),
    Case::new("V02", "linear velocity fields survive P2G and G2P", Tier::A, linear_fields)
        .proves("the signs and factors of the affine term")
        .setup("the same points with v = a + Mx and C = M; one step there and back")
        .formula("nodes and points reproduce a + Mx and M exactly; without C the field must be lost"),
];

const GRID: Grid = Grid { origin: [0.0; 3], spacing: 0.05, nodes: [32; 3] };
const DT: f64 = 1e-5;

/// 10⁴ points in a block of 20³ cells without stiffness; `motion` gives velocity and affine matrix at a position.
fn cloud(mut motion: impl FnMut(&mut Rng, [f64; 3]) -> ([f64; 3], Mat3<f64>)) -> Particles {
    let mut rng = Rng::new(1);
    let mut p = Particles::blank(&GRID, 10_000);
    for i in 0..p.len() {
        p.id[i] = i as u32;
        let x = std::array::from_fn(|_| GRID.spacing * rng.range(6.0, 26.0));
        p.set_position(i, x);
        p.mass[i] = rng.range(0.5, 2.0) as f32;
        let (v, c) = motion(&mut rng, p.position(i));
        p.set_velocity(i, vec3::cast(v));
        p.set_affine(i, mat3::cast(c));
    }
    p.sort();
    p
}

fn points(p: &Particles) -> Vec<Point<f64>> {
    (0..p.len())
        .map(|i| Point {
            xi: p.grid_coordinate(i),
            velocity: vec3::cast(p.velocity(i)),
            affine: mat3::cast(p.affine(i)),
            elastic: mat3::identity(),
            mass: p.mass[i].into(),
            volume: 0.0,
        })
        .collect()
}

/// Mass, momentum, and angular momentum `Σ x × m v + Σ m (Δx²/4) ε : Cᵀ` about the centre of the grid.
fn totals(points: &[Point<f64>]) -> (f64, [f64; 3], [f64; 3]) {
    let center = GRID.position([16; 3]);
    let mut sum = (0.0, [0.0; 3], [0.0; 3]);
    for q in points {
        sum.0 += q.mass;
        sum.1 = vec3::add_scaled(sum.1, q.velocity, q.mass);
        let x = vec3::sub(vec3::scale(q.xi, GRID.spacing), center);
        sum.2 = vec3::add_scaled(sum.2, vec3::cross(x, q.velocity), q.mass);
        let c = q.affine;
        let spin = [c[2][1] - c[1][2], c[0][2] - c[2][0], c[1][0] - c[0][1]];
        sum.2 = vec3::add_scaled(sum.2, spin, q.mass * GRID.spacing * GRID.spacing / 4.0);
    }
    sum
}

fn still() -> Settings {
    Settings { gravity: [0.0; 3], isolation: 0.0, ..Settings::default() }
}

fn conservation() -> Outcome {
    let mut p =
        cloud(|r, _| (std::array::from_fn(|_| r.range(-1.0, 2.0)), std::array::from_fn(|_| std::array::from_fn(|_| r.range(-10.0, 10.0)))));
    let mut oracle = points(&p);
    let before = totals(&oracle);
    let mut nodes = reference::p2g(&GRID, &oracle, DT, |_| [[0.0; 3]; 3]);
    let node_mass: f64 = nodes.mass.iter().sum();
    let node_momentum = nodes.motion.iter().fold([0.0; 3], |a, v| vec3::add(a, *v));
    reference::update(&mut nodes, DT, [0.0; 3]);
    for q in &mut oracle {
        (q.velocity, q.affine) = reference::g2p(&GRID, &nodes, q.xi);
        // Moving along v changes neither momentum nor angular momentum; done here as in production.
        q.xi = vec3::add_scaled(q.xi, q.velocity, DT / GRID.spacing);
    }
    let mut mechanics = Mechanics::new(&GRID, still(), Vec::new());
    mechanics.run(&mut p, 1, DT);
    let mut fast_mass = 0.0;
    let mut fast_momentum = [0.0; 3];
    mechanics.for_each_node(|_, m, v| {
        fast_mass += f64::from(m);
        fast_momentum = vec3::add_scaled(fast_momentum, vec3::cast(v), f64::from(m));
    });
    let compare = |name: &str, tol: f64, mass: f64, nodes: [f64; 3], after: (f64, [f64; 3], [f64; 3])| {
        let off = |a: [f64; 3], b: [f64; 3]| vec3::norm(vec3::sub(a, b)) / vec3::norm(b);
        vec![
            Row::new(format!("{name}: relative error of node mass"), 0.0, mass / before.0 - 1.0, tol),
            Row::new(format!("{name}: node momentum"), 0.0, off(nodes, before.1), tol),
            Row::new(format!("{name}: point momentum after G2P"), 0.0, off(after.1, before.1), tol),
            Row::new(format!("{name}: angular momentum after G2P"), 0.0, off(after.2, before.2), tol),
        ]
    };
    let mut rows = compare("f64", 1e-12, node_mass, node_momentum, totals(&oracle));
    rows.extend(compare("f32", 2e-6, fast_mass, fast_momentum, totals(&points(&p))));
    rows.into()
}

fn linear_fields() -> Outcome {
    let a = [0.3, -1.0, 0.7];
    let m: Mat3<f64> = [[1.0, -2.0, 0.5], [0.3, 1.5, -1.0], [2.0, 0.1, -0.7]];
    let field = |x: [f64; 3]| vec3::add(a, mat3::mul_vec(m, x));
    let fastest = vec3::norm(field([1.6; 3]));
    let mut p = cloud(|_, x| (field(x), m));
    let start: Vec<_> = points(&p).iter().map(|q| vec3::scale(q.xi, GRID.spacing)).collect();
    // Exact data for the oracle; production starts from values rounded to f32.
    let mut exact = points(&p);
    for (q, x) in exact.iter_mut().zip(&start) {
        (q.velocity, q.affine) = (field(*x), m);
    }
    let errors = |points: &[Point<f64>]| {
        let mut nodes = reference::p2g(&GRID, points, DT, |_| [[0.0; 3]; 3]);
        reference::update(&mut nodes, DT, [0.0; 3]);
        let (mut worst_node, mut worst_v, mut worst_c) = (0.0f64, 0.0f64, 0.0f64);
        for n in 0..GRID.len() {
            if nodes.mass[n] > 0.0 {
                worst_node = worst_node.max(vec3::norm(vec3::sub(nodes.motion[n], field(GRID.position(GRID.node(n))))));
            }
        }
        for (q, x) in points.iter().zip(&start) {
            let (v, c) = reference::g2p(&GRID, &nodes, q.xi);
            worst_v = worst_v.max(vec3::norm(vec3::sub(v, field(*x))));
            worst_c = worst_c.max(mat3::norm(mat3::sub(c, m)));
        }
        (worst_node / fastest, worst_v / fastest, worst_c / mat3::norm(m))
    };
    let e = errors(&exact);
    let mut rows = vec![
        Row::new("f64: relative error of node velocities", 0.0, e.0, 1e-12),
        Row::new("f64: velocity after G2P", 0.0, e.1, 1e-12),
        Row::new("f64: affine matrix after G2P", 0.0, e.2, 1e-12),
    ];
    let pic: Vec<_> = exact.iter().map(|q| Point { affine: [[0.0; 3]; 3], ..*q }).collect();
    let pic = errors(&pic).0;
    rows.push(Row::new("without affine matrix the field is lost (1 = error > 1e-3)", 1.0, f64::from(u8::from(pic > 1e-3)), 0.0));
    let mut mechanics = Mechanics::new(&GRID, still(), Vec::new());
    let order = p.id.clone();
    mechanics.run(&mut p, 1, DT);
    assert_eq!(order, p.id);
    let mut worst = 0.0f64;
    mechanics.for_each_node(|n, mass, v| {
        // Nodes below 1e-12 of a point's mass count as empty (§2.3).
        if mass > 4e-12 {
            worst = worst.max(vec3::norm(vec3::sub(vec3::cast(v), field(GRID.position(n)))));
        }
    });
    rows.push(Row::new("f32: relative error of node velocities", 0.0, worst / fastest, 2e-6));
    let (mut worst_v, mut worst_c) = (0.0f64, 0.0f64);
    for (q, x) in points(&p).iter().zip(&start) {
        worst_v = worst_v.max(vec3::norm(vec3::sub(q.velocity, field(*x))));
        worst_c = worst_c.max(mat3::norm(mat3::sub(q.affine, m)) * GRID.spacing);
    }
    rows.push(Row::new("f32: velocity after G2P", 0.0, worst_v / fastest, 2e-6));
    // C is a difference of node velocities over Δx, so its rounding is that of a velocity over Δx.
    rows.push(Row::new("f32: Δx · affine matrix after G2P, relative to speed", 0.0, worst_c / fastest, 2e-6));
    rows.into()
}

#[cfg(test)]
mod tests {
    #[test]
    fn v01_conservation() {
        crate::assert_case("V01");
    }

    #[test]
    fn v02_linear_fields() {
        crate::assert_case("V02");
    }
}
