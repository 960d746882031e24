//! From the scene's words to the simulator's numbers.

use std::cell::RefCell;
use std::collections::HashMap;

use megas_math::{quat, vec3};
use megas_model::Points;
use megas_scene::{
    AirMode, AirStorage, Auto, CELSIUS_K, Clock, Frame, Heat, HeatTransfer, MomentumTransfer, MotionKey, Object, Placement, Quantity,
    Region, ResolvedMaterial, Scene, Severity,
};
use megas_sim::air::{SimulatedAir, Storage};
use megas_sim::collider::{Collider, Thermal};
use megas_sim::material::{Law, Material, PhaseMode, Rheology};
use megas_sim::phase::PhaseOptions;
use megas_sim::region;
use megas_sim::schedule::{Duty, Motion, PoseKey, Schedule};
use megas_sim::solver::{Coupling, Solver, SolverConfig};
use megas_sim::source::{Film, HeatSource, Light, Radiant, SourceKind};
use megas_sim::table::{Table, TableError, Tables};
use megas_sim::thermal::{AirModel, ThermalOptions, Transfer, natural_film_coefficient};

use crate::body::{Bodies, scene_objects, total_height};
use crate::meshes::Meshes;
use crate::{Failure, LoadedScene};

/// What sources need to know about the bodies.
pub struct HeatContext<'a> {
    /// Scene ↔ metres.
    pub placement: &'a Placement,
    /// Object numbers by name.
    pub objects: &'a HashMap<String, u16>,
    /// Surroundings \[K\].
    pub ambient_k: f64,
    /// 60 K above the highest melting point of the scene \[K\].
    pub default_source_k: f64,
    /// Film coefficient of natural convection around the bodies \[W/(m²·K)\].
    pub natural_film: f64,
    /// Turns mesh files into shapes.
    pub meshes: &'a Meshes<'a>,
}

/// The simulator's source of one `[[heat]]`.
pub fn heat_source(heat: &Heat, context: &HeatContext<'_>) -> Result<HeatSource, Failure> {
    let kind = match heat.quantity(context.ambient_k) {
        Quantity::Temperature(k) => SourceKind::Temperature { kelvin: k.unwrap_or(context.default_source_k) },
        Quantity::Power(watts) => SourceKind::Power { watts },
        Quantity::Volume(watts_per_m3) => SourceKind::Volume { watts_per_m3 },
        Quantity::Flux(watts_per_m2) => SourceKind::Flux { watts_per_m2 },
        Quantity::Film { coefficient, temperature_k } => {
            SourceKind::Film(Film { ambient: temperature_k, coefficient: coefficient.unwrap_or(context.natural_film), emissivity: 0.0 })
        }
        Quantity::Radiant { strength, absorptivity } => {
            SourceKind::Radiant(Radiant { light: light(heat, context.placement), strength, absorptivity })
        }
        Quantity::Radiation { emissivity, temperature_k } => {
            SourceKind::Film(Film { ambient: temperature_k, coefficient: 0.0, emissivity })
        }
    };
    // Keyframes of a temperature are in °C in the file and in kelvin in the simulator.
    let kelvin = matches!(kind, SourceKind::Temperature { .. } | SourceKind::Film(_));
    let offset = if kelvin { CELSIUS_K } else { 0.0 };
    let s = &heat.schedule;
    let whole = s.start_s <= 0.0 && s.end_s.is_none() && s.ramp_s <= 0.0;
    let schedule = Schedule {
        intervals: if whole { Vec::new() } else { vec![[s.start_s, s.end_s.unwrap_or(f64::MAX)]] },
        ramp: s.ramp_s,
        keyframes: s.keyframes.iter().map(|k| [k[0], k[1] + offset]).collect(),
        duty: s.period_s.map(|period| Duty { period, on: s.duty.unwrap_or(0.5) }),
    };
    Ok(HeatSource {
        name: heat.name.clone(),
        region: heat_region(&heat.region, heat.frame, !heat.motion.is_empty(), context)?,
        kind,
        schedule,
        motion: motion(&heat.motion, heat.frame, context.placement),
    })
}

