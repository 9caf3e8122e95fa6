//! Reads and writes Wavefront OBJ: vertices keep their order, also those that no face names.

use std::fmt::Write;

use glam::DVec3;

use super::Format;
use super::content::Content;
use super::error::{Fault, Place, Problem};
use super::text::{Lines, missing, unexpected};
use crate::mesh::TriangleMesh;

/// Statements that change nothing about positions and faces.
const IGNORED: [&[u8]; 23] = [
    b"vt",
    b"vp",
    b"g",
    b"o",
    b"s",
    b"mg",
    b"usemtl",
    b"mtllib",
    b"usemap",
    b"maplib",
    b"l",
    b"p",
    b"bevel",
    b"c_interp",
    b"d_interp",
    b"lod",
    b"shadow_obj",
    b"trace_obj",
    b"cstype",
    b"deg",
    b"bmat",
    b"step",
    b"end",
];
/// Statements that make geometry which is not read here.
const FREE_FORM: [&[u8]; 4] = [b"surf", b"curv", b"curv2", b"call"];

/// Reads positions, normals (for clouds) and polygons.
pub(super) fn read(bytes: &[u8]) -> Result<Content, Fault> {
    let mut content = Content::new(Format::Obj);
    let mut normals = Vec::new();
    let mut corners = Vec::new();
    let mut lines = Lines::continued(bytes);
    while let Some(mut line) = lines.next_line() {
        let place = line.place;
        match line.next_word() {
            Some(b"v") => {
                let position = line.next_vector("a vertex coordinate")?;
                content.add_position(position, place)?;
            }
            Some(b"vn") => normals.push(line.next_vector("a normal's coordinate")?),
            Some(b"f" | b"fo") => {
                corners.clear();
                while let Some(word) = line.next_word() {
                    corners.push(corner(word, &content, place)?);
                }
                if corners.is_empty() {
                    return Err(missing(place, "every corner of the face"));
                }
                content.add_polygon(&corners, place);
            }
            Some(word) if FREE_FORM.contains(&word) => {
                let what = format!("the free-form statement `{}`", String::from_utf8_lossy(word));
                let problem = Problem::Unsupported { what, remedy: "save the surface as polygons" };
                return Err(Fault { place, problem });
            }
            Some(word) if !IGNORED.contains(&word) => {
                return Err(unexpected(
                    place,
                    "an OBJ statement such as v, vn, vt, f, g, o, s or usemtl",
                    word,
                ));
            }
            _ => {}
        }
    }
    // Normals of a mesh belong to corners, not vertices; a cloud's can only be meant one by one.
    if content.report.polygon_count == 0 && !normals.is_empty() && normals.len() == content.positions.len() {
        content.normals = Some(normals);
    }
    content.finish(lines.place())
}

/// The vertex of a corner `v`, `v/vt`, `v//vn` or `v/vt/vn`; negative numbers count back from the last vertex.
fn corner(word: &[u8], content: &Content, place: Place) -> Result<u32, Fault> {
    let refuse = || unexpected(place, "a corner such as 7, 7/2, 7//3 or -1 (vertices count from 1)", word);
    let mut parts = word.split(|&byte| byte == b'/');
    let vertex = whole_number(parts.next().unwrap_or_default()).ok_or_else(refuse)?;
    let attributes: Vec<&[u8]> = parts.collect();
    let are_whole = attributes.iter().all(|part| part.is_empty() || whole_number(part).is_some());
    if vertex == 0 || attributes.len() > 2 || !are_whole {
        return Err(refuse());
    }
    let vertex_count = content.positions.len();
    let from_zero = if vertex > 0 { vertex - 1 } else { vertex_count as i64 + vertex };
    u32::try_from(from_zero).map_err(|_| Fault {
        place,
        problem: Problem::VertexOutOfRange {
            face: content.report.polygon_count,
            vertex: from_zero,
            vertex_count,
        },
    })
}

fn whole_number(word: &[u8]) -> Option<i64> {
    let number: i64 = std::str::from_utf8(word).ok()?.parse().ok()?;
    // Keeps sums with vertex counts away from overflow.
    (number.unsigned_abs() <= 1 << 40).then_some(number)
}

/// The text of an OBJ file; positions are written in the shortest form that reads back the same.
pub fn obj_text(mesh: &TriangleMesh) -> String {
    let mut text = String::with_capacity(64 * mesh.positions().len() + 24 * mesh.faces().len());
    for DVec3 { x, y, z } in mesh.positions() {
        // Writing to a string cannot fail.
        let _ = writeln!(text, "v {x} {y} {z}");
    }
    for [a, b, c] in mesh.faces() {
        let _ = writeln!(text, "f {} {} {}", u64::from(*a) + 1, u64::from(*b) + 1, u64::from(*c) + 1);
    }
    text
}
