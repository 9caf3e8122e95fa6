//! Fits identity and pose of a body model to one scan by Gauss–Newton, coarse to fine (P1 §3.2).
//!
//! Gaps along the body's normals, in both directions, are gathered at some vertices of the body; a population prior and
//! landmarks, if there are any, settle what the surface leaves open.

use glam::DVec3;
use habitus_geometry::{SurfaceIndex, TriangleMesh, farthest_points, vertex_normals_into};
use habitus_optimize::{Bounds, GaussNewtonSettings, Silent, SolveError, gauss_newton};
use serde::{Deserialize, Serialize};

use super::Fit;
use super::correspondence::Correspondence;
use super::deformers::{BodyParameters, FreeParameters};
use super::gaps::{GapRules, ScanPoints, gaps_of_scan, gaps_of_vertices};
use super::local_shapes::{LocalShapeConfig, with_local_shapes};
use super::terms::{ClosestPoints, DistanceForm, LandmarkPull, LandmarkTargets, StayNear};
use crate::body::{BodyModel, BodySurface, IdentityCoefficients, ROOT_LENGTH};

/// Identity (standard deviations) and pose (metres and radians).
#[derive(Clone, Debug, PartialEq)]
pub struct ModelState {
    /// Identity coefficients, missing ones are zero; behind all of the model's come those of local shapes.
    pub identity: Vec<f64>,
    /// Pose parameters.
    pub pose: Vec<f64>,
}

/// Rounds at one resolution.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ModelRounds {
    /// Number of rounds: pairs are found anew in each.
    pub rounds: usize,
    /// Vertices of the body that are used.
    pub vertex_count: usize,
    /// Points of the scan that are used in each round.
    pub sample_count: usize,
    /// Identity components that are free.
    pub components: usize,
    /// Whether local shapes are free, too.
    pub local: bool,
    /// Which pairs count, and how much.
    pub pairs: GapRules,
}

/// Settings of the model fit.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ModelFitConfig {
    /// What the space cannot express, standard deviation in millimetres: the noise against which the population counts.
    pub residual_mm: f64,
    /// How many independent places of the body the residual has; neighbouring vertices say the same.
    pub independent_residuals: f64,
    /// Standard deviation of joint angles about the start's, degrees.
    pub angle_spread_deg: f64,
    /// Standard deviation of landmarks, millimetres.
    pub landmark_mm: f64,
    /// Shapes that the space cannot express.
    pub local: LocalShapeConfig,
    /// From coarse to fine.
    pub levels: Vec<ModelRounds>,
}

impl Default for ModelFitConfig {
    fn default() -> Self {
        let level = |rounds, vertex_count, sample_count, components, [distance_mm, robust_mm]: [f64; 2]| {
            let pairs = GapRules { distance_mm, angle_deg: 60.0, robust_mm };
            ModelRounds { rounds, vertex_count, sample_count, components, local: components >= 100, pairs }
        };
        Self {
            residual_mm: 1.0,
            independent_residuals: 500.0,
            angle_spread_deg: 40.0,
            landmark_mm: 3.0,
            local: LocalShapeConfig::default(),
            levels: vec![
                level(6, 400, 800, 5, [200.0, 80.0]),
                level(5, 800, 2000, 20, [80.0, 30.0]),
                level(4, 1500, 4000, 50, [40.0, 15.0]),
                level(4, 3000, 8000, 100, [25.0, 8.0]),
            ],
        }
    }
}

/// A landmark: a vertex of the body and where it should be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GivenLandmark {
    /// Vertex of the body.
    pub vertex: u32,
    /// Where it should be, metres.
    pub position: DVec3,
}

/// Some vertices of the body as a surface of their own.
pub(super) struct Level {
    pub(super) vertices: Vec<u32>,
    /// The vertices, and behind them those of the landmarks.
    pub(super) surface: BodySurface,
    /// For each vertex of the body its nearest one of the level.
    nearest: Vec<u32>,
}

/// A body model prepared for fitting to many scans.
pub struct ModelFitter<'a> {
    model: &'a BodyModel,
    pub(super) config: &'a ModelFitConfig,
    pub(super) levels: Vec<Level>,
    landmark_vertices: Vec<u32>,
    landmark_level: BodySurface,
    /// All vertices, with local shapes behind the model's components.
    surface: BodySurface,
}

