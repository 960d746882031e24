//! Thin sheets: one open layer of triangles with two sides and nothing in between (simulation.md §6.2).
//!
//! The side of a point is the sign of its offset from the closest point along the normal there: that of the triangle, the sum
//! of both triangles at an edge, the sum weighted with the angles at a corner (Bærentzen and Aanæs 2005), so that it is right at
//! folds too. A point whose closest point lies on the rim is beyond the sheet and has no side.

use std::collections::HashMap;

use megas_math::{Mat3, Vec3, mat3, vec3};
use megas_model::Mesh;

use crate::MeshError;
use crate::bvh::{Bvh, Triangle};
use crate::distance::{Feature, closest_feature, nearest, triangles_of};
use crate::winding::area_normal;

/// Where a point is against a sheet.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OnSheet {
    /// Distance to the sheet \[mesh units\], ≥ 0 on the side that [`OnSheet::normal`] points to.
    pub distance: f64,
    /// Unit normal at the closest point, the same way on both sides; the gradient of `distance`.
    pub normal: Vec3<f64>,
    /// The closest point.
    pub point: Vec3<f64>,
    /// The closest point lies on the rim: the sheet does not reach to here, and `distance` has no meaningful sign.
    pub rim: bool,
}

/// What belongs to the edges (`ab`, `bc`, `ca`) and corners of a triangle: direction to the positive side, and whether they are
/// part of the rim.
#[derive(Clone, Debug, PartialEq)]
struct Face {
    normal: Vec3<f64>,
    edges: [(Vec3<f64>, bool); 3],
    corners: [(Vec3<f64>, bool); 3],
}

/// A thin sheet, prepared for many queries. It has two sides, told apart by the order of the corners of its triangles.
#[derive(Clone, Debug)]
pub struct Sheet {
    tree: Bvh,
    /// By the order of the tree's triangles.
    faces: Vec<Face>,
    /// Distance below which the direction of an offset means nothing.
    rounding: f64,
}

impl PartialEq for Sheet {
    fn eq(&self, o: &Self) -> bool {
        self.tree.triangles == o.tree.triangles && self.faces == o.faces
    }
}

impl Sheet {
    /// A sheet of the triangles of a mesh. Corners in the same place are one; triangles that face the other way than their
    /// neighbours are turned round; those without area are left out. Fails where the mesh is closed, has only one side or several
    /// pieces, or edges where more than two triangles meet.
    pub fn new(mesh: &Mesh) -> Result<Self, MeshError> {
        Self::from_triangles(&triangles_of(mesh)?)
    }

    /// The rectangle in the middle of a box, across its thinnest side: centre, half edge lengths, and axes as columns.
    pub fn across_box(center: Vec3<f64>, half: Vec3<f64>, axes: Mat3<f64>) -> Result<Self, MeshError> {
        let thin = (0..3).fold(0, |best, a| if half[a] < half[best] { a } else { best });
        let side = |a: usize| vec3::scale(mat3::column(axes, a), half[a]);
        let (u, v) = (side((thin + 1) % 3), side((thin + 2) % 3));
        let at = |s: f64, t: f64| vec3::add_scaled(vec3::add_scaled(center, u, s), v, t);
        Self::from_triangles(&[[at(-1.0, -1.0), at(1.0, -1.0), at(1.0, 1.0)], [at(-1.0, -1.0), at(1.0, 1.0), at(-1.0, 1.0)]])
    }

