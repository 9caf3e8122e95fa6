//! `summary.json`: what other programs read of a run. The names of its keys are a contract.

use std::collections::BTreeMap;
use std::path::Path;

use serde::{Deserialize, Serialize};

use super::run_folder::RunFolderError;
use crate::artifacts::codes::Code;
use crate::artifacts::fitted_sequence::{FittedSequence, StartReport};
use crate::artifacts::measurements::Measurement;
use crate::artifacts::write_atomically;
use crate::evaluation::sequence_accuracy::SequenceAccuracy;

/// Wall-clock seconds by part of the work.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Seconds {
    /// From the first byte read to the last written.
    pub total: f64,
    /// Search for the first pose and the identity of the first frames.
    pub start: f64,
    /// Tracking of all frames.
    pub track: f64,
    /// Joint refinement, last poses and codes.
    pub refine: f64,
    /// Reading captures and writing results. Captures are read while others are fitted, so that part of it lies
    /// within the times above.
    pub io: f64,
}

/// The codes that fired.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct CodeSummary {
    /// Codes of the sequence as a whole.
    pub sequence: Vec<Code>,
    /// How many frames each code fired in.
    pub frames: BTreeMap<String, usize>,
    /// Names of the frames whose body must not be used unseen.
    pub failed: Vec<String>,
}

/// A measurement in the unit that people read it in.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MeasurementSummary {
    /// The value.
    pub value: f64,
    /// One standard deviation, where the identity's uncertainty is known.
    pub plus_minus: Option<f64>,
    /// mm or l.
    pub unit: String,
}

/// The contents of `summary.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Summary {
    /// The verb that made the run.
    pub verb: String,
    /// Version of the program.
    pub version: String,
    /// Number of frames.
    pub frames: usize,
    /// Number of frames whose body must not be used unseen.
    pub failed_frames: usize,
    /// The codes that fired.
    pub codes: CodeSummary,
    /// How the first pose was found.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub start: Option<StartReport>,
    /// Where the time went.
    pub seconds: Seconds,
    /// Frames over total seconds.
    pub frames_per_second: f64,
    /// Share of body vertices more than 5 mm outside the capture, bare parts included; mean over all readable frames.
    pub outside_share_5mm: f64,
    /// Mean depth of the body outside the capture over all vertices and all readable frames.
    pub outside_mean_mm: f64,
    /// Measurements by name.
    pub measurements: BTreeMap<String, MeasurementSummary>,
    /// Largest memory in use, where the system tells.
    pub peak_memory_mb: Option<f64>,
    /// Comparison with the truth, where it is known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub truth: Option<SequenceAccuracy>,
}

impl Summary {
    /// Sums up a fit. Time and memory are the caller's to measure.
    pub fn new(
        verb: &str,
        fit: &FittedSequence,
        measurements: &[Measurement],
        seconds: Seconds,
        peak_memory_mb: Option<f64>,
    ) -> Self {
        let mut codes = CodeSummary { sequence: fit.codes.clone(), ..CodeSummary::default() };
        for frame in &fit.frames {
            for code in &frame.codes {
                *codes.frames.entry(code.name().to_string()).or_default() += 1;
            }
            if !frame.is_ok() {
                codes.failed.push(frame.name.clone());
            }
        }
        let readable: Vec<_> =
            fit.frames.iter().filter(|frame| !frame.codes.contains(&Code::UnreadableFrame)).collect();
        let count = readable.len().max(1) as f64;
        Self {
            verb: verb.into(),
            version: env!("CARGO_PKG_VERSION").into(),
            frames: fit.frames.len(),
            failed_frames: codes.failed.len(),
            codes,
            start: fit.start.clone(),
            seconds,
            frames_per_second: fit.frames.len() as f64 / seconds.total.max(1e-9),
            outside_share_5mm: readable.iter().map(|frame| frame.outside_share_5mm).sum::<f64>() / count,
            outside_mean_mm: readable.iter().map(|frame| frame.outside_mean).sum::<f64>() / count * 1000.0,
            measurements: measurements.iter().map(measurement_summary).collect(),
            peak_memory_mb,
            truth: None,
        }
    }

    /// Whether every frame may be used and no code says that the whole is no person.
    pub fn is_ok(&self) -> bool {
        self.failed_frames == 0 && !self.codes.sequence.iter().any(|code| code.is_failure())
    }

    /// Writes `summary.json`.
    pub fn write(&self, path: &Path) -> Result<(), RunFolderError> {
        let unusable = |source| RunFolderError::Unusable { path: path.to_path_buf(), source };
        let mut text = serde_json::to_string_pretty(self).map_err(|error| unusable(error.into()))?;
        text.push('\n');
        write_atomically(path, text.as_bytes()).map_err(unusable)
    }

    /// Reads `summary.json`.
    pub fn read(path: &Path) -> Result<Self, RunFolderError> {
        let unusable = |source| RunFolderError::Unusable { path: path.to_path_buf(), source };
        let text = std::fs::read_to_string(path).map_err(unusable)?;
        serde_json::from_str(&text).map_err(|error| unusable(error.into()))
    }
}

fn measurement_summary(measurement: &Measurement) -> (String, MeasurementSummary) {
    let shown = |value: f64| measurement.quantity.to_display(value);
    let summary = MeasurementSummary {
        value: shown(measurement.value),
        plus_minus: measurement.plus_minus.map(shown),
        unit: measurement.quantity.display_unit().into(),
    };
    (measurement.name.clone(), summary)
}
