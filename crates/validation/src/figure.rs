//! A [`Plot`] as SVG: references are lines, ours are points on them.

use std::fmt::Write;

use crate::text::{html, number, svg};
use crate::{Curve, Plot};

const WIDTH: f64 = 560.0;
const HEIGHT: f64 = 350.0;
/// Left, right, top, bottom.
const MARGIN: [f64; 4] = [68.0, 16.0, 12.0, 48.0];
/// Markers per curve at most; more hide the line behind them.
const MARKERS: usize = 36;
/// Colours of the page's style.
const COLOURS: usize = 7;

/// The figure with its title and legend; empty if there is nothing to draw.
pub fn draw(plot: &Plot) -> String {
    let Some(axes) = Axes::new(plot) else { return String::new() };
    let mut out = format!("<figure><figcaption>{}</figcaption>", html(&plot.title));
    legend(&mut out, plot);
    let _ = write!(out, "<svg viewBox=\"0 0 {WIDTH} {:.0}\" role=\"img\" aria-label=\"{}\">", axes.height, html_attribute(&plot.title));
    axes.draw(&mut out, plot);
    for (k, curve) in plot.curves.iter().enumerate() {
        curve_path(&mut out, &axes, curve, colour(plot, k));
    }
    out.push_str("</svg></figure>\n");
    out
}

fn html_attribute(text: &str) -> String {
    crate::text::escape(text)
}

/// References and ours that come in pairs share a colour; a lone reference is drawn in ink (colour 0).
fn colour(plot: &Plot, index: usize) -> usize {
    let reference = plot.curves[index].reference;
    let rank = plot.curves[..index].iter().filter(|c| c.reference == reference).count();
    let references = plot.curves.iter().filter(|c| c.reference).count();
    let paired = references > 1 && references == plot.curves.len() - references;
    if reference && !paired {
        // Several references without partners differ by their dashes alone.
        return 0;
    }
    rank % COLOURS + 1
}

/// Dash pattern of a reference.
fn dash(plot: &Plot, index: usize) -> &'static str {
    let rank = plot.curves[..index].iter().filter(|c| c.reference).count();
    if colour(plot, index) > 0 {
        return "";
    }
    ["", " stroke-dasharray=\"7 4\"", " stroke-dasharray=\"2 3\"", " stroke-dasharray=\"9 3 2 3\""][rank % 4]
}

fn legend(out: &mut String, plot: &Plot) {
    out.push_str("<div class=\"legend\">");
    for (k, curve) in plot.curves.iter().enumerate() {
        let c = colour(plot, k);
        let mark = if curve.reference {
            format!("<line x1=\"0\" y1=\"6\" x2=\"26\" y2=\"6\" class=\"line c{c}\"{}/>", dash(plot, k))
        } else {
            format!("<circle cx=\"13\" cy=\"6\" r=\"3.4\" class=\"dot c{c}\"/>")
        };
        let _ = write!(out, "<span><svg width=\"26\" height=\"12\" aria-hidden=\"true\">{mark}</svg> {}</span>", html(&curve.label));
    }
    out.push_str("</div>");
}

fn curve_path(out: &mut String, axes: &Axes, curve: &Curve, colour: usize) {
    let points: Vec<[f64; 2]> = curve.points.iter().filter_map(|p| axes.place(*p)).collect();
    if curve.reference || points.len() > MARKERS {
        let class = if curve.reference { "line" } else { "thin" };
        let mut path = String::new();
        let mut last: Option<[f64; 2]> = None;
        for (k, p) in points.iter().enumerate() {
            // Curves are kept to a fifth of a unit: finer would only make the page heavy.
            let close = last.is_some_and(|l| (l[0] - p[0]).abs() + (l[1] - p[1]).abs() < 0.2);
            if !close || k + 1 == points.len() {
                let _ = write!(path, "{}{:.1} {:.1}", if last.is_none() { "M" } else { "L" }, p[0], p[1]);
                last = Some(*p);
            }
        }
        let _ = write!(out, "<path d=\"{path}\" class=\"{class} c{colour}\"/>");
    }
    if !curve.reference {
        let step = points.len().div_ceil(MARKERS).max(1);
        for p in points.iter().step_by(step) {
            let _ = write!(out, "<circle cx=\"{:.1}\" cy=\"{:.1}\" r=\"3.2\" class=\"dot c{colour}\"/>", p[0], p[1]);
        }
    }
}

