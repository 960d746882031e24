//! The results as one HTML file that needs nothing else.

use std::fmt::Write;

use crate::figure::draw;
use crate::run::margin;
use crate::text::{duration, escape, html, number};
use crate::{Finished, Results, Row, Tier};

/// Cases with more rows than this hide them behind a click; their figures tell more.
const LONG: usize = 12;

/// Chapters of the suite: the first number of each and its name.
const CHAPTERS: [(u32, &str, &str); 6] = [
    (1, "Transfers", "Mass, momentum and heat on their way between points and nodes."),
    (5, "Conduction and melting", "Heat in bodies at rest: walls, fronts, films, areas."),
    (18, "Air", "The lattice Boltzmann solver: flow, convection, moving obstacles."),
    (26, "Mechanics", "Elastic solids, yield-stress melts, contact, friction."),
    (39, "Heat and motion together", "What melts flows, what freezes stops, and the energy is accounted for."),
    (44, "Deformation, determinism, robustness", "The bits are the same every time, and bad input ends well."),
];

/// Number of a case: `V34-fine` is 34.
fn case_number(id: &str) -> u32 {
    id.chars().skip_while(|c| !c.is_ascii_digit()).take_while(char::is_ascii_digit).collect::<String>().parse().unwrap_or(0)
}

/// The cases of every chapter that has some, with their places among all.
fn chapters(results: &Results) -> Vec<(&'static str, &'static str, Vec<(usize, &Finished)>)> {
    let chapter = |id: &str| CHAPTERS.iter().rposition(|c| case_number(id) >= c.0).unwrap_or(0);
    let cases = |k: usize| results.cases.iter().enumerate().filter(|(_, c)| chapter(c.id) == k).collect::<Vec<_>>();
    (0..CHAPTERS.len()).map(|k| (CHAPTERS[k].1, CHAPTERS[k].2, cases(k))).filter(|c| !c.2.is_empty()).collect()
}

/// The page.
pub fn page(results: &Results) -> String {
    let mut out = String::from("<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n");
    out.push_str("<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n<title>MeGAS: is the physics right?</title>\n");
    let _ = write!(out, "<style>\n{}</style>\n</head>\n<body>\n", include_str!("page.css"));
    head(&mut out, results);
    for (name, about, cases) in chapters(results) {
        let _ = writeln!(out, "<h2>{name}</h2>\n<p class=\"soft\">{about}</p>");
        for (index, case) in cases {
            section(&mut out, index, case);
        }
    }
    out.push_str("</body>\n</html>\n");
    out
}

fn head(out: &mut String, results: &Results) {
    let failed = results.failed();
    let rows: usize = results.cases.iter().map(|c| c.outcome.rows.len()).sum();
    let good: usize = results.cases.iter().map(Finished::rows_passed).sum();
    out.push_str("<h1>Is the physics right?</h1>\n");
    let _ = writeln!(
        out,
        "<p>Every case below runs the simulator that also makes the films and compares it with an analytic solution, a conservation law or a \
         published benchmark. A number passes when |ours − reference| is at most its tolerance; the bar beside it shows how much of the \
         tolerance is used. Lines are references, points are ours. <code>megas validate --full</code> makes this page anew.</p>"
    );
    let colour = |ok: bool| if ok { "good" } else { "bad" };
    let verdict = |passed: usize, total: usize| format!("{passed} of {total}");
    out.push_str("<div class=\"verdict numbers\">");
    let mut figure = |class: &str, value: String, label: &str| {
        let _ = write!(out, "<div class=\"{class}\"><b>{value}</b>{label}</div>");
    };
    figure(colour(failed.is_empty()), verdict(results.cases.len() - failed.len(), results.cases.len()), "cases passed");
    figure(colour(rows == good), verdict(good, rows), "numbers inside their tolerance");
    figure("", duration(results.core_seconds.unwrap_or(results.seconds)), "of processor time");
    figure("", escape(results.version), "version");
    out.push_str("</div>\n");
    for (name, _, cases) in chapters(results) {
        let _ = write!(out, "<div class=\"chapter\"><div>{name}</div><div class=\"chips\">");
        for (index, case) in cases {
            let class = if case.passed { "chip" } else { "chip bad" };
            let _ = write!(out, "<a class=\"{class}\" href=\"#case-{index}\" title=\"{}\">{}</a>", escape(case.name), escape(case.id));
        }
        out.push_str("</div></div>\n");
    }
}

