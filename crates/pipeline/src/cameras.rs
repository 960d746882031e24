//! From the scene's cameras to camera paths in scene coordinates.

use megas_film::{CameraPath, Distance, FIT_FACTOR, Keyframe, KeyframePath, Orbit};
use megas_math::vec3;
use megas_scene::{Camera, Placement, Scene};

use crate::Failure;
use crate::body::BodyMeta;

/// The camera paths of a scene by name.
pub fn camera_paths(scene: &Scene, meta: &BodyMeta) -> Result<Vec<(String, CameraPath)>, Failure> {
    let placement = meta.placement();
    scene.cameras_or_default().iter().map(|c| Ok((c.name.clone(), path(c, scene, &placement)?))).collect()
}

fn path(camera: &Camera, scene: &Scene, placement: &Placement) -> Result<CameraPath, Failure> {
    let s = &placement.similarity;
    let up = vec3::cast::<f64, f32>(s.direction_to_scene([0.0, 0.0, 1.0]));
    let to_scene = |p: [f64; 3]| vec3::cast::<f64, f32>(s.to_scene(placement.point(camera.frame, p)));
    let Some(orbit) = camera.orbit_or_default() else {
        let keys = camera.keyframes.iter().map(|k| Keyframe {
            time: k.time_s,
            eye: to_scene(k.eye),
            target: to_scene(k.target),
            fov_y: k.fov_deg.unwrap_or(camera.fov_deg) as f32,
        });
        let path = KeyframePath::new(keys.collect(), up).map_err(|e| Failure::Input(format!("camera '{}': {e}", camera.name)))?;
        return Ok(CameraPath::Keyframes(path));
    };
    let size: [f64; 3] = std::array::from_fn(|a| placement.box_max[a] - placement.box_min[a]);
    // A melting thing sinks: look a little below its middle.
    let middle = [0.5, 0.5, 0.42];
    let center: [f64; 3] = std::array::from_fn(|a| placement.box_min[a] + middle[a] * size[a]);
    // Half the longest side and a little: the bounding sphere of a flat thing would leave most of the picture empty.
    let radius = 0.6 * size.iter().copied().fold(0.0, f64::max) / s.metres_per_unit;
    let distance = match orbit.distance {
        Some(d) => Distance::Fixed((placement.length(camera.frame, d) / s.metres_per_unit) as f32),
        None => Distance::Fit { radius: radius as f32, factor: FIT_FACTOR },
    };
    let mut out = Orbit {
        target: orbit.target.map_or_else(|| vec3::cast(s.to_scene(center)), to_scene),
        distance,
        elevation: orbit.elevation_deg as f32,
        azimuth: 0.0,
        speed: (orbit.turn_deg / scene.time.duration_s) as f32,
        up,
        fov_y: camera.fov_deg as f32,
    };
    // The scene counts azimuths in simulator axes from −y; the orbit counts them in the file's axes. Ask it where its zero is.
    let eye = out.camera_at(0.0, 64, 64).center();
    let d = s.direction_to_si(vec3::cast(vec3::sub(eye, out.target)));
    let zero = d[1].atan2(d[0]).to_degrees();
    out.azimuth = (orbit.azimuth_deg - 90.0 - zero) as f32;
    Ok(CameraPath::Orbit(out))
}
