//! Connected components of means hashed into cells (splatting.md §5.11).

use std::collections::HashMap;

use megas_math::{Vec3, vec3};
use megas_model::Splats;

use crate::neighbours::Neighbours;

/// The Gaussians of one component of `mask`: nearest to the seed, or the largest by Σ o·S¹S².
pub(super) fn component(splats: &Splats, mask: &[bool], seed: Option<Vec3<f32>>, cell: Option<f32>) -> Vec<bool> {
    let members: Vec<usize> = (0..splats.len()).filter(|&i| mask[i] && splats.mean[i].iter().all(|v| v.is_finite())).collect();
    let points: Vec<Vec3<f32>> = members.iter().map(|&i| splats.mean[i]).collect();
    let mut out = vec![false; splats.len()];
    let Some(tree) = Neighbours::new(&points) else { return out };
    let size = f64::from(cell.filter(|c| *c > 0.0).unwrap_or_else(|| 2.5 * median_spacing(&tree, &points)));
    if size <= 0.0 {
        return mask.to_vec();
    }

    let key = |p: Vec3<f32>| p.map(|v| (f64::from(v) / size).floor() as i64);
    let mut cells: HashMap<[i64; 3], Vec<usize>> = HashMap::new();
    for (j, &p) in points.iter().enumerate() {
        cells.entry(key(p)).or_default().push(j);
    }
    // Labels are given in the order of the Gaussians, so that the hash map's own order never shows.
    let mut label = vec![u32::MAX; points.len()];
    let mut components = 0;
    let mut todo = Vec::new();
    for j in 0..points.len() {
        if label[j] != u32::MAX {
            continue;
        }
        label[j] = components;
        todo.push(key(points[j]));
        while let Some(k) = todo.pop() {
            for offset in 0..27 {
                let near = [k[0] + offset % 3 - 1, k[1] + offset / 3 % 3 - 1, k[2] + offset / 9 - 1];
                if let Some(inside) = cells.remove(&near) {
                    inside.iter().for_each(|&m| label[m] = components);
                    todo.push(near);
                }
            }
        }
        components += 1;
    }

    let wanted = match seed {
        Some(s) => tree.nearest(&s, 1).first().map(|n| label[n.0 as usize]),
        None => {
            let mut weight = vec![0.0f64; components as usize];
            for (j, &i) in members.iter().enumerate() {
                let mut s = splats.scale(i);
                s.sort_by(f32::total_cmp);
                weight[label[j] as usize] += f64::from(splats.opacity(i) * s[2] * s[1]);
            }
            (0..components).max_by(|&a, &b| weight[a as usize].total_cmp(&weight[b as usize]).then(b.cmp(&a)))
        }
    };
    for (j, &i) in members.iter().enumerate() {
        out[i] = Some(label[j]) == wanted;
    }
    out
}

/// Median distance to the nearest neighbour, over at most 4000 evenly taken points.
fn median_spacing(tree: &Neighbours, points: &[Vec3<f32>]) -> f32 {
    let stride = (points.len() / 4000).max(1);
    let mut d: Vec<f32> = points.iter().step_by(stride).filter_map(|p| tree.nearest(p, 2).get(1).map(|n| n.1.sqrt())).collect();
    d.sort_by(f32::total_cmp);
    // Several copies of one point have no distance: fall back to a fiftieth of the extent.
    match d.get(d.len() / 2) {
        Some(&m) if m > 0.0 => m,
        _ => {
            let first = points[0];
            let (lo, hi) = points.iter().fold((first, first), |(lo, hi), &p| (vec3::min(lo, p), vec3::max(hi, p)));
            0.02 / 2.5 * vec3::norm(vec3::sub(hi, lo))
        }
    }
}
