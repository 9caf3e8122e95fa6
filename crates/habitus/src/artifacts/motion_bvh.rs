//! The motion as BVH (Biovision hierarchy): 15 joints, offsets from the rest body, Euler angles in degrees.
//!
//! Lengths are centimetres, y up, as most readers of this format assume. Only the motion is kept; the skin is in
//! `body.glb`.

use std::fmt::Write;
use std::path::Path;

use glam::{DMat3, DVec3, EulerRot};

use super::rigged_sequence::{FrameRate, RiggedSequence};
use super::write_atomically;

const CENTIMETRES_PER_METRE: f64 = 100.0;

/// Writes the motion; frame times follow from the frame rate.
pub fn write_bvh(path: &Path, fit: &RiggedSequence, frame_rate: FrameRate) -> std::io::Result<()> {
    write_atomically(path, bvh_text(fit, frame_rate).as_bytes())
}

/// The text of [`write_bvh`]'s file.
pub fn bvh_text(fit: &RiggedSequence, frame_rate: FrameRate) -> String {
    let mut text = String::from("HIERARCHY\n");
    let mut order = Vec::new();
    add_joint(&mut text, fit, 0, 0, &mut order);
    let frame_count = fit.sequence.frames.len();
    // Writing to a String cannot fail.
    let _ = write!(text, "MOTION\nFrames: {frame_count}\nFrame Time: {:.8}\n", frame_rate.time_of(1));
    for frame in 0..frame_count {
        add_frame(&mut text, fit, frame, &order);
    }
    text
}

fn add_joint(text: &mut String, fit: &RiggedSequence, bone: usize, depth: usize, order: &mut Vec<usize>) {
    order.push(bone);
    let bones = fit.rig.skeleton.bones();
    let joints = &fit.sequence.rest_joints;
    let indent = "  ".repeat(depth);
    let (kind, offset, channels) = match bones[bone].parent {
        // The root's place is all in its channels, so that readers which add offset and channel agree with others.
        None => ("ROOT", DVec3::ZERO, "6 Xposition Yposition Zposition Zrotation Xrotation Yrotation"),
        Some(parent) => ("JOINT", joints[bone] - joints[parent], "3 Zrotation Xrotation Yrotation"),
    };
    let _ = write!(
        text,
        "{indent}{kind} {}\n{indent}{{\n{indent}  OFFSET {}\n{indent}  CHANNELS {channels}\n",
        bones[bone].name,
        numbers(offset * CENTIMETRES_PER_METRE)
    );
    let children: Vec<usize> = (0..bones.len()).filter(|child| bones[*child].parent == Some(bone)).collect();
    if children.is_empty() {
        let end = middle_of_bone(fit, bone) - joints[bone];
        let _ = write!(
            text,
            "{indent}  End Site\n{indent}  {{\n{indent}    OFFSET {}\n{indent}  }}\n",
            numbers(end * CENTIMETRES_PER_METRE)
        );
    }
    for child in children {
        add_joint(text, fit, child, depth + 1, order);
    }
    let _ = writeln!(text, "{indent}}}");
}

/// Mean of a bone's vertices by weight: where the line of a last bone ends.
fn middle_of_bone(fit: &RiggedSequence, bone: usize) -> DVec3 {
    let (mut sum, mut total) = (DVec3::ZERO, 0.0);
    for (vertex, position) in fit.sequence.rest_vertices.iter().enumerate() {
        for (_, weight) in fit.rig.skin.of(vertex).filter(|(owner, _)| *owner == bone) {
            sum += *position * weight;
            total += weight;
        }
    }
    if total > 0.0 { sum / total } else { fit.sequence.rest_joints[bone] }
}

fn add_frame(text: &mut String, fit: &RiggedSequence, frame: usize, order: &[usize]) {
    let bones = fit.rig.skeleton.bones();
    let posed = fit.posed_skeleton(frame);
    text.push_str(&numbers(posed.joints[0] * CENTIMETRES_PER_METRE));
    for bone in order {
        let global = posed.rotations[*bone];
        let local = bones[*bone].parent.map_or(global, |parent| posed.rotations[parent].transpose() * global);
        text.push(' ');
        text.push_str(&numbers(euler_degrees(local)));
    }
    text.push('\n');
}

