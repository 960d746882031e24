//! A bare set of points for thermal cases.

use megas_sim::material::{Law, Material, PhaseMode, Rheology};
use megas_sim::source::HeatSource;
use megas_sim::thermal::{Audit, ThermalPoints, ThermalSolver, Wall};

/// Points with nothing but what the heat needs.
#[derive(Clone, Default)]
pub struct Cloud {
    pub xi: Vec<[f64; 3]>,
    pub mass: Vec<f32>,
    pub volume: Vec<f32>,
    pub material: Vec<u8>,
    pub object: Vec<u16>,
    pub h: Vec<f64>,
    pub grad_t: Vec<[f32; 3]>,
}

impl Cloud {
    /// Adds a point without temperature gradient.
    pub fn push(&mut self, xi: [f64; 3], mass: f64, volume: f64, material: u8, h: f64) {
        self.xi.push(xi);
        self.mass.push(mass as f32);
        self.volume.push(volume as f32);
        self.material.push(material);
        self.object.push(0);
        self.h.push(h);
        self.grad_t.push([0.0; 3]);
    }

    /// Adds the points of another cloud as body `object`.
    pub fn append(&mut self, other: &Self, object: u16) {
        self.xi.extend(&other.xi);
        self.mass.extend(&other.mass);
        self.volume.extend(&other.volume);
        self.material.extend(&other.material);
        self.object.resize(self.xi.len(), object);
        self.h.extend(&other.h);
        self.grad_t.extend(&other.grad_t);
    }

    /// One step of the solver; an error ends the case.
    pub fn step(&mut self, solver: &mut ThermalSolver, dt: f64, time: f64, sources: &[HeatSource], walls: Option<&[Wall]>) -> Audit {
        let mut points = ThermalPoints {
            xi: &self.xi,
            mass: &self.mass,
            volume: &self.volume,
            material: &self.material,
            object: &self.object,
            h: &mut self.h,
            grad_t: &mut self.grad_t,
        };
        solver.step(&mut points, dt, time, sources, walls).unwrap_or_else(|e| panic!("{e}"))
    }
}

/// A material that only conducts: density, specific heat, conductivity; it never melts.
pub fn simple(density: f64, heat_capacity: f64, conductivity: f64) -> Material {
    Material {
        name: "simple".into(),
        law: Law::Hencky,
        density,
        shear_modulus: 1.0,
        bulk_modulus: 1.0,
        solid_yield_stress: f64::INFINITY,
        melt_shear_modulus: 1.0,
        melt: Rheology { yield_stress: 0.0, consistency: 1.0, index: 1.0 },
        arrhenius_k: 0.0,
        softening: 0.0,
        reference_temperature: 0.0,
        heat_capacity_solid: heat_capacity,
        heat_capacity_liquid: heat_capacity,
        conductivity_solid: conductivity,
        conductivity_liquid: conductivity,
        latent_heat: 0.0,
        solidus: f64::INFINITY,
        liquidus: f64::INFINITY,
        phase_mode: PhaseMode::Mushy,
        ..Material::default()
    }
}