fn section(out: &mut String, index: usize, case: &Finished) {
    let (class, verdict) = if case.passed { ("", "passed") } else { (" bad", "failed") };
    let _ = write!(
        out,
        "<section id=\"case-{index}\" class=\"{}\"><header><span class=\"id\">{}</span><h3>{}</h3><span class=\"pill{class}\">{verdict}</span>",
        class.trim(),
        escape(case.id),
        html(case.name)
    );
    let time = case.core_seconds.unwrap_or(case.seconds);
    let _ = write!(out, "<span class=\"time\">{} of processor time</span></header>", duration(time));
    out.push_str("<dl>");
    for (name, class, text) in [("proves", "", case.proves), ("set-up", "", case.setup), ("reference", "formula", case.formula)] {
        if !text.is_empty() {
            let _ = write!(out, "<dt>{name}</dt><dd class=\"{class}\">{}</dd>", html(text));
        }
    }
    out.push_str("</dl>\n");
    if let Some(panic) = &case.panic {
        let _ = writeln!(out, "<p class=\"panic\">{}</p>", escape(panic));
    }
    for note in &case.outcome.notes {
        let _ = writeln!(out, "<p class=\"note\">{}</p>", html(note));
    }
    let figures: String = case.outcome.plots.iter().map(draw).collect();
    if !figures.is_empty() {
        let _ = write!(out, "<div class=\"figures\">\n{figures}</div>\n");
    }
    let long = case.outcome.rows.len() > LONG && case.passed;
    if long {
        let worst = case.worst().map_or(String::new(), |w| format!(", at most {:.0} % of a tolerance used", (100.0 * w).ceil()));
        let _ = write!(out, "<details><summary>{} numbers{worst}</summary>", case.outcome.rows.len());
    }
    table(out, &case.outcome.rows);
    out.push_str(if long { "</details></section>\n" } else { "</section>\n" });
}

fn table(out: &mut String, rows: &[Row]) {
    if rows.is_empty() {
        return;
    }
    out.push_str(
        "<div class=\"scroll\"><table><thead><tr><th>quantity</th><th>reference</th><th>ours</th><th>error</th><th>tolerance</th><th>used</th></tr></thead><tbody>\n",
    );
    for row in rows {
        let used = match margin(row) {
            None => String::new(),
            Some(m) => format!("<span class=\"meter\"><i style=\"width:{:.0}%\"></i></span>", (100.0 * m).clamp(0.0, 100.0)),
        };
        let tolerance = if row.tolerance > 0.0 { number(row.tolerance, 2) } else { "exact".into() };
        let _ = writeln!(
            out,
            "<tr{}><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{tolerance}</td><td>{used}</td></tr>",
            if row.passed() { "" } else { " class=\"bad\"" },
            html(&row.quantity),
            number(row.reference, 5),
            number(row.ours, 5),
            number(row.error(), 2)
        );
    }
    out.push_str("</tbody></table></div>\n");
}

