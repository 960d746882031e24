//! Distance to a triangle mesh with a sign.

use megas_math::{Vec3, rng::hash01, vec3};
use megas_model::Mesh;
use rayon::prelude::*;

use crate::bvh::{Bvh, DEPTH, Triangle, bounds};
use crate::winding::{Patch, area_normal, patches, winding};

/// The point of a mesh that is nearest to a given one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Closest {
    /// The point.
    pub point: Vec3<f64>,
    /// Distance to it \[mesh units\].
    pub distance: f64,
    /// Triangle it lies on, an index into [`Mesh::triangles`].
    pub triangle: u32,
}

/// Why a mesh has no distance.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum MeshError {
    /// Nothing to measure from.
    #[error("the mesh has no triangles; export it with faces, not as points")]
    Empty,
    /// A triangle names a vertex that does not exist.
    #[error("triangle {triangle} names vertex {vertex}, but there are {vertices}; export the mesh again")]
    Vertex {
        /// Index of the triangle, from 0.
        triangle: usize,
        /// Index of the vertex.
        vertex: u32,
        /// Number of vertices.
        vertices: usize,
    },
    /// A vertex is not a place.
    #[error("vertex {vertex} is {position:?}, not a finite position; export the mesh again")]
    NotFinite {
        /// Index of the vertex.
        vertex: u32,
        /// What stands there.
        position: [f32; 3],
    },
    /// The grid for its distances would be too large, or the mesh has no extent.
    #[error("{0}")]
    Grid(String),
    /// It is not a layer with two sides.
    #[error("{0}")]
    Sheet(String),
}

/// A mesh prepared for many queries; all of them may run in parallel. The surface should be closed and consistently
/// oriented (either way round); small holes do no harm.
#[derive(Clone, Debug)]
pub struct MeshDistance {
    tree: Bvh,
    patches: Vec<Patch>,
    diagonal: f64,
}

impl MeshDistance {
    /// Fails for a mesh without triangles or with corners that are missing or not finite.
    pub fn new(mesh: &Mesh) -> Result<Self, MeshError> {
        Self::from_triangles(&triangles_of(mesh)?)
    }

    /// From triangles by their corners, which must be finite.
    pub(crate) fn from_triangles(triangles: &[Triangle]) -> Result<Self, MeshError> {
        if triangles.is_empty() {
            return Err(MeshError::Empty);
        }
        let tree = Bvh::new(triangles);
        let (low, high) = bounds(triangles.iter().flatten().copied());
        Ok(Self { patches: patches(&tree), tree, diagonal: vec3::norm(vec3::sub(high, low)) })
    }

    /// Smallest and largest corner of the box of the surface.
    pub fn bounds(&self) -> (Vec3<f64>, Vec3<f64>) {
        (self.tree.nodes[0].low, self.tree.nodes[0].high)
    }

    /// All triangles by their corners, in no particular order.
    pub(crate) fn triangles(&self) -> &[Triangle] {
        &self.tree.triangles
    }

    /// Diagonal L of the box of the surface \[mesh units\].
    pub fn diagonal(&self) -> f64 {
        self.diagonal
    }

    /// The nearest point of the surface.
    pub fn closest(&self, x: Vec3<f64>) -> Closest {
        let (d2, point, k) = nearest(&self.tree, x, f64::INFINITY);
        Closest { point, distance: d2.sqrt(), triangle: self.tree.index[k as usize] }
    }

    /// Distance to the surface if it is less than `reach`.
    pub fn distance_within(&self, x: Vec3<f64>, reach: f64) -> Option<f64> {
        let d2 = nearest(&self.tree, x, reach * reach).0;
        (d2 < reach * reach).then(|| d2.sqrt())
    }

    /// Generalised winding number: ±1 inside, 0 outside.
    pub fn winding_number(&self, x: Vec3<f64>) -> f64 {
        winding(&self.tree, &self.patches, x)
    }

    /// Signed distance, negative where the surface winds around the point by more than one half.
    pub fn signed(&self, x: Vec3<f64>) -> f64 {
        let distance = self.closest(x).distance;
        if self.winding_number(x).abs() > 0.5 { -distance } else { distance }
    }

    /// Signed distance of many points.
    pub fn signed_all(&self, points: &[[f32; 3]]) -> Vec<f64> {
        points.par_iter().with_min_len(64).map(|&x| self.signed(vec3::cast(x))).collect()
    }

