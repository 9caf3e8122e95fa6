//! Normals of faces and of vertices.

use glam::DVec3;

pub use crate::cloud_normals::estimate_cloud_normals;

/// Unit normals of the faces; zero where a face has no area.
pub fn face_normals(positions: &[DVec3], faces: &[[u32; 3]]) -> Vec<DVec3> {
    faces.iter().map(|face| doubled_area_vector(positions, *face).normalize_or_zero()).collect()
}

/// Unit vertex normals, each face weighted by its angle at the vertex (Bærentzen and Aanæs 2005, Eq. 1); zero at a vertex without faces.
pub fn vertex_normals(positions: &[DVec3], faces: &[[u32; 3]]) -> Vec<DVec3> {
    let mut normals = vec![DVec3::ZERO; positions.len()];
    for face in faces {
        let normal = doubled_area_vector(positions, *face).normalize_or_zero();
        let angles = corner_angles(face.map(|vertex| positions[vertex as usize]));
        for (vertex, angle) in face.iter().zip(angles) {
            normals[*vertex as usize] += normal * angle;
        }
    }
    for normal in &mut normals {
        *normal = normal.normalize_or_zero();
    }
    normals
}

/// Unit vertex normals, each face weighted by its area: about five times as fast as [`vertex_normals`], for tracking loops.
pub fn vertex_normals_into(positions: &[DVec3], faces: &[[u32; 3]], normals: &mut Vec<DVec3>) {
    normals.clear();
    normals.resize(positions.len(), DVec3::ZERO);
    for face in faces {
        let area_vector = doubled_area_vector(positions, *face);
        for vertex in face {
            normals[*vertex as usize] += area_vector;
        }
    }
    for normal in normals {
        *normal = normal.normalize_or_zero();
    }
}

/// The vector of twice a face's area along its normal.
pub(crate) fn doubled_area_vector(positions: &[DVec3], face: [u32; 3]) -> DVec3 {
    let [a, b, c] = face.map(|vertex| positions[vertex as usize]);
    (b - a).cross(c - a)
}

/// The three inner angles of a triangle in radians.
pub(crate) fn corner_angles([a, b, c]: [DVec3; 3]) -> [f64; 3] {
    let angle = |u: DVec3, v: DVec3| u.cross(v).length().atan2(u.dot(v));
    let at_a = angle(b - a, c - a);
    let at_b = angle(c - b, a - b);
    [at_a, at_b, (std::f64::consts::PI - at_a - at_b).max(0.0)]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A unit cube of twelve triangles, whose diagonals bias area weights but not angle weights.
    fn cube() -> (Vec<DVec3>, Vec<[u32; 3]>) {
        let positions = (0..8)
            .map(|corner| DVec3::new((corner & 1) as f64, (corner >> 1 & 1) as f64, (corner >> 2) as f64))
            .collect();
        let quads: [[u32; 4]; 6] =
            [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
        (positions, quads.iter().flat_map(|q| [[q[0], q[1], q[2]], [q[0], q[2], q[3]]]).collect())
    }

    #[test]
    fn angle_weighted_normals_of_a_cube_point_along_its_diagonals() {
        let (positions, faces) = cube();
        for (position, normal) in positions.iter().zip(vertex_normals(&positions, &faces)) {
            let diagonal = (*position - DVec3::splat(0.5)).normalize();
            assert!((normal - diagonal).length() < 1e-12, "{normal} is not {diagonal}");
        }
    }

    #[test]
    fn area_weighted_normals_are_unit_and_point_outwards() {
        let (positions, faces) = cube();
        let mut normals = vec![DVec3::NAN; 3];
        vertex_normals_into(&positions, &faces, &mut normals);
        assert_eq!(normals.len(), 8);
        for (position, normal) in positions.iter().zip(&normals) {
            assert!((normal.length() - 1.0).abs() < 1e-12);
            assert!(normal.dot(*position - DVec3::splat(0.5)) > 0.0);
        }
    }

    #[test]
    fn faces_without_area_and_vertices_without_faces_have_zero_normals() {
        let positions = vec![DVec3::ZERO, DVec3::X, DVec3::X * 2.0, DVec3::Y];
        assert_eq!(face_normals(&positions, &[[0, 1, 2]]), [DVec3::ZERO]);
        assert_eq!(vertex_normals(&positions, &[[0, 1, 2]]), [DVec3::ZERO; 4]);
    }
}
