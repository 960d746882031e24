//! Cleaning a mesh: specks removed, slivers collapsed, noise smoothed without shrinking (splatting.md §7.7, step 4).

use megas_math::vec3;
use rayon::prelude::*;

use super::nets::Net;

/// Root of every vertex' connected part: its smallest vertex.
pub(crate) fn components(vertices: usize, triangles: &[[u32; 3]]) -> Vec<u32> {
    let mut root: Vec<u32> = (0..vertices as u32).collect();
    fn find(root: &mut [u32], mut i: u32) -> u32 {
        while root[i as usize] != i {
            root[i as usize] = root[root[i as usize] as usize];
            i = root[i as usize];
        }
        i
    }
    for t in triangles {
        for k in 1..3 {
            let (a, b) = (find(&mut root, t[0]), find(&mut root, t[k]));
            root[a.max(b) as usize] = a.min(b);
        }
    }
    // Roots are smaller than what hangs on them: one pass flattens.
    for i in 0..vertices {
        root[i] = root[root[i] as usize];
    }
    root
}

/// Removes the parts that are small in area and number of triangles, and hollows in the inside (parts turned inside out)
/// smaller than `void` \[voxels³\]. The largest part always stays.
pub(crate) fn remove_specks(net: &mut Net, area_share: f64, triangles: usize, void: f64) {
    let root = components(net.vertices.len(), &net.triangles);
    let mut parts: std::collections::BTreeMap<u32, (f64, f64, usize)> = Default::default();
    let mut total = 0.0;
    let mut last: Option<(u32, (f64, f64, usize))> = None;
    for t in &net.triangles {
        let base = net.vertices[root[t[0] as usize] as usize].map(f64::from);
        let [a, b, c] = t.map(|i| vec3::sub(net.vertices[i as usize].map(f64::from), base));
        let area = 0.5 * vec3::norm(vec3::cross(vec3::sub(b, a), vec3::sub(c, a)));
        total += area;
        let r = root[t[0] as usize];
        let add = (area, vec3::dot(a, vec3::cross(b, c)) / 6.0, 1);
        // Neighbours in the list mostly belong to the same part.
        match &mut last {
            Some((k, sum)) if *k == r => *sum = (sum.0 + add.0, sum.1 + add.1, sum.2 + 1),
            _ => {
                if let Some((k, sum)) = last.replace((r, add)) {
                    let p = parts.entry(k).or_default();
                    *p = (p.0 + sum.0, p.1 + sum.1, p.2 + sum.2);
                }
            }
        }
    }
    if let Some((k, sum)) = last {
        let p = parts.entry(k).or_default();
        *p = (p.0 + sum.0, p.1 + sum.1, p.2 + sum.2);
    }
    let Some(largest) = parts.iter().max_by(|a, b| a.1.0.total_cmp(&b.1.0).then(b.0.cmp(a.0))).map(|p| *p.0) else { return };
    let keep = |k: u32, p: &(f64, f64, usize)| {
        let speck = p.0 < area_share * total && p.2 < triangles;
        k == largest || !(speck || (p.1 < 0.0 && -p.1 < void))
    };
    let gone: std::collections::BTreeSet<u32> = parts.iter().filter(|(k, p)| !keep(**k, p)).map(|(k, _)| *k).collect();
    if gone.is_empty() {
        return;
    }
    net.triangles.retain(|t| !gone.contains(&root[t[0] as usize]));
    compact(net);
}

/// Drops vertices without triangles; the others keep their order.
fn compact(net: &mut Net) {
    let mut map = vec![u32::MAX; net.vertices.len()];
    net.triangles.iter().flatten().for_each(|i| map[*i as usize] = 0);
    let mut next = 0;
    for m in &mut map {
        if *m == 0 {
            *m = next;
            next += 1;
        }
    }
    let mut k = 0;
    net.vertices.retain(|_| {
        k += 1;
        map[k - 1] != u32::MAX
    });
    net.triangles.iter_mut().flatten().for_each(|i| *i = map[*i as usize]);
}

/// Entries around every vertex, one per triangle that has it, in the order of the triangles: `list[start[i]..start[i + 1]]`.
pub(crate) struct Around {
    start: Vec<u32>,
    list: Vec<u32>,
}

impl Around {
    /// The triangles around every vertex.
    pub fn triangles(vertices: usize, triangles: &[[u32; 3]]) -> Self {
        Self::new(vertices, triangles, |triangle, _| triangle as u32)
    }

    /// The neighbours of every vertex. On a closed manifold the triangles around a vertex name each neighbour twice, once as
    /// the vertex that follows it.
    fn neighbours(vertices: usize, triangles: &[[u32; 3]]) -> Self {
        Self::new(vertices, triangles, |triangle, corner| triangles[triangle][(corner + 1) % 3])
    }

    /// `entry` of every triangle and corner, sorted by the vertex at the corner.
    fn new(vertices: usize, triangles: &[[u32; 3]], entry: impl Fn(usize, usize) -> u32) -> Self {
        let mut start = vec![0u32; vertices + 1];
        triangles.iter().flatten().for_each(|i| start[*i as usize + 1] += 1);
        for i in 0..vertices {
            start[i + 1] += start[i];
        }
        let mut next = start.clone();
        let mut list = vec![0; 3 * triangles.len()];
        for (k, t) in triangles.iter().enumerate() {
            for (corner, i) in t.iter().enumerate() {
                let slot = &mut next[*i as usize];
                list[*slot as usize] = entry(k, corner);
                *slot += 1;
            }
        }
        Self { start, list }
    }

