//! How far registered vertices are from where they truly belong.

use glam::DVec3;
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
}

/// Distances over many scans.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct RegistrationAccuracy {
    /// Over all vertices of all scans, millimetres.
    pub vertex_mm: DistanceSummary,
    /// Each scan.
    pub scans: Vec<ScanAccuracy>,
    #[serde(skip)]
    distances: Vec<f64>,
}

impl RegistrationAccuracy {
    /// Adds a scan; both in metres.
    pub fn add(&mut self, scan: &str, found: &[DVec3], truth: &[DVec3]) -> Result<(), OtherTemplate> {
        if found.len() != truth.len() {
            return Err(OtherTemplate { scan: scan.into(), found: found.len(), expected: truth.len() });
        }
        let distances: Vec<f64> = found.iter().zip(truth).map(|(a, b)| a.distance(*b)).collect();
        self.distances.extend(&distances);
        self.scans.push(ScanAccuracy { name: scan.into(), vertex_mm: DistanceSummary::of(distances) });
        self.vertex_mm = DistanceSummary::default();
        Ok(())
    }

    /// Sums up what was added.
    #[must_use]
    pub fn finished(mut self) -> Self {
        self.vertex_mm = DistanceSummary::of(std::mem::take(&mut self.distances));
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn vertices_count_alike_whatever_scan_they_are_of() {
        let mut accuracy = RegistrationAccuracy::default();
        let truth = [DVec3::ZERO, DVec3::X];
        accuracy.add("a", &[DVec3::ZERO, DVec3::X * 1.001], &truth).expect("alike");
        accuracy.add("b", &[DVec3::Y * 0.003, DVec3::X], &truth).expect("alike");
        accuracy.add("c", &truth, &[DVec3::ZERO]).expect_err("other sizes");
        let accuracy = accuracy.finished();
        assert!((accuracy.vertex_mm.mean - 1.0).abs() < 1e-9);
        assert!((accuracy.scans[1].vertex_mm.mean - 1.5).abs() < 1e-9);
    }
}
