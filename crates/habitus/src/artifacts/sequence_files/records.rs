//! The JSON record inside `fit.npz`: names, input frame, codes and the quality of each frame.

use glam::DMat3;
use serde::{Deserialize, Serialize};

use crate::artifacts::codes::Code;
use crate::artifacts::fitted_sequence::{InputFrame, StartReport};
use crate::artifacts::rig_file::RigNames;
use crate::artifacts::rigged_sequence::RiggedSequence;

#[derive(Serialize, Deserialize)]
pub(in crate::artifacts) struct FileHeader {
    pub(in crate::artifacts) format: String,
    pub(in crate::artifacts) version: u32,
    #[serde(flatten)]
    pub(in crate::artifacts) contents: serde_json::Value,
}

#[derive(Serialize, Deserialize)]
pub(super) struct FitMetadata {
    #[serde(flatten)]
    pub(super) rig: RigNames,
    pub(super) input_frame: InputFrameRecord,
    pub(super) codes: Vec<Code>,
    /// Absent in files of earlier versions.
    #[serde(default)]
    pub(super) start: Option<StartReport>,
    pub(super) frames: Vec<FrameRecord>,
}

#[derive(Serialize, Deserialize)]
pub(in crate::artifacts) struct InputFrameRecord {
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
    /// Absent in files of earlier versions.
    #[serde(default)]
    pub(super) clearance_percentiles: Option<[f64; 5]>,
    pub(super) energy: Option<f64>,
    pub(super) seconds: Option<f64>,
}

impl FitMetadata {
    /// The record of a fit.
    pub(super) fn of(fit: &RiggedSequence) -> Self {
        let sequence = &fit.sequence;
        let finite = |value: f64| value.is_finite().then_some(value);
        Self {
            rig: RigNames::of(&fit.rig),
            input_frame: InputFrameRecord::of(&sequence.input_frame),
            codes: sequence.codes.clone(),
            start: sequence.start.clone(),
            frames: sequence
                .frames
                .iter()
                .map(|frame| FrameRecord {
                    name: frame.name.clone(),
                    codes: frame.codes.clone(),
                    inlier_share: finite(frame.inlier_share),
                    outside_share_5mm: finite(frame.outside_share_5mm),
                    outside_mean: finite(frame.outside_mean),
                    clearance_percentiles: frame
                        .clearance_percentiles
                        .filter(|values| values.iter().all(|value| value.is_finite())),
                    energy: finite(frame.energy),
                    seconds: finite(frame.seconds),
                })
                .collect(),
        }
    }
}

impl InputFrameRecord {
    /// The record of an input frame.
    pub(in crate::artifacts) fn of(frame: &InputFrame) -> Self {
        Self {
            metres_per_unit: frame.metres_per_unit,
            internal_from_input: frame.internal_from_input.transpose().to_cols_array_2d(),
            report: frame.report.clone(),
        }
    }

    /// The frame as the library holds it.
    pub(in crate::artifacts) fn to_input_frame(&self) -> InputFrame {
        InputFrame {
            metres_per_unit: self.metres_per_unit,
            internal_from_input: DMat3::from_cols_array_2d(&self.internal_from_input).transpose(),
            report: self.report.clone(),
        }
    }
}
