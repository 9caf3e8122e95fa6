use glam::{DQuat, DVec3};

use super::*;
use crate::statistics::{ProcrustesSettings, align_samples, align_to};

/// Bodies of a made-up space: a helix of points with a few modes and noise, turned at random.
fn bodies(count: usize, points: usize) -> SampleMatrix {
    let mut stream = RandomStream::named(11, "bodies");
    let mut samples = SampleMatrix::new(3 * points);
    for _ in 0..count {
        let scores: Vec<f64> = (0..6).map(|k| stream.normal() * 0.6_f64.powi(k)).collect();
        let turn = DQuat::from_rotation_y(0.2 * stream.normal());
        let body: Vec<DVec3> = (0..points)
            .map(|k| {
                let t = k as f64 / points as f64;
                let base = DVec3::new((9.0 * t).sin(), 2.0 * t, (9.0 * t).cos());
                let bend: DVec3 = scores
                    .iter()
                    .enumerate()
                    .map(|(mode, score)| {
                        let m = mode as f64 + 1.0;
                        DVec3::new((m * 3.0 * t).cos(), (m * 2.0 * t).sin(), (m * t).cos()) * (0.05 * score)
                    })
                    .sum();
                let noise = DVec3::new(stream.normal(), stream.normal(), stream.normal()) * 0.004;
                turn * (base + bend + noise)
            })
            .collect();
        samples.push_points(&body);
    }
    let anchor = samples.points(0);
    align_samples(&mut samples, &anchor, &ProcrustesSettings::default());
    samples
}

fn mean_distance(left: &[f64], right: &[f64]) -> f64 {
    let distances = left
        .chunks_exact(3)
        .zip(right.chunks_exact(3))
        .map(|(x, y)| DVec3::from_slice(x).distance(DVec3::from_slice(y)));
    distances.sum::<f64>() / (left.len() / 3) as f64
}

/// Everything anew for each left-out body: alignment, components, projection.
fn brute_force(samples: &SampleMatrix, components: &[usize]) -> Vec<Vec<f64>> {
    (0..samples.len())
        .map(|left_out| {
            let others: Vec<usize> = (0..samples.len()).filter(|other| *other != left_out).collect();
            let mut training = samples.subset(&others);
            let anchor = training.points(0);
            let settings = ProcrustesSettings { tolerance: 1e-13, rounds: 200, ..Default::default() };
            let mean = align_samples(&mut training, &anchor, &settings);
            let mut test = samples.sample(left_out).to_vec();
            align_to(&mut test, &mean);
            components
                .iter()
                .map(|count| {
                    let settings = LinearSpaceSettings::with_components((*count).max(1));
                    let space = LinearSpace::learn(&training, &settings).expect("learns").truncated(*count);
                    mean_distance(&test, &space.project(&test))
                })
                .collect()
        })
        .collect()
}

#[test]
fn leave_one_out_equals_learning_anew_for_each_body() {
    let samples = bodies(14, 90);
    let components = [0, 1, 2, 5, 9];
    let validation = CrossValidation::new(&samples);
    let found = validation.errors(&validation.leave_one_out_folds(), &components);
    for (found, expected) in found.iter().flatten().zip(brute_force(&samples, &components).iter().flatten()) {
        // The issue is leakage through alignment and components, which shows in the third digit.
        assert!((found - expected).abs() < 1e-6 * expected, "{found} for {expected}");
    }
}

#[test]
fn folds_of_many_bodies_share_their_eigenvectors_without_changing_the_result() {
    let samples = bodies(300, 60);
    let components = [1, 4, 8];
    let validation = CrossValidation::new(&samples);
    let folds = validation.leave_one_out_folds();
    let found = validation.errors(&folds[..3], &components);
    let mut alone = CrossValidation::new(&samples);
    alone.forget_vectors();
    for (found, expected) in
        found.iter().flatten().zip(alone.errors(&folds[..3], &components).iter().flatten())
    {
        assert!((found - expected).abs() < 1e-6 * expected, "{found} for {expected}");
    }
}

