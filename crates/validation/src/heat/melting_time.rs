//! V42: how melting times grow with size (simulation.md §8.5).

use megas_math::vec3;
use megas_sim::grid::Grid;
use megas_sim::material::Material;
use megas_sim::source::Film;
use megas_sim::thermal::{AirModel, ThermalOptions, ThermalSolver, natural_film_coefficient};

use super::cloud::simple;
use super::surfaces::shape;
use crate::{Outcome, Plot, Row};

const SPACING: f64 = 1e-3;
const DENSITY: f64 = 1000.0;
const LATENT: f64 = 3.3e4;
/// Air above the melting point \[K\].
const WARMER: f64 = 20.0;

/// Seconds until a ball of `cells` per radius at its melting point has taken its latent heat, and the molten share over the time.
fn melting_time(cells: f64, coefficient: f64) -> (f64, Vec<[f64; 2]>) {
    let nodes = 2 * cells as usize + 8;
    let grid = Grid { origin: [0.0; 3], spacing: SPACING, nodes: [nodes; 3] };
    let volume = 4.0 / 3.0 * std::f64::consts::PI * cells.powi(3);
    let mut cloud = shape(&grid, volume, [1.0, 0.0, 0.0, 0.0], DENSITY, 0.0, |x| vec3::norm(x) < cells);
    let material = Material { latent_heat: LATENT, solidus: 0.0, liquidus: 0.0, ..simple(DENSITY, 2000.0, 20.0) };
    let film = Film { ambient: WARMER, coefficient, emissivity: 0.0 };
    let options = ThermalOptions { air: AirModel::Film(film), max_subcycles: 2000, ..ThermalOptions::default() };
    let mut solver = ThermalSolver::new(grid, std::slice::from_ref(&material), 0.0, options);
    let expected = DENSITY * LATENT * cells * SPACING / (3.0 * coefficient * WARMER);
    let dt = expected / 100.0;
    let mut history = vec![[0.0, 0.0]];
    for step in 1..200 {
        cloud.step(&mut solver, dt, dt * f64::from(step - 1), &[], None);
        let molten = cloud.h.iter().sum::<f64>() / (LATENT * cloud.h.len() as f64);
        let [t, before] = history[history.len() - 1];
        history.push([t + dt, molten]);
        if molten >= 1.0 {
            return (t + dt * (1.0 - before) / (molten - before), history);
        }
    }
    (f64::INFINITY, history)
}

pub fn scaling() -> Outcome {
    let (small, large) = (6.0f64, 12.0f64);
    let exact = |cells: f64, h: f64| DENSITY * LATENT * cells * SPACING / (3.0 * h * WARMER);
    let h = 20.0;
    let (time, history) = melting_time(small, h);
    let natural = |cells: f64| natural_film_coefficient(4.0 / 3.0 * std::f64::consts::PI * (cells * SPACING).powi(3), WARMER, 293.15);
    let (warm, warmer) = (natural(small), natural(large));
    let ratio = |factor: f64| melting_time(large, h * factor).0 / time;
    let rows = vec![
        Row::relative("h_f = 20 W/m²K: time of the smaller ball [s]", exact(small, h), time, 0.05),
        Row::relative("the same h_f for both: ratio of the times", 2.0, ratio(1.0), 0.05),
        Row::relative("Nu = 2 for both, h_f ∝ 1/D: ratio", 4.0, ratio(0.5), 0.05),
        Row::relative("laminar convection, h_f ∝ D^{−1/4}: ratio", 2f64.powf(1.25), ratio(2f64.powf(-0.25)), 0.05),
        Row::relative(
            "still air as scenes have it: ratio",
            2.0 * warm / warmer,
            melting_time(large, warmer).0 / melting_time(small, warm).0,
            0.05,
        ),
    ];
    let plot = Plot::new("molten share of the smaller ball", "t [s]", "f_{l}")
        .function("3h_{f}ΔT t/(ρLR)", 0.0, exact(small, h), move |t| t / exact(small, h))
        .ours("points", history);
    Outcome::from(rows).plot(plot).note(
        "The melt stays where it is, so the ball keeps its area and melts in ρLR/(3h_f ΔT); if the melt ran off it would take three times as long, \
         which is the design's formula: a suspended ball of ice 30 mm across in still air of 22 °C with h_f = 10 W/m²K takes 5.8 h.",
    )
}
