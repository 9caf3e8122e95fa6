//! What a motion is described by where something else is learnt from it (P3 §4): speed, joint angles, angular speeds.

use glam::{DMat3, DQuat, DVec3};
use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};

use super::skeleton::{ROOT_LENGTH, Skeleton};

/// Which numbers describe a moment of a motion.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FeatureSet {
    /// P3 §4: global speed, joint angles and joint angular speeds.
    Paper2018,
    /// Joint angles and their speeds, and how the pelvis is inclined, moves and turns, all as seen from the pelvis.
    FromPelvis,
}

/// What a feature is, in words that do not change, and the bone that it belongs to.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Feature {
    /// `speed`, `angle.AXIS`, `rate.AXIS`, `up.x`, `velocity.x`, `turn.x` and so on.
    pub name: String,
    /// Kind of the feature: the part of its name before the dot.
    pub kind: FeatureKind,
    /// The bone; the root for what concerns the body as a whole.
    pub bone: usize,
}

/// Kinds of features.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FeatureKind {
    /// Angle about an axis of a joint, radians.
    Angle,
    /// Its speed, radians per second.
    Rate,
    /// Speed of the root, metres per second.
    Speed,
    /// The direction up, as the root sees it.
    Up,
    /// Velocity of the root as it sees it, metres per second.
    Velocity,
    /// Angular velocity of the root as it sees it, radians per second.
    Turn,
}

impl FeatureSet {
    /// The features in order.
    pub fn features(self, skeleton: &Skeleton) -> Vec<Feature> {
        let of_axes = |kind, word: &str| -> Vec<Feature> {
            let axes = skeleton.axes().iter();
            axes.map(|axis| Feature { name: format!("{word}.{}", axis.name), kind, bone: axis.bone })
                .collect()
        };
        let of_root = |kind, word: &str| {
            ["x", "y", "z"].map(|axis| Feature { name: format!("{word}.{axis}"), kind, bone: 0 }).to_vec()
        };
        let angles = [of_axes(FeatureKind::Angle, "angle"), of_axes(FeatureKind::Rate, "rate")].concat();
        match self {
            Self::Paper2018 => {
                [vec![Feature { name: "speed".into(), kind: FeatureKind::Speed, bone: 0 }], angles].concat()
            }
            Self::FromPelvis => [
                angles,
                of_root(FeatureKind::Up, "up"),
                of_root(FeatureKind::Velocity, "velocity"),
                of_root(FeatureKind::Turn, "turn"),
            ]
            .concat(),
        }
    }

    /// One row of features for each pose; `times` in seconds, ascending. Speeds are central differences.
    pub fn of_motion(self, skeleton: &Skeleton, poses: &[&[f64]], times: &[f64]) -> DMatrix<f64> {
        assert_eq!(poses.len(), times.len(), "one time for each pose");
        let width = self.features(skeleton).len();
        let mut rows = DMatrix::zeros(poses.len(), width);
        for frame in 0..poses.len() {
            let (before, after) = (frame.saturating_sub(1), (frame + 1).min(poses.len() - 1));
            let span = (times[after] - times[before]).max(f64::MIN_POSITIVE);
            let slope =
                |k: usize| if after > before { (poses[after][k] - poses[before][k]) / span } else { 0.0 };
            let pose = poses[frame];
            let angles = ROOT_LENGTH..pose.len();
            let joint_numbers = angles.clone().map(|k| pose[k]).chain(angles.map(slope));
            let velocity = DVec3::new(slope(0), slope(1), slope(2));
            let numbers: Vec<f64> = match self {
                Self::Paper2018 => std::iter::once(velocity.length()).chain(joint_numbers).collect(),
                Self::FromPelvis => {
                    let root = root_rotation(pose).inverse();
                    let step = root_rotation(poses[before]).inverse() * root_rotation(poses[after]);
                    let turn = if after > before { step.to_scaled_axis() / span } else { DVec3::ZERO };
                    let of_root = [root * DVec3::Y, root * velocity, turn].map(|vector| vector.to_array());
                    joint_numbers.chain(of_root.concat()).collect()
                }
            };
            rows.row_mut(frame).iter_mut().zip(numbers).for_each(|(to, from)| *to = from);
        }
        rows
    }
}

