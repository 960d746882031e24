//! How often a mesh winds around a point: 1 inside a closed surface, 0 outside, something between near holes, so that
//! meshes with defects still have an inside (Jacobson et al. 2013). Far parts of the mesh act as one oriented patch
//! (Barill et al. 2018).

use megas_math::{Vec3, vec3};

use crate::bvh::{Bvh, DEPTH, Triangle};

/// A part of the mesh counts as far beyond this many of its radii.
const FAR: f64 = 2.5;

/// A part of the mesh as seen from afar.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Patch {
    /// Area-weighted centre.
    centre: Vec3<f64>,
    /// Sum of `area · normal`.
    normal: Vec3<f64>,
    /// (2.5 times) the largest distance of a corner from the centre, squared.
    near2: f64,
}

/// The patch of every node of the tree.
pub(crate) fn patches(tree: &Bvh) -> Vec<Patch> {
    tree.nodes
        .iter()
        .map(|node| {
            let part = &tree.triangles[node.first as usize..(node.first + node.count) as usize];
            let (mut normal, mut centre, mut total) = ([0.0; 3], [0.0; 3], 0.0);
            for t in part {
                let n = area_normal(t);
                let area = vec3::norm(n);
                normal = vec3::add(normal, n);
                centre = vec3::add_scaled(centre, vec3::add(vec3::add(t[0], t[1]), t[2]), area / 3.0);
                total += area;
            }
            let middle = vec3::scale(vec3::add(node.low, node.high), 0.5);
            let centre = if total > 0.0 { vec3::scale(centre, 1.0 / total) } else { middle };
            let radius2 = part.iter().flatten().map(|&x| norm2(vec3::sub(x, centre))).fold(0.0, f64::max);
            Patch { centre, normal, near2: FAR * FAR * radius2 }
        })
        .collect()
}

/// The generalised winding number around `x`.
pub(crate) fn winding(tree: &Bvh, patches: &[Patch], x: Vec3<f64>) -> f64 {
    let mut angle = 0.0;
    let mut stack = [0u32; DEPTH];
    let mut top = usize::from(!tree.nodes.is_empty());
    while top > 0 {
        top -= 1;
        let n = stack[top] as usize;
        let (node, patch) = (&tree.nodes[n], &patches[n]);
        let toward = vec3::sub(patch.centre, x);
        let d2 = norm2(toward);
        if d2 > patch.near2 {
            angle += vec3::dot(patch.normal, toward) / (d2 * d2.sqrt());
        } else if node.second == 0 {
            let range = node.first as usize..(node.first + node.count) as usize;
            angle += tree.triangles[range].iter().map(|t| solid_angle(t, x)).sum::<f64>();
        } else {
            stack[top] = node.second;
            stack[top + 1] = n as u32 + 1;
            top += 2;
        }
    }
    angle / (4.0 * std::f64::consts::PI)
}

/// Half the cross product of two edges: area times normal.
pub(crate) fn area_normal(t: &Triangle) -> Vec3<f64> {
    vec3::scale(vec3::cross(vec3::sub(t[1], t[0]), vec3::sub(t[2], t[0])), 0.5)
}

/// Signed solid angle of a triangle, positive seen from behind (van Oosterom and Strackee 1983).
fn solid_angle(t: &Triangle, x: Vec3<f64>) -> f64 {
    let [a, b, c] = t.map(|v| vec3::sub(v, x));
    let [la, lb, lc] = [a, b, c].map(vec3::norm);
    let volume = vec3::dot(a, vec3::cross(b, c));
    let other = la * lb * lc + vec3::dot(a, b) * lc + vec3::dot(b, c) * la + vec3::dot(c, a) * lb;
    2.0 * volume.atan2(other)
}

fn norm2(v: Vec3<f64>) -> f64 {
    vec3::dot(v, v)
}

#[cfg(test)]
mod tests {
    use super::*;
    use megas_math::rng::Rng;

    #[test]
    fn an_octant_is_an_eighth() {
        let t = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        assert!((solid_angle(&t, [0.0; 3]) - std::f64::consts::PI / 2.0).abs() < 1e-12);
        assert!(solid_angle(&[t[1], t[0], t[2]], [0.0; 3]) < 0.0);
    }

    #[test]
    fn the_tree_approximates_the_sum_over_all_triangles() {
        // A crumpled sheet: nothing closed, all orientations.
        let mut rng = Rng::new(6);
        let triangles: Vec<Triangle> = (0..2000)
            .map(|_| {
                let at = [(); 3].map(|_| rng.unit());
                [(); 3].map(|_| vec3::add(at, [(); 3].map(|_| 0.05 * rng.normal())))
            })
            .collect();
        let tree = Bvh::new(&triangles);
        let far = patches(&tree);
        for _ in 0..200 {
            let x = [(); 3].map(|_| rng.range(-0.5, 1.5));
            let exact = triangles.iter().map(|t| solid_angle(t, x)).sum::<f64>() / (4.0 * std::f64::consts::PI);
            let got = winding(&tree, &far, x);
            assert!((got - exact).abs() < 0.02, "{got} {exact}");
        }
    }
}
