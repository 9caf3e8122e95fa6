//! The recipe of the paper: P2 §4 with the constants of §5 and L-BFGS-B.
//!
//! Deviation: the landmarks of a frame come from our own start and tracking instead of the Stitched Puppet (§4.2), unless
//! the sequence starts with our puppet.
//! With frozen pairs and poses the body is linear in the identity, so every energy over the identity alone is summed
//! into its exact quadratic once and handed to L-BFGS-B in that form; the values are the same.

use glam::DVec3;
use habitus_geometry::procrustes;
use habitus_optimize::{Bounds, LbfgsbSettings, Objective, Observer, Silent, Sink, Wanted, lbfgsb};
use nalgebra::{DMatrix, DVector};

use super::body_levels::PreparedIdentity;
use super::captured_frame::CapturedFrame;
use super::config::{ClothingForm, Paper2016Config, StartMethod};
use super::pose_solver::normalise_root;
use super::puppet::PuppetFollower;
use super::start_search::StartSearch;
use super::{FitSequenceError, Stage, Track, progress};
use crate::body::{BodySurface, IdentityCoefficients, rotation_vector};
use crate::fitting::correspondence::{ClosestField, Correspondence};
use crate::fitting::deformers::body_assembly::{BodyAssembly, Gather, ShapeMoments};
use crate::fitting::terms::{ClosestPoints, DistanceForm, InsideClothing, LandmarkPull, LandmarkTargets};
use crate::fitting::{Fit, VertexResidual};

/// Replaces identity and poses of a tracked sequence by those of the paper's three stages.
pub(super) fn refit(
    stage: &Stage<'_>,
    track: &mut Track,
    observer: &mut dyn Observer,
) -> Result<(), FitSequenceError> {
    let config = &stage.config.paper2016;
    let trusted = track.trusted();
    let Some(first) = trusted.first().copied() else { return Ok(()) };
    let steps = 2 * trusted.len() + config.initial_frames.min(trusted.len());
    let mut done = 0;
    let mut advance = |observer: &mut dyn Observer| {
        done += 1;
        progress(observer, "refine", done, steps + 1)
    };
    let recipe = Recipe { stage, config, fit_from_input: track.orientation.fit_from_input };
    let landmarks = match stage.config.start.method {
        StartMethod::Puppet => recipe.puppet_landmarks(track)?,
        StartMethod::Search | StartMethod::Landmarks => recipe.landmarks(track)?,
    };

    // Stage 1 (§4.5, initial identity estimation): frame by frame, then together.
    let initial: Vec<usize> = trusted.iter().copied().take(config.initial_frames).collect();
    let mut identity = vec![0.0; stage.component_count];
    let mut pose = recipe.rigid_start(&landmarks[first]);
    let mut identity_sum = vec![0.0; stage.component_count];
    for frame in &initial {
        if let Ok(capture) = stage.load(*frame, &recipe.fit_from_input) {
            recipe.alternate(&capture, &landmarks[*frame], &mut identity, &mut pose)?;
        }
        track.frames[*frame].pose.clone_from(&pose);
        for (sum, value) in identity_sum.iter_mut().zip(&identity) {
            *sum += value / initial.len() as f64;
        }
        advance(observer)?;
    }
    identity = identity_sum;
    for _ in 0..config.joint_rounds {
        let mut sum = IdentityQuadratic::new(&stage.full.surface, &identity);
        let body = PreparedIdentity::new(stage.model, &stage.full, &identity);
        for frame in &initial {
            let Ok(capture) = stage.load(*frame, &recipe.fit_from_input) else { continue };
            let pose = &mut track.frames[*frame].pose;
            recipe.solve_pose(&body, &capture, &landmarks[*frame], 0.0, pose)?;
            let pairs = recipe.pairs(&body, &capture, pose);
            sum.add(&body, pose, ClosestPoints::new(&pairs, DistanceForm::Point).residuals());
        }
        identity = sum.minimise(config, &vec![0.0; identity.len()], &identity)?;
    }

    // Stage 2 (§4.5, posture estimation).
    let body = PreparedIdentity::new(stage.model, &stage.full, &identity);
    let mut pose = initial.last().map_or(pose, |frame| track.frames[*frame].pose.clone());
    for frame in trusted.iter().copied().skip(initial.len()) {
        if let Ok(capture) = stage.load(frame, &recipe.fit_from_input) {
            for round in 0..config.alternations {
                let landmark_weight = config.landmark_weight.weight(round, config.alternations);
                recipe.solve_pose(&body, &capture, &landmarks[frame], landmark_weight, &mut pose)?;
            }
        }
        track.frames[frame].pose.clone_from(&pose);
        advance(observer)?;
    }

    // Stage 3 (§4.5, identity refinement): only the clothing energy, all frames, poses fixed.
    let initial_identity = identity.clone();
    let deviations = stage.model.standard_deviations();
    // ω_r ‖β − β₀‖² stands inside E_cloth and so counts once for each frame; β is metric, ours is in deviations.
    let stiffness: Vec<f64> = deviations[..identity.len()]
        .iter()
        .map(|deviation| config.stay_near_weight * trusted.len() as f64 * deviation * deviation)
        .collect();
    for _ in 0..config.joint_rounds {
        let mut sum = IdentityQuadratic::new(&stage.full.surface, &identity);
        let body = PreparedIdentity::new(stage.model, &stage.full, &identity);
        for frame in &trusted {
            let Ok(capture) = stage.load(*frame, &recipe.fit_from_input) else { continue };
            let pose = &track.frames[*frame].pose;
            let pairs = recipe.pairs(&body, &capture, pose);
            sum.add(&body, pose, &clothing_residuals(config, &pairs));
        }
        identity = sum.minimise(config, &stiffness, &initial_identity)?;
    }
    track.identity = identity;
    progress(observer, "refine", steps + 1, steps + 1)
}

