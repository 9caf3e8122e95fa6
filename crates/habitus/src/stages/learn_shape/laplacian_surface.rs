//! Surfaces from their Laplacian coordinates: δ_i = p_i − mean of the one-ring of i.

use glam::{DMat3, DVec3};
use habitus_geometry::{Topology, best_rotation};
use habitus_optimize::{CholeskyFactor, SolveError, SparseCholesky, SymmetricMatrix};

/// Minimises `Σ ‖(L P)_i − δ_i‖² + Σ anchor_i ‖p_i − target_i‖²`: factorised once for one topology and its anchors.
pub(super) struct LaplacianSurface {
    topology: Topology,
    anchors: Vec<f64>,
    factor: CholeskyFactor,
}

impl LaplacianSurface {
    /// Factorises `LᵀL + diag(anchors)`.
    pub fn new(faces: &[[u32; 3]], anchors: Vec<f64>) -> Result<Self, SolveError> {
        let count = anchors.len();
        let topology = Topology::new(count, faces);
        let rows: Vec<Vec<(usize, f64)>> = (0..count).map(|vertex| row(&topology, vertex)).collect();
        let places = rows.iter().flat_map(|row| {
            row.iter().flat_map(move |(i, _)| row.iter().map(move |(j, _)| (*i, *j)).filter(|(i, j)| i >= j))
        });
        let mut matrix = SymmetricMatrix::with_places(count, places);
        for row in &rows {
            for (i, left) in row {
                for (j, right) in row.iter().filter(|(j, _)| i >= j) {
                    matrix.add(*i, *j, left * right);
                }
            }
        }
        for (vertex, anchor) in anchors.iter().enumerate() {
            matrix.add(vertex, vertex, *anchor);
        }
        let factor = SparseCholesky::analyse(&matrix)?.factorize(&matrix)?;
        Ok(Self { topology, anchors, factor })
    }

    /// The Laplacian coordinates of a surface.
    pub fn coordinates(&self, positions: &[DVec3]) -> Vec<DVec3> {
        (0..positions.len())
            .map(|vertex| {
                row(&self.topology, vertex).iter().map(|(other, value)| positions[*other] * *value).sum()
            })
            .collect()
    }

    /// The surface that comes closest to these coordinates and anchor targets.
    pub fn solve(&self, coordinates: &[DVec3], targets: &[DVec3]) -> Vec<DVec3> {
        let count = targets.len();
        let mut right_hand_sides = vec![0.0; 3 * count];
        let mut add = |vertex: usize, value: DVec3| {
            for (axis, value) in value.to_array().into_iter().enumerate() {
                right_hand_sides[axis * count + vertex] += value;
            }
        };
        for vertex in 0..count {
            for (other, value) in row(&self.topology, vertex) {
                add(other, coordinates[vertex] * value);
            }
            add(vertex, targets[vertex] * self.anchors[vertex]);
        }
        self.factor.solve(&mut right_hand_sides);
        (0..count)
            .map(|vertex| {
                DVec3::from_array(std::array::from_fn(|axis| right_hand_sides[axis * count + vertex]))
            })
            .collect()
    }

    /// For each vertex the rotation that lays its one-ring on `from` best on that on `to`: what the local frames of a
    /// vertex on two surfaces differ by.
    pub fn frame_rotations(&self, from: &[DVec3], to: &[DVec3]) -> Vec<DMat3> {
        (0..from.len())
            .map(|vertex| {
                let mut covariance = DMat3::ZERO;
                for other in self.topology.one_ring(vertex) {
                    let (source, target) =
                        (from[*other as usize] - from[vertex], to[*other as usize] - to[vertex]);
                    covariance += DMat3::from_cols(target * source.x, target * source.y, target * source.z);
                }
                best_rotation(&covariance).unwrap_or(DMat3::IDENTITY)
            })
            .collect()
    }
}

/// A row of the Laplacian: one at the vertex, the rest shared by its neighbours.
fn row(topology: &Topology, vertex: usize) -> Vec<(usize, f64)> {
    let ring = topology.one_ring(vertex);
    let share = -1.0 / ring.len().max(1) as f64;
    std::iter::once((vertex, 1.0)).chain(ring.iter().map(|other| (*other as usize, share))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::body::fixture;

    #[test]
    fn a_surface_comes_back_from_its_coordinates_and_one_anchor_each() {
        let model = fixture::model();
        let positions = model.mean_vertices();
        let surface =
            LaplacianSurface::new(model.faces(), vec![1e-6; positions.len()]).expect("is positive definite");
        let again = surface.solve(&surface.coordinates(positions), positions);
        for (left, right) in again.iter().zip(positions) {
            assert!(left.distance(*right) < 1e-8);
        }
    }

    #[test]
    fn frames_turn_with_the_surface() {
        let model = fixture::model();
        let positions = model.mean_vertices();
        let surface = LaplacianSurface::new(model.faces(), vec![1.0; positions.len()]).expect("factorises");
        let turn = DMat3::from_rotation_y(0.7) * DMat3::from_rotation_x(-0.2);
        let turned: Vec<DVec3> = positions.iter().map(|position| turn * *position).collect();
        for rotation in surface.frame_rotations(positions, &turned) {
            assert!(rotation.abs_diff_eq(turn, 1e-9));
        }
    }
}
