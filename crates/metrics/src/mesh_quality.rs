//! Quality of extracted meshes, and how coherent a sequence of them is (splatting.md §9.3 M10, M11).

use std::collections::HashMap;

use kiddo::{ImmutableKdTree, SquaredEuclidean};
use megas_math::{Vec3, vec3};
use megas_model::Mesh;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::surface::MeshDistance;

/// Surface points that two meshes are compared at.
pub const SAMPLES: usize = 100_000;
/// Particles whose mean velocity moves a vertex to the next frame.
const CARRIERS: usize = 8;

/// A mesh by itself.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct MeshShape {
    /// Enclosed volume (signed, by the divergence theorem) \[scene units³\].
    pub volume: f64,
    /// Area \[scene units²\].
    pub area: f64,
    /// Vertices in use − edges + triangles: 2 for every closed part without handles.
    pub euler: i64,
    /// Every edge belongs to two triangles that pass it in opposite directions.
    pub watertight: bool,
    /// Angle between the normals of neighbouring triangles over the distance of their centres, weighted by their area
    /// \[rad per diagonal L\]: the mean curvature of a smooth surface, more for a rough one.
    pub roughness: f64,
}

/// A mesh against the true one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct MeshDifference {
    /// Mean distance from each surface to the other, averaged over both directions, over L.
    pub chamfer: f64,
    /// The half of it from the mesh to the true one.
    pub to_truth: f64,
    /// Mean signed distance of the mesh from the true one over L; positive outside.
    pub outward: f64,
    /// Largest such distance over L.
    pub hausdorff: f64,
    /// 95th percentile of the distances of both directions over L.
    pub p95: f64,
    /// Angle between the normal of a mesh and that of the nearest place of the other, mean \[rad\].
    pub normal_mean: f64,
    /// Its 95th percentile \[rad\].
    pub normal_p95: f64,
}

fn corners(mesh: &Mesh, t: [u32; 3]) -> [Vec3<f64>; 3] {
    t.map(|v| vec3::cast(mesh.positions[v as usize]))
}

/// Twice the area times the normal.
fn normal([a, b, c]: [Vec3<f64>; 3]) -> Vec3<f64> {
    vec3::cross(vec3::sub(b, a), vec3::sub(c, a))
}

fn angle(a: Vec3<f64>, b: Vec3<f64>) -> f64 {
    vec3::norm(vec3::cross(a, b)).atan2(vec3::dot(a, b))
}

impl MeshShape {
    /// Measures a mesh; `diagonal` is L.
    pub fn new(mesh: &Mesh, diagonal: f64) -> Self {
        let (mut volume, mut area) = (0.0, 0.0);
        let mut used = vec![false; mesh.positions.len()];
        let mut edges: HashMap<(u32, u32), [Option<u32>; 2]> = HashMap::new();
        let mut watertight = !mesh.triangles.is_empty();
        let mut unique = 0i64;
        for (k, &t) in mesh.triangles.iter().enumerate() {
            let c = corners(mesh, t);
            volume += vec3::dot(c[0], vec3::cross(c[1], c[2])) / 6.0;
            area += 0.5 * vec3::norm(normal(c));
            for s in 0..3 {
                let (a, b) = (t[s], t[(s + 1) % 3]);
                used[a as usize] = true;
                let sides = edges.entry((a.min(b), a.max(b))).or_insert_with(|| {
                    unique += 1;
                    [None; 2]
                });
                let side = &mut sides[usize::from(a > b)];
                // A direction that is passed twice belongs to no closed surface.
                watertight &= side.is_none();
                *side = Some(k as u32);
            }
        }
        watertight &= edges.values().all(|s| s[0].is_some() && s[1].is_some());
        let mut pairs: Vec<(u32, u32)> = edges.values().filter_map(|s| Some((s[0]?, s[1]?))).collect();
        // The order of a hash map must not reach the sums.
        pairs.sort_unstable();
        let (mut sum, mut weight) = (0.0, 0.0);
        for (a, b) in pairs {
            let [p, q] = [a, b].map(|k| corners(mesh, mesh.triangles[k as usize]));
            let (n, m) = (normal(p), normal(q));
            let centre = |c: [Vec3<f64>; 3]| vec3::scale(vec3::add(vec3::add(c[0], c[1]), c[2]), 1.0 / 3.0);
            let (distance, w) = (vec3::norm(vec3::sub(centre(p), centre(q))), vec3::norm(n) + vec3::norm(m));
            if distance > 0.0 && w > 0.0 {
                sum += w * angle(n, m) / distance;
                weight += w;
            }
        }
        let vertices = used.iter().filter(|u| **u).count() as i64;
        Self {
            volume,
            area,
            euler: vertices - unique + mesh.triangles.len() as i64,
            watertight,
            roughness: if weight > 0.0 { diagonal * sum / weight } else { 0.0 },
        }
    }
}

