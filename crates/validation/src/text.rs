//! Numbers and small formulas as HTML.

use std::fmt::Write;

/// Escapes text for HTML and turns `_{…}`, `^{…}`, `_word`, `^word` after a letter, digit or bracket into subscripts and superscripts.
pub fn html(text: &str) -> String {
    marked(text, |out, kind, inner| {
        let tag = if kind == '_' { "sub" } else { "sup" };
        let _ = write!(out, "<{tag}>{inner}</{tag}>");
    })
}

/// The same for the text of an SVG, where raising is a shift that has to be undone.
pub fn svg(text: &str) -> String {
    marked(text, |out, kind, inner| {
        let (there, back) = if kind == '_' { (3.0, -3.0) } else { (-4.0, 4.0) };
        let _ = write!(out, "<tspan dy=\"{there}\" font-size=\"75%\">{inner}</tspan><tspan dy=\"{back}\">\u{200b}</tspan>");
    })
}

fn marked(text: &str, script: impl Fn(&mut String, char, &str)) -> String {
    let mut out = String::with_capacity(text.len() + 32);
    let chars: Vec<char> = text.chars().collect();
    let mut i = 0;
    while let Some(&c) = chars.get(i) {
        let after_symbol = i > 0 && (chars[i - 1].is_alphanumeric() || matches!(chars[i - 1], ')' | ']' | '}' | '′' | '̃' | '∞' | '⟩'));
        let next = chars.get(i + 1).copied();
        if (c == '_' || c == '^') && after_symbol {
            let inner: Option<String> = match next {
                Some('{') => chars[i + 2..].iter().position(|&c| c == '}').map(|n| chars[i + 2..i + 2 + n].iter().collect()),
                Some('∞') => Some("∞".into()),
                Some(_) => Some(chars[i + 1..].iter().take_while(|c| c.is_alphanumeric()).collect::<String>()).filter(|w| !w.is_empty()),
                _ => None,
            };
            if let Some(inner) = inner {
                i += inner.chars().count() + if next == Some('{') { 3 } else { 1 };
                script(&mut out, c, &escape(&inner));
                continue;
            }
        }
        push_escaped(&mut out, c);
        i += 1;
    }
    out
}

/// Text without meaning for HTML.
pub fn escape(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    text.chars().for_each(|c| push_escaped(&mut out, c));
    out
}

fn push_escaped(out: &mut String, c: char) {
    match c {
        '&' => out.push_str("&amp;"),
        '<' => out.push_str("&lt;"),
        '>' => out.push_str("&gt;"),
        '"' => out.push_str("&quot;"),
        _ => out.push(c),
    }
}

/// `digits` significant digits, powers of ten as `1.2×10⁻³`.
pub fn number(v: f64, digits: usize) -> String {
    if v == 0.0 {
        return "0".into();
    }
    if !v.is_finite() {
        return if v.is_nan() { "no number".into() } else { format!("{}∞", if v < 0.0 { "−" } else { "" }) };
    }
    // Rounded first, so that 9.996 has the exponent of 10.
    let text = format!("{:.*e}", digits.saturating_sub(1), v.abs());
    let (mantissa, exponent) = text.split_once('e').unwrap_or((&text, "0"));
    let exponent: i32 = exponent.parse().unwrap_or(0);
    let sign = if v < 0.0 { "−" } else { "" };
    if (-3..6).contains(&exponent) {
        let decimals = (digits as i32 - 1 - exponent).max(0) as usize;
        let plain = format!("{:.*}", decimals, v.abs());
        return format!("{sign}{}", trimmed(&plain));
    }
    let raised: String = exponent.to_string().chars().map(superscript).collect();
    match trimmed(mantissa) {
        "1" => format!("{sign}10{raised}"),
        m => format!("{sign}{m}×10{raised}"),
    }
}

fn trimmed(number: &str) -> &str {
    if number.contains('.') { number.trim_end_matches('0').trim_end_matches('.') } else { number }
}

fn superscript(c: char) -> char {
    match c {
        '-' => '⁻',
        '1' => '¹',
        '2' => '²',
        '3' => '³',
        c => c.to_digit(10).and_then(|d| char::from_u32(0x2070 + d)).unwrap_or(c),
    }
}

/// A time for people.
pub fn duration(seconds: f64) -> String {
    match seconds {
        s if s < 0.0995 => format!("{:.0} ms", s * 1e3),
        s if s < 59.95 => format!("{s:.1} s"),
        s if s < 3599.5 => format!("{} min {:02} s", s.round() as u64 / 60, s.round() as u64 % 60),
        s => format!("{} h {:02} min", (s / 60.0).round() as u64 / 60, (s / 60.0).round() as u64 % 60),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn formulas_become_subscripts_and_nothing_becomes_markup() {
        assert_eq!(html("T_w < 1 & e^{−λ²}"), "T<sub>w</sub> &lt; 1 &amp; e<sup>−λ²</sup>");
        assert_eq!(html("c_sub=0 _x ^{y} 10^{-3}"), "c<sub>sub</sub>=0 _x ^{y} 10<sup>-3</sup>");
        assert_eq!(html("x_{open"), "x_{open");
    }

    #[test]
    fn numbers_read_like_in_a_book() {
        let shown = [0.0, 1.0, -0.00123456, 123456.0, 9.99996, 1e-10, -2.5e7, 1e6].map(|v| number(v, 4));
        assert_eq!(shown, ["0", "1", "−0.001235", "123456", "10", "10⁻¹⁰", "−2.5×10⁷", "10⁶"]);
        assert_eq!(number(f64::NAN, 3), "no number");
    }
}
