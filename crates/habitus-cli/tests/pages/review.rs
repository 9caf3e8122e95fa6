//! `habitus review`.

use habitus::artifacts::review_decisions::{ReviewDecisions, Verdict};
use serde_json::Value;

use crate::browser::Browser;
use crate::registered_people::{RegisteredPeople, WORST_FIRST, registered_people};
use crate::server::{Served, habitus};

fn review(people: &RegisteredPeople) -> std::process::Command {
    let mut command = habitus();
    command.arg("review").arg(&people.run).arg("--scans").arg(&people.scans);
    command
}

fn verdicts(people: &RegisteredPeople) -> Vec<(String, Option<Verdict>)> {
    let decisions = ReviewDecisions::read(&people.run.join(ReviewDecisions::FILE)).expect("are readable");
    decisions.iter().map(|decision| (decision.scan.clone(), decision.verdict)).collect()
}

#[test]
fn the_ranking_is_printed_worst_first_and_decides_without_a_page() {
    let people = registered_people();
    let listed = review(&people).arg("--list").output().expect("runs");
    assert!(listed.status.success(), "{listed:?}");
    let text = String::from_utf8_lossy(&listed.stdout).into_owned();
    let names: Vec<&str> = text.lines().skip(1).filter_map(|line| line.split('\t').next_back()).collect();
    assert_eq!(names, WORST_FIRST);
    // A person's word stands, whatever the score says.
    let file = people.run.join(ReviewDecisions::FILE);
    std::fs::write(
        &file,
        "[[decision]]\nscan = \"belly bulge\"\nverdict = \"accept\"\nnote = \"pregnant\"\n",
    )
    .expect("writes");
    let decided = review(&people).args(["--accept-below", "1.0"]).output().expect("runs");
    assert!(decided.status.success(), "{decided:?}");
    let all = ReviewDecisions::read(&file).expect("are readable");
    let accepted: Vec<&str> = WORST_FIRST
        .into_iter()
        .filter(|name| all.of(name).expect("decided").verdict == Some(Verdict::Accept))
        .collect();
    assert_eq!(accepted, ["belly bulge", "everywhere 2 mm", "exact"]);
    assert_eq!(all.of("belly bulge").expect("decided").note, "pregnant");
    assert!(all.of("unusual").expect("decided").note.starts_with("score "));
}

#[test]
fn faults_of_a_run_are_said_before_anybody_starts() {
    let people = registered_people();
    let said = |command: &mut std::process::Command| {
        let output = command.output().expect("runs");
        assert_eq!(output.status.code(), Some(1), "{output:?}");
        String::from_utf8_lossy(&output.stderr).into_owned()
    };
    assert!(said(habitus().arg("review").arg(&people.run)).contains("--scans"));
    let empty = tempfile::tempdir().expect("a folder");
    assert!(
        said(habitus().arg("review").arg(empty.path()).arg("--scans").arg(&people.scans))
            .contains("habitus register")
    );
    assert!(said(habitus().arg("review").arg(empty.path().join("none"))).contains("no such run folder"));
    assert!(said(review(&people).args(["--accept-below", "nan"])).contains("--accept-below"));
    std::fs::write(people.run.join(ReviewDecisions::FILE), "[[decision]]\nscan = 3\n").expect("writes");
    assert!(said(&mut review(&people)).contains("line 2"));
}

