//! What is drawn but not simulated: the background splats, and procedural bodies of no object that move as they are told.

use megas_math::{quat, sh, vec3};
use megas_model::Splats;
use megas_raster::Gaussians;
use megas_scene::{CELSIUS_K, Frame, Scene};
use megas_sim::schedule::Motion;

use crate::body::Bodies;
use crate::convert::motion;

/// Marks [`Splats::object_id`] of scenery that moves; the other bits are the index of its body.
const MOVES: u16 = 1 << 15;

/// Gives the splats of procedural scenery its temperature, and marks what moves. Their `object_id` is the body's index plus
/// one, or 0 for the table.
pub fn mark(background: &mut Splats, scene: &Scene) {
    let ambient = scene.ambient_k();
    for i in 0..background.len() {
        let index = background.object_id[i].checked_sub(1);
        let body = index.and_then(|b| scene.input.bodies.get(usize::from(b)));
        background.temperature[i] = body.and_then(|b| b.temperature_c).map_or(ambient, |c| c + CELSIUS_K) as f32;
        background.object_id[i] = index.filter(|_| body.is_some_and(|b| !b.motion.is_empty())).map_or(0, |b| MOVES | b);
    }
}

/// The splats that never move.
pub fn standing(background: &Splats) -> Splats {
    background.select(&(0..background.len()).filter(|&i| background.object_id[i] & MOVES == 0).collect::<Vec<_>>())
}

/// A body that moves.
struct Mover {
    splats: Vec<usize>,
    motion: Motion,
    centre: [f64; 3],
}

/// The scenery at some time.
pub struct Scenery {
    /// As splats, scene units.
    pub splats: Splats,
    /// As the rasterizer draws it.
    pub gaussians: Gaussians,
    rest: Splats,
    movers: Vec<Mover>,
}

impl Scenery {
    /// The scenery of a scene at rest.
    pub fn new(scene: &Scene, bodies: &Bodies) -> Self {
        let mut rest = bodies.background.clone();
        if scene.input.bodies.is_empty() {
            rest.temperature.fill(scene.ambient_k() as f32);
        }
        // Procedural bodies stand upright in metres: their axes are those of the simulator.
        let movers = (scene.input.bodies.iter().zip(0u16..)).filter(|(b, _)| !b.motion.is_empty()).map(|(b, k)| Mover {
            splats: (0..rest.len()).filter(|&i| rest.object_id[i] == MOVES | k).collect(),
            motion: motion(&b.motion, Frame::Scene, &bodies.meta.placement()),
            centre: b.center(),
        });
        Self { movers: movers.collect(), gaussians: Gaussians::from_splats(&rest), splats: rest.clone(), rest }
    }

    /// Moves it to where it is at `time` \[s\].
    pub fn set(&mut self, time: f64) {
        let Self { splats, gaussians, rest, movers } = self;
        let stride = rest.sh.len() / rest.len().max(1);
        for mover in &*movers {
            let pose = mover.motion.at(time, mover.centre);
            let turn = quat::from_mat3(pose.rotation());
            for &i in &mover.splats {
                splats.mean[i] = vec3::cast(pose.now(vec3::cast(rest.mean[i])));
                splats.rotation[i] = quat::mul(turn, rest.rotation[i].map(f64::from)).map(|v| v as f32);
                let sh = i * stride..(i + 1) * stride;
                splats.sh[sh.clone()].copy_from_slice(&rest.sh[sh.clone()]);
                sh::rotate(rest.sh_degree, &mut splats.sh[sh], pose.rotation());
            }
        }
        if !movers.is_empty() {
            gaussians.assign_splats(splats);
        }
    }
}

#[cfg(test)]
mod tests {
    use megas_math::mat3;
    use megas_model::{Points, Similarity};

    use super::*;
    use crate::body::BodyMeta;

    #[test]
    fn scenery_moves_about_its_centre_and_keeps_its_temperature() {
        let scene = "
            [[input.body]]
            name = 'thing'
            [[input.body]]
            name = 'poker'
            center_m = [1.0, 0.0, 0.0]
            temperature_c = 300.0
            motion = [{ time_s = 1.0 }, { time_s = 3.0, offset = [0.0, 0.0, 2.0], rotation_deg = 90.0 }]
            [[object]]
            parts = ['thing']";
        let scene = Scene::parse(scene, "s.toml").unwrap();
        // A splat of the table and one of the poker.
        let mut background = Splats { sh_degree: 1, ..Splats::default() };
        for x in [[5.0, 5.0, 0.0], [2.0, 0.0, 0.0]] {
            background.push(x, [0.0; 3], [1.0, 0.0, 0.0, 0.0], 0.0, &[0.0; 12]);
        }
        background.object_id = vec![0, 2];
        // Red from +x: the coefficient of Y₃ is that of −x.
        background.sh[12 + 9] = -1.0;
        mark(&mut background, &scene);
        assert!((background.temperature[1] - 573.15).abs() < 1e-3 && (background.temperature[0] - scene.ambient_k() as f32).abs() < 1e-3);
        assert_eq!(standing(&background).len(), 1);

        let meta = BodyMeta {
            similarity: Similarity { metres_per_unit: 1.0, rotation: mat3::identity(), origin: [0.0; 3] },
            box_min: [0.0; 3],
            box_max: [1.0; 3],
            support_z: 0.0,
            dx_m: 0.1,
            antialiased: true,
            objects: Vec::new(),
        };
        let bodies = Bodies { meta, surface: Splats::default(), internal_rgb: Vec::new(), background, points: Points::default() };
        let mut scenery = Scenery::new(&scene, &bodies);
        let near = |a: &[f32], b: &[f32]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-5);
        for (time, place) in [(0.5, [2.0, 0.0, 0.0]), (9.0, [1.0, 1.0, 2.0]), (0.0, [2.0, 0.0, 0.0])] {
            scenery.set(time);
            assert!(near(&scenery.gaussians.mean[1], &place), "{time} {:?}", scenery.gaussians.mean[1]);
            assert_eq!(scenery.gaussians.mean[0], [5.0, 5.0, 0.0]);
        }
        // Turned by a quarter it is red from +y, the coefficient of Y₁ = −y.
        scenery.set(3.0);
        assert!(near(&[scenery.splats.sh[12 + 3], scenery.splats.sh[12 + 9]], &[-1.0, 0.0]), "{:?}", &scenery.splats.sh[12..]);
    }
}
