//! Reads PLY: ascii and both binary encodings, any scalar types, lists anywhere.

use glam::DVec3;

use super::Format;
use super::content::Content;
use super::error::{Fault, Place, Problem, shortened};
use super::ply_header::{Element, Encoding, Header, Scalar};

/// The two names in use for the list of a face's corners.
const CORNER_LISTS: [&str; 2] = ["vertex_indices", "vertex_index"];

/// Reads the vertices, normals and faces of a PLY file.
pub(super) fn read(bytes: &[u8]) -> Result<Content, Fault> {
    let header = Header::parse(bytes)?;
    let mut numbers = match header.encoding {
        Encoding::Ascii => Numbers::Text(TextRows::new(bytes, &header)),
        encoding => Numbers::Binary(BinaryRows {
            bytes,
            offset: header.byte_count,
            is_big_endian: encoding == Encoding::BigEndian,
        }),
    };
    let mut content = Content::new(Format::Ply);
    let mut has_vertices = false;
    for element in &header.elements {
        numbers.check_count(element, header.encoding)?;
        match element.name.as_str() {
            "vertex" => {
                has_vertices = true;
                read_vertices(&mut numbers, element, &mut content)?;
            }
            "face" => read_faces(&mut numbers, element, &mut content)?,
            "tristrips" if element.count > 0 => {
                let what = "a table of triangle strips".to_owned();
                let problem = Problem::Unsupported { what, remedy: "save the mesh with plain faces" };
                return Err(Fault { place: numbers.place(), problem });
            }
            _ => skip_rows(&mut numbers, element)?,
        }
    }
    if !has_vertices {
        let problem = Problem::Missing { what: "the element `vertex`".to_owned() };
        return Err(Fault { place: Place::Line(header.line_count), problem });
    }
    numbers.check_end()?;
    content.finish(numbers.place())
}

fn read_vertices(numbers: &mut Numbers, element: &Element, content: &mut Content) -> Result<(), Fault> {
    let column =
        |name: &str| element.property(name).filter(|&place| element.properties[place].list_count.is_none());
    let mut columns = [0; 3];
    for (place, name) in columns.iter_mut().zip(["x", "y", "z"]) {
        *place = column(name).ok_or_else(|| Fault {
            place: numbers.place(),
            problem: Problem::Missing { what: format!("the vertex property `{name}`") },
        })?;
    }
    let normal_columns = match (column("nx"), column("ny"), column("nz")) {
        (Some(x), Some(y), Some(z)) => Some([x, y, z]),
        _ => None,
    };
    content.positions.reserve(element.count);
    let mut normals = Vec::with_capacity(if normal_columns.is_some() { element.count } else { 0 });
    let mut row = vec![0.0; element.properties.len()];
    for index in 0..element.count {
        let place = numbers.begin_row(element, index)?;
        read_row(numbers, element, index, &mut row, |_, _| Ok(()))?;
        content.add_position(DVec3::from(columns.map(|column| row[column])), place)?;
        if let Some(columns) = normal_columns {
            normals.push(DVec3::from(columns.map(|column| row[column])));
        }
    }
    if normal_columns.is_some() && element.count > 0 {
        content.normals = Some(normals);
    }
    Ok(())
}

fn read_faces(numbers: &mut Numbers, element: &Element, content: &mut Content) -> Result<(), Fault> {
    if element.count == 0 {
        return Ok(());
    }
    let corner_list = CORNER_LISTS
        .iter()
        .find_map(|name| element.property(name))
        .filter(|&place| element.properties[place].list_count.is_some())
        .ok_or_else(|| Fault {
            place: numbers.place(),
            problem: Problem::Missing { what: "the face property `list … vertex_indices`".to_owned() },
        })?;
    content.faces.reserve(element.count);
    let mut row = vec![0.0; element.properties.len()];
    let mut corners = Vec::new();
    for index in 0..element.count {
        let place = numbers.begin_row(element, index)?;
        corners.clear();
        read_row(numbers, element, index, &mut row, |property, value| {
            if property == corner_list {
                corners.push(vertex_index(value).ok_or_else(|| Fault {
                    place,
                    problem: Problem::Unexpected {
                        expected: "a vertex index counted from 0",
                        found: value.to_string(),
                    },
                })?);
            }
            Ok(())
        })?;
        content.add_polygon(&corners, place);
    }
    Ok(())
}

