//! Killed runs, several threads and several processes.

use std::path::Path;
use std::process::{Child, Stdio};
use std::time::{Duration, Instant};

use serde_json::Value;

use crate::bench::{fit_into, fitted, habitus, quick_settings};
use crate::sequence::open_npz;

const ARRAYS: [&str; 10] = [
    "identity",
    "identity_covariance",
    "pose",
    "rest_vertices",
    "rest_joints",
    "joints",
    "landmarks",
    "landmark_confidence",
    "smallest_clearance",
    "frame_ok",
];

/// Everything in a fit's file, to the bit, but the seconds that it took.
fn contents(run: &Path) -> (Vec<Vec<u64>>, Value) {
    let mut fit = open_npz(&run.join("3_fit_sequence/fit.npz"));
    let bits = |key: &&str| -> Vec<u64> {
        let array = fit.floats(key).expect(key);
        array.values.iter().map(|value| value.to_bits()).collect()
    };
    let arrays = ARRAYS.iter().map(bits).collect();
    let mut metadata: Value =
        serde_json::from_str(&fit.text("metadata").expect("metadata")).expect("is JSON");
    for frame in metadata["frames"].as_array_mut().expect("frames") {
        frame["seconds"] = Value::Null;
    }
    (arrays, metadata)
}

fn start(captures: &Path, run: &Path) -> Child {
    let mut command = habitus();
    command.arg("fit-sequence").arg(captures).arg("-o").arg(run).args(quick_settings());
    command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().expect("the command starts")
}

/// Waits until the journal has this many lines, and says whether it came that far before the run ended.
fn wait_for_lines(child: &mut Child, run: &Path, count: usize) -> bool {
    let journal = run.join("3_fit_sequence/frames.journal");
    let deadline = Instant::now() + Duration::from_secs(120);
    while Instant::now() < deadline {
        let lines = std::fs::read_to_string(&journal).map_or(0, |text| text.lines().count());
        if lines >= count {
            return true;
        }
        if child.try_wait().expect("can be asked").is_some() {
            return false;
        }
        std::thread::sleep(Duration::from_millis(2));
    }
    panic!("no progress in two minutes");
}

#[test]
fn a_killed_run_goes_on_and_ends_as_if_it_had_not_been_killed() {
    let expected = contents(&fitted().run);
    let folder = tempfile::tempdir().expect("a folder");
    let run = folder.path().join("run");
    // The key, the start and two frames; then some moment of the third.
    let mut child = start(&fitted().captures, &run);
    assert!(wait_for_lines(&mut child, &run, 4), "the run ended before it could be killed");
    std::thread::sleep(Duration::from_millis(7));
    child.kill().expect("can be killed");
    child.wait().expect("ends");
    assert!(!run.join("summary.json").exists(), "a killed run has no summary");
    let answer = fit_into(&fitted().captures, &run, &["--frame-rate", "30"]).expect(0);
    assert!(answer.messages.contains("going on after"), "{answer:?}");
    assert!(contents(&run) == expected, "the resumed fit differs from the uninterrupted one");
    assert!(!run.join("3_fit_sequence/frames.journal").exists(), "the journal is no longer needed");
}

#[test]
fn one_and_two_threads_give_the_same_fit() {
    let folder = tempfile::tempdir().expect("a folder");
    let run = folder.path().join("run");
    fit_into(&fitted().captures, &run, &["--jobs", "1"]).expect(0);
    assert!(contents(&run) == contents(&fitted().run), "one thread and all threads differ");
}

#[test]
fn a_second_process_does_not_write_into_the_same_run() {
    let folder = tempfile::tempdir().expect("a folder");
    let run = folder.path().join("run");
    let mut child = start(&fitted().captures, &run);
    let is_running = wait_for_lines(&mut child, &run, 1);
    assert!(is_running, "the run ended at once");
    let second = fit_into(&fitted().captures, &run, &[]).expect(1);
    assert!(second.messages.contains("another habitus works"), "{second:?}");
    child.kill().expect("can be killed");
    child.wait().expect("ends");
}
