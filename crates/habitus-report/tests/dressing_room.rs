//! The dressing room in a headless Chromium, where one is installed, against a server of the test's own.
#![allow(clippy::expect_used, clippy::print_stderr, reason = "test helpers stand outside test functions")]

use std::io::{BufRead, BufReader, Write};
use std::net::{TcpListener, TcpStream};
use std::path::PathBuf;
use std::process::Command;
use std::sync::Mutex;
use std::sync::mpsc::{Sender, channel};
use std::time::Duration;

use glam::{DMat3, DVec3};
use habitus_report::dressing_room::{
    DressedMotion, DressingChoice, DressingScene, FabricChoice, SizeChoice, SkinnedSurface,
};
use serde_json::Value;

/// Rows and columns of the skirt: 10,000 vertices, as a garment has.
const ROWS: usize = 100;
const COLUMNS: usize = 100;
const COMPONENTS: usize = 40;
const BONES: usize = 15;

/// Clicks what a person would click, and posts what came of it.
const MEASURE: &str = r##"
const check = { troubles: [] };
addEventListener("error", (event) => check.troubles.push(String(event.message)));
addEventListener("unhandledrejection", (event) => check.troubles.push(String(event.reason)));
const wait = (milliseconds) => new Promise((done) => setTimeout(done, milliseconds));
const until = async (holds) => { for (let i = 0; i < 400 && !holds(); i++) await wait(25); };
const changed = (a, b) => {
  let count = 0;
  for (let i = 0; i < a.length; i += 4) if (Math.abs(a[i] - b[i]) + Math.abs(a[i + 1] - b[i + 1]) + Math.abs(a[i + 2] - b[i + 2]) > 12) count++;
  return count / (a.length / 4);
};
const measure = async () => {
  await until(() => document.documentElement.dataset.state !== "loading");
  check.state = document.documentElement.dataset.state;
  const { state, stage, setPlaying, showFrame, isIdle } = window.dressingRoom;
  const click = (selector) => document.querySelector(selector).click();
  const slide = async (name, value) => {
    const input = document.querySelector(`[name="${name}"]`);
    input.value = value;
    input.dispatchEvent(new Event("input", { bubbles: true }));
    await wait(20);
    await until(isIdle);
  };
  await until(() => state.framesDrawn > 0);
  check.framesDrawn = state.framesDrawn;
  setPlaying(false);
  // Adding components and posing alone: pictures of a software rasteriser say nothing about a graphics card.
  const count = stage.clothing.componentCount;
  const times = Array.from({ length: 21 }, (_, k) => {
    const start = performance.now();
    stage.clothing.dress(stage.sequence.base, stage.sequence.coefficients.subarray(k * count, (k + 1) * count), stage.bonesOf(k));
    return performance.now() - start;
  });
  check.dressMilliseconds = times.sort((a, b) => a - b)[10];
  showFrame(0);
  const both = stage.snapshot();
  check.repeat = changed(both, stage.snapshot());
  click('[data-layer="clothing"]');
  const body = stage.snapshot();
  check.clothing = changed(both, body);
  click('[data-layer="body"]');
  check.body = changed(body, stage.snapshot());
  click('[data-layer="body"]');
  click('[data-layer="clothing"]');
  showFrame(10);
  check.otherFrame = changed(both, stage.snapshot());
  showFrame(0);
  for (const [name, value] of [["size_width", 1.4], ["identity_0", 3], ["fabric_1", 2], ["motion", 1], ["fabric", 1]]) {
    await slide(name, value);
    check[name] = changed(both, stage.snapshot());
    click("#reset");
    await wait(20);
    await until(isIdle);
    check[`${name}_back`] = changed(both, stage.snapshot());
  }
  click('[data-layer="clearance"]');
  await wait(20);
  await until(isIdle);
  check.clearance = changed(both, stage.snapshot());
  check.note = document.getElementById("penetration-note").textContent;
  check.answers = state.answers;
  await fetch("/check", { method: "POST", body: JSON.stringify(check) });
};
measure().catch((error) => fetch("/check", { method: "POST", body: JSON.stringify({ troubles: [String(error.stack)] }) }));
"##;

