//! BVH (Biovision hierarchy): a tree of offsets and channels, then one line of channels a frame.

use std::path::Path;

use glam::{DQuat, DVec3};

use super::words::Words;
use super::{CapturedJoint, JointMotion, MotionFileError};
use crate::artifacts::rigged_sequence::FrameRate;

/// More joints than any skeleton has; a file that goes on is not believed.
const MOST_JOINTS: usize = 10_000;

#[derive(Clone, Copy)]
enum Channel {
    Position(DVec3),
    Rotation(DVec3),
}

struct BvhJoint {
    offset: DVec3,
    channels: Vec<Channel>,
}

/// Reads the text of a BVH file; `path` is for messages.
pub fn read_bvh(text: &str, path: &Path, name: &str) -> Result<JointMotion, MotionFileError> {
    let mut words = Words::of(text, path);
    words.expect("HIERARCHY")?;
    let (joints, moving) = hierarchy(&mut words)?;
    words.expect("MOTION")?;
    words.expect("Frames:")?;
    let declared = words.number("the number of frames")?;
    words.expect("Frame")?;
    words.expect("Time:")?;
    let frame_time = words.number("the frame time")?;
    let frame_rate = FrameRate::new(1.0 / frame_time)
        .ok_or_else(|| words.fault(format!("a frame time of {frame_time} s is not possible")))?;
    let channel_count: usize = moving.iter().map(|joint| joint.channels.len()).sum();
    let mut positions = Vec::new();
    let mut values = Vec::with_capacity(channel_count.min(MOST_JOINTS * 6));
    while words.peek().is_some() {
        values.clear();
        for _ in 0..channel_count {
            values.push(words.number("a channel")?);
        }
        positions.push(place(&joints, &moving, &values));
        if channel_count == 0 {
            break;
        }
    }
    if positions.is_empty() {
        return Err(MotionFileError::NoFrames { path: path.to_path_buf() });
    }
    if positions.len() as f64 != declared {
        return Err(words.fault(format!(
            "{declared} frames are declared, {} are there: the file is cut off or its channels are miscounted",
            positions.len()
        )));
    }
    Ok(JointMotion { name: name.into(), joints, frame_rate, positions })
}

fn hierarchy(words: &mut Words<'_>) -> Result<(Vec<CapturedJoint>, Vec<BvhJoint>), MotionFileError> {
    let mut joints: Vec<CapturedJoint> = Vec::new();
    let mut moving: Vec<BvhJoint> = Vec::new();
    let mut open: Vec<usize> = Vec::new();
    loop {
        let word = words.need("a joint or '}'")?;
        let parent = open.last().copied();
        match word.to_ascii_uppercase().as_str() {
            "ROOT" | "JOINT" if joints.len() < MOST_JOINTS => {
                let name = words.need("a joint's name")?.to_string();
                words.expect("{")?;
                joints.push(CapturedJoint { name, parent });
                moving.push(BvhJoint { offset: DVec3::ZERO, channels: Vec::new() });
                open.push(joints.len() - 1);
            }
            "END" if joints.len() < MOST_JOINTS => {
                words.expect("Site")?;
                words.expect("{")?;
                let Some(parent) = parent else {
                    return Err(words.fault("an end site must belong to a joint".into()));
                };
                joints.push(CapturedJoint {
                    name: format!("{}_end", joints[parent].name),
                    parent: Some(parent),
                });
                moving.push(BvhJoint { offset: DVec3::ZERO, channels: Vec::new() });
                open.push(joints.len() - 1);
            }
            "OFFSET" if parent.is_some() => {
                let [x, y, z] = [(); 3].map(|()| words.number("an offset"));
                moving[open[open.len() - 1]].offset = DVec3::new(x?, y?, z?);
            }
            "CHANNELS" if parent.is_some() => {
                let count = words.number("the number of channels")?;
                if !(0.0..=6.0).contains(&count) || count.fract() != 0.0 {
                    return Err(words.fault(format!("{count} channels: a joint has 0 to 6")));
                }
                for _ in 0..count as usize {
                    let channel = channel(words)?;
                    moving[open[open.len() - 1]].channels.push(channel);
                }
            }
            "}" if parent.is_some() => {
                open.pop();
                if open.is_empty() && words.peek().is_some_and(|next| next.eq_ignore_ascii_case("MOTION")) {
                    return Ok((joints, moving));
                }
            }
            _ => return Err(words.fault(format!("'{word}' has no meaning here"))),
        }
    }
}

fn channel(words: &mut Words<'_>) -> Result<Channel, MotionFileError> {
    let word = words.need("a channel's name")?;
    Ok(match word.to_ascii_lowercase().as_str() {
        "xposition" => Channel::Position(DVec3::X),
        "yposition" => Channel::Position(DVec3::Y),
        "zposition" => Channel::Position(DVec3::Z),
        "xrotation" => Channel::Rotation(DVec3::X),
        "yrotation" => Channel::Rotation(DVec3::Y),
        "zrotation" => Channel::Rotation(DVec3::Z),
        _ => return Err(words.fault(format!("'{word}' is no channel (Xposition … Zrotation)"))),
    })
}

/// Positions of all joints. A joint with position channels stands where they say, in place of its offset.
fn place(joints: &[CapturedJoint], moving: &[BvhJoint], values: &[f64]) -> Vec<DVec3> {
    let mut next = values.iter().copied();
    let mut frames: Vec<(DQuat, DVec3)> = Vec::with_capacity(joints.len());
    for (joint, BvhJoint { offset, channels }) in joints.iter().zip(moving) {
        let mut local = *offset;
        if channels.iter().any(|channel| matches!(channel, Channel::Position(_))) {
            local = DVec3::ZERO;
        }
        let mut turn = DQuat::IDENTITY;
        for channel in channels {
            let value = next.next().unwrap_or(0.0);
            match channel {
                Channel::Position(axis) => local += *axis * value,
                Channel::Rotation(axis) => turn *= DQuat::from_axis_angle(*axis, value.to_radians()),
            }
        }
        let (rotation, position) =
            joint.parent.map_or((DQuat::IDENTITY, DVec3::ZERO), |parent| frames[parent]);
        frames.push((rotation * turn, position + rotation * local));
    }
    frames.into_iter().map(|(_, position)| position).collect()
}
