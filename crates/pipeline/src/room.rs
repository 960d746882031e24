//! The simulated box: room for what melts to spread, and a warning when it reaches the sides all the same.

use megas_model::PointFrame;
use megas_scene::{AirMode, Scene};
use megas_sim::collider::SCENE_CONTACT_OFFSET;
use megas_sim::grid::{Grid, PADDING};
use megas_sim::material::{Law, Material};
use megas_sim::particles::MAX_NODES;

use crate::Failure;
use crate::body::BodyMeta;
use crate::colliders::support_height;

/// A sheet of melt thinner than this many cells spreads no further on the grid.
const THINNEST: f64 = 1.5;
/// Cells below the lowest point of the bodies.
const BELOW: f64 = 6.0;

/// Radius \[m\] of the puddle that everything that can melt or flow may end up in: where the yield stress holds a thin sheet
/// (Roussel and Coussot 2005, R⁵ = 225 ρ g V² / (128 π² τ)), at most where it is too thin for cells of `dx`.
/// `bodies` are volumes \[m³\] and what they are made of.
fn puddle<'a>(bodies: impl Iterator<Item = (f64, &'a Material)>, gravity: f64, dx: f64) -> f64 {
    let (mut volume, mut density, mut stress) = (0.0, 0.0f64, f64::INFINITY);
    for (v, m) in bodies.filter(|(_, m)| m.law == Law::Fluid || m.liquidus.is_finite()) {
        volume += v;
        density = density.max(m.density);
        stress = stress.min(m.melt.yield_stress);
    }
    let held = (225.0 * density * gravity * volume * volume / (128.0 * std::f64::consts::PI.powi(2) * stress)).powf(0.2);
    held.min((volume / (std::f64::consts::PI * THINNEST * dx)).sqrt())
}

/// The simulation box (simulation.md §0.1): room to spread at the sides, a little above, the support six cells above the
/// lowest nodes. A layer of nodes lies just below the contact level of the support: were it left to chance, the first nodes
/// that hold matter could be anywhere within a cell below that level, and matter would sink to them.
pub(crate) fn grid(scene: &Scene, meta: &BodyMeta, materials: &[Material]) -> Result<Grid, Failure> {
    let dx = meta.dx_m;
    let size: [f64; 3] = std::array::from_fn(|a| meta.box_max[a] - meta.box_min[a]);
    let longest = size.iter().copied().fold(0.0, f64::max);
    let room = scene.simulation.box_m;
    // Empty nodes cost nothing unless they hold air (docs/performance.md, c1).
    let spread = if matches!(scene.air.mode, AirMode::None | AirMode::Film) && scene.simulation.mechanics {
        let bodies = meta.objects.iter().map(|o| o.volume_m3).zip(materials);
        puddle(bodies, scene.simulation.gravity_m_s2, dx) + 4.0 * dx
    } else {
        0.0
    };
    let mut lo = [0.0; 3];
    let mut nodes = [0; 3];
    for a in 0..3 {
        let (below, above) = match (a, room) {
            (2, None) => (BELOW * dx, (8.0 * dx).max(0.5 * longest)),
            (2, Some(r)) => (BELOW * dx, (r[2] - size[2]).max(8.0 * dx)),
            (_, None) => {
                let most = 0.5 * ((MAX_NODES - 2) as f64 * dx - size[a]);
                let side = (8.0 * dx).max(0.8 * longest);
                let side = side.max((spread - 0.5 * size[a]).min(most));
                (side, side)
            }
            (_, Some(r)) => {
                let side = (0.5 * (r[a] - size[a])).max(8.0 * dx);
                (side, side)
            }
        };
        let bottom = if a == 2 { meta.support_z.min(meta.box_min[2]) } else { meta.box_min[a] };
        lo[a] = bottom - below;
        if a == 2 && scene.support.enabled {
            let contact = support_height(scene, meta) + (SCENE_CONTACT_OFFSET - 1e-3) * dx;
            lo[a] = contact - ((contact - lo[a]) / dx).ceil() * dx;
        }
        nodes[a] = ((meta.box_max[a] + above - lo[a]) / dx).ceil() as usize + 1;
        if nodes[a] > MAX_NODES {
            return Err(Failure::Input(format!(
                "the simulation box would have {} nodes along {}, more than {MAX_NODES}; use fewer cells or a smaller simulation.box_m",
                nodes[a],
                ["x", "y", "z"][a]
            )));
        }
    }
    Ok(Grid { origin: lo, spacing: dx, nodes })
}

/// What stands at a side of the space as at a wall, told to the user; `None` while there is little of it.
pub(crate) fn confined(frame: &PointFrame, grid: &Grid) -> Option<String> {
    // Nodes in the padding layers let nothing out; they stop a point a node and a half before.
    let reach = (PADDING as f64 + 0.75) * grid.spacing;
    let size = grid.nodes.map(|n| (n - 1) as f64 * grid.spacing);
    let enough = (frame.position.len() / 2000).max(8);
    (0..3).flat_map(|a| [(a, -1.0), (a, 1.0)]).find_map(|(a, out)| {
        let wall = grid.origin[a] + if out > 0.0 { size[a] - reach } else { reach };
        let n = frame.position.iter().filter(|x| (f64::from(x[a]) - wall) * out > 0.0).count();
        (n >= enough).then(|| {
            format!(
                "at {:.2} s {n} points are at a side of the simulated space ({}{}) and stay there as at a wall; set simulation.box_m, with \
                 more than [{:.3}, {:.3}, {:.3}]",
                frame.time,
                if out > 0.0 { '+' } else { '-' },
                ["x", "y", "z"][a],
                size[0],
                size[1],
                size[2] - BELOW * grid.spacing
            )
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wax(stress: f64) -> Material {
        Material {
            law: Law::Hencky,
            density: 1000.0,
            liquidus: 330.0,
            melt: megas_sim::material::Rheology { yield_stress: stress, consistency: 1.0, index: 1.0 },
            ..Material::default()
        }
    }

    #[test]
    fn a_puddle_is_held_by_its_yield_stress_or_by_the_cells() {
        // V37: a litre of 50 Pa.
        let (m, never) = (wax(50.0), Material { liquidus: f64::INFINITY, ..wax(50.0) });
        let held = puddle([(1e-3, &m), (5e-3, &never)].into_iter(), 9.81, 1e-3);
        assert!((held.powi(5) * 128.0 * std::f64::consts::PI.powi(2) * 50.0 / (225.0 * 1000.0 * 9.81 * 1e-6) - 1.0).abs() < 1e-9, "{held}");
        let thin = puddle([(1e-3, &wax(0.0))].into_iter(), 9.81, 1e-3);
        assert!((std::f64::consts::PI * thin * thin * THINNEST * 1e-3 - 1e-3).abs() < 1e-12);
        assert!(puddle([(1e-3, &never)].into_iter(), 9.81, 1e-3) == 0.0);
    }

    #[test]
    fn what_leans_on_a_side_is_told() {
        let grid = Grid { origin: [-0.02; 3], spacing: 1e-3, nodes: [41; 3] };
        let mut frame = PointFrame { time: 1.5, position: vec![[0.0; 3]; 1000], ..PointFrame::default() };
        assert_eq!(confined(&frame, &grid), None);
        frame.position[..20].fill([0.0, -0.0165, 0.0]);
        let told = confined(&frame, &grid).expect("a warning");
        assert!(told.contains("1.50 s 20 points") && told.contains("(-y)") && told.contains("[0.040, 0.040, 0.034]"), "{told}");
    }
}
