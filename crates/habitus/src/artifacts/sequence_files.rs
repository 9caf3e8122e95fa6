//! Files of a fitted sequence in the input's own frame and unit: `fit.npz` and `landmarks.csv`.
//!
//! A plain reader needs no body model: skinning the stored rest vertices with the stored poses gives the body in
//! the input's coordinates. Rest vertices keep the model's axes (y up), only their unit is the input's. Where a frame's
//! capture has another scale than the sequence (`capture_scale` is not 1), the arrays keep the sequence's scale, and
//! the frame's own file is that factor larger.

pub(super) mod records;
#[cfg(test)]
mod tests;

use std::path::{Path, PathBuf};

use glam::{DMat3, DVec3};
use nalgebra::DMatrix;
use thiserror::Error;

use super::csv::CsvText;
use super::fitted_sequence::{FittedFrame, FittedSequence, InputFrame, Landmark};
use super::npz::{NpzError, NpzReader, NpzWriter};
use super::rig_file::{add_rig, flat, read_rig};
use super::rigged_sequence::{
    Rig, RiggedSequence, pose_in_input_frame, pose_in_internal_frame, unwind_root_rotations,
};
use super::write_atomically;
use crate::body::ModelFileError;
use records::{FileHeader, FitMetadata};

const FORMAT: &str = "habitus-fit";
const VERSION: u32 = 1;
/// Written rotations are right to rounding; more means that somebody edited the file.
const ROTATION_TOLERANCE: f64 = 1e-6;

