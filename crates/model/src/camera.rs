//! Cameras: x right, y down, z forward; pixel (i, j) has its centre at (i+½, j+½) (splatting.md §0.1).

use megas_math::{Mat3, Vec3, mat3, vec3};
use serde::{Deserialize, Serialize};

/// How camera space maps to pixels.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Projection {
    /// `u = fx·x/z + cx`, `v = fy·y/z + cy`, focal lengths in pixels.
    Pinhole {
        /// Horizontal focal length \[px\].
        fx: f32,
        /// Vertical focal length \[px\].
        fy: f32,
    },
    /// `u = s·x + cx`, `v = s·y + cy`, `s` in pixels per scene unit; every ray is parallel to z.
    Orthographic {
        /// Pixels per scene unit.
        scale: f32,
    },
}

/// A posed camera.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Camera {
    /// World→camera rotation `W` (rows are the camera's axes in the world).
    pub rotation: [[f32; 3]; 3],
    /// World→camera translation: `p = W x + t`.
    pub translation: [f32; 3],
    /// Projection model.
    pub projection: Projection,
    /// Principal point, horizontal \[px\].
    pub cx: f32,
    /// Principal point, vertical \[px\].
    pub cy: f32,
    /// Image width \[px\].
    pub width: u32,
    /// Image height \[px\].
    pub height: u32,
}

impl Camera {
    /// A pinhole camera at `eye` looking at `target`, `up` upward in the image, with a vertical field of view in radians
    /// and the principal point in the middle.
    pub fn look_at(eye: Vec3<f32>, target: Vec3<f32>, up: Vec3<f32>, fov_y: f32, width: u32, height: u32) -> Self {
        let f = 0.5 * height as f32 / (0.5 * fov_y).tan();
        Self::oriented(eye, vec3::sub(target, eye), up, Projection::Pinhole { fx: f, fy: f }, width, height)
    }

    /// An orthographic camera that looks along `forward` at `center`; half of the image's shorter side spans `half_size`
    /// scene units. The camera stands `distance` before the centre (only the reported depth depends on it).
    pub fn orthographic(
        center: Vec3<f32>,
        forward: Vec3<f32>,
        up: Vec3<f32>,
        half_size: f32,
        distance: f32,
        width: u32,
        height: u32,
    ) -> Self {
        let f = vec3::normalize_or(forward, [0.0, 0.0, 1.0]);
        let scale = 0.5 * width.min(height) as f32 / half_size;
        Self::oriented(vec3::add_scaled(center, f, -distance), f, up, Projection::Orthographic { scale }, width, height)
    }

    fn oriented(eye: Vec3<f32>, forward: Vec3<f32>, up: Vec3<f32>, projection: Projection, width: u32, height: u32) -> Self {
        let z = vec3::normalize_or(forward, [0.0, 0.0, 1.0]);
        let side = vec3::cross(z, up);
        // Looking straight along `up`: any horizontal direction will do, but always the same one.
        let x =
            if vec3::norm(side) > 1e-4 * vec3::norm(up) { vec3::normalize_or(side, [1.0, 0.0, 0.0]) } else { vec3::frame_from_normal(z).0 };
        let y = vec3::cross(z, x);
        let rotation = [x, y, z];
        let t = mat3::mul_vec(rotation, eye).map(|v| -v);
        Self { rotation, translation: t, projection, cx: 0.5 * width as f32, cy: 0.5 * height as f32, width, height }
    }

    /// Position of the camera in the world.
    pub fn center(&self) -> Vec3<f32> {
        mat3::tmul_vec(self.rotation, self.translation).map(|v| -v)
    }

    /// World → camera space.
    #[inline(always)]
    pub fn to_camera(&self, x: Vec3<f32>) -> Vec3<f32> {
        vec3::add(mat3::mul_vec(self.rotation, x), self.translation)
    }

    /// Camera space → continuous pixel coordinates.
    #[inline(always)]
    pub fn project(&self, p: Vec3<f32>) -> [f32; 2] {
        match self.projection {
            Projection::Pinhole { fx, fy } => [fx * p[0] / p[2] + self.cx, fy * p[1] / p[2] + self.cy],
            Projection::Orthographic { scale } => [scale * p[0] + self.cx, scale * p[1] + self.cy],
        }
    }

    /// Origin and unit direction, in the world, of the viewing ray through the continuous pixel position `(u, v)`.
    pub fn ray(&self, u: f32, v: f32) -> (Vec3<f32>, Vec3<f32>) {
        match self.projection {
            Projection::Pinhole { fx, fy } => {
                let d = [(u - self.cx) / fx, (v - self.cy) / fy, 1.0];
                (self.center(), vec3::normalize_or(mat3::tmul_vec(self.rotation, d), self.rotation[2]))
            }
            Projection::Orthographic { scale } => {
                let p = [(u - self.cx) / scale, (v - self.cy) / scale, 0.0];
                (mat3::tmul_vec(self.rotation, vec3::sub(p, self.translation)), self.rotation[2])
            }
        }
    }

    /// World axes of the camera's x, y, z as rows.
    pub fn axes(&self) -> Mat3<f32> {
        self.rotation
    }

    /// The same view at another resolution; intrinsics follow the exact size ratio.
    pub fn resized(&self, width: u32, height: u32) -> Self {
        let (sx, sy) = (width as f32 / self.width as f32, height as f32 / self.height as f32);
        let projection = match self.projection {
            Projection::Pinhole { fx, fy } => Projection::Pinhole { fx: fx * sx, fy: fy * sy },
            Projection::Orthographic { scale } => Projection::Orthographic { scale: scale * sx },
        };
        Self { projection, cx: self.cx * sx, cy: self.cy * sy, width, height, ..*self }
    }
}

/// `count` well-spread unit directions (Fibonacci sphere, splatting.md §7.1).
pub fn fibonacci_directions(count: usize) -> Vec<Vec3<f32>> {
    let golden = std::f64::consts::PI * (1.0 + 5f64.sqrt());
    (0..count)
        .map(|k| {
            let z = 1.0 - (2.0 * k as f64 + 1.0) / count as f64;
            let (s, c) = (golden * k as f64).sin_cos();
            let r = (1.0 - z * z).sqrt();
            [(r * c) as f32, (r * s) as f32, z as f32]
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rays_go_through_the_points_they_project_from() {
        let pin = Camera::look_at([3.0, -2.0, 1.5], [0.1, 0.2, 0.3], [0.0, 0.0, 1.0], 0.8, 640, 480);
        let ortho = Camera::orthographic([0.1, 0.2, 0.3], [0.3, 0.5, -0.8], [0.0, 0.0, 1.0], 2.0, 5.0, 640, 480);
        for cam in [pin, ortho] {
            for x in [[0.4, 0.1, 0.2], [-0.3, 0.5, 0.9]] {
                let [u, v] = cam.project(cam.to_camera(x));
                let (o, d) = cam.ray(u, v);
                let e = vec3::sub(x, o);
                assert!(vec3::norm(vec3::cross(e, d)) < 1e-4 && vec3::dot(e, d) > 0.0);
            }
        }
        assert!((pin.project(pin.to_camera([0.1, 0.2, 0.3]))[0] - 320.0).abs() < 1e-3);
        // A point above the target appears above the middle: v grows downward.
        assert!(pin.project(pin.to_camera([0.1, 0.2, 0.5]))[1] < 240.0);
        assert!(vec3::norm(vec3::sub(pin.center(), [3.0, -2.0, 1.5])) < 1e-5);
    }
}
