//! Landmarks of raw scans: named vertices of the template, and where a person would have put them.

use glam::DVec3;
use habitus::body::{BodyModel, PartLabel};
use habitus::geometry::{SurfaceIndex, TriangleMesh};
use habitus::statistics::RandomStream;

use super::RawScanSettings;

/// P1 §3.1: 64 landmarks.
const LANDMARK_COUNT: usize = 64;

/// Names and template vertices of landmarks.
#[derive(Debug, Clone, PartialEq)]
pub struct LandmarkTable {
    /// Names with their vertices, each name once.
    pub entries: Vec<(String, u32)>,
}

impl LandmarkTable {
    /// The model's landmarks and measurement vertices, and further vertices spread evenly over everything but the hands
    /// (`spread_00` …) up to P1's 64.
    pub fn of(model: &BodyModel) -> Self {
        let metadata = model.metadata();
        let mut entries: Vec<(String, u32)> =
            metadata.landmarks.iter().cloned().zip(model.landmark_vertices().iter().copied()).collect();
        for (name, vertex) in &metadata.measurement_vertices {
            if !entries.iter().any(|(known, at)| known == name || at == vertex) {
                entries.push((name.clone(), *vertex));
            }
        }
        let positions = model.mean_vertices();
        let mut distances: Vec<f64> = positions
            .iter()
            .zip(model.part_labels())
            .map(|(position, label)| {
                let nearest =
                    entries.iter().map(|(_, vertex)| position.distance_squared(positions[*vertex as usize]));
                if *label == PartLabel::Hand { 0.0 } else { nearest.fold(f64::INFINITY, f64::min) }
            })
            .collect();
        for number in 0..LANDMARK_COUNT.saturating_sub(entries.len()) {
            let farthest =
                (0..distances.len()).fold(0, |best, v| if distances[v] > distances[best] { v } else { best });
            for (distance, position) in distances.iter_mut().zip(positions) {
                *distance = distance.min(position.distance_squared(positions[farthest]));
            }
            entries.push((format!("spread_{number:02}"), farthest as u32));
        }
        Self { entries }
    }
}

/// A landmark on a scan.
#[derive(Debug, Clone, PartialEq)]
pub struct PlacedLandmark {
    /// The landmark's name.
    pub name: String,
    /// Where it was put, metres.
    pub position: DVec3,
}

/// Puts landmarks on a body with an error along its surface; some are forgotten.
pub(super) fn place_landmarks(
    model: &BodyModel,
    vertices: &[DVec3],
    table: &LandmarkTable,
    settings: &RawScanSettings,
    random: &mut RandomStream,
) -> Vec<PlacedLandmark> {
    let index = TriangleMesh::new(vertices.to_vec(), model.faces().to_vec())
        .ok()
        .map(|mesh| SurfaceIndex::of_mesh(&mesh));
    let error = settings.landmark_error_mm / 1000.0;
    let mut placed = Vec::with_capacity(table.entries.len());
    for (name, vertex) in &table.entries {
        let offset = DVec3::new(random.normal(), random.normal(), random.normal()) * error;
        let is_missing = random.unit() < settings.landmark_missing_probability;
        let aimed = vertices[*vertex as usize] + offset;
        let position = index.as_ref().map_or(aimed, |index| index.closest(aimed).position);
        if !is_missing {
            placed.push(PlacedLandmark { name: name.clone(), position });
        }
    }
    placed
}
