use glam::DVec3;

use super::{SequenceLabel, sequence_errors};
use crate::artifacts::codes::Code;
use crate::artifacts::fixture::rigged_sequence;
use crate::artifacts::measurements::{Measurement, Quantity};
use crate::artifacts::rigged_sequence::RiggedSequence;
use crate::evaluation::sequence_accuracy::SequenceTruth;

const NAMES: [&str; 8] = [
    "stature",
    "chest_girth",
    "waist_girth",
    "hip_girth",
    "left_thigh_girth",
    "right_thigh_girth",
    "left_upper_arm_girth",
    "right_upper_arm_girth",
];

fn measured(value: f64, plus_minus: Option<f64>) -> Vec<Measurement> {
    let measurement = |name: &str| Measurement {
        name: name.into(),
        quantity: Quantity::Length,
        value,
        plus_minus,
        curve: Vec::new(),
        definition: String::new(),
    };
    NAMES.map(measurement).to_vec()
}

/// The fit itself as truth, every point shifted in the unit of the captures.
fn shifted_truth(fit: &RiggedSequence, shift: DVec3) -> SequenceTruth {
    let sequence = &fit.sequence;
    let to_input = |points: Vec<DVec3>| -> Vec<DVec3> {
        points.into_iter().map(|point| sequence.input_frame.to_input(point) + shift).collect()
    };
    let frames = 0..sequence.frames.len();
    SequenceTruth {
        rest_vertices: sequence.rest_vertices.clone(),
        rest_joints: sequence.rest_joints.clone(),
        posed_vertices: frames.clone().map(|frame| to_input(fit.posed_vertices(frame))).collect(),
        joints: frames.clone().map(|frame| to_input(fit.posed_skeleton(frame).joints)).collect(),
        landmarks: frames
            .map(|frame| {
                let landmarks = &sequence.frames[frame].landmarks;
                to_input(landmarks.iter().map(|landmark| landmark.position).collect())
            })
            .collect(),
    }
}

#[test]
fn a_shift_is_the_error_of_every_vertex_joint_and_landmark_and_of_no_rest_vertex() {
    let fit = rigged_sequence(3);
    // 7 mm in the captures' own unit, which is the millimetre.
    let truth = shifted_truth(&fit, DVec3::new(0.0, 0.0, 7.0));
    let measurements = [measured(1.0, Some(0.01)), measured(0.98, None)];
    let errors =
        sequence_errors(SequenceLabel::default(), &fit, &truth, [&measurements[0], &measurements[1]])
            .expect("they belong together");
    assert!((errors.posed.mean() - 7.0).abs() < 1e-9);
    for frame in &errors.frames {
        assert!((frame.posed_mean_mm - 7.0).abs() < 1e-9 && (frame.mpjpe_mm - 7.0).abs() < 1e-9);
        assert_eq!(frame.landmarks_mm.len(), fit.rig.landmarks.len());
        assert!(frame.landmarks_mm.iter().all(|error| (error - 7.0).abs() < 1e-9));
    }
    assert!(errors.rest_mm.iter().all(|error| *error < 1e-9));
    assert!((errors.jitter_mm[0] - errors.jitter_mm[1]).abs() < 1e-9);
    assert_eq!(errors.measurements.len(), NAMES.len());
    let stature = &errors.measurements[0];
    assert!((stature.error - 20.0).abs() < 1e-9 && (stature.plus_minus - 10.0).abs() < 1e-12);
}

#[test]
fn a_frame_is_marked_by_codes_that_fail_it_only() {
    let mut fit = rigged_sequence(2);
    fit.sequence.frames[0].codes = vec![Code::JointAtLimit];
    fit.sequence.frames[1].codes = vec![Code::JointAtLimit, Code::TooFewInliers];
    let truth = shifted_truth(&fit, DVec3::ZERO);
    let same = measured(1.0, None);
    let errors = sequence_errors(SequenceLabel::default(), &fit, &truth, [&same, &same]).expect("fits");
    assert!(!errors.frames[0].is_marked && errors.frames[1].is_marked);
    assert!(errors.measurements.is_empty(), "no ± was stated");
}

#[test]
fn a_root_joint_that_is_found_elsewhere_is_no_error_of_the_rest_body_and_one_from_the_root() {
    let fit = rigged_sequence(1);
    let mut truth = shifted_truth(&fit, DVec3::ZERO);
    truth.rest_joints[0].y += 0.012;
    let same = measured(1.0, None);
    let errors = sequence_errors(SequenceLabel::default(), &fit, &truth, [&same, &same]).expect("fits");
    assert!(errors.rest_mm.iter().all(|error| *error < 1e-9));
    assert!(errors.rest_from_root_mm.iter().all(|error| (error - 12.0).abs() < 1e-9));
}
