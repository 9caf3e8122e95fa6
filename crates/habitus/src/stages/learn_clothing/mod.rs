//! How clothes move: components of the layer, and what drives them (P3 §3.2, 3.3).
//!
//! ```text
//! layers ──settle_poses──▶ samples ──LinearSpace──▶ amounts ┐
//!    └──────── motion features, controls ───────────────────┴─ regression ──▶ ClothingModel
//! ```

pub mod config;
mod regression;
mod settle_poses;
#[cfg(test)]
mod tests;

use habitus_optimize::{Event, Flow, Observer};
use nalgebra::DMatrix;
use rayon::prelude::*;
use thiserror::Error;

pub use config::{ClothingRecipe, ClothingSplit, LearnClothingConfig};
pub use regression::Baseline;

use crate::artifacts::clothing_controls::{ClothingControls, ControlsError, ParameterTable};
use crate::artifacts::clothing_layer::ClothingLayer;
use crate::artifacts::clothing_model::{
    ClothingModel, ClothingRegressor, LearningRecord, millimetres_per_coefficient, with_controls,
};
use crate::body::FeatureSet;
use crate::evaluation::layer_reconstruction::{PosedLayer, mean_error_mm};
use crate::statistics::kernel_ridge::KernelRidgeError;
use crate::statistics::network::NetworkError;
use crate::statistics::{LinearSpace, LinearSpaceError, LinearSpaceSettings, RandomStream, SampleMatrix};
use config::VertexWeights;
use regression::{learn_regressor, relative_areas};

/// Name of the stage in progress events.
const STAGE: &str = "learn clothing";

