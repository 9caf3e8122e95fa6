//! What raw captures carry besides the person: crumbs and the floor, removed with a report.

use std::collections::HashSet;

use glam::DVec3;

use crate::frame_of_reference::SignedAxis;
use crate::mesh::{PointCloud, Surface, TriangleMesh};
use crate::normals::doubled_area_vector;
use crate::topology::components;

/// What [`remove_small_components`] removed.
#[derive(Debug, Clone, PartialEq)]
pub struct ComponentReport {
    /// How many components with faces there were.
    pub component_count: usize,
    /// How many of them were kept.
    pub kept_component_count: usize,
    /// How many vertices were removed, those without faces included.
    pub removed_vertex_count: usize,
    /// How many faces were removed.
    pub removed_face_count: usize,
    /// For each given vertex its new index, if it was kept.
    pub map: Vec<Option<u32>>,
}

/// Keeps the components whose area is at least `smallest_share` (0 to 1) of the whole; the largest always stays.
pub fn remove_small_components(mesh: &TriangleMesh, smallest_share: f64) -> (TriangleMesh, ComponentReport) {
    let labels = components(mesh.positions().len(), mesh.faces());
    let label_of = |face: &[u32; 3]| labels[face[0] as usize] as usize;
    let mut areas: Vec<Option<f64>> = vec![None; labels.len()];
    for face in mesh.faces() {
        let area = 0.5 * doubled_area_vector(mesh.positions(), *face).length();
        *areas[label_of(face)].get_or_insert(0.0) += area;
    }
    let total: f64 = areas.iter().flatten().sum();
    let largest = areas.iter().flatten().fold(0.0, |largest: f64, area| largest.max(*area));
    let is_kept =
        |label: usize| areas[label].is_some_and(|area| area >= (smallest_share * total).min(largest));

    let kept_faces: Vec<[u32; 3]> =
        mesh.faces().iter().copied().filter(|face| is_kept(label_of(face))).collect();
    let (positions, faces, map) = compacted(mesh.positions(), &kept_faces);
    let report = ComponentReport {
        component_count: areas.iter().flatten().count(),
        kept_component_count: (0..areas.len()).filter(|&label| is_kept(label)).count(),
        removed_vertex_count: mesh.positions().len() - positions.len(),
        removed_face_count: mesh.faces().len() - faces.len(),
        map,
    };
    // The largest component has a face, and every face was valid before.
    let kept = TriangleMesh::new(positions, faces).unwrap_or_else(|_| mesh.clone());
    (kept, report)
}

/// The vertices that faces name, in their old order, the faces over them, and where each vertex went.
fn compacted(positions: &[DVec3], faces: &[[u32; 3]]) -> (Vec<DVec3>, Vec<[u32; 3]>, Vec<Option<u32>>) {
    let mut is_used = vec![false; positions.len()];
    for vertex in faces.iter().flatten() {
        is_used[*vertex as usize] = true;
    }
    let mut kept = Vec::new();
    let mut new_index = vec![0; positions.len()];
    for (vertex, position) in positions.iter().enumerate().filter(|(vertex, _)| is_used[*vertex]) {
        new_index[vertex] = kept.len() as u32;
        kept.push(*position);
    }
    let faces = faces.iter().map(|face| face.map(|vertex| new_index[vertex as usize])).collect();
    let map = is_used.iter().zip(&new_index).map(|(is_used, index)| is_used.then_some(*index)).collect();
    (kept, faces, map)
}

/// A floor that [`drop_floor_plane`] found and removed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FloorReport {
    /// Its height along up, in the file's unit.
    pub height: f64,
    /// The area that it covers, relative to the square of the whole height.
    pub relative_area: f64,
    /// How many vertices or points lay in it or below it and were removed.
    pub removed_vertex_count: usize,
}

/// Heights relative to the whole height of the surface.
mod floor {
    /// A floor lies no higher than this.
    pub const SEARCHED: f64 = 0.15;
    /// The thickness of the layers among which the fullest is taken for the floor.
    pub const LAYER: f64 = 0.005;
    /// How far points of the floor lie from its middle.
    pub const HALF_THICKNESS: f64 = 0.0075;
    /// The side of the cells by which the covered area is counted.
    pub const CELL: f64 = 0.05;
    /// The smallest area of a floor: soles cover about 0.02, the hem of a wide dress about 0.1.
    pub const SMALLEST_AREA: f64 = 0.2;
}

/// The surface without a large horizontal plane at its bottom, or `None` where there is none.
///
/// What stands on the plane loses the lowest 0.75 % of the height with it.
pub fn drop_floor_plane(surface: &Surface, up: SignedAxis) -> Option<(Surface, FloorReport)> {
    let positions = surface.positions();
    let heights: Vec<f64> = positions.iter().map(|position| position.dot(up.vector())).collect();
    let lowest = heights.iter().copied().fold(f64::INFINITY, f64::min);
    let whole = heights.iter().copied().fold(f64::NEG_INFINITY, f64::max) - lowest;
    if whole <= 0.0 {
        return None;
    }
    let mut layers = vec![0usize; (floor::SEARCHED / floor::LAYER).ceil() as usize];
    for height in &heights {
        if let Some(count) = layers.get_mut(((height - lowest) / (whole * floor::LAYER)) as usize) {
            *count += 1;
        }
    }
    let fullest =
        (0..layers.len()).fold(0, |best, layer| if layers[layer] > layers[best] { layer } else { best });
    let middle = lowest + (fullest as f64 + 0.5) * whole * floor::LAYER;
    let top = middle + whole * floor::HALF_THICKNESS;

    let side = up.vector().any_orthonormal_vector();
    let across = up.vector().cross(side);
    let cell = whole * floor::CELL;
    let covered: HashSet<(i64, i64)> = positions
        .iter()
        .zip(&heights)
        .filter(|(_, height)| (**height - middle).abs() <= whole * floor::HALF_THICKNESS)
        .map(|(position, _)| {
            ((position.dot(side) / cell).floor() as i64, (position.dot(across) / cell).floor() as i64)
        })
        .collect();
    let relative_area = covered.len() as f64 * floor::CELL * floor::CELL;
    if relative_area < floor::SMALLEST_AREA {
        return None;
    }
    let above = above(surface, &heights, top)?;
    let removed_vertex_count = positions.len() - above.positions().len();
    Some((above, FloorReport { height: middle, relative_area, removed_vertex_count }))
}

