//! Fits the pose of one frame for a fixed identity, coarse to fine.

use glam::{DQuat, DVec3};
use habitus_optimize::{Bounds, GaussNewtonSettings, Silent, gauss_newton};

use super::FitSequenceError;
use super::body_levels::{BodyLevel, PreparedIdentity};
use super::captured_frame::CapturedFrame;
use super::clothed_surface::{
    bare_capture_pairs, capture_pairs, clothed_pairs, sole_pairs, uncovered_limb_share, uncovered_sole_share,
};
use super::config::{CodeThresholds, SurfaceConfig, TrackConfig};
use super::limb_watch::{SpreadBody, has_lost_a_limb};
use crate::body::{ROOT_LENGTH, Skeleton, rotation_vector};
use crate::fitting::Fit;
use crate::fitting::correspondence::ClosestField;
use crate::fitting::terms::{ClosestPoints, DistanceForm, LandmarkPull, LandmarkTargets, StayNear};

/// What pulls the pose besides the capture.
#[derive(Clone, Debug, Default)]
pub(super) struct PosePrior {
    /// Poses to whose angles the angles are drawn, each with a stiffness per vertex.
    pub angles: Vec<(Vec<f64>, f64)>,
    /// The pose that the motion around the frame expects, with the stiffness per vertex of the root's translation, of its
    /// rotation and of the angles.
    pub motion: Option<(Vec<f64>, [f64; 3])>,
    /// Landmarks that the user gives: vertices of the model and where they should be.
    pub landmarks: Vec<GivenLandmark>,
}

/// A landmark that the user gives, in the fit's coordinates.
#[derive(Clone, Copy, Debug)]
pub(super) struct GivenLandmark {
    /// Vertex of the model.
    pub vertex: u32,
    pub position: DVec3,
}

/// A given landmark weighs as much as this share of all vertices: more than the cloth around it.
const LANDMARK_SHARE: f64 = 0.03;

/// Given landmarks as a term over the vertices of a level.
pub(super) fn landmark_term(level: &BodyLevel, landmarks: &[GivenLandmark]) -> LandmarkTargets {
    let weight = LANDMARK_SHARE * level.vertices.len() as f64;
    let pulls: Vec<LandmarkPull> = landmarks
        .iter()
        .filter_map(|given| {
            let slot = level.vertices.binary_search(&given.vertex).ok()?;
            Some(LandmarkPull { vertex: slot as u32, target: given.position, confidence: weight })
        })
        .collect();
    LandmarkTargets::new(&pulls)
}

/// A fitted pose and how well it explains the frame.
#[derive(Clone, Debug)]
pub(super) struct PoseSolution {
    pub pose: Vec<f64>,
    /// Mean one-sided energy per vertex plus the capture's share, in square metres.
    pub energy: f64,
    pub inlier_share: f64,
    /// Head, a hand or a foot is away from the capture, or a limb of the capture has no body in it.
    pub has_lost_a_limb: bool,
}

impl PoseSolution {
    /// Whether it explains the frame better: first no limb may be lost, then the energy counts.
    pub fn is_better_than(&self, other: &Self) -> bool {
        match (self.has_lost_a_limb, other.has_lost_a_limb) {
            (false, true) => true,
            (true, false) => false,
            _ => self.energy < other.energy,
        }
    }
}

/// Capture samples that are compared with the coarse vertices in one round.
const SAMPLES_PER_ROUND: usize = 300;

/// Fits poses of one identity.
pub(super) struct PoseSolver<'a> {
    pub coarse: PreparedIdentity<'a>,
    pub fine: PreparedIdentity<'a>,
    pub surface: &'a SurfaceConfig,
    pub track: &'a TrackConfig,
    pub codes: &'a CodeThresholds,
    pub bounds: Bounds,
}

