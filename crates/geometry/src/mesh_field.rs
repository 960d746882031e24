//! A triangle mesh as distances on a grid (simulation.md §6.1).
//!
//! Within [`BAND`] spacings of the surface distances are exact; further out they spread by sweeping. The sign is the
//! generalised winding number, so that a mesh with holes has an inside all the same; the surface that closes a hole lies where
//! the number is one half. Parts thinner than two spacings, among them sheets that enclose nothing, would let material through:
//! they become two spacings thick.

use std::collections::HashMap;

use megas_math::{Vec3, vec3};
use megas_model::Mesh;
use rayon::prelude::*;

use crate::bvh::Triangle;
use crate::sweep::sweep;
use crate::winding::area_normal;
use crate::{Field, MeshDistance, MeshError};

/// Spacings from the surface within which distances are exact.
const BAND: f64 = 3.0;
/// Empty spacings around the mesh.
const MARGIN: f64 = 4.0;
/// Most nodes of a field.
const MOST_NODES: usize = 1 << 26;
/// Smallest thickness of a solid \[spacings\].
const THICK: f64 = 2.0;
/// Steps per spacing in which thickness is measured.
const PROBES: usize = 4;

/// A mesh sampled on a grid, and what was found on the way.
#[derive(Clone, Debug)]
pub struct MeshField {
    /// Signed distances, negative inside.
    pub field: Field,
    /// Every edge joins exactly two triangles that agree about the outside.
    pub closed: bool,
    /// Share of the surface that was thinner than two spacings and has been thickened, 0–1.
    pub thickened: f64,
}

/// Samples the signed distance of `mesh` on a grid of the given spacing around it, or around the part of it inside `within`
/// (smallest and largest corner).
pub fn mesh_field(mesh: &Mesh, spacing: f64, within: Option<(Vec3<f64>, Vec3<f64>)>) -> Result<MeshField, MeshError> {
    let surface = MeshDistance::new(mesh)?;
    let (mut lo, mut hi) = surface.bounds();
    if let Some((low, high)) = within {
        (lo, hi) = (vec3::max(lo, low), vec3::min(hi, high));
        if (0..3).any(|a| lo[a] > hi[a]) {
            return Err(MeshError::Grid(format!("the mesh, which reaches from {lo:.3?} to {hi:.3?}, lies outside the simulation box")));
        }
    }
    let origin = lo.map(|v| v - MARGIN * spacing);
    let nodes: [usize; 3] = std::array::from_fn(|a| ((hi[a] - lo[a]) / spacing + 2.0 * MARGIN).ceil().min(1e9) as usize + 1);
    let len = nodes.iter().try_fold(1usize, |n, &m| n.checked_mul(m)).filter(|&n| n <= MOST_NODES);
    let Some(len) = len else {
        return Err(MeshError::Grid(format!(
            "a mesh of {nodes:?} cells of {spacing:.2e} m is too large; make it smaller or use fewer cells"
        )));
    };
    let position = |n: usize| -> Vec3<f64> {
        let c = [n / nodes[2] / nodes[1], n / nodes[2] % nodes[1], n % nodes[2]];
        std::array::from_fn(|a| origin[a] + spacing * c[a] as f64)
    };
    let reach = BAND * spacing;
    let mut distance: Vec<f32> = (0..len)
        .into_par_iter()
        .with_min_len(256)
        .map(|n| surface.distance_within(position(n), reach).map_or(f32::INFINITY, |d| d as f32))
        .collect();
    let closed = is_closed(mesh);
    let mut winding = vec![0.0f32; len];
    winding.par_chunks_mut(nodes[2]).zip(distance.par_chunks(nodes[2])).enumerate().for_each(|(row, (w, d))| {
        for k in 0..w.len() {
            // No surface passes between two far neighbours of a closed mesh.
            let same = closed && k > 0 && d[k].is_infinite() && d[k - 1].is_infinite();
            w[k] = if same { w[k - 1] } else { surface.winding_number(position(row * nodes[2] + k)).abs() as f32 };
        }
    });
    let mut fixed: Vec<bool> = distance.iter().map(|d| d.is_finite()).collect();
    if !closed {
        close_holes(&mut distance, &mut fixed, &winding, nodes, spacing);
    }
    sweep(&mut distance, &fixed, nodes, spacing);
    let far = (vec3::norm(vec3::sub(hi, lo)) + 2.0 * MARGIN * spacing) as f32;
    for (d, w) in distance.iter_mut().zip(&winding) {
        // Nothing anywhere near: the surface lies outside `within`.
        *d = d.min(far);
        if *w > 0.5 {
            *d = -*d;
        }
    }
    let (sheets, thickened) = thin_parts(&surface, spacing);
    if let Ok(middle) = MeshDistance::from_triangles(&sheets) {
        let half = 0.5 * THICK * spacing;
        distance.par_iter_mut().enumerate().with_min_len(256).for_each(|(n, d)| {
            if let Some(to_middle) = middle.distance_within(position(n), reach + half) {
                *d = d.min((to_middle - half) as f32);
            }
        });
    }
    let field = Field::new(origin, spacing, nodes, distance).ok_or_else(|| MeshError::Grid("the mesh has no usable extent".into()))?;
    Ok(MeshField { field, closed, thickened })
}