/// Half of the opening angle of a torch that does not say \[°\].
const CONE_DEG: f64 = 20.0;

/// Where the light of a radiant source comes from.
fn light(heat: &Heat, placement: &Placement) -> Light {
    let direction = heat.direction.map_or([0.0, 0.0, -1.0], |d| placement.direction(heat.frame, d));
    match heat.position {
        None => Light::Sun { direction },
        Some(p) => {
            Light::Torch { position: placement.point(heat.frame, p), direction, half_angle: heat.cone_deg.unwrap_or(CONE_DEG).to_radians() }
        }
    }
}

fn heat_region(r: &Region, frame: Frame, moves: bool, context: &HeatContext<'_>) -> Result<region::Region, Failure> {
    let object = |name: &str| {
        context
            .objects
            .get(name)
            .copied()
            .ok_or_else(|| Failure::Input(format!("heat source names the object '{name}', which does not exist")))
    };
    match (r, r.to_si(frame, context.placement)) {
        (_, Some(shape)) => Ok(shape.into()),
        (Region::Mesh(m), None) => Ok(context.meshes.shape(frame, m, moves)?.into()),
        (Region::Surface(name), None) if name == "all" => Ok(region::Region::Surface(None)),
        (Region::Surface(name), None) => Ok(region::Region::Surface(Some(object(name)?))),
        (Region::Object(name), None) if name != "all" => Ok(region::Region::Object(object(name)?)),
        _ => Ok(region::Region::All),
    }
}

/// Keyframed motion in metres.
pub fn motion(keys: &[MotionKey], frame: Frame, placement: &Placement) -> Motion {
    let one = placement.length(frame, 1.0);
    let key = |k: &MotionKey| {
        let turn = |d: [f64; 3]| match frame {
            Frame::Scene => placement.similarity.direction_to_si(d),
            Frame::Object => d,
        };
        let axis = vec3::normalize_or(turn(k.axis), [0.0, 0.0, 1.0]);
        PoseKey {
            time: k.time_s,
            translation: vec3::scale(turn(k.offset), one),
            rotation: quat::from_axis_angle(axis, k.rotation_deg.to_radians()),
        }
    };
    Motion(keys.iter().map(key).collect())
}

/// The number of an [`Auto`], or the program's choice.
pub fn auto(value: Auto, choice: impl FnOnce() -> f64) -> f64 {
    value.value().unwrap_or_else(choice)
}

/// The material of an object in the scene's numbers, for a body of that height \[m\].
pub fn resolve_material(scene: &Scene, object: &Object, height_m: f64) -> Result<ResolvedMaterial, Failure> {
    let spec = scene
        .material(&object.material)
        .ok_or_else(|| Failure::Input(format!("object '{}': there is no material '{}'", object.name, object.material)))?;
    spec.resolve(&object.material, &scene.material_context(object, height_m))
        .map_err(|e| Failure::Input(format!("material '{}' of object '{}': {e}", object.material, object.name)))
}