impl<'a> ModelFitter<'a> {
    /// Prepares the levels; `landmark_vertices` are those that landmarks may name.
    pub fn new(model: &'a BodyModel, config: &'a ModelFitConfig, landmark_vertices: &[u32]) -> Self {
        let most = config.levels.iter().map(|level| level.vertex_count).max().unwrap_or(0);
        let order = farthest_points(model.mean_vertices(), most.max(config.local.centres));
        let surface = with_local_shapes(model, model.component_count(), &order, &config.local);
        let mut landmark_vertices = landmark_vertices.to_vec();
        landmark_vertices.sort_unstable();
        landmark_vertices.dedup();
        let levels = config.levels.iter().map(|rounds| {
            let mut vertices = order[..rounds.vertex_count.min(order.len())].to_vec();
            vertices.sort_unstable();
            let components = if rounds.local { surface.component_count() } else { rounds.components };
            let chosen: Vec<u32> = vertices.iter().chain(&landmark_vertices).copied().collect();
            let surface = surface.subset(&chosen).truncated(components.min(surface.component_count()));
            let nearest = nearest_of(model, &vertices);
            Level { vertices, surface, nearest }
        });
        let levels = levels.collect();
        let landmark_level = model.surface().subset(&landmark_vertices);
        Self { model, config, levels, landmark_vertices, landmark_level, surface }
    }

