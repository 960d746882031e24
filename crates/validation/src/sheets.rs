//! V49: thin sheets (simulation.md §6.2).

use std::sync::Arc;

use megas_math::{mat3, vec3};
use megas_model::Mesh;
use megas_sim::collider::{Collider, Mode, Shape, Sheet};
use megas_sim::grid::Grid;
use megas_sim::mechanics::{Mechanics, Settings};
use megas_sim::particles::Particles;
use megas_sim::schedule::{Motion, PoseKey};

use crate::mechanics::{GRAVITY, block, slide_on};
use crate::{Case, Outcome, Plot, Row, Tier};

/// The cases of this file.
pub const CASES: &[Case] = &[Case::new("V49", "thin sheets", Tier::B, sheets)
    .proves("that neither matter nor momentum passes a sheet without thickness, and that weight and friction are those of a thick obstacle")
    .setup(
        "Δx = 10 mm: a column of melt of 6 × 3 × 14 cells between a slip wall and a sheet; two bodies a quarter cell before and behind a \
         sheet, one of them thrown at it; V37's block on a sheet at 30°, level with the grid and tilted, one rectangle and a mesh; a block of yielding \
         material of 12 × 8 × 8 cells that a blade cuts in 0.5 s and then pushes apart by 5 cells",
    )
    .formula("p = ρgz; a = g (sin θ − μ cos θ), and rest where μ > tan θ; nothing beyond a sheet")];

const DX: f64 = 0.01;
/// Columns: along y, along z, and across x.
const ACROSS_X: [[f64; 3]; 3] = [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];

/// The rectangle across axis 2 of `axes`.
fn rectangle(center: [f64; 3], half: [f64; 2], axes: [[f64; 3]; 3]) -> Shape {
    let sheet = Sheet::across_box(center, [half[0], half[1], 1e-4], axes).unwrap_or_else(|e| panic!("{e}"));
    Shape::Sheet(Arc::new(sheet))
}

fn run(m: &mut Mechanics, p: &mut Particles, seconds: f64) {
    let coupling = 5e-3;
    for _ in 0..(seconds / coupling).round() as usize {
        let step = m.time_step(p, coupling);
        m.run(p, step.steps, step.dt);
    }
}

fn sheets() -> Outcome {
    let (mut rows, plot) = column();
    rows.extend(apart());
    rows.extend(slope());
    rows.extend(cut());
    Outcome::from(rows).plot(plot)
}

/// A melt that a sheet keeps on one side of the box, 0.3 cells beyond a plane of nodes.
fn column() -> (Vec<Row>, Plot) {
    // Faces of the box lie at nodes 2.
    let grid = Grid { origin: [-2.0 * DX; 3], spacing: DX, nodes: [20, 8, 24] };
    let (bulk, height, face) = (1e5, 14.0 * DX, 6.3 * DX);
    let mut p = block(&grid, [0.0; 3], [6.0 * DX, 3.0 * DX, height], 1000.0, 0.0, bulk);
    p.yield_stress.fill(0.0);
    p.viscosity.fill(4.0);
    p.liquid.fill(1.0);
    let sheet = Collider { mode: Mode::Slip, ..Collider::new(rectangle([face, 0.0, 0.0], [1.0; 2], ACROSS_X)) };
    let mut m = Mechanics::new(&grid, Settings { drag: 20.0, ..Settings::default() }, vec![sheet]);
    run(&mut m, &mut p, 0.6);
    let mut z: Vec<f64> = (0..p.len()).map(|i| p.position(i)[2]).collect();
    z.sort_by(f64::total_cmp);
    let top = z[z.len() - 36] + 0.25 * DX;
    let pressure = |i: usize| bulk * (1.0 - f64::from(p.volume_ratio(i)));
    let (mut sums, mut beyond, mut seen) = ([0.0; 2], 0.0, Vec::new());
    for i in 0..p.len() {
        let [x, y, z] = p.position(i);
        beyond = f64::max(beyond, (x - face) / DX);
        if z > 2.0 * DX && top - z > 2.0 * DX {
            sums = [sums[0] + pressure(i), sums[1] + 1000.0 * GRAVITY * (top - z)];
        }
        if x > 5.0 * DX && y < DX {
            seen.push([top - z, pressure(i)]);
        }
    }
    let plot = Plot::new("pressure of the melt beside the sheet", "depth [m]", "p [Pa]")
        .function("ρgz", 0.0, height, |z| 1000.0 * GRAVITY * z)
        .ours("points", seen);
    let rows = vec![
        Row::new("column: pressure over ρgz", 1.0, sums[0] / sums[1], 0.03),
        Row::new("column: farthest point beyond the sheet [cells]", 0.0, beyond, 1e-6),
    ];
    (rows, plot)
}

