//! A generated sequence through all verbs.

use std::path::Path;

use habitus::artifacts::npz::NpzReader;
use serde_json::Value;

use crate::bench::{FRAMES, Fitted, fit_into, fitted, quick_settings, run};
use crate::words;

const SUMMARY_KEYS: [&str; 13] = [
    "verb",
    "version",
    "frames",
    "failed_frames",
    "codes",
    "seconds",
    "frames_per_second",
    "outside_share_5mm",
    "outside_mean_mm",
    "measurements",
    "peak_memory_mb",
    "start",
    "truth",
];

fn json(path: &Path) -> Value {
    serde_json::from_str(&std::fs::read_to_string(path).expect("exists")).expect("is JSON")
}

fn keys(value: &Value) -> Vec<&str> {
    value.as_object().expect("an object").keys().map(String::as_str).collect()
}

fn sorted<'a>(names: &[&'a str]) -> Vec<&'a str> {
    let mut names = names.to_vec();
    names.sort_unstable();
    names
}

pub fn open_npz(path: &Path) -> NpzReader {
    NpzReader::new(std::fs::read(path).expect("exists"), path).expect("is an npz file")
}

#[test]
fn a_run_holds_exactly_the_files_of_the_contract() {
    let run = &fitted().run;
    for name in ["report.html", "summary.json"] {
        assert!(run.join(name).is_file(), "{name}");
    }
    let entries = std::fs::read_dir(run.join("3_fit_sequence")).expect("exists");
    let names: Vec<String> =
        entries.map(|entry| entry.expect("an entry").file_name().to_string_lossy().into_owned()).collect();
    let mut names: Vec<&str> =
        names.iter().map(String::as_str).filter(|name| !name.starts_with('.')).collect();
    names.sort_unstable();
    assert_eq!(names, ["body.glb", "fit.npz", "landmarks.csv", "measurements.csv", "provenance.toml"]);
}

#[test]
fn the_summary_has_the_keys_of_the_contract() {
    let summary = json(&fitted().run.join("summary.json"));
    assert_eq!(keys(&summary), sorted(&SUMMARY_KEYS[..12]));
    assert_eq!(keys(&summary["seconds"]), sorted(&["total", "start", "track", "refine", "io"]));
    assert_eq!(summary["verb"], "fit-sequence");
    assert_eq!(
        (summary["frames"].as_u64(), summary["failed_frames"].as_u64()),
        (Some(FRAMES as u64), Some(0))
    );
    let seconds = |key: &str| summary["seconds"][key].as_f64().expect("a number");
    assert!(seconds("start") > 0.0 && seconds("track") > 0.0 && seconds("refine") > 0.0);
    // The three stages follow one another within the whole.
    assert!(seconds("start") + seconds("track") + seconds("refine") <= seconds("total"));
    let stature = &summary["measurements"]["stature"];
    assert_eq!(keys(stature), ["plus_minus", "unit", "value"]);
    if Path::new("/proc/self/status").exists() {
        assert!(summary["peak_memory_mb"].as_f64().expect("known here") > 1.0);
    }
}

#[test]
fn the_fit_has_the_arrays_of_the_contract() {
    let path = fitted().run.join("3_fit_sequence/fit.npz");
    let mut fit = open_npz(&path);
    let vertex_count = fit.floats("rest_vertices").expect("is there").shape[0];
    for (key, shape) in [
        ("identity", vec![12]),
        ("pose", vec![FRAMES, 30]),
        ("rest_vertices", vec![vertex_count, 3]),
        ("joints", vec![FRAMES, 15, 3]),
        ("landmarks", vec![FRAMES, 14, 3]),
        ("landmark_confidence", vec![FRAMES, 14]),
    ] {
        let array = fit.floats(key).expect(key);
        assert_eq!(array.shape, shape, "{key}");
        assert!(array.values.iter().all(|value| value.is_finite()), "{key}");
    }
    let faces = fit.indices("faces", vertex_count).expect("faces");
    assert_eq!(faces.shape[1], 3);
    let ok = fit.integers("frame_ok").expect("frame_ok");
    assert_eq!((ok.shape, ok.values), (vec![FRAMES], vec![1; FRAMES]));
}

