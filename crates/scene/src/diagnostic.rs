//! Messages about a scene file, with place.

use std::fmt;

/// How serious a message is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Severity {
    /// Good to know.
    Note,
    /// Runs, but probably not as meant.
    Warning,
    /// Cannot run.
    Error,
}

/// One message: `file:line:column: text`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Diagnostic {
    /// File name as given.
    pub file: String,
    /// Line, from 1.
    pub line: usize,
    /// Column in characters, from 1.
    pub column: usize,
    /// Key, without indices: `heat.region.sphere.radius`; empty for syntax errors.
    pub key: String,
    /// What is wrong, what is allowed, what to do; one line.
    pub message: String,
}

impl fmt::Display for Diagnostic {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:{}:{}: {}", self.file, self.line, self.column, self.message)
    }
}

/// Why a scene could not be read.
#[derive(Clone, Debug, thiserror::Error)]
pub enum SceneError {
    /// The file could not be read at all.
    #[error("{file}: {reason}")]
    Read {
        /// File name as given.
        file: String,
        /// Why.
        reason: String,
    },
    /// The text is not a valid scene; at least one message, in the order of the file.
    #[error("{}", lines(.0))]
    Invalid(Vec<Diagnostic>),
}

fn lines(diagnostics: &[Diagnostic]) -> String {
    diagnostics.iter().map(Diagnostic::to_string).collect::<Vec<_>>().join("\n")
}

/// Byte offset → (line, column), both from 1; the column counts characters.
pub(crate) fn position(text: &str, offset: usize) -> (usize, usize) {
    let mut offset = offset.min(text.len());
    while !text.is_char_boundary(offset) {
        offset -= 1;
    }
    let before = &text[..offset];
    let line_start = before.rfind('\n').map_or(0, |i| i + 1);
    (before.matches('\n').count() + 1, before[line_start..].chars().count() + 1)
}

/// The candidate most like `word`, if any is like it: a small typing error, or one is the beginning of the other (a missing unit).
pub(crate) fn nearest<'a>(word: &str, candidates: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    let plain = |s: &str| s.to_lowercase().replace(['-', ' '], "_");
    let word = plain(word);
    let mut best: Option<(f64, &str)> = None;
    for candidate in candidates {
        let c = plain(candidate);
        let typo = strsim::damerau_levenshtein(&word, &c) <= 1 + word.chars().count() / 4;
        let stem = word.len() >= 3 && (c.starts_with(&word) || word.starts_with(&c) || c.ends_with(&word));
        let score = strsim::jaro_winkler(&word, &c) + if typo { 1.0 } else { 0.0 };
        if (typo || stem || score > 0.9) && best.is_none_or(|(s, _)| score > s) {
            best = Some((score, candidate));
        }
    }
    best.map(|(_, c)| c)
}

/// `; did you mean "x"?`, or the list of what is allowed.
pub(crate) fn suggestion(word: &str, candidates: &[&str]) -> String {
    match nearest(word, candidates.iter().copied()) {
        Some(c) => format!("; did you mean \"{c}\"?"),
        None if candidates.is_empty() => String::new(),
        None => format!("; allowed: {}", candidates.join(", ")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn positions_count_characters() {
        assert_eq!(position("ab\ncäd", 6), (2, 3));
        assert_eq!(position("", 5), (1, 1));
    }

    #[test]
    fn near_words_are_found_and_far_ones_are_not() {
        let keys = ["density_kg_m3", "preset", "melt_yield_stress_pa", "solidus_c"];
        assert_eq!(nearest("density", keys), Some("density_kg_m3"));
        assert_eq!(nearest("presett", keys), Some("preset"));
        assert_eq!(nearest("Solidus-C", keys), Some("solidus_c"));
        assert_eq!(nearest("colour", keys), None);
    }
}
