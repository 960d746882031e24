//! The tables of a study.

use std::fmt::Write;

use megas_reconstruct::Method;
use serde_json::{Map, Value, json};

use super::claims::{Check, checks};
use crate::seeds;

/// A column of the table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Measure {
    /// M1 \[dB\].
    Psnr,
    /// M1.
    Ssim,
    /// M1.
    Flip,
    /// Number of Gaussians.
    Gaussians,
    /// M2: 99th percentile of `S¹/S²`.
    NeedleP99,
    /// M2: fraction above 2a.
    AboveTwoA,
    /// M3: F(0.02 L).
    Floaters,
    /// M3 without a surface: fraction that no training view shows with a weight of 0.1.
    Hidden,
    /// M4: coefficient of variation of `S¹S²`.
    AreaCv,
    /// M5: coefficient of variation of the distance to the nearest mean.
    SpacingCv,
    /// M5: largest empty disc in median spacings.
    Gap,
    /// Wall time of the training \[s\].
    Seconds,
    /// Processor time of the training \[s\].
    CoreSeconds,
}

impl Measure {
    /// All columns in their order.
    pub const ALL: [Self; 13] = [
        Self::Psnr,
        Self::Ssim,
        Self::Flip,
        Self::Gaussians,
        Self::NeedleP99,
        Self::AboveTwoA,
        Self::Floaters,
        Self::Hidden,
        Self::AreaCv,
        Self::SpacingCv,
        Self::Gap,
        Self::Seconds,
        Self::CoreSeconds,
    ];

    /// Heading.
    pub fn name(self) -> &'static str {
        match self {
            Self::Psnr => "PSNR",
            Self::Ssim => "SSIM",
            Self::Flip => "FLIP",
            Self::Gaussians => "Gaussians",
            Self::NeedleP99 => "S¹/S² p99",
            Self::AboveTwoA => "S¹/S² > 2a",
            Self::Floaters => "F(0.02 L)",
            Self::Hidden => "hidden",
            Self::AreaCv => "area CV",
            Self::SpacingCv => "spacing CV",
            Self::Gap => "largest gap",
            Self::Seconds => "s",
            Self::CoreSeconds => "core-s",
        }
    }

    /// Key in `table.json`.
    fn key(self) -> &'static str {
        match self {
            Self::Psnr => "psnr",
            Self::Ssim => "ssim",
            Self::Flip => "flip",
            Self::Gaussians => "gaussians",
            Self::NeedleP99 => "needle_p99",
            Self::AboveTwoA => "needle_above_2a",
            Self::Floaters => "floaters",
            Self::Hidden => "internal_fraction",
            Self::AreaCv => "area_cv",
            Self::SpacingCv => "spacing_cv",
            Self::Gap => "largest_gap",
            Self::Seconds => "seconds",
            Self::CoreSeconds => "core_seconds",
        }
    }

    /// The value in the figures of a reconstruction.
    fn of(self, figures: &Value) -> Option<f64> {
        let measures = &figures["measures"];
        match self {
            Self::AboveTwoA => measures["needles"]["plain"]["above_2_a"].as_f64(),
            Self::SpacingCv => measures["uniformity"]["spacing_cv"].as_f64(),
            Self::Gap => measures["uniformity"]["largest_gap"].as_f64(),
            other => figures[other.key()].as_f64(),
        }
    }

    /// The value with the digits that mean something.
    pub fn show(self, v: f64) -> String {
        match self {
            Self::Psnr | Self::NeedleP99 => format!("{v:.2}"),
            Self::Ssim | Self::Flip => format!("{v:.4}"),
            Self::Gaussians | Self::Seconds | Self::CoreSeconds => format!("{v:.0}"),
            Self::AboveTwoA | Self::Floaters | Self::Hidden => format!("{:.2} %", 100.0 * v.abs()),
            Self::AreaCv | Self::SpacingCv => format!("{v:.3}"),
            Self::Gap => format!("{v:.1}"),
        }
    }
}

/// The trainings of one method.
#[derive(Clone, Debug)]
pub struct Row {
    /// Method.
    pub method: Method,
    /// Figures of every seed.
    pub runs: Vec<Value>,
}

impl Row {
    fn values(&self, measure: Measure) -> Vec<f64> {
        self.runs.iter().filter_map(|f| measure.of(f)).collect()
    }

    fn mean(&self, measure: Measure) -> Option<f64> {
        seeds::mean(&self.values(measure))
    }

    fn deviation(&self, measure: Measure) -> Option<f64> {
        seeds::deviation(&self.values(measure))
    }
}

/// The trainings on one capture.
#[derive(Clone, Debug)]
pub struct Asset {
    /// Name.
    pub name: String,
    /// Methods.
    pub rows: Vec<Row>,
}

