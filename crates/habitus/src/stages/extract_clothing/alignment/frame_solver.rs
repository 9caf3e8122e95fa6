//! Bends the template onto one capture: rounds of frozen pairs in both directions, with stiffness that falls.

use glam::DVec3;
use habitus_geometry::{SurfaceIndex, TriangleMesh, vertex_normals_into};
use habitus_optimize::{
    SparseCholesky, SparseGaussNewtonSettings, SparseNormalEquations, SymmetricMatrix, sparse_gauss_newton,
};

use super::super::ExtractClothingError;
use super::super::config::AlignmentConfig;
use super::Capture;
use super::detail::DetailSolver;
use super::template::ClothingTemplate;
use crate::fitting::correspondence::{ClosestField, Correspondence};
use crate::fitting::deformers::{DeformationGraph, GraphDeformer, NODE_PARAMETERS};
use crate::fitting::terms::{ClosestPoints, DistanceForm, GraphRigidity, GraphSmoothness};
use crate::fitting::{Deformer, Fit};

/// What all frames share: the graph, the pattern of its normal equations and their analysis.
pub(super) struct FrameSolver<'a> {
    pub template: &'a ClothingTemplate,
    config: &'a AlignmentConfig,
    graph: DeformationGraph,
    sums: SparseNormalEquations,
    cholesky: SparseCholesky,
    detail: DetailSolver,
    /// Share of the template's area around each vertex.
    vertex_shares: Vec<f64>,
}

impl<'a> FrameSolver<'a> {
    pub fn new(
        template: &'a ClothingTemplate,
        config: &'a AlignmentConfig,
    ) -> Result<Self, ExtractClothingError> {
        let graph = DeformationGraph::new(template.shape(), config.nodes);
        let size = NODE_PARAMETERS * graph.node_count();
        let pattern = SymmetricMatrix::with_places(size, graph.places());
        Ok(Self {
            template,
            config,
            sums: SparseNormalEquations::new(&pattern),
            cholesky: SparseCholesky::analyse(&pattern)?,
            detail: DetailSolver::new(template.shape())?,
            vertex_shares: vertex_shares(template.shape()),
            graph,
        })
    }

    /// Bends the template, placed as `base` is, onto the capture, looking for closest points from `guess` first.
    pub fn solve(
        &mut self,
        base: &[DVec3],
        guess: &[DVec3],
        capture: &Capture,
    ) -> Result<Vec<DVec3>, ExtractClothingError> {
        let config = self.config;
        // What hangs on the body tears where neighbours hang on different limbs; the nodes average that out.
        let (base, guess) = (self.smoothed(base), self.smoothed(guess));
        let graph = self.graph.about(&base);
        let (rotations, mut parameters) = graph.pose_of(&guess);
        let deformer = GraphDeformer::new(&graph, rotations);
        let mut surface = deformer.deform(&parameters).vertices().to_vec();
        let mut field: Option<ClosestField> = None;
        let edge_count = graph.edges().len().max(1) as f64;
        let settings = SparseGaussNewtonSettings {
            max_iterations: config.solver_iterations,
            ..SparseGaussNewtonSettings::default()
        };
        for round in 0..config.rounds {
            let found = ClosestField::find(&capture.index, &surface, field.as_ref());
            let scale = config.robust_scale.weight(round, config.rounds).max(config.smallest_robust_scale);
            let pairs = self.pairs(&surface, &found, capture, scale);
            field = Some(found);
            let plane = ClosestPoints::new(&pairs, DistanceForm::Plane);
            let point = ClosestPoints::new(&pairs, DistanceForm::Point);
            let (rigidity, smoothness) = (GraphRigidity(&deformer), GraphSmoothness(&deformer));
            let stiffness = config.rigidity.weight(round, config.rounds).max(config.smallest_rigidity);
            let objective = Fit::new(&deformer)
                .with(1.0, &plane)
                .with(config.point_share, &point)
                .with(stiffness / (2.0 * edge_count), &rigidity)
                .with(stiffness * config.smoothness_share / edge_count, &smoothness);
            sparse_gauss_newton(&objective, &mut parameters, &mut self.sums, &self.cholesky, &settings)?;
            surface.clear();
            surface.extend_from_slice(deformer.deform(&parameters).vertices());
        }
        self.detail.add(&mut surface, self.template.shape(), capture, &config.detail)?;
        Ok(surface)
    }

