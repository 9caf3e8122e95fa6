//! P1 §3.1: one affine map for each vertex, minimising Eq. 7 exactly or by L-BFGS-B.

use glam::DVec3;
use habitus_optimize::{Bounds, LbfgsbSettings, Silent, SolveError, SparseCholesky, SymmetricMatrix, lbfgsb};

use super::RegisterError;
use super::config::{AffineOrigin, AffineSolver, PaperRound};
use super::template::PreparedTemplate;
use crate::fitting::Fit;
use crate::fitting::correspondence::Correspondence;
use crate::fitting::deformers::{PARAMETERS_PER_VERTEX, VertexAffines};
use crate::fitting::terms::{
    AffineMetric, ClosestPoints, DistanceForm, LandmarkPull, LandmarkTargets, SmoothAffines,
};

/// Unknowns of one vertex along one axis: a row of the linear part, and the offset.
const PER_AXIS: usize = 4;
/// P1's weights belong to millimetres; all residuals here are metres.
const MILLIMETRE: f64 = 0.001;

/// The places of the axes' common matrix and their analysis: once for each template.
pub(super) fn analyse(
    vertex_count: usize,
    edges: &[[u32; 2]],
) -> Result<(SymmetricMatrix, SparseCholesky), SolveError> {
    let within = (0..vertex_count).map(|vertex| [vertex, vertex]);
    let across = edges.iter().map(|edge| edge.map(|vertex| vertex as usize));
    let places = within.chain(across).flat_map(|[a, b]| {
        (0..PER_AXIS * PER_AXIS).map(move |k| (PER_AXIS * a + k / PER_AXIS, PER_AXIS * b + k % PER_AXIS))
    });
    let matrix = SymmetricMatrix::with_places(PER_AXIS * vertex_count, places);
    let cholesky = SparseCholesky::analyse(&matrix)?;
    Ok((matrix, cholesky))
}

/// Affine maps of a template about a start.
pub(super) struct AffineFit<'a> {
    template: &'a PreparedTemplate<'a>,
    affines: VertexAffines,
    metric: AffineMetric,
    /// What β is multiplied with.
    smoothness_factor: f64,
    parameters: Vec<f64>,
}

impl<'a> AffineFit<'a> {
    /// Identity maps of the start's vertices, metres.
    pub fn new(template: &'a PreparedTemplate<'a>, start: &[DVec3]) -> Self {
        let bounds = start.iter().fold([DVec3::INFINITY, DVec3::NEG_INFINITY], |[low, high], vertex| {
            [low.min(*vertex), high.max(*vertex)]
        });
        let size = (bounds[1] - bounds[0]).max_element().max(1e-6);
        let affines = VertexAffines::new(start.to_vec(), size);
        // Deviation: P1 Eq. 5 sums the entries of matrices over absolute millimetres, so that a displacement u is cheap
        // far from the origin, β (u / |p|)². Over coordinates about the edge and in units of the body's size all entries
        // are free of units, and the same β means the same everywhere.
        let (metric, smoothness_factor) = match template.config.paper.origin {
            AffineOrigin::Edge => (AffineMetric::AtEdge, (MILLIMETRE / size).powi(2)),
            AffineOrigin::World => (AffineMetric::Printed { unit: MILLIMETRE }, 1.0),
        };
        let parameters = vec![0.0; PARAMETERS_PER_VERTEX * start.len()];
        Self { template, affines, metric, smoothness_factor, parameters }
    }

    /// The bent vertices.
    pub fn vertices(&self) -> Vec<DVec3> {
        self.affines.vertices(&self.parameters)
    }

    /// Minimises P1 Eq. 7 over frozen pairs.
    pub fn solve(
        &mut self,
        round: &PaperRound,
        pairs: &[Correspondence],
        landmarks: &[LandmarkPull],
    ) -> Result<(), RegisterError> {
        match self.template.config.paper.solver {
            AffineSolver::SparseCholesky => self.solve_exactly(round, pairs, landmarks),
            AffineSolver::Lbfgsb => self.solve_lbfgsb(round, pairs, landmarks),
        }
    }

    fn solve_lbfgsb(
        &mut self,
        round: &PaperRound,
        pairs: &[Correspondence],
        landmarks: &[LandmarkPull],
    ) -> Result<(), RegisterError> {
        let smooth = SmoothAffines::new(&self.affines, &self.template.edges, self.metric);
        let data = ClosestPoints::new(pairs, DistanceForm::Point);
        let landmarks = LandmarkTargets::new(landmarks);
        let fit = Fit::new(&self.affines)
            .with(round.closest_points, &data)
            .with(round.smooth_affines * self.smoothness_factor, &smooth)
            .with(round.landmarks, &landmarks);
        let count = self.parameters.len();
        let bounds = Bounds::new(vec![f64::NEG_INFINITY; count], vec![f64::INFINITY; count])?;
        let settings = LbfgsbSettings {
            max_iterations: self.template.config.paper.lbfgsb_iterations,
            ..LbfgsbSettings::default()
        };
        lbfgsb(&fit, &mut self.parameters, &bounds, &settings, &mut Silent)?;
        Ok(())
    }

