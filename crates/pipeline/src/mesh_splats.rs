//! Meshes drawn by the splat rasterizer: one flat Gaussian per triangle. Pictures of meshes then share shading, background,
//! temperature and occlusion with those of splats, and differ by the surface alone.

use megas_math::{sh, vec3};
use megas_model::Mesh;
use megas_raster::{Gaussians, pack_covariance};

/// Covariance of a drawn triangle over that of its uniform interior: wide enough that neighbours overlap without seams.
const SPREAD: f32 = 5.0;
/// Standard deviation across the surface over that along it.
const FLATNESS: f32 = 0.1;
/// Opacity at the middle of a triangle.
const OPACITY: f32 = 0.98;

/// Replaces `out` by the triangles of `mesh`. The degree of `out` stays; colours are those of the vertices, from all sides.
pub fn assign(out: &mut Gaussians, mesh: &Mesh) {
    out.clear();
    let mut coefficients = vec![0.0; out.sh_stride()];
    for t in &mesh.triangles {
        let [a, b, c] = t.map(|i| i as usize);
        let corner = [a, b, c].map(|i| mesh.positions[i]);
        let mean = |v: [[f32; 3]; 3]| -> [f32; 3] { std::array::from_fn(|k| (v[0][k] + v[1][k] + v[2][k]) / 3.0) };
        let centre = mean(corner);
        let across = vec3::cross(vec3::sub(corner[1], corner[0]), vec3::sub(corner[2], corner[0]));
        let twice_area = vec3::norm(across);
        if twice_area.is_nan() || twice_area <= 0.0 {
            continue;
        }
        let normal = vec3::scale(across, 1.0 / twice_area);
        // A uniform triangle has the covariance Σ d dᵀ / 12 of its corners.
        let thin = FLATNESS * FLATNESS * twice_area / 12.0;
        let arms = corner.map(|p| vec3::sub(p, centre));
        let covariance = std::array::from_fn(|i| {
            std::array::from_fn(|j| SPREAD * (arms.iter().map(|d| d[i] * d[j]).sum::<f32>() / 12.0 + thin * normal[i] * normal[j]))
        });
        let rgb = mean([a, b, c].map(|i| mesh.colours[i]));
        for k in 0..3 {
            coefficients[k] = sh::dc_from_rgb(rgb[k]);
        }
        let kelvin = [a, b, c].iter().map(|i| mesh.temperature[*i]).sum::<f32>() / 3.0;
        out.push(centre, pack_covariance(covariance), normal, OPACITY, &coefficients, kelvin);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use megas_model::Camera;
    use megas_raster::{Channels, Frame, Rasterizer, Settings};

    /// A ball with two triangles per patch of longitude and latitude.
    fn ball() -> Mesh {
        let mut mesh = Mesh::default();
        let (rings, sides) = (24u32, 48u32);
        for i in 0..=rings {
            for j in 0..sides {
                let (t, p) = (std::f32::consts::PI * i as f32 / rings as f32, std::f32::consts::TAU * j as f32 / sides as f32);
                mesh.positions.push([t.sin() * p.cos(), t.sin() * p.sin(), t.cos()]);
            }
        }
        for i in 0..rings {
            for j in 0..sides {
                let (a, b) = (i * sides + j, i * sides + (j + 1) % sides);
                mesh.triangles.push([a, a + sides, b]);
                mesh.triangles.push([b, a + sides, b + sides]);
            }
        }
        mesh.normals = mesh.positions.clone();
        mesh.colours = vec![[0.2, 0.5, 0.8]; mesh.positions.len()];
        mesh.temperature = vec![350.0; mesh.positions.len()];
        mesh
    }

    #[test]
    fn a_drawn_mesh_is_opaque_and_has_its_colour() {
        let mut g = Gaussians::new(1);
        assign(&mut g, &ball());
        // Those at the first pole have no area.
        assert_eq!(g.len(), ball().triangles.len() - 48);
        let camera = Camera::look_at([4.0, 0.5, 0.6], [0.0; 3], [0.0, 0.0, 1.0], 30.0, 96, 96);
        let mut frame = Frame::default();
        Rasterizer::new().render(&g, &camera, &Settings::default(), Channels::RgbaTemperature, &mut frame);
        let middle = 48 * 96 + 48;
        for k in [middle, middle + 10, middle - 10 * 96] {
            assert!(frame.alpha(k) > 0.985, "{}", frame.alpha(k));
            assert!((frame.temperature[k] / frame.alpha(k) - 350.0).abs() < 0.1);
        }
        assert!(frame.alpha(0) < 1e-3);
    }
}
