//! Checks the text of a scene against the JSON Schema, with line and column of every problem.

use std::ops::Range;

use serde_json::Value as Json;
use toml_edit::{Document, Item, Table, TableLike, Value};

use crate::diagnostic::{Diagnostic, SceneError, nearest, position, suggestion};
use crate::value::{COLOUR_PATTERN, is_colour};

/// One step of the way to a value.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Step {
    Key(String),
    Index(usize),
}

/// Keys of a path joined by dots; indices are left out, lines tell which one.
fn key_of(path: &[Step]) -> String {
    let keys: Vec<&str> = path.iter().filter_map(|s| if let Step::Key(k) = s { Some(k.as_str()) } else { None }).collect();
    keys.join(".")
}

/// A scene's text, parsed with the place of everything.
pub(crate) struct Source<'t> {
    text: &'t str,
    file: String,
    document: Document<&'t str>,
}

/// A TOML value wherever it is written: under a header, inline, or an element of `[[…]]`.
#[derive(Clone, Copy)]
enum Node<'a> {
    Item(&'a Item),
    Value(&'a Value),
    Table(&'a Table),
}

impl<'a> Node<'a> {
    fn span(self) -> Option<Range<usize>> {
        match self {
            Self::Item(i) => i.span(),
            Self::Value(v) => v.span(),
            Self::Table(t) => t.span(),
        }
    }

    fn value(self) -> Option<&'a Value> {
        match self {
            Self::Item(i) => i.as_value(),
            Self::Value(v) => Some(v),
            Self::Table(_) => None,
        }
    }

    fn table(self) -> Option<&'a dyn TableLike> {
        match self {
            Self::Item(i) => i.as_table_like(),
            Self::Value(v) => v.as_inline_table().map(|t| t as &dyn TableLike),
            Self::Table(t) => Some(t),
        }
    }

    fn elements(self) -> Option<Vec<Node<'a>>> {
        if let Self::Item(Item::ArrayOfTables(tables)) = self {
            return Some(tables.iter().map(Node::Table).collect());
        }
        Some(self.value()?.as_array()?.iter().map(Node::Value).collect())
    }

    fn number(self) -> Option<f64> {
        match self.value()? {
            Value::Integer(i) => Some(*i.value() as f64),
            Value::Float(f) => Some(*f.value()),
            _ => None,
        }
    }

    /// The value as the user wrote it, shortened; a table as "a table".
    fn shown(self, text: &str) -> String {
        if self.table().is_some() {
            return "a table".into();
        }
        if matches!(self, Self::Item(Item::ArrayOfTables(_))) {
            return "a list of tables".into();
        }
        let raw = self.span().and_then(|s| text.get(s)).unwrap_or("").trim();
        match raw.char_indices().nth(40) {
            Some((cut, _)) => format!("{}…", raw[..cut].replace('\n', " ")),
            None => raw.replace('\n', " "),
        }
    }
}

/// Sorts by place and drops repetitions.
pub(crate) fn in_file_order(mut problems: Vec<Diagnostic>) -> Vec<Diagnostic> {
    problems.sort_by_key(|d| (d.line, d.column));
    problems.dedup();
    problems
}

impl<'t> Source<'t> {
    pub(crate) fn new(text: &'t str, file: &str) -> Result<Self, SceneError> {
        let document = Document::parse(text).map_err(|e| {
            let (line, column) = position(text, e.span().map_or(0, |s| s.start));
            let message = format!("not valid TOML: {}", e.message().trim().replace('\n', "; "));
            SceneError::Invalid(vec![Diagnostic { file: file.into(), line, column, key: String::new(), message }])
        })?;
        Ok(Self { text, file: file.into(), document })
    }

    /// A message at a span of the text.
    pub(crate) fn at_span(&self, span: Option<Range<usize>>, key: &str, message: &str) -> Diagnostic {
        let (line, column) = position(self.text, span.map_or(0, |s| s.start));
        Diagnostic { file: self.file.clone(), line, column, key: key.into(), message: message.trim().replace('\n', "; ") }
    }

