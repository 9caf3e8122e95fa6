//! From anatomical angles to the poses of one body, with feet that stay where they stand.

use glam::{DMat3, DQuat, DVec3};
use habitus::artifacts::motion_clip::MotionClip;
use habitus::body::{BodyModel, Pose, Skeleton, rotation_vector};

use crate::motion::{ArmAngles, LegAngles, Motion, Stance};
use crate::rest_body::{Bone, RestBody};

/// Softness of "the lowest point carries the weight", metres.
const CONTACT_SOFTNESS: f64 = 0.008;

/// Where the poses come from.
enum Choreography {
    /// Joint angles that are made here.
    Made {
        motion: Motion,
        /// In 0..1, shifts the cycle.
        phase: f64,
    },
    /// A clip of this very body, turned so that it begins above the origin and facing +z.
    Captured {
        clip: MotionClip,
        /// Where in the clip time zero is, seconds.
        start: f64,
        forwards: DQuat,
        origin: DVec3,
    },
}

/// Poses of one body over time, made one after the other because each stands on the last one's feet.
pub struct Animation<'a> {
    model: &'a BodyModel,
    joints: Vec<DVec3>,
    /// Heel and ball of the left and the right sole, rest space.
    soles: [(Bone, DVec3); 4],
    choreography: Choreography,
    /// Sole points (before translation) and root translation of the last pose.
    last: Option<([DVec3; 4], DVec3)>,
}

impl<'a> Animation<'a> {
    /// A motion of one body; `phase` in 0..1 shifts its cycle.
    pub fn new(model: &'a BodyModel, body: &RestBody, motion: Motion, phase: f64) -> Self {
        Self::of(model, body, Choreography::Made { motion, phase })
    }

    /// A clip that was made for this body, from `start` seconds on; none if the clip has no pose.
    pub fn captured(model: &'a BodyModel, body: &RestBody, clip: MotionClip, start: f64) -> Option<Self> {
        let first = clip.pose_at(start)?;
        let ahead = first.root_rotation() * DVec3::Z;
        let forwards = DQuat::from_rotation_y(-ahead.x.atan2(ahead.z));
        let origin = (body.joints()[0] + first.translation()).with_y(0.0);
        Some(Self::of(model, body, Choreography::Captured { clip, start, forwards, origin }))
    }

    fn of(model: &'a BodyModel, body: &RestBody, choreography: Choreography) -> Self {
        let joints = body.joints().to_vec();
        let soles = [
            (Bone::LeftFoot, sole(body, Bone::LeftFoot, -1.0)),
            (Bone::LeftFoot, sole(body, Bone::LeftFoot, 1.0)),
            (Bone::RightFoot, sole(body, Bone::RightFoot, -1.0)),
            (Bone::RightFoot, sole(body, Bone::RightFoot, 1.0)),
        ];
        Self { model, joints, soles, choreography, last: None }
    }

    /// The pose at a time (seconds), blended from the rest pose (0) to the motion (1).
    pub fn next_pose(&mut self, time: f64, blend: f64) -> Pose {
        match &self.choreography {
            Choreography::Made { motion, phase } => {
                let stance = motion.at(time, *phase);
                self.made_pose(&stance, blend)
            }
            Choreography::Captured { clip, start, forwards, origin } => {
                let skeleton = self.model.skeleton();
                let Some(mut pose) = clip.pose_at(start + time) else { return skeleton.rest_pose() };
                let root = *forwards * (self.joints[0] + pose.translation() - *origin);
                pose.set_root(*forwards * pose.root_rotation(), root - self.joints[0]);
                let mut rest = skeleton.rest_pose();
                let lowest = self.soles.iter().map(|(_, sole)| sole.y).fold(f64::INFINITY, f64::min);
                rest.set_root(DQuat::IDENTITY, DVec3::new(-self.joints[0].x, -lowest, -self.joints[0].z));
                rest.towards(&pose, blend)
            }
        }
    }

