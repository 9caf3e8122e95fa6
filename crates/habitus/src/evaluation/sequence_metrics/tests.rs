use glam::DVec3;

use super::{SequenceMetricsSettings, benchmark_metrics, cumulative, mean_rest_errors_mm};
use crate::evaluation::distribution::Distribution;
use crate::evaluation::sequence_accuracy::SequenceAccuracy;
use crate::evaluation::sequence_errors::{FrameErrors, MeasurementError, SequenceErrors, SequenceLabel};

fn frame(mpjpe_mm: f64, is_marked: bool) -> FrameErrors {
    FrameErrors {
        name: format!("{mpjpe_mm}"),
        posed_mean_mm: mpjpe_mm,
        mpjpe_mm,
        landmarks_mm: vec![mpjpe_mm],
        outside_share_5mm: Some(0.02),
        codes: Vec::new(),
        is_marked,
        seconds: Some(mpjpe_mm / 100.0),
    }
}

/// A person of two vertices, the second of them `size` metres from the root.
fn sequence(style: &str, motion: &str, size: f64, frames: Vec<FrameErrors>) -> SequenceErrors {
    let mut posed = Distribution::default();
    frames.iter().for_each(|frame| posed.extend(&[frame.posed_mean_mm]));
    SequenceErrors {
        label: SequenceLabel {
            name: format!("{style}_{motion}"),
            subject: "one".into(),
            style: style.into(),
            motion: motion.into(),
        },
        accuracy: SequenceAccuracy {
            posed_mean_mm: 1.0,
            rest_mean_mm: 1.0,
            rest_under_10mm: 1.0,
            mpjpe_mm: 1.0,
            stature_error_mm: 4.0,
            girth_mean_error_mm: size * 100.0,
            jitter_ratio: None,
        },
        posed,
        frames,
        rest_mm: vec![0.0, size * 10.0],
        rest_from_root_mm: vec![size * 5.0; 2],
        rest_body: vec![DVec3::ZERO, DVec3::Y * size],
        measurements: vec![
            MeasurementError { name: "a".into(), error: -3.0, plus_minus: 2.0 },
            MeasurementError { name: "b".into(), error: 1.0, plus_minus: 2.0 },
        ],
        jitter_mm: [3.0, 2.0],
    }
}

#[test]
fn no_frame_is_left_out_and_every_wrong_one_is_marked_or_missed() {
    let frames = vec![frame(10.0, false), frame(20.0, true), frame(300.0, true), frame(150.0, false)];
    let found =
        benchmark_metrics(&[sequence("wide", "walk", 1.0, frames)], &SequenceMetricsSettings::default());
    let overall = &found.overall;
    assert_eq!(overall.frames, 4);
    assert!((overall.mpjpe_mm - 120.0).abs() < 1e-12 && (overall.posed_mean_mm - 120.0).abs() < 1e-12);
    assert_eq!((overall.failure_rate, overall.false_alarm_rate, overall.miss_rate), (0.75, 0.25, 0.25));
    assert_eq!(found.misses.len(), 1);
    assert_eq!(found.misses[0].mpjpe_mm, 150.0);
    assert_eq!(overall.seconds_per_frame.expect("measured").p95, 3.0);
    assert!((overall.jitter_ratio.expect("moves") - 1.5).abs() < 1e-12);
    assert_eq!(overall.drift_mm, None, "four frames have no trend");
}

#[test]
fn a_strict_limit_makes_more_frames_wrong() {
    let all = [sequence("wide", "walk", 1.0, vec![frame(10.0, false), frame(30.0, false)])];
    let found = benchmark_metrics(&all, &SequenceMetricsSettings { wrong_mpjpe_mm: 20.0 });
    assert_eq!(found.overall.miss_rate, 0.5);
}

#[test]
fn the_papers_protocol_compares_with_the_tight_walk_of_the_same_person() {
    let all = [
        sequence("tight", "knees", 9.0, vec![frame(1.0, false)]),
        sequence("tight", "walk", 1.0, vec![frame(1.0, false)]),
        sequence("wide", "walk", 1.02, vec![frame(1.0, false)]),
        sequence("layered", "walk", 1.004, vec![frame(1.0, false)]),
    ];
    let found = benchmark_metrics(&all, &SequenceMetricsSettings::default());
    assert_eq!(found.styles["tight"].paper_protocol, None);
    let wide = found.styles["wide"].paper_protocol.expect("a reference is there");
    // Of the two vertices one is at the root of both and one 20 mm off.
    assert!((wide.mean_mm - 10.0).abs() < 1e-9 && (wide.under_10mm - 0.5).abs() < 1e-12);
    let overall = found.overall.paper_protocol.expect("a reference is there");
    assert!((overall.mean_mm - 6.0).abs() < 1e-9 && (overall.under_10mm - 0.75).abs() < 1e-12);
    assert_eq!(found.sequences.len(), 4);
    assert!((found.styles["tight"].girth_mean_error_mm - 500.0).abs() < 1e-9);
}

#[test]
fn coverage_says_how_often_the_stated_uncertainty_holds() {
    let all = [sequence("tight", "walk", 1.0, vec![frame(1.0, false)])];
    let coverage =
        benchmark_metrics(&all, &SequenceMetricsSettings::default()).overall.uncertainty.expect("stated");
    assert_eq!((coverage.measurements, coverage.within_one, coverage.within_two), (2, 0.5, 1.0));
    // Ratios 1.5 and 0.5.
    assert!((coverage.error_over_stated - 1.25_f64.sqrt()).abs() < 1e-12);
}

#[test]
fn a_tracker_that_drifts_is_seen() {
    let frames = (0..40).map(|k| frame(f64::from(k), false)).collect();
    let all = [sequence("tight", "walk", 1.0, frames)];
    let drift = benchmark_metrics(&all, &SequenceMetricsSettings::default()).overall.drift_mm;
    assert!((drift.expect("forty frames") - 30.0).abs() < 1e-12);
}

#[test]
fn curves_rise_to_one_and_maps_are_means() {
    let curve = cumulative(&[1.0, 2.0, 4.0, 8.0], &[0.0, 2.0, 5.0, 10.0]);
    assert_eq!(curve.iter().map(|point| point[1]).collect::<Vec<_>>(), [0.0, 0.5, 0.75, 1.0]);
    let (one, two) = (sequence("tight", "walk", 1.0, vec![]), sequence("tight", "turn", 3.0, vec![]));
    assert_eq!(mean_rest_errors_mm(&[&one, &two]), [0.0, 20.0]);
}