/// The part of a surface above a height, if anything is left of it.
fn above(surface: &Surface, heights: &[f64], top: f64) -> Option<Surface> {
    match surface {
        Surface::Mesh(mesh) => {
            let is_above = |face: &[u32; 3]| face.iter().any(|vertex| heights[*vertex as usize] > top);
            let faces: Vec<[u32; 3]> = mesh.faces().iter().copied().filter(is_above).collect();
            let (positions, faces, _) = compacted(mesh.positions(), &faces);
            TriangleMesh::new(positions, faces).ok().map(Surface::Mesh)
        }
        Surface::Cloud(cloud) => {
            let kept = |values: &[DVec3]| -> Vec<DVec3> {
                values
                    .iter()
                    .zip(heights)
                    .filter(|(_, height)| **height > top)
                    .map(|(value, _)| *value)
                    .collect()
            };
            PointCloud::new(kept(cloud.positions()), cloud.normals().map(kept)).ok().map(Surface::Cloud)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A box standing on y = 0, one metre wide and two metres tall, with its lid triangulated finely.
    fn pillar(width: f64) -> Vec<DVec3> {
        let mut points = Vec::new();
        for i in 0..20 {
            for j in 0..20 {
                let (u, v) = (f64::from(i) / 19.0, f64::from(j) / 19.0);
                points.push(DVec3::new(width * u, 2.0 * v, 0.0));
                points.push(DVec3::new(width * u, 2.0 * v, width));
            }
        }
        points
    }

    fn floor_points() -> Vec<DVec3> {
        (0..60 * 60)
            .map(|place| {
                DVec3::new(f64::from(place % 60) / 20.0 - 1.5, 0.002, f64::from(place / 60) / 20.0 - 1.5)
            })
            .collect()
    }

    #[test]
    fn crumbs_go_and_the_largest_component_stays() {
        let positions = vec![
            DVec3::ZERO,
            DVec3::X,
            DVec3::Y,
            DVec3::Z,
            DVec3::Z + DVec3::X * 0.1,
            DVec3::Z + DVec3::Y * 0.1,
            DVec3::ONE * 9.0,
        ];
        let mesh = TriangleMesh::new(positions, vec![[3, 4, 5], [0, 1, 2]]).unwrap();
        let (kept, report) = remove_small_components(&mesh, 0.05);
        assert_eq!(kept.faces(), [[0, 1, 2]]);
        assert_eq!((report.component_count, report.kept_component_count), (2, 1));
        assert_eq!((report.removed_vertex_count, report.removed_face_count), (4, 1));
        assert_eq!(report.map[..4], [Some(0), Some(1), Some(2), None]);
        assert_eq!(remove_small_components(&mesh, 1.0).0.faces().len(), 1);
        assert_eq!(remove_small_components(&mesh, 0.0).0.faces().len(), 2);
    }

    #[test]
    fn a_floor_is_found_and_removed_in_any_direction() {
        for up in SignedAxis::ALL {
            let frame = crate::frame_of_reference::FrameOfReference { metres_per_unit: 1.0, up };
            let points: Vec<DVec3> =
                pillar(0.4).into_iter().chain(floor_points()).map(|point| frame.to_input(point)).collect();
            let cloud = Surface::Cloud(PointCloud::new(points, None).unwrap());
            let (above, report) = drop_floor_plane(&cloud, up).unwrap();
            // The pillar's lowest row of 40 points goes with the floor.
            assert_eq!(above.positions().len(), pillar(0.4).len() - 40);
            assert!(report.height.abs() < 0.01);
        }
    }

    #[test]
    fn the_foot_of_what_stands_there_is_no_floor() {
        let cloud = Surface::Cloud(PointCloud::new(pillar(0.4), None).unwrap());
        assert!(drop_floor_plane(&cloud, SignedAxis::PlusY).is_none());
        let point = Surface::Cloud(PointCloud::new(vec![DVec3::ONE], None).unwrap());
        assert!(drop_floor_plane(&point, SignedAxis::PlusY).is_none());
    }

    #[test]
    fn a_mesh_loses_the_faces_of_its_floor() {
        let mut positions = floor_points();
        let first = positions.len() as u32;
        positions.extend([DVec3::Y * 0.5, DVec3::new(0.2, 2.0, 0.0), DVec3::new(-0.2, 2.0, 0.0)]);
        let mut faces: Vec<[u32; 3]> =
            (0..59 * 60).filter(|v| v % 60 < 59).map(|v| [v, v + 60, v + 1]).collect();
        faces.push([first, first + 1, first + 2]);
        let mesh = Surface::Mesh(TriangleMesh::new(positions, faces).unwrap());
        let (above, report) = drop_floor_plane(&mesh, SignedAxis::PlusY).unwrap();
        assert_eq!(above.positions().len(), 3);
        assert_eq!(report.removed_vertex_count, 3600);
    }
}
