//! `dressed.glb`: the skinned body and its clothing, whose layer components are morph targets with animated weights.
//!
//! A player adds the weighted components to the mean layer and skins the sum, which is P3's Eq. 3 and 4 as long as no
//! blend had to be limited. That the clothing was pushed out of the body has no place in components; the mesh files hold it.

use std::path::Path;

use glam::DVec3;
use habitus_geometry::io::ContentError;
use habitus_geometry::io::glb::{GlbBuilder, UNSIGNED_BYTE, ViewTarget};
use serde_json::{Map, Value, json};

use super::clothing_layer::ClothingLayer;
use super::skinned_glb::{
    SkinnedGlbError, animation, extras, inverse_bind_matrices, joint_nodes, mesh, single_precision,
};
use super::synthesized_sequence::SynthesizedSequence;
use super::write_atomically;
use crate::statistics::LinearSpace;

/// Bones of a vertex in two sets of four, as glTF has them.
const BONES_PER_VERTEX: usize = 8;

/// Writes the body and the clothing; `dressed` is what was synthesized over, `space` the layer's components.
pub fn write_dressed_glb(
    path: &Path,
    sequence: &SynthesizedSequence,
    dressed: &ClothingLayer,
    space: &LinearSpace,
) -> Result<(), SkinnedGlbError> {
    write_atomically(path, &dressed_glb(sequence, dressed, space)?)
        .map_err(|source| SkinnedGlbError::Unwritable { path: path.to_path_buf(), source })
}

/// The bytes of [`write_dressed_glb`]'s file.
pub fn dressed_glb(
    sequence: &SynthesizedSequence,
    dressed: &ClothingLayer,
    space: &LinearSpace,
) -> Result<Vec<u8>, SkinnedGlbError> {
    let body = &sequence.body;
    let joints = &body.sequence.rest_joints;
    let mut glb = GlbBuilder::new();
    let meshes = [mesh(&mut glb, body)?, clothing_mesh(&mut glb, dressed, space)?];
    let (body_node, clothing_node) = (joints.len(), joints.len() + 1);
    let mut nodes = joint_nodes(&body.rig, joints);
    nodes.push(json!({ "name": "body", "mesh": 0, "skin": 0 }));
    nodes.push(json!({ "name": "clothing", "mesh": 1, "skin": 0 }));
    let joint_indices: Vec<usize> = (0..joints.len()).collect();
    let skin = json!({
        "joints": joint_indices,
        "skeleton": 0,
        "inverseBindMatrices": inverse_bind_matrices(&mut glb, joints)?,
    });
    let material = |color: [f64; 4]| {
        json!({
            "pbrMetallicRoughness": { "baseColorFactor": color, "metallicFactor": 0, "roughnessFactor": 0.8 },
            "doubleSided": true,
        })
    };
    let mut motion = animation(&mut glb, body, sequence.frame_rate)?;
    add_weights(&mut glb, &mut motion, sequence, clothing_node);
    let mut description = Map::new();
    let parts = [
        ("scene", json!(0)),
        ("scenes", json!([{ "nodes": [0, body_node, clothing_node] }])),
        ("nodes", Value::Array(nodes)),
        ("meshes", Value::Array(meshes.to_vec())),
        ("skins", json!([skin])),
        ("materials", json!([material([0.8, 0.65, 0.55, 1.0]), material([0.35, 0.45, 0.65, 1.0])])),
        ("animations", json!([motion])),
        ("extras", extras(body, sequence.frame_rate)),
    ];
    description.extend(parts.map(|(name, part)| (name.to_owned(), part)));
    Ok(glb.finish(description)?)
}

