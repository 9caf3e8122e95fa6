//! Files of surfaces, read with errors that name the place and written so that reading gives the same back.

mod content;
mod error;
mod ply_header;
mod ply_read;
mod ply_write;

use std::fmt;
use std::path::Path;

use crate::mesh::{PointCloud, Surface, TriangleMesh};
use content::Content;

pub use error::{ContentError, Place, Problem, ReadError, WriteError};
pub use ply_write::{PlyContent, ply_bytes};

/// A file format.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// Stanford polygons: ascii, little-endian or big-endian.
    Ply,
}

impl Format {
    /// The format that a file's extension names, upper or lower case.
    pub fn of_path(path: &Path) -> Option<Self> {
        match path.extension()?.to_str()?.to_ascii_lowercase().as_str() {
            "ply" => Some(Self::Ply),
            _ => None,
        }
    }

    /// The format that the first bytes suggest.
    pub(crate) fn sniff(bytes: &[u8]) -> Option<Self> {
        bytes.starts_with(b"ply").then_some(Self::Ply)
    }
}

impl fmt::Display for Format {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(match self {
            Self::Ply => "PLY",
        })
    }
}

/// What reading a file changed or left out, so that nothing is silent.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ReadReport {
    /// The format that was read.
    pub format: Format,
    /// The faces in the file, of any number of corners.
    pub polygon_count: usize,
    /// The faces with more than three corners, which became fans of triangles.
    pub fanned_polygon_count: usize,
    /// The faces or triangles of fans that name a vertex twice and were dropped.
    pub degenerate_face_count: usize,
    /// The vertices that were joined to another at the same place.
    pub joined_vertex_count: usize,
    /// The points whose normal is not finite or zero; if there are any, all normals were left out.
    pub unusable_normal_count: usize,
}

impl ReadReport {
    fn new(format: Format) -> Self {
        Self {
            format,
            polygon_count: 0,
            fanned_polygon_count: 0,
            degenerate_face_count: 0,
            joined_vertex_count: 0,
            unusable_normal_count: 0,
        }
    }
}

/// Reads a mesh, or a point cloud where the file has no faces; the extension tells the format.
pub fn read_surface(path: &Path) -> Result<Surface, ReadError> {
    read_surface_with_report(path).map(|(surface, _)| surface)
}

/// Reads a surface and tells what was changed or left out.
pub fn read_surface_with_report(path: &Path) -> Result<(Surface, ReadReport), ReadError> {
    let format = Format::of_path(path).ok_or_else(|| ReadError::UnknownFormat { path: path.to_owned() })?;
    let bytes = std::fs::read(path).map_err(|source| ReadError::Io { path: path.to_owned(), source })?;
    read_surface_bytes(format, &bytes, path)
}

/// Reads a mesh; a file without faces is an error.
pub fn read_mesh(path: &Path) -> Result<TriangleMesh, ReadError> {
    match read_surface(path)? {
        Surface::Mesh(mesh) => Ok(mesh),
        Surface::Cloud(cloud) => {
            Err(ReadError::CloudInsteadOfMesh { path: path.to_owned(), point_count: cloud.positions().len() })
        }
    }
}

/// Reads a surface from memory; `name` only serves the messages.
pub fn read_surface_bytes(
    format: Format,
    bytes: &[u8],
    name: &Path,
) -> Result<(Surface, ReadReport), ReadError> {
    let content = match format {
        Format::Ply => ply_read::read(bytes),
    }
    .map_err(|fault| ReadError::Malformed {
        path: name.to_owned(),
        format,
        place: fault.place,
        problem: fault.problem,
    })?;
    let Content { positions, normals, faces, report, .. } = content;
    let surface = if faces.is_empty() {
        PointCloud::new(positions, normals).map(Surface::Cloud)
    } else {
        TriangleMesh::new(positions, faces).map(Surface::Mesh)
    }
    .map_err(|source| ReadError::Surface { path: name.to_owned(), source })?;
    Ok((surface, report))
}

/// Writes a mesh in the format that the extension names.
pub fn write_mesh(path: &Path, mesh: &TriangleMesh) -> Result<(), WriteError> {
    let bytes = match Format::of_path(path) {
        Some(Format::Ply) => ply_bytes(PlyContent {
            positions: mesh.positions(),
            faces: mesh.faces(),
            ..PlyContent::default()
        }),
        None => return Err(WriteError::UnknownFormat { path: path.to_owned() }),
    };
    write_content(path, bytes)
}

/// Writes a PLY mesh with one colour (red, green, blue) per vertex.
pub fn write_ply_with_colors(path: &Path, mesh: &TriangleMesh, colors: &[[u8; 3]]) -> Result<(), WriteError> {
    let content = PlyContent {
        positions: mesh.positions(),
        faces: mesh.faces(),
        colors: Some(colors),
        ..PlyContent::default()
    };
    write_content(path, ply_bytes(content))
}

/// Writes a PLY point cloud with its normals.
pub fn write_cloud(path: &Path, cloud: &PointCloud) -> Result<(), WriteError> {
    let content =
        PlyContent { positions: cloud.positions(), normals: cloud.normals(), ..PlyContent::default() };
    write_content(path, ply_bytes(content))
}

fn write_content(path: &Path, bytes: Result<Vec<u8>, ContentError>) -> Result<(), WriteError> {
    let bytes = bytes.map_err(|source| WriteError::Content { path: path.to_owned(), source })?;
    ply_write::write_whole(path, &bytes).map_err(|source| WriteError::Io { path: path.to_owned(), source })
}
