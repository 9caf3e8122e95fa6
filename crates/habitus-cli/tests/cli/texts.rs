//! Help, usage errors, completions and settings: what a person reads.

use std::path::Path;

use crate::bench::run;
use crate::words;

const VERBS: [&str; 19] = [
    "demo",
    "register",
    "learn-shape",
    "reconstruct",
    "review",
    "fit-sequence",
    "landmarks",
    "measure",
    "extract-clothing",
    "learn-clothing",
    "synthesize",
    "bootstrap",
    "report",
    "render",
    "export",
    "generate",
    "evaluate",
    "config",
    "completions",
];

/// Compares a text with its snapshot; with UPDATE_SNAPSHOTS set, writes it anew.
#[track_caller]
fn expect_snapshot(name: &str, text: &str) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/snapshots").join(format!("{name}.txt"));
    if std::env::var_os("UPDATE_SNAPSHOTS").is_some() {
        std::fs::create_dir_all(path.parent().expect("a folder")).expect("makes");
        std::fs::write(&path, text).expect("writes");
    }
    let expected = std::fs::read_to_string(&path).unwrap_or_default();
    assert_eq!(text, expected, "{name} changed; look at it and run the tests with UPDATE_SNAPSHOTS=1");
}

#[test]
fn help_texts_are_as_they_were_read_last() {
    expect_snapshot("help", &run(words!["--help"]).expect(0).result);
    for verb in VERBS {
        expect_snapshot(&format!("help_{verb}"), &run(words![verb, "--help"]).expect(0).result);
    }
    expect_snapshot(
        "help_evaluate_sequence",
        &run(words!["evaluate", "sequence", "--help"]).expect(0).result,
    );
    expect_snapshot(
        "help_evaluate_benchmark",
        &run(words!["evaluate", "benchmark", "--help"]).expect(0).result,
    );
    expect_snapshot(
        "help_evaluate_clothing",
        &run(words!["evaluate", "clothing", "--help"]).expect(0).result,
    );
}

#[test]
fn help_texts_of_what_generate_makes_are_as_they_were_read_last() {
    for kind in ["clothing-data", "benchmark"] {
        let help = run(words!["generate", kind, "--help"]).expect(0).result;
        expect_snapshot(&format!("help_generate_{kind}"), &help);
        assert!(help.contains(&format!("  habitus generate {kind}")), "{kind} has no example");
    }
}

#[test]
fn every_verb_shows_examples_of_itself() {
    for verb in VERBS.iter().filter(|verb| **verb != "evaluate") {
        let help = run(words![*verb, "--help"]).expect(0).result;
        assert!(help.contains(&format!("  habitus {verb}")), "{verb} has no example");
    }
}

#[test]
fn wrong_usage_has_its_own_exit_code() {
    for words in [
        words!["fit-sequnce"],
        words!["fit-sequence"],
        words!["fit-sequence", "in", "-o", "run", "--unit", "inch"],
        words!["fit-sequence", "in", "-o", "run", "--step", "0"],
        words!["demo", "--jobs", "0"],
        words!["render", "run"],
    ] {
        let answer = run(words).expect(2);
        assert!(answer.messages.starts_with("error: "), "{answer:?}");
    }
    let bare: &[&str] = &[];
    assert!(run(bare).expect(2).messages.contains("Usage: habitus"));
}

#[test]
fn settings_are_printed_so_that_they_can_be_read_again() {
    let folder = tempfile::tempdir().expect("a folder");
    let all = run(words!["config"]).expect(0).result;
    let path = folder.path().join("all.toml");
    std::fs::write(&path, &all).expect("writes");
    assert_eq!(run(words!["config", "--config", path]).expect(0).result, all);
    let changed = run(words!["config", "--set", "fit_sequence.components=7"]).expect(0).result;
    assert_ne!(changed, all);
    assert!(changed.contains("components = 7"));
}

#[test]
fn the_settings_in_the_repository_are_valid() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../configs");
    let mut count = 0;
    for entry in std::fs::read_dir(folder).expect("exists") {
        let path = entry.expect("an entry").path();
        run(words!["config", "--config", path]).expect(0);
        count += 1;
    }
    assert!(count > 0);
}

#[test]
fn completions_name_the_verbs() {
    for shell in ["bash", "zsh", "fish"] {
        let script = run(words!["completions", shell]).expect(0).result;
        assert!(VERBS.iter().all(|verb| script.contains(verb)), "{shell}");
    }
}

#[test]
fn the_version_is_the_packages() {
    let answer = run(words!["--version"]).expect(0);
    assert_eq!(answer.result, format!("habitus {}\n", env!("CARGO_PKG_VERSION")));
}