struct Recipe<'a> {
    stage: &'a Stage<'a>,
    config: &'a Paper2016Config,
    fit_from_input: super::captured_frame::FitFromInput,
}

impl Recipe<'_> {
    /// l_i(F): landmark vertices of the tracked bodies, in the fit's coordinates.
    fn landmarks(&self, track: &Track) -> Result<Vec<Vec<DVec3>>, FitSequenceError> {
        let body = PreparedIdentity::new(self.stage.model, &self.stage.full, &track.identity);
        Ok(track
            .frames
            .iter()
            .map(|frame| {
                let (vertices, _) = body.vertices_and_normals(&body.posed(&frame.pose));
                self.stage.model.landmark_vertices().iter().map(|v| vertices[*v as usize]).collect()
            })
            .collect())
    }

    /// l_i(F) of P2 §4.2: the puppet's, frame after frame. Where a frame cannot be read, those of the tracked body.
    fn puppet_landmarks(&self, track: &Track) -> Result<Vec<Vec<DVec3>>, FitSequenceError> {
        let mut landmarks = self.landmarks(track)?;
        let search = StartSearch::new(self.stage.model, &self.stage.config.start);
        let mut follower = PuppetFollower::new(self.stage, &search);
        for (frame, own) in landmarks.iter_mut().enumerate() {
            if let Ok(capture) = self.stage.load(frame, &self.fit_from_input) {
                let body = follower.next(&capture);
                *own = body.landmarks.iter().map(|landmark| landmark.position).collect();
            }
        }
        Ok(landmarks)
    }

    /// The rest pose, moved rigidly onto the landmarks.
    fn rigid_start(&self, landmarks: &[DVec3]) -> Vec<f64> {
        let model = self.stage.model;
        let mean = model.mean_vertices();
        let own: Vec<DVec3> = model.landmark_vertices().iter().map(|v| mean[*v as usize]).collect();
        let mut pose = vec![0.0; model.skeleton().pose_length()];
        if let Some(motion) = procrustes(&own, landmarks) {
            let root = model.surface().joint_map().mean[0];
            let rotation = glam::DQuat::from_mat3(&motion.rotation);
            let translation = motion.rotation * root + motion.translation - root;
            pose[..3].copy_from_slice(&translation.to_array());
            pose[3..6].copy_from_slice(&rotation_vector(rotation).to_array());
        }
        pose
    }

    /// §4.5: N_it alternations of Θ for fixed β and β for fixed Θ, the landmark weight falling.
    fn alternate(
        &self,
        capture: &CapturedFrame,
        landmarks: &[DVec3],
        identity: &mut Vec<f64>,
        pose: &mut [f64],
    ) -> Result<(), FitSequenceError> {
        for round in 0..self.config.alternations {
            let landmark_weight = self.config.landmark_weight.weight(round, self.config.alternations);
            let body = PreparedIdentity::new(self.stage.model, &self.stage.full, identity);
            self.solve_pose(&body, capture, landmarks, landmark_weight, pose)?;
            let pairs = self.pairs(&body, capture, pose);
            let closest = ClosestPoints::new(&pairs, DistanceForm::Point);
            let pulls = LandmarkTargets::new(&self.pulls(landmarks));
            let weighted: Vec<VertexResidual> = scaled(closest.residuals(), 1.0 - landmark_weight)
                .chain(scaled(pulls.residuals(), landmark_weight))
                .collect();
            let mut sum = IdentityQuadratic::new(&self.stage.full.surface, identity);
            sum.add(&body, pose, &weighted);
            *identity = sum.minimise(self.config, &vec![0.0; identity.len()], identity)?;
        }
        Ok(())
    }

    /// Minimises ω_lnd E_lnd + ω_data E_data over the pose (Eq. 4 with ω_cloth = 0 and ω_data = 1 − ω_lnd).
    fn solve_pose(
        &self,
        body: &PreparedIdentity<'_>,
        capture: &CapturedFrame,
        landmarks: &[DVec3],
        landmark_weight: f64,
        pose: &mut [f64],
    ) -> Result<(), FitSequenceError> {
        let pairs = self.pairs(body, capture, pose);
        let closest = ClosestPoints::new(&pairs, DistanceForm::Point);
        let pulls = LandmarkTargets::new(&self.pulls(landmarks));
        let fit =
            Fit::new(&body.deformer).with(1.0 - landmark_weight, &closest).with(landmark_weight, &pulls);
        let (lower, upper) = self.stage.model.skeleton().pose_limits();
        lbfgsb(&fit, pose, &Bounds::new(lower, upper)?, &solver_settings(self.config), &mut Silent)?;
        normalise_root(pose);
        Ok(())
    }

    fn pairs(
        &self,
        body: &PreparedIdentity<'_>,
        capture: &CapturedFrame,
        pose: &[f64],
    ) -> Vec<Correspondence> {
        let (vertices, normals) = body.vertices_and_normals(&body.posed(pose));
        let field = ClosestField::find(&capture.index, &vertices, None);
        field.correspondences(&vertices, &normals, &self.config.compatibility)
    }

    fn pulls(&self, landmarks: &[DVec3]) -> Vec<LandmarkPull> {
        let vertices = self.stage.model.landmark_vertices();
        vertices
            .iter()
            .zip(landmarks)
            .map(|(vertex, target)| LandmarkPull { vertex: *vertex, target: *target, confidence: 1.0 })
            .collect()
    }
}

