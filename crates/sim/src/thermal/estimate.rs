//! Rules of thumb for people: film coefficients, melting times, thermal acceleration (simulation.md §3.8, §4.7, §10.3).

use crate::material::Material;
use crate::source::Film;

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

/// Film coefficient \[W/(m²·K)\] of a sphere-like body of `volume` \[m³\] in wind of `speed` \[m/s\] (Ranz and Marshall).
pub fn forced_film_coefficient(volume: f64, speed: f64) -> f64 {
    let (nu, alpha, k) = AIR;
    let d = (6.0 * volume / std::f64::consts::PI).cbrt();
    let reynolds = speed.abs() * d / nu;
    (2.0 + 0.6 * reynolds.sqrt() * (nu / alpha).cbrt()) * k / d
}

/// Heat flux \[W/m²\] that a film brings to a melting surface; negative if the surroundings are colder.
pub fn film_flux(film: &Film, surface: f64) -> f64 {
    film.total_coefficient(surface) * (film.ambient - surface)
}

/// Seconds to melt a body of `volume` \[m³\] and `area` \[m²\] that starts at `t0` \[K\] under the flux `flux` \[W/m²\]
/// from a source at `source` \[K\]; the larger of the flux-limited time and the time that conduction through the melt takes.
/// Infinite if it never melts.
pub fn melting_time(material: &Material, volume: f64, area: f64, t0: f64, flux: f64, source: f64) -> f64 {
    let t_m = material.melting_point();
    if !t_m.is_finite() || flux <= 0.0 || source <= t_m {
        return f64::INFINITY;
    }
    let latent = material.density * material.latent_heat;
    let sensible = material.density * material.heat_capacity_solid * (t_m - t0).max(0.0);
    let thickness = volume / area;
    let by_flux = (latent + sensible) * thickness / flux;
    let by_conduction = latent * thickness * thickness / (2.0 * material.conductivity_liquid * (source - t_m));
    by_flux.max(by_conduction)
}

/// Thermal acceleration A_th ≥ 1 with which a melting time of `real` seconds becomes `wanted` seconds.
pub fn acceleration(real: f64, wanted: f64) -> f64 {
    if real.is_finite() && wanted > 0.0 { (real / wanted).max(1.0) } else { 1.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::thermal::enthalpy::tests::wax;

    #[test]
    fn an_ice_ball_in_a_room_melts_in_hours() {
        // simulation.md V42: 30 mm ice sphere, 22 °C still air, h_f = 10: 5.8 h.
        let ice = Material { density: 917.0, latent_heat: 334e3, solidus: 273.15, liquidus: 273.15, ..wax() };
        let (r, film) = (0.015f64, Film { ambient: 295.15, coefficient: 10.0, emissivity: 0.0 });
        let (v, a) = (4.0 / 3.0 * std::f64::consts::PI * r.powi(3), 4.0 * std::f64::consts::PI * r * r);
        // The rule uses V/A = R/3 of the initial ball; a shrinking ball takes R/(…) three times longer.
        let t = melting_time(&ice, v, a, 273.15, film_flux(&film, 273.15), 295.15);
        assert!((3.0 * t / 3600.0 - 5.8).abs() < 0.1, "{} h", 3.0 * t / 3600.0);
        assert_eq!(acceleration(t, t / 50.0), 50.0);
        assert_eq!(acceleration(f64::INFINITY, 5.0), 1.0);
    }

    #[test]
    fn film_coefficients_are_those_of_room_air() {
        let v = 4.0 / 3.0 * std::f64::consts::PI * 0.05f64.powi(3);
        let h = natural_film_coefficient(v, 40.0, 293.15);
        assert!((4.0..9.0).contains(&h), "{h}");
        assert!(forced_film_coefficient(v, 3.0) > 2.0 * h);
        // Radiation adds about five.
        let grey = Film { emissivity: 0.9, ..Film::default() };
        assert!((grey.total_coefficient(293.15) - 10.0 - 5.1).abs() < 0.2);
    }
}
