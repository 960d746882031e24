//! The orderings that the paper claims, checked on the figures of a capture (splatting.md §9.4).

use megas_reconstruct::Method;
use serde::Serialize;

use super::table::{Asset, Measure};
use crate::reconstruct::ASPECT;

/// What a method may lose in PSNR against plain splatting, and how near the planar methods should be to each other \[dB\].
const PSNR_LOSS: f64 = 0.7;
const PSNR_NEAR: f64 = 0.5;
/// 99th percentile of the needles in units of `a`.
const NEEDLE_LIMIT: f64 = 1.2;
/// Share of floaters, and share of those of plain splatting.
const FLOATER_LIMIT: f64 = 0.005;
const FLOATER_SHARE: f64 = 0.1;
/// Coefficient of variation of the areas.
const AREA_LIMIT: f64 = 0.6;

/// One claim and what came out.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Check {
    /// Capture.
    pub asset: String,
    /// The claim, with its measure.
    pub claim: String,
    /// Whether it holds.
    pub holds: bool,
    /// The numbers it was judged by.
    pub numbers: String,
}

impl Check {
    /// The check on one line.
    pub fn line(&self) -> String {
        format!("{}: {} {}: {}", self.asset, self.claim, if self.holds { "holds" } else { "fails" }, self.numbers)
    }
}

/// All claims that can be judged with the methods at hand.
pub fn checks(asset: &Asset) -> Vec<Check> {
    use Method::{Ours, Pgsr, PgsrPrune, Physgaussian, Vanilla, Vrdoh};
    let c = Checker { asset };
    let floaters = if asset.mean(Ours, Measure::Floaters).is_some() { Measure::Floaters } else { Measure::Hidden };
    let limit = |m: Measure, most: f64| c.limit(m, most);
    let mut all: Vec<Check> = Vec::new();
    let judged = [
        c.compare(Measure::Psnr, Ours, Vanilla, &format!("PSNR: ours loses at most {PSNR_LOSS} dB against vanilla"), |a, b| {
            a >= b - PSNR_LOSS
        }),
        c.compare(Measure::Psnr, Pgsr, Vanilla, &format!("PSNR: pgsr within {PSNR_NEAR} dB of vanilla"), |a, b| (a - b).abs() <= PSNR_NEAR),
        c.compare(Measure::Psnr, Ours, Pgsr, &format!("PSNR: ours loses at most {PSNR_NEAR} dB against pgsr"), |a, b| a >= b - PSNR_NEAR),
        c.compare(Measure::Psnr, Ours, Vrdoh, "PSNR: ours at least vrdoh", |a, b| a >= b),
        c.compare(Measure::Psnr, Ours, Physgaussian, "PSNR: ours at least physgaussian", |a, b| a >= b),
        limit(Measure::NeedleP99, NEEDLE_LIMIT * ASPECT),
        c.chain(Measure::NeedleP99, &[Ours, Physgaussian, Vrdoh, Vanilla]),
        c.chain(Measure::NeedleP99, &[Ours, Pgsr, Vanilla]),
        c.chain(Measure::AboveTwoA, &[Ours, Vrdoh, Vanilla]),
        limit(floaters, FLOATER_LIMIT),
        c.compare(floaters, Ours, Vanilla, &format!("{}: ours at most a tenth of vanilla", floaters.name()), |a, b| a <= FLOATER_SHARE * b),
        c.chain(floaters, &[Ours, Pgsr, Vanilla]),
        c.chain(floaters, &[PgsrPrune, Pgsr]),
        limit(Measure::AreaCv, AREA_LIMIT),
        c.chain(Measure::AreaCv, &[Ours, Vrdoh, Physgaussian]),
        c.chain(Measure::AreaCv, &[Ours, Pgsr, Vanilla]),
    ];
    for check in judged.into_iter().flatten() {
        // Chains without their middle may say the same.
        if all.iter().all(|other| other.claim != check.claim) {
            all.push(check);
        }
    }
    all
}

struct Checker<'a> {
    asset: &'a Asset,
}

impl Checker<'_> {
    fn check(&self, claim: String, holds: bool, numbers: String) -> Option<Check> {
        Some(Check { asset: self.asset.name.clone(), claim, holds, numbers })
    }

    /// A relation of two methods.
    fn compare(&self, m: Measure, a: Method, b: Method, claim: &str, relation: impl Fn(f64, f64) -> bool) -> Option<Check> {
        let (x, y) = (self.asset.mean(a, m)?, self.asset.mean(b, m)?);
        let numbers = format!("{} {}, {} {}", a.name(), m.show(x), b.name(), m.show(y));
        self.check(claim.to_owned(), relation(x, y), numbers)
    }

    /// An upper limit for ours.
    fn limit(&self, m: Measure, most: f64) -> Option<Check> {
        let x = self.asset.mean(Method::Ours, m)?;
        self.check(format!("{}: ours at most {}", m.name(), m.show(most)), x <= most, m.show(x))
    }

    /// Smaller from each method that is there to the next.
    fn chain(&self, m: Measure, methods: &[Method]) -> Option<Check> {
        let values: Vec<(Method, f64)> = methods.iter().filter_map(|&k| Some((k, self.asset.mean(k, m)?))).collect();
        if values.len() < 2 {
            return None;
        }
        let names: Vec<&str> = values.iter().map(|v| v.0.name()).collect();
        let numbers: Vec<String> = values.iter().map(|v| m.show(v.1)).collect();
        let holds = values.windows(2).all(|w| w[0].1 < w[1].1);
        self.check(format!("{}: {}", m.name(), names.join(" < ")), holds, numbers.join(", "))
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::super::table::Row;
    use super::*;

    #[test]
    fn claims_are_judged_with_what_is_there() {
        let figures = |psnr: f64, p99: f64, floaters: f64, cv: f64| json!({ "psnr": psnr, "needle_p99": p99, "floaters": floaters, "area_cv": cv, "internal_fraction": 0.5 });
        let row = |method, runs| Row { method, runs };
        let mut asset = Asset {
            name: "cup".into(),
            rows: vec![
                row(Method::Vanilla, vec![figures(33.0, 8.0, 0.2, 2.0), figures(33.4, 8.0, 0.2, 2.0)]),
                row(Method::Ours, vec![figures(32.6, 2.0, 0.004, 0.5)]),
            ],
        };
        let all = checks(&asset);
        assert_eq!(all.len(), 8, "{all:?}");
        assert!(all.iter().all(|c| c.holds), "{all:?}");
        assert_eq!(all[0].numbers, "ours 32.60, vanilla 33.20");
        asset.rows[1].runs[0]["floaters"] = json!(0.03);
        let failed: Vec<String> = checks(&asset).iter().filter(|c| !c.holds).map(Check::line).collect();
        assert_eq!(failed.len(), 2);
        assert_eq!(failed[0], "cup: F(0.02 L): ours at most 0.50 % fails: 3.00 %");
        // Without a true surface the hidden ones stand in.
        asset.rows.iter_mut().flat_map(|r| &mut r.runs).for_each(|f| f["floaters"] = serde_json::Value::Null);
        assert!(checks(&asset).iter().any(|c| c.claim.starts_with("hidden: ours at most")));
        asset.rows.truncate(1);
        assert!(checks(&asset).is_empty());
    }
}
