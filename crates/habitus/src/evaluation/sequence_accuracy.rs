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
    let sequence = &fit.sequence;
    same("frames", sequence.frames.len(), truth.posed_vertices.len())?;
    same("frames", sequence.frames.len(), truth.joints.len())?;
    same("vertices", sequence.rest_vertices.len(), truth.rest_vertices.len())?;
    same("joints", sequence.rest_joints.len(), truth.rest_joints.len())?;
    let (mut posed, mut joints) = (Mean::default(), Mean::default());
    let mut fitted_joints = Vec::with_capacity(truth.joints.len());
    let mut true_joints = Vec::with_capacity(truth.joints.len());
    for (frame, (vertices, joints_of_frame)) in truth.posed_vertices.iter().zip(&truth.joints).enumerate() {
        same("vertices", sequence.rest_vertices.len(), vertices.len())?;
        same("joints", sequence.rest_joints.len(), joints_of_frame.len())?;
        let internal = |points: &[DVec3]| -> Vec<DVec3> {
            points.iter().map(|point| sequence.input_frame.to_internal(*point)).collect()
        };
        posed.add_distances(&fit.posed_vertices(frame), &internal(vertices));
        let (fitted, true_ones) = (fit.posed_skeleton(frame).joints, internal(joints_of_frame));
        joints.add_distances(&fitted, &true_ones);
        fitted_joints.push(fitted);
        true_joints.push(true_ones);
    }
    let rest = distances_mm(&centred(&sequence.rest_vertices), &centred(&truth.rest_vertices));
    let stature = difference("stature", measurements)?;
    let true_jitter = jitter(&true_joints);
    Ok(SequenceAccuracy {
        posed_mean_mm: posed.value() * 1000.0,
        rest_mean_mm: mean(&rest),
        rest_under_10mm: share_under_10mm(&rest),
        mpjpe_mm: joints.value() * 1000.0,
        stature_error_mm: stature * 1000.0,
        girth_mean_error_mm: girth_error(measurements)? * 1000.0,
        jitter_ratio: (true_jitter > 0.0).then(|| jitter(&fitted_joints) / true_jitter),
    })
}

fn same(what: &'static str, fitted: usize, truth: usize) -> Result<(), AccuracyError> {
    if fitted == truth { Ok(()) } else { Err(AccuracyError::Mismatch { what, fitted, truth }) }
}

#[derive(Default)]
struct Mean {
    sum: f64,
    count: usize,
}

impl Mean {
    fn add_distances(&mut self, a: &[DVec3], b: &[DVec3]) {
        self.sum += a.iter().zip(b).map(|(a, b)| a.distance(*b)).sum::<f64>();
        self.count += a.len();
    }

    fn value(&self) -> f64 {
        self.sum / self.count.max(1) as f64
    }
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

/// Mean length of the second difference over joints and inner frames.
pub(super) fn jitter(joints: &[Vec<DVec3>]) -> f64 {
    let mut mean = Mean::default();
    for frames in joints.windows(3) {
        for ((before, here), after) in frames[0].iter().zip(&frames[1]).zip(&frames[2]) {
            mean.sum += (*before + *after - 2.0 * *here).length();
            mean.count += 1;
        }
    }
    mean.value()
}

#[cfg(test)]
mod tests;
