//! A benchmark of one tiny sequence: fitted in two ways, resumed, compared.

use serde_json::Value;

use crate::bench::{fitted, quick_settings, run};
use crate::words;

#[test]
fn a_benchmark_is_fitted_once_and_compared_by_style() {
    let folder = tempfile::tempdir().expect("a folder");
    let (benchmark, out) = (folder.path().join("benchmark"), folder.path().join("results"));
    let sequence = benchmark.join("one_tight_walk");
    std::fs::create_dir_all(&sequence).expect("makes");
    for entry in std::fs::read_dir(&fitted().captures).expect("lists") {
        let path = entry.expect("an entry").path();
        std::fs::copy(&path, sequence.join(path.file_name().expect("a name"))).expect("copies");
    }
    let variant = folder.path().join("few.toml");
    std::fs::write(&variant, "[fit_sequence]\ncomponents = 6\n").expect("writes");
    let mut words =
        words!["evaluate", "benchmark", benchmark, "-o", out, "--recipe", "default", "--variant", variant]
            .to_vec();
    // All but the number of components, which the variant sets.
    let settings = quick_settings();
    words.extend(settings.chunks(2).filter(|pair| !pair[1].contains("components")).flatten().map(Into::into));
    let answer = run(&words).expect(0);
    assert!(answer.result.contains("default") && answer.result.contains("few"), "{answer:?}");
    let read = || -> Value {
        let text = std::fs::read_to_string(out.join("metrics.json")).expect("exists");
        serde_json::from_str(&text).expect("is JSON")
    };
    let metrics = read();
    assert_eq!(metrics["variant"], "default");
    assert_eq!(metrics["overall"], metrics["variants"]["default"]["overall"]);
    assert_ne!(metrics["overall"], metrics["variants"]["few"]["overall"]);
    assert_eq!(metrics["sequences"].as_object().expect("by name").len(), 1);
    assert!(out.join("runs/few/one_tight_walk/3_fit_sequence/fit.npz").is_file());
    assert!(!out.join("runs/few/one_tight_walk/report.html").exists(), "one page for all");
    // The one sequence is in tight clothes, and that figure is about loose ones.
    assert!(!out.join("shape_by_variant.svg").exists());

    let again = run(&words).expect(0);
    assert!(again.messages.contains("already finished"), "{again:?}");
    assert_eq!(read(), metrics);
    // The same runs, compared by themselves.
    let (run_of_few, other) = (out.join("runs/few/one_tight_walk"), folder.path().join("other"));
    run(words!["evaluate", "sequence", run_of_few, "--truth", benchmark, "-o", other]).expect(0);
    let text = std::fs::read_to_string(other.join("metrics.json")).expect("exists");
    let alone: Value = serde_json::from_str(&text).expect("is JSON");
    assert_eq!(alone["overall"], metrics["variants"]["few"]["overall"]);
}

#[test]
fn what_is_no_benchmark_says_how_to_make_one() {
    let folder = tempfile::tempdir().expect("a folder");
    let out = folder.path().join("out");
    let answer = run(words!["evaluate", "benchmark", folder.path(), "-o", out]).expect(1);
    assert!(answer.messages.contains("habitus generate benchmark"), "{answer:?}");
    assert!(!out.exists(), "a wrong input leaves nothing behind");
    let answer = run(words!["generate", "benchmark", "-o", out, "--only", "nobody"]).expect(1);
    assert!(answer.messages.contains("--only nobody"), "{answer:?}");
}