/// Why a fit cannot be written or read.
#[derive(Debug, Error)]
pub enum FitFileError {
    /// The file cannot be read at all.
    #[error("{}: the fit cannot be read ({source})", path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// The file cannot be written.
    #[error("{}: cannot be written ({source})", path.display())]
    Unwritable {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// An array is missing or broken.
    #[error(transparent)]
    Npz(#[from] NpzError),
    /// Skin or skeleton is broken.
    #[error(transparent)]
    Rig(#[from] ModelFileError),
    /// It is some other file.
    #[error("{}: is not a habitus fit (its metadata says '{found}')", path.display())]
    Foreign {
        /// The file.
        path: PathBuf,
        /// The format that it names.
        found: String,
    },
    /// It was written by a newer version.
    #[error("{}: has format version {found}, this program reads up to {VERSION}; update habitus", path.display())]
    Newer {
        /// The file.
        path: PathBuf,
        /// Its version.
        found: u32,
    },
    /// Its parts contradict one another, or a number is not finite.
    #[error("{}: {reason}", path.display())]
    Inconsistent {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
}

/// Writes `fit.npz`.
pub fn write_fit(path: &Path, fit: &RiggedSequence) -> Result<(), FitFileError> {
    let (sequence, rig) = (&fit.sequence, &fit.rig);
    check_before_writing(fit)
        .map_err(|reason| FitFileError::Inconsistent { path: path.to_path_buf(), reason })?;
    let unit = sequence.input_frame.metres_per_unit;
    let (frame_count, bone_count) = (sequence.frames.len(), rig.skeleton.bones().len());
    let mut file = NpzWriter::new();
    let header = FileHeader {
        format: FORMAT.into(),
        version: VERSION,
        contents: serde_json::to_value(FitMetadata::of(fit)).unwrap_or_default(),
    };
    file.add_text("metadata", &serde_json::to_string(&header).unwrap_or_default());

    let component_count = sequence.identity.len();
    file.add("identity", &[component_count], &sequence.identity);
    let covariance = &sequence.identity_covariance;
    let uncertainty: Vec<f64> =
        covariance.diagonal().iter().map(|variance| variance.max(0.0).sqrt()).collect();
    file.add("identity_uncertainty", &[component_count], &uncertainty);
    file.add("identity_covariance", &[component_count, component_count], covariance.as_slice());

    let mut poses: Vec<Vec<f64>> = sequence
        .frames
        .iter()
        .map(|frame| pose_in_input_frame(&sequence.input_frame, sequence.rest_joints[0], &frame.pose))
        .collect();
    unwind_root_rotations(&mut poses);
    file.add("pose", &[frame_count, rig.skeleton.pose_length()], &poses.concat());
    let ok: Vec<u8> = sequence.frames.iter().map(|frame| u8::from(frame.is_ok())).collect();
    file.add("frame_ok", &[frame_count], &ok);
    let scales: Vec<f64> = sequence.frames.iter().map(|frame| frame.capture_scale).collect();
    file.add("capture_scale", &[frame_count], &scales);

    let in_unit = |points: &[DVec3]| flat(points.iter().map(|point| *point / unit));
    file.add("rest_vertices", &[sequence.rest_vertices.len(), 3], &in_unit(&sequence.rest_vertices));
    file.add("rest_joints", &[bone_count, 3], &in_unit(&sequence.rest_joints));
    let clearance: Vec<f64> = sequence.smallest_clearance.iter().map(|metres| metres / unit).collect();
    file.add("smallest_clearance", &[clearance.len()], &clearance);

    let input_points =
        |points: Vec<DVec3>| flat(points.iter().map(|point| sequence.input_frame.to_input(*point)));
    let joints: Vec<f64> =
        (0..frame_count).flat_map(|frame| input_points(fit.posed_skeleton(frame).joints)).collect();
    file.add("joints", &[frame_count, bone_count, 3], &joints);
    let landmarks = sequence.frames.iter().flat_map(|frame| &frame.landmarks);
    let positions: Vec<DVec3> = landmarks.clone().map(|landmark| landmark.position).collect();
    let confidence: Vec<f64> = landmarks.map(|landmark| landmark.confidence).collect();
    file.add("landmarks", &[frame_count, rig.landmarks.len(), 3], &input_points(positions));
    file.add("landmark_confidence", &[frame_count, rig.landmarks.len()], &confidence);
    add_rig(&mut file, rig);
    Ok(file.write(path)?)
}

/// A file that cannot be read again must not be written.
fn check_before_writing(fit: &RiggedSequence) -> Result<(), String> {
    let (sequence, rig) = (&fit.sequence, &fit.rig);
    let component_count = sequence.identity.len();
    let vertex_count = sequence.rest_vertices.len();
    let is_consistent = sequence.identity_covariance.shape() == (component_count, component_count)
        && sequence.rest_joints.len() == rig.skeleton.bones().len()
        && rig.skin.weights.len() == vertex_count
        && sequence.smallest_clearance.len() == vertex_count;
    if !is_consistent {
        return Err("the fit and the rig differ in components, bones or vertices".into());
    }
    check_input_frame(&sequence.input_frame)?;
    let numbers = sequence
        .identity
        .iter()
        .chain(sequence.identity_covariance.iter())
        .chain(&sequence.smallest_clearance);
    let points = sequence.rest_vertices.iter().chain(&sequence.rest_joints);
    if !numbers.copied().all(f64::is_finite) || !points.copied().all(DVec3::is_finite) {
        return Err("the identity or the rest body has a number that is not finite".into());
    }
    for frame in &sequence.frames {
        let name = &frame.name;
        if frame.pose.len() != rig.skeleton.pose_length() || frame.landmarks.len() != rig.landmarks.len() {
            return Err(format!("frame '{name}' has a pose or landmarks of another length than the model's"));
        }
        let landmarks_are_finite = frame
            .landmarks
            .iter()
            .all(|landmark| landmark.position.is_finite() && landmark.confidence.is_finite());
        if !is_scale(frame.capture_scale) {
            return Err(format!("frame '{name}' has the capture scale {}", frame.capture_scale));
        }
        if !frame.pose.iter().copied().all(f64::is_finite) || !landmarks_are_finite {
            return Err(format!("frame '{name}' has a pose or a landmark that is not finite"));
        }
    }
    Ok(())
}

fn is_scale(factor: f64) -> bool {
    factor.is_finite() && factor > 0.0
}

fn check_input_frame(frame: &InputFrame) -> Result<(), String> {
    if !is_scale(frame.metres_per_unit) {
        return Err(format!("the input's unit of {} m must be positive", frame.metres_per_unit));
    }
    let rotation = frame.internal_from_input;
    let is_rotation = (rotation * rotation.transpose()).abs_diff_eq(DMat3::IDENTITY, ROTATION_TOLERANCE)
        && rotation.determinant() > 0.0;
    if is_rotation { Ok(()) } else { Err("internal_from_input is not a rotation".into()) }
}

/// Reads `fit.npz` back into metres, y up.
pub fn read_fit(path: &Path) -> Result<RiggedSequence, FitFileError> {
    let bytes = std::fs::read(path)
        .map_err(|source| FitFileError::Unreadable { path: path.to_path_buf(), source })?;
    read_fit_bytes(bytes, path)
}

fn read_fit_bytes(bytes: Vec<u8>, path: &Path) -> Result<RiggedSequence, FitFileError> {
    let mut file = NpzReader::new(bytes, path)?;
    let metadata = read_metadata(&mut file, path)?;
    let input_frame = metadata.input_frame.to_input_frame();
    check_input_frame(&input_frame)
        .map_err(|reason| FitFileError::Inconsistent { path: path.to_path_buf(), reason })?;
    let unit = input_frame.metres_per_unit;

    let rest_vertices = read_points(&mut file, "rest_vertices", &[None, Some(3)], |point| point * unit)?;
    let vertex_count = rest_vertices.len();
    let rig = read_rig(&mut file, &metadata.rig, vertex_count, path)?;
    let bone_count = rig.skeleton.bones().len();
    let rest_joints =
        read_points(&mut file, "rest_joints", &[Some(bone_count), Some(3)], |point| point * unit)?;
    let clearance = file.floats("smallest_clearance")?;
    file.expect_shape("smallest_clearance", &clearance, &[Some(vertex_count)])?;
    let identity = file.floats("identity")?;
    file.expect_shape("identity", &identity, &[None])?;
    let component_count = identity.values.len();
    let covariance = file.floats("identity_covariance")?;
    file.expect_shape("identity_covariance", &covariance, &[Some(component_count); 2])?;
    let frames = read_frames(&mut file, &metadata, &rig, &input_frame, rest_joints[0])?;
    let sequence = FittedSequence {
        input_frame,
        identity: identity.values,
        identity_covariance: DMatrix::from_vec(component_count, component_count, covariance.values),
        rest_vertices,
        rest_joints,
        smallest_clearance: clearance.values.iter().map(|distance| distance * unit).collect(),
        frames,
        start: metadata.start,
        codes: metadata.codes,
    };
    Ok(RiggedSequence { sequence, rig })
}

fn read_metadata(file: &mut NpzReader, path: &Path) -> Result<FitMetadata, FitFileError> {
    let text = file.text("metadata")?;
    let unusable = |file: &NpzReader, reason: serde_json::Error| {
        FitFileError::Npz(file.invalid("metadata", reason.to_string()))
    };
    let header: FileHeader = serde_json::from_str(&text).map_err(|error| unusable(file, error))?;
    if header.format != FORMAT {
        return Err(FitFileError::Foreign { path: path.to_path_buf(), found: header.format });
    }
    if header.version > VERSION {
        return Err(FitFileError::Newer { path: path.to_path_buf(), found: header.version });
    }
    serde_json::from_value(header.contents).map_err(|error| unusable(file, error))
}

fn read_frames(
    file: &mut NpzReader,
    metadata: &FitMetadata,
    rig: &Rig,
    input_frame: &InputFrame,
    root_joint: DVec3,
) -> Result<Vec<FittedFrame>, FitFileError> {
    let (frame_count, landmark_count) = (metadata.frames.len(), rig.landmarks.len());
    let pose_length = rig.skeleton.pose_length();
    let stored = file.floats("pose")?;
    file.expect_shape("pose", &stored, &[Some(frame_count), Some(pose_length)])?;
    let mut poses: Vec<Vec<f64>> = stored
        .values
        .chunks_exact(pose_length)
        .map(|pose| pose_in_internal_frame(input_frame, root_joint, pose))
        .collect();
    unwind_root_rotations(&mut poses);
    let scales = file.floats("capture_scale")?;
    file.expect_shape("capture_scale", &scales, &[Some(frame_count)])?;
    if scales.values.iter().any(|scale| !is_scale(*scale)) {
        return Err(file.invalid("capture_scale", "has a factor that is not positive".into()).into());
    }
    let shape = [Some(frame_count), Some(landmark_count), Some(3)];
    let positions = read_points(file, "landmarks", &shape, |point| input_frame.to_internal(point))?;
    let confidence = file.floats("landmark_confidence")?;
    file.expect_shape("landmark_confidence", &confidence, &shape[..2])?;
    let mut landmarks = positions
        .into_iter()
        .zip(confidence.values)
        .map(|(position, confidence)| Landmark { position, confidence });
    let number = |value: Option<f64>| value.unwrap_or(f64::NAN);
    Ok(metadata
        .frames
        .iter()
        .zip(poses)
        .zip(scales.values)
        .map(|((record, pose), capture_scale)| FittedFrame {
            name: record.name.clone(),
            pose,
            landmarks: landmarks.by_ref().take(landmark_count).collect(),
            codes: record.codes.clone(),
            inlier_share: number(record.inlier_share),
            outside_share_5mm: number(record.outside_share_5mm),
            outside_mean: number(record.outside_mean),
            clearance_percentiles: record.clearance_percentiles,
            energy: number(record.energy),
            capture_scale,
            seconds: number(record.seconds),
        })
        .collect())
}

fn read_points(
    file: &mut NpzReader,
    key: &str,
    shape: &[Option<usize>],
    convert: impl Fn(DVec3) -> DVec3,
) -> Result<Vec<DVec3>, FitFileError> {
    let array = file.floats(key)?;
    file.expect_shape(key, &array, shape)?;
    Ok(array.values.chunks_exact(3).map(|point| convert(DVec3::from_slice(point))).collect())
}

/// Writes `landmarks.csv`: `frame,landmark,x,y,z,confidence` in the input's frame and unit, at the scale of each
/// frame's own capture.
pub fn write_landmarks(path: &Path, fit: &RiggedSequence) -> Result<(), FitFileError> {
    let mut table = CsvText::with_header(&["frame", "landmark", "x", "y", "z", "confidence"]);
    for frame in &fit.sequence.frames {
        for (name, landmark) in fit.rig.landmarks.iter().zip(&frame.landmarks) {
            let position = fit.sequence.input_frame.to_input(landmark.position) * frame.capture_scale;
            let numbers = [position.x, position.y, position.z].map(|value| value.to_string());
            let [x, y, z] = &numbers;
            table.add_row([&frame.name, name, x, y, z, &format!("{:.3}", landmark.confidence)]);
        }
    }
    write_atomically(path, table.into_text().as_bytes())
        .map_err(|source| FitFileError::Unwritable { path: path.to_path_buf(), source })
}
