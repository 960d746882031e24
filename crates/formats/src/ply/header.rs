//! PLY header: grammar and limits.

use std::io::BufRead;

use crate::{
    error::{FormatError, Place, Result, TRUNCATED, quoted},
    source::Source,
};

/// Bytes a header may have.
const MAX_HEADER: usize = 64 << 10;
/// Elements a header may declare.
const MAX_ELEMENTS: usize = 64;
/// Properties an element may have.
const MAX_PROPERTIES: usize = 1024;

/// Type of one value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Scalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Scalar {
    fn parse(name: &str) -> Option<Self> {
        Some(match name {
            "char" | "int8" => Self::I8,
            "uchar" | "uint8" => Self::U8,
            "short" | "int16" => Self::I16,
            "ushort" | "uint16" => Self::U16,
            "int" | "int32" => Self::I32,
            "uint" | "uint32" => Self::U32,
            "float" | "float32" => Self::F32,
            "double" | "float64" => Self::F64,
            _ => return None,
        })
    }

    pub fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    pub fn is_integer(self) -> bool {
        !matches!(self, Self::F32 | Self::F64)
    }

    /// The value at the start of `bytes` (little endian, at least [`Scalar::size`] of them).
    #[inline(always)]
    pub fn f64(self, bytes: &[u8]) -> f64 {
        match self {
            Self::F32 => f32::from_le_bytes(first(bytes)).into(),
            Self::U8 => bytes[0].into(),
            Self::I8 => (bytes[0] as i8).into(),
            Self::I16 => i16::from_le_bytes(first(bytes)).into(),
            Self::U16 => u16::from_le_bytes(first(bytes)).into(),
            Self::I32 => i32::from_le_bytes(first(bytes)).into(),
            Self::U32 => u32::from_le_bytes(first(bytes)).into(),
            Self::F64 => f64::from_le_bytes(first(bytes)),
        }
    }
}

#[inline(always)]
fn first<const N: usize>(bytes: &[u8]) -> [u8; N] {
    std::array::from_fn(|i| bytes[i])
}

/// One value or a counted list of values.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    One(Scalar),
    List { count: Scalar, item: Scalar },
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Property {
    pub name: String,
    pub kind: Kind,
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Element {
    pub name: String,
    pub count: u64,
    pub properties: Vec<Property>,
}

impl Element {
    /// Bytes of a binary row, unless lists make it variable.
    pub fn stride(&self) -> Option<usize> {
        self.properties.iter().try_fold(0, |n, p| match p.kind {
            Kind::One(s) => Some(n + s.size()),
            Kind::List { .. } => None,
        })
    }

    /// The least a row can occupy in the file, with every list holding at least `items` values.
    pub fn least_row(&self, encoding: Encoding, items: usize) -> usize {
        let sizes = self.properties.iter().map(|p| match (p.kind, encoding) {
            // A digit and a separator.
            (Kind::One(_), Encoding::Ascii) => 2,
            (Kind::List { .. }, Encoding::Ascii) => 2 + 2 * items,
            (Kind::One(s), _) => s.size(),
            (Kind::List { count, item }, _) => count.size() + items * item.size(),
        });
        sizes.sum()
    }

    /// The named property of a row without lists.
    pub fn column(&self, name: &str) -> Option<Column> {
        let mut offset = 0;
        for p in &self.properties {
            let Kind::One(scalar) = p.kind else { return None };
            if p.name == name {
                return Some(Column { offset, scalar });
            }
            offset += scalar.size();
        }
        None
    }

    /// Like [`Element::column`]; an error that says what the property is for if it is missing.
    pub fn need(&self, source: &std::path::Path, name: &str, remedy: &'static str) -> Result<Column> {
        self.column(name).ok_or_else(|| {
            let place = Place::Property { element: self.name.clone(), property: name.into() };
            FormatError::defect(source, place, "nothing", "a number in every row", remedy)
        })
    }

    /// Refuses a claim that the rest of the file cannot hold.
    pub fn check_fits(&self, source: &std::path::Path, encoding: Encoding, remaining: u64, items: usize) -> Result<()> {
        let row = self.least_row(encoding, items) as u64;
        // The last separator of a text file may be missing.
        let spare = u64::from(encoding == Encoding::Ascii);
        let need = self.count.checked_mul(row);
        if need.is_some_and(|n| n <= remaining + spare) {
            return Ok(());
        }
        let found = format!("{} rows of at least {row} bytes claimed and {remaining} bytes left", self.count);
        let expected = format!("at most {} rows", remaining / row.max(1));
        Err(FormatError::defect(source, Place::Element(self.name.clone()), found, expected, TRUNCATED))
    }
}

/// Where a property stands in a row of little-endian bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Column {
    pub offset: usize,
    pub scalar: Scalar,
}

