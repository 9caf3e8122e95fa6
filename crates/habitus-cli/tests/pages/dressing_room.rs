//! `habitus synthesize --interactive`.

use std::path::PathBuf;

use serde_json::Value;
use tempfile::TempDir;

use crate::browser::Browser;
use crate::dressed_people::{SEQUENCES, write_dressed_model};
use crate::server::{Served, habitus};

fn model() -> (TempDir, PathBuf) {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("tunic & more.npz");
    write_dressed_model(&path);
    (folder, path)
}

fn interactive(path: &std::path::Path) -> std::process::Command {
    let mut command = habitus();
    command.arg("synthesize").arg(path).arg("--interactive");
    command
}

#[test]
fn nothing_but_the_room_is_served_and_unknown_names_list_the_known_ones() {
    let (folder, path) = model();
    let said = |arguments: &[&str]| {
        let output = interactive(&path).args(arguments).output().expect("runs");
        assert!(!output.status.success(), "{output:?}");
        String::from_utf8_lossy(&output.stderr).into_owned()
    };
    let message = said(&["--material", "chainmail"]);
    assert!(message.contains("silk-satin") && message.contains("cotton-poplin"), "{message}");
    assert!(said(&["--fit", "sleeve=1"]).contains("tunic_width"));
    assert!(said(&["--fit", "tunic_width=wide"]).contains("NAME=NUMBER"));
    assert!(said(&["--motion", "dance"]).contains("denim, silk-satin, jersey"));
    assert!(said(&["-o", "somewhere"]).contains("cannot be used with"));

    let served = Served::start(interactive(&path).args(["--material", "linen", "--fit", "tunic_width=1.3"]));
    for there in ["/", "/style.css", "/script.js", "/scene.json", "/scene.bin"] {
        assert_eq!(served.get(there).0, 200, "{there}");
    }
    let scene: Value = serde_json::from_slice(&served.get("/scene.json").1).expect("is JSON");
    assert_eq!(scene["motions"], Value::from(SEQUENCES.map(|(name, _)| name).to_vec()));
    // The mean, what was learnt from, and the other fabrics of our own.
    assert_eq!(scene["fabrics"].as_array().map(Vec::len), Some(9));
    assert_eq!(scene["sizes"][0]["value"], 1.3);
    let zeros = ["0"; 8].join(",");
    let fabric = ["0"; 2].join(",");
    let asked = format!("/sequence/motion=1;identity={zeros};fabric={fabric};sizes=1.2");
    let (status, answer) = served.get(&asked);
    assert_eq!((status, u32::from_le_bytes([answer[0], answer[1], answer[2], answer[3]])), (200, 16));
    for (refused, status) in [
        (asked.replace("motion=1", "motion=3"), 400),
        (asked.replace("sizes=1.2", "sizes=9"), 400),
        ("/sequence/".to_string(), 400),
        ("/model.npz".to_string(), 404),
        ("/sequence/..%2F..%2Fetc".to_string(), 400),
    ] {
        assert_eq!(served.get(&refused).0, status, "{refused}");
    }
    drop(served);
    assert_eq!(std::fs::read_dir(folder.path()).expect("is there").count(), 1, "nothing is written");
}

