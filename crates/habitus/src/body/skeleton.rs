//! The skeleton: bones that turn about shape-dependent joints by products of exponentials (P2 §3).

use std::cmp::Ordering;

use glam::{DMat3, DQuat, DVec3};
use thiserror::Error;

/// Bones of the default skeleton (P2 §5).
pub const BONE_COUNT: usize = 15;
/// Pose parameters of the default skeleton: translation 3, root rotation vector 3, 24 angles (P2 §5).
pub const POSE_LENGTH: usize = 30;
/// Pose parameters of the root: translation 3 and rotation vector 3.
pub const ROOT_LENGTH: usize = 6;

/// A rigid part that turns about its own joint in its parent's frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Bone {
    /// Name, for example `left_thigh`.
    pub name: String,
    /// Index of the parent; the root has none.
    pub parent: Option<usize>,
}

/// One rotation axis of a bone.
#[derive(Clone, Debug, PartialEq)]
pub struct Axis {
    /// Name, for example `left_hip_flexion`.
    pub name: String,
    /// The bone it turns.
    pub bone: usize,
    /// Unit direction in rest space.
    pub direction: DVec3,
    /// Smallest and largest angle in radians.
    pub limits: [f64; 2],
}

/// Why a skeleton cannot be built.
#[derive(Debug, Error, PartialEq)]
pub enum SkeletonError {
    /// There is no bone at all.
    #[error("the skeleton has no bones: it needs at least a root")]
    NoRoot,
    /// A parent does not come before its child.
    #[error(
        "bone {bone} has parent {parent}: parents must come before their children, and only bone 0 has none"
    )]
    ParentOrder {
        /// The child.
        bone: usize,
        /// Its parent as given (−1: none).
        parent: i64,
    },
    /// An axis names no bone, breaks the order of bones, or has an unusable direction or limits.
    #[error("axis {axis} is invalid: {reason}")]
    BadAxis {
        /// Index of the axis.
        axis: usize,
        /// What is wrong.
        reason: &'static str,
    },
}

/// Bones, their axes and limits: data, so that a richer rig is another file.
#[derive(Clone, Debug, PartialEq)]
pub struct Skeleton {
    bones: Vec<Bone>,
    axes: Vec<Axis>,
    chains: Vec<Vec<usize>>,
}

impl Skeleton {
    /// Builds a skeleton; bones are sorted parents first, axes by bone.
    pub fn new(bones: Vec<Bone>, mut axes: Vec<Axis>) -> Result<Self, SkeletonError> {
        if bones.is_empty() {
            return Err(SkeletonError::NoRoot);
        }
        for (index, bone) in bones.iter().enumerate() {
            let valid = match bone.parent {
                None => index == 0,
                Some(parent) => parent < index,
            };
            if !valid {
                return Err(SkeletonError::ParentOrder {
                    bone: index,
                    parent: bone.parent.map_or(-1, |parent| parent as i64),
                });
            }
        }
        for (index, axis) in axes.iter_mut().enumerate() {
            let fail = |reason| Err(SkeletonError::BadAxis { axis: index, reason });
            if axis.bone == 0 || axis.bone >= bones.len() {
                return fail("its bone must exist and must not be the root");
            }
            let length = axis.direction.length();
            if !length.is_finite() || length < 1e-6 {
                return fail("its direction has no length");
            }
            axis.direction /= length;
            if axis.limits[0].partial_cmp(&axis.limits[1]) != Some(Ordering::Less) {
                return fail("its lower limit must lie below its upper limit");
            }
        }
        if let Some(index) = axes.windows(2).position(|pair| pair[0].bone > pair[1].bone) {
            return Err(SkeletonError::BadAxis { axis: index + 1, reason: "axes must be sorted by bone" });
        }
        let mut chains: Vec<Vec<usize>> = Vec::with_capacity(bones.len());
        for (index, bone) in bones.iter().enumerate() {
            let mut chain = bone.parent.map_or_else(|| (0..ROOT_LENGTH).collect(), |p| chains[p].clone());
            chain.extend(
                axes.iter().enumerate().filter(|(_, axis)| axis.bone == index).map(|(k, _)| ROOT_LENGTH + k),
            );
            chains.push(chain);
        }
        Ok(Self { bones, axes, chains })
    }

