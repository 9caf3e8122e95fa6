//! How far a fitted sequence is from the truth.

use glam::DVec3;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::artifacts::measurements::Measurement;
use crate::artifacts::rigged_sequence::RiggedSequence;

/// The true body and motion of a sequence, in the frame and unit of its captures; the rest body in metres.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SequenceTruth {
    /// Rest vertices in model space and in the fit's topology, metres.
    pub rest_vertices: Vec<DVec3>,
    /// Rest joints in model space, metres.
    pub rest_joints: Vec<DVec3>,
    /// Vertices of the naked body, frame by frame.
    pub posed_vertices: Vec<Vec<DVec3>>,
    /// Joints, frame by frame.
    pub joints: Vec<Vec<DVec3>>,
    /// The model's landmark vertices on the naked body, frame by frame; empty where they are not known.
    pub landmarks: Vec<Vec<DVec3>>,
}

/// Why a fit and a truth cannot be compared.
#[derive(Debug, Error, PartialEq)]
pub enum AccuracyError {
    /// They speak of different things.
    #[error("the fit has {fitted} {what}, the truth {truth}: they do not belong together")]
    Mismatch {
        /// What is counted.
        what: &'static str,
        /// How many the fit has.
        fitted: usize,
        /// How many the truth has.
        truth: usize,
    },
    /// A measurement is missing on one side.
    #[error("the measurement '{name}' was not taken on both bodies")]
    MissingMeasurement {
        /// Its name.
        name: String,
    },
}

/// Errors of a fit over all its frames; no frame is left out.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SequenceAccuracy {
    /// Mean distance between corresponding vertices of the posed bodies.
    pub posed_mean_mm: f64,
    /// Mean distance between corresponding vertices of the rest bodies (P2 §6.2: s(β, Θ₀) against s(β₀, Θ₀)). Both are in
    /// the same rest pose and centred as the space centres its people: a rotation or scale would hide errors of build.
    pub rest_mean_mm: f64,
    /// Share of rest vertices less than 10 mm apart.
    pub rest_under_10mm: f64,
    /// Mean distance between corresponding joints (mean per joint position error).
    pub mpjpe_mm: f64,
    /// Absolute error of the stature.
    pub stature_error_mm: f64,
    /// Mean absolute error of the girths of chest, waist, hip, thigh and upper arm; sides count half each.
    pub girth_mean_error_mm: f64,
    /// Mean second difference of the fitted joints over that of the true joints; 1 is as smooth as the truth.
    /// None below three frames or when the true person stands still.
    pub jitter_ratio: Option<f64>,
}

/// The girths that count, each with the measurements that it is the mean of.
const GIRTHS: [&[&str]; 5] = [
    &["chest_girth"],
    &["waist_girth"],
    &["hip_girth"],
    &["left_thigh_girth", "right_thigh_girth"],
    &["left_upper_arm_girth", "right_upper_arm_girth"],
];

/// Compares a fit with the truth; `measurements` are those of the fitted and of the true rest body.
pub fn sequence_accuracy(
    fit: &RiggedSequence,
    truth: &SequenceTruth,
    measurements: [&[Measurement]; 2],
) -> Result<SequenceAccuracy, AccuracyError> {
    ComparedSequence::new(fit, truth)?.accuracy(measurements)
}

/// One frame of a fit beside the truth.
pub(super) struct ComparedFrame {
    /// Distances of corresponding vertices of the posed bodies.
    pub posed_mm: Vec<f64>,
    /// Distances of corresponding joints.
    pub joints_mm: Vec<f64>,
    /// Fitted and true joints in internal coordinates, metres.
    joints: [Vec<DVec3>; 2],
}

/// A fit beside the truth, which all errors of it are made from.
pub(super) struct ComparedSequence {
    pub frames: Vec<ComparedFrame>,
    /// Distances of corresponding vertices of the centred rest bodies.
    pub rest_mm: Vec<f64>,
}

