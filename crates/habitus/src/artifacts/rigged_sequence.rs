//! A fitted sequence together with the rig that moves it: what report and export need, without the model's file.

use glam::{DMat3, DQuat, DVec3};

use super::fitted_sequence::{FittedSequence, InputFrame};
use crate::body::{BodyModel, PosedSkeleton, Skeleton, SkinWeights, rotation_vector};

/// Faces, skin and skeleton of a body model, and the names that go with them.
#[derive(Clone, Debug, PartialEq)]
pub struct Rig {
    /// Name of the body model.
    pub model_name: String,
    /// Licence of the body model's data.
    pub model_license: String,
    /// Triangles, counter-clockwise from outside.
    pub faces: Vec<[u32; 3]>,
    /// Skin weights.
    pub skin: SkinWeights,
    /// Bones, axes and limits.
    pub skeleton: Skeleton,
    /// Names of the landmarks.
    pub landmarks: Vec<String>,
}

impl Rig {
    /// The rig of a body model.
    pub fn of(model: &BodyModel) -> Self {
        Self {
            model_name: model.metadata().name.clone(),
            model_license: model.metadata().license.clone(),
            faces: model.faces().to_vec(),
            skin: model.surface().skin().clone(),
            skeleton: model.skeleton().clone(),
            landmarks: model.metadata().landmarks.clone(),
        }
    }
}

/// Frames per second: a positive, finite number.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrameRate(f64);

impl FrameRate {
    /// A frame rate, unless the number cannot be one.
    pub fn new(frames_per_second: f64) -> Option<Self> {
        (frames_per_second.is_finite() && frames_per_second > 0.0).then_some(Self(frames_per_second))
    }

    /// Frames per second.
    pub fn frames_per_second(self) -> f64 {
        self.0
    }

    /// Seconds from the first frame to this one.
    pub fn time_of(self, frame: usize) -> f64 {
        frame as f64 / self.0
    }
}

/// A fitted sequence that can be posed.
#[derive(Clone, Debug, PartialEq)]
pub struct RiggedSequence {
    /// Identity, rest body, poses and quality, in metres, y up.
    pub sequence: FittedSequence,
    /// What moves the rest body.
    pub rig: Rig,
}

impl RiggedSequence {
    /// The skeleton in a frame's pose, metres, y up.
    pub fn posed_skeleton(&self, frame: usize) -> PosedSkeleton {
        self.rig.skeleton.pose(&self.sequence.rest_joints, &self.sequence.frames[frame].pose)
    }

    /// The body in a frame's pose, metres, y up.
    pub fn posed_vertices(&self, frame: usize) -> Vec<DVec3> {
        let mut vertices = Vec::with_capacity(self.sequence.rest_vertices.len());
        let posed = self.posed_skeleton(frame);
        self.rig.skin.apply_into(&self.sequence.rest_vertices, &posed, &mut vertices);
        vertices
    }
}

/// The pose that brings the rest body, measured in the input's unit, into the input's own frame.
///
/// A posed point is `x = R (w − J₀) + J₀ + t` with `w` bent but not moved by the root. With the input's
/// `x' = Qᵀ x / s` and the stored `w' = w / s`, that is `x' = R' (w' − J₀') + J₀' + t'` for `R' = Qᵀ R` and
/// `t' = Qᵀ (J₀ + t) / s − J₀ / s`. The angles do not change.
pub(super) fn pose_in_input_frame(frame: &InputFrame, root_joint: DVec3, pose: &[f64]) -> Vec<f64> {
    let input_from_internal = frame.internal_from_input.transpose();
    let translation =
        frame.to_input(root_joint + DVec3::from_slice(pose)) - root_joint / frame.metres_per_unit;
    with_root(pose, input_from_internal, translation)
}

/// Undoes [`pose_in_input_frame`]; `root_joint` is in metres.
pub(super) fn pose_in_internal_frame(frame: &InputFrame, root_joint: DVec3, pose: &[f64]) -> Vec<f64> {
    let translation =
        frame.to_internal(root_joint / frame.metres_per_unit + DVec3::from_slice(pose)) - root_joint;
    with_root(pose, frame.internal_from_input, translation)
}

