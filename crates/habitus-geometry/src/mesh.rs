//! Surfaces that were checked once, so that everything after may index without fear: triangle meshes and point clouds.

use glam::DVec3;
use thiserror::Error;

/// Why vertices and faces do not make a usable surface.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum MeshError {
    /// A mesh needs at least one face.
    #[error("the mesh has no faces; read it as a point cloud, or check that the export kept its faces")]
    NoFaces,
    /// A surface needs at least one vertex.
    #[error("the surface has no vertices; check that the export was not empty")]
    NoVertices,
    /// More vertices than 32-bit face indices can name.
    #[error("{found} vertices are more than 32-bit face indices can name; split or decimate the surface")]
    TooManyVertices {
        /// How many vertices were given.
        found: usize,
    },
    /// A face names a vertex that does not exist.
    #[error("face {face} names vertex {vertex}, but there are only {vertex_count} vertices (counted from 0)")]
    VertexOutOfRange {
        /// The face, counted from 0.
        face: usize,
        /// The vertex that it names.
        vertex: u32,
        /// How many vertices there are.
        vertex_count: usize,
    },
    /// A face names one vertex twice and so has no area.
    #[error("face {face} names vertex {vertex} twice; drop degenerate faces before building the mesh")]
    RepeatedVertex {
        /// The face, counted from 0.
        face: usize,
        /// The vertex that it names twice.
        vertex: u32,
    },
    /// A coordinate is infinite or not a number.
    #[error("vertex {vertex} has a coordinate that is not finite: {position}; remove it from the file")]
    NonFiniteVertex {
        /// The vertex, counted from 0.
        vertex: usize,
        /// Its position as given.
        position: DVec3,
    },
    /// A normal is infinite, not a number, or of length zero.
    #[error("the normal of point {point} is unusable: {normal}; drop the normals and let them be estimated")]
    UnusableNormal {
        /// The point, counted from 0.
        point: usize,
        /// Its normal as given.
        normal: DVec3,
    },
    /// Two lists that belong together differ in length.
    #[error("{found} {what} were given where {expected} are needed, one per vertex")]
    CountMismatch {
        /// What the list holds.
        what: &'static str,
        /// The length that is needed.
        expected: usize,
        /// The length that was given.
        found: usize,
    },
}

/// A triangle mesh whose indices are in range, whose coordinates are finite and whose faces name three different vertices.
#[derive(Debug, Clone, PartialEq)]
pub struct TriangleMesh {
    positions: Vec<DVec3>,
    faces: Vec<[u32; 3]>,
}

impl TriangleMesh {
    /// Checks and keeps positions and counter-clockwise faces; there must be at least one face.
    pub fn new(positions: Vec<DVec3>, faces: Vec<[u32; 3]>) -> Result<Self, MeshError> {
        check_positions(&positions)?;
        if faces.is_empty() {
            return Err(MeshError::NoFaces);
        }
        for (face, corners) in faces.iter().enumerate() {
            if let Some(&vertex) = corners.iter().find(|&&vertex| vertex as usize >= positions.len()) {
                return Err(MeshError::VertexOutOfRange { face, vertex, vertex_count: positions.len() });
            }
            if let Some(vertex) = repeated_vertex(*corners) {
                return Err(MeshError::RepeatedVertex { face, vertex });
            }
        }
        Ok(Self { positions, faces })
    }

    /// The vertex positions.
    pub fn positions(&self) -> &[DVec3] {
        &self.positions
    }

    /// The faces as counter-clockwise vertex indices, seen from outside.
    pub fn faces(&self) -> &[[u32; 3]] {
        &self.faces
    }

    /// The same faces over other positions, one per vertex.
    pub fn with_positions(&self, positions: Vec<DVec3>) -> Result<Self, MeshError> {
        if positions.len() != self.positions.len() {
            return Err(MeshError::CountMismatch {
                what: "positions",
                expected: self.positions.len(),
                found: positions.len(),
            });
        }
        check_positions(&positions)?;
        Ok(Self { positions, faces: self.faces.clone() })
    }

    /// The positions and faces, given away.
    pub fn into_parts(self) -> (Vec<DVec3>, Vec<[u32; 3]>) {
        (self.positions, self.faces)
    }

    /// The three corner positions of a face.
    pub fn corners(&self, face: usize) -> [DVec3; 3] {
        self.faces[face].map(|vertex| self.positions[vertex as usize])
    }
}

/// Points with finite coordinates, with or without unit normals.
#[derive(Debug, Clone, PartialEq)]
pub struct PointCloud {
    positions: Vec<DVec3>,
    normals: Option<Vec<DVec3>>,
}

impl PointCloud {
    /// Checks positions and normals (any length but zero; they are kept as unit vectors).
    pub fn new(positions: Vec<DVec3>, normals: Option<Vec<DVec3>>) -> Result<Self, MeshError> {
        check_positions(&positions)?;
        let normals = normals.map(|normals| unit_normals(normals, positions.len())).transpose()?;
        Ok(Self { positions, normals })
    }

