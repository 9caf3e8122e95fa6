//! All errors of one fitted sequence that numbers and figures about a benchmark are made from; no frame is left out.

use glam::DVec3;
use serde::{Deserialize, Serialize};

use super::distribution::Distribution;
use super::sequence_accuracy::{
    AccuracyError, ComparedSequence, SequenceAccuracy, SequenceTruth, centred, distances_mm, mean,
};
use crate::artifacts::codes::Code;
use crate::artifacts::measurements::{Measurement, Quantity};
use crate::artifacts::rigged_sequence::RiggedSequence;

/// What is known of a sequence besides its truth.
#[derive(Clone, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct SequenceLabel {
    /// Name of the sequence.
    pub name: String,
    /// Who it shows.
    pub subject: String,
    /// How the person is dressed: `tight`, `layered` or `wide` (P2 §6.1).
    pub style: String,
    /// What the person does.
    pub motion: String,
}

/// Errors of one frame.
#[derive(Clone, Debug, PartialEq)]
pub struct FrameErrors {
    /// Name of the frame.
    pub name: String,
    /// Mean distance between corresponding vertices of the posed bodies.
    pub posed_mean_mm: f64,
    /// Mean distance between corresponding joints.
    pub mpjpe_mm: f64,
    /// Distance of each landmark vertex from the true one; empty where the truth has no landmarks.
    pub landmarks_mm: Vec<f64>,
    /// Share of body vertices more than 5 mm outside the capture; none for a capture that could not be read.
    pub outside_share_5mm: Option<f64>,
    /// Codes that fired.
    pub codes: Vec<Code>,
    /// Whether the codes say that the body must not be used unseen.
    pub is_marked: bool,
    /// Seconds that tracking took; none where nobody measured.
    pub seconds: Option<f64>,
}

/// Error of one measurement beside what the fit said of it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MeasurementError {
    /// Name of the measurement.
    pub name: String,
    /// Fitted minus true, mm (litres for volumes).
    pub error: f64,
    /// One standard deviation as the fit states it, in the same unit.
    pub plus_minus: f64,
}

/// Errors of one sequence.
#[derive(Clone, Debug, PartialEq)]
pub struct SequenceErrors {
    /// Which sequence.
    pub label: SequenceLabel,
    /// The means of the sequence.
    pub accuracy: SequenceAccuracy,
    /// Distances of all corresponding vertices of all posed bodies.
    pub posed: Distribution,
    /// The frames in order.
    pub frames: Vec<FrameErrors>,
    /// Distance of each vertex of the centred rest bodies.
    pub rest_mm: Vec<f64>,
    /// The same with the root joints brought together instead: what a rig that hangs on its root sees.
    pub rest_from_root_mm: Vec<f64>,
    /// The fitted rest body, centred, metres: P2's own protocol compares these.
    pub rest_body: Vec<DVec3>,
    /// Measurements with a stated uncertainty.
    pub measurements: Vec<MeasurementError>,
    /// Mean second difference of fitted and of true joints, mm.
    pub jitter_mm: [f64; 2],
}

/// Compares a fit with the truth; `measurements` are those of the fitted and of the true rest body.
pub fn sequence_errors(
    label: SequenceLabel,
    fit: &RiggedSequence,
    truth: &SequenceTruth,
    measurements: [&[Measurement]; 2],
) -> Result<SequenceErrors, AccuracyError> {
    let compared = ComparedSequence::new(fit, truth)?;
    let accuracy = compared.accuracy(measurements)?;
    let jitter_mm = compared.jitter_mm();
    let sequence = &fit.sequence;
    let mut posed = Distribution::default();
    let mut frames = Vec::with_capacity(sequence.frames.len());
    for (index, (frame, compared)) in sequence.frames.iter().zip(&compared.frames).enumerate() {
        posed.extend(&compared.posed_mm);
        let own: Vec<DVec3> = frame.landmarks.iter().map(|landmark| landmark.position).collect();
        let landmarks: Vec<DVec3> = truth.landmarks.get(index).map_or_else(Vec::new, |landmarks| {
            landmarks.iter().map(|landmark| sequence.input_frame.to_internal(*landmark)).collect()
        });
        frames.push(FrameErrors {
            name: frame.name.clone(),
            posed_mean_mm: mean(&compared.posed_mm),
            mpjpe_mm: mean(&compared.joints_mm),
            landmarks_mm: distances_mm(&own, &landmarks),
            outside_share_5mm: Some(frame.outside_share_5mm)
                .filter(|share| share.is_finite() && !frame.codes.contains(&Code::UnreadableFrame)),
            codes: frame.codes.clone(),
            is_marked: !frame.is_ok(),
            seconds: Some(frame.seconds).filter(|seconds| seconds.is_finite() && *seconds > 0.0),
        });
    }
    let rest_from_root_mm = distances_mm(
        &from_root(&sequence.rest_vertices, &sequence.rest_joints),
        &from_root(&truth.rest_vertices, &truth.rest_joints),
    );
    Ok(SequenceErrors {
        label,
        accuracy,
        posed,
        frames,
        rest_mm: compared.rest_mm,
        rest_from_root_mm,
        rest_body: centred(&sequence.rest_vertices),
        measurements: measurement_errors(measurements),
        jitter_mm,
    })
}

fn from_root(vertices: &[DVec3], joints: &[DVec3]) -> Vec<DVec3> {
    let root = joints.first().copied().unwrap_or_default();
    vertices.iter().map(|vertex| *vertex - root).collect()
}

fn measurement_errors([fitted, truth]: [&[Measurement]; 2]) -> Vec<MeasurementError> {
    let of_truth = |name: &str| truth.iter().find(|measurement| measurement.name == name);
    fitted
        .iter()
        .filter_map(|measurement| {
            let shown = |value: f64| Quantity::to_display(measurement.quantity, value);
            let plus_minus = measurement.plus_minus.filter(|value| *value > 0.0)?;
            let error = measurement.value - of_truth(&measurement.name)?.value;
            Some(MeasurementError {
                name: measurement.name.clone(),
                error: shown(error),
                plus_minus: shown(plus_minus),
            })
        })
        .collect()
}

#[cfg(test)]
mod tests;
