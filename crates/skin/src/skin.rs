//! Poses the splats of a body after one frame of the simulation (splatting.md §8.1–8.5).

use megas_body::neighbours::Neighbours;
use megas_math::{Mat3, mat3, sh, vec3};
use megas_model::{FLAG_ESCAPED, Phase, PointFrame, Similarity, Splats};
use megas_raster::{Gaussians, pack_covariance};
use rayon::prelude::*;

use crate::{NeedleLimit, clamp_covariance, dull, gloss, lost_depth, push_forward, rebase_covariance, squeeze};

/// Which deformation carries the splats (splatting.md §8.2).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Push {
    /// The elastic gradient: rigid splats in the melt (the paper).
    Elastic,
    /// The limited total gradient: splats stretch with the flow and cover what opens.
    #[default]
    Total,
    /// The rotation of the total gradient only (ablation).
    Rotation,
}

/// How splats follow the points.
#[derive(Clone, Copy, Debug)]
pub struct SkinSettings {
    /// Deformation source.
    pub push: Push,
    /// Splats get narrower where the flow presses the surface together ([`crate::squeeze`]); matters for the elastic source.
    pub squeeze: bool,
    /// Depth of the means below the surface that the splats draw, kept when the flow changes it ([`crate::lost_depth`]) \[scene units\];
    /// 0 leaves them where the points are.
    pub depth: f64,
    /// What melts loses the highlights that were photographed ([`crate::dull`]).
    pub dull: bool,
    /// Needle clamp: largest aspect ρ = S¹/S² (default 4).
    pub needle_aspect: f64,
    /// Needle clamp: largest standard deviation τ_def \[scene units\]; infinite with an infinite aspect switches it off.
    pub needle_size: f64,
}

/// What the frames so far have left in a [`Skin`]: all that the next ones depend on.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SkinState {
    /// Covariances at rest, rebased and realigned, row by row.
    pub sigma0: Vec<[f64; 9]>,
    /// Rotations at rest by realignment; empty: none.
    pub turned: Vec<[f64; 9]>,
    /// Shares of the photographed highlights that are left; empty: all of them.
    pub gloss: Vec<f32>,
}

/// Kernels of the filled inside, which become visible where the surface opens. Points follow the surface points in the
/// simulator's input, in the same order.
#[derive(Clone, Debug, Default)]
pub struct InternalKernels {
    /// Colours in [0, 1].
    pub colour: Vec<[f32; 3]>,
    /// Positions at rest \[scene units\]; as many as colours.
    pub position: Vec<[f32; 3]>,
    /// Largest standard deviation of the isotropic kernels \[scene units\]; 0 shows none. A kernel closer to the surface is
    /// smaller, so that it stays below the skin.
    pub radius: f32,
}

/// The skin of a body. Feed it every frame in order ([`Skin::advance`]); pose any frame after it was fed.
#[derive(Clone, Debug)]
pub struct Skin {
    surface: Splats,
    internal: InternalKernels,
    similarity: Similarity,
    settings: SkinSettings,
    /// Covariances at rest, rebased; scene axes.
    sigma0: Vec<Mat3<f64>>,
    /// Rotation at rest that realignment has given each Gaussian; empty: none.
    turned: Vec<Mat3<f64>>,
    /// Share of its directional colours that each Gaussian has left; empty: all of them.
    gloss: Vec<f32>,
    limits: Vec<NeedleLimit>,
    /// Standard deviations of the internal kernels; empty shows none.
    radii: Vec<f32>,
}

/// Distance of an internal kernel from the nearest surface Gaussian at rest, in standard deviations, at which it adds less
/// than a tenth to a ray through the skin.
const DEPTH_IN_SIGMA: f32 = 2.2;

/// Opacity of an internal kernel: opaque after the rasterizer's clamp.
const INTERNAL_OPACITY: f32 = 0.99;

