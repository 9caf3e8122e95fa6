//! Motion of captured joints → poses of one of our bodies.
//!
//! Zero rotation means another posture in each file convention, and in some no posture at all; where joints are means
//! the same in all. So nothing is said about rotations: each frame is a small fit (Gauss–Newton inside the joint limits)
//! of the directions of limbs. Steps scale with the legs, and the lowest foot stands on the floor when the captured one
//! does.

mod floor;
mod limbs;
mod roles;

use glam::{DMat3, DQuat, DVec3};
use habitus_optimize::{Bounds, GaussNewtonSettings, Silent, SolveError, Tolerances, gauss_newton};
use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::artifacts::motion_clip::MotionClip;
use crate::artifacts::motion_files::JointMotion;
use crate::artifacts::rigged_sequence::FrameRate;
use crate::body::{BodyModel, Pose};
use floor::{Floor, Soles};
use limbs::{DirectionFit, Limbs};
use roles::{CapturedBody, Role};

/// Which direction of a motion file points up.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum UpAxis {
    /// The axis nearest to the line from hips to neck, over all frames.
    #[default]
    Found,
    /// y.
    Y,
    /// z.
    Z,
}

/// How a captured motion is brought to a body.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RetargetSettings {
    /// Which axis of the file points up.
    pub up: UpAxis,
    /// Poses a second of the result; none: the file's own.
    pub frames_per_second: Option<f64>,
    /// Weight of the directions of thighs, shanks, upper arms and forearms; all weights are against this one.
    pub limbs: f64,
    /// Weight of the line from hip to hip.
    pub pelvis: f64,
    /// Weight of the line from the hips to the neck.
    pub trunk: f64,
    /// Weight of the line from shoulder to shoulder; collar bones, which our skeleton lacks, disturb it.
    pub shoulders: f64,
    /// Weight of the feet.
    pub feet: f64,
    /// Weight of the hands.
    pub hands: f64,
    /// Weight of the head.
    pub head: f64,
    /// Pull of all angles to the rest pose, per square radian: decides what no direction shows.
    pub rest: f64,
    /// Pull of all angles to the frame before, per square radian.
    pub smoothness: f64,
    /// A foot closer than this to its lowest level stands on the floor; in metres of a body with legs of 0.85 m.
    pub standing_height: f64,
    /// A foot stands still below this speed, m/s.
    pub standing_speed: f64,
    /// Time over which corrections of the height are smoothed, seconds.
    pub height_smoothing_seconds: f64,
}

impl Default for RetargetSettings {
    fn default() -> Self {
        Self {
            up: UpAxis::Found,
            frames_per_second: None,
            limbs: 1.0,
            pelvis: 1.0,
            trunk: 1.0,
            shoulders: 0.3,
            feet: 0.3,
            hands: 0.1,
            head: 0.2,
            rest: 2e-4,
            smoothness: 2e-3,
            standing_height: 0.02,
            standing_speed: 0.25,
            height_smoothing_seconds: 0.07,
        }
    }
}

/// Why a motion cannot be brought to a body.
#[derive(Debug, Error)]
pub enum RetargetError {
    /// No joint of the file has a name that stands for this place of the body.
    #[error(
        "{motion}: none of its joints is the {role} (it has {found}); rename it, for example to '{example}'"
    )]
    JointMissing {
        /// The motion.
        motion: String,
        /// What is needed.
        role: &'static str,
        /// A name that is known.
        example: &'static str,
        /// The names that are there.
        found: String,
    },
    /// The model's skeleton lacks a bone by that name.
    #[error("the body model has no bone '{bone}'; motions need the bones of the default skeleton")]
    BoneMissing {
        /// The bone.
        bone: &'static str,
    },
    /// There is nothing to move.
    #[error("{motion}: has no frames")]
    NoFrames {
        /// The motion.
        motion: String,
    },
    /// Its legs have no length.
    #[error(
        "{motion}: its legs have no length; the file is broken, or its joints are named in another sense"
    )]
    NoLegs {
        /// The motion.
        motion: String,
    },
    /// The frame rate is impossible.
    #[error("retarget.frames_per_second is {0}, but must be positive and finite")]
    FrameRate(f64),
    /// A frame's fit failed.
    #[error("{motion}, frame {frame}: {source}")]
    Solve {
        /// The motion.
        motion: String,
        /// The frame, from zero.
        frame: usize,
        /// What the solver says.
        source: SolveError,
    },
}

/// The body that a motion is brought to.
pub struct RetargetBody<'a> {
    model: &'a BodyModel,
    joints: Vec<DVec3>,
    limbs: Limbs,
    soles: Soles,
}

impl<'a> RetargetBody<'a> {
    /// A body by its rest vertices in the model's topology, metres.
    pub fn new(model: &'a BodyModel, rest_vertices: &[DVec3]) -> Result<Self, RetargetError> {
        let joints = model.joints(rest_vertices);
        let limbs = Limbs::of(model, rest_vertices, &joints)?;
        Ok(Self { model, limbs, soles: Soles::of(model, rest_vertices)?, joints })
    }