    /// The bones, parents first.
    pub fn bones(&self) -> &[Bone] {
        &self.bones
    }

    /// The rotation axes in the order of the pose's angles.
    pub fn axes(&self) -> &[Axis] {
        &self.axes
    }

    /// Length of this skeleton's pose vector.
    pub fn pose_length(&self) -> usize {
        ROOT_LENGTH + self.axes.len()
    }

    /// Pose parameters that move a bone, root first.
    pub fn chain(&self, bone: usize) -> &[usize] {
        &self.chains[bone]
    }

    /// The pose in which all parameters are zero.
    pub fn rest_pose(&self) -> Pose {
        Pose { parameters: vec![0.0; self.pose_length()] }
    }

    /// Lower and upper limits of the whole pose vector; the root is unlimited.
    pub fn pose_limits(&self) -> (Vec<f64>, Vec<f64>) {
        let mut lower = vec![f64::NEG_INFINITY; ROOT_LENGTH];
        let mut upper = vec![f64::INFINITY; ROOT_LENGTH];
        for axis in &self.axes {
            lower.push(axis.limits[0]);
            upper.push(axis.limits[1]);
        }
        (lower, upper)
    }

    /// Bone transforms, posed joints and the twist of each pose parameter (P2 Eq. 2, T_j(Θ)).
    pub fn pose(&self, joints: &[DVec3], pose: &[f64]) -> PosedSkeleton {
        assert_eq!(joints.len(), self.bones.len(), "one joint for each bone");
        assert_eq!(pose.len(), self.pose_length(), "pose of this skeleton's length");
        let translation = DVec3::new(pose[0], pose[1], pose[2]);
        let rotation_vector = DVec3::new(pose[3], pose[4], pose[5]);
        let root_joint = joints[0] + translation;
        let mut twists = vec![Twist::default(); pose.len()];
        for (k, direction) in DVec3::AXES.into_iter().enumerate() {
            twists[k] = Twist { angular: DVec3::ZERO, linear: direction };
        }
        let left_jacobian = left_jacobian(rotation_vector);
        for k in 0..3 {
            twists[3 + k] = Twist::about(left_jacobian.col(k), root_joint);
        }
        let mut rotations = Vec::with_capacity(self.bones.len());
        let mut posed_joints = Vec::with_capacity(self.bones.len());
        rotations.push(DMat3::from_quat(DQuat::from_scaled_axis(rotation_vector)));
        posed_joints.push(root_joint);
        let mut next_axis = 0;
        for (index, bone) in self.bones.iter().enumerate().skip(1) {
            let parent = bone.parent.unwrap_or(0);
            let mut rotation: DMat3 = rotations[parent];
            let joint = posed_joints[parent] + rotation * (joints[index] - joints[parent]);
            while next_axis < self.axes.len() && self.axes[next_axis].bone == index {
                let axis = &self.axes[next_axis];
                let parameter = ROOT_LENGTH + next_axis;
                twists[parameter] = Twist::about(rotation * axis.direction, joint);
                rotation *= DMat3::from_axis_angle(axis.direction, pose[parameter]);
                next_axis += 1;
            }
            rotations.push(rotation);
            posed_joints.push(joint);
        }
        let translations = rotations
            .iter()
            .zip(&posed_joints)
            .zip(joints)
            .map(|((rotation, posed), rest)| *posed - *rotation * *rest)
            .collect();
        PosedSkeleton { rotations, translations, joints: posed_joints, twists }
    }
}

/// The velocity field that one pose parameter causes: `v(x) = angular × x + linear`, in posed space.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Twist {
    /// Angular part.
    pub angular: DVec3,
    /// Linear part, the velocity at the origin.
    pub linear: DVec3,
}

impl Twist {
    fn about(axis: DVec3, pivot: DVec3) -> Self {
        Self { angular: axis, linear: pivot.cross(axis) }
    }