impl Asset {
    /// Mean of a measure over the seeds of a method.
    pub fn mean(&self, method: Method, measure: Measure) -> Option<f64> {
        self.rows.iter().find(|r| r.method == method)?.mean(measure)
    }
}

/// Means, deviations, every training and the orderings.
pub fn to_json(assets: &[Asset]) -> Value {
    let figures = |row: &Row, f: fn(&Row, Measure) -> Option<f64>| -> Map<String, Value> {
        Measure::ALL.iter().filter_map(|m| Some((m.key().to_owned(), json!(f(row, *m)?)))).collect()
    };
    let row = |r: &Row| json!({ "method": r.method.name(), "seeds": r.runs.len(), "mean": figures(r, Row::mean), "deviation": figures(r, Row::deviation), "runs": r.runs });
    let asset = |a: &Asset| json!({ "name": a.name, "methods": a.rows.iter().map(row).collect::<Vec<_>>(), "orderings": checks(a) });
    json!({ "assets": assets.iter().map(asset).collect::<Vec<_>>() })
}

/// The same for people.
pub fn to_markdown(assets: &[Asset], settings: &Value) -> String {
    let mut text = String::from("# Reconstruction: methods compared\n\n");
    let n = |key: &str| settings[key].as_u64().unwrap_or_default();
    let _ = writeln!(
        text,
        "Profile `{}`, {} iterations; {} of {} trainings done. Means over the seeds (± their deviation); a = 2. PSNR, SSIM and FLIP on \
         held-out views, transparent ones over white; F(0.02 L) against the true surface where there is one; hidden: largest blend weight \
         below 0.1 in every training view.",
        settings["profile"].as_str().unwrap_or_default(),
        n("iterations"),
        n("trainings_done"),
        n("trainings_planned"),
    );
    for asset in assets {
        let shown: Vec<Measure> = Measure::ALL.into_iter().filter(|m| asset.rows.iter().any(|r| r.mean(*m).is_some())).collect();
        let headings: Vec<&str> = shown.iter().map(|m| m.name()).collect();
        let _ = writeln!(text, "\n## {}\n\n| method | seeds | {} |", asset.name, headings.join(" | "));
        let _ = writeln!(text, "| --- | ---: |{}", " ---: |".repeat(shown.len()));
        for row in &asset.rows {
            let cell = |m: &Measure| match (row.mean(*m), row.deviation(*m)) {
                (Some(mean), Some(d)) if *m == Measure::Psnr => format!("{} ± {}", m.show(mean), m.show(d)),
                (Some(mean), _) => m.show(mean),
                (None, _) => "–".into(),
            };
            let cells: Vec<String> = shown.iter().map(cell).collect();
            let _ = writeln!(text, "| {} | {} | {} |", row.method.name(), row.runs.len(), cells.join(" | "));
        }
        let all = checks(asset);
        if !all.is_empty() {
            text.push_str("\n| expected | outcome | numbers |\n| --- | --- | --- |\n");
            all.iter().for_each(|c| line(&mut text, c));
        }
    }
    text
}

fn line(text: &mut String, c: &Check) {
    let _ = writeln!(text, "| {} | {} | {} |", c.claim, if c.holds { "holds" } else { "**fails**" }, c.numbers);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_table_has_means_over_seeds_and_no_empty_columns() {
        let run = |psnr: f64| json!({ "psnr": psnr, "gaussians": 1000, "measures": { "uniformity": { "spacing_cv": 0.25 } } });
        let rows = vec![
            Row { method: Method::Vanilla, runs: vec![run(30.0), run(32.0)] },
            Row { method: Method::Ours, runs: vec![json!({ "psnr": 31.0, "gaussians": 1.5e3 })] },
        ];
        let assets = [Asset { name: "cup".into(), rows }];
        let settings = json!({ "profile": "tiny", "iterations": 1500, "trainings_done": 3, "trainings_planned": 3 });
        let text = to_markdown(&assets, &settings);
        assert!(text.contains("| method | seeds | PSNR | Gaussians | spacing CV |\n"), "{text}");
        assert!(text.contains("| vanilla | 2 | 31.00 ± 1.41 | 1000 | 0.250 |\n| ours | 1 | 31.00 | 1500 | – |\n"), "{text}");
        assert!(text.contains("| PSNR: ours loses at most 0.7 dB against vanilla | holds | ours 31.00, vanilla 31.00 |"), "{text}");
        let json = to_json(&assets);
        assert_eq!(json["assets"][0]["methods"][0]["mean"]["psnr"], 31.0);
        assert!(json["assets"][0]["methods"][1]["deviation"].as_object().is_some_and(Map::is_empty));
    }
}