fn with_root(pose: &[f64], turn: DMat3, translation: DVec3) -> Vec<f64> {
    let mut changed = pose.to_vec();
    changed[..3].copy_from_slice(&translation.to_array());
    let rotation = DQuat::from_mat3(&turn) * DQuat::from_scaled_axis(DVec3::from_slice(&pose[3..]));
    changed[3..6].copy_from_slice(&rotation_vector(rotation.normalize()).to_array());
    changed
}

/// Of all rotation vectors that mean the same rotation, the one nearest to the frame before: a root that turns
/// through π would otherwise jump by 2π in the file.
pub(super) fn unwind_root_rotations(poses: &mut [Vec<f64>]) {
    for index in 1..poses.len() {
        let before = DVec3::from_slice(&poses[index - 1][3..]);
        let here = DVec3::from_slice(&poses[index][3..]);
        let Some(direction) = here.try_normalize() else { continue };
        let turns = ((before.dot(direction) - here.length()) / std::f64::consts::TAU).round();
        let unwound = here + direction * (turns * std::f64::consts::TAU);
        poses[index][3..6].copy_from_slice(&unwound.to_array());
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use glam::{DMat3, DVec3};

    use super::{FrameRate, InputFrame, pose_in_input_frame, pose_in_internal_frame, unwind_root_rotations};
    use crate::body::{Pose, fixture};

    fn frame() -> InputFrame {
        InputFrame {
            metres_per_unit: 0.001,
            internal_from_input: DMat3::from_axis_angle(DVec3::new(0.6, 0.0, 0.8), 1.1),
            report: Vec::new(),
        }
    }

    #[test]
    fn skinning_in_the_input_frame_gives_the_input_points() {
        let model = fixture::model();
        let rest = model.rest_vertices(&[1.0, -0.5]);
        let joints = model.joints(&rest);
        let pose: Vec<f64> = (0..30).map(|k| 0.5 * (2.1 * k as f64).cos()).collect();
        let frame = frame();
        let internal = model.pose_vertices(&rest, &model.skeleton().pose(&joints, &pose));
        let scaled = |points: &[DVec3]| -> Vec<DVec3> { points.iter().map(|p| *p / 0.001).collect() };
        let moved = pose_in_input_frame(&frame, joints[0], &pose);
        let posed = model.skeleton().pose(&scaled(&joints), &moved);
        for (a, b) in internal.iter().zip(model.pose_vertices(&scaled(&rest), &posed)) {
            assert!(frame.to_input(*a).distance(b) < 1e-9, "in millimetres");
        }
        let back = pose_in_internal_frame(&frame, joints[0], &moved);
        assert!(pose.iter().zip(&back).all(|(a, b)| (a - b).abs() < 1e-12));
    }

    #[test]
    fn unwinding_keeps_rotations_and_makes_them_continuous() {
        let model = fixture::model();
        let turned = |angle: f64| {
            let mut pose = model.skeleton().rest_pose();
            let rotation = glam::DQuat::from_axis_angle(DVec3::new(0.0, 0.8, 0.6), angle);
            pose.set_root(rotation, DVec3::ZERO);
            pose.parameters().to_vec()
        };
        let mut poses: Vec<Vec<f64>> = (0..60).map(|k| turned(0.3 * f64::from(k))).collect();
        let wound = poses.clone();
        unwind_root_rotations(&mut poses);
        for (index, (pose, wound)) in poses.iter().zip(&wound).enumerate() {
            let angle = DVec3::from_slice(&pose[3..]).dot(DVec3::new(0.0, 0.8, 0.6));
            assert!((angle - 0.3 * index as f64).abs() < 1e-9);
            let rotation = |pose: &[f64]| {
                Pose::new(model.skeleton(), pose.to_vec()).map(|pose| pose.root_rotation()).unwrap()
            };
            assert!(rotation(pose).dot(rotation(wound)).abs() > 1.0 - 1e-12);
        }
        assert!(DVec3::from_slice(&poses[59][3..]).length() > 2.0 * TAU);
    }

    #[test]
    fn only_positive_numbers_are_frame_rates() {
        assert_eq!(FrameRate::new(25.0).map(|rate| rate.time_of(50)), Some(2.0));
        assert!([0.0, -1.0, f64::NAN, f64::INFINITY].iter().all(|rate| FrameRate::new(*rate).is_none()));
    }
}
