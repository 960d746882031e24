//! What a case gives: compared numbers, curves that show a person why, remarks.

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

    /// `ours − reference`.
    pub fn error(&self) -> f64 {
        self.ours - self.reference
    }

    /// True when inside the tolerance; false for anything that is not a number.
    pub fn passed(&self) -> bool {
        self.error().abs() <= self.tolerance
    }
}

/// What a case gives.
#[derive(Clone, Debug, Default, serde::Serialize)]
pub struct Outcome {
    /// The compared numbers.
    pub rows: Vec<Row>,
    /// Profiles and histories against their references.
    pub plots: Vec<Plot>,
    /// What a reader of the numbers has to know: known deviations and their cause, figures without a reference.
    pub notes: Vec<String>,
}

impl From<Vec<Row>> for Outcome {
    fn from(rows: Vec<Row>) -> Self {
        Self { rows, ..Self::default() }
    }
}

impl Outcome {
    /// Adds a figure.
    #[must_use]
    pub fn plot(mut self, plot: Plot) -> Self {
        self.plots.push(plot);
        self
    }

    /// Adds a remark.
    #[must_use]
    pub fn note(mut self, note: impl Into<String>) -> Self {
        self.notes.push(note.into());
        self
    }
}

/// A figure of one case.
#[derive(Clone, Debug, Default, serde::Serialize)]
pub struct Plot {
    /// What it shows.
    pub title: String,
    /// Quantity and unit of the horizontal axis.
    pub x: String,
    /// Quantity and unit of the vertical axis.
    pub y: String,
    /// Drawn in order, references first.
    pub curves: Vec<Curve>,
    /// Logarithmic axes, horizontal and vertical.
    pub log: [bool; 2],
    /// Same scale on both axes, for shapes.
    pub equal_axes: bool,
}

impl Plot {
    /// An empty figure.
    pub fn new(title: impl Into<String>, x: impl Into<String>, y: impl Into<String>) -> Self {
        Self { title: title.into(), x: x.into(), y: y.into(), ..Self::default() }
    }

    /// Adds the analytic or published values.
    #[must_use]
    pub fn reference(mut self, label: impl Into<String>, points: Vec<[f64; 2]>) -> Self {
        self.curves.push(Curve { label: label.into(), reference: true, points });
        self
    }

    /// Adds a function as reference, sampled evenly (in the logarithm on a logarithmic axis) between `from` and `to`.
    #[must_use]
    pub fn function(self, label: impl Into<String>, from: f64, to: f64, f: impl Fn(f64) -> f64) -> Self {
        const SAMPLES: usize = 160;
        let log = self.log[0];
        let at = |i: usize| {
            let t = i as f64 / SAMPLES as f64;
            if log { from * (to / from).powf(t) } else { from + t * (to - from) }
        };
        self.reference(label, (0..=SAMPLES).map(|i| [at(i), f(at(i))]).collect())
    }

    /// Adds what the simulator gives.
    #[must_use]
    pub fn ours(mut self, label: impl Into<String>, points: Vec<[f64; 2]>) -> Self {
        self.curves.push(Curve { label: label.into(), reference: false, points });
        self
    }

    /// Sets which axes are logarithmic, horizontal and vertical; call it before [`Plot::function`].
    #[must_use]
    pub fn log(mut self, x: bool, y: bool) -> Self {
        self.log = [x, y];
        self
    }

    /// Gives both axes the same scale.
    #[must_use]
    pub fn equal_axes(mut self) -> Self {
        self.equal_axes = true;
        self
    }
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
