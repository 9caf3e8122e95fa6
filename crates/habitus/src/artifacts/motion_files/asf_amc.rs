//! Acclaim ASF/AMC: a skeleton of bones with their own axes, and a motion that names the bones it turns.
//!
//! A joint carries the name of the bone that starts there. With `C` a bone's `axis` rotation and `R` that of its
//! channels, the bone turns by `C R C⁻¹` against its parent.

use std::collections::BTreeMap;
use std::path::Path;

use glam::{DQuat, DVec3};

use super::words::Words;
use super::{CapturedJoint, JointMotion, MotionFileError};
use crate::artifacts::rigged_sequence::FrameRate;

#[derive(Clone, Copy, Debug, PartialEq)]
enum Freedom {
    Translation(DVec3),
    Rotation(DVec3),
    Length,
}

struct AsfBone {
    name: String,
    parent: usize,
    /// From its start to its end, rest space.
    extent: DVec3,
    axis: DQuat,
    freedoms: Vec<Freedom>,
}

struct AsfSkeleton {
    /// Parents first; bone 0 is the root.
    bones: Vec<AsfBone>,
    radians_per_angle: f64,
    root_position: DVec3,
}

/// Reads the texts of a skeleton and of a motion; paths are for messages.
pub fn read_asf_amc(
    skeleton: &str,
    skeleton_path: &Path,
    motion: &str,
    motion_path: &Path,
    frames_per_second: f64,
) -> Result<JointMotion, MotionFileError> {
    let skeleton = read_skeleton(skeleton, skeleton_path)?;
    let joints = skeleton.joints();
    let place_of: BTreeMap<&str, usize> =
        skeleton.bones.iter().enumerate().map(|(index, bone)| (bone.name.as_str(), index)).collect();
    let mut words = Words::of(motion, motion_path);
    while words.peek().is_some_and(|word| word.starts_with(':')) {
        let line = words.line_of_next();
        while words.peek().is_some() && words.line_of_next() == line {
            words.next();
        }
    }
    let mut positions = Vec::new();
    while words.peek().is_some() {
        words.number("a frame's number")?;
        let mut values: Vec<Vec<f64>> =
            skeleton.bones.iter().map(|bone| vec![0.0; bone.freedoms.len()]).collect();
        while let Some(word) = words.peek().filter(|word| word.parse::<f64>().is_err()) {
            words.next();
            let Some(bone) = place_of.get(word) else {
                return Err(words.fault(format!("bone '{word}' is not in {}", skeleton_path.display())));
            };
            for value in &mut values[*bone] {
                *value = words.number("a bone's channel")?;
            }
        }
        positions.push(skeleton.place(&values));
    }
    if positions.is_empty() {
        return Err(MotionFileError::NoFrames { path: motion_path.to_path_buf() });
    }
    let frame_rate = FrameRate::new(frames_per_second)
        .ok_or_else(|| words.fault(format!("{frames_per_second} frames a second are not possible")))?;
    let name = motion_path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    Ok(JointMotion { name, joints, frame_rate, positions })
}

impl AsfSkeleton {
    /// One joint at each bone's start, then one at the end of each last bone.
    fn joints(&self) -> Vec<CapturedJoint> {
        let parents = |index: usize| (index > 0).then(|| self.bones[index].parent);
        let starts = self.bones.iter().enumerate();
        let starts =
            starts.map(|(index, bone)| CapturedJoint { name: bone.name.clone(), parent: parents(index) });
        let ends = self.last_bones().into_iter().map(|index| CapturedJoint {
            name: format!("{}_end", self.bones[index].name),
            parent: Some(index),
        });
        starts.chain(ends).collect()
    }

    fn last_bones(&self) -> Vec<usize> {
        let is_last = |index: &usize| !self.bones.iter().skip(1).any(|bone| bone.parent == *index);
        (1..self.bones.len()).filter(is_last).collect()
    }

