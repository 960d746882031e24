//! Area, volume and topology of triangle meshes.

use std::collections::HashMap;

use megas_math::vec3;
use megas_model::Mesh;

/// What can be said about a surface as a whole.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Surface {
    /// Area \[scene units²\].
    pub area: f64,
    /// Enclosed volume by the divergence theorem, `⅙ Σ a·(b × c)` \[scene units³\]; meaningful for closed surfaces.
    pub volume: f64,
}

impl Surface {
    /// Measures a mesh.
    pub fn of(mesh: &Mesh) -> Self {
        let corner = |i: u32| mesh.positions[i as usize].map(f64::from);
        // Relative to a vertex: far from the origin the sum would cancel badly.
        let base = mesh.positions.first().map_or([0.0; 3], |p| p.map(f64::from));
        let mut s = Self::default();
        for t in &mesh.triangles {
            let [a, b, c] = t.map(|i| vec3::sub(corner(i), base));
            s.area += 0.5 * vec3::norm(vec3::cross(vec3::sub(b, a), vec3::sub(c, a)));
            s.volume += vec3::dot(a, vec3::cross(b, c)) / 6.0;
        }
        s
    }
}

/// How triangles hang together.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Topology {
    /// Edges that do not belong to exactly two triangles running along them in opposite directions.
    pub open_edges: usize,
    /// Vertices minus edges plus triangles; 2 for every closed surface without handles. Vertices without triangles do not count.
    pub euler: i64,
    /// Connected parts.
    pub components: usize,
}

impl Topology {
    /// Counts edges and parts of a mesh.
    pub fn of(mesh: &Mesh) -> Self {
        let mut edges: HashMap<(u32, u32), (u32, u32)> = HashMap::new();
        let mut used = vec![false; mesh.positions.len()];
        for t in &mesh.triangles {
            for k in 0..3 {
                let (a, b) = (t[k], t[(k + 1) % 3]);
                used[a as usize] = true;
                let e = edges.entry((a.min(b), a.max(b))).or_default();
                if a < b { e.0 += 1 } else { e.1 += 1 }
            }
        }
        let vertices = used.iter().filter(|u| **u).count();
        let labels = super::clean::components(mesh.positions.len(), &mesh.triangles);
        let components = (0..used.len()).filter(|i| used[*i] && labels[*i] as usize == *i).count();
        Self {
            open_edges: edges.values().filter(|e| **e != (1, 1)).count(),
            euler: vertices as i64 - edges.len() as i64 + mesh.triangles.len() as i64,
            components,
        }
    }

    /// True if the surface is closed and a manifold along its edges.
    pub fn watertight(&self) -> bool {
        self.open_edges == 0
    }
}
