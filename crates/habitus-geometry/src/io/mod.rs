//! Files of surfaces, read with errors that name the place and written so that reading gives the same back.

mod content;
mod error;
pub mod glb;
mod glb_read;
mod glb_write;
mod obj;
mod off;
mod ply_header;
mod ply_read;
mod ply_write;
mod stl;
mod text;
mod write;

use std::fmt;
use std::path::Path;

use crate::mesh::{PointCloud, Surface, TriangleMesh};
use content::Content;

pub use error::{ContentError, Place, Problem, ReadError, WriteError};
pub use glb_write::{MeshToGlb, glb_bytes};
pub use obj::obj_text;
pub use ply_write::{PlyContent, ply_bytes};
pub use write::{write_cloud, write_mesh, write_ply_with_colors, write_whole};

/// A file format.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// Stanford polygons: ascii, little-endian or big-endian.
    Ply,
    /// Wavefront objects.
    Obj,
    /// Stereolithography: ascii or binary.
    Stl,
    /// Geomview's object file format, as text.
    Off,
    /// glTF 2.0 in its binary container.
    Glb,
}

impl Format {
    /// The format that a file's extension names, upper or lower case.
    pub fn of_path(path: &Path) -> Option<Self> {
        match path.extension()?.to_str()?.to_ascii_lowercase().as_str() {
            "ply" => Some(Self::Ply),
            "obj" => Some(Self::Obj),
            "stl" => Some(Self::Stl),
            "off" => Some(Self::Off),
            "glb" => Some(Self::Glb),
            _ => None,
        }
    }

    /// The format that the first bytes suggest.
    pub(crate) fn sniff(bytes: &[u8]) -> Option<Self> {
        let is_off = bytes.starts_with(b"OFF") || bytes.get(1..4) == Some(b"OFF");
        let starts: [(&[u8], Self); 5] = [
            (b"ply\n", Self::Ply),
            (b"ply\r", Self::Ply),
            (b"glTF", Self::Glb),
            (b"solid ", Self::Stl),
            (b"v ", Self::Obj),
        ];
        let found = starts.iter().find(|(start, _)| bytes.starts_with(start)).map(|(_, format)| *format);
        found.or(is_off.then_some(Self::Off))
    }
}

impl fmt::Display for Format {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(match self {
            Self::Ply => "PLY",
            Self::Obj => "OBJ",
            Self::Stl => "STL",
            Self::Off => "OFF",
            Self::Glb => "GLB",
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
        Format::Obj => obj::read(bytes),
        Format::Stl => stl::read(bytes),
        Format::Off => off::read(bytes),
        Format::Glb => glb_read::read(bytes),
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