/// The same material for the simulator.
pub fn sim_material(m: &ResolvedMaterial) -> Result<Material, Failure> {
    let bad = |e: TableError| Failure::Input(format!("material '{}': a table over temperature: {e}", m.name));
    let tables = Tables {
        stiffness: Table::linear(&m.tables.stiffness).map_err(bad)?,
        solid_yield: Table::linear(&m.tables.solid_yield).map_err(bad)?,
        melt_yield: Table::log_linear(&m.tables.melt_yield).map_err(bad)?,
        melt_consistency: Table::log_linear(&m.tables.melt_consistency).map_err(bad)?,
        conductivity: Table::linear(&m.tables.conductivity).map_err(bad)?,
    };
    Ok(Material {
        name: m.name.clone(),
        law: match m.law {
            megas_scene::Law::Hencky => Law::Hencky,
            megas_scene::Law::FixedCorotated => Law::FixedCorotated,
            megas_scene::Law::NeoHookean => Law::NeoHookean,
            megas_scene::Law::NeoHookeanSplit => Law::NeoHookeanSplit,
            megas_scene::Law::VonMises => Law::VonMises,
            megas_scene::Law::DruckerPrager => Law::DruckerPrager,
            megas_scene::Law::Fluid => Law::Fluid,
        },
        density: m.density,
        shear_modulus: m.shear_modulus,
        bulk_modulus: m.bulk_modulus,
        solid_yield_stress: m.solid_yield_stress,
        melt_shear_modulus: m.melt_shear_modulus,
        melt: Rheology { yield_stress: m.melt_yield_stress, consistency: m.melt_consistency, index: m.melt_flow_index },
        arrhenius_k: m.arrhenius_k,
        softening: m.softening,
        reference_temperature: m.reference_temperature,
        heat_capacity_solid: m.heat_capacity_solid,
        heat_capacity_liquid: m.heat_capacity_liquid,
        conductivity_solid: m.conductivity_solid,
        conductivity_liquid: m.conductivity_liquid,
        latent_heat: m.latent_heat,
        solidus: m.solidus,
        liquidus: m.liquidus,
        phase_mode: match m.phase_mode {
            megas_scene::PhaseMode::Mushy => PhaseMode::Mushy,
            megas_scene::PhaseMode::Binary => PhaseMode::Binary,
            megas_scene::PhaseMode::InitMelted => PhaseMode::InitMelted,
        },
        hardening: m.hardening,
        friction_angle: m.friction_angle,
        fluid_viscosity: m.fluid_viscosity,
        melt_density: m.melt_density,
        expansion: m.expansion,
        tables,
    })
}

/// Seconds at nature's pace until what the sources reach has melted (simulation.md §3.8, §10.3): the heat that the material
/// in their regions takes, over the power they bring at the start. Sources that hold a temperature bring as much as
/// conduction through the melt lets pass. Infinite if nothing melts.
fn natural_melt_time(config: &SolverConfig, materials: &[ResolvedMaterial], points: &Points) -> Result<f64, Failure> {
    // Whatever is scheduled counts at its strongest.
    let strongest = |s: &HeatSource| {
        let peak = s.schedule.keyframes.iter().copied().max_by(|a, b| a[1].total_cmp(&b[1]));
        HeatSource { schedule: Schedule { keyframes: peak.into_iter().collect(), ..Schedule::default() }, ..s.clone() }
    };
    let sources: Vec<HeatSource> = config.sources.iter().map(strongest).collect();
    let setup = SolverConfig { sources: sources.clone(), ..config.clone() };
    let mut solver = Solver::new(setup, points).map_err(|e| Failure::Input(e.to_string()))?;
    let powers = solver.probe_power().map_err(|e| Failure::Input(e.to_string()))?;
    let mut best = f64::INFINITY;
    let mut total = 0.0;
    for (k, &(power, area)) in powers.iter().enumerate() {
        total += power;
        // The last one is the film of the air; it acts everywhere, together with the others.
        let (source, power) = match sources.get(k) {
            Some(s) => (s.clone(), power),
            None => (nothing(), total),
        };
        let reached = reached(&source, config, materials, points);
        if let SourceKind::Temperature { .. } = source.kind {
            best = best.min(reached.conduction_s);
        } else if power > 0.0 && reached.volume > 0.0 {
            best = best.min(reached.heat / power * reached.overheating(power, area));
        }
    }
    Ok(config.colliders.iter().map(|c| conduction_from(c, config.ambient, materials, points)).fold(best, f64::min))
}

