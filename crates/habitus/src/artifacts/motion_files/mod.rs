//! Motion capture files of others: BVH, Acclaim ASF/AMC, and AMASS-style `.npz`.
//!
//! All three become a [`JointMotion`]: named joints and where they are in each frame, in the file's own unit and axes.
//! Rotations stop here: zero means another posture in each convention (in some files none at all), positions do not.
//! `fitting::retarget` turns a joint motion into poses of our skeleton.

mod amass;
mod asf_amc;
mod bvh;
mod words;

use std::path::{Path, PathBuf};

use glam::DVec3;
use thiserror::Error;

use super::npz::NpzError;
use super::rigged_sequence::FrameRate;

pub use amass::read_amass;
pub use asf_amc::read_asf_amc;
pub use bvh::read_bvh;

/// Frames a second of AMC files, which do not say: the CMU library's rate.
const AMC_FRAMES_PER_SECOND: f64 = 120.0;

/// Why a motion file cannot be read.
#[derive(Debug, Error)]
pub enum MotionFileError {
    /// The file cannot be read at all.
    #[error("{}: the motion cannot be read ({source})", path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// Nobody knows the format.
    #[error("{}: is no motion file that is known; give .bvh, .amc (with its .asf) or an AMASS .npz", path.display())]
    UnknownFormat {
        /// The file.
        path: PathBuf,
    },
    /// An AMC file is of no use without its skeleton.
    #[error(
        "{}: the .asf that describes its skeleton is not beside it; copy it there as {expected}",
        path.display()
    )]
    SkeletonMissing {
        /// The AMC file.
        path: PathBuf,
        /// Name of the skeleton's file.
        expected: String,
    },
    /// A line does not say what it must.
    #[error("{}, line {line}: {reason}", path.display())]
    Malformed {
        /// The file.
        path: PathBuf,
        /// Line, from one.
        line: usize,
        /// What is wrong.
        reason: String,
    },
    /// An array of an archive is missing or broken.
    #[error(transparent)]
    Npz(#[from] NpzError),
    /// There is nothing to move.
    #[error("{}: holds no frame of motion", path.display())]
    NoFrames {
        /// The file.
        path: PathBuf,
    },
}

/// A joint of the captured person.
#[derive(Clone, Debug, PartialEq)]
pub struct CapturedJoint {
    /// Its name in the file; the end of a chain is `<name>_end`.
    pub name: String,
    /// Index of its parent, which comes before it.
    pub parent: Option<usize>,
}

/// Where the joints of a captured person are, in the file's unit and axes.
#[derive(Clone, Debug, PartialEq)]
pub struct JointMotion {
    /// Where it comes from, for messages.
    pub name: String,
    /// Joints, parents first.
    pub joints: Vec<CapturedJoint>,
    /// Frames a second.
    pub frame_rate: FrameRate,
    /// One position a joint, for each frame.
    pub positions: Vec<Vec<DVec3>>,
}

impl JointMotion {
    /// The same motion at another rate, positions interpolated.
    #[must_use]
    pub fn resampled(&self, frame_rate: FrameRate) -> Self {
        let Some(last) = self.positions.len().checked_sub(1) else { return self.clone() };
        let scale = self.frame_rate.frames_per_second() / frame_rate.frames_per_second();
        let steps = (last as f64 / scale + 1e-6).floor() as usize;
        let positions = (0..=steps)
            .map(|step| {
                let place = (step as f64 * scale).min(last as f64);
                let before = place.floor() as usize;
                let after = (before + 1).min(last);
                let share = place - before as f64;
                let pairs = self.positions[before].iter().zip(&self.positions[after]);
                pairs.map(|(before, after)| before.lerp(*after, share)).collect()
            })
            .collect();
        Self { name: self.name.clone(), joints: self.joints.clone(), frame_rate, positions }
    }
}

/// Reads a motion file by its extension; the skeleton of an `.amc` is the `.asf` beside it with the same name up to
/// the last underscore (`02_01.amc`: `02.asf`).
pub fn read_joint_motion(path: &Path) -> Result<JointMotion, MotionFileError> {
    let extension = path.extension().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
    let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    match extension.as_str() {
        "bvh" => read_bvh(&text_of(path)?, path, &name),
        "amc" => {
            let skeleton = skeleton_beside(path)?;
            read_asf_amc(&text_of(&skeleton)?, &skeleton, &text_of(path)?, path, AMC_FRAMES_PER_SECOND)
        }
        "npz" => read_amass(bytes_of(path)?, path),
        _ => Err(MotionFileError::UnknownFormat { path: path.to_path_buf() }),
    }
}

fn skeleton_beside(path: &Path) -> Result<PathBuf, MotionFileError> {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let subject = stem.rsplit_once('_').map_or(stem.as_str(), |(subject, _)| subject);
    let candidates = [path.with_extension("asf"), path.with_file_name(format!("{subject}.asf"))];
    candidates.into_iter().find(|candidate| candidate.is_file()).ok_or_else(|| {
        MotionFileError::SkeletonMissing { path: path.to_path_buf(), expected: format!("{subject}.asf") }
    })
}

fn bytes_of(path: &Path) -> Result<Vec<u8>, MotionFileError> {
    std::fs::read(path).map_err(|source| MotionFileError::Unreadable { path: path.to_path_buf(), source })
}

/// The text of a file; bytes that are no UTF-8 (comments in old code pages) are replaced.
fn text_of(path: &Path) -> Result<String, MotionFileError> {
    Ok(String::from_utf8_lossy(&bytes_of(path)?).into_owned())
}

#[cfg(test)]
mod tests;