/// The mean layer over the rest body, one morph target for each component, scaled to one standard deviation.
fn clothing_mesh(
    glb: &mut GlbBuilder,
    dressed: &ClothingLayer,
    space: &LinearSpace,
) -> Result<Value, ContentError> {
    let anchors = dressed.association.anchors(&dressed.rest_vertices);
    let offsets = space.mean().chunks_exact(3).map(DVec3::from_slice);
    let rest: Vec<DVec3> = anchors.iter().zip(offsets).map(|(anchor, offset)| *anchor + offset).collect();
    let normals: Vec<DVec3> = habitus_geometry::vertex_normals(&rest, &dressed.clothing_faces)
        .into_iter()
        .map(|normal| normal.try_normalize().unwrap_or(DVec3::Y))
        .collect();
    let (bones, weights) = eight_bones(dressed);
    let set = |slots: &[[u8; BONES_PER_VERTEX]], first: usize| -> Vec<u8> {
        slots.iter().flat_map(|bones| bones[first..first + 4].to_vec()).collect()
    };
    let weight_set = |first: usize| -> Vec<[f32; 4]> {
        weights.iter().map(|weights| std::array::from_fn(|k| weights[first + k])).collect()
    };
    let positions = single_precision("clothing vertex", &rest)?;
    let normals = single_precision("clothing normal", &normals)?;
    let attributes = json!({
        "POSITION": glb.add_vectors(ViewTarget::Vertices, &positions),
        "NORMAL": glb.add_vectors(ViewTarget::Vertices, &normals),
        "JOINTS_0": glb.add_accessor("VEC4", UNSIGNED_BYTE, rest.len(), ViewTarget::Vertices, set(&bones, 0)),
        "JOINTS_1": glb.add_accessor("VEC4", UNSIGNED_BYTE, rest.len(), ViewTarget::Vertices, set(&bones, 4)),
        "WEIGHTS_0": glb.add_floats("VEC4", ViewTarget::Vertices, &weight_set(0)),
        "WEIGHTS_1": glb.add_floats("VEC4", ViewTarget::Vertices, &weight_set(4)),
    });
    let mut targets = Vec::new();
    for (column, deviation) in space.basis().column_iter().zip(space.standard_deviations()) {
        let moved: Vec<DVec3> =
            column.as_slice().chunks_exact(3).map(|vector| DVec3::from_slice(vector) * *deviation).collect();
        let moved = single_precision("component", &moved)?;
        targets.push(json!({ "POSITION": glb.add_vectors(ViewTarget::Vertices, &moved) }));
    }
    let names: Vec<String> = (1..=targets.len()).map(|k| format!("component_{k}")).collect();
    let indices = glb.add_indices(&dressed.clothing_faces);
    let mut primitive = json!({ "attributes": attributes, "indices": indices, "material": 1 });
    let mut mesh = json!({ "name": "clothing" });
    if !targets.is_empty() {
        mesh["weights"] = json!(vec![0.0; targets.len()]);
        mesh["extras"] = json!({ "targetNames": names });
        primitive["targets"] = Value::Array(targets);
    }
    mesh["primitives"] = json!([primitive]);
    Ok(mesh)
}

/// The heaviest bones of each vertex, and their weights in proportion.
fn eight_bones(dressed: &ClothingLayer) -> (Vec<[u8; BONES_PER_VERTEX]>, Vec<[f32; BONES_PER_VERTEX]>) {
    let skin = dressed.association.blended_skin(&dressed.rig);
    (0..skin.point_count())
        .map(|point| {
            let mut heaviest: Vec<(usize, f64)> = skin.of(point).collect();
            heaviest.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
            heaviest.truncate(BONES_PER_VERTEX);
            let sum: f64 = heaviest.iter().map(|(_, weight)| weight).sum();
            let (mut bones, mut weights) = ([0; BONES_PER_VERTEX], [0.0; BONES_PER_VERTEX]);
            for (slot, (bone, weight)) in heaviest.into_iter().enumerate() {
                bones[slot] = bone as u8;
                weights[slot] = (weight / sum) as f32;
            }
            (bones, weights)
        })
        .unzip()
}

/// One key of all weights for each frame, beside the joints' keys.
fn add_weights(glb: &mut GlbBuilder, motion: &mut Value, sequence: &SynthesizedSequence, node: usize) {
    if sequence.coefficients.ncols() == 0 {
        return;
    }
    let keys: Vec<[f32; 1]> =
        sequence.coefficients.transpose().iter().map(|coefficient| [*coefficient as f32]).collect();
    let output = glb.add_floats("SCALAR", ViewTarget::Other, &keys);
    let input = motion["samplers"][0]["input"].clone();
    let sampler = motion["samplers"].as_array().map_or(0, Vec::len);
    if let Some(samplers) = motion["samplers"].as_array_mut() {
        samplers.push(json!({ "input": input, "output": output, "interpolation": "LINEAR" }));
    }
    if let Some(channels) = motion["channels"].as_array_mut() {
        channels.push(json!({ "sampler": sampler, "target": { "node": node, "path": "weights" } }));
    }
}

#[cfg(test)]
mod tests;
