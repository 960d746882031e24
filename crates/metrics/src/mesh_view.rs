//! Pictures of triangle meshes by z-buffer: what the splats of an object should look like (splatting.md §9.2).
//!
//! Both sides of a triangle are drawn. Triangles that reach behind the camera are left out: cameras stand outside of what
//! they look at.

use megas_math::{Vec3, vec3};
use megas_model::{Camera, Image, Mesh, Projection};
use rayon::prelude::*;

/// [`MeshGeometry::triangle`] where there is none.
pub const NO_TRIANGLE: u32 = u32::MAX;

/// Rows of samples that are worked on at once.
const BAND: usize = 32;
/// Triangles nearer than this are left out \[scene units\].
const NEAR: f64 = 1e-3;

/// What the ray through the centre of every pixel meets first.
#[derive(Clone, Debug, PartialEq)]
pub struct MeshGeometry {
    /// Width \[px\].
    pub width: u32,
    /// Height \[px\].
    pub height: u32,
    /// Depth along the camera's z \[scene units\]; ∞ where nothing is.
    pub depth: Vec<f32>,
    /// Triangle, [`NO_TRIANGLE`] where nothing is.
    pub triangle: Vec<u32>,
    /// Weights of the triangle's corners; zero where nothing is.
    pub weights: Vec<[f32; 3]>,
}

impl MeshGeometry {
    /// Draws a mesh.
    pub fn new(mesh: &Mesh, camera: &Camera) -> Self {
        let (width, height) = (camera.width as usize, camera.height as usize);
        let scene = Projected::new(mesh, camera);
        let bands = scene.bands(height);
        let samples: Vec<Vec<Sample>> = bands.par_iter().enumerate().map(|(b, list)| scene.draw(list, width, height, b)).collect();
        let samples = samples.iter().flatten();
        let weights = samples.clone().enumerate().map(|(i, s)| scene.weights(s, i % width, i / width)).collect();
        Self {
            width: camera.width,
            height: camera.height,
            depth: samples.clone().map(|s| s.depth as f32).collect(),
            triangle: samples.map(|s| s.triangle).collect(),
            weights,
        }
    }

    /// Unit normal of the triangle at pixel `i`, world axes, on the side that the winding says; `None` where nothing is.
    pub fn normal(&self, mesh: &Mesh, i: usize) -> Option<Vec3<f32>> {
        let t = mesh.triangles.get(self.triangle[i] as usize)?;
        let [a, b, c] = t.map(|v| mesh.positions[v as usize]);
        Some(vec3::normalize_or(vec3::cross(vec3::sub(b, a), vec3::sub(c, a)), [0.0, 0.0, 1.0]))
    }

    /// A vertex attribute interpolated at pixel `i`; `None` where nothing is.
    pub fn attribute(&self, mesh: &Mesh, values: &[[f32; 3]], i: usize) -> Option<[f32; 3]> {
        let t = mesh.triangles.get(self.triangle[i] as usize)?;
        Some(interpolate(values, *t, self.weights[i]))
    }

    /// True at the pixels whose centre the mesh covers.
    pub fn silhouette(&self) -> Vec<bool> {
        self.triangle.iter().map(|t| *t != NO_TRIANGLE).collect()
    }
}

/// The vertex colours of a mesh, averaged over `samples`² points of every pixel and put on `background`; four channels, the
/// last is the covered fraction.
pub fn mesh_image(mesh: &Mesh, camera: &Camera, samples: u32, background: [f32; 3]) -> Image {
    assert_eq!(mesh.colours.len(), mesh.positions.len(), "a colour for every vertex");
    let n = samples.max(1);
    let fine = camera.resized(camera.width * n, camera.height * n);
    let (width, height) = (fine.width as usize, fine.height as usize);
    let scene = Projected::new(mesh, &fine);
    let n = n as usize;
    // A band is made of whole pixels.
    let rows = BAND.next_multiple_of(n);
    let bands = scene.bands_of(height, rows);
    let pixels = width / n;
    let drawn: Vec<Vec<f32>> = bands
        .par_iter()
        .enumerate()
        .map(|(b, list)| {
            let fine = scene.draw_rows(list, width, height, b * rows, rows);
            let mut out = vec![0.0f32; fine.len() / (n * n) * 4];
            for (p, out) in out.chunks_exact_mut(4).enumerate() {
                let (x, y) = (p % pixels, p / pixels);
                let mut sum = [0.0f64; 4];
                for s in 0..n * n {
                    let (i, j) = (x * n + s % n, y * n + s / n);
                    let sample = &fine[j * width + i];
                    let c = match mesh.triangles.get(sample.triangle as usize) {
                        Some(t) => {
                            let c = interpolate(&mesh.colours, *t, scene.weights(sample, i, b * rows + j));
                            sum[3] += 1.0;
                            c
                        }
                        None => background,
                    };
                    (0..3).for_each(|k| sum[k] += f64::from(c[k]));
                }
                (0..4).for_each(|k| out[k] = (sum[k] / (n * n) as f64) as f32);
            }
            out
        })
        .collect();
    Image { width: camera.width, height: camera.height, channels: 4, data: drawn.concat() }
}

