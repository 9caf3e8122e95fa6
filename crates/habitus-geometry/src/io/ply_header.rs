//! The header of a PLY file (Turk 1994).

use super::error::{Fault, Place, Problem, shortened};

/// How the numbers after the header are written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Encoding {
    Ascii,
    LittleEndian,
    BigEndian,
}

/// A number type of PLY.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Scalar {
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
    fn parse(word: &str) -> Option<Self> {
        Some(match word {
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

    /// The whole numbers that the type can hold; `None` for floats.
    pub fn integer_range(self) -> Option<(f64, f64)> {
        Some(match self {
            Self::I8 => (f64::from(i8::MIN), f64::from(i8::MAX)),
            Self::U8 => (0.0, f64::from(u8::MAX)),
            Self::I16 => (f64::from(i16::MIN), f64::from(i16::MAX)),
            Self::U16 => (0.0, f64::from(u16::MAX)),
            Self::I32 => (f64::from(i32::MIN), f64::from(i32::MAX)),
            Self::U32 => (0.0, f64::from(u32::MAX)),
            Self::F32 | Self::F64 => return None,
        })
    }
}

/// One column of an element.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Property {
    pub name: String,
    /// The type of the count where the column is a list.
    pub list_count: Option<Scalar>,
    pub scalar: Scalar,
}

/// One table of the file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Element {
    pub name: String,
    pub count: usize,
    pub properties: Vec<Property>,
}

impl Element {
    /// The fewest bytes that a row can take.
    pub fn smallest_row(&self, encoding: Encoding) -> usize {
        match encoding {
            // A digit and a separator each.
            Encoding::Ascii => 2 * self.properties.len(),
            _ => self
                .properties
                .iter()
                .map(|property| property.list_count.unwrap_or(property.scalar).size())
                .sum(),
        }
    }

    pub fn property(&self, name: &str) -> Option<usize> {
        self.properties.iter().position(|property| property.name == name)
    }
}

/// A parsed header.
#[derive(Debug, Clone)]
pub(super) struct Header {
    pub encoding: Encoding,
    pub elements: Vec<Element>,
    /// Where the numbers begin.
    pub byte_count: usize,
    pub line_count: usize,
}

impl Header {
    pub fn parse(bytes: &[u8]) -> Result<Self, Fault> {
        let mut lines = HeaderLines { bytes, offset: 0, line: 0 };
        let first = lines.next_line()?;
        if first != "ply" {
            return Err(Fault {
                place: Place::Line(1),
                problem: Problem::WrongStart { looks_like: super::Format::sniff(bytes) },
            });
        }
        let mut encoding = None;
        let mut elements: Vec<Element> = Vec::new();
        loop {
            let text = lines.next_line()?;
            let place = Place::Line(lines.line);
            let fault = |problem| Fault { place, problem };
            let unexpected =
                |expected| fault(Problem::Unexpected { expected, found: shortened(text.as_bytes()) });
            let words: Vec<&str> = text.split_ascii_whitespace().collect();
            match words.as_slice() {
                [] | ["comment" | "obj_info", ..] => {}
                ["end_header"] => break,
                ["format", name, "1.0"] if encoding.is_none() => {
                    encoding = Some(match *name {
                        "ascii" => Encoding::Ascii,
                        "binary_little_endian" => Encoding::LittleEndian,
                        "binary_big_endian" => Encoding::BigEndian,
                        _ => return Err(unexpected("ascii, binary_little_endian or binary_big_endian")),
                    });
                }
                ["format", ..] => return Err(unexpected("one line `format <encoding> 1.0`")),
                ["element", name, count] => {
                    if elements.iter().any(|element| element.name == *name) {
                        return Err(fault(Problem::Repeated { what: format!("element {name}") }));
                    }
                    let count = count
                        .parse()
                        .map_err(|_| unexpected("`element <name> <count>` with a whole count"))?;
                    elements.push(Element { name: (*name).to_owned(), count, properties: Vec::new() });
                }
                ["property", kind @ .., name] => {
                    let property = parse_property(kind, name).ok_or_else(|| {
                        unexpected("`property <type> <name>` or `property list <count type> <type> <name>`")
                    })?;
                    let element =
                        elements.last_mut().ok_or_else(|| unexpected("an element before its properties"))?;
                    if element.property(name).is_some() {
                        return Err(fault(Problem::Repeated { what: format!("property {name}") }));
                    }
                    element.properties.push(property);
                }
                _ => return Err(unexpected("format, element, property, comment or end_header")),
            }
        }
        let encoding = encoding.ok_or_else(|| Fault {
            place: Place::Line(lines.line),
            problem: Problem::Missing { what: "the line `format <encoding> 1.0`".to_owned() },
        })?;
        Ok(Self { encoding, elements, byte_count: lines.offset, line_count: lines.line })
    }
}

fn parse_property(kind: &[&str], name: &str) -> Option<Property> {
    let (list_count, scalar) = match kind {
        ["list", count, scalar] => {
            // A fraction counts nothing.
            let count = Scalar::parse(count).filter(|count| count.integer_range().is_some())?;
            (Some(count), Scalar::parse(scalar)?)
        }
        [scalar] => (None, Scalar::parse(scalar)?),
        _ => return None,
    };
    Some(Property { name: name.to_owned(), list_count, scalar })
}

struct HeaderLines<'a> {
    bytes: &'a [u8],
    offset: usize,
    line: usize,
}

impl<'a> HeaderLines<'a> {
    fn next_line(&mut self) -> Result<&'a str, Fault> {
        self.line += 1;
        let rest = &self.bytes[self.offset..];
        let place = Place::Line(self.line);
        let Some(length) = rest.iter().position(|&byte| byte == b'\n') else {
            let problem = if self.line == 1 {
                Problem::WrongStart { looks_like: super::Format::sniff(self.bytes) }
            } else {
                Problem::EndsInside { part: "header" }
            };
            return Err(Fault { place, problem });
        };
        self.offset += length + 1;
        let text = rest[..length].strip_suffix(b"\r").unwrap_or(&rest[..length]);
        std::str::from_utf8(text).map(str::trim_end).or_else(|_| {
            // Comments may hold any bytes; keywords may not.
            if text.starts_with(b"comment") || text.starts_with(b"obj_info") {
                Ok("comment")
            } else {
                Err(Fault {
                    place,
                    problem: Problem::Unexpected {
                        expected: "a header line of text",
                        found: shortened(text),
                    },
                })
            }
        })
    }
}
