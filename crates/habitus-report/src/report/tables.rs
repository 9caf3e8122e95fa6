//! Tables and small charts of the page as HTML; everything that came from outside is escaped.

use std::collections::BTreeMap;
use std::fmt::Write;

use super::markup::{duration, escaped, number};
use super::{FrameSummary, IdentityCoefficient, ReportData};

/// A section with a heading; nothing when it has no content.
pub(crate) fn section(id: &str, title: &str, note: &str, content: &str) -> String {
    if content.is_empty() {
        return String::new();
    }
    let note = if note.is_empty() {
        String::new()
    } else {
        format!("<p class=\"section-note\">{}</p>", escaped(note))
    };
    format!(
        "<section class=\"card {id}\" aria-labelledby=\"{id}-title\"><header class=\"card-head\"><h2 id=\"{id}-title\">{title}</h2>{note}</header>{content}</section>"
    )
}

/// The class that says how far a frame can be trusted.
pub(crate) fn trust(frame: &FrameSummary) -> &'static str {
    match (frame.is_ok, frame.codes.is_empty()) {
        (false, _) => "failed",
        (true, false) => "flagged",
        (true, true) => "clean",
    }
}

/// One line that tells whether the run can be used.
pub(crate) fn verdict(data: &ReportData) -> String {
    let count = |class: &str| data.frames.iter().filter(|frame| trust(frame) == class).count();
    let (total, failed, flagged) = (data.frames.len(), count("failed"), count("flagged"));
    let (class, text) = match (total, failed, flagged + data.sequence_codes.len()) {
        (0, _, _) => ("flagged", "No frames".to_owned()),
        (_, 0, 0) => ("clean", format!("All {total} frames accepted")),
        (_, 0, _) => ("flagged", format!("All {total} frames accepted, {flagged} with remarks")),
        _ => ("failed", format!("{failed} of {total} frames not usable, {flagged} with remarks")),
    };
    format!("<p class=\"verdict {class}\"><span class=\"dot\" aria-hidden=\"true\"></span>{text}</p>")
}

pub(crate) fn headlines(data: &ReportData) -> String {
    let tile = |h: &super::Headline| {
        format!(
            "<div class=\"tile\"><dt>{}</dt><dd><span class=\"figure\">{}</span> <span class=\"unit\">{}</span><span class=\"note\">{}</span></dd></div>",
            escaped(&h.label),
            escaped(&h.value),
            escaped(&h.unit),
            escaped(&h.note)
        )
    };
    let tiles: String = data.headlines.iter().map(tile).collect();
    if tiles.is_empty() {
        tiles
    } else {
        format!("<dl class=\"tiles\" aria-label=\"Key figures\">{tiles}</dl>")
    }
}

pub(crate) fn measurements(data: &ReportData) -> String {
    if data.measurements.is_empty() {
        return String::new();
    }
    let mut rows = String::new();
    for (row, m) in data.measurements.iter().enumerate() {
        let plus_minus = m.plus_minus.map_or(String::new(), |value| format!("± {}", number(value, 1)));
        let (mark, interactive) = if m.curve.is_some() {
            (
                "<span class=\"curve-mark\" aria-hidden=\"true\"></span>",
                format!(" data-row=\"{row}\" tabindex=\"0\" title=\"Show on the body\""),
            )
        } else {
            ("", String::new())
        };
        let _ = write!(
            rows,
            "<tr{interactive}><th scope=\"row\">{mark}{}</th><td class=\"num\">{}</td><td class=\"num pm\">{plus_minus}</td><td class=\"unit\">{}</td><td class=\"definition\">{}</td></tr>",
            escaped(&m.name),
            number(m.value, 1),
            escaped(&m.unit),
            escaped(&m.definition)
        );
    }
    format!(
        "<div class=\"scroll\"><table><thead><tr><th scope=\"col\">Measurement</th><th scope=\"col\" class=\"num\">Value</th><th scope=\"col\" class=\"num\">Error</th><th scope=\"col\">Unit</th><th scope=\"col\">Definition</th></tr></thead><tbody>{rows}</tbody></table></div>"
    )
}