#[test]
fn nothing_but_the_review_is_served_and_ctrl_c_keeps_what_was_decided() {
    let people = registered_people();
    let mut served = Served::start(&mut review(&people));
    let origin = served.origin();
    assert_eq!(served.get("/").0, 200);
    assert_eq!(served.get("/review.js").0, 200);
    assert_eq!(served.get("/api/registration/exact").0, 200);
    for path in [
        "/1_register/exact.ply",
        "/decisions.toml",
        "/api/registration/..",
        "/api/registration/..%2Fexact",
        "/api/registration/nobody",
        "/api/registration/exact/x",
        "/api/decision",
    ] {
        assert!([400, 404].contains(&served.get(path).0), "{path}");
    }
    let exact = r#"{"scan":"exact","verdict":"accept","note":" fine "}"#;
    assert_eq!(served.post("/api/decision", "http://evil.example", exact).0, 403);
    assert!(verdicts(&people).is_empty());
    assert_eq!(served.post("/api/decision", &origin, exact).0, 200);
    for wrong in
        [r#"{"scan":"nobody","verdict":"accept"}"#, r#"{"scan":"exact","verdict":"perhaps"}"#, "[]", ""]
    {
        assert!([400, 404].contains(&served.post("/api/decision", &origin, wrong).0), "{wrong}");
    }
    assert_eq!(verdicts(&people), [("exact".to_string(), Some(Verdict::Accept))]);
    // A second review of the same run is told to wait.
    let second = review(&people).output().expect("runs");
    assert!(String::from_utf8_lossy(&second.stderr).contains("another habitus"), "{second:?}");
    assert!(!served.interrupt().success());
    assert_eq!(verdicts(&people), [("exact".to_string(), Some(Verdict::Accept))]);
}

#[test]
fn a_person_reviews_with_keys_and_clicks() {
    let people = registered_people();
    let mut served = Served::start(&mut review(&people));
    let Some(mut page) = Browser::open(&served.address) else { return };
    let shown = |name: &str| format!("document.documentElement.dataset.shown === {}", Value::from(name));
    page.wait_for("document.documentElement.dataset.state === 'ready'");
    // Worst first, and the name is text, not markup.
    page.wait_for(&shown(WORST_FIRST[0]));
    assert_eq!(
        page.value("[...document.querySelectorAll('#scan-list .name')].map((name) => name.textContent)"),
        Value::from(WORST_FIRST.to_vec())
    );
    assert_eq!(page.value("document.querySelectorAll('#scan-list b').length"), 0);
    page.picture("review_worst");

    // What is drawn changes with each layer.
    let changed = "((a, b) => { let count = 0; for (let i = 0; i < a.length; i += 4) \
                   if (Math.abs(a[i] - b[i]) + Math.abs(a[i + 1] - b[i + 1]) + Math.abs(a[i + 2] - b[i + 2]) > 12) count++; return count / (a.length / 4); })";
    page.value("window.before = habitusReview.snapshot(), 0");
    // Where scan and registration coincide, the registration alone is seen, and both are neutral: they differ at the arm.
    for (key, least) in [("e", 0.01), ("s", 2e-4), ("m", 1e-3)] {
        page.press(key);
        let share = page.value(&format!("{changed}(before, habitusReview.snapshot())"));
        assert!(share.as_f64().is_some_and(|share| share > least), "{key}: {share}");
        page.press(key);
    }
    assert_eq!(page.value(&format!("{changed}(before, habitusReview.snapshot())")), 0.0);
    page.press("w");
    page.value("habitusReview.snapshot(), 0");
    page.picture("review_worst_place");
    page.press("0");

    // Reject with a note, by keys; the next undecided comes by itself.
    page.press("n");
    page.type_text("the arm");
    page.press("Enter");
    page.press("r");
    page.wait_for(&shown(WORST_FIRST[1]));
    page.click("#accept");
    page.wait_for(&shown(WORST_FIRST[2]));
    page.value("habitusReview.settled().then(() => 0)");
    let rejected = Some(Verdict::Reject);
    let accepted = Some(Verdict::Accept);
    assert_eq!(
        verdicts(&people),
        [(WORST_FIRST[0].to_string(), rejected), (WORST_FIRST[1].to_string(), accepted)]
    );
    assert_eq!(
        page.value("document.getElementById('progress-text').textContent"),
        "1 accepted, 1 rejected, 3 to decide"
    );

    // Take the last back, and give it the other verdict by a click.
    page.press("z");
    page.wait_for(&shown(WORST_FIRST[1]));
    page.value("habitusReview.settled().then(() => 0)");
    assert_eq!(verdicts(&people), [(WORST_FIRST[0].to_string(), rejected)]);
    page.click("#reject");
    page.wait_for(&shown(WORST_FIRST[2]));

    // Filter, sort and search.
    page.click("[data-filter='reject']");
    assert_eq!(page.value("document.querySelectorAll('#scan-list .scan').length"), 2);
    page.click("[data-filter='all']");
    page.value("(() => { const sort = document.getElementById('sort'); sort.value = 'mahalanobis'; sort.dispatchEvent(new Event('change')); })()");
    assert_eq!(page.value("document.querySelector('#scan-list .name').textContent"), "unusual");
    page.press("/");
    page.type_text("the arm");
    assert_eq!(
        page.value("document.querySelectorAll('#scan-list .scan').length"),
        1,
        "notes are searched as well"
    );
    page.value("(() => { const search = document.getElementById('search'); search.value = ''; search.dispatchEvent(new Event('input')); search.blur(); })()");

    // Every other scan with the keyboard alone.
    page.press("u");
    page.wait_for("document.documentElement.dataset.shown !== ''");
    for left in [2, 1, 0] {
        page.press("a");
        page.wait_for(&format!(
            "document.getElementById('progress-text').textContent.endsWith('{left} to decide')"
        ));
        page.wait_for("document.documentElement.dataset.shown !== ''");
    }
    page.picture("review_done");
    page.click("#finish");
    page.wait_for("document.documentElement.dataset.state === 'finished'");
    assert!(served.ended().success());
    let all = ReviewDecisions::read(&people.run.join(ReviewDecisions::FILE)).expect("are readable");
    let words: Vec<_> = WORST_FIRST.iter().map(|name| all.of(name).expect("decided").verdict).collect();
    assert_eq!(words, [rejected, rejected, accepted, accepted, accepted]);
    assert_eq!(all.of(WORST_FIRST[0]).expect("decided").note, "the arm");
    assert_eq!(page.troubles, Vec::<String>::new());
}