/// Why no model can be learnt.
#[derive(Debug, Error)]
pub enum LearnClothingError {
    /// Nothing to learn from.
    #[error("no layer to learn from: give at least one run with a clothing layer")]
    NoLayers,
    /// Layers of different outfits or topologies.
    #[error(
        "the layer of '{name}' has another {what} than that of '{first}': extract all sequences of an outfit together, \
         so that they share it"
    )]
    OtherTopology {
        /// The sequence.
        name: String,
        /// The first sequence.
        first: String,
        /// What differs.
        what: &'static str,
    },
    /// Too few frames remain to learn from.
    #[error("{found} frames to learn from are too few; at least 5 are needed")]
    TooFewFrames {
        /// How many there are.
        found: usize,
    },
    /// A setting that cannot be meant.
    #[error("{name} is {value}; it must lie above 0 and below 1")]
    BadShare {
        /// The setting.
        name: &'static str,
        /// Its value.
        value: f64,
    },
    /// No relevance of a kind of input is allowed.
    #[error("relevance.{name} is empty: name at least one value")]
    NoRelevance {
        /// The empty list.
        name: &'static str,
    },
    /// The components cannot be learnt.
    #[error("the components of the layer cannot be learnt: {0}")]
    Space(#[from] LinearSpaceError),
    /// The network cannot be trained.
    #[error("the network cannot be trained: {0}")]
    Network(#[from] NetworkError),
    /// The kernel regression failed.
    #[error("the kernel regression failed: {0}")]
    Kernels(#[from] KernelRidgeError),
    /// The controls cannot be used.
    #[error(transparent)]
    Controls(#[from] ControlsError),
    /// The observer asked to stop.
    #[error("learning was stopped")]
    Stopped,
}

/// Layers of one outfit, ready to be learnt from: settled poses and one row for each frame.
pub struct PreparedLayers {
    /// Names of the sequences.
    pub names: Vec<String>,
    /// Their layers, with settled poses.
    pub layers: Vec<ClothingLayer>,
    /// Layer and frame of each row.
    pub rows: Vec<(usize, usize)>,
    /// Offsets, one sample for each row, in metres.
    pub samples: SampleMatrix,
    /// Controls besides the motion.
    pub controls: ClothingControls,
    vertex_weights: Vec<f64>,
}

impl PreparedLayers {
    /// Checks that the layers belong together, settles their poses and stacks their offsets.
    pub fn new(
        names: Vec<String>,
        mut layers: Vec<ClothingLayer>,
        parameters: Option<&ParameterTable>,
        config: &LearnClothingConfig,
    ) -> Result<Self, LearnClothingError> {
        check_topologies(&names, &layers)?;
        let controls = match parameters {
            Some(table) => ClothingControls::learn(table, &names, config.fabric_components)?,
            None => ClothingControls::default(),
        };
        settle_poses::settle_poses(&mut layers, &config.settle);
        let rows: Vec<(usize, usize)> = layers
            .iter()
            .enumerate()
            .flat_map(|(layer, content)| (0..content.frames.len()).map(move |frame| (layer, frame)))
            .collect();
        let mut samples = SampleMatrix::with_capacity(3 * layers[0].clothing_vertex_count(), rows.len());
        for (layer, frame) in &rows {
            let offsets: Vec<f64> =
                layers[*layer].frame_offsets(*frame).iter().copied().map(f64::from).collect();
            samples.push(&offsets);
        }
        let vertex_weights = match config.vertex_weights {
            VertexWeights::Equal => Vec::new(),
            VertexWeights::Area => {
                let areas = relative_areas(&layers[0].clothing_vertices(0), &layers[0].clothing_faces);
                areas.into_iter().flat_map(|area| [area; 3]).collect()
            }
        };
        Ok(Self { names, layers, rows, samples, controls, vertex_weights })
    }

    /// Components of the offsets of some rows.
    pub fn space(&self, rows: &[usize], components: usize) -> Result<LinearSpace, LearnClothingError> {
        let settings = LinearSpaceSettings::with_components(components);
        let samples;
        let samples = if rows.len() == self.rows.len() {
            &self.samples
        } else {
            samples = self.samples.subset(rows);
            &samples
        };
        Ok(LinearSpace::learn_weighted(samples, &self.vertex_weights, &settings)?)
    }

    /// Features and controls of all rows.
    pub fn features(&self, set: FeatureSet) -> DMatrix<f64> {
        let mut blocks = Vec::new();
        for (name, layer) in self.names.iter().zip(&self.layers) {
            let poses: Vec<&[f64]> = layer.frames.iter().map(|frame| frame.pose.as_slice()).collect();
            let times: Vec<f64> = (0..poses.len()).map(|frame| layer.time_of(frame)).collect();
            let motion = set.of_motion(&layer.rig.skeleton, &poses, &times);
            let controls = self.controls.of_sequence(name).unwrap_or_default();
            blocks.push(with_controls(&motion, &vec![controls; poses.len()]));
        }
        let rows: Vec<_> = blocks.iter().flat_map(DMatrix::row_iter).collect();
        DMatrix::from_rows(&rows)
    }

    /// Amounts of the components in millimetres, for some rows.
    pub fn amounts(&self, space: &LinearSpace, rows: &[usize]) -> DMatrix<f64> {
        let scale = millimetres_per_coefficient(space);
        let mut amounts = DMatrix::zeros(rows.len(), scale.len());
        for (to, row) in rows.iter().enumerate() {
            let coefficients = space.coefficients(self.samples.sample(*row));
            for (k, (coefficient, scale)) in coefficients.iter().zip(&scale).enumerate() {
                amounts[(to, k)] = coefficient * scale;
            }
        }
        amounts
    }

    /// Offsets in metres of amounts, one list for each row.
    pub fn offsets_of_amounts(&self, space: &LinearSpace, amounts: &DMatrix<f64>) -> Vec<Vec<f64>> {
        let scale = millimetres_per_coefficient(space);
        let instance = |row: usize| {
            let values = amounts.row(row);
            let coefficients: Vec<f64> = values
                .iter()
                .zip(&scale)
                .map(|(amount, scale)| amount / scale.max(f64::MIN_POSITIVE))
                .collect();
            space.instance(&coefficients)
        };
        (0..amounts.nrows()).into_par_iter().map(instance).collect()
    }

    /// Mean vertex position error in mm of amounts, one row for each of `rows`.
    pub fn error_of_amounts(&self, space: &LinearSpace, rows: &[usize], amounts: &DMatrix<f64>) -> f64 {
        let offsets = self.offsets_of_amounts(space, amounts);
        self.error_of_offsets(rows, |row| offsets[row].clone())
    }

    /// Mean vertex position error in mm of the best reconstruction in a space with some of its components.
    pub fn error_of_space(&self, space: &LinearSpace, rows: &[usize]) -> f64 {
        self.error_of_offsets(rows, |row| space.project(self.samples.sample(rows[row])))
    }

    fn error_of_offsets(&self, rows: &[usize], offsets: impl Fn(usize) -> Vec<f64> + Sync) -> f64 {
        let posed: Vec<PosedLayer<'_>> = self.layers.iter().map(PosedLayer::new).collect();
        let frames: Vec<(usize, usize)> = rows.iter().map(|row| self.rows[*row]).collect();
        mean_error_mm(&posed, &frames, offsets)
    }

    /// Rows to learn from and rows set aside.
    pub fn split(
        &self,
        config: &LearnClothingConfig,
    ) -> Result<(Vec<usize>, Vec<usize>), LearnClothingError> {
        for (name, value) in
            [("test_share", config.test_share), ("validation_share", config.validation_share)]
        {
            if !(value > 0.0 && value < 1.0) {
                return Err(LearnClothingError::BadShare { name, value });
            }
        }
        let mut test = Vec::new();
        let mut start = 0;
        for (name, layer) in self.names.iter().zip(&self.layers) {
            let count = layer.frames.len();
            let left_out = (config.test_share * count as f64).round() as usize;
            match config.split {
                ClothingSplit::Paper => {
                    let mut random = RandomStream::named(config.seed, name);
                    test.extend(random.choose(left_out, count).into_iter().map(|frame| start + frame));
                }
                ClothingSplit::Block => test.extend(start + count - left_out..start + count),
            }
            start += count;
        }
        test.sort_unstable();
        let train: Vec<usize> = (0..self.rows.len()).filter(|row| test.binary_search(row).is_err()).collect();
        if train.len() < 5 {
            Err(LearnClothingError::TooFewFrames { found: train.len() })
        } else {
            Ok((train, test))
        }
    }

    /// Components that the settings ask for, if the rows have as many.
    pub fn component_count(&self, config: &LearnClothingConfig) -> usize {
        if self.layers.len() > 1 { config.components_of_several } else { config.components }
    }
}

/// A regressor that was learnt from some rows, and the space that it speaks of.
pub struct Learnt {
    /// Components.
    pub space: LinearSpace,
    /// From features to amounts.
    pub regressor: ClothingRegressor,
}

/// Learns components from `space_rows` and a regressor from `rows`.
pub fn learn_rows(
    prepared: &PreparedLayers,
    space_rows: &[usize],
    rows: &[usize],
    config: &LearnClothingConfig,
) -> Result<Learnt, LearnClothingError> {
    let space = prepared.space(space_rows, prepared.component_count(config))?;
    let regressor = learn_regressor(prepared, &space, rows, config)?;
    Ok(Learnt { space, regressor })
}

/// Mean vertex position error in mm of a regressor on some rows.
pub fn regression_error(
    prepared: &PreparedLayers,
    learnt: &Learnt,
    rows: &[usize],
    recipe: ClothingRecipe,
) -> f64 {
    let features = prepared.features(recipe.feature_set()).select_rows(rows);
    prepared.error_of_amounts(&learnt.space, rows, &learnt.regressor.predict(&features))
}

/// Learns a model of the clothing of one outfit from the layers of one or several sequences.
///
/// The errors of its record are those of a regressor that did not see the frames set aside. The model of the default
/// recipe is then learnt from all frames; that of `paper2018` stays as it was measured.
pub fn learn_clothing(
    names: Vec<String>,
    layers: Vec<ClothingLayer>,
    parameters: Option<&ParameterTable>,
    config: &LearnClothingConfig,
    observer: &mut dyn Observer,
) -> Result<ClothingModel, LearnClothingError> {
    let mut progress =
        |done: usize| match observer.on_event(&Event::Progress { stage: STAGE, done, total: 3 }) {
            Flow::Continue => Ok(()),
            Flow::Stop => Err(LearnClothingError::Stopped),
        };
    let prepared = PreparedLayers::new(names, layers, parameters, config)?;
    progress(1)?;
    let (train, test) = prepared.split(config)?;
    let all: Vec<usize> = (0..prepared.rows.len()).collect();
    // P3 learns the components from all frames; a block that is set aside must not be in them.
    let space_rows = if config.split == ClothingSplit::Paper { &all } else { &train };
    let learnt = learn_rows(&prepared, space_rows, &train, config)?;
    let record = LearningRecord {
        recipe: name_of(&config.recipe),
        split: name_of(&config.split),
        sequences: prepared.names.clone(),
        frames: all.len(),
        train_mm: regression_error(&prepared, &learnt, &train, config.recipe),
        prediction_mm: regression_error(&prepared, &learnt, &test, config.recipe),
    };
    progress(2)?;
    let learnt = match config.recipe {
        ClothingRecipe::Paper2018 => learnt,
        ClothingRecipe::Default => learn_rows(&prepared, &all, &all, config)?,
    };
    progress(3)?;
    let PreparedLayers { names, mut layers, controls, .. } = prepared;
    let poses = |layer: &ClothingLayer| layer.frames.iter().map(|frame| frame.pose.clone()).collect();
    let motions = names.into_iter().zip(layers.iter().map(poses)).collect();
    let mut dressed = layers.swap_remove(0);
    dressed.frames.clear();
    dressed.offsets.clear();
    Ok(ClothingModel {
        dressed,
        space: learnt.space,
        feature_set: config.recipe.feature_set(),
        controls,
        regressor: learnt.regressor,
        motions,
        record,
    })
}

/// Name of an option as it stands in settings.
pub fn name_of(option: &impl serde::Serialize) -> String {
    serde_json::to_value(option).ok().and_then(|value| value.as_str().map(str::to_owned)).unwrap_or_default()
}

fn check_topologies(names: &[String], layers: &[ClothingLayer]) -> Result<(), LearnClothingError> {
    let Some(first) = layers.first() else { return Err(LearnClothingError::NoLayers) };
    for (name, layer) in names.iter().zip(layers) {
        let differs = |what| {
            Err(LearnClothingError::OtherTopology { name: name.clone(), first: names[0].clone(), what })
        };
        if layer.clothing_faces != first.clothing_faces {
            return differs("surface");
        }
        if layer.association.body_vertices != first.association.body_vertices {
            return differs("association with the body");
        }
        if layer.rig.model_name != first.rig.model_name {
            return differs("body model");
        }
    }
    let frames = layers.iter().map(|layer| layer.frames.len()).sum();
    if frames < 5 { Err(LearnClothingError::TooFewFrames { found: frames }) } else { Ok(()) }
}
