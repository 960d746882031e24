//! Parameters as functions of temperature (simulation.md §5.4): short tables, linear or log-linear in between.

use serde::{Deserialize, Serialize};

/// Most entries of a table.
pub const MAX_ENTRIES: usize = 8;

/// Values over temperature, constant outside; without entries it says nothing and the plain parameter holds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Table {
    entries: [[f64; 2]; MAX_ENTRIES],
    len: usize,
    /// Interpolate the logarithm; every value is then positive.
    log: bool,
}

/// A table that cannot be used.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum TableError {
    /// Too many entries.
    #[error("{0} entries; at most {MAX_ENTRIES} are read")]
    TooMany(usize),
    /// Temperatures not ascending.
    #[error("temperatures must ascend from entry to entry")]
    Order,
    /// A value that is negative, not a number, or zero where logarithms are taken.
    #[error("the value {0} is not allowed here; it must be a positive number")]
    Value(f64),
}

impl Table {
    /// Piecewise linear through `(T [K], value ≥ 0)`.
    pub fn linear(entries: &[[f64; 2]]) -> Result<Self, TableError> {
        Self::new(entries, false)
    }

    /// Piecewise linear in the logarithm through `(T [K], value > 0)`.
    pub fn log_linear(entries: &[[f64; 2]]) -> Result<Self, TableError> {
        Self::new(entries, true)
    }

    fn new(entries: &[[f64; 2]], log: bool) -> Result<Self, TableError> {
        if entries.len() > MAX_ENTRIES {
            return Err(TableError::TooMany(entries.len()));
        }
        if !entries.iter().all(|e| e[0].is_finite()) || entries.windows(2).any(|w| w[0][0] >= w[1][0]) {
            return Err(TableError::Order);
        }
        if let Some(e) = entries.iter().find(|e| !e[1].is_finite() || e[1] < 0.0 || log && e[1] == 0.0) {
            return Err(TableError::Value(e[1]));
        }
        let mut table = Self { len: entries.len(), log, ..Self::default() };
        for (to, from) in table.entries.iter_mut().zip(entries) {
            *to = [from[0], if log { from[1].ln() } else { from[1] }];
        }
        Ok(table)
    }

    /// True without entries.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Value at `t` \[K\]; `None` without entries.
    #[inline]
    pub fn at(&self, t: f64) -> Option<f64> {
        let e = &self.entries[..self.len];
        let (first, last) = (e.first()?, e.last()?);
        let raw = if t <= first[0] {
            first[1]
        } else if t >= last[0] {
            last[1]
        } else {
            let k = e.iter().position(|x| x[0] > t)?;
            let (a, b) = (e[k - 1], e[k]);
            a[1] + (t - a[0]) / (b[0] - a[0]) * (b[1] - a[1])
        };
        Some(if self.log { raw.exp() } else { raw })
    }

    /// Smallest and largest value; `None` without entries.
    pub fn range(&self) -> Option<(f64, f64)> {
        let e = &self.entries[..self.len];
        let value = |v: f64| if self.log { v.exp() } else { v };
        let least = e.iter().map(|x| x[1]).reduce(f64::min)?;
        let most = e.iter().map(|x| x[1]).reduce(f64::max)?;
        Some((value(least), value(most)))
    }
}

/// The parameters of a material that may follow temperature.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Tables {
    /// Shear modulus of the solid as a share of its cold value; in place of softening. The bulk modulus stays (simulation.md §5.3).
    pub stiffness: Table,
    /// Yield stress of the solid as a share of its plain value.
    pub solid_yield: Table,
    /// Yield stress τ_0 of the melt \[Pa\].
    pub melt_yield: Table,
    /// Consistency κ of the melt \[Pa·sⁿ\]; in place of Arrhenius.
    pub melt_consistency: Table,
    /// Conductivity \[W/(m·K)\] of solid and melt alike.
    pub conductivity: Table,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tables_interpolate_and_hold_their_ends() {
        let t = Table::linear(&[[300.0, 1.0], [320.0, 0.5], [330.0, 0.1]]).unwrap();
        assert_eq!([200.0, 310.0, 320.0, 325.0, 400.0].map(|x| t.at(x).unwrap()), [1.0, 0.75, 0.5, 0.3, 0.1]);
        let t = Table::log_linear(&[[300.0, 100.0], [320.0, 1.0]]).unwrap();
        assert!((t.at(310.0).unwrap() - 10.0).abs() < 1e-12);
        assert_eq!(Table::default().at(300.0), None);
        let (a, b) = t.range().unwrap();
        assert!((a - 1.0).abs() < 1e-12 && (b - 100.0).abs() < 1e-9);
    }

    #[test]
    fn bad_tables_are_refused() {
        assert_eq!(Table::linear(&[[300.0, 1.0], [300.0, 2.0]]), Err(TableError::Order));
        assert_eq!(Table::log_linear(&[[300.0, 0.0]]), Err(TableError::Value(0.0)));
        assert_eq!(Table::linear(&[[0.0, 1.0]; 9]), Err(TableError::TooMany(9)));
    }
}
