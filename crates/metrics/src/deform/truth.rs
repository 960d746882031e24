//! The true deformed surface: the mesh, finely divided and mapped; for the cut, two halves with caps (splatting.md §9.2).

use std::collections::HashMap;

use megas_math::{Vec3, vec3};
use megas_model::Mesh;
use rayon::prelude::*;

use super::{Deformation, Stage};

/// Width of the strips and cells of a cap, in diagonals L.
const CAP_STRIP: f64 = 0.002;
const CAP_CELL: f64 = 0.004;

/// Splits edges longer than `longest` at their middles until none is left. Positions and colours are kept; neighbours stay
/// joined, so that a closed surface stays closed.
pub fn finely_divided(mesh: &Mesh, longest: f64) -> Mesh {
    assert!(longest > 0.0, "a positive length");
    let mut positions = mesh.positions.clone();
    let mut colours = mesh.colours.clone();
    let mut open = mesh.triangles.clone();
    let mut done = Vec::with_capacity(open.len());
    let mut middles: HashMap<(u32, u32), u32> = HashMap::new();
    while let Some(t) = open.pop() {
        let length2 = |k: usize| {
            let d = vec3::sub(positions[t[k] as usize], positions[t[(k + 1) % 3] as usize]);
            vec3::dot::<f64>(vec3::cast(d), vec3::cast(d))
        };
        let long = [0, 1, 2].map(|k| length2(k) > longest * longest);
        if long == [false; 3] {
            done.push(t);
            continue;
        }
        // All long edges are split at once: whether an edge is split does not depend on the triangle that asks.
        let mut middle = |k: usize| {
            let (a, b) = (t[k], t[(k + 1) % 3]);
            *middles.entry((a.min(b), a.max(b))).or_insert_with(|| {
                let half = |v: &[[f32; 3]]| vec3::scale(vec3::add(v[a as usize], v[b as usize]), 0.5);
                let (x, c) = (half(&positions), (!colours.is_empty()).then(|| half(&colours)));
                positions.push(x);
                colours.extend(c);
                positions.len() as u32 - 1
            })
        };
        let m = [0, 1, 2].map(|k| long[k].then(|| middle(k)));
        match long.iter().filter(|l| **l).count() {
            3 => {
                let [a, b, c] = m.map(|v| v.unwrap_or_default());
                open.extend([[t[0], a, c], [a, t[1], b], [c, b, t[2]], [a, b, c]]);
            }
            count => {
                // Turned so that the first edge is split; with two split edges it is the one before the whole one.
                let k = (0..3).find(|&k| long[k] && (count == 1 || long[(k + 2) % 3])).unwrap_or(0);
                let [p, q, r] = [0, 1, 2].map(|s| t[(k + s) % 3]);
                let (a, c) = (m[k].unwrap_or_default(), m[(k + 2) % 3]);
                match c {
                    None => open.extend([[p, a, r], [a, q, r]]),
                    Some(c) => open.extend([[p, a, c], [a, q, r], [a, r, c]]),
                }
            }
        }
    }
    // The order of the stack is turned round again, so that triangles stay near where they were.
    done.reverse();
    Mesh { positions, colours, triangles: done, ..Mesh::default() }
}

/// The surface after a deformation. Colours go along; the faces of a cut get theirs from `inside`, given the point at rest.
pub fn deformed(mesh: &Mesh, stage: &Stage, d: Deformation, inside: impl Fn(Vec3<f64>) -> [f32; 3] + Sync) -> Mesh {
    if d == Deformation::Cut {
        return halves(mesh, stage, &inside);
    }
    let positions = mesh.positions.par_iter().map(|&x| vec3::cast(stage.map(d, vec3::cast(x)))).collect();
    Mesh { positions, colours: mesh.colours.clone(), triangles: mesh.triangles.clone(), ..Mesh::default() }
}

