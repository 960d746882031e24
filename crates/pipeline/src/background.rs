//! The reconstructed background as a solid (simulation.md §6.1, splatting.md §5.11): its depth, seen from many sides, fused
//! into signed distances over the simulation box.

use std::sync::Arc;

use megas_geometry::Field;
use megas_math::{Vec3, vec3};
use megas_model::{Camera, Splats, fibonacci_directions};
use megas_raster::{Channels, Frame, Gaussians, Rasterizer, Settings};
use megas_sim::collider::Shape;
use megas_sim::grid::Grid;
use rayon::prelude::*;

use crate::body::Bodies;
use crate::scenery::standing;

/// Directions on the whole sphere; those from above are used.
const DIRECTIONS: usize = 96;
/// Least height of a view, as the sine of its elevation: from below, a table is a ceiling.
const LEAST_HEIGHT: f32 = 0.25;
/// Pixels per node spacing.
const PIXELS: f64 = 2.0;
/// Largest picture \[px\].
const MOST_PIXELS: u32 = 1024;
/// Pixels with less alpha see nothing solid.
const LEAST_ALPHA: f32 = 0.9;
/// Distances are known, and solids reach behind their surface, this far \[node spacings\].
const TRUNCATION: f64 = 4.0;
/// What surfaces seen at a glancing angle count at least.
const LEAST_WEIGHT: f32 = 0.05;

/// The solid that the background splats bound, or `None` without any; scenery that moves is no part of it. Space that no view
/// has seen is free. Under the objects, where nobody can see, it is solid up to the height `support`.
pub fn background_shape(bodies: &Bodies, grid: &Grid, support: f64) -> Option<Shape> {
    let background = standing(&bodies.background);
    if background.is_empty() {
        return None;
    }
    let scale = bodies.meta.similarity.metres_per_unit;
    let views = look(&background, bodies, grid);
    let reach = TRUNCATION * grid.spacing;
    let footprint = |x: Vec3<f64>| {
        let margin = 2.0 * grid.spacing;
        (0..2).all(|a| x[a] > bodies.meta.box_min[a] - margin && x[a] < bodies.meta.box_max[a] + margin)
    };
    let fuse = |n: usize| {
        let x = grid.position(grid.node(n));
        let scene = vec3::cast(bodies.meta.similarity.to_scene(x));
        let (mut sum, mut weight) = (0.0, 0.0);
        for view in &views {
            if let Some((d, w)) = view.distance(scene) {
                let d = f64::from(d) * scale;
                // What lies further behind a surface is unknown: no shadows without end.
                if d > -reach {
                    sum += f64::from(w) * d.min(reach);
                    weight += f64::from(w);
                }
            }
        }
        let seen = if weight > 0.0 { sum / weight } else { reach };
        let ground = x[2] - support;
        let d = if footprint(x) && ground > -reach { seen.min(ground) } else { seen };
        d as f32
    };
    let mut distance: Vec<f32> = (0..grid.len()).into_par_iter().with_min_len(256).map(fuse).collect();
    blur(&mut distance, grid.nodes);
    clear_objects(&mut distance, bodies, grid);
    Field::new(grid.origin, grid.spacing, grid.nodes, distance).map(|f| Shape::Field(Arc::new(f)))
}

/// A picture of the background's surface.
struct View {
    camera: Camera,
    /// Depth of the surface \[scene units\] and how squarely it faces the view, per pixel; weight 0 where there is none.
    surface: Vec<(f32, f32)>,
}

impl View {
    /// Distance of a point in front of the surface that its pixel shows \[scene units\], and its weight.
    fn distance(&self, x: Vec3<f32>) -> Option<(f32, f32)> {
        let p = self.camera.to_camera(x);
        let [u, v] = self.camera.project(p);
        if p[2] <= 0.0 || u < 0.0 || v < 0.0 || u >= self.camera.width as f32 || v >= self.camera.height as f32 {
            return None;
        }
        let (depth, facing) = self.surface[v as usize * self.camera.width as usize + u as usize];
        // Along the ray it is farther to a slanting surface than straight to it.
        (facing > 0.0).then(|| ((depth - p[2]) * facing, facing))
    }
}