    /// The template's own shape, moved by the motion of each node's neighbourhood.
    fn smoothed(&self, surface: &[DVec3]) -> Vec<DVec3> {
        let (rotations, parameters) = self.graph.pose_of(surface);
        let deformer = GraphDeformer::new(&self.graph, rotations);
        deformer.deform(&parameters).vertices().to_vec()
    }

    /// Pairs in both directions; each direction weighs the same in all.
    fn pairs(
        &self,
        surface: &[DVec3],
        field: &ClosestField,
        capture: &Capture,
        scale: f64,
    ) -> Vec<Correspondence> {
        let config = self.config;
        let mut normals = Vec::new();
        vertex_normals_into(surface, self.template.faces(), &mut normals);
        let mut pairs = field.correspondences(surface, &normals, &config.compatibility);
        // A node moves dozens of vertices: an evenly spread part of them tells where it goes.
        let stride = surface.len().div_ceil(config.template_samples.max(1)).max(1);
        pairs.retain(|pair| (pair.vertex as usize).is_multiple_of(stride));
        for pair in &mut pairs {
            pair.weight = stride as f64
                * self.vertex_shares[pair.vertex as usize]
                * robust_weight(pair.target.distance_squared(surface[pair.vertex as usize]), scale);
        }
        let Ok(mesh) = TriangleMesh::new(surface.to_vec(), self.template.faces().to_vec()) else {
            return pairs;
        };
        let index = SurfaceIndex::of_mesh(&mesh);
        let positions: Vec<DVec3> = capture.samples.iter().map(|(position, _)| *position).collect();
        let mut closest = Vec::new();
        index.closest_many(&positions, None, &mut closest);
        let smallest_cosine = config.compatibility.angle_deg.to_radians().cos();
        let largest_squared = config.compatibility.distance * config.compatibility.distance;
        let share = config.capture_weight / capture.samples.len().max(1) as f64;
        for ((position, normal), point) in capture.samples.iter().zip(&closest) {
            if point.distance_squared > largest_squared || point.normal.dot(*normal) < smallest_cosine {
                continue;
            }
            let corners = mesh.faces()[point.face as usize];
            let heaviest = (0..3)
                .fold(0, |best, k| if point.barycentric[k] > point.barycentric[best] { k } else { best });
            let vertex = corners[heaviest];
            let signed_distance = (surface[vertex as usize] - *position).dot(*normal);
            // The sample belongs to a point of the face; its vertex is shifted by as much.
            let target = *position + surface[vertex as usize] - point.position;
            pairs.push(Correspondence {
                vertex,
                target,
                normal: *normal,
                is_outside: signed_distance > 0.0,
                signed_distance,
                weight: share * robust_weight(point.distance_squared, scale),
            });
        }
        pairs
    }
}

/// Geman–McClure, in iteratively reweighted least squares.
fn robust_weight(distance_squared: f64, scale: f64) -> f64 {
    let share = scale * scale / (scale * scale + distance_squared);
    share * share
}

/// A third of each face's area goes to each corner; the sum is one.
fn vertex_shares(mesh: &TriangleMesh) -> Vec<f64> {
    let mut shares = vec![0.0; mesh.positions().len()];
    let mut total = 0.0;
    for (face, corners) in mesh.faces().iter().enumerate() {
        let [a, b, c] = mesh.corners(face);
        let area = (b - a).cross(c - a).length();
        total += area;
        corners.iter().for_each(|vertex| shares[*vertex as usize] += area / 3.0);
    }
    shares.iter_mut().for_each(|share| *share /= total.max(f64::MIN_POSITIVE));
    shares
}
