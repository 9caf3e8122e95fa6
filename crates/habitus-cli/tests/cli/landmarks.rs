//! Landmarks of single scans, as a table, as JSON and as pictures; bad scans stop no other.

use habitus::geometry::glam::DVec3;
use serde_json::Value;

use crate::bench::run;
use crate::shapes::Shape;
use crate::words;

const QUICK: [&str; 4] = ["--set", "fit_sequence.components=12", "--set", "fit_sequence.refine.passes=1"];

#[test]
fn landmarks_of_a_scan_are_in_its_own_unit_and_a_broken_scan_stops_no_other() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = |name: &str| folder.path().join(name);
    Shape::person().moved(|vertex| 1000.0 * (vertex + DVec3::new(3.0, 0.0, 0.0))).write(&at("person.obj"));
    std::fs::write(at("broken.ply"), b"ply\nformat ascii 1.0\n").expect("writes");
    let out = at("marks");
    let mut words = words!["landmarks", at("broken.ply"), at("person.obj"), "-o", out, "--pictures"].to_vec();
    words.extend(QUICK.iter().map(Into::into));
    let answer = run(&words).expect(3);
    assert!(answer.messages.contains("broken.ply"), "{answer:?}");
    let table = std::fs::read_to_string(out.join("landmarks.csv")).expect("exists");
    assert!(table.starts_with("frame,landmark,x,y,z,confidence\nperson.obj,"), "{table}");
    assert_eq!(table.lines().count(), 15);
    let found: Value =
        serde_json::from_str(&std::fs::read_to_string(out.join("landmarks.json")).expect("exists"))
            .expect("is JSON");
    let [broken, person] = [&found["scans"][0], &found["scans"][1]];
    assert!(broken["error"].is_string() && broken.get("found").is_none());
    assert_eq!(person["found"]["metres_per_unit"], 0.001);
    let landmarks = person["found"]["landmarks"].as_array().expect("a list");
    let height = |name: &str| {
        let landmark = landmarks.iter().find(|landmark| landmark["name"] == name).expect(name);
        assert!(landmark["confidence"].as_f64().expect("a number") > 0.5, "{landmark}");
        landmark["position"][1].as_f64().expect("a number")
    };
    assert!(height("forehead") - height("left_heel") > 1400.0, "millimetres, y up");
    assert!((height("left_knee") - height("right_knee")).abs() < 60.0);
    assert!(out.join("person.obj.png").is_file());

    // The finished scan is not done again: no picture is drawn either.
    std::fs::remove_file(out.join("person.obj.png")).expect("is there");
    run(&words).expect(3);
    assert!(!out.join("person.obj.png").exists());
    assert_eq!(std::fs::read_to_string(out.join("landmarks.csv")).expect("exists"), table);
}

#[test]
fn folders_and_equal_names_are_refused_with_a_remedy() {
    let folder = tempfile::tempdir().expect("a folder");
    let out = folder.path().join("marks");
    let answer = run(words!["landmarks", folder.path(), "-o", out]).expect(3);
    assert!(answer.messages.contains("a file is needed"), "{answer:?}");
    let answer = run(words!["landmarks", "a/scan.ply", "b/scan.ply", "-o", out]).expect(1);
    assert!(answer.messages.contains("same file name"), "{answer:?}");
}
