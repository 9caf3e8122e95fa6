//! A clothing model in one `.npz` file: metres, y up.

use std::path::{Path, PathBuf};

use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::{ClothingModel, ClothingRegressor, LearningRecord};
use crate::artifacts::clothing_controls::{ClothingControls, Control, FabricSpace};
use crate::artifacts::clothing_layer::{LayerFileError, add_layer, read_arrays};
use crate::artifacts::npz::{NpzError, NpzReader, NpzWriter};
use crate::body::FeatureSet;
use crate::statistics::LinearSpace;
use crate::statistics::kernel_mixture::{KernelMixture, KernelPart};
use crate::statistics::kernel_ridge::{InputScale, Kernel, KernelRidge};
use crate::statistics::network::{NetworkRegressor, NetworkShape};
use crate::statistics::standardization::Standardization;

const FORMAT: &str = "habitus-clothing-model";
const VERSION: u32 = 1;
/// Which numbers of a fabric's table are compared by their logarithms: 1, else 0.
const FABRIC_LOGARITHMS: &str = "fabric_numbers_logarithmic";

/// Why a clothing model cannot be written or read.
#[derive(Debug, Error)]
pub enum ClothingModelError {
    /// The file cannot be read at all.
    #[error("{}: the clothing model cannot be read ({source})", path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// An array is missing or broken.
    #[error(transparent)]
    Npz(#[from] NpzError),
    /// The dressed person is broken.
    #[error(transparent)]
    Layer(#[from] LayerFileError),
    /// It is some other file.
    #[error("{}: is not a clothing model (its metadata says '{found}'); make one with habitus learn-clothing", path.display())]
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
}

#[derive(Serialize, Deserialize)]
struct Metadata {
    format: String,
    version: u32,
    feature_set: FeatureSet,
    /// Names of the regressor's inputs: features of the motion, then controls.
    inputs: Vec<String>,
    controls: Vec<Control>,
    known: Vec<(String, Vec<f64>)>,
    has_fabrics: bool,
    regressor: RegressorRecord,
    /// Names of the sequences and how many poses of `motion_pose` belong to each.
    motions: Vec<(String, usize)>,
    record: LearningRecord,
}

#[derive(Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum RegressorRecord {
    Network {
        shape: NetworkShape,
        members: usize,
    },
    Kernels {
        kernels: Vec<Kernel>,
        /// How many of the last inputs the kernels take as controls.
        #[serde(default)]
        control_count: usize,
    },
}

/// Writes the model.
pub fn write_clothing_model(path: &Path, model: &ClothingModel) -> Result<(), ClothingModelError> {
    let features = model.feature_set.features(&model.dressed.rig.skeleton).into_iter();
    let control_names = model.controls.controls.iter().map(|control| control.name.clone());
    let metadata = Metadata {
        format: FORMAT.into(),
        version: VERSION,
        feature_set: model.feature_set,
        inputs: features.map(|feature| feature.name).chain(control_names).collect(),
        controls: model.controls.controls.clone(),
        known: model.controls.known.clone(),
        has_fabrics: model.controls.fabrics.is_some(),
        regressor: RegressorRecord::of(&model.regressor),
        motions: model.motions.iter().map(|(name, poses)| (name.clone(), poses.len())).collect(),
        record: model.record.clone(),
    };
    let mut file = NpzWriter::new();
    file.add_text("metadata", &serde_json::to_string(&metadata).unwrap_or_default());
    add_layer(&mut file, "layer_metadata", &model.dressed);
    model.space.add_to(&mut file, "layer_");
    let poses: Vec<f64> = model.motions.iter().flat_map(|(_, poses)| poses.concat()).collect();
    let pose_length = model.dressed.rig.skeleton.pose_length();
    file.add("motion_pose", &[poses.len() / pose_length, pose_length], &poses);
    if let Some(fabrics) = &model.controls.fabrics {
        add_standardization(&mut file, "fabric_numbers_", &fabrics.scale);
        let is_logarithmic: Vec<f64> = fabrics
            .is_logarithmic
            .iter()
            .map(|is_logarithmic| f64::from(u8::from(*is_logarithmic)))
            .collect();
        file.add(FABRIC_LOGARITHMS, &[is_logarithmic.len()], &is_logarithmic);
        fabrics.space.add_to(&mut file, "fabric_");
    }
    match &model.regressor {
        ClothingRegressor::Network(network) => add_network(&mut file, network),
        ClothingRegressor::Kernels(kernels) => add_kernels(&mut file, kernels),
    }
    Ok(file.write(path)?)
}

/// Reads a model.
pub fn read_clothing_model(path: &Path) -> Result<ClothingModel, ClothingModelError> {
    let bytes = std::fs::read(path)
        .map_err(|source| ClothingModelError::Unreadable { path: path.to_path_buf(), source })?;
    let mut file = NpzReader::new(bytes, path)?;
    let metadata = read_metadata(&mut file, path)?;
    let dressed = read_arrays(&mut file, "layer_metadata", path)?;
    let space = LinearSpace::read_from(&mut file, "layer_")?;
    if space.sample_length() != 3 * dressed.clothing_vertex_count() {
        return Err(file.invalid("layer_mean", "does not fit the clothing's vertices".into()).into());
    }
    let fabrics = if metadata.has_fabrics {
        let scale = read_standardization(&mut file, "fabric_numbers_")?;
        // Models of before this array was written compare the numbers as they are.
        let mut is_logarithmic = vec![false; scale.width()];
        if file.contains(FABRIC_LOGARITHMS) {
            let array = file.floats(FABRIC_LOGARITHMS)?;
            file.expect_shape(FABRIC_LOGARITHMS, &array, &[Some(scale.width())])?;
            is_logarithmic = array.values.iter().map(|value| *value > 0.0).collect();
        }
        Some(FabricSpace { is_logarithmic, scale, space: LinearSpace::read_from(&mut file, "fabric_")? })
    } else {
        None
    };
    let motions = read_motions(&mut file, &metadata.motions, dressed.rig.skeleton.pose_length())?;
    let feature_count = metadata.feature_set.features(&dressed.rig.skeleton).len();
    let sizes = (feature_count + metadata.controls.len(), space.component_count());
    let regressor = match metadata.regressor {
        RegressorRecord::Network { shape, members } => {
            ClothingRegressor::Network(read_network(&mut file, shape, members, sizes)?)
        }
        RegressorRecord::Kernels { kernels, control_count } => {
            // As many controls as the model names, or none: older kernels take them as any other input.
            let control_count = control_count.min(metadata.controls.len());
            ClothingRegressor::Kernels(read_kernels(&mut file, &kernels, control_count, sizes)?)
        }
    };
    Ok(ClothingModel {
        dressed,
        space,
        feature_set: metadata.feature_set,
        controls: ClothingControls { controls: metadata.controls, fabrics, known: metadata.known },
        regressor,
        motions,
        record: metadata.record,
    })
}

/// A sequence's name and its poses.
type NamedPoses = (String, Vec<Vec<f64>>);

fn read_motions(
    file: &mut NpzReader,
    lengths: &[(String, usize)],
    pose_length: usize,
) -> Result<Vec<NamedPoses>, NpzError> {
    let array = file.floats("motion_pose")?;
    let count = lengths.iter().fold(0_usize, |sum, (_, length)| sum.saturating_add(*length));
    file.expect_shape("motion_pose", &array, &[Some(count), Some(pose_length)])?;
    let mut poses = array.values.chunks_exact(pose_length).map(<[f64]>::to_vec);
    Ok(lengths.iter().map(|(name, length)| (name.clone(), poses.by_ref().take(*length).collect())).collect())
}

/// The format and version come first: a foreign file must be told from a broken one.
fn read_metadata(file: &mut NpzReader, path: &Path) -> Result<Metadata, ClothingModelError> {
    let text = file.text("metadata")?;
    let unusable = |file: &NpzReader, reason: serde_json::Error| file.invalid("metadata", reason.to_string());
    let value: serde_json::Value = serde_json::from_str(&text).map_err(|error| unusable(file, error))?;
    let found = value["format"].as_str().unwrap_or_default();
    if found != FORMAT {
        return Err(ClothingModelError::Foreign { path: path.to_path_buf(), found: found.into() });
    }
    let version =
        value["version"].as_u64().and_then(|version| u32::try_from(version).ok()).unwrap_or(u32::MAX);
    if version > VERSION {
        return Err(ClothingModelError::Newer { path: path.to_path_buf(), found: version });
    }
    Ok(serde_json::from_value(value).map_err(|error| unusable(file, error))?)
}

impl RegressorRecord {
    fn of(regressor: &ClothingRegressor) -> Self {
        match regressor {
            ClothingRegressor::Network(network) => {
                Self::Network { shape: network.shape, members: network.members.len() }
            }
            ClothingRegressor::Kernels(mixture) => {
                let first = mixture.parts.first();
                Self::Kernels {
                    kernels: mixture.parts.iter().map(|part| part.regressor.kernel).collect(),
                    control_count: first.map_or(0, |part| part.regressor.inputs.control_count),
                }
            }
        }
    }
}

fn add_standardization(file: &mut NpzWriter, prefix: &str, scale: &Standardization) {
    file.add(&format!("{prefix}means"), &[scale.width()], &scale.means);
    file.add(&format!("{prefix}deviations"), &[scale.width()], &scale.deviations);
}

fn read_standardization(file: &mut NpzReader, prefix: &str) -> Result<Standardization, NpzError> {
    let means = file.floats(&format!("{prefix}means"))?.values;
    let key = format!("{prefix}deviations");
    let deviations = file.floats(&key)?;
    file.expect_shape(&key, &deviations, &[Some(means.len())])?;
    if deviations.values.iter().any(|deviation| *deviation <= 0.0) {
        return Err(file.invalid(&key, "holds a deviation that is not positive".into()));
    }
    Ok(Standardization { means, deviations: deviations.values })
}

fn add_network(file: &mut NpzWriter, network: &NetworkRegressor) {
    add_standardization(file, "network_input_", &network.inputs);
    add_standardization(file, "network_output_", &network.outputs);
    let shape = [network.members.len(), network.shape.parameter_count()];
    file.add("network_weights", &shape, &network.members.concat());
}

fn read_network(
    file: &mut NpzReader,
    shape: NetworkShape,
    members: usize,
    (input_count, output_count): (usize, usize),
) -> Result<NetworkRegressor, NpzError> {
    let inputs = read_standardization(file, "network_input_")?;
    let outputs = read_standardization(file, "network_output_")?;
    let is_consistent = [inputs.width(), shape.widths[0]].iter().all(|width| *width == input_count)
        && [outputs.width(), shape.widths[3]].iter().all(|width| *width == output_count)
        && shape.widths.iter().all(|width| *width < 1 << 20);
    if !is_consistent {
        return Err(file.invalid("network_weights", "belong to other inputs or outputs".into()));
    }
    let weights = file.floats("network_weights")?;
    let count = shape.parameter_count();
    file.expect_shape("network_weights", &weights, &[Some(members), Some(count)])?;
    let members = weights.values.chunks_exact(count).map(<[f64]>::to_vec).collect();
    Ok(NetworkRegressor { inputs, outputs, shape, members })
}

fn add_kernels(file: &mut NpzWriter, mixture: &KernelMixture) {
    let (rows, inputs) = mixture.inputs.shape();
    let Some(first) = mixture.parts.first().map(|part| &part.regressor) else { return };
    let (parts, outputs) = (mixture.parts.len(), first.output_means.len());
    let row_major = |matrix: &DMatrix<f64>| matrix.transpose().as_slice().to_vec();
    let all = |values: &dyn Fn(&KernelPart) -> Vec<f64>| -> Vec<f64> {
        mixture.parts.iter().flat_map(values).collect()
    };
    file.add("kernel_inputs", &[rows, inputs], &row_major(&mixture.inputs));
    file.add("kernel_input_means", &[inputs], &first.inputs.means);
    file.add("kernel_output_means", &[outputs], &first.output_means);
    file.add("kernel_input_scales", &[parts, inputs], &all(&|part| part.regressor.inputs.scales.clone()));
    file.add("kernel_dual", &[parts, rows, outputs], &all(&|part| row_major(&part.regressor.dual)));
    file.add("kernel_mixing", &[parts, outputs, outputs], &all(&|part| row_major(&part.mixing)));
}

fn read_kernels(
    file: &mut NpzReader,
    kernels: &[Kernel],
    control_count: usize,
    (input_count, output_count): (usize, usize),
) -> Result<KernelMixture, NpzError> {
    let mut read = |key: &str, shape: &[Option<usize>]| {
        let array = file.floats(key)?;
        file.expect_shape(key, &array, shape)?;
        Ok::<_, NpzError>(array)
    };
    let (parts, inputs, outputs) = (Some(kernels.len()), Some(input_count), Some(output_count));
    let kept = read("kernel_inputs", &[None, inputs])?;
    let rows = kept.shape[0];
    let means = read("kernel_input_means", &[inputs])?.values;
    let output_means = read("kernel_output_means", &[outputs])?.values;
    let scales = read("kernel_input_scales", &[parts, inputs])?.values;
    let dual = read("kernel_dual", &[parts, Some(rows), outputs])?.values;
    let mixing = read("kernel_mixing", &[parts, outputs, outputs])?.values;
    let kept = DMatrix::from_row_slice(rows, input_count, &kept.values);
    let part = |index: usize| {
        let slice = |values: &'_ [f64], length: usize| values[index * length..(index + 1) * length].to_vec();
        let scale = InputScale { means: means.clone(), scales: slice(&scales, input_count), control_count };
        let regressor = KernelRidge {
            centres: scale.columns(&kept),
            inputs: scale,
            output_means: output_means.clone(),
            kernel: kernels[index],
            dual: DMatrix::from_row_slice(rows, output_count, &slice(&dual, rows * output_count)),
        };
        let mixing = slice(&mixing, output_count * output_count);
        KernelPart { regressor, mixing: DMatrix::from_row_slice(output_count, output_count, &mixing) }
    };
    Ok(KernelMixture { parts: (0..kernels.len()).map(part).collect(), inputs: kept })
}
