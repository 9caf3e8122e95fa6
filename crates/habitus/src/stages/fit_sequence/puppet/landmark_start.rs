//! From 14 landmarks to a start: the pose that meets them, then the capture's own say (P2 §4.5: ω_lnd from one to zero).

use glam::{DQuat, DVec3};
use habitus_geometry::procrustes;
use habitus_optimize::{Bounds, GaussNewtonSettings, Silent, gauss_newton};

use super::super::body_levels::BodyLevel;
use super::super::captured_frame::CapturedFrame;
use super::super::pose_solver::normalise_root;
use super::super::start_search::{Start, StartSearch};
use crate::body::{ROOT_LENGTH, rotation_vector};
use crate::fitting::Fit;
use crate::fitting::deformers::{BodyParameters, FreeParameters};
use crate::fitting::terms::{LandmarkPull, LandmarkTargets, StayNear};

/// Fewer landmarks leave the heading free.
pub(in super::super) const FEWEST_LANDMARKS: usize = 4;

/// Identity and pose that meet landmarks (vertex of the model, position, weight): rigidly from rest, then with all joints.
/// `None` if there are too few.
fn pose_at_landmarks(level: &BodyLevel, landmarks: &[(u32, DVec3, f64)]) -> Option<(Vec<f64>, Vec<f64>)> {
    /// Square metres per squared unit: a landmark a centimetre off outweighs a radian, or a standard deviation.
    const ANGLE_STIFFNESS: f64 = 2e-4;
    const IDENTITY_STIFFNESS: f64 = 2e-4;
    const ITERATIONS: usize = 40;
    let surface = &level.surface;
    let pulls: Vec<LandmarkPull> = landmarks
        .iter()
        .filter_map(|(vertex, target, confidence)| {
            let slot = level.vertices.binary_search(vertex).ok()? as u32;
            Some(LandmarkPull { vertex: slot, target: *target, confidence: *confidence })
        })
        .collect();
    if pulls.len() < FEWEST_LANDMARKS {
        return None;
    }
    let identity_count = surface.component_count();
    let identity = vec![0.0; identity_count];
    let rest = surface.rest_vertices(&identity);
    let own: Vec<DVec3> = pulls.iter().map(|pull| rest[pull.vertex as usize]).collect();
    let targets: Vec<DVec3> = pulls.iter().map(|pull| pull.target).collect();
    let motion = procrustes(&own, &targets)?;
    let root = surface.rest_joints(&identity)[0];
    let translation = motion.rotation * root + motion.translation - root;
    let rotation = rotation_vector(DQuat::from_mat3(&motion.rotation));
    let mut start = vec![0.0; surface.skeleton().pose_length()];
    start[..3].copy_from_slice(&translation.to_array());
    start[3..6].copy_from_slice(&rotation.to_array());
    let deformer = BodyParameters::new(surface, FreeParameters::IdentityAndPose);
    let (mut lower, mut upper) = (vec![-2.0; identity_count], vec![2.0; identity_count]);
    let limits = surface.skeleton().pose_limits();
    lower.extend(limits.0);
    upper.extend(limits.1);
    let bounds = Bounds::new(lower, upper).ok()?;
    let angle_count = start.len() - ROOT_LENGTH;
    let identity_prior = StayNear::new(0, &identity, &vec![IDENTITY_STIFFNESS; identity_count]);
    let angle_prior = StayNear::new(
        identity_count + ROOT_LENGTH,
        &start[ROOT_LENGTH..],
        &vec![ANGLE_STIFFNESS; angle_count],
    );
    let targets = LandmarkTargets::new(&pulls);
    let fit = Fit::new(&deformer).with(1.0, &targets).with(1.0, &identity_prior).with(1.0, &angle_prior);
    let settings = GaussNewtonSettings { max_iterations: ITERATIONS, ..GaussNewtonSettings::default() };
    let mut parameters = [identity, start].concat();
    gauss_newton(&fit, &mut parameters, &bounds, &settings, &mut Silent).ok()?;
    let mut pose = parameters.split_off(identity_count);
    normalise_root(&mut pose);
    Some((parameters, pose))
}

/// A start at landmarks, improved on the capture without them.
pub(in super::super) fn start_at_landmarks(
    search: &StartSearch<'_>,
    (capture, frame): (usize, &CapturedFrame),
    landmarks: &[(u32, DVec3, f64)],
) -> Option<Start> {
    let (identity, pose) = pose_at_landmarks(search.level(), landmarks)?;
    let start = Start { capture, identity, pose, energy: f64::INFINITY };
    Some(search.finish(frame, start))
}