    /// Velocity of a posed point.
    pub fn at(&self, point: DVec3) -> DVec3 {
        self.angular.cross(point) + self.linear
    }
}

/// A skeleton in a pose: `posed = rotation · rest + translation` for each bone.
#[derive(Clone, Debug, PartialEq)]
pub struct PosedSkeleton {
    /// Rotation of each bone, posed from rest.
    pub rotations: Vec<DMat3>,
    /// Translation of each bone, posed from rest, in metres.
    pub translations: Vec<DVec3>,
    /// Posed joints in metres.
    pub joints: Vec<DVec3>,
    /// Twist of each pose parameter, in posed space.
    pub twists: Vec<Twist>,
}

/// Pose parameters of one frame: translation (metres), root rotation vector and angles (radians).
#[derive(Clone, Debug, PartialEq)]
pub struct Pose {
    parameters: Vec<f64>,
}

impl Pose {
    /// Takes a parameter vector of the skeleton's length.
    pub fn new(skeleton: &Skeleton, parameters: Vec<f64>) -> Option<Self> {
        (parameters.len() == skeleton.pose_length()).then_some(Self { parameters })
    }

    /// The parameter vector.
    pub fn parameters(&self) -> &[f64] {
        &self.parameters
    }

    /// The parameter vector, to change.
    pub fn parameters_mut(&mut self) -> &mut [f64] {
        &mut self.parameters
    }

    /// Translation of the root in metres.
    pub fn translation(&self) -> DVec3 {
        DVec3::from_slice(&self.parameters)
    }

    /// Rotation of the root.
    pub fn root_rotation(&self) -> DQuat {
        DQuat::from_scaled_axis(DVec3::from_slice(&self.parameters[3..]))
    }

    /// A pose on the way to another: the root's rotation on the shortest arc, all else in straight lines.
    #[must_use]
    pub fn towards(&self, other: &Self, share: f64) -> Self {
        let pairs = self.parameters.iter().zip(&other.parameters);
        let mut pose = Self { parameters: pairs.map(|(from, to)| from + (to - from) * share).collect() };
        let rotation = self.root_rotation().slerp(other.root_rotation(), share);
        pose.set_root(rotation, pose.translation());
        pose
    }

    /// Sets the root's rotation and translation.
    pub fn set_root(&mut self, rotation: DQuat, translation: DVec3) {
        self.parameters[..3].copy_from_slice(&translation.to_array());
        self.parameters[3..6].copy_from_slice(&rotation_vector(rotation).to_array());
    }
}

/// The shortest rotation vector of a rotation, |r| ≤ π.
pub fn rotation_vector(rotation: DQuat) -> DVec3 {
    let q = if rotation.w < 0.0 { -rotation } else { rotation };
    let half_sine = q.xyz().length();
    // Not glam's form: it returns zero below 1e-8, which would freeze a derivative taken by differences.
    let angle_over_half_sine = if half_sine < 1e-9 { 2.0 } else { 2.0 * half_sine.atan2(q.w) / half_sine };
    q.xyz() * angle_over_half_sine
}

/// Left Jacobian of SO(3): exp(r + J⁻¹-free small change) = exp(J δ) exp(r) to first order.
pub(crate) fn left_jacobian(r: DVec3) -> DMat3 {
    let angle_squared = r.length_squared();
    let skew =
        DMat3::from_cols(DVec3::new(0.0, r.z, -r.y), DVec3::new(-r.z, 0.0, r.x), DVec3::new(r.y, -r.x, 0.0));
    let angle = angle_squared.sqrt();
    // Series near zero: both quotients cancel catastrophically there.
    let (a, b) = if angle < 1e-4 {
        (0.5 - angle_squared / 24.0, 1.0 / 6.0 - angle_squared / 120.0)
    } else {
        ((1.0 - angle.cos()) / angle_squared, (angle - angle.sin()) / (angle_squared * angle))
    };
    DMat3::IDENTITY + skew * a + skew * skew * b
}

#[cfg(test)]
mod tests;