    /// The point positions.
    pub fn positions(&self) -> &[DVec3] {
        &self.positions
    }

    /// The unit normals, where the cloud has any.
    pub fn normals(&self) -> Option<&[DVec3]> {
        self.normals.as_deref()
    }

    /// The positions and normals, given away.
    pub fn into_parts(self) -> (Vec<DVec3>, Option<Vec<DVec3>>) {
        (self.positions, self.normals)
    }
}

/// What a file can hold.
#[derive(Debug, Clone, PartialEq)]
pub enum Surface {
    /// Vertices joined by triangles.
    Mesh(TriangleMesh),
    /// Points alone.
    Cloud(PointCloud),
}

impl Surface {
    /// The vertex or point positions.
    pub fn positions(&self) -> &[DVec3] {
        match self {
            Self::Mesh(mesh) => mesh.positions(),
            Self::Cloud(cloud) => cloud.positions(),
        }
    }
}

/// The vertex that a face names twice, if any.
pub(crate) fn repeated_vertex([a, b, c]: [u32; 3]) -> Option<u32> {
    if a == b || a == c {
        Some(a)
    } else if b == c {
        Some(b)
    } else {
        None
    }
}

fn check_positions(positions: &[DVec3]) -> Result<(), MeshError> {
    if positions.is_empty() {
        return Err(MeshError::NoVertices);
    }
    if positions.len() > u32::MAX as usize {
        return Err(MeshError::TooManyVertices { found: positions.len() });
    }
    match positions.iter().position(|position| !position.is_finite()) {
        Some(vertex) => Err(MeshError::NonFiniteVertex { vertex, position: positions[vertex] }),
        None => Ok(()),
    }
}

fn unit_normals(mut normals: Vec<DVec3>, point_count: usize) -> Result<Vec<DVec3>, MeshError> {
    if normals.len() != point_count {
        return Err(MeshError::CountMismatch {
            what: "normals",
            expected: point_count,
            found: normals.len(),
        });
    }
    for (point, normal) in normals.iter_mut().enumerate() {
        *normal = normal.try_normalize().ok_or(MeshError::UnusableNormal { point, normal: *normal })?;
    }
    Ok(normals)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn corner_positions() -> Vec<DVec3> {
        vec![DVec3::ZERO, DVec3::X, DVec3::Y]
    }

    #[test]
    fn a_valid_triangle_is_accepted_and_gives_its_corners() {
        let mesh = TriangleMesh::new(corner_positions(), vec![[0, 1, 2]]).unwrap();
        assert_eq!(mesh.corners(0), [DVec3::ZERO, DVec3::X, DVec3::Y]);
    }

    #[test]
    fn each_fault_is_named_with_its_place() {
        assert_eq!(TriangleMesh::new(corner_positions(), vec![]), Err(MeshError::NoFaces));
        assert_eq!(TriangleMesh::new(vec![], vec![[0, 1, 2]]), Err(MeshError::NoVertices));
        assert_eq!(
            TriangleMesh::new(corner_positions(), vec![[0, 1, 2], [0, 1, 3]]),
            Err(MeshError::VertexOutOfRange { face: 1, vertex: 3, vertex_count: 3 })
        );
        assert_eq!(
            TriangleMesh::new(corner_positions(), vec![[0, 2, 2]]),
            Err(MeshError::RepeatedVertex { face: 0, vertex: 2 })
        );
        let mut broken = corner_positions();
        broken[1].y = f64::INFINITY;
        assert!(matches!(
            TriangleMesh::new(broken, vec![[0, 1, 2]]),
            Err(MeshError::NonFiniteVertex { vertex: 1, .. })
        ));
    }

    #[test]
    fn other_positions_must_be_as_many_and_finite() {
        let mesh = TriangleMesh::new(corner_positions(), vec![[0, 1, 2]]).unwrap();
        assert!(matches!(
            mesh.with_positions(vec![DVec3::ZERO]),
            Err(MeshError::CountMismatch { expected: 3, found: 1, .. })
        ));
        let moved = mesh.with_positions(corner_positions().iter().map(|p| *p + DVec3::Z).collect()).unwrap();
        assert_eq!(moved.faces(), mesh.faces());
    }

    #[test]
    fn cloud_normals_become_unit_or_are_refused() {
        let cloud = PointCloud::new(vec![DVec3::ZERO], Some(vec![DVec3::Z * 3.0])).unwrap();
        assert_eq!(cloud.normals().unwrap(), [DVec3::Z]);
        assert!(matches!(
            PointCloud::new(vec![DVec3::ZERO], Some(vec![DVec3::ZERO])),
            Err(MeshError::UnusableNormal { point: 0, .. })
        ));
    }
}
