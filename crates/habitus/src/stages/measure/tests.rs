//! Tapes around figures with known girths, laws that any measure obeys, and the ± against sampled bodies.

use std::f64::consts::TAU;

use glam::{DMat3, DVec3};
use nalgebra::DMatrix;

use super::cross_section::{polyline_length, taut_tape};
use super::{
    Definitions, DefinitionsError, MeasureError, measure, measure_with_uncertainty, measurement_uncertainty,
};
use crate::artifacts::measurements::{Measurement, Quantity};
use crate::body::{BodyModel, fixture};

/// Definitions that the figure of tubes has the points for.
const FIGURE_DEFINITIONS: &str = r#"
version = 1
[[measurement]]
name = "stature"
kind = "height"
from = "floor"
to = "top"
definition = "floor to top"
[[measurement]]
name = "trunk_girth"
kind = "girth"
at = { between = ["vertex:left_nipple", "vertex:right_nipple"], at = 0.5 }
tape = { bones = ["pelvis", "thorax"] }
definition = "trunk"
[[measurement]]
name = "{side}_thigh_girth"
kind = "girth"
at = { between = ["joint:{side}_thigh", "joint:{side}_shank"], at = 0.4 }
tape = { bones = ["{side}_thigh", "{side}_shank"], along = ["joint:{side}_thigh", "joint:{side}_shank"] }
definition = "thigh"
[[measurement]]
name = "{side}_level_thigh_girth"
kind = "girth"
at = { between = ["joint:{side}_thigh", "joint:{side}_shank"], at = 0.6 }
tape = { bones = ["left_thigh", "right_thigh"], around = { between = ["joint:{side}_thigh", "joint:{side}_shank"], at = 0.5 } }
definition = "thigh, level"
[[measurement]]
name = "{side}_upper_arm_girth"
kind = "girth"
at = { between = ["joint:{side}_upper_arm", "joint:{side}_forearm"], at = 0.4 }
tape = { bones = ["{side}_upper_arm", "{side}_forearm"], along = ["joint:{side}_upper_arm", "joint:{side}_forearm"] }
definition = "upper arm"
[[measurement]]
name = "largest_head_girth"
kind = "extreme_girth"
pick = "largest"
from = { between = ["joint:head", "top"], at = 0.1 }
to = { between = ["joint:head", "top"], at = 1.1 }
tape = { bones = ["head"] }
definition = "head"
[[measurement]]
name = "trunk_depth"
kind = "breadth"
at = { between = ["vertex:left_nipple", "vertex:right_nipple"], at = 0.5 }
across = ["joint:left_thigh", "joint:right_thigh"]
direction = "front_to_back"
tape = { bones = ["pelvis", "thorax"] }
definition = "depth"
[[measurement]]
name = "trunk_breadth"
kind = "breadth"
at = { between = ["vertex:left_nipple", "vertex:right_nipple"], at = 0.5 }
across = ["joint:left_thigh", "joint:right_thigh"]
direction = "sideways"
tape = { bones = ["pelvis", "thorax"] }
definition = "breadth"
[[measurement]]
name = "{side}_arm_length"
kind = "length"
through = ["joint:{side}_upper_arm", "joint:{side}_forearm", "joint:{side}_hand"]
definition = "arm"
[[measurement]]
name = "volume"
kind = "volume"
definition = "volume"
"#;

fn definitions() -> Definitions {
    Definitions::from_toml(FIGURE_DEFINITIONS).unwrap()
}

fn value(measurements: &[Measurement], name: &str) -> f64 {
    measurements.iter().find(|measurement| measurement.name == name).map(|m| m.value).unwrap()
}

fn measured(model: &BodyModel, vertices: &[DVec3]) -> Vec<Measurement> {
    measure(model, vertices, &definitions()).unwrap()
}

/// Perimeter of an ellipse (trapezoid rule on a periodic integrand: exact to rounding).
fn ellipse_perimeter([a, b]: [f64; 2]) -> f64 {
    let steps = 400;
    (0..steps)
        .map(|k| {
            let (sine, cosine) = (TAU * f64::from(k) / f64::from(steps)).sin_cos();
            (a * a * sine * sine + b * b * cosine * cosine).sqrt()
        })
        .sum::<f64>()
        * TAU
        / f64::from(steps)
}