    /// The model.
    pub fn model(&self) -> &'a BodyModel {
        self.model
    }

    /// Number of levels.
    pub fn level_count(&self) -> usize {
        self.levels.len()
    }

    /// Vertices of an identity at rest, metres.
    pub fn rest_vertices(&self, identity: &[f64]) -> Vec<DVec3> {
        self.surface.rest_vertices(identity)
    }

    /// Posed vertices of a state, metres.
    pub fn vertices(&self, state: &ModelState) -> Vec<DVec3> {
        let surface = &self.surface;
        let rest = surface.rest_vertices(&state.identity);
        let posed = surface.skeleton().pose(&surface.rest_joints(&state.identity), &state.pose);
        surface.skin_vertices(&rest, &posed)
    }

    /// P1 §3.2, first step: pose (and a few components) from landmarks alone.
    pub fn fit_landmarks(
        &self,
        state: &mut ModelState,
        landmarks: &[GivenLandmark],
        components: usize,
        iterations: usize,
    ) -> Result<(), SolveError> {
        let surface = self.landmark_level.truncated(components);
        let pulls = self.pulls(landmarks, 0, 1.0);
        let scale = (self.config.landmark_mm / 1000.0).powi(2);
        let term = LandmarkTargets::new(&pulls);
        self.solve(&surface, state, &[&term], scale, iterations)
    }

    /// All rounds of one level.
    pub fn fit_level(
        &self,
        level: usize,
        state: &mut ModelState,
        scan: &ScanPoints<'_>,
        landmarks: &[GivenLandmark],
    ) -> Result<(), SolveError> {
        let mut hints = Vec::new();
        for round in 0..self.config.levels[level].rounds {
            self.fit_round([level, round], state, scan, landmarks, &mut hints)?;
        }
        Ok(())
    }

    fn fit_round(
        &self,
        [level, round]: [usize; 2],
        state: &mut ModelState,
        scan: &ScanPoints<'_>,
        landmarks: &[GivenLandmark],
        hints: &mut Vec<u32>,
    ) -> Result<(), SolveError> {
        let rounds = &self.config.levels[level];
        let level = &self.levels[level];
        let vertices = self.vertices(state);
        let pairs = self.gather(level, rounds, round, &vertices, scan, hints);
        let term = ClosestPoints::new(&pairs, DistanceForm::Plane);
        // Weights of a round sum to about the number of vertices; the prior counts against independent places.
        let count = level.vertices.len() as f64;
        let variance = (self.config.residual_mm / 1000.0).powi(2) * count / self.config.independent_residuals;
        let confidence = variance / (self.config.landmark_mm / 1000.0).powi(2);
        let pulls = self.pulls(landmarks, level.vertices.len(), confidence);
        let marks = LandmarkTargets::new(&pulls);
        self.solve(&level.surface, state, &[&term, &marks], variance, 1)
    }

    /// Gaps of both directions, gathered at the vertices of the level: one residual for each.
    pub(super) fn gather(
        &self,
        level: &Level,
        rounds: &ModelRounds,
        round: usize,
        vertices: &[DVec3],
        scan: &ScanPoints<'_>,
        hints: &mut Vec<u32>,
    ) -> Vec<Correspondence> {
        let faces = self.model.faces();
        let mut normals = Vec::new();
        vertex_normals_into(vertices, faces, &mut normals);
        // Half of the weight for each direction, so that both together count once for each vertex.
        let mut sums = vec![(0.0, 0.0); level.vertices.len()];
        for pair in gaps_of_vertices(scan, &level.vertices, vertices, &normals, &rounds.pairs, hints) {
            if let Ok(slot) = level.vertices.binary_search(&pair.vertices[0]) {
                sums[slot].0 += 0.5 * pair.weight;
                sums[slot].1 += 0.5 * pair.weight * pair.gap;
            }
        }
        if let Ok(mesh) = TriangleMesh::new(vertices.to_vec(), faces.to_vec()) {
            let index = SurfaceIndex::of_mesh(&mesh);
            let stride = (scan.positions.len() / rounds.sample_count.max(1)).max(1);
            let pairs = gaps_of_scan(scan, [round % stride, stride], &index, faces, &normals, &rounds.pairs);
            let sample_count = (scan.positions.len() / stride).max(1) as f64;
            let share = 0.5 * level.vertices.len() as f64 / sample_count;
            for pair in pairs {
                let largest = (0..3)
                    .fold(0, |best, k| if pair.barycentric[k] > pair.barycentric[best] { k } else { best });
                let slot = level.nearest[pair.vertices[largest] as usize] as usize;
                // A cell's normal differs across a thin limb: what looks the other way belongs elsewhere.
                if normals[level.vertices[slot] as usize].dot(pair.normal) > 0.5 {
                    sums[slot].0 += share * pair.weight;
                    sums[slot].1 += share * pair.weight * pair.gap;
                }
            }
        }
        sums.iter()
            .enumerate()
            .filter(|(_, (weight, _))| *weight > 1e-6)
            .map(|(slot, (weight, sum))| {
                let vertex = level.vertices[slot] as usize;
                let gap = sum / weight;
                Correspondence {
                    vertex: slot as u32,
                    target: vertices[vertex] + normals[vertex] * gap,
                    normal: normals[vertex],
                    is_outside: gap < 0.0,
                    signed_distance: -gap,
                    weight: *weight,
                }
            })
            .collect()
    }

    /// Pulls on the landmarks' vertices, which stand behind the first `behind` of a surface.
    fn pulls(&self, landmarks: &[GivenLandmark], behind: usize, confidence: f64) -> Vec<LandmarkPull> {
        landmarks
            .iter()
            .filter_map(|landmark| {
                let slot = behind + self.landmark_vertices.binary_search(&landmark.vertex).ok()?;
                Some(LandmarkPull { vertex: slot as u32, target: landmark.position, confidence })
            })
            .collect()
    }

    /// Gauss–Newton inside the limits; `variance` is what one standard deviation of the priors costs.
    fn solve(
        &self,
        surface: &BodySurface,
        state: &mut ModelState,
        terms: &[&dyn super::Term],
        variance: f64,
        iterations: usize,
    ) -> Result<(), SolveError> {
        let components = surface.component_count();
        let skeleton = surface.skeleton();
        let angle_spread = self.config.angle_spread_deg.to_radians();
        let mut stiffness = vec![variance; components];
        stiffness.extend(vec![0.0; ROOT_LENGTH]);
        stiffness.extend(vec![variance / (angle_spread * angle_spread); skeleton.axes().len()]);
        let mut parameters = state.identity.clone();
        parameters.resize(components, 0.0);
        parameters.extend(&state.pose);
        let prior = StayNear::new(0, &vec![0.0; parameters.len()], &stiffness);
        let deformer = BodyParameters::new(surface, FreeParameters::IdentityAndPose);
        let fit = terms.iter().fold(Fit::new(&deformer).with(1.0, &prior), |fit, term| fit.with(1.0, *term));
        let (mut lower, mut upper) =
            (vec![-IdentityCoefficients::LIMIT; components], vec![IdentityCoefficients::LIMIT; components]);
        let (low, high) = skeleton.pose_limits();
        lower.extend(low);
        upper.extend(high);
        let bounds = Bounds::new(lower, upper)?;
        let settings = GaussNewtonSettings { max_iterations: iterations, ..GaussNewtonSettings::default() };
        gauss_newton(&fit, &mut parameters, &bounds, &settings, &mut Silent)?;
        state.pose = parameters.split_off(components);
        state.identity = parameters;
        Ok(())
    }
}

/// For each vertex of the mean body the place in `chosen` of its nearest one.
fn nearest_of(model: &BodyModel, chosen: &[u32]) -> Vec<u32> {
    let positions: Vec<DVec3> = chosen.iter().map(|vertex| model.mean_vertices()[*vertex as usize]).collect();
    let index = SurfaceIndex::of_cloud(&positions, &vec![DVec3::Y; positions.len()]);
    model.mean_vertices().iter().map(|vertex| index.closest(*vertex).face).collect()
}
