//! The JSON record inside `fit.npz`: names, input frame, codes and the quality of each frame.

use glam::DMat3;
use serde::{Deserialize, Serialize};

use crate::artifacts::codes::Code;
use crate::artifacts::fitted_sequence::InputFrame;
use crate::artifacts::rigged_sequence::RiggedSequence;

#[derive(Serialize, Deserialize)]
pub(super) struct FileHeader {
    pub(super) format: String,
    pub(super) version: u32,
    #[serde(flatten)]
    pub(super) contents: serde_json::Value,
}

#[derive(Serialize, Deserialize)]
pub(super) struct FitMetadata {
    pub(super) model: ModelRecord,
    pub(super) bones: Vec<String>,
    pub(super) axes: Vec<String>,
    pub(super) landmarks: Vec<String>,
    pub(super) input_frame: InputFrameRecord,
    pub(super) codes: Vec<Code>,
    pub(super) frames: Vec<FrameRecord>,
}

#[derive(Serialize, Deserialize)]
pub(super) struct ModelRecord {
    pub(super) name: String,
    pub(super) license: String,
}

#[derive(Serialize, Deserialize)]
pub(super) struct InputFrameRecord {
    pub(super) metres_per_unit: f64,
    /// Row by row.
    pub(super) internal_from_input: [[f64; 3]; 3],
    pub(super) report: Vec<String>,
}

/// Lengths in metres, as everywhere but in the arrays; a number that is not finite is stored as null.
#[derive(Serialize, Deserialize)]
pub(super) struct FrameRecord {
    pub(super) name: String,
    pub(super) codes: Vec<Code>,
    pub(super) inlier_share: Option<f64>,
    pub(super) outside_share_5mm: Option<f64>,
    pub(super) outside_mean: Option<f64>,
    pub(super) energy: Option<f64>,
    pub(super) seconds: Option<f64>,
}

impl FitMetadata {
    /// The record of a fit.
    pub(super) fn of(fit: &RiggedSequence) -> Self {
        let (sequence, rig) = (&fit.sequence, &fit.rig);
        let finite = |value: f64| value.is_finite().then_some(value);
        Self {
            model: ModelRecord { name: rig.model_name.clone(), license: rig.model_license.clone() },
            bones: rig.skeleton.bones().iter().map(|bone| bone.name.clone()).collect(),
            axes: rig.skeleton.axes().iter().map(|axis| axis.name.clone()).collect(),
            landmarks: rig.landmarks.clone(),
            input_frame: InputFrameRecord {
                metres_per_unit: sequence.input_frame.metres_per_unit,
                internal_from_input: sequence.input_frame.internal_from_input.transpose().to_cols_array_2d(),
                report: sequence.input_frame.report.clone(),
            },
            codes: sequence.codes.clone(),
            frames: sequence
                .frames
                .iter()
                .map(|frame| FrameRecord {
                    name: frame.name.clone(),
                    codes: frame.codes.clone(),
                    inlier_share: finite(frame.inlier_share),
                    outside_share_5mm: finite(frame.outside_share_5mm),
                    outside_mean: finite(frame.outside_mean),
                    energy: finite(frame.energy),
                    seconds: finite(frame.seconds),
                })
                .collect(),
        }
    }
}

impl InputFrameRecord {
    /// The frame as the library holds it.
    pub(super) fn to_input_frame(&self) -> InputFrame {
        InputFrame {
            metres_per_unit: self.metres_per_unit,
            internal_from_input: DMat3::from_cols_array_2d(&self.internal_from_input).transpose(),
            report: self.report.clone(),
        }
    }
}
