//! From gradients in the image to gradients of one Gaussian's parameters (splatting.md §4.2–§4.4).

use megas_math::{Mat3, Real, Vec3, mat3, quat, sh, vec3};
use megas_model::{Camera, Projection};

use crate::Settings;

/// Camera and constants in the precision of the chain.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ChainView<T> {
    w: Mat3<T>,
    t: Vec3<T>,
    center: Vec3<T>,
    pinhole: bool,
    focal: [T; 2],
    tangent: [[T; 2]; 2],
    /// Half the image size: pixels to normalised device coordinates.
    half: [T; 2],
    low_pass: T,
    anti_aliased: bool,
    geometry: bool,
}

impl<T: Real> ChainView<T> {
    pub fn new(camera: &Camera, settings: &Settings, geometry: bool) -> Self {
        let cast = |v: f32| T::of(f64::from(v));
        let w = camera.rotation.map(|r| r.map(cast));
        let t = camera.translation.map(cast);
        let (pinhole, focal) = match camera.projection {
            Projection::Pinhole { fx, fy } => (true, [cast(fx), cast(fy)]),
            Projection::Orthographic { scale } => (false, [cast(scale); 2]),
        };
        let (principal, size) = ([cast(camera.cx), cast(camera.cy)], [camera.width, camera.height].map(|v| T::of(f64::from(v))));
        Self {
            w,
            t,
            center: mat3::tmul_vec(w, t).map(|v| -v),
            pinhole,
            focal,
            tangent: [0, 1]
                .map(|k| [-(principal[k] + T::of(0.15) * size[k]) / focal[k], (T::of(1.15) * size[k] - principal[k]) / focal[k]]),
            half: size.map(|v| v * T::of(0.5)),
            low_pass: cast(settings.low_pass),
            anti_aliased: settings.anti_aliased,
            geometry,
        }
    }

    /// True where a tangent of the camera-space point `p` is outside the bounds.
    #[cfg(test)]
    pub fn clamps(&self, p: Vec3<T>) -> bool {
        (0..2).any(|k| p[k] / p[2] < self.tangent[k][0] || p[k] / p[2] > self.tangent[k][1])
    }
}

/// The parameters of one Gaussian.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Parameters<'a, T> {
    pub mean: Vec3<T>,
    pub log_scale: Vec3<T>,
    pub rotation: [T; 4],
    pub opacity_logit: T,
    pub degree: u8,
    pub sh: &'a [T],
}

/// What one Gaussian received from the pixels of an image: sums of `∂L/∂·` over all of them.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Received<T> {
    /// Colour along the viewing direction, after the clamp at zero.
    pub rgb: [T; 3],
    /// Effective opacity ô.
    pub opacity: T,
    /// Projected mean \[1/px\].
    pub mean: [T; 2],
    /// Sum of absolute values of the same over pixels.
    pub absolute: [T; 2],
    /// Image covariance Σ' `[xx, xy, yy]`, full symmetric form.
    pub covariance: [T; 3],
    /// Depth, normal, plane distance, temperature.
    pub depth: T,
    pub normal: [T; 3],
    pub plane: T,
    pub temperature: T,
}

/// Gradients of one Gaussian.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Outcome<T> {
    pub mean: Vec3<T>,
    pub log_scale: Vec3<T>,
    pub rotation: [T; 4],
    pub opacity_logit: T,
    /// Of the colour before the clamp at zero: `∂L/∂c_k = Y_k(direction) · colour`.
    pub colour: [T; 3],
    pub direction: Vec3<T>,
    pub temperature: T,
    /// Lengths of the gradient of the projected mean and of its absolute sum, in normalised device coordinates.
    pub screen: [T; 2],
    /// Three standard deviations of the longer image axis \[px\].
    pub radius: T,
}

