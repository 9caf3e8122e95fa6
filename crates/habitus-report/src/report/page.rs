//! The page: template, tables, plots, data and blocks in one text.

use rayon::prelude::*;
use serde::Serialize;

use super::blocks::{Block, BodyHead, FrameHead, body_block, frame_block};
use super::check::check;
use super::decimate::decimated;
use super::markup::{escaped, script_json};
use super::plan::{Plan, plan};
use super::plots::{Plot, figures, plots};
use super::{ModelView, ReportData, ReportError, ReportOptions, tables};
use crate::render::ColorScale;

const TEMPLATE: &str = include_str!("../../assets/template.html");
const VIEWER_MARKUP: &str = include_str!("../../assets/viewer.html");
pub(crate) const STYLE: &str = include_str!("../../assets/style.css");
/// The parts of the one script, in the order in which they need each other.
const SCRIPTS: [&str; 6] = [
    include_str!("../../assets/linear_algebra.js"),
    include_str!("../../assets/blocks.js"),
    include_str!("../../assets/shaders.js"),
    include_str!("../../assets/viewer.js"),
    include_str!("../../assets/controls.js"),
    include_str!("../../assets/page.js"),
];
const IDENTITY_NOTE: &str = "Standard deviations of the population; dashed: the limits.";
/// The keys of the 3D view.
const KEYS: &str = "<p class=\"keys\"><kbd>space</kbd> play <kbd>←</kbd> <kbd>→</kbd> frame <kbd>c</kbd> capture <kbd>b</kbd> body <kbd>h</kbd> clearance <kbd>m</kbd> curves <kbd>l</kbd> landmarks <kbd>s</kbd> skeleton <kbd>f</kbd> follow</p>";
/// Steps of the heat map's colour table.
const HEAT_STEPS: usize = 256;
/// How often the plan is tightened when the page comes out too large.
const PLAN_TRIALS: usize = 6;

/// What the script reads.
#[derive(Serialize)]
#[serde(rename_all = "camelCase")]
struct PageData<'a> {
    frames: Vec<PageFrame<'a>>,
    plots: &'a [Plot],
    frames_per_second: f64,
    heat_range: [f64; 2],
    heat_colors: Vec<[u8; 3]>,
    body: Option<&'a BodyHead>,
    views: Vec<&'a FrameHead>,
}

#[derive(Serialize)]
struct PageFrame<'a> {
    name: &'a str,
    trust: &'static str,
    codes: &'a [String],
}

/// The 3D view as it goes into the page.
struct Viewer {
    body: Block<BodyHead>,
    frames: Vec<Block<FrameHead>>,
    plan: Plan,
}

/// The whole page as HTML.
///
/// # Errors
/// When the data contradict themselves.
pub fn page(data: &ReportData, options: &ReportOptions) -> Result<String, ReportError> {
    check(data)?;
    let plots = plots(data);
    let bare = assemble(data, options, &plots, None)?;
    let Some(model) = data.model.as_ref().filter(|model| !model.frames.is_empty()) else { return Ok(bare) };
    let body = body_block(&model.body, &data.measurements);
    let fixed = bare.len() + body.base64.len() + script_json(&body.head)?.len() + VIEWER_MARKUP.len();
    let mut available = options.size_limit.saturating_sub(fixed);
    let mut viewer = Viewer { body, frames: Vec::new(), plan: plan(model, available, options) };
    for _ in 0..PLAN_TRIALS {
        if viewer.plan.selected.is_empty() {
            break;
        }
        viewer.frames = frame_blocks(model, &viewer.plan);
        let html = assemble(data, options, &plots, Some(&viewer))?;
        if html.len() <= options.size_limit {
            return Ok(html);
        }
        // Captures with more faces a vertex than planned: less room the next time.
        available -= (html.len() - options.size_limit).min(available) + available / 50;
        viewer.plan = plan(model, available, options);
    }
    Ok(bare)
}

fn frame_blocks(model: &ModelView, plan: &Plan) -> Vec<Block<FrameHead>> {
    let frames = plan.selected.par_iter().map(|number| &model.frames[*number]);
    frames.map(|view| frame_block(view, &decimated(&view.capture, plan.capture_vertices))).collect()
}

