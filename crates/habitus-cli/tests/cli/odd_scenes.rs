//! Readable captures that show no usable person: never a body without a mark.

use habitus::geometry::glam::DVec3;
use serde_json::Value;

use crate::bench::{Answer, run};
use crate::shapes::Shape;
use crate::words;

struct Fitted {
    answer: Answer,
    /// Nothing when the whole input was refused.
    summary: Option<Value>,
}

fn fit(shape: &Shape, options: &[&str]) -> Fitted {
    let folder = tempfile::tempdir().expect("a folder");
    let capture = folder.path().join("scene.obj");
    shape.write(&capture);
    let out = folder.path().join("run");
    let mut words = words!["fit-sequence", capture, "-o", out].to_vec();
    words.extend(options.iter().map(Into::into));
    let answer = run(&words);
    assert!(!answer.messages.contains("panicked"), "{answer:?}");
    let text = std::fs::read_to_string(out.join("summary.json")).ok();
    let summary = text.map(|text| serde_json::from_str(&text).expect("is JSON"));
    assert_eq!(answer.code == Some(1), summary.is_none(), "an error has no summary: {answer:?}");
    Fitted { answer, summary }
}

/// Refused, or marked as failed by a code that is told to the user.
#[track_caller]
fn expect_failure(shape: &Shape, options: &[&str]) {
    let fitted = fit(shape, options);
    match fitted.answer.code {
        Some(1) => assert!(fitted.answer.messages.contains("scene.obj"), "{:?}", fitted.answer),
        Some(3) => {
            assert!(fitted.answer.messages.contains("What to do"), "{:?}", fitted.answer);
            assert!(fitted.summary.is_some_and(|summary| summary["failed_frames"] == 1));
        }
        _ => panic!("a wrong body without a mark: {:?} {:?}", fitted.answer, fitted.summary),
    }
}

fn stature(fitted: &Fitted) -> f64 {
    let summary = fitted.summary.as_ref().expect("was fitted");
    summary["measurements"]["stature"]["value"].as_f64().expect("a number")
}

#[test]
fn a_cube_is_no_person() {
    expect_failure(&Shape::cuboid(DVec3::splat(1.7)), &[]);
}

#[test]
fn a_ball_is_no_person() {
    let ball = Shape::cuboid(DVec3::splat(1.7)).moved(|vertex| 0.85 * vertex.normalize());
    expect_failure(&ball, &[]);
}

#[test]
fn a_sheet_is_no_person() {
    expect_failure(&Shape::cuboid(DVec3::new(1.0, 1.7, 1e-4)), &[]);
}

#[test]
fn a_person_of_the_size_of_a_dog_is_no_person() {
    expect_failure(&Shape::person().moved(|vertex| 0.4 * vertex), &[]);
}

#[test]
fn half_a_person_is_no_whole_one() {
    let middle = Shape::person().vertices.iter().map(|vertex| vertex.y).sum::<f64>() / 6500.0;
    expect_failure(&Shape::person().part(|vertex| vertex.y > middle), &[]);
}

#[test]
fn a_unit_that_is_off_by_a_thousand_is_noticed() {
    expect_failure(&Shape::person().moved(|vertex| 1000.0 * vertex), &["--unit", "m"]);
    expect_failure(&Shape::person(), &["--unit", "mm"]);
}

#[test]
fn two_people_in_one_frame_are_noticed() {
    let other = Shape::person().moved(|vertex| vertex + DVec3::new(1.3, 0.0, 0.2));
    expect_failure(&Shape::person().with(other), &[]);
}

#[test]
fn a_person_may_stand_on_the_head_or_lie_and_keeps_the_stature() {
    let person = Shape::person();
    let upright = fit(&person, &[]);
    assert_eq!(upright.answer.code, Some(0), "{:?}", upright.answer);
    for (name, turned) in [
        ("on the head", person.clone().moved(|v| DVec3::new(v.x, -v.y, -v.z))),
        ("z up", person.clone().moved(|v| DVec3::new(v.x, -v.z, v.y))),
    ] {
        let fitted = fit(&turned, &[]);
        assert_eq!(fitted.answer.code, Some(0), "{name}: {:?}", fitted.answer);
        assert!((stature(&fitted) - stature(&upright)).abs() < 2.0, "{name}");
    }
    let centimetres = fit(&person.moved(|vertex| 100.0 * vertex), &[]);
    assert_eq!(centimetres.answer.code, Some(0), "{:?}", centimetres.answer);
    assert!((stature(&centimetres) - stature(&upright)).abs() < 2.0, "centimetres");
}
