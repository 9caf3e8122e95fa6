//! `layer.npz`: metres, y up, with all that is needed to pose the clothing again, without the model's file.

use std::path::{Path, PathBuf};

use glam::DVec3;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::{AlignmentQuality, AssociationOrigin, ClothingAssociation, ClothingFrame, ClothingLayer};
use crate::artifacts::codes::Code;
use crate::artifacts::npz::{NpzError, NpzReader, NpzWriter};
use crate::artifacts::rig_file::{RigNames, add_rig, flat, read_rig};
use crate::artifacts::rigged_sequence::FrameRate;
use crate::artifacts::sequence_files::records::{FileHeader, InputFrameRecord};
use crate::body::{BlendedSkin, ModelFileError};

const FORMAT: &str = "habitus-clothing-layer";
/// The newest version that is read; what an older program can read too is written as [`VERSION_WITHOUT_BONE_WEIGHTS`].
const VERSION: u32 = 2;
/// A program that does not know the bone weights would pose the clothing with others, and must refuse the file instead.
const VERSION_WITHOUT_BONE_WEIGHTS: u32 = 1;
/// Bone weights of each clothing vertex, where they are not those of its body vertices.
const BONE_WEIGHTS: &str = "association_bone_weights";
/// Written sums are right to rounding; more means that somebody edited the file.
const WEIGHT_SUM_TOLERANCE: f64 = 1e-6;