    fn made_pose(&mut self, stance: &Stance, blend: f64) -> Pose {
        let mut pose = posed_by_angles(self.model, &self.joints, stance);
        for angle in &mut pose.parameters_mut()[3..] {
            *angle *= blend;
        }
        // The heading is the only angle that may exceed a half turn, so it is blended before it is a vector.
        let root = DQuat::from_rotation_y(stance.heading * blend)
            * DQuat::from_rotation_y(stance.pelvis_turn * blend)
            * DQuat::from_rotation_z(stance.pelvis_list * blend);
        pose.set_root(root, DVec3::ZERO);
        let support = stance.support.map(|share| 1.0 + (share - 1.0) * blend);
        let translation = self.stand(&pose, support);
        pose.set_root(root, translation);
        pose
    }

    /// Root translation that keeps the loaded sole points where they were and the standing feet on the floor.
    fn stand(&mut self, pose: &Pose, support: [f64; 2]) -> DVec3 {
        let posed = self.model.skeleton().pose(&self.joints, pose.parameters());
        let soles = self
            .soles
            .map(|(bone, point)| posed.rotations[bone as usize] * point + posed.translations[bone as usize]);
        let total_support = (support[0] + support[1]).max(1e-9);
        let mut loads = [0.0; 4];
        let mut height = 0.0;
        for (foot, share) in support.into_iter().enumerate() {
            let share = share / total_support;
            let ends = [soles[2 * foot].y, soles[2 * foot + 1].y];
            let lowest = ends[0].min(ends[1]);
            let weights = ends.map(|end| (-(end - lowest) / CONTACT_SOFTNESS).exp());
            let sum = weights[0] + weights[1];
            for (end, weight) in weights.into_iter().enumerate() {
                loads[2 * foot + end] = share * weight / sum;
            }
            // Legs that stand both may differ in length by a few centimetres: the pelvis goes between them.
            height -= share * (lowest - CONTACT_SOFTNESS * sum.ln());
        }
        let translation = match &self.last {
            None => DVec3::ZERO,
            Some((last_soles, last_translation)) => {
                let slide: DVec3 = soles
                    .iter()
                    .zip(last_soles)
                    .zip(loads)
                    .map(|((now, last), load)| (*now - *last) * load)
                    .sum();
                *last_translation - slide
            }
        };
        let translation = DVec3::new(translation.x, height, translation.z);
        self.last = Some((soles, translation));
        translation
    }
}

/// The pose of a body whose joints have these anatomical angles; the root stays at rest.
pub fn posed_by_angles(model: &BodyModel, joints: &[DVec3], stance: &Stance) -> Pose {
    let skeleton = model.skeleton();
    let mut pose = skeleton.rest_pose();
    let (lower, upper) = skeleton.pose_limits();
    let parameters = pose.parameters_mut();
    let legs = [
        [Bone::LeftThigh, Bone::LeftShank, Bone::LeftFoot],
        [Bone::RightThigh, Bone::RightShank, Bone::RightFoot],
    ];
    for (chain, (angles, side)) in legs.into_iter().zip(stance.legs.iter().zip([1.0, -1.0])) {
        set_leg(parameters, skeleton, joints, chain, angles, side);
    }
    let arms = [
        [Bone::LeftUpperArm, Bone::LeftForearm, Bone::LeftHand],
        [Bone::RightUpperArm, Bone::RightForearm, Bone::RightHand],
    ];
    for (chain, (angles, side)) in arms.into_iter().zip(stance.arms.iter().zip([1.0, -1.0])) {
        set_arm(parameters, skeleton, joints, chain, angles, side);
    }
    let thorax = DMat3::from_rotation_y(stance.thorax_turn)
        * DMat3::from_rotation_z(-stance.thorax_list)
        * DMat3::from_rotation_x(stance.thorax_flexion);
    set_rotation(parameters, skeleton, Bone::Thorax, thorax);
    for ((angle, low), high) in parameters.iter_mut().zip(lower).zip(upper) {
        *angle = angle.clamp(low, high);
    }
    pose
}

fn set_leg(
    parameters: &mut [f64],
    skeleton: &Skeleton,
    joints: &[DVec3],
    chain: [Bone; 3],
    angles: &LegAngles,
    side: f64,
) {
    let [thigh, shank, foot] = chain;
    let leg = joints[foot as usize] - joints[thigh as usize];
    // The rest pose stands with legs apart; walking brings the feet together.
    let rest_abduction = (leg.x * side).atan2(-leg.y);
    let outwards = DMat3::from_rotation_z(side * (angles.hip_abduction - rest_abduction));
    set_rotation(parameters, skeleton, thigh, DMat3::from_rotation_x(-angles.hip_flexion) * outwards);
    set_flexion(parameters, skeleton, shank, angles.knee_flexion);
    set_turn(parameters, skeleton, foot, -angles.ankle_dorsiflexion, DVec3::X);
}