fn vertex_index(value: f64) -> Option<u32> {
    (value >= 0.0 && value <= f64::from(u32::MAX) && value.fract() == 0.0).then_some(value as u32)
}

fn skip_rows(numbers: &mut Numbers, element: &Element) -> Result<(), Fault> {
    // A table without columns takes no room, whatever its count says.
    if element.properties.is_empty() {
        return Ok(());
    }
    let mut row = vec![0.0; element.properties.len()];
    for index in 0..element.count {
        numbers.begin_row(element, index)?;
        read_row(numbers, element, index, &mut row, |_, _| Ok(()))?;
    }
    Ok(())
}

/// Reads one row: scalars into `row`, list items to `on_item` with their column.
fn read_row(
    numbers: &mut Numbers,
    element: &Element,
    index: usize,
    row: &mut [f64],
    mut on_item: impl FnMut(usize, f64) -> Result<(), Fault>,
) -> Result<(), Fault> {
    for (column, property) in element.properties.iter().enumerate() {
        let Some(count_scalar) = property.list_count else {
            row[column] = numbers.next(property.scalar, element, index)?;
            continue;
        };
        let item_count = numbers.next(count_scalar, element, index)?;
        if item_count < 0.0 {
            let found = item_count.to_string();
            let problem = Problem::Unexpected { expected: "a list length of 0 or more", found };
            return Err(Fault { place: numbers.place(), problem });
        }
        for _ in 0..item_count as u64 {
            on_item(column, numbers.next(property.scalar, element, index)?)?;
        }
    }
    numbers.end_row()
}

/// Numbers from either encoding.
enum Numbers<'a> {
    Text(TextRows<'a>),
    Binary(BinaryRows<'a>),
}

impl Numbers<'_> {
    fn place(&self) -> Place {
        match self {
            Self::Text(text) => Place::Line(text.line),
            Self::Binary(binary) => Place::Byte(binary.offset),
        }
    }

    /// Refuses counts that the rest of the file cannot hold, before anything is allocated for them.
    fn check_count(&self, element: &Element, encoding: Encoding) -> Result<(), Fault> {
        let remaining = match self {
            // The last separator may be missing.
            Self::Text(text) => text.rest.len() + 1,
            Self::Binary(binary) => binary.bytes.len() - binary.offset,
        };
        let smallest_row = element.smallest_row(encoding);
        if smallest_row == 0 || element.count <= remaining / smallest_row {
            return Ok(());
        }
        let problem = Problem::CountBeyondFile {
            element: element.name.clone(),
            declared: element.count as u64,
            possible: (remaining / smallest_row) as u64,
        };
        Err(Fault { place: self.place(), problem })
    }

    fn begin_row(&mut self, element: &Element, index: usize) -> Result<Place, Fault> {
        if let Self::Text(text) = self {
            text.begin_row(element, index)?;
        }
        Ok(self.place())
    }

    #[inline]
    fn next(&mut self, scalar: Scalar, element: &Element, index: usize) -> Result<f64, Fault> {
        match self {
            Self::Text(text) => text.next(scalar, element),
            Self::Binary(binary) => binary.next(scalar).ok_or_else(|| Fault {
                place: Place::Byte(binary.bytes.len()),
                problem: ends_early(element, index),
            }),
        }
    }

    fn end_row(&mut self) -> Result<(), Fault> {
        if let Self::Text(text) = self
            && let Some(word) = next_word(&mut text.row)
        {
            let problem = Problem::Unexpected { expected: "the end of the row", found: shortened(word) };
            return Err(Fault { place: self.place(), problem });
        }
        Ok(())
    }

    /// Only blanks (or the zeros of padding) may follow the last row.
    fn check_end(&self) -> Result<(), Fault> {
        let rest = match self {
            Self::Text(text) => text.rest,
            Self::Binary(binary) => &binary.bytes[binary.offset..],
        };
        if rest.iter().all(|&byte| byte.is_ascii_whitespace() || byte == 0) {
            return Ok(());
        }
        Err(Fault { place: self.place(), problem: Problem::LeftOver })
    }
}