    pub fn of(&self, i: usize) -> &[u32] {
        &self.list[self.start[i] as usize..self.start[i + 1] as usize]
    }
}

/// Collapses edges shorter than `length` \[voxels\] to their middle where that keeps the surface a manifold: the ends may
/// have no common neighbours but the two opposite corners, and no triangle may turn over. Vertices touched once are left
/// alone afterwards, so that no chain of collapses wanders off.
pub(crate) fn collapse_short_edges(net: &mut Net, length: f32) {
    let short: Vec<(u32, u32)> = net
        .triangles
        .par_iter()
        .flat_map_iter(|t| (0..3).map(|k| (t[k], t[(k + 1) % 3])).filter(|(a, b)| a < b))
        .filter(|(a, b)| {
            let d = vec3::sub(net.vertices[*a as usize], net.vertices[*b as usize]);
            vec3::dot(d, d) < length * length
        })
        .collect();
    if short.is_empty() {
        return;
    }
    let fans = Around::triangles(net.vertices.len(), &net.triangles);
    let ring = |i: u32| -> Vec<u32> {
        let mut v: Vec<u32> = fans.of(i as usize).iter().flat_map(|t| net.triangles[*t as usize]).filter(|j| *j != i).collect();
        v.sort_unstable();
        v.dedup();
        v
    };
    let mut target: Vec<u32> = (0..net.vertices.len() as u32).collect();
    let mut frozen = vec![false; net.vertices.len()];
    let mut moved: Vec<(u32, [f32; 3])> = Vec::new();
    for (a, b) in short {
        let (ra, rb) = (ring(a), ring(b));
        if frozen[a as usize] || frozen[b as usize] || ra.iter().chain(&rb).any(|i| frozen[*i as usize]) {
            continue;
        }
        let common = ra.iter().filter(|i| rb.binary_search(i).is_ok()).count();
        // A tetrahedron has nothing to give.
        if common != 2 || ra.len() <= 3 || rb.len() <= 3 {
            continue;
        }
        let middle = vec3::lerp(net.vertices[a as usize], net.vertices[b as usize], 0.5);
        let flips = fans.of(a as usize).iter().chain(fans.of(b as usize)).any(|t| {
            let t = net.triangles[*t as usize];
            if t.contains(&a) && t.contains(&b) {
                return false;
            }
            let normal = |p: [[f32; 3]; 3]| vec3::cross(vec3::sub(p[1], p[0]), vec3::sub(p[2], p[0]));
            let old = normal(t.map(|i| net.vertices[i as usize]));
            let new = normal(t.map(|i| if i == a || i == b { middle } else { net.vertices[i as usize] }));
            vec3::dot(old, new) <= 0.0 && vec3::dot(old, old) > 0.0
        });
        if flips {
            continue;
        }
        for i in ra.iter().chain(&rb) {
            frozen[*i as usize] = true;
        }
        target[b as usize] = a;
        moved.push((a, middle));
    }
    for (i, p) in moved {
        net.vertices[i as usize] = p;
    }
    net.triangles.iter_mut().flatten().for_each(|i| *i = target[*i as usize]);
    net.triangles.retain(|t| t[0] != t[1] && t[1] != t[2] && t[2] != t[0]);
    compact(net);
}

/// Smooths with the pair of factors λ = 0.5, μ = −0.53, which keeps long waves and hence the volume (Taubin 1995).
pub(crate) fn taubin(net: &mut Net, iterations: u32) {
    if iterations == 0 {
        return;
    }
    let rings = Around::neighbours(net.vertices.len(), &net.triangles);
    let mut next = net.vertices.clone();
    for _ in 0..iterations {
        for factor in [0.5f32, -0.53] {
            let from = &net.vertices;
            next.par_iter_mut().with_min_len(2048).enumerate().for_each(|(i, out)| {
                let ring = rings.of(i);
                let sum = ring.iter().fold([0.0f32; 3], |s, j| vec3::add(s, from[*j as usize]));
                let mean = vec3::scale(sum, 1.0 / ring.len().max(1) as f32);
                *out = if ring.is_empty() { from[i] } else { vec3::lerp(from[i], mean, factor) };
            });
            std::mem::swap(&mut net.vertices, &mut next);
        }
    }
}

/// Unit normals: face normals averaged with the angle of each face at the vertex.
pub(crate) fn normals(vertices: &[[f32; 3]], triangles: &[[u32; 3]]) -> Vec<[f32; 3]> {
    let mut out = vec![[0.0f32; 3]; vertices.len()];
    for t in triangles {
        let p = t.map(|i| vertices[i as usize]);
        let e = [vec3::sub(p[1], p[0]), vec3::sub(p[2], p[1]), vec3::sub(p[0], p[2])];
        let l2 = e.map(|e| vec3::dot(e, e).max(1e-30));
        let n = vec3::cross(e[0], vec3::scale(e[2], -1.0));
        // Dividing by the squares of the two edges at a corner weighs like the angle and gives the exact normal of a
        // sphere (Max 1999).
        for k in 0..3 {
            out[t[k] as usize] = vec3::add_scaled(out[t[k] as usize], n, 1.0 / (l2[k] * l2[(k + 2) % 3]));
        }
    }
    out.par_iter_mut().with_min_len(4096).for_each(|n| *n = vec3::normalize_or(*n, [0.0, 0.0, 1.0]));
    out
}
