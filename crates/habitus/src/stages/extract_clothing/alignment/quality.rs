//! How well an aligned surface lies on its capture.

use glam::{DMat3, DVec3};
use habitus_geometry::{SurfaceIndex, Topology, TriangleMesh, best_rotation, face_normals};
use rayon::prelude::*;

use super::Capture;
use super::template::ClothingTemplate;
use crate::artifacts::clothing_layer::AlignmentQuality;

/// Faces per parallel piece.
const CHUNK: usize = 512;

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
    let topology = Topology::of_mesh(template.shape());
    AlignmentQuality {
        mean_to_capture,
        mean_from_capture: mean(&from_capture),
        folded_share: folded_share(surface, template.shape(), &topology),
        mean_edge_strain: edge_strain(surface, template.shape(), &topology),
    }
}

/// Share of faces that are turned over: whose normal points against the template's, turned as the face's surroundings have turned.
///
/// The surroundings are the one-rings of the three corners and their turn is the best rotation of all of them, so that cloth may
/// bend, crumple and touch itself. Comparing with the capture's own normal would count both sheets of a thin hem.
fn folded_share(surface: &[DVec3], shape: &TriangleMesh, topology: &Topology) -> f64 {
    let from = shape.positions();
    let (before, after) = (face_normals(from, shape.faces()), face_normals(surface, shape.faces()));
    let is_folded = |(face, corners): (usize, &[u32; 3])| {
        let mut around: Vec<usize> = Vec::with_capacity(16);
        for corner in corners {
            for vertex in topology.one_ring(*corner as usize) {
                if !around.contains(&(*vertex as usize)) {
                    around.push(*vertex as usize);
                }
            }
        }
        let count = around.len().max(1) as f64;
        let mean =
            |positions: &[DVec3]| around.iter().map(|vertex| positions[*vertex]).sum::<DVec3>() / count;
        let (centre_before, centre_after) = (mean(from), mean(surface));
        let mut covariance = DMat3::ZERO;
        for vertex in &around {
            let (arm, turned) = (from[*vertex] - centre_before, surface[*vertex] - centre_after);
            covariance += DMat3::from_cols(turned * arm.x, turned * arm.y, turned * arm.z);
        }
        best_rotation(&covariance).is_none_or(|turn| (turn * before[face]).dot(after[face]) < 0.0)
    };
    let folded =
        shape.faces().par_iter().with_min_len(CHUNK).enumerate().filter(|face| is_folded(*face)).count();
    folded as f64 / shape.faces().len().max(1) as f64
}

fn edge_strain(surface: &[DVec3], shape: &TriangleMesh, topology: &Topology) -> f64 {
    let strain = |[a, b]: &[u32; 2]| {
        let length = |positions: &[DVec3]| positions[*a as usize].distance(positions[*b as usize]);
        (length(surface) / length(shape.positions()).max(1e-9) - 1.0).abs()
    };
    topology.edges().iter().map(strain).sum::<f64>() / topology.edges().len().max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A sheet of 20 × 20 squares of 1 cm.
    fn sheet() -> TriangleMesh {
        const SIDE: u32 = 21;
        let at = |k: u32| DVec3::new(0.01 * f64::from(k % SIDE), 0.0, 0.01 * f64::from(k / SIDE));
        let positions = (0..SIDE * SIDE).map(at).collect();
        let corner = |row, column| row * SIDE + column;
        let squares = (0..SIDE - 1).flat_map(|row| (0..SIDE - 1).map(move |column| (row, column)));
        let faces = squares.flat_map(|(r, c)| {
            let [a, b, d, e] = [corner(r, c), corner(r, c + 1), corner(r + 1, c), corner(r + 1, c + 1)];
            [[a, d, e], [a, e, b]]
        });
        TriangleMesh::new(positions, faces.collect()).expect("a mesh")
    }

    #[test]
    fn cloth_that_bends_and_lies_upon_itself_is_not_folded_but_a_face_turned_over_is() {
        let sheet = sheet();
        let topology = Topology::of_mesh(&sheet);
        // Rolled up with a radius of 2 cm, 1.6 turns, two layers half a millimetre apart, in another pose.
        let rolled: Vec<DVec3> = sheet
            .positions()
            .iter()
            .map(|p| {
                let (angle, radius) = (p.x / 0.02, 0.02 + 0.0005 * p.x / 0.126);
                DMat3::from_rotation_x(2.0) * DVec3::new(radius * angle.sin(), radius * angle.cos(), p.z)
            })
            .collect();
        assert_eq!(folded_share(&rolled, &sheet, &topology), 0.0);
        // One vertex goes past its neighbour, in the surface: the faces between them turn over.
        let mut torn = rolled;
        let middle = 10 * 21 + 10;
        let beyond = torn[middle + 1] - torn[middle];
        torn[middle] += beyond * 1.5;
        let turned = folded_share(&torn, &sheet, &topology) * sheet.faces().len() as f64;
        assert!((1.5..=6.5).contains(&turned), "of the six faces around it: {turned}");
    }
}
