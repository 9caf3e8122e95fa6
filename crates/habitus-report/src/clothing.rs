//! The page of `evaluate clothing`: tables beside the paper's form, and the error of each frame as a curve.

use std::collections::BTreeMap;

use habitus::evaluation::clothing_metrics::ClothingMetrics;

use crate::report::markup::{escaped, number};

const STYLE: &str = "body{font:15px/1.5 system-ui,sans-serif;max-width:60rem;margin:2rem auto;padding:0 1rem;color:#222}\
table{border-collapse:collapse;margin:.5rem 0 1.5rem}th,td{padding:.25rem .8rem;border-bottom:1px solid #ddd;\
text-align:right}th:first-child,td:first-child{text-align:left}svg{max-width:100%;height:auto}.note{color:#666}";

/// One self-contained HTML page.
pub fn clothing_page(metrics: &ClothingMetrics) -> String {
    let title = format!("Clothing of {} sequences, {} frames", metrics.sequences.len(), metrics.frames);
    let sections = [
        components(metrics),
        regression(metrics),
        left_out(metrics),
        section(
            "Error of each frame",
            "Default recipe; the frames right of the line were set aside. Mean vertex position error.",
            &curve(metrics),
        ),
        quality(metrics),
        controls(metrics),
    ];
    format!(
        "<!doctype html><html lang=\"en\"><head><meta charset=\"utf-8\"><title>{0}</title><style>{STYLE}</style>\
         </head><body><h1>{0}</h1>{1}</body></html>\n",
        escaped(&title),
        sections.concat()
    )
}

fn section(title: &str, note: &str, content: &str) -> String {
    format!("<h2>{}</h2><p class=\"note\">{}</p>{content}", escaped(title), escaped(note))
}

/// A table; numbers with two decimals.
fn table(head: &[&str], rows: &[(String, Vec<f64>)]) -> String {
    let head: String = head.iter().map(|name| format!("<th>{}</th>", escaped(name))).collect();
    let rows: String = rows
        .iter()
        .map(|(name, values)| {
            let cells: String =
                values.iter().map(|value| format!("<td>{}</td>", number(*value, 2))).collect();
            format!("<tr><td>{}</td>{cells}</tr>", escaped(name))
        })
        .collect();
    format!("<table><tr>{head}</tr>{rows}</table>")
}

fn components(metrics: &ClothingMetrics) -> String {
    let order = ["1", "5", "40", "all"];
    let row = |name: &str, errors: &BTreeMap<String, f64>| {
        let values = order.iter().map(|count| errors.get(*count).copied().unwrap_or(f64::NAN)).collect();
        (name.to_owned(), values)
    };
    let rows = [
        row("poses settled on the surface", &metrics.pca_error_mm),
        row("poses as fitted", &metrics.pca_error_fitted_poses_mm),
    ];
    section(
        "Reconstruction by components",
        "Mean vertex position error in mm with 1, 5, 40 and all components.",
        &table(&["", "1", "5", "40", "all"], &rows),
    )
}

fn regression(metrics: &ClothingMetrics) -> String {
    let mut rows = Vec::new();
    for (recipe, splits) in &metrics.regression {
        for (split, errors) in splits {
            rows.push((format!("{recipe}, {split}"), vec![errors.train_mm, errors.prediction_mm]));
        }
    }
    for (split, baselines) in &metrics.baselines {
        for (name, error) in baselines {
            rows.push((format!("{name}, {split}"), vec![f64::NAN, *error]));
        }
    }
    section(
        "Regression",
        "Mean vertex position error in mm of frames learnt from and of frames set aside.",
        &table(&["recipe or baseline, split", "train", "prediction"], &rows),
    )
}

fn left_out(metrics: &ClothingMetrics) -> String {
    let Some(first) = metrics.left_out.values().next() else { return String::new() };
    let names: Vec<&str> = first.keys().map(String::as_str).collect();
    let head: Vec<&str> = std::iter::once("sequence left out").chain(names.iter().copied()).collect();
    let row = |(name, found): (&String, &BTreeMap<String, f64>)| {
        let values = names.iter().map(|method| found.get(*method).copied().unwrap_or(f64::NAN));
        (name.clone(), values.collect())
    };
    let rows: Vec<(String, Vec<f64>)> = metrics.left_out.iter().map(row).collect();
    section("Sequences that were not learnt from", "Prediction error in mm.", &table(&head, &rows))
}

