//! AMASS-style `.npz`: rotation vectors of 22 or more body joints, a root translation, a frame rate.
//!
//! Read are `poses` (F, ≥ 66), `trans` (F, 3) and `mocap_framerate` (or `mocap_frame_rate`). The order of the joints is
//! the archive's; the skeleton that they turn is a plain adult of our own, because only directions and the ratio of
//! steps to legs matter afterwards.

use std::path::Path;

use glam::{DQuat, DVec3};

use super::{CapturedJoint, JointMotion, MotionFileError};
use crate::artifacts::npz::NpzReader;
use crate::artifacts::rigged_sequence::FrameRate;

/// Name, parent and offset from it at rest (arms to the sides, y up, facing +z), in metres: round numbers of an adult
/// of 1.70 m.
const JOINTS: [(&str, usize, [f64; 3]); 22] = [
    ("pelvis", 0, [0.0, 0.0, 0.0]),
    ("left_hip", 0, [0.09, -0.08, 0.0]),
    ("right_hip", 0, [-0.09, -0.08, 0.0]),
    ("spine1", 0, [0.0, 0.11, -0.02]),
    ("left_knee", 1, [0.01, -0.40, 0.0]),
    ("right_knee", 2, [-0.01, -0.40, 0.0]),
    ("spine2", 3, [0.0, 0.14, 0.0]),
    ("left_ankle", 4, [0.0, -0.41, -0.02]),
    ("right_ankle", 5, [0.0, -0.41, -0.02]),
    ("spine3", 6, [0.0, 0.06, 0.0]),
    ("left_foot", 7, [0.02, -0.06, 0.13]),
    ("right_foot", 8, [-0.02, -0.06, 0.13]),
    ("neck", 9, [0.0, 0.21, -0.02]),
    ("left_collar", 9, [0.08, 0.11, -0.01]),
    ("right_collar", 9, [-0.08, 0.11, -0.01]),
    ("head", 12, [0.0, 0.08, 0.04]),
    ("left_shoulder", 13, [0.10, 0.04, 0.0]),
    ("right_shoulder", 14, [-0.10, 0.04, 0.0]),
    ("left_elbow", 16, [0.26, 0.0, 0.0]),
    ("right_elbow", 17, [-0.26, 0.0, 0.0]),
    ("left_wrist", 18, [0.25, 0.0, 0.0]),
    ("right_wrist", 19, [-0.25, 0.0, 0.0]),
];
/// Ends of the arms, so that a bent wrist shows.
const ENDS: [(&str, usize, [f64; 3]); 2] =
    [("left_wrist_end", 20, [0.08, 0.0, 0.0]), ("right_wrist_end", 21, [-0.08, 0.0, 0.0])];

/// Reads an archive that is in memory; `path` is for messages.
pub fn read_amass(bytes: Vec<u8>, path: &Path) -> Result<JointMotion, MotionFileError> {
    let mut file = NpzReader::new(bytes, path)?;
    let poses = file.floats("poses")?;
    file.expect_shape("poses", &poses, &[None, None])?;
    let (frame_count, width) = (poses.shape[0], poses.shape[1]);
    if width < JOINTS.len() * 3 {
        let reason = format!("has {width} numbers a frame, needs at least {}", JOINTS.len() * 3);
        return Err(file.invalid("poses", reason).into());
    }
    if frame_count == 0 {
        return Err(MotionFileError::NoFrames { path: path.to_path_buf() });
    }
    let translation = file.floats("trans")?;
    file.expect_shape("trans", &translation, &[Some(frame_count), Some(3)])?;
    let rate_key = if file.contains("mocap_framerate") { "mocap_framerate" } else { "mocap_frame_rate" };
    let rate = file.floats(rate_key)?;
    let frame_rate = match rate.values[..] {
        [rate] => FrameRate::new(rate),
        _ => None,
    };
    let frame_rate =
        frame_rate.ok_or_else(|| file.invalid(rate_key, "must be one positive number".into()))?;
    let joints = JOINTS.iter().chain(&ENDS).enumerate().map(|(index, (name, parent, _))| CapturedJoint {
        name: (*name).into(),
        parent: (index > 0).then_some(*parent),
    });
    let frames = poses.values.chunks_exact(width).zip(translation.values.chunks_exact(3));
    Ok(JointMotion {
        name: path.file_name().unwrap_or_default().to_string_lossy().into_owned(),
        joints: joints.collect(),
        frame_rate,
        positions: frames.map(|(pose, translation)| place(pose, DVec3::from_slice(translation))).collect(),
    })
}

fn place(pose: &[f64], translation: DVec3) -> Vec<DVec3> {
    let mut placed: Vec<(DQuat, DVec3)> = Vec::with_capacity(JOINTS.len() + ENDS.len());
    for (index, (_, parent, offset)) in JOINTS.iter().chain(&ENDS).enumerate() {
        let turn = pose.get(index * 3..index * 3 + 3).filter(|_| index < JOINTS.len());
        let turn = turn.map_or(DQuat::IDENTITY, |r| DQuat::from_scaled_axis(DVec3::from_slice(r)));
        let (rotation, position) = if index == 0 { (DQuat::IDENTITY, translation) } else { placed[*parent] };
        placed.push((rotation * turn, position + rotation * DVec3::from_array(*offset)));
    }
    placed.into_iter().map(|(_, position)| position).collect()
}
