//! The physics suite: every case compares the simulator with an analytic or published reference (simulation.md §8).
//!
//! `megas validate` runs it and writes a page of it; `cargo test -p megas-validation` asserts it.

pub mod air;
pub mod cost;
pub mod coupled;
pub mod elastic;
mod figure;
pub mod flows;
pub mod heat;
pub mod mechanics;
pub mod melting;
pub mod outcome;
pub mod page;
pub mod robustness;
pub mod rotation;
pub mod run;
pub mod sheets;
pub mod slumps;
pub mod splats;
mod text;
pub mod timing;
pub mod transfers;

pub use outcome::{Curve, Outcome, Plot, Row};
pub use run::{Finished, Results};

/// How long a case takes on two cores.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, serde::Serialize)]
pub enum Tier {
    /// Under 5 s.
    A,
    /// Under 60 s.
    B,
    /// Longer.
    C,
}

/// One validation case. Its texts may hold `x_{i}` and `x^{i}` for subscripts and superscripts.
///
/// ```ignore
/// Case::new("V06", "half space behind a wall of fixed temperature", Tier::A, half_space)
///     .proves("position of the wall, diffusivity")
///     .setup("128 cells, T_{w} = 1 from t = 0 on, K = 0.1, 4000 steps")
///     .formula("T = erfc(x / √(4αt))")
/// ```
#[derive(Clone, Copy)]
pub struct Case {
    /// `V01` …
    pub id: &'static str,
    /// What is simulated, in a few words.
    pub name: &'static str,
    /// Cost.
    pub tier: Tier,
    /// Runs it.
    pub run: fn() -> Outcome,
    /// What a pass shows about the simulator.
    pub proves: &'static str,
    /// Geometry, grid, parameters.
    pub setup: &'static str,
    /// The reference: a formula, or where the published value comes from.
    pub formula: &'static str,
}

impl Case {
    /// A case; add its texts for the page with the methods below.
    pub const fn new(id: &'static str, name: &'static str, tier: Tier, run: fn() -> Outcome) -> Self {
        Self { id, name, tier, run, proves: "", setup: "", formula: "" }
    }

    /// Says what a pass shows about the simulator.
    #[must_use]
    pub const fn proves(mut self, text: &'static str) -> Self {
        self.proves = text;
        self
    }

    /// Describes geometry, grid and parameters.
    #[must_use]
    pub const fn setup(mut self, text: &'static str) -> Self {
        self.setup = text;
        self
    }

    /// Gives the reference.
    #[must_use]
    pub const fn formula(mut self, text: &'static str) -> Self {
        self.formula = text;
        self
    }
}

/// Every case, by id.
pub fn cases() -> Vec<Case> {
    let mut all: Vec<Case> = [
        transfers::CASES,
        air::CASES,
        heat::CASES,
        mechanics::CASES,
        sheets::CASES,
        rotation::CASES,
        elastic::CASES,
        flows::CASES,
        slumps::CASES,
        coupled::CASES,
        melting::CASES,
        splats::CASES,
        robustness::CASES,
        cost::CASES,
    ]
    .concat();
    all.sort_by_key(|c| c.id);
    all
}

/// Runs every case of an id and panics with the failing rows; for tests. One test per id is enough, also where cases of
/// several modules share it.
pub fn assert_case(id: &str) {
    let mut found = false;
    for case in cases().iter().filter(|c| c.id == id) {
        found = true;
        for row in (case.run)().rows {
            assert!(
                row.passed(),
                "{id} {}: {} is {:e}, expected {:e} ± {:e}",
                case.name,
                row.quantity,
                row.ours,
                row.reference,
                row.tolerance
            );
        }
    }
    assert!(found, "no case {id}");
}