impl MeshDifference {
    /// Compares two meshes, given prepared, at `samples` points of each; `diagonal` is L. The second is the true one.
    pub fn new(a: (&Mesh, &MeshDistance), b: (&Mesh, &MeshDistance), diagonal: f64, samples: usize) -> Self {
        Self::with_part(a, b, diagonal, samples, |_| false).0
    }

    /// The same, and once more for a part of the true surface: its points for which `counts` says so, and the points of `a` whose nearest
    /// of `b` is such.
    pub fn with_part(
        a: (&Mesh, &MeshDistance),
        b: (&Mesh, &MeshDistance),
        diagonal: f64,
        samples: usize,
        counts: impl Fn(Vec3<f64>) -> bool + Sync,
    ) -> (Self, Self) {
        let pair = |x: Vec3<f32>, forth: bool| {
            let x = vec3::cast::<f32, f64>(x);
            let (own, other) = if forth { (a, b) } else { (b, a) };
            let there = other.1.closest(x);
            let n = normal(corners(own.0, own.0.triangles[own.1.closest(x).triangle as usize]));
            let m = normal(corners(other.0, other.0.triangles[there.triangle as usize]));
            let outward = vec3::dot(vec3::sub(x, there.point), m).signum() * there.distance;
            Pair {
                distance: there.distance / diagonal,
                angle: angle(n, m),
                outward: outward / diagonal,
                counts: counts(if forth { there.point } else { x }),
            }
        };
        let one = |own: &MeshDistance, forth: bool| -> Vec<Pair> {
            own.sample(samples, 7).par_iter().with_min_len(256).map(|&x| pair(x, forth)).collect()
        };
        let (mut forth, mut back) = (one(a.1, true), one(b.1, false));
        let whole = Self::of(&forth, &back);
        forth.retain(|p| p.counts);
        back.retain(|p| p.counts);
        (whole, Self::of(&forth, &back))
    }

    fn of(forth: &[Pair], back: &[Pair]) -> Self {
        let mean = |v: &[Pair], f: fn(&Pair) -> f64| v.iter().map(f).sum::<f64>() / v.len().max(1) as f64;
        let mut distances: Vec<f64> = forth.iter().chain(back).map(|p| p.distance).collect();
        let mut angles: Vec<f64> = forth.iter().chain(back).map(|p| p.angle).collect();
        distances.sort_unstable_by(f64::total_cmp);
        angles.sort_unstable_by(f64::total_cmp);
        let at = |v: &[f64], q: f64| v.get(((v.len() as f64 * q) as usize).min(v.len().saturating_sub(1))).copied().unwrap_or(0.0);
        let to_truth = mean(forth, |p| p.distance);
        Self {
            chamfer: 0.5 * (to_truth + mean(back, |p| p.distance)),
            to_truth,
            outward: mean(forth, |p| p.outward),
            hausdorff: at(&distances, 1.0),
            p95: at(&distances, 0.95),
            normal_mean: angles.iter().sum::<f64>() / angles.len().max(1) as f64,
            normal_p95: at(&angles, 0.95),
        }
    }
}

/// A point of one mesh and the nearest of the other.
struct Pair {
    distance: f64,
    angle: f64,
    /// How far the point of the first mesh is outside of the second.
    outward: f64,
    /// It belongs to the part that is asked for.
    counts: bool,
}

