//! Points that the heat solver borrows.

use megas_sim::source::HeatSource;
use megas_sim::thermal::{Audit, ThermalError, ThermalPoints, ThermalSolver, Wall};

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
    pub fn push(&mut self, xi: [f64; 3], mass: f32, volume: f32, material: u8, object: u16, h: f64) {
        self.xi.push(xi);
        self.mass.push(mass);
        self.volume.push(volume);
        self.material.push(material);
        self.object.push(object);
        self.h.push(h);
        self.grad_t.push([0.0; 3]);
    }

    pub fn step(
        &mut self,
        solver: &mut ThermalSolver,
        dt: f64,
        sources: &[HeatSource],
        walls: Option<&[Wall]>,
    ) -> Result<Audit, ThermalError> {
        let mut points = ThermalPoints {
            xi: &self.xi,
            mass: &self.mass,
            volume: &self.volume,
            material: &self.material,
            object: &self.object,
            h: &mut self.h,
            grad_t: &mut self.grad_t,
        };
        solver.step(&mut points, dt, 0.0, sources, walls)
    }
}