/// Time \[s\] until the heat of an obstacle that holds a temperature has melted what lies on it: conduction through a layer as
/// thick as twice the mean distance of the points.
fn conduction_from(collider: &Collider, ambient: f64, materials: &[ResolvedMaterial], points: &Points) -> f64 {
    let Thermal::Fixed { kelvin, keyframes } = &collider.thermal else { return f64::INFINITY };
    let hottest = keyframes.iter().map(|k| k[1]).reduce(f64::max).unwrap_or(*kelvin);
    let Some(pose) = collider.at(0.0) else { return f64::INFINITY };
    let time = |(k, m): (usize, &ResolvedMaterial)| {
        let mine = (0..points.len()).filter(|&i| usize::from(points.material[i]) == k);
        let (sum, n) = mine.fold((0.0, 0.0), |(s, n), i| (s + pose.distance(&collider.shape, points.position[i]).0.max(0.0), n + 1.0));
        if n > 0.0 { m.melt_time_s(2.0 * sum / n, m.initial_temperature_k(ambient), None, Some(hottest)) } else { f64::INFINITY }
    };
    materials.iter().enumerate().map(time).fold(f64::INFINITY, f64::min)
}

/// Every body, without an effect.
fn nothing() -> HeatSource {
    HeatSource {
        name: String::new(),
        region: region::Region::All,
        kind: SourceKind::Power { watts: 0.0 },
        schedule: Schedule::default(),
        motion: Motion::default(),
    }
}

/// What a source has to melt.
#[derive(Default)]
struct Reached {
    /// Heat that melting takes in the region \[J\].
    heat: f64,
    /// Meltable volume in the region \[m³\].
    volume: f64,
    /// Time that conduction from a wall at the source's temperature needs \[s\].
    conduction_s: f64,
    /// `∫ c_l / k_l dV` of the melt \[J·m⁴/(kg·W)\] times density: what a kelvin per watt of resistance stores.
    storage: f64,
}

impl Reached {
    /// Volume over surface of a compact body; a ball has 0.207 V^(1/3).
    fn depth(&self) -> f64 {
        0.2 * self.volume.cbrt()
    }

    /// Heat that the melt takes above its melting point on the way, relative to what melting needs: a strong flux through a poor
    /// conductor overheats the surface first. Half of the steady temperature difference across the depth.
    fn overheating(&self, power: f64, area: f64) -> f64 {
        if area <= 0.0 || self.heat <= 0.0 {
            return 1.0;
        }
        1.0 + 0.5 * power / area * self.depth() * self.storage / self.heat
    }
}

fn reached(source: &HeatSource, config: &SolverConfig, materials: &[ResolvedMaterial], points: &Points) -> Reached {
    let mut out = Reached { conduction_s: f64::INFINITY, ..Reached::default() };
    let mut slowest = 0.0f64;
    let start = source.motion.at(0.0, source.region.pivot());
    for (k, m) in materials.iter().enumerate().filter(|(_, m)| m.melting_point().is_finite()) {
        let mut v = 0.0;
        for i in (0..points.len()).filter(|&i| usize::from(points.material[i]) == k) {
            let inside = source.region.object().is_none_or(|o| o == points.object[i])
                && source.region.weight(points.position[i], config.grid.spacing, &start) > 0.5;
            if inside {
                let dv = f64::from(points.volume[i]);
                let warm = m.heat_capacity_solid * (m.melting_point() - f64::from(points.temperature[i])).max(0.0);
                out.heat += dv * m.density * (m.latent_heat + warm);
                out.storage += dv * m.density * m.heat_capacity_liquid / m.conductivity_liquid;
                v += dv;
            }
        }
        out.volume += v;
        if v > 0.0
            && let SourceKind::Temperature { kelvin } = source.kind
        {
            let start = m.initial_temperature_k(config.ambient);
            slowest = slowest.max(m.melt_time_s(0.2 * v.cbrt(), start, None, Some(kelvin)));
        }
    }
    if slowest > 0.0 {
        out.conduction_s = slowest;
    }
    out
}