    /// A message about the value at `path`, placed at its key, or at the nearest thing around it that is in the file.
    pub(crate) fn at_path(&self, path: &[Step], message: &str) -> Diagnostic {
        let mut node = Node::Item(self.document.as_item());
        let mut span = None;
        for step in path {
            let next = match step {
                Step::Key(key) => node.table().and_then(|t| t.get_key_value(key)).map(|(k, item)| (k.span(), Node::Item(item))),
                Step::Index(i) => node.elements().and_then(|e| e.get(*i).copied()).map(|n| (n.span(), n)),
            };
            let Some((place, inner)) = next else { break };
            // `[[heat]]` gives the header's place for the element; keys give their own.
            span = place.or(span);
            node = inner;
        }
        self.at_span(span, &key_of(path), message)
    }

    /// All problems of the text against the schema, in the order of the file.
    pub(crate) fn check_against(&self, schema: &Json) -> Vec<Diagnostic> {
        let mut walk = Walk { source: self, root: schema, path: Vec::new(), problems: Vec::new() };
        walk.check(Node::Item(self.document.as_item()), schema);
        in_file_order(walk.problems)
    }
}

struct Walk<'s, 't> {
    source: &'s Source<'t>,
    root: &'s Json,
    path: Vec<Step>,
    problems: Vec<Diagnostic>,
}