#[test]
fn the_left_out_body_does_not_help() {
    let samples = bodies(14, 90);
    let validation = CrossValidation::new(&samples);
    let components = [8];
    let honest = validation.errors(&validation.leave_one_out_folds(), &components);
    let leaking: Vec<Fold> = (0..14).map(|test| Fold { test, training: (0..14).collect() }).collect();
    let leaking = validation.errors(&leaking, &components);
    assert!(honest.iter().zip(&leaking).all(|(honest, leaking)| honest[0] > leaking[0]));
}

#[test]
fn every_number_of_training_samples_tests_bodies_that_it_did_not_see() {
    let samples = bodies(40, 60);
    let settings = ShapeSpaceQualitySettings {
        training_samples: vec![6, 20, 4000],
        specificity_samples: 50,
        components: vec![0, 3, 5],
        ..Default::default()
    };
    let found = quality_by_training_samples(&samples, &settings).expect("evaluates");
    assert_eq!(found.iter().map(|quality| quality.samples).collect::<Vec<_>>(), [6, 20]);
    assert_eq!(found[0].components, [0, 3], "six samples have at most five components, and one is left out");
    assert!(found[1].generalization_mm[1] < found[0].generalization_mm[1]);
}

#[test]
fn specificity_is_the_distance_to_the_nearest_body() {
    let samples = bodies(30, 200);
    let settings = ShapeSpaceQualitySettings { specificity_samples: 40, ..Default::default() };
    let space = LinearSpace::learn(&samples, &LinearSpaceSettings::with_components(6)).expect("learns");
    let components = [0, 2, 6];
    let found = specificity(&space, &samples, &components, &settings);
    let mut expected = vec![0.0; components.len()];
    for index in 0..40 {
        let mut stream = RandomStream::named(settings.seed, &format!("specificity {index}"));
        let coefficients: Vec<f64> = (0..6).map(|_| stream.normal()).collect();
        for (sum, count) in expected.iter_mut().zip(components) {
            let body = space.instance(&coefficients[..count]);
            let nearest = samples.samples().map(|sample| mean_distance(&body, sample));
            *sum += 1000.0 * nearest.fold(f64::INFINITY, f64::min) / 40.0;
        }
    }
    for (found, expected) in found.iter().zip(&expected) {
        // Coordinates are compared in f32.
        assert!((found - expected).abs() < 1e-5 * expected, "{found} for {expected}");
    }
}

#[test]
fn compactness_rises_to_one() {
    let samples = bodies(12, 40);
    let space = LinearSpace::learn(&samples, &LinearSpaceSettings::with_components(11)).expect("learns");
    let found = compactness(&space, &[0, 1, 5, 11]);
    assert!(found[0] == 0.0 && (found[3] - 1.0).abs() < 1e-12);
    assert!(found.windows(2).all(|pair| pair[0] < pair[1]));
}

#[test]
fn a_round_is_measured_against_the_last_one() {
    let samples = bodies(16, 60);
    let settings =
        ShapeSpaceQualitySettings { components: vec![0, 4], specificity_samples: 30, ..Default::default() };
    let own = shape_space_quality(&samples, &settings).expect("evaluates");
    let own_of: Vec<Option<usize>> = (0..samples.len()).map(Some).collect();
    let against_itself = quality_against(&samples, &samples, &own_of, &settings).expect("evaluates");
    for (left, right) in own.generalization_mm.iter().zip(&against_itself.generalization_mm) {
        assert!((left - right).abs() < 1e-6 * left);
    }
    assert_eq!(own.specificity_mm, against_itself.specificity_mm);
    // A body that the earlier round had not accepted is reconstructed from all that it had.
    let earlier = samples.subset(&(1..16).collect::<Vec<usize>>());
    let own_of: Vec<Option<usize>> = (0..samples.len()).map(|body| body.checked_sub(1)).collect();
    let fewer = quality_against(&earlier, &samples, &own_of, &settings).expect("evaluates");
    assert_eq!(fewer.samples, 15);
    assert!(fewer.generalization_mm[1] > own.generalization_mm[1]);
}
