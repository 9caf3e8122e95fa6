//! The page of a made-up run: self-contained, safe, within its size, honest about what it leaves out.
#![expect(clippy::expect_used, reason = "test helpers stand outside test functions")]

mod capsule_person;
mod made_up_run;

use base64::Engine;
use habitus_report::report::{CaptureView, ReportData, ReportError, ReportOptions, page, write_report};
use made_up_run::made_up_run;
use serde_json::Value;

fn default_page(data: &ReportData) -> String {
    page(data, &ReportOptions::default()).expect("page")
}

/// The text between a start and the next end.
fn between<'a>(text: &'a str, start: &str, end: &str) -> &'a str {
    let after = text.split_once(start).map(|(_, after)| after).expect("start");
    after.split_once(end).map(|(before, _)| before).expect("end")
}

fn page_data(html: &str) -> Value {
    serde_json::from_str(between(html, "id=\"report-data\">", "</script>")).expect("JSON")
}

fn block(html: &str, id: &str) -> Vec<u8> {
    let text = between(html, &format!("<script type=\"application/octet-stream\" id=\"{id}\">"), "</script>");
    base64::engine::general_purpose::STANDARD.decode(text).expect("base64")
}

#[test]
fn the_page_asks_for_nothing_from_elsewhere() {
    let html = default_page(&made_up_run(5, 8));
    for loader in [
        "http:",
        "https:",
        "src=",
        "@import",
        "url(",
        "fetch(",
        "XMLHttpRequest",
        "import(",
        "<link rel=\"style",
    ] {
        assert!(!html.contains(loader), "{loader}");
    }
    assert!(html.contains("default-src 'none'"));
    assert!(!html.contains("{{"), "a place of the template was left open");
}

#[test]
fn hostile_names_stay_text() {
    let hostile = "</script><script>alert(1)</script>\"'<img src=x onerror=alert(2)>&{{script}}";
    let mut data = made_up_run(3, 8);
    let clean = default_page(&data);
    data.title = hostile.into();
    data.subtitle = hostile.into();
    data.units = hostile.into();
    data.version = hostile.into();
    data.provenance = hostile.into();
    data.frames[1].name = hostile.into();
    data.frames[1].codes = vec![hostile.into()];
    data.frames[1].energies[0].0 = hostile.into();
    data.code_meanings[0].meaning = hostile.into();
    data.measurements[0].name = hostile.into();
    data.measurements[1].definition = hostile.into();
    data.timings[0].stage = hostile.into();
    data.truth[0].metric = hostile.into();
    data.headlines[0].label = hostile.into();
    data.model.as_mut().expect("model").frames[0].landmarks[0].name = hostile.into();
    let html = default_page(&data);
    assert_eq!(html.matches("<script").count(), clean.matches("<script").count());
    assert_eq!(html.matches("</script").count(), clean.matches("</script").count());
    assert!(!html.contains("<img"));
    assert_eq!(page_data(&html)["frames"][1]["name"], hostile);
}

#[test]
fn blocks_hold_what_their_heads_say() {
    let data = made_up_run(4, 8);
    let model = data.model.as_ref().expect("model");
    let html = default_page(&data);
    let head = page_data(&html);
    let vertex_count = model.body.rest_vertices.len();
    assert_eq!(head["body"]["vertexCount"], vertex_count);
    let face_bytes = |count: usize| (count * 6).next_multiple_of(4);
    assert_eq!(block(&html, "block-body").len(), vertex_count * 20 + face_bytes(model.body.faces.len()));
    for (number, view) in model.frames.iter().enumerate() {
        let bytes = block(&html, &format!("block-frame-{number}"));
        let (positions, faces) = (&view.capture.positions, &view.capture.faces);
        let clearance_start = 15 * 48;
        let positions_start = clearance_start + vertex_count.next_multiple_of(4);
        assert_eq!(
            bytes.len(),
            positions_start + (positions.len() * 6).next_multiple_of(4) + face_bytes(faces.len())
        );
        // Rows of three by four: the last number of the first row is the translation along x.
        let translation = f32::from_le_bytes(bytes[12..16].try_into().expect("four bytes"));
        assert!((f64::from(translation) - view.posed_from_rest[0].translation.x).abs() < 1e-6);
        let clearance = f32::from(bytes[clearance_start + 7].cast_signed());
        assert!((clearance - view.clearance_mm[7].clamp(-127.0, 127.0)).abs() <= 0.5);
        let frame_head = &head["views"][number];
        let number_at = |key: &str, axis: usize| frame_head[key][axis].as_f64().expect("number");
        for (vertex, axis) in [(0, 0), (3, 1), (positions.len() - 1, 2)] {
            let at = positions_start + vertex * 6 + axis * 2;
            let share =
                f64::from(u16::from_le_bytes(bytes[at..at + 2].try_into().expect("two bytes"))) / 65_535.0;
            let value = number_at("captureLow", axis) + share * number_at("captureSize", axis);
            // Half a step of 2 m in 65,535 parts.
            assert!((value - positions[vertex][axis]).abs() < 1.6e-5);
        }
    }
}