#[test]
fn a_person_dresses_another_with_clicks() {
    let (_folder, path) = model();
    let served = Served::start(&mut interactive(&path));
    let Some(mut page) = Browser::open(&served.address) else { return };
    page.wait_for("document.documentElement.dataset.state === 'ready'");
    page.wait_for("dressingRoom.state.framesDrawn > 2");
    page.click("#play");
    assert_eq!(page.value("dressingRoom.state.isPlaying"), false);
    page.value("dressingRoom.showFrame(0), 0");
    page.value("window.before = dressingRoom.stage.snapshot(), 0");
    let changed = "((a, b) => { let count = 0; for (let i = 0; i < a.length; i += 4) \
                   if (Math.abs(a[i] - b[i]) + Math.abs(a[i + 1] - b[i + 1]) + Math.abs(a[i + 2] - b[i + 2]) > 12) count++; return count / (a.length / 4); })(before, dressingRoom.stage.snapshot())";
    let share = |page: &mut Browser| page.value(changed).as_f64().expect("a number");
    assert_eq!(share(&mut page), 0.0);
    for (name, value) in [
        ("size_tunic_width", "1.4"),
        ("identity_0", "3"),
        ("fabric_0", "1.3"),
        ("fabric", "1"),
        ("motion", "1"),
    ] {
        page.value(&format!(
            "(() => {{ const input = document.querySelector('[name={name}]'); input.value = {value}; \
             input.dispatchEvent(new Event('input', {{ bubbles: true }})); }})()"
        ));
        page.wait_for("dressingRoom.isIdle()");
        let moved = share(&mut page);
        // The motions of the model are one and the same here: only the list is looked at.
        assert!(moved > 1e-3 || name == "motion", "{name}: {moved}");
        page.click("#reset");
        page.wait_for("dressingRoom.isIdle()");
        assert_eq!(share(&mut page), 0.0, "{name} goes back");
    }
    page.click("[data-layer=clearance]");
    page.wait_for("dressingRoom.isIdle() && document.getElementById('penetration-note').textContent !== ''");
    assert!(share(&mut page) > 1e-2);
    page.picture("dressing_room_clearance");
    // Denim was learnt as the narrowest tunic, which reaches into the body, and the page says so.
    let inside = "parseFloat(document.getElementById('penetration-note').textContent)";
    let before = page.value(inside).as_f64().expect("a share");
    page.value(
        "(() => { const set = (name, value) => { const input = document.querySelector(`[name=${name}]`); input.value = value(input); \
         input.dispatchEvent(new Event('input', { bubbles: true })); }; set('fabric', () => 1); set('size_tunic_width', (input) => input.min); })()",
    );
    page.wait_for("dressingRoom.isIdle()");
    let after = page.value(inside).as_f64().expect("a share");
    assert!(after > before + 1.0, "{before} % to {after} %");
    page.click("[data-layer=clearance]");
    page.click("[data-layer=penetration]");
    page.wait_for("dressingRoom.isIdle()");
    page.picture("dressing_room_penetration");
    assert_eq!(page.troubles, Vec::<String>::new());
}

#[test]
fn the_page_of_a_synthesis_plays_with_and_without_the_push_out() {
    let (folder, path) = model();
    let run = folder.path().join("narrow");
    let synthesize = || {
        let mut command = habitus();
        command
            .args(["synthesize", "--fit", "tunic_width=0.5", "--motion", "denim", "-o"])
            .arg(&run)
            .arg(&path);
        command.output().expect("runs")
    };
    let made = synthesize();
    assert!(made.status.success(), "{made:?}");
    // Finished work is not done again, and says the same.
    let again = synthesize();
    assert!(String::from_utf8_lossy(&again.stderr).contains("already finished"), "{again:?}");
    assert_eq!(made.stdout, again.stdout);
    let report = run.join("6_synthesize/report.html");
    let Some(mut page) = Browser::open(&format!("file://{}", report.display())) else { return };
    page.wait_for("document.documentElement.dataset.state === 'ready'");
    page.wait_for("dressedReport.state.framesDrawn > 1");
    page.click("#play");
    page.value("dressedReport.showFrame(3), 0");
    page.value("window.before = dressedReport.stage.snapshot(), 0");
    page.click("[data-layer=penetration]");
    let inside = "parseFloat(document.getElementById('penetration-note').textContent)";
    let after_push = page.value(inside).as_f64().expect("a share");
    page.click("[data-layer=before]");
    let before_push = page.value(inside).as_f64().expect("a share");
    assert!(before_push > after_push + 5.0, "{before_push} % before, {after_push} % after the push-out");
    let changed = "((a, b) => a.some((value, i) => Math.abs(value - b[i]) > 12))(before, dressedReport.stage.snapshot())";
    assert_eq!(page.value(changed), true);
    page.picture("synthesis_page");
    assert_eq!(page.troubles, Vec::<String>::new());
}