fn tube(
    rows: usize,
    columns: usize,
    low: f64,
    high: f64,
    radius: impl Fn(f64) -> f64,
) -> (Vec<DVec3>, Vec<[u32; 3]>) {
    let place = |row: usize, column: usize| {
        let share = row as f64 / (rows - 1) as f64;
        let angle = column as f64 / columns as f64 * std::f64::consts::TAU;
        DVec3::new(angle.sin() * radius(share), high + (low - high) * share, angle.cos() * radius(share))
    };
    let points = (0..rows).flat_map(|row| (0..columns).map(move |column| (row, column)));
    let positions = points.map(|(row, column)| place(row, column)).collect();
    let mut faces = Vec::new();
    for row in 0..rows - 1 {
        for column in 0..columns {
            let [a, b] = [column, (column + 1) % columns].map(|column| (row * columns + column) as u32);
            let below = columns as u32;
            faces.extend([[a, a + below, b], [b, a + below, b + below]]);
        }
    }
    (positions, faces)
}

fn body() -> (Vec<DVec3>, Vec<[u32; 3]>) {
    tube(60, 40, 0.0, 1.7, |share| 0.14 * (1.0 - share * 0.4))
}

fn skirt() -> (Vec<DVec3>, Vec<[u32; 3]>) {
    tube(ROWS, COLUMNS, 0.4, 1.2, |share| 0.15 + 0.25 * share)
}

fn scene() -> DressingScene {
    let surface = |(positions, faces): (Vec<DVec3>, Vec<[u32; 3]>)| SkinnedSurface {
        vertex_count: positions.len(),
        faces,
        skin: positions.iter().map(|place| vec![(0, 1.0 - place.y * 0.3), (1, place.y * 0.3)]).collect(),
    };
    let wave = |component: usize| {
        let (positions, _) = skirt();
        let amplitude = 0.02 / (1.0 + component as f64);
        let wave = move |place: DVec3| {
            let angle = place.x.atan2(place.z) * (2 + component) as f64;
            DVec3::new(place.x, 0.0, place.z) * angle.sin() * amplitude * (1.2 - place.y)
        };
        positions.into_iter().map(wave).collect()
    };
    DressingScene {
        title: "A tube in a skirt".into(),
        subtitle: "made up".into(),
        body: surface(body()),
        bone_count: BONES,
        clothing: surface(skirt()),
        components: (0..COMPONENTS).map(wave).collect(),
        identity_count: 3,
        motions: vec!["sway".into(), "turn".into()],
        fabrics: vec![
            FabricChoice { name: "first".into(), components: vec![0.0, 0.0] },
            FabricChoice { name: "second".into(), components: vec![1.0, -1.0] },
        ],
        fabric_component_count: 2,
        sizes: vec![SizeChoice {
            name: "width".into(),
            label: "Width".into(),
            low: 0.8,
            high: 1.5,
            value: 1.0,
        }],
        frames_per_second: 30.0,
    }
}

fn answer(choice: &DressingChoice) -> DressedMotion {
    let build = 1.0 + 0.06 * choice.identity[0];
    let widened = |place: DVec3| DVec3::new(place.x * build, place.y, place.z * build);
    let bones = |frame: usize| {
        let time = frame as f64 / 30.0;
        let lean = DMat3::from_rotation_z(0.1 * (time * 4.0).sin());
        let turn = DMat3::from_rotation_y(if choice.motion == 1 { time + 0.4 } else { 0.0 });
        (0..BONES).map(move |bone| (if bone == 1 { turn * lean } else { turn }, DVec3::ZERO)).collect()
    };
    let frame_count = 60;
    let coefficients = (0..frame_count).map(|frame| {
        let swing = |k: usize| (f64::from(frame) * 0.2 + k as f64).sin() * 4.0 + choice.fabric[1] * 6.0;
        (0..COMPONENTS).map(swing).collect()
    });
    let clearance = |_| vec![if choice.identity[0] > 0.0 { -4.0 } else { 12.0 }; ROWS * COLUMNS];
    DressedMotion {
        rest_vertices: body().0.into_iter().map(widened).collect(),
        clothing_base: skirt()
            .0
            .into_iter()
            .map(|place| widened(place) * DVec3::new(choice.sizes[0], 1.0, choice.sizes[0]))
            .collect(),
        bones: (0..frame_count as usize).map(bones).collect(),
        coefficients: coefficients.collect(),
        clearance_mm: if choice.shows_clearance {
            (0..frame_count).map(clearance).collect()
        } else {
            Vec::new()
        },
    }
}