impl PoseSolver<'_> {
    /// The predicted pose: the last one, continued by part of its last motion.
    pub fn predict(skeleton: &Skeleton, last: &[f64], before: Option<&[f64]>, velocity: f64) -> Vec<f64> {
        let Some(before) = before else { return last.to_vec() };
        let mut pose = last.to_vec();
        for (k, value) in pose.iter_mut().enumerate() {
            if !(3..ROOT_LENGTH).contains(&k) {
                *value += velocity * (last[k] - before[k]);
            }
        }
        let rotation_of = |pose: &[f64]| DQuat::from_scaled_axis(DVec3::from_slice(&pose[3..6]));
        let change = rotation_vector(rotation_of(last) * rotation_of(before).inverse()) * velocity;
        let rotation = rotation_vector(DQuat::from_scaled_axis(change) * rotation_of(last));
        pose[3..6].copy_from_slice(&rotation.to_array());
        let (lower, upper) = skeleton.pose_limits();
        for (k, value) in pose.iter_mut().enumerate() {
            *value = value.clamp(lower[k], upper[k]);
        }
        pose
    }

    /// Coarse rounds, then fine rounds.
    pub fn solve(
        &self,
        frame: &CapturedFrame,
        start: &[f64],
        prior: &PosePrior,
    ) -> Result<PoseSolution, FitSequenceError> {
        let mut pose = start.to_vec();
        self.rounds(&self.coarse, frame, &mut pose, prior, self.track.coarse_rounds)?;
        self.polish(frame, pose, prior, self.track.fine_rounds)
    }

    /// Fine rounds only, without judging the result; the field belongs to the last round but one step.
    pub fn polish_pose(
        &self,
        frame: &CapturedFrame,
        mut pose: Vec<f64>,
        prior: &PosePrior,
        rounds: usize,
    ) -> Result<(Vec<f64>, Option<ClosestField>), FitSequenceError> {
        let field = self.rounds(&self.fine, frame, &mut pose, prior, rounds)?;
        normalise_root(&mut pose);
        Ok((pose, field))
    }

    /// Fine rounds on a pose that has been found. What moves a joint far from there is no polish, as when a foot that comes
    /// down is drawn to where the other one stands: then the pose stays as it is.
    pub fn polish_found_pose(
        &self,
        frame: &CapturedFrame,
        found: Vec<f64>,
        prior: &PosePrior,
        rounds: usize,
    ) -> Result<(Vec<f64>, Option<ClosestField>), FitSequenceError> {
        let (pose, field) = self.polish_pose(frame, found.clone(), prior, rounds)?;
        let joints = self.fine.posed(&pose).joints;
        let is_thrown = joints
            .iter()
            .zip(&self.fine.posed(&found).joints)
            .any(|(polished, found)| polished.distance(*found) > self.track.farthest_polish);
        Ok(if is_thrown { (found, None) } else { (pose, field) })
    }

    /// Fine rounds only.
    pub fn polish(
        &self,
        frame: &CapturedFrame,
        pose: Vec<f64>,
        prior: &PosePrior,
        rounds: usize,
    ) -> Result<PoseSolution, FitSequenceError> {
        let (pose, field) = self.polish_pose(frame, pose, prior, rounds)?;
        Ok(self.judge(&self.fine, frame, pose, field.as_ref()))
    }

    /// How well a pose explains the frame, both directions together.
    fn judge(
        &self,
        body: &PreparedIdentity<'_>,
        frame: &CapturedFrame,
        pose: Vec<f64>,
        earlier: Option<&ClosestField>,
    ) -> PoseSolution {
        let posed = body.posed(&pose);
        let (vertices, normals) = body.vertices_and_normals(&posed);
        let field = ClosestField::find(&frame.index, &vertices, earlier);
        let clothed = clothed_pairs(body.level, &field, &vertices, &normals, self.surface);
        // The coarse body is enough to see what of the capture is unexplained.
        let (vertices, normals) = self.coarse.vertices_and_normals(&self.coarse.posed(&pose));
        let stride = frame.samples.len().div_ceil(SAMPLES_PER_ROUND);
        let (_, uncovered) =
            capture_pairs(frame, stride, &vertices, &normals, 1.0, self.track.capture_scale[1]);
        // A limb of the capture without a body counts like a vertex without a pair: as far away.
        let lost_limbs = uncovered_limb_share(frame, &vertices, self.codes.limb_distance)
            + uncovered_sole_share(frame, &vertices, self.codes.limb_distance, self.surface);
        let far = self.surface.bare_weight * self.surface.bare_scale * self.surface.bare_scale;
        let energy = clothed.energy + self.track.capture_weight * uncovered + lost_limbs * far;
        let bones = &self.coarse.level.main_bones;
        let spread = SpreadBody { vertices: &vertices, normals: &normals, bones };
        let has_lost_a_limb = has_lost_a_limb(body, &posed, &field, frame, &spread, self.codes);
        PoseSolution { pose, energy, inlier_share: clothed.inlier_share, has_lost_a_limb }
    }

    fn rounds(
        &self,
        body: &PreparedIdentity<'_>,
        frame: &CapturedFrame,
        pose: &mut [f64],
        prior: &PosePrior,
        rounds: usize,
    ) -> Result<Option<ClosestField>, FitSequenceError> {
        let settings = GaussNewtonSettings {
            max_iterations: self.track.steps_per_round,
            initial_damping: 1e-3,
            ..GaussNewtonSettings::default()
        };
        let is_coarse = std::ptr::eq(body.level, self.coarse.level);
        let stride = frame.samples.len().div_ceil(SAMPLES_PER_ROUND);
        let mut field: Option<ClosestField> = None;
        for round in 0..rounds {
            let (vertices, normals) = body.vertices_and_normals(&body.posed(pose));
            let found = ClosestField::find(&frame.index, &vertices, field.as_ref());
            let mut pairs = clothed_pairs(body.level, &found, &vertices, &normals, self.surface).pairs;
            if is_coarse {
                let (weight, scale) = (self.track.capture_weight, self.track.capture_scale(round, rounds));
                pairs.extend(capture_pairs(frame, stride, &vertices, &normals, weight, scale).0);
            } else {
                pairs.extend(bare_capture_pairs(body.level, frame, &vertices, &normals, self.surface));
            }
            let closest = ClosestPoints::new(&pairs, DistanceForm::Plane);
            let soles = sole_pairs(body.level, frame, &vertices, self.surface);
            let soles = ClosestPoints::new(&soles, DistanceForm::Point);
            let count = vertices.len() as f64;
            let mut pulls: Vec<StayNear> = prior
                .angles
                .iter()
                .map(|(target, stiffness)| {
                    let angles = &target[ROOT_LENGTH..];
                    StayNear::new(ROOT_LENGTH, angles, &vec![stiffness * count; angles.len()])
                })
                .collect();
            if let Some((target, [translation, rotation, angle])) = &prior.motion {
                let mut stiffness = vec![angle * count; target.len()];
                stiffness[..3].fill(translation * count);
                stiffness[3..ROOT_LENGTH].fill(rotation * count);
                pulls.push(StayNear::new(0, target, &stiffness));
            }
            let landmarks = landmark_term(body.level, &prior.landmarks);
            let start = Fit::new(&body.deformer).with(1.0, &closest).with(1.0, &soles).with(1.0, &landmarks);
            let fit = pulls.iter().fold(start, |fit, pull| fit.with(1.0, pull));
            gauss_newton(&fit, pose, &self.bounds, &settings, &mut Silent)?;
            field = Some(found);
        }
        Ok(field)
    }
}

