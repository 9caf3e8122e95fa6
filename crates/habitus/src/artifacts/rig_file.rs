//! A rig inside an `.npz` file: what every file stores that can be posed without the model's own file.

use std::path::Path;

use glam::DVec3;
use serde::{Deserialize, Serialize};

use super::npz::{NpzReader, NpzWriter};
use super::rigged_sequence::Rig;
use crate::body::ModelFileError;
use crate::body::file::{read_skeleton, read_skin};

/// Name and licence of a body model.
#[derive(Serialize, Deserialize)]
struct ModelRecord {
    name: String,
    license: String,
}

/// The names of a rig, for the JSON record of a file.
#[derive(Serialize, Deserialize)]
pub(super) struct RigNames {
    model: ModelRecord,
    bones: Vec<String>,
    axes: Vec<String>,
    landmarks: Vec<String>,
}

impl RigNames {
    /// The names of this rig.
    pub(super) fn of(rig: &Rig) -> Self {
        Self {
            model: ModelRecord { name: rig.model_name.clone(), license: rig.model_license.clone() },
            bones: rig.skeleton.bones().iter().map(|bone| bone.name.clone()).collect(),
            axes: rig.skeleton.axes().iter().map(|axis| axis.name.clone()).collect(),
            landmarks: rig.landmarks.clone(),
        }
    }
}

/// The coordinates of points, one after another.
pub(super) fn flat(points: impl Iterator<Item = DVec3>) -> Vec<f64> {
    points.flat_map(|point| point.to_array()).collect()
}

/// Adds faces, skin and skeleton, all in f64: what a plain reader skins from the file agrees with ours to rounding.
pub(super) fn add_rig(file: &mut NpzWriter, rig: &Rig) {
    let faces: Vec<i32> = rig.faces.iter().flatten().map(|vertex| *vertex as i32).collect();
    file.add("faces", &[rig.faces.len(), 3], &faces);
    file.add("skin_bones", &[rig.skin.bones.len(), 4], &rig.skin.bones.concat());
    file.add("skin_weights", &[rig.skin.weights.len(), 4], &rig.skin.weights.concat());
    let bones = rig.skeleton.bones();
    let parents: Vec<i32> = bones.iter().map(|bone| bone.parent.map_or(-1, |parent| parent as i32)).collect();
    file.add("bone_parents", &[parents.len()], &parents);
    let axes = rig.skeleton.axes();
    let axis_bones: Vec<i32> = axes.iter().map(|axis| axis.bone as i32).collect();
    file.add("axis_bones", &[axes.len()], &axis_bones);
    file.add("axis_directions", &[axes.len(), 3], &flat(axes.iter().map(|axis| axis.direction)));
    let limits: Vec<f64> = axes.iter().flat_map(|axis| axis.limits).collect();
    file.add("axis_limits", &[axes.len(), 2], &limits);
}

/// Reads what [`add_rig`] has added.
pub(super) fn read_rig(
    file: &mut NpzReader,
    names: &RigNames,
    vertex_count: usize,
    path: &Path,
) -> Result<Rig, ModelFileError> {
    let skeleton = read_skeleton(file, &names.bones, &names.axes, path)?;
    let skin = read_skin(file, vertex_count, skeleton.bones().len())?;
    let faces = file.indices("faces", vertex_count)?;
    file.expect_shape("faces", &faces, &[None, Some(3)])?;
    Ok(Rig {
        model_name: names.model.name.clone(),
        model_license: names.model.license.clone(),
        faces: faces.values.as_chunks().0.to_vec(),
        skin,
        skeleton,
        landmarks: names.landmarks.clone(),
    })
}