impl Skin {
    /// `surface` are the object's splats at rest; they belong to the points with ids `0..surface.len()`, the internal kernels
    /// to the ids after them.
    pub fn new(surface: Splats, internal: InternalKernels, similarity: Similarity, settings: SkinSettings) -> Self {
        let sigma0: Vec<Mat3<f64>> = (0..surface.len()).into_par_iter().map(|i| mat3::cast(surface.covariance(i))).collect();
        let limits = sigma0.par_iter().map(|&s| NeedleLimit::new(s, settings.needle_aspect, settings.needle_size)).collect();
        let radii = if internal.radius > 0.0 { internal_radii(&surface, &internal) } else { Vec::new() };
        Self { surface, internal, similarity, settings, sigma0, turned: Vec::new(), gloss: Vec::new(), limits, radii }
    }

    /// Number of points a frame must have.
    pub fn points(&self) -> usize {
        self.surface.len() + self.internal.colour.len()
    }

    /// Takes in the rebase events of one frame (none where its array is empty), `dt` seconds of film after the last, and what has
    /// melted. Only the elastic source rebases (splatting.md §8.2).
    pub fn advance(&mut self, frame: &PointFrame, dt: f32) {
        let n = self.surface.len();
        if self.settings.dull && (!self.gloss.is_empty() || frame.liquid.iter().take(n).any(|l| *l > 0.0)) {
            self.gloss.resize(n, 1.0);
            self.gloss.iter_mut().zip(&frame.liquid).for_each(|(share, liquid)| *share = gloss::left(*share, *liquid, dt));
        }
        if self.settings.push != Push::Elastic {
            return;
        }
        let similarity = self.similarity;
        self.sigma0.par_iter_mut().zip(&frame.rebase).for_each(|(s, b)| {
            let b = unflatten(b);
            if b != mat3::identity::<f64>() {
                *s = rebase_covariance(similarity.map_to_scene(b), *s);
            }
        });
    }

    /// What [`Skin::restore`] needs to go on after this frame.
    pub fn state(&self) -> SkinState {
        let flat = |m: &Mat3<f64>| std::array::from_fn(|k| m[k / 3][k % 3]);
        SkinState {
            sigma0: self.sigma0.iter().map(flat).collect(),
            turned: self.turned.iter().map(flat).collect(),
            gloss: self.gloss.clone(),
        }
    }

    /// Continues after the frame that left `state`. `false`, and nothing changes, where it belongs to another body.
    pub fn restore(&mut self, state: &SkinState) -> bool {
        let n = self.surface.len();
        let fits = |len: usize| len == 0 || len == n;
        if state.sigma0.len() != n || !fits(state.turned.len()) || !fits(state.gloss.len()) {
            return false;
        }
        let square = |m: &[f64; 9]| std::array::from_fn(|r| std::array::from_fn(|c| m[3 * r + c]));
        self.sigma0 = state.sigma0.iter().map(square).collect();
        self.turned = state.turned.iter().map(square).collect();
        self.gloss.clone_from(&state.gloss);
        true
    }

    /// Turns molten Gaussians towards the surface, for the frames that follow (splatting.md §7.5). `normal_at` gives the surface
    /// normal at Gaussian `i` of the `posed` set, zero where none is known. Returns how many turned.
    pub fn realign(&mut self, frame: &PointFrame, posed: &Gaussians, dt: f32, normal_at: &(dyn Fn(usize) -> [f32; 3] + Sync)) -> usize {
        let molten = |i: usize| matches!(frame.phase[i], p if p == Phase::Liquid as u8 || p == Phase::Mushy as u8);
        let turns: Vec<Option<Mat3<f64>>> = (0..self.surface.len())
            .into_par_iter()
            .with_min_len(64)
            .map(|i| {
                if !molten(i) {
                    return None;
                }
                let n = normal_at(i);
                let covariance = mat3::cast(megas_raster::unpack_covariance(posed.covariance[i]));
                let q = if n == [0.0; 3] { None } else { crate::realign::turn(covariance, n.map(f64::from), f64::from(dt)) }?;
                // In the material, so that whatever turns the body later turns this along. A pure rotation there: undoing the
                // strain of the moment as well would leave a needle once the strain has relaxed.
                let r = megas_math::svd::polar_rotation(self.gradient(frame, i));
                Some(mat3::mul(mat3::transpose(r), mat3::mul(q, r)))
            })
            .collect();
        let count = turns.iter().flatten().count();
        if count > 0 && self.turned.is_empty() {
            self.turned = vec![mat3::identity(); self.surface.len()];
        }
        for (i, t) in turns.iter().enumerate() {
            if let Some(turn) = t {
                self.sigma0[i] = rebase_covariance(*turn, self.sigma0[i]);
                self.turned[i] = mat3::mul(*turn, self.turned[i]);
            }
        }
        count
    }