/// Keeps the root's rotation vector shorter than π, away from its singularity at 2π.
pub(super) fn normalise_root(pose: &mut [f64]) {
    let rotation = DQuat::from_scaled_axis(DVec3::from_slice(&pose[3..6]));
    pose[3..6].copy_from_slice(&rotation_vector(rotation).to_array());
}

#[cfg(test)]
mod tests {
    use glam::DMat3;
    use habitus_geometry::{Surface, TriangleMesh};

    use super::super::captured_frame::{FitFromInput, size_of};
    use super::super::config::FrameConfig;
    use super::*;
    use crate::body::BodyModel;

    #[test]
    fn a_polish_moves_a_pose_a_little_and_leaves_one_that_it_throws() {
        let model = BodyModel::default_space().expect("the embedded model");
        let [coarse, fine] = [300, 600].map(|count| BodyLevel::spread(&model, count, 1));
        let (surface, track, codes) =
            (SurfaceConfig::default(), TrackConfig::default(), CodeThresholds::default());
        let (lower, upper) = model.skeleton().pose_limits();
        let solver = PoseSolver {
            coarse: PreparedIdentity::new(&model, &coarse, &[0.0]),
            fine: PreparedIdentity::new(&model, &fine, &[0.0]),
            surface: &surface,
            track: &track,
            codes: &codes,
            bounds: Bounds::new(lower, upper).expect("bounds"),
        };
        let polished_moves = |shift: f64| {
            let shifted = model.mean_vertices().iter().map(|vertex| *vertex + DVec3::Z * shift).collect();
            let capture = TriangleMesh::new(shifted, model.faces().to_vec()).expect("a mesh");
            let capture = Surface::Mesh(capture);
            let fit_from_input = FitFromInput {
                scale: 1.0,
                rotation: DMat3::IDENTITY,
                translation: DVec3::ZERO,
                usual_size: size_of(&capture),
            };
            let frame =
                CapturedFrame::prepare(capture, &fit_from_input, &FrameConfig::default(), (1, "body"));
            let frame = frame.expect("a frame");
            let found = vec![0.0; model.skeleton().pose_length()];
            let solved = solver.polish_found_pose(&frame, found, &PosePrior::default(), 12);
            solved.expect("a pose").0[2]
        };
        // The tolerance outside, a few millimetres, is what the body may stay behind.
        assert!((polished_moves(0.02) - 0.02).abs() < 0.005, "{}", polished_moves(0.02));
        assert_eq!(polished_moves(0.19), 0.0, "a joint may be polished by 15 cm at most");
    }
}
