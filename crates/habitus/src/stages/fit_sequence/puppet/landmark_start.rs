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

/// Identity and pose that meet landmarks (vertex of the model, position, weight): rigidly, then with all joints, from
/// `pose`, or from rest without one. `None` if there are too few.
pub(in super::super) fn pose_at_landmarks(
    level: &BodyLevel,
    landmarks: &[(u32, DVec3, f64)],
    known_identity: Option<&[f64]>,
    pose: Option<&[f64]>,
) -> Option<(Vec<f64>, Vec<f64>)> {
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
    let identity = known_identity.map_or_else(
        || vec![0.0; identity_count],
        |known| known.iter().copied().chain(std::iter::repeat(0.0)).take(identity_count).collect(),
    );
    let mut start = vec![0.0; surface.skeleton().pose_length()];
    if let Some(pose) = pose {
        start.copy_from_slice(pose);
    } else {
        let rest = surface.rest_vertices(&identity);
        let own: Vec<DVec3> = pulls.iter().map(|pull| rest[pull.vertex as usize]).collect();
        let targets: Vec<DVec3> = pulls.iter().map(|pull| pull.target).collect();
        let motion = procrustes(&own, &targets)?;
        let root = surface.rest_joints(&identity)[0];
        let translation = motion.rotation * root + motion.translation - root;
        start[..3].copy_from_slice(&translation.to_array());
        let rotation = rotation_vector(DQuat::from_mat3(&motion.rotation));
        start[3..6].copy_from_slice(&rotation.to_array());
    }
    let free = if known_identity.is_some() { 0 } else { identity_count };
    let deformer = if known_identity.is_some() {
        BodyParameters::of_pose(surface, &identity)
    } else {
        BodyParameters::new(surface, FreeParameters::IdentityAndPose)
    };
    let (mut lower, mut upper) = (vec![-2.0; free], vec![2.0; free]);
    let limits = surface.skeleton().pose_limits();
    lower.extend(limits.0);
    upper.extend(limits.1);
    let bounds = Bounds::new(lower, upper).ok()?;
    let angle_count = start.len() - ROOT_LENGTH;
    let identity_prior = StayNear::new(0, &vec![0.0; free], &vec![IDENTITY_STIFFNESS; free]);
    let angle_prior =
        StayNear::new(free + ROOT_LENGTH, &start[ROOT_LENGTH..], &vec![ANGLE_STIFFNESS; angle_count]);
    let targets = LandmarkTargets::new(&pulls);
    let fit = Fit::new(&deformer).with(1.0, &targets).with(1.0, &identity_prior).with(1.0, &angle_prior);
    let settings = GaussNewtonSettings { max_iterations: ITERATIONS, ..GaussNewtonSettings::default() };
    let mut parameters = identity[..free].to_vec();
    parameters.extend(&start);
    gauss_newton(&fit, &mut parameters, &bounds, &settings, &mut Silent).ok()?;
    let pose = parameters.split_off(free);
    let mut pose = pose;
    normalise_root(&mut pose);
    Some((if free > 0 { parameters } else { identity }, pose))
}

/// A start at landmarks, improved on the capture without them.
pub(in super::super) fn start_at_landmarks(
    search: &StartSearch<'_>,
    (capture, frame): (usize, &CapturedFrame),
    landmarks: &[(u32, DVec3, f64)],
    known_identity: Option<&[f64]>,
) -> Option<Start> {
    let (identity, pose) = pose_at_landmarks(search.level(), landmarks, known_identity, None)?;
    let start = Start { capture, identity, pose, energy: f64::INFINITY };
    Some(search.finish(frame, start, known_identity.is_some()))
}
