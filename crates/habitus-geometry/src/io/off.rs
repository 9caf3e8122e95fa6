//! Reads OFF (Geomview), with normals (`NOFF`) and colours (`COFF`), as text.

use super::Format;
use super::content::Content;
use super::error::{Fault, Place, Problem, shortened};
use super::text::{Line, Lines, missing};

/// Reads the vertices, normals and polygons of an OFF file.
pub(super) fn read(bytes: &[u8]) -> Result<Content, Fault> {
    let mut lines = Lines::plain(bytes);
    let (has_normals, mut counts) = read_keyword(&mut lines, bytes)?;
    let vertex_count = counts.next_count("the vertex count")?;
    let face_count = counts.next_count("the face count")?;
    // A row of three digits and one of a count and a digit are the shortest that there are.
    check_count(vertex_count, "vertices", 6, bytes, counts.place)?;
    check_count(face_count, "faces", 2, bytes, counts.place)?;

    let mut content = Content::new(Format::Off);
    let mut normals = Vec::new();
    for index in 0..vertex_count {
        let mut line = next_row(&mut lines, "vertex", index, vertex_count)?;
        let place = line.place;
        content.add_position(line.next_vector("a vertex coordinate")?, place)?;
        if has_normals {
            normals.push(line.next_vector("a normal's coordinate")?);
        }
    }
    let mut corners = Vec::new();
    for index in 0..face_count {
        let mut line = next_row(&mut lines, "face", index, face_count)?;
        let place = line.place;
        corners.clear();
        for _ in 0..line.next_count("the number of corners")? {
            let vertex = line.next_count("a corner of this face")?;
            corners.push(
                u32::try_from(vertex).ok().filter(|&vertex| u64::from(vertex) < vertex_count).ok_or(
                    Fault {
                        place,
                        problem: Problem::VertexOutOfRange {
                            face: index as usize,
                            vertex: i64::try_from(vertex).unwrap_or(i64::MAX),
                            vertex_count: vertex_count as usize,
                        },
                    },
                )?,
            );
        }
        content.add_polygon(&corners, place);
    }
    if let Some(line) = lines.next_line() {
        return Err(Fault { place: line.place, problem: Problem::LeftOver });
    }
    content.normals = (has_normals && !normals.is_empty()).then_some(normals);
    content.finish(lines.place())
}

/// Whether there are normals, and the line with the counts, which may begin with the keyword.
fn read_keyword<'a>(lines: &mut Lines<'a>, bytes: &[u8]) -> Result<(bool, Line<'a>), Fault> {
    let wrong_start =
        || Fault { place: Place::Line(1), problem: Problem::WrongStart { looks_like: Format::sniff(bytes) } };
    let mut line = lines.next_line().ok_or_else(wrong_start)?;
    let place = line.place;
    let keyword = shortened(line.next_word().unwrap_or_default());
    let has_normals = match keyword.as_str() {
        "OFF" | "COFF" | "STOFF" | "STCOFF" => false,
        "NOFF" | "CNOFF" | "STNOFF" | "STCNOFF" => true,
        "4OFF" | "nOFF" | "4nOFF" | "C4OFF" => {
            let problem = Problem::Unsupported {
                what: format!("{keyword} with other than three coordinates"),
                remedy: "save as plain OFF",
            };
            return Err(Fault { place, problem });
        }
        _ => return Err(wrong_start()),
    };
    // A copy looks ahead, for the counts may stand here or on the next line.
    let mut ahead = line.clone();
    match ahead.next_word() {
        Some(b"BINARY") => {
            let problem =
                Problem::Unsupported { what: "binary OFF".to_owned(), remedy: "save as text OFF or as PLY" };
            Err(Fault { place, problem })
        }
        Some(_) => Ok((has_normals, line)),
        None => Ok((has_normals, lines.next_line().ok_or_else(|| missing(place, "the line of counts"))?)),
    }
}

fn check_count(declared: u64, element: &str, row: usize, bytes: &[u8], place: Place) -> Result<(), Fault> {
    let possible = (bytes.len() / row) as u64;
    if declared <= possible {
        return Ok(());
    }
    Err(Fault {
        place,
        problem: Problem::CountBeyondFile { element: element.to_owned(), declared, possible },
    })
}

fn next_row<'a>(lines: &mut Lines<'a>, element: &str, index: u64, declared: u64) -> Result<Line<'a>, Fault> {
    let line = lines.next_line();
    let problem = Problem::EndsEarly {
        element: element.to_owned(),
        index: index as usize,
        declared: declared as usize,
    };
    line.ok_or(Fault { place: lines.place(), problem })
}
