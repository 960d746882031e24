//! The physics suite: every case compares the simulator with an analytic or published reference (simulation.md §8).
//!
//! `cargo run --release -p megas-validation` prints the table; `cargo test -p megas-validation` asserts it.

pub mod coupled;
pub mod heat;
pub mod mechanics;
pub mod transfers;

/// One compared number.
#[derive(Clone, Debug, serde::Serialize)]
pub struct Row {
    /// What is compared, with its unit.
    pub quantity: String,
    /// Analytic or published value.
    pub reference: f64,
    /// What the simulator gives.
    pub ours: f64,
    /// Largest accepted |ours − reference|.
    pub tolerance: f64,
}

impl Row {
    /// A row with an absolute tolerance.
    pub fn new(quantity: impl Into<String>, reference: f64, ours: f64, tolerance: f64) -> Self {
        Self { quantity: quantity.into(), reference, ours, tolerance }
    }

    /// A row whose tolerance is a fraction of the reference.
    pub fn relative(quantity: impl Into<String>, reference: f64, ours: f64, fraction: f64) -> Self {
        Self::new(quantity, reference, ours, reference.abs() * fraction)
    }

    /// True when inside the tolerance; false for anything that is not a number.
    pub fn passed(&self) -> bool {
        (self.ours - self.reference).abs() <= self.tolerance
    }
}

/// What a case gives: the compared numbers, and curves that show a person why.
#[derive(Clone, Debug, Default, serde::Serialize)]
pub struct Outcome {
    /// The compared numbers.
    pub rows: Vec<Row>,
    /// Profiles and histories against their references.
    pub plots: Vec<Plot>,
}

impl From<Vec<Row>> for Outcome {
    fn from(rows: Vec<Row>) -> Self {
        Self { rows, plots: Vec::new() }
    }
}

/// A figure of one case.
#[derive(Clone, Debug, serde::Serialize)]
pub struct Plot {
    /// What it shows.
    pub title: String,
    /// Quantity and unit of the horizontal axis.
    pub x: String,
    /// Quantity and unit of the vertical axis.
    pub y: String,
    /// Drawn in order, references first.
    pub curves: Vec<Curve>,
}

/// One curve of a [`Plot`].
#[derive(Clone, Debug, serde::Serialize)]
pub struct Curve {
    /// Name in the legend.
    pub label: String,
    /// True for the analytic or published values, which are drawn as a line; ours are drawn as points.
    pub reference: bool,
    /// Abscissa and ordinate.
    pub points: Vec<[f64; 2]>,
}

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

/// One validation case.
#[derive(Clone, Copy)]
pub struct Case {
    /// `V01` …
    pub id: &'static str,
    /// What it proves, in a few words.
    pub name: &'static str,
    /// Cost.
    pub tier: Tier,
    /// Runs it.
    pub run: fn() -> Outcome,
}

/// Every case, by id.
pub fn cases() -> Vec<Case> {
    let mut all: Vec<Case> = [transfers::CASES, heat::CASES, mechanics::CASES, coupled::CASES].concat();
    all.sort_by_key(|c| c.id);
    all
}

/// Runs one case by id and panics with the failing rows; for tests.
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