struct Axes {
    /// Range of both axes, logarithms on logarithmic axes.
    range: [[f64; 2]; 2],
    log: [bool; 2],
    height: f64,
}

impl Axes {
    /// Ranges that hold every point that can be drawn.
    fn new(plot: &Plot) -> Option<Self> {
        let mut range = [[f64::INFINITY, f64::NEG_INFINITY]; 2];
        for p in plot.curves.iter().flat_map(|c| &c.points) {
            let at: [f64; 2] = std::array::from_fn(|a| if plot.log[a] { p[a].log10() } else { p[a] });
            if at.iter().all(|v| v.is_finite()) {
                for a in 0..2 {
                    range[a] = [range[a][0].min(at[a]), range[a][1].max(at[a])];
                }
            }
        }
        if !range[0][0].is_finite() {
            return None;
        }
        for (a, [lo, hi]) in range.iter_mut().enumerate() {
            let size = (*hi - *lo).max(1e-9 * hi.abs().max(lo.abs())).max(1e-12);
            // Zero belongs to an axis that nearly reaches it.
            let zero = !plot.log[a] && *lo >= 0.0 && *lo < 0.35 * *hi;
            let pad = if a == 0 && !plot.log[a] { 0.02 } else { 0.06 };
            *lo = if zero { 0.0 } else { *lo - pad * size };
            *hi += pad * size;
        }
        let mut height = HEIGHT;
        if plot.equal_axes {
            let scale = (WIDTH - MARGIN[0] - MARGIN[1]) / (range[0][1] - range[0][0]);
            height = (scale * (range[1][1] - range[1][0])).clamp(90.0, 420.0) + MARGIN[2] + MARGIN[3];
            let held = (height - MARGIN[2] - MARGIN[3]) / scale;
            let middle = 0.5 * (range[1][0] + range[1][1]);
            if held < range[1][1] - range[1][0] {
                // Too tall: widen the other axis instead.
                let grow = (range[1][1] - range[1][0]) / held;
                range[0][1] = range[0][0] + (range[0][1] - range[0][0]) * grow;
            } else if range[1][0] == 0.0 {
                range[1][1] = held;
            } else {
                range[1] = [middle - 0.5 * held, middle + 0.5 * held];
            }
        }
        Some(Self { range, log: plot.log, height })
    }

    /// Position on the page of a value on one axis (logarithm taken already).
    fn on_page(&self, axis: usize, v: f64) -> f64 {
        let t = (v - self.range[axis][0]) / (self.range[axis][1] - self.range[axis][0]);
        match axis {
            0 => MARGIN[0] + t * (WIDTH - MARGIN[0] - MARGIN[1]),
            _ => self.height - MARGIN[3] - t * (self.height - MARGIN[2] - MARGIN[3]),
        }
    }

    fn place(&self, p: [f64; 2]) -> Option<[f64; 2]> {
        let at: [f64; 2] = std::array::from_fn(|a| self.on_page(a, if self.log[a] { p[a].log10() } else { p[a] }));
        at.iter().all(|v| v.is_finite()).then_some(at)
    }

