//! Folds finer than the graph: each vertex moves onto the capture, its surroundings turning but not stretching with it.

use glam::{DMat3, DVec3};
use habitus_geometry::{Topology, TriangleMesh, best_rotation, vertex_normals_into};
use habitus_optimize::{SolveError, SparseCholesky, SymmetricMatrix};
use rayon::prelude::*;

use super::super::config::DetailConfig;
use super::Capture;
use crate::fitting::correspondence::ClosestField;

/// Vertices per parallel piece.
const CHUNK: usize = 256;

/// Σ w_i (n_i · (x_i − q_i))² + stiffness · Σ_edges ‖x_i − x_j − R (p_i − p_j)‖², the second term as rigid as possible
/// (Sorkine and Alexa 2007) about the template p: lengths stay, so that neighbours cannot pass one another where the capture's
/// folds are narrow. Rotations and targets are frozen in a round. A target is the vertex itself, moved along the normal of its
/// partner only; the three coordinates then share one matrix, whose pattern is the same for all frames.
pub(super) struct DetailSolver {
    edges: Vec<[u32; 2]>,
    topology: Topology,
    matrix: SymmetricMatrix,
    cholesky: SparseCholesky,
}

impl DetailSolver {
    pub fn new(shape: &TriangleMesh) -> Result<Self, SolveError> {
        let topology = Topology::of_mesh(shape);
        let edges = topology.edges().to_vec();
        let places = edges.iter().map(|[a, b]| (*a as usize, *b as usize));
        let matrix = SymmetricMatrix::with_places(shape.positions().len(), places);
        let cholesky = SparseCholesky::analyse(&matrix)?;
        Ok(Self { edges, topology, matrix, cholesky })
    }

    /// Moves a surface that is near its capture onto it, in metres.
    pub fn add(
        &mut self,
        surface: &mut [DVec3],
        shape: &TriangleMesh,
        capture: &Capture,
        config: &DetailConfig,
    ) -> Result<(), SolveError> {
        let mut normals = Vec::new();
        let mut field: Option<ClosestField> = None;
        let smallest_cosine = config.angle_deg.to_radians().cos();
        for round in 0..config.rounds {
            let stiffness = config.stiffness.weight(round, config.rounds).max(config.smallest_stiffness);
            vertex_normals_into(surface, shape.faces(), &mut normals);
            let found = ClosestField::find(&capture.index, surface, field.as_ref());
            self.matrix.clear();
            let mut sums = vec![DVec3::ZERO; surface.len()];
            for (vertex, point) in found.points.iter().enumerate() {
                let gap = point.position - surface[vertex];
                let is_credible = point.normal.dot(normals[vertex]) >= smallest_cosine
                    && point.distance_squared <= config.largest_shift * config.largest_shift;
                let weight = if is_credible { 1.0 } else { config.resting_weight };
                let shift = if is_credible { point.normal * gap.dot(point.normal) } else { DVec3::ZERO };
                sums[vertex] = (surface[vertex] + shift) * weight;
                self.matrix.add(vertex, vertex, weight);
            }
            let rotations = self.rotations(shape.positions(), surface);
            for [a, b] in &self.edges {
                let (a, b) = (*a as usize, *b as usize);
                let edge = shape.positions()[a] - shape.positions()[b];
                let turned = (rotations[a] * edge + rotations[b] * edge) * (0.5 * stiffness);
                sums[a] += turned;
                sums[b] -= turned;
                self.matrix.add(a, a, stiffness);
                self.matrix.add(b, b, stiffness);
                self.matrix.add(a, b, -stiffness);
            }
            let factor = self.cholesky.factorize(&self.matrix)?;
            for axis in 0..3 {
                let mut coordinate: Vec<f64> = sums.iter().map(|sum| sum[axis]).collect();
                factor.solve(&mut coordinate);
                surface.iter_mut().zip(coordinate).for_each(|(position, value)| position[axis] = value);
            }
            field = Some(found);
        }
        Ok(())
    }

    /// The turn of each vertex's surroundings from the template to a surface.
    fn rotations(&self, from: &[DVec3], to: &[DVec3]) -> Vec<DMat3> {
        let turn = |vertex: usize| {
            let mut covariance = DMat3::ZERO;
            for other in self.topology.one_ring(vertex) {
                let other = *other as usize;
                let (before, after) = (from[other] - from[vertex], to[other] - to[vertex]);
                covariance += DMat3::from_cols(after * before.x, after * before.y, after * before.z);
            }
            best_rotation(&covariance).unwrap_or(DMat3::IDENTITY)
        };
        (0..from.len()).into_par_iter().with_min_len(CHUNK).map(turn).collect()
    }
}
