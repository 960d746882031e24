//! Results for people: a short table out of a result object.

use std::fmt::Write;

use serde_json::Value;

/// Keys with a label and a unit of their own, in the order they are shown; anything else follows under its own name.
const KNOWN: &[(&str, &str)] = &[
    ("file", "file"),
    ("format", "format"),
    ("count", "Gaussians"),
    ("dropped", "rows dropped"),
    ("sh_degree", "SH degree"),
    ("bbox", "bounding box"),
    ("psnr", "PSNR"),
    ("ssim", "SSIM"),
    ("flip", "FLIP"),
    ("frames", "frames"),
    ("seconds", "time"),
    ("particles", "particles"),
    ("gaussians", "Gaussians"),
    ("acceleration", "heat runs"),
    ("thermal_acceleration", "heat runs"),
    ("energy_residual", "energy residual"),
    ("volume_change", "volume change"),
    ("repairs", "repairs"),
    ("films", "films"),
];

/// Units at the end of keys, longest first: the unit moves behind the number.
const UNITS: &[(&str, &str)] =
    &[("_m_s", " m/s"), ("_m3", " m³"), ("_w_m2", " W/m²"), ("_k", " K"), ("_c", " °C"), ("_m", " m"), ("_j", " J"), ("_w", " W")];

/// The table of a result. Figures within figures are details.
pub fn table(result: &Value, details: bool) -> String {
    let mut text = String::new();
    let Some(map) = result.as_object() else { return text };
    for (key, label) in KNOWN {
        if let Some(value) = map.get(*key) {
            row(&mut text, key, label, value, details);
        }
    }
    for (key, value) in map.iter().filter(|(key, _)| KNOWN.iter().all(|(k, _)| k != key)) {
        row(&mut text, key, &label_of(key), value, details);
    }
    text
}

/// A key as words, without its unit where that is shown with the number.
fn label_of(key: &str) -> String {
    let (stem, estimate) = key.strip_suffix("_estimate").map_or((key, ""), |s| (s, " (estimate)"));
    let units = UNITS.iter().map(|u| u.0).chain(["_s", "_mib", "_bytes"]);
    let stem = units.into_iter().find_map(|u| stem.strip_suffix(u)).unwrap_or(stem);
    format!("{}{estimate}", stem.replace('_', " "))
}

fn row(text: &mut String, key: &str, label: &str, value: &Value, details: bool) {
    let mut line = |shown: &str, first: bool| {
        let line = format!("{:<24} {shown}", if first { label } else { "" });
        let _ = writeln!(text, "{}", line.trim_end());
    };
    match value {
        Value::Null => {}
        Value::Object(map) if key == "bbox" || key.ends_with("_bbox") => {
            let corner = |c: &str| map.get(c).map(scalar_list).unwrap_or_default();
            line(&format!("{} to {}", corner("min"), corner("max")), true);
        }
        Value::Object(_) if !details => {}
        Value::Object(_) => line(&fields(value), true),
        Value::Array(items) if items.iter().any(Value::is_object) => {
            items.iter().enumerate().for_each(|(i, item)| line(&fields(item), i == 0));
        }
        Value::Array(items) if items.iter().any(Value::is_string) => {
            let words: Vec<&str> = items.iter().filter_map(Value::as_str).collect();
            let short = key != "films" && words.iter().map(|w| w.len() + 2).sum::<usize>() <= 60;
            match short {
                true => line(&words.join(", "), true),
                false => words.iter().enumerate().for_each(|(i, w)| line(w, i == 0)),
            }
        }
        Value::Array(items) if items.is_empty() => {}
        Value::Array(_) => line(&scalar_list(value), true),
        _ => line(&scalar(key, value), true),
    }
}

/// An object on one line.
fn fields(value: &Value) -> String {
    let one = |(key, value): (&String, &Value)| format!("{} {}", label_of(key), scalar(key, value));
    value.as_object().into_iter().flatten().map(one).collect::<Vec<_>>().join(", ")
}

fn scalar_list(value: &Value) -> String {
    let items: Vec<String> = value.as_array().into_iter().flatten().map(|v| scalar("", v)).collect();
    format!("[{}]", items.join(", "))
}