impl Column {
    #[inline(always)]
    pub fn f32(self, row: &[u8]) -> f32 {
        let bytes = &row[self.offset..];
        match self.scalar {
            Scalar::F32 => f32::from_le_bytes(first(bytes)),
            other => other.f64(bytes) as f32,
        }
    }

    #[inline(always)]
    pub fn f64(self, row: &[u8]) -> f64 {
        self.scalar.f64(&row[self.offset..])
    }

    #[inline(always)]
    pub fn u32(self, row: &[u8]) -> u32 {
        let bytes = &row[self.offset..];
        match self.scalar {
            Scalar::U32 => u32::from_le_bytes(first(bytes)),
            // Saturates; not-a-number becomes 0.
            other => other.f64(bytes) as u32,
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Encoding {
    Ascii,
    Little,
    Big,
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Header {
    pub encoding: Encoding,
    pub comments: Vec<String>,
    pub elements: Vec<Element>,
}

impl Header {
    /// Reads a header and leaves the source at the first row.
    pub fn read<R: BufRead>(source: &mut Source<'_, R>) -> Result<Self> {
        let path = source.path;
        let mut line = Vec::new();
        let mut used = 0;
        let mut encoding = None;
        let mut header = Self { encoding: Encoding::Ascii, comments: Vec::new(), elements: Vec::new() };
        loop {
            let more = source.line_into(&mut line, MAX_HEADER)?;
            used += line.len() + 1;
            let place = || Place::Line(source.line());
            if !more || used >= MAX_HEADER {
                let found = if more { "64 KiB of header" } else { "the end of the file" };
                return Err(FormatError::defect(path, place(), found, "'end_header'", TRUNCATED));
            }
            let text = String::from_utf8_lossy(&line);
            let bad = |found: &str, expected: &str| {
                Err(FormatError::defect(path, place(), quoted(found), expected, "the header is damaged, export the file again"))
            };
            if source.line() == 1 {
                if text.trim_end() != "ply" {
                    return Err(FormatError::defect(path, place(), quoted(&text), "'ply'", "this is not a PLY file"));
                }
                continue;
            }
            let mut words = text.split_ascii_whitespace();
            match words.next() {
                None | Some("obj_info") => {}
                Some("comment") => {
                    header.comments.push(text.trim_start().trim_start_matches("comment").trim().to_owned());
                }
                Some("format") => {
                    encoding = Some(match words.next() {
                        Some("ascii") => Encoding::Ascii,
                        Some("binary_little_endian") => Encoding::Little,
                        Some("binary_big_endian") => Encoding::Big,
                        _ => return bad(&text, "'format ascii', 'binary_little_endian' or 'binary_big_endian'"),
                    });
                }
                Some("element") => {
                    let (Some(name), Some(Ok(count))) = (words.next(), words.next().map(str::parse::<u64>)) else {
                        return bad(&text, "'element NAME COUNT'");
                    };
                    if header.elements.len() == MAX_ELEMENTS || header.elements.iter().any(|e| e.name == name) {
                        return bad(&text, "at most 64 elements with different names");
                    }
                    header.elements.push(Element { name: name.to_owned(), count, properties: Vec::new() });
                }
                Some("property") => {
                    let Some(property) = property(words) else {
                        return bad(&text, "'property TYPE NAME' or 'property list TYPE TYPE NAME'");
                    };
                    let Some(element) = header.elements.last_mut() else { return bad(&text, "an element before its properties") };
                    if element.properties.len() == MAX_PROPERTIES || element.properties.iter().any(|p| p.name == property.name) {
                        return bad(&text, "at most 1024 properties with different names");
                    }
                    element.properties.push(property);
                }
                Some("end_header") => {
                    header.encoding = match encoding {
                        Some(e) => e,
                        None => return bad(&text, "a 'format' line before the end of the header"),
                    };
                    return Ok(header);
                }
                Some(_) => return bad(&text, "format, comment, element, property or end_header"),
            }
        }
    }

    pub fn element(&self, name: &str) -> Option<&Element> {
        self.elements.iter().find(|e| e.name == name)
    }
}

fn property<'a>(mut words: impl Iterator<Item = &'a str>) -> Option<Property> {
    let kind = match words.next()? {
        "list" => {
            let count = Scalar::parse(words.next()?).filter(|s| s.is_integer())?;
            Kind::List { count, item: Scalar::parse(words.next()?)? }
        }
        one => Kind::One(Scalar::parse(one)?),
    };
    let name = words.next()?.to_owned();
    words.next().is_none().then_some(Property { name, kind })
}