/// The film that stands in for the air.
pub fn air_film(scene: &Scene, volume_m3: f64) -> Film {
    let ambient = scene.ambient_k();
    let coefficient = auto(scene.air.film_coefficient_w_m2k, || natural_film_coefficient(volume_m3, 20.0, ambient));
    Film { ambient, coefficient, emissivity: scene.air.emissivity }
}

/// The air as a lattice.
fn simulated_air(scene: &Scene, volume_m3: f64, config: &SolverConfig, points: &Points) -> Result<SimulatedAir, Failure> {
    if scene.simulation.heat_every_substep {
        return Err(Failure::Input(
            "air.mode: \"still\" and \"lbm\" need exchanges at even intervals; set simulation.heat_every_substep = false, or air.mode = \"film\"".into(),
        ));
    }
    let film = air_film(scene, volume_m3);
    let sources = config.sources.iter().filter_map(|s| match s.kind {
        SourceKind::Temperature { kelvin } => Some(kelvin),
        SourceKind::Film(f) => Some(f.ambient),
        // Powers have no temperature; what they heat melts before it gets much hotter.
        _ => None,
    });
    let colliders = config.colliders.iter().flat_map(|c| match &c.thermal {
        Thermal::Fixed { kelvin, keyframes } if keyframes.is_empty() => vec![*kelvin],
        Thermal::Fixed { keyframes, .. } => keyframes.iter().map(|k| k[1]).collect(),
        _ => Vec::new(),
    });
    let melting = config.materials.iter().map(|m| m.liquidus).filter(|t| t.is_finite());
    let start = points.temperature.iter().map(|t| f64::from(*t));
    let difference = sources.chain(colliders).chain(melting).chain(start).map(|t| (t - film.ambient).abs()).fold(5.0, f64::max);
    Ok(SimulatedAir {
        convection: scene.air.mode == AirMode::Lbm,
        wall_film: if scene.air.wall_film { film.coefficient } else { 0.0 },
        emissivity: film.emissivity,
        temperature_difference: difference,
        gravity: scene.simulation.gravity_m_s2,
        plume_steps: scene.air.plume_steps,
        closed: scene.air.closed,
        storage: match scene.air.storage {
            AirStorage::F32 => Storage::F32,
            AirStorage::F16 => Storage::F16,
        },
        flow_ratio: if scene.air.coarse_flow { 2 } else { 1 },
    })
}

/// What a scene becomes for the simulator.
pub struct Prepared {
    /// Everything the solver needs.
    pub config: SolverConfig,
    /// Thermal acceleration.
    pub acceleration: f64,
    /// Time to melt at nature's pace \[s\]; infinite if nothing melts.
    pub melt_time: f64,
    /// Remarks of the material checks.
    pub remarks: Vec<(Severity, String)>,
}

