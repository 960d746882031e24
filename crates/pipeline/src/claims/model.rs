//! A trained model as a method uses it: filled, and carried by a deformation.

use megas_body::fill::{BottomCap, DensityField, FillMethod, FillSettings, Filling, Shell, TauAlpha, fill};
use megas_body::{BodySettings, Placement, build_body};
use megas_math::{Mat3, mat3, svd, vec3};
use megas_metrics::deform::{Carry, Deformation, Stage, carry};
use megas_metrics::filling::{FilledGrid, FillingQuality};
use megas_metrics::surface::MeshDistance;
use megas_model::{Phase, Similarity, Splats};
use megas_raster::Gaussians;
use megas_skin::densify::{Anatomy, Deformed, Densifier, DensifySettings};
use megas_skin::{NeedleLimit, clamp_covariance, dull, lost_depth, squeeze};
use rayon::prelude::*;

use super::methods::Contender;

/// Simulator cells along the longest side, as in films; grid points of the filling are half a cell apart.
pub const CELLS: u32 = 48;
/// Needle clamp ρ (§8.4), and τ_scale in diagonals L.
const ASPECT: f64 = 4.0;
const SCALE: f64 = 0.006;

/// A model filled by one of the two ways.
pub struct Filled {
    /// Positions of the particles, scene.
    pub particles: Vec<[f32; 3]>,
    /// Their colours.
    pub colour: Vec<[f32; 3]>,
    /// Judged against the truth.
    pub quality: FillingQuality,
    /// The surface as the simulator would get it: with outward normals.
    pub surface: Splats,
    /// Distance of neighbouring particles, scene units.
    pub spacing: f64,
    /// Depth of the splats below the surface that they draw, scene units.
    pub depth: f64,
    /// Why nothing was filled.
    pub failed: Option<String>,
}

fn settings(density: bool) -> BodySettings {
    let method = if density { FillMethod::DensityField(DensityField::default()) } else { FillMethod::Rays };
    BodySettings {
        placement: Placement::Size { up: [0.0, 0.0, 1.0], size_m: 0.2, cells: CELLS },
        // Models are judged as they are: what nobody sees stays in.
        prune_below: None,
        fill: FillSettings { method, tau_alpha: TauAlpha::Fixed(0.5), cap: BottomCap::Auto, ..FillSettings::default() },
        ..BodySettings::default()
    }
}

/// Fills a model. A filling that finds nothing is a result, not an error.
pub fn filled(splats: &Splats, density: bool, truth: &MeshDistance, volume: f64) -> Filled {
    match build_body(splats, &settings(density)) {
        Ok(body) => {
            let particles = body.internal.position.clone();
            let unit = body.similarity.metres_per_unit;
            let sum = body.points.volume.iter().map(|v| f64::from(*v)).sum::<f64>() / unit.powi(3);
            let quality = judge(&body.filling, &body.similarity, &particles, sum, truth, volume);
            let spacing = body.filling.grid.spacing * body.filling.per_particle as f64;
            Filled { particles, colour: body.internal.rgb, quality, surface: body.surface, spacing, depth: 0.0, failed: None }
        }
        Err(e) => {
            // What the grid says, without particles.
            let (grid, similarity) = bare(splats, density);
            let sum = grid.volume();
            let quality = judge(&grid, &similarity, &[], sum, truth, volume);
            Filled {
                particles: Vec::new(),
                colour: Vec::new(),
                quality,
                surface: splats.clone(),
                spacing: grid.grid.spacing,
                depth: 0.0,
                failed: Some(e.to_string()),
            }
        }
    }
}

/// The classified grid of a model that makes no body.
fn bare(splats: &Splats, density: bool) -> (Filling, Similarity) {
    let (low, high) = splats.bounds().unwrap_or_default();
    let centre = vec3::scale(vec3::add(low, high), 0.5);
    let longest = (0..3).map(|k| f64::from(high[k] - low[k])).fold(1e-6, f64::max);
    let similarity = Similarity { metres_per_unit: 0.2 / longest, rotation: mat3::identity(), origin: vec3::cast(centre) };
    let normals: Vec<[f32; 3]> = (0..splats.len()).map(|i| splats.normal(i)).collect();
    let shell = Shell::<f32>::new(splats, &normals, similarity.rotation, similarity.origin);
    let corner = |v: [f32; 3]| vec3::cast::<f32, f64>(vec3::sub(v, centre));
    let grid = fill(&shell, corner(low), corner(high), longest / f64::from(CELLS), &settings(density).fill, |_| false);
    (grid, similarity)
}

fn judge(
    filling: &Filling,
    similarity: &Similarity,
    particles: &[[f32; 3]],
    sum: f64,
    truth: &MeshDistance,
    volume: f64,
) -> FillingQuality {
    let g = &filling.grid;
    let centre: Vec<[f64; 3]> =
        (0..g.len()).map(|i| vec3::add(mat3::tmul_vec(similarity.rotation, g.center(g.cell(i))), similarity.origin)).collect();
    let distance: Vec<f64> = centre.par_iter().with_min_len(64).map(|&x| truth.signed(x)).collect();
    FillingQuality::new(
        FilledGrid { centre: &centre, inside: &filling.inside, distance: &distance, spacing: g.spacing },
        particles,
        sum,
        volume,
    )
}

/// The model after a deformation, as the method draws it.
pub fn posed(method: Contender, model: &Filled, stage: &Stage, d: Deformation, mode: Carry) -> Gaussians {
    let surface = posed_surface(method, model, stage, d, mode);
    if method.shows_inside() && !model.particles.is_empty() {
        // A single frame shows at once what it selects.
        with_inside(d, surface, &moved(model, stage, d), &mut densifier(model), 0.0)
    } else {
        surface
    }
}