fn root_rotation(pose: &[f64]) -> DQuat {
    let rotation = DQuat::from_scaled_axis(DVec3::from_slice(&pose[3..]));
    // The shorter way round, so that steps are small rotations.
    DQuat::from_mat3(&DMat3::from_quat(rotation)).normalize()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::body::fixture;

    #[test]
    fn features_of_a_turning_walk_are_what_was_put_in() {
        let model = fixture::model();
        let skeleton = model.skeleton();
        let rate = 30.0;
        let poses: Vec<Vec<f64>> = (0..20)
            .map(|frame| {
                let time = f64::from(frame) / rate;
                let mut pose = vec![0.0; skeleton.pose_length()];
                pose[2] = 1.5 * time;
                pose[4] = 0.8 * time;
                pose[ROOT_LENGTH] = 2.0 * time;
                pose
            })
            .collect();
        let views: Vec<&[f64]> = poses.iter().map(Vec::as_slice).collect();
        let times: Vec<f64> = (0..20).map(|frame| f64::from(frame) / rate).collect();
        let value = |set: FeatureSet, name: &str| {
            let index = set.features(skeleton).iter().position(|feature| feature.name == name).unwrap();
            set.of_motion(skeleton, &views, &times)[(10, index)]
        };
        let axis = &skeleton.axes()[0].name;
        assert!((value(FeatureSet::Paper2018, "speed") - 1.5).abs() < 1e-9);
        for set in [FeatureSet::Paper2018, FeatureSet::FromPelvis] {
            assert!((value(set, &format!("angle.{axis}")) - 2.0 * 10.0 / rate).abs() < 1e-12);
            assert!((value(set, &format!("rate.{axis}")) - 2.0).abs() < 1e-9);
        }
        assert!((value(FeatureSet::FromPelvis, "up.y") - 1.0).abs() < 1e-12);
        assert!((value(FeatureSet::FromPelvis, "turn.y") - 0.8).abs() < 1e-9);
        let heading: f64 = 0.8 * 10.0 / rate;
        assert!((value(FeatureSet::FromPelvis, "velocity.z") - 1.5 * heading.cos()).abs() < 1e-9);
    }

    #[test]
    fn where_and_which_way_a_person_walks_does_not_matter() {
        let model = fixture::model();
        let skeleton = model.skeleton();
        let poses: Vec<Vec<f64>> = (0..8)
            .map(|frame| {
                let mut pose: Vec<f64> =
                    (0..skeleton.pose_length()).map(|k| 0.2 * (f64::from(frame) + k as f64).sin()).collect();
                pose[..3].iter_mut().for_each(|value| *value *= 2.0);
                pose
            })
            .collect();
        let turn = DQuat::from_rotation_y(1.1);
        let moved: Vec<Vec<f64>> = poses
            .iter()
            .map(|pose| {
                let mut pose = pose.clone();
                let translation = turn * DVec3::from_slice(&pose) + DVec3::new(3.0, 0.0, -1.0);
                let rotation =
                    (turn * DQuat::from_scaled_axis(DVec3::from_slice(&pose[3..]))).to_scaled_axis();
                pose[..3].copy_from_slice(&translation.to_array());
                pose[3..6].copy_from_slice(&rotation.to_array());
                pose
            })
            .collect();
        let times: Vec<f64> = (0..8).map(|frame| 0.04 * f64::from(frame)).collect();
        for set in [FeatureSet::Paper2018, FeatureSet::FromPelvis] {
            let of = |poses: &[Vec<f64>]| {
                set.of_motion(skeleton, &poses.iter().map(Vec::as_slice).collect::<Vec<_>>(), &times)
            };
            assert!((of(&poses) - of(&moved)).amax() < 1e-9);
        }
    }
}
