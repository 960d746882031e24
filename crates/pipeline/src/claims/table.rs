//! The tables of the claims.

use std::fmt::Write;

use megas_metrics::deform::{Carry, Deformation};
use serde_json::{Map, Value, json};

use super::coherence::{self, Look};
use super::measure::states;
use super::methods::Contender;
use crate::seeds;
use crate::study::Check;

/// In a cell without a figure.
const NOTHING: &str = "–";
/// Where a model's mesh is judged.
const MESH: &str = "/meshes/skin/chamfer";

/// Figures of every method on an object; several where there are several trainings.
#[derive(Clone, Debug, Default)]
pub struct Results {
    /// Name of the object.
    pub name: String,
    /// Methods with the figures of each seed.
    pub rows: Vec<(Contender, Vec<Value>)>,
}

impl Results {
    /// The number at a JSON pointer, of every seed that has it.
    fn values(&self, m: Contender, pointer: &str) -> Vec<f64> {
        let runs = self.rows.iter().filter(|r| r.0 == m).flat_map(|r| &r.1);
        runs.filter_map(|f| f.pointer(pointer)?.as_f64()).collect()
    }

    /// Mean over the seeds of the number at a JSON pointer.
    pub fn mean(&self, m: Contender, pointer: &str) -> Option<f64> {
        seeds::mean(&self.values(m, pointer))
    }

    fn deformed(&self, m: Contender, d: Deformation, mode: Carry, rest: &str) -> Option<f64> {
        self.mean(m, &format!("/deformed/{}/{}/{rest}", d.id(), mode.name()))
    }

    /// A figure of M6 with elastic-like gradients.
    pub fn cracks(&self, m: Contender, d: Deformation, what: &str) -> Option<f64> {
        self.deformed(m, d, Carry::ElasticLike, &format!("cracks/{what}"))
    }

    /// PSNR of M7 with elastic-like gradients \[dB\].
    pub fn psnr(&self, m: Contender, d: Deformation) -> Option<f64> {
        self.deformed(m, d, Carry::ElasticLike, "fidelity/picture/psnr")
    }

    /// A figure of M8.
    pub fn filling(&self, m: Contender, what: &str) -> Option<f64> {
        self.mean(m, &format!("/filling/{what}"))
    }

    /// The figures as Markdown.
    pub fn to_markdown(&self, checks: &[Check], settings: &Value) -> String {
        let mut out = format!("# Claims on {}\n\n", self.name);
        let _ = writeln!(out, "Settings: `{settings}`\n");
        out.push_str("## Models (M1–M5)\n\n");
        let columns: [(&str, &str, fn(f64) -> String); 10] = [
            ("PSNR", "/psnr", two),
            ("SSIM", "/ssim", four),
            ("FLIP", "/flip", four),
            ("Gaussians", "/gaussians", whole),
            ("S¹/S² p99", "/splats/needles/plain/p99", two),
            ("> 2a", "/splats/needles/plain/above_2_a", percent),
            ("F(0.02 L)", "/splats/floaters/opacity/1", percent),
            ("area CV", "/splats/consistency/area/cv", three),
            ("spacing CV", "/splats/uniformity/spacing_cv", three),
            ("gap", "/splats/uniformity/largest_gap", two),
        ];
        self.section(&mut out, &columns.map(|(name, pointer, show)| (name.to_owned(), pointer.to_owned(), show)));
        for mode in Carry::ALL {
            let any = self.rows.iter().any(|r| self.deformed(r.0, Deformation::Slump, mode, "drawn").is_some());
            if !any {
                continue;
            }
            let kinds: [(&str, &str, fn(f64) -> String); 8] = [
                ("Crack fraction (M6)", "cracks/crack_fraction", percent),
                ("Of it, where a nearer part of the model sticks out over the true surface", "cracks/overlapped", percent),
                ("Crack fraction off occluding contours", "cracks/off_contours", percent),
                ("Front deficit (M6)", "cracks/front_deficit", percent),
                ("Spill (M6) in parts per million", "cracks/spill", millionths),
                ("PSNR in dB (M7)", "fidelity/picture/psnr", two),
                ("PSNR inside the silhouette in dB (M7)", "fidelity/psnr_inside", two),
                ("S¹/S² p99 (M2b)", "needle_p99", two),
            ];
            for (title, rest, show) in kinds {
                let _ = writeln!(out, "## {title}, {}\n", mode.name());
                let at = |d: Deformation| {
                    // At rest there is one mode.
                    let mode = if d == Deformation::Rest { Carry::ElasticLike } else { mode };
                    (
                        format!("{} {}", d.id(), d.name()).replace("rest rest", "rest"),
                        format!("/deformed/{}/{}/{rest}", d.id(), mode.name()),
                        show,
                    )
                };
                self.section(&mut out, &states().map(at).collect::<Vec<_>>());
            }
        }
        out.push_str("## Filling (M8)\n\n");
        let columns: [(&str, &str, fn(f64) -> String); 7] = [
            ("IoU", "iou", three),
            ("hollow", "hollow", percent),
            ("false fill", "false_fill", percent),
            ("count CV", "count_cv", three),
            ("largest gap / Δ", "largest_gap", two),
            ("volume error", "volume_error", percent),
            ("particles", "particles", whole),
        ];
        self.section(&mut out, &columns.map(|(name, key, show)| (name.to_owned(), format!("/filling/{key}"), show)));
        if let (Some(iou), Some(hollow)) =
            (self.mean(Contender::B0, "/filling_by_rays/iou"), self.mean(Contender::B0, "/filling_by_rays/hollow"))
        {
            let _ = writeln!(out, "B0 filled by rays: IoU {iou:.3}, hollow {}.\n", percent(hollow));
        }
        self.meshes(&mut out);
        self.films(&mut out);
        out.push_str("## Orderings\n\n| claim | holds | numbers |\n| --- | --- | --- |\n");
        for c in checks {
            let _ = writeln!(out, "| {} | {} | {} |", c.claim, if c.holds { "yes" } else { "**no**" }, c.numbers);
        }
        out
    }

