//! A short synthetic capture with its truth, for tests of the whole stage.
#![allow(dead_code, reason = "each test file uses the part that it needs")]

use glam::DVec3;
use habitus::artifacts::fitted_sequence::FittedSequence;
use habitus::artifacts::frames::{FrameSource, FramesInMemory};
use habitus::artifacts::journal::Journal;
use habitus::artifacts::rigged_sequence::{Rig, RiggedSequence};
use habitus::body::BodyModel;
use habitus::evaluation::sequence_accuracy::{SequenceAccuracy, SequenceTruth, sequence_accuracy};
use habitus::optimize::Silent;
use habitus::stages::fit_sequence::{FitSequenceConfig, FitSequenceError, fit_sequence};
use habitus::stages::measure::{Definitions, measure};
use habitus_synthetic::sequence::{DressedSequence, DressedSequenceSettings, generate};

/// The embedded body model.
pub fn model() -> BodyModel {
    BodyModel::default_space().expect("the embedded model is valid")
}

/// Makes a sequence.
pub fn dressed(model: &BodyModel, settings: &DressedSequenceSettings) -> DressedSequence {
    generate(model, settings, &mut |_, _| {}).expect("the settings are sound")
}

/// Fits without journal, landmarks or observer.
pub fn fit(
    source: &dyn FrameSource,
    model: &BodyModel,
    config: &FitSequenceConfig,
) -> Result<FittedSequence, FitSequenceError> {
    fit_sequence(source, model, config, &[], &mut Journal::none(), &mut Silent)
}

/// The captures alone.
pub fn captures(sequence: &DressedSequence) -> FramesInMemory {
    let surface = |frame| sequence.surface(frame).expect("it is in memory");
    FramesInMemory { surfaces: (0..sequence.len()).map(surface).collect() }
}

/// Errors of a fit against the truth that the sequence was made from.
pub fn accuracy(model: &BodyModel, fitted: &FittedSequence, sequence: &DressedSequence) -> SequenceAccuracy {
    let truth = SequenceTruth {
        rest_vertices: sequence.rest_vertices.clone(),
        rest_joints: model.joints(&sequence.rest_vertices),
        posed_vertices: sequence.frames.iter().map(|frame| frame.scene.body_vertices.clone()).collect(),
        joints: sequence.frames.iter().map(|frame| frame.scene.joints.clone()).collect(),
        landmarks: sequence.frames.iter().map(|frame| frame.scene.landmarks.clone()).collect(),
    };
    let of = |vertices: &[DVec3]| {
        let definitions = Definitions::standard().expect("the standard definitions are valid");
        measure(model, vertices, &definitions).expect("a body can be measured")
    };
    let measurements = [of(&fitted.rest_vertices), of(&truth.rest_vertices)];
    let rigged = RiggedSequence { sequence: fitted.clone(), rig: Rig::of(model) };
    sequence_accuracy(&rigged, &truth, [&measurements[0], &measurements[1]]).expect("they belong together")
}

/// Mean distance of corresponding points in millimetres.
pub fn mean_distance_mm(one: &[DVec3], other: &[DVec3]) -> f64 {
    assert_eq!(one.len(), other.len());
    let sum: f64 = one.iter().zip(other).map(|(a, b)| a.distance(*b)).sum();
    1000.0 * sum / one.len() as f64
}

/// Largest distance of corresponding points in millimetres.
pub fn largest_distance_mm(one: &[DVec3], other: &[DVec3]) -> f64 {
    assert_eq!(one.len(), other.len());
    1000.0 * one.iter().zip(other).map(|(a, b)| a.distance(*b)).fold(0.0, f64::max)
}
