//! The page in a headless Chromium, where one is installed: what is drawn, and that nothing is loaded.
#![expect(clippy::expect_used, clippy::print_stderr, reason = "test helpers stand outside test functions")]

mod capsule_person;
mod made_up_run;

use std::path::{Path, PathBuf};
use std::process::Command;

use habitus_report::report::{CaptureView, ReportData, ReportOptions, page};
use made_up_run::made_up_run;
use serde_json::Value;

/// Notes every error and every refused load from the very start of the page.
const WATCH: &str = "<script>window.troubles = [];
addEventListener('error', (event) => troubles.push(String(event.message)));
addEventListener('unhandledrejection', (event) => troubles.push(String(event.reason)));
addEventListener('securitypolicyviolation', (event) => troubles.push('refused ' + event.blockedURI));</script>";

/// Switches layers and frames, and writes the share of pixels that each step changes into the page.
const MEASURE: &str = r#"<script type="module">
const check = { state: document.documentElement.dataset.state, troubles };
const { showFrame, setLayer, snapshot, state, layers } = window.habitusReport;
const changed = (a, b) => {
  let count = 0;
  for (let i = 0; i < a.length; i += 4) if (Math.abs(a[i] - b[i]) + Math.abs(a[i + 1] - b[i + 1]) + Math.abs(a[i + 2] - b[i + 2]) > 12) count++;
  return count / (a.length / 4);
};
const only = (...names) => Object.keys(layers).forEach((name) => name !== "follow" && setLayer(name, names.includes(name)));
const press = (key) => document.body.dispatchEvent(new KeyboardEvent("keydown", { key, bubbles: true }));
try {
  only();
  const nothing = snapshot();
  only("body");
  const body = snapshot();
  check.body = changed(nothing, body);
  only("capture");
  check.capture = changed(nothing, snapshot());
  only("body", "capture");
  const both = snapshot();
  check.captureOverBody = changed(body, both);
  const center = (pixels) => [...pixels.slice((pixels.length / 8 | 0) * 4, (pixels.length / 8 | 0) * 4 + 3)];
  check.repeat = changed(both, snapshot());
  for (const layer of ["heat", "curves", "landmarks", "skeleton"]) {
    only("body", layer);
    check[layer] = changed(body, snapshot());
  }
  only("body", "capture");
  showFrame(2);
  check.otherFrame = changed(both, snapshot());
  press("ArrowRight");
  check.frameAfterArrow = state.frame;
  press("h");
  check.heatAfterKey = layers.heat;
  document.querySelector('[data-row]').click();
  check.rowAfterClick = state.row;
  document.querySelector('.chip').click();
  check.frameAfterChip = state.frame;
  check.current = document.querySelector('#frame-list [aria-current]').dataset.frame;
  check.readout = document.querySelector('.plot-readout').textContent;
  check.loads = performance.getEntriesByType("resource").length;
} catch (error) {
  troubles.push(String(error.stack));
}
const out = document.createElement("pre");
out.id = "check";
out.textContent = JSON.stringify(check);
document.body.append(out);
</script></body>"#;

fn browser() -> Option<PathBuf> {
    let path = std::env::var_os("PATH")?;
    let names = ["chromium", "chromium-browser", "google-chrome"];
    std::env::split_paths(&path)
        .flat_map(|folder| names.map(|name| folder.join(name)))
        .find(|file| file.is_file())
}

fn run_browser(browser: &Path, folder: &Path, more: &[&str], page: &Path) -> std::process::Output {
    let profile = format!("--user-data-dir={}", folder.join("profile").display());
    Command::new(browser)
        .args(["--headless", "--no-sandbox", "--disable-gpu", "--use-gl=angle", "--use-angle=swiftshader"])
        .args([
            "--enable-unsafe-swiftshader",
            "--virtual-time-budget=8000",
            "--window-size=1280,900",
            &profile,
        ])
        .args(more)
        .arg(format!("file://{}", page.display()))
        .output()
        .expect("the browser starts")
}

/// The page's own measurements in a browser; none, and a remark, where no browser is installed.
fn measured(data: &ReportData, flags: &[&str]) -> Option<Value> {
    let Some(browser) = browser() else {
        eprintln!("skipped: no chromium in the search path");
        return None;
    };
    let html = page(data, &ReportOptions::default()).expect("page");
    let html = html.replacen("<style>", &format!("{WATCH}<style>"), 1).replacen("</body>", MEASURE, 1);
    let folder = tempfile::tempdir().expect("folder");
    let file = folder.path().join("report.html");
    std::fs::write(&file, html).expect("written");
    let output = run_browser(&browser, folder.path(), &[&["--dump-dom"], flags].concat(), &file);
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    let (_, after) = text.rsplit_once("<pre id=\"check\">").expect("the page measured itself");
    let json = after.split_once("</pre>").map(|(json, _)| json.replace("&lt;", "<").replace("&gt;", ">"));
    Some(serde_json::from_str(&json.expect("end").replace("&amp;", "&")).expect("JSON"))
}

#[test]
fn body_and_capture_are_drawn_and_every_control_changes_the_picture() {
    let Some(check) = measured(&made_up_run(12, 16), &[]) else { return };
    assert_eq!(check["troubles"], Value::Array(Vec::new()));
    assert_eq!(check["state"], "ready");
    assert_eq!(check["loads"], 0);
    let share = |name: &str| check[name].as_f64().expect("share");
    // A person fills several hundredths of the view; thin lines and dots a few thousandths.
    for name in ["body", "capture", "captureOverBody", "heat", "otherFrame"] {
        assert!(share(name) > 0.02 && share(name) < 0.6, "{name}: {check}");
    }
    for name in ["curves", "landmarks", "skeleton"] {
        assert!(share(name) > 5e-4 && share(name) < 0.05, "{name}: {check}");
    }
    assert!(share("repeat") == 0.0, "the same state gives the same picture: {check}");
    assert_eq!(check["frameAfterArrow"], 3);
    assert_eq!(check["heatAfterKey"], true);
    assert_eq!(check["rowAfterClick"], 1);
    assert_eq!(check["frameAfterChip"], 4);
    assert_eq!(check["current"], "4");
    assert!(check["readout"].as_str().expect("text").ends_with(") mm"));
}

#[test]
fn without_webgl_the_page_says_so_and_keeps_its_tables() {
    let Some(check) = measured(&made_up_run(3, 8), &["--disable-3d-apis"]) else { return };
    assert_eq!(check["state"], "without-3d");
}

#[test]
fn a_run_whose_captures_are_gone_shows_the_body() {
    let mut data = made_up_run(4, 12);
    for view in &mut data.model.as_mut().expect("model").frames {
        view.capture = CaptureView::default();
        view.clearance_mm.clear();
    }
    let Some(check) = measured(&data, &[]) else { return };
    let share = |name: &str| check[name].as_f64().expect("share");
    assert!(share("body") > 0.02 && share("body") < 0.6 && share("capture") == 0.0, "{check}");
}

#[test]
fn pages_without_a_body_work() {
    let mut data = made_up_run(3, 8);
    data.model = None;
    let Some(check) = measured(&data, &[]) else { return };
    assert_eq!(check["state"], "ready");
}
