//! Stage three: frames of the simulation to pictures, films and splat sequences.

use std::path::{Path, PathBuf};
use std::time::Instant;

use megas_film::{Appearance, CameraPath, Captions, Mp4Writer, PlySequence, ThermalStyle, side_by_side, thermal_image, write_png};
use megas_formats::WriteOptions;
use megas_model::{Camera, Image};
use megas_raster::{Channels, ClipPlane, Frame, Gaussians, Rasterizer, Settings};
use megas_scene::{CELSIUS_K, Draw, Film, Scene};
use megas_skin::bake_splats;
use serde_json::{Value, json};

use crate::body::{Bodies, scene_objects, total_height};
use crate::cameras::camera_paths;
use crate::convert::resolve_material;
use crate::disk::{create_dir, frame_path};
use crate::scenery::Scenery;
use crate::simulate::read_frame;
use crate::skin::{Dresser, forget};
use crate::stage::StageDir;
use crate::surface_meshes::{SurfaceMeshes, whole_mesh};
use crate::{Event, Failure, LoadedScene, Options, Sink, mesh_splats};

/// Frames looked at for the range of the false colours.
const RANGE_SAMPLES: u64 = 12;

/// Share of opposing normals of neighbours that is worth a warning.
const OPPOSING_LIMIT: f32 = 0.08;

/// Everything that stays the same from frame to frame.
struct Studio<'a> {
    scene: &'a Scene,
    paths: Vec<(String, CameraPath)>,
    size: (u32, u32),
    style: ThermalStyle,
    skin: Dresser,
    surface: usize,
    antialiased: bool,
    clip: Option<ClipPlane>,
    appearance: Appearance,
    /// Up and the direction of the light that melts mirror, scene axes.
    up: [f32; 3],
    lamp: [f32; 3],
}