    fn place(&self, values: &[Vec<f64>]) -> Vec<DVec3> {
        let mut turns: Vec<DQuat> = Vec::with_capacity(self.bones.len());
        let mut starts: Vec<DVec3> = Vec::with_capacity(self.bones.len());
        let mut ends: Vec<DVec3> = Vec::with_capacity(self.bones.len());
        for (index, (bone, values)) in self.bones.iter().zip(values).enumerate() {
            let mut moved = DVec3::ZERO;
            let mut channels = DQuat::IDENTITY;
            for (freedom, value) in bone.freedoms.iter().zip(values) {
                match freedom {
                    Freedom::Translation(direction) => moved += *direction * *value,
                    // Acclaim turns about fixed axes, first named first applied.
                    Freedom::Rotation(axis) => {
                        channels = DQuat::from_axis_angle(*axis, value * self.radians_per_angle) * channels;
                    }
                    Freedom::Length => {}
                }
            }
            let local = bone.axis * channels * bone.axis.inverse();
            let (parent_turn, start) = if index == 0 {
                (DQuat::IDENTITY, self.root_position + moved)
            } else {
                (turns[bone.parent], ends[bone.parent])
            };
            let turn = parent_turn * local;
            turns.push(turn);
            starts.push(start);
            ends.push(start + turn * bone.extent);
        }
        let last = self.last_bones().into_iter().map(|index| ends[index]);
        starts.iter().copied().chain(last).collect()
    }
}

/// What a skeleton file says, before it is put in order.
struct Draft {
    root: AsfBone,
    bones: Vec<AsfBone>,
    parents: Vec<(String, String)>,
    radians_per_angle: f64,
    root_position: DVec3,
}

fn read_skeleton(text: &str, path: &Path) -> Result<AsfSkeleton, MotionFileError> {
    let mut words = Words::of(text, path);
    let root = AsfBone {
        name: "root".into(),
        parent: 0,
        extent: DVec3::ZERO,
        axis: DQuat::IDENTITY,
        freedoms: Vec::new(),
    };
    let mut draft = Draft {
        root,
        bones: Vec::new(),
        parents: Vec::new(),
        radians_per_angle: std::f64::consts::PI / 180.0,
        root_position: DVec3::ZERO,
    };
    while let Some(word) = words.next() {
        match word {
            ":units" => draft.read_units(&mut words)?,
            ":root" => draft.read_root(&mut words)?,
            ":bonedata" => draft.read_bones(&mut words)?,
            ":hierarchy" => draft.read_hierarchy(&mut words)?,
            // Version, name, documentation, skin and what else there may be: not needed.
            _ => {}
        }
    }
    draft.in_order(&words)
}

impl Draft {
    fn read_units(&mut self, words: &mut Words<'_>) -> Result<(), MotionFileError> {
        while words.peek().is_some_and(|word| !word.starts_with(':')) {
            let key = words.need("a unit")?;
            let value = words.need("a unit's value")?;
            if key == "angle" {
                self.radians_per_angle =
                    if value.starts_with("deg") { std::f64::consts::PI / 180.0 } else { 1.0 };
            }
        }
        Ok(())
    }

    fn read_root(&mut self, words: &mut Words<'_>) -> Result<(), MotionFileError> {
        let mut angles = DVec3::ZERO;
        let mut axis_order = "XYZ";
        while words.peek().is_some_and(|word| !word.starts_with(':')) {
            match words.need("a property of the root")? {
                "order" => {
                    while let Some(freedom) = words.peek().and_then(freedom) {
                        words.next();
                        self.root.freedoms.push(freedom);
                    }
                }
                "axis" => axis_order = words.need("an order of axes")?,
                "position" => self.root_position = vector(words, "the root's position")?,
                "orientation" => angles = vector(words, "the root's orientation")?,
                other => return Err(words.fault(format!("'{other}' is no property of the root"))),
            }
        }
        self.root.axis = turn(angles * self.radians_per_angle, axis_order, words)?;
        Ok(())
    }