fn tube(bone: usize) -> fixture::Tube {
    *fixture::TUBES.iter().find(|tube| tube.bone == bone).unwrap()
}

#[test]
fn girths_of_tubes_are_those_of_their_ellipses() {
    let model = fixture::model_with_segments(256);
    let measurements = measured(&model, model.mean_vertices());
    for (name, bone) in [
        ("trunk_girth", 7),
        ("left_thigh_girth", 1),
        ("right_thigh_girth", 1),
        ("left_upper_arm_girth", 9),
        ("right_upper_arm_girth", 9),
        ("largest_head_girth", 8),
    ] {
        let (found, expected) = (value(&measurements, name), ellipse_perimeter(tube(bone).half_axes));
        // 256 chords are shorter than their arcs by (π/256)²/6 = 2.5e-5.
        assert!((found / expected - 1.0).abs() < 4e-5, "{name}: {found} against {expected}");
    }
}

#[test]
fn a_level_cut_of_two_thighs_goes_around_the_named_one() {
    let model = fixture::model_with_segments(64);
    let measurements = measured(&model, model.mean_vertices());
    let thigh = tube(1);
    // A level cut of a slightly slanted tube: wider by 1 / cos of the slant, sideways.
    let cosine = (thigh.end - thigh.start).normalize().y.abs();
    let expected = ellipse_perimeter([thigh.half_axes[0] / cosine, thigh.half_axes[1]]);
    for side in ["left", "right"] {
        let found = value(&measurements, &format!("{side}_level_thigh_girth"));
        assert!((found / expected - 1.0).abs() < 1e-3, "{side}: {found} against {expected}");
    }
    let curve = |side: &str| {
        let name = format!("{side}_level_thigh_girth");
        measurements.iter().find(|m| m.name == name).map(|m| m.curve.clone()).unwrap()
    };
    assert!(curve("left").iter().all(|point| point.x > 0.0));
    assert!(curve("right").iter().all(|point| point.x < 0.0));
}

#[test]
fn lengths_breadths_and_volume_are_those_of_the_tubes() {
    let model = fixture::model_with_segments(256);
    let measurements = measured(&model, model.mean_vertices());
    let [a, b] = tube(7).half_axes;
    assert!((value(&measurements, "trunk_breadth") - 2.0 * a).abs() < 1e-6);
    assert!((value(&measurements, "trunk_depth") - 2.0 * b).abs() < 1e-6);
    let arm = tube(9).start.distance(tube(9).end) + tube(10).start.distance(tube(10).end);
    assert!((value(&measurements, "left_arm_length") - arm).abs() < 1e-6);
    let (top, sole) = (tube(8), tube(3));
    let top = top.end.y + 0.5 * (top.half_axes[0] + top.half_axes[1]);
    let lowest = model.mean_vertices().iter().map(|v| v.y).fold(f64::INFINITY, f64::min);
    assert!(lowest < sole.end.y && (value(&measurements, "stature") - (top - lowest)).abs() < 1e-6);

    // Each tube is a cylinder and two rounded ends made of rings at 0°, 30°, 60° and a pole.
    let frustum = |low: f64, high: f64, height: f64| height / 3.0 * (low * low + low * high + high * high);
    let (s30, s60) = (0.5, 3.0_f64.sqrt() / 2.0);
    let cap = frustum(1.0, s60, s30) + frustum(s60, 0.5, s60 - s30) + frustum(0.5, 0.0, 1.0 - s60);
    let expected: f64 = fixture::TUBES
        .iter()
        .map(|tube| {
            let [a, b] = tube.half_axes;
            let area = 0.5 * TAU * a * b;
            let one = area * (tube.start.distance(tube.end) + 2.0 * cap * 0.5 * (a + b));
            if matches!(tube.bone, 0 | 7 | 8) { one } else { 2.0 * one }
        })
        .sum();
    let found = value(&measurements, "volume");
    assert!((found / expected - 1.0).abs() < 2e-4, "{found} against {expected}");
}

