//! Normals of deformed surface Gaussians (splatting.md §7.3): transported, kept within 25° of what the surface around shows.

use megas_math::{Mat3, Vec3, mat3, quat, svd, vec3};
use megas_raster::{Gaussians, unpack_covariance};
use rayon::prelude::*;

use super::settings::Normals;
use crate::rows::Rows;

/// Neighbours of the plane fit.
const NEIGHBOURS: usize = 12;
/// Largest angle to the plane's normal.
const LARGEST: f32 = 0.436;
/// sin² of it.
const SIN2_LARGEST: f64 = 0.178;
/// Gaussians and neighbours of the consistency check.
const CHECKED: usize = 4096;

/// Oriented normals of the surface. Only Gaussians that have melted need the correction, solids turn with their
/// material; and of these only those that are asked for get it.
///
/// The design blends a fifth of the plane's normal in whenever the two differ by more than 25°, frame after frame, which jumps at
/// that angle; here the normal is turned until it is within 25°, which is where those frames would end.
pub(crate) fn normals(
    surface: &Gaussians,
    phase: &[u8],
    asked: impl Fn(usize) -> bool + Sync,
    spacing: f32,
    mode: Normals,
) -> Vec<Vec3<f32>> {
    let n = surface.len();
    if mode == Normals::Axis {
        let axis = |i: usize| {
            let (_, r) = svd::eigen_symmetric(mat3::cast::<f32, f64>(unpack_covariance(surface.covariance[i])));
            let axis: Vec3<f32> = vec3::cast(mat3::column(r, 2));
            // The sign is the transported one's: an axis has none.
            if vec3::dot(axis, surface.normal[i]) < 0.0 { axis.map(|v| -v) } else { axis }
        };
        return (0..n).into_par_iter().map(axis).collect();
    }
    let melted = |i: usize| phase.get(i).is_some_and(|p| *p != 0);
    if mode == Normals::Transport || spacing <= 0.0 || !(0..n).any(melted) {
        return surface.normal.clone();
    }
    let rows = Rows::new(&surface.mean, 1.5 * spacing);
    (0..n)
        .into_par_iter()
        .with_min_len(64)
        .map_init(Vec::new, |found, i| {
            let normal = surface.normal[i];
            if !melted(i) || !asked(i) || normal == [0.0; 3] {
                return normal;
            }
            rows.nearest(surface.mean[i], NEIGHBOURS + 1, 2.2 * spacing, 8.0 * spacing, found);
            let points = found.iter().map(|f| [rows.x[f.1 as usize], rows.y[f.1 as usize], rows.z[f.1 as usize]]);
            match covariance(surface.mean[i], points).filter(|c| !is_axis_within(*c, normal, SIN2_LARGEST)).map(plane) {
                Some((axis, planarity)) => toward(normal, axis, ((planarity - 0.5) / 0.2).clamp(0.0, 1.0)),
                None => normal,
            }
        })
        .collect()
}

/// Covariance of `points`; `None` for too few.
fn covariance(around: Vec3<f32>, points: impl Iterator<Item = Vec3<f32>>) -> Option<Mat3<f64>> {
    let (mut m, mut c, mut count) = ([0.0f64; 3], [[0.0f64; 3]; 3], 0.0);
    for p in points {
        let d: Vec3<f64> = vec3::cast(vec3::sub(p, around));
        for a in 0..3 {
            m[a] += d[a];
            for b in 0..3 {
                c[a][b] += d[a] * d[b];
            }
        }
        count += 1.0;
    }
    if count < 6.0 {
        return None;
    }
    Some(std::array::from_fn(|a| std::array::from_fn(|b| c[a][b] / count - m[a] * m[b] / (count * count))))
}

/// Normal of the plane through points of this covariance, and its planarity `1 − λ_min/λ_mid`.
fn plane(covariance: Mat3<f64>) -> (Vec3<f32>, f32) {
    let (w, r) = svd::eigen_symmetric(covariance);
    let planarity = 1.0 - w[2] / w[1].max(1e-30);
    (vec3::cast(mat3::column(r, 2)), planarity as f32)
}

/// `true` only if the axis of the smallest eigenvalue of `c` is within the angle of squared sine `sin2` of the line of the unit vector
/// `n`; says `false` now and then where it is. Costs a twentieth of the eigenvectors: with θ the angle, `nᵀCn ≥ λ_mid sin²θ`, and
/// λ_mid is at least the smaller eigenvalue of C in the plane across n.
pub(crate) fn is_axis_within(c: Mat3<f64>, n: Vec3<f32>, sin2: f64) -> bool {
    let n: Vec3<f64> = vec3::cast(n);
    let (t1, t2) = vec3::frame_from_normal(n);
    let (c1, c2) = (mat3::mul_vec(c, t1), mat3::mul_vec(c, t2));
    let (a, b, d) = (vec3::dot(t1, c1), vec3::dot(t1, c2), vec3::dot(t2, c2));
    let least = 0.5 * (a + d) - (0.5 * (a - d)).hypot(b);
    // A little less than the bound: the vector is a unit vector in single precision only.
    vec3::dot(n, mat3::mul_vec(c, n)) < 0.99 * sin2 * least
}

