//! `body.glb`: the fitted body as a skinned, animated glTF 2.0 binary, in metres, y up, as glTF demands.
//!
//! Joints really are joints: 15 nodes in their hierarchy, each turning about its own joint, and one skin.

use std::path::{Path, PathBuf};

use glam::{DQuat, DVec3};
use habitus_geometry::io::ContentError;
use habitus_geometry::io::glb::{GlbBuilder, UNSIGNED_BYTE, ViewTarget};
use serde_json::{Map, Value, json};
use thiserror::Error;

use super::rigged_sequence::{FrameRate, Rig, RiggedSequence};
use super::write_atomically;

/// Why a skinned body cannot be written.
#[derive(Debug, Error)]
pub enum SkinnedGlbError {
    /// The content does not fit glTF.
    #[error("the body cannot be written as glTF: {0}")]
    Content(#[from] ContentError),
    /// The file cannot be written.
    #[error("{}: cannot be written ({source})", path.display())]
    Unwritable {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
}

/// Writes the body and its motion; without frames, the body in its rest pose.
pub fn write_skinned_glb(
    path: &Path,
    fit: &RiggedSequence,
    frame_rate: FrameRate,
) -> Result<(), SkinnedGlbError> {
    write_atomically(path, &skinned_glb(fit, frame_rate)?)
        .map_err(|source| SkinnedGlbError::Unwritable { path: path.to_path_buf(), source })
}

/// The bytes of [`write_skinned_glb`]'s file.
pub fn skinned_glb(fit: &RiggedSequence, frame_rate: FrameRate) -> Result<Vec<u8>, SkinnedGlbError> {
    let (rig, joints) = (&fit.rig, &fit.sequence.rest_joints);
    let mut glb = GlbBuilder::new();
    let mesh = mesh(&mut glb, fit)?;
    let body_node = joints.len();
    let mut nodes = joint_nodes(rig, joints);
    nodes.push(json!({ "name": "body", "mesh": 0, "skin": 0 }));
    let joint_indices: Vec<usize> = (0..body_node).collect();
    let skin = json!({
        "joints": joint_indices,
        "skeleton": 0,
        "inverseBindMatrices": inverse_bind_matrices(&mut glb, joints)?,
    });
    let mut description = Map::new();
    let parts = [
        ("scene", json!(0)),
        ("scenes", json!([{ "nodes": [0, body_node] }])),
        ("nodes", Value::Array(nodes)),
        ("meshes", json!([mesh])),
        ("skins", json!([skin])),
        ("materials", json!([{ "pbrMetallicRoughness": { "metallicFactor": 0, "roughnessFactor": 0.8 } }])),
        ("extras", extras(fit, frame_rate)),
    ];
    description.extend(parts.map(|(name, part)| (name.to_owned(), part)));
    if !fit.sequence.frames.is_empty() {
        description.insert("animations".into(), json!([animation(&mut glb, fit, frame_rate)?]));
    }
    Ok(glb.finish(description)?)
}

/// What a person who finds the file wants to know, and which frames not to trust.
pub(super) fn extras(fit: &RiggedSequence, frame_rate: FrameRate) -> Value {
    let suspects: Vec<Value> = fit
        .sequence
        .frames
        .iter()
        .enumerate()
        .filter(|(_, frame)| !frame.is_ok())
        .map(|(index, frame)| json!({ "frame": index, "name": frame.name, "codes": frame.codes }))
        .collect();
    json!({
        "written_by": concat!("habitus ", env!("CARGO_PKG_VERSION")),
        "body_model": fit.rig.model_name,
        "body_model_license": fit.rig.model_license,
        "frames_per_second": frame_rate.frames_per_second(),
        "failed_frames": suspects,
    })
}

pub(super) fn mesh(glb: &mut GlbBuilder, fit: &RiggedSequence) -> Result<Value, ContentError> {
    let (rest, rig) = (&fit.sequence.rest_vertices, &fit.rig);
    let normals: Vec<DVec3> = habitus_geometry::vertex_normals(rest, &rig.faces)
        .into_iter()
        .map(|normal| normal.try_normalize().unwrap_or(DVec3::Y))
        .collect();
    let positions = single_precision("vertex", rest)?;
    let normals = single_precision("normal", &normals)?;
    // glTF wants slots of weight zero to name joint 0.
    let bones = rig.skin.bones.iter().zip(&rig.skin.weights).flat_map(|(bones, weights)| {
        std::array::from_fn::<u8, 4, _>(|slot| if weights[slot] > 0.0 { bones[slot] } else { 0 })
    });
    let weights: Vec<[f32; 4]> =
        rig.skin.weights.iter().map(|weights| weights.map(|weight| weight as f32)).collect();
    let attributes = json!({
        "POSITION": glb.add_vectors(ViewTarget::Vertices, &positions),
        "NORMAL": glb.add_vectors(ViewTarget::Vertices, &normals),
        "JOINTS_0": glb.add_accessor("VEC4", UNSIGNED_BYTE, rest.len(), ViewTarget::Vertices, bones),
        "WEIGHTS_0": glb.add_floats("VEC4", ViewTarget::Vertices, &weights),
    });
    let indices = glb.add_indices(&rig.faces);
    Ok(json!({
        "name": "body",
        "primitives": [{ "attributes": attributes, "indices": indices, "material": 0 }],
    }))
}

/// One node for each bone, at rest: only the offset from its parent.
pub(super) fn joint_nodes(rig: &Rig, joints: &[DVec3]) -> Vec<Value> {
    let bones = rig.skeleton.bones();
    bones
        .iter()
        .enumerate()
        .map(|(index, bone)| {
            let offset = joints[index] - bone.parent.map_or(DVec3::ZERO, |parent| joints[parent]);
            let children: Vec<usize> =
                (0..bones.len()).filter(|child| bones[*child].parent == Some(index)).collect();
            let mut node = json!({ "name": bone.name, "translation": offset.as_vec3().to_array() });
            if !children.is_empty() {
                node["children"] = json!(children);
            }
            node
        })
        .collect()
}

pub(super) fn inverse_bind_matrices(glb: &mut GlbBuilder, joints: &[DVec3]) -> Result<usize, ContentError> {
    let matrices: Vec<[f32; 16]> = single_precision("joint", joints)?
        .into_iter()
        .map(|[x, y, z]| [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, -x, -y, -z, 1.0])
        .collect();
    Ok(glb.add_floats("MAT4", ViewTarget::Other, &matrices))
}

/// A rotation for each joint and a translation for the root, linear between frames.
pub(super) fn animation(
    glb: &mut GlbBuilder,
    fit: &RiggedSequence,
    frame_rate: FrameRate,
) -> Result<Value, ContentError> {
    let frame_count = fit.sequence.frames.len();
    let bones = fit.rig.skeleton.bones();
    let mut rotations: Vec<Vec<[f32; 4]>> = vec![Vec::with_capacity(frame_count); bones.len()];
    let mut root_positions = Vec::with_capacity(frame_count);
    let mut before = vec![DQuat::IDENTITY; bones.len()];
    for frame in 0..frame_count {
        let posed = fit.posed_skeleton(frame);
        root_positions.push(posed.joints[0]);
        for (index, bone) in bones.iter().enumerate() {
            let global = posed.rotations[index];
            let local = bone.parent.map_or(global, |parent| posed.rotations[parent].transpose() * global);
            let rotation = DQuat::from_mat3(&local).normalize();
            // Of the two quaternions of a rotation the one near the frame before: players interpolate.
            before[index] = if rotation.dot(before[index]) < 0.0 { -rotation } else { rotation };
            rotations[index].push(before[index].as_quat().to_array());
        }
    }
    let times: Vec<[f32; 1]> = (0..frame_count).map(|frame| [frame_rate.time_of(frame) as f32]).collect();
    let input = glb.add_floats("SCALAR", ViewTarget::Other, &times);
    let root_positions = single_precision("root position", &root_positions)?;
    let mut samplers = vec![json!({
        "input": input,
        "output": glb.add_vectors(ViewTarget::Other, &root_positions),
        "interpolation": "LINEAR",
    })];
    let mut channels = vec![json!({ "sampler": 0, "target": { "node": 0, "path": "translation" } })];
    for (index, keys) in rotations.iter().enumerate() {
        let output = glb.add_floats("VEC4", ViewTarget::Other, keys);
        samplers.push(json!({ "input": input, "output": output, "interpolation": "LINEAR" }));
        channels.push(json!({ "sampler": index + 1, "target": { "node": index, "path": "rotation" } }));
    }
    Ok(json!({ "name": "motion", "samplers": samplers, "channels": channels }))
}

pub(super) fn single_precision(what: &'static str, vectors: &[DVec3]) -> Result<Vec<[f32; 3]>, ContentError> {
    vectors
        .iter()
        .enumerate()
        .map(|(index, vector)| {
            let single = vector.as_vec3();
            if single.is_finite() {
                Ok(single.to_array())
            } else {
                Err(ContentError::BeyondSinglePrecision { what, index })
            }
        })
        .collect()
}

#[cfg(test)]
pub(super) mod tests;