    /// Position of a point of the frame \[scene units\].
    pub fn place(&self, si: [f32; 3]) -> [f32; 3] {
        self.similarity.to_scene(si.map(f64::from)).map(|v| v as f32)
    }

    /// The matrix that carries Gaussian `i`, scene axes.
    fn gradient(&self, frame: &PointFrame, i: usize) -> Mat3<f64> {
        let f = match self.settings.push {
            Push::Elastic => unflatten(&frame.elastic[i]),
            Push::Total => unflatten(&frame.total[i]),
            Push::Rotation => megas_math::svd::polar_rotation(unflatten(&frame.total[i])),
        };
        self.similarity.map_to_scene(f)
    }

    /// Writes the posed surface (and internal kernels) into `out`, in the order of the points. Returns how many surface
    /// Gaussians the needle clamp changed.
    pub fn pose(&self, frame: &PointFrame, out: &mut Gaussians) -> usize {
        let (n, total) = (self.surface.len(), self.points());
        assert_eq!(frame.position.len(), total, "the frame has another number of points than the body");
        out.clear();
        out.sh_degree = self.surface.sh_degree;
        out.sh.extend_from_slice(&self.surface.sh);
        out.opacity.extend((0..n).map(|i| self.surface.opacity(i)));
        let posed: Vec<(Posed, bool)> = (0..n).into_par_iter().map(|i| self.pose_surface(frame, i)).collect();
        let clamped = posed.iter().filter(|p| p.1).count();
        for (p, _) in &posed {
            out.mean.push(p.mean);
            out.covariance.push(p.covariance);
            out.view_rotation.push(p.rotation);
            out.normal.push(p.normal);
        }
        let stride = out.sh_stride();
        for (i, share) in self.gloss.iter().enumerate() {
            dull(&mut out.sh[i * stride..(i + 1) * stride], self.surface.normal(i), *share);
        }
        if !self.radii.is_empty() {
            for (k, colour) in self.internal.colour.iter().enumerate() {
                let v = self.radii[k] * self.radii[k];
                out.mean.push(self.place(frame.position[n + k]));
                out.covariance.push([v, 0.0, 0.0, v, 0.0, v]);
                out.view_rotation.push([1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]);
                out.normal.push([0.0; 3]);
                out.opacity.push(INTERNAL_OPACITY);
                out.sh.extend(colour.map(sh::dc_from_rgb));
                out.sh.resize(out.sh.len() + stride - 3, 0.0);
            }
        }
        let shown = out.mean.len();
        out.trained_pixel.extend_from_slice(self.surface.known_pixels());
        if !out.trained_pixel.is_empty() {
            out.trained_pixel.resize(shown, 0.0);
        }
        out.temperature.extend_from_slice(&frame.temperature[..shown]);
        out.visible.extend(frame.flags[..shown].iter().map(|f| f & FLAG_ESCAPED == 0));
        clamped
    }