/// Angles of `R = Rz · Rx · Ry`, in the order of the channels.
fn euler_degrees(rotation: DMat3) -> DVec3 {
    let (z, x, y) = rotation.to_euler(EulerRot::ZXY);
    DVec3::new(z, x, y) * (180.0 / std::f64::consts::PI)
}

fn numbers(vector: DVec3) -> String {
    format!("{:.6} {:.6} {:.6}", vector.x, vector.y, vector.z)
}

#[cfg(test)]
mod tests {
    use glam::{DMat3, DVec3};

    use super::bvh_text;
    use crate::artifacts::fixture::rigged_sequence;
    use crate::artifacts::rigged_sequence::FrameRate;

    /// A BVH reader: offsets, parents and channels in the order of the file, then positions of all joints.
    fn joints_of_frame(text: &str, frame: usize) -> Vec<(String, DVec3)> {
        let (hierarchy, motion) = text.split_once("MOTION\n").unwrap();
        let mut joints: Vec<(String, DVec3, Option<usize>)> = Vec::new();
        let mut open: Vec<Option<usize>> = Vec::new();
        for line in hierarchy.lines() {
            let mut words = line.split_whitespace();
            match words.next() {
                Some("ROOT" | "JOINT") => {
                    let parent = open.iter().rev().find_map(|joint| *joint);
                    joints.push((words.next().unwrap().into(), DVec3::ZERO, parent));
                    open.push(Some(joints.len() - 1));
                }
                Some("End") => open.push(None),
                Some("OFFSET") => {
                    let numbers: Vec<f64> = words.map(|word| word.parse().unwrap()).collect();
                    if let Some(Some(joint)) = open.last() {
                        joints[*joint].1 = DVec3::from_slice(&numbers);
                    }
                }
                Some("}") => drop(open.pop()),
                _ => {}
            }
        }
        let line = motion.lines().nth(2 + frame).unwrap();
        let values: Vec<f64> = line.split_whitespace().map(|word| word.parse().unwrap()).collect();
        assert_eq!(values.len(), 3 + 3 * joints.len());
        let mut placed: Vec<(DMat3, DVec3)> = Vec::new();
        for (index, (_, offset, parent)) in joints.iter().enumerate() {
            let angles = &values[3 + 3 * index..];
            let turn = DMat3::from_rotation_z(angles[0].to_radians())
                * DMat3::from_rotation_x(angles[1].to_radians())
                * DMat3::from_rotation_y(angles[2].to_radians());
            placed.push(match parent {
                None => (turn, *offset + DVec3::from_slice(&values)),
                Some(parent) => {
                    let (rotation, position) = placed[*parent];
                    (rotation * turn, position + rotation * *offset)
                }
            });
        }
        joints.into_iter().zip(placed).map(|((name, ..), (_, position))| (name, position)).collect()
    }

    #[test]
    fn a_reader_finds_our_joints_at_every_frame() {
        let fit = rigged_sequence(12);
        let text = bvh_text(&fit, FrameRate::new(30.0).unwrap());
        assert!(text.contains("Frames: 12\nFrame Time: 0.03333333\n"));
        assert_eq!(text.matches("End Site").count(), 5, "head, hands and feet");
        for frame in 0..12 {
            let posed = fit.posed_skeleton(frame);
            let joints = joints_of_frame(&text, frame);
            assert_eq!(joints.len(), 15);
            for (name, position) in joints {
                let bone = fit.rig.skeleton.bones().iter().position(|bone| bone.name == name).unwrap();
                // Six decimals of centimetres and degrees.
                assert!(position.distance(posed.joints[bone] * 100.0) < 1e-4, "{name} in frame {frame}");
            }
        }
    }
}