    fn section(&self, out: &mut String, columns: &[(String, String, fn(f64) -> String)]) {
        let names: Vec<&str> = columns.iter().map(|c| c.0.as_str()).collect();
        let _ = writeln!(out, "| method | {} |\n| --- |{}", names.join(" | "), " ---: |".repeat(columns.len()));
        for (m, runs) in &self.rows {
            let cell = |pointer: &str, show: fn(f64) -> String| {
                let values = self.values(*m, pointer);
                let Some(mean) = seeds::mean(&values) else { return NOTHING.to_owned() };
                seeds::deviation(&values).map_or_else(|| show(mean), |d| format!("{} ± {}", show(mean), show(d)))
            };
            let cells: Vec<String> = columns.iter().map(|(_, pointer, show)| cell(pointer, *show)).collect();
            let seeds = if runs.len() > 1 { format!(" × {}", runs.len()) } else { String::new() };
            let _ = writeln!(out, "| {} {}{seeds} | {} |", m.id(), m.name(), cells.join(" | "));
        }
        out.push('\n');
    }

    /// Meshes of the models that have them.
    fn meshes(&self, out: &mut String) {
        let kinds = [("skin", "shaped by the splats, closed by the particles"), ("particles", "particles alone")];
        let columns: [(&str, &str, fn(f64) -> String); 10] = [
            ("Chamfer / L", "chamfer", percent),
            ("of what is photographed", "seen/chamfer", percent),
            ("its p95", "seen/p95", percent),
            ("outward", "seen/outward", percent),
            ("p95 / L", "p95", percent),
            ("Hausdorff / L", "hausdorff", percent),
            ("normals, mean °", "normal_mean_deg", two),
            ("volume error", "volume_error", percent),
            ("roughness, rad/L", "roughness", one),
            ("triangles", "triangles", whole),
        ];
        let with_meshes: Vec<&(Contender, Vec<Value>)> = self.rows.iter().filter(|r| self.mean(r.0, MESH).is_some()).collect();
        if with_meshes.is_empty() {
            return;
        }
        let names = columns.map(|c| c.0).join(" | ");
        let _ =
            writeln!(out, "## Meshes at rest (M10)\n\n| mesh | {names} | watertight |\n| --- |{} --- |", " ---: |".repeat(columns.len()));
        for (m, runs) in with_meshes {
            for (kind, words) in kinds {
                let at = |key: &str| format!("/meshes/{kind}/{key}");
                let cells = columns.map(|(_, key, show)| self.mean(*m, &at(key)).map_or(NOTHING.to_owned(), show));
                let closed = runs.iter().filter_map(|f| f.pointer(&at("watertight"))?.as_bool()).all(|w| w);
                let _ = writeln!(out, "| {}, {words} | {} | {} |", m.id(), cells.join(" | "), if closed { "yes" } else { "**no**" });
            }
        }
        out.push('\n');
    }