    fn read_bones(&mut self, words: &mut Words<'_>) -> Result<(), MotionFileError> {
        while words.peek() == Some("begin") {
            words.next();
            let mut bone = AsfBone {
                name: String::new(),
                parent: 0,
                extent: DVec3::ZERO,
                axis: DQuat::IDENTITY,
                freedoms: Vec::new(),
            };
            let (mut direction, mut length) = (DVec3::ZERO, 0.0);
            loop {
                match words.need("a bone's property or 'end'")? {
                    "end" => break,
                    "name" => bone.name = words.need("a bone's name")?.into(),
                    "direction" => direction = vector(words, "a bone's direction")?,
                    "length" => length = words.number("a bone's length")?,
                    "axis" => {
                        let angles = vector(words, "a bone's axis")? * self.radians_per_angle;
                        let order = words.need("an order of axes")?;
                        bone.axis = turn(angles, order, words)?;
                    }
                    "dof" => {
                        while let Some(freedom) = words.peek().and_then(freedom) {
                            words.next();
                            bone.freedoms.push(freedom);
                        }
                    }
                    // Identifiers, limits, masses.
                    _ => {}
                }
            }
            bone.extent = direction.normalize_or_zero() * length;
            self.bones.push(bone);
        }
        Ok(())
    }

    fn read_hierarchy(&mut self, words: &mut Words<'_>) -> Result<(), MotionFileError> {
        words.expect("begin")?;
        loop {
            let parent = words.need("a bone or 'end'")?;
            if parent == "end" {
                return Ok(());
            }
            let line = words.line_of_next();
            while words.peek().is_some_and(|word| word != "end") && words.line_of_next() == line {
                let child = words.need("a child")?;
                self.parents.push((parent.into(), child.into()));
            }
        }
    }

    /// Sorts the bones, parents first.
    fn in_order(self, words: &Words<'_>) -> Result<AsfSkeleton, MotionFileError> {
        let mut waiting: BTreeMap<String, AsfBone> =
            self.bones.into_iter().map(|bone| (bone.name.clone(), bone)).collect();
        let mut bones = vec![self.root];
        let mut place_of = BTreeMap::from([("root".to_string(), 0)]);
        // Each round places all children of placed parents; a line that waits for ever names an unknown parent.
        let mut lines = self.parents;
        loop {
            let before = lines.len();
            let mut left = Vec::new();
            for (parent, child) in lines {
                let Some(&place) = place_of.get(&parent) else {
                    left.push((parent, child));
                    continue;
                };
                let Some(mut bone) = waiting.remove(&child) else {
                    return Err(words.fault(format!("'{child}' is no bone, or has two parents")));
                };
                bone.parent = place;
                place_of.insert(child, bones.len());
                bones.push(bone);
            }
            if left.is_empty() {
                break;
            }
            if left.len() == before {
                return Err(words.fault(format!("'{}' does not hang from the root", left[0].0)));
            }
            lines = left;
        }
        if bones.len() < 2 {
            return Err(words.fault("there is no hierarchy of bones".into()));
        }
        Ok(AsfSkeleton {
            bones,
            radians_per_angle: self.radians_per_angle,
            root_position: self.root_position,
        })
    }
}

fn vector(words: &mut Words<'_>, what: &str) -> Result<DVec3, MotionFileError> {
    Ok(DVec3::new(words.number(what)?, words.number(what)?, words.number(what)?))
}

fn freedom(word: &str) -> Option<Freedom> {
    Some(match word.to_ascii_lowercase().as_str() {
        "tx" => Freedom::Translation(DVec3::X),
        "ty" => Freedom::Translation(DVec3::Y),
        "tz" => Freedom::Translation(DVec3::Z),
        "rx" => Freedom::Rotation(DVec3::X),
        "ry" => Freedom::Rotation(DVec3::Y),
        "rz" => Freedom::Rotation(DVec3::Z),
        "l" => Freedom::Length,
        _ => return None,
    })
}

/// The rotation of three angles about fixed axes, first named first applied.
fn turn(angles: DVec3, order: &str, words: &Words<'_>) -> Result<DQuat, MotionFileError> {
    let mut turn = DQuat::IDENTITY;
    for (letter, angle) in order.chars().zip(angles.to_array()) {
        let axis = match letter.to_ascii_uppercase() {
            'X' => DVec3::X,
            'Y' => DVec3::Y,
            'Z' => DVec3::Z,
            _ => return Err(words.fault(format!("'{order}' is no order of axes such as XYZ"))),
        };
        turn = DQuat::from_axis_angle(axis, angle) * turn;
    }
    Ok(turn)
}