fn ends_early(element: &Element, index: usize) -> Problem {
    Problem::EndsEarly { element: element.name.clone(), index, declared: element.count }
}

struct BinaryRows<'a> {
    bytes: &'a [u8],
    offset: usize,
    is_big_endian: bool,
}

impl BinaryRows<'_> {
    #[inline]
    fn next(&mut self, scalar: Scalar) -> Option<f64> {
        Some(match scalar {
            Scalar::I8 => f64::from(i8::from_le_bytes(self.take()?)),
            Scalar::U8 => f64::from(u8::from_le_bytes(self.take()?)),
            Scalar::I16 => f64::from(i16::from_le_bytes(self.take()?)),
            Scalar::U16 => f64::from(u16::from_le_bytes(self.take()?)),
            Scalar::I32 => f64::from(i32::from_le_bytes(self.take()?)),
            Scalar::U32 => f64::from(u32::from_le_bytes(self.take()?)),
            Scalar::F32 => f64::from(f32::from_le_bytes(self.take()?)),
            Scalar::F64 => f64::from_le_bytes(self.take()?),
        })
    }

    /// The next bytes in little-endian order.
    #[inline]
    fn take<const SIZE: usize>(&mut self) -> Option<[u8; SIZE]> {
        let mut taken: [u8; SIZE] = *self.bytes.get(self.offset..)?.first_chunk()?;
        self.offset += SIZE;
        if self.is_big_endian {
            taken.reverse();
        }
        Some(taken)
    }
}

struct TextRows<'a> {
    rest: &'a [u8],
    row: &'a [u8],
    line: usize,
}

impl<'a> TextRows<'a> {
    fn new(bytes: &'a [u8], header: &Header) -> Self {
        Self { rest: &bytes[header.byte_count..], row: &[], line: header.line_count }
    }

    /// Goes to the next line that is not blank.
    fn begin_row(&mut self, element: &Element, index: usize) -> Result<(), Fault> {
        loop {
            if self.rest.is_empty() {
                return Err(Fault { place: Place::Line(self.line), problem: ends_early(element, index) });
            }
            let length = self.rest.iter().position(|&byte| byte == b'\n').unwrap_or(self.rest.len());
            self.row = self.rest[..length].trim_ascii();
            self.rest = &self.rest[(length + 1).min(self.rest.len())..];
            self.line += 1;
            if !self.row.is_empty() {
                return Ok(());
            }
        }
    }

    fn next(&mut self, scalar: Scalar, element: &Element) -> Result<f64, Fault> {
        let fault = |problem| Fault { place: Place::Line(self.line), problem };
        let Some(word) = next_word(&mut self.row) else {
            let what = format!("a value of this {} row", element.name);
            return Err(fault(Problem::Missing { what }));
        };
        let unexpected = |expected| fault(Problem::Unexpected { expected, found: shortened(word) });
        let value: f64 = std::str::from_utf8(word)
            .ok()
            .and_then(|word| word.parse().ok())
            .ok_or_else(|| unexpected("a number"))?;
        match scalar.integer_range() {
            Some((lowest, highest)) if !(value.fract() == 0.0 && (lowest..=highest).contains(&value)) => {
                Err(unexpected("a whole number in the range of its type"))
            }
            _ => Ok(value),
        }
    }
}

/// Takes the next word off a row of text.
fn next_word<'a>(row: &mut &'a [u8]) -> Option<&'a [u8]> {
    let start = row.trim_ascii_start();
    if start.is_empty() {
        return None;
    }
    let length = start.iter().position(u8::is_ascii_whitespace).unwrap_or(start.len());
    let (word, rest) = start.split_at(length);
    *row = rest;
    Some(word)
}