#[test]
fn a_body_twice_as_large_has_twice_the_lengths_and_eight_times_the_volume() {
    let model = fixture::model();
    let rest = model.rest_vertices(&[0.5, -1.0, 0.3]);
    let scaled: Vec<DVec3> = rest.iter().map(|vertex| *vertex * 2.0).collect();
    for (small, large) in measured(&model, &rest).iter().zip(&measured(&model, &scaled)) {
        let factor = if small.quantity == Quantity::Volume { 8.0 } else { 2.0 };
        assert!((large.value / small.value - factor).abs() < 1e-9, "{}", small.name);
    }
}

#[test]
fn moving_the_body_and_turning_it_about_the_vertical_changes_no_measure() {
    let model = fixture::model();
    let rest = model.rest_vertices(&[-0.5, 1.0, 0.3, 0.8]);
    let turn = DMat3::from_rotation_y(2.3);
    let moved: Vec<DVec3> = rest.iter().map(|v| turn * *v + DVec3::new(3.0, -1.0, 0.7)).collect();
    for (before, after) in measured(&model, &rest).iter().zip(&measured(&model, &moved)) {
        // A search ends within 1e-6 of its range, where girths are flat.
        assert!((before.value - after.value).abs() < 1e-9, "{}", before.name);
        assert_eq!(before.curve.is_empty(), after.curve.is_empty());
    }
}

#[test]
fn left_and_right_swap_on_the_mirrored_body() {
    let model = fixture::model();
    let rest = model.rest_vertices(&[0.5, 0.2, -0.3, 1.0, 0.0, 2.5]);
    let mirrored: Vec<DVec3> = model
        .mirror_vertices()
        .iter()
        .map(|image| rest[*image as usize] * DVec3::new(-1.0, 1.0, 1.0))
        .collect();
    let (original, mirrored) = (measured(&model, &rest), measured(&model, &mirrored));
    let swapped = |name: &str| match name.split_once('_') {
        Some(("left", rest)) => format!("right_{rest}"),
        Some(("right", rest)) => format!("left_{rest}"),
        _ => name.to_string(),
    };
    let mut some_side_differs = false;
    for measurement in &original {
        let image = value(&mirrored, &swapped(&measurement.name));
        assert!((image - measurement.value).abs() < 1e-7, "{}", measurement.name);
        some_side_differs |= (value(&mirrored, &measurement.name) - measurement.value).abs() > 1e-6;
    }
    assert!(some_side_differs, "the body must be asymmetric for this test to say anything");
}

#[test]
fn curves_have_the_length_that_is_reported() {
    let model = fixture::model();
    for measurement in measured(&model, model.mean_vertices()) {
        if measurement.quantity == Quantity::Length {
            assert!(
                (polyline_length(&measurement.curve) - measurement.value).abs() < 1e-12,
                "{}",
                measurement.name
            );
        }
        if measurement.name.contains("girth") {
            assert_eq!(measurement.curve.first(), measurement.curve.last());
        }
    }
}

#[test]
fn a_taut_tape_bridges_hollows() {
    let normal = DVec3::new(0.0, 0.6, 0.8);
    let (x, y) = normal.any_orthonormal_pair();
    let star: Vec<DVec3> = (0..16)
        .map(|k| {
            let radius = if k % 2 == 0 { 1.0 } else { 0.3 };
            let angle = TAU * f64::from(k) / 16.0;
            DVec3::new(5.0, 1.0, -2.0) + radius * (x * angle.cos() + y * angle.sin())
        })
        .collect();
    let octagon = 16.0 * (TAU / 16.0).sin();
    let tape = taut_tape(&star, normal).unwrap();
    assert!((polyline_length(&tape) - octagon).abs() < 1e-12);
    assert_eq!(tape.len(), 9);
    let doubled: Vec<DVec3> = star.iter().chain(&star).copied().collect();
    assert!((polyline_length(&taut_tape(&doubled, normal).unwrap()) - octagon).abs() < 1e-12);
    assert!(taut_tape(&[x, x * 2.0, x * 3.0], normal).is_none(), "a line encloses nothing");
    assert!(taut_tape(&[], normal).is_none());
}

