//! A template brought onto a scan, and how well it lies there.
//!
//! On disk: `<name>.ply` (the template's topology in the scan's own frame and unit) and `<name>.json` (quality, codes, and
//! the body model's identity and pose if one was used).

use std::path::{Path, PathBuf};

use habitus_geometry::TriangleMesh;
use habitus_geometry::io::{ReadError, WriteError, read_mesh, write_mesh};
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::codes::Code;
use super::write_atomically;

/// Why a registration cannot be written or read.
#[derive(Debug, Error)]
pub enum RegistrationFileError {
    /// The mesh cannot be read.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// The mesh cannot be written.
    #[error(transparent)]
    Write(#[from] WriteError),
    /// The record cannot be written or read.
    #[error("{}: {reason}", path.display())]
    Record {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
}

/// Mean and 95th percentile of distances.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct DistanceSummary {
    /// The mean, millimetres.
    pub mean: f64,
    /// The 95th percentile, millimetres.
    pub p95: f64,
}

impl DistanceSummary {
    /// Sums up distances in metres; zero without any.
    pub fn of(mut distances: Vec<f64>) -> Self {
        distances.sort_by(f64::total_cmp);
        let count = distances.len().max(1) as f64;
        let mean = distances.iter().sum::<f64>() / count;
        let p95 = distances.get((distances.len() * 95 / 100).min(distances.len().saturating_sub(1)));
        Self { mean: mean * 1000.0, p95: p95.copied().unwrap_or(0.0) * 1000.0 }
    }
}

/// Percentiles of the length of an edge over its length on the surface that the registration started from.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct EdgeRatio {
    /// First percentile.
    pub p1: f64,
    /// 99th percentile.
    pub p99: f64,
}

/// How well a registration lies on its scan.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RegistrationQuality {
    /// From each used point of the scan to the registered surface.
    pub point_to_surface_mm: DistanceSummary,
    /// The same for points of the scan that the fit never saw.
    pub held_out_mm: DistanceSummary,
    /// From each registered vertex that the scan covers to the scan.
    pub surface_to_point_mm: DistanceSummary,
    /// Share of registered vertices that the scan covers.
    pub covered_share: f64,
    /// How edges were stretched.
    pub edge_ratio: EdgeRatio,
    /// Number of faces that lie folded over against their neighbours.
    pub flipped_faces: usize,
    /// Mean distance of landmarks, if there are any.
    pub landmark_mm: Option<f64>,
    /// Wall-clock seconds of the registration.
    pub seconds: f64,
    /// `ok`, or the code that says best why the registration must not be used unseen.
    pub code: String,
}

/// The body model's part of a registration.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FittedModel {
    /// Name of the model.
    pub model: String,
    /// Identity in standard deviations.
    pub identity: Vec<f64>,
    /// Pose parameters; metres, y up.
    pub pose: Vec<f64>,
}

/// The record beside a registered mesh.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RegistrationRecord {
    /// Name of the scan.
    pub name: String,
    /// What the registration depends on; see [`crate::artifacts::provenance`].
    pub key: String,
    /// How well it lies.
    pub quality: RegistrationQuality,
    /// All codes that fired.
    pub codes: Vec<Code>,
    /// The body model's fit that the registration started from, if there was one.
    pub fitted_model: Option<FittedModel>,
    /// How many metres one unit of the scan is.
    pub metres_per_unit: f64,
}

/// A registered scan.
#[derive(Clone, Debug, PartialEq)]
pub struct RegisteredScan {
    /// The template's topology in the scan's own frame and unit.
    pub mesh: TriangleMesh,
    /// All else.
    pub record: RegistrationRecord,
}

impl RegisteredScan {
    /// Whether it may be used unseen.
    pub fn is_ok(&self) -> bool {
        !self.record.codes.iter().any(|code| code.is_failure())
    }

    /// Writes `<name>.ply`, then `<name>.json`.
    pub fn write(&self, folder: &Path) -> Result<(), RegistrationFileError> {
        write_mesh(&mesh_file(folder, &self.record.name), &self.mesh)?;
        self.record.write(folder)
    }

    /// Reads what [`RegisteredScan::write`] wrote.
    pub fn read(folder: &Path, name: &str) -> Result<Self, RegistrationFileError> {
        let record = RegistrationRecord::read(folder, name)?;
        Ok(Self { mesh: read_mesh(&mesh_file(folder, name))?, record })
    }
}

impl RegistrationRecord {
    /// Writes `<name>.json`.
    pub fn write(&self, folder: &Path) -> Result<(), RegistrationFileError> {
        let path = record_file(folder, &self.name);
        let failed = |reason: String| RegistrationFileError::Record { path: path.clone(), reason };
        let text = serde_json::to_string_pretty(self).map_err(|error| failed(error.to_string()))?;
        write_atomically(&path, (text + "\n").as_bytes()).map_err(|error| failed(error.to_string()))
    }

    /// Reads `<name>.json`.
    pub fn read(folder: &Path, name: &str) -> Result<Self, RegistrationFileError> {
        let path = record_file(folder, name);
        let failed = |reason: String| RegistrationFileError::Record { path: path.clone(), reason };
        let text = std::fs::read_to_string(&path).map_err(|error| failed(error.to_string()))?;
        serde_json::from_str(&text).map_err(|error| failed(error.to_string()))
    }
}

/// The registered mesh of a scan in a folder.
pub fn mesh_file(folder: &Path, name: &str) -> PathBuf {
    folder.join(format!("{name}.ply"))
}

fn record_file(folder: &Path, name: &str) -> PathBuf {
    folder.join(format!("{name}.json"))
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;

    #[test]
    fn a_registration_is_read_back_as_written() {
        let folder = tempfile::tempdir().expect("a folder");
        let quality = RegistrationQuality {
            point_to_surface_mm: DistanceSummary { mean: 0.8, p95: 2.0 },
            held_out_mm: DistanceSummary { mean: 0.9, p95: 2.1 },
            surface_to_point_mm: DistanceSummary { mean: 0.5, p95: 1.5 },
            covered_share: 0.9,
            edge_ratio: EdgeRatio { p1: 0.9, p99: 1.1 },
            flipped_faces: 0,
            landmark_mm: None,
            seconds: 0.5,
            code: "ok".into(),
        };
        let record = RegistrationRecord {
            name: "a".into(),
            key: "k".into(),
            quality,
            codes: vec![],
            fitted_model: None,
            metres_per_unit: 0.001,
        };
        let mesh = TriangleMesh::new(vec![DVec3::ZERO, DVec3::X, DVec3::Y], vec![[0, 1, 2]]).expect("valid");
        let scan = RegisteredScan { mesh, record };
        scan.write(folder.path()).expect("writes");
        assert_eq!(RegisteredScan::read(folder.path(), "a").expect("reads"), scan);
        assert!(scan.is_ok());
    }

    #[test]
    fn distances_are_summed_up_in_millimetres() {
        let summary = DistanceSummary::of((1..=100).map(|k| f64::from(k) / 1000.0).collect());
        assert!((summary.mean - 50.5).abs() < 1e-9 && (summary.p95 - 96.0).abs() < 1e-9);
        assert_eq!(DistanceSummary::of(vec![]), DistanceSummary::default());
    }
}