fn interpolate(values: &[[f32; 3]], t: [u32; 3], w: [f32; 3]) -> [f32; 3] {
    let [a, b, c] = t.map(|v| values[v as usize]);
    std::array::from_fn(|k| w[0] * a[k] + w[1] * b[k] + w[2] * c[k])
}

/// The nearest triangle of a sample.
#[derive(Clone, Copy)]
struct Sample {
    depth: f64,
    triangle: u32,
}

const EMPTY: Sample = Sample { depth: f64::INFINITY, triangle: NO_TRIANGLE };

/// A mesh in pixels.
struct Projected<'a> {
    mesh: &'a Mesh,
    /// Position in the image, and what is affine in it: 1/z seen in perspective, z without.
    corner: Vec<[f64; 3]>,
    perspective: bool,
}

impl<'a> Projected<'a> {
    fn new(mesh: &'a Mesh, camera: &Camera) -> Self {
        let w = camera.rotation.map(|r| r.map(f64::from));
        let t = camera.translation.map(f64::from);
        let (cx, cy) = (f64::from(camera.cx), f64::from(camera.cy));
        let perspective = matches!(camera.projection, Projection::Pinhole { .. });
        let corner = mesh.positions.par_iter().map(|&x| {
            let p = vec3::add(megas_math::mat3::mul_vec(w, vec3::cast(x)), t);
            match camera.projection {
                Projection::Pinhole { fx, fy } if p[2] > NEAR => {
                    [f64::from(fx) * p[0] / p[2] + cx, f64::from(fy) * p[1] / p[2] + cy, 1.0 / p[2]]
                }
                Projection::Pinhole { .. } => [f64::NAN; 3],
                Projection::Orthographic { scale } => [f64::from(scale) * p[0] + cx, f64::from(scale) * p[1] + cy, p[2]],
            }
        });
        Self { mesh, corner: corner.collect(), perspective }
    }

    fn corners(&self, t: u32) -> [[f64; 3]; 3] {
        self.mesh.triangles[t as usize].map(|v| self.corner[v as usize])
    }

    fn bands(&self, height: usize) -> Vec<Vec<u32>> {
        self.bands_of(height, BAND)
    }

    /// The triangles of every band of `rows` rows, in the order of the mesh.
    fn bands_of(&self, height: usize, rows: usize) -> Vec<Vec<u32>> {
        let mut bands = vec![Vec::new(); height.div_ceil(rows)];
        for t in 0..self.mesh.triangles.len() as u32 {
            let c = self.corners(t);
            if c.as_flattened().iter().any(|v| !v.is_finite()) {
                continue;
            }
            let low = c[0][1].min(c[1][1]).min(c[2][1]);
            let high = c[0][1].max(c[1][1]).max(c[2][1]);
            if high < 0.0 || low > height as f64 {
                continue;
            }
            let first = (low.max(0.0) as usize / rows).min(bands.len() - 1);
            let last = (high.max(0.0) as usize / rows).min(bands.len() - 1);
            bands[first..=last].iter_mut().for_each(|b| b.push(t));
        }
        bands
    }

    fn draw(&self, list: &[u32], width: usize, height: usize, band: usize) -> Vec<Sample> {
        self.draw_rows(list, width, height, band * BAND, BAND)
    }

    /// The samples of rows `first..first + rows` that exist.
    fn draw_rows(&self, list: &[u32], width: usize, height: usize, first: usize, rows: usize) -> Vec<Sample> {
        let rows = rows.min(height - first);
        let mut out = vec![EMPTY; rows * width];
        for &t in list {
            let [a, b, c] = self.corners(t);
            let area = cross(a, b, c);
            if area == 0.0 {
                continue;
            }
            // Pixels whose centres can lie inside.
            let range = |k: usize, from: usize, to: usize| {
                let low = a[k].min(b[k]).min(c[k]) - 0.5;
                let high = a[k].max(b[k]).max(c[k]) - 0.5;
                (low.ceil().max(from as f64) as usize, ((high.floor() + 1.0).max(0.0) as usize).min(to))
            };
            let ((x0, x1), (y0, y1)) = (range(0, 0, width), range(1, first, first + rows));
            for y in y0..y1 {
                for x in x0..x1 {
                    let p = [x as f64 + 0.5, y as f64 + 0.5, 0.0];
                    let w = [cross(p, b, c) / area, cross(a, p, c) / area, cross(a, b, p) / area];
                    // A sample on an edge belongs to both sides: the nearer one, then the first, wins.
                    if w.iter().any(|w| *w < 0.0) {
                        continue;
                    }
                    let affine = w[0] * a[2] + w[1] * b[2] + w[2] * c[2];
                    let depth = if self.perspective { 1.0 / affine } else { affine };
                    let sample = &mut out[(y - first) * width + x];
                    if depth < sample.depth {
                        *sample = Sample { depth, triangle: t };
                    }
                }
            }
        }
        out
    }