    /// `count` points spread over the surface, as many per area everywhere; they depend on the mesh and `seed` alone.
    pub fn sample(&self, count: usize, seed: u64) -> Vec<[f32; 3]> {
        let mut total = 0.0;
        let areas = self.tree.triangles.iter().map(|t| {
            total += vec3::norm(area_normal(t));
            total
        });
        let areas: Vec<f64> = areas.collect();
        let place = |k: usize| {
            let random = |purpose| hash01(seed, k as u64, purpose);
            // One sample in each of `count` strips of equal area.
            let at = (k as f64 + random(0)) / count as f64 * total;
            let t = &self.tree.triangles[areas.partition_point(|a| *a <= at).min(areas.len() - 1)];
            let (root, v) = (random(1).sqrt(), random(2));
            let x = vec3::add_scaled(vec3::scale(t[0], 1.0 - root), t[1], root * (1.0 - v));
            vec3::cast(vec3::add_scaled(x, t[2], root * v))
        };
        (0..count).into_par_iter().map(place).collect()
    }
}

/// The triangles of a mesh by their corners; fails for corners that are missing or not finite.
pub(crate) fn triangles_of(mesh: &Mesh) -> Result<Vec<Triangle>, MeshError> {
    let corner = |triangle: usize, vertex: u32| match mesh.positions.get(vertex as usize) {
        None => Err(MeshError::Vertex { triangle, vertex, vertices: mesh.positions.len() }),
        Some(x) if x.iter().all(|v| v.is_finite()) => Ok(vec3::cast::<f32, f64>(*x)),
        Some(&position) => Err(MeshError::NotFinite { vertex, position }),
    };
    mesh.triangles.iter().enumerate().map(|(k, t)| Ok([corner(k, t[0])?, corner(k, t[1])?, corner(k, t[2])?])).collect()
}

/// The part of a triangle that a point lies on: its inside, edge 0–2 (`ab`, `bc`, `ca`), corner 0–2.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Feature {
    Face,
    Edge(usize),
    Corner(usize),
}

/// Squared distance, point and place in the tree of the nearest triangle nearer than `√limit2`; `limit2` if there is none.
pub(crate) fn nearest(tree: &Bvh, x: Vec3<f64>, limit2: f64) -> (f64, Vec3<f64>, u32) {
    let mut best = (limit2, tree.triangles[0][0], 0);
    let mut stack = [(0u32, 0.0f64); DEPTH];
    stack[0] = (0, tree.nodes[0].distance2(x));
    let mut top = 1;
    while top > 0 {
        top -= 1;
        let (n, d2) = stack[top];
        if d2 >= best.0 {
            continue;
        }
        let node = &tree.nodes[n as usize];
        if node.second == 0 {
            for k in node.first..node.first + node.count {
                let point = closest_on(&tree.triangles[k as usize], x);
                let offset = vec3::sub(point, x);
                let d2 = vec3::dot(offset, offset);
                if d2 < best.0 {
                    best = (d2, point, k);
                }
            }
        } else {
            let [a, b] = [n + 1, node.second].map(|c| (c, tree.nodes[c as usize].distance2(x)));
            // The nearer child is looked at first: it is on top.
            (stack[top], stack[top + 1]) = if a.1 <= b.1 { (b, a) } else { (a, b) };
            top += 2;
        }
    }
    best
}

/// The point of a triangle nearest to `x`.
fn closest_on(t: &Triangle, x: Vec3<f64>) -> Vec3<f64> {
    closest_feature(t, x).0
}

