//! A posed frame as plain splats, for other programs (splatting.md §8.3, last paragraph).

use megas_math::{Mat3, mat3, quat, sh, svd};
use megas_model::{Origin, Splats, logit};
use megas_raster::{Gaussians, unpack_covariance};
use rayon::prelude::*;

/// Opacity of files: 0.99 keeps the logit finite.
const MOST: f32 = 0.99;

/// Turns posed Gaussians into splats: axes from an eigen-decomposition of the covariance (largest first), colours rotated with
/// the appearance. Hidden Gaussians are left out. `surface` of them come first, the rest are internal particles.
pub fn bake_splats(g: &Gaussians, surface: usize) -> Splats {
    let shown: Vec<usize> = (0..g.len()).filter(|&i| g.visible.get(i).is_none_or(|v| *v)).collect();
    let stride = g.sh_stride();
    let rows: Vec<([f32; 3], [f32; 4], Vec<f32>)> = shown
        .par_iter()
        .map(|&i| {
            let (w, r) = svd::eigen_symmetric(mat3::cast::<f32, f64>(unpack_covariance(g.covariance[i])));
            let mut c = g.sh[i * stride..(i + 1) * stride].to_vec();
            if let Some(m) = g.view_rotation.get(i) {
                let m: Mat3<f64> = std::array::from_fn(|a| std::array::from_fn(|b| f64::from(m[3 * a + b])));
                if m != mat3::identity::<f64>() {
                    sh::rotate(g.sh_degree, &mut c, m);
                }
            }
            let scale = w.map(|v| (0.5 * v.max(1e-30).ln()) as f32);
            (scale, quat::from_mat3(r).map(|v| v as f32), c)
        })
        .collect();
    let mut out = Splats::with_capacity(g.sh_degree, rows.len());
    for (&i, (scale, rotation, c)) in shown.iter().zip(&rows) {
        out.push(g.mean[i], *scale, *rotation, logit(g.opacity[i].min(MOST)), c);
    }
    for (k, &i) in shown.iter().enumerate() {
        out.birth_id[k] = i as u32;
        out.temperature[k] = g.temperature.get(i).copied().unwrap_or(megas_model::AMBIENT_K);
        out.trained_pixel[k] = g.trained_pixel.get(i).copied().unwrap_or(0.0);
        if i >= surface {
            out.origin[k] = Origin::Internal as u8;
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn baked_splats_have_the_covariances_and_colours_they_came_from() {
        let mut s = Splats { sh_degree: 1, ..Splats::default() };
        let mut rng = megas_math::rng::Rng::new(3);
        for _ in 0..50 {
            let q = std::array::from_fn(|_| rng.range(-1.0, 1.0) as f32);
            let c: Vec<f32> = (0..12).map(|_| rng.range(-1.0, 1.0) as f32).collect();
            s.push([rng.unit() as f32; 3], std::array::from_fn(|_| rng.range(-3.0, -1.0) as f32), q, 1.0, &c);
        }
        let mut g = Gaussians::from_splats(&s);
        let turn = quat::to_mat3([0.8f32, 0.1, -0.5, 0.3]);
        g.set_view_rotation(7, turn);
        g.set_visible(3, false);
        let b = bake_splats(&g, 40);
        assert_eq!(b.len(), 49);
        for k in 0..b.len() {
            let i = b.birth_id[k] as usize;
            assert!(mat3::norm(mat3::sub(b.covariance(k), s.covariance(i))) < 1e-5);
            let d = [0.6f32, 0.0, 0.8];
            let seen = if i == 7 { mat3::tmul_vec(turn, d) } else { d };
            let (x, y) = (sh::colour(1, b.sh_of(k), d), sh::colour(1, s.sh_of(i), seen));
            assert!((0..3).all(|c| (x[c] - y[c]).abs() < 1e-5));
            assert_eq!(b.origin[k] == Origin::Internal as u8, i >= 40);
        }
    }
}