/// ω_cloth E_cloth without its regularisation (Eq. 8), or its symmetric counterpart.
fn clothing_residuals(config: &Paper2016Config, pairs: &[Correspondence]) -> Vec<VertexResidual> {
    let weight = config.clothing_weight;
    match config.clothing_form {
        ClothingForm::Outside => {
            scaled(InsideClothing::new(pairs, DistanceForm::Point).residuals(), weight).collect()
        }
        ClothingForm::Symmetric => {
            scaled(ClosestPoints::new(pairs, DistanceForm::Point).residuals(), weight).collect()
        }
    }
}

fn scaled(residuals: &[VertexResidual], weight: f64) -> impl Iterator<Item = VertexResidual> + '_ {
    residuals
        .iter()
        .map(move |r| VertexResidual { weight: r.weight * weight, ..*r })
        .filter(|r| r.weight > 0.0)
}

fn solver_settings(config: &Paper2016Config) -> LbfgsbSettings {
    LbfgsbSettings { max_iterations: config.solver_iterations, ..LbfgsbSettings::default() }
}

/// Energies over the identity with pairs and poses fixed: value + 2 gᵀ d + dᵀ H d around `center`, exactly.
struct IdentityQuadratic<'a> {
    surface: &'a BodySurface,
    center: Vec<f64>,
    value: f64,
    gradient: DVector<f64>,
    matrix: DMatrix<f64>,
    moments: ShapeMoments,
}