#[test]
fn landmarks_and_provenance_can_be_read_by_anyone() {
    let stage = fitted().run.join("3_fit_sequence");
    let table = std::fs::read_to_string(stage.join("landmarks.csv")).expect("exists");
    assert_eq!(table.lines().count(), 1 + 14 * FRAMES);
    assert!(table.starts_with("frame,landmark,x,y,z,confidence\nframe_0000.ply,"));
    let provenance: toml::Table =
        std::fs::read_to_string(stage.join("provenance.toml")).expect("exists").parse().expect("is TOML");
    assert_eq!(provenance["inputs"].as_array().expect("inputs").len(), FRAMES);
    assert_eq!(provenance["config"]["components"].as_integer(), Some(12), "the effective setting");
    let animation = std::fs::read(stage.join("body.glb")).expect("exists");
    assert_eq!(&animation[..4], b"glTF");
}

#[test]
fn a_finished_run_is_not_done_again_unless_forced_or_changed() {
    let Fitted { captures, run, .. } = fitted();
    let fit_file = run.join("3_fit_sequence/fit.npz");
    let date = || std::fs::metadata(&fit_file).and_then(|file| file.modified()).expect("has a date");
    let before = date();
    let again = fit_into(captures, run, &["--frame-rate", "25"]).expect(0);
    assert!(again.messages.contains("already finished") && again.messages.contains("--force"), "{again:?}");
    assert_eq!(date(), before);
    assert_eq!(again.result, fitted().answer.result, "the same answer as the first time");
}

#[test]
fn the_truth_is_near_and_two_fits_are_compared_in_one_table() {
    let Fitted { captures, run: fit, .. } = fitted();
    let folder = tempfile::tempdir().expect("a folder");
    let out = folder.path().join("accuracy");
    let answer = run(words!["evaluate", "sequence", fit, "--truth", captures, "-o", out]).expect(0);
    assert!(answer.result.contains("posed body, mean"), "{answer:?}");
    assert!(answer.result.trim_end().ends_with("benchmark.html"), "{answer:?}");
    let metrics = json(&out.join("metrics.json"));
    let accuracy = &metrics["overall"];
    assert_eq!(&metrics["styles"]["tight"], accuracy, "one sequence is all of them");
    let contract = [
        "posed_mean_mm",
        "posed_p95_mm",
        "rest_mean_mm",
        "rest_under_10mm",
        "mpjpe_mm",
        "landmark_mm",
        "girth_mean_error_mm",
        "stature_error_mm",
        "outside_share_5mm",
        "jitter_ratio",
        "failure_rate",
        "false_alarm_rate",
        "miss_rate",
        "paper_protocol",
        "seconds_per_frame",
    ];
    let keys = accuracy.as_object().expect("an object");
    contract.iter().for_each(|key| assert!(keys.contains_key(*key), "{key} is missing"));
    assert!(accuracy["seconds_per_frame"]["p95"].as_f64() >= accuracy["seconds_per_frame"]["p50"].as_f64());
    assert_eq!(accuracy["miss_rate"], 0.0);
    let page = std::fs::read_to_string(out.join("benchmark.html")).expect("exists");
    assert!(page.contains("data:image/png;base64") && !page.contains("<script"), "one file without scripts");
    assert!(out.join("shape_map.svg").is_file() && out.join("landmarks_by_style.svg").is_file());
    // Coarse captures and a dozen components: far from the demo's accuracy, but the same person in the same pose.
    assert!(accuracy["posed_mean_mm"].as_f64().expect("a number") < 60.0, "{accuracy}");
    assert!(accuracy["mpjpe_mm"].as_f64().expect("a number") < 60.0, "{accuracy}");
}

#[test]
fn a_part_of_a_sequence_is_compared_with_its_own_frames() {
    let folder = tempfile::tempdir().expect("a folder");
    let (out, numbers) = (folder.path().join("run"), folder.path().join("accuracy"));
    let part = ["--first", "1", "--last", "3", "--step", "2", "--recipe", "paper2016"];
    fit_into(&fitted().captures, &out, &part);
    run(words!["evaluate", "sequence", out, "--truth", fitted().captures, "-o", numbers]).expect(0);
    let summary = json(&out.join("summary.json"));
    assert_eq!(keys(&summary), sorted(&SUMMARY_KEYS[..12]), "the same keys from the paper's recipe");
    assert_eq!(summary["frames"], 2);
    let metrics = json(&numbers.join("metrics.json"));
    let accuracy = &metrics["overall"];
    // Compared with the wrong frames, a walk would be off by a step.
    assert!(accuracy["mpjpe_mm"].as_f64().expect("a number") < 120.0, "{accuracy}");
    assert!(accuracy["jitter_ratio"].is_null(), "two frames have no second difference");
}