/// Renders what is missing and writes the films; returns the figures of the stage.
pub fn render(
    loaded: &LoadedScene,
    bodies: &Bodies,
    simulated: &Path,
    stage: &StageDir,
    options: &Options,
    sink: &dyn Sink,
) -> Result<Value, Failure> {
    let scene = &loaded.scene;
    let total = scene.time.frames();
    let mut studio = Studio {
        scene,
        paths: camera_paths(scene, &bodies.meta)?,
        size: scene.picture_size(),
        style: thermal_style(scene, bodies, simulated, total)?,
        skin: Dresser::new(scene, bodies),
        surface: bodies.surface.len(),
        antialiased: bodies.meta.antialiased,
        clip: clip_plane(scene, &bodies.meta.placement()),
        appearance: appearance(scene),
        up: to_scene_axes(bodies, [0.0, 0.0, 1.0]),
        lamp: to_scene_axes(bodies, LAMP),
    };
    let mut scenery = Scenery::new(scene, bodies);
    stage.begin()?;
    sink.event(Event::Stage { name: "render", steps: total });
    let start = Instant::now();
    let mut rasterizer = Rasterizer::new();
    let mut frame = Frame::default();
    let mut posed = Gaussians::new(bodies.surface.sh_degree);
    let splats = sequence(scene, &options.out)?;
    let mut meshes = SurfaceMeshes::create(scene, bodies, &options.out)?;
    let wants_ply = |k: u64| {
        splats.as_ref().filter(|_| k.is_multiple_of(u64::from(scene.output.ply_every.max(1)))).filter(|s| !s.path(k as u32).exists())
    };
    let mesh = |k: u64, meshes: &Option<SurfaceMeshes>| meshes.as_ref().is_some_and(|m| m.wants(k));
    // Frames before the first that is missing are only gone through where the skin has no state of them.
    let first =
        (0..total).find(|&k| !studio.missing(&stage.path, k).is_empty() || wants_ply(k).is_some() || mesh(k, &meshes)).unwrap_or(total);
    studio.skin.resume(&stage.path, first);
    // Meshes are made anew in every frame: with the skin, or of the particles alone.
    let mesh_only = match scene.skin.draw {
        Draw::Splats => None,
        Draw::Mesh => Some(true),
        Draw::ParticleMesh => Some(false),
    };
    let begin = if first == total || mesh_only.is_some() { first } else { studio.skin.next() };
    for k in begin..total {
        if sink.cancelled() {
            return Err(Failure::Interrupted(format!("stopped at picture {k} of {total}; run the same command again to continue")));
        }
        let points = read_frame(simulated, k)?;
        let wanted = studio.missing(&stage.path, k);
        if let Some(m) = meshes.as_mut().filter(|m| m.wants(k)) {
            m.write(k, bodies, &points)?;
        }
        let ply = wants_ply(k);
        let viewers: Vec<Camera> = (0..studio.paths.len()).map(|c| studio.view(c, k)).collect();
        let drawn = !wanted.is_empty() || ply.is_some();
        match mesh_only {
            None => {
                studio.skin.frame(&points, &viewers, drawn, &mut posed);
                studio.skin.keep(&stage.path)?;
            }
            Some(skin) if drawn => mesh_splats::assign(&mut posed, &whole_mesh(scene, bodies, &points, skin)),
            Some(_) => {}
        }
        if !drawn {
            sink.event(Event::Step { done: k + 1 });
            continue;
        }
        scenery.set(k as f64 * scene.time.frame_dt_s());
        if let Some(sequence) = ply {
            let mut baked = bake_splats(&posed, studio.surface);
            baked.append(&scenery.splats);
            sequence.write(k as u32, &baked).map_err(|e| Failure::Input(e.to_string()))?;
        }
        // Meshes do not know which of their points is molten: they stay dry.
        let liquid = &if mesh_only.is_none() { studio.skin.liquid(&points, posed.len()) } else { vec![0.0; posed.len()] };
        posed.extend_from(&scenery.gaussians);
        studio.appearance.apply(&mut posed, liquid);
        let matt = if studio.appearance.wet > 0.0 { posed.sh.clone() } else { Vec::new() };
        for camera in wanted {
            if !matt.is_empty() {
                posed.sh.copy_from_slice(&matt);
                studio.appearance.add_sheen(&mut posed, liquid, &studio.view(camera, k), studio.up, studio.lamp);
            }
            studio.picture(camera, k, &posed, &mut rasterizer, &mut frame, &stage.path)?;
        }
        sink.event(Event::Step { done: k + 1 });
    }
    sink.event(Event::StageDone { name: "render", seconds: start.elapsed().as_secs_f64() });
    let films = films(&studio, &stage.path, options, total, sink)?;
    if !scene.output.png {
        for (name, _) in &studio.paths {
            for k in 0..total {
                for kind in KINDS {
                    let _ = std::fs::remove_file(picture_path(&stage.path, name, kind, k));
                }
            }
        }
    }
    let gaussians = posed.len().max(bodies.surface.len() + bodies.background.len());
    let skin = &studio.skin;
    if skin.worst_normals > OPPOSING_LIMIT {
        sink.event(Event::Warning(&format!(
            "up to {:.0} % of neighbouring surface normals oppose each other: sealed cracks may be shaded wrongly",
            100.0 * skin.worst_normals
        )));
    }
    let mut figures = json!({"films": films, "gaussians": gaussians, "needles_clamped_last_frame": skin.clamped});
    if let Some(m) = &meshes {
        figures["mesh"] = m.figures();
    }
    if skin.remembers() {
        let shown = skin.report.shown;
        figures["skin"] = json!({
            "kernels_last_frame": shown, "kernels_most": skin.most_kernels,
            "toggles_per_kernel_and_frame": skin.toggles / (skin.most_kernels.max(1) as f64 * total as f64),
            "opposing_normals_worst": skin.worst_normals,
        });
    }
    forget(&stage.path, total);
    stage.finish(&figures)?;
    Ok(figures)
}

/// Kinds of pictures on disk.
const KINDS: [&str; 2] = ["rgb", "thermal"];

