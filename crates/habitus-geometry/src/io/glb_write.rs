//! Writes a mesh as GLB; glTF is in metres, y up, and so are bodies here.

use glam::DVec3;
use serde_json::{Map, Value, json};

use super::error::ContentError;
use super::glb::{GlbBuilder, UNSIGNED_BYTE, ViewTarget};
use crate::mesh::TriangleMesh;

/// A mesh on its way into a GLB file.
#[derive(Debug, Clone, Copy)]
pub struct MeshToGlb<'a> {
    /// The mesh, in metres, y up.
    pub mesh: &'a TriangleMesh,
    /// One unit normal per vertex; angle-weighted ones are computed where none are given.
    pub normals: Option<&'a [DVec3]>,
    /// One colour (red, green, blue) per vertex, or none.
    pub colors: Option<&'a [[u8; 3]]>,
}

/// The bytes of a GLB file with one mesh.
pub fn glb_bytes(content: MeshToGlb<'_>) -> Result<Vec<u8>, ContentError> {
    let positions = content.mesh.positions();
    let computed;
    let normals = match content.normals {
        Some(normals) => normals,
        None => {
            computed = crate::normals::vertex_normals(positions, content.mesh.faces());
            &computed
        }
    };
    let lengths =
        [("normals", normals.len()), ("colours", content.colors.map_or(positions.len(), <[_]>::len))];
    for (what, found) in lengths {
        if found != positions.len() {
            return Err(ContentError::CountMismatch { what, expected: positions.len(), found });
        }
    }
    let mut glb = GlbBuilder::new();
    let mut attributes = json!({
        "POSITION": glb.add_vectors(ViewTarget::Vertices, &single_precision("vertex", positions)?),
        "NORMAL": glb.add_vectors(ViewTarget::Vertices, &single_precision("normal", &drawable(normals))?),
    });
    if let Some(colors) = content.colors {
        let bytes = colors.iter().flat_map(|[red, green, blue]| [*red, *green, *blue, u8::MAX]);
        let accessor = glb.add_accessor("VEC4", UNSIGNED_BYTE, colors.len(), ViewTarget::Vertices, bytes);
        glb.mark_normalized(accessor);
        attributes["COLOR_0"] = json!(accessor);
    }
    let indices = glb.add_indices(content.mesh.faces());
    let mut description = Map::new();
    let parts: [(&str, Value); 4] = [
        ("scene", json!(0)),
        ("scenes", json!([{ "nodes": [0] }])),
        ("nodes", json!([{ "mesh": 0 }])),
        ("meshes", json!([{ "primitives": [{ "attributes": attributes, "indices": indices }] }])),
    ];
    description.extend(parts.map(|(name, part)| (name.to_owned(), part)));
    glb.finish(description)
}

/// Vectors as 32-bit floats, refused where they would become infinite.
pub fn single_precision(what: &'static str, vectors: &[DVec3]) -> Result<Vec<[f32; 3]>, ContentError> {
    vectors
        .iter()
        .enumerate()
        .map(|(index, vector)| {
            let single = vector.as_vec3();
            if single.is_finite() {
                Ok(single.to_array())
            } else {
                Err(ContentError::BeyondSinglePrecision { what, index })
            }
        })
        .collect()
}

/// glTF wants unit normals everywhere, also at vertices that have no face and so no direction of their own.
fn drawable(normals: &[DVec3]) -> Vec<DVec3> {
    normals.iter().map(|normal| normal.try_normalize().unwrap_or(DVec3::Y)).collect()
}