#[test]
fn uncertainty_is_the_spread_of_measures_over_sampled_identities() {
    let model = fixture::model();
    let identity = [0.3, -0.2, 0.1, 0.4, 0.0, 0.2];
    let factor = DMatrix::from_fn(6, 6, |row, column| {
        if row == column { 0.1 + 0.02 * row as f64 } else { 0.03 * ((row * 3 + column) as f64).sin() }
    });
    let covariance = &factor * factor.transpose();
    let predicted =
        measurement_uncertainty(&model, &model.rest_vertices(&identity), &covariance, &definitions());
    let predicted = predicted.unwrap();
    // Antithetic unit directions through the factor: their spread is the covariance exactly.
    let mut sums = vec![0.0; predicted.len()];
    for column in 0..6 {
        let shifted = |sign: f64| -> Vec<Measurement> {
            let at: Vec<f64> = (0..6).map(|row| identity[row] + sign * factor[(row, column)]).collect();
            measured(&model, &model.rest_vertices(&at))
        };
        for (sum, (a, b)) in sums.iter_mut().zip(shifted(1.0).iter().zip(&shifted(-1.0))) {
            *sum += (0.5 * (a.value - b.value)).powi(2);
        }
    }
    for ((predicted, sum), definition) in predicted.iter().zip(&sums).zip(&definitions().measurements) {
        // Second-order differences between a small step and one standard deviation of this covariance.
        assert!((predicted - sum.sqrt()).abs() < 0.02 * sum.sqrt() + 1e-6, "{}", definition.name);
        assert!(*predicted > 0.0, "{}", definition.name);
    }
}

#[test]
fn a_body_without_covariance_has_no_plus_minus() {
    let model = fixture::model();
    let body = model.rest_vertices(&[0.1]);
    let measurements = measure(&model, &body, &definitions()).unwrap();
    assert!(measurements.iter().all(|measurement| measurement.plus_minus.is_none()));
    let too_many = model.component_count() + 1;
    let wrong =
        measure_with_uncertainty(&model, &body, &DMatrix::identity(too_many, too_many), &definitions());
    let components = model.component_count();
    assert_eq!(wrong, Err(MeasureError::WrongCovariance { rows: too_many, columns: too_many, components }));
    let known = measure_with_uncertainty(&model, &body, &DMatrix::zeros(1, 1), &definitions()).unwrap();
    assert!(known.iter().all(|measurement| measurement.plus_minus == Some(0.0)));
}

#[test]
fn a_body_beyond_the_space_is_measured_as_it_is() {
    let model = fixture::model();
    let larger: Vec<DVec3> = model.mean_vertices().iter().map(|vertex| *vertex * 1.1).collect();
    let covariance = DMatrix::from_diagonal_element(2, 2, 0.01);
    let [mean, grown] = [model.mean_vertices(), &larger]
        .map(|body| measure_with_uncertainty(&model, body, &covariance, &definitions()).unwrap());
    for (mean, grown) in mean.iter().zip(&grown).filter(|(mean, _)| mean.quantity == Quantity::Length) {
        // Lengths and girths grow by the scale; a searched girth may find another level nearby.
        assert!((grown.value / mean.value - 1.1).abs() < 0.01, "{}", mean.name);
    }
}

#[test]
fn bodies_of_another_topology_are_refused() {
    let model = fixture::model();
    let short = measure(&model, &model.mean_vertices()[1..], &definitions());
    assert!(matches!(short, Err(MeasureError::WrongVertexCount { .. })));
    let mut broken = model.mean_vertices().to_vec();
    broken[5].y = f64::NAN;
    assert_eq!(measure(&model, &broken, &definitions()), Err(MeasureError::NotFinite { vertex: 5 }));
}

#[test]
fn a_model_without_a_named_point_keeps_the_other_measures() {
    let model = fixture::model();
    let standard = Definitions::standard().unwrap();
    let (available, missing) = standard.available_in(&model);
    assert!(!available.measurements.is_empty() && !missing.is_empty());
    assert!(missing.iter().any(|error| error.to_string().contains("'vertex:navel'")));
    let measured = measure(&model, model.mean_vertices(), &available).unwrap();
    assert_eq!(measured.len() + missing.len(), standard.measurements.len());
    assert!(matches!(
        measure(&model, model.mean_vertices(), &standard),
        Err(MeasureError::UnknownPoint { .. })
    ));
}