pub(crate) fn picture_path(folder: &Path, camera: &str, kind: &str, k: u64) -> PathBuf {
    let stem = if camera == "main" { kind.to_owned() } else { format!("{camera}_{kind}") };
    frame_path(folder, &stem, k as usize, "png")
}

fn sequence(scene: &Scene, out: &Path) -> Result<Option<PlySequence>, Failure> {
    if scene.output.ply_every == 0 {
        return Ok(None);
    }
    let options = WriteOptions { overwrite: true, ..WriteOptions::default() };
    PlySequence::create(out.join("splats"), options).map(Some).map_err(|e| Failure::Input(e.to_string()))
}

/// Where the light comes from that melts mirror, simulator axes: high, a little from the side.
const LAMP: [f64; 3] = [-0.35, -0.35, 0.87];

fn to_scene_axes(bodies: &Bodies, d: [f64; 3]) -> [f32; 3] {
    let d = megas_math::vec3::cast(bodies.meta.similarity.direction_to_scene(d));
    megas_math::vec3::normalize_or(d, [0.0, 0.0, 1.0])
}

fn appearance(scene: &Scene) -> Appearance {
    let a = scene.appearance();
    Appearance { glow: a.glow as f32, white: (a.white_c + CELSIUS_K) as f32, compression: a.contrast as f32, wet: a.wet as f32 }
}

fn clip_plane(scene: &Scene, placement: &megas_scene::Placement) -> Option<ClipPlane> {
    let c = scene.output.clip.as_ref()?;
    let s = &placement.similarity;
    let point = s.to_scene(placement.point(c.frame, c.point));
    let normal = match c.frame {
        megas_scene::Frame::Scene => c.normal,
        megas_scene::Frame::Object => s.direction_to_scene(c.normal),
    };
    Some(ClipPlane { normal: normal.map(|v| v as f32), offset: megas_math::vec3::dot(normal, point) as f32 })
}

/// Range of the false colours and the melting line.
fn thermal_style(scene: &Scene, bodies: &Bodies, simulated: &Path, total: u64) -> Result<ThermalStyle, Failure> {
    let height = total_height(&bodies.meta);
    let mut melting = None;
    for o in scene_objects(scene) {
        let t = resolve_material(scene, &o, height)?.melting_point();
        if melting.is_none() && t.is_finite() {
            melting = Some(t as f32);
        }
    }
    let range = match scene.output.thermal_range_c {
        Some(r) => r.map(|c| (c + CELSIUS_K) as f32),
        None => {
            let mut range = [f32::INFINITY, f32::NEG_INFINITY];
            for s in 0..=RANGE_SAMPLES {
                let mut t = read_frame(simulated, s * (total - 1) / RANGE_SAMPLES)?.temperature;
                t.sort_by(f32::total_cmp);
                range = [range[0].min(t[t.len() / 200]), range[1].max(t[t.len() - 1 - t.len() / 200])];
            }
            // A little room, and never a range too narrow to draw.
            let middle = 0.5 * (range[0] + range[1]);
            let half = (0.52 * (range[1] - range[0])).max(0.5);
            [middle - half, middle + half]
        }
    };
    Ok(ThermalStyle::new(range, melting))
}