fn set_arm(
    parameters: &mut [f64],
    skeleton: &Skeleton,
    joints: &[DVec3],
    chain: [Bone; 3],
    angles: &ArmAngles,
    side: f64,
) {
    let [upper_arm, forearm, hand] = chain.map(|bone| joints[bone as usize]);
    let rest = (forearm - upper_arm).normalize_or_zero();
    let rest_bend = rest.angle_between(hand - forearm);
    let [upper_arm, forearm, _] = chain;
    let hanging = DVec3::new(side * angles.shoulder_abduction.sin(), -angles.shoulder_abduction.cos(), 0.0);
    let wanted = DMat3::from_rotation_x(-angles.shoulder_flexion) * hanging;
    set_rotation(parameters, skeleton, upper_arm, DMat3::from_quat(DQuat::from_rotation_arc(rest, wanted)));
    set_flexion(parameters, skeleton, forearm, angles.elbow_flexion - rest_bend);
}

/// The lowest vertex in the rear (−1) or front (1) half of a foot.
fn sole(body: &RestBody, foot: Bone, end: f64) -> DVec3 {
    let vertices = || {
        body.positions()
            .iter()
            .zip(body.bones())
            .filter(|(_, bone)| **bone == foot)
            .map(|(position, _)| *position)
    };
    let (low, high) = vertices().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), position| {
        (low.min(position.z), high.max(position.z))
    });
    let middle = (low + high) * 0.5;
    vertices()
        .filter(|position| (position.z - middle) * end > 0.25 * (high - middle))
        .min_by(|first, second| first.y.total_cmp(&second.y))
        .unwrap_or(body.joint(foot))
}

/// Parameters of a bone's axes within the pose vector.
fn axes_of(skeleton: &Skeleton, bone: Bone) -> Vec<(usize, DVec3)> {
    let root_length = skeleton.pose_length() - skeleton.axes().len();
    let axes = skeleton.axes().iter().enumerate();
    axes.filter(|(_, axis)| axis.bone == bone as usize)
        .map(|(index, axis)| (root_length + index, axis.direction))
        .collect()
}

/// Angles about a bone's own axes that come closest to a wanted rotation (Gauss–Newton on the rotation error).
fn set_rotation(parameters: &mut [f64], skeleton: &Skeleton, bone: Bone, wanted: DMat3) {
    let axes = axes_of(skeleton, bone);
    for _ in 0..20 {
        let mut rotation = DMat3::IDENTITY;
        let mut columns = [DVec3::ZERO; 3];
        for (column, (parameter, direction)) in columns.iter_mut().zip(&axes) {
            *column = rotation * *direction;
            rotation *= DMat3::from_axis_angle(*direction, parameters[*parameter]);
        }
        let error = rotation_vector(DQuat::from_mat3(&(wanted * rotation.transpose())));
        let jacobian = DMat3::from_cols(columns[0], columns[1], columns[2]);
        // Damped: axes may align (gimbal lock) or be fewer than three.
        let normal = jacobian.transpose() * jacobian + DMat3::from_diagonal(DVec3::splat(1e-6));
        let step = normal.inverse() * (jacobian.transpose() * error);
        for (value, (parameter, _)) in step.to_array().into_iter().zip(&axes) {
            parameters[*parameter] += value;
        }
    }
}

/// Bends a hinge the way its limits leave most room: knees and elbows.
fn set_flexion(parameters: &mut [f64], skeleton: &Skeleton, bone: Bone, angle: f64) {
    for ((parameter, _), axis) in axes_of(skeleton, bone)
        .into_iter()
        .zip(skeleton.axes().iter().filter(|axis| axis.bone == bone as usize))
    {
        parameters[parameter] = if axis.limits[1] >= -axis.limits[0] { angle } else { -angle };
    }
}

/// Turns a hinge by an angle about the direction that its axis lies closest to.
fn set_turn(parameters: &mut [f64], skeleton: &Skeleton, bone: Bone, angle: f64, about: DVec3) {
    for (parameter, direction) in axes_of(skeleton, bone) {
        parameters[parameter] = angle * direction.dot(about).signum();
    }
}