fn assemble(
    data: &ReportData,
    options: &ReportOptions,
    plots: &[Plot],
    viewer: Option<&Viewer>,
) -> Result<String, ReportError> {
    let [low_mm, high_mm] = options.clearance_range_mm;
    let page_data = PageData {
        frames: data
            .frames
            .iter()
            .map(|frame| PageFrame { name: &frame.name, trust: tables::trust(frame), codes: &frame.codes })
            .collect(),
        plots,
        frames_per_second: if data.frames_per_second > 0.0 { data.frames_per_second } else { 30.0 },
        heat_range: [low_mm, high_mm],
        heat_colors: ColorScale { low_mm, high_mm }.table(HEAT_STEPS),
        body: viewer.map(|viewer| &viewer.body.head),
        views: viewer.iter().flat_map(|viewer| &viewer.frames).map(|block| &block.head).collect(),
    };
    let json = script_json(&page_data)?;
    let frames_word =
        if data.frames.len() == 1 { "1 frame".to_owned() } else { format!("{} frames", data.frames.len()) };
    let main_column = [
        tables::section(
            "measurements",
            "Measurements",
            "Choose a row to see it on the body.",
            &tables::measurements(data),
        ),
        tables::section("truth", "Against known truth", "", &tables::truth(data)),
        tables::section("provenance", "Provenance", "", &provenance(data)),
    ];
    let side_column = [
        tables::section("codes", "Codes", "Why a frame should not be trusted blindly.", &tables::codes(data)),
        tables::section("identity", "Identity", IDENTITY_NOTE, &tables::identity(&data.identity)),
        tables::section("timings", "Time", "", &tables::timings(data)),
    ];
    let plot_section = tables::section(
        "curves",
        "Frame by frame",
        "Point at a curve to move the cursor; press to jump there.",
        &figures(plots, &data.frames),
    );
    let values = [
        ("title", escaped(&data.title)),
        ("subtitle", escaped(&data.subtitle)),
        ("version", escaped(&data.version)),
        ("units", escaped(&data.units)),
        ("frame_count", frames_word),
        ("verdict", tables::verdict(data)),
        ("headlines", tables::headlines(data)),
        ("stage", stage(data, viewer)),
        ("plots", plot_section),
        ("main_column", main_column.concat()),
        ("side_column", side_column.concat()),
        ("style", STYLE.to_owned()),
        ("data", json),
        ("blocks", viewer.map_or(String::new(), blocks)),
        ("script", SCRIPTS.join("\n")),
    ];
    Ok(filled(TEMPLATE, &values))
}

fn provenance(data: &ReportData) -> String {
    if data.provenance.is_empty() {
        return String::new();
    }
    format!("<pre tabindex=\"0\">{}</pre>", escaped(&data.provenance))
}

/// The 3D view with its frame list, or the reason why there is none.
fn stage(data: &ReportData, viewer: Option<&Viewer>) -> String {
    let list = tables::frame_list(&data.frames);
    let notice = match (viewer, data.model.as_ref()) {
        (Some(viewer), Some(model)) => selection_notice(&viewer.plan, model, data.frames.len()),
        (None, Some(model)) if !model.frames.is_empty() => {
            "The size limit of this page leaves no room for the 3D view; raise the limit to have it."
                .to_owned()
        }
        _ => "This run has nothing to show in 3D.".to_owned(),
    };
    let view = if viewer.is_some() { VIEWER_MARKUP } else { "" };
    filled(
        "<section class=\"stage{{class}}\" aria-label=\"3D view and frames\">{{view}}<aside class=\"frames\"><h2>Frames</h2><ol id=\"frame-list\">{{list}}</ol></aside></section><div class=\"stage-notes\"><p class=\"stage-note\">{{notice}}</p>{{keys}}</div>",
        &[
            ("class", if viewer.is_some() { "" } else { " without-view" }.to_owned()),
            ("view", view.to_owned()),
            ("list", list),
            ("notice", escaped(&notice)),
            ("keys", if viewer.is_some() { KEYS } else { "" }.to_owned()),
        ],
    )
}

fn selection_notice(plan: &Plan, model: &ModelView, frame_count: usize) -> String {
    let mut notice = String::new();
    if plan.selected.len() < frame_count {
        notice = format!(
            "The 3D view holds {} of {} frames, evenly chosen, to keep this page small; curves and tables hold all frames. ",
            plan.selected.len(),
            frame_count
        );
    }
    let largest = model.frames.iter().map(|view| view.capture.positions.len()).max().unwrap_or(0);
    if largest > plan.capture_vertices {
        notice.push_str(&format!(
            "Captures are simplified to at most {} vertices for display; all numbers come from the full captures.",
            plan.capture_vertices
        ));
    }
    notice
}

fn blocks(viewer: &Viewer) -> String {
    let block = |id: String, base64: &str| {
        format!("<script type=\"application/octet-stream\" id=\"{id}\">{base64}</script>\n")
    };
    let frames =
        viewer.frames.iter().enumerate().map(|(i, frame)| block(format!("block-frame-{i}"), &frame.base64));
    std::iter::once(block("block-body".to_owned(), &viewer.body.base64)).chain(frames).collect()
}

/// Puts values in the place of `{{name}}` in one pass, so a value is never searched itself.
fn filled(template: &str, values: &[(&str, String)]) -> String {
    let mut out =
        String::with_capacity(template.len() + values.iter().map(|(_, value)| value.len()).sum::<usize>());
    let mut rest = template;
    while let Some((before, after)) = rest.split_once("{{") {
        out.push_str(before);
        let Some((name, remainder)) = after.split_once("}}") else {
            rest = after;
            break;
        };
        out.push_str(values.iter().find(|(key, _)| *key == name).map_or("", |(_, value)| value));
        rest = remainder;
    }
    out.push_str(rest);
    out
}