impl ComparedSequence {
    pub fn new(fit: &RiggedSequence, truth: &SequenceTruth) -> Result<Self, AccuracyError> {
        let sequence = &fit.sequence;
        same("frames", sequence.frames.len(), truth.posed_vertices.len())?;
        same("frames", sequence.frames.len(), truth.joints.len())?;
        same("vertices", sequence.rest_vertices.len(), truth.rest_vertices.len())?;
        same("joints", sequence.rest_joints.len(), truth.rest_joints.len())?;
        let internal = |points: &[DVec3]| -> Vec<DVec3> {
            points.iter().map(|point| sequence.input_frame.to_internal(*point)).collect()
        };
        let mut frames = Vec::with_capacity(sequence.frames.len());
        for (frame, (vertices, joints)) in truth.posed_vertices.iter().zip(&truth.joints).enumerate() {
            same("vertices", sequence.rest_vertices.len(), vertices.len())?;
            same("joints", sequence.rest_joints.len(), joints.len())?;
            let joints = [fit.posed_skeleton(frame).joints, internal(joints)];
            frames.push(ComparedFrame {
                posed_mm: distances_mm(&fit.posed_vertices(frame), &internal(vertices)),
                joints_mm: distances_mm(&joints[0], &joints[1]),
                joints,
            });
        }
        let rest_mm = distances_mm(&centred(&sequence.rest_vertices), &centred(&truth.rest_vertices));
        Ok(Self { frames, rest_mm })
    }

    pub fn accuracy(&self, measurements: [&[Measurement]; 2]) -> Result<SequenceAccuracy, AccuracyError> {
        // Frames have equally many vertices and joints: the mean of their means is that of all.
        let mean_of = |distances: fn(&ComparedFrame) -> &[f64]| {
            mean(&self.frames.iter().map(|frame| mean(distances(frame))).collect::<Vec<_>>())
        };
        let [fitted_jitter, true_jitter] = self.jitter_mm();
        Ok(SequenceAccuracy {
            posed_mean_mm: mean_of(|frame| &frame.posed_mm),
            rest_mean_mm: mean(&self.rest_mm),
            rest_under_10mm: share_under_10mm(&self.rest_mm),
            mpjpe_mm: mean_of(|frame| &frame.joints_mm),
            stature_error_mm: difference("stature", measurements)? * 1000.0,
            girth_mean_error_mm: girth_error(measurements)? * 1000.0,
            jitter_ratio: (true_jitter > 0.0).then(|| fitted_jitter / true_jitter),
        })
    }

    /// Mean length of the second difference of fitted and of true joints over inner frames.
    pub fn jitter_mm(&self) -> [f64; 2] {
        [0, 1].map(|side| {
            let lengths = self.frames.windows(3).flat_map(|frames| {
                let [before, here, after] = [0, 1, 2].map(|frame: usize| &frames[frame].joints[side]);
                (0..here.len())
                    .map(|joint| (before[joint] + after[joint] - 2.0 * here[joint]).length() * 1000.0)
            });
            mean(&lengths.collect::<Vec<_>>())
        })
    }
}

fn same(what: &'static str, fitted: usize, truth: usize) -> Result<(), AccuracyError> {
    if fitted == truth { Ok(()) } else { Err(AccuracyError::Mismatch { what, fitted, truth }) }
}

/// Distances of corresponding points, mm; as many as both have.
pub(super) fn distances_mm(one: &[DVec3], other: &[DVec3]) -> Vec<f64> {
    one.iter().zip(other).map(|(a, b)| a.distance(*b) * 1000.0).collect()
}

/// A body with the mean of its vertices at the origin: where people stand in a space, whose bodies are aligned before
/// anything is learnt from them (P1 §2).
pub(super) fn centred(vertices: &[DVec3]) -> Vec<DVec3> {
    let middle = vertices.iter().sum::<DVec3>() / vertices.len().max(1) as f64;
    vertices.iter().map(|vertex| *vertex - middle).collect()
}

/// Mean of numbers; zero of none.
pub(super) fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len().max(1) as f64
}

/// Share of distances, mm, below 10 mm; zero of none.
pub(super) fn share_under_10mm(distances_mm: &[f64]) -> f64 {
    distances_mm.iter().filter(|distance| **distance < 10.0).count() as f64 / distances_mm.len().max(1) as f64
}

fn difference(name: &str, measurements: [&[Measurement]; 2]) -> Result<f64, AccuracyError> {
    let value = |list: &[Measurement]| {
        list.iter()
            .find(|measurement| measurement.name == name)
            .map(|measurement| measurement.value)
            .ok_or_else(|| AccuracyError::MissingMeasurement { name: name.into() })
    };
    Ok((value(measurements[0])? - value(measurements[1])?).abs())
}

fn girth_error(measurements: [&[Measurement]; 2]) -> Result<f64, AccuracyError> {
    let mut sum = 0.0;
    for sides in GIRTHS {
        for name in sides {
            sum += difference(name, measurements)? / sides.len() as f64;
        }
    }
    Ok(sum / GIRTHS.len() as f64)
}

#[cfg(test)]
mod tests;