/// Both halves with their caps.
fn halves(mesh: &Mesh, stage: &Stage, inside: &(impl Fn(Vec3<f64>) -> [f32; 3] + Sync)) -> Mesh {
    let local: Vec<Vec3<f64>> = mesh.positions.iter().map(|&x| stage.local(vec3::cast(x))).collect();
    let mut out = Mesh::default();
    let mut section: Vec<[[f64; 2]; 2]> = Vec::new();
    for left in [true, false] {
        let side = |x: f64| if left { -x } else { x };
        let first = out.positions.len() as u32;
        // Vertices keep their numbers; those of the other side are left unused.
        out.positions.extend(mesh.positions.iter().map(|&x| vec3::cast::<f64, f32>(stage.map_half(Deformation::Cut, vec3::cast(x), left))));
        out.colours.extend_from_slice(&mesh.colours);
        let mut crossings: HashMap<(u32, u32), u32> = HashMap::new();
        for t in &mesh.triangles {
            let kept = t.map(|v| side(local[v as usize][0]) >= 0.0);
            let count = kept.iter().filter(|k| **k).count();
            if count == 3 {
                out.triangles.push(t.map(|v| first + v));
            }
            if count == 0 || count == 3 {
                continue;
            }
            // The corner that is alone on its side comes first.
            let k = (0..3).find(|&k| kept[k] == (count == 1)).unwrap_or(0);
            let [p, q, r] = [0, 1, 2].map(|s| t[(k + s) % 3]);
            let mut cross = |a: u32, b: u32| {
                *crossings.entry((a.min(b), a.max(b))).or_insert_with(|| {
                    let (a, b) = (a.min(b) as usize, a.max(b) as usize);
                    let u = local[a][0] / (local[a][0] - local[b][0]);
                    let x = vec3::lerp(local[a], local[b], u);
                    out.positions.push(vec3::cast(stage.map_half(Deformation::Cut, stage.scene([0.0, x[1], x[2]]), left)));
                    if !mesh.colours.is_empty() {
                        out.colours.push(vec3::lerp(mesh.colours[a], mesh.colours[b], u as f32));
                    }
                    out.positions.len() as u32 - 1
                })
            };
            let (a, b) = (cross(p, q), cross(p, r));
            let [p, q, r] = [p, q, r].map(|v| first + v);
            match count {
                1 => out.triangles.push([p, a, b]),
                _ => out.triangles.extend([[a, q, r], [a, r, b]]),
            }
            if left {
                let flat = |v: u32| {
                    let x = stage.local(stage.map(Deformation::Rest, vec3::cast(out.positions[v as usize])));
                    [x[1], x[2]]
                };
                section.push([flat(a), flat(b)]);
            }
        }
    }
    let cap = cap(&section, stage.diagonal);
    for left in [true, false] {
        let first = out.positions.len() as u32;
        let place = |p: &[f64; 2]| stage.scene([0.0, p[0], p[1]]);
        out.positions.extend(cap.0.iter().map(|p| vec3::cast::<f64, f32>(stage.map_half(Deformation::Cut, place(p), left))));
        if !mesh.colours.is_empty() {
            let colours: Vec<[f32; 3]> = cap.0.par_iter().with_min_len(16).map(|p| inside(place(p))).collect();
            out.colours.extend(colours);
        }
        // The left half ends with a face that looks along +x.
        let turned = |[a, b, c]: [u32; 3]| if left { [a, b, c] } else { [a, c, b] };
        out.triangles.extend(cap.1.iter().map(|t| turned(t.map(|v| first + v))));
    }
    out
}

/// Fills closed outlines (segments in any order; what an odd number of them is below of is inside) with strips of equal
/// width between the places where lines of constant second coordinate cross them. Triangles are counter-clockwise.
fn cap(section: &[[[f64; 2]; 2]], diagonal: f64) -> (Vec<[f64; 2]>, Vec<[u32; 3]>) {
    let strip = CAP_STRIP * diagonal;
    let (low, high) = section.iter().flatten().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), p| (l.min(p[1]), h.max(p[1])));
    let (mut points, mut triangles) = (Vec::new(), Vec::new());
    if section.is_empty() || high <= low {
        return (points, triangles);
    }
    let count = ((high - low) / strip).ceil() as usize;
    let strip = (high - low) / count as f64;
    // Crossings of the lines at half strips.
    let mut lines: Vec<Vec<f64>> = vec![Vec::new(); 2 * count + 1];
    let height = |k: usize| low + 0.5 * strip * k as f64;
    for [a, b] in section {
        let (a, b) = if a[1] <= b[1] { (a, b) } else { (b, a) };
        let from = (((a[1] - low) / (0.5 * strip)).floor() as usize).saturating_sub(1);
        for k in from..lines.len() {
            if height(k) >= b[1] {
                break;
            }
            if height(k) >= a[1] {
                lines[k].push(a[0] + (height(k) - a[1]) / (b[1] - a[1]) * (b[0] - a[0]));
            }
        }
    }
    lines.iter_mut().for_each(|l| l.sort_unstable_by(f64::total_cmp));
    for s in 0..count {
        let (bottom, middle, top) = (&lines[2 * s], &lines[2 * s + 1], &lines[2 * s + 2]);
        for (i, inside) in middle.chunks_exact(2).enumerate() {
            // Where the outline begins or ends inside the strip, it is taken to be upright.
            let pick = |line: &Vec<f64>| if line.len() == middle.len() { [line[2 * i], line[2 * i + 1]] } else { [inside[0], inside[1]] };
            let ends = [pick(bottom), pick(top)];
            let cells = ((inside[1] - inside[0]) / (CAP_CELL * diagonal)).ceil().max(1.0) as u32;
            let first = points.len() as u32;
            for c in 0..=cells {
                let u = f64::from(c) / f64::from(cells);
                for (row, e) in ends.iter().enumerate() {
                    points.push([e[0] + u * (e[1] - e[0]), height(2 * (s + row))]);
                }
            }
            for c in 0..cells {
                let v = first + 2 * c;
                triangles.extend([[v, v + 2, v + 3], [v, v + 3, v + 1]]);
            }
        }
    }
    (points, triangles)
}

#[cfg(test)]
mod tests {
    use std::collections::HashSet;

    use megas_math::mat3;

    use super::*;

