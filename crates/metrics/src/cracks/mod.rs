//! Cracks of a deformed model (splatting.md §9.3 M6). A ray through a crack of a closed shell meets the far wall, so opacity
//! alone sees none: only what lies at the true surface counts.

mod front;

pub use front::{FrontLayer, front_layer};

use megas_math::vec3;
use megas_model::{Camera, Mesh, fibonacci_directions};
use megas_raster::Gaussians;
use serde::{Deserialize, Serialize};

use crate::mesh_view::MeshGeometry;

/// Views of [`CrackViews::new`] and their side \[px\].
pub const VIEWS: usize = 24;
/// Side of a view \[px\].
pub const SIZE: u32 = 256;
/// Half of the window about the true depth, in diagonals L.
pub const WINDOW: f64 = 0.03;

/// The silhouette is eroded by this before it is looked at, and dilated by this before anything counts as spilt \[px\].
const ERODE: i32 = 2;
const DILATE: i32 = 3;
/// Half size of a view in radii of the sphere about the box.
const ROOM: f32 = 1.05;
/// Connected cracked pixels that count as a hole.
const HOLE: usize = 4;
/// Front opacity below which a pixel is cracked, and opacity below which the silhouette has a hole.
const CRACKED: f32 = 0.5;

/// What is cracked, over the pixels of all views.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Cracks {
    /// Mean of `1 − A_f` inside the silhouette.
    pub front_deficit: f64,
    /// Fraction of it with `A_f < 0.5`.
    pub crack_fraction: f64,
    /// The same without the pixels within 2 px of a place where the surface hides itself (its depth jumps by more than the window):
    /// there a pixel sees two layers, in a perfect model too.
    pub off_contours: f64,
    /// The part of the crack fraction where what is there instead lies before the true surface: the model of a nearer part sticks out
    /// over its outline. In the rest the surface is not covered.
    pub overlapped: f64,
    /// Connected sets of at least four such pixels, mean per view.
    pub holes: f64,
    /// The largest of them, as a fraction of its view's silhouette.
    pub largest_hole: f64,
    /// Mean of `1 − A` inside the silhouette.
    pub alpha_deficit: f64,
    /// Fraction of it with `A < 0.5`.
    pub silhouette_holes: f64,
    /// Mean of `A` outside of the silhouette.
    pub spill: f64,
}

/// One view of the true surface.
#[derive(Clone, Debug)]
pub struct CrackView {
    /// Orthographic camera.
    pub camera: Camera,
    /// True depth.
    pub depth: Vec<f32>,
    /// Pixels inside the eroded silhouette.
    pub inside: Vec<bool>,
    /// Pixels outside the dilated silhouette.
    pub outside: Vec<bool>,
    /// Pixels near a jump of the depth.
    pub contour: Vec<bool>,
}

/// The views that cracks are looked for in; they depend on the true surface alone.
#[derive(Clone, Debug)]
pub struct CrackViews {
    /// The views.
    pub views: Vec<CrackView>,
    window: f32,
}

impl CrackViews {
    /// The views of the design: 24 orthographic ones of 256² about the (deformed) true surface; `diagonal` is L at rest.
    pub fn new(truth: &Mesh, diagonal: f64) -> Self {
        Self::with(truth, diagonal, VIEWS, SIZE)
    }

    /// As [`CrackViews::new`] with another number and size of views.
    pub fn with(truth: &Mesh, diagonal: f64, count: usize, size: u32) -> Self {
        let views = orthographic_views(truth, count, size).into_iter().map(|camera| {
            let geometry = MeshGeometry::new(truth, &camera);
            let solid = geometry.silhouette();
            let empty: Vec<bool> = solid.iter().map(|s| !s).collect();
            let inside = grown(&empty, size as i32, ERODE).iter().map(|near| !near).collect();
            let outside = grown(&solid, size as i32, DILATE).iter().map(|near| !near).collect();
            let jumps = jumps(&geometry.depth, size as usize, (WINDOW * diagonal) as f32);
            CrackView { camera, depth: geometry.depth, inside, outside, contour: grown(&jumps, size as i32, ERODE) }
        });
        Self { views: views.collect(), window: (WINDOW * diagonal) as f32 }
    }

