//! All errors of one fitted sequence that numbers and figures about a benchmark are made from; no frame is left out.

use glam::DVec3;
use serde::{Deserialize, Serialize};

use super::distribution::Distribution;
use super::sequence_accuracy::{
    AccuracyError, SequenceAccuracy, SequenceTruth, centred, distances_mm, jitter, mean, sequence_accuracy,
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
    let accuracy = sequence_accuracy(fit, truth, measurements)?;
    let sequence = &fit.sequence;
    let internal = |points: &[DVec3]| -> Vec<DVec3> {
        points.iter().map(|point| sequence.input_frame.to_internal(*point)).collect()
    };
    let mut posed = Distribution::default();
    let mut frames = Vec::with_capacity(sequence.frames.len());
    let mut joints = [Vec::new(), Vec::new()];
    for (index, frame) in sequence.frames.iter().enumerate() {
        let distances = distances_mm(&fit.posed_vertices(index), &internal(&truth.posed_vertices[index]));
        posed.extend(&distances);
        let fitted_joints = fit.posed_skeleton(index).joints;
        let true_joints = internal(&truth.joints[index]);
        let own: Vec<DVec3> = frame.landmarks.iter().map(|landmark| landmark.position).collect();
        let landmarks = truth.landmarks.get(index).map(|points| internal(points)).unwrap_or_default();
        frames.push(FrameErrors {
            name: frame.name.clone(),
            posed_mean_mm: mean(&distances),
            mpjpe_mm: mean(&distances_mm(&fitted_joints, &true_joints)),
            landmarks_mm: distances_mm(&own, &landmarks),
            outside_share_5mm: Some(frame.outside_share_5mm)
                .filter(|share| share.is_finite() && !frame.codes.contains(&Code::UnreadableFrame)),
            codes: frame.codes.clone(),
            is_marked: !frame.is_ok(),
            seconds: Some(frame.seconds).filter(|seconds| seconds.is_finite() && *seconds > 0.0),
        });
        joints[0].push(fitted_joints);
        joints[1].push(true_joints);
    }
    let rest_body = centred(&sequence.rest_vertices);
    let rest_mm = distances_mm(&rest_body, &centred(&truth.rest_vertices));
    let rest_from_root_mm = distances_mm(
        &from_root(&sequence.rest_vertices, &sequence.rest_joints),
        &from_root(&truth.rest_vertices, &truth.rest_joints),
    );
    let jitter_mm = [&joints[0], &joints[1]].map(|joints| jitter(joints) * 1000.0);
    let measurements = measurement_errors(measurements);
    Ok(SequenceErrors {
        label,
        accuracy,
        posed,
        frames,
        rest_mm,
        rest_from_root_mm,
        rest_body,
        measurements,
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