    /// A box from 0 to `size`, closed, oriented outwards.
    pub(super) fn brick(size: [f32; 3]) -> Mesh {
        let mut m = Mesh::default();
        for i in 0..8 {
            m.positions.push(std::array::from_fn(|k| if i >> k & 1 == 1 { size[k] } else { 0.0 }));
            m.colours.push(std::array::from_fn(|k| (i >> k & 1) as f32));
        }
        let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
        m.triangles = quads.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
        m
    }

    fn volume(m: &Mesh) -> f64 {
        let v = |i: u32| vec3::cast::<f32, f64>(m.positions[i as usize]);
        m.triangles.iter().map(|&[a, b, c]| vec3::dot(v(a), vec3::cross(v(b), v(c))) / 6.0).sum()
    }

    fn area(m: &Mesh) -> f64 {
        let v = |i: u32| vec3::cast::<f32, f64>(m.positions[i as usize]);
        m.triangles.iter().map(|&[a, b, c]| 0.5 * vec3::norm(vec3::cross(vec3::sub(v(b), v(a)), vec3::sub(v(c), v(a))))).sum()
    }

    fn closed(m: &Mesh) -> bool {
        let edges: HashSet<(u32, u32)> = m.triangles.iter().flat_map(|t| [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])]).collect();
        edges.len() == 3 * m.triangles.len() && edges.iter().all(|&(a, b)| edges.contains(&(b, a)))
    }

    #[test]
    fn division_keeps_surface_colour_and_closure() {
        let rough = brick([1.0, 2.0, 0.7]);
        let fine = finely_divided(&rough, 0.11);
        assert!(closed(&fine) && fine.colours.len() == fine.positions.len());
        assert!((volume(&fine) - 1.4).abs() < 1e-6 && (area(&fine) - area(&rough)).abs() < 1e-5);
        for t in &fine.triangles {
            for k in 0..3 {
                let d = vec3::sub(fine.positions[t[k] as usize], fine.positions[t[(k + 1) % 3] as usize]);
                assert!(vec3::norm(d) <= 0.1101);
            }
        }
        for (x, c) in fine.positions.iter().zip(&fine.colours) {
            assert!((0..3).all(|k| (x[k] / [1.0, 2.0, 0.7][k] - c[k]).abs() < 1e-5));
        }
    }

    #[test]
    fn deformed_volumes_follow_the_determinant() {
        let fine = finely_divided(&brick([1.0, 2.0, 0.7]), 0.02);
        let stage = Stage::new(&fine.positions, mat3::identity()).unwrap();
        for d in Deformation::ALL {
            let m = deformed(&fine, &stage, d, |_| [0.0; 3]);
            let expected = if d == Deformation::Inflate { 1.4 * 3.375 } else { 1.4 };
            assert!((volume(&m) / expected - 1.0).abs() < 2e-3, "{d:?} {}", volume(&m));
        }
    }

    #[test]
    fn a_cut_makes_two_faces_of_the_section() {
        let fine = finely_divided(&brick([1.0, 2.0, 0.7]), 0.05);
        let stage = Stage::new(&fine.positions, mat3::identity()).unwrap();
        let m = deformed(&fine, &stage, Deformation::Cut, |x| [x[0] as f32, x[1] as f32, x[2] as f32]);
        assert!((area(&m) - area(&fine) - 2.0 * 1.4).abs() < 1e-3, "{} {}", area(&m), area(&fine));
        let gap = 0.08 * stage.diagonal;
        let faces: Vec<usize> = (0..m.positions.len()).filter(|&i| (f64::from(m.positions[i][0]) - (0.5 - gap)).abs() < 1e-6).collect();
        // The caps are coloured from the inside at rest.
        assert!(faces.iter().any(|&i| m.colours[i][0] == 0.5 && (m.colours[i][1] - m.positions[i][1]).abs() < 1e-5));
        assert!(m.positions.iter().all(|x| (f64::from(x[0]) - 0.5).abs() > 0.0));
    }

    #[test]
    fn caps_of_rings_keep_their_hole() {
        let circle = |r: f64| -> Vec<[[f64; 2]; 2]> {
            let at = |k: usize| (k as f64 / 200.0 * std::f64::consts::TAU).sin_cos();
            (0..200).map(|k| (at(k), at(k + 1))).map(|(a, b)| [[r * a.0, r * a.1], [r * b.0, r * b.1]]).collect()
        };
        let section: Vec<_> = circle(1.0).into_iter().chain(circle(0.6)).collect();
        let (points, triangles) = cap(&section, 3.0);
        let cross = |t: &[u32; 3]| {
            let [a, b, c] = t.map(|v| points[v as usize]);
            0.5 * ((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]))
        };
        assert!(triangles.iter().all(|t| cross(t) >= -1e-9));
        let total: f64 = triangles.iter().map(cross).sum();
        let exact = std::f64::consts::PI * (1.0 - 0.36);
        assert!((total / exact - 1.0).abs() < 2e-3, "{total} {exact}");
        assert!(cap(&[], 1.0).0.is_empty());
    }
}
