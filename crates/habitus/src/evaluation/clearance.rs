//! How far inside a capture a body lies.

use glam::DVec3;
use habitus_geometry::{Surface, SurfaceIndex};

/// Clearance of each vertex in the unit of the input, positive inside the capture and negative outside. A cloud
/// without normals has no inside, so nothing is known there.
pub fn clearance(vertices: &[DVec3], capture: &Surface) -> Option<Vec<f64>> {
    let index = match capture {
        Surface::Mesh(mesh) => SurfaceIndex::of_mesh(mesh),
        Surface::Cloud(cloud) => SurfaceIndex::of_cloud(cloud.positions(), cloud.normals()?),
    };
    let mut closest = Vec::new();
    index.closest_many(vertices, None, &mut closest);
    let signed = |(vertex, point): (&DVec3, &habitus_geometry::SurfacePoint)| {
        let distance = point.distance_squared.sqrt();
        if (*vertex - point.position).dot(point.normal) > 0.0 { -distance } else { distance }
    };
    Some(vertices.iter().zip(&closest).map(signed).collect())
}

#[cfg(test)]
mod tests {
    use glam::DVec3;
    use habitus_geometry::{Surface, TriangleMesh};

    use super::clearance;

    #[test]
    fn inside_a_tetrahedron_is_positive_and_outside_negative() {
        let corners = vec![
            DVec3::ZERO,
            DVec3::new(6.0, 0.0, 0.0),
            DVec3::new(0.0, 6.0, 0.0),
            DVec3::new(0.0, 0.0, 6.0),
        ];
        let faces = vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]];
        let mesh = TriangleMesh::new(corners, faces).expect("is valid");
        let points = [DVec3::splat(1.0), DVec3::new(1.0, 1.0, -2.0)];
        let found = clearance(&points, &Surface::Mesh(mesh)).expect("a mesh has an inside");
        assert!((found[0] - 1.0).abs() < 1e-12 && (found[1] + 2.0).abs() < 1e-12, "{found:?}");
    }
}
