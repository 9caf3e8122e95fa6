use glam::DVec3;

use super::{AccuracyError, SequenceTruth, sequence_accuracy};
use crate::artifacts::fixture::rigged_sequence;
use crate::artifacts::measurements::{Measurement, Quantity};
use crate::artifacts::rigged_sequence::RiggedSequence;

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

fn measured(value_of: impl Fn(&str) -> f64) -> Vec<Measurement> {
    let measurement = |name: &str| Measurement {
        name: name.into(),
        quantity: Quantity::Length,
        value: value_of(name),
        plus_minus: None,
        curve: Vec::new(),
        definition: String::new(),
    };
    NAMES.map(measurement).to_vec()
}

/// The fit itself as truth, in the unit and axes of its captures.
fn truth_of(fit: &RiggedSequence) -> SequenceTruth {
    let sequence = &fit.sequence;
    let to_input = |points: Vec<DVec3>| -> Vec<DVec3> {
        points.into_iter().map(|point| sequence.input_frame.to_input(point)).collect()
    };
    let frames = 0..sequence.frames.len();
    SequenceTruth {
        rest_vertices: sequence.rest_vertices.clone(),
        rest_joints: sequence.rest_joints.clone(),
        posed_vertices: frames.clone().map(|frame| to_input(fit.posed_vertices(frame))).collect(),
        joints: frames.map(|frame| to_input(fit.posed_skeleton(frame).joints)).collect(),
        landmarks: Vec::new(),
    }
}

#[test]
fn the_truth_itself_has_no_error_and_its_own_jitter() {
    let fit = rigged_sequence(5);
    let same = measured(|_| 1.0);
    let accuracy = sequence_accuracy(&fit, &truth_of(&fit), [&same, &same]).expect("fits");
    let errors = [accuracy.posed_mean_mm, accuracy.rest_mean_mm, accuracy.mpjpe_mm];
    assert!(errors.iter().all(|error| *error < 1e-9), "{accuracy:?}");
    assert!((accuracy.rest_under_10mm - 1.0).abs() < 1e-15);
    assert!((accuracy.jitter_ratio.expect("five frames") - 1.0).abs() < 1e-9);
}

#[test]
fn a_shift_of_the_capture_is_the_error_of_vertices_and_joints_but_not_of_the_rest_body() {
    let fit = rigged_sequence(4);
    let mut truth = truth_of(&fit);
    // 12 mm in the captures' own unit, which is the millimetre.
    let shift = DVec3::new(0.0, 12.0, 0.0);
    truth.posed_vertices.iter_mut().chain(&mut truth.joints).flatten().for_each(|point| *point += shift);
    // A rest body that stands elsewhere is the same body.
    truth.rest_vertices.iter_mut().chain(&mut truth.rest_joints).for_each(|point| point.z += 0.5);
    let same = measured(|_| 1.0);
    let accuracy = sequence_accuracy(&fit, &truth, [&same, &same]).expect("fits");
    assert!((accuracy.posed_mean_mm - 12.0).abs() < 1e-9, "{accuracy:?}");
    assert!((accuracy.mpjpe_mm - 12.0).abs() < 1e-9);
    assert!(accuracy.rest_mean_mm < 1e-9);
}

#[test]
fn the_rest_error_counts_vertices_below_ten_millimetres() {
    let fit = rigged_sequence(1);
    let mut truth = truth_of(&fit);
    let count = truth.rest_vertices.len();
    for vertex in truth.rest_vertices.iter_mut().take(count / 4) {
        vertex.x += 0.02;
    }
    let same = measured(|_| 1.0);
    let accuracy = sequence_accuracy(&fit, &truth, [&same, &same]).expect("fits");
    let moved = (count / 4) as f64 / count as f64;
    // A quarter moves by 20 mm, so the middle by 5: those are 15 mm apart and all others 5.
    assert!((accuracy.rest_mean_mm - 2.0 * 20.0 * moved * (1.0 - moved)).abs() < 1e-9);
    assert!((accuracy.rest_under_10mm - (1.0 - moved)).abs() < 1e-12);
    assert_eq!(accuracy.jitter_ratio, None, "one frame has no second difference");
}

#[test]
fn sides_share_the_weight_of_their_girth() {
    let fit = rigged_sequence(1);
    let truth = truth_of(&fit);
    let true_ones = measured(|_| 1.0);
    let fitted = measured(|name| match name {
        "stature" => 0.99,
        "hip_girth" => 1.05,
        "left_thigh_girth" => 0.90,
        _ => 1.0,
    });
    let accuracy = sequence_accuracy(&fit, &truth, [&fitted, &true_ones]).expect("fits");
    assert!((accuracy.stature_error_mm - 10.0).abs() < 1e-9);
    assert!((accuracy.girth_mean_error_mm - (50.0 + 100.0 / 2.0) / 5.0).abs() < 1e-9);
}

#[test]
fn what_does_not_belong_together_is_refused() {
    let fit = rigged_sequence(2);
    let same = measured(|_| 1.0);
    let mut truth = truth_of(&fit);
    truth.joints.pop();
    let error = sequence_accuracy(&fit, &truth, [&same, &same]).expect_err("is refused");
    assert_eq!(error, AccuracyError::Mismatch { what: "frames", fitted: 2, truth: 1 });
    let error = sequence_accuracy(&fit, &truth_of(&fit), [&same[1..], &same]).expect_err("is refused");
    assert_eq!(error, AccuracyError::MissingMeasurement { name: "stature".into() });
}
