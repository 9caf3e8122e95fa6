//! A motion of our own skeleton: a pose for each moment, at a constant rate.
//!
//! Keys of its `.npz`: `metadata` (UTF-8 JSON: format, version, name, bones), `pose` (F, P) in metres and radians with
//! y up, and `frames_per_second` (1).

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::npz::{NpzError, NpzReader, NpzWriter};
use super::rigged_sequence::{FrameRate, RiggedSequence};
use crate::body::{Pose, Skeleton};

const FORMAT: &str = "habitus-motion";
const VERSION: u32 = 1;

/// Why a motion clip cannot be read.
#[derive(Debug, Error)]
pub enum MotionClipError {
    /// The file cannot be read at all.
    #[error("{}: the motion cannot be read ({source})", path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// An array is missing or broken.
    #[error(transparent)]
    Npz(#[from] NpzError),
    /// It is some other file, of a newer version, or contradicts itself.
    #[error("{}: {reason}", path.display())]
    Unusable {
        /// The file.
        path: PathBuf,
        /// What is wrong, and what to do.
        reason: String,
    },
}

/// Poses at a constant rate, in metres and radians, y up, the floor at y = 0.
#[derive(Clone, Debug, PartialEq)]
pub struct MotionClip {
    /// Where it comes from, for messages.
    pub name: String,
    /// Poses a second.
    pub frame_rate: FrameRate,
    /// One pose for each moment.
    pub poses: Vec<Pose>,
}

#[derive(Serialize, Deserialize)]
struct Metadata {
    format: String,
    version: u32,
    name: String,
    bones: Vec<String>,
}

impl MotionClip {
    /// The motion of a fitted sequence.
    pub fn of_fit(fit: &RiggedSequence, frame_rate: FrameRate, name: &str) -> Self {
        let skeleton = &fit.rig.skeleton;
        let poses = fit.sequence.frames.iter().filter_map(|frame| Pose::new(skeleton, frame.pose.clone()));
        Self { name: name.into(), frame_rate, poses: poses.collect() }
    }

    /// Seconds from the first pose to the last.
    pub fn duration(&self) -> f64 {
        self.frame_rate.time_of(self.poses.len().saturating_sub(1))
    }

    /// The pose at a time, seconds; before the first and after the last pose it stands still. A clip without poses
    /// has none.
    pub fn pose_at(&self, time: f64) -> Option<Pose> {
        let last = self.poses.len().checked_sub(1)?;
        let place = (time * self.frame_rate.frames_per_second()).clamp(0.0, last as f64);
        let before = (place.floor() as usize).min(last);
        let after = (before + 1).min(last);
        Some(self.poses[before].towards(&self.poses[after], place - before as f64))
    }

    /// The same motion at another rate; its last pose is the last whole step before the end.
    #[must_use]
    pub fn resampled(&self, frame_rate: FrameRate) -> Self {
        // The tolerance keeps the last pose where rates are the same up to rounding.
        let steps = (self.duration() * frame_rate.frames_per_second() + 1e-6).floor() as usize;
        let poses = (0..=steps).filter_map(|step| self.pose_at(frame_rate.time_of(step)));
        Self { name: self.name.clone(), frame_rate, poses: poses.collect() }
    }

    /// Writes the clip; `skeleton` names its bones.
    pub fn write(&self, path: &Path, skeleton: &Skeleton) -> Result<(), MotionClipError> {
        let metadata = Metadata {
            format: FORMAT.into(),
            version: VERSION,
            name: self.name.clone(),
            bones: skeleton.bones().iter().map(|bone| bone.name.clone()).collect(),
        };
        let values: Vec<f64> = self.poses.iter().flat_map(|pose| pose.parameters()).copied().collect();
        let mut file = NpzWriter::new();
        file.add_text("metadata", &serde_json::to_string(&metadata).unwrap_or_default());
        file.add("pose", &[self.poses.len(), skeleton.pose_length()], &values);
        file.add("frames_per_second", &[1], &[self.frame_rate.frames_per_second()]);
        Ok(file.write(path)?)
    }

    /// Reads a clip that was made for this skeleton.
    pub fn read(path: &Path, skeleton: &Skeleton) -> Result<Self, MotionClipError> {
        let bytes = std::fs::read(path)
            .map_err(|source| MotionClipError::Unreadable { path: path.to_path_buf(), source })?;
        let unusable = |reason: String| MotionClipError::Unusable { path: path.to_path_buf(), reason };
        let mut file = NpzReader::new(bytes, path)?;
        let metadata: Metadata = serde_json::from_str(&file.text("metadata")?)
            .map_err(|error| unusable(format!("its metadata are not those of a motion ({error})")))?;
        if metadata.format != FORMAT {
            return Err(unusable(format!("is no motion (its metadata say '{}')", metadata.format)));
        }
        if metadata.version > VERSION {
            return Err(unusable(format!(
                "has format version {}, this program reads up to {VERSION}; update habitus",
                metadata.version
            )));
        }
        if !metadata.bones.iter().eq(skeleton.bones().iter().map(|bone| &bone.name)) {
            return Err(unusable("belongs to another skeleton; name the body model it was made for".into()));
        }
        let pose = file.floats("pose")?;
        file.expect_shape("pose", &pose, &[None, Some(skeleton.pose_length())])?;
        let rate = file.floats("frames_per_second")?;
        file.expect_shape("frames_per_second", &rate, &[Some(1)])?;
        let frame_rate = FrameRate::new(rate.values[0])
            .ok_or_else(|| unusable(format!("has {} frames a second", rate.values[0])))?;
        let poses = pose.values.chunks_exact(skeleton.pose_length());
        let poses = poses.filter_map(|values| Pose::new(skeleton, values.to_vec())).collect();
        Ok(Self { name: metadata.name, frame_rate, poses })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::artifacts::fixture::rigged_sequence;

    fn clip() -> (MotionClip, Skeleton) {
        let fit = rigged_sequence(9);
        (MotionClip::of_fit(&fit, FrameRate::new(30.0).unwrap(), "take 1"), fit.rig.skeleton)
    }

    #[test]
    fn a_clip_survives_its_file() {
        let (clip, skeleton) = clip();
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("motion.npz");
        clip.write(&path, &skeleton).unwrap();
        assert_eq!(MotionClip::read(&path, &skeleton).unwrap(), clip);
        let fewer_bones = Skeleton::new(skeleton.bones()[..1].to_vec(), Vec::new()).unwrap();
        let message = MotionClip::read(&path, &fewer_bones).unwrap_err().to_string();
        assert!(message.contains("another skeleton"), "{message}");
    }

    #[test]
    fn resampling_keeps_the_poses_that_both_rates_share() {
        let (clip, _) = clip();
        let fine = clip.resampled(FrameRate::new(60.0).unwrap());
        assert_eq!(fine.poses.len(), 17);
        for (index, pose) in clip.poses.iter().enumerate() {
            for (a, b) in pose.parameters().iter().zip(fine.poses[2 * index].parameters()) {
                assert!((a - b).abs() < 1e-9, "frame {index}");
            }
        }
        let half = fine.poses[1].root_rotation();
        let whole = clip.poses[0].root_rotation().slerp(clip.poses[1].root_rotation(), 0.5);
        assert!(half.angle_between(whole) < 1e-6);
    }
}
