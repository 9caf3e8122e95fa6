//! Folds finer than the graph: each vertex moves along its own normal, neighbours alike.

use glam::DVec3;
use habitus_geometry::{Topology, TriangleMesh, vertex_normals_into};
use habitus_optimize::{SolveError, SparseCholesky, SymmetricMatrix};

use super::super::config::DetailConfig;
use super::Capture;
use crate::fitting::correspondence::ClosestField;

/// Σ w_i (s_i − r_i)² + stiffness · Σ_edges (s_i − s_j)² over the shifts s along the normals: one unknown a vertex, one
/// pattern for all frames.
pub(super) struct DetailSolver {
    edges: Vec<[u32; 2]>,
    matrix: SymmetricMatrix,
    cholesky: SparseCholesky,
}

impl DetailSolver {
    pub fn new(shape: &TriangleMesh, _: &DetailConfig) -> Result<Self, SolveError> {
        let edges = Topology::of_mesh(shape).edges().to_vec();
        let places = edges.iter().map(|[a, b]| (*a as usize, *b as usize));
        let matrix = SymmetricMatrix::with_places(shape.positions().len(), places);
        let cholesky = SparseCholesky::analyse(&matrix)?;
        Ok(Self { edges, matrix, cholesky })
    }

    /// Moves a surface that is near its capture onto it, in metres.
    pub fn add(
        &mut self,
        surface: &mut [DVec3],
        faces: &[[u32; 3]],
        capture: &Capture,
        config: &DetailConfig,
    ) -> Result<(), SolveError> {
        let mut normals = Vec::new();
        let mut field: Option<ClosestField> = None;
        let smallest_cosine = config.angle_deg.to_radians().cos();
        for _ in 0..config.rounds {
            vertex_normals_into(surface, faces, &mut normals);
            let found = ClosestField::find(&capture.index, surface, field.as_ref());
            self.matrix.clear();
            let mut shifts = vec![0.0; surface.len()];
            for (vertex, point) in found.points.iter().enumerate() {
                let normal = normals[vertex];
                let gap = point.position - surface[vertex];
                let is_credible = point.normal.dot(normal) >= smallest_cosine
                    && point.distance_squared <= config.largest_shift * config.largest_shift;
                let weight = if is_credible { 1.0 } else { 0.0 };
                shifts[vertex] = weight * gap.dot(normal);
                // The little that keeps a vertex without a pair and its whole island in place.
                self.matrix.add(vertex, vertex, weight + config.resting_weight);
            }
            for [a, b] in &self.edges {
                let (a, b) = (*a as usize, *b as usize);
                self.matrix.add(a, a, config.stiffness);
                self.matrix.add(b, b, config.stiffness);
                self.matrix.add(a, b, -config.stiffness);
            }
            self.cholesky.factorize(&self.matrix)?.solve(&mut shifts);
            for ((position, normal), shift) in surface.iter_mut().zip(&normals).zip(shifts) {
                *position += *normal * shift;
            }
            field = Some(found);
        }
        Ok(())
    }
}