    fn draw(&self, out: &mut String, plot: &Plot) {
        let (left, right) = (MARGIN[0], WIDTH - MARGIN[1]);
        let (top, bottom) = (MARGIN[2], self.height - MARGIN[3]);
        for axis in 0..2 {
            for (at, label) in ticks(self.range[axis], self.log[axis], if axis == 0 { 6 } else { 5 }) {
                let v = self.on_page(axis, at);
                let _ = match axis {
                    0 => write!(
                        out,
                        "<path d=\"M{v:.1} {top:.1}V{bottom:.1}\" class=\"grid\"/><text x=\"{v:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{label}</text>",
                        bottom + 17.0
                    ),
                    _ => write!(
                        out,
                        "<path d=\"M{left:.1} {v:.1}H{right:.1}\" class=\"grid\"/><text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\">{label}</text>",
                        left - 7.0,
                        v + 4.0
                    ),
                };
            }
        }
        let _ = write!(out, "<path d=\"M{left:.1} {top:.1}V{bottom:.1}H{right:.1}\" class=\"axis\"/>");
        let (x, y) = (0.5 * (left + right), 0.5 * (top + bottom));
        let _ = write!(
            out,
            "<text x=\"{x:.1}\" y=\"{:.1}\" text-anchor=\"middle\" class=\"label\">{}</text>\
             <text transform=\"translate(14 {y:.1}) rotate(-90)\" text-anchor=\"middle\" class=\"label\">{}</text>",
            self.height - 9.0,
            svg(&plot.x),
            svg(&plot.y)
        );
    }
}

/// Round values inside `range`, about `count` of them, and what is written there.
fn ticks(range: [f64; 2], log: bool, count: usize) -> Vec<(f64, String)> {
    let size = range[1] - range[0];
    if log && size > 1.2 {
        let step = (size / count as f64).ceil().max(1.0);
        let first = (range[0] / step).ceil();
        return (0..)
            .map(|k| (first + f64::from(k)) * step)
            .take_while(|v| *v <= range[1])
            .map(|v| (v, number(10f64.powf(v), 3)))
            .collect();
    }
    if log {
        // Less than a decade or so: round values themselves.
        let inner = ticks([10f64.powf(range[0]), 10f64.powf(range[1])], false, count);
        return inner.into_iter().filter_map(|(v, label)| (v > 0.0).then(|| (v.log10(), label))).collect();
    }
    let raw = size / count as f64;
    let power = 10f64.powf(raw.log10().floor());
    let step = [1.0, 2.0, 2.5, 5.0, 10.0].into_iter().map(|m| m * power).find(|s| *s >= raw * 0.999).unwrap_or(raw);
    let first = (range[0] / step - 1e-9).ceil() as i64;
    let last = (range[1] / step + 1e-9).floor() as i64;
    // Enough digits to tell neighbours apart.
    let digits = |v: f64| if v == 0.0 { 1 } else { ((v.abs() / step).log10().floor() as i64 + 3).clamp(2, 9) as usize };
    (first..=last).map(|k| k as f64 * step).map(|v| (v, number(v, digits(v)))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_inside() {
        let labels = |r, log| ticks(r, log, 5).into_iter().map(|t| t.1).collect::<Vec<_>>();
        assert_eq!(labels([0.0, 1.0], false), ["0", "0.2", "0.4", "0.6", "0.8", "1"]);
        assert_eq!(labels([300.1, 300.9], false), ["300.2", "300.4", "300.6", "300.8"]);
        assert_eq!(labels([-3.0, 1.0], true), ["0.001", "0.01", "0.1", "1", "10"]);
        assert_eq!(labels([-1e-7, 1e-7], false).first().map(String::as_str), Some("−10⁻⁷"));
    }

    #[test]
    fn a_figure_holds_every_curve_and_no_bad_number() {
        let plot = Plot::new("T_w < 1", "x [m]", "T [K]")
            .function("erfc", 0.0, 1.0, |x| 1.0 - x)
            .ours("simulated", vec![[0.0, 1.0], [0.5, f64::NAN], [1.0, 0.0]]);
        let text = draw(&plot);
        assert!(text.contains("T<sub>w</sub> &lt; 1") && text.contains("erfc") && !text.contains("NaN"));
        assert_eq!(text.matches("class=\"dot").count(), 3, "two points and one in the legend");
        assert!(draw(&Plot::new("nothing", "x", "y")).is_empty());
        assert!(draw(&Plot::new("one point", "x", "y").ours("p", vec![[1.0, 1.0]])).contains("circle"));
    }
}