/// True if every edge is walked once in each direction. Corners count as one where they lie in the same place.
fn is_closed(mesh: &Mesh) -> bool {
    let mut places: HashMap<[u32; 3], u32> = HashMap::new();
    let mut edges: HashMap<(u32, u32), i32> = HashMap::new();
    for t in &mesh.triangles {
        let c = t.map(|i| {
            // Adding zero turns −0 into 0.
            let key = mesh.positions[i as usize].map(|v| (v + 0.0).to_bits());
            let next = places.len() as u32;
            *places.entry(key).or_insert(next)
        });
        for (a, b) in [(c[0], c[1]), (c[1], c[2]), (c[2], c[0])] {
            if a != b {
                *edges.entry((a.min(b), a.max(b))).or_default() += if a < b { 1 } else { -1 };
            }
        }
    }
    edges.values().all(|&sum| sum == 0)
}

/// Where the winding number passes one half between two nodes that are far from all triangles, a hole is closed there.
fn close_holes(distance: &mut [f32], fixed: &mut [bool], winding: &[f32], nodes: [usize; 3], spacing: f64) {
    let strides = [nodes[1] * nodes[2], nodes[2], 1];
    let h = spacing as f32;
    let triangles = distance.to_vec();
    for n in 0..distance.len() {
        let c = [n / strides[0], n / nodes[2] % nodes[1], n % nodes[2]];
        for a in 0..3 {
            let m = n + strides[a];
            if c[a] + 1 == nodes[a] || (winding[n] > 0.5) == (winding[m] > 0.5) || triangles[n] + triangles[m] < 1.5 * h {
                continue;
            }
            let crossing = (0.5 - winding[n]) / (winding[m] - winding[n]);
            for (i, d) in [(n, crossing * h), (m, (1.0 - crossing) * h)] {
                distance[i] = distance[i].min(d);
                fixed[i] = true;
            }
        }
    }
    // Band nodes may be nearer to a closed hole than to the rim: the sweep may lower what is not next to either.
    for n in 0..distance.len() {
        if fixed[n] && distance[n] > 2.0 * h {
            fixed[n] = false;
        }
    }
}

/// Middle surface of everything thinner than [`THICK`] spacings, in pieces of about one spacing, and its share of the area.
fn thin_parts(surface: &MeshDistance, spacing: f64) -> (Vec<Triangle>, f64) {
    let pieces: Vec<(f64, Option<Triangle>)> = surface
        .triangles()
        .par_iter()
        .flat_map_iter(|t| split(t, spacing))
        .map(|t| {
            let n = area_normal(&t);
            let area = vec3::norm(n);
            let Some(n) = Some(vec3::normalize_or(n, [0.0; 3])).filter(|n| *n != [0.0; 3]) else { return (0.0, None) };
            (area, thickness(surface, &t, n, spacing).map(|s| t.map(|x| vec3::add_scaled(x, n, 0.5 * s))))
        })
        .collect();
    let total: f64 = pieces.iter().map(|p| p.0).sum();
    let thin: f64 = pieces.iter().filter(|p| p.1.is_some()).map(|p| p.0).sum();
    (pieces.into_iter().filter_map(|p| p.1).collect(), if total > 0.0 { thin / total } else { 0.0 })
}