/// The point of a triangle nearest to `x` and what it lies on, by the region of the plane that `x` lies above (Ericson 2005, §5.1.5).
#[inline(always)]
pub(crate) fn closest_feature(t: &Triangle, x: Vec3<f64>) -> (Vec3<f64>, Feature) {
    let [a, b, c] = *t;
    let (ab, ac) = (vec3::sub(b, a), vec3::sub(c, a));
    let from = |corner| {
        let v = vec3::sub(x, corner);
        (vec3::dot(ab, v), vec3::dot(ac, v))
    };
    let (a1, a2) = from(a);
    if a1 <= 0.0 && a2 <= 0.0 {
        return (a, Feature::Corner(0));
    }
    let (b1, b2) = from(b);
    if b1 >= 0.0 && b2 <= b1 {
        return (b, Feature::Corner(1));
    }
    let (c1, c2) = from(c);
    if c2 >= 0.0 && c1 <= c2 {
        return (c, Feature::Corner(2));
    }
    // Twice the signed areas of the parts opposite to each corner.
    let along_ab = a1 * b2 - b1 * a2;
    if along_ab <= 0.0 && a1 >= 0.0 && b1 <= 0.0 && a1 - b1 > 0.0 {
        return (vec3::add_scaled(a, ab, a1 / (a1 - b1)), Feature::Edge(0));
    }
    let along_ac = c1 * a2 - a1 * c2;
    if along_ac <= 0.0 && a2 >= 0.0 && c2 <= 0.0 && a2 - c2 > 0.0 {
        return (vec3::add_scaled(a, ac, a2 / (a2 - c2)), Feature::Edge(2));
    }
    let along_bc = b1 * c2 - c1 * b2;
    let (toward_c, toward_b) = (b2 - b1, c1 - c2);
    if along_bc <= 0.0 && toward_c >= 0.0 && toward_b >= 0.0 && toward_c + toward_b > 0.0 {
        return (vec3::add_scaled(b, vec3::sub(c, b), toward_c / (toward_c + toward_b)), Feature::Edge(1));
    }
    let sum = along_bc + along_ac + along_ab;
    (vec3::add_scaled(vec3::add_scaled(a, ab, along_ac / sum), ac, along_ab / sum), Feature::Face)
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use megas_math::rng::Rng;

    use super::*;

    /// A surface of revolution about z with `n` sides from its closed profile `(radius, z)`.
    fn lathe(profile: &[[f64; 2]], n: usize) -> Mesh {
        let mut mesh = Mesh::default();
        for [r, z] in profile {
            for k in 0..n {
                let angle = 2.0 * PI * k as f64 / n as f64;
                mesh.positions.push([(r * angle.cos()) as f32, (r * angle.sin()) as f32, *z as f32]);
            }
        }
        let m = profile.len();
        for i in 0..m {
            // A strip on the axis would be a wire without area.
            if profile[i][0].max(profile[(i + 1) % m][0]) < 1e-9 {
                continue;
            }
            for k in 0..n {
                let at = |i: usize, k: usize| (i % m * n + k % n) as u32;
                mesh.triangles.push([at(i, k), at(i, k + 1), at(i + 1, k + 1)]);
                mesh.triangles.push([at(i, k), at(i + 1, k + 1), at(i + 1, k)]);
            }
        }
        mesh
    }

    fn sphere(rings: usize) -> Mesh {
        let profile: Vec<[f64; 2]> = (0..=rings).map(|i| (PI * (i as f64 / rings as f64 - 0.5)).sin_cos()).map(|(z, r)| [r, z]).collect();
        lathe(&profile, 2 * rings)
    }

    /// A thick-walled cup: outer radius 1, height 2, wall and floor 0.2, standing on z = 0.
    fn cup(sides: usize) -> Mesh {
        lathe(&[[0.0, 0.0], [1.0, 0.0], [1.0, 2.0], [0.8, 2.0], [0.8, 0.2], [0.0, 0.2]], sides)
    }

    fn cup_distance(x: Vec3<f64>) -> f64 {
        let cylinder = |r: f64, low: f64, high: f64| {
            let side = x[0].hypot(x[1]) - r;
            let end = (low - x[2]).max(x[2] - high);
            side.max(end).min(0.0) + side.max(0.0).hypot(end.max(0.0))
        };
        // The cavity goes on above the rim, so that subtracting it leaves the exact distance near the rim.
        let (outer, inner) = (cylinder(1.0, 0.0, 2.0), cylinder(0.8, 0.2, 9.0));
        outer.max(-inner)
    }

    #[test]
    fn distance_to_a_sphere() {
        let d = MeshDistance::new(&sphere(100)).unwrap();
        assert!((d.diagonal() - 2.0 * 3f64.sqrt()).abs() < 1e-3);
        let mut rng = Rng::new(1);
        for _ in 0..500 {
            let r = rng.range(0.0, 2.5);
            let x = rng.direction().map(|v| v * r);
            // The facets lie inside the sphere by at most 1 − cos(π/200)² or so.
            let s = d.signed(x);
            assert!((s - (r - 1.0)).abs() < 6e-4, "{r} {s}");
        }
    }

    #[test]
    fn distance_to_a_concave_body_and_its_inside() {
        let mesh = cup(300);
        let d = MeshDistance::new(&mesh).unwrap();
        let mut flipped = mesh.clone();
        flipped.triangles.iter_mut().for_each(|t| t.swap(0, 1));
        let reverse = MeshDistance::new(&flipped).unwrap();
        let mut rng = Rng::new(2);
        let mut inside = 0;
        for _ in 0..3000 {
            let x = [rng.range(-1.3, 1.3), rng.range(-1.3, 1.3), rng.range(-0.3, 2.3)];
            let (s, exact) = (d.signed(x), cup_distance(x));
            inside += usize::from(exact < 0.0);
            // Unsigned distance outside the convex corners of the subtraction is a bound only; there compare signs.
            if exact < 0.0 || x[2] < 1.9 {
                assert!((s - exact).abs() < 2e-4, "{x:?}: {s} {exact}");
            }
            assert!(exact.abs() < 1e-3 || (s < 0.0) == (exact < 0.0));
            assert!((s - reverse.signed(x)).abs() < 1e-12);
        }
        assert!(inside > 300);
        // The middle of the cavity is outside although the cup surrounds it.
        assert!((d.signed([0.0, 0.0, 1.0]) - 0.8).abs() < 1e-3);
    }

    #[test]
    fn a_hole_does_not_turn_the_inside_out() {
        let mut mesh = sphere(60);
        mesh.triangles.retain(|t| t.iter().any(|&i| mesh.positions[i as usize][2] < 0.95));
        let d = MeshDistance::new(&mesh).unwrap();
        assert!(d.signed([0.0, 0.0, 0.5]) < 0.0 && d.signed([0.0, 0.0, 1.3]) > 0.0);
        assert!(d.winding_number([0.0; 3]) < 0.99);
    }

    #[test]
    fn the_closest_point_is_the_closest_of_all_triangles() {
        let mut rng = Rng::new(3);
        let positions: Vec<[f32; 3]> = (0..600).map(|_| [(); 3].map(|_| rng.unit() as f32)).collect();
        let mut triangles: Vec<[u32; 3]> = (0..200u32).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
        // Degenerate ones: a point and a segment.
        triangles.extend([[5, 5, 5], [7, 8, 7], [9, 9, 10]]);
        let mesh = Mesh { positions, triangles, ..Mesh::default() };
        let d = MeshDistance::new(&mesh).unwrap();
        for _ in 0..300 {
            let x = [(); 3].map(|_| rng.range(-0.5, 1.5));
            let got = d.closest(x);
            let corner = |i: u32| vec3::cast::<f32, f64>(mesh.positions[i as usize]);
            let distance = |t: &[u32; 3]| vec3::norm(vec3::sub(closest_on(&t.map(corner), x), x));
            let best = mesh.triangles.iter().map(distance).fold(f64::INFINITY, f64::min);
            assert!((got.distance - best).abs() < 1e-12);
            assert!((distance(&mesh.triangles[got.triangle as usize]) - best).abs() < 1e-12);
            assert!((vec3::norm(vec3::sub(got.point, x)) - best).abs() < 1e-12);
            // Against a dense set of points of the same triangle.
            let t = mesh.triangles[got.triangle as usize].map(corner);
            for i in 0..=20 {
                for j in 0..=20 - i {
                    let (u, v) = (f64::from(i) / 20.0, f64::from(j) / 20.0);
                    let p: Vec3<f64> = std::array::from_fn(|k| t[0][k] * (1.0 - u - v) + t[1][k] * u + t[2][k] * v);
                    assert!(vec3::norm(vec3::sub(p, x)) >= best - 1e-12);
                }
            }
        }
    }

    #[test]
    fn samples_lie_on_the_surface_and_are_even() {
        let d = MeshDistance::new(&cup(60)).unwrap();
        let samples = d.sample(20_000, 4);
        assert!(samples.iter().all(|&x| d.closest(vec3::cast(x)).distance < 1e-6));
        // Bottom disc π against all: side 4π, rim 0.36π, cavity wall 2.88π, cavity floor 0.64π.
        let bottom = samples.iter().filter(|x| x[2] < 1e-6).count() as f64 / 20_000.0;
        assert!((bottom - 1.0 / (1.0 + 4.0 + 0.36 + 2.88 + 0.64)).abs() < 2e-3, "{bottom}");
        assert!(d.sample(100, 4) == d.sample(100, 4) && d.sample(100, 4) != d.sample(100, 5));
    }

    #[test]
    fn broken_meshes_are_refused() {
        let mut mesh = sphere(4);
        assert_eq!(MeshDistance::new(&Mesh::default()).unwrap_err(), MeshError::Empty);
        mesh.triangles[3][1] = 10_000;
        assert!(MeshDistance::new(&mesh).is_err());
        let mut mesh = sphere(4);
        mesh.positions[2][0] = f32::NAN;
        assert!(MeshDistance::new(&mesh).is_err());
    }

    /// Run with `--ignored --nocapture` to see the cost.
    #[test]
    #[ignore = "a measurement"]
    fn cost_of_a_hundred_thousand_queries() {
        let mut rng = Rng::new(9);
        let mut near = || (rng.range(0.8, 1.1), rng.direction());
        let points: Vec<[f32; 3]> = (0..100_000).map(|_| near()).map(|(r, d)| d.map(|v| (v * r) as f32)).collect();
        let start = std::time::Instant::now();
        let mesh = sphere(100);
        let d = MeshDistance::new(&mesh).unwrap();
        let built = start.elapsed().as_secs_f64();
        let inside = d.signed_all(&points).iter().filter(|s| **s < 0.0).count();
        println!("{} triangles: built {built:.3} s, queried {:.3} s", mesh.triangles.len(), start.elapsed().as_secs_f64() - built);
        assert!((inside as f64 / 1e5 - 2.0 / 3.0).abs() < 0.01);
    }
}