#[test]
fn a_cut_that_misses_the_body_is_an_error_by_name() {
    let text = FIGURE_DEFINITIONS.replace(
        "at = 0.4 }\ntape = { bones = [\"{side}_thigh\"",
        "at = 9.0 }\ntape = { bones = [\"{side}_thigh\"",
    );
    let model = fixture::model();
    let result = measure(&model, model.mean_vertices(), &Definitions::from_toml(&text).unwrap());
    assert_eq!(result, Err(MeasureError::NothingThere { measurement: "left_thigh_girth".into() }));
}

#[test]
fn unusable_definitions_are_refused_by_name() {
    let one = |body: &str| {
        let text = format!("version = 1\n[[measurement]]\nname = \"m\"\ndefinition = \"d\"\n{body}");
        Definitions::from_toml(&text)
    };
    assert!(one("kind = \"volume\"").is_ok());
    for bad in [
        "kind = \"weight\"",
        "kind = \"height\"\nfrom = \"floor\"",
        "kind = \"volume\"\nbones = []",
        "kind = \"girth\"\nat = \"top\"\ntape = { bones = [], allong = [\"floor\", \"top\"] }",
        "",
    ] {
        let error = one(bad).unwrap_err();
        assert!(error.to_string().contains("'m'"), "{bad}: {error}");
    }
    assert!(matches!(
        Definitions::from_toml("version = 9\nmeasurement = []"),
        Err(DefinitionsError::Newer { found: 9 })
    ));
    let twice = "version = 1\n[[measurement]]\nname = \"m\"\ndefinition = \"d\"\nkind = \"volume\"\n";
    let twice = format!("{twice}{}", twice.trim_start_matches("version = 1\n"));
    assert!(
        matches!(Definitions::from_toml(&twice), Err(DefinitionsError::Duplicate { name }) if name == "m")
    );
    assert!(matches!(Definitions::from_toml("measurement = 3"), Err(DefinitionsError::Malformed(_))));
    let nameless = "version = 1\n[[measurement]]\ndefinition = \"d\"\nkind = \"volume\"\n";
    assert!(matches!(Definitions::from_toml(nameless), Err(DefinitionsError::NoText { key: "name" })));
}

#[test]
fn the_standard_set_measures_the_default_space() {
    let model = BodyModel::default_space().unwrap();
    let standard = Definitions::standard().unwrap();
    let components = model.component_count();
    let covariance = DMatrix::from_diagonal_element(components, components, 0.01);
    let mean = measure_with_uncertainty(&model, model.mean_vertices(), &covariance, &standard).unwrap();
    let stature = value(&mean, "stature");
    for measurement in &mean {
        let value_here = measurement.value;
        assert!(value_here > 0.0 && measurement.plus_minus.is_some_and(|error| error > 0.0));
        if let Some(name) = measurement.name.strip_prefix("left_") {
            // The space is symmetric; its basis is stored in 16 bits.
            let right = value(&mean, &format!("right_{name}"));
            assert!((value_here - right).abs() < 1e-3, "{name}: left {value_here}, right {right}");
        }
        if measurement.quantity == Quantity::Length {
            assert!(value_here <= stature, "{} is longer than the body", measurement.name);
        }
    }
    // Order of girths and heights that holds for every adult, so a tape on the wrong part is noticed.
    for (smaller, larger) in [
        ("inseam", "shoulder_height"),
        ("shoulder_height", "neck_base_height"),
        ("left_wrist_girth", "left_forearm_girth"),
        ("left_forearm_girth", "left_upper_arm_girth"),
        ("left_ankle_girth", "left_calf_girth"),
        ("left_calf_girth", "left_mid_thigh_girth"),
        ("left_mid_thigh_girth", "left_thigh_girth"),
        ("neck_girth", "head_girth"),
        ("left_thigh_girth", "waist_girth"),
        ("waist_girth", "hip_girth"),
        ("waist_girth", "abdomen_girth"),
        ("waist_girth", "chest_girth"),
    ] {
        assert!(value(&mean, smaller) < value(&mean, larger), "{smaller} must be less than {larger}");
    }
}