    /// Measures a deformed model.
    pub fn measure(&self, model: &Gaussians) -> Cracks {
        let mut sum = Cracks::default();
        let (mut inside, mut outside, mut smooth) = (0usize, 0usize, 0usize);
        for view in &self.views {
            let layer = front_layer(model, &view.camera, &view.depth, self.window);
            let mut cracked = vec![false; layer.alpha.len()];
            let mut here = 0usize;
            for i in 0..layer.alpha.len() {
                let (a, f) = (layer.alpha[i], layer.front[i]);
                if view.inside[i] {
                    here += 1;
                    cracked[i] = f < CRACKED;
                    sum.front_deficit += f64::from(1.0 - f);
                    sum.crack_fraction += f64::from(u8::from(cracked[i]));
                    sum.overlapped += f64::from(u8::from(cracked[i] && layer.near[i] > 0.5 * (1.0 - f)));
                    if !view.contour[i] {
                        smooth += 1;
                        sum.off_contours += f64::from(u8::from(cracked[i]));
                    }
                    sum.alpha_deficit += f64::from(1.0 - a);
                    sum.silhouette_holes += f64::from(u8::from(a < CRACKED));
                } else if view.outside[i] {
                    outside += 1;
                    sum.spill += f64::from(a);
                }
            }
            inside += here;
            let holes: Vec<usize> = components(&cracked, view.camera.width as usize).into_iter().filter(|n| *n >= HOLE).collect();
            sum.holes += holes.len() as f64;
            let largest = holes.into_iter().max().unwrap_or(0) as f64 / here.max(1) as f64;
            sum.largest_hole = sum.largest_hole.max(largest);
        }
        let (n, m) = (inside.max(1) as f64, outside.max(1) as f64);
        Cracks {
            front_deficit: sum.front_deficit / n,
            crack_fraction: sum.crack_fraction / n,
            off_contours: sum.off_contours / smooth.max(1) as f64,
            overlapped: sum.overlapped / n,
            holes: sum.holes / self.views.len().max(1) as f64,
            largest_hole: sum.largest_hole,
            alpha_deficit: sum.alpha_deficit / n,
            silhouette_holes: sum.silhouette_holes / n,
            spill: sum.spill / m,
        }
    }
}

/// Middle and radius of the sphere about a mesh's box.
pub fn box_sphere(mesh: &Mesh) -> ([f32; 3], f32) {
    let used = mesh.triangles.iter().flatten().map(|&i| mesh.positions[i as usize]);
    let (low, high) = used.fold(([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]), |(l, h), x| (vec3::min(l, x), vec3::max(h, x)));
    (vec3::scale(vec3::add(low, high), 0.5), 0.5 * vec3::norm(vec3::sub(high, low)))
}

/// Well-spread orthographic cameras that see a whole mesh.
pub fn orthographic_views(mesh: &Mesh, count: usize, size: u32) -> Vec<Camera> {
    let (centre, radius) = box_sphere(mesh);
    let camera = |d: [f32; 3]| Camera::orthographic(centre, d.map(|v| -v), [0.0, 0.0, 1.0], ROOM * radius, 2.0 * radius, size, size);
    fibonacci_directions(count).into_iter().map(camera).collect()
}

/// Pixels whose depth differs by more than `window` from that of the pixel to the right or below, both inside the silhouette.
fn jumps(depth: &[f32], width: usize, window: f32) -> Vec<bool> {
    let mut out = vec![false; depth.len()];
    for i in 0..depth.len() {
        for j in [(i % width + 1 < width).then_some(i + 1), (i + width < depth.len()).then_some(i + width)].into_iter().flatten() {
            if (depth[i] - depth[j]).abs() > window && depth[i].is_finite() && depth[j].is_finite() {
                (out[i], out[j]) = (true, true);
            }
        }
    }
    out
}

/// Pixels of a square image within `reach` (centre to centre) of a set one.
fn grown(set: &[bool], size: i32, reach: i32) -> Vec<bool> {
    let mut out = set.to_vec();
    for y in 0..size {
        for x in 0..size {
            if !set[(y * size + x) as usize] {
                continue;
            }
            for dy in -reach..=reach {
                for dx in -reach..=reach {
                    let (u, v) = (x + dx, y + dy);
                    if dx * dx + dy * dy <= reach * reach && (0..size).contains(&u) && (0..size).contains(&v) {
                        out[(v * size + u) as usize] = true;
                    }
                }
            }
        }
    }
    out
}