impl<'s> Walk<'s, '_> {
    fn resolve(&self, schema: &'s Json) -> &'s Json {
        match schema.get("$ref").and_then(Json::as_str) {
            Some(reference) => self.root.pointer(reference.trim_start_matches('#')).unwrap_or(schema),
            None => schema,
        }
    }

    fn report(&mut self, message: String) {
        let diagnostic = self.source.at_path(&self.path, &message);
        self.problems.push(diagnostic);
    }

    fn key(&self) -> String {
        key_of(&self.path)
    }

    fn wrong_value(&mut self, node: Node<'_>, expected: &str) {
        let message = format!("{} = {}: {expected}", self.key(), node.shown(self.source.text));
        self.report(message);
    }

    fn check(&mut self, node: Node<'_>, schema: &'s Json) {
        let schema = self.resolve(schema);
        if let Some(alternatives) = ["anyOf", "oneOf"].iter().find_map(|k| schema.get(k)?.as_array()) {
            return self.check_alternatives(node, alternatives);
        }
        if schema.get("enum").is_some() || schema.get("const").is_some() {
            return self.check_words(node, &[schema]);
        }
        match schema.get("type").and_then(Json::as_str) {
            Some("object") => self.check_object(node, schema),
            Some("array") => self.check_array(node, schema),
            Some("string") if node.value().is_none_or(|v| !v.is_str()) => self.wrong_value(node, "expected text in quotes"),
            Some("string") if schema.get("pattern").is_some_and(|p| p == COLOUR_PATTERN) && !is_text(node, is_colour) => {
                self.wrong_value(node, "expected \"#rrggbb\" or 3 numbers");
            }
            Some("boolean") if node.value().is_none_or(|v| !v.is_bool()) => self.wrong_value(node, "expected true or false"),
            Some(kind @ ("number" | "integer")) => self.check_number(node, schema, kind == "integer"),
            _ => {}
        }
    }

    fn check_number(&mut self, node: Node<'_>, schema: &Json, integer: bool) {
        let limit = |key: &str| schema.get(key).and_then(Json::as_f64);
        let range = match (limit("minimum"), limit("maximum")) {
            (Some(a), Some(b)) => format!(", {} to {}", plain(a), plain(b)),
            (Some(a), None) => format!(", at least {}", plain(a)),
            (None, Some(b)) => format!(", at most {}", plain(b)),
            (None, None) => String::new(),
        };
        let is_integer = node.value().is_some_and(Value::is_integer);
        match node.number() {
            Some(v) if v.is_finite() && (is_integer || !integer) => {
                if limit("minimum").is_some_and(|m| v < m) || limit("maximum").is_some_and(|m| v > m) {
                    self.wrong_value(node, &format!("out of range; allowed{}", range.replacen(", ", ": ", 1)));
                }
            }
            _ => {
                let noun = if integer { "a whole number" } else { "a number" };
                self.wrong_value(node, &format!("expected {noun}{range}"));
            }
        }
    }

    fn check_array(&mut self, node: Node<'_>, schema: &'s Json) {
        let items = schema.get("items").map(|i| self.resolve(i));
        let of_tables = items.is_some_and(|i| i.get("properties").is_some());
        let Some(elements) = node.elements() else {
            if of_tables && node.table().is_some() {
                let key = self.key();
                return self.report(format!("write [[{key}]] with two brackets instead of [{key}]: there may be several"));
            }
            return self.wrong_value(node, if of_tables { "expected a list of tables" } else { "expected a list [ … ]" });
        };
        let count = |key: &str| schema.get(key).and_then(Json::as_u64).map(|n| n as usize);
        let (least, most) = (count("minItems"), count("maxItems"));
        if least.is_some_and(|m| elements.len() < m) || most.is_some_and(|m| elements.len() > m) {
            let expected = match (least, most) {
                (Some(a), Some(b)) if a == b => format!("expected {a} values, found {}", elements.len()),
                _ => format!("has {} values, too few or too many", elements.len()),
            };
            return self.wrong_value(node, &expected);
        }
        let Some(items) = items else { return };
        for (i, element) in elements.into_iter().enumerate() {
            self.path.push(Step::Index(i));
            self.check(element, items);
            self.path.pop();
        }
    }

    fn check_object(&mut self, node: Node<'_>, schema: &'s Json) {
        let Some(table) = node.table() else {
            return self.wrong_value(node, "expected a table");
        };
        let properties = schema.get("properties").and_then(Json::as_object);
        let others = schema.get("additionalProperties").filter(|a| a.is_object());
        let known: Vec<&str> = properties.iter().flat_map(|p| p.keys().map(String::as_str)).collect();
        for (key, item) in table.iter() {
            let inner = properties.and_then(|p| p.get(key)).or(others);
            self.path.push(Step::Key(key.into()));
            match inner {
                Some(inner) => self.check(Node::Item(item), inner),
                None => self.unknown_key(key, &known),
            }
            self.path.pop();
        }
        for required in schema.get("required").and_then(Json::as_array).into_iter().flatten().filter_map(Json::as_str) {
            if table.get(required).is_none() {
                let place = self.key();
                let place = if place.is_empty() { "the scene".into() } else { place };
                self.report(format!("{place}: \"{required}\" is missing"));
            }
        }
    }

    fn unknown_key(&mut self, key: &str, known: &[&str]) {
        let parent = key_of(&self.path[..self.path.len() - 1]);
        let place = if parent.is_empty() { String::new() } else { format!(" in {parent}") };
        self.report(format!("unknown key \"{key}\"{place}{}", suggestion(key, known)));
    }

    /// Words out of `enum`s and `const`s.
    fn check_words(&mut self, node: Node<'_>, schemas: &[&Json]) {
        let allowed: Vec<&Json> =
            schemas.iter().flat_map(|s| s.get("enum").and_then(Json::as_array).into_iter().flatten().chain(s.get("const"))).collect();
        let found = match node.value() {
            Some(Value::String(s)) => Some(Json::from(s.value().as_str())),
            Some(Value::Integer(i)) => Some(Json::from(*i.value())),
            _ => None,
        };
        if found.as_ref().is_some_and(|f| allowed.contains(&f)) {
            return;
        }
        let list = allowed.iter().map(|a| a.to_string()).collect::<Vec<_>>().join(", ");
        let words: Vec<&str> = allowed.iter().filter_map(|a| a.as_str()).collect();
        let near = found.as_ref().and_then(Json::as_str).and_then(|f| nearest(f, words));
        let hint = near.map_or(String::new(), |n| format!("; did you mean \"{n}\"?"));
        self.wrong_value(node, &format!("allowed: {list}{hint}"));
    }

    /// One of several forms: words, a table with one key that names the form, or plain types side by side.
    fn check_alternatives(&mut self, node: Node<'_>, alternatives: &'s [Json]) {
        let resolved: Vec<&Json> = alternatives.iter().map(|a| self.resolve(a)).collect();
        let words: Vec<&Json> = resolved.iter().copied().filter(|a| a.get("enum").is_some() || a.get("const").is_some()).collect();
        if words.len() == resolved.len() {
            return self.check_words(node, &words);
        }
        let named: Vec<(&'s str, &'s Json)> = resolved
            .iter()
            .filter_map(|a| a.get("properties")?.as_object())
            .filter(|p| p.len() == 1)
            .flat_map(|p| p.iter().map(|(k, v)| (k.as_str(), v)))
            .collect();
        if named.len() == resolved.len() {
            return self.check_named(node, &named);
        }
        // Plain types side by side ("auto" or a number): the form with the value's own type speaks.
        let own = resolved.iter().copied().find(|a| match a.get("type").and_then(Json::as_str) {
            Some("number" | "integer") => node.number().is_some(),
            Some("string") => node.value().is_some_and(Value::is_str),
            Some("boolean") => node.value().is_some_and(Value::is_bool),
            Some("array") => node.elements().is_some(),
            Some("object") => node.table().is_some(),
            // A word that is not one of the words gets to hear of all forms.
            _ => node.value().and_then(Value::as_str).is_some_and(|w| words_of(a).any(|allowed| allowed == w)),
        });
        match own {
            Some(schema) => self.check(node, schema),
            None => {
                let forms: Vec<String> = resolved.iter().map(|a| form_name(a)).collect();
                let near = node.value().and_then(Value::as_str).and_then(|w| nearest(w, resolved.iter().flat_map(|a| words_of(a))));
                let hint = near.map_or(String::new(), |n| format!("; did you mean \"{n}\"?"));
                self.wrong_value(node, &format!("expected {}{hint}", forms.join(" or ")));
            }
        }
    }

    /// A table whose single key names the form: `region = { sphere = { … } }`.
    fn check_named(&mut self, node: Node<'_>, named: &[(&'s str, &'s Json)]) {
        let names: Vec<&str> = named.iter().map(|n| n.0).collect();
        let Some(table) = node.table() else {
            return self.wrong_value(node, &format!("expected a table with one of: {}", names.join(", ")));
        };
        let mut known = 0;
        for (key, item) in table.iter() {
            self.path.push(Step::Key(key.into()));
            match named.iter().find(|n| n.0 == key) {
                Some((_, inner)) => {
                    known += 1;
                    self.check(Node::Item(item), inner);
                }
                None => self.unknown_key(key, &names),
            }
            self.path.pop();
        }
        if known > 1 || table.is_empty() {
            let key = self.key();
            self.report(format!("{key}: write exactly one of: {}", names.join(", ")));
        }
    }
}

fn is_text(node: Node<'_>, test: fn(&str) -> bool) -> bool {
    node.value().and_then(Value::as_str).is_some_and(test)
}

fn words_of(schema: &Json) -> impl Iterator<Item = &str> {
    schema.get("enum").and_then(Json::as_array).into_iter().flatten().filter_map(Json::as_str)
}

fn form_name(schema: &Json) -> String {
    if let Some(words) = schema.get("enum").and_then(Json::as_array) {
        return words.iter().map(Json::to_string).collect::<Vec<_>>().join(", ");
    }
    match schema.get("type").and_then(Json::as_str) {
        Some("number" | "integer") => "a number".into(),
        Some("array") => match schema.get("minItems").and_then(Json::as_u64) {
            Some(n) => format!("{n} numbers"),
            None => "a list".into(),
        },
        Some("object") => "a table".into(),
        Some("boolean") => "true or false".into(),
        _ => match schema.get("pattern").is_some() {
            true => "\"#rrggbb\"".into(),
            false => "text".into(),
        },
    }
}

/// A number for people: no exponent where it is short without.
fn plain(v: f64) -> String {
    if v != 0.0 && !(1e-4..1e7).contains(&v.abs()) { format!("{v:e}") } else { format!("{v}") }
}
