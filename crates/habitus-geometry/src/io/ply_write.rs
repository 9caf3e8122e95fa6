//! Writes PLY in little-endian binary; doubles, so that reading gives the same positions back.

use glam::DVec3;

use super::error::ContentError;

/// What to put into a PLY file.
#[derive(Debug, Clone, Copy, Default)]
pub struct PlyContent<'a> {
    /// The vertex positions.
    pub positions: &'a [DVec3],
    /// The faces; empty for a point cloud.
    pub faces: &'a [[u32; 3]],
    /// One normal per vertex, or none.
    pub normals: Option<&'a [DVec3]>,
    /// One colour (red, green, blue) per vertex, or none.
    pub colors: Option<&'a [[u8; 3]]>,
}

/// The bytes of a PLY file.
pub fn ply_bytes(content: PlyContent<'_>) -> Result<Vec<u8>, ContentError> {
    let vertex_count = content.positions.len();
    let lengths =
        [("normals", content.normals.map(<[DVec3]>::len)), ("colours", content.colors.map(<[[u8; 3]]>::len))];
    for (what, found) in lengths {
        if let Some(found) = found.filter(|&found| found != vertex_count) {
            return Err(ContentError::CountMismatch { what, expected: vertex_count, found });
        }
    }
    let mut bytes = header(&content).into_bytes();
    for vertex in 0..vertex_count {
        push_vector(&mut bytes, content.positions[vertex]);
        if let Some(normals) = content.normals {
            push_vector(&mut bytes, normals[vertex]);
        }
        if let Some(colors) = content.colors {
            bytes.extend_from_slice(&colors[vertex]);
        }
    }
    for face in content.faces {
        bytes.push(3);
        for vertex in face {
            bytes.extend_from_slice(&vertex.to_le_bytes());
        }
    }
    Ok(bytes)
}

fn header(content: &PlyContent<'_>) -> String {
    let mut header = format!(
        "ply\nformat binary_little_endian 1.0\nelement vertex {}\nproperty double x\nproperty double y\nproperty double z\n",
        content.positions.len()
    );
    if content.normals.is_some() {
        header += "property double nx\nproperty double ny\nproperty double nz\n";
    }
    if content.colors.is_some() {
        header += "property uchar red\nproperty uchar green\nproperty uchar blue\n";
    }
    if !content.faces.is_empty() {
        header += &format!("element face {}\nproperty list uchar uint vertex_indices\n", content.faces.len());
    }
    header + "end_header\n"
}

fn push_vector(bytes: &mut Vec<u8>, vector: DVec3) {
    for coordinate in vector.to_array() {
        bytes.extend_from_slice(&coordinate.to_le_bytes());
    }
}