    fn from_triangles(triangles: &[Triangle]) -> Result<Self, MeshError> {
        let mut places: HashMap<[u64; 3], u32> = HashMap::new();
        let mut kept: Vec<Triangle> = Vec::new();
        let mut corners: Vec<[u32; 3]> = Vec::new();
        for t in triangles {
            let c = t.map(|x| {
                // Adding zero turns −0 into 0.
                let next = places.len() as u32;
                *places.entry(x.map(|v| (v + 0.0).to_bits())).or_insert(next)
            });
            if vec3::norm(area_normal(t)) > 0.0 && c[0] != c[1] && c[1] != c[2] && c[2] != c[0] {
                kept.push(*t);
                corners.push(c);
            }
        }
        if kept.is_empty() {
            return Err(MeshError::Empty);
        }
        orient(&mut kept, &mut corners)?;
        let normals: Vec<Vec3<f64>> = kept.iter().map(|t| vec3::normalize_or(area_normal(t), [0.0; 3])).collect();
        let mut edges: HashMap<(u32, u32), (Vec3<f64>, u32)> = HashMap::new();
        let mut vertices: HashMap<u32, (Vec3<f64>, bool)> = HashMap::new();
        for ((t, c), n) in kept.iter().zip(&corners).zip(&normals) {
            for k in 0..3 {
                let e = edges.entry(edge(c, k)).or_insert(([0.0; 3], 0));
                *e = (vec3::add(e.0, *n), e.1 + 1);
                let v = vertices.entry(c[k]).or_insert(([0.0; 3], false));
                let [a, b] = [1, 2].map(|o| vec3::sub(t[(k + o) % 3], t[k]));
                let angle = vec3::norm(vec3::cross(a, b)).atan2(vec3::dot(a, b));
                v.0 = vec3::add_scaled(v.0, *n, angle);
            }
        }
        for (&(a, b), &(_, count)) in &edges {
            if count == 1 {
                for v in [a, b] {
                    if let Some(v) = vertices.get_mut(&v) {
                        v.1 = true;
                    }
                }
            }
        }
        let face = |k: usize| {
            let (c, normal) = (&corners[k], normals[k]);
            let unit = |v: Vec3<f64>| vec3::normalize_or(v, normal);
            Face {
                normal,
                edges: std::array::from_fn(|i| edges.get(&edge(c, i)).map_or((normal, true), |e| (unit(e.0), e.1 == 1))),
                corners: std::array::from_fn(|i| vertices.get(&c[i]).map_or((normal, true), |v| (unit(v.0), v.1))),
            }
        };
        let tree = Bvh::new(&kept);
        let faces = tree.index.iter().map(|&k| face(k as usize)).collect();
        let rounding = 1e-6 * vec3::norm(vec3::sub(tree.nodes[0].high, tree.nodes[0].low));
        Ok(Self { tree, faces, rounding })
    }

    /// Smallest and largest corner of the box around it.
    pub fn bounds(&self) -> (Vec3<f64>, Vec3<f64>) {
        (self.tree.nodes[0].low, self.tree.nodes[0].high)
    }

    /// Where `x` is, if the sheet is nearer than `reach`.
    pub fn near(&self, x: Vec3<f64>, reach: f64) -> Option<OnSheet> {
        let limit2 = reach * reach;
        let (d2, _, k) = nearest(&self.tree, x, limit2);
        if d2 >= limit2 {
            return None;
        }
        let (point, feature) = closest_feature(&self.tree.triangles[k as usize], x);
        let face = &self.faces[k as usize];
        let (up, rim) = match feature {
            Feature::Face => (face.normal, false),
            Feature::Edge(e) => face.edges[e],
            Feature::Corner(c) => face.corners[c],
        };
        let offset = vec3::sub(x, point);
        let (length, side) = (vec3::norm(offset), if vec3::dot(offset, up) < 0.0 { -1.0 } else { 1.0 });
        // Of a point on the sheet the offset is rounding.
        let normal = if feature == Feature::Face || length <= self.rounding { up } else { vec3::scale(offset, side / length) };
        Some(OnSheet { distance: side * length, normal, point, rim })
    }
}

/// Edge `k` of a triangle by its corners, smaller first.
fn edge(c: &[u32; 3], k: usize) -> (u32, u32) {
    let (a, b) = (c[k], c[(k + 1) % 3]);
    (a.min(b), a.max(b))
}