/// The simulator's configuration of a scene with built bodies.
pub fn prepare(loaded: &LoadedScene, bodies: &Bodies) -> Result<Prepared, Failure> {
    let scene = &loaded.scene;
    let meta = &bodies.meta;
    let objects = scene_objects(scene);
    let height = total_height(meta);
    let placement = meta.placement();
    let materials = objects.iter().map(|o| resolve_material(scene, o, height)).collect::<Result<Vec<_>, _>>()?;
    let simulated: Vec<Material> = materials.iter().map(sim_material).collect::<Result<_, _>>()?;
    let limits = scene.step_limits(height, meta.dx_m);
    let mut remarks = Vec::new();
    for m in &materials {
        for (severity, text) in m.check(&limits).messages {
            match severity {
                Severity::Error => return Err(Failure::Input(text)),
                _ if remarks.iter().any(|(_, t)| *t == text) => {}
                _ => remarks.push((severity, text)),
            }
        }
    }
    remarks.extend(crate::gaps::remarks(&bodies.points, meta.dx_m, |number| {
        meta.objects.iter().find(|o| o.number == number).map_or_else(|| number.to_string(), |o| o.name.clone())
    }));
    let names: HashMap<String, u16> = meta.objects.iter().map(|o| (o.name.clone(), o.number)).collect();
    let volume: f64 = meta.objects.iter().map(|o| o.volume_m3).sum();
    let hottest = materials.iter().map(ResolvedMaterial::melting_point).filter(|t| t.is_finite()).fold(scene.ambient_k(), f64::max);
    let grid = crate::room::grid(scene, meta, &simulated)?;
    let meshes = Meshes { base_dir: &loaded.base_dir, placement: &placement, grid: &grid, remarks: RefCell::default() };
    let context = HeatContext {
        meshes: &meshes,
        placement: &placement,
        objects: &names,
        ambient_k: scene.ambient_k(),
        default_source_k: hottest + 60.0,
        natural_film: natural_film_coefficient(volume, 20.0, scene.ambient_k()),
    };
    let sources = scene.heat_or_default().iter().map(|h| heat_source(h, &context)).collect::<Result<Vec<_>, _>>()?;
    let air = match scene.air.mode {
        AirMode::None => AirModel::None,
        // Simulated air follows below; until then a film stands in for it where melting times are estimated.
        AirMode::Film | AirMode::Still | AirMode::Lbm => AirModel::Film(air_film(scene, volume)),
    };
    let transfer = match scene.heat_transfer() {
        HeatTransfer::Increments => Transfer::default(),
        HeatTransfer::Affine => Transfer::AffineOverwrite,
        HeatTransfer::Pic => Transfer::PicOverwrite,
    };
    let colliders = crate::colliders::colliders(scene, bodies, &meshes)?;
    remarks.extend(meshes.remarks.borrow_mut().drain(..).map(|text| (Severity::Warning, text)));
    let mut config = SolverConfig {
        grid,
        materials: simulated,
        sources,
        colliders,
        gravity: [0.0, 0.0, -scene.simulation.gravity_m_s2],
        ambient: scene.ambient_k(),
        thermal: ThermalOptions { air, transfer, ..ThermalOptions::default() },
        phase: PhaseOptions { delta_t: scene.hysteresis_k(), frozen_stress: scene.simulation.frozen_stress, ..PhaseOptions::default() },
        frame_dt: scene.time.frame_dt_s(),
        coupling_step: scene.simulation.coupling_step_s,
        courant: scene.simulation.courant,
        mechanics: scene.simulation.mechanics,
        bounds: match scene.simulation.bounds {
            megas_scene::Bounds::Clamp => megas_sim::mechanics::Bounds::Clamp,
            megas_scene::Bounds::Delete => megas_sim::mechanics::Bounds::Delete,
        },
        coupling: Coupling {
            plain_momentum: scene.simulation.momentum_transfer == MomentumTransfer::Pic,
            heat_every_substep: scene.simulation.heat_every_substep,
        },
    };
    let melt_time = natural_melt_time(&config, &materials, &bodies.points)?;
    let factor = match scene.clock() {
        Clock::Factor(f) => f,
        Clock::MeltIn(seconds) if melt_time.is_finite() => (melt_time / seconds).max(1.0),
        Clock::MeltIn(_) => 1.0,
    };
    config.materials = config.materials.iter().map(|m| m.accelerated(factor)).collect();
    for c in &mut config.colliders {
        if let Thermal::Conducting(inside) = &mut c.thermal {
            inside.volumetric_capacity /= factor;
        }
    }
    if matches!(scene.air.mode, AirMode::Still | AirMode::Lbm) {
        config.thermal.air = AirModel::Simulated(simulated_air(scene, volume, &config, &bodies.points)?);
    }
    Ok(Prepared { config, acceleration: factor, melt_time, remarks })
}
