//! Convex polygons in the plane: footprints.

/// Convex hull, counter-clockwise without repetition (Andrew's monotone chain). Fewer than three corners where the points
/// do not span an area.
pub(crate) fn convex_hull(points: &[[f64; 2]]) -> Vec<[f64; 2]> {
    let mut p: Vec<[f64; 2]> = points.iter().copied().filter(|q| q[0].is_finite() && q[1].is_finite()).collect();
    p.sort_by(|a, b| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])));
    p.dedup();
    if p.len() < 3 {
        return p;
    }
    let half = |order: &mut dyn Iterator<Item = [f64; 2]>| {
        let mut chain: Vec<[f64; 2]> = Vec::new();
        for q in order {
            while chain.len() >= 2 && cross(chain[chain.len() - 2], chain[chain.len() - 1], q) <= 0.0 {
                chain.pop();
            }
            chain.push(q);
        }
        chain.pop();
        chain
    };
    let mut hull = half(&mut p.iter().copied());
    hull.extend(half(&mut p.iter().rev().copied()));
    hull
}

/// Twice the signed area of the triangle `a b c`.
fn cross(a: [f64; 2], b: [f64; 2], c: [f64; 2]) -> f64 {
    (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
}

/// True for points inside or on the border of a convex counter-clockwise polygon.
pub(crate) fn contains(polygon: &[[f64; 2]], q: [f64; 2]) -> bool {
    let n = polygon.len();
    n >= 3 && (0..n).all(|i| cross(polygon[i], polygon[(i + 1) % n], q) >= 0.0)
}

/// Distance from `q` to the polygon, 0 inside.
pub(crate) fn distance(polygon: &[[f64; 2]], q: [f64; 2]) -> f64 {
    if contains(polygon, q) {
        return 0.0;
    }
    let n = polygon.len();
    (0..n)
        .map(|i| {
            let (a, b) = (polygon[i], polygon[(i + 1) % n]);
            let (e, w) = ([b[0] - a[0], b[1] - a[1]], [q[0] - a[0], q[1] - a[1]]);
            let l2 = e[0] * e[0] + e[1] * e[1];
            let t = if l2 > 0.0 { ((e[0] * w[0] + e[1] * w[1]) / l2).clamp(0.0, 1.0) } else { 0.0 };
            (w[0] - t * e[0]).hypot(w[1] - t * e[1])
        })
        .fold(f64::INFINITY, f64::min)
}

/// Area of a counter-clockwise polygon.
pub(crate) fn area(polygon: &[[f64; 2]]) -> f64 {
    let n = polygon.len();
    0.5 * (0..n).map(|i| polygon[i][0] * polygon[(i + 1) % n][1] - polygon[(i + 1) % n][0] * polygon[i][1]).sum::<f64>()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hull_of_a_square_with_points_inside_and_on_the_edges() {
        let mut p: Vec<[f64; 2]> = (0..=10).flat_map(|i| (0..=10).map(move |j| [i as f64, j as f64])).collect();
        p.push([3.3, 4.4]);
        let h = convex_hull(&p);
        assert_eq!(h, [[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0]]);
        assert_eq!(area(&h), 100.0);
        assert!(contains(&h, [0.0, 5.0]) && contains(&h, [9.9, 9.9]) && !contains(&h, [10.1, 5.0]));
        assert!((distance(&h, [13.0, 14.0]) - 5.0).abs() < 1e-12 && distance(&h, [5.0, 5.0]) == 0.0);
        assert!(convex_hull(&[[0.0, 0.0], [1.0, 1.0], [2.0, 2.0]]).len() < 3);
    }
}
