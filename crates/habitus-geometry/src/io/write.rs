//! Writes surfaces to files, whole or not at all.

use std::ffi::OsString;
use std::io::Write;
use std::path::Path;

use super::Format;
use super::error::{ContentError, WriteError};
use super::glb_write::{MeshToGlb, glb_bytes};
use super::obj::obj_text;
use super::ply_write::{PlyContent, ply_bytes};
use crate::mesh::{PointCloud, TriangleMesh};

/// Writes a mesh as PLY, OBJ or GLB, as the extension says.
pub fn write_mesh(path: &Path, mesh: &TriangleMesh) -> Result<(), WriteError> {
    let bytes = match Format::of_path(path) {
        Some(Format::Ply) => ply_bytes(PlyContent {
            positions: mesh.positions(),
            faces: mesh.faces(),
            ..PlyContent::default()
        }),
        Some(Format::Obj) => Ok(obj_text(mesh).into_bytes()),
        Some(Format::Glb) => glb_bytes(MeshToGlb { mesh, normals: None, colors: None }),
        Some(Format::Stl | Format::Off) | None => {
            return Err(WriteError::UnknownFormat { path: path.to_owned() });
        }
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
    write_whole(path, &bytes)
}

/// Writes bytes beside the file and then renames them, so that a file is either whole or not there.
pub fn write_whole(path: &Path, bytes: &[u8]) -> Result<(), WriteError> {
    let mut beside = OsString::from(path.as_os_str());
    beside.push(".part");
    let written = std::fs::File::create(&beside)
        .and_then(|mut file| file.write_all(bytes))
        .and_then(|()| std::fs::rename(&beside, path));
    written.map_err(|source| WriteError::Io { path: path.to_owned(), source })
}