/// Two bodies on either side of a sheet, one thrown at it.
fn apart() -> Vec<Row> {
    let grid = Grid { origin: [0.0; 3], spacing: DX, nodes: [40, 24, 24] };
    let mut p = block(&grid, [0.1, 0.08, 0.08], [0.3, 0.16, 0.16], 1000.0, 1e4, 3e4);
    let thrown: Vec<bool> = (0..p.len()).map(|i| p.position(i)[0] < 0.2).collect();
    for i in (0..p.len()).filter(|i| thrown[*i]) {
        p.set_velocity(i, [0.3, 0.1, 0.0]);
        p.object[i] = 1;
    }
    let sheet = Collider { friction: 0.3, ..Collider::new(rectangle([0.2, 0.12, 0.12], [1.0; 2], ACROSS_X)) };
    let mut m = Mechanics::new(&grid, Settings { gravity: [0.0; 3], ..Settings::default() }, vec![sheet]);
    run(&mut m, &mut p, 0.05);
    let (mut speed, mut beyond) = (0.0, 0.0);
    for i in 0..p.len() {
        if p.object[i] == 1 {
            beyond = f64::max(beyond, (p.position(i)[0] - 0.2) / DX);
        } else {
            speed = f64::max(speed, vec3::norm(vec3::cast(p.velocity(i))));
        }
    }
    vec![
        Row::new("thrown body: farthest point beyond the sheet [cells]", 0.0, beyond, 1e-6),
        Row::new("body behind it: largest speed [m/s]", 0.0, speed, 0.0),
    ]
}

/// The block of V37 on sheets.
fn slope() -> Vec<Row> {
    let (sin, cos) = 30f64.to_radians().sin_cos();
    let tilted = [[cos, 0.0, sin], [0.0, 1.0, 0.0], [-sin, 0.0, cos]];
    let (level, pull, weight) = (mat3::identity(), [GRAVITY * sin, 0.0, -GRAVITY * cos], [0.0, 0.0, -GRAVITY]);
    let on = |friction, shape| Collider { friction, melt_sticks: false, ..Collider::new(shape) };
    // Squares of ten cells, cut into triangles.
    let mut mesh = Mesh::default();
    for i in 0..=20u32 {
        for j in 0..=10u32 {
            let x = [0.2 * (f64::from(i) - 10.0), 0.2 * (f64::from(j) - 5.0), 0.0];
            mesh.positions.push(vec3::cast(mat3::mul_vec(tilted, x)));
            if i < 20 && j < 10 {
                let a = i * 11 + j;
                mesh.triangles.extend([[a, a + 11, a + 12], [a, a + 12, a + 1]]);
            }
        }
    }
    let mesh = Shape::Sheet(Arc::new(Sheet::new(&mesh).unwrap_or_else(|e| panic!("{e}"))));
    let exact = GRAVITY * (sin - 0.3 * cos);
    let flat = || rectangle([0.0; 3], [2.0, 1.0], level);
    let turned = rectangle([0.0; 3], [2.0, 1.0], tilted);
    // A block that starts in contact with held nodes, as it does half a cell before a sheet, first settles while it creeps.
    let (_, way, dx) = slide_on(Collider { offset: 0.0, ..on(0.7, flat()) }, pull, level, 0.5);
    vec![
        Row::relative("sheet, μ 0.3: acceleration [m/s²]", exact, slide_on(on(0.3, flat()), pull, level, 0.3).0, 0.05),
        Row::relative("tilted sheet, μ 0.3: acceleration [m/s²]", exact, slide_on(on(0.3, turned), weight, tilted, 0.3).0, 0.05),
        Row::relative("tilted mesh, μ 0.3: acceleration [m/s²]", exact, slide_on(on(0.3, mesh), weight, tilted, 0.3).0, 0.05),
        Row::new("sheet, μ 0.7: way in 0.5 s [cells]", 0.0, way / dx, 0.1),
    ]
}

/// A block that a blade cuts and pushes apart.
fn cut() -> Vec<Row> {
    let grid = Grid { origin: [0.0; 3], spacing: DX, nodes: [40, 24, 36] };
    let mut p = block(&grid, [0.12, 0.08, 0.05], [0.24, 0.16, 0.13], 1000.0, 1e4, 5e4);
    p.yield_stress.fill(300.0);
    p.viscosity.fill(10.0);
    let floor = Collider { offset: 0.0, ..Collider::new(Shape::HalfSpace { point: [0.0, 0.0, 0.05], normal: [0.0, 0.0, 1.0] }) };
    let key = |time, translation| PoseKey { time, translation, rotation: [1.0, 0.0, 0.0, 0.0] };
    let blade = Collider {
        motion: Motion(vec![key(0.0, [0.0; 3]), key(0.5, [0.0, 0.0, -0.14]), key(1.0, [0.05, 0.0, -0.14])]),
        friction: 0.1,
        ..Collider::new(rectangle([0.18, 0.12, 0.245], [0.2, 0.08], ACROSS_X))
    };
    let mut m = Mechanics::new(&grid, Settings::default(), vec![floor, blade]);
    run(&mut m, &mut p, 0.5);
    let mut left = vec![false; p.len()];
    for i in 0..p.len() {
        left[p.id[i] as usize] = p.position(i)[0] < 0.18;
    }
    run(&mut m, &mut p, 0.5);
    let [mut stayed, mut pushed] = [f64::NEG_INFINITY, f64::INFINITY];
    for i in 0..p.len() {
        let x = p.position(i)[0];
        if left[p.id[i] as usize] { stayed = stayed.max((x - 0.18) / DX) } else { pushed = pushed.min((x - 0.23) / DX) }
    }
    vec![
        Row::new("cut: points of the left half beyond the cut [cells]", 0.0, stayed.max(0.0), 0.5),
        Row::new("cut: points of the right half behind the blade [cells]", 0.0, (-pushed).max(0.0), 1e-6),
    ]
}

#[cfg(test)]
mod tests {
    #[test]
    fn v49_thin_sheets() {
        crate::assert_case("V49");
    }
}