    /// Weights of the corners in space at the sample in column `x` and row `y`.
    fn weights(&self, s: &Sample, x: usize, y: usize) -> [f32; 3] {
        if s.triangle == NO_TRIANGLE {
            return [0.0; 3];
        }
        let [a, b, c] = self.corners(s.triangle);
        let p = [x as f64 + 0.5, y as f64 + 0.5, 0.0];
        let area = cross(a, b, c);
        let w = [cross(p, b, c) / area, cross(a, p, c) / area, cross(a, b, p) / area];
        let w = if self.perspective { [w[0] * a[2] * s.depth, w[1] * b[2] * s.depth, w[2] * c[2] * s.depth] } else { w };
        w.map(|v| v as f32)
    }
}

/// Twice the signed area of a triangle in the image.
#[inline(always)]
fn cross(a: [f64; 3], b: [f64; 3], c: [f64; 3]) -> f64 {
    (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_shapes::ball;

    #[test]
    fn depth_and_attributes_of_a_ball_are_those_of_the_rays() {
        // The vertices carry their position as colour.
        let mut m = ball(200);
        m.colours = m.positions.clone();
        let pin = Camera::look_at([2.0, 2.5, 1.0], [0.1, 0.0, 0.1], [0.0, 0.0, 1.0], 0.7, 90, 70);
        let flat = Camera::orthographic([0.1, 0.0, 0.1], [-1.0, 0.3, -0.4], [0.0, 0.0, 1.0], 1.2, 3.0, 90, 70);
        for camera in [pin, flat] {
            let g = MeshGeometry::new(&m, &camera);
            let mut hits = 0;
            for i in 0..g.depth.len() {
                let (o, d) = camera.ray((i % 90) as f32 + 0.5, (i / 90) as f32 + 0.5);
                let (b, c) = (vec3::dot(o, d), vec3::dot(o, o) - 1.0);
                let disc = b * b - c;
                if disc.abs() < 0.03 {
                    continue;
                }
                assert_eq!(disc > 0.0, g.triangle[i] != NO_TRIANGLE);
                if disc > 0.0 {
                    hits += 1;
                    let x = vec3::add_scaled(o, d, -b - disc.sqrt());
                    assert!((camera.to_camera(x)[2] - g.depth[i]).abs() < 2e-3);
                    let position = g.attribute(&m, &m.positions, i).unwrap();
                    assert!(vec3::norm(vec3::sub(position, x)) < 4e-3);
                    assert!(vec3::dot(g.normal(&m, i).unwrap(), x) > 0.999);
                }
            }
            assert!(hits > 1000);
        }
    }

    #[test]
    fn coverage_is_the_area_and_colour_is_interpolated() {
        // A square of side 1 seen from the front fills a fractional number of pixels.
        let mut m = Mesh { positions: vec![[-0.5, 0.0, -0.5], [0.5, 0.0, -0.5], [0.5, 0.0, 0.5], [-0.5, 0.0, 0.5]], ..Mesh::default() };
        m.triangles = vec![[0, 1, 2], [0, 2, 3]];
        m.colours = vec![[0.0, 0.5, 1.0], [1.0, 0.5, 1.0], [1.0, 0.5, 1.0], [0.0, 0.5, 1.0]];
        let camera = Camera::orthographic([0.0; 3], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], 0.77, 2.0, 40, 40);
        let image = mesh_image(&m, &camera, 4, [0.25, 0.5, 0.0]);
        let covered: f32 = image.data.chunks_exact(4).map(|p| p[3]).sum();
        let exact = (20.0f32 / 0.77).powi(2);
        assert!((covered / exact - 1.0).abs() < 0.02, "{covered} {exact}");
        let middle = image.pixel(20, 20);
        let x = (0.5 / 20.0) * 0.77 + 0.5;
        assert!((middle[0] - x).abs() < 1e-3 && middle[1] == 0.5 && middle[2] == 1.0 && middle[3] == 1.0);
        assert_eq!(image.pixel(0, 0), [0.25, 0.5, 0.0, 0.0]);
        // Every pixel mixes colour and background by its coverage.
        assert!(image.data.chunks_exact(4).all(|p| (p[2] - p[3]).abs() < 1e-6));
    }

    #[test]
    fn what_is_nearer_hides_and_what_is_behind_the_camera_is_left_out() {
        let mut m = Mesh::default();
        for (y, colour) in [(0.5, [1.0, 0.0, 0.0]), (0.0, [0.0, 1.0, 0.0]), (-9.0, [0.0, 0.0, 1.0])] {
            let first = m.positions.len() as u32;
            m.positions.extend([[-1.0, y, -1.0], [1.0, y, -1.0], [0.0, y, 1.5]]);
            m.colours.extend([colour; 3]);
            m.triangles.push([first, first + 1, first + 2]);
        }
        let camera = Camera::look_at([0.0, -3.0, 0.0], [0.0; 3], [0.0, 0.0, 1.0], 0.5, 31, 31);
        let image = mesh_image(&m, &camera, 2, [1.0; 3]);
        assert_eq!(image.pixel(15, 15), [0.0, 1.0, 0.0, 1.0]);
        let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
        assert_eq!(pool.install(|| mesh_image(&m, &camera, 2, [1.0; 3])), image);
    }
}