impl Studio<'_> {
    fn wants(&self, kind: &str) -> bool {
        let films = &self.scene.output.films;
        films.contains(&Film::SideBySide)
            || films.contains(if kind == "rgb" { &Film::Rgb } else { &Film::Thermal })
            || films.is_empty() && kind == "rgb"
    }

    /// Cameras whose pictures of frame `k` are not all there.
    fn missing(&self, folder: &Path, k: u64) -> Vec<usize> {
        (0..self.paths.len())
            .filter(|&c| KINDS.iter().any(|kind| self.wants(kind) && !picture_path(folder, &self.paths[c].0, kind, k).exists()))
            .collect()
    }

    fn view(&self, camera: usize, k: u64) -> Camera {
        self.paths[camera].1.camera_at(k as f64 / self.scene.time.fps, self.size.0, self.size.1)
    }

    fn picture(
        &self,
        camera: usize,
        k: u64,
        g: &Gaussians,
        rasterizer: &mut Rasterizer,
        frame: &mut Frame,
        folder: &Path,
    ) -> Result<(), Failure> {
        let name = &self.paths[camera].0;
        let view = self.view(camera, k);
        let settings =
            Settings { background: self.scene.output.background.0, anti_aliased: self.antialiased, clip: self.clip, ..Settings::default() };
        let channels = if self.wants("thermal") { Channels::RgbaTemperature } else { Channels::Rgba };
        rasterizer.render(g, &view, &settings, channels, frame);
        let fail = |e: megas_film::FilmError| Failure::Input(e.to_string());
        if self.wants("rgb") {
            write_png(picture_path(folder, name, "rgb", k), &frame.rgb_image(), true).map_err(fail)?;
        }
        if self.wants("thermal") {
            let n = frame.rgb.len();
            let plane = |data: Vec<f32>| Image { width: frame.width, height: frame.height, channels: 1, data };
            let alpha = plane((0..n).map(|i| frame.alpha(i)).collect());
            let kelvin = plane((0..n).map(|i| frame.temperature[i] / frame.alpha(i).max(1e-6)).collect());
            let image = thermal_image(&kelvin, &alpha, &self.style).map_err(fail)?;
            write_png(picture_path(folder, name, "thermal", k), &image, true).map_err(fail)?;
        }
        Ok(())
    }
}

/// Encodes the films from the pictures on disk.
fn films(studio: &Studio<'_>, folder: &Path, options: &Options, total: u64, sink: &dyn Sink) -> Result<Vec<String>, Failure> {
    create_dir(&options.out)?;
    let wanted = &studio.scene.output.films;
    sink.event(Event::Stage { name: "encode", steps: total * (studio.paths.len() * wanted.len()) as u64 });
    let start = Instant::now();
    let mut paths = Vec::new();
    let mut done = 0;
    for (name, _) in &studio.paths {
        for film in wanted {
            let stem = match film {
                Film::Rgb => "film",
                other => other.name(),
            };
            let file = if name == "main" { format!("{stem}.mp4") } else { format!("{name}_{stem}.mp4") };
            let path = options.out.join(file);
            let mut writer: Option<Mp4Writer> = None;
            for k in 0..total {
                if sink.cancelled() {
                    return Err(Failure::Interrupted("stopped while encoding; run the same command again to continue".into()));
                }
                let read = |kind| read_png(&picture_path(folder, name, kind, k));
                let time = k as f64 * studio.scene.time.frame_dt_s();
                let image = match film {
                    Film::Rgb => read("rgb")?,
                    Film::Thermal => read("thermal")?,
                    Film::SideBySide => {
                        let captions = Captions { time: Some(time), ..Captions::default() };
                        side_by_side(&read("rgb")?, &read("thermal")?, &captions).map_err(|e| Failure::Input(e.to_string()))?
                    }
                };
                let w = match &mut writer {
                    Some(w) => w,
                    none => none.insert(
                        Mp4Writer::create(&path, image.width, image.height, studio.scene.time.fps, true)
                            .map_err(|e| Failure::Input(e.to_string()))?,
                    ),
                };
                w.push(&image).map_err(|e| Failure::Input(e.to_string()))?;
                done += 1;
                sink.event(Event::Step { done });
            }
            if let Some(w) = writer {
                w.finish().map_err(|e| Failure::Input(e.to_string()))?;
                sink.event(Event::File(&path));
                paths.push(path.display().to_string());
            }
        }
    }
    sink.event(Event::StageDone { name: "encode", seconds: start.elapsed().as_secs_f64() });
    Ok(paths)
}

pub(crate) fn read_png(path: &Path) -> Result<Image, Failure> {
    let image = image::open(path).map_err(|e| Failure::Input(format!("{}: {e}; delete it to render it again", path.display())))?.to_rgb8();
    let (width, height) = image.dimensions();
    Ok(Image { width, height, channels: 3, data: image.into_raw().iter().map(|v| f32::from(*v) / 255.0).collect() })
}