fn quality(metrics: &ClothingMetrics) -> String {
    let inside = |name: &str, found: &habitus::artifacts::synthesized_sequence::Penetration, error: f64| {
        let values = vec![100.0 * found.inside_share, found.mean_depth_mm, found.deepest_mm, error];
        (name.to_owned(), values)
    };
    let rows = [
        inside("before the push-out", &metrics.penetration_before, metrics.prediction_before_push_out_mm),
        inside("after it", &metrics.penetration_after, metrics.prediction_after_push_out_mm),
    ];
    let note = format!(
        "Predicted frames of the block that was set aside. Normals differ by {}° and accelerations by {} m/s² on average.",
        number(metrics.normal_error_deg, 1),
        number(metrics.acceleration_error, 2)
    );
    let head =
        ["clothing inside the body", "% of vertices", "mean depth, mm", "deepest, mm", "vertex error, mm"];
    section("Penetration", &note, &table(&head, &rows))
}

fn controls(metrics: &ClothingMetrics) -> String {
    let Some(first) = metrics.control_response_mm.values().next() else { return String::new() };
    let bones: Vec<&str> = first.keys().map(String::as_str).collect();
    let head: Vec<&str> = std::iter::once("control").chain(bones.iter().copied()).collect();
    let row = |(name, found): (&String, &BTreeMap<String, f64>)| {
        (name.clone(), bones.iter().map(|bone| found.get(*bone).copied().unwrap_or(f64::NAN)).collect())
    };
    let rows: Vec<(String, Vec<f64>)> = metrics.control_response_mm.iter().map(row).collect();
    section(
        "What each control moves",
        "Mean movement in mm of the clothing on each bone, from the control's smallest to its largest value, the others \
         at their means.",
        &table(&head, &rows),
    )
}

/// Errors over frames as a line, with the border between frames learnt from and frames set aside.
pub fn curve(metrics: &ClothingMetrics) -> String {
    const WIDTH: f64 = 900.0;
    const HEIGHT: f64 = 240.0;
    const MARGIN: f64 = 40.0;
    let errors = &metrics.frame_error_mm;
    let largest = errors.iter().copied().filter(|error| error.is_finite()).fold(1.0, f64::max);
    let count = errors.len().max(2) as f64 - 1.0;
    let x = |frame: f64| MARGIN + (WIDTH - 2.0 * MARGIN) * frame / count;
    let y = |error: f64| HEIGHT - MARGIN - (HEIGHT - 2.0 * MARGIN) * error / largest;
    let points: Vec<String> = errors
        .iter()
        .enumerate()
        .map(|(frame, error)| format!("{:.1},{:.1}", x(frame as f64), y(*error)))
        .collect();
    let border = x(metrics.block_start as f64);
    let steps = (0..=4).map(|step| {
        let value = largest * f64::from(step) / 4.0;
        format!(
            "<line x1=\"{MARGIN}\" x2=\"{0}\" y1=\"{1:.1}\" y2=\"{1:.1}\" stroke=\"#ddd\"/><text x=\"{2}\" y=\"{3:.1}\" \
             font-size=\"12\" text-anchor=\"end\">{4}</text>",
            WIDTH - MARGIN,
            y(value),
            MARGIN - 6.0,
            y(value) + 4.0,
            number(value, 1)
        )
    });
    format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH} {HEIGHT}\" font-family=\"sans-serif\">{}\
         <line x1=\"{border:.1}\" x2=\"{border:.1}\" y1=\"{MARGIN}\" y2=\"{}\" stroke=\"#888\" stroke-dasharray=\"4\"/>\
         <polyline fill=\"none\" stroke=\"#2a6fb0\" stroke-width=\"1.5\" points=\"{}\"/><text x=\"{}\" y=\"{}\" \
         font-size=\"12\" text-anchor=\"middle\">frame</text><text x=\"{MARGIN}\" y=\"20\" font-size=\"12\">error, mm</text>\
         </svg>",
        steps.collect::<String>(),
        HEIGHT - MARGIN,
        points.join(" "),
        WIDTH / 2.0,
        HEIGHT - 8.0
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_page_shows_every_number_and_no_name_breaks_it() {
        let mut metrics =
            ClothingMetrics { sequences: vec!["<walk>".into()], frames: 3, ..Default::default() };
        metrics.pca_error_mm = [("1", 26.51), ("5", 14.82), ("40", 3.07), ("all", 0.01)]
            .map(|(count, error)| (count.to_owned(), error))
            .into();
        metrics.left_out.insert("<walk>".into(), [("mean".to_owned(), 12.345)].into());
        metrics.frame_error_mm = vec![1.0, 2.0, 8.0];
        metrics.block_start = 2;
        let page = clothing_page(&metrics);
        for needle in ["26.51", "14.82", "3.07", "12.3", "&lt;walk&gt;", "<polyline"] {
            assert!(page.contains(needle), "{needle}");
        }
        assert!(!page.contains("<walk>"));
    }
}