/// Moves the vertices of a mesh as the 8 nearest particles move on average between two frames. Particles keep their order.
pub fn advected(mesh: &Mesh, before: &[Vec3<f32>], after: &[Vec3<f32>]) -> Option<Mesh> {
    assert_eq!(before.len(), after.len(), "the same particles");
    let count = std::num::NonZero::new(CARRIERS.min(before.len()))?;
    let tree: ImmutableKdTree<f32, 3> = ImmutableKdTree::new_from_slice(before).ok()?;
    let moved = |x: &Vec3<f32>| {
        let near = tree.query(x).nearest_n::<SquaredEuclidean<f32>>(count).execute();
        let mut sum = [0.0f32; 3];
        for n in &near {
            let k = n.item as usize;
            sum = vec3::add(sum, vec3::sub(after[k], before[k]));
        }
        vec3::add_scaled(*x, sum, 1.0 / near.len().max(1) as f32)
    };
    Some(Mesh {
        positions: mesh.positions.par_iter().with_min_len(256).map(moved).collect(),
        triangles: mesh.triangles.clone(),
        ..Mesh::default()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A ball with vertices pushed out by `bump` of the place.
    fn ball(n: usize, radius: f64, bump: impl Fn(f64, f64) -> f64) -> Mesh {
        let mut m = Mesh { positions: vec![[0.0, 0.0, -radius as f32], [0.0, 0.0, radius as f32]], ..Mesh::default() };
        let (pi, wide) = (std::f64::consts::PI, 2 * n);
        for i in 1..n {
            for k in 0..wide {
                let (z, r) = (pi * (i as f64 / n as f64 - 0.5)).sin_cos();
                let (s, c) = (pi * k as f64 / n as f64).sin_cos();
                let f = radius * (1.0 + bump(i as f64, k as f64));
                m.positions.push([f * r * c, f * r * s, f * z].map(|v| v as f32));
            }
        }
        let at = |i: usize, k: usize| (2 + (i - 1) * wide + k % wide) as u32;
        for k in 0..wide {
            m.triangles.push([0, at(1, k + 1), at(1, k)]);
            m.triangles.push([1, at(n - 1, k), at(n - 1, k + 1)]);
            for i in 1..n - 1 {
                m.triangles.extend([[at(i, k), at(i, k + 1), at(i + 1, k + 1)], [at(i, k), at(i + 1, k + 1), at(i + 1, k)]]);
            }
        }
        m
    }

    #[test]
    fn a_ball_has_the_shape_of_a_ball() {
        let m = ball(60, 1.0, |_, _| 0.0);
        let s = MeshShape::new(&m, 2.0);
        assert!(s.watertight && s.euler == 2);
        assert!(
            (s.volume / (4.0 / 3.0 * std::f64::consts::PI) - 1.0).abs() < 0.01
                && (s.area / (4.0 * std::f64::consts::PI) - 1.0).abs() < 0.01
        );
        // A sphere of radius 1 turns its normal by one per length.
        assert!((s.roughness / 2.0 - 1.0).abs() < 0.15, "{s:?}");
        let rough = MeshShape::new(&ball(60, 1.0, |i, k| 0.005 * ((i + k) % 2.0)), 2.0);
        assert!(rough.roughness > 3.0 * s.roughness, "{rough:?}");
        let mut open = m.clone();
        open.triangles.pop();
        let o = MeshShape::new(&open, 2.0);
        assert!(!o.watertight && o.euler == 1);
        let mut twisted = m;
        twisted.triangles[5].swap(0, 1);
        assert!(!MeshShape::new(&twisted, 2.0).watertight);
    }

    #[test]
    fn balls_differ_by_their_radii_and_follow_their_particles() {
        let (a, b) = (ball(50, 1.0, |_, _| 0.0), ball(50, 1.1, |_, _| 0.0));
        let [da, db] = [&a, &b].map(|m| MeshDistance::new(m).unwrap());
        let d = MeshDifference::new((&a, &da), (&b, &db), 2.0, 4000);
        assert!((d.chamfer - 0.05).abs() < 0.002 && (d.hausdorff - 0.05).abs() < 0.003 && (d.p95 - 0.05).abs() < 0.002, "{d:?}");
        assert!(d.normal_mean < 0.05 && d.normal_p95 < 0.1, "{d:?}");
        // Inside by 0.05 L; and the upper half alone.
        assert!((d.outward + 0.05).abs() < 0.002 && (d.to_truth - 0.05).abs() < 0.002, "{d:?}");
        let lifted = Mesh { positions: b.positions.iter().map(|x| [x[0], x[1], x[2].max(-0.5)]).collect(), ..b.clone() };
        let dl = MeshDistance::new(&lifted).unwrap();
        let upper = MeshDifference::with_part((&lifted, &dl), (&a, &da), 2.0, 4000, |x| x[2] > 0.0).1;
        assert!((upper.outward - 0.05).abs() < 0.003 && (upper.chamfer - 0.05).abs() < 0.003 && upper.hausdorff < 0.06, "{upper:?}");
        let same = MeshDifference::new((&a, &da), (&a, &da), 2.0, 1000);
        assert!(same.chamfer < 1e-6 && same.normal_mean < 1e-6);
        // Particles that go outward by a tenth take the vertices along.
        let particles = b.positions.iter().map(|x| vec3::scale(*x, 1.0 / 1.1)).collect::<Vec<_>>();
        let moved = advected(&a, &particles, &b.positions).unwrap();
        let dm = MeshDistance::new(&moved).unwrap();
        assert!(MeshDifference::new((&moved, &dm), (&b, &db), 2.0, 2000).chamfer < 1e-3);
        assert!(advected(&a, &[], &[]).is_none());
    }
}