/// The chain rule for one Gaussian; `colour_open[c]` is false where the clamp at zero held the channel.
#[inline(always)]
pub(crate) fn chain<T: Real>(view: &ChainView<T>, p: &Parameters<T>, g: &Received<T>, colour_open: [bool; 3]) -> Outcome<T> {
    let (zero, one, two) = (T::zero(), T::one(), T::of(2.0));
    let length =
        (p.rotation[0] * p.rotation[0] + p.rotation[1] * p.rotation[1] + p.rotation[2] * p.rotation[2] + p.rotation[3] * p.rotation[3])
            .sqrt();
    let q = if length > zero { p.rotation.map(|v| v / length) } else { [one, zero, zero, zero] };
    let r = quat::to_mat3_unit(q);
    let s = p.log_scale.map(|l| l.exp());
    let m: Mat3<T> = r.map(|row| [row[0] * s[0], row[1] * s[1], row[2] * s[2]]);
    let toward = vec3::sub(p.mean, view.center);
    let camera = vec3::add(mat3::mul_vec(view.w, p.mean), view.t);

    // Projection: rows of T = J W, and the clamped tangents.
    let mut rows = [[zero; 3]; 2];
    let mut tangent = [zero; 2];
    let mut free = [true; 2];
    let iz = if view.pinhole { camera[2].recip() } else { one };
    for k in 0..2 {
        if view.pinhole {
            let raw = camera[k] * iz;
            tangent[k] = raw.max(view.tangent[k][0]).min(view.tangent[k][1]);
            free[k] = raw == tangent[k];
            let f = view.focal[k] * iz;
            rows[k] = [0, 1, 2].map(|a| (view.w[k][a] - tangent[k] * view.w[2][a]) * f);
        } else {
            rows[k] = view.w[k].map(|v| v * view.focal[k]);
        }
    }
    let tm = rows.map(|row| mat3::tmul_vec(m, row));
    let (s00, s01, s11) = (vec3::dot(tm[0], tm[0]), vec3::dot(tm[0], tm[1]), vec3::dot(tm[1], tm[1]));
    let (c00, c11) = (s00 + view.low_pass, s11 + view.low_pass);
    let det = c00 * c11 - s01 * s01;

    // Opacity and, with the anti-aliasing factor ρ, its part of the covariance gradient (§4.2).
    let o = one / (one + (-p.opacity_logit).exp());
    let mut gs = g.covariance;
    let mut go = g.opacity;
    if view.anti_aliased {
        let det0 = s00 * s11 - s01 * s01;
        let floor = T::of(2.5e-5);
        let ratio = det0 / det;
        let rho = ratio.max(floor).sqrt();
        go = rho * g.opacity;
        if ratio > floor {
            let h = g.opacity * o * rho * T::of(0.5);
            gs[0] += h * (s11 / det0 - c11 / det);
            gs[1] += h * (s01 / det - s01 / det0);
            gs[2] += h * (s00 / det0 - c00 / det);
        }
    }

    // Covariance to scale, rotation and the projection (§4.3).
    let gt_m: [Vec3<T>; 2] =
        [[0, 1, 2].map(|a| two * (gs[0] * tm[0][a] + gs[1] * tm[1][a])), [0, 1, 2].map(|a| two * (gs[1] * tm[0][a] + gs[2] * tm[1][a]))];
    let gm: Mat3<T> = [0, 1, 2].map(|a| [0, 1, 2].map(|b| rows[0][a] * gt_m[0][b] + rows[1][a] * gt_m[1][b]));
    let log_scale = [0, 1, 2].map(|k| s[k] * (r[0][k] * gm[0][k] + r[1][k] * gm[1][k] + r[2][k] * gm[2][k]));
    let mut gr: Mat3<T> = gm.map(|row| [row[0] * s[0], row[1] * s[1], row[2] * s[2]]);
    let mut gp = [zero; 3];
    if view.pinhole {
        for k in 0..2 {
            let f = view.focal[k] * iz;
            // ∂L/∂T = 2 G' T Σ, row k; only two columns of J depend on p.
            let gt = mat3::mul_vec(m, gt_m[k]);
            let gj_k = vec3::dot(gt, view.w[k]);
            let gj_2 = vec3::dot(gt, view.w[2]);
            gp[2] += iz * f * (tangent[k] * gj_2 - gj_k);
            let gu = -f * gj_2;
            if free[k] {
                gp[k] += gu * iz;
                gp[2] -= gu * camera[k] * iz * iz;
            }
            gp[k] += g.mean[k] * f;
            gp[2] -= g.mean[k] * f * camera[k] * iz;
        }
    } else {
        for k in 0..2 {
            gp[k] += g.mean[k] * view.focal[k];
        }
    }

    let mut mean = [zero; 3];
    let mut direction = view.w[2];
    let colour = [0, 1, 2].map(|c| if colour_open[c] { g.rgb[c] } else { zero });
    if view.pinhole {
        let inverse = vec3::norm(toward).recip();
        direction = vec3::scale(toward, inverse);
        if p.degree > 0 {
            let slope = sh::basis_gradient(direction);
            let mut gd = [zero; 3];
            for k in 1..sh::coefficients(p.degree) {
                let weight = p.sh[3 * k] * colour[0] + p.sh[3 * k + 1] * colour[1] + p.sh[3 * k + 2] * colour[2];
                gd = vec3::add_scaled(gd, slope[k], weight);
            }
            let along = vec3::dot(direction, gd);
            mean = [0, 1, 2].map(|a| (gd[a] - direction[a] * along) * inverse);
        }
    }
    if view.geometry {
        gp[2] += g.depth;
        let k = usize::from(p.log_scale[1] < p.log_scale[0]);
        let k = if p.log_scale[2] < p.log_scale[k] { 2 } else { k };
        let n = mat3::column(r, k);
        let facing = if view.pinhole { vec3::dot(n, toward) } else { vec3::dot(n, view.w[2]) };
        let sign = if facing > zero { -one } else { one };
        for a in 0..3 {
            gr[a][k] += sign * (g.normal[a] + g.plane * toward[a]);
            mean[a] += g.plane * sign * n[a];
        }
    }
    let back = mat3::tmul_vec(view.w, gp);
    let mean = vec3::add(mean, back);

    let [w, x, y, z] = q;
    let a = gr;
    let gq = [
        two * (x * (a[2][1] - a[1][2]) + y * (a[0][2] - a[2][0]) + z * (a[1][0] - a[0][1])),
        two * (-two * x * (a[1][1] + a[2][2]) + y * (a[0][1] + a[1][0]) + z * (a[0][2] + a[2][0]) + w * (a[2][1] - a[1][2])),
        two * (x * (a[0][1] + a[1][0]) - two * y * (a[0][0] + a[2][2]) + z * (a[1][2] + a[2][1]) + w * (a[0][2] - a[2][0])),
        two * (x * (a[0][2] + a[2][0]) + y * (a[1][2] + a[2][1]) - two * z * (a[0][0] + a[1][1]) + w * (a[1][0] - a[0][1])),
    ];
    let along = gq[0] * w + gq[1] * x + gq[2] * y + gq[3] * z;
    let rotation = if length > zero { [0, 1, 2, 3].map(|i| (gq[i] - q[i] * along) / length) } else { [zero; 4] };

    let mid = (c00 + c11) * T::of(0.5);
    let widest = mid + ((mid * mid - det).max(zero)).sqrt();
    let ndc = |v: [T; 2]| (v[0] * view.half[0]).hypot(v[1] * view.half[1]);
    Outcome {
        mean,
        log_scale,
        rotation,
        opacity_logit: go * o * (one - o),
        colour,
        direction,
        temperature: g.temperature,
        screen: [ndc(g.mean), ndc(g.absolute)],
        radius: T::of(3.0) * widest.sqrt(),
    }
}