    fn solve_exactly(
        &mut self,
        round: &PaperRound,
        pairs: &[Correspondence],
        landmarks: &[LandmarkPull],
    ) -> Result<(), RegisterError> {
        let Some((places, cholesky)) = &self.template.affine else {
            return Err(RegisterError::NotPrepared);
        };
        let smooth = SmoothAffines::new(&self.affines, &self.template.edges, self.metric);
        let smooth_affines = round.smooth_affines * self.smoothness_factor;
        let mut matrix = places.clone();
        matrix.clear();
        for edge in &self.template.edges {
            let rows = smooth.rows(*edge);
            let columns: [usize; 2 * PER_AXIS] =
                std::array::from_fn(|k| PER_AXIS * edge[k / PER_AXIS] as usize + k % PER_AXIS);
            let mut block = [0.0; 4 * PER_AXIS * PER_AXIS];
            for row in rows {
                for (i, a) in row.iter().enumerate().filter(|(_, a)| **a != 0.0) {
                    for (j, b) in row.iter().enumerate() {
                        block[2 * PER_AXIS * i + j] += smooth_affines * a * b;
                    }
                }
            }
            matrix.add_block(&columns, &block);
        }
        let count = PER_AXIS * self.affines.rest().len();
        let mut sides = vec![0.0; 3 * count];
        let data = pairs.iter().map(|pair| (pair.vertex, pair.target, round.closest_points * pair.weight));
        let marks =
            landmarks.iter().map(|pull| (pull.vertex, pull.target, round.landmarks * pull.confidence));
        for (vertex, target, weight) in data.chain(marks).filter(|(_, _, weight)| *weight > 0.0) {
            let place = PER_AXIS * vertex as usize + 3;
            matrix.add(place, place, weight);
            let offset = target - self.affines.rest()[vertex as usize];
            for (axis, value) in offset.to_array().into_iter().enumerate() {
                sides[axis * count + place] += weight * value;
            }
        }
        // Without data and with few landmarks some affine motion is free: the start is the least of them.
        let dust = 1e-9 * smooth_affines;
        for place in 0..count {
            matrix.add(place, place, dust);
        }
        cholesky.factorize(&matrix)?.solve(&mut sides);
        for vertex in 0..self.affines.rest().len() {
            for axis in 0..3 {
                let from = axis * count + PER_AXIS * vertex;
                let to = PARAMETERS_PER_VERTEX * vertex + PER_AXIS * axis;
                self.parameters[to..to + PER_AXIS].copy_from_slice(&sides[from..from + PER_AXIS]);
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use habitus_geometry::TriangleMesh;

    use super::*;
    use crate::artifacts::template_mesh::TemplateMesh;
    use crate::stages::register::config::{PaperConfig, RegisterConfig};
    use crate::stages::register::template::Template;

    /// A bent sheet of some vertices.
    fn sheet() -> TemplateMesh {
        const COUNT: u32 = 6;
        let place = |k: u32| DVec3::new(f64::from(k % COUNT) * 0.1, f64::from(k / COUNT) * 0.1, 0.0);
        let bent = |point: DVec3| DVec3::new(point.x, point.y, 0.2 * (3.0 * point.x).sin());
        let faces = (0..(COUNT - 1) * (COUNT - 1))
            .flat_map(|k| {
                let a = k / (COUNT - 1) * COUNT + k % (COUNT - 1);
                [[a, a + 1, a + COUNT + 1], [a, a + COUNT + 1, a + COUNT]]
            })
            .collect();
        let positions = (0..COUNT * COUNT).map(|k| bent(place(k))).collect();
        let mesh = TriangleMesh::new(positions, faces).expect("valid");
        TemplateMesh { name: "sheet".into(), mesh, landmarks: Vec::new() }
    }

    fn bent_by(solver: AffineSolver, origin: AffineOrigin) -> Vec<DVec3> {
        let paper = PaperConfig { solver, origin, lbfgsb_iterations: 20_000, ..PaperConfig::default() };
        let config = RegisterConfig { paper, ..RegisterConfig::default() };
        let template = sheet();
        let prepared = PreparedTemplate::new(Template::Mesh(&template), None, &config).expect("a template");
        let start = prepared.rest.clone();
        let pairs: Vec<Correspondence> = (0..start.len())
            .step_by(2)
            .map(|vertex| Correspondence {
                vertex: vertex as u32,
                target: start[vertex] + DVec3::new(0.01, 0.02 * (vertex as f64).sin(), -0.03),
                normal: DVec3::Z,
                is_outside: false,
                signed_distance: 0.0,
                weight: 1.0,
            })
            .collect();
        let pull = LandmarkPull { vertex: 1, target: start[1] + DVec3::Y * 0.05, confidence: 1.0 };
        let mut fit = AffineFit::new(&prepared, &start);
        let round = PaperRound { closest_points: 1.0, smooth_affines: 1e5, landmarks: 0.5 };
        fit.solve(&round, &pairs, &[pull]).expect("solves");
        fit.vertices()
    }

    #[test]
    fn both_solvers_reach_the_least_energy() {
        // About the world's origin L-BFGS-B does not arrive: the printed form is too badly conditioned.
        let exact = bent_by(AffineSolver::SparseCholesky, AffineOrigin::Edge);
        let iterated = bent_by(AffineSolver::Lbfgsb, AffineOrigin::Edge);
        let farthest = exact.iter().zip(&iterated).map(|(a, b)| a.distance(*b)).fold(0.0, f64::max);
        // Far below a vertex' movement of 30 mm; L-BFGS-B stops where the energy is flat.
        assert!(farthest < 1e-3, "{farthest}");
        let template = sheet();
        let moved = exact.iter().zip(template.mesh.positions()).map(|(a, b)| a.distance(*b));
        assert!(moved.fold(0.0, f64::max) > 0.02);
    }
}