#[test]
fn a_long_run_keeps_to_the_size_limit_and_says_what_it_leaves_out() {
    let mut data = made_up_run(60, 12);
    let options =
        ReportOptions { size_limit: 900_000, capture_vertex_floor: 900, ..ReportOptions::default() };
    let html = page(&data, &options).expect("page");
    assert!(html.len() <= options.size_limit, "{}", html.len());
    let views = page_data(&html)["views"].as_array().expect("views").len();
    assert!(views > 1 && views < 60, "{views}");
    assert!(html.contains(&format!("holds {views} of 60 frames")));
    assert!(html.contains("Captures are simplified"));
    assert_eq!(page_data(&html)["frames"].as_array().expect("frames").len(), 60);
    let tiny = ReportOptions { size_limit: 1000, ..options };
    assert!(page(&data, &tiny).expect("page").contains("no room for the 3D view"));
    data.model = None;
    assert!(default_page(&data).contains("nothing to show in 3D"));
}

#[test]
fn an_empty_run_still_has_a_page() {
    let html = default_page(&ReportData { title: "Empty".into(), ..ReportData::default() });
    assert!(html.contains("No frames"));
    assert_eq!(page_data(&html)["views"].as_array().expect("views").len(), 0);
}

#[test]
fn values_that_are_not_finite_leave_gaps_and_dashes() {
    let mut data = made_up_run(6, 8);
    data.frames[2].clearance_mm = None;
    data.frames[3].energies[0].1 = f64::NAN;
    data.measurements[0].value = f64::INFINITY;
    data.identity[3].value = f64::NAN;
    data.model.as_mut().expect("model").frames[1].capture.positions[0].x = f64::NAN;
    let html = default_page(&data);
    let visible = between(&html, "</style>", "<script");
    assert!(!visible.contains("NaN") && !visible.contains("inf"), "numbers that a reader cannot read");
    assert!(page_data(&html)["plots"][0]["lines"][0][2].is_null());
}

#[test]
fn contradictions_are_refused_with_their_place() {
    let broken = |change: &dyn Fn(&mut ReportData)| {
        let mut data = made_up_run(3, 8);
        change(&mut data);
        page(&data, &ReportOptions::default()).expect_err("refused")
    };
    let error = broken(&|data| data.model.as_mut().expect("model").frames[1].posed_from_rest.truncate(14));
    assert!(matches!(error, ReportError::Count { expected: 15, found: 14, .. }));
    assert!(error.to_string().contains("coat_walk_0001.ply"));
    let error = broken(&|data| data.model.as_mut().expect("model").frames[2].frame = 3);
    assert!(matches!(error, ReportError::OutOfRange { found: 3, limit: 3, .. }));
    let error = broken(&|data| data.model.as_mut().expect("model").body.rest_vertices[0].y = f64::NAN);
    assert!(matches!(error, ReportError::NotFinite { .. }));
    let error = broken(&|data| {
        data.model.as_mut().expect("model").frames[0].capture =
            CaptureView { positions: Vec::new(), faces: vec![[0, 1, 2]] };
    });
    assert!(matches!(error, ReportError::OutOfRange { found: 0, limit: 0, .. }));
}

#[test]
fn the_same_data_give_the_same_file() {
    let folder = tempfile::tempdir().expect("folder");
    let [first, second] = ["a.html", "b.html"].map(|name| {
        let path = folder.path().join(name);
        write_report(&path, &made_up_run(4, 10), &ReportOptions::default()).expect("written");
        std::fs::read(path).expect("read")
    });
    assert!(first == second);
    assert_eq!(std::fs::read_dir(folder.path()).expect("folder").count(), 2, "temporary files are gone");
    let missing = folder.path().join("missing").join("report.html");
    let error = write_report(&missing, &made_up_run(2, 8), &ReportOptions::default()).expect_err("no folder");
    assert!(matches!(error, ReportError::Write { .. }));
}
