//! Reads STL, ascii and binary. Its triangles share no vertices, so those at exactly the same place are joined.

use std::collections::HashMap;

use glam::DVec3;

use super::Format;
use super::content::Content;
use super::error::{Fault, Place, Problem};
use super::text::{Line, Lines, missing, unexpected};

/// Bytes before the first triangle of a binary file: a free text of 80 and the count.
const HEADER_SIZE: usize = 84;
/// Bytes of a binary triangle: a normal, three corners and two bytes that mean nothing.
const TRIANGLE_SIZE: usize = 50;

/// Reads the triangles of an STL file.
pub(super) fn read(bytes: &[u8]) -> Result<Content, Fault> {
    if is_ascii(bytes) { read_ascii(bytes) } else { read_binary(bytes) }
}

/// Binary files may also begin with "solid"; zeros and the length give them away.
fn is_ascii(bytes: &[u8]) -> bool {
    let is_exact_binary = declared_count(bytes).is_some_and(|count| {
        bytes.len() as u64 == HEADER_SIZE as u64 + u64::from(count) * TRIANGLE_SIZE as u64
    });
    bytes.trim_ascii_start().starts_with(b"solid")
        && !is_exact_binary
        && !bytes[..bytes.len().min(HEADER_SIZE)].contains(&0)
}

fn declared_count(bytes: &[u8]) -> Option<u32> {
    bytes.get(80..)?.first_chunk().map(|count| u32::from_le_bytes(*count))
}

/// Joins corners at the same place while triangles are added.
struct Corners {
    content: Content,
    vertices: HashMap<[u64; 3], u32>,
}

impl Corners {
    fn new() -> Self {
        Self { content: Content::new(Format::Stl), vertices: HashMap::new() }
    }

    fn vertex(&mut self, position: DVec3, place: Place) -> Result<u32, Fault> {
        // Adding zero makes −0 equal to 0.
        let key = position.to_array().map(|coordinate| (coordinate + 0.0).to_bits());
        if let Some(&vertex) = self.vertices.get(&key) {
            self.content.report.joined_vertex_count += 1;
            return Ok(vertex);
        }
        let vertex = self.content.positions.len() as u32;
        self.content.add_position(position, place)?;
        self.vertices.insert(key, vertex);
        Ok(vertex)
    }
}

fn read_binary(bytes: &[u8]) -> Result<Content, Fault> {
    let end = Place::Byte(bytes.len());
    let Some(count) = declared_count(bytes) else {
        let problem = if bytes.len() < 5 || bytes.starts_with(b"solid") {
            Problem::EndsInside { part: "header" }
        } else {
            Problem::WrongStart { looks_like: Format::sniff(bytes) }
        };
        return Err(Fault { place: end, problem });
    };
    let count = count as usize;
    let triangles = &bytes[HEADER_SIZE..];
    let possible = triangles.len() / TRIANGLE_SIZE;
    if count > possible {
        let problem = match Format::sniff(bytes) {
            Some(other) => Problem::WrongStart { looks_like: Some(other) },
            None => Problem::CountBeyondFile {
                element: "triangle".to_owned(),
                declared: count as u64,
                possible: possible as u64,
            },
        };
        return Err(Fault { place: Place::Byte(80), problem });
    }
    let (triangles, left_over) = triangles.split_at(count * TRIANGLE_SIZE);
    if left_over.iter().any(|&byte| byte != 0) {
        let place = Place::Byte(HEADER_SIZE + count * TRIANGLE_SIZE);
        return Err(Fault { place, problem: Problem::LeftOver });
    }
    let mut corners = Corners::new();
    for (index, triangle) in triangles.chunks_exact(TRIANGLE_SIZE).enumerate() {
        let place = Place::Byte(HEADER_SIZE + index * TRIANGLE_SIZE);
        let mut face = [0; 3];
        for (corner, position) in face.iter_mut().zip(triangle[12..48].chunks_exact(12)) {
            *corner = corners.vertex(single_precision_vector(position), place)?;
        }
        corners.content.add_polygon(&face, place);
    }
    corners.content.finish(end)
}

fn single_precision_vector(bytes: &[u8]) -> DVec3 {
    let coordinate = |axis: usize| {
        bytes[4 * axis..].first_chunk().map_or(f64::NAN, |bytes| f64::from(f32::from_le_bytes(*bytes)))
    };
    DVec3::new(coordinate(0), coordinate(1), coordinate(2))
}

fn read_ascii(bytes: &[u8]) -> Result<Content, Fault> {
    let mut lines = Lines::plain(bytes);
    let mut corners = Corners::new();
    let mut solid_is_open = false;
    while let Some(mut line) = lines.next_line() {
        let place = line.place;
        match line.next_word() {
            Some(b"solid") if !solid_is_open => solid_is_open = true,
            Some(b"endsolid") if solid_is_open => solid_is_open = false,
            Some(b"facet") if solid_is_open => read_facet(&mut lines, &mut corners, place)?,
            Some(word) if solid_is_open => return Err(unexpected(place, "`facet` or `endsolid`", word)),
            Some(word) => return Err(unexpected(place, "`solid`", word)),
            None => {}
        }
    }
    if solid_is_open {
        let problem = Problem::EndsInside { part: "last solid (no `endsolid`)" };
        return Err(Fault { place: lines.place(), problem });
    }
    corners.content.finish(lines.place())
}

fn read_facet(lines: &mut Lines<'_>, corners: &mut Corners, place: Place) -> Result<(), Fault> {
    expect(next_in_facet(lines)?, &[b"outer", b"loop"], "`outer loop`")?;
    let mut face = Vec::with_capacity(3);
    loop {
        let mut line = next_in_facet(lines)?;
        let at = line.place;
        match line.next_word() {
            Some(b"vertex") => {
                let position = line.next_vector("a vertex coordinate")?;
                face.push(corners.vertex(position, at)?);
            }
            Some(b"endloop") => break,
            Some(word) => return Err(unexpected(at, "`vertex` or `endloop`", word)),
            None => {}
        }
    }
    if face.len() < 3 {
        return Err(missing(place, "a corner of this facet"));
    }
    expect(next_in_facet(lines)?, &[b"endfacet"], "`endfacet`")?;
    corners.content.add_polygon(&face, place);
    Ok(())
}

fn next_in_facet<'a>(lines: &mut Lines<'a>) -> Result<Line<'a>, Fault> {
    let line = lines.next_line();
    let place = lines.place();
    line.ok_or(Fault { place, problem: Problem::EndsInside { part: "last facet" } })
}

fn expect(mut line: Line<'_>, words: &[&[u8]], expected: &'static str) -> Result<(), Fault> {
    let place = line.place;
    for word in words {
        match line.next_word() {
            Some(found) if found == *word => {}
            found => return Err(unexpected(place, expected, found.unwrap_or_default())),
        }
    }
    Ok(())
}
