//! Joining vertices that lie in one place, such as the two sides of a texture seam.

use std::collections::HashMap;

use glam::DVec3;

use crate::mesh::repeated_vertex;

/// A welded mesh with what became of its parts.
#[derive(Debug, Clone, PartialEq)]
pub struct Welded {
    /// The kept positions: of each group the one with the lowest index, unmoved, in the order given.
    pub positions: Vec<DVec3>,
    /// The faces over the kept positions, without those that the weld made degenerate.
    pub faces: Vec<[u32; 3]>,
    /// For each given vertex its place in `positions`.
    pub map: Vec<u32>,
    /// How many vertices were joined to another.
    pub joined_vertex_count: usize,
    /// How many faces became degenerate and were dropped.
    pub dropped_face_count: usize,
}

/// Joins each vertex to the first kept one within `tolerance` (in the positions' unit; 0 joins equal positions only).
pub fn weld(positions: &[DVec3], faces: &[[u32; 3]], tolerance: f64) -> Welded {
    let mut kept = KeptVertices::new(tolerance);
    let map: Vec<u32> = positions.iter().map(|position| kept.place(*position)).collect();
    let mut welded_faces = Vec::with_capacity(faces.len());
    for face in faces {
        let welded = face.map(|vertex| map[vertex as usize]);
        if repeated_vertex(welded).is_none() {
            welded_faces.push(welded);
        }
    }
    Welded {
        joined_vertex_count: positions.len() - kept.positions.len(),
        dropped_face_count: faces.len() - welded_faces.len(),
        positions: kept.positions,
        faces: welded_faces,
        map,
    }
}

/// Kept positions in a hash grid whose cells are as wide as the tolerance, so that a match is at most one cell away.
struct KeptVertices {
    positions: Vec<DVec3>,
    tolerance: f64,
    cells: HashMap<[u64; 3], Vec<u32>>,
}

impl KeptVertices {
    fn new(tolerance: f64) -> Self {
        Self { positions: Vec::new(), tolerance: tolerance.max(0.0), cells: HashMap::new() }
    }

    fn place(&mut self, position: DVec3) -> u32 {
        if let Some(found) = self.find(position) {
            return found;
        }
        let vertex = self.positions.len() as u32;
        self.positions.push(position);
        self.cells.entry(self.cell(position)).or_default().push(vertex);
        vertex
    }

    fn find(&self, position: DVec3) -> Option<u32> {
        if self.tolerance == 0.0 {
            return self.cells.get(&self.cell(position)).map(|vertices| vertices[0]);
        }
        let mut found: Option<u32> = None;
        for neighbour in 0..27 {
            let step = DVec3::new((neighbour % 3) as f64, (neighbour / 3 % 3) as f64, (neighbour / 9) as f64);
            let cell = self.cell(position + (step - DVec3::ONE) * self.tolerance);
            for &vertex in self.cells.get(&cell).into_iter().flatten() {
                if self.positions[vertex as usize].distance(position) <= self.tolerance {
                    found = Some(found.map_or(vertex, |lowest| lowest.min(vertex)));
                }
            }
        }
        found
    }

    fn cell(&self, position: DVec3) -> [u64; 3] {
        // Adding zero makes −0 equal to 0.
        let key = if self.tolerance == 0.0 { position } else { (position / self.tolerance).floor() };
        key.to_array().map(|coordinate| (coordinate + 0.0).to_bits())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_seam_closes_and_the_map_tells_where_each_vertex_went() {
        let positions = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::X, DVec3::Y, DVec3::ONE];
        let welded = weld(&positions, &[[0, 1, 2], [3, 5, 4]], 0.0);
        assert_eq!(welded.map, [0, 1, 2, 1, 2, 3]);
        assert_eq!(welded.faces, [[0, 1, 2], [1, 3, 2]]);
        assert_eq!((welded.joined_vertex_count, welded.dropped_face_count), (2, 0));
    }

    #[test]
    fn the_tolerance_is_a_distance_also_across_cell_borders() {
        let tolerance = 0.1;
        for offset in [0.0, 0.05, 0.0999, 12.34] {
            let base = DVec3::splat(offset);
            let near = base + DVec3::new(0.05, 0.06, 0.05);
            let far = base - DVec3::new(0.0, 0.11, 0.0);
            let welded = weld(&[base, near, far], &[], tolerance);
            assert_eq!(welded.map, [0, 0, 1], "offset {offset}");
        }
    }

    #[test]
    fn faces_that_collapse_are_counted_and_zero_signs_do_not_matter() {
        let welded = weld(&[DVec3::ZERO, -DVec3::ZERO, DVec3::X], &[[0, 1, 2]], 0.0);
        assert_eq!(welded.positions.len(), 2);
        assert_eq!((welded.faces.len(), welded.dropped_face_count), (0, 1));
    }
}