impl<'a> IdentityQuadratic<'a> {
    fn new(surface: &'a BodySurface, center: &[f64]) -> Self {
        let width = center.len();
        Self {
            surface,
            center: center.to_vec(),
            value: 0.0,
            gradient: DVector::zeros(width),
            matrix: DMatrix::zeros(width, width),
            moments: ShapeMoments::new(surface.vertex_count()),
        }
    }

    fn add(&mut self, body: &PreparedIdentity<'_>, pose: &[f64], residuals: &[VertexResidual]) {
        let posed = body.posed(pose);
        let (vertices, _) = body.vertices_and_normals(&posed);
        let mut assembly = BodyAssembly::new(self.surface, Gather::PoseAndIdentity, true);
        assembly.add(self.surface, &posed, &body.rest, &vertices, residuals);
        let equations = assembly.equations(self.surface, &posed);
        self.value += equations.value;
        self.gradient += equations.identity_gradient;
        self.matrix += equations.identity_matrix;
        self.moments.merge(assembly.moments());
    }

    /// L-BFGS-B inside ±3σ with `stiffness` towards `anchor`.
    fn minimise(
        mut self,
        config: &Paper2016Config,
        stiffness: &[f64],
        anchor: &[f64],
    ) -> Result<Vec<f64>, FitSequenceError> {
        self.moments.apply(self.surface, Some(&mut self.matrix), self.gradient.as_mut_slice());
        for (k, s) in stiffness.iter().enumerate() {
            let offset = self.center[k] - anchor[k];
            self.value += s * offset * offset;
            self.gradient[k] += s * offset;
            self.matrix[(k, k)] += s;
        }
        let limit = IdentityCoefficients::LIMIT;
        let bounds = Bounds::new(vec![-limit; self.center.len()], vec![limit; self.center.len()])?;
        let mut identity = self.center.clone();
        lbfgsb(&self, &mut identity, &bounds, &solver_settings(config), &mut Silent)?;
        Ok(identity)
    }
}

impl Objective for IdentityQuadratic<'_> {
    fn parameter_count(&self) -> usize {
        self.center.len()
    }

    fn add_to(&self, parameters: &[f64], sink: &mut dyn Sink) {
        let step = DVector::from_iterator(
            self.center.len(),
            parameters.iter().zip(&self.center).map(|(x, center)| x - center),
        );
        let curved = &self.matrix * &step;
        let value = self.value + 2.0 * self.gradient.dot(&step) + curved.dot(&step);
        let half_gradient = &self.gradient + curved;
        let columns: Vec<usize> = (0..self.center.len()).collect();
        let matrix = (sink.wanted() == Wanted::NormalEquations).then_some(&self.matrix);
        sink.add_assembled(value, &columns, half_gradient.as_slice(), matrix);
    }
}
