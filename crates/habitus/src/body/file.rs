//! The body model's `.npz` form; the keys are listed in the book's reference page on model files.

use std::path::{Path, PathBuf};

use glam::DVec3;
use half::f16;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::model::{BodyModel, ModelMetadata, PartLabel};
use super::skeleton::{Axis, Bone, Skeleton, SkeletonError};
use super::surface::{BodySurface, JointMap, SkinWeights};
use crate::artifacts::npz::{Array, NpzError, NpzReader, NpzWriter};

const FORMAT: &str = "habitus-body-model";
const VERSION: u32 = 1;
/// Stored weights are f32: sums are right to about 4 · 2⁻²⁴.
const WEIGHT_SUM_TOLERANCE: f64 = 1e-5;
/// A row of the joint regressor has hundreds of f32 values.
const ROW_SUM_TOLERANCE: f64 = 1e-4;

/// Why a model file is refused.
#[derive(Debug, Error)]
pub enum ModelFileError {
    /// The file cannot be read at all.
    #[error("{}: the model file cannot be read ({source})", path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// An array is missing or broken.
    #[error(transparent)]
    Npz(#[from] NpzError),
    /// It is some other file.
    #[error("{}: is not a habitus body model (its metadata says '{found}')", path.display())]
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
    /// Its arrays contradict one another.
    #[error("{}: {reason}", path.display())]
    Inconsistent {
        /// The file.
        path: PathBuf,
        /// What contradicts what.
        reason: String,
    },
    /// Its skeleton cannot be built.
    #[error("{}: {source}", path.display())]
    Skeleton {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        source: SkeletonError,
    },
}

#[derive(Serialize, Deserialize)]
struct FileMetadata {
    format: String,
    version: u32,
    #[serde(flatten)]
    model: serde_json::Value,
}

/// Reads a model from the bytes of its file.
pub(super) fn read(bytes: Vec<u8>, path: &Path) -> Result<BodyModel, ModelFileError> {
    let inconsistent = |reason: String| ModelFileError::Inconsistent { path: path.to_path_buf(), reason };
    let mut file = NpzReader::new(bytes, path)?;
    let metadata = read_metadata(&mut file, path)?;

    let mean = file.floats("mean")?;
    file.expect_shape("mean", &mean, &[None, Some(3)])?;
    let vertex_count = mean.shape[0];
    let faces = file.indices("faces", vertex_count)?;
    file.expect_shape("faces", &faces, &[None, Some(3)])?;
    let is_degenerate = |face: &[u32]| face[0] == face[1] || face[1] == face[2] || face[2] == face[0];
    if let Some(face) = faces.values.chunks_exact(3).position(is_degenerate) {
        return Err(inconsistent(format!("face {face} names a vertex twice")));
    }
    let skeleton = read_skeleton(&mut file, &metadata.bones, &metadata.axes, path)?;
    let bone_count = skeleton.bones().len();
    let skin = read_skin(&mut file, vertex_count, bone_count)?;
    let joint_regressor = read_regressor(&mut file, vertex_count, bone_count)?;

    let standard_deviations = file.floats("standard_deviations")?.values;
    if standard_deviations.iter().any(|deviation| *deviation < 0.0) {
        return Err(inconsistent("a standard deviation is negative".into()));
    }
    let component_count = standard_deviations.len();
    let stored_basis = file.floats("basis")?;
    file.expect_shape("basis", &stored_basis, &[Some(component_count), Some(vertex_count), Some(3)])?;
    let basis = vertex_major(&stored_basis, &standard_deviations, vertex_count);
    if basis.iter().any(|value| !value.is_finite()) {
        return Err(inconsistent("the basis times its standard deviations exceeds the range of f32".into()));
    }

    let landmark_vertices = file.indices("landmark_vertices", vertex_count)?.values;
    if landmark_vertices.len() != metadata.landmarks.len() {
        return Err(inconsistent("landmark_vertices and the landmark names differ in number".into()));
    }
    let mirror_vertices = file.indices("mirror_vertices", vertex_count)?;
    file.expect_shape("mirror_vertices", &mirror_vertices, &[Some(vertex_count)])?;
    let mirror = &mirror_vertices.values;
    if (0..vertex_count).any(|vertex| mirror[mirror[vertex] as usize] as usize != vertex) {
        return Err(inconsistent("mirror_vertices is not its own inverse".into()));
    }
    let labels = file.indices("part_labels", 4)?;
    file.expect_shape("part_labels", &labels, &[Some(vertex_count)])?;
    if let Some((name, _)) =
        metadata.measurement_vertices.iter().find(|(_, vertex)| **vertex as usize >= vertex_count)
    {
        return Err(inconsistent(format!("measurement vertex '{name}' is beyond the last vertex")));
    }

    let mean = points(&mean);
    let joints = joint_map(&joint_regressor, &mean, &basis, component_count);
    Ok(BodyModel {
        metadata,
        surface: BodySurface { skeleton, mean, basis, component_count, skin, joints },
        standard_deviations,
        faces: faces.values.chunks_exact(3).map(|face| [face[0], face[1], face[2]]).collect(),
        joint_regressor,
        landmark_vertices,
        mirror_vertices: mirror_vertices.values,
        part_labels: labels
            .values
            .iter()
            .map(|label| match label {
                1 => PartLabel::Head,
                2 => PartLabel::Hand,
                3 => PartLabel::Foot,
                _ => PartLabel::Covered,
            })
            .collect(),
    })
}

fn read_metadata(file: &mut NpzReader, path: &Path) -> Result<ModelMetadata, ModelFileError> {
    let text = file.text("metadata")?;
    let unusable = |file: &NpzReader, reason: serde_json::Error| {
        ModelFileError::Npz(file.invalid("metadata", reason.to_string()))
    };
    let header: FileMetadata = serde_json::from_str(&text).map_err(|error| unusable(file, error))?;
    if header.format != FORMAT {
        return Err(ModelFileError::Foreign { path: path.to_path_buf(), found: header.format });
    }
    if header.version > VERSION {
        return Err(ModelFileError::Newer { path: path.to_path_buf(), found: header.version });
    }
    serde_json::from_value(header.model).map_err(|error| unusable(file, error))
}

/// Reads a skeleton whose bones and axes have these names.
pub(crate) fn read_skeleton(
    file: &mut NpzReader,
    bone_names: &[String],
    axis_names: &[String],
    path: &Path,
) -> Result<Skeleton, ModelFileError> {
    let (bone_count, axis_count) = (bone_names.len(), axis_names.len());
    let parents = file.integers("bone_parents")?;
    file.expect_shape("bone_parents", &parents, &[Some(bone_count)])?;
    let axis_bones = file.indices("axis_bones", bone_count)?;
    file.expect_shape("axis_bones", &axis_bones, &[Some(axis_count)])?;
    let directions = file.floats("axis_directions")?;
    file.expect_shape("axis_directions", &directions, &[Some(axis_count), Some(3)])?;
    let limits = file.floats("axis_limits")?;
    file.expect_shape("axis_limits", &limits, &[Some(axis_count), Some(2)])?;
    let bones = bone_names
        .iter()
        .zip(&parents.values)
        .map(|(name, parent)| Bone { name: name.clone(), parent: usize::try_from(*parent).ok() })
        .collect();
    let axes = axis_names
        .iter()
        .enumerate()
        .map(|(k, name)| Axis {
            name: name.clone(),
            bone: axis_bones.values[k] as usize,
            direction: DVec3::from_slice(&directions.values[3 * k..]),
            limits: [limits.values[2 * k], limits.values[2 * k + 1]],
        })
        .collect();
    Skeleton::new(bones, axes).map_err(|source| ModelFileError::Skeleton { path: path.to_path_buf(), source })
}

/// Reads skin weights and makes each row sum to one.
pub(crate) fn read_skin(
    file: &mut NpzReader,
    vertex_count: usize,
    bone_count: usize,
) -> Result<SkinWeights, ModelFileError> {
    let bones = file.indices("skin_bones", bone_count.min(256))?;
    file.expect_shape("skin_bones", &bones, &[Some(vertex_count), Some(4)])?;
    let stored = file.floats("skin_weights")?;
    file.expect_shape("skin_weights", &stored, &[Some(vertex_count), Some(4)])?;
    let mut weights = Vec::with_capacity(vertex_count);
    for (vertex, row) in stored.values.chunks_exact(4).enumerate() {
        let sum: f64 = row.iter().sum();
        if row.iter().any(|weight| *weight < 0.0) || (sum - 1.0).abs() > WEIGHT_SUM_TOLERANCE {
            let reason = format!("the weights of vertex {vertex} are negative or do not sum to 1");
            return Err(file.invalid("skin_weights", reason).into());
        }
        weights.push(std::array::from_fn(|slot| row[slot] / sum));
    }
    let bones = bones
        .values
        .chunks_exact(4)
        .map(|row| std::array::from_fn(|slot| u8::try_from(row[slot]).unwrap_or(0)))
        .collect();
    Ok(SkinWeights { bones, weights })
}

fn read_regressor(
    file: &mut NpzReader,
    vertex_count: usize,
    bone_count: usize,
) -> Result<Vec<Vec<(u32, f64)>>, ModelFileError> {
    let vertices = file.indices("joint_regressor_vertices", vertex_count)?.values;
    let values = file.floats("joint_regressor_values")?.values;
    let offsets = file.indices("joint_regressor_offsets", vertices.len() + 1)?.values;
    let consistent = offsets.len() == bone_count + 1
        && offsets[0] == 0
        && values.len() == vertices.len()
        && offsets.windows(2).all(|pair| pair[0] <= pair[1])
        && offsets.last().map(|last| *last as usize) == Some(vertices.len());
    if !consistent {
        let reason = "offsets must rise from 0 to the number of values, one row for each bone".into();
        return Err(file.invalid("joint_regressor_offsets", reason).into());
    }
    let rows: Vec<Vec<(u32, f64)>> = offsets
        .windows(2)
        .map(|pair| {
            let range = pair[0] as usize..pair[1] as usize;
            vertices[range.clone()].iter().copied().zip(values[range].iter().copied()).collect()
        })
        .collect();
    // A row that does not sum to one leaves its joint behind when the body moves.
    let row_sum = |row: &Vec<(u32, f64)>| row.iter().map(|(_, value)| value).sum::<f64>();
    match rows.iter().position(|row| (row_sum(row) - 1.0).abs() > ROW_SUM_TOLERANCE) {
        None => Ok(rows),
        Some(bone) => {
            let reason = format!("the values of bone {bone} do not sum to 1");
            Err(file.invalid("joint_regressor_values", reason).into())
        }
    }
}

fn points(array: &Array<f64>) -> Vec<DVec3> {
    array.values.chunks_exact(3).map(DVec3::from_slice).collect()
}

/// Stored component-major with unit rows; held vertex-major in metres per standard deviation.
fn vertex_major(stored: &Array<f64>, standard_deviations: &[f64], vertex_count: usize) -> Vec<f32> {
    let component_count = standard_deviations.len();
    let mut basis = vec![0.0_f32; vertex_count * 3 * component_count];
    for (component, (row, deviation)) in
        stored.values.chunks_exact((3 * vertex_count).max(1)).zip(standard_deviations).enumerate()
    {
        for (coordinate, value) in row.iter().enumerate() {
            basis[coordinate * component_count + component] = (value * deviation) as f32;
        }
    }
    basis
}

/// The regressor applied to the mean and to each component.
pub(super) fn joint_map(
    regressor: &[Vec<(u32, f64)>],
    mean: &[DVec3],
    basis: &[f32],
    component_count: usize,
) -> JointMap {
    let joint_of = |vertex_value: &dyn Fn(usize) -> DVec3| -> Vec<DVec3> {
        regressor
            .iter()
            .map(|row| row.iter().map(|(vertex, value)| vertex_value(*vertex as usize) * *value).sum())
            .collect()
    };
    let entry = |vertex: usize, axis: usize, component: usize| {
        f64::from(basis[(vertex * 3 + axis) * component_count + component])
    };
    JointMap {
        mean: joint_of(&|vertex| mean[vertex]),
        basis: (0..component_count)
            .map(|component| {
                joint_of(&|vertex| {
                    DVec3::new(
                        entry(vertex, 0, component),
                        entry(vertex, 1, component),
                        entry(vertex, 2, component),
                    )
                })
            })
            .collect(),
    }
}

/// Writes a model file.
pub(super) fn write(model: &BodyModel, path: &Path) -> Result<(), ModelFileError> {
    let mut file = NpzWriter::new();
    let vertex_count = model.vertex_count();
    let component_count = model.component_count();
    let model_metadata = serde_json::to_value(&model.metadata).unwrap_or_default();
    let header = FileMetadata { format: FORMAT.into(), version: VERSION, model: model_metadata };
    file.add_text("metadata", &serde_json::to_string(&header).unwrap_or_default());
    let flat = |points: &[DVec3]| -> Vec<f32> {
        points.iter().flat_map(|p| [p.x as f32, p.y as f32, p.z as f32]).collect()
    };
    file.add("mean", &[vertex_count, 3], &flat(model.mean_vertices()));
    let mut basis = vec![f16::ZERO; component_count * vertex_count * 3];
    for (index, value) in model.surface.basis.iter().enumerate() {
        let (coordinate, component) = (index / component_count, index % component_count);
        let deviation = model.standard_deviations[component].max(f64::MIN_POSITIVE);
        basis[component * vertex_count * 3 + coordinate] = f16::from_f64(f64::from(*value) / deviation);
    }
    file.add("basis", &[component_count, vertex_count, 3], &basis);
    let deviations: Vec<f32> = model.standard_deviations.iter().map(|d| *d as f32).collect();
    file.add("standard_deviations", &[component_count], &deviations);
    let faces: Vec<i32> = model.faces.iter().flatten().map(|v| *v as i32).collect();
    file.add("faces", &[model.faces.len(), 3], &faces);
    write_rig(model, &mut file);
    let labels: Vec<u8> = model.part_labels.iter().map(|label| *label as u8).collect();
    file.add("part_labels", &[vertex_count], &labels);
    let as_i32 = |indices: &[u32]| -> Vec<i32> { indices.iter().map(|v| *v as i32).collect() };
    file.add("landmark_vertices", &[model.landmark_vertices.len()], &as_i32(&model.landmark_vertices));
    file.add("mirror_vertices", &[vertex_count], &as_i32(&model.mirror_vertices));
    Ok(file.write(path)?)
}

fn write_rig(model: &BodyModel, file: &mut NpzWriter) {
    let skeleton = model.skeleton();
    let parents: Vec<i32> =
        skeleton.bones().iter().map(|bone| bone.parent.map_or(-1, |parent| parent as i32)).collect();
    file.add("bone_parents", &[parents.len()], &parents);
    let axes = skeleton.axes();
    let axis_bones: Vec<i32> = axes.iter().map(|axis| axis.bone as i32).collect();
    file.add("axis_bones", &[axes.len()], &axis_bones);
    let directions: Vec<f32> =
        axes.iter().flat_map(|axis| axis.direction.to_array().map(|x| x as f32)).collect();
    file.add("axis_directions", &[axes.len(), 3], &directions);
    let limits: Vec<f32> = axes.iter().flat_map(|axis| axis.limits.map(|x| x as f32)).collect();
    file.add("axis_limits", &[axes.len(), 2], &limits);
    let skin = &model.surface.skin;
    file.add("skin_bones", &[skin.bones.len(), 4], &skin.bones.concat());
    let weights: Vec<f32> = skin.weights.iter().flatten().map(|weight| *weight as f32).collect();
    file.add("skin_weights", &[skin.weights.len(), 4], &weights);
    let mut offsets = vec![0_i32];
    let (mut vertices, mut values) = (Vec::<i32>::new(), Vec::<f32>::new());
    for row in &model.joint_regressor {
        vertices.extend(row.iter().map(|(vertex, _)| *vertex as i32));
        values.extend(row.iter().map(|(_, value)| *value as f32));
        offsets.push(vertices.len() as i32);
    }
    file.add("joint_regressor_offsets", &[offsets.len()], &offsets);
    file.add("joint_regressor_vertices", &[vertices.len()], &vertices);
    file.add("joint_regressor_values", &[values.len()], &values);
}

#[cfg(test)]
mod tests;
