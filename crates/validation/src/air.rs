//! Lattice Boltzmann air: temperature, flow, both together, obstacles (simulation.md §8.2, §8.3).

mod cavity;
mod conduction;
mod flow;
mod obstacles;

use crate::{Case, Tier};

/// The cases of this file.
pub const CASES: &[Case] = &[
    Case::new("V05", "diffusion of a Gaussian in three dimensions", Tier::A, conduction::gaussian)
        .proves("conductivity against relaxation time (a factor of two is easily lost) and isotropy")
        .setup("periodic 64³, σ_{0} = 5, K = 0.05 and 0.2, until the variance has doubled; populations and flux links")
        .formula("T(0) = (1 + 2Kt/σ_{0}²)^{−3/2}"),
    Case::new("V07", "Gaussian carried around the box", Tier::A, conduction::advected)
        .proves("the velocity in the equilibrium of the temperature")
        .setup("periodic line of N = 64, 128, 256 nodes, u = 0.05, σ = N/16, K = 0.01 N/64, one crossing")
        .formula("σ² = σ_{0}² + 2K(1 − 4u²)t, centre back at its start"),
    Case::new("V08", "slab with a uniform heat source", Tier::A, conduction::source_slab)
        .proves("the half source in the enthalpy, and that walls of fixed temperature lie exactly half-way")
        .setup("16 nodes between walls at T = 0, S = 10^{−5}, double precision")
        .formula("T = S y(N − y)/2K; with Λ = ¼ too large by 6(Λ − 1/6)/N²"),
    Case::new("V09", "steady conduction through two layers", Tier::A, conduction::two_layers)
        .proves("that flux and temperature are continuous across a jump of capacity and conductivity")
        .setup("32 nodes between walls at 1 and 0, K = 0.01 | 0.1 and 0.01 | 1, C = 1 | 50, 40 000 steps")
        .formula("q = 1/(16/K_{1} + 16/K_{2})"),
    Case::new("V10", "two half spaces in contact", Tier::A, conduction::contact)
        .proves("the ratio of heat capacities, transient")
        .setup("400 nodes, K = 0.05 | 0.5, C = 1 | 1, 50, 1700, t = 8000")
        .formula("contact temperature e_{L}/(e_{L} + e_{R}), e = √(KC), error functions on both sides"),
    Case::new("V18", "Poiseuille flow driven by a force", Tier::A, flow::poiseuille)
        .proves("two relaxation times, Guo forcing, and that walls lie exactly half-way at every viscosity")
        .setup("16 nodes between walls, ν = 0.02 to 0.5, F = 10^{−6}, double precision")
        .formula("u = F y(N − y)/2ν"),
    Case::new("V19", "Taylor–Green vortices", Tier::A, flow::taylor_green)
        .proves("the viscosity")
        .setup("periodic N², N = 32, 64, 128, u_{0} = 0.04 · 32/N, ν = 0.02")
        .formula("kinetic energy e^{−4νk²t}"),
    Case::new("V20", "lid-driven cavity at Re = 100", Tier::B, flow::lid_driven)
        .proves("the moving wall and the nonlinear terms")
        .setup("96², lid at 0.1, 40 000 steps")
        .formula("Ghia, Ghia and Shin 1982; extrema of Botella and Peyret 1998"),
    Case::new("V21", "onset of Rayleigh–Bénard convection", Tier::C, cavity::onset)
        .proves("buoyancy, viscosity and diffusivity at once: the most sensitive single number of the air")
        .setup("64 × 32, periodic sides, Pr = 0.71, growth rates at four Rayleigh numbers, zero by a straight line")
        .formula("Ra_{c} = 1707.76 (Chandrasekhar 1961)"),
    Case::new("V22", "natural convection in a square cavity, Ra = 10³ and 10⁴", Tier::B, cavity::square_small)
        .proves("the whole air: flow, temperature, buoyancy, walls")
        .setup("32² and 64², hot left, cold right, other walls adiabatic, Pr = 0.71, until the Nusselt number rests")
        .formula("de Vahl Davis 1983"),
    Case::new("V22-half", "vortices and natural convection in half precision", Tier::B, cavity::half)
        .proves("how much of the air survives when its populations are stored in 16 bits")
        .setup("V19 at N = 64 and 128, V22 at Ra = 10³ and 10⁴, as many steps as single precision needs to rest")
        .formula("the same runs in single precision; de Vahl Davis 1983"),
    Case::new("V22", "natural convection in a square cavity, Ra = 10⁵", Tier::C, cavity::square_large)
        .proves("thin boundary layers")
        .setup("96², as above")
        .formula("de Vahl Davis 1983"),
    Case::new("V22", "natural convection in a square cavity, Ra = 10⁶", Tier::C, cavity::square_largest)
        .proves("boundary layers of a few nodes")
        .setup("160², as above")
        .formula("de Vahl Davis 1983"),
    Case::new("V22-coarse", "natural convection with the flow on every second node", Tier::B, cavity::coarse)
        .proves("that the flow may have an eighth of the nodes")
        .setup("V22 at Ra = 10³, 10⁴ and 10⁵: temperature on 32², 64² and 96² nodes, flow on 16², 32² and 48²")
        .formula("de Vahl Davis 1983"),
    Case::new("V23", "natural convection in a cubic cavity, Ra = 10⁴", Tier::C, cavity::cube)
        .proves("the third dimension")
        .setup("32³, hot and cold walls, four adiabatic walls")
        .formula("mean Nusselt number 2.0542, spectral (Tric, Labrosse and Betrouni 2000)"),
    Case::new("V24", "impulsively started solid, and a block that crosses a box", Tier::A, obstacles::saturated)
        .proves("partially saturated nodes: no slip, no leak through touching solids, no lost mass")
        .setup("half space over nodes of s = 1 that slide at 0.05, alone and on a resting block, ν = 0.05, t = 2000; block of 8³ through 20 cells")
        .formula("u = v erfc(y/√(4νt))"),
    Case::new("V25", "plume of a hot ball in an open room", Tier::B, obstacles::plume)
        .proves("open faces and sponges: no preferred direction, heat and mass accounted for")
        .setup("48 × 48 × 96, ball of radius 6 held hot near the bottom, 4000 steps")
        .formula("mirror symmetry; heat in = heat stored + heat out"),
];

