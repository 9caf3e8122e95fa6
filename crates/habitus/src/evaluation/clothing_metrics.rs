//! What is measured of clothes that were learnt: the contents of `metrics.json`.

use std::collections::BTreeMap;

use glam::DVec3;
use serde::{Deserialize, Serialize};

use crate::artifacts::synthesized_sequence::Penetration;

/// Errors of a recipe on one split, in mm.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SplitErrors {
    /// On the frames that were learnt from.
    pub train_mm: f64,
    /// On the frames that were set aside.
    pub prediction_mm: f64,
}

/// What differs between a sequence that is left out and the others.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LeftOutKind {
    /// A body or a motion, or all of it.
    #[default]
    Sequence,
    /// The fabric alone is a control.
    Material,
    /// Sizes alone are controls.
    Size,
}

/// Lengths and heights of the clothing's borders, such as hems and sleeves, at rest.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct HemResponse {
    /// Values of the control.
    pub values: Vec<f64>,
    /// Length in mm of each border at each value, by the bone that carries the border.
    pub lengths_mm: BTreeMap<String, Vec<f64>>,
    /// Mean height in mm of each border at each value. Longer shorts end lower on a leg that is thinner there: their hem
    /// falls and need not grow. Absent in files of earlier versions.
    #[serde(default)]
    pub heights_mm: BTreeMap<String, Vec<f64>>,
}

/// How a number changes while a control grows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Course {
    /// It never gets smaller.
    Grows,
    /// It never gets larger, and is smaller at last.
    Falls,
    /// Neither.
    Turns,
}

impl Course {
    fn of(values: &[f64]) -> Self {
        match (values.is_sorted(), values.is_sorted_by(|a, b| a >= b)) {
            (true, _) => Self::Grows,
            (false, true) => Self::Falls,
            (false, false) => Self::Turns,
        }
    }
}

/// A border and what a control does to it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BorderChange<'a> {
    /// The border's name.
    pub border: &'a str,
    /// From the control's smallest to its largest value, in mm.
    pub change_mm: f64,
    /// What happens in between.
    pub course: Course,
}

impl HemResponse {
    /// The border whose length the control changes most.
    pub fn length_change(&self) -> Option<BorderChange<'_>> {
        largest_change(&self.lengths_mm)
    }

    /// The border whose height the control changes most.
    pub fn height_change(&self) -> Option<BorderChange<'_>> {
        largest_change(&self.heights_mm)
    }

    /// Whether a border never gets shorter as the control grows.
    pub fn grows(&self, border: &str) -> bool {
        self.lengths_mm.get(border).is_some_and(|lengths| Course::of(lengths) == Course::Grows)
    }
}

fn largest_change(borders: &BTreeMap<String, Vec<f64>>) -> Option<BorderChange<'_>> {
    let changes = borders.iter().filter_map(|(border, values)| {
        let change_mm = values.last()? - values.first()?;
        Some(BorderChange { border, change_mm, course: Course::of(values) })
    });
    changes.max_by(|a, b| a.change_mm.abs().total_cmp(&b.change_mm.abs()))
}

/// Where on the clothing a prediction is wrong: means over the frames of one sequence.
#[derive(Clone, Debug, PartialEq)]
pub struct ClothingErrorMap {
    /// The sequence.
    pub sequence: String,
    /// The captured clothing of its middle frame, metres.
    pub vertices: Vec<DVec3>,
    /// The body of that frame, metres.
    pub body: Vec<DVec3>,
    /// The body's triangles.
    pub body_faces: Vec<[u32; 3]>,
    /// The clothing's triangles.
    pub faces: Vec<[u32; 3]>,
    /// Error of each vertex in mm, by method.
    pub errors_mm: Vec<(String, Vec<f64>)>,
}

/// The contents of `metrics.json`. The names of its keys are a contract.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ClothingMetrics {
    /// Names of the sequences.
    pub sequences: Vec<String>,
    /// Frames in all.
    pub frames: usize,
    /// P3 Table 1: mean vertex position error by number of components.
    pub pca_error_mm: BTreeMap<String, f64>,
    /// The same with the poses as they were fitted.
    pub pca_error_fitted_poses_mm: BTreeMap<String, f64>,
    /// Errors by recipe and split: `paper`, `block`, and `leave_one_out` if there are several sequences.
    pub regression: BTreeMap<String, BTreeMap<String, SplitErrors>>,
    /// Prediction errors of the baselines by split.
    pub baselines: BTreeMap<String, BTreeMap<String, f64>>,
    /// Prediction errors in mm of each sequence that was left out, by method.
    pub left_out: BTreeMap<String, BTreeMap<String, f64>>,
    /// What a sequence that is left out is to those that stay: a material, a size, or a sequence of another kind.
    pub left_out_kind: LeftOutKind,
    /// How much each control moves the clothing on each bone, in mm from its smallest to its largest value.
    pub control_response_mm: BTreeMap<String, BTreeMap<String, f64>>,
    /// How long and how high each border of the clothing is as a control goes from its smallest to its largest value.
    pub hem_response: BTreeMap<String, HemResponse>,
    /// Error of each frame, in mm, of the default recipe on the block split; frames learnt from come first.
    pub frame_error_mm: Vec<f64>,
    /// Where the frames set aside begin in that list.
    pub block_start: usize,
    /// Mean angle between predicted and captured normals of the block's frames, degrees.
    pub normal_error_deg: f64,
    /// Mean difference of predicted and captured accelerations of the block's vertices, m/s².
    pub acceleration_error: f64,
    /// Clothing of the predicted block inside the body.
    pub penetration_before: Penetration,
    /// The same after it was pushed out.
    pub penetration_after: Penetration,
    /// Mean vertex position error of the block after the push-out, in mm, over the frames that were looked at.
    pub prediction_after_push_out_mm: f64,
    /// The same before.
    pub prediction_before_push_out_mm: f64,
    /// Wall-clock seconds by part; filled in by the caller, who keeps the clock.
    pub seconds: BTreeMap<String, f64>,
}