fn scalar(key: &str, value: &Value) -> String {
    let key = key.trim_end_matches("_estimate");
    match value {
        Value::String(s) => s.clone(),
        Value::Bool(b) => if *b { "yes" } else { "no" }.into(),
        Value::Number(n) => match (key, n.as_f64()) {
            (_, Some(v)) if UNITS.iter().any(|u| key.ends_with(u.0)) => {
                let unit = UNITS.iter().find(|u| key.ends_with(u.0)).map_or("", |u| u.1);
                format!("{}{unit}", number(v))
            }
            (_, Some(v)) if key.ends_with("seconds") || key.ends_with("_s") => duration(v),
            (_, Some(v)) if key.ends_with("bytes") => bytes(v),
            (_, Some(v)) if key.ends_with("_mib") => bytes(v * f64::from(1 << 20)),
            ("psnr", Some(v)) => format!("{v:.2} dB"),
            ("volume_change", Some(v)) => format!("{:+.3} %", 100.0 * v),
            ("acceleration" | "thermal_acceleration", Some(v)) => format!("{} times faster than nature", number(v)),
            (_, Some(v)) if n.is_f64() => number(v),
            _ => n.to_string(),
        },
        other => other.to_string(),
    }
}

/// A live figure, of few and always as many letters.
pub fn figure(name: &str, value: f64) -> String {
    match name {
        "psnr" => format!("{value:.2} dB"),
        "gaussians" => format!("{value:.0}"),
        _ => format!("{value:.4}"),
    }
}

/// Four significant digits; powers of ten where plain digits would be long.
fn number(v: f64) -> String {
    if v == 0.0 {
        return "0".into();
    }
    let magnitude = v.abs().log10().floor() as i32;
    if !(-3..7).contains(&magnitude) {
        return format!("{v:.2e}");
    }
    let text = format!("{v:.*}", (3 - magnitude).max(0) as usize);
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').into() } else { text }
}

/// A time for people.
pub fn duration(seconds: f64) -> String {
    match seconds {
        s if !s.is_finite() => "for ever".into(),
        s if s < 0.0995 => format!("{:.0} ms", s * 1e3),
        s if s < 59.95 => format!("{s:.1} s"),
        s if s < 3599.5 => format!("{} min {:02} s", (s.round() as u64) / 60, (s.round() as u64) % 60),
        s => format!("{} h {:02} min", (s / 60.0).round() as u64 / 60, (s / 60.0).round() as u64 % 60),
    }
}

fn bytes(v: f64) -> String {
    match v {
        v if v < 1024.0 => format!("{v:.0} B"),
        v if v < 1024.0 * 1024.0 => format!("{:.1} KiB", v / 1024.0),
        v if v < 1024.0f64.powi(3) => format!("{:.1} MiB", v / 1024.0f64.powi(2)),
        v => format!("{:.1} GiB", v / 1024.0f64.powi(3)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn a_run_reads_like_a_table() {
        let result = json!({
            "frames": 120, "seconds": 133.4, "particles": 60000, "energy_residual": 3.14159e-7, "volume_change": -0.00012, "repairs": 0,
            "films": ["out/film.mp4", "out/thermal.mp4"], "acceleration": 42.0, "peak_memory_bytes": 3145728, "skipped": null,
            "max_speed_m_s": 0.3, "audit": { "heat_j": 2.0 }, "memory_mib_estimate": 158.0, "render_s_estimate": 17.0,
        });
        let expected = "\
frames                   120
time                     2 min 13 s
particles                60000
heat runs                42 times faster than nature
energy residual          3.14e-7
volume change            -0.012 %
repairs                  0
films                    out/film.mp4
                         out/thermal.mp4
max speed                0.3 m/s
memory (estimate)        158.0 MiB
peak memory              3.0 MiB
render (estimate)        17.0 s
";
        assert_eq!(table(&result, false), expected);
    }

    #[test]
    fn details_take_one_line_each() {
        let result = json!({
            "bbox": { "min": [-1.0, 0.0, 0.25], "max": [1.0, 2.0, 12345.678] }, "opacity": { "p50": 0.98765 },
            "objects": [{ "name": "cup", "height_m": 0.1 }, { "name": "tea", "height_m": 0.05 }], "stages": ["fill", "render"],
        });
        let expected = "\
bounding box             [-1, 0, 0.25] to [1, 2, 12346]
objects                  height 0.1 m, name cup
                         height 0.05 m, name tea
opacity                  p50 0.9877
stages                   fill, render
";
        assert_eq!(table(&result, true), expected);
    }

    #[test]
    fn times_have_sensible_units() {
        assert_eq!([0.0123, 59.94, 60.0, 3599.0, 7300.0].map(duration), ["12 ms", "59.9 s", "1 min 00 s", "59 min 59 s", "2 h 02 min"]);
    }
}