/// Runs on the calling thread alone: small lattices are not worth sharing.
fn alone<T: Send>(f: impl FnOnce() -> T + Send) -> T {
    match rayon::ThreadPoolBuilder::new().num_threads(1).build() {
        Ok(pool) => pool.install(f),
        Err(_) => f(),
    }
}

/// Complementary error function: series for small arguments, continued fraction for large ones.
fn erfc(x: f64) -> f64 {
    let z = x.abs();
    let value = if z < 2.0 {
        let (mut term, mut sum) = (z, z);
        for n in 1..60 {
            term *= -z * z / f64::from(n);
            sum += term / f64::from(2 * n + 1);
        }
        1.0 - 2.0 / std::f64::consts::PI.sqrt() * sum
    } else {
        let mut d = z;
        for n in (1..60).rev() {
            d = z + 0.5 * f64::from(n) / d;
        }
        (-z * z).exp() / (std::f64::consts::PI.sqrt() * d)
    };
    if x < 0.0 { 2.0 - value } else { value }
}

#[cfg(test)]
mod tests {
    use crate::assert_case;

    #[test]
    fn error_function() {
        for (x, e) in [
            (0.5, 0.479_500_122_186_953_5),
            (1.5, 0.033_894_853_524_689_27),
            (3.0, 2.209_049_699_858_544e-5),
            (-0.5, 1.520_499_877_813_046_5),
        ] {
            assert!((super::erfc(x) - e).abs() < 1e-12, "{x}");
        }
    }

    /// Prints the rows of the cases named in `CASES` (V22,V23).
    #[test]
    #[ignore = "takes minutes; a tool to look at numbers"]
    fn show() {
        let wanted = std::env::var("CASES").unwrap_or_default();
        for case in super::CASES.iter().filter(|c| wanted.split(',').any(|w| w == c.id || c.name.ends_with(w) && !w.is_empty())) {
            let start = std::time::Instant::now();
            let outcome = (case.run)();
            for r in outcome.rows {
                let mark = if r.passed() { "" } else { "FAILED" };
                println!("{} {:<55} {:>13.6e} {:>13.6e} {:>9.1e} {mark}", case.id, r.quantity, r.reference, r.ours, r.tolerance);
            }
            println!("{} {:?} {:?}", case.id, start.elapsed(), outcome.notes);
        }
    }

    #[test]
    fn v05_gaussian() {
        assert_case("V05");
    }

    #[test]
    fn v08_source() {
        assert_case("V08");
    }

    #[test]
    fn v10_contact() {
        assert_case("V10");
    }

    #[test]
    fn v18_poiseuille() {
        assert_case("V18");
    }

    #[test]
    fn v22_small() {
        for row in super::cavity::square_small().rows {
            assert!(row.passed(), "{} is {:e}, expected {:e} ± {:e}", row.quantity, row.ours, row.reference, row.tolerance);
        }
    }

    #[test]
    fn v24_saturated() {
        assert_case("V24");
    }
}