/// Signed way from a piece of surface along `n` to the other side of the solid, if that is nearer than [`THICK`] spacings; zero
/// for a sheet with nothing on either side.
fn thickness(surface: &MeshDistance, t: &Triangle, n: Vec3<f64>, spacing: f64) -> Option<f64> {
    let center = vec3::scale(vec3::add(vec3::add(t[0], t[1]), t[2]), 1.0 / 3.0);
    let solid = |s: f64| surface.winding_number(vec3::add_scaled(center, n, s)).abs() > 0.5;
    let near = 1e-3 * spacing;
    let side = match (solid(-near), solid(near)) {
        (true, true) => return None,
        (false, false) => return Some(0.0),
        (true, false) => -1.0,
        (false, true) => 1.0,
    };
    (1..=THICK as usize * PROBES)
        .map(|k| side * spacing * k as f64 / PROBES as f64)
        .find(|&s| !solid(s))
        .map(|s| s - side * 0.5 * spacing / PROBES as f64)
}

/// Cuts a triangle into pieces with sides of at most `longest`.
fn split(t: &Triangle, longest: f64) -> Vec<Triangle> {
    let side = [(0, 1), (1, 2), (2, 0)].map(|(a, b)| vec3::norm(vec3::sub(t[a], t[b]))).into_iter().fold(0.0, f64::max);
    let n = (side / longest).ceil().clamp(1.0, 1024.0) as usize;
    let at = |i: usize, j: usize| {
        let (u, v) = (i as f64 / n as f64, j as f64 / n as f64);
        std::array::from_fn(|a| t[0][a] + u * (t[1][a] - t[0][a]) + v * (t[2][a] - t[0][a]))
    };
    let mut out = Vec::with_capacity(n * n);
    for i in 0..n {
        for j in 0..n - i {
            out.push([at(i, j), at(i + 1, j), at(i, j + 1)]);
            if i + j + 1 < n {
                out.push([at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)]);
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;
    use std::sync::Arc;

    use megas_math::rng::Rng;

    use super::*;
    use crate::Shape;

    /// A box by its corners, twelve triangles facing out.
    fn block(lo: [f32; 3], hi: [f32; 3]) -> Mesh {
        let positions = (0..8).map(|i| std::array::from_fn(|a| if i >> a & 1 == 1 { hi[a] } else { lo[a] })).collect();
        let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
        let triangles = quads.iter().flat_map(|q| [[q[0], q[1], q[2]], [q[0], q[2], q[3]]]).collect();
        Mesh { positions, triangles, ..Mesh::default() }
    }

    fn ball(n: usize) -> Mesh {
        let mut mesh = Mesh::default();
        for i in 0..=n {
            for k in 0..2 * n {
                let (lat, lon) = (PI * i as f64 / n as f64, PI * k as f64 / n as f64);
                mesh.positions.push([lat.sin() * lon.cos(), lat.sin() * lon.sin(), lat.cos()].map(|v| (v * 1e6).round() as f32 / 1e6));
                if i < n {
                    let at = |i: usize, k: usize| (i * 2 * n + k % (2 * n)) as u32;
                    mesh.triangles.push([at(i, k), at(i + 1, k), at(i + 1, k + 1)]);
                    mesh.triangles.push([at(i, k), at(i + 1, k + 1), at(i, k + 1)]);
                }
            }
        }
        mesh
    }

    fn worst(field: &Field, reach: f64, exact: impl Fn(Vec3<f64>) -> f64) -> f64 {
        let shape = Shape::Field(Arc::new(field.clone()));
        let mut rng = Rng::new(5);
        let (lo, hi) = field.bounds();
        let mut worst = 0.0f64;
        for _ in 0..4000 {
            let x = std::array::from_fn(|a| rng.range(lo[a], hi[a]));
            let d = exact(x);
            if d.abs() < reach {
                worst = worst.max((shape.distance(x).0 - d).abs());
            }
        }
        worst
    }

    #[test]
    fn fields_of_meshes_agree_with_shapes() {
        let f = mesh_field(&ball(40), 0.1, None).unwrap();
        assert!(f.closed && f.thickened == 0.0);
        let error = worst(&f.field, 0.2, |x| vec3::norm(x) - 1.0);
        assert!(error < 0.004, "{error}");
        // Swept distances further away.
        let error = worst(&f.field, 9.0, |x| vec3::norm(x) - 1.0);
        assert!(error < 0.08, "{error}");
        let f = mesh_field(&block([-1.0, -0.5, -0.8], [1.0, 0.5, 0.4]), 0.1, None).unwrap();
        let exact = Shape::aligned_box([-1.0, -0.5, -0.8], [1.0, 0.5, 0.4]);
        assert!(f.closed && f.thickened == 0.0);
        // Interpolation rounds edges by a fraction of a cell.
        let error = worst(&f.field, 0.2, |x| exact.distance(x).0);
        assert!(error < 0.04, "{error}");
        let flat = |x: Vec3<f64>| if x[0].abs() < 0.7 && x[1].abs() < 0.2 { exact.distance(x).0 } else { 9.0 };
        let error = worst(&f.field, 0.2, flat);
        assert!(error < 1e-6, "{error}");
    }

    #[test]
    fn a_mesh_turned_inside_out_is_the_same_solid() {
        let mut mesh = ball(20);
        let f = mesh_field(&mesh, 0.1, None).unwrap();
        mesh.triangles.iter_mut().for_each(|t| t.swap(0, 1));
        let g = mesh_field(&mesh, 0.1, None).unwrap();
        let differ = f.field.values().iter().zip(g.field.values()).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(differ < 1e-6);
    }

    #[test]
    fn a_large_hole_is_closed_smoothly() {
        let mut mesh = ball(40);
        // A cap of 37°: the rim has radius 0.6 at z = 0.8.
        mesh.triangles.retain(|t| t.iter().any(|&i| mesh.positions[i as usize][2] < 0.8));
        let f = mesh_field(&mesh, 0.1, None).unwrap();
        assert!(!f.closed);
        let shape = Shape::Field(Arc::new(f.field));
        assert!(
            worst(
                match &shape {
                    Shape::Field(f) => f,
                    _ => unreachable!(),
                },
                0.15,
                |x| if x[2] < 0.4 { vec3::norm(x) - 1.0 } else { 9.0 }
            ) < 0.01
        );
        // Along the axis the distance passes zero once, between the rim's plane and the ball, with a slope near one.
        let along = |z: f64| shape.distance([0.0, 0.0, z]);
        let zero = (0..100).map(|i| 0.5 + 0.01 * f64::from(i)).find(|&z| along(z).0 > 0.0).unwrap();
        assert!((0.78..1.02).contains(&zero), "{zero}");
        for z in [zero - 0.25, zero - 0.1, zero + 0.1, zero + 0.25] {
            let (d, n) = along(z);
            assert!((d - (z - zero)).abs() < 0.05 && n[2] > 0.95, "{z} {zero}: {d} {n:?}");
        }
    }

    #[test]
    fn thin_plates_and_open_sheets_become_two_cells_thick() {
        let plate = mesh_field(&block([-1.0, -1.0, -0.02], [1.0, 1.0, 0.02]), 0.1, None).unwrap();
        assert!(plate.closed && plate.thickened > 0.9, "{}", plate.thickened);
        let sheet = Mesh {
            positions: vec![[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]],
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            ..Mesh::default()
        };
        let sheet = mesh_field(&sheet, 0.1, None).unwrap();
        assert!(!sheet.closed && sheet.thickened == 1.0);
        for f in [plate, sheet] {
            let shape = Shape::Field(Arc::new(f.field));
            for (x, y) in [(0.0, 0.0), (0.33, -0.51), (-0.7, 0.7)] {
                // Nodes on either side of the middle plane see the plate's own distance or the thickened one.
                // Where no node lies in the middle plane, interpolation cuts the tip of the distance off.
                assert!((-0.13..-0.045).contains(&shape.distance([x, y, 0.0]).0));
                let (d, n) = shape.distance([x, y, 0.27]);
                assert!((d - 0.17).abs() < 0.02 && n[2] > 0.99, "{d}");
                assert!(shape.distance([x, y, -0.27]).1[2] < -0.99);
            }
        }
    }

    #[test]
    fn impossible_meshes_are_refused() {
        assert_eq!(mesh_field(&Mesh::default(), 0.1, None).unwrap_err(), MeshError::Empty);
        let far = Some(([5.0; 3], [6.0; 3]));
        assert!(matches!(mesh_field(&ball(4), 0.1, far), Err(MeshError::Grid(_))));
        assert!(matches!(mesh_field(&ball(4), 1e-6, None), Err(MeshError::Grid(_))));
    }
}
