//! The film coefficient of natural convection (simulation.md §4.7).

/// Kinematic viscosity \[m²/s\], thermal diffusivity \[m²/s\] and conductivity \[W/(m·K)\] of room air.
const AIR: (f64, f64, f64) = (1.5e-5, 2.1e-5, 0.026);

/// Film coefficient \[W/(m²·K)\] of a sphere-like body of `volume` \[m³\] in still air, by natural convection (Churchill):
/// `ΔT` is the typical difference to the air \[K\] at absolute air temperature `ambient` \[K\].
pub fn natural_film_coefficient(volume: f64, delta_t: f64, ambient: f64) -> f64 {
    let (nu, alpha, k) = AIR;
    let d = (6.0 * volume / std::f64::consts::PI).cbrt();
    let prandtl = nu / alpha;
    let rayleigh = 9.81 * delta_t.abs() / ambient * d.powi(3) / (nu * alpha);
    let nusselt = 2.0 + 0.589 * rayleigh.powf(0.25) / (1.0 + (0.469 / prandtl).powf(9.0 / 16.0)).powf(4.0 / 9.0);
    nusselt * k / d
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::source::Film;

    #[test]
    fn film_coefficients_are_those_of_room_air() {
        let v = 4.0 / 3.0 * std::f64::consts::PI * 0.05f64.powi(3);
        let h = natural_film_coefficient(v, 40.0, 293.15);
        assert!((4.0..9.0).contains(&h), "{h}");
        // Radiation adds about five.
        let grey = Film { emissivity: 0.9, ..Film::default() };
        assert!((grey.total_coefficient(293.15) - 10.0 - 5.1).abs() < 0.2);
    }
}
