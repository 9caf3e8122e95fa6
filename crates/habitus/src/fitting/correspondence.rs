//! Which point of the capture belongs to which vertex, and whether the pair is credible.

use glam::DVec3;
use habitus_geometry::SurfaceIndex;
use rayon::prelude::*;
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
        const CHUNK: usize = 512;
        let mut points = Vec::with_capacity(vertices.len());
        match earlier.filter(|field| field.points.len() == vertices.len()) {
            Some(field) => vertices
                .par_iter()
                .zip(&field.points)
                .with_min_len(CHUNK)
                .map(|(vertex, hint)| index.closest_warm(*vertex, hint.face))
                .collect_into_vec(&mut points),
            None => vertices
                .par_iter()
                .with_min_len(CHUNK)
                .map(|vertex| index.closest(*vertex))
                .collect_into_vec(&mut points),
        }
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