/// A bar a coefficient between −3 and 3 standard deviations, with its error.
pub(crate) fn identity(coefficients: &[IdentityCoefficient]) -> String {
    if coefficients.is_empty() {
        return String::new();
    }
    let (width, height, left, top, bottom) = (560.0, 190.0, 34.0, 8.0, 24.0);
    let y = |value: f64| top + (height - top - bottom) * (3.2 - value.clamp(-3.2, 3.2)) / 6.4;
    let slot = (width - left - 8.0) / coefficients.len() as f64;
    let mut out = format!(
        "<svg class=\"identity-bars\" viewBox=\"0 0 {width} {height}\" role=\"img\" aria-label=\"{} identity coefficients in standard deviations\">",
        coefficients.len()
    );
    for level in [-3.0f64, -2.0, -1.0, 0.0, 1.0, 2.0, 3.0] {
        let class = if level == 0.0 {
            "zero"
        } else if level.abs() == 3.0 {
            "limit"
        } else {
            "grid"
        };
        let _ = write!(out, "<path class=\"{class}\" d=\"M{left} {:.1}H{}\"/>", y(level), width - 8.0);
        let _ = write!(
            out,
            "<text class=\"tick\" x=\"{}\" y=\"{:.1}\" text-anchor=\"end\">{}</text>",
            left - 7.0,
            y(level) + 3.5,
            number(level, 0)
        );
    }
    let label_step = (coefficients.len() / 10).max(1);
    for (i, c) in coefficients.iter().enumerate().filter(|(_, c)| c.value.is_finite()) {
        let middle = left + slot * (i as f64 + 0.5);
        let (from, to) = (y(c.value.max(0.0)), y(c.value.min(0.0)));
        let half = (0.36 * slot).min(14.0);
        let class = if c.value.abs() >= 2.999 { "bar at-limit" } else { "bar" };
        let error = c.plus_minus.map_or(String::new(), |e| format!(" ± {}", number(e, 2)));
        let _ = write!(
            out,
            "<rect class=\"{class}\" x=\"{:.1}\" y=\"{from:.1}\" width=\"{:.1}\" height=\"{:.1}\" rx=\"1.5\"><title>Coefficient {}: {}{error}</title></rect>",
            middle - half,
            2.0 * half,
            (to - from).max(0.5),
            i + 1,
            number(c.value, 2)
        );
        if let Some(error) = c.plus_minus.filter(|error| error.is_finite()) {
            let _ = write!(
                out,
                "<path class=\"whisker\" d=\"M{middle:.1} {:.1}V{:.1}\"/>",
                y(c.value + error),
                y(c.value - error)
            );
        }
        if i == 0 || (i + 1) % label_step == 0 {
            let _ = write!(
                out,
                "<text class=\"tick\" x=\"{middle:.1}\" y=\"{}\" text-anchor=\"middle\">{}</text>",
                height - 7.0,
                i + 1
            );
        }
    }
    out.push_str("</svg>");
    out
}