    /// Films of deformations, where they were made.
    fn films(&self, out: &mut String) {
        let columns: [(&str, &str, fn(f64) -> String); 6] = [
            ("second difference", "second_difference", thousandths),
            ("of what differs from the truth", "beyond_truth", thousandths),
            ("the same of normals", "normals_beyond_truth", thousandths),
            ("Chamfer of a step / L", "chamfer", hundredths_of_percent),
            ("p95 / L", "p95", hundredths_of_percent),
            ("normals, °", "normal_deg", two),
        ];
        let rows: Vec<(&str, &str)> = Look::ALL.iter().map(|l| l.names()).chain([(coherence::TRUTH, "the truth")]).collect();
        for d in coherence::FILMS {
            let at = |row: &str, key: &str| self.mean(Contender::B6, &format!("/coherence/{}/{row}/{key}", d.id()));
            if at(rows[0].0, columns[0].1).is_none() {
                continue;
            }
            let names = columns.map(|c| c.0).join(" | ");
            let title = format!("Unrest of a film of {} (M11), pictures in thousandths", d.id());
            let _ = writeln!(out, "## {title}\n\n| drawn | {names} |\n| --- |{}", " ---: |".repeat(columns.len()));
            for (row, words) in &rows {
                let cells = columns.map(|(_, key, show)| at(row, key).map_or(NOTHING.to_owned(), show));
                let _ = writeln!(out, "| {words} | {} |", cells.join(" | "));
            }
            out.push('\n');
        }
    }

    /// The figures for machines: per method means of M1–M8.
    pub fn to_json(&self) -> Value {
        let methods: Map<String, Value> = self.rows.iter().map(|(m, runs)| (m.id().to_owned(), self.summary(*m, runs.len()))).collect();
        Value::Object(methods)
    }

    fn summary(&self, m: Contender, seeds: usize) -> Value {
        let per = |rest: &str| -> Map<String, Value> {
            states().map(|d| (d.id().to_owned(), json!(self.deformed(m, d, Carry::ElasticLike, rest)))).collect()
        };
        json!({
            "name": m.name(),
            "seeds": seeds,
            "m1": { "psnr": self.mean(m, "/psnr"), "ssim": self.mean(m, "/ssim"), "flip": self.mean(m, "/flip") },
            "m2": { "p99": self.mean(m, "/splats/needles/plain/p99"), "above_2a": self.mean(m, "/splats/needles/plain/above_2_a") },
            "m2b_p99": per("needle_p99"),
            "m3": { "f_0.02": self.mean(m, "/splats/floaters/opacity/1") },
            "m4": { "area_cv": self.mean(m, "/splats/consistency/area/cv") },
            "m5": {
                "spacing_cv": self.mean(m, "/splats/uniformity/spacing_cv"),
                "largest_gap": self.mean(m, "/splats/uniformity/largest_gap"),
            },
            "m6_crack_fraction": per("cracks/crack_fraction"),
            "m6_overlapped": per("cracks/overlapped"),
            "m6_off_contours": per("cracks/off_contours"),
            "m6_front_deficit": per("cracks/front_deficit"),
            "m6_spill": per("cracks/spill"),
            "m7_psnr": per("fidelity/picture/psnr"),
            "m7_psnr_inside": per("fidelity/psnr_inside"),
            "m8": {
                "iou": self.filling(m, "iou"), "hollow": self.filling(m, "hollow"), "false_fill": self.filling(m, "false_fill"),
                "volume_error": self.filling(m, "volume_error"),
            },
            "m11": self.rows.iter().find(|r| r.0 == m).and_then(|r| r.1.first()).map(|f| f["coherence"].clone()),
            "m10_chamfer": self.mean(m, MESH),
            "m10_chamfer_photographed": self.mean(m, "/meshes/skin/seen/chamfer"),
        })
    }
}

