//! How well an aligned surface lies on its capture.

use glam::DVec3;
use habitus_geometry::{SurfaceIndex, Topology, TriangleMesh, face_normals};

use super::Capture;
use super::template::ClothingTemplate;
use crate::artifacts::clothing_layer::AlignmentQuality;

/// Distances both ways, folds and strain of a surface in the template's connectivity, metres.
pub(super) fn measure_quality(
    surface: &[DVec3],
    template: &ClothingTemplate,
    capture: &Capture,
) -> AlignmentQuality {
    let mut closest = Vec::new();
    capture.index.closest_many(surface, None, &mut closest);
    let mean = |closest: &[habitus_geometry::SurfacePoint]| {
        let sum: f64 = closest.iter().map(|point| point.distance_squared.sqrt()).sum();
        sum / closest.len().max(1) as f64
    };
    let mean_to_capture = mean(&closest);
    let samples: Vec<DVec3> = capture.samples.iter().map(|(position, _)| *position).collect();
    let mut from_capture = Vec::new();
    if let Ok(mesh) = TriangleMesh::new(surface.to_vec(), template.faces().to_vec()) {
        SurfaceIndex::of_mesh(&mesh).closest_many(&samples, None, &mut from_capture);
    }
    AlignmentQuality {
        mean_to_capture,
        mean_from_capture: mean(&from_capture),
        folded_share: folded_share(surface, template.faces(), capture),
        mean_edge_strain: edge_strain(surface, template.shape()),
    }
}

/// Share of faces that look to the other side than the capture does under their middle.
fn folded_share(surface: &[DVec3], faces: &[[u32; 3]], capture: &Capture) -> f64 {
    let middles: Vec<DVec3> = faces
        .iter()
        .map(|face| face.iter().map(|vertex| surface[*vertex as usize]).sum::<DVec3>() / 3.0)
        .collect();
    let mut closest = Vec::new();
    capture.index.closest_many(&middles, None, &mut closest);
    let normals = face_normals(surface, faces);
    let folded = normals.iter().zip(&closest).filter(|(normal, point)| normal.dot(point.normal) < 0.0);
    folded.count() as f64 / faces.len().max(1) as f64
}

fn edge_strain(surface: &[DVec3], shape: &TriangleMesh) -> f64 {
    let topology = Topology::of_mesh(shape);
    let strain = |[a, b]: &[u32; 2]| {
        let length = |positions: &[DVec3]| positions[*a as usize].distance(positions[*b as usize]);
        (length(surface) / length(shape.positions()).max(1e-9) - 1.0).abs()
    };
    topology.edges().iter().map(strain).sum::<f64>() / topology.edges().len().max(1) as f64
}