/// Its surface alone.
pub fn posed_surface(method: Contender, model: &Filled, stage: &Stage, d: Deformation, mode: Carry) -> Gaussians {
    let refits = method.shows_inside() && d != Deformation::Rest;
    let clamp = |pushed: Mat3<f64>, rest: Mat3<f64>, total: Mat3<f64>| {
        if !method.clamps_needles() || d == Deformation::Rest {
            return pushed;
        }
        let pushed = if refits && mode == Carry::ElasticLike { squeeze(total, rest, pushed) } else { pushed };
        clamp_covariance(pushed, NeedleLimit::new(rest, ASPECT, 2.0 * SCALE * stage.diagonal)).0
    };
    let mut surface = carry(&model.surface, stage, d, mode, clamp).gaussians;
    if refits {
        let lost = |i: usize| {
            let total = stage.gradient(d, vec3::cast(model.surface.mean[i]));
            lost_depth(limited(total), model.surface.normal(i).map(f64::from))
        };
        let stride = surface.sh_stride();
        for i in 0..surface.len() {
            surface.mean[i] = vec3::add_scaled(surface.mean[i], surface.normal[i], -(lost(i) * model.depth) as f32);
            // What flows has lost its highlights.
            dull(&mut surface.sh[i * stride..(i + 1) * stride], model.surface.normal(i), 0.0);
        }
    }
    surface
}

/// A gradient within the design's bounds of exported stretches (simulation.md §7.3), [½, 2]. Not `limit_total`: the simulator itself exports
/// down to 0.2 and limits the volume.
fn limited(f: Mat3<f64>) -> Mat3<f64> {
    let d = svd::svd(f);
    d.with_values(d.s.map(|s| s.clamp(0.5, 2.0)))
}

/// Where the particles are after a deformation.
pub fn moved(model: &Filled, stage: &Stage, d: Deformation) -> Vec<[f32; 3]> {
    model.particles.par_iter().with_min_len(64).map(|&x| vec3::cast(stage.map(d, vec3::cast(x)))).collect()
}

/// What seals the cracks of a model, before its first frame.
pub fn densifier(model: &Filled) -> Densifier {
    let anatomy = Anatomy {
        surface_object: vec![1; model.surface.len()],
        inside_object: vec![1; model.particles.len()],
        inside_rgb: model.colour.clone(),
        spacing: model.spacing as f32,
    };
    Densifier::new(anatomy, DensifySettings::default())
}

/// Draws those of the particles at `inside` that come to light, on top of the surface (§7), `dt` seconds after the last frame.
pub fn with_inside(d: Deformation, mut surface: Gaussians, inside: &[[f32; 3]], densifier: &mut Densifier, dt: f32) -> Gaussians {
    // What these maps stand for is the flow of a melt.
    let phase = vec![if d == Deformation::Rest { Phase::Solid } else { Phase::Liquid } as u8; surface.len()];
    densifier.cover(&mut surface, &phase);
    let frame = Deformed { surface: &surface, phase: &phase, inside, temperature: &[], gone: &[] };
    densifier.advance(&frame, &[], dt);
    let mut out = surface.clone();
    densifier.append(&frame, &mut out);
    out
}

#[cfg(test)]
mod tests {
    use megas_math::{quat, sh};
    use megas_model::fibonacci_directions;

    use super::*;

    fn ball() -> Filled {
        let mut s = Splats::default();
        for d in fibonacci_directions(600) {
            s.push(d, [-2.1, -2.1, -5.0], quat::between([0.0, 0.0, 1.0], d), 6.0, &[0.2, 0.5, 0.7].map(sh::dc_from_rgb));
        }
        let particles: Vec<[f32; 3]> = (0..512).map(|i| [i % 8, i / 8 % 8, i / 64].map(|v| (v as f32 - 3.5) / 8.0)).collect();
        Filled {
            colour: vec![[0.3; 3]; particles.len()],
            particles,
            quality: FillingQuality::default(),
            surface: s,
            spacing: 0.125,
            depth: 0.0,
            failed: None,
        }
    }

    #[test]
    fn the_inside_comes_to_light_at_a_cut_and_the_surface_stays() {
        let model = ball();
        let stage = Stage::new(&model.surface.mean, mat3::identity()).unwrap();
        let shown = |d| {
            let plain = posed(Contender::B5, &model, &stage, d, Carry::ElasticLike);
            let full = posed(Contender::B6, &model, &stage, d, Carry::ElasticLike);
            // But for what is trimmed at the rims of the cut, by less than its width.
            let trimmed: Vec<usize> = (0..plain.len()).filter(|&i| full.covariance[i] != plain.covariance[i]).collect();
            assert!(trimmed.len() * 10 < plain.len(), "{} trimmed", trimmed.len());
            for i in 0..plain.len() {
                let way = vec3::norm(vec3::sub(full.mean[i], plain.mean[i]));
                assert!(if trimmed.contains(&i) { way < (-2.1f32).exp() } else { way == 0.0 }, "{i}: {way}");
            }
            (full.len() - plain.len(), trimmed.len())
        };
        let (rest, cut) = (shown(Deformation::Rest), shown(Deformation::Cut));
        // Two faces of 8 × 8 particles, less the corners outside of the ball.
        assert!(cut.0 >= rest.0 + 60 && cut.1 > 0 && rest.1 == 0, "{rest:?} {cut:?}");
    }
}