    fn pose_surface(&self, frame: &PointFrame, i: usize) -> (Posed, bool) {
        let pushed = push_forward(self.gradient(frame, i), self.sigma0[i]);
        let turn = self.turned.get(i);
        let total = || self.similarity.map_to_scene(unflatten(&frame.total[i]));
        let flowed = if self.settings.squeeze && self.settings.push == Push::Elastic {
            let rest = mat3::cast(self.surface.covariance(i));
            squeeze(total(), turn.map_or(rest, |t| mat3::congruence(*t, rest)), pushed.covariance)
        } else {
            pushed.covariance
        };
        let (covariance, clamped) = clamp_covariance(flowed, self.limits[i]);
        let turned = turn.map_or(pushed.rotation, |t| mat3::mul(pushed.rotation, *t));
        let r = mat3::cast::<f64, f32>(turned);
        let normal = self.similarity.direction_to_scene(frame.normal[i].map(f64::from)).map(|v| v as f32);
        let mut mean = self.place(frame.position[i]);
        if self.settings.depth > 0.0 {
            let lost = lost_depth(total(), self.surface.normal(i).map(f64::from));
            mean = vec3::add_scaled(mean, normal, -(lost * self.settings.depth) as f32);
        }
        let posed = Posed {
            mean,
            covariance: pack_covariance(mat3::cast(covariance)),
            rotation: [r[0][0], r[0][1], r[0][2], r[1][0], r[1][1], r[1][2], r[2][0], r[2][1], r[2][2]],
            normal,
        };
        (posed, clamped)
    }
}

/// Radii that keep the kernels inside the body at rest.
fn internal_radii(surface: &Splats, internal: &InternalKernels) -> Vec<f32> {
    let tree = Neighbours::new(&surface.mean);
    let radius = |x: &[f32; 3]| {
        let depth = tree.as_ref().map_or(f32::INFINITY, |t| t.distance2(x).sqrt());
        (depth / DEPTH_IN_SIGMA).min(internal.radius)
    };
    internal.position.par_iter().map(radius).collect()
}

struct Posed {
    mean: [f32; 3],
    covariance: [f32; 6],
    rotation: [f32; 9],
    normal: [f32; 3],
}

fn unflatten(m: &[f32; 9]) -> Mat3<f64> {
    std::array::from_fn(|r| std::array::from_fn(|c| f64::from(m[3 * r + c])))
}

#[cfg(test)]
mod tests {
    use super::*;
    use megas_math::rng::Rng;
    use megas_model::{Camera, FLAG_SPLAT};
    use megas_raster::{Channels, Rasterizer, Settings};

    fn shell(count: usize) -> Splats {
        let mut rng = Rng::new(11);
        let mut s = Splats { sh_degree: 1, ..Splats::default() };
        for _ in 0..count {
            let d = rng.direction().map(|v| v as f32);
            let q = megas_math::quat::between([0.0, 0.0, 1.0], d);
            let c: Vec<f32> = (0..12).map(|_| rng.range(-0.5, 0.5) as f32).collect();
            s.push(d, [-2.5, -2.8, -5.0], q, 2.0, &c);
        }
        s
    }

    fn similarity() -> Similarity {
        Similarity { metres_per_unit: 0.07, rotation: Similarity::rotation_from_up([0.0, -1.0, 0.0]), origin: [0.1, -0.2, 0.3] }
    }

    fn frame_of(s: &Splats, sim: &Similarity, f: Mat3<f64>, shift: [f64; 3]) -> PointFrame {
        let flat: [f32; 9] = std::array::from_fn(|k| f[k / 3][k % 3] as f32);
        let n = s.len();
        let carry = |m: &[f32; 3]| megas_math::vec3::add(mat3::mul_vec(f, sim.to_si(m.map(f64::from))), shift).map(|v| v as f32);
        PointFrame {
            time: 0.0,
            id: (0..n as u32).collect(),
            position: s.mean.iter().map(carry).collect(),
            elastic: vec![flat; n],
            total: vec![flat; n],
            rebase: vec![[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]; n],
            normal: (0..n).map(|i| sim.direction_to_si(s.normal(i).map(f64::from)).map(|v| v as f32)).collect(),
            temperature: vec![300.0; n],
            liquid: vec![0.0; n],
            phase: vec![0; n],
            flags: vec![FLAG_SPLAT; n],
        }
    }

