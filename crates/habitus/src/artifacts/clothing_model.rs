//! The result of `learn_clothing`: how the clothes of a person, or of several, move (P3 §3.2, 3.3).
//!
//! ```text
//! motion, controls ──features──▶ regressor ──▶ amounts of the components ──space──▶ offsets ──pose──▶ clothing
//! ```

mod file;

use glam::DVec3;
use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};

pub use file::{ClothingModelError, read_clothing_model, write_clothing_model};

use super::clothing_controls::ClothingControls;
use super::clothing_layer::{ClothingLayer, pose_offsets};
use super::rigged_sequence::FrameRate;
use crate::body::{BlendedSkin, Carrier, FeatureSet};
use crate::statistics::LinearSpace;
use crate::statistics::kernel_mixture::KernelMixture;
use crate::statistics::network::NetworkRegressor;

/// What turns features into amounts of the layer's components.
#[derive(Clone, Debug, PartialEq)]
pub enum ClothingRegressor {
    /// P3 §3.3: a network, or the mean of several.
    Network(NetworkRegressor),
    /// Kernel ridge regression for each part of the body.
    Kernels(KernelMixture),
}

impl ClothingRegressor {
    /// Amounts of the components in millimetres, one row for each row of features and controls.
    pub fn predict(&self, features: &DMatrix<f64>) -> DMatrix<f64> {
        match self {
            Self::Network(network) => network.predict(features),
            Self::Kernels(kernels) => kernels.predict(features),
        }
    }
}

/// How a model was learnt, and how well.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LearningRecord {
    /// The recipe's name.
    pub recipe: String,
    /// How frames were set aside for testing.
    pub split: String,
    /// Names of the sequences.
    pub sequences: Vec<String>,
    /// Frames in all.
    pub frames: usize,
    /// Mean vertex position error of the frames that were learnt from, in mm.
    pub train_mm: f64,
    /// The same of the frames that were set aside.
    pub prediction_mm: f64,
}

/// A model of the clothing layer of one outfit.
#[derive(Clone, Debug, PartialEq)]
pub struct ClothingModel {
    /// The dressed person: body, association and faces, without frames.
    pub dressed: ClothingLayer,
    /// Components of the stacked offsets.
    pub space: LinearSpace,
    /// What describes the motion.
    pub feature_set: FeatureSet,
    /// Controls besides the motion.
    pub controls: ClothingControls,
    /// From features and controls to amounts of the components.
    pub regressor: ClothingRegressor,
    /// Poses of the sequences that were learnt from, settled on their surfaces, by the sequences' names.
    pub motions: Vec<(String, Vec<Vec<f64>>)>,
    /// How the model was learnt.
    pub record: LearningRecord,
}

/// Amounts are coefficients in millimetres of root mean square vertex displacement: their squared errors add up to the
/// squared error of the vertices.
pub fn millimetres_per_coefficient(space: &LinearSpace) -> Vec<f64> {
    let vertex_count = (space.sample_length() / 3).max(1) as f64;
    // Weighted bases are orthonormal in the weights, which sum to the number of coordinates.
    space.standard_deviations().iter().map(|deviation| deviation * 1000.0 / vertex_count.sqrt()).collect()
}

impl ClothingModel {
    /// Frames per second of the sequences that the model was learnt from; speeds are those of this rate.
    pub fn frame_rate(&self) -> FrameRate {
        self.dressed.frame_rate
    }

    /// Coefficients of the layer's components (in standard deviations) for a motion, one row a frame.
    ///
    /// `poses` in metres and radians, `times` in seconds, `controls` one value for each control.
    pub fn coefficients(&self, poses: &[&[f64]], times: &[f64], controls: &[f64]) -> DMatrix<f64> {
        assert_eq!(controls.len(), self.controls.len(), "one value for each control");
        let motion = self.feature_set.of_motion(&self.dressed.rig.skeleton, poses, times);
        let features = with_controls(&motion, &vec![controls; poses.len()]);
        let mut amounts = self.regressor.predict(&features);
        for (mut column, scale) in amounts.column_iter_mut().zip(millimetres_per_coefficient(&self.space)) {
            column /= if scale > 0.0 { scale } else { 1.0 };
        }
        amounts
    }

    /// Stacked offsets of coefficients, in metres in rest space.
    pub fn offsets(&self, coefficients: &[f64]) -> Vec<f32> {
        self.space.instance(coefficients).into_iter().map(|value| value as f32).collect()
    }

    /// Bone weights of the clothing.
    pub fn skin(&self) -> BlendedSkin {
        self.dressed.association.blended_skin(&self.dressed.rig)
    }
}

/// Features of the motion followed by the controls of each frame.
pub fn with_controls(motion: &DMatrix<f64>, controls: &[&[f64]]) -> DMatrix<f64> {
    let (rows, width) = motion.shape();
    let control_count = controls.first().map_or(0, |values| values.len());
    DMatrix::from_fn(rows, width + control_count, |row, k| {
        if k < width { motion[(row, k)] } else { controls[row][k - width] }
    })
}

/// Posed clothing of coefficients, in metres.
pub fn pose_clothing(model: &ClothingModel, carriers: &[Carrier], coefficients: &[f64]) -> Vec<DVec3> {
    pose_offsets(carriers, &model.offsets(coefficients))
}