/// Turns `normal` by `share` of what it exceeds the largest angle to the line of `axis`.
fn toward(normal: Vec3<f32>, axis: Vec3<f32>, share: f32) -> Vec3<f32> {
    let axis = if vec3::dot(axis, normal) < 0.0 { axis.map(|v| -v) } else { axis };
    let angle = vec3::dot(axis, normal).clamp(-1.0, 1.0).acos();
    if angle <= LARGEST || share <= 0.0 {
        return normal;
    }
    let q = quat::slerp([1.0, 0.0, 0.0, 0.0], quat::between(normal, axis), share * (angle - LARGEST) / angle);
    vec3::normalize_or(mat3::mul_vec(quat::to_mat3(q), normal), normal)
}

/// Share of the pairs of neighbours whose normals oppose each other, over at most 4096 Gaussians of one object with six
/// neighbours each. Thin walls and folds have some; a rise over the film means normals that went wrong.
pub(crate) fn opposing(position: &[Vec3<f32>], normal: &[Vec3<f32>], spacing: f32) -> f32 {
    if position.is_empty() || spacing <= 0.0 {
        return 0.0;
    }
    let rows = Rows::new(position, 1.5 * spacing);
    let (mut found, mut pairs, mut bad) = (Vec::new(), 0u32, 0u32);
    for s in (0..rows.len()).step_by(rows.len().div_ceil(CHECKED).max(1)) {
        rows.nearest([rows.x[s], rows.y[s], rows.z[s]], 7, 1.5 * spacing, 4.0 * spacing, &mut found);
        for f in found.iter().skip(1) {
            pairs += 1;
            let (a, b) = (normal[rows.item[s] as usize], normal[rows.item[f.1 as usize] as usize]);
            bad += u32::from(vec3::dot(a, b) < 0.0);
        }
    }
    bad as f32 / pairs.max(1) as f32
}

#[cfg(test)]
mod tests {
    use super::*;
    use megas_math::rng::Rng;

    #[test]
    fn the_quick_test_of_an_axis_never_says_yes_wrongly_and_mostly_yes_rightly() {
        let mut rng = Rng::new(5);
        let (mut right, mut said) = (0, 0);
        for _ in 0..20_000 {
            let r = quat::to_mat3::<f64>(std::array::from_fn(|_| rng.range(-1.0, 1.0)));
            let c = mat3::congruence(r, mat3::diag([1.0, rng.range(0.05, 1.0), rng.range(0.0, 0.02)]));
            let axis: Vec3<f32> = vec3::cast(mat3::column(svd::eigen_symmetric(c).1, 2));
            let tilt: Vec3<f32> = std::array::from_fn(|_| rng.range(-0.5, 0.5) as f32);
            let n = vec3::normalize_or(vec3::add(axis, tilt), axis);
            let within = vec3::dot(axis, n).abs().acos() <= LARGEST;
            let says = is_axis_within(c, n, SIN2_LARGEST);
            assert!(within || !says);
            right += usize::from(within);
            said += usize::from(says);
        }
        assert!(said * 2 > right, "{said} of {right}");
    }

    #[test]
    fn tilted_normals_of_melt_come_back_and_solids_keep_theirs() {
        let mut rng = Rng::new(2);
        let mut g = Gaussians::new(0);
        let mut phase = Vec::new();
        for i in 0..900 {
            let x = [(i % 30) as f32 * 0.1 + rng.range(-0.02, 0.02) as f32, (i / 30) as f32 * 0.1, 0.0];
            let n = vec3::normalize_or([1.2, 0.0, 1.0], [0.0; 3]);
            g.push(x, [1e-3, 0.0, 0.0, 1e-3, 0.0, 1e-5], n, 0.9, &[0.0; 3], 300.0);
            phase.push(u8::from(i % 2 == 0));
        }
        let n = normals(&g, &phase, |_| true, 0.1, Normals::TransportPca);
        for i in 0..900 {
            let angle = n[i][2].acos();
            if i % 2 == 0 {
                assert!((angle - LARGEST).abs() < 0.05, "{angle}");
            } else {
                assert_eq!(n[i], g.normal[i]);
            }
        }
        let axis = normals(&g, &phase, |_| true, 0.1, Normals::Axis);
        assert!(axis.iter().all(|n| n[2] > 0.9999));
        assert_eq!(opposing(&g.mean, &axis, 0.1), 0.0);
        let mixed: Vec<Vec3<f32>> = (0..900).map(|i| [0.0, 0.0, if i / 30 == 15 { -1.0 } else { 1.0 }]).collect();
        let bad = opposing(&g.mean, &mixed, 0.1);
        assert!(bad > 0.02 && bad < 0.15, "{bad}");
    }
}