/// Turns triangles until all agree with the first about the positive side.
fn orient(triangles: &mut [Triangle], corners: &mut [[u32; 3]]) -> Result<(), MeshError> {
    let mut at: HashMap<(u32, u32), Vec<u32>> = HashMap::new();
    for (t, c) in corners.iter().enumerate() {
        for k in 0..3 {
            at.entry(edge(c, k)).or_default().push(t as u32);
        }
    }
    let refuse = |what: String| Err(MeshError::Sheet(what));
    let mut seen = vec![false; triangles.len()];
    for start in 0..triangles.len() {
        if seen[start] {
            continue;
        }
        if start > 0 {
            // Sides of pieces that lie close to each other would contradict each other.
            return refuse(format!(
                "the mesh has more than one piece, one of them at {:.4?}; give each piece its own file and collider",
                triangles[start][0]
            ));
        }
        seen[start] = true;
        let mut rim = false;
        let mut open = vec![start];
        while let Some(t) = open.pop() {
            for k in 0..3 {
                let (a, b) = (corners[t][k], corners[t][(k + 1) % 3]);
                let both = &at[&edge(&corners[t], k)];
                if both.len() > 2 {
                    let x = triangles[t][k];
                    return refuse(format!(
                        "{} triangles meet in one edge at {x:.4?}, which has no two sides; use a single layer of triangles, or leave out thin",
                        both.len()
                    ));
                }
                let Some(&o) = both.iter().find(|&&o| o as usize != t) else {
                    rim = true;
                    continue;
                };
                let o = o as usize;
                // Neighbours that agree walk the common edge in opposite directions.
                let agrees = !(0..3).any(|k| (corners[o][k], corners[o][(k + 1) % 3]) == (a, b));
                if !agrees && seen[o] {
                    return refuse(format!(
                        "the mesh has only one side, which shows at {:.4?}; use a layer of triangles with two sides, or leave out thin",
                        triangles[o][0]
                    ));
                }
                if !agrees {
                    triangles[o].swap(0, 1);
                    corners[o].swap(0, 1);
                }
                if !seen[o] {
                    seen[o] = true;
                    open.push(o);
                }
            }
        }
        if !rim {
            return refuse(format!(
                "the mesh is closed at {:.4?}; use a single layer of triangles, or leave out thin",
                triangles[start][0]
            ));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use megas_math::rng::Rng;

    use super::*;

    /// The strip `z = f(x)` for x in −1..1 and y in −1..1, every other triangle turned the wrong way.
    fn strip(n: usize, f: impl Fn(f64) -> f64) -> Mesh {
        let mut mesh = Mesh::default();
        for i in 0..=n {
            let x = 2.0 * i as f64 / n as f64 - 1.0;
            for y in [-1.0, 1.0] {
                mesh.positions.push([x as f32, y, f(x) as f32]);
            }
        }
        for i in 0..n as u32 {
            let [a, b, c, d] = [2 * i, 2 * i + 2, 2 * i + 3, 2 * i + 1];
            mesh.triangles.push([a, b, c]);
            mesh.triangles.push([a, d, c]);
        }
        mesh
    }

    #[test]
    fn sides_and_distances_of_a_plate() {
        let sheet = Sheet::new(&strip(5, |_| 0.25)).unwrap();
        let up = sheet.near([0.0, 0.0, 1.0], 2.0).unwrap().distance.signum();
        let mut rng = Rng::new(3);
        for _ in 0..2000 {
            let x: Vec3<f64> = std::array::from_fn(|_| rng.range(-1.5, 1.5));
            let at = sheet.near(x, 9.0).unwrap();
            let inside = x[0].abs() < 1.0 && x[1].abs() < 1.0;
            assert_eq!(at.rim, !inside, "{x:?}");
            if inside {
                assert!((at.distance - up * (x[2] - 0.25)).abs() < 1e-9 && (at.normal[2] - up).abs() < 1e-9, "{x:?} {at:?}");
            }
        }
        assert!(sheet.near([0.0, 0.0, 1.0], 0.5).is_none());
        // On the sheet, on edges and corners too, rounding does not turn the normal.
        for k in 0..200 {
            let x = 0.009 * f64::from(k) - 0.9;
            let at = sheet.near([x, 0.5 * x, 0.25 + 1e-16 * f64::from(k % 3 - 1)], 1.0).unwrap();
            assert!((at.normal[2] - up).abs() < 1e-9, "{at:?}");
            let at = sheet.near([x, 5.0 * (x + 0.2), 0.25], 9.0).unwrap();
            assert!(at.rim || (at.normal[2] - up).abs() < 1e-9, "{at:?}");
        }
        let same = Sheet::across_box([0.0, 0.0, 0.25], [1.0, 1.0, 0.01], mat3::identity()).unwrap();
        for x in [[0.3, 0.4, 0.9], [-0.2, 0.9, -0.3], [1.2, 0.0, 0.1]] {
            let (a, b) = (sheet.near(x, 9.0).unwrap(), same.near(x, 9.0).unwrap());
            assert!((a.distance.abs() - b.distance.abs()).abs() < 1e-9 && a.rim == b.rim);
        }
    }

    #[test]
    fn folds_keep_their_sides() {
        // A roof of 60°, and a curved strip.
        let roof = |x: f64| -3f64.sqrt() * x.abs();
        let bow = |x: f64| 0.5 * (2.0 * x).cos();
        let mut rng = Rng::new(4);
        for (n, f) in [(2, &roof as &dyn Fn(f64) -> f64), (40, &bow)] {
            let sheet = Sheet::new(&strip(n, f)).unwrap();
            let up = sheet.near([0.0, 0.0, 2.0], 9.0).unwrap().distance.signum();
            for _ in 0..2000 {
                let x = [rng.range(-0.8, 0.8), rng.range(-0.9, 0.9), rng.range(-1.0, 1.5)];
                let above = x[2] - f(x[0]);
                let at = sheet.near(x, 9.0).unwrap();
                if !at.rim && above.abs() > 0.02 {
                    assert_eq!(at.distance.signum() * up, above.signum(), "{x:?} {at:?}");
                    let back = vec3::add_scaled(x, at.normal, -at.distance);
                    assert!(vec3::norm(vec3::sub(back, at.point)) < 1e-6);
                }
            }
        }
    }

    #[test]
    fn closed_one_sided_and_branching_meshes_are_refused() {
        let error = |mesh: &Mesh| Sheet::new(mesh).unwrap_err().to_string();
        let mut tetrahedron = Mesh { positions: vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], ..Mesh::default() };
        tetrahedron.triangles = vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]];
        assert!(error(&tetrahedron).contains("closed") && error(&tetrahedron).contains("single layer"));
        tetrahedron.triangles.pop();
        assert!(Sheet::new(&tetrahedron).is_ok());
        let book = Mesh {
            positions: vec![[0.0; 3], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]],
            triangles: vec![[0, 1, 2], [0, 1, 3], [0, 1, 4]],
            ..Mesh::default()
        };
        assert!(error(&book).contains("3 triangles"));
        // A strip of five quads joined with a half turn.
        let mut moebius = Mesh::default();
        for k in 0..5 {
            let turn = std::f64::consts::TAU * f64::from(k) / 5.0;
            for s in [-0.3, 0.3] {
                let r = 1.0 + s * (0.5 * turn).cos();
                moebius.positions.push([r * turn.cos(), r * turn.sin(), s * (0.5 * turn).sin()].map(|v| v as f32));
            }
        }
        for k in 0..5u32 {
            let [a, b] = [2 * k, 2 * k + 1];
            let [c, d] = if k == 4 { [1, 0] } else { [2 * k + 2, 2 * k + 3] };
            moebius.triangles.extend([[a, c, b], [b, c, d]]);
        }
        assert!(error(&moebius).contains("one side"), "{}", error(&moebius));
        let mut two = strip(2, |_| 0.0);
        two.positions.extend([[5.0, 0.0, 0.0], [6.0, 0.0, 0.0], [5.0, 1.0, 0.0]]);
        two.triangles.push([6, 7, 8]);
        assert!(error(&two).contains("more than one piece"));
        assert_eq!(Sheet::new(&Mesh::default()).unwrap_err(), MeshError::Empty);
    }
}