    /// From hip to ankle along the bones, mean of both sides, metres.
    pub fn leg_length(&self) -> f64 {
        self.limbs.leg_length
    }
}

/// Poses of a body that follow a captured motion (see the module's head), y up, the floor at y = 0.
pub fn retarget(
    motion: &JointMotion,
    body: &RetargetBody<'_>,
    settings: &RetargetSettings,
) -> Result<MotionClip, RetargetError> {
    if motion.positions.is_empty() {
        return Err(RetargetError::NoFrames { motion: motion.name.clone() });
    }
    let resampled;
    let motion = match settings.frames_per_second {
        None => motion,
        Some(rate) => {
            let rate = FrameRate::new(rate).ok_or(RetargetError::FrameRate(rate))?;
            resampled = motion.resampled(rate);
            &resampled
        }
    };
    let mut captured = CapturedBody::of(motion)?;
    captured.turn_up(settings.up);
    let captured_legs = captured.leg_length();
    if captured_legs.partial_cmp(&0.0) != Some(std::cmp::Ordering::Greater) {
        return Err(RetargetError::NoLegs { motion: motion.name.clone() });
    }
    captured.scale(body.leg_length() / captured_legs);
    let floor = Floor::of(&captured, motion.frame_rate, settings);
    let directions = body.limbs.directions(&captured, &floor, settings);
    let mut poses = fit_directions(motion, body, &captured, &directions, settings)?;
    let heights: Vec<f64> = poses.iter().map(|pose| body.soles.lowest(body, pose)).collect();
    let shifts = floor.shifts(&heights, motion.frame_rate, settings);
    for (pose, shift) in poses.iter_mut().zip(shifts) {
        pose.parameters_mut()[1] += shift;
    }
    Ok(MotionClip { name: motion.name.clone(), frame_rate: motion.frame_rate, poses })
}

/// A clip of one body carried over to another: the same angles, steps scaled with the legs, feet on the floor.
pub fn carry_over(clip: &MotionClip, from: &RetargetBody<'_>, to: &RetargetBody<'_>) -> MotionClip {
    let scale = to.leg_length() / from.leg_length();
    let poses = clip.poses.iter().map(|pose| {
        let mut carried = pose.clone();
        // Heights above the floor scale with the legs; between the floors the soles decide.
        let clearance = from.soles.lowest(from, pose);
        let root = (from.joints[0] + pose.translation()) * scale - to.joints[0];
        carried.set_root(pose.root_rotation(), root);
        let shift = clearance * scale - to.soles.lowest(to, &carried);
        carried.parameters_mut()[1] += shift;
        carried
    });
    MotionClip { name: clip.name.clone(), frame_rate: clip.frame_rate, poses: poses.collect() }
}

fn fit_directions(
    motion: &JointMotion,
    body: &RetargetBody<'_>,
    captured: &CapturedBody,
    directions: &[Vec<Option<DVec3>>],
    settings: &RetargetSettings,
) -> Result<Vec<Pose>, RetargetError> {
    let skeleton = body.model.skeleton();
    let (lower, upper) = skeleton.pose_limits();
    let bounds = Bounds { lower, upper };
    let mut last = skeleton.rest_pose();
    last.set_root(heading(captured, 0), DVec3::ZERO);
    let start = captured.middle_of_hips(0).with_y(0.0);
    let mut poses = Vec::with_capacity(directions.len());
    for (frame, wanted) in directions.iter().enumerate() {
        let fit = DirectionFit::new(body, wanted, &last, settings);
        let solver = GaussNewtonSettings {
            max_iterations: if frame == 0 { 200 } else { 30 },
            initial_damping: 1e-3,
            tolerances: Tolerances { gradient: 1e-9, step: 1e-6, energy: 1e-8 },
            ..GaussNewtonSettings::default()
        };
        let mut parameters = last.parameters().to_vec();
        gauss_newton(&fit, &mut parameters, &bounds, &solver, &mut Silent)
            .map_err(|source| RetargetError::Solve { motion: motion.name.clone(), frame, source })?;
        last.parameters_mut().copy_from_slice(&parameters);
        let mut pose = last.clone();
        // The shortest vector: a person who turns twice must not come near the singular ones at 2π.
        last.set_root(pose.root_rotation(), DVec3::ZERO);
        // The middle between the hips follows the captured one, from above the origin; directions do not see where.
        let posed = skeleton.pose(&body.joints, pose.parameters());
        let hips = body.limbs.middle_of_hips(&posed);
        let translation = pose.translation() + captured.middle_of_hips(frame) - start - hips;
        pose.set_root(last.root_rotation(), translation);
        poses.push(pose);
    }
    Ok(poses)
}

/// The rotation that turns the rest pose to where the captured person faces.
fn heading(captured: &CapturedBody, frame: usize) -> DQuat {
    let left = captured.place(frame, Role::LeftHip) - captured.place(frame, Role::RightHip);
    let left = DVec3::new(left.x, 0.0, left.z).try_normalize().unwrap_or(DVec3::X);
    DQuat::from_mat3(&DMat3::from_cols(left, DVec3::Y, left.cross(DVec3::Y)))
}

#[cfg(test)]
mod tests;