/// Why a clothing layer cannot be written or read.
#[derive(Debug, Error)]
pub enum LayerFileError {
    /// The file cannot be read at all.
    #[error("{}: the clothing layer cannot be read ({source})", path.display())]
    Unreadable {
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
    #[error("{}: is not a clothing layer (its metadata says '{found}'); make one with habitus extract-clothing", path.display())]
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

#[derive(Serialize, Deserialize)]
struct LayerMetadata {
    #[serde(flatten)]
    rig: RigNames,
    input_frame: InputFrameRecord,
    frame_rate: f64,
    smallest_stretch: f64,
    frames: Vec<FrameRecord>,
}

#[derive(Serialize, Deserialize)]
struct FrameRecord {
    name: String,
    capture_index: usize,
    codes: Vec<Code>,
    #[serde(flatten)]
    quality: AlignmentQuality,
}

/// Writes `layer.npz`.
pub fn write_layer(path: &Path, layer: &ClothingLayer) -> Result<(), LayerFileError> {
    check(layer).map_err(|reason| LayerFileError::Inconsistent { path: path.to_path_buf(), reason })?;
    let mut file = NpzWriter::new();
    add_layer(&mut file, "metadata", layer);
    Ok(file.write(path)?)
}

/// Adds the arrays of a layer to a file, its record under the name `metadata_key`.
pub(in crate::artifacts) fn add_layer(file: &mut NpzWriter, metadata_key: &str, layer: &ClothingLayer) {
    let association = &layer.association;
    let (frame_count, vertex_count) = (layer.frames.len(), layer.clothing_vertex_count());
    let metadata = LayerMetadata {
        rig: RigNames::of(&layer.rig),
        input_frame: InputFrameRecord::of(&layer.input_frame),
        frame_rate: layer.frame_rate.frames_per_second(),
        smallest_stretch: association.smallest_stretch,
        frames: layer.frames.iter().map(FrameRecord::of).collect(),
    };
    let contents = serde_json::to_value(metadata).unwrap_or_default();
    let version = if association.spread_skin.is_some() { VERSION } else { VERSION_WITHOUT_BONE_WEIGHTS };
    let header = FileHeader { format: FORMAT.into(), version, contents };
    file.add_text(metadata_key, &serde_json::to_string(&header).unwrap_or_default());
    file.add("offsets", &[frame_count, vertex_count, 3], &layer.offsets);
    let poses: Vec<f64> = layer.frames.iter().flat_map(|frame| frame.pose.iter().copied()).collect();
    file.add("pose", &[frame_count, layer.rig.skeleton.pose_length()], &poses);
    let slots = association.body_vertices_per_clothing_vertex;
    let bodies: Vec<i32> = association.body_vertices.iter().map(|vertex| *vertex as i32).collect();
    file.add("association_body_vertices", &[vertex_count, slots], &bodies);
    file.add("association_weights", &[vertex_count, slots], &association.weights);
    if let Some(skin) = &association.spread_skin {
        let bone_count = layer.rig.skeleton.bones().len();
        file.add(BONE_WEIGHTS, &[vertex_count, bone_count], &skin.table(bone_count));
    }
    let completed =
        association.origins.iter().map(|origin| u8::from(*origin == AssociationOrigin::Completed));
    file.add("association_completed", &[vertex_count], &completed.collect::<Vec<u8>>());
    let faces: Vec<i32> = layer.clothing_faces.iter().flatten().map(|vertex| *vertex as i32).collect();
    file.add("clothing_faces", &[layer.clothing_faces.len(), 3], &faces);
    file.add("identity", &[layer.identity.len()], &layer.identity);
    file.add("rest_vertices", &[layer.rest_vertices.len(), 3], &flat(layer.rest_vertices.iter().copied()));
    file.add("rest_joints", &[layer.rest_joints.len(), 3], &flat(layer.rest_joints.iter().copied()));
    add_rig(file, &layer.rig);
}

impl FrameRecord {
    fn of(frame: &ClothingFrame) -> Self {
        Self {
            name: frame.name.clone(),
            capture_index: frame.capture_index,
            codes: frame.codes.clone(),
            quality: frame.quality,
        }
    }
}

/// Reads `layer.npz`.
pub fn read_layer(path: &Path) -> Result<ClothingLayer, LayerFileError> {
    let bytes = std::fs::read(path)
        .map_err(|source| LayerFileError::Unreadable { path: path.to_path_buf(), source })?;
    read_layer_bytes(bytes, path)
}

pub(super) fn read_layer_bytes(bytes: Vec<u8>, path: &Path) -> Result<ClothingLayer, LayerFileError> {
    let mut file = NpzReader::new(bytes, path)?;
    read_arrays(&mut file, "metadata", path)
}

/// Reads what [`add_layer`] has added.
pub(in crate::artifacts) fn read_arrays(
    file: &mut NpzReader,
    metadata_key: &str,
    path: &Path,
) -> Result<ClothingLayer, LayerFileError> {
    let metadata = read_metadata(file, metadata_key, path)?;
    let inconsistent = |reason: String| LayerFileError::Inconsistent { path: path.to_path_buf(), reason };
    let rest_vertices = read_points(file, "rest_vertices", None)?;
    let rig = read_rig(file, &metadata.rig, rest_vertices.len(), path)?;
    let rest_joints = read_points(file, "rest_joints", Some(rig.skeleton.bones().len()))?;
    let mut association = read_association(file, rest_vertices.len(), metadata.smallest_stretch)?;
    let vertex_count = association.clothing_vertex_count();
    association.spread_skin = read_spread_skin(file, vertex_count, rig.skeleton.bones().len())?;
    let faces = file.indices("clothing_faces", vertex_count)?;
    file.expect_shape("clothing_faces", &faces, &[None, Some(3)])?;
    let frame_count = metadata.frames.len();
    let offsets = file.floats("offsets")?;
    file.expect_shape("offsets", &offsets, &[Some(frame_count), Some(vertex_count), Some(3)])?;
    let identity = file.floats("identity")?;
    file.expect_shape("identity", &identity, &[None])?;
    let pose_length = rig.skeleton.pose_length();
    let poses = file.floats("pose")?;
    file.expect_shape("pose", &poses, &[Some(frame_count), Some(pose_length)])?;
    let frame_rate = FrameRate::new(metadata.frame_rate).ok_or_else(|| {
        inconsistent(format!("the frame rate of {} must be positive and finite", metadata.frame_rate))
    })?;
    let frames = metadata.frames.into_iter().zip(poses.values.chunks_exact(pose_length));
    let layer = ClothingLayer {
        input_frame: metadata.input_frame.to_input_frame(),
        rig,
        identity: identity.values,
        rest_vertices,
        rest_joints,
        association,
        clothing_faces: faces.values.as_chunks().0.to_vec(),
        frame_rate,
        frames: frames
            .map(|(record, pose)| ClothingFrame {
                name: record.name,
                capture_index: record.capture_index,
                pose: pose.to_vec(),
                codes: record.codes,
                quality: record.quality,
            })
            .collect(),
        offsets: offsets.values.iter().map(|value| *value as f32).collect(),
    };
    check(&layer).map_err(inconsistent)?;
    Ok(layer)
}

fn read_metadata(
    file: &mut NpzReader,
    metadata_key: &str,
    path: &Path,
) -> Result<LayerMetadata, LayerFileError> {
    let text = file.text(metadata_key)?;
    let unusable = |file: &NpzReader, reason: serde_json::Error| file.invalid("metadata", reason.to_string());
    let header: FileHeader = serde_json::from_str(&text).map_err(|error| unusable(file, error))?;
    if header.format != FORMAT {
        return Err(LayerFileError::Foreign { path: path.to_path_buf(), found: header.format });
    }
    if header.version > VERSION {
        return Err(LayerFileError::Newer { path: path.to_path_buf(), found: header.version });
    }
    Ok(serde_json::from_value(header.contents).map_err(|error| unusable(file, error))?)
}

fn read_association(
    file: &mut NpzReader,
    body_vertex_count: usize,
    smallest_stretch: f64,
) -> Result<ClothingAssociation, NpzError> {
    let bodies = file.indices("association_body_vertices", body_vertex_count)?;
    file.expect_shape("association_body_vertices", &bodies, &[None, None])?;
    let (vertex_count, slots) = (bodies.shape[0], bodies.shape[1]);
    let weights = file.floats("association_weights")?;
    file.expect_shape("association_weights", &weights, &[Some(vertex_count), Some(slots)])?;
    let completed = file.indices("association_completed", 2)?;
    file.expect_shape("association_completed", &completed, &[Some(vertex_count)])?;
    let origin = |flag: &u32| match flag {
        0 => AssociationOrigin::Diffused,
        _ => AssociationOrigin::Completed,
    };
    Ok(ClothingAssociation {
        body_vertices_per_clothing_vertex: slots,
        body_vertices: bodies.values,
        weights: weights.values,
        origins: completed.values.iter().map(origin).collect(),
        smallest_stretch,
        spread_skin: None,
    })
}

/// Files of before the weights were spread, and those whose weights are the paper's, do without the array.
fn read_spread_skin(
    file: &mut NpzReader,
    vertex_count: usize,
    bone_count: usize,
) -> Result<Option<BlendedSkin>, NpzError> {
    if !file.contains(BONE_WEIGHTS) {
        return Ok(None);
    }
    let table = file.floats(BONE_WEIGHTS)?;
    file.expect_shape(BONE_WEIGHTS, &table, &[Some(vertex_count), Some(bone_count)])?;
    Ok(Some(BlendedSkin::of_table(bone_count, &table.values)))
}

fn read_points(file: &mut NpzReader, key: &str, count: Option<usize>) -> Result<Vec<DVec3>, NpzError> {
    let array = file.floats(key)?;
    file.expect_shape(key, &array, &[count, Some(3)])?;
    Ok(array.values.chunks_exact(3).map(DVec3::from_slice).collect())
}

fn are_shares(weights: impl Iterator<Item = f64>) -> bool {
    let (mut sum, mut smallest) = (0.0, 0.0_f64);
    for weight in weights {
        sum += weight;
        smallest = smallest.min(weight);
    }
    // A sum that is not a number fails, too.
    smallest >= 0.0 && (sum - 1.0).abs() <= WEIGHT_SUM_TOLERANCE
}

fn check_spread_skin(skin: &BlendedSkin, vertex_count: usize, bone_count: usize) -> Result<(), String> {
    if skin.point_count() != vertex_count {
        return Err("the bone weights do not belong to the clothing vertices".into());
    }
    for vertex in 0..vertex_count {
        if skin.of(vertex).any(|(bone, _)| bone >= bone_count) {
            return Err(format!("clothing vertex {vertex} hangs on a bone that the skeleton does not have"));
        }
        if !are_shares(skin.of(vertex).map(|(_, weight)| weight)) {
            return Err(format!("the bone weights of clothing vertex {vertex} do not sum to one"));
        }
    }
    Ok(())
}

/// A file that cannot be read again must not be written, and one that was edited must not be believed.
fn check(layer: &ClothingLayer) -> Result<(), String> {
    let association = &layer.association;
    let slots = association.body_vertices_per_clothing_vertex;
    let vertex_count = layer.clothing_vertex_count();
    if slots == 0
        || association.body_vertices.len() != vertex_count * slots
        || association.weights.len() != vertex_count * slots
    {
        return Err("the association needs as many body vertices and weights as its clothing vertices".into());
    }
    for (vertex, weights) in association.weights.chunks_exact(slots).enumerate() {
        if !are_shares(weights.iter().copied()) {
            return Err(format!("the association weights of clothing vertex {vertex} do not sum to one"));
        }
    }
    if let Some(skin) = &association.spread_skin {
        check_spread_skin(skin, vertex_count, layer.rig.skeleton.bones().len())?;
    }
    if !(association.smallest_stretch > 0.0 && association.smallest_stretch <= 1.0) {
        let found = association.smallest_stretch;
        return Err(format!("the smallest stretch is {found}; it must lie above 0 and not above 1"));
    }
    if layer.offsets.len() != layer.frames.len() * vertex_count * 3 {
        return Err("the offsets do not belong to the frames and clothing vertices".into());
    }
    if layer.offsets.iter().any(|value| !value.is_finite()) {
        return Err("an offset is not finite".into());
    }
    if layer.rest_vertices.len() != layer.rig.skin.weights.len()
        || layer.rest_joints.len() != layer.rig.skeleton.bones().len()
    {
        return Err("the rest body and the rig differ in vertices or bones".into());
    }
    for frame in &layer.frames {
        let is_usable = frame.pose.len() == layer.rig.skeleton.pose_length()
            && frame.pose.iter().copied().all(f64::is_finite);
        if !is_usable {
            return Err(format!("frame '{}' has a pose that is not finite or of another length", frame.name));
        }
    }
    let is_ascending = layer.frames.windows(2).all(|pair| pair[0].capture_index < pair[1].capture_index);
    if is_ascending { Ok(()) } else { Err("the frames are not in the order of the capture".into()) }
}
