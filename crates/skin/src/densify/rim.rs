//! Rims: where the skin ends, at a cut or a tear, its outermost Gaussians stick out over the edge by their own radius. They are trimmed:
//! narrower across the edge, and moved back so that their inner side stays where it was.
//!
//! A Gaussian is at a rim if no other of its object lies, in its plane, within a third of the directions around it or more. At a sharp
//! edge of a closed surface there are those of the other face.

use megas_math::{Vec3, mat3, vec3};
use megas_raster::{Gaussians, pack_covariance, unpack_covariance};
use rayon::prelude::*;

use super::cover::SECTORS;

/// Length of the sum of the directions (six, 60° apart) with neighbours, from which on there is an edge, and how far until it is
/// certain: 1 where one direction is empty, which is chance, √3 and 2 where two or three beside each other are.
const EDGE: [f32; 2] = [1.1, 0.5];
/// Mean distance of the neighbours, in the farthest distance searched, up to which emptiness means anything, and the range over which
/// that fades: a sheet drawn into a net is full of it.
const DENSE: [f32; 2] = [0.65, 0.15];
/// Share of its width across the edge that a Gaussian keeps.
const KEPT: f32 = 0.4;

/// Points out over the edge, as long as it is certain (0–1). `occupied`: sixths of the plane around `t1`, `t2` with neighbours.
pub(crate) fn edge(occupied: [bool; SECTORS], distance: f32, reach: f32, t1: Vec3<f32>, t2: Vec3<f32>) -> Vec3<f32> {
    let (mut a, mut b) = (0.0, 0.0);
    for k in (0..SECTORS).filter(|&k| occupied[k]) {
        let (s, c) = (std::f32::consts::TAU * (k as f32 + 0.5) / SECTORS as f32).sin_cos();
        (a, b) = (a - c, b - s);
    }
    let length = a.hypot(b);
    let dense = ((DENSE[0] - distance / reach) / DENSE[1]).clamp(0.0, 1.0);
    let certain = dense * ((length - EDGE[0]) / EDGE[1]).clamp(0.0, 1.0) / length.max(1e-6);
    std::array::from_fn(|k| certain * (a * t1[k] + b * t2[k]))
}

/// Trims the Gaussians whose `rim` is not zero.
pub(crate) fn trim(surface: &mut Gaussians, rim: &[Vec3<f32>]) {
    let both = surface.covariance.par_iter_mut().zip(&mut surface.mean).zip(rim);
    both.with_min_len(1024).filter(|(_, e)| **e != [0.0; 3]).for_each(|((covariance, mean), e)| {
        let certain = vec3::norm(*e);
        let u = vec3::normalize_or(*e, [0.0; 3]);
        let s = unpack_covariance(*covariance);
        let width = vec3::dot(u, mat3::mul_vec(s, u)).max(0.0).sqrt();
        let less = certain.min(1.0) * (1.0 - KEPT);
        let f = std::array::from_fn(|r| std::array::from_fn(|k| f32::from(u8::from(r == k)) - less * u[r] * u[k]));
        *covariance = pack_covariance(mat3::congruence(f, s));
        *mean = vec3::add_scaled(*mean, u, -less * width);
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn emptiness_on_one_side_is_an_edge_and_chance_is_not() {
        let (t1, t2) = ([1.0, 0.0, 0.0], [0.0, 1.0, 0.0]);
        let at = |empty: &[usize], distance: f32| edge(std::array::from_fn(|k| !empty.contains(&k)), distance, 1.0, t1, t2);
        assert!(vec3::norm(at(&[], 0.3)) < 1e-5 && vec3::norm(at(&[2], 0.3)) < 1e-5 && vec3::norm(at(&[0, 3], 0.3)) < 1e-5);
        // The middle of the empty sectors is at 90°.
        let e = at(&[0, 1, 2], 0.3);
        assert!((e[1] - 1.0).abs() < 1e-5 && e[0].abs() < 1e-5, "{e:?}");
        assert!((vec3::norm(at(&[4, 5], 0.3)) - 1.0).abs() < 1e-5);
        assert!(vec3::norm(at(&[0, 1, 2], 0.6)) < 0.4 && at(&[0, 1, 2], 0.7) == [0.0; 3]);
    }

    #[test]
    fn a_trimmed_disc_keeps_its_inner_side() {
        let mut g = Gaussians::new(0);
        for _ in 0..2 {
            g.push([1.0, 2.0, 3.0], [0.04, 0.0, 0.0, 0.04, 0.0, 1e-6], [0.0, 0.0, 1.0], 0.9, &[0.0; 3], 300.0);
        }
        let before = g.clone();
        trim(&mut g, &[[0.0, 1.0, 0.0], [0.0; 3]]);
        assert_eq!((g.mean[1], g.covariance[1]), (before.mean[1], before.covariance[1]));
        let [xx, xy, _, yy, _, zz] = g.covariance[0];
        assert!(xx == 0.04 && xy == 0.0 && zz == 1e-6 && (yy.sqrt() - 0.4 * 0.2).abs() < 1e-6);
        assert!((g.mean[0][1] - yy.sqrt() - (2.0 - 0.2)).abs() < 1e-6);
    }
}