/// The results for `docs/validation.md`.
pub fn markdown(results: &Results) -> String {
    let summary = results.summary();
    let mut out = String::from("# Validation\n\n");
    let _ = writeln!(
        out,
        "Made by `megas validate --markdown FILE`, with `--full` for the cases that take longer than a minute;\n\
         the same command writes `validation.html` with a figure for\n\
         almost every case. A number passes when |ours − reference| ≤ tolerance; *used* is the largest share of a tolerance that a case uses\n\
         up. References are analytic solutions, conservation laws or published benchmarks. Time is processor time of all threads.\n\n\
         **{} of {} cases passed, {} of {} numbers, {}.**\n",
        summary["passed"],
        summary["total"],
        summary["rows_passed"],
        summary["rows"],
        duration(results.core_seconds.unwrap_or(results.seconds))
    );
    out.push_str("| case | | what it proves | numbers | used | time |\n| --- | --- | --- | ---: | ---: | ---: |\n");
    let cell = |text: &str| text.replace('|', "\\|");
    for case in &results.cases {
        let verdict = if case.passed { String::new() } else { " **failed**".into() };
        let _ = writeln!(
            out,
            "| {}{verdict} | {} | {} | {}/{} | {} | {} |",
            case.id,
            cell(case.name),
            cell(&html(case.proves)),
            case.rows_passed(),
            case.outcome.rows.len(),
            case.worst().map_or("–".into(), |w| format!("{:.0} %", (100.0 * w).ceil())),
            duration(case.core_seconds.unwrap_or(case.seconds))
        );
    }
    for (name, _, cases) in chapters(results) {
        let _ = write!(out, "\n## {name}\n");
        for (_, case) in cases {
            let tier = if case.tier == Tier::C { " (only with `--full`)" } else { "" };
            let _ = write!(out, "\n### {} {}{tier}\n\n", case.id, case.name);
            for text in [case.setup, case.formula].iter().filter(|t| !t.is_empty()) {
                let _ = writeln!(out, "{}\n", html(text).replace('*', "\\*"));
            }
            for note in &case.outcome.notes {
                let _ = writeln!(out, "> {}\n", html(note));
            }
            if let Some(panic) = &case.panic {
                let _ = writeln!(out, "> ended early: {panic}\n");
            }
            out.push_str("| quantity | reference | ours | error | tolerance | |\n| --- | ---: | ---: | ---: | ---: | --- |\n");
            for row in &case.outcome.rows {
                let _ = writeln!(
                    out,
                    "| {} | {} | {} | {} | {} | {} |",
                    cell(&html(&row.quantity)),
                    number(row.reference, 5),
                    number(row.ours, 5),
                    number(row.error(), 2),
                    if row.tolerance > 0.0 { number(row.tolerance, 2) } else { "exact".into() },
                    if row.passed() { "" } else { "**failed**" }
                );
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Case, Outcome, Plot, run::run};

    fn some() -> Outcome {
        let plot = Plot::new("a|b", "x", "y").function("exact", 0.0, 1.0, |x| x).ours("ours", vec![[0.0, 0.1]]);
        Outcome::from(vec![Row::new("T_w <hot> | [K]", 1.0, 1.5, 0.1)]).plot(plot).note("because <script>")
    }

    fn results() -> Results {
        let case = Case::new("V34-fine", "a & b", Tier::A, some).proves("p").setup("s").formula("x^{2}");
        Results::new(vec![run(&case)])
    }

    #[test]
    fn the_page_is_one_file_and_escapes_what_it_shows() {
        let page = page(&results());
        for wanted in ["Mechanics", "a &amp; b", "x<sup>2</sup>", "T<sub>w</sub> &lt;hot&gt;", "because &lt;script&gt;", "0 of 1", "<svg"] {
            assert!(page.contains(wanted), "{wanted}");
        }
        for unwanted in ["http", "src=", "<script", "NaN", "@import"] {
            assert!(!page.contains(unwanted), "{unwanted}");
        }
        assert_eq!(page.matches("<section").count(), page.matches("</section>").count());
        assert_eq!(page.matches("<div").count(), page.matches("</div>").count());
    }

    #[test]
    fn markdown_has_a_row_per_case_and_number() {
        let text = markdown(&results());
        assert!(text.contains("| V34-fine **failed** | a & b | p | 0/1 | 500 % |"), "{text}");
        assert!(text.contains("| T<sub>w</sub> &lt;hot&gt; \\| [K] | 1 | 1.5 | 0.5 | 0.1 | **failed** |"), "{text}");
    }
}