/// Sizes of the sets of pixels that touch along edges.
fn components(set: &[bool], width: usize) -> Vec<usize> {
    let mut seen = vec![false; set.len()];
    let mut sizes = Vec::new();
    let mut stack = Vec::new();
    for start in 0..set.len() {
        if !set[start] || seen[start] {
            continue;
        }
        seen[start] = true;
        stack.push(start);
        let mut size = 0;
        while let Some(i) = stack.pop() {
            size += 1;
            let x = i % width;
            let near = [
                (x > 0).then(|| i - 1),
                (x + 1 < width).then_some(i + 1),
                i.checked_sub(width),
                (i + width < set.len()).then_some(i + width),
            ];
            for j in near.into_iter().flatten() {
                if set[j] && !seen[j] {
                    seen[j] = true;
                    stack.push(j);
                }
            }
        }
        sizes.push(size);
    }
    sizes
}

#[cfg(test)]
mod tests {
    use megas_math::quat;
    use megas_model::Splats;

    use super::*;
    use crate::test_shapes::ball;

    /// Opaque discs on the unit sphere where `keep` holds.
    fn shell(count: usize, keep: impl Fn([f32; 3]) -> bool) -> Gaussians {
        let size = (4.0 * std::f32::consts::PI / count as f32).sqrt();
        let mut s = Splats::default();
        for d in fibonacci_directions(count).into_iter().filter(|d| keep(*d)) {
            let l = (0.65 * size).ln();
            s.push(d, [l, l, l - 3.0], quat::between([0.0, 0.0, 1.0], d), 6.0, &[0.0; 3]);
        }
        Gaussians::from_splats(&s)
    }

    #[test]
    fn a_hole_of_known_area_is_found_though_the_far_wall_hides_it() {
        let views = CrackViews::with(&ball(60), 2.0 * 3f64.sqrt(), 24, 160);
        let whole = views.measure(&shell(60_000, |_| true));
        assert!(whole.crack_fraction == 0.0 && whole.front_deficit < 0.01 && whole.holes == 0.0, "{whole:?}");
        assert!(whole.spill < 1e-6);
        // Without the cap of 20° the fraction is that of the pixels whose true point lies in it, less what the discs at its
        // rim reach: two of their standard deviations in the image, √(0.0095² + 0.3 px²) = 0.016.
        let cos = 20f32.to_radians().cos();
        let holed = views.measure(&shell(60_000, |d| d[2] < cos));
        let inner = (20f32.to_radians() - 0.032).cos();
        let (mut all, mut open, mut surely) = (0u32, 0u32, 0u32);
        for v in &views.views {
            for i in (0..v.depth.len()).filter(|&i| v.inside[i]) {
                let (o, d) = v.camera.ray((i % 160) as f32 + 0.5, (i / 160) as f32 + 0.5);
                let z0 = v.camera.to_camera(o)[2];
                let x = vec3::add_scaled(o, d, v.depth[i] - z0);
                all += 1;
                open += u32::from(x[2] > cos);
                surely += u32::from(x[2] > inner);
            }
        }
        let bounds = [surely, open].map(|n| f64::from(n) / f64::from(all));
        assert!(bounds[0] > 0.02 && holed.crack_fraction > bounds[0] && holed.crack_fraction < bounds[1], "{holed:?} {bounds:?}");
        assert!(holed.alpha_deficit < 0.2 * holed.front_deficit, "the far wall hides it from alpha: {holed:?}");
        assert!(holed.holes > 0.2 && holed.holes < 0.6 && holed.largest_hole > 0.05, "{holed:?}");
    }

    #[test]
    fn opacity_beside_the_object_is_spill() {
        let views = CrackViews::with(&ball(60), 2.0 * 3f64.sqrt(), 6, 96);
        let mut g = shell(8_000, |_| true);
        let clean = views.measure(&g);
        g.push([1.2, 0.0, 0.0], [0.01, 0.0, 0.0, 0.01, 0.0, 0.01], [1.0, 0.0, 0.0], 0.9, &[0.0; 3], 293.0);
        let dirty = views.measure(&g);
        assert!(clean.spill < 1e-6 && dirty.spill > 1e-3, "{clean:?} {dirty:?}");
    }

    #[test]
    fn masks_and_components() {
        let mut set = vec![false; 100];
        set[55] = true;
        assert_eq!(grown(&set, 10, 2).iter().filter(|s| **s).count(), 13);
        let depth = [1.0, 1.05, 2.0, f32::INFINITY, 1.0, 1.0, 2.0, 2.0];
        assert_eq!(jumps(&depth, 4, 0.5), [false, true, true, false, false, true, true, false]);
        let picture = [1, 1, 0, 0, 1, 0, 0, 1, 0, 1, 0, 0].map(|v| v == 1);
        let mut sizes = components(&picture, 4);
        sizes.sort_unstable();
        assert_eq!(sizes, [1, 1, 3]);
    }
}