/// The background alone, from above, as far as the simulation box.
fn look(background: &Splats, bodies: &Bodies, grid: &Grid) -> Vec<View> {
    let similarity = &bodies.meta.similarity;
    let corner = grid.position(grid.nodes.map(|n| n - 1));
    let center: Vec3<f32> = vec3::cast(similarity.to_scene(vec3::lerp(grid.origin, corner, 0.5)));
    let half = 0.5 * vec3::norm(vec3::sub(corner, grid.origin)) / similarity.metres_per_unit;
    let side = ((2.0 * half * similarity.metres_per_unit / grid.spacing * PIXELS) as u32).clamp(16, MOST_PIXELS);
    let gaussians = Gaussians::from_splats(background);
    let settings = Settings { anti_aliased: bodies.meta.antialiased, ..Settings::default() };
    let mut rasterizer = Rasterizer::new();
    let mut frame = Frame::default();
    let up: Vec3<f32> = vec3::cast(similarity.direction_to_scene([0.0, 0.0, 1.0]));
    let from_above = fibonacci_directions(DIRECTIONS).into_iter().filter(|d| vec3::dot(*d, up) > LEAST_HEIGHT);
    from_above
        .map(|d| {
            let across = vec3::frame_from_normal(d).1;
            // The camera stands at the edge of the ball around the box: what is farther out does not hide it.
            let camera = Camera::orthographic(center, d.map(|v| -v), across, half as f32, half as f32, side, side);
            rasterizer.render(&gaussians, &camera, &settings, Channels::Geometry, &mut frame);
            let pixel = |i: usize| {
                let (depth, alpha) = (frame.planar_depth[i], frame.alpha(i));
                let facing = vec3::dot(vec3::normalize_or(frame.normal[i], d), d);
                if alpha < LEAST_ALPHA || !depth.is_finite() || depth <= 0.0 { (0.0, 0.0) } else { (depth, facing.max(LEAST_WEIGHT)) }
            };
            View { surface: (0..frame.planar_depth.len()).map(pixel).collect(), camera }
        })
        .collect()
}

/// Smooths once with (1, 2, 1)/4 along each axis.
fn blur(values: &mut Vec<f32>, nodes: [usize; 3]) {
    for (axis, stride) in [nodes[1] * nodes[2], nodes[2], 1].into_iter().enumerate() {
        let from = values.clone();
        values.par_iter_mut().enumerate().with_min_len(4096).for_each(|(n, v)| {
            let c = n / stride % nodes[axis];
            let before = if c > 0 { from[n - stride] } else { from[n] };
            let after = if c + 1 < nodes[axis] { from[n + stride] } else { from[n] };
            *v = 0.25 * (before + after) + 0.5 * from[n];
        });
    }
}

/// Objects do not start inside the background: nodes within half a spacing of their points are free.
fn clear_objects(distance: &mut [f32], bodies: &Bodies, grid: &Grid) {
    for x in &bodies.points.position {
        let node = grid.coordinate(*x).map(|c| c.round());
        if (0..3).all(|a| node[a] >= 0.0 && node[a] < grid.nodes[a] as f64) {
            let node = node.map(|c| c as usize);
            if vec3::norm(vec3::sub(grid.position(node), *x)) < 0.5 * grid.spacing {
                let d = &mut distance[grid.index(node[0], node[1], node[2])];
                *d = d.max(0.0);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use megas_math::mat3;
    use megas_metrics::assets::{Part, Sprinkle, Sundae};
    use megas_model::{Points, Similarity};

    use super::*;
    use crate::body::BodyMeta;

    #[test]
    fn the_table_of_the_embedded_scene_becomes_solid_and_the_air_stays_free() {
        let sundae = Sundae::new();
        let splats = sundae.sprinkle(&Sprinkle { spacing: 0.03, table_spacing: 0.03, sh_degree: 0, ..Sprinkle::default() });
        let table: Vec<usize> = (0..splats.len()).filter(|&i| splats.object_id[i] == Part::Table as u16).collect();
        // One scene unit is 0.1 m; the box is wider than the table, whose edge is at 1.34 units.
        let meta = BodyMeta {
            similarity: Similarity { metres_per_unit: 0.1, rotation: mat3::identity(), origin: [0.0; 3] },
            box_min: [-0.086, -0.086, 0.0],
            box_max: [0.086, 0.086, 0.158],
            support_z: 0.0,
            dx_m: 0.006,
            antialiased: true,
            objects: Vec::new(),
        };
        let bodies = Bodies {
            meta,
            surface: splats.select(&[]),
            internal_rgb: Vec::new(),
            background: splats.select(&table),
            points: Points::default(),
        };
        let grid = Grid { origin: [-0.18, -0.18, -0.05], spacing: 0.006, nodes: [61, 61, 40] };
        let shape = background_shape(&bodies, &grid, 0.0).unwrap();
        let mut worst = 0.0f64;
        for i in 0..40 {
            for j in 0..40 {
                let (x, y) = (-0.12 + 0.006 * f64::from(i), -0.12 + 0.006 * f64::from(j));
                if x.hypot(y) < 0.115 {
                    // The top: distance from two cells below to three above, and its normal.
                    for z in [-0.012, -0.006, 0.006, 0.018] {
                        let (d, n) = shape.distance([x, y, z]);
                        worst = worst.max((d - z).abs());
                        assert!(n[2] > 0.9, "{x} {y} {z}: {d} {n:?}");
                    }
                }
            }
        }
        assert!(worst < 0.5 * grid.spacing, "{worst}");
        // Beside the table and high above it there is nothing.
        for x in [[0.0, 0.0, 0.1], [0.17, 0.0, 0.01], [0.0, -0.17, -0.02], [0.1, 0.1, 0.15]] {
            assert!(shape.distance(x).0 > 0.006, "{x:?} {}", shape.distance(x).0);
        }
    }
}