/// Which codes fired, how often, what they mean, and where to look.
pub(crate) fn codes(data: &ReportData) -> String {
    let mut frames_of: BTreeMap<&str, Vec<usize>> = BTreeMap::new();
    for (frame, summary) in data.frames.iter().enumerate() {
        for code in &summary.codes {
            frames_of.entry(code).or_default().push(frame);
        }
    }
    let meaning =
        |code: &str| data.code_meanings.iter().find(|m| m.code == code).map_or("", |m| m.meaning.as_str());
    let mut rows = String::new();
    for code in &data.sequence_codes {
        let cells = [escaped(code), "whole sequence".to_owned(), escaped(meaning(code))];
        let _ = write!(
            rows,
            "<tr><th scope=\"row\"><code>{}</code></th><td>{}</td><td class=\"definition\">{}</td></tr>",
            cells[0], cells[1], cells[2]
        );
    }
    for (code, frames) in &frames_of {
        let shown = frames.iter().take(12).map(|frame| {
            format!(
                "<button type=\"button\" class=\"chip\" data-frame=\"{frame}\" title=\"{}\">{}</button>",
                escaped(&data.frames[*frame].name),
                frame + 1
            )
        });
        let shown: String = shown.collect();
        let rest = frames.len().saturating_sub(12);
        let rest =
            if rest > 0 { format!("<span class=\"more\">and {rest} more</span>") } else { String::new() };
        let _ = write!(
            rows,
            "<tr><th scope=\"row\"><code>{}</code><span class=\"count\">{} frame{}</span></th><td class=\"chips\">{shown}{rest}</td><td class=\"definition\">{}</td></tr>",
            escaped(code),
            frames.len(),
            if frames.len() == 1 { "" } else { "s" },
            escaped(meaning(code))
        );
    }
    if rows.is_empty() {
        return "<p class=\"calm\">No code fired.</p>".to_owned();
    }
    format!(
        "<div class=\"scroll\"><table><thead><tr><th scope=\"col\">Code</th><th scope=\"col\">Frames</th><th scope=\"col\">Meaning</th></tr></thead><tbody>{rows}</tbody></table></div>"
    )
}

pub(crate) fn timings(data: &ReportData) -> String {
    let total: f64 =
        data.timings.iter().map(|timing| timing.seconds).filter(|seconds| seconds.is_finite()).sum();
    if data.timings.is_empty() || total <= 0.0 {
        return String::new();
    }
    let mut rows = String::new();
    for timing in &data.timings {
        let share = (timing.seconds / total * 100.0).clamp(0.0, 100.0);
        let _ = write!(
            rows,
            "<tr><th scope=\"row\">{}</th><td class=\"num\">{}</td><td class=\"bar-cell\"><span class=\"hbar\" style=\"width:{share:.1}%\"></span></td></tr>",
            escaped(&timing.stage),
            duration(timing.seconds)
        );
    }
    format!(
        "<table><thead class=\"quiet\"><tr><th scope=\"col\">Stage</th><th scope=\"col\" class=\"num\">Time</th><th scope=\"col\">Share</th></tr></thead><tbody>{rows}</tbody><tfoot><tr><th scope=\"row\">Total</th><td class=\"num\">{}</td><td></td></tr></tfoot></table>",
        duration(total)
    )
}

pub(crate) fn truth(data: &ReportData) -> String {
    if data.truth.is_empty() {
        return String::new();
    }
    let row = |t: &super::TruthRow| {
        let value = number(t.value, 2);
        format!(
            "<tr><th scope=\"row\">{}</th><td class=\"num\">{value}</td><td class=\"unit\">{}</td></tr>",
            escaped(&t.metric),
            escaped(&t.unit)
        )
    };
    let rows: String = data.truth.iter().map(row).collect();
    format!(
        "<table><thead class=\"quiet\"><tr><th scope=\"col\">Metric</th><th scope=\"col\" class=\"num\">Value</th><th scope=\"col\">Unit</th></tr></thead><tbody>{rows}</tbody></table>"
    )
}

/// All frames as a list of buttons beside the 3D view.
pub(crate) fn frame_list(frames: &[FrameSummary]) -> String {
    let item = |(number, frame): (usize, &FrameSummary)| {
        let codes: String =
            frame.codes.iter().map(|code| format!("<span class=\"code\">{}</span>", escaped(code))).collect();
        let class = trust(frame);
        let word = match class {
            "failed" => "not usable",
            "flagged" => "with remarks",
            _ => "accepted",
        };
        format!(
            "<li><button type=\"button\" data-frame=\"{number}\" class=\"frame {class}\"><span class=\"dot\" aria-hidden=\"true\"></span><span class=\"ordinal\">{}</span><span class=\"name\">{}</span><span class=\"visually-hidden\">{word}</span>{codes}</button></li>",
            number + 1,
            escaped(&frame.name)
        )
    };
    frames.iter().enumerate().map(item).collect()
}