#[test]
fn a_run_is_measured_as_a_table_and_as_a_file() {
    let folder = tempfile::tempdir().expect("a folder");
    let table = folder.path().join("table.csv");
    let answer = run(words!["measure", fitted().run, "--csv", table]).expect(0);
    assert!(
        answer.result.lines().any(|line| line.starts_with("stature ") && line.contains('±')),
        "{answer:?}"
    );
    let written = std::fs::read_to_string(table).expect("exists");
    let own = std::fs::read_to_string(fitted().run.join("3_fit_sequence/measurements.csv")).expect("exists");
    assert_eq!(written, own);
}

#[test]
fn bodies_motion_and_animation_are_exported() {
    let folder = tempfile::tempdir().expect("a folder");
    let [bodies, motion, animation] = ["bodies", "walk.bvh", "walk.glb"].map(|name| folder.path().join(name));
    run(words!["export", fitted().run, "--ply", bodies, "--bvh", motion, "--glb", animation]).expect(0);
    assert_eq!(std::fs::read_dir(&bodies).expect("exists").count(), FRAMES + 1);
    assert!(bodies.join("rest.ply").is_file());
    let motion = std::fs::read_to_string(motion).expect("exists");
    assert!(
        motion.contains(&format!("Frames: {FRAMES}")) && motion.contains("Frame Time: 0.04"),
        "25 a second"
    );
    // Read back from fit.npz, poses differ by rounding; the parts of the file are the same.
    let length = |path: &Path| std::fs::metadata(path).expect("exists").len();
    let own = length(&fitted().run.join("3_fit_sequence/body.glb"));
    assert!(own.abs_diff(length(&animation)) < own / 100);
}

#[test]
fn pictures_of_runs_and_meshes_are_drawn() {
    let folder = tempfile::tempdir().expect("a folder");
    let picture = folder.path().join("sheet.png");
    let size = |words: &[std::ffi::OsString]| {
        run(words).expect(0);
        let bytes = std::fs::read(&picture).expect("exists");
        assert_eq!(&bytes[1..4], b"PNG");
        bytes.len()
    };
    let overlay = size(words!["render", fitted().run, "-o", picture, "--frames", "0,3", "--height", "160"]);
    let one = size(words!["render", fitted().run, "-o", picture, "--frames", "0", "--height", "160"]);
    assert!(overlay > one, "two frames show more than one");
    size(words!["render", fitted().run, "-o", picture, "--measurements", "--height", "160"]);
    let mesh = fitted().captures.join("frame_0000.ply");
    size(words!["render", mesh, "-o", picture, "--views", "front,back", "--height", "160"]);
    let beyond = run(words!["render", fitted().run, "-o", picture, "--frames", "99"]).expect(1);
    assert!(beyond.messages.contains("no frame 99"), "{beyond:?}");
}

#[test]
fn a_report_is_written_again_with_and_without_captures() {
    let folder = tempfile::tempdir().expect("a folder");
    let copy = folder.path().join("copy");
    std::fs::create_dir_all(copy.join("3_fit_sequence")).expect("makes");
    for name in ["summary.json", "3_fit_sequence/fit.npz", "3_fit_sequence/provenance.toml"] {
        std::fs::copy(fitted().run.join(name), copy.join(name)).expect("copies");
    }
    let without = run(words!["report", copy]).expect(0);
    assert!(without.messages.contains("--captures"), "{without:?}");
    let small = std::fs::metadata(copy.join("report.html")).expect("exists").len();
    let with = run(words!["report", copy, "--captures", fitted().captures]).expect(0);
    assert!(!with.messages.contains("warning"), "{with:?}");
    let large = std::fs::metadata(copy.join("report.html")).expect("exists").len();
    assert!(large > small, "captures take room");
    let first = std::fs::metadata(fitted().run.join("report.html")).expect("exists").len();
    assert!(first.abs_diff(large) < first / 20, "the same page as the fit's own but for names and times");
}