fn one(x: f64) -> String {
    format!("{x:.1}")
}

fn two(x: f64) -> String {
    format!("{x:.2}")
}

fn three(x: f64) -> String {
    format!("{x:.3}")
}

fn thousandths(x: f64) -> String {
    two(1e3 * x)
}

fn hundredths_of_percent(x: f64) -> String {
    format!("{:.4} %", 100.0 * x)
}

fn four(x: f64) -> String {
    format!("{x:.4}")
}

fn whole(x: f64) -> String {
    format!("{x:.0}")
}

fn millionths(x: f64) -> String {
    format!("{:.1}", 1e6 * x)
}

pub fn percent(x: f64) -> String {
    // An empty sum of floats is −0.
    format!("{:.2} %", 100.0 * x + 0.0)
}

#[cfg(test)]
mod tests {
    use super::super::orderings::checks;
    use super::*;

    fn figures(psnr: f64, cracks: f64, hollow: f64) -> Value {
        let one = json!({ "elastic-like": { "cracks": { "crack_fraction": cracks, "spill": cracks }, "drawn": 5,
            "fidelity": { "picture": { "psnr": psnr } } } });
        let deformed: Map<String, Value> = states().map(|d| (d.id().to_owned(), one.clone())).collect();
        json!({ "psnr": 33.0, "deformed": deformed, "filling": { "iou": 1.0 - hollow, "hollow": hollow } })
    }

    #[test]
    fn orderings_are_judged_on_means() {
        let mut r = Results {
            name: "cup".into(),
            rows: vec![
                (Contender::B0, vec![figures(20.0, 0.2, 0.9), figures(22.0, 0.4, 0.9)]),
                (Contender::B5, vec![figures(26.0, 0.08, 0.01)]),
                (Contender::B6, vec![figures(27.0, 0.004, 0.01)]),
                (Contender::A1, vec![figures(26.0, 0.08, 0.95)]),
            ],
        };
        assert_eq!(r.mean(Contender::B0, "/deformed/D3/elastic-like/cracks/crack_fraction"), Some(0.30000000000000004));
        let all = checks(&r);
        assert!(all.len() >= 18 && all.iter().all(|c| c.holds), "{all:#?}");
        r.rows[2].1[0] = figures(23.5, 0.03, 0.01);
        let failed: Vec<String> = checks(&r).iter().filter(|c| !c.holds).map(Check::line).collect();
        assert!(failed.iter().any(|l| l.contains("D3 cracks: B6 at most 1.00 % fails: 3.00 %")), "{failed:?}");
        assert!(failed.iter().any(|l| l.contains("a quarter of B5")) && failed.iter().any(|l| l.contains("B0 + 3 dB")), "{failed:?}");
        let text = r.to_markdown(&all, &json!({}));
        assert!(text.contains("| B0 vanilla × 2 |") && text.contains("30.00 % ± 14.14 %"), "{text}");
        assert!(!text.contains("## Meshes"), "{text}");
        r.rows[1].1[0]["meshes"] =
            json!({ "skin": { "chamfer": 0.002, "watertight": true }, "particles": { "chamfer": 0.004, "watertight": false } });
        let text = r.to_markdown(&checks(&r), &json!({}));
        assert!(text.contains("the particles | 0.20 % |") && text.contains("| **no** |"), "{text}");
        assert_eq!(r.to_json()["B6"]["m6_crack_fraction"]["D5"], json!(0.03));
        let look = |unrest: f64| json!({ "second_difference": 0.009, "beyond_truth": unrest, "normals_beyond_truth": 2.0 * unrest });
        r.rows[2].1[0]["coherence"] = json!({ "D3": { "splats": look(0.002), "skin_mesh": look(0.001), "density_mesh": look(0.0019) } });
        let text = r.to_markdown(&checks(&r), &json!({}));
        assert!(text.contains("| mesh, shaped by the splats | 9.00 | 1.00 | 2.00 | – |"), "{text}");
        assert!(
            text.contains("| D3 film, unrest of pictures: mesh, shaped by the splats at most half of the density's mesh | **no** | 1.00, 1.90 thousandths |"),
            "{text}"
        );
    }
}