    fn image(g: &Gaussians, camera: &Camera) -> Vec<[f32; 3]> {
        Rasterizer::new().frame(g, camera, &Settings::default(), Channels::Rgba).rgb
    }

    fn largest_difference(a: &[[f32; 3]], b: &[[f32; 3]]) -> f32 {
        a.as_flattened().iter().zip(b.as_flattened()).fold(0.0, |m, (x, y)| m.max((x - y).abs()))
    }

    #[test]
    fn i10_identity_reproduces_the_static_render_and_a_rigid_motion_equals_moving_the_camera() {
        let s = shell(800);
        let sim = similarity();
        let camera = Camera::look_at([3.0, 1.0, 0.5], [0.0; 3], [0.0, -1.0, 0.0], 0.8, 96, 96);
        let still = image(&Gaussians::from_splats(&s), &camera);
        for push in [Push::Elastic, Push::Total, Push::Rotation] {
            let settings = SkinSettings { push, squeeze: true, depth: 0.1, dull: true, needle_aspect: 4.0, needle_size: 0.01 };
            let skin = Skin::new(s.clone(), InternalKernels::default(), sim, settings);
            let mut g = Gaussians::default();
            assert_eq!(skin.pose(&frame_of(&s, &sim, mat3::identity(), [0.0; 3]), &mut g), 0);
            assert!(largest_difference(&image(&g, &camera), &still) < 2e-5);

            let r = megas_math::quat::to_mat3::<f64>([0.9, 0.2, -0.3, 0.1]);
            let shift = [0.01, 0.02, -0.03];
            skin.pose(&frame_of(&s, &sim, r, shift), &mut g);
            // The camera that sees the moved body as the old one saw it at rest: X' = M X + d in the scene.
            let m = sim.map_to_scene(r);
            let d = megas_math::vec3::sub(sim.to_scene(megas_math::vec3::add(mat3::mul_vec(r, sim.to_si([0.0; 3])), shift)), [0.0; 3]);
            let w = mat3::mul(mat3::cast::<f32, f64>(camera.rotation), mat3::transpose(m));
            let t = megas_math::vec3::sub(camera.translation.map(f64::from), mat3::mul_vec(w, d));
            let moved = Camera { rotation: mat3::cast(w), translation: t.map(|v| v as f32), ..camera };
            assert!(largest_difference(&image(&g, &moved), &still) < 1e-3, "{push:?}");
        }
    }

    #[test]
    fn a_rebase_event_does_not_show() {
        let s = shell(300);
        let sim = similarity();
        let camera = Camera::look_at([3.0, 1.0, 0.5], [0.0; 3], [0.0, -1.0, 0.0], 0.8, 64, 64);
        let settings = SkinSettings { push: Push::Elastic, squeeze: true, depth: 0.0, dull: true, needle_aspect: 4.0, needle_size: 1.0 };
        let mut skin = Skin::new(s.clone(), InternalKernels::default(), sim, settings);
        let before = mat3::diag([1.1, 0.95, 0.9]);
        let after = mat3::scale(mat3::identity(), (1.1f64 * 0.95 * 0.9).cbrt());
        let mut g = Gaussians::default();
        skin.pose(&frame_of(&s, &sim, before, [0.0; 3]), &mut g);
        let a = image(&g, &camera);
        let mut frame = frame_of(&s, &sim, before, [0.0; 3]);
        let Some(inverse) = mat3::inverse(after) else { panic!("invertible") };
        let b = mat3::mul(inverse, before);
        frame.elastic = vec![std::array::from_fn(|k| after[k / 3][k % 3] as f32); s.len()];
        frame.rebase = vec![std::array::from_fn(|k| b[k / 3][k % 3] as f32); s.len()];
        skin.advance(&frame, 0.04);
        skin.pose(&frame, &mut g);
        assert!(largest_difference(&image(&g, &camera), &a) < 1e-4);
    }
}
