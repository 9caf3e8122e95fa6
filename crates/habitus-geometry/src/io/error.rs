//! What can be wrong with a file, and where.

use std::fmt;
use std::path::PathBuf;

use thiserror::Error;

use super::Format;
use crate::mesh::MeshError;

/// Why a file could not be read as a surface.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum ReadError {
    /// The file could not be opened or read at all.
    #[error("cannot read {path}: {source}", path = path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The extension names no format that is known.
    #[error("cannot tell the format of {path}: use the extension .ply, .obj, .stl, .off or .glb", path = path.display())]
    UnknownFormat {
        /// The file.
        path: PathBuf,
    },
    /// The content breaks the rules of its format.
    #[error("{path} is not a usable {format} file: at {place}: {problem}", path = path.display())]
    Malformed {
        /// The file.
        path: PathBuf,
        /// The format that it was read as.
        format: Format,
        /// Where the problem is.
        place: Place,
        /// What the problem is.
        problem: Problem,
    },
    /// The content was read but is no valid surface.
    #[error("{path} holds no usable surface: {source}", path = path.display())]
    Surface {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        source: MeshError,
    },
    /// A mesh was asked for, and the file has points only.
    #[error("{path} has {point_count} points but no faces, and a mesh is needed here", path = path.display())]
    CloudInsteadOfMesh {
        /// The file.
        path: PathBuf,
        /// How many points it has.
        point_count: usize,
    },
}

/// A place in a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Place {
    /// A line of text, counted from 1.
    Line(usize),
    /// An offset in bytes from the start.
    Byte(usize),
    /// An object in a list of a glTF description, such as `accessors[3]`.
    Object(&'static str, usize),
}

impl fmt::Display for Place {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Line(line) => write!(formatter, "line {line}"),
            Self::Byte(byte) => write!(formatter, "byte {byte}"),
            Self::Object(list, index) => write!(formatter, "{list}[{index}]"),
        }
    }
}

/// What is wrong at a place in a file.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum Problem {
    /// The first bytes are not those of the format.
    #[error("this does not begin like such a file{}", looks_like.map_or(String::new(), |format| format!(" but like {format}; rename it")))]
    WrongStart {
        /// The format that the first bytes suggest.
        looks_like: Option<Format>,
    },
    /// The file stops in the middle of something.
    #[error("the file ends inside {element} {index} of {declared}; it was probably cut off while copying")]
    EndsEarly {
        /// What was being read.
        element: String,
        /// Which one, counted from 0.
        index: usize,
        /// How many the file promised.
        declared: usize,
    },
    /// The file stops in the middle of its header or structure.
    #[error("the file ends inside its {part}; it was probably cut off while copying")]
    EndsInside {
        /// The part that is not complete.
        part: &'static str,
    },
    /// A count promises more than the file can hold.
    #[error("{declared} of {element} are declared, but the rest of the file can hold at most {possible}")]
    CountBeyondFile {
        /// What is counted.
        element: String,
        /// How many the file promises.
        declared: u64,
        /// How many could fit into what follows.
        possible: u64,
    },
    /// Content is left over after everything that was declared.
    #[error("content is left over after the last declared element; the declared counts are wrong")]
    LeftOver,
    /// A word is not what the format asks for here.
    #[error("expected {expected}, found {found:?}")]
    Unexpected {
        /// What the format asks for.
        expected: &'static str,
        /// What stands there, shortened.
        found: String,
    },
    /// Something needed is missing.
    #[error("{what} is missing")]
    Missing {
        /// What is missing.
        what: String,
    },
    /// Something is there twice.
    #[error("{what} appears twice")]
    Repeated {
        /// What is repeated.
        what: String,
    },
    /// A coordinate is infinite or not a number.
    #[error("vertex {vertex} has a coordinate that is not finite")]
    NonFiniteVertex {
        /// The vertex, counted from 0.
        vertex: usize,
    },
    /// A face names a vertex that does not exist.
    #[error(
        "face {face} names vertex {vertex}, but there are only {vertex_count} vertices (both counted from 0)"
    )]
    VertexOutOfRange {
        /// The face, counted from 0.
        face: usize,
        /// The vertex that it names.
        vertex: i64,
        /// How many vertices there are.
        vertex_count: usize,
    },
    /// The faces are there, but none has an area.
    #[error("all {face_count} faces name a vertex twice; none is left")]
    OnlyDegenerateFaces {
        /// How many faces the file has.
        face_count: usize,
    },
    /// The format allows it, but it is not read here.
    #[error("{what} is not supported; {remedy}")]
    Unsupported {
        /// What the file uses.
        what: String,
        /// What to do instead.
        remedy: &'static str,
    },
}

/// Why a surface could not be written.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum WriteError {
    /// The extension names no format that can be written.
    #[error("cannot write {path}: use the extension .ply, .obj or .glb", path = path.display())]
    UnknownFormat {
        /// The file.
        path: PathBuf,
    },
    /// The file could not be created or written.
    #[error("cannot write {path}: {source}", path = path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// What was to be written does not fit the format.
    #[error("cannot write {path}: {source}", path = path.display())]
    Content {
        /// The file.
        path: PathBuf,
        /// What does not fit.
        source: ContentError,
    },
}

/// Why content does not fit a format.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum ContentError {
    /// Not one value per vertex.
    #[error("{found} {what} for {expected} vertices; give one for each")]
    CountMismatch {
        /// What the list holds.
        what: &'static str,
        /// The number of vertices.
        expected: usize,
        /// The length that was given.
        found: usize,
    },
    /// The format keeps 32-bit floats and the value is beyond them.
    #[error("{what} {index} is beyond the range of 32-bit floats that the format keeps")]
    BeyondSinglePrecision {
        /// What the value belongs to.
        what: &'static str,
        /// Which one, counted from 0.
        index: usize,
    },
    /// The file would be larger than its format can say.
    #[error(
        "the content needs {byte_count} bytes, more than the 4 GiB that the format can address; split it"
    )]
    TooLarge {
        /// How many bytes are needed.
        byte_count: usize,
    },
}

/// A problem with its place, before the file's name is known.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Fault {
    pub place: Place,
    pub problem: Problem,
}

/// A word of a file, made short enough for a message.
pub(super) fn shortened(word: &[u8]) -> String {
    const LONGEST: usize = 40;
    let text = String::from_utf8_lossy(&word[..word.len().min(LONGEST)]).into_owned();
    if word.len() > LONGEST { text + "…" } else { text }
}
