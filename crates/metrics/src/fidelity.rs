//! How a deformed model looks against the deformed surface (splatting.md §9.3 M7).

use megas_math::vec3;
use megas_model::{Camera, Image, Mesh, fibonacci_directions};
use megas_raster::{Channels, Frame, Gaussians, Rasterizer, Settings};
use serde::{Deserialize, Serialize};

use crate::cracks::box_sphere;
use crate::image::{Quality, psnr};
use crate::mesh_view::mesh_image;

/// Views of the design and their side \[px\].
pub const VIEWS: usize = 24;
/// Side of a view \[px\].
pub const SIZE: u32 = 400;

/// Vertical field of view \[rad\] and the room about the sphere around the box.
const FIELD: f32 = 40.0 * std::f32::consts::PI / 180.0;
const ROOM: f32 = 1.05;
/// Points per pixel along one side at which the true surface is drawn.
const SAMPLES: u32 = 4;
const WHITE: [f32; 3] = [1.0; 3];

/// Differences, as means over the views.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Fidelity {
    /// Whole pictures on white.
    pub picture: Quality,
    /// PSNR over the pixels that the true surface covers wholly \[dB\].
    pub psnr_inside: f64,
}

/// A view of the true surface.
#[derive(Clone, Debug)]
pub struct TrueView {
    /// Camera.
    pub camera: Camera,
    /// True picture on white.
    pub image: Image,
    /// Pixels that the surface covers wholly.
    pub inside: Vec<bool>,
}

/// The views that a deformed model is judged in; they depend on the true surface alone.
#[derive(Clone, Debug)]
pub struct TrueViews(pub Vec<TrueView>);

impl TrueViews {
    /// `count` views of `size`² about a mesh with vertex colours; 24 of 400² in the design.
    pub fn new(truth: &Mesh, count: usize, size: u32) -> Self {
        Self(perspective_views(truth, count, size).into_iter().map(|camera| TrueView::new(truth, camera)).collect())
    }

    /// Compares a model with the truth. Structural similarity and FLIP take most of the time; without `all` they stay zero.
    pub fn measure(&self, model: &Gaussians, all: bool, rasterizer: &mut Rasterizer) -> Fidelity {
        let mut frame = Frame::default();
        let mut inside = 0.0;
        let views: Vec<Quality> = self
            .0
            .iter()
            .map(|v| {
                let image = draw(model, &v.camera, rasterizer, &mut frame);
                inside += psnr(&image, &v.image, Some(&v.inside));
                if all { Quality::of(&image, &v.image, None) } else { Quality { psnr: psnr(&image, &v.image, None), ..Quality::default() } }
            })
            .collect();
        Fidelity { picture: Quality::mean(&views).unwrap_or_default(), psnr_inside: inside / views.len().max(1) as f64 }
    }
}

impl TrueView {
    /// Draws the truth.
    pub fn new(truth: &Mesh, camera: Camera) -> Self {
        let rgba = mesh_image(truth, &camera, SAMPLES, WHITE);
        let inside = rgba.data.chunks_exact(4).map(|p| p[3] == 1.0).collect();
        let data = rgba.data.chunks_exact(4).flat_map(|p| [p[0], p[1], p[2]]).collect();
        Self { camera, image: Image { channels: 3, data, ..rgba }, inside }
    }
}

/// A model on white.
pub fn draw(model: &Gaussians, camera: &Camera, rasterizer: &mut Rasterizer, frame: &mut Frame) -> Image {
    let settings = Settings { background: WHITE, ..Settings::default() };
    rasterizer.render(model, camera, &settings, Channels::Rgba, frame);
    frame.rgb_image()
}

/// Well-spread cameras that see a whole mesh.
pub fn perspective_views(mesh: &Mesh, count: usize, size: u32) -> Vec<Camera> {
    let (centre, radius) = box_sphere(mesh);
    let distance = ROOM * radius / (0.5 * FIELD).sin();
    let camera = |d: [f32; 3]| Camera::look_at(vec3::add_scaled(centre, d, distance), centre, [0.0, 0.0, 1.0], FIELD, size, size);
    fibonacci_directions(count).into_iter().map(camera).collect()
}

#[cfg(test)]
mod tests {
    use megas_math::{quat, sh};
    use megas_model::Splats;

    use super::*;

    /// A square facing +y and discs of its colour on it; without the discs of one quarter if `holed`.
    fn square(holed: bool) -> (Mesh, Gaussians) {
        let mut m = Mesh { positions: vec![[-1.0, 0.0, -1.0], [1.0, 0.0, -1.0], [1.0, 0.0, 1.0], [-1.0, 0.0, 1.0]], ..Mesh::default() };
        m.triangles = vec![[0, 1, 2], [0, 2, 3]];
        m.colours = vec![[0.2, 0.4, 0.6]; 4];
        let mut s = Splats::default();
        let n = 80;
        for i in 0..n * n {
            let at = |k: i32| (k as f32 + 0.5) / n as f32 * 2.0 - 1.0;
            let x = [at(i % n), 0.0, at(i / n)];
            if !(holed && x[0] > 0.0 && x[2] > 0.0) {
                let q = quat::between([0.0, 0.0, 1.0], [0.0, 1.0, 0.0]);
                s.push(x, [-4.2, -4.2, -7.0], q, 6.0, &[0.2, 0.4, 0.6].map(sh::dc_from_rgb));
            }
        }
        (m, Gaussians::from_splats(&s))
    }

    #[test]
    fn a_model_of_the_truth_is_good_and_a_missing_quarter_is_its_share_of_the_error() {
        let (mesh, model) = square(false);
        let camera = Camera::look_at([0.0, 4.0, 0.0], [0.0; 3], [0.0, 0.0, 1.0], 0.7, 120, 120);
        let views = TrueViews(vec![TrueView::new(&mesh, camera)]);
        let mut r = Rasterizer::new();
        let good = views.measure(&model, true, &mut r);
        // The discs of the rim reach about a pixel beyond the edge.
        assert!(good.picture.psnr > 20.0 && good.psnr_inside > 40.0 && good.picture.ssim > 0.9, "{good:?}");
        let bad = views.measure(&square(true).1, true, &mut r);
        // A quarter of the inside is white instead of the colour.
        let error: f64 = [0.8f64, 0.6, 0.4].iter().map(|d| d * d).sum::<f64>() / 3.0 / 4.0;
        assert!((bad.psnr_inside + 10.0 * error.log10()).abs() < 0.3, "{bad:?} {}", -10.0 * error.log10());
        assert!(bad.picture.psnr < good.picture.psnr - 5.0 && bad.picture.flip > good.picture.flip);
        let quick = views.measure(&model, false, &mut r);
        assert!(quick.picture.psnr == good.picture.psnr && quick.picture.ssim == 0.0);
    }

    #[test]
    fn cameras_see_the_whole_mesh() {
        let (mesh, _) = square(false);
        for camera in perspective_views(&mesh, 24, 100) {
            for &x in &mesh.positions {
                let [u, v] = camera.project(camera.to_camera(x));
                assert!((0.0..100.0).contains(&u) && (0.0..100.0).contains(&v));
            }
        }
    }
}
