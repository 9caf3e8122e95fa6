//! Which point of the capture belongs to which vertex, and whether the pair is credible.

use glam::DVec3;
use habitus_geometry::SurfaceIndex;
use serde::{Deserialize, Serialize};

/// A vertex and its closest point on the capture, frozen for one solve.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Correspondence {
    /// Vertex of the surface that is fitted.
    pub vertex: u32,
    /// Closest point of the capture in metres.
    pub target: DVec3,
    /// Outward unit normal of the capture there.
    pub normal: DVec3,
    /// P2 §4.4: the vertex lies on the outer side of the capture.
    pub is_outside: bool,
    /// Signed distance along the normal in metres, positive outside.
    pub signed_distance: f64,
    /// Weight of the pair.
    pub weight: f64,
}

/// When a pair is credible.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CompatibilityRules {
    /// Largest distance in metres (not squared). P2 §4.3: 200 mm.
    pub distance: f64,
    /// Largest angle between the outer normals in degrees. P2 §4.3: 60°.
    pub angle_deg: f64,
}

impl Default for CompatibilityRules {
    fn default() -> Self {
        Self { distance: 0.2, angle_deg: 60.0 }
    }
}

/// Closest capture point of each vertex, with the face it lies on as the hint of the next search.
pub struct ClosestField {
    /// For each vertex its closest point.
    pub points: Vec<habitus_geometry::SurfacePoint>,
}

impl ClosestField {
    /// Finds the closest point of each vertex; an earlier field of the same capture speeds it up.
    pub fn find(index: &SurfaceIndex, vertices: &[DVec3], earlier: Option<&Self>) -> Self {
        let hints: Option<Vec<u32>> = earlier
            .filter(|field| field.points.len() == vertices.len())
            .map(|field| field.points.iter().map(|point| point.face).collect());
        let mut points = Vec::with_capacity(vertices.len());
        index.closest_many(vertices, hints.as_deref(), &mut points);
        Self { points }
    }

    /// P2 §4.3–4.4: the pairs that satisfy the rules, with weight 1.
    pub fn correspondences(
        &self,
        vertices: &[DVec3],
        normals: &[DVec3],
        rules: &CompatibilityRules,
    ) -> Vec<Correspondence> {
        let smallest_cosine = rules.angle_deg.to_radians().cos();
        let largest_squared = rules.distance * rules.distance;
        self.points
            .iter()
            .enumerate()
            .filter(|(vertex, point)| {
                point.distance_squared <= largest_squared
                    && normals[*vertex].dot(point.normal) >= smallest_cosine
            })
            .map(|(vertex, point)| {
                let signed_distance = (vertices[vertex] - point.position).dot(point.normal);
                Correspondence {
                    vertex: vertex as u32,
                    target: point.position,
                    normal: point.normal,
                    is_outside: signed_distance > 0.0,
                    signed_distance,
                    weight: 1.0,
                }
            })
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use habitus_geometry::TriangleMesh;

    use super::*;

    /// A plate of two metres in the plane z = 0, outward +z.
    fn plate() -> SurfaceIndex {
        let corners =
            [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)].map(|(x, y)| DVec3::new(x, y, 0.0));
        let mesh = TriangleMesh::new(corners.to_vec(), vec![[0, 1, 2], [0, 2, 3]]).expect("a plate");
        SurfaceIndex::of_mesh(&mesh)
    }

    fn pairs(vertices: &[DVec3], normals: &[DVec3]) -> Vec<Correspondence> {
        let field = ClosestField::find(&plate(), vertices, None);
        field.correspondences(vertices, normals, &CompatibilityRules::default())
    }

    #[test]
    fn pairs_end_at_the_distance_and_not_at_its_square_root() {
        // 0.3 m and 0.44 m are beyond 0.2 m, although their squares are not.
        let vertices = [0.19, -0.19, 0.21, 0.3, -0.44].map(|z| DVec3::new(0.1, 0.2, z));
        let found = pairs(&vertices, &[DVec3::Z; 5]);
        assert_eq!(found.iter().map(|pair| pair.vertex).collect::<Vec<_>>(), [0, 1]);
    }

    #[test]
    fn pairs_end_at_the_angle() {
        let normals = [59.0_f64, 61.0, 180.0].map(|angle| {
            let angle = angle.to_radians();
            DVec3::new(angle.sin(), 0.0, angle.cos())
        });
        let found = pairs(&[DVec3::new(0.1, 0.2, 0.05); 3], &normals);
        assert_eq!(found.iter().map(|pair| pair.vertex).collect::<Vec<_>>(), [0]);
    }

    #[test]
    fn a_vertex_in_front_of_the_capture_is_outside_by_its_distance() {
        let found = pairs(&[DVec3::new(0.1, 0.2, 0.05), DVec3::new(0.3, 0.1, -0.07)], &[DVec3::Z; 2]);
        assert!(found[0].is_outside && (found[0].signed_distance - 0.05).abs() < 1e-12);
        assert!(!found[1].is_outside && (found[1].signed_distance + 0.07).abs() < 1e-12);
        for pair in found {
            assert!(pair.target.z.abs() < 1e-12 && pair.normal == DVec3::Z && pair.weight == 1.0);
        }
    }

    #[test]
    fn an_earlier_field_speeds_the_search_and_does_not_change_it() {
        let index = plate();
        let vertices: Vec<DVec3> = (0..40)
            .map(|k| DVec3::new((0.7 * f64::from(k)).sin(), (1.3 * f64::from(k)).cos(), 0.1))
            .collect();
        let cold = ClosestField::find(&index, &vertices, None);
        let elsewhere: Vec<DVec3> = vertices.iter().map(|vertex| -*vertex).collect();
        let earlier = ClosestField::find(&index, &elsewhere, None);
        let warm = ClosestField::find(&index, &vertices, Some(&earlier));
        for (cold, warm) in cold.points.iter().zip(&warm.points) {
            assert!((cold.distance_squared - warm.distance_squared).abs() < 1e-15);
            assert!(cold.position.distance(warm.position) < 1e-12);
        }
        // A field of another surface's size is no hint.
        let short = ClosestField { points: cold.points[..3].to_vec() };
        let found = ClosestField::find(&index, &vertices, Some(&short));
        assert_eq!(found.points, cold.points);
    }
}