#[test]
fn one_unreadable_frame_does_not_stop_the_others() {
    let folder = tempfile::tempdir().expect("a folder");
    let captures = folder.path().join("captures");
    std::fs::create_dir(&captures).expect("makes");
    for frame in 0..3 {
        let name = format!("frame_{frame:04}.ply");
        std::fs::copy(fitted().captures.join(&name), captures.join(&name)).expect("copies");
    }
    let broken = captures.join("frame_0001.ply");
    let bytes = std::fs::read(&broken).expect("exists");
    std::fs::write(&broken, &bytes[..bytes.len() / 2]).expect("writes");
    let out = folder.path().join("run");
    let answer = fit_into(&captures, &out, &[]).expect(3);
    assert!(answer.messages.contains("unreadable_frame"), "{answer:?}");
    assert!(answer.messages.contains("frame_0001.ply is not a usable PLY file: at byte"), "{answer:?}");
    let summary = json(&out.join("summary.json"));
    assert_eq!(summary["failed_frames"], 1);
    assert_eq!(summary["codes"]["failed"][0], "frame_0001.ply");
    let ok = open_npz(&out.join("3_fit_sequence/fit.npz")).integers("frame_ok").expect("frame_ok");
    assert_eq!(ok.values, [1, 0, 1]);
    let again = fit_into(&captures, &out, &[]).expect(3);
    assert!(
        again.messages.contains("already finished"),
        "the exit code tells the second time too: {again:?}"
    );
    let exported = run(words!["export", out, "--ply", folder.path().join("bodies"), "--leave-out-failed"]);
    assert_eq!(exported.code, Some(3));
    assert!(!folder.path().join("bodies/body_000001.ply").exists());
}

#[test]
fn landmarks_of_a_user_are_taken_and_faults_in_them_named() {
    let folder = tempfile::tempdir().expect("a folder");
    let table = folder.path().join("marks.csv");
    let out = folder.path().join("run");
    for (text, needle) in [
        ("frame,landmark,x,y,z\nframe_0009.ply,abdomen,0,1,0\n", "frame_0009.ply"),
        ("frame,landmark,x,y,z\nframe_0000.ply,tail,0,1,0\n", "tail"),
        ("frame,landmark,x,y,z\nframe_0000.ply,abdomen,0,one,0\n", "line 2"),
        ("landmark,x\n", "header"),
    ] {
        std::fs::write(&table, text).expect("writes");
        let words = ["--landmarks", table.to_str().expect("is UTF-8"), "--last", "0"];
        let answer = fit_into(&fitted().captures, &out, &words).expect(1);
        assert!(answer.messages.contains(needle), "{needle}: {answer:?}");
    }
}

#[test]
fn a_demo_compares_its_fit_with_the_truth() {
    let folder = tempfile::tempdir().expect("a folder");
    let out = folder.path().join("demo");
    let mut words = vec!["demo".to_string(), "-o".into(), out.to_str().expect("is UTF-8").into()];
    words.extend(quick_settings());
    words.extend(["--set".to_string(), "generate.frame_count=3".into(), "--quiet".into()]);
    let answer = run(&words).expect(0);
    assert_eq!(answer.result.lines().count(), 1, "quiet leaves the result only: {answer:?}");
    assert!(answer.messages.lines().all(|line| line.starts_with("warning: ")), "{answer:?}");
    let summary = json(&out.join("summary.json"));
    assert_eq!(keys(&summary), sorted(&SUMMARY_KEYS));
    assert_eq!(summary["verb"], "demo");
    for key in [
        "posed_mean_mm",
        "rest_mean_mm",
        "rest_under_10mm",
        "mpjpe_mm",
        "stature_error_mm",
        "girth_mean_error_mm",
    ] {
        assert!(summary["truth"][key].as_f64().is_some_and(f64::is_finite), "{key}: {summary}");
    }
    assert!(out.join("0_scans/truth.npz").is_file() && out.join("report.html").is_file());
}