/// Just enough of HTTP for one browser.
fn serve(
    mut stream: TcpStream,
    scene: &DressingScene,
    results: &Mutex<Sender<String>>,
) -> std::io::Result<()> {
    let mut reader = BufReader::new(stream.try_clone()?);
    let mut line = String::new();
    reader.read_line(&mut line)?;
    let mut length = 0;
    loop {
        let mut header = String::new();
        reader.read_line(&mut header)?;
        if let Some(value) = header.to_ascii_lowercase().strip_prefix("content-length:") {
            length = value.trim().parse().unwrap_or(0);
        }
        if header.trim().is_empty() {
            break;
        }
    }
    let target = line.split_whitespace().nth(1).unwrap_or("/").to_string();
    let (kind, body) = match target.as_str() {
        "/" => ("text/html", scene.page().into_bytes()),
        "/style.css" => ("text/css", DressingScene::style().into_bytes()),
        "/script.js" => ("text/javascript", (DressingScene::script() + MEASURE).into_bytes()),
        "/scene.json" => ("application/json", scene.head().to_string().into_bytes()),
        "/scene.bin" => ("application/octet-stream", scene.bytes()),
        question if question.starts_with("/sequence/") => {
            let question = question.trim_start_matches("/sequence/");
            let choice = scene.choice(question).expect("the page asks for what its sliders can say");
            ("application/octet-stream", answer(&choice).bytes())
        }
        "/check" => {
            let mut body = vec![0; length];
            std::io::Read::read_exact(&mut reader, &mut body)?;
            let _ = results.lock().expect("unpoisoned").send(String::from_utf8_lossy(&body).into_owned());
            ("text/plain", Vec::new())
        }
        _ => ("text/plain", Vec::new()),
    };
    write!(
        stream,
        "HTTP/1.1 200 OK\r\nContent-Type: {kind}\r\nContent-Length: {}\r\nConnection: close\r\n\r\n",
        body.len()
    )?;
    stream.write_all(&body)
}

fn browser() -> Option<PathBuf> {
    let path = std::env::var_os("PATH")?;
    let names = ["chromium", "chromium-browser", "google-chrome"];
    std::env::split_paths(&path)
        .flat_map(|folder| names.map(|name| folder.join(name)))
        .find(|file| file.is_file())
}

#[test]
fn every_slider_changes_the_picture_and_reset_brings_it_back() {
    let Some(browser) = browser() else {
        eprintln!("skipped: no chromium in the search path");
        return;
    };
    let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
    let address = listener.local_addr().expect("an address");
    let (sender, receiver) = channel();
    std::thread::spawn(move || {
        let scene = scene();
        let sender = Mutex::new(sender);
        std::thread::scope(|scope| {
            for stream in listener.incoming().flatten() {
                scope.spawn(|| {
                    let _ = serve(stream, &scene, &sender);
                });
            }
        });
    });
    let folder = tempfile::tempdir().expect("a folder");
    let mut running = Command::new(browser)
        .args(["--headless", "--no-sandbox", "--disable-gpu", "--use-gl=angle", "--use-angle=swiftshader"])
        .args(["--enable-unsafe-swiftshader", "--window-size=820,520", "--remote-debugging-port=0"])
        .arg(format!("--user-data-dir={}", folder.path().join("profile").display()))
        .arg(format!("http://{address}/"))
        .stdout(std::process::Stdio::null())
        .stderr(std::process::Stdio::null())
        .spawn()
        .expect("the browser starts");
    let text = receiver.recv_timeout(Duration::from_secs(150));
    let _ = running.kill();
    let _ = running.wait();
    let check: Value = serde_json::from_str(&text.expect("the page answers in time")).expect("JSON");
    eprintln!("{check}");
    assert_eq!(check["troubles"], Value::Array(Vec::new()));
    assert_eq!(check["state"], "ready");
    let share = |name: &str| check[name].as_f64().expect("a share");
    assert!(share("repeat") == 0.0, "the same state gives the same picture: {check}");
    for name in [
        "clothing",
        "body",
        "otherFrame",
        "size_width",
        "identity_0",
        "fabric_1",
        "motion",
        "fabric",
        "clearance",
    ] {
        assert!(share(name) > 3e-3 && share(name) < 0.6, "{name}: {check}");
    }
    for name in ["size_width", "identity_0", "fabric_1", "motion", "fabric"] {
        assert!(share(&format!("{name}_back")) == 0.0, "{name}: {check}");
    }
    assert!(check["note"].as_str().expect("text").starts_with("0.0 % of the cloth inside"), "{check}");
    assert!(share("framesDrawn") > 0.0, "it plays: {check}");
}
