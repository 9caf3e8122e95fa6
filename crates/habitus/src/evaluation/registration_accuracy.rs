//! How far registered vertices are from where they truly belong.

use glam::DVec3;
use habitus_geometry::{SurfaceIndex, TriangleMesh};
use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::artifacts::registered_scan::DistanceSummary;

/// Two lists of vertices cannot be compared.
#[derive(Clone, Debug, PartialEq, Error)]
#[error(
    "scan '{scan}': {found} registered vertices, but the truth has {expected}; it belongs to another template"
)]
pub struct OtherTemplate {
    /// The scan.
    pub scan: String,
    /// Registered vertices.
    pub found: usize,
    /// Vertices of the truth.
    pub expected: usize,
}

/// Distances of one scan's vertices from the truth.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ScanAccuracy {
    /// Name of the scan.
    pub name: String,
    /// Over all its vertices, millimetres.
    pub vertex_mm: DistanceSummary,
    /// From all its vertices to the true surface, wherever on it, millimetres: what noise and holes of the scan leave, without
    /// what slides along the surface.
    pub surface_mm: DistanceSummary,
}

/// Distances over many scans.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct RegistrationAccuracy {
    /// Over all vertices of all scans, millimetres.
    pub vertex_mm: DistanceSummary,
    /// From all vertices of all scans to the true surfaces, millimetres.
    pub surface_mm: DistanceSummary,
    /// Each scan.
    pub scans: Vec<ScanAccuracy>,
    #[serde(skip)]
    distances: [Vec<f64>; 2],
}

impl RegistrationAccuracy {
    /// Adds a scan; both in metres.
    pub fn add(&mut self, scan: &str, found: &[DVec3], truth: &TriangleMesh) -> Result<(), OtherTemplate> {
        let expected = truth.positions().len();
        if found.len() != expected {
            return Err(OtherTemplate { scan: scan.into(), found: found.len(), expected });
        }
        let vertices: Vec<f64> = found.iter().zip(truth.positions()).map(|(a, b)| a.distance(*b)).collect();
        let mut closest = Vec::new();
        SurfaceIndex::of_mesh(truth).closest_many(found, None, &mut closest);
        let surface: Vec<f64> = closest.iter().map(|point| point.distance_squared.sqrt()).collect();
        self.distances[0].extend(&vertices);
        self.distances[1].extend(&surface);
        self.scans.push(ScanAccuracy {
            name: scan.into(),
            vertex_mm: DistanceSummary::of(vertices),
            surface_mm: DistanceSummary::of(surface),
        });
        Ok(())
    }

    /// Sums up what was added.
    #[must_use]
    pub fn finished(mut self) -> Self {
        let [vertices, surface] = std::mem::take(&mut self.distances);
        self.vertex_mm = DistanceSummary::of(vertices);
        self.surface_mm = DistanceSummary::of(surface);
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn vertices_count_alike_whatever_scan_they_are_of() {
        let mut accuracy = RegistrationAccuracy::default();
        let corners = [DVec3::ZERO, DVec3::X, DVec3::Y];
        let truth = TriangleMesh::new(corners.to_vec(), vec![[0, 1, 2]]).expect("valid");
        // Along the surface, and off it.
        accuracy.add("a", &corners.map(|c| c * 0.999), &truth).expect("alike");
        accuracy.add("b", &corners.map(|c| c + DVec3::Z * 0.003), &truth).expect("alike");
        accuracy.add("c", &corners[..2], &truth).expect_err("other sizes");
        let accuracy = accuracy.finished();
        assert!((accuracy.vertex_mm.mean - (2.0 / 3.0 + 3.0) / 2.0).abs() < 1e-9);
        assert!((accuracy.surface_mm.mean - 1.5).abs() < 1e-9);
        assert!((accuracy.scans[1].vertex_mm.mean - 3.0).abs() < 1e-9);
    }
}
